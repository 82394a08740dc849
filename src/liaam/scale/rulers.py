"""Find the ticks of a ruler: by their period in the spectra of tiles, then one by one along the ruler.

The spectrum of a tile with ticks has its power on a ray across the ticks, at the multiples of one frequency. Such tiles
propose a direction and a period; around them the image is resampled along the ruler, its tilt and period are refined by
the phase of the period, and each tick is measured. What does not look like a ruler in every step is refused. Where
some ticks are longer at regular steps (:mod:`liaam.scale.hierarchy`), only these are taken for rulers: combs, fabrics,
threads of screws and graph paper have no such ticks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import short_repr
from liaam.scale.hierarchy import are_teeth, expected, goes_on, has_halves, heaviest_lines, longest_ticks, may_be
from liaam.scale.lengths import Length, widened
from liaam.scale.strips import find_strips

TILES = (96, 192, 384)
"""Sides of tiles in pixels. The longest period that is found is a sixth of the largest, the shortest 4 pixels."""

SHORTEST = 4.0
"""Shortest period in pixels; ticks of less are not resolved."""

FEWEST_TICKS = 10
"""Least number of ticks in turn. Textures rarely repeat that often."""

FEWEST_ALIKE = 15
"""Least number of ticks that are all of one length."""

LARGEST = 2000
"""Longer side in pixels to which larger images are reduced. The millimetres of a ruler of 20 cm are then 10 pixels."""

_OUTSTANDING = 4.0  # least ratio of the power of a harmonic to that of those beside it
_ZOOMS = (1.0, 0.5, 0.25)  # to which an image is reduced in turn, until a ruler is found: for long periods and ticks
_CYCLES = (6, 24)  # fewest and most periods in a tile
_ANGLES = 180  # directions that are looked at, of 180 degrees
_HARMONICS = 3  # of the period whose power is summed
_CONTRAST = 2.2  # least mean logarithm of the power at harmonics over that between them
_OF_TILE = 2  # proposals of a tile
_APART = 0.1  # least difference of their directions, radians
_MOST_TILES = 32  # proposals that are refined
_MOST_ALIKE = 3  # of them on one line
_MOST_OF_KIND = 4  # of them of one period and direction, as those of a fabric or graph paper below a ruler
_AGREE = 0.08  # greatest difference of the logarithms of periods, and of directions in radians, of proposals in line
_REACH = 40  # pixels across the ruler that are looked at, to both sides
_COHERENT = 0.33  # least share of the variation that has the period, of 0.5 for a sine and less for thin ticks
_LONG = 3.0  # least ratio of the length of a ruler to that of its ticks
_PRESENT = 0.35  # least strength of a tick, of the stronger ones
_MOST_LACKING = 0.1  # greatest share of ticks that are not there
_MOST_TURNS = 8  # times that the direction is refined
_LEVEL = 2e-3  # radians by which it then may still change
_SHARED = 0.006
"""Standard error in pixels of either end of a ruler that all its ticks share, by the resampling."""
_IN_TURN = 6  # the errors of ticks that are up to this part of a ruler apart may go together
_STRAY = 0.05  # greatest root mean square distance of ticks from their places, of the period
_STRAY_TICKS = (0.2, 0.015)
"""And the greatest in pixels, or of the period if that is more, by perspective. That of rulers is about 0.1 pixels."""
_SHORT = 0.25  # length of a second ruler, of the longer one's, below which it is taken for a texture, such as a QR code
_SAME = 0.02  # greatest relative difference of periods of one ruler
_MOST_LEVEL = 1e9  # of an image
_NOT_FOUND = (
    f"no ruler with {FEWEST_TICKS} even ticks or more is found: "
    "give the scale with --scale, or crop the image to its ruler"
)
_WITHOUT_HEAVY = (
    "lines are found every {:.4g} pixels, but not every {}th is heavier, as on graph paper of {}: give the scale with "
    "--scale, or crop the image to its ruler"
)
_CROSSED = 5.0  # greatest difference from a right angle, degrees, of lines that cross
_AT_ENDS = 2  # ticks at each end that are not fitted, as the ground that is subtracted changes there
_DIVISORS = (10, 5, 4, 3, 2)  # of periods that only longer ticks have


@dataclass(frozen=True, eq=False, repr=False)
class Ruler:
    """Ticks of a ruler in an image.

    Attributes
    ----------
    period : float
        Distance of neighbouring ticks, pixels.
    period_se : float
        Its standard error.
    ends : (2, 2) float64
        x and y of the first and the last tick, in pixels.
    n_ticks : int
        Ticks from the first to the last.
    longest : int
        From one of the longest ticks to the next, in ticks, such as 10; 0 if none clearly are longer than others.
    """

    period: float
    period_se: float
    ends: np.ndarray
    n_ticks: int
    longest: int = 0

    __repr__ = short_repr

    @property
    def angle(self) -> float:
        """Tilt against the horizontal, -90 to 90 degrees; downwards is positive."""
        across, down = self.ends[1] - self.ends[0]
        return (math.degrees(math.atan2(down, across)) + 90) % 180 - 90

    def pixel(self, tick: Length) -> Length:
        """Return the length of a pixel, given that from one tick to the next."""
        value = tick.value / self.period
        error = value * math.hypot(self.period_se / self.period, tick.se / tick.value)
        return Length(value, tick.unit, error, "a ruler in the image")


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
    for strip in find_strips(grey)[:_MOST_TILES]:
        proposal = _Proposal(strip.centre, strip.angle, strip.period)
        if any(_is_on(proposal, ruler) for ruler in (*found, *further)):
            continue
        ruler = _refined(grey, proposal)
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
    proposals = _proposals(small)
    for proposal in proposals:
        if any(_is_on(proposal, ruler) for ruler in found):
            continue
        ruler = _refined(small, proposal) or _of_grid(small, proposal, proposals)
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
    band = _band(grey, centre, angle, _REACH)
    half = float(np.hypot(*(ruler.ends[1] - ruler.ends[0]))) / 2
    middle = band.shape[1] // 2
    part = band[:, max(middle - int(half), 0) : middle + int(half) + 1]
    finer = [_Proposal(centre, angle, ruler.period / divisor) for divisor in _DIVISORS]
    is_measured = any(each.period >= SHORTEST and _measured(band, each, is_endless=True) for each in finer)
    return None if is_measured or any(_stands_out(part, ruler.period, n) for n in _DIVISORS) else ruler


def _stands_out(band: np.ndarray, period: float, n: int) -> bool:
    """Whether the n-th harmonic of a period is clearly above those beside it, as by fainter ticks in n-ths of it."""
    flat = (band - _smooth(band, 1.5 * period)) * np.hanning(band.shape[1])
    harmonics = np.array([n - 1, n, n + 1]) / period
    waves = np.exp(-2j * np.pi * harmonics[:, None] * np.arange(band.shape[1]))
    below, own, above = (np.abs(flat @ waves.T) ** 2).mean(axis=0).tolist()
    return n / period <= 0.5 and own > _OUTSTANDING * max(below, above)


def _of_grid(grey: np.ndarray, proposal: _Proposal, proposals: Sequence[_Proposal]) -> Ruler | None:
    """Return the lines of graph paper at a proposal; None if no other is of the same period across its direction."""
    if not any(_cross(proposal, other) for other in proposals):
        return None
    lines = _aligned(grey, proposal)
    if lines is None:
        return None
    return _finest_measured(_band(grey, lines.centre, lines.angle, _REACH), lines, is_endless=True)


def _cross(proposal: _Proposal, other: _Proposal) -> bool:
    """Whether two proposals are of one period, and of directions across each other."""
    turn = (proposal.angle - other.angle) % math.pi - math.pi / 2
    return abs(math.log(proposal.period / other.period)) < _AGREE and abs(turn) < _AGREE


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


@dataclass(frozen=True)
class _Proposal:
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


def _proposals(grey: np.ndarray) -> list[_Proposal]:
    """Return the proposals of the tiles whose spectra are most like those of ticks, the best first."""
    proposals = []
    for side in TILES:
        for top, left in _places(grey.shape, side):
            for proposal in _of_tile(grey[top : top + side, left : left + side]):
                proposals.append(replace(proposal, centre=proposal.centre + np.array([left, top])))
    return _likeliest(proposals)


def _likeliest(proposals: Sequence[_Proposal]) -> list[_Proposal]:
    """Return the proposals that are most likely to be on a ruler, first those with high scores and others in line."""
    if not proposals:
        return []
    periods = np.array([proposal.period for proposal in proposals])
    angles = np.array([proposal.angle for proposal in proposals])
    centres = np.array([proposal.centre for proposal in proposals])
    away = centres[None] - centres[:, None]
    across = away[..., 1] * np.cos(angles)[:, None] - away[..., 0] * np.sin(angles)[:, None]
    turned = (angles[None] - angles[:, None] + np.pi / 2) % np.pi - np.pi / 2
    is_alike = np.abs(np.log(periods[None] / periods[:, None])) < _AGREE
    is_of_kind = is_alike & (np.abs(turned) < _AGREE)
    agree = is_of_kind & (np.abs(across) < _REACH)
    scores = np.array([proposal.score for proposal in proposals]) + np.log(agree.sum(axis=1))
    chosen: list[int] = []
    for i in np.argsort(-scores, kind="stable").tolist():
        if agree[i, chosen].sum() < _MOST_ALIKE and is_of_kind[i, chosen].sum() < _MOST_OF_KIND:
            chosen.append(i)
    return [proposals[i] for i in chosen[:_MOST_TILES]]


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


def _of_tile(tile: np.ndarray) -> Iterator[_Proposal]:
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
        yield _Proposal(centre, float(angles[row]), period, best + 0.2 * math.log(strength + 1e-9))
        turned = (angles - angles[row] + np.pi / 2) % np.pi - np.pi / 2
        score[np.abs(turned) < _APART] = -np.inf


def _band(grey: np.ndarray, centre: np.ndarray, angle: float, reach: float) -> np.ndarray:
    """Resample an image along a direction: rows (2 reach + 1) across the ruler, columns (2 half + 1) along it."""
    corners = np.array([(x, y) for x in (0, grey.shape[1]) for y in (0, grey.shape[0])]) - centre
    half = math.ceil(np.abs(corners @ (math.cos(angle), math.sin(angle))).max())
    along = np.arange(-half, half + 1)
    across = np.arange(-reach, reach + 1)[:, None]
    x = centre[0] + along * math.cos(angle) - across * math.sin(angle)
    y = centre[1] + along * math.sin(angle) + across * math.cos(angle)
    return cv2.remap(grey, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def _smooth(rows: np.ndarray, sigma: float) -> np.ndarray:
    """Smooth rows (m, n) along themselves by a triangle of a standard deviation, which takes the same time for all."""
    width = 2 * round(1.2247 * sigma) + 1  # the variance of two boxes is a sixth of the squared width
    once = cv2.blur(np.ascontiguousarray(rows, np.float32), (width, 1))
    return cv2.blur(once, (width, 1))


def _demodulated(band: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the complex strength of a period in each row of a band, within some periods, and its coherence, 0 to 1.

    The coherence is the amplitude of the period over the root mean square of the variation.
    """
    flat = band - _smooth(band, 1.5 * period)
    turned = flat * np.exp(-2j * np.pi * np.arange(band.shape[1]) / period)
    real = _smooth(turned.real, 2 * period)
    imaginary = _smooth(turned.imag, 2 * period)
    energy = np.maximum(_smooth(flat**2, 2 * period), 0)
    strength = real + 1j * imaginary
    return strength, np.abs(strength) / np.sqrt(energy + 1e-8)


