"""Landmark files: readers by kind of file, and a table of formats (:mod:`liaam.io.landmarks.formats`).

Every format is converted to liaam's convention, pixel centres counted from 0. The docstring of each format's reader
describes the conversion.
"""

import warnings
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np

from liaam.errors import ImageError, LandmarkError
from liaam.io.atomic import write_text_atomically
from liaam.io.files import AnyPath, existing_file, is_file, read_bytes
from liaam.io.images import PICTURE_SUFFIXES, size_and_orientation
from liaam.io.landmarks import formats, writers
from liaam.io.landmarks.base import Contour, Landmarks, Placing, Size
from liaam.io.landmarks.formats import FORMATS, LANDMARK_SUFFIXES
from liaam.io.landmarks.matching import ImageNames
from liaam.io.landmarks.reading import (
    LACKING,
    MAX_BINARY,
    USUAL,
    Notes,
    Reading,
    Source,
    UnrecognisedError,
    read_text,
)
from liaam.io.landmarks.spreadsheets import csv_of_sheet

__all__ = [
    "FORMATS",
    "LANDMARK_SUFFIXES",
    "Contour",
    "LandmarkFile",
    "Landmarks",
    "Notes",
    "Reading",
    "collection_text",
    "parse_landmark_data",
    "read_collection",
    "read_landmarks",
    "write_collection",
    "write_landmarks",
]

# Largest absolute value up to which all positions of an image look like fractions: of its size, 0 to 1, or of half its
# size, -1 to 1. The rest is for points beyond the border.
_FRACTION = 1.5
_SMALL = 16  # up to this width or height in pixels, positions below _FRACTION may be pixels nevertheless

# EXIF orientations of a stored image in which its axes are exchanged to turn it upright, and in which then its columns
# or its rows are in reverse order.
_TRANSPOSED = (5, 6, 7, 8)
_X_REVERSED = (2, 3, 6, 7)
_Y_REVERSED = (3, 4, 7, 8)

SCALED = "positions are for another size of the image, and are scaled along"
TURNED = "positions are for the photo before its EXIF orientation turns it, and are turned along"
UNDECIDED = (
    "photos have an EXIF orientation, and nothing says whether positions are for the photos before they are turned; "
    "they are taken for the turned ones (--stored-orientation if not)"
)


