"""Joint estimation of the appearance and the light of a fitted image.

The invariant alone (:func:`liaam.relighting.shadow_free`) discards brightness and one direction of colour. If the
light is estimated jointly, all three channels contribute to the appearance. At a pixel x of the reference frame, the
image's log light is modelled as

    y(x) = A0(x) + sum_i lambda_i A_i(x)           appearance (paper eq 4)
         + sum_j h_j H_j(x) + c + e(x)             light, level and errors.

H are modes of light, which the model learnt from lamps, on the object and around it, or smooth ones without lamps; c is
one colour, by which exposures, white balances and skins differ. The errors e are noise, what the modes do not explain,
and the model's errors on left-out training images. They have long tails, such as marks and cast shadows, so each pass
solves weighted least squares with Gaussian priors, and then weighs the pixels by Student's t distribution.

Most images of an object may be in the training light, and errors of the model always look like a little light. So the
light is 0 with the probability that the data give to it, and its coordinates are means over both cases. An image that
is darker or redder as a whole is no evidence of another light, as its level c explains it; under another light, the
level is removed as well.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.polynomial.legendre import legvander

from liaam.lamps.bank import HALF, in_field, sample_field
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of
from liaam.photometry import Response, from_linear
from liaam.photometry.invariant import CHROMATICITY, THETA_DEFAULT, temperature_direction
from liaam.photometry.noise import noise_deviation
from liaam.photometry.response import log_slope
from liaam.relighting.appearance import ShadowFree
from liaam.relighting.painting import Region
from liaam.training.textures import sample_appearance

SQUARE, LEAST_UNEXPLAINED = HALF * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float64), 0.05
"""Corners of the square around the mean shape to which lamps' light is known, and lower bound on the standard deviation
of what its modes do not explain, as there may be few lamps."""

DEGREE, OF_COLOUR, AMOUNT, UNEXPLAINED = 6, 3, 0.8, 0.06
"""Without lamps: degrees of the polynomials of brightness and of colour temperature, standard deviation of their
coefficients in logarithms, which is divided by one plus their degree, and of what they do not explain."""

CORRELATED, ACROSS = 0.15, 4
"""Side of the area in which errors count as one, as a fraction of the frame's diagonal, and number of samples across
it. Modes learnt from lamps leave smooth errors; counted pixel by pixel, they would outweigh the priors."""

NOISE_FACTOR, UNKNOWN, COLOURED = 3.0, 0.05, 0.37
"""Factor on the noise's variance, to which rounding and JPEG compression add; standard deviation of the model's errors
if training has not measured it; and that of the colour of what modes do not explain, relative to its brightness."""

LEVEL, TINT, NO_PRIOR = 0.3, 0.1, 1e-6
"""Standard deviations of the brightness and of each of two colours of an image's level, in logarithms, and lower bound
on the prior's strength, which keeps unobserved coordinates determined."""

PASSES, FREEDOM = 3, 2.0
"""Number of passes; more make no visible difference. Degrees of freedom of Student's t distribution of the errors."""


@lru_cache(maxsize=4)
def light_on_frame(model: AAM) -> tuple[np.ndarray, np.ndarray]:
    """Return modes of light on a model's reference frame, each one standard deviation, (k, n_pixels, 3) float32.

    Also return the standard deviation of what they do not explain, (n_pixels,). Without lamps, they are products of
    Legendre polynomials in x and y, of brightness and then of colour temperature.
    """
    mean, frame, modes = model.shape_model.mean, model.frame, []
    if model.light is None:
        away = frame.pixels - frame.pixels.mean(axis=0)
        down, right = legvander(away / np.abs(away).max(), DEGREE).transpose(1, 2, 0)
        theta = model.camera.theta if np.isfinite(model.camera.theta) else THETA_DEFAULT
        for degree, colour in ((DEGREE, np.ones(3)), (OF_COLOUR, temperature_direction(theta))):
            pairs = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
            modes += [np.outer(AMOUNT / (1 + i + j) * down[i] * right[j], colour) for i, j in pairs]
        return np.array(modes, np.float32), np.full(model.n_pixels, UNEXPLAINED)
    away = frame.pixels[:, ::-1] + frame.origin - 0.5 * (mean.min(axis=0) + mean.max(axis=0))
    at = in_field(away / diagonal_of(mean))[:, None]
    pictures = [*model.light.modes, model.light.remainder]
    *modes, remainder = (sample_field(picture.astype(np.float32), at)[:, 0] for picture in pictures)
    return np.stack(modes), np.maximum(remainder, LEAST_UNEXPLAINED)


def light_on_image(model: AAM, coordinates: np.ndarray, region: Region) -> np.ndarray:
    """Return the change of log light around an object in a region of an image, (h, w, 3) float32; 0 without lamps."""
    if model.light is None or not coordinates.any():
        return np.zeros((*region.small[::-1], 3), np.float32)
    change = np.tensordot(coordinates.astype(np.float32), model.light.modes.astype(np.float32), axes=1)
    origin, right, down = in_field(align(model.light.mean, region.shape).inverse()(np.eye(3, 2, -1))).astype(np.float64)
    pose = np.column_stack([right - origin, down - origin, origin])
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(change, pose, region.small, flags=how, borderMode=cv2.BORDER_REPLICATE)


