"""Studios that are forked from a process which has imported everything, which takes each a second."""

import multiprocessing
import os
import signal
import sys
from dataclasses import dataclass
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import TextIO

from delayed_server import delay

from benchmarks.studio import Server, announced
from liaam.__main__ import main

FORKING = multiprocessing.get_context("forkserver")
FORKING.set_forkserver_preload(["liaam.cli.main", "liaam.cli.studio", "liaam.studio.app", "scipy.linalg", "pydantic"])


@dataclass(frozen=True)
class Forked:
    """What :class:`benchmarks.studio.Server` asks of a process."""

    process: ForkServerProcess
    output: TextIO  # kept open, since more is printed

    def terminate(self) -> None:
        self.process.terminate()

    def send_signal(self, number: int) -> None:
        if self.process.is_alive() and self.process.pid:
            os.kill(self.process.pid, number)

    def wait(self) -> None:
        self.process.join()
        self.output.close()


def start_forked(folder: Path, *arguments: str, errors: Path, state: Path) -> Server:
    """Run ``liaam studio`` on a folder, as :func:`benchmarks.studio.start` does, with the user's ``state`` folder."""
    reader, writer = FORKING.Pipe(duplex=False)
    command = ["studio", str(folder), "--no-browser", *arguments]
    process = FORKING.Process(target=_run, args=(command, writer, errors, state))
    process.start()
    writer.close()
    output = os.fdopen(os.dup(reader.fileno()), encoding="utf-8")
    return Server(Forked(process, output), announced(output))


def _run(arguments: list[str], output, errors: Path, state: Path) -> None:
    """Be ``liaam`` in a new process, with other standard streams than the process that it is forked from."""
    with errors.open("w") as file:
        os.dup2(output.fileno(), 1)
        os.dup2(file.fileno(), 2)
    sys.stdout, sys.stderr = (open(number, "w", buffering=1, closefd=False) for number in (1, 2))  # noqa: SIM115
    os.environ["COLUMNS"] = "300"
    os.environ["XDG_STATE_HOME"] = str(state)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["liaam", *arguments]
    if "LIAAM_DELAY" in os.environ:
        delay()
    main()
