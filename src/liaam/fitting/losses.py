"""Robust losses as weights of iteratively re-weighted least squares.

Theobald, Matthews and Baker, "Evaluating error functions for robust active appearance models", FG 2006 (the
paper's [12]), compare them for AAMs. Residuals in standard deviations are mapped to weights in [0, 1]. The constants of
huber, cauchy, geman-mcclure and tukey are the usual ones, with which Gaussian residuals lose 5 % of efficiency (a ratio
of variances); under l1 and learnt they lose a third.
"""

LOSSES = ("huber", "l1", "cauchy", "geman-mcclure", "tukey", "learnt")
"""Losses by name, in the order of :func:`liaam.fitting.weights.loss_weight`. ``learnt`` weighs a residual by the
density that a Gaussian, learnt for each pixel from pictures without occlusion, gives it: the best of the eight in the
paper cited above."""


def gaussian_median(k: int) -> float:
    """Median of the size of k unit normals, root mean square: 1 / 1.4826 for one."""
    from scipy.special import gammaincinv

    # Half of the sums of k squares of unit normals lie below this (the median of chi-squared).
    return float((2.0 * gammaincinv(k / 2, 0.5) / k) ** 0.5)
