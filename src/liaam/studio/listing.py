"""The listing of a project's folder: its pictures and landmark files, and whether each picture can be used."""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath

import numpy as np

from liaam.errors import ImageError, LiaamError
from liaam.io.files import count_of, natural_key, some_names
from liaam.io.images import PICTURE_SUFFIXES, UNREAD_SUFFIXES, image_size
from liaam.io.landmarks import LANDMARK_SUFFIXES
from liaam.photometry.encoding import as_colour
from liaam.studio.folder import Folder
from liaam.studio.safety import Refusal

OWN_SUFFIXES = (".pts", ".ljson")
"""Suffixes of the landmark files that the studio writes, in the order in which they are read."""

MOST_FOLDERS = 1000
"""Maximum number of folders that are listed."""

Signature = tuple[int, int, int]


@dataclass(frozen=True)
class File:
    """A file of the folder, with a signature that changes with it: time, size and inode."""

    name: str
    """Relative to the folder, with ``/`` between the parts."""
    signature: Signature

    @cached_property
    def stem(self) -> str:
        """Name without its suffix."""
        return self.name[: len(self.name) - len(PurePosixPath(self.name).suffix)]

    @cached_property
    def suffix(self) -> str:
        """Suffix in lower case."""
        return PurePosixPath(self.name).suffix.lower()

    @property
    def tag(self) -> str:
        """Identifier of the file's contents for the page."""
        return f"{self.signature[0]:x}-{self.signature[1]:x}"


