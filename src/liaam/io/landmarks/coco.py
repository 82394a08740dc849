"""COCO keypoints (``.json``): 0-indexed pixels, x to the right and y downwards.

COCO defines keypoints as "a 0-indexed location x, y". Annotators clicked on whole pixels, so the numbers are taken as
pixel centres, without a shift of half a pixel. A keypoint of visibility 0 is missing; one of visibility 1 (labelled
but hidden) is invisible. One file holds many images. Each annotation with keypoints is an object. The category's
keypoint names become the names, and its skeleton (pairs counted from 1) the contours.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import (
    Contour,
    Landmarks,
    chain_edges,
    check_number,
    edges_of,
    largest_of,
    make_landmarks,
    parse_json,
)

_Lines = tuple[tuple[str, ...], tuple[Contour, ...]]
_NO_LINES: _Lines = ((), ())


def parse(path: Path, text: str) -> dict[str, Landmarks]:
    """Parse the text of a COCO keypoints file into landmarks by the image's file name."""
    content = parse_json(path, text)
    try:
        files = {image["id"]: str(image["file_name"]) for image in content["images"]}
        categories = {category["id"]: category for category in content.get("categories") or ()}
        annotations = [each for each in content["annotations"] if each.get("keypoints")]
        used = {annotation.get("category_id") for annotation in annotations} & set(categories)
        lines = {number: _lines(path, categories[number]) for number in used}
        objects: dict[str, list[tuple[float, Landmarks]]] = {}
        for annotation in annotations:
            image, own = files[annotation["image_id"]], lines.get(annotation.get("category_id"), _NO_LINES)
            landmarks = _landmarks(path, annotation, own, image)
            objects.setdefault(image, []).append((_area(path, annotation), landmarks))
    except (TypeError, KeyError, ValueError, AttributeError) as fault:
        raise LandmarkError(
            f"{path} lacks the parts of a COCO keypoints file (images, annotations, categories): export it again."
        ) from fault
    if not objects:
        raise LandmarkError(f"{path} is COCO without keypoints: export the annotations with keypoints.")
    return {image: largest_of(each) for image, each in objects.items()}


def dump_collection(collection: Mapping[str, Landmarks], sizes: Mapping[str, tuple[float, float]] | None = None) -> str:
    """Return the text of a file with the landmarks of many images, by file name, with the sizes of the images if known.

    Missing landmarks have visibility 0, invisible ones 1, all others 2. Names and contours are those of the first
    image.
    """
    first = next(iter(collection.values()))
    names = first.names or tuple(str(i + 1) for i in range(len(first)))
    edges = [[start + 1, end + 1] for start, end in edges_of(first.contours)]
    images, annotations = [], []
    for number, (name, landmarks) in enumerate(collection.items(), 1):
        width, height = (sizes or {}).get(name, (None, None))
        size = {} if width is None else {"width": width, "height": height}
        images.append({"id": number, "file_name": name, **size})
        for each in (landmarks, *landmarks.others):
            facts = {"id": len(annotations) + 1, "image_id": number, "category_id": 1, "iscrowd": 0}
            annotations.append({**facts, **_keypoints(each)})
    category = {"id": 1, "name": "object", "supercategory": "", "keypoints": list(names), "skeleton": edges}
    return json.dumps({"images": images, "annotations": annotations, "categories": [category]}, ensure_ascii=False)


def _keypoints(landmarks: Landmarks) -> dict[str, Any]:
    placed = landmarks.points[~landmarks.missing]
    low, extent = (placed.min(axis=0), np.ptp(placed, axis=0)) if len(placed) else (np.zeros(2), np.zeros(2))
    triples = [
        (0, 0, 0) if math.isnan(x) else (x, y, 1 if i in landmarks.invisible else 2)
        for i, (x, y) in enumerate(landmarks.points.tolist())
    ]
    return {
        "keypoints": [value for triple in triples for value in triple],
        "num_keypoints": len(placed),
        "bbox": [*low.tolist(), *extent.tolist()],
        "area": float(extent.prod()),
    }


def _area(path: Path, annotation: Any) -> float:
    if "area" in annotation:
        area = check_number(path, annotation["area"], "an area")
    else:
        _, _, width, height = annotation.get("bbox", (0, 0, 0, 0))
        area = check_number(path, width, "a box") * check_number(path, height, "a box")
    return 0.0 if math.isnan(area) else area


def _lines(path: Path, category: Any) -> _Lines:
    """Return the names of a category's keypoints, and their contours."""
    what = "the skeleton of a category"
    edges = [tuple(check_number(path, number, what) for number in edge) for edge in category.get("skeleton") or ()]
    if not all(len(edge) == 2 and all(number.is_integer() for number in edge) for edge in edges):
        raise LandmarkError(f"{path}: {what} is not a list of pairs of keypoint numbers: export it again.")
    names = tuple(map(str, category.get("keypoints") or ()))
    return names, chain_edges((int(start) - 1, int(end) - 1) for start, end in edges)


def _landmarks(path: Path, annotation: Any, lines: _Lines, image: str) -> Landmarks:
    values = annotation["keypoints"]
    if len(values) % 3:
        raise LandmarkError(
            f"{path}: image '{image}' has {len(values)} keypoint values, not x, y, v per keypoint: correct it."
        )
    numbers = [check_number(path, value, f"the keypoints of image '{image}'") for value in values]
    triples = zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True)
    points = [(x, y) if v else (math.nan, math.nan) for x, y, v in triples]
    invisible = (i for i, v in enumerate(numbers[2::3]) if v == 1)
    names, contours = lines
    return make_landmarks(path, points, contours, names, image, invisible)
