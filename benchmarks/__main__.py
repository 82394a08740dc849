"""Run every benchmark: ``python -m benchmarks [NAME ...] [--save | --compare]``."""

import argparse
import sys

from benchmarks import batch, fit, iteration, load, many, metrics, objects, peers, relight, search, soak, studio, track
from benchmarks.metrics import Metrics
from liaam.errors import LiaamError

BENCHMARKS = {
    "iteration": iteration.main,
    "fit": fit.main,
    "peers": peers.main,
    "search": search.main,
    "track": track.main,
    "studio": studio.main,
    "load": load.main,
    "soak": soak.main,
    "batch": batch.main,
    "many": many.main,
    "relight": relight.main,
    "objects": objects.main,
}
"""Benchmark by name; each reports its metrics."""


def parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    made = argparse.ArgumentParser(prog="python -m benchmarks", description="Print named metrics.")
    made.add_argument("names", nargs="*", metavar="NAME", help=f"which: {', '.join(BENCHMARKS)}; all if left out")
    what = made.add_mutually_exclusive_group()
    what.add_argument("--save", action="store_true", help=f"write the metrics to benchmarks/{metrics.BASELINE.name}")
    what.add_argument("--compare", action="store_true", help="print them beside those of that file")
    return made


def run(names: list[str], save: bool = False) -> dict[str, Metrics]:
    """Run benchmarks and return the metrics of each. Save them after each benchmark if `save`."""
    measured: dict[str, Metrics] = {}
    for name in names:
        with metrics.recording() as measured[name]:
            BENCHMARKS[name]()
        if save:
            metrics.save_baseline({name: measured[name]}, metrics.BASELINE)
    return measured


def main(arguments: list[str]) -> int:
    """Run the requested benchmarks. Return 0 even if metrics have moved, since times depend on the machine."""
    asked = parser().parse_args(arguments)
    unknown = [name for name in asked.names if name not in BENCHMARKS]
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    try:
        if asked.save or asked.compare:
            metrics.read_baseline(metrics.BASELINE)  # raise before any work
        measured = run(asked.names or list(BENCHMARKS), asked.save)
        if asked.compare:
            print("\n" + "\n".join(metrics.compare(measured, metrics.BASELINE)))
    except LiaamError as fault:
        print(fault, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
