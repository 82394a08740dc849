"""Joint estimation of appearance, shading and landmark corrections of a fitted image.

The invariant alone (:func:`liaam.relighting.shadow_free`) discards brightness and one direction of colour. If the
shading is estimated jointly, all three channels contribute to the appearance. At a pixel x of the reference frame, the
image's log light is modelled as

    y(x) = A0(x) + sum_i lambda_i A_i(x)                 appearance (paper eq 4)
         + sum_v beta_v(x) u_v . grad A(x)               landmarks v displaced by u_v (eq 3, to first order)
         + (s(x) + sum_j h_j H_j(x)) 1 + c(s(x)) + e(x)  shading and errors.

Shading is a piecewise smooth brightness s with a colour c(s). Under one lamp and ambient light, the log light of any
object moves along one curve, log(a + l r), as the lamp's fraction r goes from shadow to full light. A low-degree
polynomial H models the fall-off of the ambient light. The errors e are noise and the model's errors on left-out
training images. A model trained with lamps knows more: H are then the modes of its light, which have colours, s is held
near 0 by what these modes leave, and c is 0. All but c is linear. Each pass solves weighted least squares with Gaussian
priors, with s eliminated (variable projection), and reweights the jumps of s (total variation, as in
:mod:`liaam.relighting.shading`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.model import AAM
from liaam.model.appearance import AppearanceModel
from liaam.model.light import BRIGHTEST
from liaam.model.mesh import ReferenceFrame
from liaam.photometry.invariant import CHROMATICITY
from liaam.relighting.appearance import ShadowFree
from liaam.relighting.lamplight import light_on_frame, unexplained_on_frame
from liaam.relighting.shading import CORNER, COUPLING, UNIT, UNKNOWN, Seen, every_few, factorised

PIXELS = 2500
"""Approximate number of sampled pixels of the reference frame without a light basis, for some tens of unknowns."""

CORRELATED, ACROSS = 0.12, 5
"""Side of the area in which errors count as one if there is a light basis, as a fraction of the frame's diagonal, and
number of samples across it. A basis holds the shading s, so smooth errors remain, and would outweigh the priors if they
counted as independent from pixel to pixel. Without a basis, s takes them up."""

COLOURED = 0.37
"""Standard deviation of the colour of what a light basis does not explain, relative to that of its brightness."""

OFF = 0.5
"""Standard deviation of a fitted landmark, pixels of the reference frame."""

DEGREE, AMOUNT = 6, 0.2
"""Degree of the polynomial H, and standard deviation of its coefficients."""

BENDS = 3
"""Degree of the curve of colours."""

NOISE_FACTOR = 3.0
"""Factor on the noise's variance: rounding and JPEG compression add to the measured noise."""

FINE_BRIGHTNESS, FINE_COLOUR = 0.03, 0.02
"""Standard deviations of detail that neither model nor shading explains, in logarithms."""

PASSES = 2
"""Number of passes; more make no visible difference."""

NO_PRIOR = 1e-6
"""Lower bound on the prior's strength, which keeps unobserved coordinates determined."""

LEVEL_SPREAD = 0.2
"""Standard deviation of an image's level of light around those of the lamps, in logarithms."""

OUTLYING = 3.0
"""Squared distance of a colour from the curve, in medians, at which its weight is halved."""


