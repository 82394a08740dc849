"""Relit and mirrored copies of training images, cropped around the object and generated on demand."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from liaam.model.sampling import corners_around
from liaam.model.shape import align, diagonal_of
from liaam.photometry import Response
from liaam.training.lamps.bank import LearntLamps

AROUND = 0.5  # Margin of a crop, as a fraction of the object's diagonal
FINER = 2.0  # An image is averaged down if it exceeds the required resolution by more than this factor
# Largest number of images and copies together, if that allows a copy of each image; otherwise there is one of each
MOST = 1200


@dataclass(frozen=True, eq=False)
class Copies:
    """Plan of the copies of training images."""

    lamps: LearntLamps | None  # for relit copies; without lamps, copies keep the training light
    counts: np.ndarray  # (n,) int: number of copies of each image
    # (n_points,) int: index of each landmark's mirror image, for symmetric objects: half of the copies are mirrored
    order: np.ndarray | None = None
    # Distance by which landmarks lie to the right of where they should, in image pixels. Those of mirrored copies are
    # moved to lie on the same side of the object
    offset: float = 0.0

    @classmethod
    def of(cls, lamps: LearntLamps | None, n: int, each: int, order: np.ndarray | None) -> "Copies":
        """Plan ``each`` copies of each of n images: fewer of many images, and without lamps only a mirrored one."""
        each = each if lamps is not None else min(each, 0 if order is None else 1)
        total = min(each * n, max(MOST - n, n))
        return cls(lamps, np.diff(np.arange(n + 1) * total // n), order)

    @property
    def are_relit(self) -> bool:
        """Whether any copy is relit."""
        return self.lamps is not None and bool(self.counts.any())

    @property
    def owners(self) -> np.ndarray:
        """Index of the image of each texture, (n + total,): each image is followed by its copies."""
        return np.repeat(np.arange(len(self.counts)), 1 + self.counts)

    @property
    def lit_by(self) -> np.ndarray:
        """Lamp of each texture, (n + total,) int: -1 for the images, under the training light."""
        return np.concatenate([np.append(-1, self.which(i)) for i in range(len(self.counts))])

    def which(self, i: int) -> np.ndarray:
        """Lamp of each copy of image i, int."""
        count = int(self.counts[i])
        n_lamps = 1 if self.lamps is None else len(self.lamps)
        return np.random.default_rng([30, i]).choice(n_lamps, count, replace=count > n_lamps)

    def known_of(self, i: int, j: int, known: np.ndarray | None) -> np.ndarray | None:
        """Return which landmarks of copy j of image i are known, from those ``known`` (n,) of the image.

        None if all are.
        """
        if known is None or self.order is None or not self.are_mirrored(i)[j]:
            return known
        return known[self.order]

    def are_mirrored(self, i: int) -> np.ndarray:
        """Whether each copy of image i is mirrored, (count,) bool: the first half of them, of a symmetric object."""
        count = int(self.counts[i])
        n_mirrored = 0 if self.order is None else (count + 1) // 2
        return np.arange(count) < n_mirrored

    def of_picture(
        self, i: int, image: np.ndarray, points: np.ndarray, response: Response, diagonal: float
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the copies of image i and their landmarks, at the resolution for a reference frame of a diagonal."""
        which = self.which(i)
        if not len(which):
            return
        size = diagonal_of(points)
        image, points = close_up(image, points, diagonal)
        offset = self.offset * diagonal_of(points) / size
        if self.order is not None:
            other, moved = mirrored(image, points, self.order, offset)
            are_mirrored = self.are_mirrored(i)
            first = which[are_mirrored]
            which = which[~are_mirrored]
            yield from ((copy, moved) for copy in self._relit(other, moved, first, response))
        yield from ((copy, points) for copy in self._relit(image, points, which, response))

    def relit(
        self, i: int, image: np.ndarray, points: np.ndarray, response: Response, lamps: np.ndarray
    ) -> list[np.ndarray]:
        """Return the uncropped image i under a random one of some lamps, in a list; an empty list without lamps."""
        if self.lamps is None:
            return []
        return self.lamps.relit(image, points, [np.random.default_rng([31, i]).choice(lamps)], response)

    def _relit(self, image: np.ndarray, points: np.ndarray, which: np.ndarray, response: Response) -> list[np.ndarray]:
        return [image] * len(which) if self.lamps is None else self.lamps.relit(image, points, which, response)


def mirrored(
    image: np.ndarray, points: np.ndarray, order: np.ndarray, offset: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Mirror an image and its landmarks left to right, given the index of each landmark's mirror image.

    If the landmarks have an offset to the right, those of the mirror image have it on the same side of the object.
    """
    moved = (points * [-1.0, 1.0] + [image.shape[1] - 1.0, 0.0])[order]
    if offset:  # Mirroring turns it to the left. On a turned object it must turn as the object does.
        moved += offset * (align(points, moved).matrix[:, 0] + np.array([1.0, 0.0]))
    return np.ascontiguousarray(image[:, ::-1]), moved


def close_up(image: np.ndarray, points: np.ndarray, diagonal: float) -> tuple[np.ndarray, np.ndarray]:
    """Crop an object, average it down to about twice a diagonal in pixels, and map its landmarks."""
    low, high = corners_around(image, points, AROUND, 0.0)
    part = image[low[1] : high[1], low[0] : high[0]]
    points = points - low
    factor = int(diagonal_of(points) / (FINER * diagonal))
    if factor < 2 or min(part.shape[:2]) < 8 * factor:
        return np.ascontiguousarray(part), points
    height, width = (n // factor for n in part.shape[:2])
    reduced = cv2.resize(part[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
    return reduced, (points + 0.5) / factor - 0.5
