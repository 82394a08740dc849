"""Find scale bars of equal blocks, dark and light in turn, with an outline or without.

They are looked for in two ways: by the outline of all blocks, which differ from the ground; and by their dark blocks
alone (:mod:`liaam.scale.chains`), as light blocks may be of the colour of the card that they are printed on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from liaam.scale.bar import SHORTEST, Bar, axes_of, profile_at, sampled
from liaam.scale.chains import Block, Chain, dark_blocks, find_chains
from liaam.scale.edges import OF_SHIFT, Edge, edge_of
from liaam.scale.lengths import widened
from liaam.scale.outlined import find_outlined

FEWEST = 2
"""Least number of blocks."""

_CONTRASTS = (25.0, 50.0, 90.0)  # levels of 255 from the ground, above and below, of what is looked at
_GROUND = 51  # side of the median filter that gives the ground; thicker bars are not found
_CLOSE = 5  # pixels that are closed: blur leaves a gap between a dark and a light block
_SLENDER = 4.0  # least ratio of the length to the thickness
_RECTANGLE = 0.85  # least share of its rectangle that a bar fills
_STEP = 0.25  # pixels between samples along a bar
_NARROW = 0.6  # least length of a block, of the thickness of the bar
_OF_BOTH = 1.5  # greatest distance of a bar from a longer one, of half of both thicknesses: it may be its other row
_SAME = 0.01  # greatest relative difference of the length of a bar that is found twice
_EQUAL = 0.08  # greatest relative difference of a block's length from the mean
_BEYOND = (4, 12)  # pixels beyond an end, whose median is the level of the ground
_LEAST_CONTRAST = 25.0  # between dark and light blocks
_FIRST = 0.2  # least share of the contrast by which an outline differs from the ground
_OUTLINE = math.sqrt(2 / 3)
"""Standard error of an end, of half the width of its outline, which is inside, outside, or on the end: one of three."""
_CHANGE = 0.037
"""Usual scatter of the places of changes from one block to the next, pixels.

