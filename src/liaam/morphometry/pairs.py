"""Pairs of landmarks on the two sides of an object: by their names, as text, or from a file."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from liaam.errors import LiaamError
from liaam.io.files import existing_file, some_names
from liaam.io.sides import WORD
from liaam.model.shape import mirror_order
from liaam.morphometry.measures import indices_of

OTHER_SIDE = {"left": "right", "right": "left", "l": "r", "r": "l"}

_TILT = 45.0  # maximum angle between the axis of symmetry and the vertical, in degrees
_ALIKE = 0.05
"""Maximum distance between a mirrored point and its twin, as a fraction of the shape's diagonal. It is generous,
because the user sees the result and can correct it."""

PAIR_SUFFIXES = (".csv", ".txt", ".tsv")

_REMEDY = "give pairs such as 1-2,3-4, or a .csv file with two landmarks in each row, by number from 1 or by name"


def twins_by_names(names: Sequence[str]) -> tuple[int, ...] | None:
    """Pair landmarks by names such as ``left_eye``, ``eye-R`` or ``LeftEye``.

    Parameters
    ----------
    names : sequence of str

    Returns
    -------
    tuple of int or None
        Index of each landmark's twin, its own if its name has no side. None if no name has a side, a name with a side
        has no partner, or two names differ only in their spelling.
    """
    keys = _keys(names)
    index = {key: i for i, key in enumerate(keys)}
    swapped = [_swapped(key) for key in keys]
    if len(index) < len(keys) or swapped == keys or not index.keys() >= {*swapped}:
        return None
    return tuple(index[key] for key in swapped)


def twins_by_place(points: ArrayLike) -> tuple[int, ...] | None:
    """Pair finite points (n, 2) by position, about the best axis within 45 degrees of the vertical, if there is one."""
    points = np.asarray(points, dtype=np.float64)
    if len(points) < 3:
        return None
    twins = mirror_order(points, _ALIKE, _TILT)
    return None if twins is None or (twins == np.arange(len(points))).all() else tuple(twins.tolist())


def without_partner(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names with a side of which there is none of the other side."""
    keys = _keys(names)
    return tuple(name for name, key in zip(names, keys, strict=True) if _swapped(key) not in keys)


def _keys(names: Sequence[str]) -> list[tuple[str, ...]]:
    return [tuple(word.casefold() for word in WORD.findall(name)) for name in names]


def _swapped(key: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(OTHER_SIDE.get(word, word) for word in key)


def parse_pairs(text: str, names: Sequence[str], n: int) -> tuple[int, ...]:
    """Read pairs of landmarks from text such as ``1-2,3-4``, or from a file.

    Parameters
    ----------
    text : str
        Pairs, or the name of a ``.csv`` file with two landmarks in each row. A first row that names no landmarks is its
        header.
    names : sequence of str
        Names of the landmarks, or empty.
    n : int
        Number of landmarks.

    Returns
    -------
    tuple of int
        Index of each landmark's twin, its own if it is in no pair.

    Raises
    ------
    LiaamError
        If the file cannot be read, a pair has not two different landmarks that exist, or a landmark is in two pairs.
    """
    if text.lower().endswith(PAIR_SUFFIXES) or Path(text).is_file():
        return _twins(text, _rows_of(Path(text), names, n), names, n)
    rows = [[part.strip() for part in pair.split("-")] for pair in text.split(",")]
    return _twins("--pairs", rows, names, n)


def _rows_of(path: Path, names: Sequence[str], n: int) -> list[list[str]]:
    """Return the rows of a file of pairs, without a header and empty rows."""
    content = existing_file(path, LiaamError, "file of pairs").read_text("utf-8-sig", "replace")
    form = "\t" if "\t" in content else ";" if ";" in content else ","
    rows = [[cell.strip() for cell in row] for row in csv.reader(content.splitlines(), delimiter=form)]
    rows = [row for row in rows if any(row)]
    known = {*names, *map(str, range(1, n + 1))}
    if rows and not known & {*rows[0]}:
        return rows[1:]
    return rows


def _twins(where: str, rows: Sequence[Sequence[str]], names: Sequence[str], n: int) -> tuple[int, ...]:
    twins = list(range(n))
    paired: dict[int, str] = {}
    for row in rows:
        pair = "-".join(row)
        if len(row) != 2 or not all(row):
            raise LiaamError(f"{where}: '{pair}' is no pair of landmarks; {_REMEDY}")
        first, second = indices_of(f"{where}, pair {pair}", row, names, n)
        if first == second:
            raise LiaamError(f"{where}: the pair {pair} names the same landmark twice; correct it")
        for index, label in zip((first, second), row, strict=True):
            if index in paired:
                raise LiaamError(f"{where}: landmark {label} is in the pairs {paired[index]} and {pair}; correct one")
            paired[index] = pair
        twins[first] = second
        twins[second] = first
    if not paired:
        raise LiaamError(f"{where} has no pairs; {_REMEDY}")
    return tuple(twins)


def pairs_text(twins: Sequence[int]) -> str:
    """Write twins as pairs of numbers counted from 1, such as ``1-2,3-4``."""
    return ",".join(f"{i + 1}-{twin + 1}" for i, twin in enumerate(twins) if i < twin)


def checked_twins(names: Sequence[str], mean: np.ndarray | None = None) -> tuple[int, ...]:
    """Pair landmarks by their names; an error says what names lack, and what their mean shape (k, 2) suggests.

    Raises
    ------
    LiaamError
        If there are no names, none has a side, or some have no partner.
    """
    twins = twins_by_names(names) if names else None
    if twins is not None:
        return twins
    found = None if mean is None else twins_by_place(mean)
    hint = "" if found is None else f". By their places, they may be {pairs_text(found)}"
    if not names:
        raise LiaamError(f"the landmarks have no names that tell pairs of left and right ones; {_REMEDY}{hint}")
    alone = without_partner(names)
    if alone:
        raise LiaamError(
            f"landmarks without a partner on the other side: {some_names(list(alone))}; rename them so that left and "
            f"right ones differ by these words only, or {_REMEDY}{hint}"
        )
    raise LiaamError(
        f"the names of the landmarks ({some_names(list(names), 4)}) tell no left and right ones; {_REMEDY}"
    )
