"""Images of every shape and layout in memory that are fitted: long thin ones, strides, alignment, types."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np

from fuzz.engine import METHODS, _fitter, prepare
from fuzz.forged import check_result
from fuzz.mutate import Random, one_of
from fuzz.target import Target

LARGEST = 1_600_000
"""Largest number of pixels of an image here."""

LONG = ((8, 200_000), (200_000, 8), (40, 40_000), (40_000, 40), (16, 100_000), (1000, 1600))
"""Heights and widths of large images, most of them longer than OpenCV can index."""

TYPES = ("u1", "u2", ">u2", "f4", ">f4", "f8", ">f8", "f2")


class Case(NamedTuple):
    """An image, a method with which it is fitted, and whether there is a start or the object is searched for."""

    image: np.ndarray
    method: str
    has_start: bool


def make(rng: Random) -> Case:
    """Make an image of some shape, type and layout in memory."""
    image = _typed(rng, _scene(*_size(rng)))
    return Case(one_of(rng, LAYOUTS)(rng, image), one_of(rng, METHODS), bool(rng.random() < 0.5))


def _size(rng: Random) -> tuple[int, int]:
    """Draw a height and a width: small, thin, or rarely large."""
    kind = rng.random()
    if kind < 0.5:
        height, width = (int(side) for side in rng.integers(1, 65, 2))
        return height, width
    if kind < 0.95:
        short = int(one_of(rng, (1, 2, 7, 8, 9, 16, 31)))
        long = int(short * 10.0 ** rng.uniform(0, 3))
        return (short, long) if rng.random() < 0.5 else (long, short)
    return one_of(rng, LONG)


def _scene(height: int, width: int) -> np.ndarray:
    """Random blocks of four pixels, (height, width, 3) uint8."""
    rows, columns = -(-height // 4), -(-width // 4)
    coarse = np.random.default_rng([height, width]).integers(40, 200, (rows, columns, 3), dtype=np.uint8)
    return coarse.repeat(4, axis=0).repeat(4, axis=1)[:height, :width]


def _typed(rng: Random, image: np.ndarray) -> np.ndarray:
    kind = np.dtype(one_of(rng, TYPES))
    if kind.kind == "u":
        return image.astype(kind) * kind.type(257 if kind.itemsize == 2 else 1)
    return (image / 255.0).astype(kind)


def _as_it_is(rng: Random, image: np.ndarray) -> np.ndarray:
    return image


def _reversed(rng: Random, image: np.ndarray) -> np.ndarray:
    """Negative strides."""
    return image[:: one_of(rng, (-1, 1)), :: one_of(rng, (-1, 1)), :: one_of(rng, (-1, 1))]


def _stepped(rng: Random, image: np.ndarray) -> np.ndarray:
    """Every second or third row and column, or two of four channels."""
    larger = np.repeat(np.repeat(image, 2, axis=0), 3, axis=1) if image.size < LARGEST else image
    return larger[::2, ::3] if rng.random() < 0.5 else np.concatenate([image, image], axis=2)[..., ::2]


def _transposed(rng: Random, image: np.ndarray) -> np.ndarray:
    """Columns, or channels, one after the other in memory."""
    order = one_of(rng, ((1, 0, 2), (2, 0, 1), (2, 1, 0)))
    return np.ascontiguousarray(image.transpose(order)).transpose(np.argsort(order))


def _broadcast(rng: Random, image: np.ndarray) -> np.ndarray:
    """Strides of 0."""
    part = one_of(rng, (image[:1], image[:, :1], image[..., :1], image[:1, :1, :1]))
    return np.broadcast_to(part, image.shape)


def _odd(rng: Random, image: np.ndarray) -> np.ndarray:
    """Pixels at odd distances in a record, and so at odd addresses; or rows of an odd length in bytes."""
    height, width, _ = image.shape
    size, odd = image.dtype.itemsize, int(one_of(rng, (1, 3)))
    by_row = rng.random() < 0.5
    row = width * 3 * size + odd if by_row else width * (3 * size + odd)
    pixel = 3 * size if by_row else 3 * size + odd
    memory = np.zeros(odd + height * row, np.uint8)
    made = np.ndarray(image.shape, image.dtype, memory, odd, (row, pixel, size))
    made[...] = image
    return made


def _unaligned(rng: Random, image: np.ndarray) -> np.ndarray:
    """Numbers beside multiples of their size."""
    memory = np.zeros(image.nbytes + 8, np.uint8)
    made = np.ndarray(image.shape, image.dtype, memory, int(rng.integers(1, 8)))
    made[...] = image
    return made


LAYOUTS = (_as_it_is, _reversed, _stepped, _transposed, _broadcast, _odd, _unaligned)


def check(case: Case) -> None:
    """Fit an image from a start, or after a search."""
    height, width = case.image.shape[:2]
    side = max(1.0, min(height, width) - 1.0)
    fitter: Any = _fitter(case.method)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        start = (0.5 * width, 0.5 * height, side) if case.has_start else None
        check_result(fitter.fit(case.image, start))


TARGETS = (Target("shapes", make, check, prepare, ".txt", 0.05),)