def _refined(grey: np.ndarray, proposal: _Proposal) -> Ruler | None:
    """Refine the direction and the period of a proposal, and measure the ticks; None if it is no ruler."""
    for _ in range(_MOST_TURNS):
        turned = _aligned(grey, proposal)
        if turned is None:
            return None
        change = abs(turned.angle - proposal.angle)
        proposal = turned
        if change < _LEVEL:
            break
    else:
        return None
    return _finest_measured(_band(grey, proposal.centre, proposal.angle, _REACH), proposal)


def _finest_measured(band: np.ndarray, proposal: _Proposal, *, is_endless: bool = False) -> Ruler | None:
    """Measure the ticks between those of a proposal if there are any, or else those of the proposal."""
    for divisor in _DIVISORS:
        finer = replace(proposal, period=proposal.period / divisor)
        if finer.period >= SHORTEST and (ruler := _measured(band, finer, is_endless=is_endless)) is not None:
            return ruler
    return _measured(band, proposal, is_endless=is_endless)


def _run(good: np.ndarray, middle: int, gap: int) -> tuple[int, int]:
    """Return the begin and end of the run of true values around an index, across gaps of so many."""
    places = np.flatnonzero(good)
    if not len(places):
        return middle, middle
    parts = np.split(places, np.flatnonzero(np.diff(places) > gap + 1) + 1)
    nearest = min(parts, key=lambda part: max(part[0] - middle, middle - part[-1], 0))
    return int(nearest[0]), int(nearest[-1]) + 1


