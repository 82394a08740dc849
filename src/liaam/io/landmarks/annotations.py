"""Files of annotation tools: COCO, LabelMe, Label Studio and menpo (JSON), CVAT and dlib's imglab (XML).

Positions are pixels of the image, taken as centres counted from 0, x to the right and y downwards, unless a function
says otherwise. Annotators clicked on whole pixels, so there is no shift of half a pixel.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import chain, count
from math import isnan
from pathlib import PureWindowsPath
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import natural_key
from liaam.io.landmarks import reading as rd
from liaam.io.landmarks.base import PRESENT, Contour, Landmarks, Placing, chain_edges, edges_from, edges_of
from liaam.io.landmarks.matching import names_picture
from liaam.io.landmarks.reading import HIDDEN, MISSING, SEEN, Mark, Source

_Mask = tuple[str, list[int]]  # a label, and its landmarks

_MOST_MISSING = 20  # maximum ratio of missing to present parts; above it the part names must be wrong


def parse_coco(source: Source) -> list[Landmarks]:
    """Parse annotations with keypoints, each an object of its image, the largest first.

    A keypoint of visibility 0 is missing; one of visibility 1 (labelled but hidden) is invisible. The category's
    keypoint names become the names, and its skeleton (pairs counted from 1, or from 0) the contours.
    """
    images, _ = _by_number(source.json["images"], "file_name")
    categories, unclear = _by_number(source.json.get("categories") or (), "keypoints")
    if unclear:
        raise LandmarkError(f"several categories have the number {unclear[0]}: give each a number of its own.")
    annotations = [each for each in source.json["annotations"] if each.get("keypoints")]
    # Keypoints that are all of visibility 0 belong to an object that was not labelled.
    labelled = [each for each in annotations if any(each["keypoints"][2::3]) or len(each["keypoints"]) % 3]
    order = {key: number for number, key in enumerate(images)}
    outline = cache(lambda key, n: _outline(source, categories.get(key, {}), n))

    def rank(annotation: Any) -> tuple[int, float]:
        area = rd.area_of(annotation.get("area"))
        box = annotation.get("bbox")
        area = area or rd.area_of(*(box[2:4] if isinstance(box, list) else ()))
        return order.get(str(annotation.get("image_id")), -1), -area

    def make(annotation: Any) -> tuple[str, Landmarks]:
        key = str(annotation.get("category_id"))
        number = str(annotation.get("image_id"))
        if number not in images:
            raise LandmarkError(f"the file has no image {number}: add it, or number several of this number anew.")
        name = str(images[number]["file_name"])
        values = annotation["keypoints"]
        if len(values) % 3:
            raise LandmarkError(f"image '{name}' has {len(values)} keypoint values, not x, y, v of each: correct it.")
        seen = (rd.parse_number(value, f"a keypoint of '{name}'") for value in values[2::3])
        marks = zip(map(str, count(1)), values[::3], values[1::3], seen, strict=False)
        landmarks = rd.object_of(marks, name, rd.size_of(images[number]))
        names, contours = outline(key, len(landmarks))
        return key, replace(landmarks, names=names, contours=contours)

    labelled.sort(key=rank)
    objects = source.each(((f"annotation {each.get('id')}", each) for each in labelled), make)
    return rd.of_category(source, objects, {key: str(each.get("name", key)) for key, each in categories.items()})


def _by_number(records: Any, what: str) -> tuple[dict[str, Any], list[str]]:
    """Return records by number, and the numbers of several records that differ, which are left out."""
    records_by_key: dict[str, Any] = {}
    several = [
        key for each in records if records_by_key.setdefault(key := str(each["id"]), each).get(what) != each.get(what)
    ]
    return {key: record for key, record in records_by_key.items() if key not in several}, several


def _outline(source: Source, category: Any, n: int) -> tuple[tuple[str, ...], tuple[Contour, ...]]:
    """Return the names of a category's keypoints, and their contours, as far as they suit n keypoints."""
    names = tuple(map(str, category.get("keypoints") or ()))
    skeleton = category.get("skeleton") or ()
    if names and len(names) != n:
        source.notes.repair("keypoints are read without names, because a category has", f"{len(names)} names for {n}")
        names = ()
    edges = edges_from(skeleton, n)
    if len(edges) < len(skeleton):
        what = "edges of the skeleton are left out, because there are no such keypoints"
        source.notes.repair(what, str(len(skeleton)))
        edges = []
    return names, chain_edges(edges)


