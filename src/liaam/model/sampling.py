"""From a stored image to what the kernels sample: the region of interest, encoded at the model's resolution."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from liaam.model.shape import Similarity, diagonal_of
from liaam.photometry import Response
from liaam.photometry.encoding import WIDTHS, Means, block_means, encode_means


@dataclass(frozen=True, eq=False)
class Patch:
    """Encoded region of interest of an image.

    Attributes
    ----------
    channels : (h, w, 8) float32
        Encoded pixels (see :func:`liaam.photometry.encode`), at least 2 by 2: the encoding's channels, noughts, and the
        usable weight. As wide for all encodings, so that kernels need one loop only.
    from_image : Similarity
        Image pixels to patch pixels (a shift and a reduction, never a turn).
    n_channels : int
        Of the encoding.
    """

    channels: np.ndarray
    from_image: Similarity
    n_channels: int


class _Blocks(NamedTuple):
    """Averages of blocks of an image's pixels; block 0 begins at the border of the first pixel."""

    means: Means
    first: np.ndarray
    """(x, y) int: numbers of the first block."""
    size: float
    """Image pixels across a block."""

    @classmethod
    def of(
        cls, image: np.ndarray, low: np.ndarray, high: np.ndarray, size: float, encoding: str, response: Response
    ) -> "_Blocks":
        """Average what lies between two corners (x, y) int of an image, the second not included."""
        first = _first_block(low, size)
        begin = np.floor(first * size).astype(int)
        crop, start = image[begin[1] : high[1], begin[0] : high[0]], first * size - begin
        return cls(block_means(crop, encoding, response, size, (start[0], start[1])), first, size)

    def coarser(self, low: np.ndarray, high: np.ndarray, size: float) -> "_Blocks | None":
        """Join whole blocks to ones of about a size; None where there are no such, or not enough."""
        times = max(1, round(size / self.size))
        joined = times * self.size
        if abs(joined / size - 1.0) > NEARLY:
            return None
        first = _first_block(low, joined)
        start, count = first * times - self.first, (high / joined + 1e-9).astype(int) - first
        if (start < 0).any() or (start + times * count > self.means.light.shape[:0:-1]).any() or count.min() < 2:
            return None
        means = self.means.averaged((start[0], start[1]), times, (count[1], count[0]))
        return _Blocks(means, first, joined)


def _first_block(low: np.ndarray, size: float) -> np.ndarray:
    # Blocks are those of the whole image, whatever the margin: training and fitting see the same ones.
    return np.ceil(np.floor(low / size) if size == int(size) else low / size).astype(int)


@dataclass(frozen=True, eq=False)
class Light:
    """An image, and its linear light averaged around a start: once for all patches of a fit.

    Nothing in it changes, so that threads may share it.

    Attributes
    ----------
    image : (h, w, 3) uint8, uint16 or float32
    encoding, response
        See :func:`liaam.photometry.encode`; patches of others are made of the image itself.
    blocks : _Blocks
        Averages as fine as the sharpest patch needs
    """

    image: np.ndarray
    encoding: str
    response: Response
    blocks: _Blocks

    @classmethod
    def around(
        cls,
        image: np.ndarray,
        shape: np.ndarray,
        pose: Similarity,
        *,
        encoding: str,
        response: Response,
        blurs: Sequence[float],
        margin: float,
    ) -> "Light":
        """Average an image around a start.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float32
        shape : (n, 2) float
            Start, image pixels.
        pose : Similarity
            Model pixels to image pixels there.
        encoding, response
            See :func:`liaam.photometry.encode`.
        blurs : sequence of float
            Standard deviations of the patches' blurs, model pixels.
        margin : float
            Surroundings to include, as a share of the shape's diagonal.
        """
        sizes = [block_size(encoding, pose.scale, blur) for blur in blurs]
        # The coarsest patch reaches for two of its pixels more, and begins with a whole one.
        low, high = corners_around(image, shape, margin, 2.0 * max(sizes))
        size = _limited(min(sizes), low, high)
        return cls(image, encoding, response, _Blocks.of(image, low, high, size, encoding, response))

    def blocks_of(
        self, low: np.ndarray, high: np.ndarray, size: float, encoding: str, response: Response
    ) -> "_Blocks | None":
        """Averages of about a size, joined of those that there are; None if these do not serve."""
        if (encoding, response) != (self.encoding, self.response):
            return None
        return self.blocks.coarser(low, high, size)


