"""Pair the images of a folder with their landmarks, and report the files left out.

An image ``face.jpg`` takes its landmarks from the file of the same stem in the same folder (``face.pts``),
or from an entry for it in a file of many images (dlib ``.xml``, COCO ``.json``, ``.tps``, ``.csv`` with a column
``image``). Several objects of an image are a sample each. A file of its own takes precedence over a file of many
images, then the order of `liaam.io.LANDMARK_SUFFIXES` decides.
"""

import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from typing import overload

import numpy as np

from liaam.datasets.advice import (
    ABSENT,
    NO_IMAGE,
    PICTURE_SUFFIXES,
    UNKNOWN,
    UNKNOWN_IMAGE,
    no_images,
    no_pairs,
    unread_images,
    unread_landmarks,
)
from liaam.errors import ImageError, LandmarkError, LiaamError
from liaam.evaluation import short_repr
from liaam.io.files import count_of, natural_key, some_names
from liaam.io.images import image_size, read_image
from liaam.io.landmarks import FORMATS, LANDMARK_SUFFIXES, Landmarks, in_pixels, parse_landmark_file

_BARE = "the image has no landmarks"
_PARTIAL = "one of several objects in an image lacks landmarks"


@dataclass(frozen=True, eq=False)
class Sample:
    """One landmarked object in an image.

    Attributes
    ----------
    name : str
        Unique in its data set: the path inside the folder, without suffix. If the image holds several objects, those
        after the largest have a number: ``party``, ``party#2``, ``party#3``.
    image : (height, width, 3) uint8, uint16 or float32, or Path
        The image in RGB order, or the file to read it from.
    landmarks : Landmarks
        Landmarks of the object, pixels.
    landmark_file : Path, optional
        Where the landmarks were read from.
    """

    name: str
    image: np.ndarray | Path
    landmarks: Landmarks
    landmark_file: Path | None = None

    __repr__ = short_repr

    def read_image(self) -> np.ndarray:
        """Return the image, (height, width, 3). A file is read at each call.

        Raises
        ------
        ImageError
            If the file cannot be read (see :func:`liaam.io.read_image`).
        """
        return read_image(self.image) if isinstance(self.image, str | os.PathLike) else self.image


