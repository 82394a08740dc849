"""Modes of light: those that a model learnt from lamps, on the object and around it, or smooth ones without lamps."""

from functools import lru_cache

import numpy as np

from liaam.lamps.bank import HALF, in_field, sample_field
from liaam.model import AAM
from liaam.model.light import LightBasis
from liaam.model.shape import align, diagonal_of
from liaam.photometry.invariant import temperature_direction
from liaam.relighting.region import Region
from liaam.relighting.seen import angle_of

LEAST_UNEXPLAINED = 0.05
"""Lower bound on the standard deviation of what a basis does not explain, for bases learnt from few lamps."""

DEGREE, OF_COLOUR, AMOUNT = 6, 3, 0.8
"""Without lamps: degrees of the polynomials of brightness and of colour temperature, and standard deviation of their
coefficients in logarithms, which is divided by one plus their own degree."""

UNEXPLAINED = 0.06
"""Without lamps: standard deviation of what the polynomials do not explain. Cast shadows are outliers."""


@lru_cache(maxsize=4)
def light_on_frame(model: AAM) -> np.ndarray:
    """Return modes of light on a model's reference frame, each one standard deviation, (k, n_pixels, 3) float32."""
    if model.light is None:
        return _polynomials(model)
    return np.stack([_at_frame(model, mode) for mode in model.light.modes])


@lru_cache(maxsize=4)
def unexplained_on_frame(model: AAM) -> np.ndarray:
    """Return the standard deviation of what the modes of light do not explain, (n_pixels,)."""
    if model.light is None:
        return np.full(model.n_pixels, UNEXPLAINED)
    return np.maximum(_at_frame(model, model.light.remainder), LEAST_UNEXPLAINED)


def light_on_image(model: AAM, coordinates: np.ndarray, region: Region) -> np.ndarray:
    """Return the change of log light around an object in a region of an image, (h, w, 3) float32; 0 without lamps."""
    import cv2

    if model.light is None or not coordinates.any():
        return np.zeros((*region.small[::-1], 3), np.float32)
    change = np.tensordot(coordinates.astype(np.float32), model.light.modes.astype(np.float32), axes=1)
    origin, right, down = in_field(align(model.light.mean, region.shape).inverse()(np.eye(3, 2, -1))).astype(np.float64)
    pose = np.column_stack([right - origin, down - origin, origin])
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(change, pose, region.small, flags=how, borderMode=cv2.BORDER_REPLICATE)


def square_around(light: LightBasis, shape: np.ndarray, size: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of an image of a size (height, width, ...) to which a basis reaches."""
    corners = align(light.mean, shape)(HALF * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float64))
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int) + 1
    return slice(max(low[1], 0), min(high[1], size[0])), slice(max(low[0], 0), min(high[0], size[1]))


def _polynomials(model: AAM) -> np.ndarray:
    """Return products of Legendre polynomials in x and y, of brightness and then of colour temperature."""
    from numpy.polynomial import legendre

    frame = model.frame
    away = frame.pixels - frame.pixels.mean(axis=0)
    down, right = legendre.legvander(away / np.abs(away).max(), DEGREE).transpose(1, 2, 0)

    def modes(degree: int, colour: np.ndarray) -> list[np.ndarray]:
        pairs = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
        return [np.outer(AMOUNT / (1 + i + j) * down[i] * right[j], colour) for i, j in pairs]

    coloured = temperature_direction(angle_of(model.camera.theta))
    return np.array(modes(DEGREE, np.ones(3)) + modes(OF_COLOUR, coloured), np.float32)


def _at_frame(model: AAM, picture: np.ndarray) -> np.ndarray:
    """Sample a picture on the square, (side, side, ...), at the pixels of a model's reference frame."""
    mean, frame = model.shape_model.mean, model.frame
    middle = 0.5 * (mean.min(axis=0) + mean.max(axis=0))
    away = (frame.pixels[:, ::-1] + frame.origin - middle) / diagonal_of(mean)
    return sample_field(picture.astype(np.float32), in_field(away)[:, None])[:, 0]
