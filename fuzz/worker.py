"""A child process that runs cases, and may crash."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import os
import signal
import time
import traceback
import warnings
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

from fuzz.target import MODULES, Target, targets_of
from liaam.errors import LiaamError

TRACE = "trace.txt"
"""File in the child's folder with the traceback of a crash or stop."""


SECONDS = 2
GIGABYTES = 1
"""What a case may take, processor time and memory, as SECURITY.md and README.md state."""


@dataclass(frozen=True)
class Limits:
    """Limits of a case."""

    seconds: float = SECONDS
    """Processor time. The wall-clock limit is five times as much."""
    n_bytes: int = GIGABYTES * 10**9
    """Resident memory, in addition to that of a prepared child and of the input."""


@dataclass(frozen=True)
class Job:
    """Cases of a target."""

    name: str
    seed: int
    first: int
    stop: int
    modules: tuple[str, ...] = MODULES
    """Modules that may define the target."""
    keep_in: str | None = None
    """Folder to write the inputs to instead of running them."""

    @property
    def target(self) -> Target:
        return targets_of(*self.modules)[self.name]


@dataclass(frozen=True)
class Failure:
    """A case that breaks the property."""

    name: str
    seed: int
    case: int
    kind: str
    """exception, time, memory, the name of a signal, or making (of the input)."""
    what: str
    """The error and its place, in a few lines."""


class Progress(ctypes.Structure):
    """Progress of a child, in memory shared with its parent, so that it survives the child."""

    _fields_ = (
        ("case", ctypes.c_int64),  # current case, or -1
        ("wall", ctypes.c_double),  # when it started, seconds of time.monotonic
        ("processor", ctypes.c_double),  # the same of time.process_time
        ("returned", ctypes.c_int64),  # number of cases that returned
        ("refused", ctypes.c_int64),  # number of cases that raised an error of liaam
        ("slowest", ctypes.c_double),  # largest processor time of a case, seconds
        ("growth", ctypes.c_int64),  # largest memory of a case, bytes
    )


def work(pipe: Connection, progress: Any, limits: Limits, folder: str) -> None:
    """Run jobs until there are none. Answer each with its failures and the first case that was not run."""
    import resource  # of Unix

    os.chdir(folder)
    quiet = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(quiet, stream)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    with Path(TRACE).open("w") as trace:
        faulthandler.enable(trace, all_threads=False)
        faulthandler.register(signal.SIGUSR1, trace, all_threads=False)
        try:
            for job in iter(pipe.recv, None):
                pipe.send(_keep(job) if job.keep_in else _run(job, pipe, progress, limits))
        except Exception:  # raised by preparation or by this module, not by a case
            traceback.print_exc(file=trace)
            raise


def _keep(job: Job) -> int:
    """Write the inputs of a job's cases to its folder. Return the first case that was not written."""
    target = job.target
    folder = Path(str(job.keep_in))
    for case in range(job.first, job.stop):
        data = target.input_of(job.seed, case)
        path = folder / f"{job.name}-{job.seed}-{case}{target.suffix}"
        path.write_bytes(data if isinstance(data, bytes) else repr(data).encode("utf-8", "backslashreplace"))
    return job.stop


def _run(job: Job, pipe: Connection, progress: Any, limits: Limits) -> int:
    """Run a job's cases, and send their failures. Return the first case that was not run."""
    target = job.target
    folder = Path(job.name)
    folder.mkdir(exist_ok=True)
    with contextlib.chdir(folder):  # separate the files of targets
        return _run_there(job, target, pipe, progress, limits)


def _run_there(job: Job, target: Target, pipe: Connection, progress: Any, limits: Limits) -> int:
    """Run the cases as :func:`_run` does, in the current folder, with little more memory than the limit."""
    import resource  # of Unix

    target.prepare()
    _forget_peak()
    memory_before = _memory("VmRSS")
    _, hardest = resource.getrlimit(resource.RLIMIT_AS)
    # Twice the limit, because reserved addresses are not memory, but the machine must keep working.
    resource.setrlimit(resource.RLIMIT_AS, (_memory("VmSize") + 2 * limits.n_bytes, hardest))
    try:
        for case in range(job.first, job.stop):
            try:
                data = target.input_of(job.seed, case)
            except Exception as error:  # an error of the fuzzer, which must not lose the results of other cases
                pipe.send(Failure(job.name, job.seed, case, "making", _in_short(error)))
                continue
            n_bytes = len(data) if isinstance(data, bytes) else 0
            _forget_peak()  # of making the input
            progress.wall = time.monotonic()
            progress.processor = time.process_time()
            progress.case = case  # from here on the parent enforces the time limit
            outcome = outcome_of(target, data)
            fault: tuple[str, str] | None = None
            if outcome == "returned":
                progress.returned += 1
            elif outcome == "refused":
                progress.refused += 1
            else:
                fault = outcome
            progress.slowest = max(progress.slowest, time.process_time() - progress.processor)
            progress.case = -1
            growth = _memory("VmHWM") - memory_before - n_bytes
            progress.growth = max(progress.growth, growth)
            if growth > limits.n_bytes and fault is None:
                fault = "memory", f"{growth / 1e6:.0f} MB more than before"
            if fault is not None:
                pipe.send(Failure(job.name, job.seed, case, *fault))
                if fault[0] == "memory":  # do not count its memory for the next case
                    return case + 1
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (hardest, hardest))
    return job.stop


def outcome_of(target: Target, data: Any) -> tuple[str, str] | Literal["returned", "refused"]:
    """Run a case. Return "returned" or "refused", or the kind and the description of a fault (:class:`Failure`)."""
    try:
        target.check(data)
    except LiaamError as error:
        if _lacked_memory(error):
            return "memory", _in_short(error)
        return "refused"
    except MemoryError as error:
        return "memory", _in_short(error)
    except BaseException as error:
        return "exception", _in_short(error)
    return "returned"


def _lacked_memory(error: BaseException | None) -> bool:
    """Return whether an error, or one that caused it, means out of memory; -4 is OpenCV's code for it.

    FFmpeg's does not: it also reports blocks that it refuses, from 2 GB on, as a lack of memory.
    """
    while error is not None:
        of_ffmpeg = type(error).__module__.startswith("av.")
        if (isinstance(error, MemoryError) and not of_ffmpeg) or getattr(error, "code", None) == -4:
            return True
        error = error.__cause__ or error.__context__
    return False


def _in_short(error: BaseException) -> str:
    """Format an error and its stack frames, innermost last."""
    places = [f"{Path(frame.filename).name}:{frame.lineno}" for frame in traceback.extract_tb(error.__traceback__)[1:]]
    message = str(error).encode("ascii", "backslashreplace").decode()
    return f"{type(error).__name__}: {message[:200]}\n{' '.join(places[-6:])}"


def _memory(what: str) -> int:
    """Memory of this process in bytes: VmRSS, VmHWM (its peak) or VmSize."""
    with open("/proc/self/status") as file:  # noqa: PTH123 (once a case)
        line = next(line for line in file if line.startswith(what))
    return int(line.split()[1]) * 1024


def _forget_peak() -> None:
    """Let VmHWM begin anew, from the memory that is used now."""
    Path("/proc/self/clear_refs").write_text("5")
