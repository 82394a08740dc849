"""Find a printed scale bar: a long, straight and even stroke with sharp ends or arrowheads and a number beside it.

Or a row of equal blocks, dark and light in turn (:mod:`liaam.scale.blocks`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from liaam.errors import LiaamError
from liaam.io.files import some_names
from liaam.scale.bar import SHORTEST, Bar, axes_of, profile_at, sampled
from liaam.scale.blocks import Blocks, find_blocks
from liaam.scale.edges import OF_SHIFT, Edge, edge_of, levels_of
from liaam.scale.numbers import has_number

SLENDER = 5.0
"""Least ratio of a bar's length to its thickness."""

_GROUND = 51  # side of the median filter that gives the ground of strokes; thicker ones are none of ours
_LEAST_CONTRAST = 25.0  # levels of 255
_CONTRASTS = (25.0, 50.0, 80.0, 120.0)  # above which strokes are looked for: of a rough ground, only above its own
_SLICE = 4.0  # pixels along a bar that are taken together
_EVEN = 0.35  # greatest relative difference of the thickness along a bar from its median
_MOST_UNEVEN = 0.15  # share of the length where it may differ more, as by end marks
_STRAIGHT = 0.15  # greatest root mean square distance from a straight line, of the thickness
_LEAST_STRAIGHT = 0.35  # pixels that are allowed in any case
_UNIFORM = 0.15  # greatest standard deviation of the levels inside, of the contrast
_SOFTER = 1.7  # greatest ratio of the steepest slopes at both sides: a shadow is sharp at one only
_BESIDE = (3.0, 7.0)  # pixels beside a stroke, whose level is that of the ground there
_SIDES = 0.5  # least contrast to one side, of that to the other
_BEYOND = (6, 14)  # pixels beyond an end, whose mean is the level of the ground
_SHARP = 8.0  # greatest width of the edge at an end, pixels, between 20 and 80 % of the contrast
_STEP = 0.25  # pixels between samples along a bar
_OF_MARKS = (2.0, 3.0)  # pixels beside a bar where marks across its ends are seen
_SEARCHED = (12.0, 4.0)  # pixels inwards and outwards of an end where its mark is
_OF_INK = 0.4  # least darkness of a mark, of the bar's
_MARKED = 0.1  # least share by which an end mark is darker than the bar, which is blurred more
_OF_MARK = 0.25
"""From the outer edge of an end mark to where the bar is taken to end, of the width of the mark.

Bars are drawn to that edge, or to the middle of the mark, so that the true end lies so far to one side or the other,
and alike at both ends. The standard deviation of two places is half of what is between them."""
_SHARED = 0.06  # standard error of the place of an edge by the shape of pixels and the ground, pixels
_NOT_FOUND = (
    "no even, straight stroke with sharp ends is found that could be a scale bar: crop the image to its bar, or state "
    "its scale (--scale, or a line of a table of scales)"
)
_WITHOUT_NUMBER = (
    "strokes of {} pixels could be a scale bar, but none has a number beside it: if one is the bar, give its length "
    "divided by these pixels with --scale"
)
_UNCLEAR_END = (
    "a bar of blocks of {} pixels is found, but not whether a light block follows its last dark one: give the scale "
    "with --scale, or crop the image to its bar"
)
_MINOR = 0.4  # greatest length of blocks that are no bar beside one of more, of its length
_IN_LINE = 3.0  # greatest distance in pixels of one half of a bar from the line of the other
_MOST_ALIKE = 2  # strokes side by side: one bar that is printed twice
_AROUND = 160  # pixels across a bar, to both sides, where stripes are looked for
_NEAR = 14.0  # and so far at most, of its width
_ALONG = 0.1  # share of a stripe that may be as light as the ground
_AS_DARK = 0.5  # least darkness of a stripe, of the bar's
_WIDTHS = 2.5  # greatest width of a stripe, of the bar's
_OF_COMB = 0.15  # greatest difference of the logarithms of their lengths
_HEAD = 0.5  # greatest share of a bar that its two arrowheads take
_HEAD_WIDER = 1.6  # least width of an arrowhead, of the shaft's
_POINTED = 0.3  # standard error of a tip in pixels: a line around an arrowhead moves it by more than its own width
_TAPER = (0.25, 0.75)  # shares of the width of an arrowhead between which its sides are straight
_SAME = 0.01  # greatest relative difference of the lengths of one bar that is printed twice


