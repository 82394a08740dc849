"""Lists of images (``.txt``, ``.csv``): a line has x y of all landmarks, and the image's name first or last.

Pixel centres counted from 0, x to the right and y downwards. Lines of WFLW also have a box and six attributes of 0 or 1
before the name, which are skipped.
"""

import re

from liaam.errors import LandmarkError
from liaam.io.files import is_number
from liaam.io.landmarks.base import Landmarks, Source, in_objects, make_landmarks, parse_number

_WFLW = 10
"""Numbers of a box and of attributes."""


def is_it(source: Source) -> bool:
    """Whether lines have at least two landmarks and one name."""
    return bool(source.lines) and all(_name_at(_words(line)) is not None for line in source.lines[:20])


def _words(line: str) -> list[str]:
    return [word for word in re.split(r"[\s,;]+", line) if word]


def _name_at(words: list[str]) -> int | None:
    """Return the index of the name, the first or last word, if all others are numbers."""
    for at, others in ((0, words[1:]), (-1, words[:-1])):
        if len(others) > 3 and not is_number(words[at]) and all(is_number(word) for word in others):
            return at
    return None


def parse(source: Source) -> dict[str, Landmarks]:
    """Parse a line for each image."""
    path, lines = source.path, [_words(line) for line in source.lines]
    at = _name_at(lines[0])
    numbers = [words[1:] if at == 0 else words[:-1] for words in lines]
    skipped = _WFLW if all(map(_has_attributes, numbers)) else 0

    def make(words: list[str]) -> Landmarks:
        if _name_at(words) != at:
            raise LandmarkError(f"{path}: a line has other parts than x y of landmarks and a name: correct it.")
        name, own = (words[0], words[1:]) if at == 0 else (words[-1], words[:-1])
        values = [parse_number(path, word, f"the line of '{name}'") for word in own[: len(own) - skipped]]
        if len(values) % 2:
            raise LandmarkError(f"{path}: the line of '{name}' has {len(values)} numbers, not x y of each: correct it.")
        return make_landmarks(path, list(zip(values[::2], values[1::2], strict=True)), image_name=name)

    records = ((f"line {i}", words) for i, words in enumerate(lines, 1))
    return in_objects(source.each(records, make))


def _has_attributes(numbers: list[str]) -> bool:
    if len(numbers) < _WFLW + 4 or len(numbers) % 2 or not all(map(is_number, numbers)):
        return False
    left, top, right, bottom = map(float, numbers[-_WFLW:-6])
    return set(numbers[-6:]) <= {"0", "1"} and left < right and top < bottom
