"""Sides of specimens: which are left and which are right, and the reflection of one side onto the other."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from liaam.errors import LiaamError
from liaam.fitting.result import USABLE
from liaam.io.files import count_of, some_names
from liaam.io.sides import LEFT, OTHER_SIDE, RIGHT, Named, by_letters, by_word, contradiction, folder_side, side_of_text
from liaam.model.shape import align, procrustes_mean
from liaam.model.sides import MIRRORED, ORIGINAL, reflected_covariances
from liaam.morphometry.specimens import Specimen, has_shape

AUTO = "auto"
REFLECTED = "reflected"
IGNORED = "ignore"

_ADJECTIVES = (LEFT, RIGHT, ORIGINAL, MIRRORED)
SIDES = (AUTO, "left", "right", REFLECTED, IGNORED)
"""Choices of :func:`of_one_side` for sides that are left and right."""

_CLEARLY = 1.5  # least factor by which mean shapes must be nearer to each other as they are than reflected


def of_one_side(
    specimens: Sequence[Specimen], side: str = AUTO, by: str | None = None
) -> tuple[tuple[Specimen, ...], str]:
    """Reflect the specimens of one side, so that all can be compared.

    The side is that of a specimen (`Specimen.side`, from its fit, a column ``side`` or a folder ``left`` or ``right``),
    or else in its name: the word left or right (``wing1_left``, ``left/wing1``), or the last letter L or R
    (``wing1_L``, ``wing1R``) if all names have one. Fits by a model that does not know which of its sides is left are
    ``original`` and ``mirrored``; if all names say which is which, they are called left and right.

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
    named, against = _sides_of(specimens, by)
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
        return sided, against
    if side == REFLECTED:
        return _as_reflected(sided, sides[0]), against
    reflected_side = next(each for each in sides if each != side) if side in sides else sides[0]
    other = next(each for each in sides if each != reflected_side)
    if side == AUTO and _are_alike_as_they_are(sided, sides):
        said = (
            f"specimens of the sides {some_names(sides)} are compared as they are, since they are more alike than "
            f"reflected (side {other} reflects those of the side {reflected_side} nonetheless)"
        )
        return _as_reflected(sided, sides[0]), "; ".join(filter(None, (said, against)))
    n = sum(specimen.side == reflected_side for specimen in sided)
    were = "was" if n == 1 else "were"
    if reflected_side in _ADJECTIVES:
        done = f"{count_of(n, f'{reflected_side} specimen')} {were} reflected, to be compared with the {other} ones"
    else:  # what a column calls a side, such as 1
        count = f"{count_of(n, 'specimen')} of the side {reflected_side!r}"
        done = f"{count} {were} reflected, to be compared with {other!r}"
    said = "; ".join(filter(None, (done, against)))
    return tuple(reflected(each) if each.side == reflected_side else each for each in sided), said


def _as_reflected(specimens: Sequence[Specimen], side: str) -> tuple[Specimen, ...]:
    """Note that specimens of a side were reflected before."""
    return tuple(replace(each, reflected=each.side == side) for each in specimens)


def _are_alike_as_they_are(specimens: Sequence[Specimen], sides: Sequence[str]) -> bool:
    """Return whether the mean shapes of two sides are clearly more alike than if one is reflected.

    So are specimens that were reflected before, and photographs of symmetric objects from both sides.
    """
    whole = [each for each in specimens if each.is_usable and has_shape(each.points)]
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
        covariances = reflected_covariances(covariances)
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


def _sides_of(specimens: Sequence[Specimen], by: str | None) -> tuple[list[Named], str]:
    """Return the side of each specimen, and the name of the individual that it is of.

    Also return a sentence that names the specimens whose fits are of another side than their names say, or "".
    """
    in_names = _in_names(specimens, by)
    stated = [folder_side(each.image) or named.side for each, named in zip(specimens, in_names, strict=True)]
    called = _called(specimens, stated)
    found = []
    against = []
    for specimen, named, said in zip(specimens, in_names, stated, strict=True):
        side = called.get(specimen.side, side_of_text(specimen.side))
        found.append(Named(side or named.side, named.rest))
        if specimen.status in USABLE and said in OTHER_SIDE and side == OTHER_SIDE[said]:
            against.append(f"{specimen.name} ({contradiction(said, 'fit')})")
    if not against:
        return found, ""
    return found, f"fits of another side than the names, which is taken: {some_names(against)}; check these"


def _called(specimens: Sequence[Specimen], stated: Sequence[str]) -> dict[str, str]:
    """Return what the sides of fits that have no names are called, if names or folders of all specimens say so."""
    counts = Counter(zip((specimen.side for specimen in specimens), stated, strict=True))
    if set(stated) != {LEFT, RIGHT}:
        return {}
    n_right = counts[ORIGINAL, RIGHT] + counts[MIRRORED, LEFT]
    n_left = counts[ORIGINAL, LEFT] + counts[MIRRORED, RIGHT]
    return {ORIGINAL: RIGHT, MIRRORED: LEFT} if n_right >= n_left else {ORIGINAL: LEFT, MIRRORED: RIGHT}


def _in_names(specimens: Sequence[Specimen], by: str | None) -> list[Named]:
    """Return the side that the name of each specimen says, and the name of the individual that it is of."""
    objects = [object_name(specimen, by) for specimen in specimens]
    found = [by_word(name) for name in objects]
    if by not in (None, "image"):  # the side may also follow the number of the replicate, as in wing1_2_left
        for i, specimen in enumerate(specimens):
            whole = by_word(specimen.name)
            if whole.side and not found[i].side:
                found[i] = Named(whole.side, object_name(replace(specimen, name=whole.rest), by))
    return found if any(each.side for each in found) else by_letters(objects, found)
