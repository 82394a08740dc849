"""Pictures and landmark files that are added to the folder through the page; each is checked before it is written."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from liaam.errors import LiaamError
from liaam.io import is_raw
from liaam.io.atomic import write_bytes_atomically
from liaam.io.images import PICTURE_SUFFIXES
from liaam.io.landmarks import LANDMARK_SUFFIXES, parse_landmark_data
from liaam.studio.folder import is_relative
from liaam.studio.listing import OWN_SUFFIXES, Listing
from liaam.studio.safety import Refusal
from liaam.studio.uploads import plain_name, size_in_header

ADDED = "added"
"""Subfolder of added pictures if the folder has pictures in its subfolders only: with one of its own, it would no
longer list these."""

SOME_SIZE = (640, 480)
"""Size assumed for landmark files that need one, to check whether they can be read."""


@dataclass(frozen=True, eq=False)
class Intake:
    """Writes files to the folder. It replaces none, and none of the landmarks that are there."""

    listing: Listing
    most_pixels: int
    _stems: dict[str, str] = field(default_factory=dict)
    """Name of each added picture by its stem, until the folder is listed again."""

    def add(self, name: str, data: bytes) -> dict[str, Any]:
        """Write a file; return its ``name`` in the folder, its ``kind``, and whether it was ``known`` before."""
        name = plain_name(name)
        suffix = Path(name).suffix.lower()
        if suffix in PICTURE_SUFFIXES:
            kind = "picture"
        elif suffix in LANDMARK_SUFFIXES:
            kind = "landmarks"
        else:
            raise Refusal(415, f"{name} is neither a picture nor a landmark file that liaam reads")
        if not data:
            raise Refusal(422, f"{name} is empty (0 bytes): copy or export it again")
        if not is_relative(name):
            raise Refusal(422, f"{name} is the name of a hidden file: rename it")
        pictures = self.listing.pictures
        place = f"{ADDED}/{name}" if pictures and all("/" in each.name for each in pictures) else name
        path = self.listing.folder.inside(place)
        if path.exists():
            if path.read_bytes() != data:
                raise Refusal(409, f"{name}: the folder has another file of this name; rename one of them")
            return {"name": place, "kind": kind, "known": True}
        if kind == "landmarks":
            _check_landmarks(name, data)
        elif not is_raw(name):  # RAW files can only be read from the disk
            size_in_header(data, name, self.most_pixels)
        self._check_place(place, kind)
        path.parent.mkdir(exist_ok=True)
        write_bytes_atomically(path, data)
        return {"name": place, "kind": kind, "known": False}

    def _check_place(self, place: str, kind: str) -> None:
        """Refuse a second picture, or second landmarks, of the same name but for the suffix."""
        stem, suffix = place[: -len(Path(place).suffix)], Path(place).suffix.lower()
        if kind == "picture":
            other = self._stems.setdefault(stem, self.listing.winners.get(stem, place))
            if other != place:
                raise Refusal(409, f"{place} and {other} have the same name except for the suffix: rename one of them")
        elif suffix in OWN_SUFFIXES:
            there = [stem + own for own in OWN_SUFFIXES if self.listing.folder.inside(stem + own).exists()]
            if there:
                raise Refusal(409, f"{place}: the picture has landmarks already, in {there[0]}")


def _check_landmarks(name: str, data: bytes) -> None:
    try:
        parse_landmark_data(name, data, SOME_SIZE)
    except LiaamError as fault:
        raise Refusal(422, str(fault)) from fault
