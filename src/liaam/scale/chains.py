"""Find rows of equal dark rectangles with gaps of their own length: the dark blocks of a scale bar.

The dark blocks are found without regard to the ground, so that bars on a card of the colour of their light blocks, and
those with thick blocks, are found, too. Of two rows of blocks, as on field scales, those of both make one chain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from liaam.scale.bar import sampled

FEWEST = 2
"""Least number of dark blocks."""

_QUANTILES = np.arange(0.02, 0.9, 0.08)  # of the levels, below which pixels are dark
_EACH = 25.0  # the least contrast of dark and light blocks
_OPEN = (3, 7)  # sides of openings, which cut the lines of an outline, and corners that touch
_LEAST = 4.0  # pixels of the shorter side
_LONGEST = 20.0  # ratio of the sides
_FILLED = 0.8  # least share of its rectangle that a block fills; corners are rounded by the opening
_ALIKE = 0.25  # greatest relative difference of the sides of blocks
_STEP = 0.2  # greatest relative difference of a step along the chain from its length
_EQUAL = 0.08  # greatest relative difference of the length of dark blocks from the light ones between them
_BLURRED = 4.0  # pixels that are allowed in any case, but for short blocks
_STEP_TO_OTHER_ROW = 1.5 * _STEP  # the same from a row to the other: it is half as long, so that errors count for more
_IN_LINE = 0.3  # greatest distance across a chain from where a block should be, of the thickness
_SPREAD_OF_ROW = 2.0  # greatest distance across between blocks of a row, of the thickness: the axis is not exact yet
_APART = 0.4  # greatest relative difference of the distance of two rows from the thickness
_SAME = 0.3  # greatest distance of the ends of two findings of one chain, of a block's length
_TURNED = math.radians(6)  # greatest difference of directions
_MOST_CHAINS = 200  # that are measured, the longest: a fabric has thousands
_MOST_DARK = 400  # rectangles of an image, the largest, that are compared, each with each: bounds time and memory
_SAMPLES = 0.25  # pixels between samples along a bar, whose ends are found to less than a pixel


@dataclass(frozen=True)
class Block:
    """A dark rectangle: its middle, its sides, and the direction of the first one."""

    middle: np.ndarray
    along: float
    across: float
    angle: float

    def turned(self) -> Block:
        """Return it with its sides exchanged."""
        return Block(self.middle, self.across, self.along, self.angle + math.pi / 2)


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
        half = 0.25 * self.thickness  # the middle half of the blocks is sampled, away from their borders
        across = np.linspace(-half, half, 2 * math.ceil(half) + 1)

        def levels_at(offset: float) -> np.ndarray:
            """Return the mean levels along a line at an offset across, pixels."""
            return sampled(levels, self.middle, self.axis, places, across + offset).mean(axis=1)

        if self.rows == 1:
            return places, levels_at(0.0)
        return places, levels_at(-self.thickness / 2) - levels_at(self.thickness / 2)


def dark_blocks(grey: np.ndarray, *, by_quantiles: bool = True) -> list[list[Block]]:
    """Return the dark rectangles in an image (h, w) of levels from 0 to 255, below each of several levels.

    These are quantiles, or are apart by the least contrast of blocks: the blocks of a small bar may all lie between two
    quantiles.
    """
    levels = np.quantile(grey, _QUANTILES) if by_quantiles else np.arange(_EACH, 255.0, _EACH)
    return [_blocks(grey < level, side) for level in levels.tolist() for side in _OPEN]


def find_chains(dark: Sequence[Sequence[Block]]) -> list[Chain]:
    """Return the chains of dark blocks, of which each list is looked at alone, the longest first."""
    found: list[Chain] = []
    for blocks in dark:
        found.extend(sorted(_chains(blocks), key=_length, reverse=True)[:_MOST_CHAINS])
    return _different(found)


def _length(chain: Chain) -> float:
    return chain.end - chain.begin


def _different(chains: Sequence[Chain]) -> list[Chain]:
    """Return the longest chains that do not begin and end at the same places as a longer one."""
    kept: list[Chain] = []
    ends = np.empty((0, 2, 2))
    for chain in sorted(chains, key=_length, reverse=True):
        own = _ends(chain)
        if not (np.abs(ends - own).max(axis=(1, 2)) < _SAME * chain.pitch).any():
            kept.append(chain)
            ends = np.concatenate([ends, own[None]])
    return kept[:_MOST_CHAINS]


def _ends(chain: Chain) -> np.ndarray:
    """Return the points (2, 2) where a chain begins and ends."""
    return np.array([chain.middle + chain.begin * chain.axis, chain.middle + chain.end * chain.axis])


def _blocks(dark: np.ndarray, side: int) -> list[Block]:
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
            blocks.append(Block(np.array([x, y]), *sides, math.radians(angle)))
    return sorted(blocks, key=lambda block: -block.along * block.across)[:_MOST_DARK]


def _chains(blocks: Sequence[Block]) -> Iterator[Chain]:
    """Yield the chains that blocks make: each leads to the next one, two lengths on, or to the other row, one on.

    Either side of a block may be along the chain, so that each is tried both ways.
    """
    if len(blocks) < FEWEST:
        return
    both_ways = [*blocks, *(block.turned() for block in blocks)]
    is_next, is_in_other_row = _links(both_ways)
    for links, rows in ((is_in_other_row, 2), (is_next, 1)):
        for members in _groups(links):
            chain = _chain([both_ways[i] for i in members], rows)
            if chain is not None:
                yield chain


def _links(blocks: Sequence[Block]) -> tuple[np.ndarray, np.ndarray]:
    """Return which of k blocks are beside each other in one row, and which in two, (k, k) bool each."""
    middles = np.array([block.middle for block in blocks])
    along = np.array([block.along for block in blocks])
    across = np.array([block.across for block in blocks])
    angles = np.array([block.angle for block in blocks])

    is_alike = np.abs(np.log(along[None] / along[:, None])) < _ALIKE
    is_alike &= np.abs(np.log(across[None] / across[:, None])) < _ALIKE
    is_alike &= np.abs(_between_axes(angles[None], angles[:, None])) < _TURNED

    # From each block to each other one: steps along the direction of the former, and to its side.
    away = middles[None] - middles[:, None]
    cos = np.cos(angles)[:, None]
    sin = np.sin(angles)[:, None]
    step = np.abs(away[..., 0] * cos + away[..., 1] * sin)
    side = np.abs(away[..., 1] * cos - away[..., 0] * sin)
    length = (along[None] + along[:, None]) / 2
    thickness = (across[None] + across[:, None]) / 2
    is_next = is_alike & (np.abs(step / (2 * length) - 1) < _STEP) & (side < _IN_LINE * thickness)
    is_in_other_row = is_alike & (np.abs(step / length - 1) < _STEP_TO_OTHER_ROW)
    is_in_other_row &= np.abs(side / thickness - 1) < _IN_LINE
    return is_next, is_in_other_row


def _between_axes(angles: Any, others: Any) -> Any:
    """Return the angles from other axes to axes, -pi/2 to pi/2: an axis has no sense of direction."""
    return (angles - others + np.pi / 2) % np.pi - np.pi / 2


def _groups(links: np.ndarray) -> list[np.ndarray]:
    """Return the indices of blocks that are linked (k, k), directly or by others, if they are enough for a chain."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    n, labels = connected_components(csr_array(links), directed=False)
    sizes = np.bincount(labels, minlength=n)
    return [np.flatnonzero(labels == label) for label in np.flatnonzero(sizes >= FEWEST)]


