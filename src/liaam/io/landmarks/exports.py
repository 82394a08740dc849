"""Exports of annotation tools as tables and JSON: VIA, makesense.ai, Label Studio, napari, SLEAP, QuPath, 3D Slicer.

Positions are pixels of the image, taken as centres counted from 0, x to the right and y downwards, unless a function
says otherwise.
"""

import csv
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import is_number
from liaam.io.landmarks import annotations, reading as rd, tables
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.matching import names_picture
from liaam.io.landmarks.reading import SEEN, Mark, Source

_MAKESENSE = "label,x,y,image,image_width,image_height"
_VIA_CELLS = ("region_shape_attributes", "region_attributes")
_POINTS_OF_VIA = ("all_points_x", "all_points_y")
_SLICER_COLUMNS = ("id", "x", "y", "z")
_RAS = ("0", "ras")  # names of Slicer's coordinate system whose first two axes point the other way than those of images
_FLAT = 1e-6  # greatest difference of positions across the plane of an image


# VGG Image Annotator ------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Region:
    """A region of VIA: its shape, and what is said of it."""

    shape: Mapping[str, Any]
    facts: Mapping[str, str]


def is_via_table(source: Source) -> bool:
    """Whether the first line is that of VIA."""
    return {*_VIA_CELLS} <= {*source.header}


def is_via(source: Source) -> bool:
    """Whether it is a project of VIA, or the annotations of one: records with a file name and regions."""
    if "_via_img_metadata" in source.object:
        return True
    records = source.object
    first = next(iter(records.values()), None)
    return isinstance(first, dict) and {"filename", "regions"} <= first.keys()


def parse_via_table(source: Source) -> list[Landmarks]:
    """Parse VIA's table of a row for each region. Regions that are points are the landmarks; see :func:`parse_via`."""
    at = {name: source.header.index(name) for name in _VIA_CELLS}
    image_at = next((i for i, name in enumerate(source.header) if name.lstrip("#") == "filename"), None)
    if image_at is None:
        raise LandmarkError("it has no column 'filename': export the annotations again from VIA.")
    size_at = source.header.index("file_size") if "file_size" in source.header else None
    sizes: dict[str, str] = {}
    images = defaultdict[str, list[_Region]](list)

    def add(row: list[str]) -> bool:
        shape, facts = (rd.json_of(row[at[name]] or "{}") for name in _VIA_CELLS)
        size = row[size_at] if size_at is not None else ""
        images[_checked_name(row[image_at], size, sizes)].append(_region(shape, facts))
        return True

    for _ in source.each(((f"line {number}", row) for number, row in source.rows[1:] if any(row)), add):
        pass
    return _of_regions(source, images)


def parse_via(source: Source) -> list[Landmarks]:
    """Parse VIA's annotations, or its project. Regions that are points are the landmarks, named by an attribute.

    Of several attributes that with most values names the landmarks. If names occur several times in an image, another
    attribute tells the objects. An image without points may have one line or polygon instead.
    """
    records = source.json.get("_via_img_metadata", source.json)
    images = defaultdict[str, list[_Region]](list)
    sizes: dict[str, str] = {}

    def add(record: dict[str, Any]) -> bool:
        regions = record["regions"]
        listed = regions.values() if isinstance(regions, dict) else regions
        images[_checked_name(str(record["filename"]), str(record.get("size", "")), sizes)] += [
            _region(each["shape_attributes"], each.get("region_attributes") or {}) for each in listed
        ]
        return True

    for _ in source.each(records.items(), add):
        pass
    return _of_regions(source, images)


def _checked_name(name: str, size: str, sizes: dict[str, str]) -> str:
    """Return the name of an image; raise if it has none, or that of another, whose file has another size."""
    if not name.strip():
        raise LandmarkError("a region has no file name of its image: export the annotations again from VIA.")
    if sizes.setdefault(name, size) != size:
        both = f"two images are named '{rd.short(name)}', of {sizes[name]} and {size} bytes"
        raise LandmarkError(f"{both}: rename one, and export again.")
    return name


