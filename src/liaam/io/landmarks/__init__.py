"""Landmark files: one module per format, and a registry of formats by suffix.

Every format is converted to liaam's convention, pixel centres counted from 0. The docstring of each format's module
describes the conversion.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path, PureWindowsPath

import numpy as np

from liaam.errors import ImageError, LandmarkError
from liaam.io.atomic import write_text_atomically
from liaam.io.files import existing_file
from liaam.io.images import IMAGE_SUFFIXES, image_size as size_of
from liaam.io.landmarks import asf, coco, csv_points, dlib_xml, ljson, pts, tem, tps
from liaam.io.landmarks.base import Contour, Landmarks, decode_text, read_text

__all__ = [
    "FORMATS",
    "LANDMARK_SUFFIXES",
    "Contour",
    "Format",
    "Landmarks",
    "collection_text",
    "in_pixels",
    "parse_landmark_data",
    "parse_landmark_file",
    "read_collection",
    "read_landmarks",
    "write_collection",
    "write_landmarks",
]

Parsed = Landmarks | dict[str, Landmarks]
Size = tuple[float, float]


@dataclass(frozen=True)
class Format:
    """A landmark file format."""

    title: str
    """Name of the format."""
    parse: Callable[[Path, str], Parsed]
    """Parse a path (for messages) and the file's text into landmarks of one or many images."""
    place: Callable[[Landmarks, Size], Landmarks] | None = None
    """Convert what `parse` returns to pixels, for formats that need the image's (width, height)."""
    dump: Callable[[Landmarks], str] | None = None
    """Format landmarks (`place` applied once more) as the file's text; None if the format is read-only."""
    dump_collection: Callable[[Mapping[str, Landmarks]], str] | None = None
    """Format the landmarks of many images as the file's text."""
    may_be_collection: bool = False
    """Whether one file can hold many images."""


FORMATS: dict[str, Format] = {
    ".pts": Format("300-W points", pts.parse, dump=pts.dump),
    ".ljson": Format("menpo landmarks", ljson.parse, dump=ljson.dump),
    ".tem": Format("WebMorph template", tem.parse),
    ".asf": Format("AAM-API shape", asf.parse, asf.place),
    ".csv": Format(
        "CSV table",
        csv_points.parse,
        dump=csv_points.dump,
        dump_collection=csv_points.dump_collection,
        may_be_collection=True,
    ),
    ".xml": Format("dlib imglab", dlib_xml.parse, may_be_collection=True),
    ".json": Format("COCO keypoints", coco.parse, dump_collection=coco.dump_collection, may_be_collection=True),
    ".tps": Format(
        "tpsDig points",
        tps.parse,
        tps.place,
        dump=tps.dump,
        dump_collection=tps.dump_collection,
        may_be_collection=True,
    ),
}
"""Formats by suffix, in order of preference where an image has several files."""

LANDMARK_SUFFIXES = tuple(FORMATS)
"""Suffixes (lower case) of the landmark files that can be read, in order of preference."""


def read_landmarks(
    path: str | os.PathLike[str], image_size: Size | None = None, image_name: str | None = None
) -> Landmarks:
    """Read the landmarks of one image.

    Parameters
    ----------
    path : path-like
        A file with a suffix in `LANDMARK_SUFFIXES`.
    image_size : tuple of float, optional
        (width, height) of the image in pixels. ``.asf`` and ``.tps`` need it; by default it is taken from the image
        that they name, if it lies beside them.
    image_name : str, optional
        File name of the image, to choose from a file for many images. By default the file must hold exactly one.

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
    parsed = parse_landmark_file(path)
    if isinstance(parsed, Landmarks):
        return in_pixels(path, parsed, image_size)
    if image_name is not None and len(parsed) > 1:
        parsed = {name: parsed[name] for name in _named(image_name, parsed)}
        if not parsed:
            raise LandmarkError(f"{path} has no landmarks of {image_name}: add them, or name another file.")
    if len(parsed) > 1:
        some = ", ".join(list(parsed)[:3])
        raise LandmarkError(
            f"{path} holds the landmarks of {len(parsed)} images ({some} ...): use read_collection, or load its folder."
        )
    return in_pixels(path, next(iter(parsed.values())), image_size)


def _named(image: str, entries: Iterable[str]) -> list[str]:
    """Return the entries of a file that name an image: its file name, or else in any case, or without suffix."""
    names = {entry: PureWindowsPath(entry).name for entry in entries}
    alike = (image.casefold(), Path(image).stem.casefold())
    return [entry for entry, name in names.items() if name == image] or [
        entry for entry, name in names.items() if name.casefold() in alike
    ]


def read_collection(path: str | os.PathLike[str]) -> dict[str, Landmarks]:
    """Read a file with the landmarks of many images (dlib ``.xml``, COCO ``.json``, ``.tps``, ``.csv`` with ``image``).

    The images of a ``.tps`` file must lie beside it.

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
        beside = cache(partial(_images_in, Path(path).parent))
        return {name: in_pixels(path, landmarks, None, beside) for name, landmarks in parsed.items()}
    raise LandmarkError(f"{path} holds the landmarks of one image and does not name it: use read_landmarks.")


def parse_landmark_file(path: str | os.PathLike[str]) -> Parsed:
    """Read a landmark file as `Landmarks`, or as a dict of them if the file names its images.

    The points are as in the file; :func:`in_pixels` converts them.
    """
    suffix = _suffix(Path(path))
    path = existing_file(path, LandmarkError, "landmark file")
    return FORMATS[suffix].parse(path, read_text(path))


