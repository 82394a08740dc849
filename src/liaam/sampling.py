"""From a stored image to what the kernels sample: the region of interest, encoded at the model's resolution."""

from dataclasses import dataclass

import numpy as np

from liaam.kernels.reference import sample
from liaam.photometry import Response, encode
from liaam.shape import Similarity, diagonal_of


@dataclass(frozen=True, eq=False)
class Patch:
    """Encoded region of interest of an image.

    Attributes
    ----------
    channels : (h, w, c + 1) float32
        Encoded pixels (see :func:`liaam.photometry.encode`), at least 2 by 2.
    from_image : Similarity
        Image pixels to patch pixels (a shift and a reduction, never a turn).
    """

    channels: np.ndarray
    from_image: Similarity


def make_patch(
    image: np.ndarray,
    shape: np.ndarray,
    pose: Similarity,
    *,
    encoding: str,
    response: Response,
    blur: float,
    margin: float,
) -> Patch:
    """Cut the surroundings of a shape out of an image and encode them at about the model's resolution.

    The image is averaged down and blurred so that model pixels do not skip over image pixels, and so that
    training and fitting see the object equally sharp whatever its size in the picture.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float32
    shape : (n, 2) float
        Points to surround, image pixels.
    pose : Similarity
        Model pixels to image pixels: its scale sets the resolution, its rotation the axes of directions.
    encoding, response
        See :func:`liaam.photometry.encode`.
    blur : float
        Standard deviation of the blur, model pixels.
    margin : float
        Surroundings to include, as a share of the shape's diagonal.
    """
    limits = np.array(image.shape[1::-1])
    size = block_size(encoding, pose.scale, blur)
    pad = margin * diagonal_of(shape) + 2 * size
    low, high = shape.min(axis=0) - pad, shape.max(axis=0) + pad
    low = np.clip(np.floor(low), 0, limits - 2)
    high = np.clip(np.ceil(high) + 1, low + 2, limits)
    size = max(1.0, min(size, (high - low).min() // 3))
    # Blocks are those of the whole image, whatever the margin: training and fitting see the same ones.
    first = np.ceil(np.floor(low / size) if size == int(size) else low / size)
    begin, end = np.floor(first * size).astype(int), high.astype(int)
    crop = image[begin[1] : end[1], begin[0] : end[0]]
    start = first * size - begin
    turn, pixel = pose.matrix.T / pose.scale, size / pose.scale
    channels = encode(crop, encoding, response, blur / pixel, size, turn, pixel, (start[0], start[1]))
    # The centre of the first block of pixels is at first * size + (size - 1) / 2.
    return Patch(channels, Similarity(np.eye(2) / size, -first - 0.5 * (size - 1) / size))


def block_size(encoding: str, scale: float, blur: float) -> float:
    """Image pixels across that are averaged into one of a patch, at least 1.

    Parameters
    ----------
    encoding : str
    scale : float
        Image pixels per model pixel.
    blur : float
        Model pixels.
    """
    if encoding != "soft":  # whole pixels, never coarser than the model's
        return float(max(1, int(scale)))
    return max(1.0, FINENESS * scale * blur)


FINENESS = 0.5
"""Size of a patch's pixels, in standard deviations of the blur that it gets, where that is larger than the model's."""


def sample_texture(patch: Patch, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sample a patch at image points.

    Parameters
    ----------
    patch : Patch
    points : (n, 2) float
        Image pixels.

    Returns
    -------
    values : (n, c) float32
    usable : (n,) float32 in {0, 1}
    """
    values, _, usable = sample(patch.channels, patch.from_image(points))
    return values, usable