def _region(shape: Any, facts: Any) -> _Region:
    """Make a region. An attribute with check boxes has the name of the first that is ticked as its value."""
    values = {
        str(key): str(next((name for name, on in value.items() if on), "")) if isinstance(value, dict) else str(value)
        for key, value in facts.items()
    }
    return _Region(dict(shape), values)


def _of_regions(source: Source, images: Mapping[str, list[_Region]]) -> list[Landmarks]:
    points = {
        image: [each for each in regions if each.shape.get("name") == "point"] for image, regions in images.items()
    }
    values = defaultdict[str, set[str]](set)
    for region in chain.from_iterable(points.values()):
        for key, value in region.facts.items():
            values[key].add(value)
    naming = max(values, key=lambda key: len(values[key]), default="")

    def make(image: str) -> list[Landmarks]:
        if not points[image]:
            return _of_line(image, images[image])
        groups = _grouped(points[image], naming, [key for key in values if key != naming])
        return [
            rd.object_of(
                [(region.facts.get(naming, ""), region.shape["cx"], region.shape["cy"], SEEN) for region in group],
                image,
                label=label,
            )
            for label, group in groups.items()
        ]

    made = chain.from_iterable(source.each(((image, image) for image in images), make))
    return rd.named_points(source, list(made))


def _grouped(regions: Sequence[_Region], naming: str, others: Iterable[str]) -> dict[str, list[_Region]]:
    """Return the points of each object of an image, by the attribute that tells objects, if one does."""
    names = [region.facts.get(naming, "") for region in regions]
    if len(set(names)) < len(names):
        for key in others:
            pairs = [(region.facts.get(key, ""), name) for region, name in zip(regions, names, strict=True)]
            if len(set(pairs)) == len(pairs):
                groups = defaultdict[str, list[_Region]](list)
                for region, (label, _) in zip(regions, pairs, strict=True):
                    groups[label].append(region)
                return groups
    return {"": list(regions)}


def _of_line(image: str, regions: Sequence[_Region]) -> list[Landmarks]:
    lines = [region.shape for region in regions if {*_POINTS_OF_VIA} <= region.shape.keys()]
    if len(lines) != 1:
        return []
    pairs = zip(*(lines[0][key] for key in _POINTS_OF_VIA), strict=True)
    return [rd.object_of([("", x, y, SEEN) for x, y in pairs], image)]


# Tables -------------------------------------------------------------------------------------------


def is_makesense(source: Source) -> bool:
    """Whether the first line is a point of makesense.ai: label, x, y, image, width, height."""
    _, cells = source.rows[0]
    if len(cells) != 6 or not names_picture(cells[3]):
        return False
    return all(is_number(cells[i]) for i in (1, 2, 4, 5))


def parse_makesense(source: Source) -> list[Landmarks]:
    """Parse makesense.ai's points: lines of label, x, y, image, and the image's width and height."""
    return tables.parse_long(replace(source, text=f"{_MAKESENSE}\n{source.text}"), first=0)


def is_label_studio_table(source: Source) -> bool:
    """Whether a column holds keypoints as Label Studio's JSON."""
    return any("keypointlabels" in cell and cell.startswith("[") for _, row in source.rows[1:20] for cell in row)


def parse_label_studio_table(source: Source) -> list[Landmarks]:
    """Parse Label Studio's table, whose cells hold the JSON of an image's keypoints; see its JSON."""
    (_, header), *rows = source.rows

    def task(row: list[str]) -> list[Landmarks]:
        cells = {name: rd.json_of(cell) if cell[:1] == "[" else cell for name, cell in zip(header, row, strict=False)}
        return annotations.objects_of_task(source, cells)

    objects = source.each(((f"line {number}", row) for number, row in rows if any(row)), task)
    return rd.named_points(source, list(chain.from_iterable(objects)))


