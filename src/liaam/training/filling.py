"""Estimate the missing landmarks of training images from the others, by expectation maximisation.

Aligned shapes have a normal distribution whose covariance is that of :mod:`liaam.model.shape_prior`: the sample
covariance mixed with smooth deformations and the noise of annotation, in the proportions that make left-out shapes most
likely. This is the largest posterior density under an inverse Wishart prior. Given the covariance, the expected
positions of the missing landmarks and their covariances follow from the landmarks that are known, and given these the
covariance follows (Tipping and Bishop, J. R. Stat. Soc. B 61, 1999, with another covariance than their W W' + s^2 I).

Position, size and rotation have a flat prior, so an image is aligned by the landmarks that it has.

Of fly wings, cephalograms and shells, the positions are off by 0.5 to 1.1 times as much as those of the mean shape, and
by less than with W W' + s^2 I in 34 of 36 cases (experiments/notes/missing-landmarks.md).
"""

from collections.abc import Sequence

import numpy as np

from liaam.model.missing import Missing
from liaam.model.shape import align, deviations_from, diagonal_of, procrustes_mean
from liaam.model.shape_prior import Deviations, SmoothPrior, covariance, fit_prior
from liaam.progress import Progress

FEWEST_KNOWN = 3  # Fewest known landmarks of an image, of which the others can be estimated
COMMON = 2  # Fewest landmarks that two images must share to be aligned
# Number of times that the proportions of the covariance are chosen anew, and of steps with each; they end when no
# landmark moves by more than STILL of its shape's diagonal.
ROUNDS = 3
STEPS = 15
STILL = 1e-4
LEAST_NOISE = 1e-12  # Least variance of a coordinate, of a mean shape of norm 1: shapes may be copies of each other


def filled(
    shapes: np.ndarray, folds: Sequence[np.ndarray], progress: Progress | None = None
) -> tuple[np.ndarray, Missing]:
    """Estimate the missing landmarks of shapes.

    Parameters
    ----------
    shapes : (m, n, 2) float64
        NaN where missing. Each shape has at least three landmarks, each landmark is known in a shape, and the shapes
        are linked by common landmarks (:func:`is_enough`).
    folds : sequence of int arrays
        Shapes that are left out together, such as those of one object.
    progress : callable, optional
        Called with (done, total, what) before each step.

    Returns
    -------
    shapes : (m, n, 2) float64
        All landmarks; those that are known are unchanged.
    missing : Missing
        Which are estimates, and how uncertain these are.
    """
    known = np.asarray(~np.isnan(shapes).any(axis=2))
    incomplete = np.flatnonzero(~known.all(axis=1))
    factors = [np.zeros((0, *shapes.shape[1:])) for _ in shapes]
    shapes = _placed_on_mean(shapes)
    mean = procrustes_mean(shapes)
    for i_round in range(ROUNDS):
        prior = None
        for i_step in range(STEPS):
            if progress:
                progress(i_round * STEPS + i_step, ROUNDS * STEPS, "missing landmarks")
            deviations = deviations_from(mean, shapes, missing=Missing(known, tuple(factors)))
            prior = prior or fit_prior(deviations, folds)
            precision = _precision(deviations, prior)
            mean = mean + deviations.own.mean(axis=0).reshape(-1, 2)
            moved = 0.0
            for i in incomplete:
                expected, factors[i] = _expected(shapes[i], known[i], mean, precision)
                moved = max(moved, float(np.abs(expected - shapes[i]).max()) / diagonal_of(expected))
                shapes[i] = expected
            if moved < STILL:
                break
    return shapes, Missing(known, tuple(factors))


def _placed_on_mean(shapes: np.ndarray) -> np.ndarray:
    """Place the missing landmarks (NaN) of shapes (m, n, 2) where the mean of all, aligned by similarity, has them."""
    known = ~np.isnan(shapes).any(axis=2)
    # Begin with the shape that has most landmarks, and add those that can be aligned to what there is already.
    start = shapes[known.sum(axis=1).argmax()].copy()
    while np.isnan(start).any():
        has = ~np.isnan(start).any(axis=1)
        alike = shapes[(known & has).sum(axis=1) >= COMMON]
        aligned = np.array([align(shape, start)(shape) for shape in alike])
        counts = (~np.isnan(aligned)).sum(axis=0)
        means = np.nansum(aligned, axis=0) / np.where(counts > 0, counts, np.nan)
        start = np.where(np.isnan(start), means, start)
    complete = np.where(np.isnan(shapes), [align(start, shape)(start) for shape in shapes], shapes)
    mean = procrustes_mean(complete)
    return np.where(np.isnan(shapes), [align(mean, shape)(mean) for shape in shapes], shapes)


def _precision(deviations: Deviations, prior: SmoothPrior) -> np.ndarray:
    """Inverse of the shapes' covariance with its noise, (2 n, 2 n): 0 along the similarities, whose prior is flat."""
    spread = covariance(deviations, prior)
    size = np.trace(deviations.sample_covariance()) / deviations.dimension
    noise = max(prior.noise * size, LEAST_NOISE)
    similar = deviations.rigid.T @ deviations.rigid
    scale = size + noise
    inverse = np.linalg.inv(spread + noise * (np.eye(len(spread)) - similar) + scale * similar)
    return inverse - similar / scale


def _expected(
    shape: np.ndarray, known: np.ndarray, mean: np.ndarray, precision: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a shape (n, 2) with the expected positions of its missing landmarks, and the factors of their covariance.

    The shapes have this mean (n, 2) and precision (2 n, 2 n).
    """
    pose = align(shape, mean)
    is_known = np.repeat(known, 2)
    deviation = (pose(shape) - mean).ravel()[is_known]
    within = precision[np.ix_(~is_known, ~is_known)]
    across = precision[np.ix_(~is_known, is_known)]
    # Conditional mean and covariance of a normal distribution, from its inverse covariance.
    uncertain = np.linalg.inv(0.5 * (within + within.T))
    unposed = pose.inverse()
    expected = shape.copy()
    expected[~known] = unposed(mean[~known] - (uncertain @ across @ deviation).reshape(-1, 2))
    values, vectors = np.linalg.eigh(uncertain)
    displacements = (np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T).reshape(len(values), -1, 2)
    factors = np.zeros((len(values), *shape.shape))
    factors[:, ~known] = displacements @ unposed.matrix.T
    return expected, factors


def is_enough(known: np.ndarray) -> bool:
    """Whether missing landmarks of shapes can be estimated from these shapes alone, by which are known, (m, n) bool."""
    return bool(known.any(axis=0).all()) and len(unlinked(known)) == 1


def unlinked(known: np.ndarray) -> list[np.ndarray]:
    """Group images, whose known landmarks are given, (m, n) bool, that no common landmarks align to each other.

    Two images are linked if they share two landmarks, or by images between them. Return the indices of the images of
    each group, the largest first: one group if all is well.
    """
    from scipy.sparse.csgraph import connected_components  # heavy: imported when first needed

    counts = known.astype(int)
    _, labels = connected_components(counts @ counts.T >= COMMON, directed=False)
    groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    return sorted(groups, key=len, reverse=True)
