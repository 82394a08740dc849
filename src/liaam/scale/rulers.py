"""Find a ruler in an image, and refuse what may be none.

Tiles with ticks propose where a ruler may be (:mod:`liaam.scale.proposals`), and each tick is measured there
(:mod:`liaam.scale.ticks`). Where some ticks are longer at regular steps (:mod:`liaam.scale.hierarchy`), only these are
taken for rulers: combs, fabrics, threads of screws and graph paper have no such ticks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from liaam.errors import LiaamError
from liaam.scale.hierarchy import are_teeth, expected, goes_on, has_halves, heaviest_lines, longest_ticks, may_be
from liaam.scale.lengths import Length
from liaam.scale.proposals import AGREE, MOST_TILES, REACH, Proposal, find_proposals
from liaam.scale.strips import find_strips
from liaam.scale.ticks import (
    DIVISORS,
    FEWEST_TICKS,
    SHORTEST,
    Ruler,
    aligned,
    band_along,
    finest_ruler,
    measured_ruler,
    refined_ruler,
    smooth,
)

FEWEST_ALIKE = 15
"""Least number of ticks that are all of one length."""

LARGEST = 2000
"""Longer side in pixels to which larger images are reduced. The millimetres of a ruler of 20 cm are then 10 pixels."""

_OUTSTANDING = 4.0  # least ratio of the power of a harmonic to that of those beside it
_ZOOMS = (1.0, 0.5, 0.25)  # to which an image is reduced in turn, until a ruler is found: for long periods and ticks
_SHORT = 0.25  # length of a second ruler, of the longer one's, below which it is taken for a texture, such as a QR code
_SAME = 0.02  # greatest relative difference of periods of one ruler
_CROSSED = 5.0  # greatest difference from a right angle, degrees, of lines that cross
_MOST_LEVEL = 1e9  # of an image
_NOT_FOUND = (
    f"no ruler with {FEWEST_TICKS} even ticks or more is found: crop the image to its ruler, or state its scale "
    "(--scale, or a line of a table of scales)"
)
_WITHOUT_HEAVY = (
    "lines are found every {:.4g} pixels, but not every {}th is heavier, as on graph paper of {}: crop the image to "
    "its ruler, or state its scale (--scale, or a line of a table of scales)"
)


def find_ruler(image: np.ndarray, tick: Length | None = None) -> Ruler:
    """Find the ticks of a ruler in an image.

    Parameters
    ----------
    image : (h, w, 3) or (h, w)
        Of any type of number.
    tick : Length, optional
        From one smallest tick to the next, which tells the sides of a ruler apart: every fifth or tenth millimetre is
        longer, and half and quarter inches are.

    Returns
    -------
    Ruler

    Raises
    ------
    LiaamError
        If there is no ruler, or two of different periods, or its longer ticks are not those of the length that is
        given; the message says what to do.
    """
    grey, factor = _reduced(_grey(image))
    wanted = expected(tick)
    found: list[Ruler] = []
    for zoom in _ZOOMS:
        for ruler in _rulers_in(grey, zoom):
            if not any(_are_one(ruler, other) for other in found):
                found.append(replace(ruler, longest=longest_ticks(grey, ruler.ends, ruler.n_ticks, wanted)))
        is_found = any(ruler.longest and may_be(ruler.longest, wanted) for ruler in found)
        if is_found and not (zoom == 1 and _is_tenth(tick)):
            break
    else:
        found.extend(_along_edges(grey, found, wanted))
    found = [_enlarged(ruler, 1 / factor) for ruler in found]
    marked = [ruler for ruler in found if ruler.longest]
    if marked:
        return _only(_of_kind([_with_halves(grey, factor, ruler, tick) for ruler in marked], tick))
    alike = _only([ruler for ruler in found if ruler.n_ticks >= FEWEST_ALIKE])
    if are_teeth(grey, _enlarged(alike, factor).ends, alike.n_ticks):
        raise LiaamError(_NOT_FOUND)
    rows = [ruler for ruler in found if abs(ruler.period / alike.period - 1) < _SAME]
    if wanted and _are_lines(grey, [_enlarged(row, factor) for row in rows], wanted):
        raise LiaamError(_WITHOUT_HEAVY.format(alike.period, wanted, tick))
    return alike


def _along_edges(grey: np.ndarray, found: Sequence[Ruler], wanted: int) -> list[Ruler]:
    """Return further rulers along straight edges, whose longer ticks are as expected."""
    further: list[Ruler] = []
    for strip in find_strips(grey)[:MOST_TILES]:
        proposal = Proposal(strip.centre, strip.angle, strip.period)
        if any(_is_on(proposal, ruler) for ruler in (*found, *further)):
            continue
        ruler = refined_ruler(grey, proposal)
        longest = longest_ticks(grey, ruler.ends, ruler.n_ticks, wanted) if ruler is not None else 0
        if ruler is not None and longest and may_be(longest, wanted):
            further.append(replace(ruler, longest=longest))
    return further


def _with_halves(grey: np.ndarray, factor: float, ruler: Ruler, tick: Length | None) -> Ruler:
    """Return a ruler with the ticks between its ticks, if the longest should be twice as many ticks apart."""
    wanted = expected(tick)
    small = _enlarged(ruler, factor)
    is_half = wanted == 2 * ruler.longest and small.period >= 2 * SHORTEST
    if not is_half or not has_halves(grey, small.ends, ruler.n_ticks):
        return ruler
    halves = {"period": ruler.period / 2, "period_se": ruler.period_se / 2}
    return replace(ruler, **halves, n_ticks=2 * ruler.n_ticks - 1, longest=wanted)


def _are_lines(grey: np.ndarray, rows: Sequence[Ruler], wanted: int) -> bool:
    """Whether rows of one period are lines of a fabric or a grid, of which those so far apart are no heavier.

    Lines go on at both sides of a row, or cross others of the same period. On graph paper, every fifth or tenth is
    heavier.
    """
    is_crossed = any(abs(abs(row.angle - rows[0].angle) - 90) < _CROSSED for row in rows)
    if not is_crossed and not any(goes_on(grey, row.ends, row.n_ticks) for row in rows):
        return False
    heaviest = [heaviest_lines(grey, row.ends, row.n_ticks) for row in rows]
    return not any(each and may_be(each, wanted) for each in heaviest)


def _of_kind(rulers: Sequence[Ruler], tick: Length | None) -> list[Ruler]:
    """Return the rulers whose longest ticks are those of the length from tick to tick."""
    wanted = expected(tick)
    fitting = [ruler for ruler in rulers if may_be(ruler.longest, wanted)]
    if wanted == 10:
        inches = [ruler for ruler in fitting if any(_is_of_inches(ruler, other) for other in fitting)]
        fitting = [ruler for ruler in fitting if (ruler in inches) == _is_tenth(tick)] if inches else fitting
    if fitting:
        return fitting
    best = max(rulers, key=_length)
    raise LiaamError(
        f"ticks are found every {best.period:.4g} pixels, of which every {best.longest}th is the longest, and not "
        f"every {wanted}th as where ticks are {tick} apart: give the length from one smallest tick to the next, or "
        "crop the image to the ruler; ticks of less than 4 pixels are not resolved"
    )


def _is_tenth(tick: Length | None) -> bool:
    """Whether ticks are tenths of an inch, or of a tenth, which have longer ones as those of millimetres have."""
    return tick is not None and bool(tick.unit) and expected(tick) == 10 and not _is_whole(tick.within("mm").value)


def _is_whole(value: float) -> bool:
    """Whether a length is a power of ten."""
    power = math.log10(value)
    return abs(power - round(power)) < 1e-3


def _is_of_inches(ruler: Ruler, other: Ruler) -> bool:
    """Whether ticks are as far from each other as tenths of inches, and others as millimetres."""
    return abs(ruler.period / (2.54 * other.period) - 1) < _SAME / 2


def _only(rulers: Sequence[Ruler]) -> Ruler:
    """Return the longest of some rulers, of which the others may be parts; refuse if they are of different periods."""
    rulers = [ruler for ruler in rulers if not any(_is_finer(other, ruler) for other in rulers)]
    if not rulers:
        raise LiaamError(_NOT_FOUND)
    best = max(rulers, key=_length)
    long = [each for each in rulers if _length(each) > _SHORT * _length(best)]
    other = next((each for each in long if abs(each.period / best.period - 1) > _SAME), None)
    if other is not None:
        both = f"{best.period:.4g} and {other.period:.4g} pixels"
        raise LiaamError(f"two rulers, or two sides of one, have ticks every {both}: crop the image to one of them")
    return best


def _is_finer(ruler: Ruler, other: Ruler) -> bool:
    """Whether a ruler has ticks at a whole fraction of the period of a parallel one, as the other side of one ruler."""
    times = round(other.period / ruler.period)
    is_parallel = abs((ruler.angle - other.angle + 90) % 180 - 90) < 3
    return times > 1 and is_parallel and abs(other.period / (times * ruler.period) - 1) < _SAME / 2


def _length(ruler: Ruler) -> float:
    return ruler.n_ticks * ruler.period


def _rulers_in(grey: np.ndarray, zoom: float) -> list[Ruler]:
    """Return the rulers that are found in an image when it is reduced."""
    small = _shrunk(grey, zoom)
    found: list[Ruler] = []
    proposals = find_proposals(small)
    for proposal in proposals:
        if any(_is_on(proposal, ruler) for ruler in found):
            continue
        ruler = refined_ruler(small, proposal) or _of_grid(small, proposal, proposals)
        if ruler is not None and not any(_are_one(ruler, other) for other in found):
            found.append(ruler)
    return [finest for ruler in found if (finest := _finest(grey, _enlarged(ruler, 1 / zoom), zoom)) is not None]


def _enlarged(ruler: Ruler, times: float) -> Ruler:
    """Return a ruler as it is in an image that is so many times as large."""
    ends = (ruler.ends + 0.5) * times - 0.5
    return replace(ruler, period=ruler.period * times, period_se=ruler.period_se * times, ends=ends)


def _finest(grey: np.ndarray, ruler: Ruler, zoom: float) -> Ruler | None:
    """Return a ruler that was found in a reduced image; None if the image has ticks between its ticks."""
    if zoom == 1:
        return ruler
    centre = ruler.ends.mean(axis=0)
    angle = math.radians(ruler.angle)
    band = band_along(grey, centre, angle, REACH)
    half = float(np.hypot(*(ruler.ends[1] - ruler.ends[0]))) / 2
    middle = band.shape[1] // 2
    part = band[:, max(middle - int(half), 0) : middle + int(half) + 1]
    finer = [Proposal(centre, angle, ruler.period / divisor) for divisor in DIVISORS]
    is_measured = any(each.period >= SHORTEST and measured_ruler(band, each, is_endless=True) for each in finer)
    return None if is_measured or any(_stands_out(part, ruler.period, n) for n in DIVISORS) else ruler


def _stands_out(band: np.ndarray, period: float, n: int) -> bool:
    """Whether the n-th harmonic of a period is clearly above those beside it, as by fainter ticks in n-ths of it."""
    flat = (band - smooth(band, 1.5 * period)) * np.hanning(band.shape[1])
    harmonics = np.array([n - 1, n, n + 1]) / period
    waves = np.exp(-2j * np.pi * harmonics[:, None] * np.arange(band.shape[1]))
    below, own, above = (np.abs(flat @ waves.T) ** 2).mean(axis=0).tolist()
    return n / period <= 0.5 and own > _OUTSTANDING * max(below, above)


def _of_grid(grey: np.ndarray, proposal: Proposal, proposals: Sequence[Proposal]) -> Ruler | None:
    """Return the lines of graph paper at a proposal; None if no other is of the same period across its direction."""
    if not any(_cross(proposal, other) for other in proposals):
        return None
    lines = aligned(grey, proposal)
    if lines is None:
        return None
    return finest_ruler(band_along(grey, lines.centre, lines.angle, REACH), lines, is_endless=True)


def _cross(proposal: Proposal, other: Proposal) -> bool:
    """Whether two proposals are of one period, and of directions across each other."""
    turn = (proposal.angle - other.angle) % math.pi - math.pi / 2
    return abs(math.log(proposal.period / other.period)) < AGREE and abs(turn) < AGREE


def _shrunk(grey: np.ndarray, factor: float) -> np.ndarray:
    """Return an image reduced by exactly a factor: sizes that are rounded would change periods by up to 0.1 %."""
    if factor == 1:
        return grey
    blurred = cv2.GaussianBlur(grey, (0, 0), 0.5 * math.sqrt(factor**-2 - 1))
    shift = 0.5 * factor - 0.5
    matrix = np.array([[factor, 0.0, shift], [0.0, factor, shift]])
    size = (int(grey.shape[1] * factor), int(grey.shape[0] * factor))
    return cv2.warpAffine(blurred, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def _reduced(grey: np.ndarray) -> tuple[np.ndarray, float]:
    """Return an image whose longer side has at most `LARGEST` pixels, and by which factor it is reduced."""
    factor = min(1.0, LARGEST / max(grey.shape))
    return _shrunk(grey, factor), factor


def _grey(image: np.ndarray) -> np.ndarray:
    """Return an image as (h, w) float32, of mean 0 and standard deviation 1; what is not a usual number is 0."""
    grey = np.asarray(image, np.float64)
    grey = grey.mean(axis=2) if grey.ndim == 3 else grey
    grey = np.where(np.abs(grey) < _MOST_LEVEL, grey, 0.0)
    spread = float(grey.std()) if grey.size else 0.0
    if spread == 0:
        raise LiaamError(_NOT_FOUND)
    return ((grey - grey.mean()) / spread).astype(np.float32)


def _is_on(proposal: Proposal, ruler: Ruler) -> bool:
    """Whether a proposal is on a ruler that is found, with its direction and its period or a multiple of that."""
    times = max(round(proposal.period / ruler.period), 1)
    away = abs((math.degrees(proposal.angle) - ruler.angle + 90) % 180 - 90)
    if away > 3 or abs(proposal.period / (times * ruler.period) - 1) > 2 * _SAME:
        return False
    return _is_beside(proposal.centre, ruler)


def _is_beside(point: np.ndarray, ruler: Ruler) -> bool:
    """Whether a point is near the line through the ticks of a ruler."""
    along = ruler.ends[1] - ruler.ends[0]
    away = point - ruler.ends.mean(axis=0)
    return abs(away[0] * along[1] - away[1] * along[0]) < REACH * np.hypot(*along)


def _are_one(ruler: Ruler, other: Ruler) -> bool:
    """Whether two rulers are the same: of one period and direction, and on one line."""
    if abs(ruler.period / other.period - 1) > _SAME or abs((ruler.angle - other.angle + 90) % 180 - 90) > 3:
        return False
    return _is_beside(ruler.ends.mean(axis=0), other)
