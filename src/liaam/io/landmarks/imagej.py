"""Selections of ImageJ: ``.roi``, and ``RoiSet.zip`` with several."""

import io
import re
import struct
from dataclasses import dataclass, replace
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks import reading as rd
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import Source, UnrecognisedError
from liaam.io.landmarks.unpacking import member_of

_MAGIC = b"Iout"
_HEADER = 64  # bytes before the coordinates
_LINES = (0, 4, 5, 7, 8)  # kinds of selections that are lines or outlines
_POINTS = 10  # kind of a selection of points
_SUBPIXEL = 128  # option
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
    try:
        with ZipFile(io.BytesIO(source.data)) as archive:
            names = [name for name in archive.namelist() if name.lower().endswith(".roi")]
            if not names:
                raise UnrecognisedError("this .zip has no selections of ImageJ: unpack it, or save RoiSet.zip again.")
            if len(names) > _MOST:
                raise LandmarkError(f"it holds {len(names):,} selections, more than {_MOST:,}: save fewer.")
            read = [_selection(member_of(archive, name, _MOST_BYTES), name[:-4]) for name in names]
    except (BadZipFile, NotImplementedError, RuntimeError) as fault:  # damaged, or packed or locked in another way
        raise LandmarkError(f"it is no sound .zip ({fault}): save it again from ImageJ.") from fault
    selections = [selection for selection in read if selection is not None]
    points = [selection for selection in selections if not selection.is_line]
    used = points or selections
    if len(used) < len(names):
        source.notes.say("selections of ImageJ that are no points are not read", source.path.name)
    if not used:
        raise LandmarkError("its selections are no points: use the point tools.")
    if len({selection.plane for selection in used}) > 1:
        raise LandmarkError("its selections lie on several planes of a stack: save those of one image.")
    counts = {len(selection.points) for selection in used}
    if counts == {1}:
        landmarks = Landmarks(np.concatenate([selection.points for selection in used]))
        given = [selection.name for selection in used]
        if any(_NUMBERED.fullmatch(name) for name in given) or len(set(given)) < len(given):
            return [landmarks]
        return [replace(landmarks, names=tuple(given))]
    if len(counts) > 1:
        numbers = " and ".join(map(str, sorted(counts)[:2]))
        raise LandmarkError(f"its selections have {numbers} points: make one of all points for each object.")
    return [Landmarks(selection.points, label=selection.name) for selection in used]


def _selection(data: bytes, name: str) -> _Selection | None:
    """Return a selection; None if it has no points."""
    if data[:4] != _MAGIC or len(data) < _HEADER:
        raise LandmarkError(f"'{rd.short(name)}' is no selection of ImageJ, or is cut short: save it again.")
    kind = data[6]
    top, left = struct.unpack(">hh", data[8:12])
    (count,) = struct.unpack(">H", data[16:18])
    (options,) = struct.unpack(">h", data[50:52])
    (plane,) = struct.unpack(">i", data[56:60])
    if kind not in (*_LINES, _POINTS) or count == 0:
        return None
    is_fraction = bool(options & _SUBPIXEL)
    start = _HEADER + (4 * count if is_fraction else 0)
    form: Any = np.dtype(">f4" if is_fraction else ">i2")
    end = start + 2 * count * form.itemsize
    if end > len(data):
        raise LandmarkError(f"'{rd.short(name)}' is cut short: save it again.")
    points = np.frombuffer(data[start:end], form).reshape(2, count).T.astype(np.float64)
    points = points + (-0.5 if is_fraction else np.array([left, top]))
    if not np.isfinite(points).all():
        raise LandmarkError(f"'{rd.short(name)}' has positions that are no numbers: save it again.")
    return _Selection(name.rpartition("/")[2], plane, kind in _LINES, points)