def _aligned(grey: np.ndarray, proposal: _Proposal) -> _Proposal | None:
    """Return a proposal with the direction, period and place that the phase of its period shows; None if there is none.

    Along the ruler the phase of ticks of another period grows evenly, and across it that of tilted ones.
    """
    band = _band(grey, proposal.centre, proposal.angle, _REACH)
    strength, coherence = _demodulated(band, proposal.period)
    middle = band.shape[1] // 2
    room = _room(coherence, proposal.period)
    if room is None:
        return None
    top, bottom, left, right = room
    weights = strength[top:bottom, left:right]
    slope = _slope(weights) * proposal.period / (2 * np.pi)  # pixels along, per pixel across
    summed = weights.sum(axis=0)
    if len(summed) < 4 * proposal.period:
        return None
    turn = float(np.angle((summed[1:] * summed[:-1].conj()).sum())) / (2 * np.pi)  # cycles per pixel
    frequency = 1 / proposal.period + turn
    if not 0.5 < frequency * proposal.period < 2:
        return None
    along = (left + right - 1) / 2 - middle
    across = (top + bottom - 1) / 2 - _REACH
    centre = proposal.place(along, across)
    return replace(proposal, centre=centre, angle=proposal.angle + math.atan(slope), period=1 / frequency)


def _room(coherence: np.ndarray, period: float) -> tuple[int, int, int, int] | None:
    """Return the rows and the columns of a band, around its middle, where a period is coherent; None if nowhere."""
    middle = coherence.shape[1] // 2
    near = slice(max(middle - int(3 * period), 0), middle + int(3 * period) + 1)
    rows = coherence[:, near].mean(axis=1)
    best = int(rows.argmax())
    if rows[best] < _COHERENT:
        return None
    top, bottom = _run(rows > 0.7 * rows[best], best, 1)
    along = coherence[top:bottom].mean(axis=0) > 0.6 * _COHERENT
    return (top, bottom, *_run(along, middle, int(2 * period)))


