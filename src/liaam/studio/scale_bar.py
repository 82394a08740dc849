"""Scale bars: two positions in a picture, such as along a ruler, and the length between them.

They give the length of a pixel in millimetres, the scale of a picture's landmarks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from liaam.studio.safety import Refusal
from liaam.studio.template import parse_points

UNITS = {"µm": 0.001, "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
"""Units of length, in millimetres."""

LONGEST = 1e9


def parse_bar(data: Any) -> dict[str, Any] | None:
    """Parse and check a scale bar from JSON: ``ends``, ``length`` and ``unit``, or null."""
    if data is None:
        return None
    if not isinstance(data, dict) or data.get("unit") not in UNITS:
        raise Refusal(422, f"the scale bar is not valid: send ends, length and unit, one of {', '.join(UNITS)}")
    ends, length = parse_points(data.get("ends"), 2), data.get("length")
    if isinstance(length, bool) or not isinstance(length, int | float) or not 0 < length < LONGEST:
        raise Refusal(422, "the length of the scale bar is not valid: enter a positive number")
    if ends[0] is None or ends[1] is None or math.dist(ends[0], ends[1]) < 1:
        raise Refusal(422, "the ends of the scale bar are less than a pixel apart: draw it longer")
    return {"ends": [list(ends[0]), list(ends[1])], "length": length, "unit": data["unit"]}


def pixel_length(bar: Mapping[str, Any]) -> float:
    """Return the length of a pixel in millimetres."""
    return bar["length"] * UNITS[bar["unit"]] / math.dist(*bar["ends"])
