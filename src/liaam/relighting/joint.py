"""Joint estimation of appearance, light and landmark corrections of a fitted image.

The invariant alone (:func:`liaam.relighting.shadow_free`) discards brightness and one direction of colour. If the
light is estimated jointly, all three channels contribute to the appearance. At a pixel x of the reference frame, the
image's log light is modelled as

    y(x) = A0(x) + sum_i lambda_i A_i(x)           appearance (paper eq 4)
         + sum_v beta_v(x) u_v . grad A(x)         landmarks v displaced by u_v (eq 3, to first order)
         + sum_j h_j H_j(x) + s(x) 1 + e(x)        light and errors.

H are modes of light (:mod:`liaam.relighting.basis`), and s is a piecewise smooth brightness, held near 0 by what the
modes leave. The errors e are noise and the model's errors on left-out training images. Each pass solves weighted least
squares with Gaussian priors, with s eliminated (variable projection), and reweights the jumps of s (total variation).

Most images of an object may be in the training light, and errors of the model always look like a little light. So the
light is 0 with the probability that the data give to it, and its coordinates are means over both cases.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from liaam.model import AAM
from liaam.model.appearance import AppearanceModel
from liaam.model.light import BRIGHTEST
from liaam.model.mesh import ReferenceFrame
from liaam.relighting.appearance import ShadowFree
from liaam.relighting.basis import light_on_frame, unexplained_on_frame
from liaam.relighting.grid import every_few, factorised
from liaam.relighting.seen import NOISE_FACTOR, UNKNOWN, Seen

COUPLING, CORNER = 0.03, 0.02
"""Weight of a jump of s between neighbours, and jump below which the penalty is quadratic."""

UNIT = 0.1
"""Standard deviation of a pixel's log light that gives a weight of 1."""

CORRELATED, ACROSS = 0.12, 5
"""Side of the area in which errors count as one, as a fraction of the frame's diagonal, and number of samples across
it. Modes learnt from lamps hold s, so smooth errors remain, and would outweigh the priors if they counted as
independent from pixel to pixel. Without lamps, s takes them up."""

COLOURED = 0.37
"""Standard deviation of the colour of what the modes do not explain, relative to that of its brightness."""

OFF = 0.5
"""Standard deviation of a fitted landmark, pixels of the reference frame."""

FINE_BRIGHTNESS, FINE_COLOUR = 0.03, 0.02
"""Standard deviations of detail that neither model nor light explains, in logarithms."""

PASSES = 2
"""Number of passes; more make no visible difference."""

NO_PRIOR = 1e-6
"""Lower bound on the prior's strength, which keeps unobserved coordinates determined."""

LEVEL_SPREAD = 0.2
"""Standard deviation of an image's level of light around those of the lamps, in logarithms."""


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem over n sampled pixels of the reference frame."""

    seen: np.ndarray
    """(n, 3): log light minus the mean appearance."""
    modes: np.ndarray
    """(m, n, 3): modes of appearance, of light, and of landmark displacements."""
    precision: np.ndarray
    """(m,): prior precision of their coordinates."""
    weights: np.ndarray
    """(n, 3, 3): :data:`UNIT` squared times the inverse covariance of the errors; 0 at unusable pixels."""
    pairs: tuple[np.ndarray, np.ndarray]
    """(k,) each: neighbours."""
    coupling: float
    """Weight of jumps between neighbours."""
    held: np.ndarray
    """(n,): precision, times :data:`UNIT` squared, with which s is held at 0."""
    together: float
    """Number of pixels whose errors count as one."""

    def first_brightness(self, found: np.ndarray) -> np.ndarray:
        """Estimate the brightness of shading (n,) with uniform smoothness, from initial coordinates."""
        mean = self._shading(found).mean(axis=1)
        weights = self.weights.sum(axis=(1, 2))
        coupling = np.full(len(self.pairs[0]), self.coupling)
        return factorised(self.pairs, coupling, weights + self.held).solve(weights * mean)

    def solved(self, found: np.ndarray, brightness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Run one pass; return coordinates (m,), brightness of shading (n,) and the coordinates' precision (m, m)."""
        weighted, modes = self.weights.sum(axis=2), self.modes.reshape(len(self.modes), -1)
        jumps = np.abs(brightness[self.pairs[0]] - brightness[self.pairs[1]])
        own = weighted.sum(axis=1) + self.held
        system = factorised(self.pairs, self.coupling / (jumps + CORNER), own)
        mixed = np.einsum("mnc,nc->nm", self.modes, weighted).astype(np.float64)
        eliminated = system.solve(np.column_stack([mixed, (weighted * self.seen).sum(axis=1)]))
        by_pixel = self.modes.transpose(1, 0, 2) @ self.weights.astype(np.float32)
        of_modes = by_pixel.transpose(1, 0, 2).reshape(len(modes), -1)
        hessian = of_modes @ modes.T - mixed.T @ eliminated[:, :-1]
        unit = self.together * UNIT**2
        hessian += unit * np.diag(self.precision)
        found = np.linalg.solve(hessian, of_modes @ self.seen.ravel() - mixed.T @ eliminated[:, -1])
        return found, eliminated[:, -1] - eliminated[:, :-1] @ found, hessian / unit

    def _shading(self, found: np.ndarray) -> np.ndarray:
        return self.seen - np.tensordot(found, self.modes, axes=1)


