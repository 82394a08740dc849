"""Pair the images of a folder with their landmarks, and report the files left out.

An image ``face.jpg`` takes its landmarks from the file of the same stem in the same folder (``face.pts``),
or from an entry for it in a file of many images (dlib ``.xml``, COCO ``.json``, ``.tps``, ``.csv`` with a column
``image``). Several objects of an image are a sample each. A file of its own takes precedence over a file of many
images, then the order of `liaam.io.LANDMARK_SUFFIXES` decides. A folder without images is one more set of landmarks of
the images beside it, in the folder above: ``faces/anna/face.pts`` are those of ``faces/face.jpg``.
"""

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

import numpy as np

from liaam.datasets import advice
from liaam.datasets.dataset import Dataset, Sample, UnusedFile
from liaam.datasets.side_tables import sides_in_table
from liaam.errors import ImageError, LandmarkError, MissingImageError
from liaam.io.files import is_copy, natural_key, some_names
from liaam.io.images import PICTURE_SUFFIXES, size_and_orientation
from liaam.io.landmarks import LANDMARK_SUFFIXES, LandmarkFile, Landmarks
from liaam.io.landmarks.base import Placing
from liaam.io.landmarks.formats import ALSO_OTHER, may_hold_many, name_of, rank_of
from liaam.io.landmarks.matching import ImageNames
from liaam.io.landmarks.reading import USUAL, Notes, Reading, UnrecognisedError
from liaam.io.landmarks.yolo import in_images, labels_of
from liaam.io.overlays import is_overlay
from liaam.io.sides import side_of_folder, sides_by_place_or_name, stated_side
from liaam.progress import progress_bar

_BARE = "the image has no landmarks"
_UNREAD = "the landmarks cannot be read"
_SAME = 1.5  # Largest difference of positions in pixels that the conventions of programs and rounding explain

_HIDDEN = (".", "~$")  # beginnings of names of hidden files, and of those by which Excel marks open ones
_LESSER = "another landmark file takes precedence"
_PARTIAL = "one of several objects in an image lacks landmarks"


def load_folder(
    folder: str | os.PathLike[str],
    pattern: str | None = None,
    recursive: bool = False,
    progress: bool = False,
    reading: Reading = USUAL,
) -> Dataset:
    """Find the landmarked images of a folder.

    The images are not decoded; their headers are read for sizes and EXIF orientations. Hidden files are ignored.
    Landmarks with names are put into one order.

    Parameters
    ----------
    folder : path-like
        Folder with images and landmark files, or with landmark files only, of the images in the folder above.
    pattern : str, optional
        Use only images whose name (with or without suffix, or path inside the folder) matches, e.g.
        ``"01-*"``.
    recursive : bool, optional
        Whether to include subfolders.
    progress : bool, optional
        Whether to show a progress bar on stderr.
    reading : Reading, optional
        How to read the landmark files.

    Returns
    -------
    Dataset
        Samples in natural order of their names (2 before 10), all with the most common number of landmarks. Their sides
        are those of a column ``side`` of the landmarks, or of a table of images and sides; or of the folders ``left``
        and ``right``, or of the names, if all have one; or that of the folder itself, if it is called ``left`` or
        ``right``.
        `left_out` lists the files that were not used, with reasons.

    Raises
    ------
    ImageError
        If the folder is missing, or contains no (matching) image.
    LandmarkError
        If no image has landmarks; if `reading` is strict, also if landmarks have to be left out.
    """
    root = Path(folder)
    files = _list_files(root, recursive)
    marks = [file for file in files if file.suffix.lower() in LANDMARK_SUFFIXES]
    images = _images(files)
    images_root = place = root
    if marks and not images:
        images_root = in_images(root) or root.parent
        images = _images(_list_files(images_root, recursive))
    elif images and not marks and (labels := labels_of(root)):
        place = labels
        marks = [file for file in _list_files(labels, recursive) if file.suffix.lower() in LANDMARK_SUFFIXES]
    wanted = [image for image in images if pattern is None or _matches(images_root, image, pattern)]
    if not wanted:
        raise ImageError(advice.no_images(root, files, pattern, recursive))
    pairing = _Pairing(images_root, place, images, wanted, reading)
    with progress_bar("landmark files", len(marks), progress) as tell:
        for done, file in enumerate(marks, 1):
            pairing.add(file)
            tell(done)
    samples = pairing.finish()
    left_out = pairing.left_out
    bare = [left.path for left in left_out if left.reason == _BARE]
    unread = advice.unread_landmarks(files, bare, pairing.unrecognised)
    if not samples and images_root != root and not recursive and advice.has_images_below(root):
        raise ImageError(advice.no_images(root, files, pattern, recursive))
    if not samples:
        reasons = [(left.path, left.reason) for left in left_out]
        raise LandmarkError(advice.no_pairs(root, images_root, wanted, reasons, unread, recursive))
    orphans = [left.path for left in left_out if left.reason == advice.NO_IMAGE]
    left_out += [UnusedFile(file, advice.UNKNOWN) for file in unread]
    left_out += [UnusedFile(file, advice.UNKNOWN_IMAGE) for file in advice.unread_images(files, orphans)]
    samples, unnamed = _in_one_order(samples, pairing.notes)
    samples, odd = _same_count(samples)
    samples = _with_sides(samples, root)
    left_out = sorted([*left_out, *unnamed, *odd], key=lambda left: natural_key(str(left.path)))
    if reading.strict:
        _refuse_faults(left_out, unlike=[*unnamed, *odd])
    return Dataset(tuple(samples), tuple(left_out), str(root), tuple(pairing.notes.lines()))


