"""Measure the ticks of a ruler, one by one, where tiles or edges propose them.

Around a proposal the image is resampled along the ruler, its tilt and period are refined by the phase of the period,
and each tick is measured. What does not look like a ruler in every step is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from liaam.formatting import short_repr
from liaam.scale.lengths import Length, widened
from liaam.scale.proposals import REACH, Proposal

SHORTEST = 4.0
"""Shortest period in pixels; ticks of less are not resolved."""

FEWEST_TICKS = 10
"""Least number of ticks in turn. Textures rarely repeat that often."""

DIVISORS = (10, 5, 4, 3, 2)
"""Of periods that only longer ticks have."""

_COHERENT = 0.33  # least share of the variation that has the period, of 0.5 for a sine and less for thin ticks
_LONG = 3.0  # least ratio of the length of a ruler to that of its ticks
_PRESENT = 0.35  # least strength of a tick, of the stronger ones
_MOST_LACKING = 0.1  # greatest share of ticks that are not there
_MOST_TURNS = 8  # times that the direction is refined
_LEVEL = 2e-3  # radians by which it then may still change
_SHARED = 0.005
"""Standard error in pixels of either end of a ruler that all its ticks share, as a gradient below them changes slowly.

The scatter of the ticks does not show it. Ticks that are drawn without noise have half of it, by the resampling."""
_IN_TURN = 6  # the errors of ticks that are up to this part of a ruler apart may go together
_STRAY = 0.05  # greatest root mean square distance of ticks from their places, of the period
_STRAY_TICKS = (0.2, 0.015)
"""And the greatest in pixels, or of the period if that is more, by perspective. That of rulers is about 0.1 pixels."""
_FINER = 4
"""Samples of a pixel between which a profile is interpolated before ticks are cut from it.

Cutting off what is below the ground is not linear, and moves the centre of a tick by how it lies among the samples.
Where a period is nearly a whole or half number of samples, that changes slowly along the ruler, and looks like another
period.
"""
_AT_ENDS = 2  # ticks at each end that are not fitted, as the ground that is subtracted changes there


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


def band_along(grey: np.ndarray, centre: np.ndarray, angle: float, reach: float) -> np.ndarray:
    """Resample an image along a direction: rows (2 reach + 1) across the ruler, columns (2 half + 1) along it."""
    corners = np.array([(x, y) for x in (0, grey.shape[1]) for y in (0, grey.shape[0])]) - centre
    half = math.ceil(np.abs(corners @ (math.cos(angle), math.sin(angle))).max())
    along = np.arange(-half, half + 1)
    across = np.arange(-reach, reach + 1)[:, None]
    x = centre[0] + along * math.cos(angle) - across * math.sin(angle)
    y = centre[1] + along * math.sin(angle) + across * math.cos(angle)
    return cv2.remap(grey, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def smooth(rows: np.ndarray, sigma: float) -> np.ndarray:
    """Smooth rows (m, n) along themselves by a triangle of a standard deviation, which takes the same time for all."""
    width = 2 * round(1.2247 * sigma) + 1  # the variance of two boxes is a sixth of the squared width
    once = cv2.blur(np.ascontiguousarray(rows, np.float32), (width, 1))
    return cv2.blur(once, (width, 1))


def _demodulated(band: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the complex strength of a period in each row of a band, within some periods, and its coherence, 0 to 1.

    The coherence is the amplitude of the period over the root mean square of the variation.
    """
    flat = band - smooth(band, 1.5 * period)
    turned = flat * np.exp(-2j * np.pi * np.arange(band.shape[1]) / period)
    real = smooth(turned.real, 2 * period)
    imaginary = smooth(turned.imag, 2 * period)
    energy = np.maximum(smooth(flat**2, 2 * period), 0)
    strength = real + 1j * imaginary
    return strength, np.abs(strength) / np.sqrt(energy + 1e-8)


def refined_ruler(grey: np.ndarray, proposal: Proposal) -> Ruler | None:
    """Refine the direction and the period of a proposal, and measure the ticks; None if it is no ruler."""
    for _ in range(_MOST_TURNS):
        turned = aligned(grey, proposal)
        if turned is None:
            return None
        change = abs(turned.angle - proposal.angle)
        proposal = turned
        if change < _LEVEL:
            break
    else:
        return None
    return finest_ruler(band_along(grey, proposal.centre, proposal.angle, REACH), proposal)


def finest_ruler(band: np.ndarray, proposal: Proposal, *, is_endless: bool = False) -> Ruler | None:
    """Measure the ticks between those of a proposal if there are any, or else those of the proposal."""
    for divisor in DIVISORS:
        finer = replace(proposal, period=proposal.period / divisor)
        if finer.period >= SHORTEST and (ruler := measured_ruler(band, finer, is_endless=is_endless)) is not None:
            return ruler
    return measured_ruler(band, proposal, is_endless=is_endless)


def _run(good: np.ndarray, middle: int, gap: int) -> tuple[int, int]:
    """Return the begin and end of the run of true values around an index, across gaps of so many."""
    places = np.flatnonzero(good)
    if not len(places):
        return middle, middle
    parts = np.split(places, np.flatnonzero(np.diff(places) > gap + 1) + 1)
    nearest = min(parts, key=lambda part: max(part[0] - middle, middle - part[-1], 0))
    return int(nearest[0]), int(nearest[-1]) + 1


def aligned(grey: np.ndarray, proposal: Proposal) -> Proposal | None:
    """Return a proposal with the direction, period and place that the phase of its period shows; None if there is none.

    Along the ruler the phase of ticks of another period grows evenly, and across it that of tilted ones.
    """
    band = band_along(grey, proposal.centre, proposal.angle, REACH)
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
    across = (top + bottom - 1) / 2 - REACH
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


def measured_ruler(band: np.ndarray, proposal: Proposal, *, is_endless: bool = False) -> Ruler | None:
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
    across = (top + bottom - 1) / 2 - REACH
    points = np.array([proposal.place(start + period * number - middle, across) for number in span])
    return Ruler(float(period), error, points, span[1] - span[0] + 1)


def _ticks(
    profile: np.ndarray, period: float, left: int, right: int, percentile: float
) -> tuple[np.ndarray, np.ndarray, float, tuple[int, int]] | None:
    """Return numbers and places of ticks along a profile, the standard error of their period, and the end numbers.

    The percentile of the strengths is that of usual ticks: some lines of graph paper are stronger than most.
    """
    flat = profile - smooth(profile[None], 1.5 * period)[0]
    sign = -1.0 if np.mean(flat[left:right] ** 3) < 0 else 1.0  # ticks take less room than gaps
    lit = np.maximum(sign * _finer(flat), 0.0)
    step = period * _FINER
    begin, end = left * _FINER, (right - 1) * _FINER
    start = _place_of_first(lit, step, begin, end + 1)
    numbers = np.arange(math.ceil((begin - start) / step), math.floor((end - start) / step) + 1)
    measured = [_tick(lit, start + number * step, step) for number in numbers]
    strengths = np.array([strength for _, strength in measured])
    places = np.array([place for place, _ in measured]) / _FINER
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


def _finer(profile: np.ndarray) -> np.ndarray:
    """Return a profile (n,) at `_FINER` times as many places (m,), the last of which is the last of its own."""
    from scipy.interpolate import make_interp_spline

    places = np.arange((len(profile) - 1) * _FINER + 1) / _FINER
    return make_interp_spline(np.arange(len(profile)), profile)(places)


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
