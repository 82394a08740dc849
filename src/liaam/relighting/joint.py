"""Joint estimation of appearance, light and landmark corrections of a fitted image.

The invariant alone (:func:`liaam.relighting.shadow_free`) discards brightness and one direction of colour. If the
light is estimated jointly, all three channels contribute to the appearance. At a pixel x of the reference frame, the
image's log light is modelled as

    y(x) = A0(x) + sum_i lambda_i A_i(x)           appearance (paper eq 4)
         + sum_v beta_v(x) u_v . grad A(x)         landmarks v displaced by u_v (eq 3, to first order)
         + sum_j h_j H_j(x) + e(x)                 light and errors.

H are modes of light (:mod:`liaam.relighting.basis`). The errors e are noise, what the modes of light do not explain,
and the model's errors on left-out training images. They have long tails, such as marks and cast shadows, so each pass
solves weighted least squares with Gaussian priors, and then weighs the pixels by Student's t distribution.

Most images of an object may be in the training light, and errors of the model always look like a little light. So the
light is 0 with the probability that the data give to it, and its coordinates are means over both cases.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from liaam.model import AAM
from liaam.model.appearance import AppearanceModel
from liaam.model.mesh import ReferenceFrame
from liaam.relighting.appearance import ShadowFree
from liaam.relighting.basis import light_on_frame, unexplained_on_frame
from liaam.relighting.seen import NOISE_FACTOR, UNKNOWN, Seen

CORRELATED, ACROSS = 0.15, 4
"""Side of the area in which errors count as one, as a fraction of the frame's diagonal, and number of samples across
it. Modes learnt from lamps leave smooth errors, which would outweigh the priors if they counted as independent from
pixel to pixel."""

COLOURED = 0.37
"""Standard deviation of the colour of what the modes do not explain, relative to that of its brightness."""

OFF = 0.5
"""Standard deviation of a fitted landmark, pixels of the reference frame."""

FINE_BRIGHTNESS, FINE_COLOUR = 0.03, 0.02
"""Standard deviations of detail that neither model nor light explains, in logarithms."""

PASSES = 3
"""Number of passes; more make no visible difference."""

FREEDOM = 2.0
"""Degrees of freedom of Student's t distribution of the errors."""

NO_PRIOR = 1e-6
"""Lower bound on the prior's strength, which keeps unobserved coordinates determined."""


class InLight(NamedTuple):
    """Appearance and light of a fitted image."""

    appearance: ShadowFree
    """Appearance under the training light."""
    log_rgb: np.ndarray
    """(n_pixels, 3) float32: its log light with the landmark corrections applied."""
    covariance: np.ndarray
    """(k, k): covariance of the coordinates of the light."""