It is the root mean square of that in bars of five blocks and more of the third test (experiments/notes/scale.md)."""
_CHANGES = 4.0  # which counts as that of so many changes, as few of a bar do not show their own
_AROUND = 10.0  # greatest distance from a change that is looked at, pixels
_LEVEL = 0.35  # greatest difference of the level of a block from the others of its kind, of the contrast
_STEP_OUT = 0.04  # least step from a light block at an end to the ground, or to its outline, of the contrast
_MOST = 60  # further blocks at either end of those that were seen
_OTHER_ROW = 0.04  # greatest difference of two rows beyond an end, of that of blocks: one in glare may follow
_NOISE = 4.0  # and the least in levels, above the noise of a mean
_SIDE = (5.0, 10.0)  # least and greatest distance beyond the sides of a chain that is looked at, pixels
_SHOWN = 1.0  # least levels by which light blocks differ from the card, for the shape of that to be known
_OF_USUAL = 0.35  # least part of that by which one at an end differs
_SAME_CARD = 0.15  # greatest difference of the level of a card from one block to the next, of the contrast
_IS_NONE = 0.3  # greatest correlation of the levels across a place with those of the light blocks, if it is none
_IS_ONE = 0.7  # and the least if it is one; between them it is not clear
_LIKE_BLOCK = 0.8  # least correlation with a block of one level, whose thickness is roughly known, of a dim one
_IS_SURE = 0.9  # and the least beyond the card, as by its level


class Blocks(NamedTuple):
    """A bar of blocks."""

    bar: Bar
    half: float  # of its thickness, pixels
    n: int  # blocks, dark and light
    is_clear: bool = True  # whether it is clear that no further block is at an end


def find_blocks(levels: np.ndarray) -> list[Blocks]:
    """Find bars of blocks in an image (h, w, 2) of levels, stored and in linear light."""
    found = list(_by_outline(levels))
    for by_quantiles in (True, False):
        dark = dark_blocks(levels[..., 0], by_quantiles=by_quantiles)
        single = (Blocks(*each) for each in find_outlined(levels, [block for blocks in dark for block in blocks]))
        found = _different([each for each in (*found, *_by_dark_blocks(levels, dark), *single) if _is_bar(each)])
        if any(each.is_clear for each in found):
            break
    return found


def _different(found: list[Blocks]) -> list[Blocks]:
    """Return the bars that are not parts of longer ones."""
    found.sort(key=lambda each: -each.bar.length)
    kept: list[Blocks] = []
    for each in found:
        wholes = [
            i for i, whole in enumerate(kept) if is_part(each.bar, whole.bar, _OF_BOTH * (whole.half + each.half))
        ]
        if not wholes:
            kept.append(each)
            continue
        whole = kept[wholes[0]]
        if each.n == whole.n and abs(each.bar.length / whole.bar.length - 1) < _SAME:
            steadier = min(each, whole, key=lambda blocks: blocks.bar.length_se)
            kept[wholes[0]] = steadier._replace(is_clear=each.is_clear and whole.is_clear)
    return kept


def _is_bar(blocks: Blocks) -> bool:
    """Whether blocks are not too narrow, as teeth of a comb, threads of a screw and lines of a bar code are."""
    return blocks.bar.length > _NARROW * blocks.n * 2 * blocks.half


def is_part(bar: Bar, whole: Bar, reach: float) -> bool:
    """Whether a bar lies along another, at most so far from its middle line and its ends."""
    axis = (whole.ends[1] - whole.ends[0]) / whole.length
    away = bar.ends - whole.ends[0]
    along = away @ axis
    across = away @ np.array([-axis[1], axis[0]])
    return bool((np.abs(across) < reach).all() and (along > -reach).all() and (along < whole.length + reach).all())


def _by_dark_blocks(levels: np.ndarray, dark: Sequence[Sequence[Block]]) -> Iterator[Blocks]:
    for part in find_chains(dark):
        blocks = _of_chain(levels, _whole(levels[..., 0], part))
        if blocks is not None:
            yield blocks


def _whole(grey: np.ndarray, chain: Chain) -> Chain:
    """Return a chain of one row with the further blocks that go on in its steps, some of which may not have been seen.

    A further dark block has light beside it, across the chain, as the ground beyond a card has not.
    """
    if chain.rows > 1:
        return chain
    n = _n_blocks(chain)
    levels = _levels_at(grey, chain, chain.begin + (np.arange(n) + 0.5) * chain.pitch)
    dark, light = float(np.median(levels[::2])), float(np.median(levels[1::2]))
    limit = (dark + light) / 2
    for side in (-1, 1):
        for _ in range(_MOST):
            last = chain.end if side > 0 else chain.begin
            places = last + side * np.array([0.5, 1.5]) * chain.pitch
            gap, block = _levels_at(grey, chain, places).tolist()
            beside = [_levels_at(grey, chain, places[1:], way * chain.thickness)[0] for way in (-1, 1)]
            if gap < limit or block > limit or min(beside) < limit:
                break
            further = last + 2 * side * chain.pitch
            chain = replace(chain, end=further) if side > 0 else replace(chain, begin=further)
    return chain


def _levels_at(grey: np.ndarray, chain: Chain, middles: np.ndarray, across: float = 0.0) -> np.ndarray:
    """Return the median levels around places (n,) along a chain, and so far across it."""
    places = middles[:, None] + np.linspace(-0.25, 0.25, 9) * chain.pitch
    rows = across + np.linspace(-0.2, 0.2, 3) * chain.thickness
    levels = sampled(grey, chain.middle, chain.axis, places.ravel(), rows)
    return np.median(levels.reshape(len(middles), -1), axis=1)


def _of_chain(levels: np.ndarray, chain: Chain) -> Blocks | None:
    """Return the bar whose dark blocks make a chain, or None. At its ends may be light blocks, which are looked for."""
    places, profile = chain.profile(levels, 2 * chain.pitch)
    n = _n_blocks(chain)
    middles = chain.begin + (np.arange(n) + 0.5) * chain.pitch
    means = np.array([_level(places, profile, middle, 0.25 * chain.pitch) for middle in middles])
    dark, light = np.median(means[::2], axis=0), np.median(means[1::2], axis=0)
    contrast = np.abs(light - dark)
    if contrast[0] < _LEAST_CONTRAST or not contrast.all():
        return None
    own = np.where((np.arange(n) % 2 == 0)[:, None], dark, light)
    if (np.abs(means - own) > _LEVEL * contrast).any():
        return None
    begin = chain.begin
    is_clear = True
    if chain.rows == 1:
        kinds = (float(dark[0]), float(light[0]))
        before, after = (_light_block_follows(levels[..., 0], chain, side, kinds) for side in (-1, 1))
        is_clear = before is not None and after is not None
        n += bool(before) + bool(after)
        begin -= bool(before) * chain.pitch
    else:
        ends = np.array([begin - 0.5 * chain.pitch, chain.end + 0.5 * chain.pitch])
        beyond = [abs(_level(places, profile, end, 0.25 * chain.pitch)[0]) for end in ends]
        is_clear = bool(max(beyond) < _OTHER_ROW * contrast[0])
    if n < 3 or n * chain.pitch < max(SHORTEST, _SLENDER * chain.rows * chain.thickness):
        return None
    reach = min(0.45 * chain.pitch, _AROUND)
    edges = [_edge(places, profile, begin + i * chain.pitch, reach) for i in range(1, n)]
    if None in edges:
        return None
    start, pitch, error = _pitch([edge for edge in edges if edge])
    away = np.array([edge.at - start - i * pitch for i, edge in enumerate(edges, 1) if edge])
    if np.abs(away).max() > max(_EQUAL * pitch, 2.0):
        return None
    points = np.array([chain.middle + start * chain.axis, chain.middle + (start + n * pitch) * chain.axis])
    return Blocks(Bar(n * pitch, n * error, points), chain.rows * chain.thickness / 2, n, is_clear)


def _level(places: np.ndarray, profile: np.ndarray, middle: float, half: float) -> np.ndarray:
    """Return the median level within so many pixels of a place."""
    return np.median(profile[np.abs(places - middle) <= max(half, places[1] - places[0])], axis=0)


def _light_block_follows(grey: np.ndarray, chain: Chain, side: int, kinds: tuple[float, float]) -> bool | None:
    """Whether a light block follows the last dark one at an end; None if that is not clear.

    A light block between two dark ones differs from the card at its sides, or has a line there, or nobody would end a
    bar with one. One that follows the last dark block looks alike, and what is beyond it does not. Where glare hides
    the others, it is lighter than the card; and where the card is as white as can be, it would not be seen. Of two rows
    of blocks, a dark one of the other row is beside each light one.
    """
    dark, light = kinds
    across = _across(chain)
    gaps = chain.begin + np.arange(1.5, _n_blocks(chain), 2) * chain.pitch
    places = (chain.end if side > 0 else chain.begin) + side * np.array([0.5, 1.5]) * chain.pitch
    blocks = chain.begin + np.arange(0.5, _n_blocks(chain), 2) * chain.pitch
    limit = (dark + light) / 2
    for way in (-chain.thickness, chain.thickness):
        is_dark = [_levels_at(grey, chain, each, way) < limit for each in (gaps, blocks)]
        if is_dark[0].all() and not is_dark[1].any():
            own, other, card = (_levels_at(grey, chain, places[:1], times * way)[0] for times in (0, 1, 2))
            step = (min(own, card) - other) / (light - dark)
            is_pair = min(own, card) > limit and step > 2 * _OTHER_ROW
            return None if is_pair and other > limit else bool(is_pair)  # it may be in glare
    between, cards = _at_sides(grey, chain, gaps)
    if np.median(cards) < limit:
        return None  # on a dark ground, a dark block at an end is not seen
    usual = np.median(between, axis=0)
    is_shown = np.abs(usual).max() > _SHOWN
    box = (np.abs(across) < chain.thickness / 2).astype(float)
    shape = usual if is_shown else box
    profiles, beside = _at_sides(grey, chain, places)
    is_light = np.abs(_levels_at(grey, chain, places) - light) < _LEVEL * (light - dark)
    is_on_card = np.abs(beside - cards[-1 if side > 0 else 0]) < _SAME_CARD * (light - dark)
    is_seen = np.abs(profiles).max(axis=1) > max(_STEP_OUT * (light - dark), _NOISE)
    strength = profiles @ shape / float(shape @ shape)
    is_strong = strength > _OF_USUAL if is_shown else np.ones(2, bool)
    is_block = is_seen & is_strong
    sizes = np.linalg.norm(profiles, axis=1) * np.linalg.norm(shape)
    alike = np.divide(profiles @ shape, sizes, out=np.zeros(2), where=is_block)
    alike[~is_on_card & (alike < _IS_SURE)] = 0.0
    if alike[0] < _IS_NONE:
        is_lighter = light - float(np.median(cards)) > max(_SHOWN, -float(usual.min()))
        is_hidden = is_light[0] and beside[0] + _OF_USUAL * (light - float(np.median(cards))) > float(grey.max())
        return None if is_lighter and is_hidden else False
    if is_seen[1] and abs(float(np.corrcoef(profiles[1], box)[0, 1])) > _LIKE_BLOCK:
        return None  # so is what is beyond that
    if not is_light[0]:
        return None if alike[0] > _IS_SURE else False  # it may be in a shadow, or in glare
    return True if alike[0] > _IS_ONE and alike[1] < _IS_ONE else None


def _across(chain: Chain) -> np.ndarray:
    """Return the distances across a chain (m,) at which its blocks and the card beside them are looked at, pixels."""
    half = chain.thickness / 2
    reach = half + min(max(_SIDE[0], 0.5 * half), _SIDE[1])
    return np.arange(-reach, reach + _STEP, _STEP)


def _at_sides(grey: np.ndarray, chain: Chain, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the levels across a chain at places (n,) along it, above those of the card beside it, and the latter."""
    across = _across(chain)
    along = middles[:, None] + np.linspace(-0.25, 0.25, 9) * chain.pitch
    levels = sampled(grey, chain.middle, chain.axis, along.ravel(), across)
    levels = np.median(levels.reshape(len(middles), -1, len(across)), axis=1)
    before = levels[:, :4].mean(axis=1)
    after = levels[:, -4:].mean(axis=1)
    share = (across - across[0]) / (across[-1] - across[0])
    return levels - before[:, None] * (1 - share) - after[:, None] * share, np.maximum(before, after)


