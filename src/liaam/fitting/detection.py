"""Detections of the search, and which of them are different objects."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from liaam.formatting import short_repr
from liaam.model.sampling import within
from liaam.model.shape import diagonal_of

DOUBTFUL = 0.52  # score below which a detection is uncertain (experiments/notes/engine.md)
APART = 0.1  # mean distance of landmarks, as a fraction of the size, beyond which shapes are different places
OVERLAP = 0.3  # fraction of an object's box that may lie in another's


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
    """

    landmarks: np.ndarray
    score: float
    rotation: float
    scale: float
    others: tuple["Detection", ...] = ()

    __repr__ = short_repr

    @property
    def doubtful(self) -> bool:
        """Whether the detection is uncertain: the score is below 0.52."""
        return self.score < DOUBTFUL


def is_inside(shape: np.ndarray, image: np.ndarray) -> bool:
    """Return whether at least half of the landmarks lie in the image."""
    return bool(within(shape, image).mean() >= 0.5)


def choose(
    detections: list[Detection], differ: Callable[[np.ndarray, np.ndarray], bool], most: int | None = None
) -> list[Detection]:
    """Return the first detections whose shapes differ from those chosen before them, at most ``most``."""
    chosen: list[Detection] = []
    for detection in detections:
        if len(chosen) != most and all(differ(detection.landmarks, other.landmarks) for other in chosen):
            chosen.append(detection)
    return chosen


def are_apart(shape: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two shapes (n, 2) are different places."""
    # Written out because a search compares hundreds of pairs; shapes that are not finite are different places.
    return not float(np.hypot(*(shape - other).T).mean()) <= APART * diagonal_of(shape)


def are_beside(shape: np.ndarray, other: np.ndarray) -> bool:
    """Return whether less than the fraction :data:`OVERLAP` of the smaller of two shapes' boxes lies in the other."""
    sides = np.minimum(shape.max(axis=0), other.max(axis=0)) - np.maximum(shape.min(axis=0), other.min(axis=0))
    smaller = min(float(np.prod(np.ptp(shape, axis=0))), float(np.prod(np.ptp(other, axis=0))))
    return float(np.prod(np.maximum(sides, 0.0))) / max(smaller, 1e-9) < OVERLAP