def parse_labelme(source: Source) -> list[Landmarks]:
    """Parse the shapes of an image.

    Those of the type ``point`` are the landmarks, named by their labels if these differ. Points of one ``group_id``
    are an object; those without one belong to the only object that lacks their labels. If no point has a group and
    labels occur several times, points belong to the rectangle that holds them. Without points, the only polygon or line
    is read.
    """
    shapes = source.json["shapes"]
    groups = defaultdict[str, list[Mark]](list)
    lines = [shape for shape in shapes if shape.get("shape_type") in ("polygon", "linestrip", "points")]
    for shape in shapes:
        if shape.get("shape_type") == "point":
            group = "" if shape.get("group_id") is None else str(shape["group_id"])
            groups[group].append((str(shape.get("label")), *shape["points"][0][:2], SEEN))
    marks = list(chain(*groups.values()))
    distinct = len({name for name, *_ in marks}) == len(marks)
    if len(groups) == len(marks) > 1:  # the groups number the points
        named = [(name if distinct else group, *at) for group, [(name, *at)] in groups.items()]
        groups = {"": sorted(named, key=lambda mark: natural_key(mark[0]))}
    if len(groups) == 2 and distinct and "" in groups:
        groups = {"": marks}
    boxes = [_box_of(shape["points"]) for shape in shapes if shape.get("shape_type") == "rectangle"]
    if boxes and not distinct and groups.keys() == {""}:
        inside = rd.in_boxes(marks, boxes)
        groups = {str(i): marks_inside for i, marks_inside in enumerate(inside, 1)} if len(inside) > 1 else groups
    if not groups and len(lines) == 1:
        groups = {"": [("", *pair[:2], SEEN) for pair in lines[0]["points"]]}
    if not groups:
        raise LandmarkError("it has no points: place the landmarks as points.")
    image = PureWindowsPath(str(source.json.get("imagePath") or "")).name or None
    size = rd.size_of(source.json, "imageWidth", "imageHeight")
    made = [rd.object_of(group_marks, image, size, group) for group, group_marks in groups.items()]
    usual = Counter(map(len, made)).most_common(1)[0][0]
    for landmarks in made:
        if len(landmarks) != usual:
            which = f"group '{landmarks.label}' of {source.path.name}"
            source.notes.leave_out(which, f"{len(landmarks)} points where others have {usual}")
    return [landmarks for landmarks in made if len(landmarks) == usual]


def _box_of(corners: Any) -> rd.Box:
    """Return a box given by two corners or more."""
    xs, ys = ([rd.parse_number(pair[axis], "a corner") for pair in corners] for axis in (0, 1))
    return min(xs), min(ys), max(xs), max(ys)


def parse_label_studio(source: Source) -> list[Landmarks]:
    """Parse tasks, also in the short form: percent of the image's width and height, which the file states.

    Keypoints are named by their labels. Those with one parent, or related to one region, are an object. Of several
    annotations of an image the first that was not cancelled is read.
    """
    tasks = source.json if isinstance(source.json, list) else [source.json]
    records = ((f"task {i}", task) for i, task in enumerate(tasks, 1))
    objects = source.each(records, partial(objects_of_task, source))
    return rd.named_points(source, list(chain.from_iterable(objects)))


