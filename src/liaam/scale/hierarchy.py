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
"""From one longest tick to the next on scales of millimetres or tenths, and of inches."""

MARKS = {
    5: (5,),
    10: (5, 10),
    20: (2, 10, 20),  # of half millimetres
    **{step: tuple(2**i for i in range(1, step.bit_length())) for step in BINARY},
}
"""From one longer tick to the next, from the shorter ones to the longest, by the last of these."""

_WIDE = (0.35, 2.0)  # least width of teeth and threads, of their period, and least length: blocks are short
_THIN = (0.27, 4.5)  # the same of thin teeth: ticks that are all alike are not so long
_BLURRED = (10.0, 3.0)  # pixels of a period that is short, whose blurred ticks look wide, and the least length there
_PHASES = 16  # of a period at which ticks are looked at
_REACH = (30.0, 160.0)  # least and greatest distance from the ticks' middle that is looked at, pixels
_OF_PERIOD = 8.0  # and usually, of the period
_ON = np.array([-0.12, 0.0, 0.12])  # where ticks are, of the period
_OFF = np.array([-0.5, -0.4, 0.4, 0.5])  # and where there are none
_PRESENT = 0.5  # least contrast of a tick, of the usual one
_FEWEST_LONGEST = 2  # ticks
_FEWEST_LONGER = {5: 4, 10: 3}  # longer ticks of all lengths: few lengths are more often there by chance than many
_SCATTERS = 4.0  # greatest difference of ticks of one length from the usual one, of the median difference
_ALIKE = 0.1  # and at most, of the length
_LEAST_ALIKE = 1.0  # pixels that are allowed in any case
_LONGER = 0.1  # least relative difference of longer ticks
_APART = 1.5  # and the least, of the greatest difference of ticks of one length
_USUAL = 0.75  # least share of ticks that are of the length of their rank: others are covered, or touch numbers
_TOO_LONG = 0.1  # greatest share of ticks that are longer than their rank's
_USUAL_OF_RANK = 0.6  # and of those of each rank
_FEWEST = 3  # heavy lines
_OF_LONG = 0.75  # least share of heavy lines that are so much heavier, and of halves that are there
_CLEAR = 5.0  # least difference of their weights, in standard errors
_HEAVIER = 1.25  # least weight of a heavy line, of the usual one
_PARTS = 5  # of the distances across ticks that are looked at: lines go on in each, and ticks do not
_ROWS = 3  # at so many distances in turn


def longest_ticks(grey: np.ndarray, ends: np.ndarray, n_ticks: int, wanted: int = 0) -> int:
    """Return from which tick to which one the longest ticks of a ruler are, such as 10; 0 if none clearly are longer.

    Parameters
    ----------
    grey : (h, w) float32
    ends : (2, 2) float64
        x and y of the first and the last tick, pixels.
    n_ticks : int
    wanted : int
        What is expected, see :func:`expected`. Of inches, one longest tick is then enough, if the others are as long as
        they should be.
    """
    half = (ends[1] - ends[0]) / (n_ticks - 1) / 2
    # Where a period is short and blurred, what is measured may be the gaps between the ticks.
    for first, last, n in ((ends[0], ends[1], n_ticks), (ends[0] + half, ends[1] - half, n_ticks - 1)):
        contrast = _contrasts(grey, np.array([first, last]), n)
        usual = _usual(contrast)
        if usual != 0:
            lengths = _lengths(contrast / usual > _PRESENT)
            steps = [step for step in MARKS if any(_is_shown(each, step, step == wanted) for each in lengths)]
            if steps:
                return max(steps)
    return 0


def _lengths(is_there: np.ndarray) -> list[np.ndarray]:
    """Return how far ticks go on from their middle (n_ticks,) to one side, to the other one, and in all, pixels.

    At one side they begin at the edge of a ruler. If that is not quite level, lengths in all are.
    """
    middle = len(is_there) // 2
    as_far = _as_far(is_there)
    before = as_far[:middle].sum(axis=0).astype(float)
    after = as_far[middle:].sum(axis=0).astype(float)
    return [before, after, before + after]


def _is_shown(lengths: np.ndarray, step: int, is_wanted: bool) -> bool:
    """Whether ticks are as long (n_ticks,) as those of a scale whose longest ones are a step apart.

    Ticks of one rank are of one length, but for a few, which may be covered, and those of a higher rank are longer.
    """
    n = len(lengths)
    is_there = lengths > 0
    lengths = _level(lengths, step)
    firsts = [float(np.median(lengths[first::step])) for first in range(min(step, n))]
    place = np.arange(n) - int(np.argmax(firsts))
    ranks = np.sum([place % mark == 0 for mark in MARKS[step]], axis=0)
    of_rank = [lengths[(ranks == rank) & is_there] for rank in range(len(MARKS[step]) + 1)]
    if min(len(each) for each in of_rank) == 0:
        return False
    usual = np.array([np.median(each) for each in of_rank])
    away = np.abs(lengths - usual[ranks])
    same = np.clip(_SCATTERS * float(np.median(away)), _LEAST_ALIKE, np.maximum(_ALIKE * usual, _LEAST_ALIKE))
    is_usual = away <= same[ranks]
    if (~is_usual & (lengths > usual[ranks])).mean() > _TOO_LONG:
        return False
    if is_usual.mean() < _USUAL or min(is_usual[ranks == rank].mean() for rank in range(len(usual))) < _USUAL_OF_RANK:
        return False
    more = np.diff(usual)
    is_more = more > np.maximum(_LONGER * usual[:-1], _APART * same[:-1])
    if step in _FEWEST_LONGER:  # halves of a centimetre may be as long as millimetres
        is_longer = usual > usual[0] + max(_LONGER * usual[0], _APART * same[0])
        n_longer = sum(len(each) for each, counts in zip(of_rank, is_longer, strict=True) if counts)
        is_in_order = bool(is_more[-1] and more[0] > -same[0])
        return is_in_order and len(of_rank[-1]) >= _FEWEST_LONGEST and n_longer >= _FEWEST_LONGER[step]
    is_enough = len(of_rank[-1]) >= _FEWEST_LONGEST or (is_wanted and step in BINARY)
    return bool(is_more.all()) and is_enough


def _level(lengths: np.ndarray, step: int) -> np.ndarray:
    """Return lengths (n_ticks,) without the even change that an edge has which is not quite level."""
    n = len(lengths)
    slope = float(np.median(lengths[step:] - lengths[:-step])) / step if n > step else 0.0
    return lengths - slope * (np.arange(n) - (n - 1) / 2)


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
    of_wide = _BLURRED[1] if period < _BLURRED[0] else _WIDE[1]
    is_wide = width > _WIDE[0] and length > of_wide * period
    is_thin = width > _THIN[0] and length > _THIN[1] * period
    return is_wide or (is_thin and not goes_on(grey, ends, n_ticks))


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
