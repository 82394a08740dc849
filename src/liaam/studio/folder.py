"""A project's folder: checks of the folder and its paths, and error messages without absolute paths.

Names of files are relative to the folder, with ``/`` between the parts. Names of pictures are looked up in the folder's
listing and never joined to a path. The studio neither reads nor writes through a link that leads out of the folder.
"""

from __future__ import annotations

import errno
import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from liaam.errors import ImageError, LiaamError
from liaam.io.files import may_write_in, real_path
from liaam.studio.safety import Refusal

STATE = ".liaam-studio"
"""Name of the subfolder for the studio's own files."""


@dataclass(frozen=True)
class Folder:
    """A folder of pictures."""

    root: Path
    """Path with links resolved."""

    def leads_inside(self, path: Path) -> bool:
        """Whether a path stays in the folder and outside the studio's own subfolder."""
        real = real_path(path)
        return real.is_relative_to(self.root) and STATE not in real.relative_to(self.root).parts

    def inside(self, name: str) -> Path:
        """Return the path of a file in the folder or its subfolders."""
        path = self.root / name
        if not is_relative(name) or not self.leads_inside(path):
            raise Refusal(409, f"{name} is a link that leads out of the folder, so it is not used: remove the link")
        return path

    def name_of(self, path: Path) -> str:
        """Return the name of a file in the folder."""
        return path.relative_to(self.root).as_posix()

    def time(self, subfolder: str = "") -> int:
        """Return the time of the last added or removed entry of the folder, or of a subfolder, in nanoseconds."""
        try:
            return (self.root / subfolder).stat().st_mtime_ns
        except OSError:
            return 0

    def plain(self, fault: object) -> str:
        """Return an error message in which the folder's path is replaced by its name."""
        name = self.root.name or "the folder"
        return str(fault).replace(f"{self.root}{os.sep}", "").replace(str(self.root), name)


def is_relative(name: str) -> bool:
    """Whether a name stays in the folder and names no hidden file or folder."""
    return all(part and not part.startswith(".") for part in name.split("/")) and not Path(name).is_absolute()


def checked_folder(folder: str | os.PathLike[str]) -> Path:
    """Check a folder and return it with links resolved."""
    folder = Path(folder)
    try:
        if not folder.is_dir():
            what = "is a file, not a folder" if folder.exists() else "does not exist"
            raise ImageError(f"{folder} {what}: name the folder that holds the pictures.")
        with os.scandir(folder):
            pass
    except OSError as fault:
        raise ImageError(f"{folder} cannot be read ({fault.strerror or fault}): check the rights on it.") from fault
    if not may_write_in(folder):
        raise ImageError(f"{folder} cannot be written to: check the rights on it; landmarks are saved beside pictures.")
    return real_path(folder)


def remove(path: Path) -> None:
    """Remove a file if it exists."""
    try:
        path.unlink(missing_ok=True)
    except OSError as fault:
        raise LiaamError(f"{path} cannot be removed ({fault.strerror or fault}): check the rights on it.") from fault


def status_of(fault: BaseException | None) -> int:
    """Return the HTTP status of a failed write: 507 if the disk is full, 503 otherwise. The page retries after both."""
    return 507 if isinstance(fault, OSError) and fault.errno in (errno.ENOSPC, errno.EDQUOT) else 503


def revision_of(data: bytes) -> str:
    """Return a hash of the contents of a file."""
    return hashlib.sha256(data).hexdigest()[:16]
