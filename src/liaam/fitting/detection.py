"""Detections of the search, and which of them are different objects."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from liaam.formatting import short_repr
from liaam.model.sampling import within
from liaam.model.shape import diagonal_of

DOUBTFUL = 0.52  # score below which a detection is uncertain (experiments/notes/engine.md)
APART = 0.1  # mean distance of landmarks, as a fraction of the size, beyond which shapes are different places
OVERLAP = 0.3  # fraction of an object's box that may lie in another's
AS_LARGE = 1.4  # greatest ratio of the sizes, either way, of objects that are about as large


@dataclass(frozen=True, eq=False)
class Detection:
    """A possible place of the object.

    Attributes
    ----------
    landmarks : (n, 2) float64
        Landmarks of a coarse fit, image pixels.
    score : float
        How well the model explains the gradient orientations there, 0 to 1; see :attr:`doubtful`.
    rotation : float
        Rotation of the mean shape, radians, clockwise in the image.
    scale : float
        Image pixels per pixel of the model's reference frame.
    others : tuple of Detection
        Further objects that the search for one object found with certainty, among those at least half as large.
    part : int
        Index of the part of the model that was found; 0 for most models.
    reflected : bool
        Whether it was found in the image reversed left to right, by a model of the other side.
    """

    landmarks: np.ndarray
    score: float
    rotation: float
    scale: float
    others: tuple["Detection", ...] = ()
    part: int = 0
    reflected: bool = False

    __repr__ = short_repr

    @property
    def doubtful(self) -> bool:
        """Whether the detection is uncertain: the score is below 0.52."""
        return self.score < DOUBTFUL


def is_inside(shape: np.ndarray, image: np.ndarray) -> bool:
    """Return whether at least half of the landmarks lie in the image."""
    return bool(within(shape, image).mean() >= 0.5)


class Placed(Protocol):
    """What has landmarks in an image, such as a detection or a fit."""

    @property
    def landmarks(self) -> np.ndarray:
        """Landmarks, (n, 2) float64."""
        ...


PlacedT = TypeVar("PlacedT", bound=Placed)


def choose(
    places: Sequence[PlacedT], differ: Callable[[np.ndarray, np.ndarray], bool], most: int | None = None
) -> list[PlacedT]:
    """Return the first detections or fits whose shapes differ from those chosen before them, at most ``most``."""
    chosen: list[PlacedT] = []
    for place in places:
        if len(chosen) != most and all(differ(place.landmarks, other.landmarks) for other in chosen):
            chosen.append(place)
    return chosen


def are_apart(shape: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two shapes (n, 2) are different places."""
    # Written out because a search compares hundreds of pairs; shapes that are not finite are different places.
    return not float(np.hypot(*(shape - other).T).mean()) <= APART * diagonal_of(shape)


def are_beside(shape: np.ndarray, other: np.ndarray) -> bool:
    """Return whether less than the fraction :data:`OVERLAP` of the smaller of two shapes' boxes lies in the other."""
    smaller = min(area_of_box(shape), area_of_box(other))
    return common_area(shape, other) / max(smaller, 1e-9) < OVERLAP


def is_beside_or_larger(shape: np.ndarray, other: np.ndarray) -> bool:
    """Return whether a shape is beside another one, or clearly larger than that, which may be a part of it."""
    return are_beside(shape, other) or diagonal_of(shape) > AS_LARGE * diagonal_of(other)


def are_as_large(size: float, other: float) -> bool:
    """Return whether two sizes are about the same."""
    return 1.0 / AS_LARGE < size / max(other, 1e-9) < AS_LARGE


def area_of_box(shape: np.ndarray) -> float:
    """Return the area of the box around a shape (n, 2)."""
    return float(np.prod(np.ptp(shape, axis=0)))


def common_area(shape: np.ndarray, other: np.ndarray) -> float:
    """Return the area that the boxes around two shapes (n, 2) share."""
    sides = np.minimum(shape.max(axis=0), other.max(axis=0)) - np.maximum(shape.min(axis=0), other.min(axis=0))
    return float(np.prod(np.maximum(sides, 0.0)))
