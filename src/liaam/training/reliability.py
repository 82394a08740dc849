"""Calibration of the quality and the covariances of fits, on images left out of training.

A fit that converges need not be correct. Correct fits explain more of the image, with a less unusual shape. The
threshold depends on the object and the model. Training therefore fits models to left-out images from near and distant
starts, and at the best wrong places that a search finds.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from liaam.evaluation import point_error
from liaam.fitting import Fitter
from liaam.fitting.levels import LinearImage
from liaam.fitting.methods import DEFAULT_METHOD, METHODS
from liaam.fitting.search import Finder
from liaam.fitting.solver import SolverOptions
from liaam.fitting.templates import is_searchable
from liaam.fitting.uncertainty import fitted_covariances
from liaam.model import AAM, Reliability
from liaam.model.shape import align, diagonal_of, rotation, shifted_into

RIGHT, WRONG = 0.03, 0.06
"""Mean distance from the landmarks, as a fraction of the shape's diagonal: a fit is right up to the first and wrong
beyond the second. Fits in between are not used."""

OPTIONS = SolverOptions(max_iterations=20)
"""Right fits converge sooner; wrong ones need not converge."""

PLACES = 3
"""Places of the search that are fitted in an image, besides those that fill the frame."""

SHRINK = 5.0
"""Weight, in left-out images, of the average over all landmarks in the estimate of one landmark's covariance."""

TAIL, STEADY = 12.0, 10.0
"""Covariances estimated from m left-out images are multiplied by 1 + TAIL / (m + STEADY), because few errors
underestimate the tails. On generated scenes with 20 images left out, the 95 % ellipses hold 93 %, and 91 % with half of
TAIL."""

RARE = 0.05
"""Fraction of right fits whose quality is below :attr:`liaam.model.Reliability.typical`."""

LARGEST_FACTOR = 10.0
"""Largest factor on a fit's own variances. Images without noise may suggest any factor, too large for noisy ones."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """An image, its landmarks, and a model trained without it, on the reference frame of the full model.

    ``relit`` marks images whose light was changed; their background is then not valid.
    """

    model: AAM
    image: np.ndarray
    points: np.ndarray
    relit: bool = False


def calibrate(model: AAM, pictures: Iterable[LeftOut]) -> Reliability | None:
    """Learn the quality of fits and the errors of right fits from left-out images.

    Parameters
    ----------
    model : AAM
        Model trained on all images.
    pictures : iterable of LeftOut

    Returns
    -------
    Reliability or None
        None if there are too few right fits to learn from.
    """
    seen, right, errors, spreads, surprises, units, fitter = [], [], [], [], [], [], None
    finder = Finder(model)
    for i, picture in enumerate(pictures):
        rng = np.random.default_rng([7, i])
        if fitter is None or fitter.model is not picture.model:
            fitter = Fitter(picture.model, DEFAULT_METHOD, OPTIONS, restarts=False)
        for near, start in ((True, _near(picture, rng)), (False, _far(picture, rng))):
            result = fitter.fit(picture.image, start)
            if result.status.lost:
                continue
            error = point_error(result.landmarks, picture.points) / diagonal_of(picture.points)
            if not np.isfinite(error) or not np.isfinite(result.evidence).all():
                continue
            if near and error <= WRONG:
                unposed, shapes = result.pose.inverse(), fitter.shapes
                errors.append((picture.points - result.landmarks) @ unposed.matrix.T)
                spreads.append(fitted_covariances(shapes, result.covariance))
                units.append(result.residual_variance)
                surprises.append(_surprise(shapes.parameters(unposed(picture.points)) - result.p, result.covariance))
            if not RIGHT < error <= WRONG:
                seen.append(result.evidence)
                right.append(error <= RIGHT)
        elsewhere = None if picture.relit else _elsewhere(picture, fitter, finder)
        if elsewhere is not None:
            seen.append(elsewhere)
            right.append(False)
    if sum(right) < 3 or not errors:
        return None
    weights = _weights(np.array(seen), np.array(right))
    if not weights[1] > 0:  # quality must increase with the explained contrast
        return None
    variance_factor = _variance_factor(np.array(surprises))
    landmarks = _by_shape(model)
    bias = _beyond(np.array(errors), variance_factor * np.array(spreads), landmarks)
    made = Reliability(landmarks, bias, float(np.mean(units)), weights, variance_factor)
    qualities = [made.quality(own) for own, is_right in zip(seen, right, strict=True) if is_right]
    return replace(made, typical=float(np.quantile(qualities, RARE)))


def _near(picture: LeftOut, rng: np.random.Generator) -> np.ndarray:
    mean = picture.model.shape_model.mean
    return _moved(align(mean, picture.points)(mean), rng, turn=4.0, shift=0.02)


def _far(picture: LeftOut, rng: np.random.Generator) -> np.ndarray:
    """Return a start too far away for a fit to recover, shifted into the image if possible."""
    start = _moved(_near(picture, rng), rng, turn=30.0, shift=0.4)
    return shifted_into(start, (picture.image.shape[1], picture.image.shape[0]))


def _moved(shape: np.ndarray, rng: np.random.Generator, turn: float, shift: float) -> np.ndarray:
    centre, towards = shape.mean(axis=0), rng.uniform(0.0, 2.0 * np.pi)
    angle = np.deg2rad(rng.choice([-1, 1]) * turn * rng.uniform(0.5, 1.0))
    step = shift * diagonal_of(shape) * np.array([np.cos(towards), np.sin(towards)])
    return (shape - centre) @ rotation(angle).T + centre + step


def _elsewhere(picture: LeftOut, fitter: Fitter, finder: Finder) -> np.ndarray | None:
    """Return the evidence of the wrong fit that explains most, among the places that a search finds."""
    found = []
    if not is_searchable(finder.model):
        return None
    for candidate in finder.others_in(LinearImage(picture.image, fitter.model.response), PLACES):
        result = fitter.fit(picture.image, candidate)
        error = point_error(result.landmarks, picture.points) / diagonal_of(picture.points)
        if error > WRONG and not result.status.lost and np.isfinite(result.evidence).all():
            found.append(result.evidence)
    return max(found, key=lambda evidence: evidence[0], default=None)


def _surprise(error: np.ndarray, spread: np.ndarray) -> float:
    """Return the squared Mahalanobis distance of p's error (n_p,) divided by n_p: 1 if the covariance is right.

    NaN for a singular covariance (n_q, n_q).
    """
    n_p = len(error)
    try:
        return float(error @ np.linalg.solve(spread[:n_p, :n_p], error)) / n_p
    except np.linalg.LinAlgError:
        return np.nan


def _variance_factor(surprises: np.ndarray) -> float:
    """Return the factor on a fit's own variances: a geometric mean of surprises (m,), shrunk to 1 if there are few."""
    logs = np.log(np.maximum(surprises[np.isfinite(surprises)], 1e-6))
    return float(np.clip(np.exp(logs.sum() / (len(logs) + SHRINK)), 1.0, LARGEST_FACTOR))


