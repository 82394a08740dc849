"""Run the commands of a guide, for the scripts that make its data and its picture."""

import contextlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from liaam.cli.main import main as liaam_main


def run_liaam(words: Sequence[str]) -> None:
    """Print a command of liaam, and run it."""
    print("$ liaam", *words, flush=True)
    sys.argv = ["liaam", *words]
    with contextlib.suppress(SystemExit):
        liaam_main()


def write_and_run(write: Callable[[Path], object], run: Callable[[], None]) -> None:
    """Write data to the folder that the command line names, and run the guide beside it if ``--run`` asks for it."""
    folder = Path(sys.argv[1]).resolve()
    is_run = "--run" in sys.argv
    write(folder)
    if is_run:
        os.chdir(folder.parent)
        run()
