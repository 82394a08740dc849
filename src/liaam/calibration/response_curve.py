"""A camera's response as an increasing spline of stored values, and what is known of it before any image is seen."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.photometry.response import Response, to_linear

LOWEST = 6 / 255  # Stored value at which the fitted curve starts; below it continues as a power law
# The curve is a spline of log((v + toe) / (top - v)), which resolves dark values and the shoulder finely
TOE, TOP = 0.02, 1.1
KNOTS = 17  # Number of equidistant knots of the spline
# Standard deviation (of log light) and correlation length (along the curve) of the prior's Gaussian process
SMOOTH, REACH = 0.3, 0.35


def _axis(stored: np.ndarray) -> np.ndarray:
    return np.log((stored + TOE) / (TOP - stored))


def evenly_along(count: int) -> np.ndarray:
    """Stored values (count,) from the lowest to 1, equidistant along the curve."""
    low, high = _axis(np.array([LOWEST, 1.0])).tolist()
    ratio = np.exp(np.linspace(low, high, count))
    return np.clip((TOP * ratio - TOE) / (1.0 + ratio), LOWEST, 1.0)


def _knots() -> np.ndarray:
    return np.pad(_axis(evenly_along(KNOTS)), 3, mode="edge")


def increments(stored: np.ndarray) -> np.ndarray:
    """Integrated B-splines (..., J) of stored values; a curve with positive coefficients is increasing."""
    from scipy.interpolate import BSpline  # heavy: imported when first needed

    knots = _knots()
    axis = np.clip(_axis(stored.ravel()), knots[0], knots[-1])
    splines = BSpline.design_matrix(axis, knots, 3).toarray()
    return np.cumsum(splines[:, ::-1], axis=1)[:, ::-1][:, 1:].reshape(*stored.shape, -1)


@dataclass(frozen=True)
class ResponseTable:
    """Table of the logarithm of light by stored value: (k,) each, increasing."""

    stored: np.ndarray
    light: np.ndarray

    @classmethod
    def of(cls, response: "Response | np.ndarray") -> "ResponseTable":
        """Tabulate a response, or a curve with given increments (J,)."""
        stored = evenly_along(1500)
        if isinstance(response, np.ndarray):
            return cls(stored, increments(stored) @ response)
        return cls(stored, np.log(np.asarray(to_linear(stored, response), dtype=np.float64)))

    def log_light(self, stored: np.ndarray) -> np.ndarray:
        """Logarithm of light."""
        return np.interp(stored, self.stored, self.light)

    def slope(self, stored: np.ndarray) -> np.ndarray:
        """Its derivative by the stored value."""
        return np.interp(stored, self.stored, np.gradient(self.light, self.stored))

    def stored_of(self, log_light: np.ndarray) -> np.ndarray:
        """The inverse of :meth:`log_light`."""
        return np.interp(log_light, self.light, self.stored)


@lru_cache(maxsize=1)
def prior_of_increments() -> tuple[np.ndarray, np.ndarray]:
    """Prior mean (J,) and covariance (J, J) of increments: tone curves v + v (1 - v) q(v), q quadratic, and powers."""
    stored = evenly_along(300)
    levels = np.linspace(-0.6, 0.6, 5)
    toned = [
        stored * (1 + (1 - stored) * (a + b * stored + c * stored**2)) for a in levels for b in levels for c in levels
    ]
    rising = [np.log(tone) for tone in toned if (np.diff(tone) > 0.1 * np.diff(stored)).all()]
    curves = np.stack([gamma * curve for curve in rising for gamma in (1.0, 1.8, 2.2, 2.6)], axis=1)
    design = increments(stored)
    family = np.linalg.lstsq(design - design.mean(axis=0), curves - curves.mean(axis=0), rcond=None)[0]
    knots = _knots()
    centres = np.array([knots[j + 1 : j + 4].mean() for j in range(design.shape[1] + 1)])
    along = (centres - centres[0]) / (centres[-1] - centres[0])
    smooth = SMOOTH**2 * np.exp(-0.5 * np.square((along[:, None] - along) / REACH)) + 1e-6 * np.eye(len(along))
    return family.mean(axis=1), np.cov(family) + np.diff(np.diff(smooth, axis=0), axis=1)
