"""Find scale bars of two or three blocks of which one is dark: the light ones beside it are rectangles of its size.

The lines around a light block are what tells it from the card: they run along both of its sides as far from the dark
block as that is long, and are closed there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from liaam.scale.bar import SHORTEST, Bar, sampled
from liaam.scale.chains import Block
from liaam.scale.edges import OF_SHIFT, edge_of

_UNEVEN = 0.1  # greatest relative difference of the thickness of its halves
_SLENDER = 1.5  # least ratio of the sides of the dark block
_MOST = 150  # blocks that are looked at, the largest
_STEP = 0.25  # pixels between samples along a bar
_LEAST_CONTRAST = 25.0  # levels of 255 between the dark block and the light ones
_LINE = 0.05  # least depth of a line, of that contrast
_ABOVE_NOISE = 3.0  # and in standard deviations of the levels in a block
_WIDE = 3.0  # greatest distance of a line from where the side of the dark block would go on, pixels
_BESIDE = (4.0, 8.0)  # pixels beyond the sides whose level is that of the card
_IS_LINE = 0.8  # least share of a side that has a line, if it has one
_IS_NONE = 0.4  # and the greatest if it has none
_EQUAL = 0.06  # greatest relative difference of the length of a light block from the dark one's
_LEAST_EQUAL = 3.0  # pixels that are allowed in any case
_AROUND = 6.0  # pixels around an edge or a line that are looked at
_OF_LINE = 0.25
"""From the outer edge of the outline to where the bar is taken to end, of the width of the line.

Blocks end at that edge, or in the middle of the line, and alike at both ends. The standard deviation of two places is
half of what is between them, so that this is the standard error, too."""
_SHARED = 0.06  # standard error of the place of an edge by the shape of pixels and the ground, pixels


class Outlined(NamedTuple):
    """A bar with one dark block."""

    bar: Bar
    half: float  # of its thickness, pixels
    n: int  # blocks


class _View(NamedTuple):
    """A dark block, with what is at both of its ends."""

    levels: np.ndarray  # (h, w, 2), stored and in linear light
    middle: np.ndarray
    axis: np.ndarray
    length: float
    thickness: float
    dark: np.ndarray  # (2,)


class _Side(NamedTuple):
    """What is at one end of a dark block; places are distances from the middle of the block."""

    is_block: bool  # whether it is a light block
    at: float  # of the edge of the dark block, or of the middle of the line that ends the light one
    error: float
    shift: float  # from the place of that edge in linear light to that in stored levels
    width: float  # of that line


def find_outlined(levels: np.ndarray, dark: Sequence[Block]) -> Iterator[Outlined]:
    """Yield the bars whose one dark block is among these, of an image (h, w, 2) of levels, stored and linear."""
    for block in _different(dark):
        found = _bar_at(levels, block)
        if found is not None:
            yield found


def _different(blocks: Sequence[Block]) -> list[Block]:
    """Return the largest slender blocks at different places, along their longer side."""
    kept: list[Block] = []
    places = np.empty((0, 3))
    for block in sorted(blocks, key=lambda block: -block.along * block.across):
        block = block if block.along >= block.across else block.turned()
        place = np.array([*block.middle, block.along])
        is_new = not (np.abs(places - place).max(axis=1, initial=0.0) < 2).any()
        if is_new and block.along >= max(_SLENDER * block.across, SHORTEST / 2):
            kept.append(block)
            places = np.concatenate([places, place[None]])
    return kept[:_MOST]


def _bar_at(levels: np.ndarray, block: Block) -> Outlined | None:
    """Return the bar whose dark block this is, if light ones are beside it."""
    view = _view(levels, block)
    if view is None:
        return None
    before, after = _side(view, -1), _side(view, 1)
    if before is None or after is None or not (before.is_block or after.is_block):
        return None
    sides = before, after
    n = 1 + before.is_block + after.is_block
    length = before.at + after.at
    width = max(before.width, after.width)
    # The outline is a line around all blocks, dark and light. Its middle was measured at light ones, its outer edge at
    # the dark one, from where the end of the bar is inwards.
    outer = [side.at + width / 2 if side.is_block else side.at for side in sides]
    first, last = (each - _OF_LINE * width for each in outer)
    if length < SHORTEST or abs(length / (n * block.along) - 1) > _EQUAL:
        return None
    shift = OF_SHIFT * sum(side.shift for side in sides)
    error = math.hypot(before.error, after.error, math.sqrt(2) * _SHARED, shift, 2 * _OF_LINE * width)
    ends = np.array([view.middle - first * view.axis, view.middle + last * view.axis])
    return Outlined(Bar(first + last, error, ends), view.thickness / 2, n)


def _view(levels: np.ndarray, block: Block) -> _View | None:
    """Return a dark block as its sides are at half the height of their edges; None if they are not sharp or parallel.

    The block is that of a mask, of which lines and letters that touch it may be a part.
    """
    axis = np.array([math.cos(block.angle), math.sin(block.angle)])
    inside = sampled(
        levels,
        block.middle,
        axis,
        np.linspace(-0.35, 0.35, 30) * block.along,
        np.linspace(-0.25, 0.25, 5) * block.across,
    )
    dark = np.median(inside.reshape(-1, 2), axis=0)
    reach = block.across / 2 + _BESIDE[1]
    across = np.arange(-reach, reach + _STEP, _STEP)
    edges = []
    for begin, end in ((-0.4, -0.1), (0.1, 0.4)):
        along = np.linspace(begin, end, 20) * block.along
        profile = np.median(sampled(levels[..., 0], block.middle, axis, along, across), axis=0)
        for way in (-1, 1):
            outer = profile[way * across > reach - (_BESIDE[1] - _BESIDE[0])]
            limit = (float(np.median(outer)) + float(dark[0])) / 2
            beyond = np.flatnonzero((profile > limit) & (way * across > 0))
            if not len(beyond) or limit - dark[0] < _LEAST_CONTRAST / 2:
                return None
            edges.append(float(across[beyond[0] if way > 0 else beyond[-1]]))
    tops, bottoms = np.array(edges).reshape(2, 2).T
    thickness = bottoms - tops
    if thickness.min() < 2 or abs(thickness[0] - thickness[1]) > max(_UNEVEN * thickness.max(), 1.0):
        return None
    middles = (tops + bottoms) / 2
    turn = math.atan2(middles[1] - middles[0], 0.5 * block.along)
    normal = np.array([-axis[1], axis[0]])
    axis, middle = math.cos(turn) * axis + math.sin(turn) * normal, block.middle + middles.mean() * normal
    return _View(levels, middle, axis, block.along, float(thickness.mean()), dark)


def _side(view: _View, way: int) -> _Side | None:
    """Return what is at an end of a dark block, in the direction ``way``; None if it is neither card nor a block."""
    edge = _edge(view, way)
    if edge is None:
        return None
    share = _share_of_lines(view, way, 0.65, 1.35)
    if max(share) < _IS_NONE:
        return _Side(False, *edge, 0.0)
    if min(share) < _IS_LINE or max(_share_of_lines(view, way, 1.6, 2.0)) > _IS_NONE:
        return None  # it is none, or others follow
    line = _closing_line(view, way, edge[0])
    return None if line is None else _Side(True, *line)


def _places(view: _View, way: int, begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Return distances from the middle of a block, from and to so many of its lengths, and the levels there (n, 2)."""
    along = np.arange(begin * view.length, end * view.length, _STEP)
    across = np.linspace(-0.2, 0.2, 5) * view.thickness
    return along, sampled(view.levels, view.middle, way * view.axis, along, across).mean(axis=1)


