"""The pages of TIFF files: which of them are the picture, and which cannot be read.

A TIFF is a chain of pages. Cameras, scanners and slide scanners add reduced copies of a picture as further pages, or
put one first. ImageJ saves each colour of a composite as a page, and stacks of pictures as one file.
"""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

# Tags of the TIFF 6.0 specification.
NEW_SUBFILE_TYPE = 254
SUBFILE_TYPE = 255
WIDTH = 256
HEIGHT = 257
BITS = 258
COMPRESSION = 259
PHOTOMETRIC = 262
DESCRIPTION = 270
SAMPLES = 277
PLANAR = 284
FORMAT = 339
SUB_PAGES = 330
EXTENTS = ((273, 279), (324, 325))  # offsets and byte counts, of strips or of tiles
# Tags of ImageJ: the lengths of its blocks of facts, and these blocks.
IMAGEJ_COUNTS = 50838
IMAGEJ_BLOCKS = 50839

MOST_PAGES = 1000
"""Pages that are looked at. A file of more holds several pictures in any case."""

_REDUCED_OR_MASK = 0b101  # bits of NEW_SUBFILE_TYPE
_OLD_REDUCED = 2  # value of SUBFILE_TYPE
_PREVIEW = 2  # least factor of the sides of a picture to those of a preview of it that is not marked as one
_TYPES = {1: "B", 3: "H", 4: "I", 16: "Q"}  # of integers in tags
_LUT = 768  # bytes of a colour table of ImageJ: 256 of red, then of green and of blue
_PRIMARIES = ((255, 0, 0), (0, 255, 0), (0, 0, 255))
_AS_RGB = "save it as RGB (in ImageJ: Image > Type > RGB Color)"

# Compressions that neither decoder reads, by tag.
_COMPRESSIONS = {33003: "JPEG 2000", 33004: "JPEG 2000", 33005: "JPEG 2000", 34712: "JPEG 2000", 34887: "LERC"}
_COMPRESSIONS |= {22610: "JPEG XR", 34934: "JPEG XR", 50002: "JPEG XL", 52546: "JPEG XL", 34892: "lossy JPEG of DNG"}


@dataclass(frozen=True)
class Page:
    """Where a page lies in its file, and what its tags of integers say."""

    index: int
    offset: int
    values: dict[int, int]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels; 0 if they are not stated."""
        return self.values.get(WIDTH, 0), self.values.get(HEIGHT, 0)

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        width, height = self.size
        return width * height

    @property
    def is_reduced(self) -> bool:
        """Whether it is marked as a reduced copy of another page, or as a mask."""
        old = self.values.get(SUBFILE_TYPE) == _OLD_REDUCED
        return old or bool(self.values.get(NEW_SUBFILE_TYPE, 0) & _REDUCED_OR_MASK)

    @property
    def is_grey(self) -> bool:
        """Whether a pixel is one value from black to white."""
        return self.values.get(SAMPLES, 1) == 1 and self.values.get(PHOTOMETRIC) == 1


def pages_of(file: BinaryIO) -> list[Page]:
    """Return the pages of a TIFF in their order; those behind a fault of the chain are left out."""
    n_bytes = file.seek(0, 2)
    file.seek(0)
    start = file.read(16)
    order = "<" if start[:2] == b"II" else ">"
    is_big = struct.unpack(f"{order}H", start[2:4]) == (43,)
    if is_big:
        offset = struct.unpack(f"{order}Q", start[8:16].ljust(8, b"\0"))[0]
    else:
        offset = struct.unpack(f"{order}I", start[4:8].ljust(4, b"\0"))[0]
    pages: list[Page] = []
    seen: set[int] = set()
    while 0 < offset < n_bytes and offset not in seen and len(pages) < MOST_PAGES:
        seen.add(offset)
        try:
            values, following = _directory(file, offset, order, is_big)
        except struct.error:  # the file ends within it
            break
        pages.append(Page(len(pages), offset, values))
        offset = following
    return pages


def _directory(file: BinaryIO, offset: int, order: str, is_big: bool) -> tuple[dict[int, int], int]:
    """Return the first value of each tag of integers of a page, and the offset of the next page."""
    count_form, entry_form, next_form = ("Q", "HHQ8s", "Q") if is_big else ("H", "HHI4s", "I")
    file.seek(offset)
    (count,) = _unpack(file, order + count_form)
    entry = struct.Struct(order + entry_form)
    data = file.read(min(count, 0xFFFF) * entry.size)
    if count > 0xFFFF or len(data) < count * entry.size:
        raise struct.error("the file ends within its tags")
    values: dict[int, int] = {}
    for tag, kind, n_values, stored in entry.iter_unpack(data):
        form = _TYPES.get(kind)
        if form is None or not n_values:
            continue
        size = struct.calcsize(form)
        if n_values * size <= len(stored):
            values[tag] = struct.unpack(order + form, stored[:size])[0]
        elif tag == BITS:  # the values lie elsewhere in the file
            file.seek(struct.unpack(order + next_form, stored)[0])
            values[tag] = _unpack(file, order + form)[0]
    file.seek(offset + struct.calcsize(count_form if is_big else "H") + len(data))
    (following,) = _unpack(file, order + next_form)
    return values, following


def _unpack(file: BinaryIO, form: str) -> tuple[Any, ...]:
    """Read numbers of a form of :mod:`struct`; raise struct.error at the end of the file."""
    return struct.unpack(form, file.read(struct.calcsize(form)))


def picture_in(pages: Sequence[Page], tags: Any) -> tuple[tuple[int, ...], str]:
    """Return the index of the page that is the picture, or of its red, green and blue; and why there is none, or "".

    ``tags`` are those of the first page.
    """
    full = [page for page in pages if not page.is_reduced and page.pixels]
    if not full and tags.get(SUB_PAGES):
        return (0,), "holds a reduced copy, and its picture in a sub-page, which is not read: save it as a usual TIFF."
    description = _text(tags.get(DESCRIPTION, ""))
    declared = re.search(r"^ImageJ=.*?^images=(\d{1,9})\s*$", description, re.DOTALL | re.MULTILINE)
    n_pictures = max(len(full), int(declared[1]) if declared is not None else 0)
    if n_pictures < 2:
        return ((full[0].index if full else 0),), ""
    largest = max(full, key=lambda page: page.pixels, default=None)
    if largest is not None and n_pictures == len(full):
        if all(page is largest or _is_preview(page, largest) for page in full):
            return (largest.index,), ""
        order = _colours(full, tags, description)
        if order is not None:
            return tuple(full[i].index for i in order), ""
    sizes = list(dict.fromkeys(f"{page.size[0]} x {page.size[1]}" for page in full))
    fault = f"holds {n_pictures} pictures ({', '.join(sizes[:3])} pixels), not one"
    remedy = "save the one to use as a file of its own"
    if n_pictures <= 4 and len(sizes) == 1 and all(page.is_grey for page in full):
        remedy += f"; or, if they are the colours of one picture, {_AS_RGB}"
    return (0,), f"{fault}: {remedy}."


def _is_preview(page: Page, picture: Page) -> bool:
    """Whether a page is a reduced copy of a picture by its size."""
    width, height = page.size
    whole_width, whole_height = picture.size
    is_copy = abs(width * whole_height - height * whole_width) <= max(whole_width, whole_height)
    return is_copy and _PREVIEW * width <= whole_width


def _text(value: Any) -> str:
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)


def _colours(pages: Sequence[Page], tags: Any, description: str) -> tuple[int, ...] | None:
    """Return the places of red, green and blue among the grey pages of ImageJ's composite; None if it is none."""
    facts = dict(re.findall(r"^(\w+)=(\w+)\s*$", description, re.MULTILINE))
    is_composite = facts.get("channels") == "3" and facts.get("mode") in ("composite", "color")
    alike = len({(page.size, page.values.get(BITS, 1)) for page in pages}) == 1
    if not (len(pages) == 3 and alike and is_composite and all(page.is_grey for page in pages)):
        return None
    shown_in = _colours_of_tables(tags)
    if shown_in is None:
        return (0, 1, 2)  # as ImageJ shows channels without tables
    return tuple(shown_in.index(colour) for colour in _PRIMARIES) if set(shown_in) == set(_PRIMARIES) else None


