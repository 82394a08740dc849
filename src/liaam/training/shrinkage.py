"""Shapes that vary as much as the objects do: the weight of the prior on the shape, and a factor on what is left.

A fit is a posterior mean: where the image says little, the prior pulls it to the mean shape, so that fitted shapes vary
less than the objects, and differences between groups are underestimated. With less of the prior they vary more, and so
do their errors. Left-out images say whether less of it is better at the finest level; coarser levels, which find the
object, have all of it. The rest is taken off by constrained empirical Bayes estimation (Louis 1984, Ghosh 1992): the
distances of the posterior means from the overall mean are multiplied by the factor that gives them the variance of the
truth, as far as the errors allow.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from liaam.fitting.loop.objective import PRIOR_OF_POSES
from liaam.model import AAM
from liaam.model.file_format import MOST_EXPANSION
from liaam.model.shape import align
from liaam.training.left_out_fits import LeftOutFit, LeftOutFits

# Weights of the prior at the finest level that are compared, all of it first. Of models of 40 cephalograms, wings and
# shells, the reliability of fits to other images (:func:`reliability`) is 0.67, 0.64 and 0.80 with 1; 0.68, 0.67 and
# 0.80 with 0.3; 0.66, 0.67 and 0.80 with 0.1, at larger errors. Faces under flashes need all of it.
FINAL_PRIORS = (1.0, 0.3)
# Difference of reliabilities, as a fraction of the best, that is chance between MANY left-out images, so that the
# weaker prior is taken. Between more images, less of a difference is chance.
CHANCE = 0.01
# Share of the factor's way from 1 to that of equal variances. The last tenths cost most: of refined fits to wings and
# cephalograms, 85 % of the variance costs 1 to 2 % in error, and all of it 6 %, part of which is noise of labels.
SHARE = 0.8
# Largest increase of the mean error of left-out fits, beyond that with all of the prior and without the factor: for so
# many fits or more; none for so few or fewer, which say little about it
MOST_INCREASE = 0.03
MANY = 20
FEW = 10
TRIED = 21  # Number of factors that are compared, from that of the share to 1


def prior_weights(model: AAM) -> tuple[float, ...]:
    """Return the weights of the prior on the shape that are compared for a model, the strongest first."""
    return FINAL_PRIORS if model.poses is None else (PRIOR_OF_POSES,)


def least_shrunk(candidates: Sequence[LeftOutFits]) -> LeftOutFits:
    """Return the best of a method's fits with several weights of the prior, the first all of it, expanded."""
    best = most_reliable(candidates)
    return best.expanded(expansion_of(best, candidates[0]))


def most_reliable(candidates: Sequence[LeftOutFits]) -> LeftOutFits:
    """Return the left-out fits of which most are right; of equal ones, the reliable ones with the weakest prior."""
    most_right = max(each.n_near_right for each in candidates)
    compared = [each for each in candidates if each.n_near_right == most_right]
    best = max(reliability(each) for each in compared)
    nearly = 1.0 - CHANCE * np.sqrt(MANY / max(candidates[0].n_near, MANY))
    return [each for each in compared if reliability(each) >= nearly * best][-1]


def reliability(fits: LeftOutFits) -> float:
    """Return the squared correlation of fitted and true shapes, as deviations from the mean shape; 0 without any."""
    moments = _moments(fits.near_right)
    if not moments.true * moments.fitted > 0.0:
        return 0.0
    return moments.common**2 / (moments.true * moments.fitted)


def expansion_of(fits: LeftOutFits, usual: LeftOutFits) -> float:
    """Return the factor, at least 1, on the distance of fitted shapes from the mean.

    That is :data:`SHARE` of the way to equal variances of fitted and true shapes. It is smaller if the mean error would
    exceed that of the ``usual`` fits, which have all of the prior, by more than :data:`MOST_INCREASE`.
    """
    moments = _moments(fits.near_right)
    if not moments.fitted > 0.0:
        return 1.0
    equal = float(np.sqrt(moments.true / moments.fitted))
    largest = float(np.clip(1.0 + SHARE * (equal - 1.0), 1.0, MOST_EXPANSION))
    most = _mean_error(usual.near_right) * (1.0 + MOST_INCREASE * evidence_of(usual.n_near))
    for factor in np.linspace(largest, 1.0, TRIED)[:-1].tolist():
        if _mean_error(fits.near_right, factor) <= most:
            return factor
    return 1.0


def evidence_of(n: int) -> float:
    """Return how much so many left-out images say: nothing, 0, if they are :data:`FEW`, and 1 if :data:`MANY`."""
    return float(np.clip((n - FEW) / (MANY - FEW), 0.0, 1.0))


def _mean_error(fits: Sequence[LeftOutFit], factor: float = 1.0) -> float:
    """Return the mean distance of fitted from true landmarks with a factor, pixels of the frame; NaN without fits."""
    errors = []
    for fit in fits:
        away = fit.landmarks_at(factor) - fit.truth
        errors.append(np.linalg.norm(away[fit.known], axis=1).mean())
    return float(np.mean(errors)) if errors else np.nan


class _Moments(NamedTuple):
    """Sums over fits and landmarks of squared deviations from the mean shape, and of products of both."""

    true: float
    fitted: float
    common: float


def _moments(fits: Sequence[LeftOutFit]) -> _Moments:
    true = 0.0
    fitted = 0.0
    common = 0.0
    for fit in fits:
        mean = fit.shapes.mean[fit.known]
        of_truth = _deviation(fit.truth[fit.known], mean)
        of_fit = _deviation(fit.landmarks[fit.known], mean)
        true += float(np.square(of_truth).sum())
        fitted += float(np.square(of_fit).sum())
        common += float((of_truth * of_fit).sum())
    return _Moments(true, fitted, common)


def _deviation(shape: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Return the difference of a shape (n, 2), aligned to a mean shape (n, 2), from that."""
    return align(shape, mean)(shape) - mean
