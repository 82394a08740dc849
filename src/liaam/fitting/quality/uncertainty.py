"""Uncertainty of a fit: covariances (docs/explanation/uncertainty.md)."""

import numpy as np

from liaam.fitting.loop.levels import FittedLevel
from liaam.fitting.loop.objective import Objective
from liaam.model import Reliability
from liaam.model.contours import Contours, contour_turns
from liaam.model.shape import ShapeModel, Similarity, own_parameters

UNOBSERVABLE = 1e12  # Variance in directions that nothing determines
# Least ratio of the smallest to the largest eigenvalue of a precision in observable directions, above the rounding of
# its sums; and, of the pivots of a Cholesky factor, whose squares are like eigenvalues, that above which all are.
LEAST_EIGENVALUE = 1e-12
CLEAR_PIVOT = 1e-5


def covariance(
    stage: FittedLevel, whole: Objective | None = None, strength: float = 1.0, pull: np.ndarray | None = None
) -> np.ndarray:
    """Compute the covariance of q = (p, free angles): the inverse of the Hessian of eq 10 plus the prior.

    :meth:`Objective.noise_variance` scales the Hessian, since the blur and the model's errors correlate neighbouring
    pixels. Unobservable directions have a variance of :data:`UNOBSERVABLE`.

    Parameters
    ----------
    stage : FittedLevel
        The last level of the fit.
    whole : Objective, optional
        An objective with all shape modes, of which the stage may have only the first. By default that of the stage.
    strength : float
        Strength of the prior on p.
    pull : (n_p, n_p) float64, optional
        Precision of p by the points of another landmarker.

    Returns
    -------
    (n_q, n_q) float64
    """
    whole = whole or stage.objective
    precision = _precision_of_image(stage, whole)
    n_p = whole.warp.n_parameters
    precision[np.arange(n_p), np.arange(n_p)] += strength * whole.weighted_prior
    if pull is not None:
        precision[:n_p, :n_p] += pull
    return _inverse(precision)


def _precision_of_image(stage: FittedLevel, whole: Objective) -> np.ndarray:
    """Return the precision of q by the image, (n_q, n_q) float64; 0 for parameters that the stage lacks."""
    objective = stage.objective
    solution = stage.solution
    n_p = whole.warp.n_parameters
    of_stage = own_parameters(objective.warp.n_parameters, n_p)
    entries = np.r_[of_stage, n_p : whole.n_q]  # with the angles
    precision = np.zeros((whole.n_q, whole.n_q))
    precision[np.ix_(entries, entries)] = solution.expected_hessian / max(objective.noise_variance(solution), 1e-12)
    precision[~np.isfinite(precision)] = 0.0  # of a diverged fit
    return precision


def _inverse(precision: np.ndarray) -> np.ndarray:
    """Invert a precision matrix, whose null space has the variance :data:`UNOBSERVABLE`."""
    factor = _factor_if_observable(precision)
    if factor is not None:  # takes a quarter of the time
        inverse_factor = np.linalg.inv(factor)
        return inverse_factor.T @ inverse_factor
    values, vectors = np.linalg.eigh(precision)
    is_observable = values > LEAST_EIGENVALUE * max(values[-1], 1e-300)  # none if all are 0
    variances = np.divide(1.0, values, out=np.full_like(values, UNOBSERVABLE), where=is_observable)
    return (vectors * variances) @ vectors.T


def _factor_if_observable(precision: np.ndarray) -> np.ndarray | None:
    """Return the Cholesky factor of a precision matrix if everything is clearly observable; else None."""
    try:
        factor = np.linalg.cholesky(precision)
    except np.linalg.LinAlgError:
        return None
    pivots = factor.diagonal()
    return factor if pivots.min() > CLEAR_PIVOT * pivots.max() else None


def expanded_covariance(spread: np.ndarray, n_p: int, factor: float) -> np.ndarray:
    """Return the covariance (n_q, n_q) of (p, free angles) if a factor multiplies the shape modes in p (n_p,).

    ``spread`` (n_q, n_q) is the covariance without it.
    """
    scales = np.ones(len(spread))
    scales[: n_p - 4] = factor  # the last four of p are the similarity
    return scales[:, None] * spread * scales


def fitted_covariances(shapes: ShapeModel, spread: np.ndarray) -> np.ndarray:
    """Propagate the covariance of p (first in ``spread``) to the landmarks, (n, 2, 2) float64, model pixels squared."""
    n_p = len(shapes.basis)
    weighted = spread[:n_p, :n_p] @ shapes.basis
    # Sums over the last axis, one number after the other, take a third of the time.
    basis, weighted = (
        np.ascontiguousarray(each.reshape(n_p, -1, 2).transpose(1, 2, 0)) for each in (shapes.basis, weighted)
    )
    return np.einsum("nai,nbi->nab", basis, weighted)


def landmark_covariances(
    shapes: ShapeModel,
    pose: Similarity,
    p: np.ndarray,
    spread: np.ndarray,
    contours: Contours = (),
    reliability: Reliability | None = None,
    unit: float = 1.0,
) -> np.ndarray:
    """Return the covariance of each landmark, (n, 2, 2) float64, image pixels squared: of the fit plus left-out errors.

    ``spread`` is the covariance of (p, free angles), and ``pose`` maps model pixels to image pixels. Errors on left-out
    images are those along and across the contours, from the model's calibration; by default the shape model's errors on
    left-out shapes. They depend on ``unit``, the variance of a residual at weight 1.
    """
    fitted = fitted_covariances(shapes, spread)
    unexplained = shapes.unexplained if reliability is None else reliability.errors(unit)
    scales = None if reliability is None else reliability.scales
    if contours:
        turns = contour_turns(shapes.mean, shapes.shape(p), contours)
        unexplained = _turned(unexplained, turns)
        scales = _turned(scales, turns)
    in_model_pixels = fitted if unexplained is None else fitted + unexplained
    if scales is not None:
        in_model_pixels = scales @ in_model_pixels @ scales
    return pose.matrix @ in_model_pixels @ pose.matrix.T


def _turned(matrices: np.ndarray | None, turns: np.ndarray) -> np.ndarray | None:
    """Turn symmetric matrices (n, 2, 2) by rotations (n, 2, 2)."""
    return None if matrices is None else turns @ matrices @ np.swapaxes(turns, 1, 2)
