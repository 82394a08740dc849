"""Files of annotation tools: COCO, LabelMe, Label Studio and menpo (JSON), CVAT and dlib's imglab (XML).

Positions are pixels of the image, taken as centres counted from 0, x to the right and y downwards, unless a function
says otherwise. Annotators clicked on whole pixels, so there is no shift of half a pixel.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import chain
from pathlib import PureWindowsPath
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import natural_key
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.contours import Contour, chain_edges, edges_from
from liaam.io.landmarks.matching import names_picture
from liaam.io.landmarks.reading import (
    MISSING,
    Found,
    Source,
    area_of,
    named_points,
    names_of,
    numbered_alike,
    of_category,
    size_of_file,
    with_names,
)
from liaam.io.landmarks.text import check_number, parse_number

_MOST_MISSING = 20
"""Maximum ratio of missing to present parts; above it the part names must be wrong."""

# COCO ---------------------------------------------------------------------------------------------


def parse_coco(source: Source) -> list[Landmarks]:
    """Parse annotations with keypoints, each an object of its image, the largest first.

    A keypoint of visibility 0 is missing; one of visibility 1 (labelled but hidden) is invisible. The category's
    keypoint names become the names, and its skeleton (pairs counted from 1, or from 0) the contours.
    """
    content = source.json
    images, _ = _by_number(content["images"], "file_name")
    categories, unclear = _by_number(content.get("categories") or (), "keypoints")
    if unclear:
        raise LandmarkError(f"several categories have the number {unclear[0]}: give each a number of its own.")
    annotations = [each for each in content["annotations"] if each.get("keypoints")]
    # Keypoints that are all of visibility 0 belong to an object that was not labelled.
    labelled = [each for each in annotations if any(each["keypoints"][2::3]) or len(each["keypoints"]) % 3]
    order = {key: number for number, key in enumerate(images)}
    labelled.sort(key=lambda each: (order.get(str(each.get("image_id")), -1), -_area(each)))
    outline = cache(partial(_outline, source, categories))

    def make(annotation: Any) -> Found:
        key = str(annotation.get("category_id"))
        category = categories.get(key, {})
        kind = tuple(sorted(map(str, category.get("keypoints") or ()))) or len(annotation["keypoints"])
        return Found(_annotated(annotation, images, outline), key, str(category.get("name", key)), kind)

    return of_category(source, source.each(((f"annotation {each.get('id')}", each) for each in labelled), make))


def _by_number(records: Any, what: str) -> tuple[dict[str, Any], list[str]]:
    """Return records by number, and the numbers of several records that differ, which are left out."""
    found: dict[str, Any] = {}
    several = [key for each in records if found.setdefault(key := str(each["id"]), each).get(what) != each.get(what)]
    return {key: record for key, record in found.items() if key not in several}, several


def _area(annotation: Any) -> float:
    """Return the area of an annotation, or of its box."""
    box = annotation.get("bbox")
    return area_of(annotation.get("area")) or area_of(*(box[2:4] if isinstance(box, list) else ()))


def _annotated(annotation: Any, images: dict[str, Any], outline: Any) -> Landmarks:
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


def _outline(source: Source, categories: Any, category: str, n: int) -> tuple[tuple[str, ...], tuple[Contour, ...]]:
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


# LabelMe ------------------------------------------------------------------------------------------


def parse_labelme(source: Source) -> list[Landmarks]:
    """Parse the shapes of an image.

    Those of the type ``point`` are the landmarks, named by their labels if these differ. Points of one ``group_id``
    are an object; those without one belong to the only object that lacks their labels. Without points, the only polygon
    or line is read.
    """
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
    if len(groups) == 2 and len({label for own in groups.values() for label, _ in own}) == len(points) and "" in groups:
        groups = {"": [pair for own in groups.values() for pair in own]}
    if not points and len(lines) == 1:
        groups = {"": [("", pair) for pair in lines[0]["points"]]}
    if not groups:
        raise LandmarkError("it has no points: place the landmarks as points.")
    made = [_shape(source.json, group, own) for group, own in groups.items()]
    usual = Counter(map(len, made)).most_common(1)[0][0]
    for own in made:
        if len(own) != usual:
            which = f"group '{own.label}' of {source.path.name}"
            source.notes.leave_out(which, f"{len(own)} points where others have {usual}")
    return [own for own in made if len(own) == usual]


def _shape(content: Any, group: str, pairs: list[tuple[str, Any]]) -> Landmarks:
    points: Any = [tuple(check_number(value, f"point '{label}'") for value in pair[:2]) for label, pair in pairs]
    image = PureWindowsPath(str(content.get("imagePath") or "")).name or None
    placing = size_of_file(content.get("imageWidth"), content.get("imageHeight"))
    names = names_of([label for label, _ in pairs])
    return Landmarks(points, names=names, image_name=image, label=group, placing=placing)


# Label Studio -------------------------------------------------------------------------------------


def parse_label_studio(source: Source) -> list[Landmarks]:
    """Parse tasks, also in the short form: percent of the image's width and height, which the file states.

    Keypoints are named by their labels. Those with one parent are an object. Of several annotations of an image the
    first that was not cancelled is read.
    """
    tasks = source.json if isinstance(source.json, list) else [source.json]
    records = ((f"task {i}", task) for i, task in enumerate(tasks, 1))
    found = source.each(records, partial(_objects_of_task, source))
    return named_points(source, list(chain.from_iterable(found)))


def _objects_of_task(source: Source, task: dict[str, Any]) -> list[Landmarks]:
    done = [each for each in task.get("annotations") or task.get("completions") or () if not each.get("was_cancelled")]
    if len(done) > 1:
        source.notes.say("of several annotations the first is read", str(task.get("id", "")))
    if done:
        marks = [{**each, **each["value"]} for each in done[0]["result"] if each.get("value")]
    else:  # the short form
        lists = [value for value in task.values() if isinstance(value, list)]
        marks = [each for each in chain.from_iterable(lists) if isinstance(each, dict)]
    texts = [value for value in task.get("data", task).values() if isinstance(value, str) and "." in value]
    image = next(filter(names_picture, texts), texts[0] if texts else "")
    groups: dict[Any, list[Any]] = defaultdict(list)
    for mark in marks:
        if "keypointlabels" in mark or ({"labels", "x"} <= mark.keys() and "height" not in mark):
            groups[mark.get("parentID")].append(mark)
    return [_marked(image, own) for own in groups.values()]


def _marked(image: str, marks: list[Any]) -> Landmarks:
    points: Any = [[check_number(mark[axis], f"'{image}'") / 100 for axis in "xy"] for mark in marks]
    sizes = {(float(mark["original_width"]), float(mark["original_height"])) for mark in marks}
    if len(sizes) != 1 or size_of_file(*next(iter(sizes))).size is None:
        raise LandmarkError(f"'{image}' has keypoints for several sizes: label it again.")
    if any(mark.get("image_rotation") for mark in marks):
        raise LandmarkError(f"'{image}' was labelled on a turned picture: turn the image itself, and label that.")
    names = names_of([str((mark.get("keypointlabels") or mark["labels"])[0]) for mark in marks])
    return Landmarks(points, names=names, image_name=image, placing=Placing(next(iter(sizes)), fractions=True))


# menpo --------------------------------------------------------------------------------------------

_Mask = tuple[str, list[int]]


def parse_ljson(source: Source) -> list[Landmarks]:
    """Parse ``.ljson`` of versions 1 to 3: points are [y, x]; ``null`` for a missing one.

    Of several groups in version 3 the chosen one is read. The edges of the connectivity are joined into contours.
    Labels name sets of landmarks: if each landmark has its own label, the labels are the names. A further label
    ``invisible`` holds the occluded landmarks. The length of a pixel, ``scale``, is an addition of liaam, which menpo
    ignores.
    """
    group = _group(source.json, source.reading.category)
    edges = [(start, end) for start, end in group["landmarks"].get("connectivity") or ()]
    masks = [(str(label["label"]), list(label["mask"])) for label in group.get("labels") or ()]
    pairs = [(x, y) for y, x in group["landmarks"]["points"]]
    if not all(type(index) is int for index in chain(*edges, *(mask for _, mask in masks))):
        raise TypeError("an index is no whole number")
    points: Any = [tuple(check_number(value, f"point {i}") for value in pair) for i, pair in enumerate(pairs, 1)]
    masks, invisible = _without_invisible(masks, len(points))
    scale = None if group.get("scale") is None else float(check_number(group["scale"], "the scale"))
    names = _names_of_masks(masks, len(points))
    return [Landmarks(points, chain_edges(edges), names, None, tuple(invisible), scale)]


def _group(content: Any, wanted: str | None) -> Any:
    """Find the group of landmarks in the content of any version."""
    version = content.get("version") if isinstance(content, dict) else None
    if version == 2:
        return content
    if version not in (1, 3):
        raise LandmarkError(f"this is not .ljson version 1, 2 or 3 (it says {version}): export it again with menpo.")
    groups = content["groups"]
    if version == 1:
        return _joined(groups)
    if (len(groups) > 1 and wanted is None) or (wanted is not None and wanted not in groups):
        raise LandmarkError(
            f"it holds {len(groups)} groups of landmarks ({', '.join(groups)}): choose one of them with --category."
        )
    return groups[wanted or next(iter(groups), "")]


def _joined(groups: Any) -> Any:
    """Join the groups of version 1, which are labelled parts of one shape, as version 2 has them."""
    points, edges, labels = [], [], []
    for group in groups:
        first, own = len(points), [mark["point"] for mark in group["landmarks"]]
        points += own
        edges += [(start + first, end + first) for start, end in group.get("connectivity") or ()]
        labels.append({"label": group["label"], "mask": list(range(first, len(points)))})
    return {"landmarks": {"points": points, "connectivity": edges}, "labels": labels}


def _without_invisible(masks: list[_Mask], n_points: int) -> tuple[list[_Mask], list[int]]:
    """Separate the label of invisible landmarks from the others. "invisible" may also be a landmark's name."""
    at = [i for i, (label, _) in enumerate(masks) if label == "invisible"]
    if not at or _names_of_masks(masks, n_points):
        return masks, []
    others = masks[: at[-1]] + masks[at[-1] + 1 :]
    # The label "all" is written for a single landmark without a name.
    return ([] if others == [("all", [0])] else others), masks[at[-1]][1]


