"""Find scale bars of equal blocks, dark and light in turn, with an outline or without.

They are looked for in two ways: by the outline of all blocks, which differ from the ground; and by their dark blocks
alone (:mod:`liaam.scale.chains`), as light blocks may be of the colour of the card that they are printed on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from liaam.scale.bar import SHORTEST, Bar, axes_of, profile_at, sampled
from liaam.scale.chains import Chain, find_chains
from liaam.scale.edges import OF_SHIFT, Edge, edge_of

FEWEST = 2
"""Least number of blocks."""

_CONTRASTS = (25.0, 50.0, 90.0)  # levels of 255 from the ground, above and below, of what is looked at
_GROUND = 51  # side of the median filter that gives the ground; thicker bars are not found
_CLOSE = 5  # pixels that are closed: blur leaves a gap between a dark and a light block
_SLENDER = 4.0  # least ratio of the length to the thickness
_RECTANGLE = 0.85  # least share of its rectangle that a bar fills
_STEP = 0.25  # pixels between samples along a bar
_EQUAL = 0.08  # greatest relative difference of a block's length from the mean
_BEYOND = (4, 12)  # pixels beyond an end, whose median is the level of the ground
_LEAST_CONTRAST = 25.0  # between dark and light blocks
_FIRST = 0.2  # least share of the contrast by which an outline differs from the ground
_OUTLINE = 0.5  # standard error of an end, of half the width of its outline, which the blur widens
_CHANGE = 0.12  # standard error of the place of a change from one block to the next, pixels
_AROUND = 10.0  # greatest distance from a change that is looked at, pixels
_LEVEL = 0.35  # greatest difference of the level of a block from the others of its kind, of the contrast
_STEP_OUT = 0.04  # least step from a light block at an end to the ground, or to its outline, of the contrast
_MOST = 60  # further blocks at either end of those that were seen
_NOISE = 4.0  # and the least in levels, above the noise of a mean
_OFF = 0.2  # greatest distance of such a step from the side of a block, of its length or half its thickness


def find_blocks(levels: np.ndarray) -> list[tuple[Bar, float]]:
    """Find bars of blocks, and half their thickness, in an image (h, w, 2) of levels, stored and in linear light."""
    found = [*_by_dark_blocks(levels), *_by_outline(levels)]
    found.sort(key=lambda each: -each[0].length)
    kept: list[tuple[Bar, float]] = []
    for bar, half in found:
        if not any(is_part(bar, whole, other + half) for whole, other in kept):
            kept.append((bar, half))
    return kept


def is_part(bar: Bar, whole: Bar, reach: float) -> bool:
    """Whether a bar lies along another, at most so far from its middle line and its ends."""
    axis = (whole.ends[1] - whole.ends[0]) / whole.length
    away = bar.ends - whole.ends[0]
    along = away @ axis
    across = away @ np.array([-axis[1], axis[0]])
    return bool((np.abs(across) < reach).all() and (along > -reach).all() and (along < whole.length + reach).all())


def _by_dark_blocks(levels: np.ndarray) -> Iterator[tuple[Bar, float]]:
    for part in find_chains(levels[..., 0]):
        chain = _whole(levels[..., 0], part)
        bar = _of_chain(levels, chain)
        if bar is not None:
            yield bar, chain.rows * chain.thickness / 2


def _whole(grey: np.ndarray, chain: Chain) -> Chain:
    """Return a chain of one row with the further blocks that go on in its steps, some of which may not have been seen.

    A further dark block has light beside it, across the chain, as the ground beyond a card has not.
    """
    if chain.rows > 1:
        return chain
    n = round((chain.end - chain.begin) / chain.pitch)
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


def _of_chain(levels: np.ndarray, chain: Chain) -> Bar | None:
    """Return the bar whose dark blocks make a chain, or None. At its ends may be light blocks, which are looked for."""
    places, profile = chain.profile(levels, 2 * chain.pitch)
    n = round((chain.end - chain.begin) / chain.pitch)
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
    if chain.rows == 1:
        kinds = (float(dark[0]), float(light[0]))
        before, after = (_goes_on(levels[..., 0], chain, side, kinds) for side in (-1, 1))
        n += before + after
        begin -= before * chain.pitch
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
    return Bar(n * pitch, n * error, points)


def _level(places: np.ndarray, profile: np.ndarray, middle: float, half: float) -> np.ndarray:
    """Return the median level within so many pixels of a place."""
    return np.median(profile[np.abs(places - middle) <= max(half, places[1] - places[0])], axis=0)


def _goes_on(grey: np.ndarray, chain: Chain, side: int, kinds: tuple[float, float]) -> bool:
    """Whether a light block follows the last dark one: of the level of the others, up to edges or lines at its sides.

    The card that dark blocks are printed on goes on beyond the sides that a block would have.
    """
    dark, light = kinds
    last = chain.end if side > 0 else -chain.begin
    half = chain.thickness / 2
    pitch = chain.pitch
    within = np.linspace(-0.4 * half, 0.4 * half, 5)
    inner = last + np.linspace(0.3, 0.7, 9) * pitch
    margin = np.arange(0, 1.4 * pitch, _STEP)
    rim = np.arange(0, 1.4 * half + 4, _STEP)
    ahead = sampled(grey, chain.middle, chain.axis, side * (last + margin), within).mean(axis=1)
    up, down = (sampled(grey, chain.middle, chain.axis, side * inner, way * rim).mean(axis=0) for way in (-1, 1))
    block = float(np.median(ahead[(margin > 0.3 * pitch) & (margin < 0.7 * pitch)]))
    if abs(block - light) > _LEVEL * (light - dark):
        return False
    least = max(_STEP_OUT * (light - dark), _NOISE)
    ends = [_left(each, block, least, 0.3 * to) for each, to in ((ahead, pitch), (up, half), (down, half))]
    if None in ends:
        return False
    return all(abs((end or 0.0) - to) < max(_OFF * to, 3.0) for end, to in zip(ends, (pitch, half, half), strict=True))


def _left(profile: np.ndarray, level: float, least: float, after: float) -> float | None:
    """Return where a profile first differs from a level, after a place, in pixels; None if nowhere."""
    places = np.arange(len(profile)) * _STEP
    differs = np.flatnonzero((np.abs(profile - level) > least) & (places > after))
    return float(places[differs[0]]) if len(differs) else None


def _by_outline(levels: np.ndarray) -> Iterator[tuple[Bar, float]]:
    grey = levels[..., 0]
    ground = cv2.medianBlur(np.rint(grey).astype(np.uint8), _GROUND).astype(np.float32)
    for contrast in _CONTRASTS:
        differs = (np.abs(ground - grey) > contrast).astype(np.uint8)
        closed = cv2.morphologyEx(differs, cv2.MORPH_CLOSE, np.ones((_CLOSE, _CLOSE), np.uint8))
        outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            bar = _bar_in(levels, outline)
            if bar is not None:
                yield bar, min(cv2.minAreaRect(outline)[1]) / 2


def _bar_in(levels: np.ndarray, outline: np.ndarray) -> Bar | None:
    """Return the bar of blocks whose outline (n, 1, 2) this is, or None."""
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
        bar = _of_profile(places, profile, (begin, end), middle, axis)
        if bar is not None:
            return bar
    return None


def _of_profile(
    places: np.ndarray, profile: np.ndarray, rough: tuple[float, float], middle: np.ndarray, axis: np.ndarray
) -> Bar | None:
    """Return the bar of blocks whose levels along it are a profile; None if the blocks are not equal.

    Its length is that of the blocks by the changes between them: an outline around them is drawn inside, outside or on
    their edges.
    """
    stored = profile[:, 0]
    ends = [_end(places * side, stored, rough[1] if side > 0 else -rough[0]) for side in (-1, 1)]
    if None in ends:
        return None
    (first, error), (last, other_error) = (end or (0.0, 0.0) for end in ends)
    inside = (places > 3 - first) & (places < last - 3)
    dark, light = np.percentile(profile[inside], (5, 95), axis=0)
    if light[0] - dark[0] < _LEAST_CONTRAST or not (light > dark).all():
        return None
    changes = _changes(places[inside], stored[inside] - (dark[0] + light[0]) / 2)
    blocks = np.diff(np.concatenate([[-first], changes, [last]]))
    if len(blocks) < FEWEST or np.abs(blocks / blocks.mean() - 1).max() > max(_EQUAL, 3 / blocks.mean()):
        return None
    if len(changes) < 2:
        return Bar(
            first + last, math.hypot(error, other_error), np.array([middle - first * axis, middle + last * axis])
        )
    reach = min(0.45 * float(blocks.mean()), _AROUND)
    edges = [_edge(places, profile, change, reach) for change in changes]
    if None in edges:
        return None
    start, pitch, error = _pitch([edge for edge in edges if edge])
    n = len(blocks)
    points = np.array([middle + start * axis, middle + (start + n * pitch) * axis])
    return Bar(n * pitch, n * error, points)


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
    stray = math.sqrt(float(away @ away) / free) if free > 1 else 0.0
    shift = OF_SHIFT * abs(edges[1].shift - edges[0].shift) if n == 2 else 0.0
    return float(solved[0]), float(solved[1]), math.hypot(spread * max(stray, _CHANGE), shift)


def _end(outwards: np.ndarray, profile: np.ndarray, rough: float) -> tuple[float, float] | None:
    """Return where a profile first differs from the ground beyond an end, by half of what it does there; and the error.

    What differs first may be an outline, which is thin.
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
    return at, math.hypot(noise / steep, _OUTLINE * width)