class InLight(NamedTuple):
    """Appearance and light of a fitted image."""

    appearance: ShadowFree
    """Appearance under the training light."""
    log_rgb: np.ndarray
    """(n_pixels, 3) float32: its log light with the landmark corrections applied."""
    covariance: np.ndarray
    """(k, k): covariance of the coordinates of the light."""


def appearance_in_light(model: AAM, seen: Seen, start: ShadowFree, prior: float = 1.0) -> InLight:
    """Estimate the appearance under the training light jointly with the light.

    It starts from the appearance by the invariant; ``prior`` is that of :func:`liaam.relighting.shadow_free`.
    """
    known, frame, every = model.levels[-1].appearances["log"], model.frame, light_on_frame(model)
    usable, n, k = seen.usable * (known.usable > 0), known.n_modes, len(every)
    side = CORRELATED * model.diagonal
    step = max(1, int(side / ACROSS))
    kept, pairs = every_few(frame, step)
    if not usable[kept].any():
        return InLight(replace(start, light=np.zeros(k)), start.log_rgb, np.eye(k))
    part, lit, barycentric = known.at(kept), every[:, kept], _barycentric(frame)
    priors = max(prior, NO_PRIOR) / np.maximum(known.eigenvalues, 1e-12), np.ones(k)
    precision = np.concatenate([*priors, np.full(2 * len(barycentric), OFF**-2.0)])
    unexplained = unexplained_on_frame(model)
    weights = _weights(part, seen.noise[kept], usable[kept], np.square(COLOURED * unexplained[kept]))
    held = np.square(UNIT / unexplained[kept])
    together = 1.0 if model.light is None else max(1.0, np.square(side / step))
    # Unknowns: lambda, the coordinates of the light, and the landmarks' offsets, all x before all y.
    found, posterior = np.concatenate([start.lam, np.zeros(len(precision) - n)]), np.diag(precision)
    log_rgb, brightness = start.log_rgb, None
    for _ in range(PASSES):
        slopes = frame.gradient(log_rgb)[kept]
        offsets = np.einsum("vn,nac->avnc", barycentric[:, kept], slopes).reshape(-1, *part.mean.shape)
        modes = np.concatenate([part.modes, lit, offsets], dtype=np.float32)
        # A sampled pixel represents step ** 2 pixels, and a jump ``step`` pixels of an edge.
        problem = Problem(seen.log[kept] - part.mean, modes, precision, weights, pairs, COUPLING / step, held, together)
        brightness = problem.first_brightness(found) if brightness is None else brightness
        found, brightness, posterior = problem.solved(found, brightness)
        log_rgb = known.texture(found[:n])
    own, covariance = slice(n, n + k), np.linalg.inv(posterior)
    same = as_in_training(found[own], covariance[own, own])
    if model.light is not None and len(model.light.levels):
        brightness = lit.mean(axis=2)
        top = (light := found[own] @ brightness) >= np.quantile(light, 1.0 - BRIGHTEST)
        along = np.zeros_like(found)
        along[own] = brightness[:, top].mean(axis=1)
        found = at_a_known_level(found, covariance, along, model.light.levels.astype(np.float64))
    light = found[own]
    found = found - same * covariance[:, own] @ np.linalg.solve(covariance[own, own], light)
    spread = (1.0 - same) * (covariance[own, own] + same * np.outer(light, light))
    log_rgb = known.texture(found[:n])
    offsets = found[-2 * len(barycentric) :].reshape(2, -1) @ barycentric
    displaced = log_rgb + np.einsum("an,nac->nc", offsets, frame.gradient(log_rgb))
    appearance = ShadowFree(log_rgb, found[:n], np.sqrt(np.diag(covariance)[:n]), found[own])
    return InLight(appearance, displaced.astype(np.float32), spread)


def as_in_training(light: np.ndarray, covariance: np.ndarray) -> float:
    """Return the probability that the coordinates of light (k,), whose prior is N(0, 1), are all 0.

    Both cases are equally likely beforehand. Their ratio is that of the densities of posterior and prior at 0
    (Dickey, "The weighted likelihood ratio", Annals of Mathematical Statistics 1971).
    """
    exponent = -0.5 * (light @ np.linalg.solve(covariance, light) + np.linalg.slogdet(covariance)[1])
    return float(1.0 / (1.0 + np.exp(-np.clip(exponent, -500.0, 500.0))))


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
    """Compute the weights of :class:`Problem`, (n, 3, 3) float64."""
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
