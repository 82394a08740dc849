"""The landmark template: the points of an object, their names, contours and symmetry."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from liaam.io.landmarks import Contour, Landmarks
from liaam.model.shape import mirror_order
from liaam.studio.safety import Refusal, refusing

LONGEST_NAME = 100
FARTHEST = 1e6
"""Maximum absolute coordinate in pixels."""

_TILT = 45.0
"""Maximum angle between the axis of symmetry and the vertical, in degrees."""
_ALIKE = 0.05
"""Maximum distance between a mirrored point and its twin, as a fraction of the shape's diagonal. It is generous,
because the user sees the result and can correct it."""

_TWINS = {"left": "right", "right": "left", "l": "r", "r": "l"}
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[^A-Za-z]+")


@dataclass(frozen=True)
class Template:
    """The points that are placed on every picture of a project."""

    names: tuple[str, ...]
    """Unique name of each point."""
    contours: tuple[Contour, ...] = ()
    mirror: tuple[int, ...] | None = None
    """Index of each point's twin, its mirror image (itself on the axis); None without symmetry."""
    points: tuple[tuple[float, float], ...] | None = None
    """Typical layout, in any units."""

    def __len__(self) -> int:
        return len(self.names)

    def as_json(self) -> dict[str, Any]:
        """Return the template as JSON for :func:`parse_template`."""
        return {
            "names": list(self.names),
            "contours": [{"indices": list(c.indices), "closed": c.closed} for c in self.contours],
            "mirror": None if self.mirror is None else list(self.mirror),
            "points": None if self.points is None else [list(point) for point in self.points],
        }


def parse_template(data: Any, most: int) -> Template:
    """Parse and check a template from JSON."""
    if not isinstance(data, dict):
        raise Refusal(422, "the template is not an object: send names, contours, mirror and points")
    names = data.get("names")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name.strip() for name in names):
        raise Refusal(422, "the template has no valid list of names: give every point a name")
    names = tuple(name.strip() for name in names)
    if not all(name.isprintable() for name in names):  # such as half of a surrogate pair, which no file can store
        raise Refusal(422, "a point's name has unprintable characters: give it another name")
    if len(names) > most:
        raise Refusal(422, f"the template has {len(names)} points, more than the {most} allowed: remove some")
    if max(map(len, names)) > LONGEST_NAME:
        raise Refusal(422, f"a point's name has more than {LONGEST_NAME} characters: shorten it")
    duplicate = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if duplicate is not None:
        raise Refusal(422, f"two points have the name '{duplicate}': rename one")
    n = len(names)
    points = data.get("points")
    layout = None if points is None else parse_points(points, n)
    if layout is not None and None in layout:
        raise Refusal(422, "the template's layout lacks a point: place all points, or send null for the layout")
    contours = [] if data.get("contours") is None else data["contours"]
    if not isinstance(contours, list) or len(contours) > n:
        raise Refusal(422, f"the template's contours are not valid: send a list of at most {n} contours")
    mirror = None if data.get("mirror") is None else tuple(parse_indices(data["mirror"], n, "mirror"))
    if mirror is not None and (len(mirror) != n or any(mirror[mirror[i]] != i for i in range(n))):
        raise Refusal(422, "mirror does not pair the points: if b is the twin of a, a must be the twin of b")
    return Template(names, tuple(_contour(item, i, n) for i, item in enumerate(contours)), mirror, layout)  # type: ignore[arg-type]


def parse_points(data: Any, n: int) -> tuple[tuple[float, float] | None, ...]:
    """Parse and check ``n`` points from JSON, [x, y] or null each."""
    if not isinstance(data, list) or len(data) != n:
        count = len(data) if isinstance(data, list) else "no"
        raise Refusal(422, f"there are {count} points where the template has {n}: send one [x, y] or null for each")
    return tuple(None if point is None else _pair(point, i) for i, point in enumerate(data))


def parse_indices(data: Any, n: int, what: str) -> list[int]:
    """Check a list of unique point indices from 0 to ``n - 1``."""
    valid = isinstance(data, list) and all(type(index) is int and 0 <= index < n for index in data)
    if not valid or len(set(data)) != len(data):
        raise Refusal(422, f"{what} is not valid: send a list of different whole numbers from 0 to {n - 1}")
    return data


def _pair(point: Any, i: int) -> tuple[float, float]:
    valid = isinstance(point, list) and len(point) == 2 and all(type(value) in (int, float) for value in point)
    if not valid or not all(abs(value) <= FARTHEST for value in point):  # also False for NaN
        raise Refusal(422, f"point {i + 1} is not valid: send [x, y] in pixels, or null if it is not placed")
    return round(float(point[0]), 3), round(float(point[1]), 3)


def _contour(item: Any, i: int, n: int) -> Contour:
    if not isinstance(item, dict) or not isinstance(item.get("closed"), bool):
        raise Refusal(422, f"contour {i + 1} is not valid: send {{indices, closed}}")
    indices = parse_indices(item.get("indices"), n, f"contour {i + 1}")
    if len(indices) < 2:
        raise Refusal(422, f"contour {i + 1} has fewer than 2 points: add one, or remove the contour")
    return Contour(tuple(indices), item["closed"])


def template_of(landmarks: Landmarks) -> Template:
    """Create the template of the landmarks of one picture."""
    n = len(landmarks)
    named = len(set(landmarks.names)) == n and all(name.strip() for name in landmarks.names)
    names = tuple(name[:LONGEST_NAME] for name in landmarks.names) if named else tuple(str(i + 1) for i in range(n))
    complete = not landmarks.missing.any()
    points = tuple((round(x, 3), round(y, 3)) for x, y in landmarks.points.tolist()) if complete else None
    twins = mirror_by_names(names) or (mirror_by_place(landmarks.points) if complete else None)
    return Template(names, landmarks.contours, twins, points)


def mirror_by_names(names: Sequence[str]) -> tuple[int, ...] | None:
    """Pair points by names such as ``left_eye``, ``eye-R`` or ``LeftEye``; None unless all such names pair up."""
    keys = [tuple(word.casefold() for word in _WORD.findall(name)) for name in names]
    index = {key: i for i, key in enumerate(keys)}
    swapped = [tuple(_TWINS.get(word, word) for word in key) for key in keys]
    if len(index) < len(keys) or all(a == b for a, b in zip(keys, swapped, strict=True)):
        return None
    if not all(key in index for key in swapped):
        return None
    return tuple(index[key] for key in swapped)


def mirror_by_place(points: ArrayLike) -> tuple[int, ...] | None:
    """Pair finite points (n, 2) by position, about the best axis within 45 degrees of the vertical, if there is one."""
    points = np.asarray(points, dtype=np.float64)
    if len(points) < 3:
        return None
    twins = mirror_order(points, _ALIKE, _TILT)
    return None if twins is None or (twins == np.arange(len(points))).all() else tuple(twins.tolist())


def landmarks_of(
    template: Template, points: Sequence[Any], invisible: Sequence[int] = (), scale: float | None = None
) -> Landmarks:
    """Return a picture's points as landmarks with the template's names and contours."""
    placed = [(np.nan, np.nan) if point is None else point for point in points]
    with refusing():
        return Landmarks(np.array(placed), template.contours, template.names, None, tuple(invisible), scale)