def _slope(strength: np.ndarray) -> float:
    """Return by how much the phase of rows (m, n) grows from one to the next, in radians."""
    if len(strength) < 2:
        return 0.0
    step = float(np.angle((strength[1:] * strength[:-1].conj()).sum()))
    rows = np.arange(len(strength)) - (len(strength) - 1) / 2
    level = strength * np.exp(-1j * step * rows)[:, None]
    relative = (level * level.sum(axis=0).conj()).sum(axis=1)
    return step + float(np.polyfit(rows, np.angle(relative), 1, w=np.abs(relative) + 1e-12)[0])


def _measured(band: np.ndarray, proposal: _Proposal, *, is_endless: bool = False) -> Ruler | None:
    """Measure each tick of a proposal; None if they are too few, too far from their places, or no ruler's.

    Ticks of a ruler end within the reach, and lines of graph paper need not.
    """
    _, coherence = _demodulated(band, proposal.period)
    middle = band.shape[1] // 2
    room = _room(coherence, proposal.period)
    if room is None:
        return None
    top, bottom, left, right = room
    is_cut = top == 0 or bottom == len(band)  # stripes go on beyond the reach, and ticks do not
    is_short = right - left < _LONG * (bottom - top)
    if bottom - top < 3 or (not is_endless and (is_cut or is_short)):
        return None
    profile = band[top:bottom].mean(axis=0)
    ticks = _ticks(profile, proposal.period, left, right, 50 if is_endless else 90)
    if ticks is None:
        return None
    numbers, places, error, span = ticks
    period, start = np.polyfit(numbers, places, 1)
    across = (top + bottom - 1) / 2 - _REACH
    points = np.array([proposal.place(start + period * number - middle, across) for number in span])
    return Ruler(float(period), error, points, span[1] - span[0] + 1)


