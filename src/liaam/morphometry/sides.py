"""Sides of specimens: which are left and which are right, and the reflection of one side onto the other."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from liaam.datasets.sides import (
    FEWEST_COMMON,
    are_upside_down,
    mirrored_shapes,
    others_by_shape,
    refuse_many_against,
)
from liaam.errors import LiaamError
from liaam.fitting.result import USABLE
from liaam.io.files import count_of, some_names
from liaam.io.sides import LEFT, OTHER_SIDE, RIGHT, Named, by_letters, by_word, contradiction, folder_side, side_of_text
from liaam.model.shape import align, procrustes_mean
from liaam.model.sides import MIRRORED, ORIGINAL, OTHER, reflected_covariances
from liaam.morphometry.specimens import Specimen, has_shape

AUTO = "auto"
REFLECTED = "reflected"
IGNORED = "ignore"

_ADJECTIVES = (LEFT, RIGHT, ORIGINAL, MIRRORED)
SIDES = (AUTO, "left", "right", REFLECTED, IGNORED)
"""Choices of :func:`of_one_side` for sides that are left and right."""

SHOWN = 6  # specimens that a message names
_CLEARLY = 1.5  # least factor by which mean shapes must be nearer to each other as they are than reflected


def of_one_side(
    specimens: Sequence[Specimen], side: str = AUTO, by: str | None = None, strict: bool = False
) -> tuple[tuple[Specimen, ...], str]:
    """Reflect the specimens of one side, so that all can be compared.

    The side is that of a specimen (`Specimen.side`, from its fit, a column ``side`` or a folder ``left`` or ``right``),
    or else in its name: the word left or right (``wing1_left``, ``left/wing1``), or the last letter L or R
    (``wing1_L``, ``wing1R``) if all names have one. Fits by a model that does not know which of its sides is left are
    ``original`` and ``mirrored``; if all names say which is which, they are called left and right.

    Landmarks on a mirrored object cannot be those of the other side, so sides are compared with the shapes, as in
    training (:func:`liaam.datasets.sides.sides_of_shapes`). If a fit or a shape clearly contradicts the side that is
    stated, its own side is taken, and `Specimen.stated_side` keeps the stated one. By it,
    :func:`liaam.morphometry.asymmetry` leaves individuals out.

    Where nothing states sides, shapes that are clearly mirrored against most others are reflected, too: they cannot be
    compared otherwise. Their side is then ``mirrored``, and that of the others ``original``.

    Two specimens of one image, one of each side, are of one individual where nothing else states individuals.

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
    strict : bool
        Raise if a fit or a shape contradicts the side that is stated.

    Returns
    -------
    specimens : tuple of Specimen
        With `side` and `individual`, which is the name without side and number of the replicate, where sides are known.
    said : str
        What was done, and which sides are contradicted; empty if nothing.

    Raises
    ------
    LiaamError
        If the specimens have two sides and some have none, there are more sides, or none is that asked for; if shapes
        contradict more than a quarter of the sides; or, if ``strict``, any.
    """
    specimens = tuple(specimens)
    if side == IGNORED:
        return tuple(replace(specimen, side="", stated_side="") for specimen in specimens), ""
    named, by_fit = _sides_of(specimens, by)
    sides = sorted({each.side for each in named} - {""})
    if side not in (AUTO, REFLECTED) and side not in sides:
        what = f"the specimens are of the sides {some_names(sides)}" if sides else "no specimen has a known side"
        raise LiaamError(f"--side {side}: {what}; give auto, {REFLECTED}, {IGNORED}, or one of them")
    if not sides:
        found, said = _reflected_by_shape(specimens)
        return _of_images_with_both_sides(found, by), said
    _refuse_incomplete_column(specimens, named)
    sided = tuple(
        replace(specimen, side=each.side, individual=specimen.individual or each.rest, stated_side=by_fit.get(i, ""))
        for i, (specimen, each) in enumerate(zip(specimens, named, strict=True))
    )
    if len(sides) > 2:
        files = some_names(sorted({each.file for each in sided} - {""}))
        refuse_odd_sides([each.name for each in sided], [each.side for each in sided], files)
    unknown = [specimen.name for specimen in sided if not specimen.side]
    if unknown and len(sides) == 2:
        raise LiaamError(
            f"{len(unknown)} of {len(sided)} specimens have no side ({some_names(unknown)}), and others are "
            f"{' and '.join(sides)}, which cannot be compared unreflected: name their sides as those of the others, "
            f"such as wing1_left, or give --side {IGNORED} if the names tell no sides"
        )
    kept = side if side in sides else sides[-1]
    turned = sides[sides[0] == kept] if len(sides) == 2 else OTHER.get(kept, "")
    is_alike = side == AUTO and len(sides) == 2 and _are_alike_as_they_are(sided, sides)
    if side == REFLECTED or is_alike:
        done = ""
        if is_alike:
            done = (
                f"specimens of the sides {some_names(sides)} are compared as they are, since they are more alike than "
                f"reflected (side {kept} reflects those of the side {turned} nonetheless)"
            )
        found, against = _reflected_as_most(sided)
        found = tuple(replace(each, reflected=len(sides) == 2 and each.side == sides[0]) for each in found)
    else:
        sided, against = _of_sides_by_shape(sided, kept, turned)
        done = _reflection_said([each.side for each in sided].count(turned), kept, turned)
        found = tuple(reflected(each) if each.side == turned else each for each in sided)
    found = _of_images_with_both_sides(found, by)
    fits = {i: contradiction(stated, sided[i].side, "fit") for i, stated in by_fit.items()}
    doubts = _doubts([(sided[i].name, why) for i, why in sorted((fits | against).items())])
    if doubts and strict:
        raise LiaamError(doubts)
    return found, "; ".join(filter(None, (done, doubts)))


def refuse_odd_sides(names: Sequence[str], sides: Sequence[str], where: str = "") -> None:
    """Raise if specimens of these names have more than two sides, and name the odd ones; ``where`` is their file."""
    counts = Counter(filter(None, sides))
    if len(counts) <= 2:
        return
    usual = [LEFT, RIGHT] if {LEFT, RIGHT} & {*counts} else [side for side, _ in counts.most_common(2)]
    odd = [f"{name} ('{side}')" for name, side in zip(names, sides, strict=True) if side and side not in usual]
    raise LiaamError(
        f"{where}{': ' if where else ''}the specimens have more than two sides. The side of {some_names(odd)} is "
        f"neither {' nor '.join(usual)}: correct the column 'side'"
    )


def _refuse_incomplete_column(specimens: Sequence[Specimen], named: Sequence[Named]) -> None:
    """Raise if a table states which side is left for only some fits by a model that does not know it."""
    unnamed = [
        each
        for each, found in zip(specimens, named, strict=True)
        if each.is_usable and found.side in (ORIGINAL, MIRRORED)
    ]
    bare = [each.name for each in unnamed if not each.stated_side]
    if bare and len(bare) < len(unnamed):
        raise LiaamError(
            f"{len(bare)} of {count_of(len(unnamed), 'specimen')} have no side in the column 'side' of your table, and "
            f"others have: {some_names(bare)}; the fits do not say which side is left, as training did not know it: "
            f"complete the column, or remove it (sides are then {ORIGINAL} and {MIRRORED})"
        )


def _of_images_with_both_sides(specimens: tuple[Specimen, ...], by: str | None) -> tuple[Specimen, ...]:
    """Return specimens of which the two in one image, one of each side, are of one individual, named by the image.

    So it is only if nothing states individuals, some image has both sides, and none has two of one side.
    """
    images = [image_and_number(each, by or "image")[0] for each in specimens]
    in_image: dict[str, list[str]] = defaultdict(list)
    for image, each in zip(images, specimens, strict=True):
        in_image[image].append(each.side)
    are_pairs = all(len(set(sides)) == len(sides) for sides in in_image.values())
    n_most = max(map(len, in_image.values()), default=0)
    are_named = any(each.individual not in ("", object_name(each, by)) for each in specimens)
    if not are_pairs or n_most != 2 or are_named:
        return specimens
    by_number = by not in (None, "", "image", "code", "individual")
    return tuple(
        replace(each, individual=(by_number and image.rpartition(str(by))[0]) or image)
        for image, each in zip(images, specimens, strict=True)
    )


def _reflected_by_shape(specimens: tuple[Specimen, ...]) -> tuple[tuple[Specimen, ...], str]:
    """Reflect specimens that are clearly mirrored against most others, where nothing states sides; say which."""
    n = max((len(each.points) for each in specimens), default=0)
    compared = [i for i, each in enumerate(specimens) if _shows_side(each, n)]
    if not compared:
        return specimens, ""
    shapes = np.array([specimens[i].measured for i in compared])
    is_mirrored = mirrored_shapes(shapes)
    if not is_mirrored.any():
        return specimens, ""
    is_upside_down = are_upside_down(shapes, is_mirrored)
    found = list(specimens)
    for i, mirrored in zip(compared, is_mirrored.tolist(), strict=True):
        own = reflected(found[i]) if mirrored else found[i]
        found[i] = own if is_upside_down else replace(own, side=MIRRORED if mirrored else ORIGINAL)
    names = [specimens[i].name for i in np.array(compared)[is_mirrored].tolist()]
    were = "is mirrored by its shape, and was" if len(names) == 1 else "are mirrored by their shapes, and were"
    cause = (
        "state the sides of left and right structures (a column 'side', folders left and right, or names such as "
        "wing1_left), and flip back photographs that were flipped"
    )
    if is_upside_down:
        cause = "y of these seems to count from the other border: correct it"
    everyone = " (all have the side 'mirrored' in the table)" if len(names) > SHOWN + 1 and not is_upside_down else ""
    return tuple(found), (
        f"{len(names)} of {count_of(len(specimens), 'specimen')} {were} reflected, to be compared with the others: "
        f"{some_names(names, SHOWN)}{everyone}; {cause}, or give --side {IGNORED} to compare all as they are"
    )


def _reflection_said(n: int, kept: str, turned: str) -> str:
    """Say that n specimens of a side were reflected; nothing if there are none."""
    if n == 0:
        return ""
    were = "was" if n == 1 else "were"
    if turned in _ADJECTIVES:
        return f"{count_of(n, f'{turned} specimen')} {were} reflected, to be compared with the {kept} ones"
    count = f"{count_of(n, 'specimen')} of the side {turned!r}"  # what a column calls a side, such as 1
    return f"{count} {were} reflected, to be compared with {kept!r}"


def _of_sides_by_shape(
    specimens: Sequence[Specimen], kept: str, turned: str
) -> tuple[tuple[Specimen, ...], dict[int, str]]:
    """Return specimens with the sides of their shapes, and what contradicts the sides that are stated, by index."""
    if not turned:
        return tuple(specimens), {}
    found = list(specimens)
    against = {}
    for i in _against_shapes(specimens, turned):
        stated = found[i].side
        by_shape = kept if stated == turned else turned
        found[i] = replace(found[i], side=by_shape, stated_side=stated)
        against[i] = contradiction(stated, by_shape, "shape")
    return tuple(found), against


def _reflected_as_most(specimens: Sequence[Specimen]) -> tuple[tuple[Specimen, ...], dict[int, str]]:
    """Return specimens that were reflected before, with those reflected that were not, and what is said of these."""
    found = list(specimens)
    against = {}
    for i in _against_shapes(specimens, turned=""):
        found[i] = replace(reflected(found[i]), stated_side=found[i].side)
        against[i] = "mirrored, unlike most others"
    return tuple(found), against


def _against_shapes(specimens: Sequence[Specimen], turned: str) -> list[int]:
    """Return the specimens whose shapes contradict their sides, of which one is turned against the other, by index."""
    n = max((len(each.points) for each in specimens), default=0)
    compared = [i for i, each in enumerate(specimens) if each.side and _shows_side(each, n)]
    if not compared:
        return []
    is_turned = np.array([specimens[i].side == turned for i in compared])
    by_shape, _ = others_by_shape(np.array([specimens[i].measured for i in compared]), is_turned)
    if by_shape is None:
        return []
    against = [compared[j] for j in np.flatnonzero(by_shape != is_turned).tolist()]
    otherwise = f", or give --side {IGNORED} if these are no sides"
    refuse_many_against([specimens[i].name for i in against], len(compared), "specimen", otherwise)
    return against


def _shows_side(specimen: Specimen, n: int) -> bool:
    """Return whether a specimen has enough of n landmarks, not all in one place, to be compared with others."""
    if not specimen.is_usable or len(specimen.points) != n:
        return False
    known = specimen.measured[np.isfinite(specimen.measured).all(axis=1)]
    return len(known) >= FEWEST_COMMON and bool(np.ptp(known, axis=0).any())


def _doubts(against: Sequence[tuple[str, str]]) -> str:
    """Say which specimens, by name, have another side than stated, and what to do; nothing if there are none."""
    if not against:
        return ""
    listed = some_names([f"{name} ({why})" for name, why in against])
    return (
        f"{count_of(len(against), 'specimen')} of another side than stated: {listed}. The side of the fit or the shape "
        "is taken. If the name, folder or column 'side' is wrong, correct it; if the landmarks are, place them again, "
        "or fit with --side; if the photograph is flipped, flip it back, and fit it or place its landmarks again"
    )


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
    if by == "individual":
        return specimen.individual or specimen.name
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
    if by in (None, "", "image", "code", "individual"):
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
    """Return the name of the individual that a specimen is of, and its side if known: its replicates have both.

    The side is that which is stated, as records of a structure are named alike, whether its photographs are flipped.
    One whose name states the other side than a column, as of a wing that was flipped, is a structure of its own.
    """
    side = specimen.stated_side or specimen.side
    named = by_word(specimen.name).side
    if named and OTHER_SIDE.get(named) == side:
        side = f"{side} named {named}"
    return " ".join(filter(None, (individual_name(specimen, by), side)))


def individual_name(specimen: Specimen, by: str | None) -> str:
    """Return the name of the individual that a specimen is of; if none is stated, its own without the replicate."""
    return specimen.individual or object_name(specimen, by)


def individuals_of(specimens: Iterable[Specimen], by: str | None = None) -> tuple[str, ...]:
    """Return the individual that each specimen is a record of: records of one individual are not independent.

    It is stated, or follows from what tells sides and replicates (:func:`of_one_side`), as do the objects of an image
    that has several records. A specimen of which nothing is known is its own individual.

    Parameters
    ----------
    specimens : iterable of Specimen
        As :func:`of_one_side` gives them.
    by : str, optional
        What tells replicates, as in :func:`liaam.morphometry.measurement_error`.
    """

    def individual_of(specimen: Specimen) -> str:
        if by is None and not specimen.individual:
            return specimen.replicate_of or specimen.name
        return individual_name(specimen, by)

    return tuple(map(individual_of, specimens))


def individuals_are_stated(specimens: Iterable[Specimen], by: str | None = None) -> bool:
    """Return whether anything states the individual of any specimen: it is then not only that of its own name.

    ``by`` tells replicates, as in :func:`individuals_of`.
    """
    return by is not None or any({each.individual, each.replicate_of} - {"", each.name} for each in specimens)


def _sides_of(specimens: Sequence[Specimen], by: str | None) -> tuple[list[Named], dict[int, str]]:
    """Return the side of each specimen, and the name of the individual that it is of.

    Also return the side that a table, names or folders state of the specimens whose fits are of the other, by index.
    """
    in_names = _in_names(specimens, by)
    stated = [
        each.stated_side or folder_side(each.image) or named.side
        for each, named in zip(specimens, in_names, strict=True)
    ]
    called = _called(specimens, stated)
    found = []
    against = {}
    for i, (specimen, named, said) in enumerate(zip(specimens, in_names, stated, strict=True)):
        side = called.get(specimen.side, side_of_text(specimen.side))
        found.append(Named(side or named.side, named.rest))
        if specimen.is_usable and side_is_by_fit(specimen) and said in OTHER_SIDE and side == OTHER_SIDE[said]:
            against[i] = said
    return found, against


def side_is_by_fit(specimen: Specimen) -> bool:
    """Return whether the side of a specimen is that of its fit, which knows it better than a table."""
    return specimen.side in (ORIGINAL, MIRRORED) or (specimen.status in USABLE and specimen.side in OTHER_SIDE)


def _called(specimens: Sequence[Specimen], stated: Sequence[str]) -> dict[str, str]:
    """Return what the sides of fits that have no names are called, if a table, names or folders of all say so.

    A table may state one side only; in names, a word that all have may mean something else.
    """
    known = [(each, said) for each, said in zip(specimens, stated, strict=True) if each.is_usable]
    counts = Counter((each.side, said) for each, said in known)
    sides = {said for _, said in known}
    is_stated = {LEFT, RIGHT} <= sides or all(each.stated_side for each, _ in known)
    if not is_stated or not sides <= {LEFT, RIGHT}:
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
