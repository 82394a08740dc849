"""One studio for a folder: two would overwrite what the other has written."""

from __future__ import annotations

import errno
import json
import os
import sys
from contextlib import suppress
from pathlib import Path

from liaam.errors import LiaamError
from liaam.studio.folder import STATE

LOCK_FILE = "lock"

_FAR = 1 << 30
"""The byte that is locked, on Windows, where others could not read what is locked."""

_TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


class FolderLock:
    """A lock on a folder, which the system releases when this process ends, however it ends.

    Parameters
    ----------
    folder : Path
        With links resolved.
    address : str
        Where this studio is found, for those who come later.

    Raises
    ------
    LiaamError
        If another studio has it.
    """

    def __init__(self, folder: Path, address: str) -> None:
        self._descriptor: int | None = None
        state = folder / STATE
        if state.is_symlink() or (state.exists() and not state.is_dir()):
            return  # the project says so, and writes nothing there
        path = state / LOCK_FILE
        try:
            state.mkdir(exist_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
        except OSError as fault:
            raise LiaamError(f"{path} cannot be made ({fault.strerror or fault}): check the rights on it.") from fault
        try:
            _lock(descriptor)
        except OSError as fault:
            if fault.errno in _TAKEN:
                holder = _holder(descriptor)
                os.close(descriptor)
                raise LiaamError(
                    f"{folder} is open in another studio{holder}: use that one, or stop it first."
                ) from fault
            os.close(descriptor)  # a file system without locks
            return
        self._descriptor = descriptor
        with suppress(OSError):  # it only helps people
            os.ftruncate(descriptor, 0)
            os.write(descriptor, json.dumps({"process": os.getpid(), "address": address}).encode())

    def release(self) -> None:
        """Let others have the folder."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            with suppress(OSError):
                os.ftruncate(descriptor, 0)
            os.close(descriptor)


def _holder(descriptor: int) -> str:
    """Say who has the lock."""
    try:
        data = json.loads(os.read(descriptor, 1000))
        return f" ({data['address']}, process {data['process']})"
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def _lock(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, _FAR, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        os.lseek(descriptor, 0, os.SEEK_SET)
        return
    import fcntl

    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
