"""The table of landmark formats. Documentation, help, messages, the studio and tests are made from it.

A new format is a function that makes landmarks of a `Source`, as those of :mod:`~liaam.io.landmarks.plain` do, a row in
`FORMATS`, and, if others have its suffix, what tells it from those that come later, in `_TOLD`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from liaam.errors import LandmarkError
from liaam.io.landmarks import annotations as an, plain, tables, writers as out
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import Source, UnrecognisedError


@dataclass(frozen=True)
class Format:
    """A landmark file format."""

    title: str  # name of the format
    suffixes: tuple[str, ...]  # suffixes of its files, lower case
    origin: str  # what its numbers count from, for the documentation
    many: bool  # whether one file can hold many images
    contours: bool
    names: bool
    parse: Callable[[Source], list[Landmarks]]  # make the landmarks of each object, as the file counts them
    # The text of one image's landmarks, and of those of many images of these sizes; None if it is not written.
    text: Callable[[Landmarks], str] | None = None
    text_of_many: Callable[[Mapping[str, Landmarks], out.Sizes], str] | None = None


_CENTRES = "centres counted from 0"
_TAKEN = f"taken as {_CENTRES}"
_FIRST = "(1, 1) is the centre of the top-left pixel"
_PERCENT, _FRACTIONS = "percent of width and height", "fractions of width and height; needs the image"
_UP = "(0, 0) is the centre of the bottom-left pixel, y upwards; needs the image"
_IMAGEJ = f"{_CENTRES}; ImageJ's results: corners"
_MENPO = f"[y, x], {_CENTRES}"
_TABLES = (".csv", ".tsv", ".txt")
_IMAGES, _LINES, _NAMES = True, True, True  # whether a format holds many images, contours, names

FORMATS: tuple[Format, ...] = (
    Format("300-W points", (".pts",), _FIRST, False, False, False, plain.parse_pts, out.pts_text),
    Format("menpo landmarks", (".ljson",), _MENPO, False, _LINES, _NAMES, an.parse_ljson, out.ljson_text),
    Format("WebMorph template", (".tem",), _TAKEN, False, _LINES, False, plain.parse_tem),
    Format("AAM-API shape", (".asf",), _FRACTIONS, False, _LINES, False, plain.parse_asf),
    Format("LabelMe", (".json",), _TAKEN, False, False, _NAMES, an.parse_labelme),
    Format("CVAT for images", (".xml",), _TAKEN, _IMAGES, False, _NAMES, an.parse_cvat),
    Format("dlib imglab", (".xml",), _CENTRES, _IMAGES, False, _NAMES, an.parse_dlib),
    Format("Label Studio", (".json",), _PERCENT, _IMAGES, False, _NAMES, an.parse_label_studio),
    Format("COCO keypoints", (".json",), _TAKEN, _IMAGES, _LINES, _NAMES, an.parse_coco, None, out.coco_of_many),
    Format("fit by liaam", (".json",), _CENTRES, False, _LINES, _NAMES, an.parse_fit),
    Format("tpsDig points", (".tps",), _UP, _IMAGES, _LINES, False, plain.parse_tps, out.tps_text, out.tps_of_many),
    Format("NTSYS matrix", (".nts",), "as .tps", _IMAGES, False, False, plain.parse_nts),
    Format("StereoMorph shapes", (".txt",), _CENTRES, False, False, _NAMES, plain.parse_shapes),
    Format("DeepLabCut table", _TABLES, _CENTRES, _IMAGES, False, _NAMES, tables.parse_dlc),
    Format("table of one row an image", _TABLES, _CENTRES, _IMAGES, False, _NAMES, tables.parse_wide),
    Format("table", _TABLES, _IMAGEJ, _IMAGES, False, _NAMES, tables.parse_long, out.csv_text, out.csv_of_many),
    Format("list of lines with an image's name", (".txt", ".csv"), _CENTRES, _IMAGES, False, False, tables.parse_list),
    Format("lines of x and y, HELEN's", (".txt",), _CENTRES, False, False, _NAMES, plain.parse_lines),
)
"""Formats, in order of preference where an image has several files, and in the order that they are tried for a suffix.

