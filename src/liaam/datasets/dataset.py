"""Data sets of landmarked images, and their report."""

import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import overload

import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import short_repr
from liaam.io.files import count_of, some_names
from liaam.io.images import read_image
from liaam.io.landmarks import Landmarks
from liaam.io.landmarks.formats import titles_of


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
    side : str
        Side of the individual, ``left`` or ``right``, from a table, a folder or the image's name, or as a table has it;
        empty if unknown.
    """

    name: str
    image: np.ndarray | Path
    landmarks: Landmarks
    landmark_file: Path | None = None
    side: str = ""

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
class UnusedFile:
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
    left_out : tuple of UnusedFile
        Files that were not used, with the reason.
    source : str
        Origin of the samples, for the report.
    notes : tuple of str
        Lines about records that were left out, and about what was done with others, for the report.
    """

    samples: tuple[Sample, ...]
    left_out: tuple[UnusedFile, ...] = ()
    source: str = ""
    notes: tuple[str, ...] = ()

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
        selected = tuple(
            sample
            for sample in self.samples
            if any(each(sample) if callable(each) else fnmatchcase(sample.name, each) for each in patterns)
        )
        if not selected:
            some = some_names([sample.name for sample in self.samples])
            wanted = ", ".join(repr(each) for each in patterns)
            raise LiaamError(
                f"no sample of {self.source or 'the data set'} matches {wanted}: the names are like {some}."
            )
        return replace(self, samples=selected)

    def report(self) -> str:
        """Summarise the number of samples, their formats, and the files left out with reasons, as text."""
        source = f" from {self.source}" if self.source else ""
        lines = [f"{count_of(len(self), 'sample')}{source}"]
        if self.samples:
            kinds = Counter(
                f"{sample.landmarks.format or titles_of(suffix)} ({suffix})"
                for sample in self.samples
                if sample.landmark_file and (suffix := sample.landmark_file.suffix.lower())
            )
            formats = ", ".join(f"{kind}: {n}" for kind, n in kinds.items())
            n_missing = sum(int(sample.landmarks.missing.sum()) for sample in self.samples)
            missing = f", {n_missing} missing in total" if n_missing else ""
            lines.append(f"{len(self.samples[0].landmarks)} landmarks in each sample{missing}")
            lines += [f"landmark files by format: {formats}"] if formats else []
        counts = Counter(sample.image for sample in self.samples if isinstance(sample.image, Path))
        if shared := [image for image, count in counts.items() if count > 1]:
            n_objects = sum(counts[image] for image in shared)
            names = some_names([image.name for image in shared])
            holds = "image holds" if len(shared) == 1 else "images hold"
            of_one = f"each a sample, such as {shared[0].stem}#2 ({names})"
            lines.append(f"{len(shared)} {holds} {n_objects} objects, {of_one}")
        lines += self.notes
        groups: dict[str, list[UnusedFile]] = defaultdict(list)
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
