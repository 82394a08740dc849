"""dlib ``imglab`` data sets (``.xml``): pixel centres counted from 0, x to the right and y downwards.

One file holds many images. The landmarks are the ``part`` elements of a box. Each box with parts is an object. Parts
are in natural order of their names (1, 2, ... 10) over all images. If a box lacks a part, that landmark is missing.
Boxes that are marked ``ignore`` are left out. Of labels with other parts, that with more is the object.
"""

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import natural_key
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import MISSING, Labelled, Source, area_of, of_category, size_of_file
from liaam.io.landmarks.text import parse_number

_MOST_MISSING = 20
"""Maximum ratio of missing to present parts; above it the part names must be wrong."""


def parse(source: Source) -> list[Landmarks]:
    """Parse the boxes of images."""
    boxes = ((f"box {n} of {image.get('file', '')}", (image, box)) for image, n, box in _boxes(source.xml))
    every = [each for each in source.each(boxes, _parts) if each[2]]
    of_label: dict[str, set[str]] = defaultdict(set)
    for _, label, parts in every:
        of_label[label] |= parts.keys()
    kinds = {label: tuple(sorted(names)) for label, names in of_label.items()}
    objects = [
        Labelled(label, label, kinds[label], len(parts), image.get("file", ""), (image, parts))
        for image, label, parts in every
    ]
    found = of_category(source, objects)
    names = sorted({name for _, parts in found for name in parts}, key=natural_key)
    if len(names) * len(found) > _MOST_MISSING * sum(len(parts) for _, parts in found):
        raise LandmarkError(
            f"its {len(found)} boxes share hardly any of the {len(names)} part names: give a part the same name in all "
            "images."
        )
    return [_landmarks(image, [parts.get(name, MISSING) for name in names], names) for image, parts in found]


def _boxes(root: Any) -> Iterator[tuple[Any, int, Any]]:
    """Yield the boxes of each image that are not marked to be ignored, the largest first."""
    for image in root.iter("image"):
        boxes = list(enumerate(image.iterfind("box"), 1))  # direct children, so that nested ones are not repeated
        for number, box in sorted(boxes, key=lambda each: -area_of(each[1].get("width"), each[1].get("height"))):
            if box.get("ignore", "0").lower() in ("0", "false", "no", ""):
                yield image, number, box


def _parts(pair: tuple[Any, Any]) -> tuple[Any, str, dict[str, tuple[float, float]]]:
    image, box = pair
    parts: dict[str, tuple[float, float]] = {}
    for part in box.iterfind("part"):
        where = f"part '{part.get('name')}' of image '{image.get('file', '')}'"
        if part.get("name") in parts:
            raise LandmarkError(f"{where} occurs twice: remove one of them.")
        x, y = (parse_number(part.get(axis, ""), where) for axis in "xy")
        parts[part.get("name", "")] = x, y
    return image, (box.findtext("label") or "").strip(), parts


def _landmarks(image: Any, points: Any, names: list[str]) -> Landmarks:
    placing = size_of_file(image.get("width"), image.get("height"))
    return Landmarks(points, names=tuple(names), image_name=image.get("file", ""), placing=placing)