def find_bar(image: np.ndarray) -> Bar:
    """Find a printed scale bar, dark or light, in an image.

    Parameters
    ----------
    image : (h, w, 3) or (h, w)
        uint8, uint16 or float32.

    Returns
    -------
    Bar

    Raises
    ------
    LiaamError
        If there is no such bar, or several of different lengths; the message says what to do.
    """
    levels = levels_of(image)
    if levels is None:
        raise LiaamError(_NOT_FOUND)
    strokes = [stroke for sign in (1.0, -1.0) for stroke in _bars_in(sign * levels)]
    blocks, unclear = _of_blocks(find_blocks(levels))
    numbered = [each.bar for each in _without_faint([each for each in strokes if each.has_number])]
    single = _joined(_without_combs(numbered, [each.bar for each in strokes]))
    # Even blocks are less often there by chance than strokes, but short ones are, in a fabric.
    longer = [bar for bar in single if all(_is_far_shorter(each, bar) for each in blocks)]
    bars = [*blocks, *longer]
    for bar in unclear:
        if not any(abs(bar.length / other.length - 1) < _SAME or _is_far_shorter(bar, other) for other in bars):
            raise LiaamError(_UNCLEAR_END.format(f"{bar.length:.1f}"))
    if not bars:
        lengths = sorted({f"{bar.length:.1f}" for bar, *_ in strokes})
        raise LiaamError(_WITHOUT_NUMBER.format(some_names(lengths)) if lengths else _NOT_FOUND)
    bars.sort(key=lambda bar: -bar.length)
    other = next((bar for bar in bars[1:] if abs(bar.length / bars[0].length - 1) > _SAME), None)
    if other is not None:
        both = f"{bars[0].length:.1f} and {other.length:.1f} pixels"
        raise LiaamError(f"several strokes may be the scale bar, of {both}: crop the image to its bar")
    return bars[0]


def _of_blocks(found: Sequence[Blocks]) -> tuple[list[Bar], list[Bar]]:
    """Return the bars of blocks among those that are found, whose ends are clear and whose ends are not.

    A few blocks in line, such as strokes of letters and bar codes, are more often there by chance than many, and short
    ones more often than long ones.
    """
    alone = _without_combs([each.bar for each in found])
    found = [each for each in found if any(each.bar is bar for bar in alone)]
    found = [each for each in found if not any(_is_minor(each, other) for other in found)]
    return [each.bar for each in found if each.is_clear], [each.bar for each in found if not each.is_clear]


class _Stroke(NamedTuple):
    """A stroke that may be a bar."""

    bar: Bar
    has_number: bool
    depth: float  # levels from the ground


def _without_faint(strokes: Sequence[_Stroke]) -> list[_Stroke]:
    """Return strokes without those of less than half the length and half the contrast of another, such as a leg."""
    return [
        each
        for each in strokes
        if not any(2 * each.bar.length < other.bar.length and 2 * each.depth < other.depth for other in strokes)
    ]


