"""A project's folder: whether it can be used, which of its paths may be touched, and how its faults are told.

Pictures are looked up in the folder's listing and never joined to a path; a link that leads out of the folder does not
exist for the studio, neither to read nor to write.
"""

from __future__ import annotations

import errno
import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from liaam.errors import ImageError, LiaamError
from liaam.studio.safety import Refusal

STATE = ".liaam-studio"
"""Folder in the folder, for what belongs to the studio alone."""


@dataclass(frozen=True)
class Folder:
    """A folder that pictures are kept in."""

    root: Path
    """With links resolved."""

    def leads_inside(self, path: Path) -> bool:
        """Whether a path stays in the folder, and out of what belongs to the studio alone."""
        real = Path(os.path.realpath(path))
        return real.is_relative_to(self.root) and STATE not in real.relative_to(self.root).parts

    def inside(self, name: str) -> Path:
        """Path of a file of the folder itself, which a link does not lead out of it.

        Raises
        ------
        Refusal
            409 if one does.
        """
        path = self.root / name
        if path.name != name or not self.leads_inside(path):
            raise Refusal(409, f"{name} is a link that leads out of the folder, so it is not used: remove the link")
        return path

    def time(self) -> int:
        """When an entry of the folder came or went last, nanoseconds."""
        try:
            return self.root.stat().st_mtime_ns
        except OSError:
            return 0

    def plain(self, fault: object) -> str:
        """Text of a fault with names instead of paths: the page knows the folder by its name."""
        name = self.root.name or "the folder"
        return str(fault).replace(f"{self.root}{os.sep}", "").replace(str(self.root), name)


def checked_folder(folder: str | os.PathLike[str]) -> Path:
    """Give a folder with links resolved, if pictures can be kept in it.

    Raises
    ------
    ImageError
        If it is none, or cannot be read or written.
    """
    folder = Path(folder)
    try:
        if not folder.is_dir():
            what = "is a file, not a folder" if folder.exists() else "does not exist"
            raise ImageError(f"{folder} {what}: name the folder that holds the pictures.")
        with os.scandir(folder):
            pass
    except OSError as fault:
        raise ImageError(f"{folder} cannot be read ({fault.strerror or fault}): check the rights on it.") from fault
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ImageError(f"{folder} cannot be written to: check the rights on it; landmarks are saved beside pictures.")
    return folder.resolve()


def remove(path: Path) -> None:
    """Remove a file, if it is there."""
    try:
        path.unlink(missing_ok=True)
    except OSError as fault:
        raise LiaamError(f"{path} cannot be removed ({fault.strerror or fault}): check the rights on it.") from fault


def status_of(fault: BaseException | None) -> int:
    """Status to answer with where the disk refuses: 507 where it is full, 503 otherwise. To try again may help."""
    return 507 if isinstance(fault, OSError) and fault.errno in (errno.ENOSPC, errno.EDQUOT) else 503


def revision_of(data: bytes) -> str:
    """What tells contents from all others."""
    return hashlib.sha256(data).hexdigest()[:16]
