"""Lines of ``x y`` or ``name x y`` (``.txt``, one file an image), as of patternize.

Pixel centres counted from 0, x to the right and y downwards. HELEN's begin with the image's name.
A first line with the number of points is skipped.
"""

import operator
import re
from typing import Any

from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import decimal, parse_point

_NUMBER = r"(?:[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan|na)"
_LINE = re.compile(
    rf"(?:\"?(?P<name>[^\"\t,;]*?[^\"\s,;])\"?[\s,;]+)?(?P<x>{_NUMBER})[\s,;]+(?P<y>{_NUMBER})", re.IGNORECASE
)
_FEWEST, _LONGEST = 2, 300


def is_it(source: Source) -> bool:
    """Whether all lines, perhaps but the first, are of this form, and all or none have names."""
    return bool(_matches(source))


def _matches(source: Source) -> list[re.Match[str]]:
    if len(max(source.lines, key=len)) > _LONGEST:
        return []
    lines = [_with_points(line) for line in (source.lines[1:] if _first(source) else source.lines)]
    found = [match for match in map(_LINE.fullmatch, lines) if match is not None]
    alike = len({match["name"] is None for match in found}) == 1
    return found if alike and len(found) == len(lines) >= _FEWEST else []


def _with_points(line: str) -> str:
    """Replace decimal commas, if x and y both have one."""
    cells = re.split(r"([\t;]|\s+)", line)
    made = [decimal(cell) for cell in cells]
    return "".join(made if sum(map(operator.ne, made, cells)) == 2 else cells)


def _first(source: Source) -> str:
    """Return the first line if it is one word: an image's name, or a number of points."""
    return source.lines[0] if len(source.lines[0].split()) == 1 and not _LINE.fullmatch(source.lines[0]) else ""


def parse(source: Source) -> Landmarks:
    """Parse the lines."""
    matches, first = _matches(source), _first(source)
    points: Any = [parse_point(match.group("x", "y"), match[0]) for match in matches]
    names = [match["name"] for match in matches if match["name"]]
    names = [] if names == [str(i + 1) for i in range(len(names))] else names
    return Landmarks(points, (), tuple(names), None if first.isdigit() else first or None)
