"""Estimate the angle of a camera from fits of a model."""

from collections.abc import Iterable

import numpy as np

from liaam.calibration.estimate import WIDEST_ERROR, AngleEstimate, axis_difference, huber_location, in_normal_units
from liaam.errors import CameraError
from liaam.fitting import FitResult, FitStatus

FEWEST_FITS = 5  # Least number of fits for a pooled angle


def theta_from_fits(results: Iterable[FitResult]) -> AngleEstimate:
    """Pool the camera's angle over fits that estimate it (methods ``li-pc`` and ``li-pcs``; paper section 5).

    The covariance of a single fit ignores model errors, so the standard error is estimated from the spread of the fits.
    Huber's loss reduces the weight of wrong fits.

    Parameters
    ----------
    results : iterable of FitResult
        Fits to images of one camera under lights that differ from the training light.

    Returns
    -------
    AngleEstimate
        ``light_change`` is NaN, since fits do not estimate it.

    Raises
    ------
    CameraError
        If the fits do not estimate a free angle.
    """
    results = list(results)
    nan = float("nan")
    if any(result.method.free_angles not in ("both", "shared") for result in results):
        raise CameraError(
            "to pool a camera's angle, fit with method li-pcs (one camera) or li-pc (another one trained)"
        )
    used = [r for r in results if r.status is FitStatus.CONVERGED and np.isfinite(r.theta)]
    unobservable = sum(r.status is FitStatus.LIGHT_UNOBSERVABLE for r in results)
    unused = f"{len(used)} of {len(results)} fits give an angle ({unobservable} of the others see no change of light)"
    remedy = "fit more images, under lights other than in training"
    if len(used) < FEWEST_FITS:
        message = f"{unused}, and at least {FEWEST_FITS} must: {remedy}"
        return AngleEstimate(nan, float("inf"), message, nan, len(used))
    angles = np.array([r.theta for r in used])
    centre = float(np.angle(np.exp(2j * angles).mean()) / 2 % np.pi)  # angles have a period of pi
    offset, error = huber_location(np.array([axis_difference(angle, centre) for angle in angles]))
    theta = (centre + offset) % np.pi
    spread = np.rad2deg(error * np.sqrt(len(used)))
    error = in_normal_units(error, len(used) - 1)
    message = f"the angles of {len(used)} fits have a standard deviation of {spread:.2f}°; {unused}"
    if error > WIDEST_ERROR:
        message = f"{message}: the standard error is too large; {remedy}"
        return AngleEstimate(theta, float("inf"), message, nan, len(used))
    return AngleEstimate(theta, error, message, nan, len(used)).with_warning()
