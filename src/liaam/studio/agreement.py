"""Whether shapes of two sources agree for statistics: of observers, or of the model and a person.

It is what ``liaam evaluate`` and ``liaam measure --compare`` say (:func:`liaam.evaluation.compare_shapes`).
"""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from liaam.datasets.sides import reflected_shapes
from liaam.errors import LiaamError
from liaam.formatting import finite_or_none
from liaam.morphometry import groups_of
from liaam.studio import contract
from liaam.studio.measuring import GROUPS
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal, refusing
from liaam.studio.sides import for_measuring
from liaam.studio.training import HELD_OUT

Points = Mapping[str, np.ndarray]
"""Points (n, 2) by the name of the picture."""


def mirrored_pictures(project: Project, points: Points) -> set[str]:
    """Return the pictures whose objects are of the other side than most, as stated, or by their names or points.

    Their shapes have to be reflected: the differences between the sides would count as those of specimens otherwise, so
    that all observers agree.
    """
    stated = project.stated_sides()
    sides = for_measuring(
        [stated.get(picture, "") for picture in points],
        [picture.rpartition(".")[0] for picture in points],
        np.array([*points.values()]),
    )
    usual = Counter(filter(None, sides)).most_common(1)
    return {picture for picture, side in zip(points, sides, strict=True) if usual and side not in ("", usual[0][0])}


def shape_agreement(
    project: Project, ours: Points, labels: Points, names: tuple[str, str]
) -> contract.ShapeAgreement | None:
    """Compare shapes with labels in the pictures that both have; None if these are too few.

    ``names`` are those of both. Differences between the groups of a kept table are compared too, if there are any.
    """
    from liaam.evaluation import compare_shapes  # heavy: imported when first needed

    pictures = sorted(ours.keys() & labels.keys())
    if not pictures:
        return None
    mirrored = mirrored_pictures(project, {picture: labels[picture] for picture in pictures})
    are_mirrored = np.array([picture in mirrored for picture in pictures])
    shapes = [reflected_shapes(np.array([each[name] for name in pictures]), are_mirrored) for each in (ours, labels)]
    try:
        found = compare_shapes(*shapes, groups=_groups(project, pictures))
    except LiaamError:  # too few pictures, or too few in groups
        try:
            found = compare_shapes(*shapes)
        except LiaamError:
            return None
    low, high = found.slope_interval
    attenuation_low, attenuation_high = found.attenuation_interval
    return {
        "names": [*names],
        "pictures": found.n_specimens,
        "slope": found.slope,
        "slope_interval": [low, high],
        "attenuation": finite_or_none(found.attenuation),
        "attenuation_interval": [finite_or_none(attenuation_low), finite_or_none(attenuation_high)],
        "variance_ratio": found.variance_ratio,
        "reliability": found.reliability,
        "repeatability": found.repeatability,
        "mean_distance": found.mean_distance,
        "p": found.p_of_means,
        "size_correlation": found.size_correlation,
        "methods": found.methods(),
    }


def model_agreement(project: Project) -> contract.ShapeAgreement:
    """Compare the shapes that the newest measured model found with those of a person.

    They are fits to pictures that the model was not trained on, in which a person has placed, moved or confirmed every
    point.
    """
    kept = project.store.get(HELD_OUT)
    if kept is None or kept["order"] != project.templates.order:
        raise Refusal(422, "no model was measured yet: train on at least 20 pictures, of which some are held out")
    own, _ = project.own_complete()
    with refusing():
        fits = {name: np.array(points, np.float64) for name, points in kept["fits"].items()}
    found = shape_agreement(project, fits, own, ("model", "person"))
    if found is None:
        n = len(fits.keys() & own.keys())
        text = f"{n} held-out pictures have all points placed, moved or confirmed by a person, and 5 are needed"
        raise Refusal(422, f"{text}: confirm points (Y), and train on at least 32 pictures, of which 8 are held out")
    return found


def _groups(project: Project, pictures: Sequence[str]) -> Sequence[str] | None:
    kept = project.store.get(GROUPS)
    return None if kept is None else groups_of([picture.rpartition(".")[0] for picture in pictures], kept)
