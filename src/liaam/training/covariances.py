"""Covariances of landmarks, learnt from the errors of fits to left-out images, along and across contours apart."""

from typing import Any, NamedTuple

import numpy as np

from liaam.model.contours import Contours, contour_axes, contour_directions

# Weight, in left-out images, of what is known without them: of the average over landmarks that are alike in the
# estimate of one's covariance, and of 1 in the factor on a fit's own variances. With 5, the noise of 20 images makes
# ellipses too large, because remainders below 0 are set to 0 (experiments/notes/uncertainty.md).
SHRINK = 15.0
# Covariances that agree with the errors in m left-out images are multiplied by 1 + TAIL / (m + STEADY), because few
# errors underestimate the tails (experiments/notes/uncertainty.md).
TAIL = 16.0
STEADY = 10.0
# Largest factor on a fit's own variances. Images without noise may suggest any factor, too large for noisy ones.
LARGEST_FACTOR = 10.0
# Range of the factors by which the variances of a landmark are corrected in the end
SCALES = (0.1, 10.0)


def surprise(error: np.ndarray, spread: np.ndarray) -> float:
    """Return the squared Mahalanobis distance of p's error (n_p,) divided by n_p: 1 if the covariance is right.

    NaN for a singular covariance (n_q, n_q).
    """
    n_p = len(error)
    try:
        return float(error @ np.linalg.solve(spread[:n_p, :n_p], error)) / n_p
    except np.linalg.LinAlgError:
        return np.nan


def variance_factor(surprises: np.ndarray) -> float:
    """Return the factor on a fit's own variances: a geometric mean of surprises (m,), shrunk to 1 if there are few."""
    logs = np.log(np.maximum(surprises[np.isfinite(surprises)], 1e-6))
    return float(np.clip(np.exp(logs.sum() / (len(logs) + SHRINK)), 1.0, LARGEST_FACTOR))


