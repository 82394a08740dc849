"""Landmark files: one module per format, and a table of formats (:mod:`liaam.io.landmarks.formats`).

Every format is converted to liaam's convention, pixel centres counted from 0. The docstring of each format's module
describes the conversion.
"""

import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path, PureWindowsPath

import numpy as np

from liaam.errors import ImageError, LandmarkError
from liaam.io.atomic import write_text_atomically
from liaam.io.files import existing_file
from liaam.io.images import PICTURE_SUFFIXES, size_and_orientation
from liaam.io.landmarks import placing, writers
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.contours import Contour
from liaam.io.landmarks.formats import FORMATS, LANDMARK_SUFFIXES, Parsed, formats_of, parse_source, writer_of
from liaam.io.landmarks.matching import ImageNames
from liaam.io.landmarks.reading import USUAL, Notes, Reading, Source
from liaam.io.landmarks.text import decode_text, read_text

__all__ = [
    "FORMATS",
    "LANDMARK_SUFFIXES",
    "USUAL",
    "Contour",
    "ImageNames",
    "Landmarks",
    "Notes",
    "Reading",
    "collection_text",
    "in_pixels",
    "parse_landmark_data",
    "parse_landmark_file",
    "read_collection",
    "read_landmarks",
    "write_collection",
    "write_landmarks",
]

Size = tuple[float, float]