def _n_blocks(chain: Chain) -> int:
    """Return how many blocks a chain has, dark and light, from its first dark one to its last."""
    return round((chain.end - chain.begin) / chain.pitch)


def _by_outline(levels: np.ndarray) -> Iterator[Blocks]:
    grey = levels[..., 0]
    ground = cv2.medianBlur(np.rint(grey).astype(np.uint8), _GROUND).astype(np.float32)
    for contrast in _CONTRASTS:
        differs = (np.abs(ground - grey) > contrast).astype(np.uint8)
        closed = cv2.morphologyEx(differs, cv2.MORPH_CLOSE, np.ones((_CLOSE, _CLOSE), np.uint8))
        outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            found = _bar_in(levels, outline)
            if found is not None:
                bar, n = found
                yield Blocks(bar, min(cv2.minAreaRect(outline)[1]) / 2, n)


def _bar_in(levels: np.ndarray, outline: np.ndarray) -> tuple[Bar, int] | None:
    """Return the bar of blocks whose outline (n, 1, 2) this is, and how many blocks it has, or None."""
    (_, sides, _) = cv2.minAreaRect(outline)
    length = max(sides) + 1
    thickness = min(sides) + 1
    if length < SHORTEST or length < _SLENDER * thickness or thickness < 3:
        return None
    if cv2.contourArea(outline) < _RECTANGLE * (length - 1) * (thickness - 1):
        return None
    along, across, centre, axis = axes_of(outline.reshape(-1, 2).astype(np.float64))
    begin = float(along.min())
    end = float(along.max())
    middle = centre + (across.min() + across.max()) / 2 * np.array([-axis[1], axis[0]])
    places = np.arange(begin - _BEYOND[1] - 4, end + _BEYOND[1] + 4, _STEP)
    half = 0.22 * thickness
    offsets = np.linspace(-half, half, 2 * math.ceil(half) + 1)
    rows = [offsets] if thickness < 12 else [offsets, offsets - thickness / 4, offsets + thickness / 4]
    for each in rows:  # of two rows of blocks, the middle of one
        profile = sampled(levels, middle, axis, places, each).mean(axis=1)
        found = _of_profile(places, profile, (begin, end), middle, axis)
        if found is not None:
            return found
    return None


