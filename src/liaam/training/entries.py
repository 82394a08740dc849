"""Training samples: read and validate landmarks, contours and mesh."""

import os
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from liaam.errors import LandmarkError, TrainingError
from liaam.io import Landmarks, image_size, read_image, read_landmarks
from liaam.io.files import count_of, some_names
from liaam.io.landmarks.base import contour_of
from liaam.model.file import MAX_POINTS
from liaam.model.mesh import FOLD_TOLERANCE, delaunay, folded_share, signed_areas, triangles_from_edges
from liaam.model.shape import align, procrustes_mean

# Least ratio of the landmarks' minor to major spread: that of a rod 80 times as long as wide. Measured on generated
# rods: the search finds those up to 20 times as long as wide, and fits from a start converge up to 40 times.
FLATTEST = 0.02


FEWEST = 3  # Fewest images to learn from


@dataclass(frozen=True)
class Entry:
    """A validated training sample: a name for messages, a function that reads the image, and its landmarks."""

    name: str
    read_image: Callable[[], np.ndarray]
    points: np.ndarray


def read_entries(
    data: Iterable, contours: Iterable | None = None, strict: bool = False
) -> tuple[list[Entry], tuple, np.ndarray, tuple[str, ...]]:
    """Read and validate samples.

    Also return the contours and connectivity of the first sample that has any, and the names of the landmarks if all
    samples that name them agree. ``contours``, if given, replace those of the samples. ``strict``
    refuses samples with missing landmarks.
    """
    entries: list[Entry] = []
    found: tuple = ()
    named: dict[tuple[str, ...], tuple[tuple[str, ...], str]] = {}  # names and first image, by the names in any order
    if isinstance(data, (str, os.PathLike)) or not isinstance(data, Iterable):
        raise TrainingError(f"{data!r} is not a set of landmarked images; for a folder give liaam.load_folder(folder)")
    for i, item in enumerate(data):
        entry, own, names = _entry(item, i, next(iter(named.values()))[0] if named else ())
        if entries and len(entry.points) != len(entries[0].points):
            raise TrainingError(
                f"{entry.name} has {len(entry.points)} landmarks but {entries[0].name} has {len(entries[0].points)}; "
                "every image needs the same points in the same order"
            )
        entries.append(entry)
        found = found or own
        if names:
            named.setdefault(tuple(sorted(names)), (names, entry.name))
    entries = _complete(entries, strict)
    if len(entries) < FEWEST:
        few = count_of(len(entries), "landmarked image")
        raise TrainingError(f"{few}: too few to learn from; at least 3 are needed, 5 to 20 are better")
    edges = [pair for indices, closed in found for pair in pairwise([*indices, indices[0]] if closed else indices)]
    names = next(iter(named.values()))[0] if len(named) == 1 else ()
    known = found if contours is None else contours_of(contours, len(entries[0].points))
    return entries, known, np.array(edges, dtype=int).reshape(-1, 2), names


def contours_of(given: Iterable, n: int) -> tuple[tuple[tuple[int, ...], bool], ...]:
    """Return contours as (indices, closed); given so, or as indices of which a repeated first closes a line.

    Raises a TrainingError if one is not a line through some of n landmarks.
    """
    known = []
    for each in given:
        try:
            indices, closed = each if len(each) == 2 and np.ndim(each[0]) == 1 else (each, False)
            line = contour_of([int(i) for i in indices], bool(closed))
        except (TypeError, ValueError):
            line = None
        if line is None or not all(0 <= i < n for i in line.indices):
            raise TrainingError(
                f"contour {each!r}: give the indices of the landmarks along it, 0 to {n - 1}, with the first once more "
                "at the end if it is closed"
            )
        known.append((line.indices, line.closed))
    return tuple(known)


