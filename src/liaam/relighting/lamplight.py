"""The light of an image as a model trained with lamps knows it: on the object and around it."""

from functools import lru_cache

import numpy as np

from liaam.lamps.bank import HALF, in_field, places, sample_field
from liaam.model import AAM
from liaam.model.light import LightBasis
from liaam.model.shape import align, diagonal_of

LEAST_UNEXPLAINED = 0.05
"""Lower bound on the standard deviation of what a basis does not explain, for bases learnt from few lamps."""


@lru_cache(maxsize=4)
def light_on_frame(model: AAM) -> np.ndarray:
    """Return the modes of a model's light on its reference frame, (k, n_pixels, 3) float32; k is 0 without a basis."""
    if model.light is None:
        return np.zeros((0, model.n_pixels, 3), np.float32)
    return np.stack([_at_frame(model, mode) for mode in model.light.modes])


def lit_frame(model: AAM, coordinates: np.ndarray) -> np.ndarray:
    """Return the change of log light on the reference frame, (n_pixels, 3); 0 for no coordinates."""
    return np.tensordot(coordinates, light_on_frame(model)[: len(coordinates)], axes=1)


@lru_cache(maxsize=4)
def unexplained_on_frame(model: AAM) -> np.ndarray:
    """Return the standard deviation of what a model's light does not explain, (n_pixels,); infinite without a basis."""
    if model.light is None:
        return np.full(model.n_pixels, np.inf)
    return np.maximum(_at_frame(model, model.light.remainder), LEAST_UNEXPLAINED)


def light_on_image(
    model: AAM, coordinates: np.ndarray, shape: np.ndarray, box: tuple[slice, slice], size: tuple[int, ...]
) -> np.ndarray:
    """Return the change of log light around landmarks in a box of an image, (*size, 3) float32; 0 without a basis."""
    if model.light is None or not len(coordinates):
        return np.zeros((*size, 3), np.float32)
    at = places(model.light.mean, shape - (box[1].start, box[0].start), (size[1], size[0]))
    change = np.tensordot(coordinates.astype(np.float32), model.light.modes.astype(np.float32), axes=1)
    return sample_field(change, at)


def square_around(light: LightBasis, shape: np.ndarray, size: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of an image of a size (height, width) to which a basis reaches."""
    corners = align(light.mean, shape)(HALF * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float64))
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int) + 1
    return slice(max(low[1], 0), min(high[1], size[0])), slice(max(low[0], 0), min(high[0], size[1]))


def _at_frame(model: AAM, picture: np.ndarray) -> np.ndarray:
    """Sample a picture on the square, (side, side, ...), at the pixels of a model's reference frame."""
    mean, frame = model.shape_model.mean, model.frame
    middle = 0.5 * (mean.min(axis=0) + mean.max(axis=0))
    away = (frame.pixels[:, ::-1] + frame.origin - middle) / diagonal_of(mean)
    return sample_field(picture.astype(np.float32), in_field(away)[:, None])[:, 0]
