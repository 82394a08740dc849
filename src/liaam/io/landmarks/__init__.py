"""Landmark files: readers by kind of file, and a table of formats (:mod:`liaam.io.landmarks.formats`).

Every format is converted to liaam's convention, pixel centres counted from 0. The docstring of each format's reader
describes the conversion.
"""

import os
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PureWindowsPath

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.atomic import write_text_atomically
from liaam.io.landmarks import writers
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.contours import Contour as Contour
from liaam.io.landmarks.file import ImagesBeside, LandmarkFile, Size
from liaam.io.landmarks.formats import FORMATS as FORMATS, LANDMARK_SUFFIXES as LANDMARK_SUFFIXES, writer_of
from liaam.io.landmarks.matching import ImageNames
from liaam.io.landmarks.reading import USUAL, Notes, Reading


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
    file = LandmarkFile.read(Path(path), reading)
    placed = file.placed(_entry_of(file, image_name), image_size)
    _warn(file)
    return placed


def _entry_of(file: LandmarkFile, image_name: str | None) -> str:
    """Return the only image of a file, or that with a name."""
    entries = list(file.entries)
    if len(entries) == 1:
        return entries[0]
    if image_name is None:
        many = f"{len(entries)} images ({', '.join(entries[:3])} ...)"
        raise LandmarkError(f"{file.path} holds the landmarks of {many}: use read_collection, or load its folder.")
    names = ImageNames([Path(image_name)])
    same = [entry for entry in entries if PureWindowsPath(entry).name == image_name]
    alike = same or [entry for entry in entries if names.find(entry)[0] is not None]
    if not alike:
        raise LandmarkError(f"{file.path} has no landmarks of {image_name}: add them, or name another file.")
    return alike[0]


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
    file = LandmarkFile.read(Path(path), reading)
    if file.is_single and "" in file.entries:
        raise LandmarkError(f"{path} holds the landmarks of one image and does not name it: use read_landmarks.")
    placed = file.all_placed()
    _warn(file)
    return placed


def _warn(file: LandmarkFile) -> None:
    for line in file.notes.lines():
        warnings.warn(f"{file.path}: {line}", stacklevel=3)


def parse_landmark_data(
    name: str, data: bytes, image_size: Size | None = None, reading: Reading = USUAL, notes: Notes | None = None
) -> Landmarks | dict[str, Landmarks]:
    """Parse the content of a landmark file in memory, of one image, or of many by name. All have the same size."""
    file = LandmarkFile.read(Path(name), reading, data, notes)
    placed = file.all_placed(image_size)
    return next(iter(placed.values())) if file.is_single else placed


def write_landmarks(
    path: str | os.PathLike[str], landmarks: Landmarks | np.ndarray, image_size: Size | None = None
) -> None:
    """Write the landmarks of one image atomically as ``.pts``, ``.csv``, ``.ljson`` or ``.tps``.

    Only ``.ljson`` stores contours and invisible landmarks; ``.ljson`` and ``.csv`` store names; ``.tps`` and
    ``.ljson`` store the scale; and ``.tps`` stores the image's name, and open contours of the last landmarks (as
    curves).

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
    own = landmarks if isinstance(landmarks, Landmarks) else Landmarks(landmarks)
    [own] = _to_write(path, [own], {} if image_size is None else {own.image_name or "": image_size})
    write_text_atomically(path, text(own), LandmarkError)


def _to_write(path: Path, every: list[Landmarks], sizes: Mapping[str, Size]) -> list[Landmarks]:
    """Return landmarks in pixels as the format of a file counts them."""
    if path.suffix.lower() != ".tps":
        return every
    beside, names = ImagesBeside(path.parent), [own.image_name or "" for own in every]
    try:
        known = [sizes.get(name) or beside.size_of(name)[0] for name in names]
    except LandmarkError as fault:
        raise LandmarkError(f"{path}: {fault}") from fault
    return list(map(writers.upwards, every, known))


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
    every = (own if isinstance(own, Landmarks) else Landmarks(own) for own in collection.values())
    sizes, named = (
        image_sizes or {},
        [replace(own, image_name=name) for name, own in zip(collection, every, strict=True)],
    )
    return text(dict(zip(collection, _to_write(path, named, sizes), strict=True)), sizes)