def _refuse_faults(left_out: list[UnusedFile], unlike: list[UnusedFile]) -> None:
    """Raise if landmarks are left out because of a fault, or because they are unlike those of most images."""
    for left in left_out:
        is_fault = left.partly or left.reason.startswith((_UNREAD, _PARTIAL, advice.ABSENT))
        if is_fault or left in unlike:
            raise LandmarkError(f"{left.path}: {left.reason} (refused because of --strict).")


def pair_files(
    root: Path, images: list[Path], marks: Iterable[Path], place: Path | None = None
) -> tuple[list[Sample], list[UnusedFile]]:
    """Pair images of a folder with landmark files (``marks``) in it, or in a subfolder that is their ``place``.

    Numbers of landmarks may differ. Also return the files that were not used.
    """
    pairing = _Pairing(root, place or root, images, images, USUAL)
    for file in marks:
        pairing.add(file)
    return pairing.finish(), pairing.left_out


def _list_files(root: Path, recursive: bool) -> list[Path]:
    """List the visible files in natural order."""
    if not root.is_dir():
        what = "is a file, not a folder" if root.exists() else "does not exist"
        error = ImageError if root.exists() else MissingImageError
        raise error(f"{root} {what}: name the folder with the images and their landmarks.")
    try:
        paths = root.rglob("*") if recursive else root.iterdir()
        seen = (path for path in paths if not any(part.startswith(_HIDDEN) for part in path.relative_to(root).parts))
        files = [path for path in seen if path.is_file()]
    except OSError as fault:
        raise ImageError(f"{root} cannot be read ({fault.strerror}): check the rights on the folder.") from fault
    return sorted(files, key=lambda path: natural_key(path.relative_to(root).as_posix()))


def _images(files: list[Path]) -> list[Path]:
    return [file for file in files if file.suffix.lower() in PICTURE_SUFFIXES and not is_overlay(file)]


def _name(root: Path, path: Path) -> str:
    """Return the name of the sample of an image in a folder: its path in the folder without suffix."""
    return path.relative_to(root).with_suffix("").as_posix()


def _matches(root: Path, image: Path, pattern: str) -> bool:
    """Return whether the name of an image in a folder, or its path in the folder, matches, with or without suffix."""
    relative = image.relative_to(root).as_posix()
    return any(fnmatchcase(text, pattern) for text in (image.name, image.stem, relative, _name(root, image)))


