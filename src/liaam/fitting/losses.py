"""Robust losses as weights of iteratively re-weighted least squares.

Theobald, Matthews and Baker, "Evaluating error functions for robust active appearance models", FG 2006 (the
paper's [12]), compare them for AAMs. Each function maps residuals in standard deviations to weights in
[0, 1]. The constants of huber, cauchy, geman-mcclure and tukey are the usual ones, with which Gaussian residuals lose
5 % of efficiency (a ratio of variances); under l1 and learnt they lose a third.
"""

from collections.abc import Callable

import numpy as np

Loss = Callable[[np.ndarray], np.ndarray]


def _huber(u: np.ndarray) -> np.ndarray:
    return 1.345 / np.maximum(u, 1.345)


def _l1(u: np.ndarray) -> np.ndarray:
    # Below a tenth of a standard deviation the weight stops growing.
    return 0.1 / np.maximum(u, 0.1)


def _cauchy(u: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.square(u / 2.385))


def _geman_mcclure(u: np.ndarray) -> np.ndarray:
    return 1.0 / np.square(1.0 + np.square(u / 3.65))


def _tukey(u: np.ndarray) -> np.ndarray:
    return np.square(np.maximum(1.0 - np.square(u / 4.685), 0.0))


def _gaussian(u: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * np.square(u))


LOSSES: dict[str, Loss] = {
    "huber": _huber,
    "l1": _l1,
    "cauchy": _cauchy,
    "geman-mcclure": _geman_mcclure,
    "tukey": _tukey,
    "learnt": _gaussian,
}
"""Weight functions by name. ``learnt`` weighs a residual by the density that a Gaussian, learnt for each pixel
from pictures without occlusion, gives it: the best of the eight in the paper cited above."""


def robust_scale(sizes: np.ndarray, k: int = 1) -> float:
    """Standard deviation of Gaussian residuals from the median of their sizes: 1.4826 times that for one row.

    Parameters
    ----------
    sizes : (n,) float
        Root mean squares over the k rows of each pixel's residual.
    k : int
    """
    from scipy.special import gammaincinv

    # Half of the sums of k squares of unit normals lie below this (the median of chi-squared).
    median = 2.0 * float(gammaincinv(k / 2, 0.5))
    return float(np.median(sizes) / np.sqrt(median / k)) if len(sizes) else 0.0
