"""LabelMe (``.json``, one file an image): pixels of the image, taken as centres counted from 0, y downwards.

Shapes of the type ``point`` are the landmarks, named by their labels if these differ. Points of one ``group_id`` are an
object. Without points, the only polygon or line is read.
"""

from collections import Counter
from dataclasses import replace
from pathlib import PureWindowsPath
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import natural_key
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import Source, names_of, size_of_file
from liaam.io.landmarks.text import check_number


def is_it(source: Source) -> bool:
    """Whether it is an object with shapes."""
    return isinstance(source.json, dict) and isinstance(source.json.get("shapes"), list)


def parse(source: Source) -> Landmarks:
    """Parse shapes into the objects of an image."""
    shapes = source.json["shapes"]
    points = [shape for shape in shapes if shape.get("shape_type") == "point"]
    lines = [shape for shape in shapes if shape.get("shape_type") in ("polygon", "linestrip", "points")]
    groups: dict[str, list[tuple[str, Any]]] = {}
    for shape in points:
        group = "" if shape.get("group_id") is None else str(shape["group_id"])
        groups.setdefault(group, []).append((str(shape.get("label")), shape["points"][0]))
    if len(groups) > 1 and all(len(own) == 1 for own in groups.values()):  # the groups number the points
        labels = [own[0][0] for own in groups.values()]
        keys = labels if len({*labels}) == len(labels) else list(groups)
        pairs = zip(keys, (own[0][1] for own in groups.values()), strict=True)
        groups = {"": sorted(pairs, key=lambda pair: natural_key(pair[0]))}
    if not points and len(lines) == 1:
        groups = {"": [("", pair) for pair in lines[0]["points"]]}
    if not groups:
        raise LandmarkError("it has no points: place the landmarks as points.")
    made = [_landmarks(source.json, group, own) for group, own in groups.items()]
    usual = Counter(len(own) for own in made).most_common(1)[0][0]
    first, *others = sorted(made, key=lambda own: len(own) != usual)
    for own in others:
        if len(own) != usual:
            which = f"group {own.label} of {source.path.name}"
            source.notes.leave_out(which, f"{len(own)} points where others have {usual}")
    return replace(first, others=tuple(own for own in others if len(own) == usual))


def _landmarks(content: Any, group: str, pairs: list[tuple[str, Any]]) -> Landmarks:
    points: Any = [tuple(check_number(value, f"point '{label}'") for value in pair[:2]) for label, pair in pairs]
    image = PureWindowsPath(str(content.get("imagePath") or "")).name or None
    placing = size_of_file(content.get("imageWidth"), content.get("imageHeight"))
    names = names_of([label for label, _ in pairs])
    return Landmarks(points, names=names, image_name=image, label=group, placing=placing)
