"""A process that is killed: forked from this one, which has imported and compiled all it needs, or started anew."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

WRITES = frozenset(
    ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.chmod", "sqlite3.connect", "fcntl.flock")
)
"""Audit events that change files, beside ``open``."""

LIMIT = 120.0
"""Seconds after which a process that does not end has failed."""

LATE = 0.003
"""Seconds after a write by which a kill may be late: into the next one, perhaps."""


@dataclass(frozen=True)
class Ended:
    """How a process ended."""

    status: int
    """Exit status; minus the signal where it was killed."""
    seconds: float
    said: str
    """What it printed."""

    @property
    def killed(self) -> bool:
        """Whether the kill came before the end."""
        return self.status == -signal.SIGKILL


@dataclass(frozen=True)
class AtWrite:
    """A kill at a write into a folder: just before it, or a moment later."""

    number: int
    """Of the write, from 0."""
    late: float
    """Seconds; 0 for a kill before the write."""
    signal: int = signal.SIGKILL


class Victim:
    """A run of a command in a process of its own, in a group of its own.

    Parameters
    ----------
    run : callable
        What the process does.
    folder : Path
        Whose writes count.
    said : Path
        File for what it prints, outside of the folder.
    at : AtWrite, optional
        Has the process kill itself.
    writes : Path, optional
        File to which it adds a byte for each write.
    """

    def __init__(
        self, run: Callable[[], object], folder: Path, said: Path, at: AtWrite | None = None, writes: Path | None = None
    ) -> None:
        self._said, self._begun, self._end = said, time.monotonic(), None
        said.unlink(missing_ok=True)
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if self.pid == 0:
            _be(run, folder, said, at, writes)

    @classmethod
    def anew(cls, arguments: Sequence[str], said: Path) -> Victim:
        """Run a command of liaam in a new interpreter."""
        victim = object.__new__(cls)
        victim._said, victim._begun, victim._end = said, time.monotonic(), None
        out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        line = [sys.executable, "-m", "liaam", *arguments]
        actions = [(os.POSIX_SPAWN_DUP2, out, 1), (os.POSIX_SPAWN_DUP2, out, 2)]
        victim.pid = os.posix_spawn(sys.executable, line, os.environ, file_actions=actions, setpgroup=0)
        os.close(out)
        return victim

    @property
    def said(self) -> str:
        """What it has printed so far."""
        return self._said.read_text(errors="replace") if self._said.exists() else ""

    def kill(self, signal_: int = signal.SIGKILL) -> None:
        """Kill the process, and no other."""
        os.kill(self.pid, signal_)

    def wait(self, seconds: float = LIMIT) -> Ended | None:
        """Wait for its end; None if it has not ended by then."""
        due = time.monotonic() + seconds
        while self._end is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                code = os.waitstatus_to_exitcode(status)
                self._end = Ended(code, time.monotonic() - self._begun, self.said)
                break
            left = due - time.monotonic()
            if left <= 0:
                return None
            time.sleep(min(0.002, left))
        return self._end

    @property
    def is_over(self) -> bool:
        """Whether it has been seen to end."""
        return self._end is not None

    def ended(self) -> Ended:
        """Wait for its end, which has to come."""
        end = self.wait()
        if end is None:
            os.kill(self.pid, signal.SIGUSR1)  # say where
            time.sleep(0.5)
            self.kill()
            self.wait()
            raise AssertionError(f"it hangs: no end after {LIMIT:.0f} s\n{self.said}")
        return end

    def killed_after(self, seconds: float, signal_: int = signal.SIGKILL) -> Ended:
        """Kill it after a time, unless it has ended."""
        end = self.wait(seconds)
        if end is None:
            self.kill(signal_)
        return end or self.ended()


def of_command(arguments: Sequence[str]) -> Callable[[], object]:
    """What a process does that runs a command of liaam."""

    def run() -> object:
        from liaam.__main__ import main

        sys.argv = ["liaam", *arguments]
        return main()

    return run


def _be(
    run: Callable[[], object], folder: Path, said: Path, at: AtWrite | None, writes: Path | None
) -> None:  # pragma: no cover (another process)
    """Be the process that runs a command; never returns."""
    status = 70
    try:
        os.setpgid(0, 0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        for descriptor in (1, 2):
            os.dup2(out, descriptor)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        faulthandler.register(signal.SIGUSR1, all_threads=True)
        if at is not None or writes is not None:
            _watch(folder, at, writes)
        run()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
    finally:
        for worker in multiprocessing.active_children():
            worker.kill()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _watch(folder: Path, at: AtWrite | None, writes: Path | None) -> None:
    """Count writes into a folder, and die at one of them."""
    inside, count = str(folder), iter(range(10**9))
    note = None if writes is None else os.open(writes, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def hook(event: str, arguments: tuple) -> None:
        if event == "open":
            path, _, flags = arguments
            if not isinstance(flags, int) or not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                return
        elif event not in WRITES:
            return
        else:
            path = arguments[0]
        if not isinstance(path, int) and not os.fsdecode(path).startswith(inside):
            return
        if note is not None:
            os.write(note, b".")
        if at is None or next(count) != at.number:
            return
        if not at.late:
            os.kill(os.getpid(), at.signal)
        threading.Timer(at.late, os.kill, (os.getpid(), at.signal)).start()

    sys.addaudithook(hook)
