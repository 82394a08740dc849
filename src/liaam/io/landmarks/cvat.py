"""CVAT for images (``.xml``): pixels of the image, taken as centres counted from 0, x to the right and y downwards.

One file holds many images. Each skeleton is an object, and its points are named by their labels. Without skeletons, the
points of an image are its landmarks: one ``points`` with all of them, or one each with its own label.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import (
    Landmarks,
    Source,
    in_objects,
    make_landmarks,
    named_points,
    parse_number,
    size_of_file,
)

_Object = tuple[Any, str, list[Any]]
"""The element of an image, a label, and elements of points."""


def is_it(source: Source) -> bool:
    """Whether the root element is that of CVAT."""
    return source.xml.tag == "annotations"


def parse(source: Source) -> dict[str, Landmarks]:
    """Parse the text of a CVAT file into landmarks by the image's file name."""
    if source.xml.find("track") is not None:
        raise LandmarkError(f"{source.path} is CVAT's for a video: export it as 'CVAT for images'.")
    objects = [each for image in source.xml.iter("image") for each in _objects(image)]
    wanted = source.reading.category
    labels = Counter(label for _, label, _ in objects)
    if wanted is not None and wanted not in labels:
        raise LandmarkError(f"{source.path} has no points of the label '{wanted}': it has {', '.join(labels)}.")
    sizes = {label: (max(len(own) for _, of, own in objects if of == label), n) for label, n in labels.items()}
    chosen = wanted if wanted is not None else max(sizes, key=lambda label: sizes[label], default="")
    for image, label, _ in objects:
        if label != chosen:
            what = f"left out the label '{label}', because '{chosen}' has more (--category chooses)"
            source.notes.say(what, image.get("name", ""))
    records = ((each[0].get("name", ""), each) for each in objects if each[1] == chosen)
    found = list(source.each(records, lambda each: _landmarks(source, *each)))
    if not found:
        raise LandmarkError(f"{source.path} has no image with points: annotate skeletons or points.")
    return in_objects(named_points(source, found))


def _objects(image: Any) -> Iterator[_Object]:
    skeletons = image.findall("skeleton")
    for skeleton in skeletons:
        yield image, skeleton.get("label", ""), skeleton.findall("points")
    points = image.findall("points") if not skeletons else []
    several = [each for each in points if ";" in each.get("points", "")]
    for each in several:
        yield image, each.get("label", ""), [each]
    if points and not several:
        yield image, "", points


def _landmarks(source: Source, image: Any, label: str, elements: list[Any]) -> Landmarks:
    points, names, invisible = [], [], []
    for element in elements:
        for pair in element.get("points", "").split(";"):
            x, y = (parse_number(source.path, value, f"'{image.get('name')}'") for value in pair.split(","))
            invisible += [len(points)] if element.get("occluded") == "1" else []
            points.append((math.nan, math.nan) if element.get("outside") == "1" else (x, y))
            names.append(element.get("label", ""))
    names = names if len(elements) == len(points) and len(set(names)) == len(names) else ()
    made = make_landmarks(source.path, points, (), names, image.get("name", ""), invisible)
    return replace(made, placing=size_of_file(image.get("width"), image.get("height")))