def _colours_of_tables(tags: Any) -> list[tuple[int, ...]] | None:
    """Return the brightest colour of each channel's colour table, which ImageJ stores; None if it stores none."""
    counts = tags.get(IMAGEJ_COUNTS)
    blocks = tags.get(IMAGEJ_BLOCKS)
    if not isinstance(counts, tuple) or not isinstance(blocks, bytes):
        return None
    header = blocks[: counts[0]]
    at = counts[0]
    order = ">" if header[:4] == b"IJIJ" else "<"
    kinds: list[bytes] = []
    for start in range(4, len(header) - 7, 8):
        kind = header[start : start + 4] if order == ">" else header[start : start + 4][::-1]
        (number,) = struct.unpack(f"{order}I", header[start + 4 : start + 8])
        kinds += [kind] * min(number, MOST_PAGES)
    tables = []
    for kind, size in zip(kinds, counts[1:], strict=False):
        block = blocks[at : at + size]
        at += size
        if kind == b"luts" and len(block) == _LUT:
            tables.append(tuple(block[255::256]))
    return tables or None


def fault_of(tags: Any, n_bytes: int) -> str:
    """Describe why the pixels of a page, given by Pillow's tags, cannot be decoded; empty if they can."""
    for offsets, counts in EXTENTS:
        pairs = zip(tags.get(offsets, ()), tags.get(counts, ()), strict=False)
        if any(offset + count > n_bytes for offset, count in pairs):
            return "is cut short (it ends before its pixels do): copy it again."
    compression = tags.get(COMPRESSION, 1)
    if compression in _COMPRESSIONS:
        packed = f"is a TIFF whose pixels are compressed by {_COMPRESSIONS[compression]}, which is not read"
        return f"{packed}: save it as TIFF with LZW, or as PNG (with QuPath, ImageJ or 'vips copy')."
    bits = set(tags.get(BITS, (1,)))
    n_samples = tags.get(SAMPLES, 1)
    if max(bits) <= 8:
        is_grey_with_bands = n_samples > 2 and tags.get(PHOTOMETRIC) in (0, 1)  # two are grey and transparency
        return f"has {n_samples} bands: save those for red, green and blue as RGB." if is_grey_with_bands else ""
    kinds = {(depth, form) for depth in bits for form in tags.get(FORMAT, (1,))}
    if kinds not in ({(16, 1)}, {(32, 3)}, {(64, 3)}):
        return "does not hold 8- or 16-bit unsigned integers or 32-bit floats: convert it to one of these."
    if n_samples not in (1, 3, 4) or tags.get(PHOTOMETRIC) not in (1, 2):
        return "is not a grey or RGB image: convert it to RGB."
    if n_samples > 1 and tags.get(PLANAR, 1) != 1:
        return "stores its channels in separate planes: save it with interleaved channels."
    return ""


def starting_at(data: bytes, page: Page) -> bytearray:
    """Return a file's bytes with a page as its first."""
    order = "<" if data[:2] == b"II" else ">"
    moved = bytearray(data)
    is_big = struct.unpack(f"{order}H", data[2:4]) == (43,)
    struct.pack_into(f"{order}Q" if is_big else f"{order}I", moved, 8 if is_big else 4, page.offset)
    return moved
