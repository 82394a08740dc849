"""Helpers of all benchmarks: printing and recording of metrics, timing of calls, and the committed baseline."""

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
"""Ratio of change, in either direction, above which a metric has moved."""

Value = float | bool | None
Metrics = dict[str, Value]

_recorders: list[Metrics] = []


class BaselineError(LiaamError):
    """A baseline cannot be read, or has no value for a metric."""


def report(name: str, value: float | bool, note: str = "", *, form: str = ".3f", width: int = 0) -> None:
    """Print a metric, and record it inside :func:`recording`.

    Parameters
    ----------
    name : str
    value : float or bool
    note : str
        Additional text: the unit, quartiles, the bar.
    form : str
        Format of the value.
    width : int
        Width of the name, in a table with aligned columns; 0 for plain lines.
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
    """Yield a dictionary that collects the metrics reported in the block."""
    metrics: Metrics = {}
    _recorders.append(metrics)
    try:
        yield metrics
    finally:
        _recorders.pop()


def in_turn(
    blocks: Mapping[str, Sequence[Callable[[], object]]], rounds: int, warm_up: int = 1
) -> dict[str, np.ndarray]:
    """Measure the times of calls in milliseconds, {name: (rounds, n)}.

    Each round times all calls in turn, so that other load on the machine affects all equally. The first `warm_up`
    rounds do not count. Times are processor times of all threads. For one thread that is the wall-clock time without
    other load.
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
    """Format the quartiles, for a metric's note."""
    low, high = np.percentile(values, [25, 75])
    return f"quartiles {low:{form}} to {high:{form}}"


def machine() -> dict[str, Any]:
    """Describe the machine: processor, cores, and versions of the numerical libraries."""
    from importlib.metadata import version

    return {
        "processor": processor_name(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy")},
    }


def processor_name() -> str:
    """Name of the processor, if the system reports it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def read_baseline(path: Path) -> dict[str, Any]:
    """Read a baseline, {benchmark: {"machine": ..., "metrics": ...}}; empty if there is none."""
    if not path.exists():
        return {}
    try:
        found = json.loads(path.read_text())
    except ValueError as fault:
        raise BaselineError(f"{path} is not JSON ({fault}); restore it, or delete it and save a new one") from None
    parts = found.values() if isinstance(found, dict) else [None]
    if not all(isinstance(part, dict) and {"machine", "metrics"} <= part.keys() for part in parts):
        raise BaselineError(f"{path} is not a baseline; restore it, or delete it and save a new one")
    return found


def save_baseline(measured: Mapping[str, Metrics], path: Path) -> None:
    """Write the metrics of benchmarks with the machine. Other benchmarks keep their entries.

    A benchmark without metrics, for example for lack of data, also keeps its entry.
    """
    here = machine()
    fresh = {name: {"machine": here, "metrics": metrics} for name, metrics in measured.items() if metrics}
    text = json.dumps({**read_baseline(path), **fresh}, indent=2, allow_nan=False)
    write_bytes_atomically(path, f"{text}\n".encode())


def has_moved(before: Value, now: Value) -> bool:
    """Return whether a metric differs by more than a quarter, in either direction. Other values must be equal."""
    ratio = ratio_of(before, now)
    return before != now if ratio is None else not 1 <= MOVED * ratio <= MOVED**2


def ratio_of(before: Value, now: Value) -> float | None:
    """Quotient of two values, if defined."""
    if before is None or now is None or isinstance(before, bool) or isinstance(now, bool) or before == 0:
        return None
    return now / before


def compare(measured: Mapping[str, Metrics], path: Path) -> list[str]:
    """Format a table of the metrics and the baseline, with marks where they differ by more than a quarter."""
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
