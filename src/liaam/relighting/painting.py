"""From the model's reference frame to an image, at one of two resolutions, and from stored values to light and back."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from liaam import _core
from liaam.model import AAM
from liaam.model.mesh import signed_areas
from liaam.model.shape import diagonal_of
from liaam.photometry import Response, from_linear, to_linear
from liaam.photometry.encoding import as_colour, stored_values
from liaam.relighting.appearance import ShadowFree

LARGEST = 10  # Size of a shape, relative to the image, beyond which it is not painted
REACH = 0.04  # Standard deviation of the Gaussian by which shading is removed beyond the mesh, in diagonals
FINEST = 160.0  # Largest diagonal of an object, in pixels, at which light is computed; in larger ones it is enlarged
BINS = 65536  # Number of steps of the logarithm of light from black to white
LEAST_WEIGHT = 1e-3  # Of a sample at the mesh's border; less is rounding
LEAST_AREA = 1e-3  # Of a triangle in square pixels; smaller ones are flat


@dataclass(frozen=True, eq=False)
class Region:
    """The part of an image that relighting changes, and the lower resolution at which its light is computed."""

    box: tuple[slice, slice]  # rows and columns of the image
    size: tuple[int, int]  # width and height, pixels of the image
    small: tuple[int, int]  # width and height, pixels of light
    shape: np.ndarray  # (n, 2): landmarks, pixels of light

    @classmethod
    def of(cls, shape: np.ndarray, box: tuple[slice, slice]) -> "Region":
        """Choose the resolution of light for an object with landmarks (n, 2) in a box of an image."""
        rows, columns = box
        width = columns.stop - columns.start
        height = rows.stop - rows.start
        factor = min(1.0, FINEST / max(diagonal_of(shape), 1e-6))
        small = _scaled(width, factor), _scaled(height, factor)
        scale = np.divide(small, np.maximum((width, height), 1))
        from_corner = shape - (columns.start, rows.start) + 0.5  # of the box, not from the centre of its first pixel
        return cls(box, (width, height), small, from_corner * scale - 0.5)

    @property
    def reach(self) -> float:
        """Distance over which a new light fades out around the mesh, pixels of light."""
        return max(1.0, REACH * diagonal_of(self.shape))

    def reduced(self, picture: np.ndarray) -> np.ndarray:
        """Average a picture of the box, (h, w, up to 4), to the resolution of light."""
        return picture if self.size == self.small else cv2.resize(picture, self.small, interpolation=cv2.INTER_AREA)

    def enlarged(self, layers: np.ndarray) -> np.ndarray:
        """Interpolate layers of light, (h, w, up to 4), at the pixels of the box."""
        return layers if self.size == self.small else cv2.resize(layers, self.size, interpolation=cv2.INTER_LINEAR)


def _scaled(length: int, factor: float) -> int:
    """Return a length times a factor up to 1, in whole pixels: at least one, unless there is none."""
    return min(length, max(1, round(length * factor)))


def box_of(points: np.ndarray, margin: float, size: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of points (n, 2) plus a margin, in an image of a size (height, width, ...)."""
    left, top = np.floor(points.min(axis=0) - margin).astype(int).tolist()
    right, bottom = np.ceil(points.max(axis=0) + margin).astype(int).tolist()
    return slice(max(top, 0), min(bottom + 1, size[0])), slice(max(left, 0), min(right + 1, size[1]))


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
    picture = np.zeros((*image.shape[:2], values.shape[1]), np.float32)
    inside = np.zeros(image.shape[:2], bool)
    triangles = seen_triangles(image, shape, model)
    if not len(triangles):
        return picture, inside
    rows, columns = box_of(shape, 0.0, image.shape)
    height = rows.stop - rows.start
    width = columns.stop - columns.start
    corners = np.pad(shape - (columns.start, rows.start), ((0, 0), (0, 1)))  # at equal depths, 0
    on_frame = model.shape_model.mean - model.frame.origin
    triangle_of, position_of = _core.draw_triangles(
        corners, np.ascontiguousarray(triangles, np.int32), on_frame, height, width
    )
    y, x = np.nonzero(triangle_of >= 0)
    # At the mesh's border, pixels outside it have no weight: the last value that is sampled is that of the others.
    # The channel after it tells the core what is usable, and is not among the samples.
    ones = np.ones((len(values), 1), np.float32)
    layers = model.frame.picture(np.concatenate([values, ones, ones], axis=1))
    warped, _ = _core.sample_channels(np.ascontiguousarray(layers, np.float32), position_of[y, x])
    has_weight = warped[:, -1] > LEAST_WEIGHT
    at = y[has_weight] + rows.start, x[has_weight] + columns.start
    picture[at] = warped[has_weight, :-1] / warped[has_weight, -1:]
    inside[at] = True
    return picture, inside