A file of its own takes precedence over one for many images."""

_TOLD: dict[str, Callable[[Source], object]] = {
    "LabelMe": lambda file: isinstance(file.object.get("shapes"), list),
    "CVAT for images": lambda file: file.xml.tag == "annotations",
    "Label Studio": lambda file: isinstance(file.json, list) or {"data", "annotations"} <= file.object.keys(),
    "COCO keypoints": lambda file: {"images", "annotations"} & file.object.keys(),
    "fit by liaam": lambda file: an.is_fit(file.object),
    "StereoMorph shapes": lambda file: "<landmarks.pixel" in file.text,
    "DeepLabCut table": lambda file: file.rows[0][1][:1] == ["scorer"],
    "table of one row an image": lambda file: len(tables.pairs_of(file.rows[0][1])) > 1,
    "table": lambda file: tables.has_points(file.header),
    "list of lines with an image's name": tables.is_list,
    "lines of x and y, HELEN's": plain.lines_of,
}
"""What tells a file of a format from others of its suffix that come later."""

LANDMARK_SUFFIXES = tuple(dict.fromkeys(suffix for form in FORMATS for suffix in form.suffixes))
"""Suffixes (lower case) of the landmark files that can be read, in order of preference."""


def titles_of(suffix: str) -> str:
    """Return the names of the formats of a suffix."""
    return ", ".join(form.title for form in FORMATS if suffix in form.suffixes)


_GROUPS = {form.suffixes: [own.title for own in FORMATS if own.suffixes == form.suffixes] for form in FORMATS}
KNOWN_FILES = "; ".join(f"{', '.join(suffixes)} ({', '.join(titles)})" for suffixes, titles in _GROUPS.items())
"""All formats by suffix, for help and messages."""


def formats_of(path: Path) -> list[Format]:
    """Return the formats of a file's suffix. Raise if there are none."""
    found = [form for form in FORMATS if path.suffix.lower() in form.suffixes]
    if not found:
        fault = f"has the extension '{path.suffix}', not that of a landmark format"
        raise LandmarkError(f"{path} {fault}: use {KNOWN_FILES}.")
    return found


def format_of(source: Source) -> Format:
    """Return the format that a file has, of those of its suffix. Raise if it has none."""
    for form in formats_of(source.path):
        if form.title not in _TOLD or _TOLD[form.title](source):
            return form
    suffix = source.path.suffix.lower()
    if suffix == ".json":
        raise UnrecognisedError(f"this is none of {titles_of(suffix)}: export it as one of these.")
    remedy = "name the columns in the first line, as x,y"
    raise UnrecognisedError(f"there are no columns x and y, or rows of x and y: {remedy}.")


def may_hold_many(path: Path) -> bool:
    """Return whether files of this suffix may hold many images, or one that does not have the file's name."""
    return path.suffix.lower() == ".asf" or any(form.many for form in formats_of(path))


def writer_of(path: Path, many: bool = False) -> Callable[..., str]:
    """Return the function that formats the landmarks of one image, or of many, for a suffix. Raise if there is none."""
    known = formats_of(path)
    writers = {form: form.text_of_many if many else form.text for form in FORMATS}
    for form in known:
        if (text := writers[form]) is not None:
            return text
    use = ", ".join(form.suffixes[0] for form, text in writers.items() if text is not None)
    if many:
        raise LandmarkError(f"{path} cannot be written: only {use} hold many images. Use such an extension.")
    holds_many = any(form.text_of_many is not None for form in known)
    fault = "holds many images, so it is written by write_collection" if holds_many else "is only read"
    raise LandmarkError(f"{path} cannot be written: {path.suffix} {fault}. Use {use}.")


def rank_of(landmarks: Landmarks) -> int:
    """Return the place of landmarks' format in the order of preference."""
    return next((i for i, form in enumerate(FORMATS) if form.title == landmarks.format), len(FORMATS))
