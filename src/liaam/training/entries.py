"""Training samples: read and validate landmarks, contours and mesh."""

import os
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LandmarkError, TrainingError
from liaam.io import Landmarks, image_size, read_image, read_landmarks
from liaam.io.files import count_of, some_names
from liaam.io.images import as_pixels
from liaam.io.landmarks.base import Contour, contour_of
from liaam.io.landmarks.formats import needs_image
from liaam.io.sides import stated_side
from liaam.model.file import MAX_POINTS
from liaam.model.mesh import FOLD_TOLERANCE, folded_share
from liaam.model.missing import Missing
from liaam.model.shape import aligned_to
from liaam.model.sides import Sides, reflected_image, reflected_points
from liaam.progress import Progress, reported
from liaam.scale.choice import length_of
from liaam.scale.lengths import Length
from liaam.training.filling import FEWEST_KNOWN, filled
from liaam.training.incomplete import check_known

# Least ratio of the landmarks' minor to major spread: that of a rod 80 times as long as wide. Measured on generated
# rods: the search finds those up to 20 times as long as wide, and fits from a start converge up to 40 times.
FLATTEST = 0.02
FEWEST = 3  # Fewest images to learn from
FEWEST_LANDMARKS = 3  # Fewest landmarks of a mesh, which is then one triangle
# Least extent of the landmarks in pixels: less is no object, but coordinates in other units, such as fractions.
LEAST_EXTENT = 2.0

IndexedContours = tuple[tuple[tuple[int, ...], bool], ...]
"""Lines through landmarks: the indices of these in turn, and whether the line is closed."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A validated training sample.

    Attributes
    ----------
    name : str
        Name for messages.
    read_image : callable
        Function that reads the image.
    points : (n, 2) float64
        Landmarks, pixels. Missing ones are NaN, or where the other images suggest.
    known : (n,) bool, optional
        Which landmarks are known; None if all are.
    pixel : Length, optional
        The length of a pixel, if the landmark file states it.
    side : str
        Side of the object, if it is stated, or empty.
    read_width : callable, optional
        Function that returns the width of the image, pixels; of the image that is read by default.
    reflected : bool
        Whether image and landmarks are reversed left to right.
    file : Path, optional
        File of the image; None if the image was given as an array.
    """

    name: str
    read_image: Callable[[], np.ndarray]
    points: np.ndarray
    known: np.ndarray | None = None
    pixel: Length | None = None
    side: str = ""
    read_width: Callable[[], int] | None = None
    reflected: bool = False
    file: Path | None = None

    @property
    def width(self) -> int:
        """Width of the image, pixels."""
        return self.read_image().shape[1] if self.read_width is None else self.read_width()

    def reflection(self) -> "Entry":
        """Return the sample with image and landmarks reversed left to right; both are in the coordinates of that."""
        return replace(
            self,
            read_image=partial(_read_reflected, self.read_image),
            points=reflected_points(self.points, self.width),
            reflected=not self.reflected,
        )


def _read_reflected(read_image: Callable[[], np.ndarray]) -> np.ndarray:
    """Read an image, and reverse it left to right."""
    return reflected_image(read_image())


@dataclass(frozen=True, eq=False)
class TrainingData:
    """Validated samples, and what is known of the landmarks that all have.

    Attributes
    ----------
    entries : list of Entry
    contours : tuple of (indices, closed)
        Lines through landmarks.
    edges : (e, 2) int
        Pairs of landmarks that the contours of the landmark files connect. They may form a mesh.
    landmark_names : tuple of str
        Names of the landmarks; empty if the samples have none, or do not agree.
    missing : Missing, optional
        Which landmarks are estimates; None if all are known, or if they have not been estimated yet.
    sides : Sides, optional
        The sides of the objects, of which one was reflected; None if there is one as far as is known.
    """

    entries: list[Entry]
    contours: IndexedContours
    edges: np.ndarray
    landmark_names: tuple[str, ...]
    missing: Missing | None = None
    sides: Sides | None = None

    @property
    def shapes(self) -> np.ndarray:
        """Landmarks of all samples, (m, n, 2)."""
        return np.array([entry.points for entry in self.entries])

    @property
    def names(self) -> list[str]:
        """Names of the samples."""
        return [entry.name for entry in self.entries]


@dataclass(frozen=True, eq=False)
class _Sample:
    """A sample as it was read, also the contours and the names of its landmarks; both are empty if there are none."""

    entry: Entry
    contours: IndexedContours
    landmark_names: tuple[str, ...]