def _names_of_masks(masks: list[_Mask], n_points: int) -> tuple[str, ...]:
    """Return the labels as names, if each landmark has exactly one label of its own."""
    by_index = {mask[0]: label for label, mask in masks if len(mask) == 1}
    whole = len(masks) == n_points and by_index.keys() == set(range(n_points))
    return tuple(by_index[index] for index in range(n_points)) if whole else ()


# CVAT ---------------------------------------------------------------------------------------------


def parse_cvat(source: Source) -> list[Landmarks]:
    """Parse CVAT for images: each skeleton is an object, and its points are named by their labels.

    Without skeletons, the points of an image are its landmarks: one ``points`` with all of them, or one each with its
    own label. Those of one ``group_id`` are an object.
    """
    if source.xml.find("track") is not None:
        raise LandmarkError("this is CVAT's for a video: export it as 'CVAT for images'.")
    images = source.xml.iter("image")
    records = ((image.get("name", ""), (image, *part)) for image in images for part in _parts_of_image(image))
    return named_points(source, of_category(source, source.each(records, _skeleton)))


def _parts_of_image(image: Any) -> Iterator[tuple[str, list[Any]]]:
    """Yield the label and the elements of points of each object."""
    skeletons, points = image.findall("skeleton"), image.findall("points")
    several = [each for each in points if ";" in each.get("points", "")]
    yield from ((each.get("label", ""), each.findall("points")) for each in skeletons)
    if not skeletons:
        yield from ((each.get("label", ""), [each]) for each in several)
    groups: dict[str, list[Any]] = defaultdict(list)
    for point in points if not skeletons and not several else ():
        groups[point.get("group_id", "")].append(point)
    yield from (("", group) for group in groups.values())


