"""Lists of images (``.txt``, ``.csv``): a line has x y of all landmarks, and the image's name first or last.

Pixel centres counted from 0, x to the right and y downwards. Lines of WFLW also have a box and six attributes of 0 or 1
before the name, which are skipped, as is a box around all points before them.
"""

import re

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import is_number
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import decimal

_WFLW = 10
"""Numbers of a box and of attributes."""

_SEPARATORS = r"\t;", r"\t,;", r"\s,;"
_FEW = 3
"""Least number of lines, and of points in each, to tell boxes from landmarks."""


def is_it(source: Source) -> bool:
    """Whether lines have at least two landmarks and one name."""
    return bool(source.lines) and all(_name_at(_words(line)) is not None for line in source.lines[:20])


def _words(line: str) -> list[str]:
    """Split a line; a name may hold blanks if others separate, and commas may be decimal if these do not."""
    tabbed, marked, every = ([word.strip() for word in re.split(f"[{by}]", line) if word.strip()] for by in _SEPARATORS)
    words = [decimal(cell) for cell in tabbed]
    if words != tabbed:
        return words
    return every if _name_at(marked) is None else marked


def _name_at(words: list[str]) -> int | None:
    """Return the index of the name, the first or last word, if all others are numbers."""
    for at, others in ((0, words[1:]), (-1, words[:-1])):
        if len(others) > 3 and not is_number(words[at]) and all(map(is_number, others)):
            return at
    return None


def parse(source: Source) -> list[Landmarks]:
    """Parse a line for each image."""
    lines = [_words(line) for line in source.lines]
    at = _name_at(lines[0])
    numbers = [words[1:] if at == 0 else words[:-1] for words in lines]
    skipped = _WFLW if all(map(_has_attributes, numbers)) else 0
    box = 0 if skipped or len(lines) < _FEW or not all(map(_has_box, numbers)) else 4
    if box:
        source.notes.say("four numbers before the points are taken for a box around them", source.path.name)

    def make(pair: tuple[list[str], list[str]]) -> Landmarks:
        words, own = pair
        if at is None or _name_at(words) != at or len(own) % 2:
            raise LandmarkError("it has other parts than x y of landmarks and a name: correct it.")
        values = np.array(own[box : len(own) - skipped], np.float64)
        return Landmarks(values.reshape(-1, 2), image_name=words[at])

    pairs = enumerate(zip(lines, numbers, strict=True), 1)
    return list(source.each(((f"line {i}", pair) for i, pair in pairs), make))


def _numbers(words: list[str], least: int) -> np.ndarray | None:
    """Return pairs of numbers, if there are so many."""
    if len(words) < least or len(words) % 2 or not all(map(is_number, words)):
        return None
    return np.array(words, np.float64).reshape(-1, 2)


def _has_attributes(words: list[str]) -> bool:
    pairs = _numbers(words, _WFLW + 4)
    return pairs is not None and set(words[-6:]) <= {"0", "1"} and bool((pairs[-5] < pairs[-4]).all())


def _has_box(words: list[str]) -> bool:
    """Whether the first four numbers are a box around all points: two corners, or one and the size."""
    pairs = _numbers(words, 4 + 2 * _FEW)
    if pairs is None:
        return False
    corner, other, low, high = pairs[0], pairs[1], pairs[2:].min(axis=0), pairs[2:].max(axis=0)
    around = (other >= high).all() or (corner + other >= high).all()
    return bool((corner <= low).all() and around and (other > 0).all())
