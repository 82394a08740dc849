"""Landmarks of the same specimens from several sources, paired by the specimens' names."""

from collections.abc import Sequence

import numpy as np

from liaam.errors import LiaamError
from liaam.evaluation.agreement import ShapeAgreement, compare_shapes
from liaam.io.files import some_names
from liaam.model.shape import align
from liaam.morphometry import Specimen
from liaam.morphometry.sides import individuals_of, reflected

MOST_OBSERVERS = 2  # People whose landmarks automatic ones are compared with


def points_by_name(specimens: Sequence[Specimen], landmark_names: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Return the landmarks (n, 2) of specimens by name, in the order of these landmark names if both have names.

    Those of fits that are not to be used are left out. Landmarks that were estimated are missing: nobody saw them.

    Raises
    ------
    LiaamError
        If a specimen lacks a landmark name.
    """
    found = {}
    for specimen in specimens:
        if not specimen.is_usable:
            continue
        points = specimen.measured
        if landmark_names and specimen.names and tuple(specimen.names) != tuple(landmark_names):
            absent = [name for name in landmark_names if name not in specimen.names]
            if absent:
                raise LiaamError(
                    f"{specimen.name}: it has no landmark {some_names(absent, 3)}; number or name them alike"
                )
            points = points[[specimen.names.index(name) for name in landmark_names]]
        found[specimen.name] = points
    return found


def points_of(names: Sequence[str], landmarks: dict[str, np.ndarray], n: int, what: str) -> np.ndarray:
    """Return the landmarks of named specimens, (m, n, 2) float64; NaN for those without.

    Raises
    ------
    LiaamError
        If there are none for any of these names, or a specimen has another number of landmarks.
    """
    points = np.full((len(names), n, 2), np.nan)
    shared = [name for name in names if name in landmarks]
    if not shared:
        raise LiaamError(
            f"{what}: there are no landmarks of the same specimens: it has "
            f"{some_names(sorted(landmarks), 3) or 'none'}, and the others {some_names(list(names), 3)}"
        )
    for i, name in enumerate(names):
        if name not in landmarks:
            continue
        if len(landmarks[name]) != n:
            raise LiaamError(f"{what}: {name} has {len(landmarks[name])} landmarks where the others have {n}")
        points[i] = landmarks[name]
    return points


def _on_sides_of(automatic: dict[str, np.ndarray], labels: Sequence[Specimen]) -> list[Specimen]:
    """Return labels, reflected where the automatic landmarks of the specimen were, and so are nearer to that."""

    def are_nearer_reflected(label: Specimen) -> bool:
        points = automatic.get(label.name)
        if points is None or np.shape(points) != np.shape(label.points):
            return False
        direct, mirrored = (_distance(shape, points) for shape in (label.points, reflected(label).points))
        return mirrored < direct

    return [reflected(label) if are_nearer_reflected(label) else label for label in labels]


def _distance(shape: np.ndarray, target: np.ndarray) -> float:
    """Sum of squared distances of a shape (n, 2), moved by the best similarity, from the known points of a target."""
    return float(np.nansum(np.square(align(shape, target)(shape) - target)))


def compare_specimens(
    automatic: Sequence[Specimen],
    labels: Sequence[Sequence[Specimen]],
    groups: Sequence[str] | None = None,
    *,
    individuals: Sequence[str] | None = None,
    **options,
) -> ShapeAgreement:
    """Compare specimens with automatic landmarks with the same ones with landmarks that one or two people placed.

    Parameters
    ----------
    automatic : sequence of Specimen
    labels : sequence of sequence of Specimen
        Those of one or two people; specimens go by their names.
    groups : sequence of str, optional
        Group of each automatic specimen; empty if unknown.
    individuals : sequence of str, optional
        Individual of each automatic specimen; by default :func:`liaam.morphometry.individuals_of` tells.
    **options
        As of :func:`compare_shapes`.

    Raises
    ------
    LiaamError
        If no specimen is in all sets, landmarks differ in number or names, or as :func:`compare_shapes`.
    """
    if not 1 <= len(labels) <= MOST_OBSERVERS:
        raise LiaamError(f"{len(labels)} sets of labels: give those of one person, or of two")
    names = [specimen.name for specimen in automatic]
    landmark_names = next((specimen.names for specimen in automatic if specimen.names), ())
    own = points_by_name(automatic, landmark_names)
    if any(specimen.reflected for specimen in automatic):
        labels = [_on_sides_of(own, each) for each in labels]
    n = len(next(iter(own.values()), ()))
    sets = [own, *(points_by_name(each, landmark_names) for each in labels)]
    whats = ["automatic landmarks", "labels", "labels of the second person"]
    points = [points_of(names, each, n, what) for each, what in zip(sets, whats, strict=False)]
    who = individuals_of(automatic) if individuals is None else individuals
    return compare_shapes(*points, groups=groups, individuals=who, **options)
