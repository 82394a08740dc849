"""Functions of landmarks, each with its exact derivative, and their short names such as ``distance:1-5``.

A function takes points (k, 2) and returns its value and its gradient (k, 2). The derivatives carry the covariances of
the landmarks to standard errors (delta method).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from liaam.errors import LiaamError
from liaam.model.shape import align
from liaam.scale.lengths import UNITS, Length, parse_length, unit_of, with_points

_TWO_NUMBERS = re.compile(r"[1-9]\d*,\d+")  # of landmarks, perhaps, whose distance was forgotten

Measured = tuple[float, np.ndarray]
"""A value, and its gradient (k, 2) by the points."""


def distance(points: np.ndarray) -> Measured:
    """Distance of two points, in pixels."""
    step = points[1] - points[0]
    length = math.hypot(*step)
    return length, np.array([-step, step]) / length


def angle(points: np.ndarray) -> Measured:
    """Angle at the second of three points, 0 to 180 degrees."""
    first = points[0] - points[1]
    last = points[2] - points[1]
    cross = first[0] * last[1] - first[1] * last[0]
    # How the directions of the arms change, in radians, when their ends move.
    turn_of_first = np.array([-first[1], first[0]]) / (first @ first)
    turn_of_last = np.array([-last[1], last[0]]) / (last @ last)
    by_points = np.array([-turn_of_first, turn_of_first - turn_of_last, turn_of_last])
    gradient = math.copysign(180 / math.pi, cross) * by_points
    return math.degrees(math.atan2(abs(cross), first @ last)), gradient


def area(points: np.ndarray) -> Measured:
    """Area of the polygon through the points, in square pixels."""
    after = np.roll(points, -1, axis=0)
    before = np.roll(points, 1, axis=0)
    chord = 0.5 * (after - before)
    signed = 0.5 * float(np.sum(points[:, 0] * after[:, 1] - after[:, 0] * points[:, 1]))
    return abs(signed), math.copysign(1, signed) * np.stack([chord[:, 1], -chord[:, 0]], axis=1)


def length(points: np.ndarray) -> Measured:
    """Length of the line through the points, in pixels."""
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    directions = steps / lengths[:, None]
    gradient = np.zeros_like(points, np.float64)
    gradient[:-1] -= directions
    gradient[1:] += directions
    return float(lengths.sum()), gradient


def centroid_size(points: np.ndarray) -> Measured:
    """Root of the sum of squared distances from the centroid, in pixels."""
    centred = points - points.mean(axis=0)
    size = float(np.linalg.norm(centred))
    return size, centred / size


def procrustes(points: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Procrustes coordinates (k, 2): centred, of centroid size 1, and rotated to a mean shape (k, 2), taken as fixed.

    Also return their derivative (2 k, 2 k) by the points, flattened as x0, y0, x1, ...
    """
    n = len(points)
    turn = align(points, mean).matrix
    turn = turn / math.hypot(*turn[:, 0])
    size, gradient = centroid_size(points)
    shape = gradient @ turn.T
    turned = np.stack([-shape[:, 1], shape[:, 0]], axis=1).ravel()  # derivative of the shape by its rotation
    # Derivative of the shape, times its size, at a fixed rotation: centring, and division by the size.
    aligned = np.kron(np.eye(n) - 1 / n, turn) - np.outer(shape, gradient)
    # The rotation keeps sum(mean x shape) at zero.
    torque = np.stack([-mean[:, 1], mean[:, 0]], axis=1).ravel()
    return shape, (aligned - np.outer(turned, torque @ aligned) / (torque @ turned)) / size


@dataclass(frozen=True)
class _Kind:
    """A kind of measure."""

    function: Callable[[np.ndarray], Measured]
    fewest: int  # landmarks
    most: int
    power: int  # of the length in its unit


_KINDS = {
    "distance": _Kind(distance, fewest=2, most=2, power=1),
    "angle": _Kind(angle, fewest=3, most=3, power=0),
    "area": _Kind(area, fewest=3, most=1000, power=2),
    "length": _Kind(length, fewest=2, most=1000, power=1),
}

_REMEDY = (
    "give distance:1-5, angle:1-2-3 (at landmark 2), area:1-2-3-4 or length:1-2-3-4 (of the line through them), with "
    "landmarks counted from 1, or with their names; a name may come first, as in 'wing length=distance:1-5'"
)

LONGEST_NAME = 60
"""Characters of the name of a measure."""

_OTHER_COLUMNS = re.compile(
    r"specimen|image|individual|status|side|group|estimated|scale|scale_.*|centroid_size.*|distance_from_mean|"
    r"[xy]\d+|pc\d+|.*_se",
    re.IGNORECASE,
)
"""Columns of tables of measurements that are no measures of a person's."""


