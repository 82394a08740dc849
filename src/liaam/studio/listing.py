"""The listing of a project's folder: which pictures and landmark files there are, and which pictures can be used."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from liaam.datasets.folder import PICTURE_SUFFIXES
from liaam.errors import ImageError, LiaamError
from liaam.io.files import natural_key
from liaam.io.images import image_size
from liaam.io.landmarks import LANDMARK_SUFFIXES
from liaam.photometry.encoding import as_colour
from liaam.studio.folder import Folder
from liaam.studio.safety import Refusal

OWN_SUFFIXES = (".pts", ".ljson")
"""Endings of landmark files that are written, in the order in which they are read."""

_UNREAD = (".gif", ".webp", ".heic", ".heif", ".avif", ".jxl", ".svg", ".psd", ".jp2", ".exr")
"""Endings of pictures that are not read, which a person may wonder about."""

_NAMED = 3
"""Files that a line about several names."""

Signature = tuple[int, int, int]


@dataclass(frozen=True)
class File:
    """A file of the folder, and by what a change of it shows: time, size, and the file itself."""

    name: str
    signature: Signature

    @property
    def stem(self) -> str:
        """Name without its ending."""
        return Path(self.name).stem

    @property
    def suffix(self) -> str:
        """Ending, in lower case."""
        return Path(self.name).suffix.lower()

    @property
    def tag(self) -> str:
        """What a page tells the file's contents by."""
        return f"{self.signature[0]:x}-{self.signature[1]:x}"


