"""Write files so that they are either complete or not there: temp file, fsync, rename over the target."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from liaam.errors import LiaamError


@contextmanager
def atomic_path(path: str | os.PathLike[str], error: type[LiaamError] = LiaamError) -> Iterator[Path]:
    """Give a temporary path to write to; it becomes `path` when the block ends without an error.

    The temporary file lies in the folder of the target (a rename is only atomic within one file system) and
    keeps its suffix, since many writers choose the format by it. A symbolic link is written through.

    Parameters
    ----------
    path : path-like
        The file to make or to replace.
    error : type of LiaamError, optional
        The class of error to raise when the disk refuses.

    Yields
    ------
    Path
        An empty file to write to.

    Raises
    ------
    LiaamError
        Of class `error`, if the folder is missing, or writing fails; the target is then as it was before.
    """
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise error(f"{path} cannot be written: it is a folder. Give the name of a file.")
    if not target.parent.is_dir():
        raise error(f"{path} cannot be written: the folder {target.parent} does not exist. Make it first.")
    temp = target.parent / f".liaam-{secrets.token_hex(8)}{target.suffix}"
    try:
        os.close(os.open(temp, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temp
        _publish(temp, target)
    except OSError as fault:
        reason = fault.strerror or fault
        raise error(f"{path} cannot be written ({reason}): check the rights and the free space.") from fault
    finally:
        with contextlib.suppress(OSError):  # after a success there is nothing left to remove
            temp.unlink()


def write_bytes_atomically(path: str | os.PathLike[str], data: bytes, error: type[LiaamError] = LiaamError) -> None:
    """Write `data` to `path`, all or nothing (see :func:`atomic_path`)."""
    with atomic_path(path, error) as temp:
        temp.write_bytes(data)


def write_text_atomically(path: str | os.PathLike[str], text: str, error: type[LiaamError] = LiaamError) -> None:
    """Write `text` to `path` as UTF-8 with the line ends it has, all or nothing (see :func:`atomic_path`)."""
    try:
        data = text.encode("utf-8")
    except UnicodeEncodeError as fault:
        raise error(f"{path} cannot be written ({fault}): rename what has that character in its name.") from fault
    write_bytes_atomically(path, data, error)


def _publish(temp: Path, target: Path) -> None:
    """Force `temp` to the disk and rename it over `target`."""
    if target.exists():
        shutil.copymode(target, temp)
    descriptor = os.open(temp, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    temp.replace(target)
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable, where the system can open a folder (not on Windows)."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