def _complete(entries: list[Entry], strict: bool) -> list[Entry]:
    """Leave out the samples with missing landmarks; if too few are complete, place these as the others suggest.

    Warns, in one line, about what was done.
    """
    lacking = [entry for entry in entries if np.isnan(entry.points).any()]
    if not lacking:
        return entries
    complete = [entry for entry in entries if not np.isnan(entry.points).any()]
    names = some_names([entry.name for entry in lacking])
    if strict:
        raise TrainingError(
            f"landmarks are missing in {count_of(len(lacking), 'image')} ({names}): place them, or train without "
            "--strict (strict=False)"
        )
    have, are = ("image has", "is") if len(lacking) == 1 else ("images have", "are")
    if len(complete) >= FEWEST:
        warnings.warn(f"{len(lacking)} {have} missing landmarks and {are} left out: {names}", stacklevel=4)
        return complete
    points = placed_by_others(np.array([entry.points for entry in entries]))
    if np.isnan(points).any():
        raise TrainingError(
            f"{len(lacking)} of {len(entries)} images have missing landmarks ({names}), too many to place them by the "
            "other images; place them, or remove these images"
        )
    warnings.warn(
        f"{len(lacking)} {have} missing landmarks, which are placed where the other images suggest, because only "
        f"{len(complete)} are complete: {names}",
        stacklevel=4,
    )
    return [replace(entry, points=own) for entry, own in zip(entries, points, strict=True)]


def placed_by_others(shapes: np.ndarray) -> np.ndarray:
    """Place the missing landmarks (NaN) of shapes (m, n, 2) where the mean of all, aligned by similarity, has them.

    NaN remains where fewer than three landmarks of a shape are known, or where none has the landmark.
    """
    known = ~np.isnan(shapes).any(axis=2)
    if (known.sum(axis=1) < 3).any() or not known.any(axis=0).all():
        return shapes
    mean = procrustes_mean(shapes)
    return np.where(np.isnan(shapes), [align(mean, shape)(mean) for shape in shapes], shapes)


def _entry(item, i: int, order: tuple[str, ...]) -> tuple[Entry, tuple, tuple[str, ...]]:
    if hasattr(item, "landmarks"):
        name, landmarks, read = item.name, item.landmarks, item.read_image
    else:
        try:
            image, landmarks = item
        except (TypeError, ValueError):
            raise TrainingError(
                f"training item {i + 1} is not an (image, landmarks) pair; for a folder give liaam.load_folder(folder)"
            ) from None
        name, read, file_name = f"image {i + 1}", lambda: image, None
        if isinstance(image, str | os.PathLike):
            path, read = Path(image), partial(read_image, image)
            file_name, name = path.name, str(path.parent / path.stem)
        if isinstance(landmarks, str | os.PathLike) and Path(landmarks).suffix:
            size = None
            if Path(landmarks).suffix.lower() in (".asf", ".tps", ".nts"):  # they need that of the image
                if isinstance(image, str | os.PathLike):
                    size = image_size(image)
                elif np.ndim(image) > 1 and np.shape(image)[1]:
                    size = np.shape(image)[1], np.shape(image)[0]
            landmarks = read_landmarks(landmarks, size, file_name)
    if order and isinstance(landmarks, Landmarks):
        try:
            landmarks = landmarks.in_order_of(order)
        except LandmarkError as fault:
            raise TrainingError(f"{name}: {fault}") from fault
    try:
        points = np.array(getattr(landmarks, "points", landmarks), dtype=np.float64)
    except (TypeError, ValueError):
        raise TrainingError(f"{name}: the landmarks are not numbers; give (n, 2) points") from None
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise TrainingError(f"{name}: landmarks of shape {points.shape} are not (n, 2) points with n of at least 3")
    if len(points) > MAX_POINTS:
        raise TrainingError(
            f"{name}: {len(points)} landmarks are more than {MAX_POINTS}: remove the same landmarks in all images"
        )
    if np.isinf(points).any() or (np.isnan(points).any(axis=1) != np.isnan(points).all(axis=1)).any():
        raise TrainingError(f"{name}: a landmark is infinite, or has only one of x and y; give NaN for missing ones")
    if np.isnan(points).all():
        raise TrainingError(f"{name}: all of its {len(points)} landmarks are missing (NaN); place them, or remove it")
    if np.ptp(points[~np.isnan(points[:, 0])], axis=0).max() < 2:
        raise TrainingError(f"{name}: all landmarks lie within 2 pixels of each other; are they in pixels?")
    contours = tuple((tuple(c.indices), bool(c.closed)) for c in getattr(landmarks, "contours", ()))
    return Entry(name, read, points), contours, tuple(getattr(landmarks, "names", ()))


