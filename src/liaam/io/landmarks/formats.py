"""The table of landmark formats. Documentation, help, messages, the studio and tests are made from it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

from liaam.errors import LandmarkError
from liaam.io.landmarks import (
    asf,
    coco,
    csv_points,
    cvat,
    deeplabcut,
    dlib_xml,
    label_studio,
    labelme,
    lists,
    ljson,
    nts,
    pts,
    stereomorph,
    tem,
    text_points,
    tps,
    wide,
    writers,
)
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.reading import LACKING, Source, UnrecognisedError, in_objects

Parsed = Landmarks | dict[str, Landmarks]


@dataclass(frozen=True)
class Format:
    """A landmark file format."""

    title: str
    """Name of the format."""
    suffixes: tuple[str, ...]
    """Suffixes of its files, lower case."""
    reader: ModuleType
    """Its `parse` makes landmarks of a source; `is_it`, if there is one, tells it from others of the same suffix."""
    origin: str
    """What its numbers count from, for the documentation."""
    many: bool = False
    """Whether one file can hold many images."""
    contours: bool = False
    names: bool = False
    text: Callable[[Landmarks], str] | None = None
    """Format landmarks as a file's text; None if the format is read-only. y of ``.tps`` counts upwards."""
    text_of_many: Callable[[Mapping[str, Landmarks], writers.Sizes], str] | None = None
    """Format the landmarks of many images, of these sizes, as a file's text."""


_CENTRES = "centres counted from 0"
_TAKEN = f"taken as {_CENTRES}"
_TPS = "(0, 0) is the centre of the bottom-left pixel, y upwards; needs the image"
_IMAGEJ = f"{_CENTRES}; ImageJ's results: corners"
_TABLES = (".csv", ".tsv", ".txt")
_CSV = (writers.csv_text, writers.csv_collection)

FORMATS: tuple[Format, ...] = (
    Format("300-W points", (".pts",), pts, "(1, 1) is the centre of the top-left pixel", text=writers.pts_text),
    Format("menpo landmarks", (".ljson",), ljson, f"[y, x], {_CENTRES}", False, True, True, writers.ljson_text),
    Format("WebMorph template", (".tem",), tem, _TAKEN, contours=True),
    Format("AAM-API shape", (".asf",), asf, "fractions of width and height; needs the image", contours=True),
    Format("LabelMe", (".json",), labelme, _TAKEN, names=True),
    Format("CVAT for images", (".xml",), cvat, _TAKEN, many=True, names=True),
    Format("dlib imglab", (".xml",), dlib_xml, _CENTRES, many=True, names=True),
    Format("Label Studio", (".json",), label_studio, "percent of width and height", many=True, names=True),
    Format("COCO keypoints", (".json",), coco, _TAKEN, True, True, True, text_of_many=writers.coco_collection),
    Format("tpsDig points", (".tps",), tps, _TPS, True, True, False, writers.tps_text, writers.tps_collection),
    Format("NTSYS matrix", (".nts",), nts, "as .tps", many=True),
    Format("StereoMorph shapes", (".txt",), stereomorph, _CENTRES, names=True),
    Format("DeepLabCut table", _TABLES, deeplabcut, _CENTRES, many=True, names=True),
    Format("table of one row an image", _TABLES, wide, _CENTRES, many=True, names=True),
    Format("table", _TABLES, csv_points, _IMAGEJ, True, False, True, *_CSV),
    Format("list of lines with an image's name", (".txt", ".csv"), lists, _CENTRES, many=True),
    Format("lines of x and y, HELEN's", (".txt",), text_points, _CENTRES, names=True),
)
"""Formats, in order of preference where an image has several files, and in the order that they are tried for a suffix.

A file of its own takes precedence over one for many images."""

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


def may_hold_many(path: Path) -> bool:
    """Return whether files of this suffix may hold many images, or one that does not have the file's name."""
    return path.suffix.lower() == ".asf" or any(form.many for form in formats_of(path))


def writer_of(path: Path, many: bool = False) -> Format:
    """Return the format that is written for a suffix. Raise if there is none."""
    known = formats_of(path)
    writable = [form for form in FORMATS if (form.text_of_many if many else form.text) is not None]
    for form in writable:
        if form in known:
            return form
    use = ", ".join(form.suffixes[0] for form in writable)
    if many:
        raise LandmarkError(f"{path} cannot be written: only {use} hold many images. Use such an extension.")
    holds_many = any(form.text_of_many is not None for form in known)
    fault = "holds many images, so it is written by write_collection" if holds_many else "is only read"
    raise LandmarkError(f"{path} cannot be written: {path.suffix} {fault}. Use {use}.")


def parse_source(source: Source) -> Parsed:
    """Parse a file in the format that it has, of those of its suffix. Errors name the file."""
    form, suffix = None, source.path.suffix.lower()
    try:
        form = next((form for form in formats_of(source.path) if _is_in(source, form)), None)
        if form is None:
            unknown = f"this is none of {titles_of(suffix)}: export it as one of these."
            untitled = "there are no columns x and y, or rows of x and y: name the columns in the first line, as x,y."
            raise UnrecognisedError(unknown if suffix == ".json" else untitled)
        parsed = form.reader.parse(source)
        if isinstance(parsed, Landmarks):
            return _titled(parsed, form.title)
        if not parsed:
            raise LandmarkError(
                f"no landmarks in it ({form.title}): place those of at least one image, or export it again."
            )
    except LandmarkError as fault:
        raise type(fault)(f"{source.path}: {fault}") from fault
    except LACKING as fault:
        if "json" not in suffix or form is None:
            raise
        raise LandmarkError(f"{source.path} lacks the parts of a {form.title} file: export it again.") from fault
    return {image: _titled(own, form.title) for image, own in in_objects(parsed).items()}


def _titled(landmarks: Landmarks, title: str) -> Landmarks:
    return replace(landmarks, format=title, others=tuple(_titled(other, title) for other in landmarks.others))


def _is_in(source: Source, form: Format) -> bool:
    is_it = getattr(form.reader, "is_it", None)
    return is_it is None or is_it(source)


def rank_of(landmarks: Landmarks) -> int:
    """Return the place of landmarks' format in the order of preference."""
    return next((i for i, form in enumerate(FORMATS) if form.title == landmarks.format), len(FORMATS))