@dataclass(frozen=True)
class LeftOut:
    """A file that was not used.

    Attributes
    ----------
    path : Path
        The file.
    reason : str
        One sentence; the part before the first colon groups files in the report.
    partly : bool
        Whether other parts of the file are used.
    """

    path: Path
    reason: str
    partly: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class Dataset:
    """Landmarked images with the same number of landmarks.

    Attributes
    ----------
    samples : tuple of Sample
        The landmarked objects, in order.
    left_out : tuple of LeftOut
        Files that were not used, with the reason.
    source : str
        Origin of the samples, for the report.
    """

    samples: tuple[Sample, ...]
    left_out: tuple[LeftOut, ...] = ()
    source: str = ""

    def __len__(self) -> int:
        return len(self.samples)

    def __repr__(self) -> str:
        return f"Dataset({count_of(len(self), 'sample')}, {len(self.left_out)} left out, source={self.source!r})"

    def __iter__(self) -> Iterator[Sample]:
        return iter(self.samples)

    @overload
    def __getitem__(self, index: int) -> Sample: ...
    @overload
    def __getitem__(self, index: slice) -> "Dataset": ...
    def __getitem__(self, index: int | slice) -> "Sample | Dataset":
        if isinstance(index, slice):
            return replace(self, samples=self.samples[index])
        return self.samples[index]

    def select(self, which: str | Iterable[str] | Callable[[Sample], bool]) -> "Dataset":
        """Keep some of the samples, in their order.

        Parameters
        ----------
        which : str, iterable of str, or callable
            Patterns such as ``"01-*"`` (``*``, ``?``, ``[...]``): keep samples whose name matches one of them. Or a
            predicate.

        Raises
        ------
        LiaamError
            If no sample matches.
        """
        patterns = [which] if isinstance(which, str) or callable(which) else list(which)
        kept = tuple(
            sample
            for sample in self.samples
            if any(each(sample) if callable(each) else fnmatchcase(sample.name, each) for each in patterns)
        )
        if not kept:
            some = some_names([sample.name for sample in self.samples])
            wanted = ", ".join(repr(each) for each in patterns)
            raise LiaamError(
                f"no sample of {self.source or 'the data set'} matches {wanted}: the names are like {some}."
            )
        return replace(self, samples=kept)

    def report(self) -> str:
        """Summarise the number of samples, their formats, and the files left out with reasons, as text."""
        source = f" from {self.source}" if self.source else ""
        lines = [f"{count_of(len(self), 'sample')}{source}", *self._landmark_lines(), *self._shared_lines()]
        groups: dict[str, list[LeftOut]] = defaultdict(list)
        for left in self.left_out:
            if left.partly:
                lines.append(f"{left.path.name}: {left.reason}")
            else:
                groups[left.reason.partition(":")[0]].append(left)
        for reason, members in groups.items():
            detail = members[0].reason.partition(": ")[2]
            lines.append(f"left out {len(members)}: {reason} ({some_names([left.path.name for left in members])})")
            lines += [f"  first: {detail}"] if detail else []
        return "\n".join(lines)

    def _shared_lines(self) -> list[str]:
        counts = Counter(sample.image for sample in self.samples if isinstance(sample.image, Path))
        shared = [image for image, count in counts.items() if count > 1]
        if not shared:
            return []
        n_objects, names = sum(counts[image] for image in shared), some_names([image.name for image in shared])
        holds = "image holds" if len(shared) == 1 else "images hold"
        return [f"{len(shared)} {holds} {n_objects} objects, each a sample, such as {shared[0].stem}#2 ({names})"]

    def _landmark_lines(self) -> list[str]:
        if not self.samples:
            return []
        suffixes = Counter(sample.landmark_file.suffix.lower() for sample in self.samples if sample.landmark_file)
        formats = ", ".join(f"{FORMATS[suffix].title} ({suffix}): {n}" for suffix, n in suffixes.items())
        n_missing = sum(int(sample.landmarks.missing.sum()) for sample in self.samples)
        missing = f", {n_missing} missing in total" if n_missing else ""
        count = f"{len(self.samples[0].landmarks)} landmarks each{missing}"
        return [f"{count}; {formats}" if formats else count]


def load_folder(
    folder: str | os.PathLike[str],
    pattern: str | None = None,
    recursive: bool = False,
    progress: bool = False,
) -> Dataset:
    """Find the landmarked images of a folder.

    The images are not decoded; headers are read for landmarks that need the image's size (``.asf``, ``.tps``).
    Hidden files are ignored.

    Parameters
    ----------
    folder : path-like
        Folder with images and landmark files.
    pattern : str, optional
        Use only images whose name (with or without suffix, or path inside the folder) matches, e.g.
        ``"01-*"``.
    recursive : bool, optional
        Whether to include subfolders.
    progress : bool, optional
        Whether to show a progress bar on stderr.

    Returns
    -------
    Dataset
        Samples in natural order of their names (2 before 10), all with the most common number of landmarks.
        `left_out` lists the files that were not used, with reasons.

    Raises
    ------
    ImageError
        If the folder is missing, or contains no (matching) image.
    LandmarkError
        If no image has landmarks.
    """
    root = Path(folder)
    files = _list_files(root, recursive)
    images = [file for file in files if file.suffix.lower() in PICTURE_SUFFIXES]
    wanted = [image for image in images if pattern is None or _matches(root, image, pattern)]
    if not wanted:
        raise ImageError(no_images(root, files, pattern, recursive))
    marks = [file for file in files if file.suffix.lower() in LANDMARK_SUFFIXES]
    samples, left_out = pair_files(root, images, _track(marks, progress), wanted)
    bare = [left.path for left in left_out if left.reason == _BARE]
    unread = unread_landmarks(files, bare)
    if not samples:
        reasons = [(left.path, left.reason) for left in left_out]
        raise LandmarkError(no_pairs(root, wanted, reasons, unread, recursive))
    orphans = [left.path for left in left_out if left.reason == NO_IMAGE]
    left_out += [LeftOut(file, UNKNOWN) for file in unread]
    left_out += [LeftOut(file, UNKNOWN_IMAGE) for file in unread_images(files, orphans)]
    samples, odd = _same_count(samples)
    left_out = sorted([*left_out, *odd], key=lambda left: natural_key(str(left.path)))
    return Dataset(tuple(samples), tuple(left_out), str(root))