@dataclass(frozen=True)
class LandmarkFile(Source):
    """A landmark file. Its errors name it.

    Where it states the size of its image, positions are scaled or turned along if the image has another size or an EXIF
    orientation, and refused if the size fits neither.
    """

    @classmethod
    def read(
        cls, path: Path, reading: Reading = USUAL, data: bytes | None = None, notes: Notes | None = None
    ) -> "LandmarkFile":
        """Read a file, or take its content from memory."""
        is_binary = formats.is_binary(path)
        path = existing_file(path, LandmarkError, "landmark file") if data is None else path
        notes = notes or Notes(reading.strict)
        is_spreadsheet = formats.ending_of(path) == ".xlsx"
        if not is_binary and not is_spreadsheet:
            return cls(path, read_text(path, data), reading, notes)
        content = read_bytes(path, UnrecognisedError, MAX_BINARY) if data is None else data
        if not is_spreadsheet:
            return cls(path, "", reading, notes, content)
        try:
            return cls(path, csv_of_sheet(content, path.name, notes), reading, notes)
        except LandmarkError as fault:
            raise type(fault)(f"{path}: {fault}") from fault

    @cached_property
    def form(self) -> formats.Format:
        """Its format."""
        return formats.format_of(self)

    @cached_property
    def entries(self) -> dict[str, Landmarks]:
        """Its landmarks by the name of their image, or "" if the only one has none; positions are as in the file.

        Further objects of an image are its others, unless they have no point.
        """
        try:
            parsed = self.form.parse(self)
        except LandmarkError as fault:
            raise type(fault)(f"{self.path}: {fault}") from fault
        except LACKING as fault:
            if "json" not in formats.ending_of(self.path):
                raise
            raise LandmarkError(f"{self.path} lacks the parts of a {self.form.title} file: export it again.") from fault
        if not parsed:
            remedy = "place those of at least one image, or export it again."
            raise LandmarkError(f"{self.path}: no landmarks in it ({self.form.title}): {remedy}")
        objects_by_image = defaultdict[str, list[Landmarks]](list)
        seen: set[tuple[Any, ...]] = set()
        for landmarks in parsed:
            record = landmarks.image_name, landmarks.label, landmarks.names, landmarks.points.tobytes()
            if record in seen:
                self.notes.say("records that occur twice are read once", landmarks.image_name or self.path.name)
                continue
            seen.add(record)
            objects_by_image[landmarks.image_name or ""].append(replace(landmarks, format=self.form.title))
        return {image: _joined(objects) for image, objects in objects_by_image.items()}

    @property
    def is_single(self) -> bool:
        """Whether it is a file of one image."""
        first = next(iter(self.entries.values()))
        return first.image_name is None or not self.form.many

    def zeros_of(self, landmarks: Landmarks) -> tuple[int, ...]:
        """Return the indices of those landmarks of an entry that the file has at 0, 0."""
        return tuple(np.flatnonzero((landmarks.points == self.form.zero).all(axis=1)).tolist())

    @cached_property
    def beside(self) -> "ImagesBeside":
        """The images in its folder."""
        return ImagesBeside(self.path.parent)

    def all_placed(self, size: Size | None = None) -> dict[str, Landmarks]:
        """Return all landmarks in pixels of their images, which have one size if it is given."""
        return {entry: self.placed(entry, size) for entry in self.entries}

    def placed(self, entry: str, size: Size | None = None, orientation: int = 1, name: str = "") -> Landmarks:
        """Return the landmarks of an entry in pixels of its image, which notes call by its name.

        If the (width, height) of the upright image is needed but not given, the image that lies beside the file tells
        it, and its EXIF orientation.
        """
        landmarks = self.entries[entry]
        name = name or entry or self.path.name
        try:
            if size is None and landmarks.placing != Placing():
                size, orientation = self.beside.size_of(entry, landmarks.placing.size)
            return landmarks if size is None else self._placed(landmarks, size, orientation, name)
        except LandmarkError as fault:
            raise LandmarkError(f"{self.path}: {fault}") from fault

    def _placed(self, landmarks: Landmarks, size: Size, orientation: int, name: str) -> Landmarks:
        """Return landmarks in pixels of the upright image of a size, and the others of the image with them.

        Three sizes matter: that which the file states, that of the image which the positions are for (stored or
        upright), and that of the upright image.
        """
        stored = _stored_size(size, orientation)
        is_stored = self._is_for_stored(landmarks.placing.size, size, orientation, name)
        target = stored if is_stored else size
        frame = landmarks.placing.size or target
        points = self._in_pixels(landmarks, frame)
        if frame != target:
            self.notes.say(SCALED, name)
            points = (points + 0.5) * np.divide(target, frame) - 0.5
        if is_stored and orientation != 1:
            self.notes.say(TURNED, name)
            points = turn(points, size, orientation)
        others = tuple(self._placed(other, size, orientation, name) for other in landmarks.others)
        return replace(landmarks, points=points, others=others, placing=Placing())

    def _is_for_stored(self, declared: Size | None, size: Size, orientation: int, name: str) -> bool:
        """Return whether positions are for the stored image, before its EXIF orientation turns it upright.

        A declared size that only one of both images is a copy of decides it, or else the reading.

        Raises
        ------
        LandmarkError
            If neither image is a scaled copy of one of the declared size.
        """
        fits = declared is not None and _is_scaled_copy(size, declared)
        fits_stored = declared is not None and _is_scaled_copy(_stored_size(size, orientation), declared)
        if declared is not None and not fits and not fits_stored:
            theirs = f"{declared[0]:g} x {declared[1]:g}"
            ours = f"{size[0]:g} x {size[1]:g}"
            differ = f"the file is for an image of {theirs} pixels, but the image has {ours}, which is no scaled copy"
            raise LandmarkError(f"{differ}: give the image that was annotated, or annotate this one.")
        if fits != fits_stored:
            return fits_stored
        if orientation != 1 and not self.reading.stored:
            self.notes.say(UNDECIDED, name)
        return self.reading.stored

    def _in_pixels(self, landmarks: Landmarks, frame: Size) -> np.ndarray:
        """Return points (n, 2) float64 in pixels of an image of the size `frame`, with y downwards.

        Raises
        ------
        LandmarkError
            If they seem to be fractions of the size, which the file's format does not use.
        """
        points = landmarks.points
        if landmarks.placing.fractions:
            points = points * frame
        else:
            _refuse_fractions(points[~landmarks.missing], frame)
        if landmarks.placing.upwards and not self.reading.y_down:
            points = np.stack([points[:, 0], frame[1] - 1 - points[:, 1]], axis=1)
        return points