def appearance_in_light(model: AAM, seen: Seen, prior: float = 1.0) -> InLight:
    """Estimate the appearance under the training light jointly with the light.

    ``prior`` is that of :func:`liaam.relighting.shadow_free`.
    """
    known, frame, every = model.levels[-1].appearances["log"], model.frame, light_on_frame(model)
    n, k, side = known.n_modes, len(every), CORRELATED * model.diagonal
    step = max(1, int(side / ACROSS))
    kept, barycentric = every_few(frame, step), _barycentric(frame)
    part, lit, usable = known.at(kept), every[:, kept], (seen.usable * (known.usable > 0))[kept]
    together = 1.0 if model.light is None else max(1.0, np.square(side / step))
    precision = np.concatenate([max(prior, NO_PRIOR) / np.maximum(known.eigenvalues, 1e-12), np.ones(k)])
    precision = np.concatenate([precision, np.full(2 * len(barycentric), OFF**-2.0)])
    whitened = _whitened(part, seen.noise[kept], unexplained_on_frame(model)[kept])
    target = np.einsum("nc,ncd->nd", seen.log[kept] - part.mean, whitened)
    fixed = np.einsum("mnc,ncd->mnd", np.concatenate([part.modes, lit]), whitened, optimize=True)
    weights, slopes = usable, _mean_slopes(model)
    for _ in range(PASSES):
        offsets = np.einsum("nac,ncd->and", slopes[kept], whitened)[:, None] * barycentric[:, kept, None]
        modes = np.concatenate([fixed, offsets.reshape(-1, *target.shape)])
        root = np.sqrt(weights)[:, None]
        rows = (modes * root).reshape(len(modes), -1)
        hessian = (rows @ rows.T).astype(np.float64) / together + np.diag(precision)
        found = np.linalg.solve(hessian, (rows @ (target * root).ravel()) / together)
        left = target - np.tensordot(found.astype(np.float32), modes, axes=1)
        weights = usable * ((FREEDOM + 3.0) / (FREEDOM + np.square(left).sum(axis=1)))
        slopes = frame.gradient(known.texture(found[:n])).astype(np.float32)
    own, covariance = slice(n, n + k), np.linalg.inv(hessian)
    light, variance = found[own], covariance[own, own]
    same = as_in_training(light, variance)
    found = found - same * covariance[:, own] @ np.linalg.solve(variance, light)
    spread = (1.0 - same) * (variance + same * np.outer(light, light))
    log_rgb = known.texture(found[:n])
    offsets = found[-2 * len(barycentric) :].reshape(2, -1) @ barycentric
    displaced = log_rgb + np.einsum("an,nac->nc", offsets, slopes)
    appearance = ShadowFree(log_rgb, found[:n], np.sqrt(np.diag(covariance)[:n]), found[own])
    return InLight(appearance, displaced.astype(np.float32), spread)


def as_in_training(light: np.ndarray, covariance: np.ndarray) -> float:
    """Return the probability that the coordinates of light (k,), whose prior is N(0, 1), are all 0.

    Both cases are equally likely beforehand. Their ratio is that of the densities of posterior and prior at 0
    (Dickey, "The weighted likelihood ratio", Annals of Mathematical Statistics 1971).
    """
    exponent = -0.5 * (light @ np.linalg.solve(covariance, light) + np.linalg.slogdet(covariance)[1])
    return float(1.0 / (1.0 + np.exp(-np.clip(exponent, -500.0, 500.0))))


def _whitened(known: AppearanceModel, noise: np.ndarray, of_light: np.ndarray) -> np.ndarray:
    """Return the factors (n, 3, 3) float32 that whiten the errors at pixels, (n, 3), from the right."""
    grey, every = np.ones((3, 3)), np.eye(3)
    unexplained = UNKNOWN**2 * grey if known.unexplained is None else known.unexplained
    fine = FINE_BRIGHTNESS**2 * grey + FINE_COLOUR**2 * every
    light = np.square(of_light)[:, None, None] * (grey + COLOURED**2 * (every - grey / 3.0))
    covariance = unexplained + fine + NOISE_FACTOR * noise[:, None] * every + light
    return np.linalg.cholesky(np.linalg.inv(covariance)).astype(np.float32)


@lru_cache(maxsize=8)
def every_few(frame: ReferenceFrame, step: int) -> np.ndarray:
    """Return the pixels at every ``step``-th row and column of a frame."""
    return np.flatnonzero((frame.pixels % step == 0).all(axis=1))


@lru_cache(maxsize=4)
def _mean_slopes(model: AAM) -> np.ndarray:
    """Return the derivatives of the mean appearance along x and y, (n_pixels, 2, 3) float32."""
    return model.frame.gradient(model.levels[-1].appearances["log"].mean).astype(np.float32)


@lru_cache(maxsize=4)
def _barycentric(frame: ReferenceFrame) -> np.ndarray:
    """Return the barycentric weights beta_v(x) of eq 3, (n_points, n_pixels) float32."""
    weights = np.zeros((len(frame.points), frame.n_pixels), np.float32)
    np.put_along_axis(weights, frame.vertices.T, frame.weights.T.astype(np.float32), axis=0)
    return weights
