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

_WFLW = 5
"""Pairs of numbers of a box and of attributes."""

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
        if len(others) > 3 and not _is_value(words[at]) and all(map(_is_value, others)):
            return at
    return None


def _is_value(word: str) -> bool:
    return is_number(word) or word.lower() == "nan"


def parse(source: Source) -> list[Landmarks]:
    """Parse a line for each image."""
    lines = [_words(line) for line in source.lines]
    at = _name_at(lines[0])
    rows = [_pairs(words, at) for words in lines]
    sound = [pairs for pairs in rows if pairs is not None]
    whole = len(sound) == len(rows)
    last = _WFLW if whole and all(map(_has_attributes, sound)) else 0
    first = 2 if whole and not last and len(rows) >= _FEW and all(map(_has_box, sound)) else 0
    if first:
        source.notes.say("four numbers before the points are taken for a box around them", source.path.name)

    def make(line: tuple[list[str], np.ndarray | None]) -> Landmarks:
        words, pairs = line
        if at is None or pairs is None:
            raise LandmarkError("it has other parts than x y of landmarks and a name: correct it.")
        return Landmarks(pairs[first : len(pairs) - last], image_name=words[at])

    named = ((f"line {i}", line) for i, line in enumerate(zip(lines, rows, strict=True), 1))
    return list(source.each(named, make))


def _pairs(words: list[str], at: int | None) -> np.ndarray | None:
    """Return the numbers of a line as pairs, if its name is there and their number is even."""
    if _name_at(words) != at or len(words) % 2 == 0:
        return None
    return np.array(words[1:] if at == 0 else words[:-1], np.float64).reshape(-1, 2)


def _has_attributes(pairs: np.ndarray) -> bool:
    flags, box = {*pairs[-3:].flat}, pairs[-_WFLW:]
    return len(pairs) > _WFLW + 1 and flags <= {0.0, 1.0} and bool((box[0] < box[1]).all())


def _has_box(pairs: np.ndarray) -> bool:
    """Whether the first four numbers are a box around all points: two corners, or one and the size."""
    if len(pairs) < 2 + _FEW:
        return False
    corner, other, low, high = pairs[0], pairs[1], pairs[2:].min(axis=0), pairs[2:].max(axis=0)
    around = (other >= high).all() or (corner + other >= high).all()
    return bool((corner <= low).all() and around and (other > 0).all())