NEARLY = 0.1
"""Share by which blocks that levels share may be larger or smaller than a level alone would have them. What a block
blurs more or less than it should, the blur after it makes up for."""


def make_patch(
    image: np.ndarray | Light,
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
    image : (h, w, 3) uint8, uint16 or float32, or Light
        Where patches lie near each other, :meth:`Light.around` saves them from averaging the image one by one.
    shape : (n, 2) float
        Points to surround, image pixels.
    pose : Similarity
        Model pixels to image pixels: its scale sets the resolution, its rotation the axes of directions.
    encoding, response
        See :func:`liaam.photometry.encode`.
    blur : float
        Standard deviation of the blur, model pixels. For ``soft`` it is that of all that blurs: of averaging and of
        interpolation between the patch's pixels, too.
    margin : float
        Surroundings to include, as a share of the shape's diagonal.
    """
    shared, picture = (image, image.image) if isinstance(image, Light) else (None, image)
    size = block_size(encoding, pose.scale, blur)
    low, high = corners_around(picture, shape, margin, size)
    size = _limited(size, low, high)
    blocks = shared.blocks_of(low, high, size, encoding, response) if shared is not None else None
    means, first, size = blocks or _Blocks.of(picture, low, high, size, encoding, response)
    turn, pixel = pose.matrix.T / pose.scale, size / pose.scale
    rest = _rest_of_blur(blur, pixel) if encoding == "soft" else blur
    channels = encode_means(means, encoding, response, rest / pixel, turn, pixel)
    # The centre of the first block of pixels is at first * size + (size - 1) / 2.
    from_image = Similarity(np.eye(2) / size, -first - 0.5 * (size - 1) / size)
    return Patch(channels, from_image, WIDTHS[encoding])


def corners_around(image: np.ndarray, shape: np.ndarray, margin: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners (x, y) int of a shape's surroundings within an image, the second one not included.

    ``margin`` is a share of the shape's diagonal; two pixels of a ``size`` in image pixels are added.
    """
    limits = np.array(image.shape[1::-1])
    pad = margin * diagonal_of(shape) + 2 * size
    low = np.clip(np.floor(shape.min(axis=0) - pad), 0, limits - 2)
    high = np.clip(np.ceil(shape.max(axis=0) + pad) + 1, low + 2, limits)
    return low.astype(int), high.astype(int)


def _limited(size: float, low: np.ndarray, high: np.ndarray) -> float:
    """Size of blocks of which some go between two corners."""
    return float(max(1.0, min(size, (high - low).min() // 3)))


def _rest_of_blur(blur: float, pixel: float) -> float:
    """What is left to be blurred where pixels of a size are averages, and are interpolated between (model pixels).

    An average over a pixel has a variance of a twelfth of its square, and interpolation has twice as much.
    """
    return float(np.sqrt(max(blur**2 - pixel**2 / 4.0, 0.0)))


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
    return max(1.0, scale * max(FINENESS * blur, min(blur, 1.0)))


FINENESS = 0.5
"""Size of a patch's pixels of ``soft``, in standard deviations of its blur, where that is larger than the model's
pixels; they are finer than those only where the blur is less than one. As large as the deviation of a coarse level's
blur, they lose starts that are far off (of 70 on a generated head 22 instead of 17): their gradients jump. Where the
blur is one model pixel they do no harm."""


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
    from liaam.kernels.bilinear import sample  # numba: imported when first needed

    values, usable = sample(patch.channels, patch.from_image(points))
    return values[:, : patch.n_channels], usable
