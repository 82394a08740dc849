"""The table of landmark formats. Documentation, help, messages, the studio and tests are made from it.

A new format is a function that makes landmarks of a `Source`, as those of :mod:`~liaam.io.landmarks.plain` do, and a
row in `FORMATS`. If others have its suffix, the row also has a function that tells the format from those that come
later. Files of tools that are recognised but not read are rows in `OTHER_TOOLS`.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.landmarks import annotations, exports, imagej, plain, tables, writers, yolo
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import Source, UnrecognisedError


def _any_file(_: Source) -> bool:
    """Accept every file of the suffix that the formats before did not accept."""
    return True


@dataclass(frozen=True, kw_only=True)
class Format:
    """A landmark file format.

    Attributes
    ----------
    title : str
        Name of the format.
    suffixes : tuple of str
        Suffixes of its files, lower case.
    origin : str
        What its numbers count from, for the documentation.
    parse : callable
        Makes the landmarks of each object in a file, as the file counts them.
    is_format_of : callable
        Whether a file is of this format, and not of one with the same suffix that comes later in `FORMATS`.
    zero : float
        What 0 in its files is in pixels.
    many : bool
        Whether one file can hold many images.
    contours, names : bool
        Whether the format holds contours, and names of landmarks.
    needs_image : bool
        Whether the size of the image is needed to place the landmarks in it.
    names_image : bool
        Whether a file of one image may name another than that of its own name.
    binary : bool
        Whether its files are no text.
    text : callable, optional
        Formats the landmarks of one image as the content of a file. None if the format is not written, or only for
        many images.
    text_of_many : callable, optional
        Formats the landmarks of many images, and the sizes of these images. None if the format is not written for many.
    """

    title: str
    suffixes: tuple[str, ...]
    origin: str
    parse: Callable[[Source], list[Landmarks]]
    is_format_of: Callable[[Source], bool] = _any_file
    zero: float = 0.0
    many: bool = False
    contours: bool = False
    names: bool = False
    needs_image: bool = False
    names_image: bool = False
    binary: bool = False
    text: Callable[[Landmarks], str] | None = None
    text_of_many: Callable[[Mapping[str, Landmarks], writers.Sizes], str] | None = None


def _is_labelme(source: Source) -> bool:
    return isinstance(source.object.get("shapes"), list)


def _is_cvat(source: Source) -> bool:
    return source.xml.tag == "annotations"


def _is_label_studio(source: Source) -> bool:
    """Whether it is a list of tasks, as Label Studio exports them, or one task."""
    return isinstance(source.json, list) or {"data", "annotations"} <= source.object.keys()


def _is_coco(source: Source) -> bool:
    return "images" in source.object or "annotations" in source.object


def _is_fit(source: Source) -> bool:
    return annotations.is_fit(source.object)


def _is_stereomorph(source: Source) -> bool:
    return "<landmarks.pixel" in source.text


def _is_deeplabcut(source: Source) -> bool:
    _, first_row = source.rows[0]
    return first_row[:1] == ["scorer"]


def _is_table_of_images(source: Source) -> bool:
    """Whether the first row names columns of x and y for several landmarks."""
    _, header = source.rows[0]
    return len(tables.pairs_of(header)) > 1


def _is_table_of_points(source: Source) -> bool:
    return tables.has_points(source.header)


def _is_lines_of_points(source: Source) -> bool:
    return bool(plain.lines_of(source))


_CENTRES = "centres counted from 0"
_TAKEN_AS_CENTRES = f"taken as {_CENTRES}"  # of formats that do not say what their numbers count from
_SUFFIXES_OF_TABLES = (".csv", ".tsv", ".txt", ".xlsx")

FORMATS: tuple[Format, ...] = (
    Format(
        title="300-W points",
        suffixes=(".pts",),
        origin="(1, 1) is the centre of the top-left pixel",
        zero=-1.0,
        parse=plain.parse_pts,
        text=writers.pts_text,
    ),
    Format(
        title="menpo landmarks",
        suffixes=(".ljson",),
        origin=f"[y, x], {_CENTRES}",
        contours=True,
        names=True,
        parse=annotations.parse_ljson,
        text=writers.ljson_text,
    ),
    Format(
        title="WebMorph template",
        suffixes=(".tem",),
        origin=_TAKEN_AS_CENTRES,
        contours=True,
        parse=plain.parse_tem,
    ),
    Format(
        title="AAM-API shape",
        suffixes=(".asf",),
        origin="fractions of width and height; needs the image",
        contours=True,
        needs_image=True,
        names_image=True,
        parse=plain.parse_asf,
    ),
    Format(
        title="LabelMe",
        suffixes=(".json",),
        origin=_TAKEN_AS_CENTRES,
        names=True,
        is_format_of=_is_labelme,
        parse=annotations.parse_labelme,
    ),
    Format(
        title="GeoJSON, QuPath",
        suffixes=(".geojson", ".json"),
        origin=_TAKEN_AS_CENTRES,
        names=True,
        is_format_of=exports.is_geojson,
        parse=exports.parse_geojson,
    ),
    Format(
        title="3D Slicer markups",
        suffixes=(".json",),
        origin="pixels of a picture without spacing, on one plane",
        names=True,
        is_format_of=exports.is_slicer,
        parse=exports.parse_slicer,
    ),
    Format(
        title="3D Slicer fiducials",
        suffixes=(".fcsv",),
        origin="pixels of a picture without spacing, on one plane",
        names=True,
        parse=exports.parse_fcsv,
    ),
    Format(
        title="ImageJ selection",
        suffixes=(".roi",),
        origin="whole pixels, or fractions from the corner of the first",
        binary=True,
        parse=imagej.parse_roi,
    ),
    Format(
        title="ImageJ selections",
        suffixes=(".zip",),
        origin="as .roi",
        names=True,
        binary=True,
        parse=imagej.parse_roi_set,
    ),
    Format(
        title="CVAT for images",
        suffixes=(".xml",),
        origin=_TAKEN_AS_CENTRES,
        many=True,
        names=True,
        is_format_of=_is_cvat,
        parse=annotations.parse_cvat,
    ),
    Format(
        title="dlib imglab",
        suffixes=(".xml",),
        origin=_CENTRES,
        many=True,
        names=True,
        parse=annotations.parse_dlib,
    ),
    Format(
        title="VGG Image Annotator",
        suffixes=(".json",),
        origin=_TAKEN_AS_CENTRES,
        many=True,
        names=True,
        is_format_of=exports.is_via,
        parse=exports.parse_via,
    ),
    Format(
        title="Label Studio",
        suffixes=(".json",),
        origin="percent of width and height",
        many=True,
        names=True,
        is_format_of=_is_label_studio,
        parse=annotations.parse_label_studio,
    ),
    Format(
        title="COCO keypoints",
        suffixes=(".json",),
        origin=_TAKEN_AS_CENTRES,
        many=True,
        contours=True,
        names=True,
        is_format_of=_is_coco,
        parse=annotations.parse_coco,
        text_of_many=writers.coco_of_many,
    ),
    Format(
        title="fit by liaam",
        suffixes=(".json",),
        origin=_CENTRES,
        contours=True,
        names=True,
        is_format_of=_is_fit,
        parse=annotations.parse_fit,
    ),
    Format(
        title="tpsDig points",
        suffixes=(".tps",),
        origin="(0, 0) is the centre of the bottom-left pixel, y upwards; needs the image",
        many=True,
        contours=True,
        needs_image=True,
        parse=plain.parse_tps,
        text=writers.tps_text,
        text_of_many=writers.tps_of_many,
    ),
    Format(
        title="NTSYS matrix",
        suffixes=(".nts",),
        origin="as .tps",
        many=True,
        needs_image=True,
        parse=plain.parse_nts,
    ),
    Format(
        title="StereoMorph shapes",
        suffixes=(".txt",),
        origin=_CENTRES,
        names=True,
        is_format_of=_is_stereomorph,
        parse=plain.parse_shapes,
    ),
    Format(
        title="Morphologika",
        suffixes=(".txt",),
        origin=_TAKEN_AS_CENTRES,
        many=True,
        contours=True,
        is_format_of=plain.is_morphologika,
        parse=plain.parse_morphologika,
    ),
    Format(
        title="YOLO pose",
        suffixes=(".txt",),
        origin="fractions of width and height; needs the image",
        names=True,
        needs_image=True,
        is_format_of=yolo.is_yolo,
        parse=yolo.parse_yolo,
    ),
    Format(
        title="VGG Image Annotator table",
        suffixes=_SUFFIXES_OF_TABLES,
        origin=_TAKEN_AS_CENTRES,
        many=True,
        names=True,
        is_format_of=exports.is_via_table,
        parse=exports.parse_via_table,
    ),
    Format(
        title="Label Studio table",
        suffixes=_SUFFIXES_OF_TABLES,
        origin="percent of width and height",
        many=True,
        names=True,
        is_format_of=exports.is_label_studio_table,
        parse=exports.parse_label_studio_table,
    ),
    Format(
        title="makesense.ai points",
        suffixes=_SUFFIXES_OF_TABLES,
        origin=_TAKEN_AS_CENTRES,
        many=True,
        names=True,
        is_format_of=exports.is_makesense,
        parse=exports.parse_makesense,
    ),
    Format(
        title="napari points",
        suffixes=_SUFFIXES_OF_TABLES,
        origin=f"[y, x], {_CENTRES}",
        names=True,
        is_format_of=exports.is_napari,
        parse=exports.parse_napari,
    ),
    Format(
        title="SLEAP table",
        suffixes=_SUFFIXES_OF_TABLES,
        origin=_CENTRES,
        many=True,
        names=True,
        is_format_of=exports.is_sleap_table,
        parse=exports.parse_sleap_table,
    ),
    Format(
        title="DeepLabCut table",
        suffixes=_SUFFIXES_OF_TABLES,
        origin=_CENTRES,
        many=True,
        names=True,
        is_format_of=_is_deeplabcut,
        parse=tables.parse_dlc,
    ),
    Format(
        title="table of one row an image",
        suffixes=_SUFFIXES_OF_TABLES,
        origin=_CENTRES,
        many=True,
        names=True,
        is_format_of=_is_table_of_images,
        parse=tables.parse_wide,
    ),
    Format(
        title="table",
        suffixes=_SUFFIXES_OF_TABLES,
        origin=f"{_CENTRES}; ImageJ's results: corners",
        many=True,
        names=True,
        is_format_of=_is_table_of_points,
        parse=tables.parse_long,
        text=writers.csv_text,
        text_of_many=writers.csv_of_many,
    ),
    Format(
        title="list of lines with an image's name",
        suffixes=(".txt", ".csv"),
        origin=_CENTRES,
        many=True,
        is_format_of=tables.is_list,
        parse=tables.parse_list,
    ),
    Format(
        title="lines of x and y, HELEN's",
        suffixes=(".txt",),
        origin=_CENTRES,
        names=True,
        is_format_of=_is_lines_of_points,
        parse=plain.parse_lines,
    ),
)
"""Formats, in order of preference where an image has several files, and in the order that they are tried for a suffix.