class Alike(NamedTuple):
    """Variances of landmarks that are alike: along a contour, across it, and both of all landmarks on no contour."""

    groups: np.ndarray
    """(n, 2) int64: the same number for variances that are alike."""
    axes: np.ndarray
    """(n, 2, 2) float64: unit vectors along and across the contour."""

    @classmethod
    def of(cls, shape: np.ndarray, contours: Contours) -> "Alike":
        """Group the landmarks of a mean shape (n, 2)."""
        groups = np.zeros(shape.shape, int)
        along = contour_directions(shape, contours)
        for i, (indices, _) in enumerate(contours):
            groups[list(indices)] = 2 * i + 1, 2 * i + 2
        return cls(np.where(np.isfinite(along), groups, 0), contour_axes(shape, contours))

    def variances(self, moments: np.ndarray) -> np.ndarray:
        """Return the variances along and across, (..., n, 2), of second moments (..., n, 2, 2)."""
        return np.einsum("nia,...nab,nib->...ni", self.axes, moments, self.axes)

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Return the mean of values (n, 2) over those that are alike, (n, 2)."""
        groups = self.groups.ravel()
        return (np.bincount(groups, values.ravel()) / np.maximum(np.bincount(groups), 1))[self.groups]

    def on_no_contour(self) -> np.ndarray:
        """Return which landmarks lie on no contour, (n,) bool."""
        return (self.groups == 0).all(axis=1)

    def scales(self, factors: np.ndarray) -> np.ndarray:
        """Return the matrices (n, 2, 2) that multiply variances along and across by factors (n, 2)."""
        return np.einsum("ni,nia,nib->nab", np.sqrt(factors), self.axes, self.axes)


def learn_covariances(
    errors: np.ndarray, spreads: np.ndarray, factor: float, units: np.ndarray, landmarks: np.ndarray, alike: Alike
) -> dict[str, Any]:
    """Learn the covariance of each landmark beyond what fits state.

    In the end the variances of each landmark are scaled so that they agree with the squared errors of the left-out
    fits (:func:`factors_of`), and enlarged for the tails that few fits do not show.

    Parameters
    ----------
    errors : (m, n, 2) float64
        Errors of right fits to left-out images, pixels of the frame, along and across the contours of the mean shape
        as they are along and across those of the image. NaN where the true landmark is not known.
    spreads : (m, n, 2, 2) float64
        Covariances of the landmarks by the fits, turned as the errors.
    factor : float
        Factor on these (:func:`variance_factor`).
    units : (m,) float64
        Variances of a residual at weight 1 in these fits.
    landmarks : (n, 2, 2) float64
        Covariance of left-out shapes about the nearest shape of the model.
    alike : Alike

    Returns
    -------
    dict
        Fields of :class:`liaam.model.Reliability`.
    """
    unit = float(units.mean())
    fitted = factor * spreads
    bias = beyond(errors, fitted, landmarks, alike)
    stated = fitted + landmarks + (units / unit)[:, None, None, None] * bias
    ratios = np.square(np.einsum("nia,mna->mni", alike.axes, errors)) / alike.variances(stated)
    factors = factors_of(ratios, alike) * (1.0 + TAIL / (len(errors) + STEADY))
    return {
        "landmarks": landmarks,
        "bias": bias,
        "unit": unit,
        "variance_factor": factor,
        "scales": alike.scales(np.clip(factors, *SCALES)),
    }


def factors_of(ratios: np.ndarray, alike: Alike) -> np.ndarray:
    """Return factors (n, 2) on the variances of each landmark along and across, from errors in left-out images.

    Landmarks differ in how well fits state their errors: the mean ratio of one's squared errors to the stated variances
    estimates its factor. Its logarithm is shrunk towards that of those that are alike, as far as their differences are
    those of the sampling: a mean of k independent squares has a relative variance of 2 / k (empirical Bayes).

    Parameters
    ----------
    ratios : (m, n, 2) float64
        Squared errors along and across, divided by the stated variances; NaN where the true landmark is not known.
    alike : Alike
    """
    counts = (~np.isnan(ratios)).sum(axis=0)
    means = mean_of_known(ratios, axis=0, otherwise=float(mean_of_known(ratios)))
    on_none = alike.on_no_contour()  # these have no direction
    means[on_none] = means[on_none].mean(axis=1, keepdims=True)
    counts[on_none] *= 2
    usual = np.maximum(alike.mean(means), 1e-12)
    logs = np.log(np.maximum(means / usual, 1e-6))
    known = counts > 0
    if not known.any():
        return usual
    sampling = 2.0 / np.maximum(counts, 1)
    differences = max(float(np.square(logs)[known].mean() - sampling[known].mean()), 0.0)
    return usual * np.exp(logs * differences / (differences + sampling))


def beyond(errors: np.ndarray, spreads: np.ndarray, landmarks: np.ndarray, alike: Alike) -> np.ndarray:
    """Return the covariance (n, 2, 2) of errors (m, n, 2) beyond that of fits (m, n, 2, 2) and of shapes (n, 2, 2).

    Errors that are NaN are left out. A landmark without errors has the mean covariance of the others.
    """
    counts = (~np.isnan(errors).any(axis=2)).sum(axis=0)[:, None, None]
    known = np.nan_to_num(errors)
    moments = _positive(np.einsum("mna,mnb->nab", known, known) / np.maximum(counts, 1) - spreads.mean(axis=0))
    has_errors = counts[:, 0, 0] > 0
    moments[~has_errors] = moments[has_errors].mean(axis=0)
    return _positive(shrunk(moments, counts, alike) - landmarks)


def mean_of_known(values: np.ndarray, axis: int | None = None, otherwise: float = np.nan) -> np.ndarray:
    """Return the mean of values (any shape) that are not NaN, along an axis or of all; ``otherwise`` without any."""
    are_known = ~np.isnan(values)
    counts = are_known.sum(axis=axis)
    means = np.where(are_known, values, 0.0).sum(axis=axis) / np.maximum(counts, 1)
    return np.where(counts > 0, means, otherwise)


def shrunk(moments: np.ndarray, m: int | np.ndarray, alike: Alike) -> np.ndarray:
    """Shrink second moments (n, 2, 2) of m errors towards the mean of those that are alike.

    The number of errors may differ by landmark: an array that broadcasts with the moments, such as (n, 1, 1).
    """
    pooled = np.einsum("ni,nia,nib->nab", alike.mean(alike.variances(moments)), alike.axes, alike.axes)
    return (m * moments + SHRINK * pooled) / (m + SHRINK)


def _positive(matrices: np.ndarray) -> np.ndarray:
    """Set negative eigenvalues of symmetric matrices (n, 2, 2) to 0."""
    values, vectors = np.linalg.eigh(matrices)
    return np.einsum("nai,ni,nbi->nab", vectors, np.maximum(values, 0.0), vectors)
