"""Robust least squares for response, vignetting and exposures; see :mod:`liaam.calibration.radiometry`.

The response is an increasing spline of stored values, with a prior of what is known before any image is seen.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from liaam.calibration.estimate import robust_deviation
from liaam.calibration.response_blocks import MeasuredBlocks
from liaam.error_measures import root_mean_square
from liaam.photometry.camera import falloff_at
from liaam.photometry.encoding import DARK, SATURATED
from liaam.photometry.invariant import CHROMATICITY
from liaam.photometry.response import Response, to_linear

LOWEST = 6 / 255  # Stored value at which the fitted curve starts; below it continues as a power law
# The curve is a spline of log((v + toe) / (top - v)), which resolves dark values and the shoulder finely
TOE = 0.02
TOP = 1.1
KNOTS = 17  # Number of equidistant knots of the spline
TABULATED = 1500  # Number of stored values at which a curve is tabulated

# The prior of the curve: a family of realistic curves, plus a smooth Gaussian process for what is unlike them
AMPLITUDES = np.linspace(-0.6, 0.6, 5)  # Coefficients of the family's tone curves
LEAST_RISE = 0.1  # Least slope of a tone curve
POWERS = (1.0, 1.8, 2.2, 2.6)  # Gammas of the family
FAMILY_POINTS = 300  # Number of stored values at which the family is compared with splines
SMOOTH = 0.3  # Standard deviation of the Gaussian process, of log light
REACH = 0.35  # Its correlation length, along the curve
NUGGET = 1e-6  # Variance that is added to its independent values, so that the covariance has an inverse

# Assumed range of log light between the stored values 8 and 250 if the power is unknown: sRGB has 6.0, a gamma of 2.2
# has 7.6
USUAL_RANGE = 6.6
RANGE_SPREAD = 0.15  # Its relative standard deviation
EXACT = 1e-4  # Standard deviation in the equations of the assumed range, which fix the power of the estimate

TERMS = 3  # Number of vignetting coefficients: r^2, r^4, r^6
TERM_SPREAD = 0.5  # Prior standard deviation of a vignetting coefficient
BALANCE_SPREAD = 0.1  # That of the logarithm of an image's white balance
EXPOSURE_SPREAD = 5.0  # That of the logarithm of an image's exposure

OUTLYING = 4.0  # Residual, in standard deviations, at which the weight is a quarter: rare if they are normal
MOST_STEPS = 40  # Largest number of iterations
LEAST_STEP = 1e-4  # Change of every unknown below which the iteration ends
LEAST_INCREMENT = 1e-3  # Lower bound of the curve's increments, so that the curve rises
LEAST_SCALE = 0.3  # Lower bound of the scale of the residuals, which few residuals may understate
LEAST_SHARE = 0.1  # Lower bound of the relative light with vignetting
LEAST_FREEDOM = 0.05  # Lower bound of the variance of a residual relative to that of its noise

LEAST_CONTRAST = 0.1  # Least difference of log exposures for an estimate: a factor of 1.1 in light
WORST_RMS = 0.06  # Largest residual in log exposure of an estimate, if noise does not explain it
WORST_NOISE = 0.3  # The largest if noise explains it
MISFIT = 4.0  # Ratio of residuals to noise above which noise does not explain them; JPEG of quality 75 gives 4 to 6
# Standard error of log light and exposure by mixed light in blocks and clipped noise, from simulations
SYSTEMATIC = 1.5e-3


def _axis(stored: np.ndarray) -> np.ndarray:
    """Position along the curve of stored values (any shape)."""
    return np.log((stored + TOE) / (TOP - stored))


def evenly_along(count: int) -> np.ndarray:
    """Stored values (count,) from the lowest to 1, equidistant along the curve."""
    low, high = _axis(np.array([LOWEST, 1.0])).tolist()
    ratio = np.exp(np.linspace(low, high, count))
    return np.clip((TOP * ratio - TOE) / (1.0 + ratio), LOWEST, 1.0)


def _knots() -> np.ndarray:
    """Knots of the cubic spline along the curve; those at the ends are repeated."""
    return np.pad(_axis(evenly_along(KNOTS)), 3, mode="edge")


def increments(stored: np.ndarray) -> np.ndarray:
    """Integrated B-splines (..., J) of stored values; a curve with positive coefficients is increasing."""
    from scipy.interpolate import BSpline  # heavy: imported when first needed

    knots = _knots()
    axis = np.clip(_axis(stored.ravel()), knots[0], knots[-1])
    splines = BSpline.design_matrix(axis, knots, 3).toarray()
    # The i-th is the sum of the i-th spline and all that follow. The sum of all is 1, a constant factor of light.
    integrated = np.cumsum(splines[:, ::-1], axis=1)[:, ::-1]
    return integrated[:, 1:].reshape(*stored.shape, -1)


@dataclass(frozen=True)
class ResponseTable:
    """Table of the logarithm of light by stored value: (k,) each, increasing."""

    stored: np.ndarray
    light: np.ndarray

    @classmethod
    def of(cls, response: "Response | np.ndarray") -> "ResponseTable":
        """Tabulate a response, or a curve with given increments (J,)."""
        stored = evenly_along(TABULATED)
        if isinstance(response, np.ndarray):
            return cls(stored, increments(stored) @ response)
        light = np.asarray(to_linear(stored, response), dtype=np.float64)
        return cls(stored, np.log(light))

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
    """Prior mean (J,) and covariance (J, J) of increments, of realistic curves and of smooth deviations from them."""
    stored = evenly_along(FAMILY_POINTS)
    curves = _realistic_curves(stored)
    design = increments(stored)
    # Centred, since a constant factor of light is no part of a response.
    family = np.linalg.lstsq(design - design.mean(axis=0), curves - curves.mean(axis=0), rcond=None)[0]
    return family.mean(axis=1), np.cov(family) + _covariance_of_deviations()


def _realistic_curves(stored: np.ndarray) -> np.ndarray:
    """Log light (k, n) of stored values (k,) by tone curves v + v (1 - v) q(v), q quadratic, and powers of these."""
    rising = []
    for a, b, c in product(AMPLITUDES, repeat=3):
        tone = stored * (1 + (1 - stored) * (a + b * stored + c * stored**2))
        if (np.diff(tone) > LEAST_RISE * np.diff(stored)).all():
            rising.append(np.log(tone))
    return np.stack([gamma * log_tone for log_tone in rising for gamma in POWERS], axis=1)


def _covariance_of_deviations() -> np.ndarray:
    """Covariance (J, J) of increments by a smooth Gaussian process along the curve.

    The process gives the coefficients of the splines, at the centres of these. Increments are the differences of
    neighbouring coefficients.
    """
    knots = _knots()
    centres = np.array([knots[j + 1 : j + 4].mean() for j in range(len(knots) - 4)])
    along = (centres - centres[0]) / (centres[-1] - centres[0])
    distance = (along[:, None] - along) / REACH
    covariance = SMOOTH**2 * np.exp(-0.5 * np.square(distance)) + NUGGET * np.eye(len(along))
    return np.diff(np.diff(covariance, axis=0), axis=1)


class Sizes(NamedTuple):
    """Numbers of the unknowns of each kind."""

    increments: int
    exposures: int
    balances: int
    vignetting: int


class Unknowns(NamedTuple):
    """The unknowns of each kind."""

    increments: np.ndarray  # of the curve
    exposures: np.ndarray  # log exposures of all images but the first
    balances: np.ndarray  # log white balances of these images, two numbers each
    vignetting: np.ndarray  # coefficients


@dataclass(frozen=True)
class ResponseProblem:
    """The problem; its unknowns z (P,) are the free increments, exposures, white balances and vignetting coefficients.

    Attributes
    ----------
    measured : MeasuredBlocks
        Blocks of one scene in m images.
    known_logs : (m,) float64, optional
        Log exposures, if they are given.
    response : Response, optional
        The response, if it is given.
    terms : int
        Number of vignetting coefficients to estimate.
    """

    measured: MeasuredBlocks
    known_logs: np.ndarray | None
    response: Response | None
    terms: int

    @property
    def sizes(self) -> Sizes:
        """Numbers of free increments, exposures, white balances and vignetting coefficients."""
        n_others = len(self.measured.stored) - 1  # images besides the first, to which they are relative
        is_colour = self.measured.channel.any()
        return Sizes(
            increments=len(prior_of_increments()[0]) if self.response is None else 0,
            exposures=n_others if self.known_logs is None else 0,
            balances=2 * n_others if is_colour else 0,
            vignetting=self.terms,
        )

    @property
    def power_known(self) -> bool:
        """Whether the response or ratios of exposures are given."""
        if self.response is not None:
            return True
        return self.known_logs is not None and float(np.ptp(self.known_logs)) >= LEAST_CONTRAST

    def split(self, z: np.ndarray) -> Unknowns:
        """Split z into increments, exposures, white balances and vignetting coefficients."""
        increments, exposures, balances, vignetting = np.split(z, np.cumsum(self.sizes)[:-1])
        return Unknowns(increments, exposures, balances, vignetting)

    def curve(self, z: np.ndarray) -> ResponseTable:
        """The response."""
        return ResponseTable.of(self.split(z).increments if self.response is None else self.response)

    def logs(self, z: np.ndarray) -> np.ndarray:
        """Log exposures (m,)."""
        if self.known_logs is not None:
            return self.known_logs
        return np.concatenate([[0.0], self.split(z).exposures])

    def exposure(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log of the factor of each block's light in each image (m, n), and its derivative by z (m, n, P)."""
        unknowns = self.split(z)
        radius2 = self.measured.radius2
        m, n = radius2.shape
        share = light_share(radius2, unknowns.vignetting)
        of_others = np.eye(m)[:, 1:]  # (m, m - 1): 1 for an image and its own unknowns, which the first one lacks
        by_exposures = np.broadcast_to(of_others[:, None], (m, n, m - 1))
        chromaticity = CHROMATICITY.T[self.measured.channel]  # (n, 2): of each block's channel
        by_balances = np.einsum("mp,nc->mnpc", of_others, chromaticity).reshape(m, n, -1)
        by_balances = by_balances[..., : len(unknowns.balances)]  # none in grey images
        powers = np.stack([radius2 ** (i + 1) for i in range(TERMS)], axis=-1)
        by_vignetting = powers[..., : self.terms] / share[..., None]
        value = self.logs(z)[:, None] + by_balances @ unknowns.balances + np.log(share)
        derivative = np.concatenate(
            [
                np.zeros((m, n, len(unknowns.increments))),
                by_exposures[..., : len(unknowns.exposures)],  # none if they are given
                by_balances,
                by_vignetting,
            ],
            axis=-1,
        )
        return value, derivative

    def linearised(self, z: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linearise log radiance about stored values and the last z, as constant (m, n) + design (m, n, P) @ z.

        log f(v) = log f(at) + (log f)'(at) (v - at), with the derivative of the last curve. Return design and constant.
        """
        curve = self.curve(z)
        exposure, derivative = self.exposure(z)
        constant = curve.slope(at) * (self.measured.stored - at) - exposure + derivative @ z
        design = -derivative
        if self.response is None:
            design[..., : self.sizes.increments] += increments(at)
        else:
            constant += curve.log_light(at)
        return design, constant

    def start(self) -> np.ndarray:
        """The unknowns to begin with: the mean of the prior."""
        n_increments, *n_others = self.sizes
        mean, _ = prior_of_increments()
        return np.concatenate([mean[:n_increments], np.zeros(sum(n_others))])

    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Whitened rows (k, P) and values (k,) of the prior, which fixes the power if ratios are unknown."""
        n_increments, *n_others = self.sizes
        spreads = np.repeat([EXPOSURE_SPREAD, BALANCE_SPREAD, TERM_SPREAD], n_others)
        rows = np.diag(np.concatenate([np.zeros(n_increments), 1.0 / spreads]))
        values = np.zeros(len(rows))
        if n_increments == 0:
            return rows, values
        mean, covariance = prior_of_increments()
        rows[:n_increments, :n_increments] = np.linalg.inv(np.linalg.cholesky(covariance))
        values[:n_increments] = rows[:n_increments, :n_increments] @ mean
        if self.power_known:
            return rows, values
        # One more equation says that log light has the usual range between dark and saturated values.
        span = np.diff(increments(np.array([DARK, SATURATED])), axis=0)
        span = np.pad(span, ((0, 0), (0, len(rows) - n_increments)))
        return np.concatenate([rows, span / EXACT]), np.append(values, USUAL_RANGE / EXACT)


def light_share(radius2: np.ndarray, falloff: np.ndarray) -> np.ndarray:
    """Relative light with vignetting, bounded below during the iteration."""
    return np.maximum(falloff_at(radius2, falloff), LEAST_SHARE)


@dataclass(frozen=True)
class ResponseFit:
    """A solution.

    Attributes
    ----------
    problem : ResponseProblem
    z : (P,) float64
        The unknowns, in the order of :class:`Unknowns`.
    covariance : (P, P) float64
        Their covariance.
    scale : float
        Robust standard deviation of the residuals, in units of the noise.
    rms : float
        Root mean square of the residuals, in log exposure.
    """

    problem: ResponseProblem
    z: np.ndarray
    covariance: np.ndarray
    scale: float
    rms: float

    @property
    def log_errors(self) -> np.ndarray:
        """Standard errors (m,) of the log exposures, 0 if given."""
        variances = self.problem.split(np.diag(self.covariance)).exposures
        if not len(variances):
            return np.zeros(len(self.problem.measured.stored))
        return np.concatenate([[0.0], np.sqrt(variances + SYSTEMATIC**2)])

    @property
    def corner_error(self) -> float:
        """Standard error of the relative light in the corners."""
        # The coefficients of vignetting are the last unknowns. In the corners r is 1, and the light 1 plus their sum.
        first = len(self.z) - self.problem.terms
        return float(np.sqrt(self.covariance[first:, first:].sum()))

    @property
    def is_inconsistent(self) -> bool:
        """Whether the residuals are too large for an estimate."""
        return self.rms > (WORST_RMS if self.scale > MISFIT else WORST_NOISE)

    @property
    def contrast(self) -> float:
        """Root mean square difference of the surfaces' log exposures."""
        exposure, _ = self.problem.exposure(self.z)
        return root_mean_square(largest_difference(exposure, self.problem.measured.usable))

    def curve_errors(self, stored: np.ndarray) -> np.ndarray:
        """Standard errors of log light relative to its mean over the usable range."""
        n_increments = self.problem.sizes.increments
        covariance = self.covariance[:n_increments, :n_increments]
        usable_range = np.linspace(DARK, SATURATED, 100)
        rows = increments(stored) - increments(usable_range).mean(axis=0)
        variances = np.einsum("ij,jk,ik->i", rows, covariance, rows)
        return np.sqrt(variances + SYSTEMATIC**2)


@dataclass(frozen=True)
class _State:
    """What an iteration begins with, and leaves to the next one.

    Attributes
    ----------
    z : (P,) float64
        The unknowns.
    predicted : (m, n) float64
        Stored values that the other images predict, about which log f is linearised.
    robust : (m, n) float64
        Weights that reject outliers.
    scale : float
        Robust standard deviation of the residuals, in units of the noise.
    rms : float
        Root mean square of the residuals, in log exposure.
    gram : (P, P) float64
        Matrix of the normal equations, whose inverse is the covariance of the unknowns.
    """

    z: np.ndarray
    predicted: np.ndarray
    robust: np.ndarray
    scale: float
    rms: float
    gram: np.ndarray


def solve(problem: ResponseProblem) -> ResponseFit:
    """Compute the joint robust estimate by linearised, iteratively reweighted least squares."""
    stored = problem.measured.stored
    state = _State(
        z=problem.start(),
        predicted=stored,
        robust=np.ones_like(stored),
        scale=1.0,
        rms=0.0,
        gram=np.zeros((0, 0)),
    )
    prior_rows, prior_values = problem.prior()
    for _ in range(MOST_STEPS):
        before = state
        state = _iterated(problem, before, prior_rows, prior_values)
        if np.abs(state.z - before.z).max(initial=0.0) < LEAST_STEP:
            break
    return ResponseFit(problem, z=state.z, covariance=np.linalg.inv(state.gram), scale=state.scale, rms=state.rms)


def _iterated(problem: ResponseProblem, state: _State, prior_rows: np.ndarray, prior_values: np.ndarray) -> _State:
    """Solve the equations linearised about the last solution, and weight their residuals anew."""
    measured = problem.measured
    noise = measured.deviation * problem.curve(state.z).slope(state.predicted)
    weight = measured.usable * state.robust / np.square(noise)
    design, constant = problem.linearised(state.z, state.predicted)
    # Eliminate the log radiance of the surfaces, the weighted mean over images.
    share = weight / weight.sum(axis=0)
    design_rest = design - np.einsum("mn,mnp->np", share, design)
    constant_rest = constant - np.einsum("mn,mn->n", share, constant)
    # Solve the normal equations of blocks and prior.
    root = np.sqrt(weight) / state.scale
    block_rows = (design_rest * root[..., None]).reshape(constant.size, len(state.z))
    block_values = -(constant_rest * root).ravel()
    rows = np.concatenate([block_rows, prior_rows])
    values = np.concatenate([block_values, prior_values])
    gram = rows.T @ rows
    z = _bounded(gram, rows.T @ values, problem.sizes.increments)
    # Weight the residuals. They vary less than the noise, since the mean over images contains it.
    residual = np.where(measured.usable, design_rest @ z + constant_rest, 0.0)
    standard = residual / (noise * np.sqrt(np.maximum(1.0 - share, LEAST_FREEDOM)))
    scale = max(robust_deviation(standard[measured.usable]), LEAST_SCALE)
    robust = robust_weights(measured.over_channels(standard) / scale)
    rms = float(np.sqrt(np.average(np.square(residual), weights=robust * measured.usable)))
    # Predict the stored values from the mean of the images.
    radiance = (share * (design @ z + constant)).sum(axis=0)
    exposure, _ = problem.exposure(z)
    predicted = problem.curve(z).stored_of(radiance + exposure)
    return _State(z=z, predicted=predicted, robust=robust, scale=scale, rms=rms, gram=gram)


def _bounded(gram: np.ndarray, moment: np.ndarray, n_increments: int) -> np.ndarray:
    """Solve normal equations gram @ z = moment with positive increments, which are the first of the unknowns.

    With the Cholesky factor L of gram, they are those of the least squares |L' z - L^-1 moment|^2, which are solved
    within bounds.
    """
    from scipy.optimize import lsq_linear  # heavy: imported when first needed

    if not len(moment):
        return moment
    factor = np.linalg.cholesky(gram)
    is_increment = np.arange(len(moment)) < n_increments
    lower_bounds = np.where(is_increment, LEAST_INCREMENT, -np.inf)
    return lsq_linear(factor.T, np.linalg.solve(factor, moment), (lower_bounds, np.inf)).x


def robust_weights(standard: np.ndarray) -> np.ndarray:
    """Weights of Geman and McClure for residuals in standard deviations; far ones, unlike Cauchy's, hardly pull."""
    return 1.0 / np.square(1.0 + np.square(standard / OUTLYING))


def largest_difference(values: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Largest difference (n,) of values (m, n) between usable images."""
    largest = np.where(usable, values, -np.inf).max(axis=0)
    least = np.where(usable, values, np.inf).min(axis=0)
    return largest - least