def pair_files(
    root: Path, images: list[Path], marks: Iterable[Path], wanted: list[Path] | None = None
) -> tuple[list[Sample], list[LeftOut]]:
    """Pair images of a folder with its landmark files (``marks``); numbers of landmarks may differ.

    Samples are made of the ``wanted`` images, all by default. Also return the files that were not used.
    """
    pairing = _Pairing(root, images, images if wanted is None else wanted)
    for file in marks:
        pairing.add(file)
    return pairing.finish(), pairing.left_out


def _list_files(root: Path, recursive: bool) -> list[Path]:
    """List the visible files in natural order."""
    if not root.is_dir():
        what = "is a file, not a folder" if root.exists() else "does not exist"
        raise ImageError(f"{root} {what}: name the folder with the images and their landmarks.")
    try:
        paths = root.rglob("*") if recursive else root.iterdir()
        seen = (path for path in paths if not any(part.startswith(".") for part in path.relative_to(root).parts))
        files = [path for path in seen if path.is_file()]
    except OSError as fault:
        raise ImageError(f"{root} cannot be read ({fault.strerror}): check the rights on the folder.") from fault
    return sorted(files, key=lambda path: natural_key(path.relative_to(root).as_posix()))


def _name(root: Path, path: Path) -> str:
    return path.relative_to(root).with_suffix("").as_posix()


def _matches(root: Path, image: Path, pattern: str) -> bool:
    relative = image.relative_to(root).as_posix()
    return any(fnmatchcase(text, pattern) for text in (image.name, image.stem, relative, _name(root, image)))


def _track(files: list[Path], progress: bool) -> Iterable[Path]:
    if not progress:
        return files
    from rich.console import Console
    from rich.progress import track

    return track(files, "Reading landmarks", console=Console(stderr=True))


@dataclass(frozen=True)
class _Option:
    """Candidate landmarks of an image."""

    file: Path
    landmarks: Landmarks
    own: bool
    """Whether the file belongs to this image only."""


