"""Robust least squares for response, vignetting and exposures; see :mod:`liaam.calibration.radiometry`.

The response is an increasing spline of stored values, with a prior of what is known before any image is seen.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.calibration.estimate import robust_deviation
from liaam.calibration.response_blocks import Blocks
from liaam.evaluation import root_mean_square
from liaam.photometry.camera import falloff_at
from liaam.photometry.encoding import DARK, SATURATED
from liaam.photometry.invariant import CHROMATICITY
from liaam.photometry.response import Response, to_linear

LOWEST = 6 / 255  # Stored value at which the fitted curve starts; below it continues as a power law
# The curve is a spline of log((v + toe) / (top - v)), which resolves dark values and the shoulder finely
TOE, TOP = 0.02, 1.1
KNOTS = 17  # Number of equidistant knots of the spline
# Standard deviation (of log light) and correlation length (along the curve) of the prior's Gaussian process
SMOOTH, REACH = 0.3, 0.35

# Assumed range of log light between the stored values 8 and 250 if the power is unknown, and its relative standard
# deviation: sRGB has 6.0, a gamma of 2.2 has 7.6
USUAL_RANGE, RANGE_SPREAD = 6.6, 0.15
TERMS = 3  # Number of vignetting coefficients: r^2, r^4, r^6
# Prior standard deviations of a vignetting coefficient, and of the logs of an image's white balance and exposure
TERM_SPREAD, BALANCE_SPREAD, EXPOSURE_SPREAD = 0.5, 0.1, 5.0
OUTLYING = 4.0  # Residual, in standard deviations, at which the weight is a quarter
MOST_STEPS = 40
# Lower bounds of the curve's increments, of the scale of the residuals, and of the relative light
LEAST_INCREMENT, LEAST_SCALE, LEAST_SHARE = 1e-3, 0.3, 0.1
EXACT = 1e-4  # Standard deviation of the assumed range of log light if the power is unknown
LEAST_CONTRAST = 0.1  # Least difference of log exposures for an estimate
# Largest residuals in log exposure of an estimate, if noise does not explain them and if it does
WORST_RMS, WORST_NOISE = 0.06, 0.3
# Standard error of log light and exposure by mixed light in blocks and clipped noise, from simulations
SYSTEMATIC = 1.5e-3
MISFIT = 4.0  # Ratio of residuals to noise above which noise does not explain them; JPEG of quality 75 gives 4 to 6


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


@dataclass(frozen=True)
class ResponseProblem:
    """The problem; its unknowns z (P,) are the free increments, exposures, white balances and vignetting coefficients.

    Log exposures (m,) and the response may be given; ``terms`` is the number of vignetting coefficients.
    """

    measured: Blocks
    known_logs: np.ndarray | None
    response: Response | None
    terms: int

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Numbers of free increments, exposures, white balances and vignetting coefficients."""
        increments = 0 if self.response is not None else len(prior_of_increments()[0])
        others = len(self.measured.stored) - 1
        colours = 2 * others if self.measured.channel.any() else 0
        return increments, 0 if self.known_logs is not None else others, colours, self.terms

    @property
    def power_known(self) -> bool:
        """Whether the response or ratios of exposures are given."""
        logs = self.known_logs
        return self.response is not None or (logs is not None and float(np.ptp(logs)) >= LEAST_CONTRAST)

    def split(self, z: np.ndarray) -> list[np.ndarray]:
        """Split z into increments, exposures, white balances and vignetting coefficients."""
        return np.split(z, np.cumsum(self.sizes)[:-1])

    def curve(self, z: np.ndarray) -> ResponseTable:
        """The response."""
        return ResponseTable.of(self.split(z)[0] if self.response is None else self.response)

    def logs(self, z: np.ndarray) -> np.ndarray:
        """Log exposures (m,)."""
        return np.concatenate([[0.0], self.split(z)[1]]) if self.known_logs is None else self.known_logs

    def exposure(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log of the factor of each block's light in each image (m, n), and its derivative by z (m, n, P)."""
        measured, (curve, logs, colours, falloff) = self.measured, self.split(z)
        m, n = measured.stored.shape
        share = light_share(measured.radius2, falloff)
        others = np.eye(m)[:, None, 1:]
        by_log = np.broadcast_to(others, (m, n, m - 1))[..., : len(logs)]
        by_colour = np.einsum("mop,nc->mnpc", others, CHROMATICITY.T[measured.channel]).reshape(m, n, -1)
        by_colour = by_colour[..., : len(colours)]
        by_falloff = np.stack([measured.radius2 ** (i + 1) for i in range(TERMS)], axis=-1)[..., : self.terms]
        by_falloff = by_falloff / share[..., None]
        value = self.logs(z)[:, None] + by_colour @ colours + np.log(share)
        return value, np.concatenate([np.zeros((m, n, len(curve))), by_log, by_colour, by_falloff], axis=-1)

    def linearised(self, z: np.ndarray, about: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linearise log radiance about stored values and the last z, as known (m, n) + design (m, n, P) @ z.

        log f(v) = log f(about) + (log f)'(about) (v - about), with the derivative of the last curve.
        """
        curve, (exposure, derivative) = self.curve(z), self.exposure(z)
        known = curve.slope(about) * (self.measured.stored - about) - exposure + derivative @ z
        design = -derivative
        if self.response is None:
            design[..., : self.sizes[0]] += increments(about)
        else:
            known += curve.log_light(about)
        return design, known

    def start(self) -> np.ndarray:
        """The unknowns to begin with: the mean of the prior."""
        return np.concatenate([prior_of_increments()[0][: self.sizes[0]], np.zeros(sum(self.sizes[1:]))])

    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Whitened rows (k, P) and values (k,) of the prior, which fixes the power if ratios are unknown."""
        mean, covariance = prior_of_increments()
        curve, exposures, colours, terms = self.sizes
        spreads = np.repeat([EXPOSURE_SPREAD, BALANCE_SPREAD, TERM_SPREAD], [exposures, colours, terms])
        rows = np.diag(np.concatenate([np.zeros(curve), 1.0 / spreads]))
        values = np.zeros(len(rows))
        if not curve:
            return rows, values
        rows[:curve, :curve] = np.linalg.inv(np.linalg.cholesky(covariance))
        values[:curve] = rows[:curve, :curve] @ mean
        if self.power_known:
            return rows, values
        span = np.diff(increments(np.array([DARK, SATURATED])), axis=0)
        span = np.pad(span, ((0, 0), (0, len(rows) - curve)))
        return np.concatenate([rows, span / EXACT]), np.append(values, USUAL_RANGE / EXACT)


def light_share(radius2: np.ndarray, falloff: np.ndarray) -> np.ndarray:
    """Relative light with vignetting, bounded below during the iteration."""
    return np.maximum(falloff_at(radius2, falloff), LEAST_SHARE)


@dataclass(frozen=True)
class ResponseFit:
    """A solution, with the robust standard deviation of its residuals in units of the noise, and in log exposure."""

    problem: ResponseProblem
    z: np.ndarray
    covariance: np.ndarray
    scale: float
    rms: float

    @property
    def log_errors(self) -> np.ndarray:
        """Standard errors (m,) of the log exposures, 0 if given."""
        free = np.sqrt(self.problem.split(np.diag(self.covariance))[1] + SYSTEMATIC**2)
        return np.concatenate([[0.0], free]) if len(free) else np.zeros(len(self.problem.measured.stored))

    @property
    def corner_error(self) -> float:
        """Standard error of the relative light in the corners."""
        terms = self.problem.terms
        return float(np.sqrt(self.covariance[len(self.z) - terms :, len(self.z) - terms :].sum()))

    @property
    def is_inconsistent(self) -> bool:
        """Whether the residuals are too large for an estimate."""
        return self.rms > (WORST_RMS if self.scale > MISFIT else WORST_NOISE)

    @property
    def contrast(self) -> float:
        """Root mean square difference of the surfaces' log exposures."""
        spread = largest_difference(self.problem.exposure(self.z)[0], self.problem.measured.usable)
        return root_mean_square(spread)

    def curve_errors(self, stored: np.ndarray) -> np.ndarray:
        """Standard errors of log light relative to its mean over the usable range."""
        size = self.problem.sizes[0]
        rows = increments(stored) - increments(np.linspace(DARK, SATURATED, 100)).mean(axis=0)
        return np.sqrt(np.einsum("ij,jk,ik->i", rows, self.covariance[:size, :size], rows) + SYSTEMATIC**2)


def solve(problem: ResponseProblem) -> ResponseFit:
    """Compute the joint robust estimate by linearised, iteratively reweighted least squares."""
    measured, z = problem.measured, problem.start()
    prior_rows, prior_values = problem.prior()
    about, robust, scale, gram, rms = measured.stored, np.ones_like(measured.stored), 1.0, np.zeros((0, 0)), 0.0
    for _ in range(MOST_STEPS):
        noise = measured.deviation * problem.curve(z).slope(about)
        weight = measured.usable * robust / np.square(noise)
        own = weight / weight.sum(axis=0)
        design, known = problem.linearised(z, about)
        # Eliminate the log radiance of the surfaces, the weighted mean over images.
        design_rest = design - np.einsum("mn,mnp->np", own, design)
        known_rest = known - np.einsum("mn,mn->n", own, known)
        root = np.sqrt(weight) / scale
        rows = np.concatenate([(design_rest * root[..., None]).reshape(known.size, len(z)), prior_rows])
        values = np.concatenate([-(known_rest * root).ravel(), prior_values])
        gram = rows.T @ rows
        before, z = z, _bounded(gram, rows.T @ values, problem.sizes[0])
        residual = np.where(measured.usable, design_rest @ z + known_rest, 0.0)
        standard = residual / (noise * np.sqrt(np.maximum(1.0 - own, 0.05)))
        scale = max(robust_deviation(standard[measured.usable]), LEAST_SCALE)
        robust = robust_weights(measured.over_channels(standard) / scale)
        rms = float(np.sqrt(np.average(np.square(residual), weights=robust * measured.usable)))
        radiance = (own * (design @ z + known)).sum(axis=0)
        about = problem.curve(z).stored_of(radiance + problem.exposure(z)[0])
        if np.abs(z - before).max(initial=0.0) < 1e-4:
            break
    return ResponseFit(problem, z, np.linalg.inv(gram), scale, rms)


def _bounded(gram: np.ndarray, moment: np.ndarray, increments: int) -> np.ndarray:
    """Solve normal equations with positive increments."""
    from scipy.optimize import lsq_linear  # heavy: imported when first needed

    if not len(moment):
        return moment
    factor = np.linalg.cholesky(gram)
    lower = np.where(np.arange(len(moment)) < increments, LEAST_INCREMENT, -np.inf)
    return lsq_linear(factor.T, np.linalg.solve(factor, moment), (lower, np.inf)).x


def robust_weights(standard: np.ndarray) -> np.ndarray:
    """Weights of Geman and McClure, which reject outliers, unlike Cauchy's."""
    return 1.0 / np.square(1.0 + np.square(standard / OUTLYING))


def largest_difference(values: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Largest difference (n,) of values (m, n) between usable images."""
    return np.where(usable, values, -np.inf).max(axis=0) - np.where(usable, values, np.inf).min(axis=0)
