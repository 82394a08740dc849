"""Where ticks may be: by their period in the spectra of tiles.

The spectrum of a tile with ticks has its power on a ray across the ticks, at the multiples of one frequency. Such tiles
propose a direction and a period.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

TILES = (96, 192, 384)
"""Sides of tiles in pixels. The longest period that is found is a sixth of the largest, the shortest 4 pixels."""

REACH = 40
"""Pixels across a ruler that are looked at, to both sides."""

AGREE = 0.08
"""Greatest difference of the logarithms of periods, and of directions in radians, of proposals in line."""

MOST_TILES = 32
"""Proposals that are refined."""

_CYCLES = (6, 24)  # fewest and most periods in a tile
_ANGLES = 180  # directions that are looked at, of 180 degrees
_HARMONICS = 3  # of the period whose power is summed
_CONTRAST = 2.2  # least mean logarithm of the power at harmonics over that between them
_OF_TILE = 2  # proposals of a tile
_APART = 0.1  # least difference of their directions, radians
_MOST_ALIKE = 3  # proposals that are refined on one line
_MOST_OF_KIND = 4  # of them of one period and direction, as those of a fabric or graph paper below a ruler


@dataclass(frozen=True)
class Proposal:
    """Where ticks may be: the centre of a tile, the direction along the ruler (radians), and the period (pixels)."""

    centre: np.ndarray
    angle: float
    period: float
    score: float = 0.0

    def place(self, along: float, across: float) -> np.ndarray:
        """Return the place (2,) at distances from the centre along the ruler and across it, pixels."""
        direction = np.array([math.cos(self.angle), math.sin(self.angle)])
        normal = np.array([-direction[1], direction[0]])
        return self.centre + along * direction + across * normal


def find_proposals(grey: np.ndarray) -> list[Proposal]:
    """Return the proposals of the tiles whose spectra are most like those of ticks, the best first."""
    proposals = []
    for side in TILES:
        for top, left in _places(grey.shape, side):
            for proposal in _of_tile(grey[top : top + side, left : left + side]):
                proposals.append(replace(proposal, centre=proposal.centre + np.array([left, top])))
    return _likeliest(proposals)


def _likeliest(proposals: Sequence[Proposal]) -> list[Proposal]:
    """Return the proposals that are most likely to be on a ruler, first those with high scores and others in line."""
    if not proposals:
        return []
    periods = np.array([proposal.period for proposal in proposals])
    angles = np.array([proposal.angle for proposal in proposals])
    centres = np.array([proposal.centre for proposal in proposals])
    away = centres[None] - centres[:, None]
    across = away[..., 1] * np.cos(angles)[:, None] - away[..., 0] * np.sin(angles)[:, None]
    turned = (angles[None] - angles[:, None] + np.pi / 2) % np.pi - np.pi / 2
    is_alike = np.abs(np.log(periods[None] / periods[:, None])) < AGREE
    is_of_kind = is_alike & (np.abs(turned) < AGREE)
    agree = is_of_kind & (np.abs(across) < REACH)
    scores = np.array([proposal.score for proposal in proposals]) + np.log(agree.sum(axis=1))
    chosen: list[int] = []
    for i in np.argsort(-scores, kind="stable").tolist():
        if agree[i, chosen].sum() < _MOST_ALIKE and is_of_kind[i, chosen].sum() < _MOST_OF_KIND:
            chosen.append(i)
    return [proposals[i] for i in chosen[:MOST_TILES]]


def _places(shape: tuple[int, ...], side: int) -> Iterator[tuple[int, int]]:
    """Yield the corners of tiles that overlap by a third, and reach to the borders."""
    step = 2 * side // 3
    starts = [sorted({*range(0, max(length - side, 0) + 1, step), max(length - side, 0)}) for length in shape[:2]]
    for top in starts[0]:
        for left in starts[1]:
            if min(shape[0], shape[1]) >= side:
                yield top, left


@lru_cache(4)
def _polar(side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a window (side, side), maps of polar coordinates (angles, radii) in a spectrum, and the angles."""
    window = np.hanning(side)[:, None] * np.hanning(side)
    radii = np.arange(0, side / 2 - 1, 0.5)
    angles = np.arange(_ANGLES) * np.pi / _ANGLES
    x = side // 2 + np.cos(angles)[:, None] * radii
    y = side // 2 + np.sin(angles)[:, None] * radii
    return window.astype(np.float32), x.astype(np.float32), y.astype(np.float32), angles


def _of_tile(tile: np.ndarray) -> Iterator[Proposal]:
    """Yield the directions and the periods of ticks in a tile, if its spectrum is that of ticks.

    There may be two: of a ruler, and of what it lies on.
    """
    side = len(tile)
    window, x, y, angles = _polar(side)
    values = (tile - tile.mean()) * window
    power = np.abs(np.fft.fftshift(np.fft.fft2(values))) ** 2
    if not power.any():
        return
    rays = cv2.remap(power.astype(np.float32), x, y, cv2.INTER_LINEAR)
    rays = np.log(rays + 1e-6 * rays.max() + 1e-12)
    # Twice the radius is the index: radii are in halves of a cycle per tile.
    least = 2 * _CYCLES[0]
    most = 2 * _CYCLES[1]
    frequencies = np.arange(least, min(most, rays.shape[1] // 2))
    n_harmonics = np.minimum(_HARMONICS, (rays.shape[1] - 1) // frequencies)
    score = np.full((len(angles), len(frequencies)), -np.inf)
    for column, (frequency, n) in enumerate(zip(frequencies, n_harmonics, strict=True)):
        at = frequency * np.arange(1, n + 1)
        between = at - frequency // 2
        contrasts = np.cumsum(rays[:, at] - rays[:, between], axis=1) / np.arange(1, n + 1)
        contrast = contrasts.max(axis=1)  # blur takes the higher harmonics of short periods
        score[:, column] = contrast + 0.1 * (rays[:, at].mean(axis=1) - rays.max())
    strength = float(np.sqrt(power.sum()))
    for _ in range(_OF_TILE):
        row, column = np.unravel_index(int(score.argmax()), score.shape)
        best = float(score[row, column])
        if best < _CONTRAST:
            return
        period = 2 * side / float(frequencies[column])
        centre = np.full(2, (side - 1) / 2)
        yield Proposal(centre, float(angles[row]), period, best + 0.2 * math.log(strength + 1e-9))
        turned = (angles - angles[row] + np.pi / 2) % np.pi - np.pi / 2
        score[np.abs(turned) < _APART] = -np.inf