def _of_profile(
    places: np.ndarray, profile: np.ndarray, rough: tuple[float, float], middle: np.ndarray, axis: np.ndarray
) -> tuple[Bar, int] | None:
    """Return the bar of blocks whose levels along it are a profile, and their number; None if they are not equal.

    Its length is that of the blocks by the changes between them: an outline around them is drawn inside, outside or on
    their edges.
    """
    stored = profile[:, 0]
    ends = [_end(places * side, stored, rough[1] if side > 0 else -rough[0]) for side in (-1, 1)]
    if None in ends:
        return None
    (first, error, width), (last, other_error, other_width) = (end or (0.0, 0.0, 0.0) for end in ends)
    inside = (places > 3 - first) & (places < last - 3)
    dark, light = np.percentile(profile[inside], (5, 95), axis=0)
    if light[0] - dark[0] < _LEAST_CONTRAST or not (light > dark).all():
        return None
    changes = _changes(places[inside], stored[inside] - (dark[0] + light[0]) / 2)
    blocks = np.diff(np.concatenate([[-first], changes, [last]]))
    if len(blocks) < FEWEST or np.abs(blocks / blocks.mean() - 1).max() > max(_EQUAL, 3 / blocks.mean()):
        return None
    reach = min(0.45 * float(blocks.mean()), _AROUND)
    edges = [edge for change in changes if (edge := _edge(places, profile, change, reach)) is not None]
    if len(edges) < len(changes):
        return None
    if len(edges) < 2:
        points = np.array([middle - (first - width) * axis, middle + (last - other_width) * axis])
        length = first + last - width - other_width
        drawn = _OUTLINE * (width + other_width)  # at both ends alike
        shift = OF_SHIFT * edges[0].shift  # that of the dark end, where no outline hides it: the light end is fainter
        return Bar(length, math.hypot(error, other_error, 2 * _CHANGE, drawn, shift), points), len(blocks)
    start, pitch, error = _pitch(edges)
    n = len(blocks)
    points = np.array([middle + start * axis, middle + (start + n * pitch) * axis])
    return Bar(n * pitch, n * error, points), n


