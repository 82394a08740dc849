"""dlib ``imglab`` data sets (``.xml``): pixel centres counted from 0, x to the right and y downwards.

One file holds many images. The landmarks are the ``part`` elements of a box. Each box with parts is an object. Parts
are in natural order of their names (1, 2, ... 10) over all images. If a box lacks a part, that landmark is missing.
Boxes that are marked ``ignore`` are left out.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import natural_key
from liaam.io.landmarks.base import (
    Landmarks,
    Placing,
    Source,
    largest_of,
    make_landmarks,
    parse_number,
    size_of_file,
)

_Parts = dict[str, tuple[float, float]]

_MOST_MISSING = 20
"""Maximum ratio of missing to present parts; above it the part names must be wrong."""


def parse(source: Source) -> dict[str, Landmarks]:
    """Parse the text of an ``imglab`` file into landmarks by the image's file name."""
    path = source.path
    found: list[tuple[str, Placing, float, _Parts]] = list(source.each(_boxes(source.xml), partial(_box, path)))
    found = [each for each in found if each[3]]
    if not found:
        raise LandmarkError(f"{path} has no image with landmarks (part elements in a box): export it again.")
    names = sorted({name for *_, parts in found for name in parts}, key=natural_key)
    if len(names) * len(found) > _MOST_MISSING * sum(len(parts) for *_, parts in found):
        raise LandmarkError(
            f"{path}: its {len(found)} boxes share hardly any of the {len(names)} part names: give a part the same "
            "name in all images."
        )
    absent, objects = (math.nan, math.nan), {}
    for image, placing, area, parts in found:
        points = [parts.get(name, absent) for name in names]
        landmarks = make_landmarks(path, points, names=names, image_name=image)
        objects.setdefault(image, []).append((area, replace(landmarks, placing=placing)))
    return {image: largest_of(each) for image, each in objects.items()}


def _boxes(root: Any) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the boxes that are not marked to be ignored, with their images."""
    for image in root.iter("image"):
        for number, box in enumerate(image.iterfind("box"), 1):  # direct children, so that nested ones are not repeated
            if box.get("ignore", "0") in ("0", "false", ""):
                yield f"box {number} of {image.get('file', '')}", (image, box)


def _box(path: Path, pair: tuple[Any, Any]) -> tuple[str, Placing, float, _Parts]:
    image, box = pair
    name = image.get("file", "")
    parts = _parts(path, name, box)
    return name, size_of_file(image.get("width"), image.get("height")), _area(path, name, box), parts


def _parts(path: Path, image: str, box: Any) -> _Parts:
    parts: _Parts = {}
    for part in box.iterfind("part"):
        where = f"part '{part.get('name')}' of image '{image}'"
        if part.get("name") in parts:
            raise LandmarkError(f"{path}: {where} occurs twice: remove one of them.")
        parts[part.get("name", "")] = (
            parse_number(path, part.get("x", ""), where),
            parse_number(path, part.get("y", ""), where),
        )
    return parts


def _area(path: Path, image: str, box: Any) -> float:
    sides = [parse_number(path, box.get(side, "0"), f"a box of image '{image}'") for side in ("width", "height")]
    return 0.0 if math.isnan(sides[0] * sides[1]) else sides[0] * sides[1]
