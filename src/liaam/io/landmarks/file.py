"""A landmark file: its landmarks by image, and their positions as pixels of the upright image, counted from 0.

Where a file states the size of its image, positions are scaled or turned along if the image has another size or an EXIF
orientation, and refused if the size fits neither.
"""

from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from liaam.errors import ImageError, LandmarkError
from liaam.io.files import existing_file
from liaam.io.images import PICTURE_SUFFIXES, size_and_orientation
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.formats import Format, format_of, formats_of
from liaam.io.landmarks.matching import ImageNames
from liaam.io.landmarks.reading import LACKING, USUAL, Notes, Reading, Source, read_text

Size = tuple[float, float]

_FRACTION = 1.5  # largest fraction of an image's size of a point beyond its border, or of half its size
_SMALL = 16  # width and height in pixels up to which all landmarks may lie within one pixel
SCALED = "positions are for another size of the image, and are scaled along"
TURNED = "positions are for the photo before its EXIF orientation turns it, and are turned along"
UNDECIDED = (
    "photos have an EXIF orientation, and nothing says whether positions are for the photos before they are turned"
)
UNDECIDED += "; they are taken for the turned ones (--stored-orientation if not)"


@dataclass(frozen=True)
class LandmarkFile(Source):
    """A landmark file. Its errors name it."""

    @classmethod
    def read(
        cls, path: Path, reading: Reading = USUAL, data: bytes | None = None, notes: Notes | None = None
    ) -> "LandmarkFile":
        """Read a file, or take its content from memory."""
        formats_of(path)
        path = existing_file(path, LandmarkError, "landmark file") if data is None else path
        return cls(path, read_text(path, data), reading, notes or Notes(reading.strict))

    @cached_property
    def form(self) -> Format:
        """Its format."""
        return format_of(self)

    @cached_property
    def entries(self) -> dict[str, Landmarks]:
        """Its landmarks by the name of their image, or "" if the only one has none; positions are as in the file.

        Further objects of an image are its others, unless they have no point.
        """
        try:
            found = self.form.parse(self)
        except LandmarkError as fault:
            raise type(fault)(f"{self.path}: {fault}") from fault
        except LACKING as fault:
            if "json" not in self.path.suffix.lower():
                raise
            raise LandmarkError(f"{self.path} lacks the parts of a {self.form.title} file: export it again.") from fault
        if not found:
            remedy = "place those of at least one image, or export it again."
            raise LandmarkError(f"{self.path}: no landmarks in it ({self.form.title}): {remedy}")
        objects = defaultdict[str, list[Landmarks]](list)
        for own in found:
            objects[own.image_name or ""].append(replace(own, format=self.form.title))
        return {
            image: replace(first, others=(*first.others, *(own for own in others if not own.missing.all())))
            for image, (first, *others) in objects.items()
        }

    @property
    def is_single(self) -> bool:
        """Whether it is a file of one image."""
        first = next(iter(self.entries.values()))
        return first.image_name is None or not self.form.many

    @cached_property
    def _beside(self) -> "ImagesBeside":
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
        how, name = landmarks.placing, name or entry or self.path.name
        try:
            if size is None and how != Placing():
                size, orientation = self._beside.size_of(entry, how.size)
            return landmarks if size is None else self._placed(landmarks, size, orientation, name)
        except LandmarkError as fault:
            raise LandmarkError(f"{self.path}: {fault}") from fault

    def _placed(self, landmarks: Landmarks, size: Size, orientation: int, name: str) -> Landmarks:
        """Place landmarks and the others of their image."""
        placing, reading = landmarks.placing, self.reading
        stored = (size[1], size[0]) if orientation >= 5 else size
        declared = placing.size
        fits, fits_stored = (declared is not None and _fit(declared, each) for each in (size, stored))
        if declared is not None and not fits and not fits_stored:
            sizes = (f"{width:g} x {height:g}" for width, height in (declared, size))
            differ = "the file is for an image of {} pixels, but the image has {}, which is no scaled copy".format(
                *sizes
            )
            raise LandmarkError(f"{differ}: give the image that was annotated, or annotate this one.")
        turned = reading.stored if fits == fits_stored else fits_stored
        if orientation != 1 and not reading.stored and fits == fits_stored:
            self.notes.say(UNDECIDED, name)
        target = stored if turned else size
        frame = declared or target
        points = landmarks.points * frame if placing.fractions else landmarks.points
        if not placing.fractions:
            _check_pixels(points[~landmarks.missing], frame)
        if placing.upwards and not reading.y_down:
            points = np.stack([points[:, 0], frame[1] - 1 - points[:, 1]], axis=1)
        if frame != target:
            self.notes.say(SCALED, name)
            points = (points + 0.5) * np.divide(target, frame) - 0.5
        if turned and orientation != 1:
            self.notes.say(TURNED, name)
            points = turn(points, size, orientation)
        others = tuple(self._placed(other, size, orientation, name) for other in landmarks.others)
        return replace(landmarks, points=points, others=others, placing=Placing())


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
                path = self._folder / name
                there = path.is_file()  # which spares the list of a folder that holds a file for each image
                return size_and_orientation(path if there else self._names.find(name, self._folder)[0] or path)
        except (ImageError, OSError) as error:
            fault = f" ({error})"
        if declared is not None:
            return declared, 1
        remedy = "put the image beside the file, or pass image_size=(width, height) in pixels"
        raise LandmarkError(f"the size of its image is needed{fault}: {remedy}.")


def _check_pixels(known: np.ndarray, size: Size) -> None:
    """Raise if positions in an image seem to be fractions of its size."""
    if len(known) > 2 and np.abs(known).max() <= _FRACTION and min(size) > _SMALL:
        low, high = (0, 1) if 0 <= known.min() <= known.max() <= 1 else (known.min(), known.max())
        between = f"all positions lie between {low:.3g} and {high:.3g}"
        raise LandmarkError(f"{between}, as fractions of the image's size do: give pixels.")


def turn(points: np.ndarray, size: Size, orientation: int) -> np.ndarray:
    """Turn points (n, 2) on a stored image along with its EXIF orientation; `size` is that of the upright image."""
    x, y = points.T[::-1] if orientation >= 5 else points.T
    y = size[1] - 1 - y if orientation in (3, 4, 7, 8) else y
    x = size[0] - 1 - x if orientation in (2, 3, 6, 7) else x
    return np.stack([x, y], axis=1)


def _fit(declared: Size, size: Size) -> bool:
    """Return whether sizes have one ratio, but for rounding to whole pixels."""
    return abs(declared[0] * size[1] - declared[1] * size[0]) <= max(*declared, *size)