@dataclass(frozen=True)
class _Option:
    """Candidate landmarks of an image."""

    file: Path
    landmarks: Landmarks
    is_single: bool  # whether the file is one of a single image


class _Pairing:
    """Collects the candidate landmarks of each image, file by file.

    ``root`` is the folder of the images, ``place`` that of the landmark files. Entries of files may name any of the
    ``images``; samples are made of those ``wanted``.
    """

    def __init__(self, root: Path, place: Path, images: list[Path], wanted: list[Path], reading: Reading) -> None:
        self.root = root
        self.place = place
        self.wanted = wanted
        self.reading = reading
        self.notes = Notes(reading.strict)
        self.left_out: list[UnusedFile] = []
        self.unrecognised: list[Path] = []
        """Files of text that seem to hold no landmarks."""
        self.reported: set[Path] = set()
        """Images whose landmark file is left out, which explains why they have no landmarks."""
        self.sides: dict[Path, str] = {}
        """Sides by image, of tables without landmarks."""
        self.options: dict[Path, list[_Option]] = {image: [] for image in wanted}
        preferred = sorted(images, key=lambda path: (path not in self.options, _rank(path, PICTURE_SUFFIXES)))
        self.names = ImageNames(preferred)
        self.by_stem: dict[Path, Path] = {}
        for image in preferred:
            self.by_stem.setdefault(image.with_suffix(""), image)

    def add(self, file: Path) -> None:
        """Read one landmark file if a wanted image may need it."""
        image = self._image_of_name(file)
        if not may_hold_many(file) and (image is None or image not in self.options):
            if image is None and file.suffix.lower() in ALSO_OTHER and "roi" not in file.stem.lower():
                self.unrecognised.append(file)
            elif image is None:
                self._leave_out(file, advice.NO_IMAGE)
            return
        notes = Notes(self.reading.strict, done=self.notes.done)
        try:
            read = LandmarkFile.read(file, self.reading, notes=notes)
            entries = read.entries
        except LandmarkError as fault:
            if isinstance(fault, UnrecognisedError) and (sides := sides_in_table(file)):
                self._add_sides(file, sides)
            elif isinstance(fault, UnrecognisedError) and file.suffix.lower() in ALSO_OTHER:
                self.unrecognised.append(file)
            else:
                self._leave_out(file, f"{_UNREAD}: {fault}", image)
            return
        if notes.left_out:
            self.left_out.append(UnusedFile(file, Notes(left_out=notes.left_out).lines()[0], partly=True))
        if read.is_single:
            (entry,) = entries
            self._add_single(read, image, entry)
        else:
            self._add_collection(read)

    def _add_sides(self, file: Path, sides: dict[str, str]) -> None:
        """Add the sides that a table without landmarks states, by the names of images."""
        for name, side in sides.items():
            image = self._find(file, name)
            if image is not None and side:
                self.sides[image] = side
                self.notes.say(f"sides are those of the table {file.name}", image.name)

    def finish(self) -> list[Sample]:
        """Choose the landmarks of each image, and record the files that are not used."""
        used_images: dict[Path, Path] = {}  # by path without suffix
        # Of images of the same stem, one with landmarks is used, then lossless formats come first.
        for image in sorted(self.wanted, key=lambda path: (not self.options[path], _rank(path, PICTURE_SUFFIXES))):
            used_images.setdefault(image.with_suffix(""), image)
        samples = []
        for image in self.wanted:
            used_image = used_images[image.with_suffix("")]
            # Files of a single image take precedence over files of many, then the order of formats decides.
            # A copy of a file comes behind the file.
            options = sorted(
                self.options[image],
                key=lambda each: (not each.is_single, rank_of(each.landmarks), is_copy(each.file)),
            )
            if image != used_image:
                self._leave_out(image, f"another image has the same name: {used_image.name} is used")
            elif options:
                used, *others = options
                samples += self._samples_of(image, self._with_side(image, used, others))
                for other in others:
                    self._leave_out_option(image, other, used)
            elif image not in self.reported:
                self._leave_out(image, _BARE)
        return samples

    def _with_side(self, image: Path, used: _Option, others: Sequence[_Option]) -> _Option:
        """Return the landmarks of an image with a side of another file or table, if theirs has none."""
        stated = next((each.landmarks.side for each in others if each.landmarks.side), self.sides.get(image, ""))
        if used.landmarks.side or not stated:
            return used
        return replace(used, landmarks=replace(used.landmarks, side=stated))

    def _samples_of(self, image: Path, option: _Option) -> list[Sample]:
        """Return a sample for each object of an image.

        The largest is a sample in any case, others if no landmark is missing.
        """
        samples = []
        for name, landmarks in option.landmarks.objects(_name(self.root, image)):
            if landmarks is option.landmarks or not landmarks.missing.any():
                samples.append(Sample(name, image, landmarks, option.file))
            else:
                remedy = f"place them or delete the object, in {option.file.name}"
                reason = f"{_PARTIAL}: {landmarks.missing.sum()} of {len(landmarks)}; {remedy}"
                self.left_out.append(UnusedFile(image.with_name(PurePosixPath(name).name), reason))
        return samples

    def _leave_out_option(self, image: Path, option: _Option, used: _Option) -> None:
        """Record a file that is not used for an image, once for all images, and note if it disagrees with the used."""
        is_recorded = any(left.path == option.file and left.reason.startswith(_LESSER) for left in self.left_out)
        if not is_recorded:
            self.left_out.append(UnusedFile(option.file, f"{_LESSER}: {used.file.name} is used"))
        if _disagree(used.landmarks, option.landmarks):
            # Files of one image have its name, which follows.
            name = f"the {used.file.suffix}" if used.is_single else f"'{used.file.name}'"
            both = f"{name.removeprefix('the ')} and {option.file.name}"
            if not used.is_single:
                both = f"{name} and '{option.file.name}'"
            self.notes.repair(f"landmarks disagree in {both}; remove one ({name} is used)", image.name)

    def _add_single(self, file: LandmarkFile, image: Path | None, entry: str) -> None:
        """Add the landmarks of a file for one image, which has its name, or else is the one that it names."""
        if image is None:
            image = self._find(file.path, entry) if entry else None
        elif entry:
            other, _ = self.names.find(entry, self._beside(file.path).parent)
            if other is not None and other.with_suffix("") != image.with_suffix(""):
                what = "landmark files name another image than that of their own name, which is used"
                self.notes.repair(what, file.path.name)
        if image is None:
            self._leave_out(file.path, advice.NO_IMAGE)
        else:
            self._add_option(file, image, entry)

    def _add_collection(self, file: LandmarkFile) -> None:
        """Add the landmarks of a file for many images to those that its entries name."""
        absent: list[str] = []
        entry_of: dict[Path, str] = {}
        for entry in sorted(file.entries, key=lambda entry: "/" in entry or "\\" in entry):  # plain names first
            image = self._find(file.path, entry)
            if image is None:
                absent.append(entry)
            elif image not in entry_of:
                entry_of[image] = entry
                self._add_option(file, image, entry)
            else:  # perhaps an image of another folder, which is not there
                both = f"'{entry}' and '{entry_of[image]}' both name {image.name}; the landmarks of the second are used"
                self.left_out.append(UnusedFile(file.path, both, partly=True))
        if len(absent) == len(file.entries):
            self._leave_out(file.path, f"{advice.ABSENT}: {some_names(absent)}")
        elif absent:
            verb = "is" if len(absent) == 1 else "are"
            some = f"{len(absent)} of its {len(file.entries)} images {verb} not in the folder ({some_names(absent)})"
            self.left_out.append(UnusedFile(file.path, f"{some}; the others are used", partly=True))

    def _add_option(self, file: LandmarkFile, image: Path, entry: str) -> None:
        """Add candidate landmarks of an image, in pixels."""
        if image not in self.options:
            return
        size = None
        orientation = 1
        try:
            size, orientation = size_and_orientation(image)
        except ImageError as fault:
            if file.entries[entry].placing != Placing():  # the size is needed to place them
                self._leave_out(file.path, f"its image cannot be read: {fault}", image)
                return
        try:
            landmarks = file.placed(entry, size, orientation, image.name)
        except LandmarkError as fault:
            self._leave_out(file.path, f"{_UNREAD}: {fault}", image)
            return
        self.options[image].append(_Option(file.path, landmarks, file.is_single))

    def _image_of_name(self, file: Path) -> Path | None:
        """Return the image of a landmark file's name, beside it, or in ``images`` where the file is in ``labels``."""
        stem = name_of(file)
        for place in (self._beside(file), in_images(self._beside(file))):
            image = place and (self.by_stem.get(place.with_name(stem)) or self.names.of_file(place, stem))
            if image:
                return image
        return None

    def _beside(self, file: Path) -> Path:
        """Return where a landmark file would be among the images."""
        return self.root / file.relative_to(self.place)

    def _find(self, file: Path, entry: str) -> Path | None:
        """Find the image that an entry of a file names, and note what was done to find it."""
        image, how = self.names.find(entry, self._beside(file).parent)
        if image is not None and how:
            self.notes.say(how, image.name)
        return image

    def _leave_out(self, path: Path, reason: str, image: Path | None = None) -> None:
        """Record a file that is not used, and the image that it leaves without landmarks, if any."""
        self.left_out.append(UnusedFile(path, reason))
        if image is not None:
            self.reported.add(image)