class Seen(NamedTuple):
    """A fitted image sampled on the model's reference frame, at the blur of its sharpest level.

    Logarithms of linear light (n_pixels, 3), which pixels are usable (n_pixels,), 0 or 1, and the variances of the
    noise of the logarithms.
    """

    log: np.ndarray
    usable: np.ndarray
    noise: np.ndarray

    @classmethod
    def of(cls, model: AAM, image: np.ndarray, shape: np.ndarray, response: Response) -> "Seen":
        """Warp an image (h, w, 3) by its fitted landmarks (n, 2)."""
        log, usable = sample_appearance(image, shape, model.warp, "log", response, model.levels[-1].blur)
        noise = noise_deviation(image) / max(1.0, align(model.shape_model.mean, shape).scale)
        noise = noise_of_log(from_linear(np.exp(log), response), response, noise)
        return cls(log, usable, np.square(noise).astype(np.float32))


def appearance_in_light(model: AAM, seen: Seen, prior: float = 1.0) -> tuple[ShadowFree, np.ndarray, np.ndarray]:
    """Estimate the appearance under the training light jointly with the light; ``prior`` is that of the appearance.

    Also return the covariance (k, k) of the coordinates of the light, and the logarithm of the image's level (3,),
    times the probability of another light than that of training.
    """
    known, (every, unexplained) = model.levels[-1].appearances["log"], light_on_frame(model)
    n, side = known.n_modes, CORRELATED * model.diagonal
    step = max(1, int(side / ACROSS))
    kept = np.flatnonzero((model.frame.pixels % step == 0).all(axis=1))
    part, usable = known.at(kept), (seen.usable * (known.usable > 0))[kept]
    together = 1.0 if model.light is None else max(1.0, np.square(side / step))
    levels = np.array([np.full(3, LEVEL), *(TINT * CHROMATICITY)], np.float32)
    every = np.concatenate([every[:, kept], np.broadcast_to(levels[:, None], (3, len(kept), 3))])
    precision = np.concatenate([max(prior, NO_PRIOR) / np.maximum(known.eigenvalues, 1e-12), np.ones(len(every))])
    grey, each = np.ones((3, 3)), np.eye(3)
    of_light = np.square(unexplained[kept])[:, None, None] * (grey + COLOURED**2 * (each - grey / 3.0))
    of_model = UNKNOWN**2 * grey if part.unexplained is None else part.unexplained
    errors = of_model + NOISE_FACTOR * seen.noise[kept, None] * each + of_light
    whitened = np.linalg.cholesky(np.linalg.inv(errors)).astype(np.float32)
    target = np.einsum("nc,ncd->nd", seen.log[kept] - part.mean, whitened).ravel()
    modes = np.einsum("mnc,ncd->mnd", np.concatenate([part.modes, every]), whitened, optimize=True)
    modes, weights = modes.reshape(len(modes), -1), usable
    for _ in range(PASSES):
        rows = modes * np.repeat(weights / np.float32(together), 3)
        hessian = (rows @ modes.T).astype(np.float64) + np.diag(precision)
        found = np.linalg.solve(hessian, rows @ target)
        left = (target - found.astype(np.float32) @ modes).reshape(-1, 3)
        weights = usable * ((FREEDOM + 3.0) / (FREEDOM + np.square(left).sum(axis=1)))
    own, covariance = slice(n, -3), np.linalg.inv(hessian)
    light, variance = found[own], covariance[own, own]
    same = as_in_training(light, variance)
    level = np.float32(1.0 - same) * (found[-3:].astype(np.float32) @ levels)
    found = found - same * covariance[:, own] @ np.linalg.solve(variance, light)
    spread = (1.0 - same) * (variance + same * np.outer(light, light))
    deviations = np.sqrt(np.diag(covariance)[:n])
    return ShadowFree(known.texture(found[:n]), found[:n], deviations, found[own]), spread, level


def as_in_training(light: np.ndarray, covariance: np.ndarray) -> float:
    """Return the probability that the coordinates of light (k,), whose prior is N(0, 1), are all 0.

    Both cases are equally likely beforehand. Their ratio is that of the densities of posterior and prior at 0
    (Dickey, "The weighted likelihood ratio", Annals of Mathematical Statistics 1971).
    """
    exponent = -0.5 * (light @ np.linalg.solve(covariance, light) + np.linalg.slogdet(covariance)[1])
    return float(1.0 / (1.0 + np.exp(-np.clip(exponent, -500.0, 500.0))))


def noise_of_log(stored: np.ndarray, response: Response, deviation: float) -> np.ndarray:
    """Return the standard deviation of logarithms of light from that of stored values in [0, 1] (any shape)."""
    return deviation * log_slope(np.maximum(stored, 0.5 / 255), response)