def _edge(view: _View, way: int) -> tuple[float, float, float] | None:
    """Return the place of the edge of the dark block, its error, and its shift in stored levels; None without one."""
    along, profile = _places(view, way, 0.2, 0.9)
    beyond = profile[(along > 0.5 * view.length + _WIDE) & (along < 0.5 * view.length + _WIDE + _AROUND)]
    if not len(beyond):
        return None
    light = np.median(beyond, axis=0)
    near = np.abs(along - 0.5 * view.length) < min(_AROUND, 0.25 * view.length)
    if light[0] - view.dark[0] < _LEAST_CONTRAST or not (light > view.dark).all():
        return None
    noise = float(np.std(beyond[:, 0])) / float(light[0] - view.dark[0])
    edge = edge_of(along[near], (profile[near] - view.dark) / (light - view.dark), noise)
    return None if edge is None else (edge.at, edge.error, edge.shift)


def _share_of_lines(view: _View, way: int, begin: float, end: float) -> tuple[float, float]:
    """Return in which share of the places between two distances a line goes on from either side of a dark block.

    It is darker than what is inside and what is outside of it.
    """
    along = np.linspace(begin, end, 60) * view.length
    half = view.thickness / 2
    inside = sampled(view.levels[..., 0], view.middle, way * view.axis, along, np.linspace(-0.5, 0.5, 7) * half)
    inner = np.median(inside, axis=1)
    depth = max(
        _LINE * (float(np.median(inner)) - float(view.dark[0])), _ABOVE_NOISE * float(np.std(inside - inner[:, None]))
    )
    shares = []
    for side in (-1, 1):
        lines = sampled(
            view.levels[..., 0],
            view.middle,
            way * view.axis,
            along,
            side * (half + np.arange(-_WIDE, _WIDE + 0.1, 0.5)),
        )
        card = sampled(view.levels[..., 0], view.middle, way * view.axis, along, side * (half + np.arange(*_BESIDE)))
        is_line = lines.min(axis=1) < np.minimum(inner, np.median(card, axis=1)) - depth
        shares.append(float(is_line.mean()))
    return shares[0], shares[1]


def _closing_line(view: _View, way: int, begin: float) -> tuple[float, float, float, float] | None:
    """Return the middle of the line that ends a light block, its error, 0, and its width; None if it is not there.

    In linear light, blur makes a line wider and lighter, and changes neither its middle nor its sum.
    """
    reach = max(_EQUAL * view.length, _LEAST_EQUAL)
    along, profile = _places(view, way, begin / view.length + 0.5, begin / view.length + 1.5)
    is_near = np.abs(along - begin - view.length) < reach
    around = np.median(profile[np.abs(along - begin - view.length) < 3 * reach + _AROUND], axis=0)
    depth = around - profile
    noise = 1.4826 * float(np.median(np.abs(depth[:, 0])))
    at = int(np.where(is_near, depth[:, 0], -np.inf).argmax())
    if depth[at, 0] < max(_LINE * (around[0] - view.dark[0]), _ABOVE_NOISE * noise):
        return None
    beyond = (along > along[at] + _WIDE) & (along < along[at] + 2 * _WIDE)
    if np.median(profile[beyond, 0]) < (around[0] + view.dark[0]) / 2:
        return None  # a dark block follows
    near = np.abs(along - along[at]) < _AROUND
    ink = np.maximum(depth[near, 1], 0.0)
    total = float(ink.sum())
    if total <= 0 or around[1] <= view.dark[1]:
        return None
    middle = float(along[near] @ ink) / total
    width = total * _STEP / float(around[1] - view.dark[1])
    return middle, noise / max(float(depth[at, 0]), 1e-9), 0.0, width
