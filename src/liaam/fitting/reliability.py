"""How far a fit can be trusted: its quality, calibrated on pictures left out of training.

A fit that settles need not be right. What tells is how much of the picture it explains, and how strange a shape it
takes to do so; where the line runs between right and wrong depends on the object and on how well the model knows it.
So models are fitted, at training, to pictures that they have not seen, from starts near and far, and at the places
where a search would look next: a search takes the best of many wrong places, and that is what has to be told apart.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from liaam.evaluation import point_error
from liaam.fitting.fitter import Fitter, fitted_covariances
from liaam.fitting.methods import DEFAULT_METHOD, METHODS
from liaam.fitting.search import Finder, is_searchable
from liaam.fitting.solver import SolverOptions
from liaam.model import AAM, Reliability
from liaam.model.shape import align, diagonal_of, rotation, shifted_into

RIGHT, WRONG = 0.03, 0.06
"""Mean distance from the landmarks, as a share of the shape's diagonal, up to which a fit counts as right and beyond
which as wrong; what lies between teaches nothing."""

OPTIONS = SolverOptions(max_iterations=20)
"""Right fits settle sooner, and wrong ones need not settle."""

PLACES = 3
"""Places of a search that are fitted in a picture, besides those that fill the frame; the worst of them counts."""

SHRINK = 5.0
"""Left-out pictures that the average over all landmarks counts as, where each landmark's own spread is estimated."""

TAIL, STEADY = 12.0, 10.0
"""How much few left-out pictures m widen the spread: by 1 + TAIL / (m + STEADY). What is to come lies further out than
a moment of few errors says; on generated scenes, 20 left out, the ellipses hold 93 % so, and 91 % with half of it."""

RARE = 0.05
"""Share of right fits whose quality is called out of the ordinary."""

MOST_UNDERSTATED = 10.0
"""Largest factor on a fit's own variances: pictures without noise may ask for any, and noisy ones would bear it."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A picture, its landmarks, and a model that has not seen it (on the frame of the model that has).

    ``relit`` if the picture is shown in another light than it was taken in; its background says nothing then.
    """

    model: AAM
    image: np.ndarray
    points: np.ndarray
    relit: bool = False


def calibrate(model: AAM, pictures: Iterable[LeftOut]) -> Reliability | None:
    """Learn what right and wrong fits look like, and how far right ones err.

    Parameters
    ----------
    model : AAM
        Of all pictures.
    pictures : iterable of LeftOut

    Returns
    -------
    Reliability or None
        None where there is nothing to learn from: too few right fits.
    """
    seen, right, errors, spreads, surprises, fitter = [], [], [], [], [], None
    finder = Finder(model)
    for i, picture in enumerate(pictures):
        rng = np.random.default_rng([7, i])
        if fitter is None or fitter.model is not picture.model:
            fitter = Fitter(picture.model, DEFAULT_METHOD, OPTIONS, restarts=False)
        for near, start in ((True, _near(picture, rng)), (False, _far(picture, rng))):
            result = fitter.fit(picture.image, start)
            if result.status.lost:
                continue  # its status says it all
            error = point_error(result.landmarks, picture.points) / diagonal_of(picture.points)
            if not np.isfinite(error) or not np.isfinite(result.evidence).all():
                continue
            if near and error <= WRONG:  # all that are not lost: those in doubt err, too
                unposed, shapes = result.pose.inverse(), fitter.shapes
                errors.append((picture.points - result.landmarks) @ unposed.matrix.T)
                spreads.append(fitted_covariances(shapes, result.covariance))
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
    if not weights[1] > 0:  # what is explained has to speak for a fit
        return None
    understated = _understated(np.array(surprises))
    landmarks = _landmarks(np.array(errors), understated * np.array(spreads))
    made = Reliability(_larger(landmarks, _by_shape(model)), weights, understated)
    qualities = [made.quality(own) for own, is_right in zip(seen, right, strict=True) if is_right]
    return replace(made, ordinary=float(np.quantile(qualities, RARE)))


def _near(picture: LeftOut, rng: np.random.Generator) -> np.ndarray:
    mean = picture.model.shape_model.mean
    return _moved(align(mean, picture.points)(mean), rng, turn=4.0, shift=0.02)


def _far(picture: LeftOut, rng: np.random.Generator) -> np.ndarray:
    """A start so far away that no fit should find back, shifted into the picture as far as it can be."""
    start = _moved(_near(picture, rng), rng, turn=30.0, shift=0.4)
    return shifted_into(start, (picture.image.shape[1], picture.image.shape[0]))


def _moved(shape: np.ndarray, rng: np.random.Generator, turn: float, shift: float) -> np.ndarray:
    centre, towards = shape.mean(axis=0), rng.uniform(0.0, 2.0 * np.pi)
    angle = np.deg2rad(rng.choice([-1, 1]) * turn * rng.uniform(0.5, 1.0))
    step = shift * diagonal_of(shape) * np.array([np.cos(towards), np.sin(towards)])
    return (shape - centre) @ rotation(angle).T + centre + step


