"""Selections of ImageJ: ``.roi``, and ``RoiSet.zip`` with several."""

import re
import struct
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks import reading as rd
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import Source, UnrecognisedError
from liaam.io.landmarks.unpacking import Archive

_MAGIC = b"Iout"
_HEADER = 64  # bytes before the coordinates
_LINES = (0, 4, 5, 7, 8)  # kinds of selections that are lines or outlines
_POINTS = 10  # kind of a selection of points
_SUBPIXEL = 128  # option
_LEAST = -5000  # least number of 16 bits that is negative
_COUNTERS = 48  # bytes of the second header before the place of the numbers of points
_SEVERAL_PLANES = "several planes of a stack: save those of one image."
_MOST_BYTES = 1_000_000  # of a selection
_MOST = 10_000  # selections
_NUMBERED = re.compile(r"\d{4,5}(-\d{4,5}){1,2}")  # names that ImageJ gives by itself


@dataclass(frozen=True)
class _Selection:
    """A selection: its name, its plane in a stack, and its points (n, 2)."""

    name: str
    plane: int
    is_line: bool
    points: np.ndarray


def parse_roi(source: Source) -> list[Landmarks]:
    """Parse a selection of points, or else a line or outline.

    Whole numbers are pixels, and fractions count from the corner of the first pixel, so half a pixel is subtracted.
    """
    selection = _selection(source.data, source.path.stem)
    if selection is None:
        raise LandmarkError("this selection of ImageJ has no points: use the multi-point tool.")
    return [Landmarks(selection.points)]


def parse_roi_set(source: Source) -> list[Landmarks]:
    """Parse selections of one image: a point each, named by the names that were given, or points of an object each."""
    archive = Archive(source.data, ".zip", "save it again from ImageJ")
    parts = [part for part in archive.parts if _is_selection(part.filename)]
    if not parts:
        raise UnrecognisedError("this .zip has no selections of ImageJ: unpack it, or save RoiSet.zip again.")
    if len(parts) > _MOST:
        raise LandmarkError(f"it holds {len(parts):,} selections, more than {_MOST:,}: save fewer.")
    read = [_selection(archive.read(part, _MOST_BYTES), part.filename[:-4]) for part in parts]
    selections = [selection for selection in read if selection is not None]
    points = [selection for selection in selections if not selection.is_line]
    used = points or selections
    if len(used) < len(parts):
        source.notes.say("selections of ImageJ that are no points are not read", source.path.name)
    if not used:
        raise LandmarkError("its selections are no points: use the point tools.")
    if len({selection.plane for selection in used}) > 1:
        raise LandmarkError(f"its selections lie on {_SEVERAL_PLANES}")
    counts = {len(selection.points) for selection in used}
    if counts == {1}:
        landmarks = Landmarks(np.concatenate([selection.points for selection in used]))
        given = [selection.name for selection in used]
        if any(_NUMBERED.fullmatch(name) for name in given):
            return [landmarks]
        if len(set(given)) < len(given):
            source.notes.say("selections of ImageJ are read in their order, because some have one name", _twice(given))
            return [landmarks]
        return [replace(landmarks, names=tuple(given))]
    if len(counts) > 1:
        numbers = " and ".join(map(str, sorted(counts)[:2]))
        raise LandmarkError(f"its selections have {numbers} points: make one of all points for each object.")
    return [Landmarks(selection.points, label=selection.name) for selection in used]


def _is_selection(name: str) -> bool:
    """Whether a part of an archive has the name of a selection, and is not what a Mac stores beside it."""
    return name.lower().endswith(".roi") and not name.rpartition("/")[2].startswith("._")


def _twice(names: list[str]) -> str:
    """Return a name that occurs several times."""
    return rd.short(Counter(names).most_common(1)[0][0])


def _selection(data: bytes, name: str) -> _Selection | None:
    """Return a selection; None if it has no points."""
    if data[:4] != _MAGIC or len(data) < _HEADER:
        raise LandmarkError(f"'{rd.short(name)}' is no selection of ImageJ, or is cut short: save it again.")
    kind = data[6]
    top, left = _shorts(data[8:12])
    (count,) = struct.unpack(">H", data[16:18])
    (options,) = struct.unpack(">h", data[50:52])
    (plane, second_header) = struct.unpack(">ii", data[56:64])
    count = count or max(struct.unpack(">i", data[18:22])[0], 0)  # where 16 bits do not suffice
    if kind not in (*_LINES, _POINTS) or count == 0:
        return None
    is_fraction = bool(options & _SUBPIXEL)
    start = _HEADER + (4 * count if is_fraction else 0)
    size = 4 if is_fraction else 2
    end = start + 2 * count * size
    if end > len(data):
        raise LandmarkError(f"'{rd.short(name)}' is cut short: save it again.")
    if is_fraction:
        values = np.frombuffer(data[start:end], np.dtype(">f4")).astype(np.float64) - 0.5
    else:
        values = np.maximum(_shorts(data[start:end]), 0) + np.repeat([left, top], count)
    if not np.isfinite(values).all():
        raise LandmarkError(f"'{rd.short(name)}' has positions that are no numbers: save it again.")
    planes = _planes_of_points(data, second_header, count) if kind == _POINTS else {0}
    if len(planes) > 1:
        raise LandmarkError(f"the points of '{rd.short(name)}' lie on {_SEVERAL_PLANES}")
    plane = max(planes) or plane
    return _Selection(name.rpartition("/")[2], plane, kind in _LINES, values.reshape(2, count).T)


def _shorts(data: bytes) -> np.ndarray:
    """Return numbers of 16 bits as float64, of which ImageJ takes those below -5000 for ones above 32767."""
    signed = np.frombuffer(data, np.dtype(">i2")).astype(np.float64)
    return np.where(signed < _LEAST, signed + 65536, signed)


def _planes_of_points(data: bytes, second_header: int, count: int) -> set[int]:
    """Return the planes of a stack on which the points of a selection lie, 0 if they are not stated.

    The second header may say where a number of each point is, with its counter in 8 bits and its plane above these.
    """
    at = second_header + _COUNTERS
    if second_header < _HEADER or at + 4 > len(data):
        return {0}
    (start,) = struct.unpack(">i", data[at : at + 4])
    if start < _HEADER or start + 4 * count > len(data):
        return {0}
    return {*(np.frombuffer(data[start : start + 4 * count], np.dtype(">i4")) >> 8).tolist()}
