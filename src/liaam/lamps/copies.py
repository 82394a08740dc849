"""Copies of training pictures, relit and mirrored: made when they are needed, close to the object, and not kept."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from liaam.lamps.bank import Lamps
from liaam.model.sampling import corners_around
from liaam.model.shape import diagonal_of
from liaam.photometry import Response

AROUND = 0.5
"""What is kept around an object, as a share of its diagonal."""

FINER = 2.0
"""How much finer than asked for a picture may be before it is averaged down."""

MOST = 1200
"""Pictures and copies together, of few pictures; of more there is a copy of each."""


@dataclass(frozen=True, eq=False)
class Copies:
    """What copies of which training pictures are made.

    Attributes
    ----------
    lamps : Lamps or None
        Without any, copies are in the light of training.
    counts : (n,) int
        Copies of each picture.
    order : (n_points,) int, optional
        Counterparts of the landmarks on the other side (:func:`liaam.model.shape.mirror_order`), where objects look
        alike in a mirror: every other copy is of the mirrored picture.
    """

    lamps: Lamps | None
    counts: np.ndarray
    order: np.ndarray | None = None

    @classmethod
    def of(cls, lamps: Lamps | None, n: int, each: int, order: np.ndarray | None) -> "Copies":
        """So many copies of each of n pictures, fewer of many pictures, and without lamps a mirrored one at most."""
        each = each if lamps is not None else min(each, 0 if order is None else 1)
        total = min(each * n, max(MOST - n, n))
        return cls(lamps, np.diff(np.arange(n + 1) * total // n), order)

    @property
    def are_relit(self) -> bool:
        """Whether any copy is in another light."""
        return self.lamps is not None and bool(self.counts.any())

    @property
    def owners(self) -> np.ndarray:
        """Number of the picture that each texture is of, the pictures' own first among their copies, (n + total,)."""
        return np.repeat(np.arange(len(self.counts)), 1 + self.counts)

    def of_picture(
        self, i: int, image: np.ndarray, points: np.ndarray, response: Response, diagonal: float
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Copies of picture i, and their landmarks, as fine as a reference frame of some diagonal needs them."""
        count, known = int(self.counts[i]), 1 if self.lamps is None else len(self.lamps)
        if not count:
            return
        image, points = close_up(image, points, diagonal)
        which = np.random.default_rng([30, i]).choice(known, count, replace=count > known)
        if self.order is not None:
            other = np.ascontiguousarray(image[:, ::-1])
            moved = (points * [-1.0, 1.0] + [image.shape[1] - 1.0, 0.0])[self.order]
            mirrored, which = np.split(which, [(count + 1) // 2])
            yield from ((copy, moved) for copy in self._relit(other, moved, mirrored, response))
        yield from ((copy, points) for copy in self._relit(image, points, which, response))

    def relit(self, i: int, image: np.ndarray, points: np.ndarray, response: Response) -> list[np.ndarray]:
        """Picture i in full under another lamp; none where there are no lamps."""
        if self.lamps is None:
            return []
        return self.lamps.relit(image, points, [np.random.default_rng([31, i]).integers(len(self.lamps))], response)

    def _relit(self, image: np.ndarray, points: np.ndarray, which: np.ndarray, response: Response) -> list[np.ndarray]:
        return [image] * len(which) if self.lamps is None else self.lamps.relit(image, points, which, response)


def close_up(image: np.ndarray, points: np.ndarray, diagonal: float) -> tuple[np.ndarray, np.ndarray]:
    """An object and what surrounds it, averaged down to about twice a diagonal in pixels, and its landmarks there."""
    import cv2  # heavy: imported when first needed

    low, high = corners_around(image, points, AROUND, 0.0)
    part, points = image[low[1] : high[1], low[0] : high[0]], points - low
    factor = int(diagonal_of(points) / (FINER * diagonal))
    if factor < 2 or min(part.shape[:2]) < 8 * factor:
        return np.ascontiguousarray(part), points
    height, width = (n // factor for n in part.shape[:2])
    reduced = cv2.resize(part[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
    return reduced, (points + 0.5) / factor - 0.5
