"""Files that a person brings, each checked first: pictures kept in memory only, and files added to the folder."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from liaam.io import decode_image, image_kind, image_size, is_raw, read_preview
from liaam.io.atomic import write_bytes_atomically
from liaam.io.images import PICTURE_SUFFIXES
from liaam.io.landmarks import LANDMARK_SUFFIXES, parse_landmark_data
from liaam.studio.folder import OWN_SUFFIXES, Listing, check_pixels, is_relative
from liaam.studio.pictures import Kept, Pictures, Source
from liaam.studio.safety import Refusal, refusing
from liaam.studio.settings import Settings

LONGEST_NAME = 120
"""Maximum number of characters of a name."""

ADDED = "added"
"""Subfolder of added pictures if the folder has pictures in its subfolders only: with one of its own, it would no
longer list these."""

SOME_SIZE = (640, 480)
"""Size assumed for landmark files that need one, to check whether they can be read."""


@dataclass(frozen=True, eq=False)
class Upload:
    """A dropped picture."""

    id: str
    name: str
    """Name of the file without folders."""
    data: bytes
    """Contents of the file."""
    width: int
    """Width of the upright picture in pixels."""
    height: int


class Uploads:
    """The last used dropped pictures, up to limits of number, bytes and pixels; thread-safe."""

    def __init__(self, pictures: Pictures, settings: Settings | None = None) -> None:
        self._pictures = pictures
        self._settings = settings or Settings()
        most, self._least = self._settings.uploads_bytes, self._settings.uploads_bytes // self._settings.uploads_kept
        self._uploads: Kept[str, Upload] = Kept(most, lambda upload: min(max(len(upload.data), self._least), most))

    def __len__(self) -> int:
        return len(self._uploads)

    def add(self, data: bytes, name: str) -> Upload:
        """Check, decode and keep a picture."""
        name = plain_name(name)
        most = self._settings.upload_bytes
        if len(data) > most:
            raise Refusal(413, f"{name} has {len(data):,} bytes, more than {most:,}: make it smaller")
        if data and is_raw(name):
            raise Refusal(415, f"{name} is a RAW file, which can only be read from the folder: put it there")
        upload = Upload(secrets.token_urlsafe(9), name, data, *size_in_header(data, name, self._settings.pixels))
        source = self._source(upload, data)
        with refusing():
            self._pictures.pixels(source, source.has_copy)
        self._uploads.put(upload.id, upload)
        return upload

    def get(self, number: str) -> Upload:
        """Return the upload with an id."""
        upload = self._uploads.peek(number)
        if upload is None:
            kept = f"only the {self._settings.uploads_kept} last used are kept"
            raise Refusal(404, f"this picture is no longer in memory, where {kept}: drop it again")
        return upload

    def source(self, number: str) -> Source:
        """Return an upload as a :class:`Source`, which can be read while the upload is in memory."""
        return self._source(self.get(number))

    def _source(self, upload: Upload, data: bytes | None = None) -> Source:
        # A source may outlive the upload, so it must not hold its bytes, unless they are not kept yet.
        number, name, pixels = upload.id, upload.name, self._settings.pixels
        return Source(
            name,
            f"upload-{number}",
            (upload.width, upload.height),
            lambda: decode_image(data or self.get(number).data, name, pixels),
            lambda size: read_preview(data or self.get(number).data, size, pixels, name),
        )


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
        is_picture = suffix in PICTURE_SUFFIXES
        if not is_picture and suffix not in LANDMARK_SUFFIXES:
            raise Refusal(415, f"{name} is neither a picture nor a landmark file that liaam reads")
        if not data:
            raise Refusal(422, f"{name} is empty (0 bytes): copy or export it again")
        if not is_relative(name):
            raise Refusal(422, f"{name} is the name of a hidden file: rename it")
        pictures = self.listing.pictures
        place = f"{ADDED}/{name}" if pictures and all("/" in each.name for each in pictures) else name
        path = self.listing.folder.inside(place)
        is_known = path.exists()
        if is_known and path.read_bytes() != data:
            raise Refusal(409, f"{name}: the folder has another file of this name; rename one of them")
        if not is_known:
            if not is_picture:
                with refusing():
                    parse_landmark_data(name, data, SOME_SIZE)
            elif not is_raw(name):  # RAW files can only be read from the disk
                size_in_header(data, name, self.most_pixels)
            self._check_place(place, is_picture)
            path.parent.mkdir(exist_ok=True)
            write_bytes_atomically(path, data)
        return {"name": place, "kind": "picture" if is_picture else "landmarks", "known": is_known}

    def _check_place(self, place: str, is_picture: bool) -> None:
        """Refuse a second picture, or second landmarks, of the same name but for the suffix."""
        stem, suffix = place[: -len(Path(place).suffix)], Path(place).suffix.lower()
        if is_picture:
            other = self._stems.setdefault(stem, self.listing.winners.get(stem, place))
            if other != place:
                raise Refusal(409, f"{place} and {other} have the same name except for the suffix: rename one of them")
        elif suffix in OWN_SUFFIXES:
            there = [stem + own for own in OWN_SUFFIXES if self.listing.folder.inside(stem + own).exists()]
            if there:
                raise Refusal(409, f"{place}: the picture has landmarks already, in {there[0]}")


def size_in_header(data: bytes, name: str, most_pixels: int) -> tuple[int, int]:
    """Return the width and height of an image file from its header; refuse other files and too large images."""
    if not data:
        raise Refusal(422, f"{name} is empty (0 bytes): copy or export it again")
    if not image_kind(data):
        raise Refusal(415, f"{name} is not a PNG, JPEG, TIFF, BMP, PPM or PGM image: save it as PNG in another program")
    with refusing():
        size = image_size(data, name)
    check_pixels(name, size, most_pixels)
    return size


def plain_name(name: str) -> str:
    """Return a file name without folders and unprintable characters, or "picture" if nothing is left."""
    last = name.replace("\\", "/").rpartition("/")[2]
    shown = "".join(letter if letter.isprintable() else " " for letter in last).strip()
    return shown[-LONGEST_NAME:] or "picture"