def _ticks(
    profile: np.ndarray, period: float, left: int, right: int, percentile: float
) -> tuple[np.ndarray, np.ndarray, float, tuple[int, int]] | None:
    """Return numbers and places of ticks along a profile, the standard error of their period, and the end numbers.

    The percentile of the strengths is that of usual ticks: some lines of graph paper are stronger than most.
    """
    flat = profile - _smooth(profile[None], 1.5 * period)[0]
    sign = -1.0 if np.mean(flat[left:right] ** 3) < 0 else 1.0  # ticks take less room than gaps
    lit = np.maximum(sign * flat, 0.0)
    start = _place_of_first(lit, period, left, right)
    numbers = np.arange(math.ceil((left - start) / period), math.floor((right - 1 - start) / period) + 1)
    measured = [_tick(lit, start + number * period, period) for number in numbers]
    strengths = np.array([strength for _, strength in measured])
    places = np.array([place for place, _ in measured])
    if len(numbers) < FEWEST_TICKS:
        return None
    present = strengths > _PRESENT * np.percentile(strengths, percentile)
    first, last = _run(present, len(present) // 2, 1)
    present = present[first:last]
    numbers = numbers[first:last][present]
    places = places[first:last][present]
    if len(present) < FEWEST_TICKS or 1 - present.mean() > _MOST_LACKING:
        return None
    inner = slice(_AT_ENDS, -_AT_ENDS) if len(numbers) >= FEWEST_TICKS + 2 * _AT_ENDS else slice(None)
    fitted = _fitted(numbers[inner], places[inner], period)
    return None if fitted is None else (*fitted, (int(numbers[0]), int(numbers[-1])))


def _place_of_first(lit: np.ndarray, period: float, left: int, right: int) -> float:
    """Return the place of a tick, by the phase of the period in a profile."""
    turns = np.exp(-2j * np.pi * np.arange(left, right) / period) * lit[left:right]
    return -float(np.angle(turns.sum())) * period / (2 * np.pi)


def _tick(lit: np.ndarray, expected: float, period: float) -> tuple[float, float]:
    """Return the place of a tick, the centre of the light within half a period of where it is expected, and its sum."""
    begin = max(math.ceil(expected - period / 2), 0)
    values = lit[begin : math.floor(expected + period / 2) + 1]
    total = float(values.sum())
    if total <= 0:
        return expected, 0.0
    return begin + float(values @ np.arange(len(values))) / total, total


def _fitted(numbers: np.ndarray, places: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Return numbers and places of ticks near a straight line through them, and the standard error of its slope."""
    for _ in range(3):
        slope, start = np.polyfit(numbers, places, 1)
        away = places - start - slope * numbers
        usual = max(1.4826 * float(np.median(np.abs(away))), 1e-3 * period)
        kept = np.abs(away) < 4 * usual
        if kept.all():
            break
        numbers = numbers[kept]
        places = places[kept]
        if len(numbers) < FEWEST_TICKS:
            return None
    slope, start = np.polyfit(numbers, places, 1)
    away = places - start - slope * numbers
    stray = math.sqrt(float(away @ away) / (len(numbers) - 2))
    pixels, share = _STRAY_TICKS
    if stray > min(_STRAY * period, max(pixels, share * period)):
        return None
    shared = math.sqrt(2) * _SHARED / float(np.ptp(numbers))
    return numbers, places, math.hypot(_slope_error(numbers, away), shared)


def _slope_error(numbers: np.ndarray, away: np.ndarray) -> float:
    """Return the standard error of the slope of a line, from the distances (n,) of ticks from it.

    The errors of neighbouring ticks are not independent: those by the ground below them or by perspective go together,
    and those by the pixels alternate. The estimate is that of Newey and West, Econometrica 55 (1987), p. 703, with 1.5
    degrees of freedom for each part of the ruler within which errors may go together.
    """
    n = len(numbers)
    centred = numbers - numbers.mean()
    pulls = centred * away
    most = max(n // _IN_TURN, 1)
    together = sum((1 - lag / (most + 1)) * float(pulls[lag:] @ pulls[:-lag]) for lag in range(1, most + 1))
    variance = (float(pulls @ pulls) + 2 * together) * n / (n - 2)
    return widened(1.5 * _IN_TURN) * math.sqrt(max(variance, 0.0)) / float(centred @ centred)


def _is_on(proposal: _Proposal, ruler: Ruler) -> bool:
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
    return abs(away[0] * along[1] - away[1] * along[0]) < _REACH * np.hypot(*along)


def _are_one(ruler: Ruler, other: Ruler) -> bool:
    """Whether two rulers are the same: of one period and direction, and on one line."""
    if abs(ruler.period / other.period - 1) > _SAME or abs((ruler.angle - other.angle + 90) % 180 - 90) > 3:
        return False
    return _is_beside(ruler.ends.mean(axis=0), other)
