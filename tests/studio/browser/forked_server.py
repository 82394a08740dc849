"""Studios that are forked from a process which has imported everything, which takes each a second."""

import multiprocessing
import os
from dataclasses import dataclass
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import TextIO

from server_process import run_liaam

from benchmarks.studio import Server, announced

FORKING = multiprocessing.get_context("forkserver")
FORKING.set_forkserver_preload(
    [
        "liaam.cli.main",
        "liaam.cli.studio",
        "liaam.studio.app",
        "liaam.studio.serving",
        # What these import when they first need it.
        "PIL.JpegImagePlugin",
        "PIL.PngImagePlugin",
        "pydantic.type_adapter",
        "scipy.linalg",
        "scipy.optimize",
        "scipy.spatial",
        "threadpoolctl",
        "uvicorn.lifespan.off",
        "uvicorn.loops.asyncio",
        "uvicorn.protocols.http.h11_impl",
    ]
)


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
    process = FORKING.Process(target=run_liaam, args=(command, writer, errors, state))
    process.start()
    writer.close()
    output = os.fdopen(os.dup(reader.fileno()), encoding="utf-8")
    return Server(Forked(process, output), announced(output))
