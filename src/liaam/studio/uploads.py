"""Pictures dropped on the page: checked before decoding, and kept in memory only, up to a few."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

from liaam.errors import ImageError
from liaam.io import decode_image, image_kind, image_size, is_raw, read_preview
from liaam.studio.pictures import Kept, Pictures, Source
from liaam.studio.safety import Refusal
from liaam.studio.settings import Settings

LONGEST_NAME = 120
"""Maximum number of characters of a name."""


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
        width, height = self._checked(data, name)
        upload = Upload(secrets.token_urlsafe(9), name, data, width, height)
        source = self._source(upload, data)
        try:
            self._pictures.pixels(source, source.has_copy)
        except ImageError as fault:
            raise Refusal(422, str(fault)) from fault
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

    def _checked(self, data: bytes, name: str) -> tuple[int, int]:
        """Check an upload before it is decoded; return the width and height from its header."""
        most = self._settings.upload_bytes
        if len(data) > most:
            raise Refusal(413, f"{name} has {len(data):,} bytes, more than {most:,}: make it smaller")
        if data and is_raw(name):
            raise Refusal(415, f"{name} is a RAW file, which can only be read from the folder: put it there")
        return size_in_header(data, name, self._settings.pixels)


def size_in_header(data: bytes, name: str, most_pixels: int) -> tuple[int, int]:
    """Return the width and height of an image file from its header; refuse other files and too large images."""
    if not data:
        raise Refusal(422, f"{name} is empty (0 bytes): copy or export it again")
    if not image_kind(data):
        raise Refusal(415, f"{name} is not a PNG, JPEG, TIFF, BMP, PPM or PGM image: save it as PNG in another program")
    try:
        width, height = image_size(data, name)
    except ImageError as fault:
        raise Refusal(422, str(fault)) from fault
    if width * height > most_pixels:
        raise Refusal(413, f"{name} has {width} x {height} pixels, more than {most_pixels:,}: make the picture smaller")
    return width, height


def plain_name(name: str) -> str:
    """Return a file name without folders and unprintable characters, or "picture" if nothing is left."""
    last = name.replace("\\", "/").rpartition("/")[2]
    shown = "".join(letter if letter.isprintable() else " " for letter in last).strip()
    return shown[-LONGEST_NAME:] or "picture"