def read_landmarks(
    path: str | os.PathLike[str],
    image_size: Size | None = None,
    image_name: str | None = None,
    reading: Reading = USUAL,
) -> Landmarks:
    """Read the landmarks of one image.

    Warns about records that are left out, and about positions that are converted to another size or orientation.

    Parameters
    ----------
    path : path-like
        A file with a suffix in `LANDMARK_SUFFIXES`.
    image_size : tuple of float, optional
        (width, height) of the image in pixels. ``.asf``, ``.tps`` and ``.nts`` need it; by default it is taken from
        the image that they name, if it lies beside them.
    image_name : str, optional
        File name of the image, to choose from a file for many images. By default the file must hold exactly one.
    reading : Reading, optional
        How to read the file.

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
    path, notes = Path(path), Notes(reading.strict)
    parsed = parse_landmark_file(path, reading, notes)
    found = parsed if isinstance(parsed, Landmarks) else _one_of(path, parsed, image_name)
    placed = in_pixels(path, found, image_size, reading=reading, notes=notes)
    _warn(path, notes)
    return placed


def _one_of(path: Path, parsed: dict[str, Landmarks], image_name: str | None) -> Landmarks:
    """Return the landmarks of the only image, or of that with a name."""
    if len(parsed) == 1:
        return next(iter(parsed.values()))
    if image_name is None:
        some = ", ".join(list(parsed)[:3])
        raise LandmarkError(
            f"{path} holds the landmarks of {len(parsed)} images ({some} ...): use read_collection, or load its folder."
        )
    names = ImageNames([Path(image_name)])
    entry = next((entry for entry in parsed if PureWindowsPath(entry).name == image_name), None)
    entry = entry or next((entry for entry in parsed if names.find(entry)[0] is not None), None)
    if entry is None:
        raise LandmarkError(f"{path} has no landmarks of {image_name}: add them, or name another file.")
    return parsed[entry]


def read_collection(path: str | os.PathLike[str], reading: Reading = USUAL) -> dict[str, Landmarks]:
    """Read a file with the landmarks of many images, such as a table, COCO, ``.tps``, or dlib's ``.xml``.

    The images of ``.tps`` and ``.nts`` must lie beside the file. Records with faults are left out, with a warning.

    Returns
    -------
    dict of str to Landmarks
        Landmarks by image file name, as written in the file.

    Raises
    ------
    LandmarkError
        As :func:`read_landmarks`, or if the file holds one unnamed image.
    """
    path, notes = Path(path), Notes(reading.strict)
    parsed = parse_landmark_file(path, reading, notes)
    if isinstance(parsed, Landmarks) and parsed.image_name:
        parsed = {parsed.image_name: parsed}
    if isinstance(parsed, Landmarks):
        raise LandmarkError(f"{path} holds the landmarks of one image and does not name it: use read_landmarks.")
    beside = cache(partial(_images_in, path.parent))
    placed = {
        name: in_pixels(path, landmarks, None, beside, reading, notes, name) for name, landmarks in parsed.items()
    }
    _warn(path, notes)
    return placed


def _warn(path: Path, notes: Notes) -> None:
    for line in notes.lines():
        warnings.warn(f"{path}: {line}", stacklevel=3)


def parse_landmark_file(path: str | os.PathLike[str], reading: Reading = USUAL, notes: Notes | None = None) -> Parsed:
    """Read a landmark file as `Landmarks`, or as a dict of them if the file names its images.

    The points are as in the file; :func:`in_pixels` converts them. What has to be said is added to the notes.
    """
    formats_of(Path(path))
    path = existing_file(path, LandmarkError, "landmark file")
    return parse_source(Source(path, read_text(path), reading, notes or Notes(reading.strict)))


def parse_landmark_data(
    name: str, data: bytes, image_size: Size | None = None, reading: Reading = USUAL, notes: Notes | None = None
) -> Parsed:
    """Parse the content of a landmark file in memory. All its images have the same size."""
    path = Path(name)
    formats_of(path)
    parsed = parse_source(Source(path, decode_text(path, data), reading, notes or Notes(reading.strict)))
    if isinstance(parsed, Landmarks):
        return in_pixels(path, parsed, image_size, reading=reading, notes=notes)
    return {image: in_pixels(path, own, image_size, None, reading, notes, image) for image, own in parsed.items()}


def in_pixels(
    path: str | os.PathLike[str],
    landmarks: Landmarks,
    image_size: Size | None,
    beside: Callable[[], ImageNames] | None = None,
    reading: Reading = USUAL,
    notes: Notes | None = None,
    name: str | None = None,
    orientation: int = 1,
) -> Landmarks:
    """Convert parsed landmarks to pixels; raise if that needs the image's size, and it is unknown.

    ``beside`` gives the images beside the file, which then are listed once for many entries. ``name`` is that of the
    image in notes.
    """
    path, how = Path(path), landmarks.placing
    if image_size is None and (how.upwards or how.fractions or how.size is not None):
        try:
            image_size, orientation = _size_beside(path.parent, name or landmarks.image_name, beside)
        except LandmarkError as fault:
            if how.size is None:
                raise LandmarkError(f"{path}: {fault}") from fault
            image_size = how.size
    if image_size is None:
        return landmarks if how == Placing() else replace(landmarks, placing=Placing())
    say = partial((notes or Notes()).say, which=name or landmarks.image_name or path.name)
    try:
        return placing.place(landmarks, image_size, orientation, reading, say)
    except LandmarkError as fault:
        raise LandmarkError(f"{path}: {fault}") from fault


def _size_beside(
    folder: Path, image: str | None, beside: Callable[[], ImageNames] | None
) -> tuple[tuple[int, int], int]:
    """Return the size and orientation of the image that a landmark file names, perhaps on another computer."""
    fault = ""
    if image:
        try:
            found, _ = (beside or partial(_images_in, folder))().find(image, folder)
            return size_and_orientation(found or folder / image)
        except ImageError as error:
            fault = f" ({error})"
    raise LandmarkError(
        f"the size of its image is needed{fault}: put the image beside the file, or pass image_size=(width, height) in "
        "pixels."
    )


def _images_in(folder: Path) -> ImageNames:
    """Return the images in a folder, lossless formats first."""
    try:
        files = [file for file in folder.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES]
    except OSError:
        files = []
    return ImageNames(sorted(files, key=lambda file: (PICTURE_SUFFIXES.index(file.suffix.lower()), file.name)))


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
    path = Path(path)
    text = writer_of(path).text
    assert text is not None
    write_text_atomically(path, text(_to_write(path, _as_landmarks(landmarks), image_size)), LandmarkError)


def _to_write(
    path: Path, landmarks: Landmarks, size: Size | None, beside: Callable[[], ImageNames] | None = None
) -> Landmarks:
    """Return landmarks in pixels as the format of a file counts them."""
    if path.suffix.lower() != ".tps":
        return landmarks
    try:
        return writers.upwards(landmarks, size or _size_beside(path.parent, landmarks.image_name, beside)[0])
    except LandmarkError as fault:
        raise LandmarkError(f"{path}: {fault}") from fault


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
    path = Path(path)
    text = writer_of(path, many=True).text_of_many
    assert text is not None
    if not collection:
        raise LandmarkError(f"{path} cannot be written: there are no landmarks. Give those of at least one image.")
    sizes, beside = image_sizes or {}, cache(partial(_images_in, path.parent))
    placed = {
        name: _to_write(path, replace(_as_landmarks(own), image_name=name), sizes.get(name), beside)
        for name, own in collection.items()
    }
    return text(placed, sizes)
