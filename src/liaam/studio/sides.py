"""Which side of its object a picture shows, such as a left or a right wing: as a person says, or as far as it is known.

What a person says of a picture counts first, then the column ``side`` of its landmark file. Folders or names count if
they say it of all pictures. If only some are known, the others are found by their shapes.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from liaam.datasets.sides import sides_of_shapes
from liaam.io.sides import LEFT, OTHER_SIDE, RIGHT, sides_by_place_or_name
from liaam.studio.refusal import Refusal

SIDES = (LEFT, RIGHT)


def completed(stated: Sequence[str], names: Sequence[str], shapes: np.ndarray) -> list[str]:
    """Return the side of each picture.

    Parameters
    ----------
    stated : sequence of str
        ``left``, ``right``, or empty where it is not stated. If a table has other words, all are returned as they are.
    names : sequence of str
        Names of the pictures in the folder, without their suffixes.
    shapes : (m, n, 2) float
        Their landmarks, NaN where missing.

    Returns
    -------
    list of str
        Empty for all pictures if no side is known, or if some are and the shapes do not show those of the others.
    """
    if not {*stated} <= {"", *SIDES}:
        return [*stated]
    by_name = sides_by_place_or_name(names)
    sides = [said or named for said, named in zip(stated, by_name, strict=True)]
    if all(sides) or not any(sides):
        return sides
    found = sides_of_shapes(shapes, [""] * len(sides), names)
    # Of each known picture, the side that the larger of the two groups of shapes has by it.
    votes = [
        OTHER_SIDE[side] if is_other else side
        for side, is_other in zip(sides, found.is_other.tolist(), strict=True)
        if side
    ]
    if found.sides is None and len({*votes}) > 1:
        return [""] * len(sides)
    own = max(SIDES, key=votes.count)
    return [
        side or (OTHER_SIDE[own] if is_other else own)
        for side, is_other in zip(sides, found.is_other.tolist(), strict=True)
    ]


def for_measuring(stated: Sequence[str], names: Sequence[str], shapes: np.ndarray) -> list[str]:
    """Return the side of each picture as :func:`completed` does, and ``original`` or ``mirrored`` if none is known.

    Which are mirrored then follows from the shapes, as in training, even if they are few.
    """
    sides = completed(stated, names, shapes)
    found = sides_of_shapes(shapes, sides, names) if not any(sides) else None
    if found is None or found.sides is None:
        return sides
    return [found.sides.of(is_other) for is_other in found.is_other.tolist()]


def parse_sides(data: Any) -> dict[str, str]:
    """Check the sides in a request, by picture: ``left``, ``right``, or empty to withdraw what was said."""
    if not isinstance(data, dict) or not data or not all(side in ("", *SIDES) for side in data.values()):
        raise Refusal(422, "the sides are not valid: send left, right or nothing for each picture, by name")
    return data
