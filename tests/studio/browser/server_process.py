"""What a forked process does. It imports nothing else: what it imports takes time in each."""

import os
import signal
import sys
from pathlib import Path

from delayed_server import delay

from liaam.__main__ import main


def run_liaam(arguments: list[str], output, errors: Path, state: Path) -> None:
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