def _changes(places: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Return where levels change their sign, (n,)."""
    before = np.flatnonzero(np.sign(levels[1:]) != np.sign(levels[:-1]))
    share = levels[before] / (levels[before] - levels[before + 1])
    return places[before] + share * np.diff(places)[before]


def _edge(places: np.ndarray, profile: np.ndarray, change: float, reach: float) -> Edge | None:
    """Return the edge at a change of levels (n, 2), between the means of the blocks at both sides of it."""
    near = np.abs(places - change) < reach
    levels = profile[near]
    outer = max(len(levels) // 6, 1)
    before, after = levels[:outer].mean(axis=0), levels[-outer:].mean(axis=0)
    if (before == after).any():
        return None
    return edge_of(places[near], (levels - before) / (after - before), 0.0)


def _pitch(edges: Sequence[Edge]) -> tuple[float, float, float]:
    """Return where the first block begins, the length of a block, and its standard error, from the changes between.

    Blur, ink that spreads, and glare move changes from dark to light and those from light to dark to opposite sides.
    With three changes or more, this is fitted too.
    """
    n = len(edges)
    numbers = np.arange(1.0, n + 1)
    terms = [np.ones(n), numbers, (-1.0) ** numbers]
    design = np.stack(terms if n >= 3 else terms[:2], axis=1)
    places = np.array([edge.at for edge in edges])
    solved = np.linalg.lstsq(design, places, rcond=None)[0]
    spread = math.sqrt(float(np.linalg.inv(design.T @ design)[1, 1]))
    free = n - design.shape[1]
    away = places - design @ solved
    stray = widened(_CHANGES + free) * math.sqrt((_CHANGES * _CHANGE**2 + float(away @ away)) / (_CHANGES + free))
    shift = OF_SHIFT * abs(edges[1].shift - edges[0].shift) if n == 2 else 0.0
    return float(solved[0]), float(solved[1]), math.hypot(spread * stray, shift)


def _end(outwards: np.ndarray, profile: np.ndarray, rough: float) -> tuple[float, float, float] | None:
    """Return where a profile first differs from the ground beyond an end, by half of what it does there, and its error.

    What differs first may be an outline, which is thin. Half of its width, which is returned too, is 0 if it is none.
    """
    seen = profile_at(outwards, profile, rough, _BEYOND)
    if seen is None:
        return None
    outwards, profile, beyond = seen
    differs = profile - float(np.median(beyond))
    noise = float(np.std(beyond))
    near = np.flatnonzero((outwards > rough - 8) & (outwards < rough + 4))[::-1]  # inwards
    most = float(np.abs(differs[near]).max())
    first = np.flatnonzero(np.abs(differs[near]) > max(_FIRST * most, 5 * noise))
    if most < _LEAST_CONTRAST or not len(first) or first[0] == 0:
        return None
    inwards = differs[near] * np.sign(differs[near[first[0]]])
    ends = np.flatnonzero(inwards[first[0] :] < 0)  # of an outline, before a block of the other kind
    lobe = inwards[: first[0] + (int(ends[0]) if len(ends) else len(inwards))]
    peak = int(lobe.argmax())
    half = lobe[peak] / 2
    i = int(np.flatnonzero(lobe > half)[0])
    if i == 0:
        return None
    share = (half - lobe[i - 1]) / (lobe[i] - lobe[i - 1])
    at = float(outwards[near[i - 1]]) - float(share) * _STEP
    steep = float(np.gradient(lobe[: peak + 1], _STEP).max()) if peak > 0 else 0.0
    if steep <= 0:
        return None
    width = at - float(outwards[near[peak]]) if len(ends) else 0.0
    return at, noise / steep, width
