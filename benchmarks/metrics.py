"""What all benchmarks share: metrics that are printed and recorded, calls timed in turn, and the committed baseline."""

import json
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from liaam.errors import LiaamError
from liaam.io.atomic import write_bytes_atomically

BASELINE = Path(__file__).with_name("baseline.json")

MOVED = 1.25
"""Quotient, either way round, beyond which a metric has moved."""

Value = float | bool | None
Metrics = dict[str, Value]

_recorders: list[Metrics] = []


class BaselineError(LiaamError):
    """A baseline that cannot be read."""


def report(name: str, value: float | bool, note: str = "", *, form: str = ".3f", width: int = 0) -> None:
    """Print a metric, and record it where something records.

    Parameters
    ----------
    name : str
    value : float or bool
    note : str
        What else there is to say: the unit, quartiles, the bar.
    form : str
        Format of the value.
    width : int
        Of the name, in a table with aligned columns; 0 for plain lines.
    """
    value = bool(value) if isinstance(value, bool | np.bool_) else float(value)
    told = str(value) if isinstance(value, bool) else format(value, form)
    line = f"  {name:<{width}}{told:>8}   {note}" if width else f"{name} {told} {note}"
    print(line.rstrip(), flush=True)
    for recorder in _recorders:
        # JSON has no NaN.
        recorder[name] = value if isinstance(value, bool) else float(f"{value:.6g}") if np.isfinite(value) else None


@contextmanager
def recording() -> Iterator[Metrics]:
    """Give a dictionary that fills with the metrics reported meanwhile."""
    metrics: Metrics = {}
    _recorders.append(metrics)
    try:
        yield metrics
    finally:
        _recorders.pop()


def in_turn(
    blocks: Mapping[str, Sequence[Callable[[], object]]], rounds: int, warm_up: int = 1
) -> dict[str, np.ndarray]:
    """Milliseconds of calls, {name: (rounds, n)}.

    All are timed in turn, round by round, so that a busy spell of the machine touches all alike. The first rounds,
    ``warm_up`` of them, are not counted. What counts is the processor's time, of all threads together: of one thread
    it is that of the clock, but for what others on the machine take.
    """
    times = {name: np.empty((rounds, len(calls))) for name, calls in blocks.items()}
    for i in range(-warm_up, rounds):
        for name, calls in blocks.items():
            for j, call in enumerate(calls):
                begin = process_time()
                call()
                if i >= 0:
                    times[name][i, j] = 1e3 * (process_time() - begin)
    return times


def quartiles(values: np.ndarray, form: str = ".2f") -> str:
    """The quartiles, for a metric's note."""
    low, high = np.percentile(values, [25, 75])
    return f"quartiles {low:{form}} to {high:{form}}"


def machine() -> dict[str, Any]:
    """What numbers depend on: the processor's name, its cores, and the versions of what computes."""
    from importlib.metadata import version

    return {
        "processor": processor_name(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "numba", "scipy")},
    }


def processor_name() -> str:
    """Name of the processor, as far as the system tells it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def read_baseline(path: Path) -> dict[str, Any]:
    """Read a baseline, {benchmark: {"machine": ..., "metrics": ...}}; an empty one where there is none yet."""
    if not path.exists():
        return {}
    try:
        found = json.loads(path.read_text())
    except ValueError as fault:
        raise BaselineError(
            f"{path} is not JSON ({fault}); take it from the repository, or delete it and save anew"
        ) from None
    parts = found.values() if isinstance(found, dict) else [None]
    if not all(isinstance(part, dict) and {"machine", "metrics"} <= part.keys() for part in parts):
        raise BaselineError(f"{path} is no baseline; take it from the repository, or delete it and save anew")
    return found


def save_baseline(measured: Mapping[str, Metrics], path: Path) -> None:
    """Write the metrics of benchmarks, and where they were measured; benchmarks that did not run keep theirs.

    One that reported nothing, for lack of data say, keeps what it has too.
    """
    here = machine()
    fresh = {name: {"machine": here, "metrics": metrics} for name, metrics in measured.items() if metrics}
    text = json.dumps({**read_baseline(path), **fresh}, indent=2, allow_nan=False)
    write_bytes_atomically(path, f"{text}\n".encode())


def has_moved(before: Value, now: Value) -> bool:
    """Tell whether a metric differs by more than a quarter, either way round; what is no number has to be the same."""
    ratio = ratio_of(before, now)
    return before != now if ratio is None else not 1 <= MOVED * ratio <= MOVED**2


def ratio_of(before: Value, now: Value) -> float | None:
    """Quotient of two values, where there is one."""
    if before is None or now is None or isinstance(before, bool) or isinstance(now, bool) or before == 0:
        return None
    return now / before


def compare(measured: Mapping[str, Metrics], path: Path) -> list[str]:
    """Lines of a table of what was measured beside the baseline, and what has moved by more than a quarter."""
    baseline, here, moved = read_baseline(path), machine(), []
    lines = [f"{'metric':<44}{'baseline':>12}{'now':>12}{'ratio':>8}"]
    for name, now in measured.items():
        part = baseline.get(name, {"machine": here, "metrics": {}})
        if part["machine"] != here:
            told = ", ".join(f"{key} {value}" for key, value in part["machine"].items())
            lines.append(f"{name}: the baseline is of another machine or other versions ({told})")
        before = part["metrics"]
        for metric in dict.fromkeys([*before, *now]):
            lines.append(_compared(metric, before, now))
            if metric in before and metric in now and has_moved(before[metric], now[metric]):
                lines[-1] += " moved"
                moved.append(metric)
    return [*lines, f"moved by more than a quarter: {', '.join(moved) or 'none'}"]


def _compared(metric: str, before: Metrics, now: Metrics) -> str:
    if metric not in before or metric not in now:
        return f"{metric:<44}{'not in the baseline' if metric in now else 'not measured now':>32}"
    ratio = ratio_of(before[metric], now[metric])
    told = "" if ratio is None else f"{ratio:.2f}"
    return f"{metric:<44}{_told(before[metric]):>12}{_told(now[metric]):>12}{told:>8}"


def _told(value: Value) -> str:
    return str(value) if value is None or isinstance(value, bool) else f"{value:.4g}"