def _disagree(landmarks: Landmarks, others: Landmarks) -> bool:
    """Return whether two records of an image have different points, by more than their conventions explain."""
    try:
        points = others.in_order_of(landmarks.names).points
    except LandmarkError:
        return True
    if points.shape != landmarks.points.shape:
        return True
    return not np.allclose(points, landmarks.points, rtol=0, atol=_SAME, equal_nan=True)


def _rank(file: Path, suffixes: tuple[str, ...]) -> int:
    """Return the place of a file's suffix among suffixes."""
    return suffixes.index(file.suffix.lower())


def _in_one_order(samples: list[Sample], notes: Notes) -> tuple[list[Sample], list[UnusedFile]]:
    """Put landmarks into the order of names that most samples have. Leave out those that lack some of the names."""
    orders = Counter(sample.landmarks.names for sample in samples if sample.landmarks.names)
    if len(orders) < 2:
        return samples, []
    (usual, count), *_ = orders.most_common()
    if count == 1 and len({frozenset(names) for names in orders}) == 1:  # rows in no order
        usual = tuple(sorted(usual, key=natural_key))
    ordered = []
    odd = []
    for sample in samples:
        try:
            landmarks = sample.landmarks.in_order_of(usual)
        except LandmarkError as fault:
            reason = f"other landmarks than most: {sample.name}: {fault}"
            odd.append(UnusedFile(sample.landmark_file or Path(sample.name), reason))
            continue
        if landmarks is not sample.landmarks:
            notes.say("images name their landmarks in another order, and are taken by name", sample.name)
        ordered.append(replace(sample, landmarks=landmarks))
    return ordered, odd


def _with_sides(samples: list[Sample], root: Path) -> list[Sample]:
    """Return samples with the sides that a table states, that folders or names of all images say, or that of root."""
    stated = [stated_side(sample.landmarks.side) for sample in samples]
    if not any(stated):
        stated = sides_by_place_or_name([sample.name for sample in samples])
    if not any(stated):
        stated = [side_of_folder(root.resolve().name)] * len(samples)
    return [replace(sample, side=side) for sample, side in zip(samples, stated, strict=True)]


def _same_count(samples: list[Sample]) -> tuple[list[Sample], list[UnusedFile]]:
    """Keep the samples that have the most common number of landmarks."""
    [(usual, _)] = Counter(len(sample.landmarks) for sample in samples).most_common(1)
    alike = []
    odd = []
    for sample in samples:
        count = len(sample.landmarks)
        if count == usual:
            alike.append(sample)
        else:
            reason = f"{count} landmarks where most have {usual}: those of {sample.name}"
            odd.append(UnusedFile(sample.landmark_file or Path(sample.name), reason))
    return alike, odd
