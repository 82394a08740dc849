"""Error measures of landmarks, and statistics of errors. Those for users are also in :mod:`liaam.evaluation`."""

import numpy as np
from numpy.typing import ArrayLike

from liaam.errors import LiaamError
from liaam.formatting import finite_or_none

# Least variance along an axis of an ellipse, square pixels: a covariance may be 0, or less by rounding errors
LEAST_VARIANCE = 1e-12


def point_error(shape: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance between corresponding (n, 2) landmarks, in pixels.

    Landmarks missing in `truth` (NaN) are ignored. The error is infinite if `shape` is not finite.
    """
    return float(np.mean(_known_errors(shape, truth)))


def landmark_errors(shape: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distance between corresponding landmarks, (..., n, 2), in pixels: (..., n) float64.

    NaN where the landmark is missing in `truth`; infinite where `shape` is not finite.
    """
    shape = np.asarray(shape, np.float64)
    truth = np.asarray(truth, np.float64)
    if shape.shape != truth.shape:
        raise LiaamError(f"shapes of {shape.shape} and {truth.shape} cannot be compared; give (n, 2) points for both")
    with np.errstate(invalid="ignore", over="ignore"):
        x, y = np.moveaxis(shape - truth, -1, 0)
        distances = np.hypot(x, y)
    distances = np.where(np.isfinite(shape).all(axis=-1), distances, np.inf)
    return np.where(np.isfinite(truth).all(axis=-1), distances, np.nan)


def _known_errors(shape: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distances, (k,) float64, of the k landmarks that are not missing in `truth`."""
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
    errors = landmark_errors(shape, truth)
    covariances = np.asarray(covariances, np.float64)
    is_known = ~np.isnan(errors) & np.isfinite(covariances).all(axis=(-2, -1))
    variances, axes = np.linalg.eigh(np.where(is_known[..., None, None], covariances, 0.0))
    with np.errstate(invalid="ignore", over="ignore"):
        difference = np.where(np.isfinite(errors)[..., None], np.subtract(truth, shape), 0.0)
        along_axes = np.einsum("...ab,...a->...b", axes, difference)
        mahalanobis_squared = np.sum(along_axes**2 / np.maximum(variances, LEAST_VARIANCE), axis=-1)
    limit = -2.0 * np.log1p(-level)  # the quantile of the chi-squared distribution with two degrees of freedom
    inside = np.isfinite(errors) & (mahalanobis_squared < limit)
    return np.where(is_known, inside.astype(np.float64), np.nan)


def rms_error(shape: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square distance between corresponding (n, 2) landmarks, in pixels. Compare it with covariances."""
    return root_mean_square(_known_errors(shape, truth))


def inter_ocular_distance(shape: np.ndarray, left_eye: slice, right_eye: slice) -> float:
    """Inter-ocular distance (IOD): distance between the centres of both eyes' landmarks in (n, 2), in pixels."""
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
        statistics = {
            "median": np.median(errors),
            "p90": np.percentile(errors, 90),
            "rms": root_mean_square(errors),
        }
    return {name: finite_or_none(value) for name, value in statistics.items()}


def root_mean_square(values: ArrayLike) -> float:
    """Root mean square of values."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, dtype=np.float64)))))


def angle_difference(angle: float, truth: float) -> float:
    """Difference of two angles, wrapped to (-pi, pi], in radians."""
    return float(np.pi - (np.pi - (angle - truth)) % (2 * np.pi))