def objects_of_task(source: Source, task: dict[str, Any]) -> list[Landmarks]:
    """Return the objects of a task of Label Studio, in the long or the short form."""
    done = [each for each in task.get("annotations") or task.get("completions") or () if not each.get("was_cancelled")]
    if len(done) > 1:
        source.notes.say("of several annotations the first is read", str(task.get("id", "")))
    related: dict[str, str] = {}
    if done:
        related = _related(done[0]["result"])
        marks = [{**each, **each["value"]} for each in done[0]["result"] if each.get("value")]
    else:  # the short form
        lists = [value for value in task.values() if isinstance(value, list)]
        marks = [each for each in chain.from_iterable(lists) if isinstance(each, dict)]
    texts = [value for value in task.get("data", task).values() if isinstance(value, str) and "." in value]
    image = next(filter(names_picture, texts), texts[0] if texts else "")
    groups: dict[Any, list[Any]] = defaultdict(list)
    for mark in marks:
        if "keypointlabels" in mark or ({"labels", "x"} <= mark.keys() and "height" not in mark):
            groups[mark.get("parentID") or related.get(str(mark.get("id")))].append(mark)
    boxes = [mark for mark in marks if {"x", "y", "width", "height"} <= mark.keys() and "rectanglelabels" in mark]
    if boxes and list(groups) == [None]:
        return [_marked(image, group_marks) for group_marks in _inside(groups[None], boxes)]
    return [_marked(image, group_marks) for group_marks in groups.values()]


def _inside(marks: list[Any], boxes: list[Any]) -> list[list[Any]]:
    """Return keypoints by the box that holds them, if labels occur several times; else all as one object."""
    labels = [_label_of(mark) for mark in marks]
    if len(set(labels)) == len(labels) or len(set(labels)) == 1:
        return [marks]
    corners = [_box_of([(box["x"], box["y"]), (box["x"] + box["width"], box["y"] + box["height"])]) for box in boxes]
    named: list[Mark] = [(label, mark["x"], mark["y"], mark) for label, mark in zip(labels, marks, strict=True)]
    return [[mark[-1] for mark in inside] for inside in rd.in_boxes(named, corners)]


def _label_of(mark: Any) -> str:
    """Return the label of a keypoint."""
    return str((mark.get("keypointlabels") or mark["labels"])[0])


def _related(results: Any) -> dict[str, str]:
    """Return the region that each keypoint of an annotation is related to, by their ids."""
    keypoints = {str(each.get("id")) for each in results if each.get("type") == "keypointlabels"}
    related = {}
    for each in results:
        ends = str(each.get("from_id")), str(each.get("to_id"))
        if each.get("type") == "relation":
            for point, region in (ends, ends[::-1]):
                if point not in keypoints or region in keypoints:
                    continue
                if related.setdefault(point, region) != region:
                    raise LandmarkError("a keypoint is related to two regions: relate it to one.")
    return related


def _marked(image: str, marks: list[Any]) -> Landmarks:
    sizes = {rd.size_of(mark, "original_width", "original_height") for mark in marks}
    if len(sizes) != 1 or None in sizes:
        raise LandmarkError(f"'{image}' has keypoints for several sizes, or none: label it again.")
    if any(mark.get("image_rotation") for mark in marks):
        raise LandmarkError(f"'{image}' was labelled on a turned picture: turn the image itself, and label that.")
    labels = [_label_of(mark) for mark in marks]
    landmarks = rd.object_of(
        [(label, mark["x"], mark["y"], SEEN) for label, mark in zip(labels, marks, strict=True)], image
    )
    return replace(landmarks, points=landmarks.points / 100, placing=Placing(sizes.pop(), fractions=True))


def is_fit(content: Mapping[str, Any]) -> bool:
    """Return whether a ``.json`` file of this content is one that ``liaam fit`` writes."""
    return {"landmarks", "status"} <= content.keys()


def parse_fit(source: Source) -> list[Landmarks]:
    """Parse the ``.json`` file that ``liaam fit`` writes."""
    fit = source.json
    points: Any = [
        tuple(rd.parse_number(value, f"landmark {i}") for value in pair) for i, pair in enumerate(fit["landmarks"], 1)
    ]
    lines = Contour.all_of(fit.get("contours") or ())
    _check_indices(index for line in lines for index in line.indices)
    names = tuple(map(str, fit.get("landmark_names") or ()))
    scale = fit.get("scale")
    length = None if scale is None else rd.parse_number(scale, "the scale")
    unit = str(fit.get("scale_unit") or "")
    return [Landmarks(points, lines, names, None, _estimates(fit, points), length, unit=unit)]


