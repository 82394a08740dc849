"""Whether a number is printed beside a scale bar: a few signs of one height in a line. It is not read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

_LEVELS = (0.7, 0.5, 0.3)  # of the bar's darkness above which pixels are of signs, which are thinner and so less dark
_AROUND = 220  # pixels around a bar that are looked at
_HEIGHTS = (5, 100)  # of signs, pixels
_FEWEST = 2  # signs: a digit, and letters of the unit that may touch each other
_MOST = 9  # signs of a number and its unit; a line of more is another text
_WIDE = 4.0  # greatest width of a sign, of its height: mm, whose letters touch
_LONG = 9.0  # greatest width of a number with its unit, of its height
_STEM = 0.25  # relative difference of a sign's extent and the bar's, below which the bar may be a stem of a letter
_FULL = 0.12  # least share of its box that a sign fills
_ALIKE = 0.45  # least height of a sign, of the other in the line: a small letter beside a digit
_LEVEL = 0.6  # least part of the height of the smaller of two signs in a line that is beside the other
_SPACED = 1.6  # greatest gap between them, of their height
_NEAR = 3.0  # greatest gap between the number and the bar, of its height


class _Sign(NamedTuple):
    """The box of a connected sign, in pixels along and across the bar."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def height(self) -> int:
        return self.bottom - self.top


def has_number(depth: np.ndarray, ends: np.ndarray) -> bool:
    """Return whether a number is beside a bar, of its colour and in its direction: above, below or at an end.

    Parameters
    ----------
    depth : (h, w) float32
        By how much pixels are darker than the ground.
    ends : (2, 2) float64
        Of the bar, x and y in pixels.
    """
    length = float(np.hypot(*(ends[1] - ends[0])))
    band = _along(depth, ends, length)
    row = _AROUND
    first = _AROUND
    last = _AROUND + round(length)
    of_bar_level = float(np.median(band[row, first : last + 1]))
    lines = [line for share in _LEVELS for line in _lines(_signs(band > share * of_bar_level, row, first, last))]
    texts = [_box_of(line) for line in lines if _is_text(line)]
    return any(
        _is_number(line, row, first, last) and not any(_is_in(_box_of(line), text) for text in texts) for line in lines
    )


def _signs(dark: np.ndarray, row: int, first: int, last: int) -> list[_Sign]:
    """Return the signs among the dark pixels around a bar, which is in a row from a first to a last column."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=8)
    of_bar = set(np.unique(labels[row - 1 : row + 2, first : last + 1]).tolist())
    return [
        _Sign(left, top, left + width, top + height)
        for i, (left, top, width, height, area) in enumerate(stats.tolist())
        if i not in of_bar
        and _HEIGHTS[0] <= height <= _HEIGHTS[1]
        and width <= _LONG * height  # else it is a stroke
        and area >= _FULL * width * height
    ]


def _box_of(line: Sequence[_Sign]) -> _Sign:
    """Return the box around a line of signs."""
    return _Sign(
        min(sign.left for sign in line),
        min(sign.top for sign in line),
        max(sign.right for sign in line),
        max(sign.bottom for sign in line),
    )


def _is_text(line: Sequence[_Sign]) -> bool:
    """Whether a line of signs is too long for a number with its unit: some of its letters may be faint."""
    box = _box_of(line)
    return len(line) > _MOST or (len(line) > _FEWEST and box.right - box.left > _LONG * box.height)


def _is_in(box: _Sign, other: _Sign) -> bool:
    """Whether the middle of a box lies in another."""
    across = other.left <= (box.left + box.right) / 2 <= other.right
    return across and other.top <= (box.top + box.bottom) / 2 <= other.bottom


def _along(depth: np.ndarray, ends: np.ndarray, length: float) -> np.ndarray:
    """Return the surroundings of a bar, turned so that it is horizontal: its first end is at `_AROUND`, `_AROUND`."""
    angle = math.atan2(*(ends[1] - ends[0])[::-1])
    along = np.arange(-_AROUND, length + _AROUND)
    across = np.arange(-_AROUND, _AROUND + 1)[:, None]
    x = ends[0][0] + along * math.cos(angle) - across * math.sin(angle)
    y = ends[0][1] + along * math.sin(angle) + across * math.cos(angle)
    maps = (x.astype(np.float32), y.astype(np.float32))
    return cv2.remap(depth, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def _lines(signs: Sequence[_Sign]) -> list[list[_Sign]]:
    """Group signs into lines."""
    lines: list[list[_Sign]] = []
    for sign in sorted(signs, key=lambda sign: sign.left):
        line = next((line for line in lines if any(_follows(sign, other) for other in line)), None)
        if line is None:
            lines.append([sign])
        else:
            line.append(sign)
    return lines


def _follows(sign: _Sign, other: _Sign) -> bool:
    """Whether a sign is beside another to its left, in one line of text."""
    larger = max(sign.height, other.height)
    is_alike = min(sign.height, other.height) >= _ALIKE * larger
    shared = min(sign.bottom, other.bottom) - max(sign.top, other.top)
    is_level = shared >= _LEVEL * min(sign.height, other.height)
    return is_alike and is_level and sign.left - other.right <= _SPACED * larger


def _is_number(line: Sequence[_Sign], row: int, first: int, last: int) -> bool:
    """Whether a line of signs is a number beside a bar, which is in a row from a first to a last column."""
    if not _FEWEST <= len(line) <= _MOST:
        return False
    left, top, right, bottom = _box_of(line)
    height = max(sign.height for sign in line)
    has_letters_like_it = any(abs((sign.right - sign.left) / (last - first) - 1) < _STEM for sign in line)
    has_words = any(sign.right - sign.left > _WIDE * sign.height for sign in line)
    if has_letters_like_it or has_words or right - left > _LONG * height:
        return False
    away = max(top - row, row - bottom, 0)
    beyond = max(left - last, first - right, 0)
    is_beside = away <= _NEAR * height and first <= (left + right) / 2 <= last
    is_at_end = away <= 0.5 * height and 0 < beyond <= _NEAR * height
    return is_beside or is_at_end
