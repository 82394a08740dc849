"""Error measures of landmarks, and formatting of numbers."""

from collections.abc import Sequence
from dataclasses import fields
from functools import lru_cache
from typing import Any

import numpy as np

from liaam.errors import LiaamError

__all__ = [
    "angle_difference",
    "cumulative_errors",
    "error_statistics",
    "inter_ocular_distance",
    "landmark_errors",
    "nme",
    "point_error",
    "rms_error",
    "within_ellipses",
]


def __dir__() -> list[str]:
    return __all__


Contours = Sequence[tuple[Sequence[int], bool]]
"""Lines through landmarks: their indices in turn, and whether the last is joined to the first."""


def point_error(shape: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance between corresponding (n, 2) landmarks, in pixels.

    Landmarks missing in `truth` (NaN) are ignored. The error is infinite if `shape` is not finite.
    """
    return float(np.mean(_known_errors(shape, truth)))


def landmark_errors(shape: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distance between corresponding landmarks, (..., n, 2), in pixels: (..., n) float64.

    NaN where the landmark is missing in `truth`; infinite where `shape` is not finite.
    """
    shape, truth = np.asarray(shape, np.float64), np.asarray(truth, np.float64)
    if shape.shape != truth.shape:
        raise LiaamError(f"shapes of {shape.shape} and {truth.shape} cannot be compared; give (n, 2) points for both")
    with np.errstate(invalid="ignore", over="ignore"):
        distances = np.hypot(*np.moveaxis(shape - truth, -1, 0))
    distances = np.where(np.isfinite(shape).all(axis=-1), distances, np.inf)
    return np.where(np.isfinite(truth).all(axis=-1), distances, np.nan)


def _known_errors(shape: np.ndarray, truth: np.ndarray) -> np.ndarray:
    errors = landmark_errors(shape, truth)
    return errors[~np.isnan(errors)]


def within_ellipses(shape: np.ndarray, truth: np.ndarray, covariances: np.ndarray, level: float = 0.95) -> np.ndarray:
    """Whether confidence ellipses hold the truth, (..., n) float64: 1, 0, or NaN if that is unknown.

    Parameters
    ----------
    shape, truth : (..., n, 2) float
        Fitted landmarks, the centres of the ellipses, and true ones.
    covariances : (..., n, 2, 2) float
    level : float
        Probability that an ellipse holds the truth if the covariances are right, 0 to 1.
    """
    errors, covariances = landmark_errors(shape, truth), np.asarray(covariances, np.float64)
    known = ~np.isnan(errors) & np.isfinite(covariances).all(axis=(-2, -1))
    values, axes = np.linalg.eigh(np.where(known[..., None, None], covariances, 0.0))
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.where(np.isfinite(errors)[..., None], np.subtract(truth, shape), 0.0)
        along = np.einsum("...ab,...a->...b", axes, apart)
        squared = np.sum(along**2 / np.maximum(values, 1e-12), axis=-1)  # of a chi-squared distribution
    inside = np.isfinite(errors) & (squared < -2.0 * np.log1p(-level))
    return np.where(known, inside.astype(np.float64), np.nan)


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
    before, after = np.arange(n), np.arange(n)
    for indices, closed in _curves(contours):
        whole = indices[[-1, *range(len(indices)), 0]] if closed else indices[[0, *range(len(indices)), -1]]
        before[indices], after[indices] = whole[:-2], whole[2:]
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
    cos, sin = np.real(turns), np.imag(turns)
    return np.stack([cos, -sin, sin, cos], axis=-1).reshape(*turns.shape, 2, 2)


def along_and_across(vectors: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Components of vectors (..., n, 2) along and across directions (..., n, 2), in this order, (..., n, 2) float64."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.sum(_axes(directions) * vectors[..., None, :], axis=-1)


def within_intervals(errors: np.ndarray, covariances: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Whether the 95 % intervals along and across directions hold errors, (..., n, 2) float64: 1, 0, or NaN.

    Errors are fitted minus true landmarks, and directions unit vectors, (..., n, 2); NaN where there is none.
    """
    found = along_and_across(errors, directions)
    axes = _axes(directions)
    with np.errstate(invalid="ignore"):
        variances = np.einsum("...ia,...ab,...ib->...i", axes, covariances, axes)
        inside = np.square(found) <= 1.96**2 * variances
    return np.where(np.isfinite(variances) & ~np.isnan(found), inside, np.nan)


def outline_errors(shape: np.ndarray, truth: np.ndarray, contours: Contours) -> np.ndarray:
    """Distances of landmarks from the true contours, (n,) float64, in pixels; those not on contours from the truth.

    Landmarks along a contour are often labelled a little before or after where they belong, and fits slide along it:
    the distance to the contour is what can be seen in the image.
    """
    errors, on_contour = landmark_errors(shape, truth), ~np.isnan(contour_directions(truth, contours)[:, 0])
    for indices, closed in _curves(contours):
        line = truth[[*indices, indices[0]] if closed else indices]
        own = indices[on_contour[indices] & np.isfinite(errors[indices])]
        starts, steps = line[:-1], np.diff(line, axis=0)
        known = np.isfinite(steps).all(axis=1)
        apart, steps = shape[own][:, None] - starts[known], steps[known]
        lengths = np.maximum(np.square(steps).sum(axis=1), 1e-12)
        at = np.clip(np.sum(apart * steps, axis=2) / lengths, 0.0, 1.0)
        distances = np.linalg.norm(apart - at[..., None] * steps, axis=2)
        errors[own] = np.minimum(errors[own], distances.min(axis=1, initial=np.inf))
    return errors


def _curves(contours: Contours) -> list[tuple[np.ndarray, bool]]:
    return [(np.array(indices), closed) for indices, closed in contours if len(indices) > 2]


def rms_error(shape: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square distance between corresponding (n, 2) landmarks, in pixels. Compare it with covariances."""
    return root_mean_square(_known_errors(shape, truth))


def inter_ocular_distance(shape: np.ndarray, left_eye: slice, right_eye: slice) -> float:
    """Inter-ocular distance (IOD): distance between the centres of both eyes' landmarks, in pixels."""
    return float(np.linalg.norm(shape[left_eye].mean(axis=0) - shape[right_eye].mean(axis=0)))


def nme(shape: np.ndarray, truth: np.ndarray, normaliser: float) -> float:
    """Normalised mean error: mean point-to-point distance divided by a length such as the IOD."""
    return point_error(shape, truth) / normaliser


def cumulative_errors(errors: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Cumulative error distribution (CED): fraction of errors at or below each limit. NaN counts as failure."""
    errors = np.sort(np.where(np.isfinite(errors), errors, np.inf))
    return np.searchsorted(errors, limits, side="right") / max(len(errors), 1)


def error_statistics(errors: np.ndarray) -> dict[str, float | None]:
    """Median, 90th percentile and root mean square. NaN counts as infinite; infinite results become None."""
    errors = np.asarray(errors, dtype=np.float64)
    errors = np.where(np.isfinite(errors), errors, np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        found = {
            "median": np.median(errors),
            "p90": np.percentile(errors, 90),
            "rms": root_mean_square(errors),
        }
    return {name: finite_or_none(value) for name, value in found.items()}


def root_mean_square(values) -> float:
    """Root mean square of values."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, dtype=np.float64)))))


def finite_or_none(value: float) -> float | None:
    """Return a number for JSON, None if it is not finite."""
    return float(value) if np.isfinite(value) else None


def angle_difference(angle: float, truth: float) -> float:
    """Difference of two angles, wrapped to (-pi, pi], in radians."""
    return float(np.pi - (np.pi - (angle - truth)) % (2 * np.pi))


def ranges_of(numbers: Sequence[int], most: int = 8) -> str:
    """Format sorted numbers as ranges, at most `most` of them."""
    ranges: list[list[int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][1] + 1:
            ranges[-1][1] = number
        else:
            ranges.append([number, number])
    shown = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in ranges[:most])
    return shown + (f" and {len(ranges) - most} more ranges" if len(ranges) > most else "")


def finite_list(values: np.ndarray) -> list:
    """Convert an array to (nested) lists, with None for numbers that are not finite, as JSON has no NaN."""
    plain = np.asarray(values, dtype=object)
    plain[~np.isfinite(values)] = None
    return plain.tolist()


def short_repr(self: Any) -> str:
    """Return the fields of a dataclass as text, arrays by shape and type: the ``__repr__`` of classes with arrays."""
    values = {each.name: _short(getattr(self, each.name)) for each in fields(self)}
    return f"{type(self).__name__}({', '.join(f'{name}={value}' for name, value in values.items())})"


def changed_repr(self: Any) -> str:
    """Return a dataclass as text, with the fields that differ from their defaults: the ``__repr__`` of options."""
    changed = (each.name for each in fields(self) if each.repr and getattr(self, each.name) != each.default)
    return f"{type(self).__name__}({', '.join(f'{name}={getattr(self, name)!r}' for name in changed)})"


def _short(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.shape} {value.dtype}"
    if isinstance(value, float):
        return f"{value:g}"
    return repr(str(value)) if isinstance(value, str) else repr(value)  # str() of an enumeration is its value