def is_napari(source: Source) -> bool:
    """Whether the columns are those of napari's points."""
    return "axis_0" in source.header and "vertex_index" not in source.header


def parse_napari(source: Source) -> list[Landmarks]:
    """Parse napari's points: its last axis is x, the one before it y. A column ``label`` or ``name`` names them.

    Axes before these are those of a stack; all points must lie on one plane of it.
    """
    columns = {name: i for i, name in enumerate(source.header) if re.fullmatch(r"axis_\d{1,2}", name)}
    axes = [columns.get(f"axis_{number}", -1) for number in range(len(columns))]
    if -1 in axes or len(axes) < 2 or sum(map(source.header.count, columns)) > len(columns):
        raise LandmarkError("its axes are not axis-0, axis-1 and so on, each once: save the points again from napari.")
    (_, header), *others = source.rows
    lines = tables.whole(source, header, [line for line in others if any(line[1])])
    rows = [row for _, row in lines]
    for axis in axes[:-2]:
        if len({rd.parse_number(row[axis], f"line {number}") for number, row in lines}) > 1:
            raise LandmarkError("its points lie on several planes of a stack: save those of one image.")
    naming = next((source.header.index(name) for name in ("label", "name") if name in source.header), None)
    y, x = axes[-2:]
    marks = [("" if naming is None else row[naming], row[x], row[y], SEEN) for row in rows]
    return [rd.object_of(marks, None)] if marks else []


def is_sleap_table(source: Source) -> bool:
    """Whether the columns are those of SLEAP's analysis."""
    return {"track", "frame_idx"} <= {*source.header}


def parse_sleap_table(source: Source) -> list[Landmarks]:
    """Parse SLEAP's analysis, a row for each animal in a frame. Images have the frame's number as their name.

    Tracks are the objects of a frame. Scores are not used.
    """
    (_, header), *rows = source.rows
    pairs = tables.pairs_of(header)
    frame, track = (source.header.index(name) for name in ("frame_idx", "track"))

    def make(row: list[str]) -> Landmarks:
        points: Any = [rd.parse_point((row[axes["x"]], row[axes["y"]]), f"'{name}'") for name, axes in pairs.items()]
        if not row[frame].strip():
            raise LandmarkError("it has no number of its frame: export the analysis again from SLEAP.")
        return Landmarks(points, names=tuple(pairs), image_name=row[frame].strip(), label=row[track].strip())

    if not pairs:
        raise LandmarkError("it has no columns of body parts, as 'nose.x': export the analysis again from SLEAP.")
    made = source.each(((f"line {number}", row) for number, row in rows if any(row)), make)
    return [landmarks for landmarks in made if not landmarks.missing.all()]


# GeoJSON ------------------------------------------------------------------------------------------


def is_geojson(source: Source) -> bool:
    """Whether it is a collection of features, or a list of them, as QuPath exports."""
    first = source.json[0] if isinstance(source.json, list) and source.json else source.object
    return (isinstance(first, dict) and first.get("type") in ("FeatureCollection", "Feature")) or (
        source.path.suffix.lower() == ".geojson"
    )


def parse_geojson(source: Source) -> list[Landmarks]:
    """Parse the points of an image, as QuPath exports them: each a feature, or several in one (``MultiPoint``).

    They are named by their names, or else by their classes. Other features are not read.
    """
    content = source.json
    features = content.get("features", [content]) if isinstance(content, dict) else content
    points: list[tuple[dict[str, Any], list[Any]]] = []
    for feature in features:
        geometry = feature.get("geometry") or {}
        if geometry.get("type") == "Point":
            points.append((feature.get("properties") or {}, [geometry["coordinates"]]))
        elif geometry.get("type") == "MultiPoint":
            points.append((feature.get("properties") or {}, list(geometry["coordinates"])))
    if not points:
        raise LandmarkError(
            "it is GeoJSON without points: place the landmarks as points, as with QuPath's points tool."
        )
    marks: list[Mark] = []
    for name, (_, pairs) in zip(_names_of_features([facts for facts, _ in points]), points, strict=True):
        several = len(pairs) > 1 and len(points) > 1
        marks += [(f"{name}_{i}" if several else name, *pair[:2], SEEN) for i, pair in enumerate(pairs, 1)]
    return [rd.object_of(marks, None)]