@dataclass(frozen=True)
class Measure:
    """A distance, an angle, an area, or the length of a line.

    Attributes
    ----------
    kind : {"distance", "angle", "area", "length"}
    landmarks : tuple of str
        Landmarks by number, counted from 1, or by name.
    name : str
        What a person calls it, such as ``wing length``; empty if nothing. Its column has this name.

    Raises
    ------
    LiaamError
        If the name has no letter or is that of another column.
    """

    kind: str
    landmarks: tuple[str, ...]
    name: str = ""

    def __post_init__(self) -> None:
        if self.name:
            _check_name(self.name)

    @classmethod
    def parse(cls, text: str) -> Measure:
        """Parse ``distance:1-5``, ``angle:1-2-3``, ``area:1-2-3-4`` or ``length:1-2-3-4``.

        Commas separate names that contain hyphens. A name of the measure may come first: ``wing length=distance:1-5``.

        Raises
        ------
        LiaamError
            If the kind is unknown or the number of landmarks does not suit it.
        """
        called, _, rest = text.partition(":")
        name, _, kind = map(str.strip, called.rpartition("="))
        landmarks = _split(rest)
        if kind not in _KINDS or not all(landmarks):
            raise LiaamError(f"measure '{text}': {_REMEDY}")
        measure = cls(kind, landmarks, name)
        fewest = _KINDS[kind].fewest
        most = _KINDS[kind].most
        if not fewest <= len(landmarks) <= most or len(set(landmarks)) < len(landmarks):
            number = f"{fewest}" if fewest == most else f"{fewest} or more"
            raise LiaamError(f"measure '{text}': {kind} takes {number} different landmarks; {_REMEDY}")
        return measure

    @property
    def column(self) -> str:
        """Name of its column, such as ``distance_1_5``, or that of the measure, with ``_deg`` if it is an angle."""
        if self.name:
            return _column_of(self.name) + ("" if self.power else DEGREES)
        return re.sub(r"\W", "_", "_".join((self.kind, *self.landmarks)))

    @property
    def power(self) -> int:
        """Power of the length in its unit."""
        return _KINDS[self.kind].power

    def __call__(self, points: np.ndarray) -> Measured:
        """Measure the points of its landmarks, (k, 2)."""
        return _KINDS[self.kind].function(points)


DEGREES = "_deg"
"""End of the column of an angle that has a name."""


def same_name(one: str, other: str) -> bool:
    """Return whether two names of measures would be one in a table."""
    return _column_of(one).casefold() == _column_of(other).casefold()


def _column_of(name: str) -> str:
    return re.sub(r"\W+", "_", name).strip("_")


def _check_name(name: str) -> None:
    """Raise if a measure cannot have a name."""
    remedy = "give it another name, such as 'wing length'"
    if not re.search(r"[^\W\d_]", name) or not name.isprintable() or {*":="} & {*name}:
        raise LiaamError(f"a measure cannot be called '{name}': {remedy}, with letters and without ':' and '='")
    if len(name) > LONGEST_NAME:
        raise LiaamError(
            f"the name '{name[:LONGEST_NAME]}…' of a measure is longer than {LONGEST_NAME} characters: shorten it"
        )
    if _OTHER_COLUMNS.fullmatch(_column_of(name)):
        raise LiaamError(f"a measure cannot be called '{name}', as another column of tables is: {remedy}")


@dataclass(frozen=True)
class ScaleBar:
    """Two landmarks at the ends of a scale bar of known length.

    Attributes
    ----------
    ends : tuple of str
        Landmarks by number, counted from 1, or by name.
    length : float
        Length, in the unit of the results.
    unit : str
        Unit of the length, one of `liaam.scale.UNITS`, or empty if unknown.
    se : float
        Standard error of the length.
    """

    ends: tuple[str, ...]
    length: float
    unit: str = ""
    se: float = 0.0


def parse_scale(text: str) -> Length | ScaleBar | str:
    """Parse the length of a pixel, ``0.0031 mm``, a scale bar, ``11-12=5 mm``, or the unit of files' scales, ``mm``."""
    bar, equals, written = text.rpartition("=")
    if not equals and unit_of(text):
        return unit_of(text)
    ends = _split(bar)
    lacks_length = not equals and _TWO_NUMBERS.fullmatch(written.strip())
    number = "" if lacks_length else with_points(written)
    try:
        length = parse_length(number)
    except LiaamError:
        length = None
    are_ends = len(set(ends)) == 2 and all(ends)
    if length is None or (equals and not are_ends):
        raise LiaamError(
            f"scale '{text}': give the length of a pixel, such as '0.0031 mm' or '200 px/mm'; or two landmarks and the "
            "length between them, such as '11-12=5 mm'; or the unit of the SCALE in the files, such as mm"
            f"{_unknown(text)}"
        )
    return ScaleBar(ends, length.value, length.unit, length.se) if equals else length


def _unknown(text: str) -> str:
    """Say that the unit at the end of a text is none that is known; nothing if it is one, or there is none."""
    unit = re.search(r"([^\W\d_]*)\W*\Z", text)
    if unit is None or not unit[1] or unit_of(unit[1]):
        return ""
    return f". The unit '{unit[1][:20]}' is unknown: give one of {', '.join(UNITS)}"


def indices_of(what: str, landmarks: Sequence[str], names: Sequence[str], n: int) -> list[int]:
    """Return the indices, from 0, of landmarks given by name or by number from 1."""
    numbers = {name: i for i, name in enumerate(names)} | {str(number): number - 1 for number in range(1, n + 1)}
    for landmark in landmarks:
        if landmark not in numbers:
            choices = (
                f" or their names ({', '.join(names[:5])} …)" if names else ", since these landmarks have no names"
            )
            raise LiaamError(f"{what}: there is no landmark '{landmark}'; give numbers from 1 to {n}{choices}")
    return [numbers[landmark] for landmark in landmarks]


def _split(text: str) -> tuple[str, ...]:
    """Split landmarks at commas, or at hyphens if there is no comma."""
    return tuple(part.strip() for part in text.split("," if "," in text else "-"))