def _bars_in(levels: np.ndarray) -> Iterator[_Stroke]:
    """Yield the dark strokes of levels (h, w, 2) that may be bars; negative levels have the light ones."""
    grey = levels[..., 0]
    shifted = grey - float(grey.min())
    ground = cv2.medianBlur(np.rint(shifted).astype(np.uint8), _GROUND).astype(np.float32)
    depth = ground - shifted
    found: list[Bar] = []
    for contrast in _CONTRASTS:
        for bar in _bars_above(levels, depth, contrast):
            if not any(_are_one(bar, other) for other in found):
                found.append(bar)
    for bar in found:
        axis = (bar.ends[1] - bar.ends[0]) / bar.length
        along = np.linspace(-0.4, 0.4, 41) * bar.length
        own = float(np.median(sampled(depth, bar.ends.mean(axis=0), axis, along, np.zeros(1))))
        yield _Stroke(bar, has_number(depth, bar.ends) and not _is_among_stripes(depth, bar), own)


def _without_combs(bars: Sequence[Bar], among: Sequence[Bar] | None = None) -> list[Bar]:
    """Return bars without those that have several alike at their sides, as in a comb, a bar code, or a chessboard."""
    others = bars if among is None else among
    return [bar for bar in bars if sum(_are_side_by_side(bar, other) for other in others) <= _MOST_ALIKE]


def _is_minor(blocks: Blocks, other: Blocks) -> bool:
    """Whether a bar has at most as many blocks as another, and is far shorter."""
    return blocks.n <= other.n and _is_far_shorter(blocks.bar, other.bar)


def _is_far_shorter(bar: Bar, other: Bar) -> bool:
    return bar.length < _MINOR * other.length


def _is_among_stripes(depth: np.ndarray, bar: Bar) -> bool:
    """Whether several lines of a bar's darkness run along it, as beside a tooth of a comb or a line of a bar code.

    Letters are dark in a part of such a line only.
    """
    axis = (bar.ends[1] - bar.ends[0]) / bar.length
    along = np.linspace(-0.25, 0.25, 41) * bar.length
    across = np.arange(-_AROUND, _AROUND + 1.0)
    rows = sampled(depth, bar.ends.mean(axis=0), axis, along, across)
    of_bar = float(rows[:, _AROUND - 1 : _AROUND + 2].mean())
    is_dark = (np.quantile(rows, _ALONG, axis=0) > _AS_DARK * of_bar).astype(int)
    starts, ends = (np.flatnonzero(np.diff(is_dark, prepend=0, append=0) == step) for step in (1, -1))
    width = next((end - start for start, end in zip(starts, ends, strict=True) if start <= _AROUND < end), 0)
    near = (starts < _AROUND + _NEAR * width) & (ends > _AROUND - _NEAR * width)
    return int((near & (ends - starts <= _WIDTHS * width)).sum()) - 1 > _MOST_ALIKE


def _joined(bars: Sequence[Bar]) -> list[Bar]:
    """Return bars, of which two halves in one line, with the number between them, are joined."""
    joined = []
    for bar in bars:
        half = next((other for other in bars if other is not bar and _are_halves(bar, other)), None)
        if half is None:
            joined.append(bar)
            continue
        ends = np.concatenate([bar.ends, half.ends])
        order = np.argsort(ends @ (bar.ends[1] - bar.ends[0]))
        outer = ends[order[[0, -1]]]
        joined.append(Bar(float(np.hypot(*(outer[1] - outer[0]))), math.hypot(bar.length_se, half.length_se), outer))
    return joined


def _are_halves(bar: Bar, other: Bar) -> bool:
    """Whether two strokes of one length are in one line, one after the other."""
    axis = (bar.ends[1] - bar.ends[0]) / bar.length
    away = other.ends - bar.ends.mean(axis=0)
    across = np.abs(away @ np.array([-axis[1], axis[0]]))
    is_apart = bool((np.abs(away @ axis) > 0.5 * bar.length).all())
    return _are_alike(bar, other) and bool((across < _IN_LINE).all()) and is_apart


def _are_alike(bar: Bar, other: Bar) -> bool:
    """Whether two strokes are of one length and direction."""
    return _are_parallel(bar, other) and abs(bar.length / other.length - 1) < 3 * _SAME


def _are_parallel(bar: Bar, other: Bar) -> bool:
    return abs((bar.angle - other.angle + 90) % 180 - 90) < 3