A file of its own takes precedence over one for many images."""

LANDMARK_SUFFIXES = tuple(dict.fromkeys(suffix for form in FORMATS for suffix in form.suffixes))
"""Suffixes (lower case) of the landmark files that can be read, in order of preference."""


def titles_of(suffix: str) -> str:
    """Return the names of the formats of a suffix."""
    return ", ".join(form.title for form in FORMATS if suffix in form.suffixes)


def _formats_by_suffixes() -> str:
    """List the suffixes with the names of their formats, as ``.xml (CVAT for images, dlib imglab); ...``."""
    titles: dict[tuple[str, ...], list[str]] = {}
    for form in FORMATS:
        titles.setdefault(form.suffixes, []).append(form.title)
    return "; ".join(f"{', '.join(suffixes)} ({', '.join(names)})" for suffixes, names in titles.items())


KNOWN_FILES = _formats_by_suffixes()
"""All formats by suffix, for help and messages."""


ALSO_OTHER = (".txt", ".zip", ".xlsx")
"""Suffixes of files that often hold something else, so that they are passed over unless landmarks are in them."""


@dataclass(frozen=True)
class OtherTool:
    """Files of a tool that are recognised, to say what to export instead.

    Attributes
    ----------
    suffixes : tuple of str
        Suffixes of its files, lower case.
    is_file_of : callable
        Whether a file is of the tool.
    fault : str
        What it is, and what to do instead, for the error.
    """

    suffixes: tuple[str, ...]
    is_file_of: Callable[[Source], bool]
    fault: str


def _first_of_list(source: Source) -> dict[str, Any]:
    """Return the first object of a list in JSON; empty if there is none."""
    first = source.json[0] if isinstance(source.json, list) and source.json else None
    return first if isinstance(first, dict) else {}


def _is_create_ml(source: Source) -> bool:
    marks = _first_of_list(source).get("annotations")
    return isinstance(marks, list) and any(isinstance(mark, dict) and "coordinates" in mark for mark in marks)


def _is_napari_shapes(source: Source) -> bool:
    return "vertex-index" in source.text[:1000] and {"axis_0", "vertex_index"} <= {*source.header}  # in the first line


def _is_darwin(source: Source) -> bool:
    return {"item", "annotations"} <= source.object.keys()


def _is_encord(source: Source) -> bool:
    return "data_units" in _first_of_list(source) or "data_units" in source.object


def _is_label_img(source: Source) -> bool:
    return source.xml.tag == "annotation" and source.xml.find(".//bndbox") is not None


_AS_TABLE = "save a table of the columns image, landmark, x and y, in pixels"

OTHER_TOOLS: tuple[OtherTool, ...] = (
    OtherTool(
        (".json",),
        _is_darwin,
        f"this is an export of Darwin (V7), which is not read: {_AS_TABLE}.",
    ),
    OtherTool(
        (".json",),
        _is_encord,
        f"this is an export of Encord, which is not read: export COCO keypoints, or {_AS_TABLE}.",
    ),
    OtherTool((".json",), _is_create_ml, f"this is an export of CreateML, which holds boxes, not points: {_AS_TABLE}."),
    OtherTool(
        (".xml",),
        _is_label_img,
        f"this is an export of labelImg (Pascal VOC), which holds boxes, not points: {_AS_TABLE}.",
    ),
    OtherTool(
        _SUFFIXES_OF_TABLES,
        _is_napari_shapes,
        "this holds shapes of napari, not points: place the landmarks in a layer of points, and save that.",
    ),
)
"""Files that are recognised and not read."""


NOT_READ = {
    ".h5": "DeepLabCut writes a .csv beside it; in SLEAP, export the analysis as CSV",
    ".hdf5": "export a table as CSV",
    ".slp": "in SLEAP, export the analysis as CSV",
    ".mat": "in MATLAB, save a table with writetable",
    ".xls": "save it as .xlsx, or as CSV",
    ".ods": "save it as .xlsx, or as CSV",
    ".numbers": "export it as CSV",
    ".rds": "in R, save a table with write.csv",
    ".rdata": "in R, save a table with write.csv",
    ".npy": "save a table, or give the array to liaam.io.write_landmarks",
    ".npz": "save a table, or give the arrays to liaam.io.write_landmarks",
}
"""Suffixes of files that often hold landmarks and are not read, since they need other programs; and what to do."""


def ending_of(path: Path) -> str:
    """Return the ending that tells a file's format, lower case: of ``all.tps.txt``, as Windows hides it, ``.tps``."""
    suffix = path.suffix.lower()
    inner = Path(path.stem).suffix.lower()
    return inner if suffix == ".txt" and inner in LANDMARK_SUFFIXES else suffix


