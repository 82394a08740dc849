"""Find scale bars of equal blocks, dark and light in turn, with an outline or without."""

from __future__ import annotations

import math

import cv2
import numpy as np

from liaam.scale.bar import SHORTEST, Bar, axes_of, profile_at, sampled

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


def find_blocks(grey: np.ndarray) -> list[Bar]:
    """Find bars of blocks in an image (h, w) of levels from 0 to 255."""
    ground = cv2.medianBlur(np.rint(grey).astype(np.uint8), _GROUND).astype(np.float32)
    found: list[Bar] = []
    for contrast in _CONTRASTS:
        differs = (np.abs(ground - grey) > contrast).astype(np.uint8)
        closed = cv2.morphologyEx(differs, cv2.MORPH_CLOSE, np.ones((_CLOSE, _CLOSE), np.uint8))
        outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            bar = _bar_in(grey, outline)
            if bar is not None and not any(np.abs(bar.ends - other.ends).max() < 3 for other in found):
                found.append(bar)
    return found


def _bar_in(grey: np.ndarray, outline: np.ndarray) -> Bar | None:
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
        profile = sampled(grey, middle, axis, places, each).mean(axis=1)
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
    ends = [_end(places * side, profile, rough[1] if side > 0 else -rough[0]) for side in (-1, 1)]
    if None in ends:
        return None
    (first, error), (last, other_error) = (end or (0.0, 0.0) for end in ends)
    inside = (places > 3 - first) & (places < last - 3)
    dark = float(np.percentile(profile[inside], 5))
    light = float(np.percentile(profile[inside], 95))
    if light - dark < _LEAST_CONTRAST:
        return None
    changes = _changes(places[inside], profile[inside] - (dark + light) / 2)
    blocks = np.diff(np.concatenate([[-first], changes, [last]]))
    if len(blocks) < FEWEST or np.abs(blocks / blocks.mean() - 1).max() > max(_EQUAL, 3 / blocks.mean()):
        return None
    if len(changes) < 2:
        return Bar(
            first + last, math.hypot(error, other_error), np.array([middle - first * axis, middle + last * axis])
        )
    n = len(blocks)
    numbers = np.arange(1, n)
    pitch, start = np.polyfit(numbers, changes, 1)
    spread = math.sqrt(float(np.square(numbers - numbers.mean()).sum()))
    points = np.array([middle + start * axis, middle + (start + n * pitch) * axis])
    return Bar(float(n * pitch), n * _CHANGE / spread, points)


def _changes(places: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Return where levels change their sign, (n,)."""
    before = np.flatnonzero(np.sign(levels[1:]) != np.sign(levels[:-1]))
    share = levels[before] / (levels[before] - levels[before + 1])
    return places[before] + share * np.diff(places)[before]


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