def _are_side_by_side(bar: Bar, other: Bar) -> bool:
    """Whether two strokes are of about one length, one beside the other, as those of a bar code or a comb are."""
    axis = (bar.ends[1] - bar.ends[0]) / bar.length
    away = abs(float((other.ends.mean(axis=0) - bar.ends.mean(axis=0)) @ axis))
    is_alike = abs(math.log(bar.length / other.length)) < _OF_COMB
    return is_alike and _are_parallel(bar, other) and away < 0.5 * bar.length


def _are_one(bar: Bar, other: Bar) -> bool:
    """Whether two bars are the same, found at two contrasts."""
    return bool(np.abs(bar.ends - other.ends).max() < 3)


def _bars_above(levels: np.ndarray, depth: np.ndarray, contrast: float) -> Iterator[Bar]:
    """Yield the bars among the pixels that are darker than the ground by a contrast."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((depth > contrast).astype(np.uint8), connectivity=8)
    height, width = depth.shape
    for label in range(1, len(stats)):
        left, top, across, down, area = stats[label].tolist()
        touches = left == 0 or top == 0 or left + across == width or top + down == height
        if touches or math.hypot(across, down) < SHORTEST or area > SLENDER * _GROUND**2:
            continue
        part = labels[top : top + down, left : left + across] == label
        bar = _bar_of(levels, depth, np.argwhere(part)[:, ::-1] + (left, top))
        if bar is not None:
            yield bar


def _bar_of(levels: np.ndarray, depth: np.ndarray, pixels: np.ndarray) -> Bar | None:
    """Return the bar that some dark pixels (n, 2) are, or None."""
    contrast = float(np.median(depth[pixels[:, 1], pixels[:, 0]]))
    strong = pixels[depth[pixels[:, 1], pixels[:, 0]] > 0.5 * contrast]
    if len(strong) < SHORTEST:
        return None
    along, across, centre, axis = axes_of(strong)
    length = float(np.ptp(along)) + 1
    begin = float(along.min()) - 0.5
    n = int(length / _SLICE)
    slices = np.minimum(((along - begin) / length * n).astype(int), n - 1)
    n_pixels = np.bincount(slices, minlength=n)
    counts = n_pixels * n / length
    thickness = float(np.median(counts))
    if length < SHORTEST or length < SLENDER * thickness or thickness <= 0:
        return None
    uneven = np.abs(counts - thickness) > max(_EVEN * thickness, 1.2)
    is_arrow = _has_heads(counts, thickness)
    middles = np.bincount(slices, across, n) / np.maximum(n_pixels, 1)
    bend = float(np.sqrt(np.mean(np.square(middles[~uneven] - middles[~uneven].mean())))) if (~uneven).any() else np.inf
    if uneven.mean() > (_HEAD if is_arrow else _MOST_UNEVEN) or bend > max(_STRAIGHT * thickness, _LEAST_STRAIGHT):
        return None
    middle = centre + float(middles[~uneven].mean()) * np.array([-axis[1], axis[0]])
    rough = (begin, begin + length)
    if is_arrow:
        return _with_tips(levels[..., 0], middle, axis, rough, float(counts.max()))
    return _with_ends(levels, middle, axis, rough, thickness)


def _has_heads(counts: np.ndarray, thickness: float) -> bool:
    """Whether a stroke with these widths along it has arrowheads: both ends taper from well above its width."""
    half = len(counts) // 2
    for side in (counts[:half], counts[::-1][:half]):
        widest = int(side.argmax())
        is_wide = side[widest] >= max(_HEAD_WIDER * thickness, thickness + 2)
        if not is_wide or widest < 1 or widest > _HEAD * half or (np.diff(side[: widest + 1]) < -1).any():
            return False
    return True


def _with_tips(
    grey: np.ndarray, middle: np.ndarray, axis: np.ndarray, rough: tuple[float, float], width: float
) -> Bar | None:
    """Return a bar between two arrowheads, whose tips are where their straight sides meet."""
    margin = _BEYOND[1] + 2
    along = np.arange(rough[0] - margin, rough[1] + margin, _STEP)
    half = math.ceil(width / 2) + 3
    levels = sampled(grey, middle, axis, along, np.arange(-half, half + 1.0))
    tips = [_tip(along * side, levels, rough[1] if side > 0 else -rough[0]) for side in (-1, 1)]
    if None in tips:
        return None
    (first, error), (last, other_error) = (tip or (0.0, 0.0) for tip in tips)
    ends = np.array([middle - first * axis, middle + last * axis])
    return Bar(first + last, math.hypot(error, other_error, math.sqrt(2) * _SHARED), ends)


def _tip(outwards: np.ndarray, levels: np.ndarray, end: float) -> tuple[float, float] | None:
    """Return where the darkness across an arrowhead, which its sides change in proportion, falls to 0; and the error.

    Blur keeps a straight slope, so that the extrapolation of its middle part is not shortened by it.
    """
    seen = profile_at(outwards, levels, end, _BEYOND)
    if seen is None:
        return None
    outwards, levels, beyond = seen
    darkness = (np.median(beyond) - levels).sum(axis=1)
    inside = (outwards < end + 4) & (outwards > end - 6 * levels.shape[1])
    widest = int(np.where(inside, darkness, -np.inf).argmax())
    slope = np.arange(widest, len(outwards))
    shares = darkness[slope] / darkness[widest]
    low = np.flatnonzero(shares < _TAPER[0])
    if not len(low) or darkness[widest] <= 0:
        return None
    used = slope[: low[0]][shares[: low[0]] < _TAPER[1]]
    if len(used) < 3 / _STEP:
        return None
    (steepness, start), scatter = np.polyfit(outwards[used], darkness[used], 1, cov=True)
    if steepness >= 0:
        return None
    tip = -start / steepness
    stray = float(np.std(darkness[used] - start - steepness * outwards[used]))
    error = math.hypot(
        stray / abs(steepness), math.sqrt(max(scatter[0, 0], 0.0)) / abs(steepness) * (tip - outwards[used].mean())
    )
    return (float(tip), math.hypot(float(error), _POINTED)) if abs(tip - end) < _SHARP else None


def _with_ends(
    levels: np.ndarray, middle: np.ndarray, axis: np.ndarray, rough: tuple[float, float], thickness: float
) -> Bar | None:
    """Return a bar whose ends lie where its level is half that of the ground beyond; None if they are not sharp."""
    margin = _BEYOND[1] + 2
    along = np.arange(rough[0] - margin, rough[1] + margin, _STEP)
    half = max(0.3 * thickness, 0.5)
    across = np.linspace(-half, half, 2 * math.ceil(half) + 1)
    profile = sampled(levels, middle, axis, along, across).mean(axis=1)
    pixels = sampled(levels, middle, axis, along, across, is_linear=True).mean(axis=1)
    inside = profile[(along > rough[0] + 4) & (along < rough[1] - 4)]
    if len(inside) < SHORTEST:
        return None
    level = np.median(inside, axis=0)
    beside = (thickness / 2 + np.array([_OF_MARKS])).T * np.array([-1.0, 1.0])
    marks = sampled(levels[..., 0], middle, axis, along, beside.ravel()).mean(axis=1)
    ends = [_end(along * side, profile, level, rough[1] if side > 0 else -rough[0], marks, pixels) for side in (-1, 1)]
    if None in ends:
        return None
    none = (Edge(0.0, 0.0, 0.0, 0.0), 0.0, 0.0)
    (first, ground, mark), (last, other_ground, other_mark) = (end or none for end in ends)
    contrast = min(ground, other_ground) - float(level[0])
    if contrast < _LEAST_CONTRAST or float(inside[:, 0].std()) > _UNIFORM * contrast:
        return None
    if first.at + last.at < SHORTEST or _is_shadow(levels[..., 0], middle, axis, rough, thickness):
        return None
    points = np.array([middle - first.at * axis, middle + last.at * axis])
    # Both of these make the bar longer at both ends, or shorter, but do not depend on each other.
    shift = OF_SHIFT * (first.shift + last.shift)
    drawn = _OF_MARK * (mark + other_mark)
    return Bar(first.at + last.at, math.hypot(first.error, last.error, math.sqrt(2) * _SHARED, shift, drawn), points)


def _width_of_mark(outwards: np.ndarray, levels: np.ndarray, end: float, ink: float) -> float:
    """Return the width of the mark across an end, of the level of the ink, by the levels beside the bar; 0 if none."""
    ground = float(np.median(levels))
    darkness = np.where((outwards > end - _SEARCHED[0]) & (outwards < end + _SEARCHED[1]), ground - levels, 0.0)
    if ground <= ink or darkness.max() < _OF_INK * (ground - ink):
        return 0.0
    near = np.abs(outwards - outwards[darkness.argmax()]) < _SEARCHED[0] / 2
    # Blur makes the mark wider and lighter, and does not change the sum.
    return float(np.maximum(darkness, 0)[near].sum()) * _STEP / (ground - ink)


def _is_shadow(
    grey: np.ndarray, middle: np.ndarray, axis: np.ndarray, rough: tuple[float, float], thickness: float
) -> bool:
    """Whether a stroke is the shadow along a label: the ground is much darker at one side, or one side is softer."""
    along = np.arange(rough[0] + 4, rough[1] - 4)
    reach = thickness / 2 + _BESIDE[1]
    across = np.arange(-reach, reach + _STEP, _STEP)
    levels = np.median(sampled(grey, middle, axis, along, across), axis=0)
    beside = np.abs(across) > reach - (_BESIDE[1] - _BESIDE[0])
    stroke = float(levels[len(across) // 2])
    darker, lighter = sorted(float(levels[beside & (way * across > 0)].mean()) - stroke for way in (-1, 1))
    slopes = np.gradient(levels, _STEP)
    softer, sharper = sorted(float((way * slopes[way * across > 0]).max()) for way in (-1, 1))
    return darker < _SIDES * lighter or sharper > _SOFTER * softer


def _end(
    outwards: np.ndarray, profile: np.ndarray, level: np.ndarray, end: float, marks: np.ndarray, pixels: np.ndarray
) -> tuple[Edge, float, float] | None:
    """Return where a bar ends by its profile (n, 2), outwards from the middle, the ground, and the width of its mark.

    The profile crosses half its height there. An end mark is seen beside the bar, whose levels (n,) are given, too; it
    may be darker than the bar, by levels that are not interpolated beyond those of pixels (n, 2).
    """
    mark = _width_of_mark(outwards, marks, end, float(level[0]))
    darkest = pixels[(outwards > end - 6) & (outwards < end)].min(axis=0, initial=np.inf)
    seen = profile_at(outwards, profile, end, _BEYOND)
    if seen is None:
        return None
    outwards, profile, beyond = seen
    ground = np.median(beyond, axis=0)
    near = np.flatnonzero((outwards > end - 6) & (outwards < end + 6))
    if ground[0] - level[0] < _LEAST_CONTRAST or (ground <= level).any() or not len(near):
        return None
    is_mark = bool(level[0] - darkest[0] > _MARKED * (ground[0] - level[0]))
    level = np.minimum(darkest, level) if is_mark else level
    shares = (profile[near] - level) / (ground - level)
    edge = edge_of(outwards[near], shares, float(np.std(beyond[:, 0])) / float(ground[0] - level[0]))
    if edge is None or edge.width >= _SHARP:
        return None
    width = 2 * (edge.at - float(outwards[near][shares[:, 0].argmin()])) if is_mark and not mark else mark
    return edge._replace(at=edge.at - _OF_MARK * width), float(ground[0]), width