class Listing:
    """The folder's files at the time of the last scan; ``version`` is incremented with every change.

    If there is no picture in the folder itself, the files of its subfolders are listed as well. ``files`` are by
    name, in natural order, ``other_files`` landmark files in other formats. ``winners`` are the pictures to which
    landmark files belong, by stem. ``stranded`` are links that lead out of the folder, and ``unlisted`` subfolders
    that are not listed.
    """

    def __init__(self, folder: Folder, most_pixels: int) -> None:
        self.folder = folder
        self.version = 0
        self.files: dict[str, File] = {}
        self.stranded: list[str] = []
        self.unlisted: list[str] = []
        self._most_pixels = most_pixels
        self._found: dict[str, Signature] = {}
        self._times: dict[str, int] = {}
        self._sizes: dict[str, tuple[Signature, tuple[int, int] | str]] = {}
        self._arrange()

    def scan(self) -> None:
        """List the folder."""
        self.stranded, self.unlisted, self._times = [], [], {}
        try:
            found, below = self._listed("")
        except OSError as fault:
            raise Refusal(
                503,
                f"{self.folder.root.name} cannot be read ({fault.strerror or fault}): is the folder still there?",
            ) from fault
        waiting = deque(below)
        if any(PurePosixPath(name).suffix.lower() in PICTURE_SUFFIXES for name in found):
            self.unlisted.extend(waiting)
            waiting.clear()
        while waiting:
            name = waiting.popleft()
            try:
                more, below = self._listed(name) if len(self._times) < MOST_FOLDERS else ({}, None)
            except OSError:
                more, below = {}, None
            found.update(more)
            waiting.extend(below or ())
            self.unlisted += [name] if below is None else []
        if found == self._found:
            return  # sorting thousands of files takes far longer than listing them
        self._found = found
        self.files = {name: File(name, found[name]) for name in sorted(found, key=natural_key)}
        self._arrange()

    def renew(self, name: str) -> None:
        """Update the entry of one landmark file in a format that the studio writes."""
        subfolder = name.rpartition("/")[0]
        self._times[subfolder] = self.folder.time(subfolder)
        try:
            self._found[name] = _signature((self.folder.root / name).stat())
        except OSError:
            self.files.pop(name, None)
            self._found.pop(name, None)
            self._arrange()
            return
        file = self.files[name] = File(name, self._found[name])
        if self._own.get(file.stem, file).name == name:
            self._own[file.stem] = file  # to arrange thousands of files for each that is written would take minutes
            self.version += 1
        else:
            self._arrange()

    def is_current(self, *files: File) -> bool:
        """Whether no file was added or removed, and the given files are unchanged."""
        same = all(self.folder.time(name) == time for name, time in self._times.items())
        return same and all(map(self._is_same, files))

    def own(self, picture: File) -> File | None:
        """Return the landmark file of a picture in a format that the studio writes."""
        return self._own.get(picture.stem)

    def _arrange(self) -> None:
        """Sort the files into pictures, landmark files in the studio's formats, and other landmark files."""
        files = self.files.values()
        self.pictures = [file for file in files if file.suffix in PICTURE_SUFFIXES]
        own_files = [file for file in files if file.suffix in OWN_SUFFIXES]
        self._own = {file.stem: file for file in sorted(own_files, key=lambda file: -OWN_SUFFIXES.index(file.suffix))}
        others = set(LANDMARK_SUFFIXES) - set(OWN_SUFFIXES)
        self.other_files = [file for file in files if file.suffix in others]
        self.winners: dict[str, str] = {}
        for file in sorted(self.pictures, key=lambda file: PICTURE_SUFFIXES.index(file.suffix)):
            self.winners.setdefault(file.stem, file.name)
        self.version += 1

    def _listed(self, subfolder: str) -> tuple[dict[str, Signature], list[str]]:
        """List the files of a folder, without links that lead out and unreadable entries, and its subfolders."""
        time = self.folder.time(subfolder)  # before the scan, so that changes during it are noticed
        found, below = {}, []
        with os.scandir(self.folder.root / subfolder) as entries:
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                name = f"{subfolder}/{entry.name}" if subfolder else entry.name
                try:
                    name.encode()
                    if entry.is_symlink() and not self.folder.leads_inside(Path(entry.path)):
                        is_known = PurePosixPath(name).suffix.lower() in (*PICTURE_SUFFIXES, *LANDMARK_SUFFIXES)
                        self.stranded += [name] if is_known else []
                    elif entry.is_file():
                        found[name] = _signature(entry.stat())
                    elif entry.is_dir(follow_symlinks=False):  # a link could lead to a folder above it
                        below.append(name)
                except (OSError, UnicodeEncodeError):
                    continue
        self._times[subfolder] = time
        return found, sorted(below, key=natural_key)

    def _is_same(self, file: File) -> bool:
        try:
            return file.signature == _signature((self.folder.root / file.name).stat())
        except OSError:
            return False

    def fault_of(self, picture: File) -> str | None:
        """Return why a picture cannot be used, or None if it can."""
        winner = self.winners[picture.stem]
        if winner != picture.name:
            return f"{winner} has the same name except for its suffix, so both would share landmark files: rename one"
        size = self.size_of(picture)
        return size if isinstance(size, str) else None

    def usable(self) -> list[File]:
        """Return the pictures that can be used."""
        return [file for file in self.pictures if self.fault_of(file) is None]

    def usable_size(self, picture: File) -> tuple[int, int]:
        """Return the width and height of a picture."""
        fault, size = self.fault_of(picture), self.size_of(picture)
        if fault is not None or isinstance(size, str):
            raise Refusal(409, f"{picture.name} cannot be used: {fault or size}")
        return size

    def size_of(self, picture: File) -> tuple[int, int] | str:
        """Return the width and height of a picture from its header, or an error message."""
        known = self._sizes.get(picture.name)
        if known is None or known[0] != picture.signature:
            known = self._sizes[picture.name] = (picture.signature, self._read_size(picture))
        return known[1]

    def mark_unreadable(self, picture: File, fault: str) -> None:
        """Remember that a picture cannot be decoded, although its header can be read."""
        self._sizes[picture.name] = (picture.signature, self.folder.plain(fault))
        self.version += 1

    def is_read(self, picture: File) -> bool:
        """Whether the header of a picture was read before, so that :meth:`size_of` is quick."""
        known = self._sizes.get(picture.name)
        return known is not None and known[0] == picture.signature

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

    def notices(self) -> list[str]:
        """Return messages about files that look like pictures but are skipped, and landmark files without a picture."""
        unread = [file.name for file in self.files.values() if file.suffix in UNREAD_SUFFIXES]
        kinds = Counter(Path(name).suffix.lower() for name in unread)
        lines = []
        if unread:
            endings = ", ".join(f"{count} {suffix}" for suffix, count in sorted(kinds.items()))
            lines.append(
                f"{_several(unread, 'picture')} skipped, because the format is not supported ({endings}): "
                "save as PNG or JPEG"
            )
        if self.stranded:
            lines.append(
                f"{_several(self.stranded, 'file')} skipped, because the link leads out of the folder: "
                "put a copy in its place"
            )
        below = [name for name in self.unlisted if self._has_pictures(name)]
        if below:
            lines.append(
                f"{_several(below, 'subfolder')} with pictures not shown, because "
                f"{'there are too many' if len(self._times) > 1 else 'the folder itself has pictures'}: "
                "open the studio on a subfolder"
            )
        own = [file for file in self.files.values() if file.suffix in OWN_SUFFIXES]
        orphans = [file.name for file in own if file.stem not in self.winners]
        if orphans:
            lines.append(
                f"{_several(orphans, 'landmark file')} without a picture of the same name: "
                "if the picture was renamed, rename the landmark file too"
            )
        return lines

    def _has_pictures(self, name: str) -> bool:
        try:
            with os.scandir(self.folder.root / name) as entries:
                return any(Path(entry.name).suffix.lower() in PICTURE_SUFFIXES for entry in entries)
        except OSError:
            return False


def _signature(facts: os.stat_result) -> Signature:
    return facts.st_mtime_ns, facts.st_size, facts.st_ino


def _several(names: Sequence[str], what: str) -> str:
    """Return the number of files and the first few names."""
    return f"{count_of(len(names), what)} ({some_names(names, 3)})"
