"""The parent process: distributes cases to child processes, enforces the time limit, and records how children end."""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
import time
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from multiprocessing import connection, get_context
from pathlib import Path

from fuzz.worker import TRACE, Failure, Job, Limits, Progress, work

CHUNK = 1000
"""Number of cases per job of a child."""

_LOOK = 0.05
"""Seconds between checks of the time limit."""

_SCRATCH = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
"""Parent of the children's folders, in memory for speed."""

_PREPARING = 300.0
"""Limit on the processor time for the preparation of a child, in seconds."""

_BUSY = 10.0
"""Times as long as that which the preparation may take by the clock, on a busy machine."""

_SINGLE = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


@dataclass
class Tally:
    """Results of a target's cases."""

    cases: int = 0
    returned: int = 0
    refused: int = 0
    slowest: float = 0.0
    """Seconds of processor time."""
    growth: int = 0
    """Bytes."""
    seconds: float = 0.0
    """Total time of children, including imports, in seconds."""
    failures: list[Failure] = field(default_factory=list)


def run(jobs: Iterable[Job], n_children: int, limits: Limits | None = None) -> dict[str, Tally]:
    """Run cases.

    Parameters
    ----------
    jobs : iterable of Job
    n_children : int
        Number of parallel processes.
    limits : Limits, optional

    Returns
    -------
    dict of str to Tally
        Results by target.
    """
    waiting = deque(part for job in jobs for part in _parts(job))
    tallies: dict[str, Tally] = defaultdict(Tally)
    children: list[_Child] = []
    try:
        while waiting or any(child.job for child in children):
            children = [child for child in children if child.alive or child.job]  # also check ended ones
            idle = [child for child in children if child.job is None]
            while waiting and (idle or len(children) < n_children):
                if not idle:
                    idle.append(_Child(limits or Limits()))
                    children.append(idle[-1])
                idle.pop().give(waiting.popleft())
            connection.wait([end for child in children for end in child.ends], _LOOK)
            for child in [child for child in children if child.job]:
                if (rest := child.look(tallies)) is not None:
                    waiting.appendleft(rest)
    finally:
        for child in children:
            child.end()
    return dict(tallies)


def _parts(job: Job) -> Iterator[Job]:
    for first in range(job.first, job.stop, CHUNK):
        yield replace(job, first=first, stop=min(first + CHUNK, job.stop))


class _Child:
    """A child process, its folder and its job."""

    def __init__(self, limits: Limits) -> None:
        spawn = get_context("spawn")  # share nothing with the parent, not even memory
        self.limits = limits
        self.job: Job | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="liaam-fuzz-", dir=_SCRATCH)
        self._progress = spawn.RawValue(Progress)
        self._progress.case = -1
        self._pipe, theirs = spawn.Pipe()
        given = theirs, self._progress, limits, self._folder.name
        self._process = spawn.Process(target=work, args=given, daemon=True)
        with _environment(dict.fromkeys(_SINGLE, "1")):
            self._process.start()
        theirs.close()
        self._begin = 0.0

    @property
    def ends(self) -> tuple:
        """Objects to wait for: an answer, or the end of the child."""
        return self._pipe, self._process.sentinel

    @property
    def alive(self) -> bool:
        return self._process.is_alive()

    def give(self, job: Job) -> None:
        """Start a job."""
        self.job, self._begin = job, time.monotonic()
        with contextlib.suppress(BrokenPipeError):  # it has ended, which the next check detects
            self._pipe.send(job)

    def look(self, tallies: dict[str, Tally]) -> Job | None:
        """Record events. Return the rest of the job if the child has ended or is stopped."""
        assert self.job is not None
        job, tally = self.job, tallies[self.job.name]
        try:
            while self._pipe.poll():
                answer = self._pipe.recv()
                if isinstance(answer, Failure):
                    tally.failures.append(answer)
                else:
                    return self._ended(tally, answer)
        except (EOFError, OSError):  # it has ended, or is about to
            self._process.join()
        if self._process.is_alive():
            late = self._is_late()
            if not late:
                return None
            self._stop()
            kind = "time"
        else:
            code = self._process.exitcode or 0
            kind = signal.Signals(-code).name if code < 0 else f"exit {code}"
        case = self._progress.case
        if case < 0:
            raise RuntimeError(f"{job.name}: a child ended ({kind}) before or between cases\n{self._trace()}")
        tally.failures.append(Failure(job.name, job.seed, case, kind, self._trace()))
        return self._ended(tally, case + 1)

    def end(self) -> None:
        """End the child, and kill it if it is busy."""
        if self._process.is_alive() and self.job is None:
            with contextlib.suppress(OSError):
                self._pipe.send(None)
            self._process.join(5)
        self._process.kill()
        self._process.join()
        self._pipe.close()
        self._folder.cleanup()

    def _ended(self, tally: Tally, upto: int) -> Job | None:
        """Count the finished cases of the job. Return the rest, for another child."""
        assert self.job is not None
        job, progress = self.job, self._progress
        self.job = None
        tally.cases += upto - job.first
        tally.returned += progress.returned
        tally.refused += progress.refused
        tally.slowest = max(tally.slowest, progress.slowest)
        tally.growth = max(tally.growth, progress.growth)
        tally.seconds += time.monotonic() - self._begin
        progress.returned = progress.refused = progress.growth = 0
        progress.slowest = 0.0
        if upto == job.stop and self._process.is_alive():
            return None
        self.end()
        return replace(job, first=upto) if upto < job.stop else None

    def _is_late(self) -> bool:
        case, wall, processor = self._progress.case, self._progress.wall, self._progress.processor
        if case < 0:
            taken = time.monotonic() - self._begin
            return taken > _BUSY * _PREPARING or (taken > _PREPARING and self._spent() > _PREPARING)
        taken = time.monotonic() - wall
        if taken < self.limits.seconds:
            return False
        spent = self._spent() - processor
        same = self._progress.case == case and self._progress.wall == wall
        return same and (spent > self.limits.seconds or taken > 5 * self.limits.seconds)

    def _spent(self) -> float:
        return _processor_time(self._process.pid)

    def _stop(self) -> None:
        """Make the child dump its traceback, and kill it."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._process.pid or 0, signal.SIGUSR1)
        time.sleep(0.1)
        self._process.kill()
        self._process.join()

    def _trace(self) -> str:
        path = Path(self._folder.name) / TRACE
        if not path.exists():  # it was stopped before it could say where it is
            return ""
        lines = path.read_text(errors="replace").splitlines()
        innermost_last = bool(lines) and lines[0].startswith("Traceback")
        return "\n".join(line.strip() for line in (lines[-12:] if innermost_last else lines[:12]))


def _processor_time(pid: int | None) -> float:
    """Seconds of processor time of a process and its threads."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set environment variables for children started in the block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
