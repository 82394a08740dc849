"""Modes of light: those that a model learnt from lamps, on the object and around it, or smooth ones without lamps."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.polynomial.legendre import legvander

from liaam.lamps.bank import HALF, in_field, sample_field
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of
from liaam.photometry.invariant import THETA_DEFAULT, temperature_direction
from liaam.relighting.painting import Region

LEAST_UNEXPLAINED = 0.05
"""Lower bound on the standard deviation of what a basis does not explain, for bases learnt from few lamps."""

DEGREE, OF_COLOUR, AMOUNT, UNEXPLAINED = 6, 3, 0.8, 0.06
"""Without lamps: degrees of the polynomials of brightness and of colour temperature, standard deviation of their
coefficients in logarithms, which is divided by one plus their own degree, and of what they do not explain. Cast shadows
are outliers."""

SQUARE = HALF * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float64)
"""Corners of the square around the mean shape to which a basis reaches."""


@lru_cache(maxsize=4)
def light_on_frame(model: AAM) -> tuple[np.ndarray, np.ndarray]:
    """Return modes of light on a model's reference frame, each one standard deviation, (k, n_pixels, 3) float32.

    Also return the standard deviation of what they do not explain, (n_pixels,).
    """
    if model.light is None:
        return _polynomials(model), np.full(model.n_pixels, UNEXPLAINED)
    mean, frame = model.shape_model.mean, model.frame
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


def _polynomials(model: AAM) -> np.ndarray:
    """Return products of Legendre polynomials in x and y, of brightness and then of colour temperature."""
    away = model.frame.pixels - model.frame.pixels.mean(axis=0)
    down, right = legvander(away / np.abs(away).max(), DEGREE).transpose(1, 2, 0)
    theta = model.camera.theta if np.isfinite(model.camera.theta) else THETA_DEFAULT
    return np.array(
        [
            np.outer(AMOUNT / (1 + i + j) * down[i] * right[j], colour)
            for degree, colour in ((DEGREE, np.ones(3)), (OF_COLOUR, temperature_direction(theta)))
            for i in range(degree + 1)
            for j in range(degree + 1 - i)
        ],
        np.float32,
    )