def light_curve(
    brightness: np.ndarray, shading: np.ndarray, weights: np.ndarray
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Fit the curve of the colours of shading (n, 3) by its brightness (n,), robustly and with weights (n,).

    The curve gives colours (k, 3) at brightnesses (k,), and their derivatives (k, 3). Beyond the range of the given
    brightnesses the colour is constant.
    """
    from numpy.polynomial import chebyshev

    low, high = np.quantile(brightness[weights > 0], [0.005, 0.995]) if weights.any() else (0.0, 0.0)
    scale = 2.0 / max(high - low, 1e-6)

    def to_unit(values: np.ndarray) -> np.ndarray:
        return np.clip((values - low) * scale - 1.0, -1.0, 1.0)

    basis = chebyshev.chebvander(to_unit(brightness), BENDS)
    colours, kept = shading @ CHROMATICITY.T, weights
    ridge = 1e-6 * np.eye(BENDS + 1) * max(float(weights.sum()), 1e-12)
    coefficients = np.zeros((BENDS + 1, 2))
    for _ in range(4):  # iteratively reweighted least squares
        weighted = basis * kept[:, None]
        coefficients = np.linalg.solve(weighted.T @ basis + ridge, weighted.T @ colours)
        squares = np.square(colours - basis @ coefficients)
        off = (squares / np.maximum(np.median(squares[weights > 0], axis=0), 1e-12)).sum(axis=1) if kept.any() else 0.0
        kept = weights / (1.0 + off / OUTLYING)

    def curve(brightness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        at = to_unit(brightness)
        slopes = chebyshev.chebval(at, chebyshev.chebder(coefficients)) * (scale * (np.abs(at) < 1))
        return chebyshev.chebval(at, coefficients).T @ CHROMATICITY, slopes.T @ CHROMATICITY

    return curve


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem over n sampled pixels of the reference frame."""

    seen: np.ndarray
    """(n, 3): log light minus the mean appearance."""
    modes: np.ndarray
    """(m, n, 3): modes of appearance, of the polynomial H, and of landmark displacements."""
    precision: np.ndarray
    """(m,): prior precision of their coordinates."""
    weights: np.ndarray
    """(n, 3, 3): :data:`UNIT` squared times the inverse covariance of the errors; 0 at unusable pixels."""
    pairs: tuple[np.ndarray, np.ndarray]
    """(k,) each: neighbours."""
    coupling: float
    """Weight of jumps between neighbours."""
    held: np.ndarray
    """(n,): precision, times :data:`UNIT` squared, with which s is held at 0; it has no colour of its own then."""
    together: float
    """Number of pixels whose errors count as one."""

    def first_brightness(self, found: np.ndarray) -> np.ndarray:
        """Estimate the brightness of shading (n,) with uniform smoothness, from initial coordinates."""
        mean = self._shading(found).mean(axis=1)
        weights = self.weights.sum(axis=(1, 2))
        coupling = np.full(len(self.pairs[0]), self.coupling)
        return factorised(self.pairs, coupling, weights + self.held).solve(weights * mean)

    def solved(self, found: np.ndarray, brightness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Run one pass; return coordinates (m,), brightness of shading (n,) and the coordinates' covariance (m, m)."""
        colour = slope = np.zeros_like(self.seen)
        if not self.held.any():
            of_colours = np.einsum("kc,ncd,kd->n", CHROMATICITY, self.weights, CHROMATICITY)
            colour, slope = light_curve(brightness, self._shading(found), of_colours)(brightness)
        # Linearised, the shading is brightness * along plus a known term.
        along, right = 1.0 + slope, self.seen - (colour - brightness[:, None] * slope)
        weighted = np.einsum("ncd,nd->nc", self.weights, along)
        jumps = np.abs(brightness[self.pairs[0]] - brightness[self.pairs[1]])
        own = (weighted * along).sum(axis=1) + self.held
        system = factorised(self.pairs, self.coupling / (jumps + CORNER), own)
        mixed = np.einsum("mnc,nc->nm", self.modes, weighted)
        eliminated = system.solve(np.column_stack([mixed, (weighted * right).sum(axis=1)]))
        of_modes = np.einsum("ncd,mnd->mnc", self.weights, self.modes, optimize=True).reshape(len(mixed.T), -1)
        hessian = of_modes @ self.modes.reshape(len(of_modes), -1).T - mixed.T @ eliminated[:, :-1]
        unit = self.together * UNIT**2
        covariance = np.linalg.inv(hessian + unit * np.diag(self.precision))
        found = covariance @ (of_modes @ right.ravel() - mixed.T @ eliminated[:, -1])
        return found, eliminated[:, -1] - eliminated[:, :-1] @ found, unit * covariance

    def _shading(self, found: np.ndarray) -> np.ndarray:
        return self.seen - np.tensordot(found, self.modes, axes=1)


def appearance_in_light(model: AAM, seen: Seen, start: ShadowFree, prior: float = 1.0) -> tuple[ShadowFree, np.ndarray]:
    """Estimate the appearance under the training light jointly with the shading.

    It starts from the appearance by the invariant; ``prior`` is that of :func:`liaam.relighting.shadow_free`. Also
    return the appearance's log light with the landmark corrections applied, (n_pixels, 3) float32.
    """
    known, frame = model.levels[-1].appearances["log"], model.frame
    usable = seen.usable * (known.usable > 0)
    side = CORRELATED * model.diagonal
    step = max(1, round(np.sqrt(frame.n_pixels / PIXELS)) if model.light is None else int(side / ACROSS))
    together = 1.0 if model.light is None else max(1.0, np.square(side / step))
    kept, pairs = every_few(frame, step)
    if not usable[kept].any():
        return start, start.log_rgb
    part, n, barycentric = known.at(kept), known.n_modes, _barycentric(frame)
    lit, polynomials = light_on_frame(model)[:, kept], _polynomials(frame)[:, kept, None] * np.ones(3)
    fixed = np.concatenate([part.modes, polynomials if model.light is None else lit])
    spread = AMOUNT if model.light is None else 1.0
    priors = (max(prior, NO_PRIOR) / np.maximum(known.eigenvalues, 1e-12), np.full(len(fixed) - n, spread**-2.0))
    precision = np.concatenate([*priors, np.full(2 * len(barycentric), OFF**-2.0)])
    unexplained = unexplained_on_frame(model)
    of_light = np.zeros_like(unexplained) if model.light is None else np.square(COLOURED * unexplained)
    weights = _weights(known, seen.noise, usable, of_light)[kept]
    # Unknowns: lambda, the polynomial's coefficients, and the landmarks' offsets, all x before all y.
    found, covariance = np.concatenate([start.lam, np.zeros(len(precision) - n)]), np.diag(1.0 / precision)
    held = np.square(UNIT / unexplained[kept])
    log_rgb, brightness = start.log_rgb, None
    for _ in range(PASSES):
        slopes = frame.gradient(log_rgb)[kept]
        offsets = np.einsum("vn,nac->avnc", barycentric[:, kept], slopes).reshape(-1, *part.mean.shape)
        modes = np.concatenate([fixed, offsets])
        # A sampled pixel represents step ** 2 pixels, and a jump ``step`` pixels of an edge.
        problem = Problem(seen.log[kept] - part.mean, modes, precision, weights, pairs, COUPLING / step, held, together)
        brightness = problem.first_brightness(found) if brightness is None else brightness
        found, brightness, covariance = problem.solved(found, brightness)
        log_rgb = known.texture(found[:n])
    if model.light is not None and len(model.light.levels):
        brightness = lit.mean(axis=2)
        top = (light := found[n : n + len(lit)] @ brightness) >= np.quantile(light, 1.0 - BRIGHTEST)
        along = np.zeros_like(found)
        along[n : n + len(lit)] = brightness[:, top].mean(axis=1)
        found = at_a_known_level(found, covariance, along, model.light.levels.astype(np.float64))
        log_rgb = known.texture(found[:n])
    offsets = found[-2 * len(barycentric) :].reshape(2, -1) @ barycentric
    displaced = log_rgb + np.einsum("an,nac->nc", offsets, frame.gradient(log_rgb))
    light = found[n : n + len(lit)]
    return ShadowFree(log_rgb, found[:n], np.sqrt(np.diag(covariance)[:n]), light), displaced.astype(np.float32)


def at_a_known_level(found: np.ndarray, covariance: np.ndarray, along: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Move coordinates (m,) so that the level of light, ``along @ found``, is nearer to the levels (k,) of known lamps.

    An image hardly distinguishes a bright object in weak light from a dark one in strong light. But a lamp that lights
    any part of the object does so about as brightly as the training light, unless it is as weak as another known lamp.
    The levels are a mixture of Gaussians, and the result is its posterior mean.
    """
    level, cross = along @ found, covariance @ along
    variance, own = along @ cross, LEVEL_SPREAD**2
    if not variance > 0.0:
        return found
    exponents = -0.5 * np.square(level - levels) / (variance + own)
    weights = np.exp(exponents - exponents.max())
    nearer = np.average((level * own + levels * variance) / (variance + own), weights=weights)
    return found + cross * ((nearer - level) / variance)


def _weights(known: AppearanceModel, noise: np.ndarray, usable: np.ndarray, of_light: np.ndarray) -> np.ndarray:
    """Compute the weights of :class:`Problem`, (n_pixels, 3, 3) float64."""
    grey, every = np.ones((3, 3)), np.eye(3)
    unexplained = UNKNOWN**2 * grey if known.unexplained is None else known.unexplained
    fine = FINE_BRIGHTNESS**2 * grey + FINE_COLOUR**2 * every
    colour = of_light[:, None, None] * (every - grey / 3.0)
    covariance = unexplained + fine + NOISE_FACTOR * noise[:, None] * every + colour
    return np.linalg.inv(covariance) * (UNIT**2 * usable)[:, None, None]


@lru_cache(maxsize=4)
def _barycentric(frame: ReferenceFrame) -> np.ndarray:
    """Return the barycentric weights beta_v(x) of eq 3, (n_points, n_pixels) float64."""
    weights = np.zeros((len(frame.points), frame.n_pixels))
    np.put_along_axis(weights, frame.vertices.T, frame.weights.T, axis=0)
    return weights


@lru_cache(maxsize=4)
def _polynomials(frame: ReferenceFrame) -> np.ndarray:
    """Return products of Legendre polynomials in x and y up to :data:`DEGREE`, without the constant, (m, n_pixels)."""
    from numpy.polynomial import legendre

    away = frame.pixels - frame.pixels.mean(axis=0)
    down, right = legendre.legvander(away / np.abs(away).max(), DEGREE).transpose(1, 2, 0)
    return np.stack([down[i] * right[j] for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j])
