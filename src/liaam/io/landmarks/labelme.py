"""LabelMe (``.json``, one file an image): pixels of the image, taken as centres counted from 0, y downwards.

Shapes of the type ``point`` are the landmarks, named by their labels if these differ. Points of one ``group_id`` are an
object. Without points, the only polygon or line is read.
"""

from collections import Counter
from dataclasses import replace
from pathlib import PureWindowsPath
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks, Source, check_number, make_landmarks, size_of_file


def is_it(source: Source) -> bool:
    """Whether it is an object with shapes."""
    return isinstance(source.json, dict) and isinstance(source.json.get("shapes"), list)


def parse(source: Source) -> Landmarks:
    """Parse the text of a LabelMe file."""
    path, content = source.path, source.json
    try:
        points = [shape for shape in content["shapes"] if shape.get("shape_type") == "point"]
        lines = [shape for shape in content["shapes"] if shape.get("shape_type") in ("polygon", "linestrip", "points")]
        groups: dict[Any, list[tuple[str, Any]]] = {}
        for shape in points:
            groups.setdefault(str(shape.get("group_id")), []).append((str(shape.get("label")), shape["points"][0]))
        if not points and len(lines) == 1:
            groups = {"None": [("", pair) for pair in lines[0]["points"]]}
        made = [_landmarks(source, group, own) for group, own in groups.items()]
    except (TypeError, KeyError, ValueError, IndexError, AttributeError) as fault:
        raise LandmarkError(f"{path} lacks the parts of a LabelMe file (shapes, points): export it again.") from fault
    if not made:
        raise LandmarkError(f"{path} has no points: place the landmarks as points.")
    usual = Counter(len(own) for own in made).most_common(1)[0][0]
    first, *others = sorted(made, key=lambda own: len(own) != usual)
    for own in others:
        if len(own) != usual:
            source.notes.leave_out(f"group {own.label} of {path.name}", f"{len(own)} points where others have {usual}")
    return replace(first, others=tuple(own for own in others if len(own) == usual))


def _landmarks(source: Source, group: str, pairs: list[tuple[str, Any]]) -> Landmarks:
    content, path = source.json, source.path
    points = [tuple(check_number(path, value, f"point '{label}'") for value in pair[:2]) for label, pair in pairs]
    labels = [label for label, _ in pairs]
    names = labels if len(set(labels)) == len(labels) else ()
    if 1 < len(set(labels)) < len(labels):
        twice = next(label for label in labels if labels.count(label) > 1)
        raise LandmarkError(f"{path} has several points '{twice}': give each object a group, or each point a label.")
    image = PureWindowsPath(str(content.get("imagePath") or "")).name or None
    made = make_landmarks(path, points, names=names, image_name=image)
    placing = size_of_file(content.get("imageWidth"), content.get("imageHeight"))
    return replace(made, label="" if group == "None" else group, placing=placing)
