"""How far each pixel is trusted: weights by noise, by the model's errors, or by a robust loss (docs/theory.md).

They are worked out between iterations and frozen within one (:meth:`liaam.fitting.objective.Objective.trust`).
"""

from dataclasses import dataclass

import numpy as np

from liaam.fitting.losses import LOSSES, robust_scale
from liaam.fitting.normal_equations import regular_inverse
from liaam.fitting.problem import LOGS, FitProblem, Look
from liaam.kernels import get_kernel
from liaam.photometry.encoding import BRIGHTNESS, LOG_FLOOR, SOFTNESS


@dataclass(frozen=True, eq=False)
class Weighted:
    """Model side under weights that do not turn with an angle: worked out once for all iterations they are used in.

    Attributes
    ----------
    root : (n_pixels, k) float32
        Root of the weights.
    aa : (m, m) float64
        Gram matrix of the weighted modes.
    inverse : (m, m) float64
        Its inverse.
    """

    root: np.ndarray
    aa: np.ndarray
    inverse: np.ndarray


@dataclass(frozen=True, eq=False)
class Trust:
    """How far each pixel is trusted: worked out between iterations, frozen within one.

    Attributes
    ----------
    weights : (n_pixels,) float32
        By the robust loss; 1 without one.
    noise : (n_pixels, c) float, optional
        Variance of the encoded channels by the image's noise.
    model : (n_pixels, 1) or (1, k) float, optional
        Variance of the residual by the model's errors; goes with ``noise``.
    unit : float
        Variance that weighs 1: weights are 1 on average, so that a cost is the variance of such a residual.
    gain, offset : float
        Normalisation of the image's samples: they are compared as gain * E(I) + offset.
    unexplained : tuple of float
        Variance of the model's errors by group of rows, where it is estimated so.
    silent : (n_pixels,) bool, optional
        Pixels whose logarithm says nothing, where that is known.
    weighted : Weighted, optional
        The model side under these weights, where they hold for every angle.
    """

    weights: np.ndarray
    noise: np.ndarray | None = None
    model: np.ndarray | None = None
    unit: float = 1.0
    gain: float = 1.0
    offset: float = 0.0
    unexplained: tuple[float, ...] = ()
    silent: np.ndarray | None = None
    weighted: Weighted | None = None

    def variance(self, metric: np.ndarray) -> np.ndarray | None:
        """Variance of the residual in each row of P, (n_pixels, k); None where it is not modelled."""
        if self.noise is None or self.model is None:
            return None
        return self.noise @ np.square(metric).T.astype(self.noise.dtype) + self.model


SOFT_ROWS = ((slice(0, 2), 8.0), (slice(2, 3), 30.0))
"""Rows of the metric ``soft`` whose unexplained part is alike, and by how much more it is correlated than the blur
makes noise: model errors are patches, not grains, and those of colour are the widest."""

UNKNOWN = 1e5
"""Variance that stands for a pixel whose logarithm says nothing."""

LEAST_UNEXPLAINED = 0.02
"""Share of the residual's variance that is never put down to noise."""

MOST_DIRECTION_NOISE = 0.5
"""Variance of each component of a direction that says nothing."""


ALIKE = 0.2
"""Relative change of a variance below which pixels are not weighed anew."""


MOVED = 0.02
"""Share of the pixels that may have come to say something, or ceased to, before they are weighed anew."""

FACTORS = np.concatenate([[0.0], np.geomspace(1e-3, 30.0, 19)])


def weigh(kernel: str, modes: np.ndarray, root: np.ndarray) -> Weighted:
    """Gram matrix of modes (m, n * k) under weights (n, k), and its inverse."""
    aa = get_kernel(kernel).weighted_gram(modes, root)
    return Weighted(root, aa, regular_inverse(aa))


@dataclass(frozen=True, eq=False)
class SoftRows:
    """Rows of a soft method as noise sees them.

    Attributes
    ----------
    metric : (k, 6) float64
    tied : float
        Pixels looked at that stand for one independent residual.
    own : (n_pixels, k) float32
        Root of the model's own weights.
    colours : bool
        Whether the model knows colours.
    """

    metric: np.ndarray
    tied: float
    own: np.ndarray
    colours: bool