def _names_of_features(properties: Sequence[dict[str, Any]]) -> list[str]:
    names = [str(facts.get("name") or "") for facts in properties]
    classes = [str((facts.get("classification") or {}).get("name") or "") for facts in properties]
    if all(names) and len(set(names)) >= len(set(classes)):
        return names
    return classes if any(classes) else names


# 3D Slicer ----------------------------------------------------------------------------------------


def parse_fcsv(source: Source) -> list[Landmarks]:
    """Parse 3D Slicer's table of fiducials on one plane.

    Positions are millimetres, taken as pixels of an image without spacing, as pictures are loaded. In the coordinate
    system RAS, x and y point the other way.
    """
    comments = [line.lstrip("# \t").partition("=") for line in source.lines if line.startswith("#")]
    facts = {name.strip(): value.strip() for name, _, value in comments}
    columns = [name.strip() for name in facts.get("columns", "").split(",")]
    if not {*_SLICER_COLUMNS} <= {*columns}:
        raise LandmarkError("it lacks the line '# columns = id,x,y,z,...' of 3D Slicer: save it again from Slicer.")
    try:
        rows = list(csv.reader(line for line in source.lines if not line.startswith("#")))
    except csv.Error as fault:
        raise LandmarkError(f"a line of it is no table ({fault}): save it again from Slicer.") from fault
    at = {name: columns.index(name) for name in (*_SLICER_COLUMNS, "label") if name in columns}
    short = next((row for row in rows if len(row) <= max(at.values())), None)
    if short is not None or not rows:
        raise LandmarkError("it has no fiducials, or a line of one is cut short: save it again from Slicer.")
    marks = [(row[at["label"]] if "label" in at else "", *(row[at[axis]] for axis in "xyz")) for row in rows]
    return _of_slicer(marks, facts.get("CoordinateSystem", "RAS"))


def is_slicer(source: Source) -> bool:
    """Whether it is a file of markups of 3D Slicer."""
    return isinstance(source.object.get("markups"), list)


def parse_slicer(source: Source) -> list[Landmarks]:
    """Parse 3D Slicer's markups (``.mrk.json``), whose fiducials lie on one plane; see :func:`parse_fcsv`."""
    markups = source.json["markups"]
    fiducials = [markup for markup in markups if markup.get("controlPoints")]
    if not fiducials:
        raise LandmarkError("it has no control points: place the landmarks as fiducials.")
    return list(
        chain.from_iterable(
            _of_slicer(list(_control_points(markup)), str(markup.get("coordinateSystem", "LPS")))
            for markup in fiducials
        )
    )


def _control_points(markup: dict[str, Any]) -> Iterator[Mark]:
    for point in markup["controlPoints"]:
        is_placed = point.get("positionStatus", "defined") == "defined"
        x, y, z = point["position"] if is_placed else (None, None, None)
        yield str(point.get("label", "")), x, y, z


def _of_slicer(marks: Sequence[Mark], system: str) -> list[Landmarks]:
    placed: Any = [rd.parse_number(mark[3], "z") for mark in marks if mark[3] is not None]
    if len(placed) and np.ptp(placed) > _FLAT:
        raise LandmarkError("its fiducials differ in z, so they are not those of a picture: give 2-D landmarks.")
    landmarks = rd.object_of([(name, x, y, SEEN) for name, x, y, _ in marks], None)
    if system.strip().lower() in _RAS:
        landmarks = replace(landmarks, points=-landmarks.points)
    names = Counter(re.sub(r"[-_ ]?\d+$", "", name) for name in landmarks.names)
    return [replace(landmarks, names=()) if len(names) == 1 < len(landmarks) else landmarks]
