"""Robust deviations and locations, and standard errors by the jackknife, for all calibrations."""

import numpy as np


def robust_deviation(values: np.ndarray) -> float:
    """Standard deviation of Gaussian values about 0 with outliers, from their median magnitude."""
    return float(1.4826 * np.median(np.abs(values)))


def huber_location(values: np.ndarray, cutoff: float = 1.5) -> tuple[float, float]:
    """Huber's estimate of location and its standard error; the cutoff is in standard deviations."""
    from scipy.optimize import least_squares  # heavy: imported when first needed

    deviations, n = values - np.median(values), len(values)
    # The median deviation may be 0, since half of a few values can be equal. The mean deviation bounds it from
    # below; the standard deviation would let a single outlier widen the scale.
    scale = max(robust_deviation(deviations), 0.25 * float(np.abs(deviations).mean()), 1e-9)
    found = least_squares(lambda centre: (values - centre) / scale, [np.median(values)], loss="huber", f_scale=cutoff)
    psi = np.clip(found.fun, -cutoff, cutoff)
    inside = max(float((np.abs(found.fun) < cutoff).mean()), 0.1)
    return float(found.x[0]), scale * float(np.sqrt(np.square(psi).sum() / (n - 1) / n)) / inside


def jackknife(replicates: np.ndarray) -> np.ndarray:
    """Covariance of an estimate from its replicates (k, ...) that leave out one of k groups each."""
    return (len(replicates) - 1) * np.cov(replicates.T, bias=True)


def in_normal_units(error: float, degrees: float) -> float:
    """Half of the 95 % interval by Student's t, divided by 1.96: a standard error that allows for few degrees."""
    from scipy.stats import t  # heavy: imported when first needed

    return error * float(t.ppf(0.975, degrees)) / 1.96
