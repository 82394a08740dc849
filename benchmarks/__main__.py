"""Run every benchmark: ``python -m benchmarks [NAME ...]``."""

import sys

from benchmarks import batch, batched, fit, iteration, relight, search, studio, track

BENCHMARKS = {
    "iteration": iteration.main,
    "fit": fit.main,
    "search": search.main,
    "track": track.main,
    "studio": studio.main,
    "batch": batch.main,
    "batched": batched.main,
    "relight": relight.main,
}
"""Benchmark by name; each prints its metrics."""


def main(names: list[str]) -> int:
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    for name in names or BENCHMARKS:
        BENCHMARKS[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
