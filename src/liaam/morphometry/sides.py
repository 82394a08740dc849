"""Sides of specimens: which are left and which are right, and the reflection of one side onto the other."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from liaam.errors import LiaamError
from liaam.fitting.result import USABLE
from liaam.io.files import count_of, some_names
from liaam.model.shape import align, procrustes_mean
from liaam.morphometry.pairs import WORD
from liaam.morphometry.specimens import Specimen, has_shape

AUTO = "auto"
REFLECTED = "reflected"
IGNORED = "ignore"

SIDES = (AUTO, "left", "right", REFLECTED, IGNORED)
"""Choices of :func:`of_one_side` for sides that are left and right."""

_CLEARLY = 1.5  # least factor by which mean shapes must be nearer to each other as they are than reflected

_WORDS = {"left": "left", "right": "right"}
_LETTERS = {"l": "left", "r": "right"}


class _Named(NamedTuple):
    """What a name tells: the side, or "", and the name without it."""

    side: str
    rest: str


def of_one_side(
    specimens: Sequence[Specimen], side: str = AUTO, by: str | None = None
) -> tuple[tuple[Specimen, ...], str]:
    """Reflect the specimens of one side, so that all can be compared.

    The side is that of a specimen (`Specimen.side`, from a column ``side`` or from a folder ``left`` or ``right``), or
    else in its name: the word left or right (``wing1_left``, ``left/wing1``), or the last letter L or R (``wing1_L``,
    ``wing1R``) if all names have one.

    Parameters
    ----------
    specimens : sequence of Specimen
        As :func:`liaam.morphometry.alike` gives them.
    side : str
        ``"auto"``: reflect the left ones, or the first of two other sides, if there are both, unless the sides are
        clearly more alike as they are. ``"left"`` or ``"right"``: reflect the others, so that all are as this side.
        ``"reflected"``: there are sides, but they were reflected before. ``"ignore"``: the names tell no sides.
    by : str, optional
        What tells replicates, as in :func:`liaam.morphometry.measurement_error`.

    Returns
    -------
    specimens : tuple of Specimen
        With `side` and `individual`, which is the name without side and number of the replicate, where sides are known.
    said : str
        What was done, empty if nothing.

    Raises
    ------
    LiaamError
        If the specimens have two sides and some have none, there are more sides, or none is that asked for.
    """
    specimens = tuple(specimens)
    if side == IGNORED:
        return tuple(replace(specimen, side="") for specimen in specimens), ""
    named = _sides_of(specimens, by)
    sides = sorted({each.side for each in named} - {""})
    if side not in (AUTO, REFLECTED) and side not in sides:
        what = f"the specimens are of the sides {some_names(sides)}" if sides else "no specimen has a known side"
        raise LiaamError(f"--side {side}: {what}; give auto, {REFLECTED}, {IGNORED}, or one of them")
    if not sides:
        return specimens, ""
    sided = tuple(
        replace(specimen, side=each.side, individual=specimen.individual or each.rest)
        for specimen, each in zip(specimens, named, strict=True)
    )
    if len(sides) > 2:
        raise LiaamError(f"the specimens have more than two sides ({some_names(sides)}): correct the column 'side'")
    unknown = [specimen.name for specimen in sided if not specimen.side]
    if unknown and len(sides) == 2:
        raise LiaamError(
            f"{len(unknown)} of {len(sided)} specimens have no side ({some_names(unknown)}), and others are "
            f"{' and '.join(sides)}, which cannot be compared unreflected: name their sides as those of the others, "
            f"such as wing1_left, or give --side {IGNORED} if the names tell no sides"
        )
    if len(sides) < 2:
        return sided, ""
    if side == REFLECTED:
        return _as_reflected(sided, sides[0]), ""
    reflected_side = next(each for each in sides if each != side) if side in sides else sides[0]
    other = next(each for each in sides if each != reflected_side)
    if side == AUTO and _are_alike_as_they_are(sided, sides):
        said = (
            f"specimens of the sides {some_names(sides)} are compared as they are, since they are more alike than "
            f"reflected: --side {other} reflects those of the side {reflected_side} nonetheless"
        )
        return _as_reflected(sided, sides[0]), said
    n = sum(specimen.side == reflected_side for specimen in sided)
    said = f"{count_of(n, 'specimen')} of the side {reflected_side} reflected, to be compared with the side {other}"
    return tuple(reflected(each) if each.side == reflected_side else each for each in sided), said


def _as_reflected(specimens: Sequence[Specimen], side: str) -> tuple[Specimen, ...]:
    """Note that specimens of a side were reflected before."""
    return tuple(replace(each, reflected=each.side == side) for each in specimens)


def _are_alike_as_they_are(specimens: Sequence[Specimen], sides: Sequence[str]) -> bool:
    """Return whether the mean shapes of two sides are clearly more alike than if one is reflected.

    So are specimens that were reflected before, and photographs of symmetric objects from both sides.
    """
    usable = {"", *USABLE}
    whole = [each for each in specimens if each.status in usable and has_shape(each.points)]
    whole = [each for each in whole if len(each.points) == len(whole[0].points)]
    first = [each.points for each in whole if each.side == sides[0]]
    second = [each.points for each in whole if each.side == sides[1]]
    if not first or not second:
        return False
    one = procrustes_mean(np.array(first))
    other = procrustes_mean(np.array(second))
    return _CLEARLY * _distance(one, other) < _distance(one * [-1.0, 1.0], other)


def _distance(shape: np.ndarray, target: np.ndarray) -> float:
    """Root of the sum of squared distances of a shape (k, 2), moved by the best similarity, from a target."""
    return float(np.linalg.norm(align(shape, target)(shape) - target))


def are_unreflected(specimens: Iterable[Specimen]) -> bool:
    """Return whether specimens are of several sides, none of which was reflected."""
    specimens = tuple(specimens)
    return len({each.side for each in specimens} - {""}) > 1 and not any(each.reflected for each in specimens)


def reflected(specimen: Specimen) -> Specimen:
    """Reflect the landmarks of a specimen, and their covariances: x becomes −x."""
    covariances = specimen.covariances
    if covariances is not None:
        covariances = np.asarray(covariances) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    points = specimen.points * [-1.0, 1.0]
    return replace(specimen, points=points, covariances=covariances, reflected=not specimen.reflected)


def object_name(specimen: Specimen, by: str | None) -> str:
    """Return the name of the object that a specimen is a record of, which its replicates have in common."""
    if by is None:
        return specimen.name
    if by == "image":
        return specimen.replicate_of or specimen.name.rpartition("#")[0] or specimen.name
    if by == "code":
        return specimen.code or specimen.name
    image, number = image_and_number(specimen, by)
    return ((by and image.rpartition(by)[0]) or image) + number


def image_and_number(specimen: Specimen, by: str) -> tuple[str, str]:
    """Return the name of the image of a specimen, and its number there with ``#``, or "" if it has none.

    A number that has the text before numbers of replicates in it is part of the name, as it is if the image is unknown.
    """
    name = specimen.replicate_of or specimen.name
    image, mark, number = name.rpartition("#")
    is_number = mark and by not in f"#{number}" and (specimen.image or specimen.replicate_of)
    return (image, f"#{number}") if is_number else (name, "")


def refuse_uneven(specimens: Iterable[Specimen], by: str | None) -> None:
    """Raise if photographs of the same specimens have different numbers of them.

    Parameters
    ----------
    specimens : iterable of Specimen
    by : str, optional
        As for :func:`liaam.morphometry.measurement_error`.
    """
    if by in (None, "", "image", "code"):
        return
    numbers: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for specimen in specimens:
        if not specimen.code:
            image, number = image_and_number(specimen, by)
            numbers[image.rpartition(by)[0] or image][image].add(number)
    for images in numbers.values():
        first, *others = images
        for other in others:
            if images[other] != images[first]:
                counts = f"{first} has {len(images[first])} specimens and {other} {len(images[other])}"
                raise LiaamError(
                    f"{counts}, so that positions do not identify replicates: name them by codes "
                    "('liaam fit --all --name-by code', and --replicates code), or leave out these images"
                )


def structure_name(specimen: Specimen, by: str | None) -> str:
    """Return the name of the individual that a specimen is of, and its side if known: its replicates have both."""
    return " ".join(filter(None, (specimen.individual or object_name(specimen, by), specimen.side)))


def folder_side(path: str) -> str:
    """Return the side of the folders of a path, such as ``left/wing1.jpg``, or ""."""
    folders = re.split(r"[\\/]", path)[:-1]
    sides = {(_WORDS | _LETTERS).get(folder.casefold(), "") for folder in folders} - {""}
    return sides.pop() if len(sides) == 1 else ""


def side_of_text(text: str) -> str:
    """Return ``left`` or ``right`` for texts such as ``Left`` or ``L``, and other texts as they are."""
    key = text.strip().casefold()
    return (_WORDS | _LETTERS).get(key, text.strip())


def _sides_of(specimens: Sequence[Specimen], by: str | None) -> list[_Named]:
    """Return the side of each specimen, and the name of the individual that it is of."""
    objects = [object_name(specimen, by) for specimen in specimens]
    found = [_by_word(name) for name in objects]
    if by not in (None, "image"):  # the side may also follow the number of the replicate, as in wing1_2_left
        for i, specimen in enumerate(specimens):
            whole = _by_word(specimen.name)
            if whole.side and not found[i].side:
                found[i] = _Named(whole.side, object_name(replace(specimen, name=whole.rest), by))
    if not any(each.side for each in found):
        letters = [_by_letter(name) for name in objects]
        if len({each.side for each in letters} - {""}) == 2 and all(each.side for each in letters):
            found = letters
    return [
        _Named(side_of_text(specimen.side), each.rest) if specimen.side else each
        for specimen, each in zip(specimens, found, strict=True)
    ]


def _by_word(name: str) -> _Named:
    """Find the word left or right in a name, if there is one of them, once."""
    words = WORD.findall(name)
    at = [i for i, word in enumerate(words) if word.casefold() in _WORDS]
    if len(at) != 1:
        return _Named("", name)
    return _Named(_WORDS[words[at[0]].casefold()], _without(words, at[0]))


def _by_letter(name: str) -> _Named:
    """Find the letter L or R at the end of a name."""
    words = WORD.findall(name)
    if len(words) < 2 or words[-1].casefold() not in _LETTERS:
        return _Named("", name)
    return _Named(_LETTERS[words[-1].casefold()], _without(words, len(words) - 1))


def _without(words: Sequence[str], place: int) -> str:
    """Join words without one, and without the separators that were around it."""
    starts = [0, *accumulate(map(len, words))]
    name = "".join(words)
    before = name[: starts[place]].rstrip("_-. /\\")
    after = name[starts[place + 1] :]
    return before + after if before else after.lstrip("_-. /\\")