def read_entries(data: Iterable, contours: Iterable | None = None, strict: bool = False) -> TrainingData:
    """Read and validate samples.

    Parameters
    ----------
    data : Dataset, or iterable of Sample or (image, landmarks) pairs
    contours : iterable of sequences of int, optional
        Lines through landmarks, which replace those of the samples. By default those of the first sample with any.
    strict : bool
        Whether to refuse samples with missing landmarks.

    Returns
    -------
    TrainingData
        Landmarks with names are put in the order of the first sample with names. Missing ones are NaN.
    """
    if isinstance(data, (str, os.PathLike)) or not isinstance(data, Iterable):
        raise TrainingError(f"{data!r} is not a set of landmarked images; for a folder give liaam.load_folder(folder)")
    entries: list[Entry] = []
    contours_of_files: IndexedContours = ()
    first_names: tuple[str, ...] = ()  # of the landmarks of the first sample with names, and in its order
    names_agree = True
    for i, item in enumerate(data):
        sample = _read_sample(item, i, first_names)
        entry = sample.entry
        if entries and len(entry.points) != len(entries[0].points):
            raise TrainingError(
                f"{entry.name} has {len(entry.points)} landmarks but {entries[0].name} has {len(entries[0].points)}; "
                "every image needs the same points in the same order"
            )
        entries.append(entry)
        contours_of_files = contours_of_files or sample.contours
        first_names = first_names or sample.landmark_names
        if sample.landmark_names and sorted(sample.landmark_names) != sorted(first_names):
            names_agree = False  # none in common, so that the landmarks were left in their order
    landmark_names = first_names if names_agree else ()
    entries = _usable(entries, landmark_names, strict)
    if len(entries) < FEWEST:
        few = count_of(len(entries), "landmarked image")
        raise TrainingError(f"{few}: too few to learn from; at least {FEWEST} are needed, 5 to 20 are better")
    return TrainingData(
        entries=entries,
        contours=contours_of_files if contours is None else contours_of(contours, len(entries[0].points)),
        edges=_edges_of(contours_of_files),  # of the files only: those that were given define no mesh
        landmark_names=landmark_names,
    )


def _edges_of(contours: IndexedContours) -> np.ndarray:
    """Return the pairs of neighbours along contours, (e, 2)."""
    edges: list[tuple[int, int]] = []
    for indices, is_closed in contours:
        edges += pairwise([*indices, indices[0]] if is_closed else indices)
    return np.array(edges, dtype=int).reshape(-1, 2)


def contours_of(given: Iterable, n: int) -> IndexedContours:
    """Return contours as (indices, closed); given so, or as indices of which a repeated first closes a line.

    Raises a TrainingError if one is not a line through some of n landmarks.
    """
    contours = []
    for each in given:
        contour = _as_contour(each)
        if contour is None or not all(0 <= i < n for i in contour.indices):
            raise TrainingError(
                f"contour {each!r}: give the indices of the landmarks along it, 0 to {n - 1}, with the first once more "
                "at the end if it is closed"
            )
        contours.append((contour.indices, contour.closed))
    return tuple(contours)


def _as_contour(given: Any) -> Contour | None:
    """Return a contour that was given as (indices, closed) or as indices; None if it is neither."""
    try:
        is_pair = len(given) == 2 and np.ndim(given[0]) == 1
        indices, is_closed = given if is_pair else (given, False)
        return contour_of([int(i) for i in indices], bool(is_closed))
    except (TypeError, ValueError):
        return None


def _usable(entries: list[Entry], landmark_names: Sequence[str], strict: bool) -> list[Entry]:
    """Return the samples from whose landmarks a model can be learnt, some of which may be missing.

    Warns the caller of train, which is decorated, of those that are left out. If ``strict``, samples with missing
    landmarks are refused instead. Raises a TrainingError if a landmark is missing in all, or if nothing says where some
    landmarks lie relative to others.
    """
    incomplete = [entry for entry in entries if entry.known is not None]
    if not incomplete:
        return entries
    if strict:
        names = some_names([entry.name for entry in incomplete])
        raise TrainingError(
            f"landmarks are missing in {count_of(len(incomplete), 'image')} ({names}): place them, or train without "
            "--strict (strict=False)"
        )
    counts = known_of(entries).sum(axis=1).tolist()
    poor = [f"{entry.name} ({n})" for entry, n in zip(entries, counts, strict=True) if n < FEWEST_KNOWN]
    if poor:
        have = "1 image has" if len(poor) == 1 else f"{len(poor)} images have"
        are = "is" if len(poor) == 1 else "are"
        warnings.warn(
            f"{have} fewer than {FEWEST_KNOWN} landmarks and {are} left out: {some_names(poor)}; place at least "
            f"{FEWEST_KNOWN} landmarks, or remove these images",
            stacklevel=5,
        )
        entries = [entry for entry, n in zip(entries, counts, strict=True) if n >= FEWEST_KNOWN]
    if len(entries) >= FEWEST:  # else there are too few anyway, which is said elsewhere
        check_known([entry.name for entry in entries], known_of(entries), landmark_names)
    return entries


