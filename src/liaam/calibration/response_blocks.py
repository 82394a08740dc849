"""Blocks of pixels of one scene in several images, as radiometric calibration compares them."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from liaam.errors import CameraError
from liaam.photometry.camera import squared_radius
from liaam.photometry.encoding import DARK, SATURATED, as_colour, is_grey, stored_values
from liaam.photometry.noise import noise_deviation
from liaam.registration import warp_picture

BLOCK = 8  # Side of the blocks that are averaged, pixels; up to twice as large in large images
MOST_BLOCKS = 4000  # Largest number of blocks
# Largest relative standard deviation within a block, since averaging of stored values is not linear in light
TEXTURE = 0.05
# Fraction of the standard deviation within a block that counts as noise, for small registration errors
UNREGISTERED = 0.03
INSIDE = 0.999  # Least fraction of a block inside a moved image; below 1 for the rounding of float32
CLIPPED = 0.02  # Largest fraction of a block's pixels with a stored value of 0 or 1, which hide a part of the light
LEAST_DEVIATION = 0.1 / 255  # Standard deviation of a mean from causes other than noise and texture, stored values


@dataclass(frozen=True)
class MeasuredBlocks:
    """Measurements of n blocks of one channel each in m images.

    Attributes
    ----------
    stored : (m, n) float64
        Mean stored values, in [0, 1].
    deviation : (m, n) float64
        Their standard deviations.
    usable : (m, n) bool
        Whether a block is inside the image, well exposed and without texture.
    radius2 : (m, n) float64
        Squared distance from the image's centre, 1 in the corners.
    offset : (n, 2) float64
        Position in the first image relative to its centre, in units of half the diagonal.
    channel : (n,) int64
        Channel of the image.
    block : (n,) int64
        Number of the block, which its channels share.
    """

    stored: np.ndarray
    deviation: np.ndarray
    usable: np.ndarray
    radius2: np.ndarray
    offset: np.ndarray
    channel: np.ndarray
    block: np.ndarray

    @property
    def n(self) -> int:
        """Number of blocks."""
        return len(np.unique(self.block))

    def over_channels(self, values: np.ndarray) -> np.ndarray:
        """Root mean square (m, n) of values (m, n) over a block's channels, since moved blocks move in all three."""
        count = np.bincount(self.block)
        sums = np.stack([np.bincount(self.block, weights=np.square(row)) for row in values])
        return np.sqrt(sums / np.maximum(count, 1))[:, self.block]


def checked_pictures(images: Sequence[np.ndarray], fewest: int = 2) -> list[np.ndarray]:
    """Return images (h, w, 3), or (h, w, 1) if all are grey."""
    pictures = [as_colour(image, f"image {i + 1}") for i, image in enumerate(images)]
    if len(pictures) < fewest:
        raise CameraError(f"there are too few images ({len(pictures)}); a response needs two or more of one scene")
    # Grey images have one channel of information.
    return [picture[..., :1] for picture in pictures] if all(map(is_grey, pictures)) else pictures


def checked_maps(homographies: Sequence[np.ndarray] | None, pictures: list[np.ndarray]) -> list[np.ndarray]:
    """Return the map from each image's pixels to the first's, (3, 3)."""
    if homographies is None:
        if len({picture.shape for picture in pictures}) > 1:
            raise CameraError("the images differ in size; give homographies, or images from one tripod")
        return [np.eye(3)] * len(pictures)
    maps = [np.asarray(h, dtype=np.float64) for h in homographies]
    if len(maps) != len(pictures) or any(h.shape != (3, 3) or not np.isfinite(h).all() for h in maps):
        raise CameraError(f"give one 3×3 homography for each of the {len(pictures)} images, to the first's pixels")
    if any(np.linalg.cond(h) > 1e12 for h in maps):
        raise CameraError("a homography cannot be inverted; give maps from each image's pixels to the first's")
    if not np.allclose(maps[0] / maps[0][2, 2], np.eye(3), atol=1e-6):
        raise CameraError("the first image's homography must be the identity, since all map to its pixels")
    return maps


