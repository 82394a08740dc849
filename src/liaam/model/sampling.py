"""Cut the region of interest out of an image and encode it at the model's resolution, for the core."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot
from typing import NamedTuple

import numpy as np

from liaam import _core
from liaam.model.shape import Similarity, corners_of
from liaam.photometry import Response
from liaam.photometry.encoding import Encoding, Means, block_brightness, block_means, encode_means, width_of


@dataclass(frozen=True, eq=False)
class Patch:
    """Encoded region of interest of an image.

    ``channels`` (h, w, 8) float32, at least 2 by 2, holds ``n_channels`` of the encoding, zeros, and the usable weight.
    All encodings have the same width, so that one loop samples all. ``from_image`` maps image pixels to patch
    pixels (a shift and a reduction, without rotation).
    """

    channels: np.ndarray
    from_image: Similarity
    n_channels: int


class _BlockMeans(NamedTuple):
    """Averages over blocks of an image's pixels; block 0 begins at the border of the first pixel."""

    means: Means
    first: np.ndarray
    """(x, y) int: indices of the first block."""
    size: float
    """Image pixels across a block."""

    @classmethod
    def of(
        cls,
        image: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        size: float,
        encoding: Encoding,
        response: Response,
    ) -> "_BlockMeans":
        """Average an image between two corners (x, y) int, the second excluded."""
        first, crop, start = _blocked(image, low, high, size)
        return cls(block_means(crop, encoding, response, size, start), first, size)

    def coarser(self, low: np.ndarray, high: np.ndarray, size: float) -> "_BlockMeans | None":
        """Join whole blocks to blocks of about the given size; None if that is not possible or leaves too few."""
        times = max(1, round(size / self.size))
        joined = times * self.size
        if abs(joined / size - 1.0) > SIZE_TOLERANCE:
            return None
        first = _first_block(low, joined)
        start = first * times - self.first
        count = (high / joined + ROUNDING_OF_COUNT).astype(int) - first
        is_inside = (start >= 0).all() and (start + times * count <= self.means.light.shape[1::-1]).all()
        if not is_inside or count.min() < 2:  # a patch is sampled between two pixels along each axis
            return None
        means = self.means.averaged((start[0], start[1]), times, (count[1], count[0]))
        return _BlockMeans(means, first, joined)