def known_of(entries: Sequence[Entry]) -> np.ndarray:
    """Whether each landmark of each sample is known, (m, n) bool."""
    return np.array([np.ones(len(each.points), bool) if each.known is None else each.known for each in entries])


def with_all_landmarks(
    data: TrainingData, folds: Sequence[np.ndarray], progress: Progress | bool | None = False
) -> TrainingData:
    """Return samples in which missing landmarks are where the other images suggest (:mod:`liaam.training.filling`).

    ``folds`` are samples that are left out together, by index; ``progress`` is that of :func:`train`.
    """
    entries = data.entries
    known = known_of(entries)
    if known.all():
        return replace(data, missing=None)
    holed = np.where(known[..., None], data.shapes, np.nan)
    with reported("missing landmarks", progress) as report:
        shapes, missing = filled(holed, folds, report)
    entries = [replace(entry, points=points) for entry, points in zip(entries, shapes, strict=True)]
    return replace(data, entries=entries, missing=missing)


def _read_sample(item: Any, i: int, order: tuple[str, ...]) -> _Sample:
    """Read and validate item ``i`` of the training data, a Sample or a pair (image, landmarks).

    ``order`` are the names of the landmarks in the order of earlier samples; empty if none had names.
    """
    if hasattr(item, "landmarks"):
        name = item.name
        read_image_of_item = item.read_image
        landmarks = item.landmarks
        image = getattr(item, "image", None)
    else:
        image, landmarks = _pair_of(item, i)
        name, read_image_of_item = _image_of_pair(image, i)
        if isinstance(landmarks, str | os.PathLike) and Path(landmarks).suffix:
            landmarks = _read_landmarks_of(image, landmarks)
    if order and isinstance(landmarks, Landmarks):
        try:
            landmarks = landmarks.in_order_of(order)
        except LandmarkError as fault:
            raise TrainingError(f"{name}: {fault}") from fault
    try:
        points = np.array(getattr(landmarks, "points", landmarks), dtype=np.float64)
    except (TypeError, ValueError):
        raise TrainingError(f"{name}: the landmarks are not numbers; give (n, 2) points") from None
    _check_points(points, name)
    contours = tuple((tuple(c.indices), bool(c.closed)) for c in getattr(landmarks, "contours", ()))
    is_known = np.asarray(~np.isnan(points).any(axis=1))
    entry = Entry(
        name=name,
        read_image=read_image_of_item,
        points=points,
        known=None if is_known.all() else is_known,
        pixel=length_of(landmarks) if isinstance(landmarks, Landmarks) else None,
        side=getattr(item, "side", "") or stated_side(getattr(landmarks, "side", "")),
        read_width=partial(_width_of_file, image) if isinstance(image, str | os.PathLike) else None,
        file=Path(image) if isinstance(image, str | os.PathLike) else None,
    )
    return _Sample(entry, contours, tuple(getattr(landmarks, "names", ())))


def _width_of_file(image: str | os.PathLike) -> int:
    """Return the width of an image file, pixels, without reading all of it."""
    return image_size(image)[0]


def _pair_of(item: Any, i: int) -> tuple[Any, Any]:
    """Return image and landmarks of item ``i`` of the training data."""
    try:
        image, landmarks = item
    except (TypeError, ValueError):
        raise TrainingError(
            f"training item {i + 1} is not an (image, landmarks) pair; for a folder give liaam.load_folder(folder)"
        ) from None
    return as_pixels(image, f"image {i + 1}"), landmarks


def _image_of_pair(image: Any, i: int) -> tuple[str, Callable[[], np.ndarray]]:
    """Return a name for the image of item ``i``, an array or a path, and a function that reads it."""
    if isinstance(image, str | os.PathLike):
        path = Path(image)
        return str(path.parent / path.stem), partial(read_image, image)
    return f"image {i + 1}", lambda: image


def _read_landmarks_of(image: Any, path: str | os.PathLike) -> Landmarks:
    """Read a landmark file, and of several records in it that of the image's file."""
    image_name = Path(image).name if isinstance(image, str | os.PathLike) else None
    return read_landmarks(path, _size_for(path, image), image_name)


