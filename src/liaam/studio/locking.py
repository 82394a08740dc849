"""A lock on the folder: two studios would overwrite each other's files."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path

from liaam.errors import LiaamError
from liaam.io.atomic import lock
from liaam.studio.folder import STATE

LOCK_FILE = "lock"


class FolderLock:
    """A lock on a folder. The system releases it when this process ends for any reason.

    Parameters
    ----------
    folder : Path
        Path with links resolved.
    address : str
        Address of this studio, for the error message of a second one.

    Raises
    ------
    LiaamError
        If another studio holds the lock.
    """

    def __init__(self, folder: Path, address: str) -> None:
        self._descriptor: int | None = None
        state = folder / STATE
        if state.is_symlink() or (state.exists() and not state.is_dir()):
            return  # the project reports this and writes nothing there
        path = state / LOCK_FILE
        try:
            state.mkdir(exist_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
        except OSError as fault:
            raise LiaamError(f"{path} cannot be made ({fault.strerror or fault}): check the rights on it.") from fault
        try:
            is_locked = lock(descriptor)
        except BlockingIOError as fault:
            holder = _holder(descriptor)
            os.close(descriptor)
            raise LiaamError(f"{folder} is open in another studio{holder}: use that one, or stop it first.") from fault
        if not is_locked:  # a file system without locks
            os.close(descriptor)
            return
        self._descriptor = descriptor
        with suppress(OSError):  # only used for an error message
            os.ftruncate(descriptor, 0)
            os.write(descriptor, json.dumps({"process": os.getpid(), "address": address}).encode())

    def release(self) -> None:
        """Release the lock."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            with suppress(OSError):
                os.ftruncate(descriptor, 0)
            os.close(descriptor)


def _holder(descriptor: int) -> str:
    """Describe the holder of the lock."""
    try:
        data = json.loads(os.read(descriptor, 1000))
        return f" ({data['address']}, process {data['process']})"
    except (OSError, ValueError, KeyError, TypeError):
        return ""
