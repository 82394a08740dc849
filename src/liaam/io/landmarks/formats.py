"""The table of landmark formats. Documentation, messages, the studio and tests are made from it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

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
)
from liaam.io.landmarks.base import Landmarks, Source, UnrecognisedError

Parsed = Landmarks | dict[str, Landmarks]


def _always(source: Source) -> bool:
    return True


@dataclass(frozen=True)
class Format:
    """A landmark file format."""

    title: str
    """Name of the format."""
    suffixes: tuple[str, ...]
    """Suffixes of its files, lower case."""
    parse: Callable[[Source], Parsed]
    """Parse a file's text into landmarks of one or many images."""
    origin: str
    """What its numbers count from, for the documentation."""
    is_it: Callable[[Source], bool] = _always
    """Whether a file is in this format, among those of its suffix."""
    many: bool = False
    """Whether one file can hold many images."""
    contours: bool = False
    names: bool = False
    dump: Callable[[Landmarks], str] | None = None
    """Format landmarks as the file's text; None if the format is read-only. y of ``.tps`` counts upwards."""
    dump_collection: Callable[[Mapping[str, Landmarks]], str] | None = None
    """Format the landmarks of many images as the file's text."""


_CENTRES = "centres counted from 0"
_TABLES = (".csv", ".tsv", ".txt")

FORMATS: tuple[Format, ...] = (
    Format("300-W points", (".pts",), pts.parse, "(1, 1) is the centre of the top-left pixel", dump=pts.dump),
    Format(
        "menpo landmarks", (".ljson",), ljson.parse, f"[y, x], {_CENTRES}", contours=True, names=True, dump=ljson.dump
    ),
    Format("WebMorph template", (".tem",), tem.parse, f"taken as {_CENTRES}", contours=True),
    Format("AAM-API shape", (".asf",), asf.parse, "fractions of width and height; needs the image", contours=True),
    Format("LabelMe", (".json",), labelme.parse, f"taken as {_CENTRES}", labelme.is_it, names=True),
    Format("CVAT for images", (".xml",), cvat.parse, f"taken as {_CENTRES}", cvat.is_it, many=True, names=True),
    Format("dlib imglab", (".xml",), dlib_xml.parse, _CENTRES, many=True, names=True),
    Format(
        "Label Studio",
        (".json",),
        label_studio.parse,
        "percent of width and height",
        label_studio.is_it,
        True,
        names=True,
    ),
    Format(
        "COCO keypoints",
        (".json",),
        coco.parse,
        f"taken as {_CENTRES}",
        many=True,
        contours=True,
        names=True,
        dump_collection=coco.dump_collection,
    ),
    Format(
        "tpsDig points",
        (".tps",),
        tps.parse,
        "(0, 0) is the centre of the bottom-left pixel, y upwards; needs the image",
        many=True,
        contours=True,
        dump=tps.dump,
        dump_collection=tps.dump_collection,
    ),
    Format("NTSYS matrix", (".nts",), nts.parse, "as .tps", many=True),
    Format("StereoMorph shapes", (".txt",), stereomorph.parse, _CENTRES, stereomorph.is_it, names=True),
    Format("DeepLabCut table", _TABLES, deeplabcut.parse, _CENTRES, deeplabcut.is_it, many=True, names=True),
    Format("table of one row an image", _TABLES, wide.parse, _CENTRES, wide.is_it, many=True, names=True),
    Format(
        "table",
        _TABLES,
        csv_points.parse,
        f"{_CENTRES}; ImageJ's results: corners",
        csv_points.is_it,
        many=True,
        names=True,
        dump=csv_points.dump,
        dump_collection=csv_points.dump_collection,
    ),
    Format("list of lines with an image's name", (".txt", ".csv"), lists.parse, _CENTRES, lists.is_it, many=True),
    Format("lines of x and y, HELEN's", (".txt",), text_points.parse, _CENTRES, text_points.is_it, names=True),
)
"""Formats, in order of preference where an image has several files, and in the order that they are tried for a suffix.

A file of its own takes precedence over one for many images."""

LANDMARK_SUFFIXES = tuple(dict.fromkeys(suffix for form in FORMATS for suffix in form.suffixes))
"""Suffixes (lower case) of the landmark files that can be read, in order of preference."""


def formats_of(path: Path) -> list[Format]:
    """Return the formats of a file's suffix. Raise if there are none."""
    found = [form for form in FORMATS if path.suffix.lower() in form.suffixes]
    if not found:
        known = ", ".join(f"{suffix} ({titles_of(suffix)})" for suffix in LANDMARK_SUFFIXES)
        raise LandmarkError(f"{path} has the extension '{path.suffix}', not that of a landmark format: use {known}.")
    return found


def titles_of(suffix: str) -> str:
    """Return the names of the formats of a suffix."""
    return ", ".join(form.title for form in FORMATS if suffix in form.suffixes)


def may_hold_many(path: Path) -> bool:
    """Return whether files of this suffix may hold many images, or one that does not have the file's name."""
    return any(form.many for form in formats_of(path)) or path.suffix.lower() in (".txt", ".asf", ".json")


def writer_of(path: Path, many: bool = False) -> Format:
    """Return the format that is written for a suffix. Raise if there is none."""
    known = formats_of(path)
    for form in known:
        if (form.dump_collection if many else form.dump) is not None:
            return form
    writable = ", ".join(form.suffixes[0] for form in FORMATS if (form.dump_collection if many else form.dump))
    if many:
        raise LandmarkError(f"{path} cannot be written: only {writable} hold many images. Use such an extension.")
    holds_many = any(form.dump_collection is not None for form in known)
    fault = "holds many images, so it is written by write_collection" if holds_many else "is only read"
    raise LandmarkError(f"{path} cannot be written: {path.suffix} {fault}. Use {writable}.")


def parse_source(source: Source) -> Parsed:
    """Parse a file in the format that it has, of those of its suffix."""
    form = next((form for form in formats_of(source.path) if form.is_it(source)), None)
    if form is None:
        raise UnrecognisedError(
            f"{source.path} has no columns x and y, or rows of x and y: name the columns in the first line, as x,y."
        )
    parsed = form.parse(source)
    if isinstance(parsed, Landmarks):
        return replace(parsed, format=form.title)
    return {image: replace(own, format=form.title) for image, own in parsed.items()}


def rank_of(landmarks: Landmarks) -> int:
    """Return the place of landmarks' format in the order of preference."""
    return next((i for i, form in enumerate(FORMATS) if form.title == landmarks.format), len(FORMATS))
