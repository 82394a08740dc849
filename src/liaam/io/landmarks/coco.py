"""COCO keypoints (``.json``): 0-indexed pixels, x to the right and y downwards.

COCO defines keypoints as "a 0-indexed location x, y". Annotators clicked on whole pixels, so the numbers are taken as
pixel centres, without a shift of half a pixel. A keypoint of visibility 0 is missing; one of visibility 1 (labelled
but hidden) is invisible. One file holds many images. Each annotation with keypoints is an object, the largest first.
The category's keypoint names become the names, and its skeleton (pairs counted from 1, or from 0) the contours.

Of several categories, that with more landmarks, and then in more images, is the object, with those of the same
keypoints.
"""

from functools import cache, partial
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.contours import Contour, chain_edges, edges_from
from liaam.io.landmarks.reading import MISSING, Labelled, Source, area_of, by_number, of_category, size_of_file
from liaam.io.landmarks.text import check_number


def is_it(source: Source) -> bool:
    """Whether it is an object with images or annotations."""
    return isinstance(source.json, dict) and bool({"images", "annotations"} & source.json.keys())


def parse(source: Source) -> list[Landmarks]:
    """Parse the annotations of images."""
    content = source.json
    images, _ = by_number(content["images"], "file_name")
    categories, unclear = by_number(content.get("categories") or (), "keypoints")
    if unclear:
        raise LandmarkError(f"several categories have the number {unclear[0]}: give each a number of its own.")
    annotations = [each for each in content["annotations"] if each.get("keypoints")]
    # Keypoints that are all of visibility 0 belong to an object that was not labelled.
    labelled = [each for each in annotations if any(each["keypoints"][2::3]) or len(each["keypoints"]) % 3]
    chosen = of_category(source, [_labelled(each, images, categories) for each in labelled])
    order = {key: number for number, key in enumerate(images)}
    chosen.sort(key=lambda each: (order.get(str(each.get("image_id")), -1), -_area(each)))
    outline = cache(partial(_lines, source, categories))
    records = ((f"annotation {each.get('id')}", each) for each in chosen)
    return list(source.each(records, lambda each: _landmarks(each, images, outline)))


def _labelled(annotation: Any, images: dict[str, Any], categories: dict[str, Any]) -> Labelled[Any]:
    key, n, image = str(annotation.get("category_id")), len(annotation["keypoints"]), str(annotation.get("image_id"))
    category = categories.get(key, {})
    keypoints = tuple(sorted(map(str, category.get("keypoints") or ()))) or n
    where = str(images.get(image, {}).get("file_name", image))
    return Labelled(key, str(category.get("name", key)), keypoints, n, where, annotation)


def _area(annotation: Any) -> float:
    """Return the area of an annotation, or of its box."""
    box = annotation.get("bbox")
    sides = box[2:4] if isinstance(box, list) else ()
    return area_of(annotation["area"]) if "area" in annotation else area_of(*sides)


def _landmarks(annotation: Any, images: dict[str, Any], outline: Any) -> Landmarks:
    image, values = images.get(str(annotation.get("image_id"))), annotation["keypoints"]
    if image is None:
        number = annotation.get("image_id")
        raise LandmarkError(f"the file has no image {number}: add it, or number several of this number anew.")
    name = str(image["file_name"])
    if len(values) % 3:
        raise LandmarkError(f"image '{name}' has {len(values)} keypoint values, not x, y, v per keypoint: correct it.")
    numbers = [check_number(value, f"the keypoints of image '{name}'") for value in values]
    triples = zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True)
    points: Any = [(x, y) if v else MISSING for x, y, v in triples]
    invisible = tuple(i for i, v in enumerate(numbers[2::3]) if v == 1)
    names, contours = outline(str(annotation.get("category_id")), len(points))
    placing = size_of_file(image.get("width"), image.get("height"))
    return Landmarks(points, contours, names, name, invisible, placing=placing)


def _lines(source: Source, categories: Any, category: str, n: int) -> tuple[tuple[str, ...], tuple[Contour, ...]]:
    """Return the names of a category's keypoints, and their contours, as far as they suit n keypoints."""
    found = categories.get(category, {})
    names, skeleton = tuple(map(str, found.get("keypoints") or ())), found.get("skeleton") or ()
    if names and len(names) != n:
        source.notes.repair("keypoints are read without names, because a category has", f"{len(names)} names for {n}")
        names = ()
    edges = edges_from(skeleton, n)
    if len(edges) < len(skeleton):
        which = str(len(skeleton))
        source.notes.repair("edges of the skeleton are left out, because there are no such keypoints", which)
        return names, ()
    return names, chain_edges(edges)