def parse_landmark_data(name: str, data: bytes, image_size: Size | None = None) -> Parsed:
    """Parse the content of a landmark file in memory. All its images have the same size."""
    path = Path(name)
    parsed = FORMATS[_suffix(path)].parse(path, decode_text(path, data))
    if isinstance(parsed, Landmarks):
        return in_pixels(path, parsed, image_size)
    return {image: in_pixels(path, landmarks, image_size) for image, landmarks in parsed.items()}


def in_pixels(
    path: str | os.PathLike[str],
    landmarks: Landmarks,
    image_size: Size | None,
    beside: Callable[[], dict[str, Path]] | None = None,
) -> Landmarks:
    """Convert parsed landmarks to pixels; raise if that needs the image's size, and it is unknown.

    ``beside`` gives the images beside the file (:func:`_images_in`), which then are listed once for many entries.
    """
    place = FORMATS[_suffix(Path(path))].place
    if place is None:
        return landmarks
    try:
        beside = beside or partial(_images_in, Path(path).parent)
        return place(landmarks, image_size or _size_beside(Path(path).parent, landmarks.image_name, beside))
    except LandmarkError as fault:
        raise LandmarkError(f"{path}: {fault}") from fault


def _size_beside(folder: Path, image: str | None, beside: Callable[[], dict[str, Path]]) -> Size:
    """Return the size of the image that a landmark file names, perhaps by its path on another computer."""
    fault = ""
    if image:
        name = PureWindowsPath(image).name
        places = [folder / image, folder / name]
        found = next(filter(os.path.isfile, places), None) or beside().get(name.casefold())
        try:
            return size_of(found or places[0])
        except ImageError as error:
            fault = f" ({error})"
    raise LandmarkError(
        f"the size of its image is needed{fault}: put the image beside the file, or pass image_size=(width, height) in "
        "pixels."
    )


def _images_in(folder: Path) -> dict[str, Path]:
    """Return the images in a folder by name, and by name without suffix, in lower case."""
    try:
        files = [file for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES]
    except OSError:
        return {}
    # Where several have one name, the first suffix counts, as in load_folder.
    files.sort(key=lambda file: (-IMAGE_SUFFIXES.index(file.suffix.lower()), file.name))
    return {file.stem.casefold(): file for file in files} | {file.name.casefold(): file for file in files}


def write_landmarks(
    path: str | os.PathLike[str], landmarks: Landmarks | np.ndarray, image_size: Size | None = None
) -> None:
    """Write the landmarks of one image atomically as ``.pts``, ``.csv``, ``.ljson`` or ``.tps``.

    Only ``.ljson`` stores contours and invisible landmarks. Only ``.ljson`` and ``.csv`` store names. Only ``.tps``
    stores the scale, the image's name, and open contours of the last landmarks (as curves).

    Parameters
    ----------
    path : path-like
        Its suffix determines the format.
    landmarks : Landmarks or np.ndarray
        An array holds (n, 2) points in pixels, with (0, 0) at the centre of the top-left pixel; NaN where missing.
    image_size : tuple of float, optional
        As for :func:`read_landmarks`.

    Raises
    ------
    LandmarkError
        If the format cannot be written, the points are invalid, or writing fails.
    """
    dump = FORMATS[_suffix(Path(path))].dump
    if dump is None:
        writable = ", ".join(suffix for suffix, known in FORMATS.items() if known.dump is not None)
        many = FORMATS[_suffix(Path(path))].dump_collection is not None
        fault = "holds many images, so it is written by write_collection" if many else "is only read"
        raise LandmarkError(f"{path} cannot be written: {Path(path).suffix} {fault}. Use {writable}.")
    placed = in_pixels(path, _as_landmarks(landmarks), image_size)
    write_text_atomically(path, dump(placed), LandmarkError)


def _as_landmarks(points: Landmarks | np.ndarray) -> Landmarks:
    return points if isinstance(points, Landmarks) else Landmarks(points)


def write_collection(
    path: str | os.PathLike[str],
    collection: Mapping[str, Landmarks | np.ndarray],
    image_sizes: Mapping[str, Size] | None = None,
) -> None:
    """Write the landmarks of many images, by file name, atomically as one ``.csv``, ``.tps`` or COCO ``.json``.

    ``.tps`` needs the (width, height) of each image; by default they are taken from the images beside the file. COCO
    stores them if they are given.

    Raises
    ------
    LandmarkError
        If the suffix is another, there is nothing to write, an image's size is unknown, or writing fails.
    """
    write_text_atomically(path, collection_text(path, collection, image_sizes), LandmarkError)


def collection_text(
    path: str | os.PathLike[str],
    collection: Mapping[str, Landmarks | np.ndarray],
    image_sizes: Mapping[str, Size] | None = None,
) -> str:
    """Return the text that :func:`write_collection` writes to a file; the path is not used otherwise."""
    suffix = _suffix(Path(path))
    dump = FORMATS[suffix].dump_collection
    if dump is None:
        raise LandmarkError(
            f"{path} cannot be written: only .csv, .tps and .json hold many images. Use such an extension."
        )
    if not collection:
        raise LandmarkError(f"{path} cannot be written: there are no landmarks. Give those of at least one image.")
    sizes, beside = image_sizes or {}, cache(partial(_images_in, Path(path).parent))
    placed = {
        name: in_pixels(path, replace(_as_landmarks(own), image_name=name), sizes.get(name), beside)
        for name, own in collection.items()
    }
    return coco.dump_collection(placed, sizes) if suffix == ".json" else dump(placed)


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        known = ", ".join(f"{ending} ({form.title})" for ending, form in FORMATS.items())
        raise LandmarkError(f"{path} has the extension '{path.suffix}', not that of a landmark format: use {known}.")
    return suffix
