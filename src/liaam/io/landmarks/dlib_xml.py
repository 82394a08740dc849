"""dlib ``imglab`` data sets (``.xml``): pixel centres counted from 0, x to the right and y downwards.

One file holds many images. The landmarks are the ``part`` elements of a box. Each box with parts is an object. Parts
are in natural order of their names (1, 2, ... 10) over all images. If a box lacks a part, that landmark is missing.
"""

import math
from pathlib import Path
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import natural_key
from liaam.io.landmarks.base import Landmarks, largest_of, make_landmarks, parse_number

_Parts = dict[str, tuple[float, float]]

_MOST_MISSING = 20
"""Maximum ratio of missing to present parts; above it the part names must be wrong."""


def parse(path: Path, text: str) -> dict[str, Landmarks]:
    """Parse the text of an ``imglab`` file into landmarks by the image's file name."""
    objects: dict[str, list[tuple[float, _Parts]]] = {}
    for image in _root(path, text).iter("image"):
        name = image.get("file", "")
        for box in image.iterfind("box"):  # direct children only, so that nested images do not repeat the work
            parts = _parts(path, name, box)
            area = _area(path, name, box)
            if parts:
                objects.setdefault(name, []).append((area, parts))
    if not objects:
        raise LandmarkError(f"{path} has no image with landmarks (part elements in a box): export it again.")
    found = [parts for each in objects.values() for _, parts in each]
    names = sorted({name for parts in found for name in parts}, key=natural_key)
    if len(names) * len(found) > _MOST_MISSING * sum(map(len, found)):
        raise LandmarkError(
            f"{path}: its {len(found)} boxes share hardly any of the {len(names)} part names: give a part the same "
            "name in all images."
        )
    absent = (math.nan, math.nan)

    def landmarks(image: str, parts: _Parts) -> Landmarks:
        points = [parts.get(name, absent) for name in names]
        return make_landmarks(path, points, names=names, image_name=image)

    return {
        image: largest_of((area, landmarks(image, parts)) for area, parts in each) for image, each in objects.items()
    }


def _root(path: Path, text: str) -> Any:
    """Parse XML. Reject documents that could define entities or read other files."""
    from xml.etree import ElementTree

    lower = text.lower()
    if "<!doctype" in lower or "<!entity" in lower:
        raise LandmarkError(
            f"{path} declares a document type or entities, which is not safe to read: remove that part."
        )
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as fault:
        raise LandmarkError(f"{path} is not complete XML ({fault}); it may be cut short: export it again.") from fault


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
