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
    height, width = image.shape[:2]
    scale = pose.scale
    # Never coarser than the model's pixels.
    reduce = max(1, int(scale))
    pad = margin * diagonal_of(shape) + 2 * reduce
    low = np.clip(np.floor(shape.min(axis=0) - pad), 0, [width - 2, height - 2]).astype(int)
    high = np.clip(np.ceil(shape.max(axis=0) + pad) + 1, low + 2, [width, height]).astype(int)
    reduce = max(1, min(reduce, int((high - low).min()) // 2))
    # Blocks are those of the whole image, whatever the margin: training and fitting see the same ones.
    low = low // reduce * reduce
    crop = image[low[1] : high[1], low[0] : high[0]]
    turn, pixel = pose.matrix.T / scale, reduce / scale
    channels = encode(crop, encoding, response, blur * scale / reduce, reduce, turn, pixel)
    # The centre of the first block of pixels is at low + (reduce - 1) / 2.
    matrix = np.eye(2) / reduce
    offset = -(low + (reduce - 1) / 2.0) / reduce
    return Patch(channels, Similarity(matrix, offset))


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
