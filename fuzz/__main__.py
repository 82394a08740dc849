"""Command line of the fuzzer: ``python -m fuzz NAME ... | all [--cases N] [--seed S] [--case K]``."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

from fuzz.parent import Tally, run
from fuzz.target import MODULES, Target, targets_of
from fuzz.worker import Failure, Job

_SHOWN = 5
"""Maximum number of printed failures per target. All are counted."""


def parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    made = argparse.ArgumentParser(prog="python -m fuzz", description="Feed hostile inputs to whatever reads any.")
    made.add_argument("names", nargs="+", metavar="NAME", help="targets; 'all' for all of them, 'list' to name them")
    made.add_argument("--cases", type=int, default=1000, help="of each target; with 'all' of all together (1000)")
    made.add_argument("--seed", type=int, default=0, help="another seed gives other cases (0)")
    made.add_argument("--case", type=int, help="run this one alone")
    made.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes side by side; one for each core")
    made.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="folder for failing inputs (out/fuzz)")
    return made


def runs_here() -> bool:
    """Tell whether the fuzzer runs on this system, and say so if not."""
    if sys.platform == "linux":
        return True
    print(
        "the fuzzer runs on Linux only: it reads the memory and the time of its processes from /proc; "
        "run it in a container or a virtual machine",
        file=sys.stderr,
    )
    return False


def share_out(targets: dict[str, Target], cases: int) -> dict[str, int]:
    """Distribute a number of cases over the targets."""
    whole = sum(target.share for target in targets.values())
    return {name: max(1, round(cases * target.share / whole)) for name, target in targets.items()}


def keep(failures: list[Failure], folder: Path, modules: tuple[str, ...] = MODULES) -> None:
    """Write the inputs of failures."""
    folder.mkdir(parents=True, exist_ok=True)
    where = str(folder.resolve())
    run([Job(f.name, f.seed, f.case, f.case + 1, modules, where) for f in failures], n_children=1)


def report(tallies: dict[str, Tally]) -> list[str]:
    """Format a table of the targets and their failures."""
    heads = "cases", "returned", "refused", "failed", "slowest", "memory", "/s"
    lines = [f"{'target':<22}" + "".join(f"{head:>10}" for head in heads)]
    for name, tally in tallies.items():
        rate = tally.cases / max(tally.seconds, 1e-9)
        lines.append(
            f"{name:<22}{tally.cases:>10}{tally.returned:>10}{tally.refused:>10}{len(tally.failures):>10}"
            f"{tally.slowest:>8.2f} s{tally.growth / 1e6:>7.0f} MB{rate:>10.0f}"
        )
    for tally in tallies.values():
        for failure in tally.failures[:_SHOWN]:
            lines += ["", f"{failure.kind}: python -m fuzz {failure.name} --seed {failure.seed} --case {failure.case}"]
            lines += [f"  {line}" for line in failure.what.splitlines()]
    return lines


def main(arguments: list[str], modules: tuple[str, ...] = MODULES) -> int:
    """Run the requested targets. Return 1 if anything failed."""
    asked = parser().parse_args(arguments)
    if not runs_here():
        return 2
    targets = targets_of(*modules)
    if asked.names == ["list"]:
        print("\n".join(targets))
        return 0
    unknown = [name for name in asked.names if name not in targets and name != "all"]
    if unknown:
        print(f"no target {', '.join(unknown)}; there are all, {', '.join(targets)}", file=sys.stderr)
        return 2
    everything = "all" in asked.names
    counts = share_out(targets, asked.cases) if everything else dict.fromkeys(asked.names, int(asked.cases))
    jobs = [Job(name, asked.seed, 0, count, modules) for name, count in counts.items()]
    if asked.case is not None:
        jobs = [replace(job, first=asked.case, stop=asked.case + 1) for job in jobs]
    tallies = run(jobs, asked.jobs)
    print("\n".join(report(tallies)))
    failures = [failure for tally in tallies.values() for failure in tally.failures]
    if not failures:
        return 0
    keep([f for f in failures if f.kind != "making"][:100], asked.keep, modules)
    print(f"\n{len(failures)} of {sum(t.cases for t in tallies.values())} cases failed; inputs are in {asked.keep}")
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
