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


@dataclass(frozen=True)
class MeasuredBlocks:
    """Measurements of n blocks of one channel each in m images.

    Stored values (m, n) in [0, 1], their standard deviations, and squared distances from the centre, 1 in the corners.
    Offsets (n, 2) are positions in the first image relative to its centre, in units of half the diagonal.
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


def observe(pictures: list[np.ndarray], maps: list[np.ndarray], least: int = 2) -> MeasuredBlocks:
    """Average blocks of the first image's pixels in all images; keep those that are usable in ``least`` of them."""
    height, width = pictures[0].shape[:2]
    edge = int(np.clip(np.sqrt(height * width / MOST_BLOCKS), min(BLOCK, height // 8, width // 8), 2 * BLOCK))
    parts = [_observe_one(p, m, (height, width), edge) for p, m in zip(pictures, maps, strict=True)]
    stored, deviation, usable, radius2 = np.stack(parts, axis=1)
    y, x, channel = np.mgrid[: stored.shape[1], : stored.shape[2], : stored.shape[3]]
    offset = np.stack([x - x.max() / 2, y - y.max() / 2], axis=-1) / np.hypot(x.max() / 2, y.max() / 2)
    chosen = (usable.sum(axis=0) >= least).ravel()
    block = np.arange(chosen.size) // stored.shape[3]
    chosen &= block % (len(np.unique(block[chosen])) // MOST_BLOCKS + 1) == 0
    stored, deviation, usable, radius2 = (
        part.reshape(len(pictures), -1)[:, chosen] for part in (stored, deviation, usable > 0, radius2)
    )
    offset, channel = offset.reshape(-1, 2)[chosen], channel.ravel()[chosen]
    return MeasuredBlocks(stored, deviation, usable, radius2, offset, channel, block[chosen])


def _observe_one(picture: np.ndarray, to_first: np.ndarray, size: tuple[int, int], edge: int) -> np.ndarray:
    """Mean of blocks, its deviation, whether it is usable, and squared radius, (4, rows, columns, channels)."""
    height, width = size
    rows, columns = height // edge, width // edge
    is_moved = not np.allclose(to_first, np.eye(3)) or picture.shape[:2] != size

    def block_mean(values: np.ndarray) -> np.ndarray:
        if is_moved:
            values = warp_picture(values, cv2.invert(to_first)[1], size)
        cut = values[: rows * edge, : columns * edge]
        mean = cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA)
        return mean.reshape(rows, columns, -1).astype(np.float64)

    # Centred, since the variance is a small difference of large float32 numbers.
    values = stored_values(picture)
    noise = noise_deviation(picture)
    mean = block_mean(values)
    texture = np.sqrt(np.maximum(block_mean(np.square(values - 0.5)) - np.square(mean - 0.5) - noise**2, 0.0))
    is_inside = block_mean(np.ones(picture.shape[:2], np.float32)) > 0.999
    is_clipped = block_mean(((values <= 0) | (values >= 1)).astype(np.float32)) > 0.02
    usable = is_inside & ~is_clipped & (mean >= DARK) & (mean <= SATURATED) & (texture <= TEXTURE * mean + noise)
    deviation = np.sqrt(noise**2 / edge**2 + (UNREGISTERED * texture) ** 2 + (0.1 / 255) ** 2)
    y, x = np.mgrid[:rows, :columns] * edge + (edge - 1) / 2
    there = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(to_first).T
    radius2 = squared_radius(there[..., 0] / there[..., 2], there[..., 1] / there[..., 2], *picture.shape[:2])
    return np.stack([mean, deviation, usable, np.broadcast_to(radius2[..., None], mean.shape)])
