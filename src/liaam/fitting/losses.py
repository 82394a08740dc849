"""Robust losses as weights of iteratively reweighted least squares.

Theobald, Matthews and Baker, "Evaluating error functions for robust active appearance models", FG 2006 (the
paper's [12]), compare them for AAMs. A weight in [0, 1] is a function of the residual in standard deviations. The
constants of huber, cauchy, geman-mcclure and tukey give the usual efficiency of 95 % for Gaussian residuals; l1 and
learnt have two thirds.
"""

LOSSES = ("huber", "l1", "cauchy", "geman-mcclure", "tukey", "learnt")
"""Losses by name, in the order of :func:`liaam.fitting.weights.loss_weight`. ``learnt`` weighs a residual by its
density under a Gaussian learnt for each pixel from images without occlusion: the best of the eight in the paper cited
above."""


def gaussian_median(k: int) -> float:
    """Return the median root mean square of k standard normal variables; 1 / 1.4826 for one."""
    from scipy.special import gammaincinv

    # From the median of the chi-squared distribution.
    return float((2.0 * gammaincinv(k / 2, 0.5) / k) ** 0.5)
