"""``.asf`` of the AAM-API (IMM face databases): fractions of the image's width and height, y downwards.

x is multiplied by the width and y by the height (not by width - 1), as the AAM-API does. The result is a pixel centre
counted from 0, so (0, 0) is the centre of the top-left pixel. Connectivity (``connects from``, ``connects to``)
becomes contours, and the host image named on the last line is kept.
"""

from dataclasses import replace
from pathlib import Path

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import (
    Landmarks,
    Placing,
    Source,
    chain_edges,
    check_count,
    make_landmarks,
    parse_count,
    parse_number,
)

_N_COLUMNS = 7  # path, type, x, y, point, from, to; further columns are optional


def parse(source: Source) -> Landmarks:
    """Parse the text of an ``.asf`` file into fractions of the image's size."""
    path, lines = source.path, [line for line in source.lines if not line.startswith("#")]
    if not lines:
        raise LandmarkError(f"{path} holds comments only; it may be cut short: export it again.")
    count = parse_count(path, lines[0], "points")
    columns = [line.split() for line in lines[1:]]
    rows = [row for row in columns if len(row) >= _N_COLUMNS]
    check_count(path, "header", count, rows)
    host = lines[-1] if len(columns) > count else None
    return replace(_landmarks(path, rows, host), placing=Placing(fractions=True))


def _landmarks(path: Path, rows: list[list[str]], host: str | None) -> Landmarks:
    points: list[tuple[float, float] | None] = [None] * len(rows)
    edges = []
    for row in rows:
        index, _, target = (_index(path, token, len(rows)) for token in row[4:7])
        where = f"point {index}"
        points[index] = parse_number(path, row[2], where), parse_number(path, row[3], where)
        edges.append((index, target))
    if None in points:
        raise LandmarkError(f"{path} has no point number {points.index(None)}: number the points 0 to {len(rows) - 1}.")
    return make_landmarks(path, points, chain_edges(edges), image_name=host)


def _index(path: Path, token: str, n_points: int) -> int:
    index = parse_count(path, token, "a point")
    if index >= n_points:
        raise LandmarkError(f"{path} names point {index}, but has points 0 to {n_points - 1}: correct the numbers.")
    return index