def _skeleton(part: tuple[Any, str, list[Any]]) -> Found:
    image, label, elements = part
    points: Any = []
    names, invisible = [], []
    for element in elements:
        for pair in element.get("points", "").split(";"):
            x, y = (parse_number(value, f"'{image.get('name')}'") for value in pair.split(","))
            invisible += [len(points)] if element.get("occluded") == "1" else []
            points.append(MISSING if element.get("outside") == "1" else (x, y))
            names.append(element.get("label", ""))
    attributes = [element.findtext("attribute", "").strip() for element in elements]
    numbered = len({*names}) == 1 < len({*attributes}) == len(points)
    named, placing = names_of(attributes if numbered else names), size_of_file(image.get("width"), image.get("height"))
    own = Landmarks(points, (), named, image.get("name", ""), tuple(invisible), placing=placing)
    return Found(own, label, kind=label)


# dlib ---------------------------------------------------------------------------------------------


def parse_dlib(source: Source) -> list[Landmarks]:
    """Parse imglab's boxes with parts, each an object of its image, the largest first.

    Parts are in natural order of their names (1, 2, ... 10) over all images. If a box lacks a part, that landmark is
    missing. Boxes that are marked ``ignore`` are left out.
    """
    images = source.xml.iter("image")
    boxes = ((f"box {n} of {image.get('file', '')}", (image, box)) for image in images for n, box in _boxes(image))
    every = [each for each in source.each(boxes, _box) if each]
    of_label: dict[str, set[str]] = defaultdict(set)
    for each in every:
        of_label[each.category].update(each.landmarks.names)
    found = of_category(source, [replace(each, kind=of_label[each.category]) for each in every])
    found = numbered_alike(found)
    names = sorted({name for own in found for name in own.names}, key=natural_key)
    if len(names) * len(found) > _MOST_MISSING * sum(map(len, found)):
        raise LandmarkError(
            f"its {len(found)} boxes share hardly any of the {len(names)} part names: give a part the same name in all "
            "images."
        )
    return [with_names(own, names) for own in found]


def _boxes(image: Any) -> Iterator[tuple[int, Any]]:
    """Yield the boxes of an image that are not marked to be ignored, the largest first."""
    boxes = list(enumerate(image.iterfind("box"), 1))  # direct children, so that nested ones are not repeated
    for number, box in sorted(boxes, key=lambda each: -area_of(each[1].get("width"), each[1].get("height"))):
        if box.get("ignore", "0").lower() in ("0", "false", "no", ""):
            yield number, box


def _box(pair: tuple[Any, Any]) -> Found | None:
    image, box = pair
    parts: dict[str, Any] = {}
    for part in box.iterfind("part"):
        where = f"part '{part.get('name')}' of image '{image.get('file', '')}'"
        if part.get("name") in parts:
            raise LandmarkError(f"{where} occurs twice: remove one of them.")
        parts[part.get("name", "")] = [parse_number(part.get(axis, ""), where) for axis in "xy"]
    if not parts:
        return None
    points: Any = list(parts.values())
    placing = size_of_file(image.get("width"), image.get("height"))
    own = Landmarks(points, names=tuple(parts), image_name=image.get("file", ""), placing=placing)
    return Found(own, (box.findtext("label") or "").strip())