def _blocked(
    image: np.ndarray, low: np.ndarray, high: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Cut blocks between two corners (x, y) int out of an image; return indices, the part, and where they start in it.

    The indices (x, y) are those of the first block, and the second corner is excluded.
    """
    first = _first_block(low, size)
    begin = np.floor(first * size).astype(int)
    start = first * size - begin
    return first, image[begin[1] : high[1], begin[0] : high[0]], (start[0], start[1])


def _first_block(low: np.ndarray, size: float) -> np.ndarray:
    """Return the indices (x, y) of the first block of a region that begins at a pixel (x, y).

    It is the block that contains this pixel if blocks are of whole pixels, else the first one that begins at or after
    it. Blocks are counted from the border of the image, not of the region, so that they do not depend on the margin,
    and training and fitting use the same ones.
    """
    at = low / size
    has_whole_pixels = size == int(size)
    return (np.floor(at) if has_whole_pixels else np.ceil(at)).astype(int)


@dataclass(frozen=True, eq=False)
class AveragedImage:
    """An image and block averages of its linear light around a start, shared by all patches of a fit.

    It is immutable, so that threads can share it. Patches with another encoding or response use the image. The blocks
    are as fine as the sharpest patch needs.
    """

    image: np.ndarray
    encoding: Encoding
    response: Response
    blocks: _BlockMeans

    @classmethod
    def around(
        cls,
        image: np.ndarray,
        shape: np.ndarray,
        pose: Similarity,
        *,
        encoding: Encoding,
        response: Response,
        blurs: Sequence[float],
        margin: float,
    ) -> "AveragedImage":
        """Average an image around a start, for patches of several blurs; parameters are those of `make_patch`."""
        sizes = [block_size(encoding, pose.scale, blur) for blur in blurs]
        # The coarsest patch extends by two of its pixels, and begins with a whole one.
        low, high = corners_around(image, shape, margin, 2.0 * max(sizes))
        size = _limited(min(sizes), low, high)
        return cls(image, encoding, response, _BlockMeans.of(image, low, high, size, encoding, response))


# Relative tolerance of the size of blocks that levels share. The blur that follows compensates for the difference.
SIZE_TOLERANCE = 0.1
ROUNDING_OF_COUNT = 1e-9  # Added to a number of blocks, so that rounding takes none of a whole number


def make_patch(
    image: np.ndarray | AveragedImage,
    shape: np.ndarray,
    pose: Similarity,
    *,
    encoding: Encoding,
    response: Response,
    blur: float,
    margin: float,
) -> Patch:
    """Cut the surroundings of a shape (n, 2) out of an image and encode them at about the model's resolution.

    Averaging and blurring prevent aliasing, and make the object equally sharp at any size in the image. Several patches
    around one start can share the averages of :meth:`AveragedImage.around`. The pose maps model pixels to image pixels:
    its scale sets the resolution, its rotation the axes of directions. ``blur`` is the standard deviation of the blur
    in model pixels; for ``soft`` it includes the blur by averaging and interpolation. ``margin`` are the surroundings
    to include, as a fraction of the shape's diagonal.
    """
    pixels = image.image if isinstance(image, AveragedImage) else image
    size = block_size(encoding, pose.scale, blur)
    low, high = corners_around(pixels, shape, margin, size)
    size = _limited(size, low, high)
    blocks = None
    if isinstance(image, AveragedImage) and (encoding, response) == (image.encoding, image.response):
        blocks = image.blocks.coarser(low, high, size)
    means, first, size = blocks or _BlockMeans.of(pixels, low, high, size, encoding, response)
    turn = pose.matrix.T / pose.scale
    pixel = size / pose.scale
    if encoding == "soft":
        blur = _further_blur(blur, pixel)
    channels = encode_means(means, encoding, response, blur / pixel, turn, pixel)
    return Patch(channels, _from_image(first, size), width_of(encoding))


@dataclass(frozen=True, eq=False)
class BrightnessPatch:
    """The brightness of the surroundings of a shape, in which orientations of gradients can be counted.

    It takes an eighth of the memory of the counts.

    Attributes
    ----------
    brightness : (h, w) float32
    finite : (h, w) float32 or None
        Share of each pixel that is finite, unless all are.
    from_image : Similarity
        From image pixels to these: a shift and a reduction, without rotation.
    blur, pixel : float
        Blur before gradients are taken, in these pixels, and their size in those of the pose.
    turn : tuple of float
        Rotation to the axes of the mean shape.
    """

    brightness: np.ndarray
    finite: np.ndarray | None
    from_image: Similarity
    blur: float
    pixel: float
    turn: tuple[float, ...]

    @classmethod
    def around(
        cls,
        image: np.ndarray,
        shape: np.ndarray,
        pose: Similarity,
        *,
        response: Response,
        blur: float,
        margin: float,
        grey: bool = False,
    ) -> "BrightnessPatch":
        """Cut the surroundings of a shape (n, 2) out of an image.

        For the parameters see :func:`make_patch`. Of large images, some rows and columns are decoded. If the image is
        known to be ``grey``, that takes less time.
        """
        size = block_size("soft", pose.scale, blur)
        stride = stride_for(image, size)
        sparse = every(image, stride)
        shape = (shape - stride // 2) / stride
        size /= stride
        low, high = corners_around(sparse, shape, margin, size)
        size = _limited(size, low, high)
        first, crop, start = _blocked(sparse, low, high, size)
        brightness, finite = block_brightness(crop, response, size, start, grey=grey)
        turn = tuple((pose.matrix.T / pose.scale).ravel().tolist())
        pixel = size * stride / pose.scale
        from_image = after_every(_from_image(first, size), stride)
        return cls(brightness, finite, from_image, _further_blur(blur, pixel) / pixel, pixel, turn)

    def count_orientations(self) -> np.ndarray:
        """Return the counts of orientations of the gradients of the encoding ``soft`` at each pixel, (h, w, 8) float32.

        The length of the gradient is split between the two nearest of eight orientations.
        """
        return _core.count_orientations(self.brightness, self.finite, self.blur, self.turn, self.pixel)


# Samples of a block along each axis that suffice, as for the search: in a photograph of 24 megapixels, decoding all of
# them takes two thirds of a fit.
SAMPLES_ACROSS = 4


def stride_for(image: np.ndarray, size: float) -> int:
    """Return of how many rows and columns of an image one is enough, to average blocks of a size."""
    return max(1, min(int(size / SAMPLES_ACROSS), min(image.shape[:2]) // 8))


def every(image: np.ndarray, stride: int) -> np.ndarray:
    """Return every so many rows and columns of an image, from pixel ``stride // 2`` on."""
    offset = stride // 2
    return image[offset::stride, offset::stride]


def after_every(from_sparse: Similarity, stride: int) -> Similarity:
    """Return a map from the pixels of :func:`every` as a map from those of the image."""
    return Similarity(from_sparse.matrix / stride, from_sparse(np.full(2, -(stride // 2) / stride)))


def _further_blur(blur: float, pixel: float) -> float:
    """Return the blur that remains of one that includes those of pixels, all by standard deviation and size.

    Averaging over pixels blurs by 1/12 of their squared size, and interpolation between them by 2/12.
    """
    return float(np.sqrt(max(blur**2 - pixel**2 / 4.0, 0.0)))


def _from_image(first: np.ndarray, size: float) -> Similarity:
    """Return the map from image pixels to blocks of a size, the first of which has these indices (x, y)."""
    # The centre of the first block of pixels is at first * size + (size - 1) / 2.
    return Similarity(np.eye(2) / size, -first - 0.5 * (size - 1) / size)


def within(points: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return whether points (n, 2) lie within an image or a patch (h, w, c), (n,) bool."""
    return np.asarray(((points >= 0) & (points <= np.array(image.shape[1::-1]) - 1)).all(axis=1))


def corners_around(image: np.ndarray, shape: np.ndarray, margin: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners (x, y) int of a shape's surroundings within an image, the second one excluded.

    ``margin`` is a fraction of the shape's diagonal; twice ``size`` (image pixels) is added.
    """
    low, high = corners_of(shape)
    width, height = (high - low).tolist()
    pad = margin * hypot(width, height) + 2 * size
    end_of_image = np.array(image.shape[1::-1])
    # At least two pixels along each axis, between which a patch is sampled.
    first = np.minimum(np.maximum(np.floor(low - pad), 0), end_of_image - 2)
    end = np.minimum(np.maximum(np.ceil(high + pad) + 1, first + 2), end_of_image)
    return first.astype(int), end.astype(int)


def _limited(size: float, low: np.ndarray, high: np.ndarray) -> float:
    """Limit the size of blocks such that three fit between two corners."""
    return float(max(1.0, min(size, (high - low).min() // 3)))


def block_size(encoding: Encoding, scale: float, blur: float) -> float:
    """Side of the block of image pixels that is averaged into one patch pixel, at least 1.

    ``scale`` is the number of image pixels per model pixel; ``blur`` is in model pixels.
    """
    if encoding != "soft":  # whole pixels, never coarser than the model's
        return float(max(1, int(scale)))
    # As large as the blur, but at most one model pixel, unless the blur is above two of these.
    model_pixels = max(FINENESS * blur, min(blur, 1.0))
    return max(1.0, scale * model_pixels)


# Size of a patch's pixels for soft, in standard deviations of its blur, on levels where the blur exceeds two model
# pixels. Measured on a generated head: with a size of 1, 22 of 70 distant starts fail instead of 17.
FINENESS = 0.5


def sample_texture(patch: Patch, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sample a patch at image points (n, 2): values (n, c) float32, and whether usable, (n,) float32 in {0, 1}."""
    values, usable = _core.sample_channels(patch.channels, np.ascontiguousarray(patch.from_image(points)))
    return values[:, : patch.n_channels], usable
