"""Atomic writing of files: write a temporary file, fsync, then rename it over the target.

A temporary file is locked while it is written. The system releases the lock when the process ends, however it ends, so
an unlocked temporary file was left by a killed process; :func:`sweep` removes it.
"""

import contextlib
import errno
import hashlib
import os
import re
import secrets
import shutil
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from liaam.errors import LiaamError
from liaam.io.files import may_write_in, real_path

try:
    import fcntl
except ImportError:  # Windows, where temporary files are neither locked nor swept
    fcntl = None

_UNLOCKED = "0" * 8
"""Stands in names for the machine if the disk has no usable locks; such files are swept by their age only."""

_HOST = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]
_TEMPORARY = re.compile(r"\.liaam-([0-9a-f]{8})[0-9a-f]{8,16}(\..*)?", re.DOTALL)
_DAY = 86400.0

_TAKEN = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK)

_FAR = 1 << 30
"""Position of the locked byte on Windows, beyond the contents, since locked bytes cannot be read."""

_swept: set[Path] = set()
"""Folders that this process has swept."""


def check_output(path: str | os.PathLike[str], error: type[LiaamError] = LiaamError) -> Path:
    """Return the real path of a file to write. Raise if it cannot be written, so that no work is done in vain."""
    target = _target(path, error)
    if not may_write_in(target.parent):
        raise error(
            f"{path} cannot be written: the folder {target.parent} is read-only. Change its permissions, or name "
            "another folder."
        )
    return target


def _target(path: str | os.PathLike[str], error: type[LiaamError]) -> Path:
    """Return the real path of a file to write. Raise if it is a folder, or if its folder does not exist."""
    target = real_path(path)
    if target.is_dir():
        raise error(f"{path} cannot be written: it is a folder. Give a file name.")
    if not target.parent.is_dir():
        raise error(f"{path} cannot be written: the folder {target.parent} does not exist. Make it first.")
    return target


@contextmanager
def atomic_path(path: str | os.PathLike[str], error: type[LiaamError] = LiaamError) -> Iterator[Path]:
    """Yield an empty file to write to, which takes the place of `path` if the block ends without an error.

    It is in the target's folder, because a rename is atomic only within one file system, and keeps the suffix, because
    many writers choose the format by it. A symbolic link is followed. Whatever fails is raised as `error`.
    """
    target = _target(path, error)
    if target.parent not in _swept:
        _swept.add(target.parent)
        sweep(target.parent)
    try:
        with _temporary_file(target) as temp:
            yield temp
            _publish(temp, target)
    except OSError as fault:
        reason = fault.strerror or fault
        raise error(f"{path} cannot be written ({reason}): check the permissions and the free space.") from fault


def write_bytes_atomically(path: str | os.PathLike[str], data: bytes, error: type[LiaamError] = LiaamError) -> None:
    """Write `data` to `path` atomically (see :func:`atomic_path`)."""
    with atomic_path(path, error) as temp:
        temp.write_bytes(data)


def write_text_atomically(path: str | os.PathLike[str], text: str, error: type[LiaamError] = LiaamError) -> None:
    """Write `text` to `path` atomically as UTF-8, with its line ends unchanged (see :func:`atomic_path`)."""
    try:
        data = text.encode("utf-8")
    except UnicodeEncodeError as fault:
        raise error(f"{path} cannot be written ({fault}): rename what contains that character.") from fault
    write_bytes_atomically(path, data, error)


def sweep(folder: Path) -> None:
    """Remove the temporary files that killed processes left in a folder.

    The first :func:`atomic_path` of a process in a folder does this. Files of other machines are kept for a day, as
    some network disks do not show locks across machines.
    """
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            name = _TEMPORARY.fullmatch(entry.name)
            if name is not None and entry.is_file(follow_symlinks=False):
                _remove_unlocked(Path(entry.path), 0.0 if name[1] == _HOST else _DAY)


def lock(descriptor: int, *, wait: bool = False) -> bool:
    """Lock an open file until it is closed; False if the system or the disk has no locks.

    Raise BlockingIOError if another process has it, and this one does not wait.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, _FAR, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
            os.lseek(descriptor, 0, os.SEEK_SET)
        elif fcntl is None:
            return False
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as fault:
        if fault.errno in _TAKEN:
            raise BlockingIOError(fault.errno, os.strerror(fault.errno)) from fault
        return False
    return True


def _remove_unlocked(path: Path, age: float) -> None:
    """Remove a file that nobody writes to and that is at least so old, in seconds."""
    with contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_RDWR)
        try:
            facts = os.fstat(descriptor)
            is_old = not age or time.time() - facts.st_mtime > age
            # Another process may have replaced the file before it was locked.
            if is_old and lock(descriptor) and os.path.samestat(facts, path.lstat()):
                path.unlink()
        finally:
            os.close(descriptor)


@contextmanager
def _temporary_file(target: Path) -> Iterator[Path]:
    """Make an empty file beside another, locked if the disk has locks, and remove it at the end if it still exists."""
    name = f"{secrets.token_hex(8)}{target.suffix}"
    temp, unlocked = (target.parent / f".liaam-{tag}{name}" for tag in (_HOST, _UNLOCKED))
    descriptor = None
    try:  # before the file exists, or Ctrl-C might leave it
        descriptor = _made(temp)
        if not _is_writable(temp):
            os.close(descriptor)  # and so unlocked
            descriptor = None
            temp = temp.rename(unlocked)
        yield temp
    finally:
        for path in (temp, unlocked):
            with contextlib.suppress(OSError):  # after a success there is nothing left to remove
                path.unlink()
        if descriptor is not None:
            os.close(descriptor)


def _is_writable(temp: Path) -> bool:
    """Whether a locked file can be written by its name. SMB locks refuse that, and Windows renames no open file."""
    if fcntl is None:
        return False
    try:
        with temp.open("r+b") as file:
            file.write(b"x")
            file.truncate(0)
    except PermissionError:
        return False
    return True


def _made(temp: Path) -> int:
    """Make a file and lock it."""
    while True:
        descriptor = os.open(temp, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)
        lock(descriptor, wait=True)
        if temp.exists():
            return descriptor
        os.close(descriptor)  # another process has swept it before it was locked


def _publish(temp: Path, target: Path) -> None:
    """Flush `temp` to disk, rename it over `target`, and flush the rename."""
    if target.exists():
        shutil.copymode(target, temp)
    _sync(temp, os.O_RDWR)
    temp.replace(target)
    with contextlib.suppress(OSError):  # Windows opens no folders
        _sync(target.parent, os.O_RDONLY)


def _sync(path: Path, mode: int) -> None:
    descriptor = os.open(path, mode)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