def soft_trust(
    kernel: str, problem: FitProblem, look: Look, rows: SoftRows, before: Trust | None
) -> tuple[Trust, np.ndarray] | None:
    """Variance by noise and by what the model leaves unexplained, both as strong as their correlation makes them.

    What is unexplained is alike within the gradient's rows and within the invariant's, and is what the residual at
    hand has beyond noise: where the light is as in training the invariant is precise, where it is not, or where
    colours carry JPEG's errors, it steps back behind the gradient, and the other way round in noise.

    Returns
    -------
    trust : Trust
    roots : (n_pixels, k) float32
        Root of the weights; None for both where no pixel counts, or little has changed since ``before``.
    """
    kernels, tied = get_kernel(kernel), rows.tied
    noise, by_noise, sums = kernels.soft_variances(
        look.values,
        look.residual,
        look.weights * rows.own[:, 0],
        np.square(rows.metric),
        problem.relative_noise,
        LOGS,
        (problem.noise_left, problem.slope_left),
        SOFTNESS,
        LOG_FLOOR,
        BRIGHTNESS,
        UNKNOWN,
        MOST_DIRECTION_NOISE,
        rows.colours,
    )
    silent, (model, found) = noise[:, 2] >= UNKNOWN, _unexplained_rows(sums)
    if not sums[:, 0].any() or (before is not None and _alike(before, silent, found)):
        return None
    roots, unit = kernels.soft_roots(by_noise, tied * model, tied, rows.own, look.weights)
    noise *= np.float32(tied)
    ones = np.ones(len(noise), np.float32)
    return Trust(ones, noise, tied * model[None], unit, unexplained=found, silent=silent), roots


def _unexplained_rows(sums: np.ndarray) -> tuple[np.ndarray, tuple[float, ...]]:
    """Variance of each row by the model's errors, correlation included, (k,), and what is found by group of rows."""
    model, found = np.empty(len(sums)), []
    for rows, correlated in SOFT_ROWS:
        count, squares, beyond = sums[rows].sum(axis=0)
        count = max(count, 1.0)
        found.append(max(beyond / count, LEAST_UNEXPLAINED * squares / count + 1e-9))
        model[rows] = correlated * found[-1]
    return model, tuple(found)


def _alike(before: Trust, silent: np.ndarray, unexplained: tuple[float, ...]) -> bool:
    """Tell whether soft weights have hardly changed: what is unexplained, and which pixels' logarithm says nothing."""
    if before.silent is None or len(before.unexplained) != len(unexplained):
        return False
    if any(not abs(np.log(now / then)) < ALIKE for now, then in zip(unexplained, before.unexplained, strict=True)):
        return False
    return bool(np.count_nonzero(before.silent != silent) < MOVED * len(silent))


def normalisation(mean: np.ndarray, samples: np.ndarray, usable: np.ndarray) -> tuple[float, float]:
    """Gain and offset that bring samples (n, k) to the mean and deviation of the model's mean, over usable pixels."""
    own, seen = mean[usable], samples[usable]
    spread = float(seen.std(dtype=np.float64))
    gain = float(own.std(dtype=np.float64)) / spread if spread > 1e-6 else 1.0
    return gain, float(own.mean(dtype=np.float64) - gain * seen.mean(dtype=np.float64))


def noise_variances(
    problem: FitProblem, look: Look, metric: np.ndarray, by_model: np.ndarray, usable: np.ndarray
) -> dict:
    """Variance by noise and by the model's errors, and the one that weighs 1.

    The model's errors are those of leaving one training image out (``by_model``, (n_pixels,)), times a factor that
    makes the residuals at hand most likely: nought where noise alone explains them.
    """
    relative = problem.relative_noise_of(np.exp(look.values.astype(np.float64)))
    # A blur averages noise away, but not what the logarithm's curvature makes of it: log(rho + n) is low by
    # up to half its relative variance on average.
    noise = np.square(problem.noise_left * relative) + np.square(0.5 * np.square(relative))
    by_noise = noise @ np.square(metric).mean(axis=0)
    squares = np.square(look.residual, dtype=np.float64).mean(axis=1)[usable]
    factor = _likeliest_factor(squares, by_noise[usable], by_model[usable])
    model = factor * by_model
    unit = float(1.0 / np.mean(1.0 / (by_noise + model)[usable]))
    return {"noise": noise, "model": model[:, None], "unit": unit}


def _likeliest_factor(squares: np.ndarray, by_noise: np.ndarray, by_model: np.ndarray) -> float:
    """Factor f for which squared residuals are most likely under variances by_noise + f * by_model."""
    variances = by_noise + FACTORS[:, None] * by_model + 1e-300
    cost = (np.log(variances) + squares / variances).mean(axis=1)
    return float(FACTORS[cost.argmin()])


def robust_weights(
    name: str, residual: np.ndarray, variance: np.ndarray | None, by_model: np.ndarray, usable: np.ndarray
) -> np.ndarray:
    """Weights by a loss, (n_pixels,) float32; of ``learnt`` by the variance of the model's errors (n_pixels,)."""
    loss = LOSSES[name]
    squares = np.square(residual, dtype=np.float64)
    sizes = np.sqrt(squares.mean(axis=1))
    if name == "learnt":
        # A picture under another light leaves more everywhere: the median pixel still counts.
        deviation = np.sqrt(by_model + 1e-12)
        u = sizes / deviation
        weights = loss(u / max(robust_scale(u[usable], residual.shape[1]), 1.0)) / deviation
        return (weights / max(weights[usable].mean(), 1e-300)).astype(np.float32)
    u = sizes if variance is None else np.sqrt((squares / variance).mean(axis=1))
    return loss(u / max(robust_scale(u[usable], residual.shape[1]), 1e-9)).astype(np.float32)