def image_of(name: str) -> str:
    """Return the name of the image of a sample, which may be one of several objects in it: party#2, party#left."""
    return re.sub(r"#[^#/]*$", "", name)


def check_flat(mean: np.ndarray, shapes: np.ndarray) -> None:
    """Raise if the mean of shapes (m, n, 2) is so flat that its mesh has hardly any pixels."""
    along, across = np.linalg.svd(mean - mean.mean(axis=0), compute_uv=False)
    if across < FLATTEST * along:
        spreads = np.linalg.svd(shapes - shapes.mean(axis=1, keepdims=True), compute_uv=False)
        if np.median(spreads[:, 1] / spreads[:, 0]) > 2 * FLATTEST:
            raise TrainingError(
                "the landmarks of each image are spread out, but their mean lies on one line: many images seem to be "
                "mirrored, or to have their landmarks in another order; 'liaam check' shows them"
            )
        raise TrainingError(
            "the landmarks lie on one line or at one point, or almost so (their minor spread is "
            f"{across / along:.1%} of the major one, {FLATTEST:.0%} are needed); check their order and units, or add "
            "landmarks off that line"
        )


def mesh_of(mean: np.ndarray, given: np.ndarray | None, edges: np.ndarray) -> np.ndarray:
    """Triangles: the given ones, or the landmark files' connectivity if it is a mesh, or the Delaunay triangulation."""
    if given is None:
        mesh = triangles_from_edges(mean, edges) if len(edges) else None
        return delaunay(mean) if mesh is None else mesh
    triangles = np.asarray(given)
    right = triangles.ndim == 2 and triangles.shape[1] == 3 and triangles.dtype.kind in "iu" and len(triangles)
    if not right or triangles.min() < 0 or triangles.max() >= len(mean):
        raise TrainingError(f"triangles must be (t, 3) integers from 0 to {len(mean) - 1}")
    triangles = triangles.astype(np.int32)
    # Triangles may have either orientation, as long as it is the same for all.
    return triangles[:, ::-1].copy() if (signed_areas(mean, triangles) < 0).mean() > 0.5 else triangles


def without_folded(
    entries: Sequence[Entry], mean: np.ndarray, triangles: np.ndarray, strict: bool = False
) -> np.ndarray:
    """Return the indices of samples whose landmarks do not fold the mesh, and warn of the others.

    Raises a TrainingError if there are too few of them, if most samples fold the mesh, or, if ``strict``, if any does.
    """
    shares = np.array([folded_share(align(entry.points, mean)(entry.points), triangles) for entry in entries])
    kept = np.flatnonzero(shares <= FOLD_TOLERANCE)
    if len(kept) == len(entries):
        return kept
    folded = [f"{entries[i].name} ({shares[i]:.0%})" for i in np.flatnonzero(shares > FOLD_TOLERANCE).tolist()]
    fault = (
        f"the landmarks of {len(folded)} of {count_of(len(entries), 'image')} fold the mesh (share of its area that is "
        f"flipped: {some_names(folded, 20)})"
    )
    remedy = (
        "check that their points are in the same order as in the other images, that none is misplaced, and that the "
        "images are not mirrored ('liaam check' finds such points)"
    )
    if strict or len(kept) < max(FEWEST, len(folded)):
        raise TrainingError(f"{fault}; {remedy}")
    warnings.warn(f"{fault}, and are left out; {remedy}", stacklevel=5)  # the caller of train, which is decorated
    return kept