def _joined(objects: list[Landmarks]) -> Landmarks:
    """Return the first object of an image, with the further ones that have a point as its others."""
    first, *further = objects
    with_points = (each for each in further if not each.missing.all())
    return replace(first, others=(*first.others, *with_points))


def _stored_size(size: Size, orientation: int) -> Size:
    """Return the size of a stored image, given that of the upright one."""
    width, height = size
    return (height, width) if orientation in _TRANSPOSED else size


def _is_scaled_copy(size: Size, declared: Size) -> bool:
    """Return whether two sizes have one ratio, but for rounding to whole pixels."""
    return abs(declared[0] * size[1] - declared[1] * size[0]) <= max(*declared, *size)


def _refuse_fractions(points: np.ndarray, frame: Size) -> None:
    """Raise if three or more points (n, 2), none missing, look like fractions of the size of their image."""
    if len(points) < 3 or np.abs(points).max() > _FRACTION or min(frame) <= _SMALL:
        return
    low = points.min()
    high = points.max()
    if low >= 0 and high <= 1:
        low = 0
        high = 1
    between = f"all positions lie between {low:.3g} and {high:.3g}"
    raise LandmarkError(f"{between}, as fractions of the image's size do: give pixels.")


class ImagesBeside:
    """The images in a folder, lossless formats first, with the names that landmark files give them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @cached_property
    def _names(self) -> ImageNames:
        files = [file for file in self._folder.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES]
        return ImageNames(sorted(files, key=lambda file: (PICTURE_SUFFIXES.index(file.suffix.lower()), file.name)))

    def size_of(self, name: str, declared: Size | None = None) -> tuple[Size, int]:
        """Return the size and orientation of an image, perhaps named on another computer, or the declared size."""
        fault = ""
        try:
            if name:
                return size_and_orientation(self._path_of(name))
        except (ImageError, OSError) as error:
            fault = f" ({error})"
        if declared is not None:
            return declared, 1
        remedy = "put the image beside the file, or pass image_size=(width, height) in pixels"
        raise LandmarkError(f"the size of its image is needed{fault}: {remedy}.")

    def image_of(self, name: str, file: Path) -> Path | None:
        """Return the image of a name, or without one that of a landmark file, if it is in the folder."""
        image = self._path_of(name) if name else self._names.of_file(file, formats.name_of(file))
        return image if image is not None and is_file(image) else None

    def _path_of(self, name: str) -> Path:
        """Return the path of the image that a name means; if there is none, the path that it would have."""
        path = self._folder / name
        if is_file(path):  # which spares the list of a folder that holds a file for each image
            return path
        image, _ = self._names.find(name, self._folder)
        return image or path


def turn(points: np.ndarray, size: Size, orientation: int) -> np.ndarray:
    """Turn points (n, 2) on a stored image along with its EXIF orientation; `size` is that of the upright image."""
    width, height = size
    x, y = points.T
    if orientation in _TRANSPOSED:
        x, y = y, x
    if orientation in _X_REVERSED:
        x = width - 1 - x
    if orientation in _Y_REVERSED:
        y = height - 1 - y
    return np.stack([x, y], axis=1)


def read_landmarks(
    path: AnyPath, image_size: Size | None = None, image_name: str | None = None, reading: Reading = USUAL
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
    entries = list(file.entries)
    if len(entries) > 1 and image_name is None:
        many = f"{len(entries)} images ({', '.join(entries[:3])} ...)"
        raise LandmarkError(f"{path} holds the landmarks of {many}: use read_collection, or load its folder.")
    if len(entries) > 1 and image_name is not None:
        entries = _entries_naming(image_name, entries)
        if not entries:
            raise LandmarkError(f"{path} has no landmarks of {image_name}: add them, or name another file.")
    placed = file.placed(entries[0], image_size)
    _warn(file)
    return placed


def _entries_naming(image_name: str, entries: list[str]) -> list[str]:
    """Return the entries with exactly this file name; if there are none, those that may mean it."""
    same = [entry for entry in entries if PureWindowsPath(entry).name == image_name]
    if same:
        return same
    names = ImageNames([Path(image_name)])
    return [entry for entry in entries if names.find(entry)[0] is not None]


def read_collection(path: AnyPath, reading: Reading = USUAL) -> dict[str, Landmarks]:
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
    """Give the notes on a file as warnings."""
    for line in file.notes.lines():
        warnings.warn(f"{file.path}: {line}", stacklevel=3)  # at the line that calls read_landmarks or read_collection


def parse_landmark_data(
    name: str, data: bytes, image_size: Size | None = None, reading: Reading = USUAL, notes: Notes | None = None
) -> Landmarks | dict[str, Landmarks]:
    """Parse the content of a landmark file in memory, of one image, or of many by name. All have the same size."""
    file = LandmarkFile.read(Path(name), reading, data, notes)
    placed = file.all_placed(image_size)
    return next(iter(placed.values())) if file.is_single else placed


def write_landmarks(path: AnyPath, landmarks: Landmarks | np.ndarray, image_size: Size | None = None) -> None:
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
    text_of = formats.writer_of(path)
    landmarks = _as_landmarks(landmarks)
    sizes = {} if image_size is None else {landmarks.image_name or "": image_size}
    [converted] = _in_convention_of(path, [landmarks], sizes)
    write_text_atomically(path, text_of(converted), LandmarkError)


def _as_landmarks(points: Landmarks | np.ndarray) -> Landmarks:
    """Return landmarks as they are, or make them from points (n, 2)."""
    return points if isinstance(points, Landmarks) else Landmarks(points)


def _in_convention_of(path: Path, records: list[Landmarks], sizes: Mapping[str, Size]) -> list[Landmarks]:
    """Return the landmarks of several images as the format of a file counts them: in .tps, y counts upwards.

    Sizes are by name of the image; those that lack are taken from the images beside the file.
    """
    if path.suffix.lower() != ".tps":
        return records
    beside = ImagesBeside(path.parent)
    converted = []
    for landmarks in records:
        name = landmarks.image_name or ""
        try:
            size = sizes.get(name) or beside.size_of(name)[0]
        except LandmarkError as fault:
            raise LandmarkError(f"{path}: {fault}") from fault
        converted.append(writers.upwards(landmarks, size))
    return converted


def write_collection(
    path: AnyPath, collection: Mapping[str, Landmarks | np.ndarray], image_sizes: Mapping[str, Size] | None = None
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
    path: AnyPath, collection: Mapping[str, Landmarks | np.ndarray], image_sizes: Mapping[str, Size] | None = None
) -> str:
    """Return the text that :func:`write_collection` writes to a file; the path is not used otherwise."""
    path = Path(path)
    sizes = image_sizes or {}
    text_of = formats.writer_of(path, many=True)
    if not collection:
        raise LandmarkError(f"{path} cannot be written: there are no landmarks. Give those of at least one image.")
    records = [replace(_as_landmarks(points), image_name=name) for name, points in collection.items()]
    converted = _in_convention_of(path, records, sizes)
    return text_of(dict(zip(collection, converted, strict=True)), sizes)