def name_of(path: Path) -> str:
    """Return the name of the image of a file for one: its own without what tells the format.

    Examples
    --------
    >>> name_of(Path("wing.pts")), name_of(Path("wing.pts.txt")), name_of(Path("wing.mrk.json"))
    ('wing', 'wing', 'wing')
    """
    stem = path.stem if ending_of(path) == path.suffix.lower() else Path(path.stem).stem
    return re.sub(r"(?i)(?<=.)(\.mrk|[ _-]?RoiSet)\Z", "", stem)


def formats_of(path: Path) -> list[Format]:
    """Return the formats of a file's ending. Raise if there are none."""
    formats = [form for form in FORMATS if ending_of(path) in form.suffixes]
    if not formats:
        fault = f"has the extension '{path.suffix}', not that of a landmark format"
        remedy = NOT_READ.get(path.suffix.lower(), f"use {KNOWN_FILES}")
        raise LandmarkError(f"{path} {fault}: {remedy}.")
    return formats


def format_of(source: Source) -> Format:
    """Return the format that a file has, of those of its ending. Raise if it has none."""
    ending = ending_of(source.path)
    for tool in OTHER_TOOLS:
        if ending in tool.suffixes and tool.is_file_of(source):
            raise LandmarkError(tool.fault)
    for form in formats_of(source.path):
        if form.is_format_of(source):
            return form
    if ending == ".txt" and plain.is_tps(source):
        return next(form for form in FORMATS if form.parse is plain.parse_tps)
    if ending == ".json":
        raise UnrecognisedError(f"this is none of {titles_of(ending)}: export it as one of these.")
    remedy = "name the columns in the first line, as x,y"
    raise UnrecognisedError(f"there are no columns x and y, or rows of x and y: {remedy}.")