def _estimates(fit: Mapping[str, Any], points: list[tuple[float, ...]]) -> tuple[int, ...]:
    """Return which points of a fit are estimates of absent landmarks: they are placed, but not seen."""
    if fit.get("present") is None:
        return ()
    present = [rd.parse_number(value, f"present {i}") for i, value in enumerate(fit["present"], 1)]
    placed = [not any(map(isnan, point)) for point in points]
    return tuple(
        i for i, (value, is_placed) in enumerate(zip(present, placed, strict=True)) if is_placed and value < PRESENT
    )


def parse_ljson(source: Source) -> list[Landmarks]:
    """Parse ``.ljson`` of versions 1 to 3: points are [y, x]; ``null`` for a missing one.

    Of several groups in version 3 the chosen one is read. The edges of the connectivity are joined into contours.
    Labels name sets of landmarks: if each landmark has its own label, the labels are the names. A further label
    ``invisible`` holds the occluded landmarks. The contours that have names, ``curves``, the length of a pixel,
    ``scale``, and its unit, ``scale_unit``, are additions of liaam, which menpo ignores.
    """
    group = _group(source.json, source.reading.category)
    edges = [(start, end) for start, end in group["landmarks"].get("connectivity") or ()]
    masks = [(str(label["label"]), list(label["mask"])) for label in group.get("labels") or ()]
    pairs = [(x, y) for y, x in group["landmarks"]["points"]]
    _check_indices(chain(*edges, *(mask for _, mask in masks)))
    points: Any = [tuple(rd.parse_number(value, f"point {i}") for value in pair) for i, pair in enumerate(pairs, 1)]
    masks, invisible = _without_invisible(masks, len(points))
    scale = None if group.get("scale") is None else rd.parse_number(group["scale"], "the scale")
    names = _names_of_masks(masks, len(points))
    unit = str(group.get("scale_unit") or "")
    return [Landmarks(points, _contours_of(group, edges), names, None, tuple(invisible), scale, unit=unit)]


def _contours_of(group: Mapping[str, Any], edges: Sequence[tuple[int, int]]) -> tuple[Contour, ...]:
    """Return the contours along edges, of which the group may name some."""
    curves = group.get("curves") or ()
    named = [Contour(tuple(curve["landmarks"]), bool(curve["closed"]), str(curve["name"])) for curve in curves]
    if not named:
        return chain_edges(edges)
    _check_indices(index for contour in named for index in contour.indices)
    place = {frozenset(edge): number for number, edge in reversed([*enumerate(edges)])}
    known = {frozenset(edge) for edge in edges_of(named)}
    if not known <= place.keys():  # another program has changed the edges
        return chain_edges(edges)
    others = chain_edges(edge for edge in edges if frozenset(edge) not in known)
    return tuple(sorted([*named, *others], key=lambda line: min(place[frozenset(edge)] for edge in edges_of([line]))))


def _check_indices(given: Iterable[Any]) -> None:
    if not all(type(index) is int for index in given):
        raise TypeError("an index is no whole number")


def _group(content: Any, wanted: str | None) -> Any:
    """Find the group of landmarks in the content of any version. Join the labelled parts of one shape of version 1."""
    version = content.get("version") if isinstance(content, dict) else None
    if version == 2:
        return content
    if version not in (1, 3):
        raise LandmarkError(f"this is not .ljson version 1, 2 or 3 (it says {version}): export it again with menpo.")
    groups = content["groups"]
    points = []
    edges = []
    labels = []
    if version == 3 and ((len(groups) > 1 and wanted is None) or (wanted is not None and wanted not in groups)):
        several = f"{len(groups)} groups of landmarks ({', '.join(groups)})"
        raise LandmarkError(f"it holds {several}: choose one of them with --category.")
    if version == 3:
        return groups[wanted or next(iter(groups), "")]
    for group in groups:
        first = len(points)
        group_points = [mark["point"] for mark in group["landmarks"]]
        points += group_points
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