class _Pairing:
    """Collects the candidate landmarks of each image, file by file."""

    def __init__(self, root: Path, images: list[Path], wanted: list[Path]) -> None:
        self.root = root
        self.wanted = wanted
        self.left_out: list[LeftOut] = []
        self.reported: set[Path] = set()
        """Images whose landmark file was left out, with the reason."""
        self.options: dict[Path, list[_Option]] = {image: [] for image in wanted}
        self.by_stem: dict[Path, Path] = {}
        self.by_name: dict[str, list[Path]] = defaultdict(list)
        for image in sorted(images, key=lambda path: (path not in self.options, _rank(path, PICTURE_SUFFIXES))):
            self.by_stem.setdefault(image.with_suffix(""), image)
            self.by_name[image.name.casefold()].append(image)

    def add(self, file: Path) -> None:
        """Read one landmark file if a wanted image may need it."""
        form = FORMATS[file.suffix.lower()]
        image = self.by_stem.get(file.with_suffix(""))
        if image is not None and image not in self.options and not form.may_be_collection:
            return
        if image is None and form.place is None and not form.may_be_collection:
            self._leave_out(file, NO_IMAGE)
            return
        try:
            parsed = parse_landmark_file(file)
        except LandmarkError as fault:
            self._leave_out(file, f"the landmarks cannot be read: {fault}", image)
        else:
            self._add_parsed(file, image, parsed)

    def finish(self) -> list[Sample]:
        """Choose the landmarks of each image, and record the files that are not used."""
        winners = self._winners()
        samples = []
        for image in self.wanted:
            best = winners[image.with_suffix("")]
            options = sorted(self.options[image], key=lambda each: (not each.own, _rank(each.file, LANDMARK_SUFFIXES)))
            if image != best:
                self._leave_out(image, f"another image has the same name: {best.name} is used")
            elif options:
                used, *others = options
                samples += self._samples(image, used)
                for other in others:
                    self._leave_out(other.file, f"another landmark file takes precedence: {used.file.name} is used")
            elif image not in self.reported:
                self._leave_out(image, _BARE)
        return samples

    def _samples(self, image: Path, option: _Option) -> Iterator[Sample]:
        """Yield a sample of each object: of the largest in any case, of others if no landmark is missing."""
        for name, landmarks in option.landmarks.objects(_name(self.root, image)):
            if landmarks is option.landmarks or not landmarks.missing.any():
                yield Sample(name, image, landmarks, option.file)
            else:
                remedy = f"place them or delete the object, in {option.file.name}"
                reason = f"{_PARTIAL}: {landmarks.missing.sum()} of {len(landmarks)}; {remedy}"
                self.left_out.append(LeftOut(image.with_name(PurePosixPath(name).name), reason))

    def _winners(self) -> dict[Path, Path]:
        """Choose among images of the same stem: one with landmarks, then by suffix (lossless formats first)."""
        winners: dict[Path, Path] = {}
        for image in sorted(self.wanted, key=lambda path: (not self.options[path], _rank(path, PICTURE_SUFFIXES))):
            winners.setdefault(image.with_suffix(""), image)
        return winners

    def _add_parsed(self, file: Path, image: Path | None, parsed: Landmarks | dict[str, Landmarks]) -> None:
        if isinstance(parsed, dict):
            self._add_collection(file, parsed)
            return
        if image is None and parsed.image_name:
            image = self._find(file.parent, parsed.image_name)
        if image is None:
            self._leave_out(file, NO_IMAGE)
        else:
            self._add_option(file, image, parsed, own=True)

    def _add_collection(self, file: Path, collection: dict[str, Landmarks]) -> None:
        absent = []
        for entry, landmarks in collection.items():
            image = self._find(file.parent, entry)
            if image is None:
                absent.append(entry)
            else:
                self._add_option(file, image, landmarks, own=False)
        if len(absent) == len(collection):
            self._leave_out(file, f"{ABSENT}: {some_names(absent)}")
        elif absent:
            verb = "is" if len(absent) == 1 else "are"
            some = f"{len(absent)} of its {len(collection)} images {verb} not in the folder ({some_names(absent)})"
            self.left_out.append(LeftOut(file, f"{some}; the others are used", partly=True))

    def _add_option(self, file: Path, image: Path, landmarks: Landmarks, own: bool) -> None:
        """Add candidate landmarks of an image, in pixels."""
        if image not in self.options:
            return
        try:
            size = image_size(image) if FORMATS[file.suffix.lower()].place is not None else None
            self.options[image].append(_Option(file, in_pixels(file, landmarks, size), own))
        except ImageError as fault:
            self._leave_out(file, f"its image cannot be read: {fault}", image)
        except LandmarkError as fault:
            self._leave_out(file, f"the landmarks cannot be read: {fault}", image)

    def _find(self, folder: Path, entry: str) -> Path | None:
        """Find the image that an entry names: by its path, by a unique file name in any case, or without suffix."""
        relative = PurePosixPath(entry.replace("\\", "/"))
        candidates = self.by_name.get(relative.name.casefold(), [])
        exact = [image for image in candidates if image == folder / relative]
        if exact:
            return exact[0]
        return candidates[0] if len(candidates) == 1 else self.by_stem.get(folder / relative)

    def _leave_out(self, path: Path, reason: str, image: Path | None = None) -> None:
        """Record a file that is not used, and the image that it leaves without landmarks, if any."""
        self.left_out.append(LeftOut(path, reason))
        if image is not None:
            self.reported.add(image)


def _rank(file: Path, suffixes: tuple[str, ...]) -> int:
    return suffixes.index(file.suffix.lower())


def _same_count(samples: list[Sample]) -> tuple[list[Sample], list[LeftOut]]:
    """Keep the samples that have the most common number of landmarks."""
    usual = Counter(len(sample.landmarks) for sample in samples).most_common(1)[0][0]
    odd = [
        LeftOut(
            sample.landmark_file or Path(sample.name),
            f"{len(sample.landmarks)} landmarks where most have {usual}: those of {sample.name}",
        )
        for sample in samples
        if len(sample.landmarks) != usual
    ]
    return [sample for sample in samples if len(sample.landmarks) == usual], odd