def seen_triangles(image: np.ndarray, shape: np.ndarray, model: AAM) -> np.ndarray:
    """Return the triangles of a shape's mesh that are not flipped, (t, 3); none if the shape is outside the image."""
    height, width = image.shape[:2]
    # A diverged fit may have any size.
    is_sane = np.isfinite(shape).all() and np.ptp(shape, axis=0).max() < LARGEST * max(height, width)
    if not is_sane or (shape.max(axis=0) < 0).any() or (shape.min(axis=0) > (width - 1, height - 1)).any():
        return model.triangles[:0]
    return model.triangles[signed_areas(shape, model.triangles) > LEAST_AREA]


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
    """Return the logarithm of linear light of stored values (any shape), float32; black counts as half a step."""
    if image.dtype == np.uint8:
        table = _log_light(np.arange(256, dtype=np.uint8), response)  # faster
        return table[image]
    return _log_light(image, response)


def _log_light(image: np.ndarray, response: Response) -> np.ndarray:
    """Return the logarithm of linear light of each stored value, float32."""
    black, _ = _from_black_to_white(response)
    return np.log(np.maximum(to_linear(stored_values(image), response), np.exp(black))).astype(np.float32)


def eight_bits(log_light: np.ndarray, response: Response) -> np.ndarray:
    """Convert logarithms of light (any shape) to stored values, uint8, clipped at white; by a table."""
    black, table = _from_black_to_white(response)
    # In place, as images are large: from black (0) to white (BINS - 1), rounded.
    at = log_light - black
    at *= (1 - BINS) / black
    at += np.float32(0.5)
    np.clip(at, 0.0, BINS - 1.0, out=at)
    return table[at.astype(np.uint16)]


@lru_cache(4)
def _from_black_to_white(response: Response) -> tuple[np.float32, np.ndarray]:
    """Return the logarithm of light of black, and the stored values, (BINS,) uint8, of logarithms from there to 0."""
    black = np.log(0.5 * to_linear(np.array(1 / 255), response))
    stored = from_linear(np.exp(np.linspace(black, 0.0, BINS)), response)
    stored = stored * (np.arange(BINS) > 0)  # the first is black, not half a step above
    return np.float32(black), np.rint(255 * np.clip(stored, 0.0, 1.0)).astype(np.uint8)


def mean_of(log_rgb: np.ndarray) -> np.ndarray:
    """Return the means (h, w) over the channels of a picture (h, w, 3)."""
    return cv2.transform(log_rgb, np.full((1, 3), 1 / 3, np.float32))


def smoothstep(x: np.ndarray) -> np.ndarray:
    """Rise smoothly from 0 at 0 to 1 at 1."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def averages(values: np.ndarray, weights: np.ndarray, radius: float, fallback: float = 0.0) -> np.ndarray:
    """Average values (h, w, c) float32 by weights (h, w, 1), and ``fallback`` everywhere, in two boxes of a radius."""
    sums = np.concatenate([values * weights, weights], axis=2).astype(np.float32)
    everywhere = fallback * np.array(cv2.mean(sums)[: sums.shape[2]], np.float32)
    width = 2 * round(radius) + 1
    sums = cv2.blur(cv2.blur(sums, (width, width)), (width, width)) + everywhere
    return sums[..., :-1] / np.maximum(sums[..., -1:], 1e-20)