class Listing:
    """The folder's files as they were when it was listed last.

    Parameters
    ----------
    folder : Folder
    most_pixels : int
        Width times height of a picture that can be used.

    Attributes
    ----------
    version : int
        Counts up with every change of what is listed.
    files : dict of str to File
        By name, in natural order.
    pictures : list of File
    own_files : dict of (str, str) to File
        Landmark files of the formats that are written, by stem and suffix.
    other_files : list of File
        Landmark files that are read only.
    winners : dict of str to str
        By stem, the picture that landmark files of that name belong to.
    stranded : list of str
        Links that lead out of the folder.
    """

    def __init__(self, folder: Folder, most_pixels: int) -> None:
        self.folder = folder
        self.version = 0
        self.files: dict[str, File] = {}
        self.stranded: list[str] = []
        self._most_pixels = most_pixels
        self._listed_at = 0
        self._sizes: dict[str, tuple[Signature, tuple[int, int] | str]] = {}
        self._arrange()

    # What is there --------------------------------------------------------------------------------

    def scan(self) -> None:
        """List the folder.

        Raises
        ------
        Refusal
            503 if it cannot be read any more.
        """
        self._listed_at = self.folder.time()  # before: what comes meanwhile will be noticed
        self.stranded = []
        root = self.folder.root
        try:
            with os.scandir(root) as entries:
                found = [self._entry(entry) for entry in entries if not entry.name.startswith(".")]
        except OSError as fault:
            raise Refusal(
                503, f"{root.name} cannot be read ({fault.strerror or fault}): is the folder still there?"
            ) from fault
        files = sorted((file for file in found if file is not None), key=lambda file: natural_key(file.name))
        self.files = {file.name: file for file in files}
        self._arrange()

    def renew(self, name: str) -> None:
        """Renew what is known of one file of the folder."""
        try:
            self.files[name] = File(name, _signature((self.folder.root / name).stat()))
        except OSError:
            self.files.pop(name, None)
        self._listed_at = self.folder.time()
        self._arrange()

    def is_current(self, *files: File) -> bool:
        """Whether no file has come or gone, and these are the same."""
        return self._listed_at == self.folder.time() and all(map(self._is_same, files))

    def own(self, picture: File) -> File | None:
        """Landmark file of a picture in a format that the studio writes."""
        found = (self.own_files.get((picture.stem, suffix)) for suffix in OWN_SUFFIXES)
        return next((file for file in found if file is not None), None)

    def _arrange(self) -> None:
        """Sort the listing into pictures, landmark files of the studio's formats, and others."""
        files = self.files.values()
        self.pictures = [file for file in files if file.suffix in PICTURE_SUFFIXES]
        self.own_files = {(file.stem, file.suffix): file for file in files if file.suffix in OWN_SUFFIXES}
        others = set(LANDMARK_SUFFIXES) - set(OWN_SUFFIXES)
        self.other_files = [file for file in files if file.suffix in others]
        self.winners: dict[str, str] = {}
        for file in sorted(self.pictures, key=lambda file: PICTURE_SUFFIXES.index(file.suffix)):
            self.winners.setdefault(file.stem, file.name)
        self.version += 1

    def _entry(self, entry: os.DirEntry[str]) -> File | None:
        """One file of the listing; None for folders, links that lead out, and what has gone or cannot be named."""
        try:
            entry.name.encode()
            if entry.is_symlink() and not self.folder.leads_inside(Path(entry.path)):
                if Path(entry.name).suffix.lower() in (*PICTURE_SUFFIXES, *LANDMARK_SUFFIXES):
                    self.stranded.append(entry.name)
                return None
            if not entry.is_file():
                return None
            return File(entry.name, _signature(entry.stat()))
        except (OSError, UnicodeEncodeError):
            return None

    def _is_same(self, file: File) -> bool:
        try:
            return file.signature == _signature((self.folder.root / file.name).stat())
        except OSError:
            return False

    # Which pictures can be used -------------------------------------------------------------------

    def fault_of(self, picture: File) -> str | None:
        """Why a picture cannot be used."""
        winner = self.winners[picture.stem]
        if winner != picture.name:
            return f"{winner} has the same name but for its ending, and landmark files tell by the name: rename one"
        size = self.size_of(picture)
        return size if isinstance(size, str) else None

    def usable(self) -> list[File]:
        """Pictures that can be used."""
        return [file for file in self.pictures if self.fault_of(file) is None]

    def usable_size(self, picture: File) -> tuple[int, int]:
        """Width and height of a picture.

        Raises
        ------
        Refusal
            409 if it cannot be used.
        """
        fault, size = self.fault_of(picture), self.size_of(picture)
        if fault is not None or isinstance(size, str):
            raise Refusal(409, f"{picture.name} cannot be used: {fault or size}")
        return size

    def size_of(self, picture: File) -> tuple[int, int] | str:
        """Width and height of a picture from its header, or why it has none."""
        known = self._sizes.get(picture.name)
        if known is None or known[0] != picture.signature:
            known = self._sizes[picture.name] = (picture.signature, self._read_size(picture))
        return known[1]

    def _read_size(self, picture: File) -> tuple[int, int] | str:
        try:
            width, height = image_size(self.folder.inside(picture.name))
        except LiaamError as fault:
            return self.folder.plain(fault)
        if width * height > self._most_pixels:
            return (
                f"{picture.name} has {width} x {height} pixels, more than the {self._most_pixels:,} allowed: "
                "make the picture smaller"
            )
        try:
            as_colour(np.broadcast_to(np.uint8(0), (height, width, 3)), picture.name)
        except ImageError as fault:
            return str(fault)
        return width, height

    # What a person should know --------------------------------------------------------------------

    def passed_over(self) -> list[str]:
        """Say what lies in the folder and looks like a picture but is not shown, and why."""
        unread = [file.name for file in self.files.values() if file.suffix in _UNREAD]
        kinds = Counter(Path(name).suffix.lower() for name in unread)
        lines = []
        if unread:
            endings = ", ".join(f"{count} {suffix}" for suffix, count in sorted(kinds.items()))
            lines.append(
                f"{_several(unread, 'picture')} passed over, of a format that is not read ({endings}): "
                "save as PNG or JPEG"
            )
        if self.stranded:
            lines.append(
                f"{_several(self.stranded, 'file')} passed over, as a link that leads out of the folder: "
                "put a copy in its place"
            )
        return lines

    def orphans(self) -> list[str]:
        """Say which landmark files have no picture: perhaps one was renamed."""
        names = [file.name for (stem, _), file in self.own_files.items() if stem not in self.winners]
        if not names:
            return []
        return [
            f"{_several(names, 'landmark file')} without a picture of the same name: "
            "if the picture was renamed, rename the file too"
        ]


def _signature(facts: os.stat_result) -> Signature:
    return facts.st_mtime_ns, facts.st_size, facts.st_ino


def _several(names: Sequence[str], what: str) -> str:
    """Count files, and name the first few."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{len(names)} {what}{'s' if len(names) > 1 else ''} ({', '.join(names[:_NAMED])}{more})"
