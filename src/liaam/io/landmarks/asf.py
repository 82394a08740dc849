"""``.asf`` of the AAM-API (IMM face databases): fractions of the image's width and height, y downwards.

x is multiplied by the width and y by the height (not by width - 1), as the AAM-API does. The result is a pixel centre
counted from 0, so (0, 0) is the centre of the top-left pixel. Connectivity (``connects from``, ``connects to``)
becomes contours, and the host image named on the last line is kept.
"""

from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.contours import chain_edges
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import check_count, parse_count, parse_number

_N_COLUMNS = 7  # path, type, x, y, point, from, to; further columns are optional


def parse(source: Source) -> Landmarks:
    """Parse rows of points into fractions of the image's size."""
    lines = [line for line in source.lines if not line.startswith("#")]
    if not lines:
        raise LandmarkError("it holds comments only; it may be cut short: export it again.")
    count = parse_count(lines[0], "points")
    columns = [line.split() for line in lines[1:]]
    rows = [row for row in columns if len(row) >= _N_COLUMNS]
    check_count("header", count, rows)
    points, edges = {}, []
    for row in rows:
        index, _, target = (_index(token, count) for token in row[4:7])
        points[index] = [parse_number(cell, f"point {index}") for cell in row[2:4]]
        edges.append((index, target))
    lacking = next((i for i in range(count) if i not in points), None)
    if lacking is not None:
        raise LandmarkError(f"there is no point number {lacking}: number the points 0 to {count - 1}.")
    host = lines[-1] if len(columns) > count else None
    ordered: Any = [points[i] for i in range(count)]
    return Landmarks(ordered, chain_edges(edges), image_name=host, placing=Placing(fractions=True))


def _index(token: str, n_points: int) -> int:
    index = parse_count(token, "a point")
    if index >= n_points:
        raise LandmarkError(f"it names point {index}, but has points 0 to {n_points - 1}: correct the numbers.")
    return index
