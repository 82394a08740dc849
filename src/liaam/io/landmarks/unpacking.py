"""Read parts of ``.zip`` files, which may promise more than memory holds."""

import zlib
from zipfile import ZipFile

from liaam.errors import LandmarkError
from liaam.io.landmarks.reading import short

_RATIO = 100
"""Most bytes that a packed byte may become; text packs to a tenth, and repeated text to a fiftieth."""

_FREE = 1_000_000
"""Bytes that a part may have at any ratio."""


def member_of(archive: ZipFile, name: str, limit: int) -> bytes:
    """Return a part of an archive, of at most ``limit`` bytes."""
    info = archive.getinfo(name)
    if info.file_size > limit or info.file_size > _RATIO * info.compress_size + _FREE:
        size = f"'{short(name)}' in it would have {info.file_size:,} bytes"
        raise LandmarkError(f"{size}, more than is read of such a file: save it again with less in it.")
    try:
        with archive.open(info) as part:
            return part.read(limit)
    except (OSError, EOFError, ValueError, zlib.error) as fault:  # its packing is damaged
        raise LandmarkError(f"'{short(name)}' in it is damaged ({fault}): save it again.") from fault
