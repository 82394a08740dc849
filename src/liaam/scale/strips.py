"""Where ticks may be: along the straight edges in an image, such as those of a ruler.

They are looked for where the spectra of tiles show no ruler, as on gravel or fabric: in a tile, short ticks are few
among what is around them. Along an edge they are most of what changes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

_LONGER_SIDE = 400  # pixels to which an image is reduced, in which textures are mostly even and ticks join no edge
_CANNY = (40.0, 100.0)
_VOTES = 40  # of pixels on a line
_LEAST_LENGTH = 0.12  # of an edge, of the longer side
_GAP = 10.0  # greatest gap in it, pixels of the reduced image
_TURN = math.pi / 360  # step of directions
_ALIKE = (math.radians(2), 4.0)  # differences of direction and place, pixels, of one edge that is found twice
_MOST_EDGES = 30
_REACH = 40  # pixels to both sides of an edge
_ROWS = 7  # pixels across that are averaged
_EACH = 4  # pixels from one average to the next
_FEWEST = 10  # ticks along an edge
_SHORTEST = 4.0  # pixels of a period
_HARMONICS = 3
_CONTRAST = 2.2  # least mean logarithm of the power at the harmonics over that between them
_OF_EDGE = 2  # proposals


class Strip(NamedTuple):
    """A strip along an edge whose levels repeat."""

    centre: np.ndarray  # x and y, pixels
    angle: float  # radians
    period: float  # pixels
    score: float


def find_strips(grey: np.ndarray) -> list[Strip]:
    """Return the strips along straight edges of an image (h, w) whose levels repeat most clearly, the best first."""
    found = [strip for edge in _edges(grey) for strip in _strips(grey, edge)]
    return sorted(found, key=lambda strip: -strip.score)


def _edges(grey: np.ndarray) -> list[np.ndarray]:
    """Return the ends (2, 2) of the longest straight edges, x and y in pixels."""
    factor = min(1.0, _LONGER_SIDE / max(grey.shape))
    size = (max(round(grey.shape[1] * factor), 1), max(round(grey.shape[0] * factor), 1))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    low, high = np.percentile(small, (1, 99))
    if not high > low:
        return []
    levels = np.clip((small - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    # In colour, since Intel's code for grey images in OpenCV 5.0.0 writes beyond its memory where edges are many, if
    # OpenCV uses one thread.
    outlines = cv2.Canny(cv2.cvtColor(levels, cv2.COLOR_GRAY2BGR), *_CANNY)
    length = _LEAST_LENGTH * max(small.shape)
    lines = cv2.HoughLinesP(outlines, 1, _TURN, _VOTES, minLineLength=length, maxLineGap=_GAP)
    edges = np.empty((0, 2, 2)) if lines is None else lines.reshape(-1, 2, 2).astype(float)
    kept: list[np.ndarray] = []
    for edge in sorted(edges, key=lambda edge: -float(np.hypot(*(edge[1] - edge[0])))):
        if not any(_are_one(edge, other) for other in kept):
            kept.append(edge)
    return [(edge + 0.5) / factor - 0.5 for edge in kept[:_MOST_EDGES]]


def _are_one(edge: np.ndarray, other: np.ndarray) -> bool:
    """Whether an edge lies on a longer one."""
    along = (other[1] - other[0]) / np.hypot(*(other[1] - other[0]))
    away = edge.mean(axis=0) - other.mean(axis=0)
    own = edge[1] - edge[0]
    turn = (math.atan2(own[1], own[0]) - math.atan2(along[1], along[0]) + math.pi / 2) % math.pi - math.pi / 2
    return abs(turn) < _ALIKE[0] and abs(float(away[0] * along[1] - away[1] * along[0])) < _ALIKE[1]


def _strips(grey: np.ndarray, edge: np.ndarray) -> list[Strip]:
    """Return the strips along an edge that repeat most clearly."""
    centre = edge.mean(axis=0)
    length = float(np.hypot(*(edge[1] - edge[0])))
    angle = math.atan2(*(edge[1] - edge[0])[::-1])
    along = np.arange(length) - (length - 1) / 2
    across = np.arange(-_REACH, _REACH + 1.0)[:, None]
    x = (centre[0] + along * math.cos(angle) - across * math.sin(angle)).astype(np.float32)
    y = (centre[1] + along * math.sin(angle) + across * math.cos(angle)).astype(np.float32)
    band = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    rows = cv2.blur(band, (1, _ROWS))[::_EACH]
    found = [
        Strip(centre + down * np.array([-math.sin(angle), math.cos(angle)]), angle, period, score)
        for down, (period, score) in zip(across[::_EACH, 0].tolist(), _periods(rows), strict=True)
        if score > _CONTRAST
    ]
    return sorted(found, key=lambda strip: -strip.score)[:_OF_EDGE]


def _periods(rows: np.ndarray) -> Iterator[tuple[float, float]]:
    """Yield for each row (m, n) the period of which it has most, and by how much its harmonics stand out."""
    n = rows.shape[1]
    frequencies = np.arange(_FEWEST, int(n / _SHORTEST))
    if not len(frequencies):
        yield from [(float(n), 0.0)] * len(rows)
        return
    power = np.abs(np.fft.rfft((rows - rows.mean(axis=1, keepdims=True)) * np.hanning(n), axis=1)) ** 2
    power = np.log(power + 1e-6 * power.max() + 1e-12)
    last = power.shape[1] - 1
    sums = np.zeros((len(rows), len(frequencies)))
    counts = np.zeros(len(frequencies))
    best = np.full(sums.shape, -np.inf)
    for harmonic in range(1, _HARMONICS + 1):
        at = harmonic * frequencies
        is_seen = at <= last
        sums += np.where(is_seen, power[:, np.minimum(at, last)] - power[:, np.minimum(at - frequencies // 2, last)], 0)
        counts += is_seen
        best = np.maximum(best, sums / counts)
    for row in best:
        i = int(row.argmax())
        yield n / float(frequencies[i]), float(row[i])
