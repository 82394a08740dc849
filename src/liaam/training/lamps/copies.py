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
LEAST_REDUCED = 8  # Least side of a reduced image, pixels; smaller ones are not reduced
# Largest number of images and copies together, if that allows a copy of each image; otherwise there is one of each
MOST = 1200


@dataclass(frozen=True, eq=False)
class Copies:
    """Plan of the copies of training images.

    Attributes
    ----------
    lamps : LearntLamps, optional
        Lamps of the copies. Without lamps, copies keep the training light.
    counts : (n,) int
        Number of copies of each image.
    order : (n_points,) int, optional
        Index of each landmark's mirror image, of symmetric objects: half of the copies are mirrored.
    offset : float
        Distance by which landmarks lie to the right of where they should, image pixels. Those of mirrored copies are
        moved to lie on the same side of the object.
    """

    lamps: LearntLamps | None
    counts: np.ndarray
    order: np.ndarray | None = None
    offset: float = 0.0

    @classmethod
    def of(cls, lamps: LearntLamps | None, n: int, each: int, order: np.ndarray | None) -> "Copies":
        """Plan ``each`` copies of each of n images: fewer of many images, and without lamps only a mirrored one."""
        if lamps is None:
            each = min(each, 0 if order is None else 1)
        total = min(each * n, max(MOST - n, n))
        first_copies = np.arange(n + 1) * total // n  # of each image among all copies, which spreads these evenly
        return cls(lamps, counts=np.diff(first_copies), order=order)

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
        """Lamp of each copy of image i, (count,) int: different ones, as far as there are so many."""
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
        lamps = self.which(i)
        if not len(lamps):
            return
        diagonal_before = diagonal_of(points)
        image, points = close_up(image, points, diagonal)
        if self.order is not None:
            offset = self.offset * diagonal_of(points) / diagonal_before  # in pixels of the close-up
            mirror_image, mirrored_points = mirrored(image, points, self.order, offset)
            are_mirrored = self.are_mirrored(i)
            for copy in self._relit(mirror_image, mirrored_points, lamps[are_mirrored], response):
                yield copy, mirrored_points
            lamps = lamps[~are_mirrored]
        for copy in self._relit(image, points, lamps, response):
            yield copy, points

    def relit(
        self, i: int, image: np.ndarray, points: np.ndarray, response: Response, lamps: np.ndarray
    ) -> list[np.ndarray]:
        """Return the uncropped image i under a random one of some lamps, in a list; an empty list without lamps."""
        if self.lamps is None:
            return []
        lamp = np.random.default_rng([31, i]).choice(lamps)
        return self.lamps.relit(image, points, [lamp], response)

    def _relit(self, image: np.ndarray, points: np.ndarray, lamps: np.ndarray, response: Response) -> list[np.ndarray]:
        """Return an image under each of some lamps; without lamps, the same image as many times."""
        if self.lamps is None:
            return [image] * len(lamps)
        return self.lamps.relit(image, points, lamps, response)


def mirrored(
    image: np.ndarray, points: np.ndarray, order: np.ndarray, offset: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Mirror an image and its landmarks left to right, given the index of each landmark's mirror image.

    If the landmarks have an offset to the right, those of the mirror image have it on the same side of the object.
    """
    right = np.array([1.0, 0.0])
    moved = (points * [-1.0, 1.0] + [image.shape[1] - 1.0, 0.0])[order]
    if offset:
        # Mirroring has turned the offset to the left, where it is taken away. It is added again in the direction to
        # which the object, as a similarity maps it to its mirror image, turns what was right.
        turned_right = align(points, moved).matrix[:, 0]
        moved += offset * (turned_right + right)
    return np.ascontiguousarray(image[:, ::-1]), moved


def close_up(image: np.ndarray, points: np.ndarray, diagonal: float) -> tuple[np.ndarray, np.ndarray]:
    """Crop an object, average it down to about twice a diagonal in pixels, and map its landmarks."""
    low, high = corners_around(image, points, AROUND, 0.0)
    part = image[low[1] : high[1], low[0] : high[0]]
    points = points - low
    factor = int(diagonal_of(points) / (FINER * diagonal))  # of whole pixels
    if factor < 2 or min(part.shape[:2]) < LEAST_REDUCED * factor:
        return np.ascontiguousarray(part), points
    height, width = (n // factor for n in part.shape[:2])
    reduced = cv2.resize(part[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
    return reduced, (points + 0.5) / factor - 0.5  # coordinates are of pixel centres