def may_hold_many(path: Path) -> bool:
    """Return whether files of this ending may hold many images, or one that does not have the file's name."""
    return any(form.many or form.names_image for form in formats_of(path))


def needs_image(path: Path) -> bool:
    """Return whether files of this ending may need the size of their image."""
    return any(form.needs_image for form in FORMATS if ending_of(path) in form.suffixes)


def is_binary(path: Path) -> bool:
    """Return whether files of this ending are no text."""
    return all(form.binary for form in formats_of(path))


def writer_of(path: Path, many: bool = False) -> Callable[..., str]:
    """Return the function that formats the landmarks of one image, or of many, for a suffix. Raise if there is none."""
    formats = [form for form in formats_of(path) if path.suffix.lower() in form.suffixes]
    for form in formats:
        writer = form.text_of_many if many else form.text
        if writer is not None:
            return writer
    if many:
        suffixes = ", ".join(form.suffixes[0] for form in FORMATS if form.text_of_many is not None)
        raise LandmarkError(f"{path} cannot be written: only {suffixes} hold many images. Use such an extension.")
    suffixes = ", ".join(form.suffixes[0] for form in FORMATS if form.text is not None)
    if any(form.text_of_many is not None for form in formats):
        fault = "holds many images, so it is written by write_collection"
    else:
        fault = "is only read"
    raise LandmarkError(f"{path} cannot be written: {path.suffix} {fault}. Use {suffixes}.")


def rank_of(landmarks: Landmarks) -> int:
    """Return the place of landmarks' format in the order of preference; the last if it is none of these formats."""
    for rank, form in enumerate(FORMATS):
        if form.title == landmarks.format:
            return rank
    return len(FORMATS)
