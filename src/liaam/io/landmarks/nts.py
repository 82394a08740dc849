"""NTSYS matrices (``.nts``): as ``.tps``, pixel centres counted from 0, y upwards from the bottom row.

A row is a specimen, x y of each landmark. The header has the number of rows and columns, an L (or B, E) behind the
number of rows if these are named, whether values are missing and by which number, and ``DIM=2``. A matrix of two
columns holds the landmarks of one image.
"""

import math
import re

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import parse_number

_HEADER = re.compile(
    r"1\s+(?P<rows>\d{1,9})(?P<named>[lbe]?)\s+(?P<columns>\d{1,9})(?P<columns_named>l?)"
    r"(?:\s+(?P<missing>[01])(?:\s+(?P<value>-?(?:\d+(?:\.\d*)?|\.\d+)))?)?(?:\s+dim\s*=\s*(?P<dim>\d))?\s*",
    re.IGNORECASE,
)


_UPWARDS = Placing(upwards=True)


def parse(source: Source) -> Landmarks | list[Landmarks]:
    """Parse a matrix. y counts upwards."""
    lines = [line for line in source.lines if not line.startswith(('"', "'"))]
    header = _HEADER.fullmatch(" ".join(lines[0].split())) if lines else None
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
        return Landmarks(numbers.reshape(-1, 2), placing=_UPWARDS)
    rows = zip(names, numbers.reshape(n, -1, 2), strict=True)

    def make(row: tuple[str, np.ndarray]) -> Landmarks:
        return Landmarks(row[1], image_name=row[0], placing=_UPWARDS)

    return list(source.each(((name, (name, points)) for name, points in rows), make))


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
