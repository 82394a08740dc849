"""Which ticks of a ruler are longer: every fifth and tenth, as of millimetres, or every second, fourth and eighth.

Longer ticks tell a ruler from a comb, a fabric or graph paper, a scale of millimetres from one of inches, and one whose
smallest ticks are too fine to be seen: of half millimetres every twentieth is the longest, of millimetres every tenth.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from liaam.scale.lengths import Length

DECIMAL = (5, 10, 20)
BINARY = (4, 8, 16, 32)
"""From one longer tick to the next on scales of millimetres or tenths, and of inches. On both, every second may be."""

_TEETH = (
    0.35,
    3.0,
)  # least width of teeth and threads, of their period, and least length: ticks are thin, blocks short
_PHASES = 16  # of a period at which ticks are looked at
_REACH = (30.0, 160.0)  # least and greatest distance from the ticks' middle that is looked at, pixels
_OF_PERIOD = 8.0  # and usually, of the period
_ON = np.array([-0.12, 0.0, 0.12])  # where ticks are, of the period
_OFF = np.array([-0.5, -0.4, 0.4, 0.5])  # and where there are none
_PRESENT = 0.5  # least contrast of a tick, of the usual one
_FEWEST = 3  # longer ticks
_OF_LONG = 0.75  # least share of longer ticks, and greatest of the others, that reach a distance
_OF_OTHERS = 0.2
_OF_BETWEEN = 0.4  # and greatest of the few in the middle between them
_CLEAR = 5.0  # least difference of these shares, in standard errors
_AS_CLEAR = 0.8  # least of that of the clearest step. Every second one of its ticks has 0.7 of it
_HEAVIER = 1.25  # least weight of a heavy line, of the usual one
_PARTS = 5  # of the distances across ticks that are looked at: lines go on in each, and ticks do not
_ROWS = 3  # at so many distances in turn


def longest_ticks(grey: np.ndarray, ends: np.ndarray, n_ticks: int) -> int:
    """Return from which tick to which one the longest ticks of a ruler are, such as 10; 0 if none clearly are longer.

    Parameters
    ----------
    grey : (h, w) float32
    ends : (2, 2) float64
        x and y of the first and the last tick, pixels.
    n_ticks : int
    """
    contrast = _contrasts(grey, ends, n_ticks)
    usual = _usual(contrast)
    if usual == 0:
        return 0
    is_there = _as_far(contrast / usual > _PRESENT)
    clearness = {step: _clearness(is_there, step) for step in (*DECIMAL, *BINARY)}
    best = max(clearness, key=lambda step: clearness[step])
    if clearness[best] < _CLEAR:
        return 0
    family = DECIMAL if best in DECIMAL else BINARY
    return max(step for step in family if clearness[step] >= max(_CLEAR, _AS_CLEAR * clearness[best]))


def heaviest_lines(grey: np.ndarray, ends: np.ndarray, n_ticks: int) -> int:
    """Return from which line to which one the heaviest are, as on graph paper, such as 10; 0 if none clearly are.

    Parameters
    ----------
    grey : (h, w) float32
    ends : (2, 2) float64
        x and y of the first and the last line, pixels.
    n_ticks : int
    """
    weights = np.median(_contrasts(grey, ends, n_ticks), axis=0)
    weights *= np.sign(np.median(weights))
    clearness = {step: _heaviness(weights, step) for step in (*DECIMAL, *BINARY)}
    best = max(clearness, key=lambda step: clearness[step])
    return best if clearness[best] > _CLEAR else 0


def _as_far(is_there: np.ndarray) -> np.ndarray:
    """Return which ticks go on from their middle to each distance (rows, n_ticks): numbers beyond do not count."""
    middle = len(is_there) // 2
    before = np.logical_and.accumulate(is_there[middle::-1], axis=0)
    after = np.logical_and.accumulate(is_there[middle:], axis=0)
    return np.concatenate([before[:0:-1], after])


def has_halves(grey: np.ndarray, ends: np.ndarray, n_ticks: int) -> bool:
    """Whether shorter ticks are in the middle between all ticks, such as those of half millimetres."""
    contrast = _contrasts(grey, ends, 2 * n_ticks - 1)
    own = contrast[:, ::2]
    between = contrast[:, 1::2]
    usual = _usual(own)
    if usual == 0:
        return False
    shares = [np.mean(ticks / usual > _PRESENT, axis=1) for ticks in (own, between)]
    are_there = np.min(shares, axis=0) >= _OF_LONG
    return bool(np.lib.stride_tricks.sliding_window_view(are_there, _ROWS).all(axis=1).any())


def _heaviness(weights: np.ndarray, step: int) -> float:
    """Return by how many standard errors every step-th line is heavier than the others."""
    n = len(weights)
    best = 0.0
    for first in range(step):
        is_heavy = np.arange(n) % step == first
        n_heavy = int(is_heavy.sum())
        others = weights[~is_heavy]
        if n_heavy < _FEWEST or np.mean(weights[is_heavy] > _HEAVIER * np.median(others)) < _OF_LONG:
            continue
        error = float(others.std()) * math.sqrt(1 / n_heavy + 1 / len(others)) + 1e-9
        best = max(best, float(weights[is_heavy].mean() - others.mean()) / error)
    return best


def goes_on(grey: np.ndarray, ends: np.ndarray, n_ticks: int) -> bool:
    """Whether ticks go on at both sides, as the lines of graph paper and the threads of fabric do."""
    contrast = _contrasts(grey, ends, n_ticks)
    usual = _usual(contrast)
    return usual != 0 and all(float(np.median(part / usual)) > _PRESENT for part in np.array_split(contrast, _PARTS))


def are_teeth(grey: np.ndarray, ends: np.ndarray, n_ticks: int) -> bool:
    """Whether ticks are both wide and long, as the teeth of a comb and threads are, and neither ticks nor blocks."""
    phases = np.arange(_PHASES) / _PHASES - 0.5
    values = _sampled(grey, ends, n_ticks, phases)
    middle = len(values) // 2
    waves = values.mean(axis=1)  # of the rows
    usual = waves[middle - 1 : middle + 2].mean(axis=0)
    span = float(np.ptp(usual))
    if span == 0:
        return False
    is_there = (waves - waves.mean(axis=1, keepdims=True)) @ (usual - usual.mean()) > _PRESENT * float(
        np.square(usual - usual.mean()).sum()
    )
    ends_of = [np.flatnonzero(~rows) for rows in (is_there[middle:], is_there[middle::-1])]
    length = sum(float(each[0]) if len(each) else middle for each in ends_of)
    inward = usual if abs(usual[_PHASES // 2] - usual.min()) > abs(usual[_PHASES // 2] - usual.max()) else -usual
    width = float(np.mean(inward - inward.min() > 0.5 * span))
    period = float(np.hypot(*(ends[1] - ends[0]))) / (n_ticks - 1)
    return width > _TEETH[0] and length > _TEETH[1] * period


def _contrasts(grey: np.ndarray, ends: np.ndarray, n_ticks: int) -> np.ndarray:
    """Return by how much each tick differs from the gaps beside it, (rows, n_ticks); rows are distances across."""
    values = _sampled(grey, ends, n_ticks, np.concatenate([_ON, _OFF]))
    return values[..., : len(_ON)].mean(axis=2) - values[..., len(_ON) :].mean(axis=2)


def _usual(contrast: np.ndarray) -> float:
    """Return the usual contrast of ticks (rows, n_ticks), at the middle of the rows."""
    middle = len(contrast) // 2
    return float(np.median(contrast[middle - 1 : middle + 2]))


def _sampled(grey: np.ndarray, ends: np.ndarray, n_ticks: int, phases: np.ndarray) -> np.ndarray:
    """Return the levels at distances across a ruler, at places around each tick: (rows, n_ticks, len(phases))."""
    axis = (ends[1] - ends[0]) / (n_ticks - 1)
    period = float(np.hypot(*axis))
    reach = round(min(max(_OF_PERIOD * period, _REACH[0]), _REACH[1]))
    normal = np.array([-axis[1], axis[0]]) / period
    along = np.arange(n_ticks)[:, None] + phases
    across = np.arange(-reach, reach + 1.0)[:, None, None]
    x = (ends[0][0] + along * axis[0] + across * normal[0]).astype(np.float32)
    y = (ends[0][1] + along * axis[1] + across * normal[1]).astype(np.float32)
    shape = (len(across), along.size)
    values = cv2.remap(grey, x.reshape(shape), y.reshape(shape), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return cv2.blur(values, (1, 3)).reshape(len(across), n_ticks, len(phases))


def _clearness(is_there: np.ndarray, step: int) -> float:
    """Return by how many standard errors every step-th tick is there more often than others, at several distances.

    On decimal scales, those in the middle between them are not there, or the step would be half as long. On binary
    ones, they may be little shorter.
    """
    n = is_there.shape[1]
    best = 0.0
    for first in range(step):
        is_long = np.arange(n) % step == first
        n_long = int(is_long.sum())
        if n_long < _FEWEST or n_long == n:
            continue
        of_long = is_there[:, is_long].mean(axis=1)
        of_others = is_there[:, ~is_long].mean(axis=1)
        share = np.clip(is_there.mean(axis=1), 0.5 / n, 1 - 0.5 / n)
        errors = np.sqrt(share * (1 - share) * (1 / n_long + 1 / (n - n_long)))
        is_between = 2 * ((np.arange(n) - first) % step) == step
        is_counted = step in DECIMAL and bool(is_between.any())
        of_between = is_there[:, is_between].mean(axis=1) if is_counted else np.zeros(len(is_there))
        is_clear = (of_long >= _OF_LONG) & (of_others <= _OF_OTHERS) & (of_between <= _OF_BETWEEN)
        clear = np.where(is_clear, (of_long - of_others) / errors, 0.0)
        in_turn = np.lib.stride_tricks.sliding_window_view(clear, _ROWS).min(axis=1)
        best = max(best, float(in_turn.max()))
    return best


def expected(tick: Length | None) -> int:
    """Return from which tick to which one the longest are, of ticks that are this far apart; 0 if that is not known."""
    if tick is None:
        return 0
    inches = tick.within("in").value if tick.unit else 0.0
    millimetres = tick.within("mm").value if tick.unit else 0.0
    if inches <= 0:
        return 0
    times = round(1 / inches)
    if times in BINARY and math.isclose(times * inches, 1, rel_tol=1e-3):
        return times
    if math.isclose(millimetres, 0.5, rel_tol=1e-3):
        return 20
    return 10 if _is_near_whole(math.log10(millimetres)) or _is_near_whole(math.log10(inches)) else 0


def may_be(longest: int, wanted: int) -> bool:
    """Whether ticks of which the longest are so far apart may be those of a ruler, as :func:`expected` has it.

    Where fewer ticks lie between the longest than should, half of the ticks may be too fine to be seen. On some rulers
    of millimetres, the halves of a centimetre are as long as the whole ones.
    """
    return not wanted or longest == wanted or (longest, wanted) == (5, 10)


def _is_near_whole(value: float) -> bool:
    return abs(value - round(value)) < 1e-3