def _size_for(path: str | os.PathLike, image: Any) -> tuple[int, int] | None:
    """Return (width, height) of an image, (h, w, ...) or a path, if the format of a landmark file needs it."""
    if not needs_image(Path(path)):
        return None
    if isinstance(image, str | os.PathLike):
        return image_size(image)
    if np.ndim(image) < 2:
        return None
    height, width = np.shape(image)[:2]
    return (width, height) if width else None


def _check_points(points: np.ndarray, name: str) -> None:
    """Raise unless the points of the sample of a name are usable as landmarks, some of which may be missing (NaN)."""
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < FEWEST_LANDMARKS:
        raise TrainingError(
            f"{name}: landmarks of shape {points.shape} are not (n, 2) points with n of at least {FEWEST_LANDMARKS}"
        )
    if len(points) > MAX_POINTS:
        raise TrainingError(
            f"{name}: {len(points)} landmarks are more than {MAX_POINTS}: remove the same landmarks in all images"
        )
    is_missing = np.isnan(points).all(axis=1)
    lacks_one = np.isnan(points).any(axis=1) != is_missing
    if np.isinf(points).any() or lacks_one.any():
        raise TrainingError(f"{name}: a landmark is infinite, or has only one of x and y; give NaN for missing ones")
    if is_missing.all():
        raise TrainingError(f"{name}: all of its {len(points)} landmarks are missing (NaN); place them, or remove it")
    placed = points[~is_missing]
    if len(placed) >= FEWEST_KNOWN and np.ptp(placed, axis=0).max() < LEAST_EXTENT:
        raise TrainingError(
            f"{name}: all landmarks lie within {LEAST_EXTENT:g} pixels of each other; are they in pixels?"
        )


def image_of(name: str) -> str:
    """Return the name of the image of a sample, which may be one of several objects in it: party#2, party#left."""
    return re.sub(r"#[^#/]*$", "", name)


def check_flat(mean: np.ndarray, shapes: np.ndarray) -> None:
    """Raise if the mean of shapes (m, n, 2) is so flat that its mesh has hardly any pixels."""
    major, minor = np.linalg.svd(mean - mean.mean(axis=0), compute_uv=False)
    if minor >= FLATTEST * major:
        return
    spreads = np.linalg.svd(shapes - shapes.mean(axis=1, keepdims=True), compute_uv=False)
    # If most shapes are clearly less flat than the limit, their mean is flat only because they do not correspond.
    if np.median(spreads[:, 1] / spreads[:, 0]) > 2 * FLATTEST:
        raise TrainingError(
            "the landmarks of each image are spread out, but their mean lies on one line: many seem to have y counted "
            "from the other border, or to be in another order ('liaam check' shows them); if they are upside down "
            "since the objects are of the other side, state the sides (a column 'side', or names such as wing1_left)"
        )
    raise TrainingError(
        "the landmarks lie on one line or at one point, or almost so (their minor spread is "
        f"{minor / major:.1%} of the major one, {FLATTEST:.0%} are needed); check their order and units, or add "
        "landmarks off that line"
    )


def folded_shares(entries: Sequence[Entry], mean: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the fraction of a mesh's area that the landmarks of each sample turn over, (m,), 0 to 1."""
    aligned = aligned_to(mean, np.array([entry.points for entry in entries]))
    return np.array(
        [folded_share(points, triangles, entry.known) for points, entry in zip(aligned, entries, strict=True)]
    )


def without_folded(
    entries: Sequence[Entry], mean: np.ndarray, triangles: np.ndarray, strict: bool = False
) -> np.ndarray:
    """Return the indices of samples whose landmarks do not fold the mesh, and warn of the others.

    Raises a TrainingError if there are too few of them, if most samples fold the mesh, or, if ``strict``, if any does.
    """
    shares = folded_shares(entries, mean, triangles)
    sound = np.flatnonzero(shares <= FOLD_TOLERANCE)
    if len(sound) == len(entries):
        return sound
    folded = [f"{entries[i].name} ({shares[i]:.0%})" for i in np.flatnonzero(shares > FOLD_TOLERANCE).tolist()]
    fault = (
        f"the landmarks of {len(folded)} of {count_of(len(entries), 'image')} fold the mesh (share of its area that is "
        f"flipped: {some_names(folded, 20)})"
    )
    remedy = (
        "check that their points are in the same order as in the other images, and that none is misplaced ('liaam "
        "check' finds such points)"
    )
    if strict or len(sound) < max(FEWEST, len(folded)):
        raise TrainingError(f"{fault}; {remedy}")
    warnings.warn(f"{fault}, and are left out; {remedy}", stacklevel=5)  # the caller of train, which is decorated
    return sound
