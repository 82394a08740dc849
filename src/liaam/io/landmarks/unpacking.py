"""Read parts of ``.zip`` files, which may promise more than memory holds, and more parts than can be listed in time."""

import io
import zlib
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

from liaam.errors import LandmarkError
from liaam.io.landmarks.reading import UnrecognisedError, short

_ENTRY = b"PK\1\2"
"""What begins the entry of each part in an archive's list."""

_MOST_PARTS = 30_000
"""Parts of an archive; a list of more takes long to read, and none of ours has them."""

_MOST_BYTES = 40_000_000
"""Bytes that all parts that are read may have together: many entries may name one part."""

_RATIO = 100
"""Most bytes that a packed byte may become; text packs to a tenth, and repeated text to a fiftieth."""

_FREE = 1_000_000
"""Bytes that a part may have at any ratio."""

_METHODS = (ZIP_STORED, ZIP_DEFLATED)
"""How parts may be packed. Other ways may need gigabytes to unpack, and none of the programs uses them."""

_DAMAGES = (BadZipFile, EOFError, NotImplementedError, OSError, OverflowError, RuntimeError, ValueError, zlib.error)
"""What reading a damaged or locked archive raises."""


class Archive:
    """A ``.zip`` file in memory, of which parts are read within limits.

    Parameters
    ----------
    data : bytes
        Its content.
    kind : str
        What it should be, for messages, such as ``.xlsx``.
    remedy : str
        What to do if it is damaged.

    Raises
    ------
    UnrecognisedError
        If it has so many parts that it is none of ours.
    LandmarkError
        If it is damaged.
    """

    def __init__(self, data: bytes, kind: str, remedy: str) -> None:
        self._kind = kind
        self._remedy = remedy
        self._bytes_left = _MOST_BYTES
        n_parts = data.count(_ENTRY)  # the number that the archive states may be another
        if n_parts > _MOST_PARTS:
            raise UnrecognisedError(f"it holds {n_parts:,} files, more than {_MOST_PARTS:,}: save fewer in it.")
        try:
            self._file = ZipFile(io.BytesIO(data))
        except _DAMAGES as fault:
            raise self.damage(fault) from fault

    def damage(self, fault: object) -> LandmarkError:
        """Return the error that says what is wrong with it."""
        return LandmarkError(f"it is no sound {self._kind} ({fault}): {self._remedy}.")

    @property
    def parts(self) -> list[ZipInfo]:
        """Its parts, of which several may have one name."""
        return self._file.infolist()

    def part(self, name: str) -> ZipInfo | None:
        """Return the part of a name, if there is one."""
        return self._file.NameToInfo.get(name)

    def read(self, part: ZipInfo, limit: int) -> bytes:
        """Return a part of at most ``limit`` bytes."""
        name = short(part.filename)
        limit = min(limit, _RATIO * part.compress_size + _FREE)
        if part.file_size > limit:
            size = f"'{name}' in it would have {part.file_size:,} bytes"
            raise LandmarkError(f"{size}, more than is read of such a file: save it again with less in it.")
        self._bytes_left -= part.file_size
        if self._bytes_left < 0:
            raise LandmarkError(f"its files have more than {_MOST_BYTES:,} bytes together: save it with less in it.")
        if part.compress_type not in _METHODS:
            raise self.damage(f"'{name}' in it is packed in a way that is not read")
        try:
            with self._file.open(part) as opened:
                return opened.read(limit)
        except _DAMAGES as fault:
            raise LandmarkError(f"'{name}' in it is damaged ({fault}): {self._remedy}.") from fault
