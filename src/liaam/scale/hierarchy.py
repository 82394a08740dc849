"""Which ticks of a ruler are longer: every fifth and tenth, as of millimetres, or every second, fourth and eighth.

Longer ticks tell a ruler from a comb, a fabric or graph paper, and a scale of millimetres from one of inches.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from liaam.scale.lengths import Length

DECIMAL = "fifths and tenths"
BINARY = "halves and quarters"
STEPS = {10: DECIMAL, 5: DECIMAL, 20: DECIMAL, 8: BINARY, 4: BINARY, 16: BINARY}
"""From one longer tick to the next, and what that shows. Every second tick may be longer on both."""

_REACH = (30.0, 160.0)  # least and greatest distance from the ticks' middle that is looked at, pixels
_OF_PERIOD = 8.0  # and usually, of the period
_ON = np.array([-0.12, 0.0, 0.12])  # where ticks are, of the period
_OFF = np.array([-0.5, -0.4, 0.4, 0.5])  # and where there are none
_PRESENT = 0.5  # least contrast of a tick, of the usual one
_FEWEST = 3  # longer ticks
_OF_LONG = 0.75  # least share of longer ticks, and greatest of the others, that reach a distance
_OF_OTHERS = 0.2
_CLEAR = 5.0  # least difference of these shares, in standard errors
_ROWS = 3  # at so many distances in turn


def longer_ticks(grey: np.ndarray, ends: np.ndarray, n_ticks: int) -> str:
    """Return which ticks of a ruler are longer, `DECIMAL` or `BINARY`, or "" if none clearly are.

    Parameters
    ----------
    grey : (h, w) float32
    ends : (2, 2) float64
        x and y of the first and the last tick, pixels.
    n_ticks : int
    """
    contrast = _contrasts(grey, ends, n_ticks)
    middle = len(contrast) // 2
    usual = float(np.median(contrast[middle - 1 : middle + 2]))
    if usual == 0:
        return ""
    is_there = contrast / usual > _PRESENT
    clearest = {step: _clearness(is_there, step) for step in STEPS if step * _FEWEST <= n_ticks + step}
    best = max(clearest, key=lambda step: clearest[step], default=0)
    return STEPS[best] if best and clearest[best] > _CLEAR else ""


def _contrasts(grey: np.ndarray, ends: np.ndarray, n_ticks: int) -> np.ndarray:
    """Return by how much each tick differs from the gaps beside it, (rows, n_ticks); rows are distances across."""
    axis = (ends[1] - ends[0]) / (n_ticks - 1)
    period = float(np.hypot(*axis))
    reach = round(min(max(_OF_PERIOD * period, _REACH[0]), _REACH[1]))
    normal = np.array([-axis[1], axis[0]]) / period
    along = np.arange(n_ticks)[:, None] + np.concatenate([_ON, _OFF])
    across = np.arange(-reach, reach + 1.0)[:, None, None]
    x = (ends[0][0] + along * axis[0] + across * normal[0]).astype(np.float32)
    y = (ends[0][1] + along * axis[1] + across * normal[1]).astype(np.float32)
    rows = len(across)
    shape = (rows, along.size)
    values = cv2.remap(
        grey, x.reshape(shape), y.reshape(shape), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).reshape(rows, n_ticks, -1)
    values = cv2.blur(values.reshape(shape), (1, 3)).reshape(values.shape)
    return values[..., : len(_ON)].mean(axis=2) - values[..., len(_ON) :].mean(axis=2)


def _clearness(is_there: np.ndarray, step: int) -> float:
    """Return by how many standard errors every step-th tick is there more often than others, at several distances."""
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
        clear = np.where((of_long >= _OF_LONG) & (of_others <= _OF_OTHERS), (of_long - of_others) / errors, 0.0)
        in_turn = np.lib.stride_tricks.sliding_window_view(clear, _ROWS).min(axis=1)
        best = max(best, float(in_turn.max()))
    return best


def expected(tick: Length) -> str:
    """Return which ticks are longer on a ruler whose smallest ticks are this far apart, or "" if that is not known."""
    inches = tick.within("in").value if tick.unit else 0.0
    millimetres = tick.within("mm").value if tick.unit else 0.0
    if inches <= 0:
        return ""
    if _is_near_whole(math.log2(inches)):
        return BINARY if inches < 1 else ""
    powers = (math.log10(millimetres / each) for each in (1, 2, 5))
    tenths = math.log10(inches)
    return DECIMAL if any(map(_is_near_whole, powers)) or _is_near_whole(tenths) else ""


def _is_near_whole(value: float) -> bool:
    return abs(value - round(value)) < 1e-3
