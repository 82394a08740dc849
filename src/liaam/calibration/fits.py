"""The angle of a camera, pooled over fits of a model."""

from collections.abc import Iterable

import numpy as np

from liaam.calibration.estimate import WIDEST_ERROR, AngleEstimate, axis_difference
from liaam.errors import CameraError
from liaam.fitting import FitResult, FitStatus

FEWEST_FITS = 5
"""Fits that a pooled angle needs at least."""

HUBER = 1.5
"""Scale of Huber's loss for the pooled angle, in standard deviations."""


def theta_from_fits(results: Iterable[FitResult]) -> AngleEstimate:
    """Angle of a camera pooled over fits that estimate it (methods ``li-pc`` and ``li-pcs``; paper section 2.2).

    Each fit's own covariance knows nothing of what the model cannot explain, so the error is taken from how much
    the fits differ; a few that went wrong are outliers to Huber's loss.

    Parameters
    ----------
    results : iterable of FitResult
        Fits of pictures of one camera under lights that differ from the training light.

    Returns
    -------
    AngleEstimate
        ``light_change`` is NaN: fits do not tell it.

    Raises
    ------
    CameraError
        If the fits do not estimate a free angle.
    """
    results, nan = list(results), float("nan")
    if any(result.method.free_angles not in ("both", "shared") for result in results):
        raise CameraError(
            "to pool a camera's angle, fit with method li-pcs (one camera) or li-pc (another one trained)"
        )
    told = [r for r in results if r.status is FitStatus.CONVERGED and np.isfinite(r.theta)]
    unseen = sum(r.status is FitStatus.LIGHT_UNOBSERVABLE for r in results)
    left = f"{len(results) - len(told)} of {len(results)} fits tell no angle ({unseen} saw no change of light)"
    if len(told) < FEWEST_FITS:
        message = f"{left}; at least {FEWEST_FITS} are needed: fit more pictures, under lights other than in training"
        return AngleEstimate(nan, float("inf"), message, nan, len(told))
    angles = np.array([r.theta for r in told])
    centre = float(np.angle(np.exp(2j * angles).mean()) / 2 % np.pi)  # only up to a half turn
    offset, error = _huber_location(np.array([axis_difference(angle, centre) for angle in angles]))
    from scipy.stats import t  # heavy: imported when first needed

    theta, spread = (centre + offset) % np.pi, np.rad2deg(error * np.sqrt(len(told)))
    error *= float(t.ppf(0.975, len(told) - 1)) / 1.96
    message = f"{len(told)} fits differ by {spread:.2f}°; {left}"
    if error > WIDEST_ERROR:
        return AngleEstimate(theta, float("inf"), f"{message}: too much", nan, len(told))
    return AngleEstimate(theta, error, message, nan, len(told)).doubted()


def _huber_location(values: np.ndarray) -> tuple[float, float]:
    """Huber's estimate of location and its standard error."""
    centre = float(np.median(values))
    # The median deviation may be 0, since half of a few values can be equal. The mean deviation bounds it from
    # below; the standard deviation would let a single outlier widen the scale.
    deviations = np.abs(values - centre)
    scale = max(1.4826 * float(np.median(deviations)), 0.25 * float(deviations.mean()), 1e-9)
    for _ in range(50):
        moved = float(np.clip((values - centre) / scale, -HUBER, HUBER).mean() * scale)
        centre += moved
        if abs(moved) < 1e-12:
            break
    u = (values - centre) / scale
    inside = float((np.abs(u) < HUBER).mean())
    psi = np.clip(u, -HUBER, HUBER)
    n = len(values)
    return centre, scale * float(np.sqrt(np.square(psi).sum() / (n - 1) / n)) / max(inside, 0.1)
