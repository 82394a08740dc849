"""Records of one image: which of them are of one object, and so are replicates, and which are of several objects."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby
from typing import NamedTuple

import numpy as np

from liaam.io.files import some_names
from liaam.morphometry.specimens import Specimen

NEAR = 0.5
"""Greatest distance between the centroids of records of one object, in root mean square distances of its landmarks from
their centroid. Replicates lie within some pixels of each other. Objects that do not overlap are two or more apart."""

ALIKE = 2.0
"""Greatest ratio of the sizes of records of one object."""


_AWAY = 1e12  # pixels beyond all images


class Record(NamedTuple):
    """A record of an image, as a file has it.

    Attributes
    ----------
    image : str
        Name of the image.
    specimen : Specimen
        With the name of the image, and a number or ID if the file has several records of it.
    folder : str
        Last folder that all images of the file have in common, or empty.
    zeros : tuple of int
        Landmarks that the file has at 0, 0.
    """

    image: str
    specimen: Specimen
    folder: str = ""
    zeros: tuple[int, ...] = ()


class _Place(NamedTuple):
    """Where a record lies: the centroid of its landmarks, and their root mean square distance from it, in pixels."""

    centre: np.ndarray
    radius: float

    @classmethod
    def of(cls, specimen: Specimen) -> _Place:
        points = specimen.points[np.isfinite(specimen.points).all(axis=1)]
        if not len(points):
            return cls(np.full(2, np.nan), np.nan)
        centre = points.mean(axis=0)
        return cls(centre, float(np.sqrt(np.square(points - centre).sum(axis=1).mean())))


def _are_near(place: _Place, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Whether a place and each of others, of centres (n, 2) and radii (n,), may be those of one object."""
    larger = np.maximum(radii, place.radius)
    smaller = np.minimum(radii, place.radius)
    return (np.linalg.norm(centres - place.centre, axis=1) <= NEAR * larger) & (larger <= ALIKE * smaller)


def objects_of_records(records: Sequence[Record]) -> list[Specimen]:
    """Return the specimens of records, each with a name of its own and that of the object that it is a record of.

    Records of several files are matched by image, and where an image has several objects, by their places.
    """
    objects: dict[str, dict[str, _Place]] = defaultdict(dict)  # of each image: the place of the first record
    specimens: list[Specimen] = []
    taken: Counter[str] = Counter()
    by_file = groupby(records, key=lambda record: record.specimen.file)
    for file, of_file in by_file:
        by_image: dict[str, list[Specimen]] = defaultdict(list)
        for record in of_file:
            by_image[record.image].append(record.specimen)
        for image, of_image in by_image.items():
            is_known = image in objects
            names = _objects_of(of_image, objects[image])
            for specimen, name in zip(of_image, names, strict=True):
                wanted = f"{name}#{_stem(file)}" if is_known else specimen.name
                specimens.append(replace(specimen, name=_free(wanted, taken), replicate_of=name))
    return specimens


def with_unique_codes(records: Sequence[Record], complain: Callable[[str], object]) -> list[Record]:
    """Return records of which no two specimens in different places are named by one code; their places name these."""
    places: dict[str, list[str]] = defaultdict(list)
    for record in records:
        if record.specimen.code and record.image not in places[record.specimen.name]:
            places[record.specimen.name].append(record.image)
    doubled = {name: images for name, images in places.items() if len(images) > 1}
    for name, images in doubled.items():
        complain(f"the code {name} names {some_names(images)}: their positions name them")
    return [
        record._replace(specimen=replace(record.specimen, name=record.image))
        if record.specimen.code and record.specimen.name in doubled
        else record
        for record in records
    ]


def _stem(file: str) -> str:
    return file.rpartition(".")[0] or file


def _free(name: str, taken: Counter[str]) -> str:
    """Return a name, or with the next number if it is taken."""
    free = name
    while taken[free]:
        taken[name] += 1
        free = f"{name}#{taken[name]}"
    taken[free] += 1
    return free


def _objects_of(specimens: Sequence[Specimen], known: dict[str, _Place]) -> list[str]:
    """Return the name of the object of each record of an image in one file; add objects to those of earlier files."""
    places = [_Place.of(specimen) for specimen in specimens]
    centres = np.array([place.centre for place in places])
    radii = np.array([place.radius for place in places])
    firsts: list[int] = []  # the first record of each object in this file
    object_of: list[int] = []
    for i, place in enumerate(places):
        near = np.flatnonzero(_are_near(place, centres[firsts], radii[firsts]))
        object_of.append(firsts[near[0]] if len(near) else i)
        if not len(near):
            firsts.append(i)
    names = _matched([places[first] for first in firsts], known)
    name_of: dict[int, str] = {}
    for first, matched in zip(firsts, names, strict=True):
        name = matched or specimens[first].name
        if not matched:
            while name in known:
                name += f"#{_stem(specimens[first].file)}"
            known[name] = places[first]
        name_of[first] = name
    return [name_of[first] for first in object_of]


