"""Fuzzing that is guided by coverage: ``python -m fuzz.guided NAME ... [--seconds N]``.

Needs Atheris (``pip install atheris``). It mutates bytes, keeps what reaches new lines of liaam or Pillow, and mutates
that further. Only targets whose inputs are bytes can be fuzzed so. The property is that of :mod:`fuzz`.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

from fuzz.__main__ import runs_here
from fuzz.target import MODULES, Target, targets_of
from fuzz.worker import Limits, outcome_of
from liaam.errors import LiaamError

INSTRUMENTED = ("liaam", "PIL")
"""Packages whose coverage guides."""

N_SEEDS = 400
"""Inputs of a target that it begins with."""

LONGEST = 60_000
"""Bytes of an input at most."""

_RUNS = re.compile(r"stat::number_of_executed_units: (\d+)")
_COVERED = re.compile(r"#\d+\s+DONE\s+cov: (\d+) ft: (\d+) corp: (\d+)")


class Broken(Exception):  # noqa: N818 (what Atheris looks for)
    """An input breaks the property."""


def suited() -> dict[str, Target]:
    """Targets whose inputs are bytes."""
    return {name: target for name, target in targets_of(*MODULES).items() if isinstance(target.input_of(0, 0), bytes)}


def check_one(target: Target, data: bytes, limits: Limits) -> None:
    """Feed an input to a target.

    Raises
    ------
    Broken
        If it breaks the property.
    """
    begun = time.process_time()
    outcome = outcome_of(target, data)
    taken = time.process_time() - begun
    if not isinstance(outcome, str):
        raise Broken(": ".join(outcome))
    if taken > limits.seconds:
        raise Broken(f"time: {taken:.1f} s")


def _child(name: str, corpus: str, seconds: str, under_way: str) -> None:
    """Fuzz in this process, which ends then; the input under way is written to a file, which outlives a crash."""
    atheris: Any = importlib.import_module("atheris")  # optional
    warnings.simplefilter("ignore")
    with atheris.instrument_imports(include=list(INSTRUMENTED)):
        target = suited()[name]
        target.prepare()
    _write_seeds(target, Path(corpus))
    limits = Limits()
    # What libFuzzer compares with its limit, which includes the peak of the parent.
    resident = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    options = {
        "max_total_time": seconds,
        "max_len": LONGEST,
        "timeout": round(5 * limits.seconds),
        "rss_limit_mb": (resident + limits.n_bytes) // 1_000_000,
        "print_final_stats": 1,
    }
    written = os.open(under_way, os.O_CREAT | os.O_WRONLY)

    def check(data: bytes) -> None:
        os.pwrite(written, len(data).to_bytes(8, "little") + data, 0)
        check_one(target, data, limits)

    atheris.Setup([name, *(f"-{key}={value}" for key, value in options.items()), corpus], check)
    atheris.Fuzz()


def _write_seeds(target: Target, corpus: Path) -> None:
    corpus.mkdir()
    for case in range(N_SEEDS):
        (corpus / f"{case}").write_bytes(target.input_of(0, case)[:LONGEST])


def fuzz(name: str, seconds: int, keep: Path) -> tuple[int, str]:
    """Fuzz a target in a process of its own.

    Parameters
    ----------
    name : str
    seconds : int
    keep : Path
        Folder for an input that breaks the property.

    Returns
    -------
    int
        The exit status: 0 if nothing was found.
    str
        What was found: the cases that ran, and the fault if there is one.
    """
    path = [str(Path(__file__).parents[1]), *sys.path[1:]]
    code = f"import sys; sys.path[:0] = {path!r}; from fuzz.guided import _child; _child(*sys.argv[1:])"
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory(prefix="liaam-fuzz-") as folder:
        work, under_way = Path(folder) / "work", Path(folder) / "under-way"
        work.mkdir()
        command = [sys.executable, "-c", code, name, f"{folder}/corpus", str(seconds), str(under_way)]
        done = subprocess.run(command, cwd=work, env=environment, capture_output=True, check=False)
        said, printed = (text.decode(errors="replace") for text in (done.stderr, done.stdout))
        if done.returncode == 0:
            return 0, _in_short(said)
        fault = "\n".join([*printed.splitlines()[-15:], *said.splitlines()[-10:]])
        return done.returncode, f"{_in_short(said)}{_kept(name, under_way, keep)}\n{fault}"


def _kept(name: str, under_way: Path, keep: Path) -> str:
    """Keep the input that was under way; says how to run it again."""
    if not under_way.exists():
        return ""
    written = under_way.read_bytes()
    data = written[8:][: int.from_bytes(written[:8], "little")]
    keep.mkdir(parents=True, exist_ok=True)
    path = keep / f"{name}-guided-{hashlib.sha256(data).hexdigest()[:12]}.bin"
    path.write_bytes(data)
    return f": python -m fuzz.guided {name} --input {path}"


def _in_short(said: str) -> str:
    """Say how much Atheris did, by its own words."""
    runs, covered = _RUNS.search(said), _COVERED.search(said)
    if not runs or not covered:
        return "it did not come to its end"
    return f"{runs[1]} cases, {covered[1]} places reached, {covered[3]} inputs kept"


def parser() -> argparse.ArgumentParser:
    """What can be said on the command line."""
    made = argparse.ArgumentParser(prog="python -m fuzz.guided", description="Fuzz, guided by coverage.")
    made.add_argument("names", nargs="+", metavar="NAME", help="targets; 'all' for all, 'list' to name them")
    made.add_argument("--seconds", type=int, default=60, help="for each target (60)")
    made.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="folder for failing inputs (out/fuzz)")
    made.add_argument("--input", type=Path, help="feed this file to the target, alone")
    return made


def main(arguments: list[str]) -> int:
    """Run what is asked for; 1 if anything failed."""
    asked = parser().parse_args(arguments)
    if not runs_here():
        return 2
    targets = suited()
    if asked.names == ["list"]:
        print("\n".join(targets))
        return 0
    names = list(targets) if asked.names == ["all"] else asked.names
    unknown = [name for name in names if name not in targets]
    if unknown:
        print(f"no target {', '.join(unknown)} of bytes; there are all, {', '.join(targets)}", file=sys.stderr)
        return 2
    if asked.input is not None:
        return _replay(targets[names[0]], asked.input.read_bytes())
    if importlib.util.find_spec("atheris") is None:
        print("Atheris is not installed: pip install atheris (Linux, Python 3.11 to 3.13)", file=sys.stderr)
        return 2
    failed = False
    for name in names:
        status, what = fuzz(name, asked.seconds, asked.keep)
        failed |= status != 0
        print(f"{name:<22}{'FAILED ' if status else ''}{what}", flush=True)
    return int(failed)


def _replay(target: Target, data: bytes) -> int:
    with tempfile.TemporaryDirectory(prefix="liaam-fuzz-") as folder:
        os.chdir(folder)
        target.prepare()
        try:
            target.check(data)
        except LiaamError as error:
            print(f"refused: {error}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
