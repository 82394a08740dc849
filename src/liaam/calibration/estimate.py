"""Estimate of the camera's angle with its standard error, and robust statistics for all calibrations."""

from dataclasses import dataclass, replace

import numpy as np

from liaam.error_measures import angle_difference

# Angles of physical cameras, radians (docs/explanation/how-it-works.md)
PHYSICAL = (float(np.deg2rad(90.0)), float(np.deg2rad(135.0)))
WIDEST_ERROR = float(np.deg2rad(8.0))  # Standard error above which an angle counts as unobservable, radians


def axis_difference(angle: float, other: float) -> float:
    """Difference of two angles, radians in (-pi/2, pi/2], since the angle of a projection has a period of pi."""
    return 0.5 * angle_difference(2.0 * angle, 2.0 * other)


@dataclass(frozen=True)
class AngleEstimate:
    """Estimate of the angle of the invariant projection.

    Attributes
    ----------
    theta : float
        Radians in [0, pi).
    standard_error : float
        Half the width of the 95 % interval divided by 1.96, radians; infinite if the angle is not observable.
    message : str
        Why the angle is observable, or the missing data and the remedy.
    light_change : float
        Root mean square difference of the lights' colour temperatures, as the change of log(R / B).
    n : int
        Number of surfaces (patches, blocks of pixels) used.
    """

    theta: float
    standard_error: float
    message: str
    light_change: float
    n: int

    @property
    def observable(self) -> bool:
        """Whether the data determine the angle."""
        return bool(np.isfinite(self.standard_error))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, radians; (0, pi) if the angle is not observable."""
        if not self.observable:
            return 0.0, float(np.pi)
        return self.theta - 1.96 * self.standard_error, self.theta + 1.96 * self.standard_error

    @property
    def physical(self) -> bool:
        """Whether the interval contains the angle of a physical camera."""
        slack = 2.0 * self.standard_error if self.observable else np.pi
        return bool(PHYSICAL[0] - slack <= self.theta <= PHYSICAL[1] + slack)

    def with_warning(self) -> "AngleEstimate":
        """Return the estimate, with a warning in the message if the angle is not physical."""
        if self.physical:
            return self
        warning = (
            "; but no physical camera has this angle (90 to 135 degrees): check that all images have one white balance "
            "and response, and show the same surfaces"
        )
        return replace(self, message=self.message + warning)


def robust_deviation(values: np.ndarray) -> float:
    """Standard deviation of Gaussian values about 0 with outliers, from their median magnitude."""
    return float(1.4826 * np.median(np.abs(values)))


def huber_location(values: np.ndarray, cutoff: float = 1.5) -> tuple[float, float]:
    """Huber's estimate of location and its standard error; the cutoff is in standard deviations."""
    from scipy.optimize import least_squares  # heavy: imported when first needed

    deviations = values - np.median(values)
    n = len(values)
    # The median deviation may be 0, since half of a few values can be equal. The mean deviation bounds it from
    # below; the standard deviation would let a single outlier widen the scale.
    scale = max(robust_deviation(deviations), 0.25 * float(np.abs(deviations).mean()), 1e-9)
    optimum = least_squares(lambda centre: (values - centre) / scale, [np.median(values)], loss="huber", f_scale=cutoff)
    psi = np.clip(optimum.fun, -cutoff, cutoff)
    inside = max(float((np.abs(optimum.fun) < cutoff).mean()), 0.1)
    return float(optimum.x[0]), scale * float(np.sqrt(np.square(psi).sum() / (n - 1) / n)) / inside


def jackknife(replicates: np.ndarray) -> np.ndarray:
    """Covariance of an estimate from its replicates (k, ...) that leave out one of k groups each."""
    return (len(replicates) - 1) * np.cov(replicates.T, bias=True)


def in_normal_units(error: float, degrees: float) -> float:
    """Half of the 95 % interval by Student's t, divided by 1.96: a standard error that allows for few degrees."""
    from scipy.stats import t  # heavy: imported when first needed

    return error * float(t.ppf(0.975, degrees)) / 1.96
