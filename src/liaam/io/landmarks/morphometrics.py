"""Files of morphometrics, ``.tps`` and ``.nts``: pixel centres counted from 0, y **upwards from the bottom** row."""

import math
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import is_number
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.contours import Contour
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import decimal, parse_number, parse_pair, short

_UPWARDS = Placing(upwards=True)
_KEY = re.compile(r"([A-Za-z]\w*)\s*=\s*(.*)")
_MATRIX = re.compile(
    r"1\s+(?P<rows>\d{1,9})(?P<named>[lbe]?)\s+(?P<columns>\d{1,9})(?P<columns_named>l?)"
    r"(?:\s+(?P<missing>[01])(?:\s+(?P<value>-?(?:\d+(?:\.\d*)?|\.\d+)))?)?(?:\s+dim\s*=\s*(?P<dim>\d))?\s*",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class _Block:
    """A line ``KEY=VALUE``, with the lines up to the next."""

    where: str
    key: str
    value: str
    body: list[tuple[int, str]] = field(default_factory=list)


def parse_tps(source: Source) -> list[Landmarks]:
    """Parse the records of tpsDig and geomorph.

    A record starts with ``LM=`` and its points; ``IMAGE=`` names the image, or else ``ID=`` without its extension.
    ``SCALE=`` is the length of a pixel. The points of ``CURVES=`` follow the landmarks, and each curve becomes a
    contour. Outlines, radii, variables and comments are skipped. A missing landmark is ``NA NA`` (geomorph),
    ``NaN NaN``, or ``-1 -1`` (tpsDig). Records without points, of images not digitised yet, are skipped.
    """
    records: list[list[_Block]] = []
    for block in _blocks(source):
        if block.key in ("LM", "LM3"):
            records.append([])
        if not records:
            raise LandmarkError(f"{block.where} comes before any LM=: export the file again.")
        records[-1].append(block)
    if not records:
        raise LandmarkError(f"'{short(source.lines[0])}' is not expected here, before any LM=: export the file again.")
    named = ((_facts(record).get("IMAGE") or _facts(record).get("ID") or record[0].where, record) for record in records)
    return [own for own in source.each(named, lambda record: _specimen(source, record, len(records) == 1)) if own]


def _blocks(source: Source) -> list[_Block]:
    blocks: list[_Block] = []
    for number, line in enumerate(map(str.strip, source.text.splitlines()), 1):
        match = _KEY.fullmatch(line)
        if match is not None:
            blocks.append(_Block(f"line {number} ('{short(line)}')", match[1].upper(), match[2]))
        elif line and blocks:
            blocks[-1].body.append((number, line))
    return blocks


def _facts(record: list[_Block]) -> dict[str, str]:
    return {block.key: block.value for block in record if block.value or block.key == "SCALE"}


def _specimen(source: Source, record: list[_Block], only: bool) -> Landmarks | None:
    """Make the landmarks of a record; None if it has no points."""
    facts, curves, section = _facts(record), [], ""
    points: Any = _points(record[0])
    for block in record[1:]:
        section = block.key if block.key in ("CURVES", "OUTLINES") else section
        own = _points(block) if block.key == "POINTS" else []
        if own and section == "CURVES":  # those of outlines are not used
            curves.append(Contour(tuple(range(len(points), len(points) + len(own)))))
            points = points + own
    if not points:
        return None
    name = facts.get("IMAGE") or facts.get("ID")
    if name is None and not only:
        raise LandmarkError(f"the record of {record[0].where} names no image: add a line IMAGE=, or ID=.")
    written = decimal(facts.get("SCALE", ""))
    scale = float(written) if is_number(written) else 0.0
    if scale <= 0 and "SCALE" in facts:
        source.notes.repair("there is no scale, because SCALE= is not a positive number", name or source.path.name)
    label, length = facts.get("ID", ""), scale if scale > 0 else None
    return Landmarks(points, tuple(curves), image_name=name, scale=length, label=label, placing=_UPWARDS)


def _points(block: _Block) -> list[tuple[float, float]]:
    """Return as many points as a line promises."""
    if block.key == "LM3":
        raise LandmarkError(f"{block.where} begins points with x, y and z: export x and y only, as LM=.")
    if not (block.value.isascii() and block.value.isdigit()):
        raise LandmarkError(f"{block.where} has no number of points after '=': correct it, such as LM=12.")
    count, n = float(block.value), len(block.body)  # int has a limit of digits
    if n > count:
        number, line = block.body[int(count)]
        where = f"line {number} ('{short(line)}')"
        raise LandmarkError(f"{where} is not expected here: correct the number of points above it, or remove it.")
    points = [parse_pair(line, f"line {number}") for number, line in block.body]
    if n < count:
        promised = f"{short(block.value)} points but {n} follow; the file may be cut short"
        raise LandmarkError(f"{block.where} promises {promised}: correct the number, or export the file again.")
    return points


def parse_nts(source: Source) -> list[Landmarks]:
    """Parse a matrix of NTSYS, a row of x y of each landmark for a specimen.

    The header has the number of rows and columns, an L (or B, E) behind the number of rows if these are named, whether
    values are missing and by which number, and ``DIM=2``. A matrix of two columns holds the landmarks of one image.
    """
    lines = [line for line in source.lines if not line.startswith(('"', "'"))]
    header = _MATRIX.fullmatch(" ".join(lines[0].split())) if lines else None
    if header is None:
        raise LandmarkError("there is no header of a matrix, such as '1 10L 16 0 DIM=2': export it again.")
    n, width, dim = int(header["rows"]), int(header["columns"]), int(header["dim"] or 2)
    if dim != 2 or width % 2:
        raise LandmarkError(f"it holds {width} columns of {dim} dimensions: export x and y only.")
    words = " ".join(lines[1:]).split()
    names, values = _labels_and_values(header, words, n, width) if n <= len(words) else ([], words)
    if len(values) != n * width or not values:
        raise LandmarkError(f"{n} x {width} numbers are promised but {len(values)} are there: export it again.")
    numbers = np.array([parse_number(value, "a row") for value in values])
    if header["missing"] == "1" and header["value"]:
        numbers[numbers == float(header["value"])] = math.nan
    if width == 2:
        return [Landmarks(numbers.reshape(-1, 2), placing=_UPWARDS)]
    rows = zip(names, numbers.reshape(n, -1, 2), strict=True)
    named = ((name, (name, points)) for name, points in rows)
    return list(source.each(named, lambda row: Landmarks(row[1], image_name=row[0], placing=_UPWARDS)))


def _labels_and_values(header: re.Match[str], words: list[str], n: int, width: int) -> tuple[list[str], list[str]]:
    """Separate the names of rows, or their numbers, from the values."""
    kind = header["named"].lower()
    names = [str(i + 1) for i in range(n)]
    if kind == "l":
        names, words = words[:n], words[n:]
    words = words[width:] if header["columns_named"] else words
    if kind in ("b", "e") and len(words) == n * (width + 1):
        at = 0 if kind == "b" else width
        names = words[at :: width + 1]
        words = [word for i, word in enumerate(words) if i % (width + 1) != at]
    return (names if len(names) == n else [str(i + 1) for i in range(n)]), words