def _chain(blocks: Sequence[Block], rows: int) -> Chain | None:
    """Return the chain of blocks, or None if they are not at even steps on one line, or on two."""
    middles = np.array([block.middle for block in blocks])
    first = blocks[0].angle
    angle = first + float(np.mean([_between_axes(block.angle, first) for block in blocks]))
    axis = np.array([math.cos(angle), math.sin(angle)])
    thickness = float(np.median([block.across for block in blocks]))
    length = float(np.median([block.along for block in blocks]))
    centre = middles.mean(axis=0)
    along = (middles - centre) @ axis
    blocks_per_step = 1 if rows == 2 else 2  # in one row, a light block is between two dark ones
    numbers = np.rint((along - along.min()) / (blocks_per_step * length))
    if len(set(numbers.tolist())) != len(numbers) or np.ptp(numbers) != len(numbers) - 1:
        return None  # two blocks are at one place, or one is missing
    step, start = np.polyfit(numbers, along, 1)
    pitch = float(step / blocks_per_step)
    if np.abs(along - start - step * numbers).max() > _STEP * pitch or abs(pitch - length) > _uneven(pitch):
        return None
    normal = np.array([-axis[1], axis[0]])
    across = (middles - centre) @ normal
    line = _line_of_row(along, across) if rows == 1 else _line_of_two_rows(along, across, numbers, thickness)
    if line is None:
        return None
    level, slope = line
    # The line through the middles is steadier than the sides of the blocks.
    turn = angle + math.atan(slope)
    return Chain(
        middle=centre + level * normal,
        axis=np.array([math.cos(turn), math.sin(turn)]),
        begin=float(start) - pitch / 2,
        end=float(start + step * numbers.max()) + pitch / 2,
        pitch=pitch,
        thickness=thickness,
        rows=rows,
    )


def _uneven(pitch: float) -> float:
    """Return by how many pixels the length of dark blocks may differ from their pitch: blur changes it by a few."""
    return max(_EQUAL * pitch, min(_STEP * pitch, _BLURRED))


def _line_of_row(along: np.ndarray, across: np.ndarray) -> tuple[float, float]:
    """Return level and slope of the line through the middles (k,) of the blocks of a row."""
    design = np.stack([np.ones(len(along)), along], axis=1)
    level, slope = np.linalg.lstsq(design, across, rcond=None)[0].tolist()
    return level, slope


def _line_of_two_rows(
    along: np.ndarray, across: np.ndarray, numbers: np.ndarray, thickness: float
) -> tuple[float, float] | None:
    """Return level and slope of the line between two rows, in which the blocks (k,) alternate by their numbers.

    None if there are too few, or if the rows are not one thickness apart.
    """
    sides = np.where(numbers % 2 == 0, 1.0, -1.0)
    if len(along) < 3:
        return None
    if max(np.ptp(across[sides > 0]), np.ptp(across[sides < 0])) > _SPREAD_OF_ROW * thickness:
        return None
    design = np.stack([np.ones(len(along)), along, sides], axis=1)
    level, slope, half = np.linalg.lstsq(design, across, rcond=None)[0].tolist()
    if abs(abs(half) / (thickness / 2) - 1) > _APART:
        return None
    return level, slope
