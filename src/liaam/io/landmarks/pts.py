"""300-W ``.pts``: pixel centres counted from 1, so that (1, 1) is the centre of the top-left pixel.

Reading subtracts one and writing adds one. A missing landmark is written ``nan nan``. The format does not store
contours or names.
"""

import re

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks, Source, check_count, make_landmarks, parse_count, parse_pair

_COUNT = re.compile(r"n_?points\s*(?:[:=]\s*)?(\S+)", re.IGNORECASE)  # \s*[:=]?\s* would backtrack
_COMMENT = re.compile(r"(#|//|%).*")


def parse(source: Source) -> Landmarks:
    """Parse the text of a ``.pts`` file: a header, then one ``x y`` per line between braces."""
    path, text = source.path, "\n".join(_COMMENT.sub("", line) for line in source.text.splitlines())
    header, brace, rest = text.partition("{")
    if not brace:
        raise LandmarkError(f"{path} has no '{{' before its points, so it is not a 300-W .pts file: export it again.")
    body, brace, _ = rest.partition("}")
    lines = [line for line in body.splitlines() if line.strip()]
    count = _COUNT.search(header)
    if count is not None:
        check_count(path, "header", parse_count(path, count[1], "points"), lines)
    if not brace:
        raise LandmarkError(f"{path} has no '}}' after its points; it may be cut short: export it again.")
    pairs = [parse_pair(path, line, f"point {number}") for number, line in enumerate(lines, 1)]
    return make_landmarks(path, [(x - 1, y - 1) for x, y in pairs])


def dump(landmarks: Landmarks) -> str:
    """Return the text of a ``.pts`` file."""
    lines = [f"{x + 1!r} {y + 1!r}" for x, y in landmarks.points.tolist()]
    return "\n".join(["version: 1", f"n_points: {len(lines)}", "{", *lines, "}", ""])
