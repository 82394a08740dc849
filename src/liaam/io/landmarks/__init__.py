"""Landmark files: one module per format, and a registry of formats by suffix.

Every format is converted to liaam's convention, pixel centres counted from 0. The docstring of each format's module
describes the conversion.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.atomic import write_text_atomically
from liaam.io.files import existing_file
from liaam.io.landmarks import asf, coco, csv_points, dlib_xml, ljson, pts, tem
from liaam.io.landmarks.base import Contour, Landmarks, decode_text, read_text

__all__ = [
    "FORMATS",
    "LANDMARK_SUFFIXES",
    "Contour",
    "Format",
    "Landmarks",
    "parse_landmark_data",
    "parse_landmark_file",
    "read_collection",
    "read_landmarks",
    "write_collection",
    "write_landmarks",
]

Parsed = Landmarks | dict[str, Landmarks]


@dataclass(frozen=True)
class Format:
    """A landmark file format."""

    title: str
    """Name of the format."""
    parse: Callable[[Path, str], Parsed] | None = None
    """Parse a path (for messages) and the file's text into landmarks of one or many images."""
    parse_with_size: Callable[[Path, str, tuple[float, float] | None], Landmarks] | None = None
    """The same for formats that need the image's (width, height)."""
    dump: Callable[[Landmarks], str] | None = None
    """Format landmarks as the file's text; None if the format is read-only."""
    dump_collection: Callable[[Mapping[str, Landmarks]], str] | None = None
    """Format the landmarks of many images as the file's text."""
    may_be_collection: bool = False
    """Whether one file can hold many images."""


FORMATS: dict[str, Format] = {
    ".pts": Format("300-W points", pts.parse, dump=pts.dump),
    ".ljson": Format("menpo landmarks", ljson.parse, dump=ljson.dump),
    ".tem": Format("WebMorph template", tem.parse),
    ".asf": Format("AAM-API shape", parse_with_size=asf.parse),
    ".csv": Format(
        "CSV table",
        csv_points.parse,
        dump=csv_points.dump,
        dump_collection=csv_points.dump_collection,
        may_be_collection=True,
    ),
    ".xml": Format("dlib imglab", dlib_xml.parse, may_be_collection=True),
    ".json": Format("COCO keypoints", coco.parse, may_be_collection=True),
}
"""Formats by suffix, in order of preference where an image has several files."""

LANDMARK_SUFFIXES = tuple(FORMATS)
"""Suffixes (lower case) of the landmark files that can be read, in order of preference."""


def read_landmarks(path: str | os.PathLike[str], image_size: tuple[float, float] | None = None) -> Landmarks:
    """Read the landmarks of one image.

    Parameters
    ----------
    path : path-like
        A file with a suffix in `LANDMARK_SUFFIXES`. A file for many images must hold exactly one.
    image_size : tuple of float, optional
        (width, height) of the image in pixels; required for ``.asf``.

    Returns
    -------
    Landmarks
        Points in pixels, with (0, 0) at the centre of the top-left pixel; NaN where missing.

    Raises
    ------
    LandmarkError
        If the file is missing, empty, cut short, inconsistent, has an unknown suffix, holds invalid numbers, or holds
        several images.
    """
    parsed = parse_landmark_file(path, image_size)
    if isinstance(parsed, Landmarks):
        return parsed
    if len(parsed) > 1:
        some = ", ".join(list(parsed)[:3])
        raise LandmarkError(
            f"{path} holds the landmarks of {len(parsed)} images ({some} ...): use read_collection, or load its folder."
        )
    return next(iter(parsed.values()))


def read_collection(path: str | os.PathLike[str]) -> dict[str, Landmarks]:
    """Read a file with the landmarks of many images (dlib ``.xml``, COCO ``.json``, ``.csv`` with ``image``).

    Returns
    -------
    dict of str to Landmarks
        Landmarks by image file name, as written in the file.

    Raises
    ------
    LandmarkError
        As :func:`read_landmarks`, or if the file holds one unnamed image.
    """
    suffix = _suffix(Path(path))
    parsed = parse_landmark_file(path) if FORMATS[suffix].may_be_collection else None
    if isinstance(parsed, dict):
        return parsed
    raise LandmarkError(f"{path} holds the landmarks of one image and does not name it: use read_landmarks.")


def parse_landmark_file(path: str | os.PathLike[str], image_size: tuple[float, float] | None = None) -> Parsed:
    """Read a landmark file as `Landmarks`, or as a dict of them if the file names its images.

    Raises
    ------
    LandmarkError
        As :func:`read_landmarks`.
    """
    suffix = _suffix(Path(path))
    path = existing_file(path, LandmarkError, "landmark file")
    return _parse(path, suffix, read_text(path), image_size)


def parse_landmark_data(name: str, data: bytes, image_size: tuple[float, float] | None = None) -> Parsed:
    """Parse the content of a landmark file in memory, as :func:`parse_landmark_file` does.

    Raises
    ------
    LandmarkError
        As :func:`read_landmarks`.
    """
    suffix = _suffix(Path(name))
    return _parse(Path(name), suffix, decode_text(Path(name), data), image_size)


def _parse(path: Path, suffix: str, text: str, image_size: tuple[float, float] | None) -> Parsed:
    known = FORMATS[suffix]
    if known.parse is not None:
        return known.parse(path, text)
    assert known.parse_with_size is not None
    return known.parse_with_size(path, text, image_size)


def write_landmarks(path: str | os.PathLike[str], landmarks: Landmarks | np.ndarray) -> None:
    """Write the landmarks of one image atomically as ``.pts``, ``.csv`` or ``.ljson``.

    Only ``.ljson`` stores contours and invisible landmarks. Only ``.ljson`` and ``.csv`` store names.

    Parameters
    ----------
    path : path-like
        Its suffix determines the format.
    landmarks : Landmarks or np.ndarray
        An array holds (n, 2) points in pixels, with (0, 0) at the centre of the top-left pixel; NaN where missing.

    Raises
    ------
    LandmarkError
        If the format cannot be written, the points are invalid, or writing fails.
    """
    dump = FORMATS[_suffix(Path(path))].dump
    if dump is None:
        writable = ", ".join(suffix for suffix, known in FORMATS.items() if known.dump is not None)
        raise LandmarkError(f"{path} cannot be written: {Path(path).suffix} is only read. Use {writable}.")
    if not isinstance(landmarks, Landmarks):
        landmarks = Landmarks(landmarks)
    write_text_atomically(path, dump(landmarks), LandmarkError)


def write_collection(path: str | os.PathLike[str], collection: Mapping[str, Landmarks]) -> None:
    """Write the landmarks of many images, by file name, atomically as one ``.csv``.

    Raises
    ------
    LandmarkError
        If the suffix is not ``.csv``, there is nothing to write, or writing fails.
    """
    dump = FORMATS[_suffix(Path(path))].dump_collection
    if dump is None:
        raise LandmarkError(f"{path} cannot be written: only .csv holds many images. Use that extension.")
    if not collection:
        raise LandmarkError(f"{path} cannot be written: there are no landmarks. Give those of at least one image.")
    write_text_atomically(path, dump(collection), LandmarkError)


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        known = ", ".join(f"{ending} ({form.title})" for ending, form in FORMATS.items())
        raise LandmarkError(f"{path} has the extension '{path.suffix}', not that of a landmark format: use {known}.")
    return suffix
