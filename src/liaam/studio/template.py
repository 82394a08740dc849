"""The landmark template: which points an object has, what they are called, how they are joined and mirrored."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks import Contour, Landmarks
from liaam.model.shape import mirror_order
from liaam.studio.safety import Refusal

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

LONGEST_NAME = 100
FARTHEST = 1e6
"""Coordinates beyond it are no pixels."""

_TILT = 45.0
"""Degrees from the vertical up to which the axis of symmetry is looked for."""
_ALIKE = 0.05
"""Distance of mirrored points from their twins that counts as symmetric, share of the shape's diagonal: a person sees
what is proposed, and can mend it."""

_TWINS = {"left": "right", "right": "left", "l": "r", "r": "l"}
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[^A-Za-z]+")


@dataclass(frozen=True)
class Template:
    """What all pictures of a project have landmarks of."""

    names: tuple[str, ...]
    """One for each point, each once."""
    contours: tuple[Contour, ...] = ()
    mirror: tuple[int, ...] | None = None
    """Twin of each point on the other side, itself on the axis; None where there is no symmetry."""
    points: tuple[tuple[float, float], ...] | None = None
    """A layout to show, in any units."""

    def __len__(self) -> int:
        return len(self.names)

    def as_json(self) -> dict[str, Any]:
        """Give what :func:`parse_template` reads."""
        return {
            "names": list(self.names),
            "contours": [{"indices": list(c.indices), "closed": c.closed} for c in self.contours],
            "mirror": None if self.mirror is None else list(self.mirror),
            "points": None if self.points is None else [list(point) for point in self.points],
        }


def parse_template(data: Any, most: int) -> Template:
    """Check a template that came as JSON.

    Raises
    ------
    Refusal
        422, with what is wrong.
    """
    if not isinstance(data, dict):
        raise Refusal(422, "the template is no object with names, contours, mirror and points")
    names = data.get("names")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name.strip() for name in names):
        raise Refusal(422, "the template has no list of names: give each point one that is not empty")
    names = tuple(name.strip() for name in names)
    if not all(name.isprintable() for name in names):  # such as half of a surrogate pair, which no file can hold
        raise Refusal(422, "a point's name holds characters that cannot be shown: give it another")
    if len(names) > most:
        raise Refusal(422, f"the template has {len(names)} points, more than the {most} allowed: leave some out")
    if max(map(len, names)) > LONGEST_NAME:
        raise Refusal(422, f"a point's name has more than {LONGEST_NAME} characters: give it a shorter one")
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise Refusal(422, f"two points are called '{twice}': give each its own name")
    n = len(names)
    points = data.get("points")
    layout = None if points is None else parse_points(points, n)
    if layout is not None and None in layout:
        raise Refusal(422, "the template's layout lacks a point: place all, or send null for the layout")
    return Template(names, _contours(data.get("contours"), n), _mirror(data.get("mirror"), n), layout)  # type: ignore[arg-type]


def parse_points(data: Any, n: int) -> tuple[tuple[float, float] | None, ...]:
    """Check points that came as JSON, [x, y] or null each.

    Raises
    ------
    Refusal
        422, with the point that is wrong.
    """
    if not isinstance(data, list) or len(data) != n:
        count = len(data) if isinstance(data, list) else "no"
        raise Refusal(422, f"there are {count} points where the template has {n}: send one [x, y] or null for each")
    return tuple(None if point is None else _pair(point, i) for i, point in enumerate(data))


def parse_indices(data: Any, n: int, what: str) -> list[int]:
    """Check a list of points' numbers, counted from 0.

    Raises
    ------
    Refusal
        422, with what is wrong.
    """
    sound = isinstance(data, list) and all(type(index) is int and 0 <= index < n for index in data)
    if not sound or len(set(data)) != len(data):
        raise Refusal(422, f"{what}: give a list of different whole numbers from 0 to {n - 1}")
    return data


def _pair(point: Any, i: int) -> tuple[float, float]:
    sound = isinstance(point, list) and len(point) == 2 and all(type(value) in (int, float) for value in point)
    if not sound or not all(abs(value) <= FARTHEST for value in point):  # NaN, too, fails this
        raise Refusal(422, f"point {i + 1} is not [x, y] in pixels, or null for a point that is not placed")
    return round(float(point[0]), 3), round(float(point[1]), 3)


def _contours(data: Any, n: int) -> tuple[Contour, ...]:
    if data is None:
        return ()
    if not isinstance(data, list) or len(data) > n:
        raise Refusal(422, f"the template's contours are no list of at most {n} lines")
    return tuple(_contour(item, i, n) for i, item in enumerate(data))


def _contour(item: Any, i: int, n: int) -> Contour:
    if not isinstance(item, dict) or not isinstance(item.get("closed"), bool):
        raise Refusal(422, f"contour {i + 1} is not {{indices, closed}}")
    indices = parse_indices(item.get("indices"), n, f"contour {i + 1}")
    if len(indices) < 2:
        raise Refusal(422, f"contour {i + 1} has fewer than 2 points: add one, or leave the contour out")
    return Contour(tuple(indices), item["closed"])


def _mirror(data: Any, n: int) -> tuple[int, ...] | None:
    if data is None:
        return None
    twins = parse_indices(data, n, "mirror")
    if len(twins) != n or any(twins[twins[i]] != i for i in range(n)):
        raise Refusal(422, "mirror does not pair the points: each point's twin must have that point for its own")
    return tuple(twins)


# From landmarks -----------------------------------------------------------------------------------


def template_of(landmarks: Landmarks) -> Template:
    """Make the template that landmarks of one picture follow."""
    n = len(landmarks)
    named = len(set(landmarks.names)) == n and all(name.strip() for name in landmarks.names)
    names = tuple(name[:LONGEST_NAME] for name in landmarks.names) if named else tuple(str(i + 1) for i in range(n))
    complete = not landmarks.missing.any()
    points = tuple((round(x, 3), round(y, 3)) for x, y in landmarks.points.tolist()) if complete else None
    twins = mirror_by_names(names) or (mirror_by_place(landmarks.points) if complete else None)
    return Template(names, landmarks.contours, twins, points)


def mirror_by_names(names: Sequence[str]) -> tuple[int, ...] | None:
    """Pair points by names such as ``left_eye``, ``eye-R`` or ``LeftEye``; None unless all that have a side pair up."""
    keys = [tuple(word.casefold() for word in _WORD.findall(name)) for name in names]
    index = {key: i for i, key in enumerate(keys)}
    swapped = [tuple(_TWINS.get(word, word) for word in key) for key in keys]
    if len(index) < len(keys) or all(a == b for a, b in zip(keys, swapped, strict=True)):
        return None
    if not all(key in index for key in swapped):
        return None
    return tuple(index[key] for key in swapped)


def mirror_by_place(points: ArrayLike) -> tuple[int, ...] | None:
    """Pair points by their places, about the axis within 45 degrees of the vertical that suits best; None if none does.

    Parameters
    ----------
    points : (n, 2) float
        Without NaN.
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) < 3:
        return None
    twins = mirror_order(points, _ALIKE, _TILT)
    return None if twins is None or (twins == np.arange(len(points))).all() else tuple(twins.tolist())


def landmarks_of(
    template: Template, points: Sequence[Sequence[float] | None], invisible: Sequence[int] = ()
) -> Landmarks:
    """Give a picture's points the template's names and contours."""
    placed = [(np.nan, np.nan) if point is None else point for point in points]
    try:
        return Landmarks(np.array(placed), template.contours, template.names, None, tuple(invisible))
    except LandmarkError as fault:
        raise Refusal(422, str(fault)) from fault