def _beyond(errors: np.ndarray, spreads: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """Return the covariance (n, 2, 2) of errors (m, n, 2) beyond that of fits (m, n, 2, 2) and of shapes (n, 2, 2)."""
    moments = _positive(np.einsum("mna,mnb->nab", errors, errors) / len(errors) - spreads.mean(axis=0))
    return _positive(_widened(moments, len(errors)) - landmarks)


def _positive(matrices: np.ndarray) -> np.ndarray:
    """Set negative eigenvalues of symmetric matrices (n, 2, 2) to 0."""
    values, vectors = np.linalg.eigh(matrices)
    return np.einsum("nai,ni,nbi->nab", vectors, np.maximum(values, 0.0), vectors)


def _widened(moments: np.ndarray, m: int) -> np.ndarray:
    """Shrink second moments (n, 2, 2) of m errors towards the mean of all landmarks, and inflate them."""
    pooled = 0.5 * float(np.trace(moments, axis1=1, axis2=2).mean()) * np.eye(2)
    return (m * moments + SHRINK * pooled) / (m + SHRINK) * (1.0 + TAIL / (m + STEADY))


def _by_shape(model: AAM) -> np.ndarray:
    """Return the covariance (n, 2, 2) of left-out shapes: a lower bound, because lost fits are not among the errors."""
    unexplained = model.views[METHODS[DEFAULT_METHOD].view].shape_model.unexplained
    nothing = np.zeros((model.n_points, 2, 2))
    return nothing if unexplained is None else _widened(unexplained, model.n_images)


def _weights(evidence: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return weights (3,) of the log odds by the evidence (m, 2), with a weight of at most 0 for unusual shapes."""
    # Add a fit that explains nothing as an example of a wrong one.
    evidence = np.concatenate([evidence, [[0.0, float(np.median(evidence[:, 1]))]]])
    right = np.append(right, False)
    weights = _logistic(evidence, right)
    return weights if weights[2] <= 0 else np.append(_logistic(evidence[:, :1], right), 0.0)


def _logistic(features: np.ndarray, right: np.ndarray, ridge: float = 0.5, steps: int = 50) -> np.ndarray:
    """Return weights (1 + k,) of a ridge logistic regression on features (m, k), with both classes balanced."""
    middle, scale = features.mean(axis=0), features.std(axis=0) + 1e-6
    x = np.column_stack([np.ones(len(right)), (features - middle) / scale])
    balance = np.where(right, 0.5 / max(right.sum(), 1), 0.5 / max((~right).sum(), 1)) * len(right)
    w = np.zeros(x.shape[1])
    penalty = ridge * np.diag([1e-3] + [1.0] * features.shape[1])
    for _ in range(steps):
        p = 1.0 / (1.0 + np.exp(-np.clip(x @ w, -30, 30)))
        hessian = (x * (balance * p * (1 - p) + 1e-9)[:, None]).T @ x + penalty
        w = w - np.linalg.solve(hessian, x.T @ (balance * (p - right)) + penalty @ w)
    slopes = w[1:] / scale
    return np.concatenate([[w[0] - slopes @ middle], slopes])
