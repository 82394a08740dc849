"""Warping from the model's reference frame to an image, and blending at the mesh's border."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from liaam import _core
from liaam.model import AAM
from liaam.model.mesh import signed_areas
from liaam.photometry import Response, from_linear, to_linear
from liaam.photometry.encoding import as_colour, stored_values
from liaam.relighting.appearance import ShadowFree

LARGEST = 10
"""Size of a shape, relative to the image, beyond which it is not painted."""

SOFT_EDGE = 0.05
"""Width of the border in which appearance and image are blended, as a fraction of the model's diagonal."""

REACH = 0.04
"""Standard deviation of the Gaussian by which shading is removed beyond the mesh, as a fraction of the diagonal."""

DARKEST, BINS = -9.0, 65536
"""Logarithm of light that is stored as 0, and number of steps from there to white."""


def paint(image: np.ndarray, shape: np.ndarray, model: AAM, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Warp values of the reference frame to a shape in an image (the inverse of paper eq 3).

    Parameters
    ----------
    image : (h, w, ...) array
        Only its size is used.
    shape : (n, 2) float
        Landmarks, image pixels.
    model : AAM
    values : (n_pixels, c) float32

    Returns
    -------
    picture : (h, w, c) float32
        Zero outside the mesh and in flipped triangles, and everywhere for a shape that is not finite or many times as
        large as the image.
    inside : (h, w) bool
        Where ``picture`` has values.
    """
    height, width = image.shape[:2]
    picture, inside = np.zeros((height, width, values.shape[1]), np.float32), np.zeros((height, width), bool)
    triangles = seen_triangles(image, shape, model)
    if not len(triangles):
        return picture, inside
    left, top = np.clip(np.floor(shape.min(axis=0)), 0, (width - 1, height - 1)).astype(int)
    right, bottom = np.clip(np.ceil(shape.max(axis=0)) + 1, 1, (width, height)).astype(int)
    there = model.shape_model.mean - model.frame.origin
    corners = np.ascontiguousarray(triangles, np.int32)
    owner, own = _core.carry(
        np.ascontiguousarray(shape - (left, top), np.float64), corners, there, right - left, bottom - top
    )
    y, x = np.nonzero(owner >= 0)
    # At the mesh's border, pixels outside it have no weight.
    known = np.ones((len(values), 1), np.float32)
    layers = model.frame.picture(np.concatenate([values, known, known], axis=1))
    warped, _ = _core.sample_channels(np.ascontiguousarray(layers, np.float32), own[y, x])
    kept = warped[:, -1] > 1e-3
    y, x, warped = y[kept] + top, x[kept] + left, warped[kept]
    picture[y, x] = warped[:, :-1] / warped[:, -1:]
    inside[y, x] = True
    return picture, inside


def seen_triangles(image: np.ndarray, shape: np.ndarray, model: AAM) -> np.ndarray:
    """Return the triangles of a shape's mesh that are not flipped, (t, 3); none if the shape is outside the image."""
    height, width = image.shape[:2]
    # A diverged fit may have any size.
    sane = np.isfinite(shape).all() and np.ptp(shape, axis=0).max() < LARGEST * max(height, width)
    if not sane or (shape.max(axis=0) < 0).any() or (shape.min(axis=0) > (width - 1, height - 1)).any():
        return model.triangles[:0]
    return model.triangles[signed_areas(shape, model.triangles) > 1e-3]


def without_shading(
    image: np.ndarray, shape: np.ndarray, model: AAM, appearance: ShadowFree, response: Response = "srgb"
) -> tuple[np.ndarray, np.ndarray]:
    """Return the image with the object under the training light (paper eq 11), and the shading that was removed.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float array
        Stored values.
    shape : (n, 2) float
        Fitted landmarks.
    model : AAM
    appearance : ShadowFree
    response : Response
        Response of the image's camera.

    Returns
    -------
    picture : (h, w, 3) float32
        Stored values in [0, 1]; equal to the image outside the mesh.
    shading : (h, w, 3) float32
        Logarithm of image / appearance, 0 outside the mesh.
    """
    image = as_colour(image)
    log_rgb, inside = paint(image, shape, model, appearance.log_rgb)
    fresh = np.clip(from_linear(np.exp(log_rgb), response), 0, 1)
    picture = np.where(inside[..., None], fresh, stored_values(image)).astype(np.float32)
    return picture, np.where(inside[..., None], log_light(image, response) - log_rgb, np.float32(0.0))


def log_light(image: np.ndarray, response: Response) -> np.ndarray:
    """Return the logarithm of linear light, (h, w, 3) float32, of stored values; black counts as half a step."""
    floor = 0.5 * float(to_linear(np.array(1 / 255), response))
    return of_stored(lambda stored: np.log(np.maximum(to_linear(stored, response), floor)), image)


def of_stored(function: Callable[[np.ndarray], np.ndarray], image: np.ndarray) -> np.ndarray:
    """Apply a function to the stored values in [0, 1] of an image (any shape), by a table where that is faster."""
    if image.dtype != np.uint8:
        return function(stored_values(image)).astype(np.float32)
    return function(stored_values(np.arange(256, dtype=np.uint8))).astype(np.float32)[image]


def eight_bits(log_light: np.ndarray, response: Response) -> np.ndarray:
    """Convert logarithms of light (any shape) to stored values, uint8, clipped at white; by a table."""
    at = np.clip((log_light - DARKEST) * np.float32((BINS - 1) / -DARKEST) + np.float32(0.5), 0.0, BINS - 1.0)
    return _stored(response)[at.astype(np.uint16)]


@lru_cache(4)
def _stored(response: Response) -> np.ndarray:
    """Return the stored values, (BINS,) uint8, of logarithms of light from DARKEST to 0."""
    light = np.exp(np.linspace(DARKEST, 0.0, BINS))
    return np.rint(255 * np.clip(from_linear(light, response), 0.0, 1.0)).astype(np.uint8)


def as_eight_bit(image: np.ndarray) -> np.ndarray:
    """Convert an image to uint8; return a copy of one that is."""
    if image.dtype == np.uint8:
        return image.copy()
    return np.rint(255 * np.clip(stored_values(image), 0.0, 1.0)).astype(np.uint8)


@lru_cache(maxsize=4)
def soft_edge(model: AAM) -> np.ndarray:
    """Return weights of the model's pixels, (n_pixels,) float32: 0 at the mesh's border, 1 well inside."""
    from scipy.ndimage import distance_transform_edt

    inside = model.frame.picture(np.ones(model.n_pixels, np.float32), 0.0) > 0
    depth = np.asarray(distance_transform_edt(np.pad(inside, 1)))[1:-1, 1:-1]
    ramp = np.clip((depth - 1.0) / (SOFT_EDGE * model.diagonal), 0.0, 1.0)
    return (ramp * ramp * (3.0 - 2.0 * ramp))[inside].astype(np.float32)


def box_of(shape: np.ndarray, margin: float, size: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of landmarks (n, 2) plus a margin, in an image of a size (height, width, ...)."""
    left, top = np.floor(shape.min(axis=0) - margin).astype(int).tolist()
    right, bottom = np.ceil(shape.max(axis=0) + margin).astype(int).tolist()
    return slice(max(top, 0), min(bottom + 1, size[0])), slice(max(left, 0), min(right + 1, size[1]))


def mean_of(log_rgb: np.ndarray) -> np.ndarray:
    """Return the means (h, w) over the channels of logarithms of light (h, w, 3) float32."""
    import cv2

    return cv2.transform(log_rgb, np.full((1, 3), 1 / 3, np.float32))
