"""WebMorph / Psychomorph ``.tem``: pixels of the template's image from its top-left, y downwards.

The numbers are taken as pixel centres counted from 0, without a shift. Neither program documents whether its origin is
the centre or the corner of the first pixel, and landmarks are placed by hand to about a pixel. Line templates become
contours: a count, then for each line 0 (open) or 1 (closed), the number of points and their indices from 0. A line
that ends at its first point is closed, and a line with only one distinct point is dropped. Numbers that some versions
write after the lines are ignored.
"""

from collections.abc import Iterator
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.contours import Contour, contour_of
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import check_count, parse_count, parse_pair


def parse(source: Source) -> Landmarks:
    """Parse points; the line templates after them are optional."""
    count = parse_count(source.lines[0], "points")
    pairs = source.lines[1 : count + 1]
    check_count("first line", count, pairs)
    points: Any = [parse_pair(line, f"point {number}") for number, line in enumerate(pairs, 1)]
    contours = _contours(" ".join(source.lines[count + 1 :]).split())
    return Landmarks(points, tuple(contour for contour in contours if contour is not None))


def _contours(tokens: list[str]) -> list[Contour | None]:
    stream = iter(tokens)
    contours = []
    for _ in range(_next(stream) if tokens else 0):
        closed = _next(stream) == 1
        indices = [_next(stream) for _ in range(_next(stream))]
        contours.append(contour_of(indices, closed))
    return contours


def _next(stream: Iterator[str]) -> int:
    token = next(stream, None)
    if token is None:
        raise LandmarkError("it ends within its line templates; it may be cut short: export it again.")
    return parse_count(token, "a line template")