def _matched(places: Sequence[_Place], known: dict[str, _Place]) -> list[str]:
    """Return for each object of an image in a file its name in earlier files, or "" for others."""
    if not known:
        return [""] * len(places)
    if len(known) == len(places) == 1:  # wherever they are: another person may have digitised a part of the image
        return list(known)
    centres = np.array([place.centre for place in places])
    other_centres = np.array([place.centre for place in known.values()])
    other_radii = np.array([place.radius for place in known.values()])
    if len(known) == len(places):  # files may count y from another side
        centres = centres - np.nanmean(centres, axis=0) + np.nanmean(other_centres, axis=0)
    # Objects without points lie far from all, and from each other.
    away = _AWAY * (1 + np.arange(len(places) + len(known)))[:, None]
    centres = np.where(np.isnan(centres), away[: len(places)], centres)
    other_centres = np.where(np.isnan(other_centres), -away[len(places) :], other_centres)
    nearest = _nearest(other_centres, centres)
    nearest_of_other = _nearest(centres, other_centres)
    names = list(known)
    matched = []
    for i, (place, j) in enumerate(zip(places, nearest.tolist(), strict=True)):
        moved = place._replace(centre=centres[i])
        is_near = _are_near(moved, other_centres[j : j + 1], other_radii[j : j + 1])[0]
        matched.append(names[j] if is_near and nearest_of_other[j] == i else "")
    return matched


def _nearest(points: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Return the index of the point that is nearest to each of some others, (n,)."""
    from scipy.spatial import KDTree

    _, nearest = KDTree(points).query(to)
    return np.asarray(nearest)  # by its types, SciPy might return a number


def doubts_about(records: Sequence[Record]) -> list[str]:
    """Return a sentence about points at 0, 0, and one about images of several folders that have one name."""
    n_zeros = Counter(i for record in records for i in record.zeros)
    named = []
    for record in records:
        # A landmark that most records have at 0, 0 is the origin of their coordinates.
        zeros = [i for i in record.zeros if 2 * n_zeros[i] < len(records) or len(records) == 1]
        if zeros:
            which = ", ".join(record.specimen.labels[i] for i in zeros)
            named.append(f"{record.specimen.name} (landmark {which})")
    lines = []
    if named:
        what = "landmarks at 0, 0, which many programs write for a missing one; leave x and y empty if so"
        lines.append(f"{what}: {some_names(named)}")
    folders = {record.specimen.file: record.folder for record in records if record.folder}
    images = [{record.image for record in records if record.specimen.file == file} for file in folders]
    if len(set(folders.values())) > 1 and set.intersection(*images):
        places = ", ".join(f"{folder} in {file}" for file, folder in folders.items())
        lines.append(f"images of one name in different folders are taken for the same: {places}")
    return lines


def without_copies(specimens: Sequence[Specimen]) -> tuple[tuple[Specimen, ...], tuple[str, ...]]:
    """Leave out fits to copies of a picture, and say of which: they are no specimens or replicates of their own.

    Files of equal content have equal fingerprints (`Specimen.fingerprint`). Fits to two of these are of one object if
    they lie on each other. Landmarks that a person has placed on a copy are observations of their own.

    Parameters
    ----------
    specimens : sequence of Specimen

    Returns
    -------
    kept : tuple of Specimen
    left_out : tuple of str
        A sentence for each specimen that is left out.
    """
    of_picture: dict[str, list[Specimen]] = defaultdict(list)
    kept = []
    left_out = []
    for specimen in specimens:
        if not specimen.fingerprint or not specimen.is_usable or not specimen.status:
            kept.append(specimen)
            continue
        first = next((each for each in of_picture[specimen.fingerprint] if _is_copied(each, specimen)), None)
        if first is None:
            of_picture[specimen.fingerprint].append(specimen)
            kept.append(specimen)
        else:
            left_out.append(
                f"{specimen.name}: its file is a copy of that of {first.name}, under another name; it is left out"
            )
    return tuple(kept), tuple(left_out)


def _is_copied(first: Specimen, other: Specimen) -> bool:
    """Return whether fits to files of equal content are of one object, but not of one file."""
    if first.image == other.image or len(first.points) != len(other.points):
        return False
    place = _Place.of(other)
    own = _Place.of(first)
    return bool(_are_near(place, own.centre[None], np.array([own.radius]))[0])
