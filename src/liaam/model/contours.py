"""Lines through landmarks: their directions, and errors along and across them."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from liaam.error_measures import landmark_errors

Contours = Sequence[tuple[Sequence[int], bool]]
"""Lines through landmarks: their indices in turn, and whether the last is joined to the first."""


def contour_directions(shapes: np.ndarray, contours: Contours) -> np.ndarray:
    """Directions of contours of shapes (..., n, 2) at their landmarks: unit vectors, float64; NaN at other landmarks.

    Contours of two landmarks are no curves, and landmarks where contours meet do not slide: they do not count.
    """
    shapes = np.asarray(shapes, np.float64)
    before, after = _neighbours(tuple((tuple(indices), closed) for indices, closed in contours), shapes.shape[-2])
    steps = shapes[..., after, :] - shapes[..., before, :]
    with np.errstate(invalid="ignore"):
        return steps / np.sqrt(np.square(steps).sum(axis=-1, keepdims=True))


@lru_cache(maxsize=64)
def _neighbours(contours: tuple[tuple[tuple[int, ...], bool], ...], n: int) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks before and after each of n on its contour, (n,) int64 each; itself where it is on none or several."""
    before = np.arange(n)
    after = np.arange(n)
    for indices, closed in _curves(contours):
        whole = indices[[-1, *range(len(indices)), 0]] if closed else indices[[0, *range(len(indices)), -1]]
        before[indices] = whole[:-2]
        after[indices] = whole[2:]
    on = np.concatenate([np.zeros(0, int), *(np.unique(np.array(indices, int)) for indices, _ in contours)])
    several = np.flatnonzero(np.bincount(on, minlength=n) > 1)
    before[several] = after[several] = several
    return before, after


def contour_axes(shapes: np.ndarray, contours: Contours) -> np.ndarray:
    """Unit vectors along and across contours at their landmarks, (..., n, 2, 2) float64; x and y at other landmarks."""
    along = contour_directions(shapes, contours)
    return _axes(np.where(np.isnan(along), [1.0, 0.0], along))


def _axes(along: np.ndarray) -> np.ndarray:
    """Unit vectors along and across directions (..., n, 2), in this order, (..., n, 2, 2)."""
    return np.stack([along, along[..., ::-1] * [-1.0, 1.0]], axis=-2)


def contour_turns(shape: np.ndarray, to: np.ndarray, contours: Contours) -> np.ndarray:
    """Rotations of contours at their landmarks, from a shape (n, 2) to another, (n, 2, 2) float64."""
    before, after = (contour_directions(each, contours) @ np.array([1.0, 1.0j]) for each in (shape, to))
    with np.errstate(invalid="ignore"):
        turns = after * before.conj()  # of complex unit vectors
    turns[np.isnan(turns)] = 1.0
    cos = np.real(turns)
    sin = np.imag(turns)
    return np.stack([cos, -sin, sin, cos], axis=-1).reshape(*turns.shape, 2, 2)


def along_and_across(vectors: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Components of vectors (..., n, 2) along and across directions (..., n, 2), in this order, (..., n, 2) float64."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.sum(_axes(directions) * vectors[..., None, :], axis=-1)


def within_intervals(errors: np.ndarray, covariances: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Whether the 95 % intervals along and across directions hold errors, (..., n, 2) float64: 1, 0, or NaN.

    Errors are fitted minus true landmarks, and directions unit vectors, (..., n, 2); NaN where there is none.
    """
    components = along_and_across(errors, directions)
    axes = _axes(directions)
    with np.errstate(invalid="ignore"):
        variances = np.einsum("...ia,...ab,...ib->...i", axes, covariances, axes)
        inside = np.square(components) <= 1.96**2 * variances
    return np.where(np.isfinite(variances) & ~np.isnan(components), inside, np.nan)


def outline_errors(shape: np.ndarray, truth: np.ndarray, contours: Contours) -> np.ndarray:
    """Distances of landmarks from the true contours, (n,) float64, in pixels; those not on contours from the truth.

    Landmarks along a contour are often labelled a little before or after where they belong, and fits slide along it:
    the distance to the contour is what can be seen in the image.
    """
    errors = landmark_errors(shape, truth)
    on_contour = ~np.isnan(contour_directions(truth, contours)[:, 0])
    for indices, closed in _curves(contours):
        line = truth[[*indices, indices[0]] if closed else indices]
        sliding = indices[on_contour[indices] & np.isfinite(errors[indices])]
        starts = line[:-1]
        steps = np.diff(line, axis=0)
        finite = np.isfinite(steps).all(axis=1)
        apart = shape[sliding][:, None] - starts[finite]
        steps = steps[finite]
        lengths = np.maximum(np.square(steps).sum(axis=1), 1e-12)
        at = np.clip(np.sum(apart * steps, axis=2) / lengths, 0.0, 1.0)
        distances = np.linalg.norm(apart - at[..., None] * steps, axis=2)
        errors[sliding] = np.minimum(errors[sliding], distances.min(axis=1, initial=np.inf))
    return errors


def _curves(contours: Contours) -> list[tuple[np.ndarray, bool]]:
    return [(np.array(indices), closed) for indices, closed in contours if len(indices) > 2]
