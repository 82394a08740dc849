"""DeepLabCut's tables (``.csv``): pixel centres counted from 0, x to the right and y downwards.

Rows ``scorer``, perhaps ``individuals``, ``bodyparts`` and ``coords`` come first. Of several scorers the first is read.
Individuals are the objects of an image. Likelihoods are not used.
"""

import math
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import MISSING, Source
from liaam.io.landmarks.tables import Row, check_widths, rows_of
from liaam.io.landmarks.text import parse_number

_HEADERS = ("scorer", "individuals", "bodyparts", "coords")


def is_it(source: Source) -> bool:
    """Whether the first cell says ``scorer``."""
    rows = rows_of(source)
    return bool(rows) and rows[0][1][:1] == ["scorer"]


def parse(source: Source) -> list[Landmarks]:
    """Parse a row of landmarks for each image."""
    rows = [row for row in rows_of(source) if any(row[1])]
    headers = {row[0]: row for _, row in rows[:4] if row[0] in _HEADERS}
    if not {"scorer", "bodyparts", "coords"} <= headers.keys():
        raise LandmarkError("it lacks rows of DeepLabCut's table (scorer, bodyparts, coords): export it again.")
    rows = rows[len(headers) :]
    check_widths(headers["coords"], [*((0, header) for header in headers.values()), *rows])
    coords = headers["coords"]
    first = next((i for i, cell in enumerate(coords) if cell in ("x", "y")), len(coords))
    scorers = list(dict.fromkeys(headers["scorer"][first:]))
    if len(scorers) > 1:
        source.notes.say(f"of several scorers '{scorers[0]}' is read", source.path.name)
    columns: dict[str, dict[str, dict[str, int]]] = {}  # by individual, body part and axis
    for i in range(first, len(coords)):
        if headers["scorer"][i] == scorers[0] and coords[i] in ("x", "y"):
            individual = headers["individuals"][i] if "individuals" in headers else ""
            columns.setdefault(individual, {}).setdefault(headers["bodyparts"][i], {})[coords[i]] = i

    def make(made_of: tuple[Row, str]) -> Landmarks:
        (number, row), individual = made_of
        parts = columns[individual]
        points: Any = [[parse_number(row[axes[axis]], f"line {number}") for axis in "xy"] for axes in parts.values()]
        points = [MISSING if math.isnan(x + y) else (x, y) for x, y in points]
        image = "/".join(cell for cell in row[:first] if cell)
        return Landmarks(points, names=tuple(parts), image_name=image, label=individual)

    records = ((f"line {row[0]}", (row, individual)) for row in rows for individual in columns)
    return [own for own in source.each(records, make) if not own.missing.all()]