def parse_cvat(source: Source) -> list[Landmarks]:
    """Parse CVAT for images: each skeleton is an object, and its points are named by their labels.

    Without skeletons, the points of an image are its landmarks: one ``points`` with all of them, or one each with its
    own label. Those of one ``group_id`` are an object.
    """
    if source.xml.find("track") is not None:
        raise LandmarkError("this is CVAT's for a video: export it as 'CVAT for images'.")
    images = source.xml.iter("image")
    records = ((image.get("name", ""), (image, *part)) for image in images for part in _parts_of_image(image))
    return rd.named_points(source, rd.of_category(source, source.each(records, _skeleton), alike=False))


def _parts_of_image(image: Any) -> list[tuple[str, list[Any]]]:
    """Return the label and the elements of points of each object."""
    skeletons = image.findall("skeleton")
    points = image.findall("points")
    groups = defaultdict[str, list[Any]](list)
    if skeletons:
        return [(each.get("label", ""), each.findall("points")) for each in skeletons]
    if any(";" in each.get("points", "") for each in points):
        return [(each.get("label", ""), [each]) for each in points if ";" in each.get("points", "")]
    for point in points:
        groups[point.get("group_id", "")].append(point)
    return [("", group) for group in groups.values()]


def _skeleton(part: tuple[Any, str, list[Any]]) -> tuple[str, Landmarks]:
    image, label, elements = part
    marks: list[Mark] = []
    for element in elements:
        seen = MISSING if element.get("outside") == "1" else HIDDEN if element.get("occluded") == "1" else SEEN
        marks += [(element.get("label", ""), *pair.split(","), seen) for pair in element.get("points", "").split(";")]
    attributes = [element.findtext("attribute", "").strip() for element in elements]
    if len({name for name, *_ in marks}) == 1 < len({*attributes}) == len(marks):  # they number the points
        marks = [(name, *at) for name, (_, *at) in zip(attributes, marks, strict=True)]
    return label, rd.object_of(marks, image.get("name", ""), rd.size_of(image))


def parse_dlib(source: Source) -> list[Landmarks]:
    """Parse imglab's boxes with parts, each an object of its image, the largest first.

    Parts are in natural order of their names (1, 2, ... 10) over all images. If a box lacks a part, that landmark is
    missing. Boxes that are marked ``ignore`` are left out.
    """
    boxes = rd.numbered_alike(rd.of_category(source, filter(None, source.each(_boxes(source), _box))))
    names = sorted({name for box in boxes for name in box.names}, key=natural_key)
    if len(names) * len(boxes) > _MOST_MISSING * sum(map(len, boxes)):
        few = f"its {len(boxes)} boxes share hardly any of the {len(names)} part names"
        raise LandmarkError(f"{few}: give a part the same name in all images.")
    return [box.with_names(names) for box in boxes]


def _boxes(source: Source) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield each image with each of its boxes that are not marked to be ignored, the largest first."""
    for image in source.xml.iter("image"):
        boxes = list(enumerate(image.iterfind("box"), 1))  # direct children, so that nested ones are not repeated
        for number, box in sorted(boxes, key=lambda each: -rd.area_of(each[1].get("width"), each[1].get("height"))):
            if box.get("ignore", "0").lower() in ("0", "false", "no", ""):
                yield f"box {number} of {image.get('file', '')}", (image, box)


def _box(pair: tuple[Any, Any]) -> tuple[str, Landmarks] | None:
    image, box = pair
    marks = [(part.get("name", ""), part.get("x", ""), part.get("y", ""), SEEN) for part in box.iterfind("part")]
    twice = [name for name, n in Counter(name for name, *_ in marks).items() if n > 1]
    if twice:
        raise LandmarkError(f"part '{twice[0]}' of image '{image.get('file', '')}' occurs twice: remove one of them.")
    label = (box.findtext("label") or "").strip()
    return (label, rd.object_of(marks, image.get("file", ""), rd.size_of(image))) if marks else None
