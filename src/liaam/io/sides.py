"""Sides of individuals: what texts, folders and names of files say about them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

LEFT = "left"
RIGHT = "right"

OTHER_SIDE = {LEFT: RIGHT, RIGHT: LEFT}

# Names of sides that are not stated: that of most training images, and its mirror image
ORIGINAL = "original"
MIRRORED = "mirrored"

WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[^A-Za-z]+")
"""Words of a name, such as ``left``, ``_`` and ``eye`` of ``left_eye`` or ``Left`` and ``Eye`` of ``LeftEye``."""

_WORDS = {LEFT: LEFT, RIGHT: RIGHT}
_LETTERS = {"l": LEFT, "r": RIGHT}
_FOLDERS = _WORDS | _LETTERS

# Values of tables, in the languages of many collections; names of files in these are not searched for, since they are
# part of other words, such as the French "droit".
_VALUES = dict(_FOLDERS)
_VALUES |= dict.fromkeys(("links", "linke", "linker", "linkes", "gauche", "izquierda", "izquierdo", "izq"), LEFT)
_VALUES |= dict.fromkeys(("sinistra", "sinistro", "sin", "sinister", "esquerda", "esquerdo", "left side", "lt"), LEFT)
_VALUES |= dict.fromkeys(("rechts", "rechte", "rechter", "rechtes", "droite", "droit", "derecha", "derecho"), RIGHT)
_VALUES |= dict.fromkeys(("der", "destra", "destro", "dex", "dexter", "direita", "direito", "right side", "rt"), RIGHT)


class Named(NamedTuple):
    """What a name says: the side, or "", and the name without it."""

    side: str
    rest: str


def side_of_text(text: str) -> str:
    """Return ``left`` or ``right`` for texts such as ``Left``, ``L`` or ``links``, and other texts as they are."""
    return _VALUES.get(text.strip().casefold(), text.strip())


def stated_side(text: str) -> str:
    """Return the side that a text states; nothing for ``original`` and ``mirrored``, which were found by shapes."""
    side = side_of_text(text)
    return "" if side in (ORIGINAL, MIRRORED) else side


def contradiction(stated: str, found: str, by: str) -> str:
    """Return what is said of an object that is found to be of another side than stated, by its shape or its fit."""
    return f"stated {stated}, {found} by the {by}"


def folder_side(path: str) -> str:
    """Return the side of the folders of a path, such as ``left/wing1.jpg``, or ""."""
    return by_folder(path).side


def side_of_folder(name: str) -> str:
    """Return the side of a folder that is called left or right, or "": a letter may stand for something else."""
    return _WORDS.get(name.casefold(), "")


def by_folder(path: str) -> Named:
    """Find the side of the folders of a path, such as ``left/wing1``, if there is one."""
    *folders, name = re.split(r"[\\/]", path)
    sides = {_FOLDERS.get(folder.casefold(), "") for folder in folders} - {""}
    if len(sides) != 1:
        return Named("", path)
    return Named(sides.pop(), "/".join([*(each for each in folders if each.casefold() not in _FOLDERS), name]))


def in_places_or_names(paths: Sequence[str]) -> list[Named]:
    """Return what each path without suffix, such as ``left/wing1`` or ``wing1_left``, says; no side unless all have."""
    for found in ([by_folder(path) for path in paths], sides_in_names(paths)):
        if all(each.side for each in found):
            return found
    return [Named("", path) for path in paths]


def sides_by_place_or_name(paths: Sequence[str]) -> list[str]:
    """Return the side of each path without suffix, such as ``left/wing1`` or ``wing1_left``; "" unless all have one."""
    return [each.side for each in in_places_or_names(paths)]


def sides_in_names(names: Sequence[str]) -> list[Named]:
    """Return the side that each name says by the word left or right, or all names by the last letter L or R.

    Letters count only if all names have one, and both occur.
    """
    found = [by_word(name) for name in names]
    return found if any(each.side for each in found) else by_letters(names, found)


def by_letters(names: Sequence[str], otherwise: list[Named]) -> list[Named]:
    """Return what the last letters L and R of names say if all names have one and both occur; ``otherwise`` if not."""
    letters = [_by_letter(name) for name in names]
    if len({each.side for each in letters} - {""}) == 2 and all(each.side for each in letters):
        return letters
    return otherwise


def by_word(name: str) -> Named:
    """Find the word left or right in a name, if there is one of them, once."""
    words = WORD.findall(name)
    at = [i for i, word in enumerate(words) if word.casefold() in _WORDS]
    if len(at) != 1:
        return Named("", name)
    return Named(_WORDS[words[at[0]].casefold()], _without(words, at[0]))


def _by_letter(name: str) -> Named:
    """Find the letter L or R at the end of a name."""
    words = WORD.findall(name)
    if len(words) < 2 or words[-1].casefold() not in _LETTERS:
        return Named("", name)
    return Named(_LETTERS[words[-1].casefold()], _without(words, len(words) - 1))


def _without(words: Sequence[str], place: int) -> str:
    """Join words without one, and without the separators that were around it."""
    starts = [0, *accumulate(map(len, words))]
    name = "".join(words)
    before = name[: starts[place]].rstrip("_-. /\\")
    after = name[starts[place + 1] :]
    return before + after if before else after.lstrip("_-. /\\")
