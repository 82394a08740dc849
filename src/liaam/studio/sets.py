"""Several sets of landmarks in a folder: other points, or the same points placed by another observer; their agreement.

The landmarks of the first set, "", lie beside the pictures, those of a further one in a subfolder of its name. Each set
is a :class:`Project`, with a template, proposals, reviews and a model of its own.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from liaam.formatting import finite_or_none
from liaam.io.files import count_of
from liaam.io.images import PICTURE_SUFFIXES
from liaam.io.table_writer import columns_text
from liaam.morphometry import Specimen, measure, measurement_error
from liaam.studio import contract
from liaam.studio.agreement import mirrored_pictures, shape_agreement
from liaam.studio.folder import ADDED, SET_NAME, disk_errors, plain_name
from liaam.studio.measuring import MEASURING, kept_in
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal
from liaam.studio.store import DATABASE, Store


def make_set(project: Project, data: Any) -> contract.MadeSet:
    """Make a set with the ``name`` in a request; if ``same``, of the points of a project.

    A subfolder of this name that holds landmark files, but no pictures, becomes the set's.
    """
    asked = project.checked(contract.MakeSet, data, "name and same")
    project.folder.check_writable()
    name = asked.name
    template = project.templates.needed if asked.same else None
    if not isinstance(name, str) or not SET_NAME.fullmatch(name):
        raise Refusal(422, "the name is not valid: use at most 30 letters from A to Z, digits, - and _")
    if name.casefold() in (ADDED, *map(str.casefold, project.sets)):
        raise Refusal(409, f"the name {name} is taken: choose another one")
    place = project.root / name
    with disk_errors(f"{name} cannot be made", error=partial(Refusal, 503)):
        if place.is_symlink() or (place.exists() and not place.is_dir()):
            raise Refusal(409, f"{name} is a file or a link beside the pictures: choose another name")
        if any(path.suffix.lower() in PICTURE_SUFFIXES for path in place.rglob("*")):
            raise Refusal(409, f"{name} is a subfolder with pictures: choose another name")
        place.mkdir(exist_ok=True)
    Store(project.folder, name).path(DATABASE)  # makes its folder, by which the set is known
    made = project.of_set(name)
    made.store.put("declined", {"": True})  # the points of the face model are the first set's, or of no use here
    if template is not None and made.templates.current is None:
        made.save_template({**template.as_json(), "points": None})  # they may be where the other placed them
        made.store.put(MEASURING, {"": {**kept_in(project.store), "gone": []}})  # they measure the same
    return {"name": name}


def observers(project: Project) -> list[str]:
    """Return the sets that have the points of a project, its own included."""
    current = {name: project.of_set(name).templates.current for name in project.sets}
    shown = current[project.set_name]
    return [name for name, template in current.items() if shown and template and template.names == shown.names]


def others(project: Project, picture: str) -> dict[str, list[contract.Point]]:
    """Return all points that other observers placed on a picture, by set; refused before they are placed here."""
    marks = {name: project.of_set(name).marks(picture) for name in observers(project)}
    placed = {name: marked["points"] for name, marked in marks.items() if marked["source"] == "file"}
    done = {name: points for name, points in placed.items() if None not in points}
    if done.pop(project.set_name, None) is None:
        raise Refusal(409, "the points of other observers are shown once all points are placed")
    return done


SAME_SCALE = 0.01
"""Largest relative difference of the lengths of a pixel at which pictures have one scale."""


def _common_pixel(project: Project, pictures: Sequence[str]) -> contract.Pixel | None:
    """Return the length of a pixel that pictures have in common, if they do."""
    known = [pixel for name in pictures if (pixel := project.pixel_length(name))]
    lengths = [length for length, _ in known]
    if len(known) < len(pictures) or len({unit for _, unit in known}) != 1:
        return None
    if max(lengths) > (1 + SAME_SCALE) * min(lengths):
        return None
    return {"length": float(np.median(lengths)), "unit": known[0][1]}


def agreement(project: Project) -> contract.Agreement:
    """Return how far observers are apart in the pictures that at least two have done: standard deviations.

    Observers are replicates (:func:`liaam.morphometry.measurement_error`). Points and pictures with the largest
    deviations come first. ``table`` is the text of a table with more. Pictures in which an observer has accepted points
    as they were proposed do not count for that observer; ``unconfirmed`` are their names.
    """
    placed: dict[str, dict[str, np.ndarray]] = {}
    by_set: dict[str, dict[str, np.ndarray]] = {}
    unconfirmed: set[str] = set()
    for name in observers(project):
        own, not_own = project.of_set(name).own_complete()
        by_set[name] = own
        unconfirmed.update(not_own)
        for picture, points in own.items():
            placed.setdefault(picture, {})[name] = points
    pictures = {picture: values for picture, values in placed.items() if len(values) > 1}
    if not pictures:
        remedy = "let another observer place them"
        if unconfirmed:
            some = count_of(len(unconfirmed), "picture")
            remedy = f"in {some}, points were accepted as they were proposed; move or confirm each"
        raise Refusal(422, f"no picture was placed in two sets of the same points yet: {remedy}")
    mirrored = mirrored_pictures(project, {picture: next(iter(values.values())) for picture, values in placed.items()})
    every = [
        (picture, points * (-1.0, 1.0) if picture in mirrored else points)
        for picture, values in pictures.items()
        for points in values.values()
    ]
    names = project.templates.needed.names
    specimens = [Specimen(f"{picture}#{i}", points, names=names) for i, (picture, points) in enumerate(every)]
    table = measurement_error(specimens, measure(specimens), "image")
    sd, percent = (table[name][-len(names) :] for name in ("sd", "sd_percent"))  # the rows of the points are the last
    points = zip(names, sd, percent, strict=True)
    variance = {picture: np.var([*values.values()], axis=0, ddof=1) for picture, values in pictures.items()}
    spread = {picture: float(np.sqrt(values.sum(axis=1).mean())) for picture, values in variance.items()}
    return {
        "observers": sorted({observer for values in pictures.values() for observer in values}),
        "pixel": _common_pixel(project, [*pictures]),
        "sd": float(np.sqrt(np.square(sd).mean())),
        "percent": float(np.sqrt(np.square(percent).mean())),
        "repeatability": finite_or_none(table["repeatability"][0]),
        "points": sorted(points, key=lambda row: -row[1]),
        "pictures": sorted(spread.items(), key=lambda item: -item[1]),
        "unconfirmed": sorted(unconfirmed - pictures.keys()),
        "alone": {
            picture: next(iter(values))
            for picture, values in sorted(placed.items())
            if picture not in pictures and picture not in unconfirmed
        },
        "file": f"{plain_name(project.title)}-agreement.csv",
        "table": columns_text(table),
        "shapes": [
            found
            for name, own in by_set.items()
            if name != project.set_name
            and (found := shape_agreement(project, own, by_set[project.set_name], (name, project.set_name)))
        ],
    }
