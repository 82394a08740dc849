"""The evidence that a fit is right: the features of its quality (docs/explanation/uncertainty.md).

Training learns the weight of each in the log odds that a fit is right (``liaam.model.Reliability.weights``). Another
feature is another row of :data:`FEATURES`, and one more in :data:`liaam.model.views.N_QUALITY_FEATURES`. Models that
were trained without it give it no weight.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from liaam.encoding_constants import GRADIENTS
from liaam.fitting.loop.levels import FittedLevel
from liaam.fitting.loop.objective import Objective

# Fraction of the contrast that a fit must explain, as a multiple of what its number of parameters explains of white
# noise (experiments/notes/engine.md)
BY_CHANCE = 4.0
MOST_BY_CHANCE = 0.25  # Upper limit of that fraction


@dataclass(frozen=True)
class Feature:
    """A feature of the quality.

    Attributes
    ----------
    name : str
    of : callable
        Computes it from the last level of a fit, and the doubt of the model's regressor (:func:`quality_features`).
    sign : int
        1 if much of it may only speak for a fit, -1 if only against it.
    worst : float
        Its value if the residual is not finite.
    """

    name: str
    of: Callable[[FittedLevel, float], float]
    sign: int
    worst: float


def explained_contrast(stage: FittedLevel, _doubt: float) -> float:
    """Return the explained fraction of the image's contrast, minus a penalty for an unlikely appearance.

    It is multiplied by the square root of the contrast, so that a blurred or partly visible object counts little.
    """
    objective = stage.objective
    contrast, left = _contrast(objective, stage.solution.contrast)
    unlikely = float(objective.fields["ridge"] @ np.square(stage.solution.lam))
    # The mean over all of the model's pixels: unusable and absent ones count as unexplained.
    strength = np.sqrt(contrast / max(objective.n_usable, 1e-9))
    explained = (1.0 - (left + unlikely) / contrast) * strength if contrast > 0 else -1.0
    return max(explained, -1.0)


def distance_from_mean(stage: FittedLevel, doubt: float) -> float:
    """Return the distance of the shape from the mean, log(1 + mean squared mode in standard deviations).

    Added to that square is the doubt of the model's regressor.
    """
    objective = stage.objective
    squared_modes = np.square(stage.solution.p) * objective.prior
    n_modes = objective.warp.n_parameters - 4  # without the similarity
    mean_square = squared_modes[:n_modes].mean() if n_modes > 0 else 0.0
    return np.log1p(min(mean_square + doubt, 1e6))


FEATURES = (
    Feature("explained contrast", explained_contrast, sign=1, worst=-1.0),
    Feature("distance from the mean shape", distance_from_mean, sign=-1, worst=14.0),  # about log(1 + 1e6)
)
"""The features, in the order of :attr:`liaam.FitResult.evidence`. The first says what a fit explains: it is 0 for
nothing, and the quality must increase with it."""


def quality_features(stage: FittedLevel, doubt: float = 0.0) -> np.ndarray:
    """Compute the features that separate right fits from wrong ones, (k,) float64, in the order of :data:`FEATURES`.

    ``doubt`` is the squared distance of the model's regressor from the shape, in its mean squared error.
    """
    _, left = _contrast(stage.objective, stage.solution.contrast)
    if not np.isfinite(left):
        return np.array([feature.worst for feature in FEATURES])
    return np.array([feature.of(stage, doubt) for feature in FEATURES])


def explains_more_than_noise(stage: FittedLevel) -> bool:
    """Return whether a fit explains more of its image, under its own weights, than it would of noise."""
    objective = stage.objective
    solution = stage.solution
    contrast, left = _contrast(objective, solution.weighted_contrast)
    n_parameters = objective.n_q + objective.n_lambda
    by_chance = BY_CHANCE * n_parameters * objective.correlated / max(solution.n_counted, 1)
    return left < (1.0 - min(by_chance, MOST_BY_CHANCE)) * contrast


def _contrast(objective: Objective, sums: np.ndarray) -> tuple[float, float]:
    """Return the weighted squares of a fit's samples and of its residual, over the rows that count.

    For ``soft-li`` these are the gradients. Values and logarithms count relative to their mean. ``sums`` (rows, 4) are
    those of weights, samples, their squares, and squares of the residual.
    """
    weight, total, squares, left = sums.T
    if objective.method.encoding_name not in (*GRADIENTS, "features"):
        about_mean = squares - total**2 / np.maximum(weight, 1e-300)
        squares = np.where(about_mean > 1e-9 * squares, about_mean, 0.0)  # else it is rounding
    return float(squares.sum()), float(left.sum())
