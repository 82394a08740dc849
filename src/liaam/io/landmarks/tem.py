"""WebMorph / Psychomorph ``.tem``: pixels of the template's image from its top-left, y downwards.

The numbers are taken as pixel centres counted from 0, without a shift. Neither program documents whether its origin is
the centre or the corner of the first pixel, and landmarks are placed by hand to about a pixel. Line templates become
contours: a count, then for each line 0 (open) or 1 (closed), the number of points and their indices from 0. A line
that ends at its first point is closed, and a line with only one distinct point is dropped.
"""

from collections.abc import Iterator
from pathlib import Path

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import (
    Contour,
    Landmarks,
    Source,
    check_count,
    contour_of,
    make_landmarks,
    parse_count,
    parse_pair,
)


def parse(source: Source) -> Landmarks:
    """Parse the text of a ``.tem`` file; the line templates after the points are optional."""
    path, lines = source.path, source.lines
    count = parse_count(path, lines[0], "points")
    pairs = lines[1 : count + 1]
    check_count(path, "first line", count, pairs)
    points = [parse_pair(path, line, f"point {number}") for number, line in enumerate(pairs, 1)]
    contours = _contours(path, " ".join(lines[count + 1 :]).split())
    return make_landmarks(path, points, contours)


def _contours(path: Path, tokens: list[str]) -> list[Contour]:
    if not tokens:
        return []
    stream = iter(tokens)
    contours = []
    for _ in range(_next(path, stream)):
        closed = _next(path, stream) == 1
        indices = [_next(path, stream) for _ in range(_next(path, stream))]
        contours.append(contour_of(indices, closed))
    left = sum(1 for _ in stream)
    if left:
        raise LandmarkError(f"{path} goes on for {left} values after its last line template: export it again.")
    return [contour for contour in contours if contour is not None]


def _next(path: Path, stream: Iterator[str]) -> int:
    token = next(stream, None)
    if token is None:
        raise LandmarkError(f"{path} ends within its line templates; it may be cut short: export it again.")
    return parse_count(path, token, "a line template")
