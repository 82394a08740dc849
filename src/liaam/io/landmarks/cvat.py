"""CVAT for images (``.xml``): pixels of the image, taken as centres counted from 0, x to the right and y downwards.

One file holds many images. Each skeleton is an object, and its points are named by their labels. Without skeletons, the
points of an image are its landmarks: one ``points`` with all of them, or one each with its own label.
"""

from collections.abc import Iterator
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import MISSING, Labelled, Source, named_points, names_of, of_category, size_of_file
from liaam.io.landmarks.text import parse_number

_Object = tuple[Any, list[Any]]
"""The element of an image, and elements of points."""


def is_it(source: Source) -> bool:
    """Whether the root element is that of CVAT."""
    return source.xml.tag == "annotations"


def parse(source: Source) -> list[Landmarks]:
    """Parse the skeletons or points of images."""
    if source.xml.find("track") is not None:
        raise LandmarkError("this is CVAT's for a video: export it as 'CVAT for images'.")
    chosen = of_category(source, [each for image in source.xml.iter("image") for each in _objects(image)])
    records = ((each[0].get("name", ""), each) for each in chosen)
    return named_points(source, list(source.each(records, _landmarks)))


def _objects(image: Any) -> Iterator[Labelled[_Object]]:
    skeletons, points = image.findall("skeleton"), image.findall("points")
    several = [each for each in points if ";" in each.get("points", "")]
    parts = [(each.get("label", ""), each.findall("points")) for each in skeletons]
    if not skeletons:
        parts = [(each.get("label", ""), [each]) for each in several] or ([("", points)] if points else [])
    for label, own in parts:
        n = sum(each.get("points", "").count(";") + 1 for each in own)
        yield Labelled(label, label, (label,), n, image.get("name", ""), (image, own))


def _landmarks(found: _Object) -> Landmarks:
    image, elements = found
    points: Any = []
    names, invisible = [], []
    for element in elements:
        for pair in element.get("points", "").split(";"):
            x, y = (parse_number(value, f"'{image.get('name')}'") for value in pair.split(","))
            invisible += [len(points)] if element.get("occluded") == "1" else []
            points.append(MISSING if element.get("outside") == "1" else (x, y))
            names.append(element.get("label", ""))
    placing, image_name = size_of_file(image.get("width"), image.get("height")), image.get("name", "")
    attributes = [element.findtext("attribute", "").strip() for element in elements]
    numbered = len({*names}) == 1 < len({*attributes}) == len(points)
    named = names_of(attributes if numbered else names)
    return Landmarks(points, (), named, image_name, tuple(invisible), placing=placing)
