"""COCO keypoints (``.json``): 0-indexed pixels, x to the right and y downwards.

COCO defines keypoints as "a 0-indexed location x, y". Annotators clicked on whole pixels, so the numbers are taken as
pixel centres, without a shift of half a pixel. A keypoint of visibility 0 is missing; one of visibility 1 (labelled
but hidden) is invisible. One file holds many images. Each annotation with keypoints is an object. The category's
keypoint names become the names, and its skeleton (pairs counted from 1, or from 0) the contours.

Of several categories, that with more landmarks, and then in more images, is the object, with those of the same
keypoints.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import (
    Contour,
    Landmarks,
    Source,
    chain_edges,
    check_number,
    edges_of,
    largest_of,
    make_landmarks,
    size_of_file,
)

_Group = list[dict[str, Any]]


def parse(source: Source) -> dict[str, Landmarks]:
    """Parse the text of a COCO keypoints file into landmarks by the image's file name."""
    content = source.json
    try:
        images = {str(image["id"]): image for image in content["images"]}
        categories = {str(category["id"]): category for category in content.get("categories") or ()}
        annotations = [each for each in content["annotations"] if each.get("keypoints")]
        # Keypoints that are all of visibility 0 belong to an object that was not labelled.
        labelled = [each for each in annotations if any(each["keypoints"][2::3]) or len(each["keypoints"]) % 3]
        groups: dict[str, _Group] = {}
        for each in labelled:
            groups.setdefault(str(each.get("category_id")), []).append(each)
        chosen = _chosen(source, groups, categories, images)
    except (TypeError, KeyError, ValueError, AttributeError) as fault:
        raise LandmarkError(
            f"{source.path} lacks the parts of a COCO keypoints file (images, annotations, categories): export it "
            "again."
        ) from fault
    if not chosen:
        raise LandmarkError(f"{source.path} is COCO without keypoints: export the annotations with keypoints.")
    outline = cache(partial(_lines, source, categories))

    def make(annotation: Any) -> tuple[str, float, Landmarks]:
        image = images.get(str(annotation.get("image_id")))
        if image is None:
            raise LandmarkError(f"{source.path}: the file has no image {annotation.get('image_id')}: add it.")
        landmarks = _landmarks(source.path, annotation, str(image["file_name"]), outline)
        placing = size_of_file(image.get("width"), image.get("height"))
        return str(image["file_name"]), _area(source.path, annotation), replace(landmarks, placing=placing)

    objects: dict[str, list[tuple[float, Landmarks]]] = {}
    for image, area, landmarks in source.each(((f"annotation {each.get('id')}", each) for each in chosen), make):
        objects.setdefault(image, []).append((area, landmarks))
    return {image: largest_of(each) for image, each in objects.items()}


def _chosen(source: Source, groups: dict[str, _Group], categories: dict[str, Any], images: dict[str, Any]) -> _Group:
    """Return the annotations of the category that is the object, and of those with the same keypoints."""
    names = {key: str(categories.get(key, {}).get("name", key)) for key in groups}
    wanted = source.reading.category
    if wanted is not None:
        keys = [key for key in groups if wanted.casefold() in (key.casefold(), names[key].casefold())]
        if not keys:
            raise LandmarkError(
                f"{source.path} has no keypoints of the category '{wanted}': it has {', '.join(names.values())}."
            )
        return [each for key in keys for each in groups[key]]
    if len(groups) < 2:
        return [each for group in groups.values() for each in group]

    def rank(key: str) -> tuple[int, int]:
        counts = Counter(len(each["keypoints"]) for each in groups[key])
        return counts.most_common(1)[0][0], len({str(each.get("image_id")) for each in groups[key]})

    def keypoints(key: str) -> object:
        return tuple(map(str, categories.get(key, {}).get("keypoints") or ())) or rank(key)[0]

    first, *others = sorted(groups, key=rank, reverse=True)
    others = [key for key in others if keypoints(key) != keypoints(first)]
    if others and rank(others[0]) == rank(first):
        raise LandmarkError(
            f"{source.path} has the categories '{names[first]}' and '{names[others[0]]}' with as many landmarks and "
            "images: choose one with --category."
        )
    for key in others:
        for each in groups[key]:
            which = str(images.get(str(each.get("image_id")), {}).get("file_name", each.get("image_id")))
            what = f"left out the category '{names[key]}', because '{names[first]}' has more (--category chooses)"
            source.notes.say(what, which)
    return [each for key in groups if key not in others for each in groups[key]]


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
            annotations.append({**facts, **_keypoints(each.in_order_of(names))})
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


def _lines(source: Source, categories: Any, category: str, n: int) -> tuple[tuple[str, ...], tuple[Contour, ...]]:
    """Return the names of a category's keypoints, and their contours, as far as they suit n keypoints."""
    found = categories.get(category, {})
    names, edges = tuple(map(str, found.get("keypoints") or ())), found.get("skeleton") or ()
    if names and len(names) != n:
        source.notes.repair("keypoints are read without names, because a category has", f"{len(names)} names for {n}")
        names = ()
    sound = [edge for edge in edges if isinstance(edge, list) and len(edge) == 2 and all(map(_is_count, edge))]
    numbers = [int(number) for edge in sound for number in edge]
    first = 0 if 0 in numbers else 1  # COCO counts from 1, some programs from 0
    kept = [edge for edge in sound if all(0 <= number - first < n for number in edge)]
    if len(kept) < len(edges):
        source.notes.repair("edges of the skeleton are left out, because there are no such keypoints", str(len(edges)))
        kept = []
    return names, chain_edges((int(start) - first, int(end) - first) for start, end in kept)


def _is_count(number: Any) -> bool:
    return type(number) is int or (isinstance(number, float) and number.is_integer())


def _landmarks(path: Path, annotation: Any, image: str, outline: Any) -> Landmarks:
    values = annotation["keypoints"]
    if len(values) % 3:
        raise LandmarkError(
            f"{path}: image '{image}' has {len(values)} keypoint values, not x, y, v per keypoint: correct it."
        )
    numbers = [check_number(path, value, f"the keypoints of image '{image}'") for value in values]
    triples = zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True)
    points = [(x, y) if v else (math.nan, math.nan) for x, y, v in triples]
    invisible = (i for i, v in enumerate(numbers[2::3]) if v == 1)
    names, contours = outline(str(annotation.get("category_id")), len(points))
    return make_landmarks(path, points, contours, names, image, invisible)