@dataclass(frozen=True)
class _OneImage:
    """All blocks of one image: arrays (rows, columns, channels) of what :class:`MeasuredBlocks` has of those chosen."""

    mean: np.ndarray
    deviation: np.ndarray
    usable: np.ndarray
    radius2: np.ndarray


def observe(pictures: list[np.ndarray], maps: list[np.ndarray], least: int = 2) -> MeasuredBlocks:
    """Average blocks of the first image's pixels in all images, and choose those that are usable in ``least`` of them.

    Of more than :data:`MOST_BLOCKS`, every second, third or so is chosen, in the order of rows.
    """
    height, width = pictures[0].shape[:2]
    edge = _block_side(height, width)
    images = [_observe_one(p, m, (height, width), edge) for p, m in zip(pictures, maps, strict=True)]
    rows, columns, channels = images[0].mean.shape
    chosen = (np.sum([image.usable for image in images], axis=0) >= least).ravel()
    block = np.arange(chosen.size) // channels
    step = len(np.unique(block[chosen])) // MOST_BLOCKS + 1
    chosen &= block % step == 0

    def of_chosen(arrays: list[np.ndarray]) -> np.ndarray:
        return np.stack(arrays).reshape(len(images), -1)[:, chosen]

    y, x, channel = np.mgrid[:rows, :columns, :channels]
    middle_x = x.max() / 2
    middle_y = y.max() / 2
    offset = np.stack([x - middle_x, y - middle_y], axis=-1) / np.hypot(middle_x, middle_y)
    return MeasuredBlocks(
        stored=of_chosen([image.mean for image in images]),
        deviation=of_chosen([image.deviation for image in images]),
        usable=of_chosen([image.usable for image in images]),
        radius2=of_chosen([image.radius2 for image in images]),
        offset=offset.reshape(-1, 2)[chosen],
        channel=channel.ravel()[chosen],
        block=block[chosen],
    )


def _block_side(height: int, width: int) -> int:
    """Side of the blocks of an image, pixels: smaller where eight would not fit along each side."""
    least = min(BLOCK, height // 8, width // 8)
    return int(np.clip(np.sqrt(height * width / MOST_BLOCKS), least, 2 * BLOCK))


def _observe_one(picture: np.ndarray, to_first: np.ndarray, size: tuple[int, int], edge: int) -> _OneImage:
    """Average blocks of a side of ``edge`` pixels of the first image, which has a (height, width), in one image."""
    height, width = size
    rows = height // edge
    columns = width // edge
    is_moved = not np.allclose(to_first, np.eye(3)) or picture.shape[:2] != size

    def block_mean(values: np.ndarray) -> np.ndarray:
        """Mean of float32 values of the image's pixels over each block, (rows, columns, channels) float64."""
        if is_moved:
            values = warp_picture(values, cv2.invert(to_first)[1], size)
        cut = values[: rows * edge, : columns * edge]
        mean = cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA)
        return mean.reshape(rows, columns, -1).astype(np.float64)

    values = stored_values(picture)
    noise = noise_deviation(picture)
    mean = block_mean(values)
    # Centred, since the variance is a small difference of large float32 numbers.
    variance = block_mean(np.square(values - 0.5)) - np.square(mean - 0.5)
    texture = np.sqrt(np.maximum(variance - noise**2, 0.0))
    is_inside = block_mean(np.ones(picture.shape[:2], np.float32)) > INSIDE
    is_clipped = block_mean(((values <= 0) | (values >= 1)).astype(np.float32)) > CLIPPED
    is_exposed = (mean >= DARK) & (mean <= SATURATED)
    usable = is_inside & ~is_clipped & is_exposed & (texture <= TEXTURE * mean + noise)
    deviation = np.sqrt(noise**2 / edge**2 + (UNREGISTERED * texture) ** 2 + LEAST_DEVIATION**2)
    y, x = np.mgrid[:rows, :columns] * edge + (edge - 1) / 2  # the blocks' centres in the first image
    centres = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(to_first).T  # homogeneous, in this image
    radius2 = squared_radius(centres[..., 0] / centres[..., 2], centres[..., 1] / centres[..., 2], *picture.shape[:2])
    return _OneImage(mean, deviation, usable, np.broadcast_to(radius2[..., None], mean.shape))
