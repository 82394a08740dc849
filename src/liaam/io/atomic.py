"""Atomic writing of files: write a temporary file, fsync, then rename it over the target.

The name of a temporary file has the number of the process that writes it. :func:`sweep` removes those of killed ones.
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
from liaam.io.files import AnyPath, may_write_in, real_path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


_SPACE = Path("/proc/self/ns/pid")  # what numbers processes: this machine, or the container that liaam runs in
_MACHINE = f"{socket.gethostname()} {_SPACE.readlink() if _SPACE.is_symlink() else ''}"
_HOST = hashlib.sha256(_MACHINE.encode()).hexdigest()[:8]
_TEMPORARY = re.compile(r"\.liaam-(?P<host>[0-9a-f]{8})-(?P<process>\d{1,9})-[0-9a-f]{16}(\..*)?", re.DOTALL)
_DAY = 86400.0
_SEES_PROCESSES = os.name == "posix"  # elsewhere os.kill would end them
_TAKEN = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK)
_FAR = 1 << 30  # position of the locked byte on Windows, beyond the contents, since locked bytes cannot be read
_swept: set[Path] = set()  # folders that this process has swept


def check_output(path: AnyPath, error: type[LiaamError] = LiaamError) -> Path:
    """Return the real path of a file to write. Raise if it cannot be written, so that no work is done in vain."""
    target = _target(path, error)
    if not may_write_in(target.parent):
        remedy = "Change its permissions, or name another folder."
        raise error(f"{path} cannot be written: the folder {target.parent} is read-only. {remedy}")
    return target


def _target(path: AnyPath, error: type[LiaamError]) -> Path:
    """Return the real path of a file to write. Raise if it is a folder, or if its folder does not exist."""
    target = real_path(path)
    if target.is_dir():
        raise error(f"{path} cannot be written: it is a folder. Give a file name.")
    if not target.parent.is_dir():
        raise error(f"{path} cannot be written: the folder {target.parent} does not exist. Make it first.")
    return target


@contextmanager
def atomic_path(path: AnyPath, error: type[LiaamError] = LiaamError) -> Iterator[Path]:
    """Yield an empty file to write to, which takes the place of `path` if the block ends without an error.

    It is in the target's folder, because a rename is atomic only within one file system, and keeps the suffix, because
    many writers choose the format by it. A symbolic link is followed. Whatever fails is raised as `error`.
    """
    target = _target(path, error)
    if target.parent not in _swept:
        _swept.add(target.parent)
        sweep(target.parent)
    temp = target.parent / f".liaam-{_HOST}-{os.getpid()}-{secrets.token_hex(8)}{target.suffix}"
    try:  # before the file exists, or Ctrl-C might leave it
        os.close(os.open(temp, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temp
        if target.exists():
            shutil.copymode(target, temp)
        _sync(temp, os.O_RDWR)
        temp.replace(target)
        with contextlib.suppress(OSError):  # Windows opens no folders
            _sync(target.parent, os.O_RDONLY)
    except OSError as fault:
        reason = fault.strerror or fault
        raise error(f"{path} cannot be written ({reason}): check the permissions and the free space.") from fault
    finally:
        with contextlib.suppress(OSError):  # after a success there is nothing left to remove
            temp.unlink()


def is_disk_full(error: BaseException) -> bool:
    """Return whether an error, or one that caused it, says that there is no room on the disk."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        cause = cause.__cause__
    return False


def write_bytes_atomically(path: AnyPath, data: bytes, error: type[LiaamError] = LiaamError) -> None:
    """Write `data` to `path` atomically (see :func:`atomic_path`)."""
    with atomic_path(path, error) as temp:
        temp.write_bytes(data)


def write_text_atomically(path: AnyPath, text: str, error: type[LiaamError] = LiaamError) -> None:
    """Write `text` to `path` atomically as UTF-8, with its line ends unchanged (see :func:`atomic_path`)."""
    try:
        data = text.encode("utf-8")
    except UnicodeEncodeError as fault:
        raise error(f"{path} cannot be written ({fault}): rename what contains that character.") from fault
    write_bytes_atomically(path, data, error)


def sweep(folder: Path) -> None:
    """Remove the temporary files that killed processes left in a folder.

    The first :func:`atomic_path` of a process in a folder does this.
    """
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            name = _TEMPORARY.fullmatch(entry.name)
            if name is not None and entry.is_file(follow_symlinks=False) and _has_ended(name, entry):
                with contextlib.suppress(OSError):  # another process may sweep too
                    Path(entry.path).unlink()


def _has_ended(name: re.Match[str], entry: os.DirEntry[str]) -> bool:
    """Whether a temporary file's process has ended; where that is unknown, whether it was not written to for a day."""
    if name["host"] != _HOST or not _SEES_PROCESSES:
        return time.time() - entry.stat(follow_symlinks=False).st_mtime > _DAY
    try:
        os.kill(int(name["process"]), 0)
    except OSError as fault:
        return isinstance(fault, ProcessLookupError)  # else it is another user's
    return False


def lock(descriptor: int) -> bool:
    """Lock an open file until it is closed; False if the system or the disk has no locks.

    Raise BlockingIOError if another process has it.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, _FAR, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            os.lseek(descriptor, 0, os.SEEK_SET)
        elif fcntl is None:
            return False
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as fault:
        if fault.errno in _TAKEN:
            raise BlockingIOError(fault.errno, os.strerror(fault.errno)) from fault
        return False
    return True


def _sync(path: Path, mode: int) -> None:
    descriptor = os.open(path, mode)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
