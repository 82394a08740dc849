"""300-W ``.pts``: pixel centres counted from 1, so that (1, 1) is the centre of the top-left pixel.

Reading subtracts one and writing adds one. A missing landmark is written ``nan nan``. The format does not store
contours or names.
"""

import re
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import check_count, parse_count, parse_pair

_COUNT = re.compile(r"n_?points\s*(?:[:=]\s*)?(\S+)", re.IGNORECASE)  # \s*[:=]?\s* would backtrack
_COMMENT = re.compile(r"(#|//|%).*")


def parse(source: Source) -> Landmarks:
    """Parse a header, then one ``x y`` per line between braces."""
    text = "\n".join(_COMMENT.sub("", line) for line in source.text.splitlines())
    header, brace, rest = text.partition("{")
    if not brace:
        raise LandmarkError("there is no '{' before its points, so it is not a 300-W .pts file: export it again.")
    body, brace, _ = rest.partition("}")
    lines = [line for line in body.splitlines() if line.strip()]
    count = _COUNT.search(header)
    if count is not None:
        check_count("header", parse_count(count[1], "points"), lines)
    if not brace:
        raise LandmarkError("there is no '}' after its points; it may be cut short: export it again.")
    pairs = [parse_pair(line, f"point {number}") for number, line in enumerate(lines, 1)]
    points: Any = [(x - 1, y - 1) for x, y in pairs]
    return Landmarks(points)
