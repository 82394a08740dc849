"""Find rows of equal dark rectangles with gaps of their own length: the dark blocks of a scale bar.

The dark blocks are found without regard to the ground, so that bars on a card of the colour of their light blocks, and
those with thick blocks, are found, too. Of two rows of blocks, as on field scales, those of both make one chain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from liaam.scale.bar import sampled

FEWEST = 2
"""Least number of dark blocks."""

_QUANTILES = np.arange(0.02, 0.9, 0.08)  # of the levels, below which pixels are dark
_OPEN = (3, 7)  # sides of openings, which cut the lines of an outline, and corners that touch
_LEAST = 4.0  # pixels of the shorter side
_LONGEST = 20.0  # ratio of the sides
_FILLED = 0.8  # least share of its rectangle that a block fills; corners are rounded by the opening
_ALIKE = 0.25  # greatest relative difference of the sides of blocks
_STEP = 0.2  # greatest relative difference of a step along the chain from its length
_IN_LINE = 0.3  # greatest distance across a chain from where a block should be, of the thickness
_TURNED = math.radians(6)  # greatest difference of directions
_MOST_DARK = 1500  # rectangles of an image that are compared
_SAMPLES = 0.25  # pixels between samples along a bar


@dataclass(frozen=True)
class _Block:
    """A dark rectangle: its middle, its sides, and the direction of the first one."""

    middle: np.ndarray
    along: float
    across: float
    angle: float

    def turned(self) -> _Block:
        """Return it with its sides exchanged."""
        return _Block(self.middle, self.across, self.along, self.angle + math.pi / 2)


@dataclass(frozen=True)
class Chain:
    """Blocks in line.

    Attributes
    ----------
    middle, axis : (2,) float64
        A point on the middle line and its direction, pixels.
    begin, end : float
        Of the dark blocks, along the axis from the middle.
    pitch, thickness : float
        Length and thickness of a block, pixels.
    rows : int
        2 if dark blocks alternate between two rows.
    """

    middle: np.ndarray
    axis: np.ndarray
    begin: float
    end: float
    pitch: float
    thickness: float
    rows: int

    def profile(self, levels: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
        """Return places along the axis, up to a margin beyond the ends, and the levels there (n, ...).

        Of two rows, the levels are those of one row less those of the other.
        """
        places = np.arange(self.begin - margin, self.end + margin, _SAMPLES)
        half = 0.25 * self.thickness
        rows = np.linspace(-half, half, 2 * math.ceil(half) + 1)
        if self.rows == 1:
            return places, sampled(levels, self.middle, self.axis, places, rows).mean(axis=1)
        upper, lower = (
            sampled(levels, self.middle, self.axis, places, rows + side * self.thickness / 2).mean(axis=1)
            for side in (-1, 1)
        )
        return places, upper - lower


def find_chains(grey: np.ndarray) -> list[Chain]:
    """Return the chains of dark blocks in an image (h, w) of levels from 0 to 255."""
    found: list[Chain] = []
    for level in np.quantile(grey, _QUANTILES).tolist():
        for side in _OPEN:
            for chain in _chains(_blocks(grey < level, side)):
                if not any(_are_one(chain, other) for other in found):
                    found.append(chain)
    return found


def _are_one(chain: Chain, other: Chain) -> bool:
    ends = [each.middle + place * each.axis for each in (chain, other) for place in (each.begin, each.end)]
    return bool(np.abs(np.array(ends[:2]) - np.array(ends[2:])).max() < 0.3 * chain.pitch)


def _blocks(dark: np.ndarray, side: int) -> list[_Block]:
    """Return the solid rectangles of a mask, once it is opened by a disc."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    opened = cv2.morphologyEx(dark.astype(np.uint8), cv2.MORPH_OPEN, disc)
    outlines, _ = cv2.findContours(opened, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    blocks = []
    for outline in outlines:
        area = cv2.contourArea(outline)
        if area < _LEAST**2:
            continue
        (x, y), (width, height), angle = cv2.minAreaRect(outline)
        sides = (width + 1, height + 1)
        is_block = min(sides) >= _LEAST and max(sides) < _LONGEST * min(sides)
        if is_block and area > _FILLED * width * height:
            blocks.append(_Block(np.array([x, y]), *sides, math.radians(angle)))
    return blocks[:_MOST_DARK]


def _chains(blocks: Sequence[_Block]) -> Iterator[Chain]:
    """Yield the chains that blocks make: each leads to the next one, two lengths on, or to the other row, one on."""
    if len(blocks) < FEWEST:
        return
    both = [*blocks, *(block.turned() for block in blocks)]
    middles = np.array([block.middle for block in both])
    along, across, angles = np.array([(block.along, block.across, block.angle) for block in both]).T
    away = middles[None] - middles[:, None]
    step = away[..., 0] * np.cos(angles)[:, None] + away[..., 1] * np.sin(angles)[:, None]
    side = away[..., 1] * np.cos(angles)[:, None] - away[..., 0] * np.sin(angles)[:, None]
    is_alike = (np.abs(np.log(along[None] / along[:, None])) < _ALIKE) & (
        np.abs(np.log(across[None] / across[:, None])) < _ALIKE
    )
    turned = (angles[None] - angles[:, None] + np.pi / 2) % np.pi - np.pi / 2
    is_alike &= np.abs(turned) < _TURNED
    length = (along[None] + along[:, None]) / 2
    thickness = (across[None] + across[:, None]) / 2
    is_next = is_alike & (np.abs(np.abs(step) / (2 * length) - 1) < _STEP) & (np.abs(side) < _IN_LINE * thickness)
    is_across = is_alike & (np.abs(np.abs(step) / length - 1) < 1.5 * _STEP)
    is_across &= np.abs(np.abs(side) / thickness - 1) < _IN_LINE
    for links, rows in ((is_across, 2), (is_next, 1)):
        for members in _groups(links):
            chain = _chain([both[i] for i in members], rows)
            if chain is not None:
                yield chain


def _groups(links: np.ndarray) -> list[np.ndarray]:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    n, labels = connected_components(csr_array(links), directed=False)
    sizes = np.bincount(labels, minlength=n)
    return [np.flatnonzero(labels == label) for label in np.flatnonzero(sizes >= FEWEST)]


def _chain(blocks: Sequence[_Block], rows: int) -> Chain | None:
    """Return the chain of blocks, or None if they are not at even steps on one line, or on two."""
    middles = np.array([block.middle for block in blocks])
    angle = blocks[0].angle + float(
        np.mean([(block.angle - blocks[0].angle + np.pi / 2) % np.pi - np.pi / 2 for block in blocks])
    )
    axis = np.array([math.cos(angle), math.sin(angle)])
    thickness = float(np.median([block.across for block in blocks]))
    length = float(np.median([block.along for block in blocks]))
    centre = middles.mean(axis=0)
    along = (middles - centre) @ axis
    numbers = np.rint((along - along.min()) / (length if rows == 2 else 2 * length))
    if len(set(numbers.tolist())) != len(numbers) or np.ptp(numbers) != len(numbers) - 1:
        return None
    step, start = np.polyfit(numbers, along, 1)
    pitch = float(step if rows == 2 else step / 2)
    if np.abs(along - start - step * numbers).max() > _STEP * pitch or abs(pitch / length - 1) > _STEP:
        return None
    normal = np.array([-axis[1], axis[0]])
    across = (middles - centre) @ normal
    if rows == 2:
        sides = np.where(numbers % 2 == 0, 1.0, -1.0)
        if len(blocks) < 3 or np.ptp(across[sides > 0]) > 2 * thickness or np.ptp(across[sides < 0]) > 2 * thickness:
            return None
    # The line through the middles is steadier than the sides of the blocks.
    design = np.stack([np.ones(len(along)), along] + ([sides] if rows == 2 else []), axis=1)
    level, slope, *half = np.linalg.lstsq(design, across, rcond=None)[0].tolist()
    if rows == 2 and abs(abs(half[0]) / (thickness / 2) - 1) > 0.4:
        return None
    turn = angle + math.atan(slope)
    axis = np.array([math.cos(turn), math.sin(turn)])
    return Chain(
        centre + level * normal, axis, float(start) - pitch / 2, float(start + step * numbers.max()) + pitch / 2,
        pitch, thickness, rows,
    )  # fmt: skip