def _elsewhere(picture: LeftOut, fitter: Fitter, finder: Finder) -> np.ndarray | None:
    """Evidence of the fit that explains most of a picture at the places that a search finds, but for its object's."""
    found = []
    if not is_searchable(finder.model):
        return None
    for candidate in finder.others(picture.image, fitter.model.response, PLACES):
        result = fitter.fit(picture.image, candidate)
        error = point_error(result.landmarks, picture.points) / diagonal_of(picture.points)
        if error > WRONG and not result.status.lost and np.isfinite(result.evidence).all():
            found.append(result.evidence)
    return max(found, key=lambda evidence: evidence[0], default=None)


def _surprise(error: np.ndarray, spread: np.ndarray) -> float:
    """Mean square of p's error (n_p,) in units of what a fit states of it, the covariance (n_q, n_q): 1 if it is so.

    NaN of a covariance that has no inverse.
    """
    n_p = len(error)
    try:
        return float(error @ np.linalg.solve(spread[:n_p, :n_p], error)) / n_p
    except np.linalg.LinAlgError:
        return np.nan


def _understated(surprises: np.ndarray) -> float:
    """Factor on stated variances that the surprises of left-out pictures (m,) ask for on the whole; few are doubted."""
    logs = np.log(np.maximum(surprises[np.isfinite(surprises)], 1e-6))
    return float(np.clip(np.exp(logs.sum() / (len(logs) + SHRINK)), 1.0, MOST_UNDERSTATED))


def _landmarks(errors: np.ndarray, spreads: np.ndarray) -> np.ndarray:
    """Covariance (n, 2, 2) that explains the errors (m, n, 2) beyond what fits state, the spreads (m, n, 2, 2)."""
    beyond = np.einsum("mna,mnb->nab", errors, errors) / len(errors) - spreads.mean(axis=0)
    values, vectors = np.linalg.eigh(beyond)
    return _widened(np.einsum("nai,ni,nbi->nab", vectors, np.maximum(values, 0.0), vectors), len(errors))


def _widened(moments: np.ndarray, m: int) -> np.ndarray:
    """Second moments (n, 2, 2) of m errors, drawn towards those of all landmarks and widened for what is to come."""
    pooled = 0.5 * float(np.trace(moments, axis1=1, axis2=2).mean()) * np.eye(2)
    return (m * moments + SHRINK * pooled) / (m + SHRINK) * (1.0 + TAIL / (m + STEADY))


def _by_shape(model: AAM) -> np.ndarray:
    """Covariance (n, 2, 2) that shapes left out tell; of pictures whose fits are lost, fits themselves tell nothing."""
    unexplained = model.views[METHODS[DEFAULT_METHOD].view].shape_model.unexplained
    nothing = np.zeros((model.n_points, 2, 2))
    return nothing if unexplained is None else _widened(unexplained, model.n_images)


def _larger(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The one of two covariances (n, 2, 2) with the larger trace, landmark by landmark."""
    traces = [np.trace(each, axis1=1, axis2=2) for each in (a, b)]
    return np.where((traces[0] >= traces[1])[:, None, None], a, b)


def _weights(evidence: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Log odds (3,) by the evidence (m, 2); a strange shape may not speak for a fit, which chance can have it do."""
    # A fit that explains nothing is wrong, whether or not one was seen.
    evidence = np.concatenate([evidence, [[0.0, float(np.median(evidence[:, 1]))]]])
    right = np.append(right, False)
    weights = _logistic(evidence, right)
    return weights if weights[2] <= 0 else np.append(_logistic(evidence[:, :1], right), 0.0)


def _logistic(features: np.ndarray, right: np.ndarray, ridge: float = 0.5, steps: int = 50) -> np.ndarray:
    """Weights (1 + k,) of a logistic regression on (1, features (m, k)), both answers counted alike, with a ridge."""
    middle, scale = features.mean(axis=0), features.std(axis=0) + 1e-6
    x = np.column_stack([np.ones(len(right)), (features - middle) / scale])
    # As if of as many wrong as right ones.
    share = np.where(right, 0.5 / max(right.sum(), 1), 0.5 / max((~right).sum(), 1)) * len(right)
    w = np.zeros(x.shape[1])
    penalty = ridge * np.diag([1e-3] + [1.0] * features.shape[1])
    for _ in range(steps):
        p = 1.0 / (1.0 + np.exp(-np.clip(x @ w, -30, 30)))
        hessian = (x * (share * p * (1 - p) + 1e-9)[:, None]).T @ x + penalty
        w = w - np.linalg.solve(hessian, x.T @ (share * (p - right)) + penalty @ w)
    slopes = w[1:] / scale
    return np.concatenate([[w[0] - slopes @ middle], slopes])
