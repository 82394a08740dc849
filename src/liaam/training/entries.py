"""Training samples: read and validate landmarks, contours and mesh."""

import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import TrainingError
from liaam.io import image_size, read_image, read_landmarks
from liaam.io.files import count_of, some_names
from liaam.model.file import MAX_POINTS
from liaam.model.mesh import FOLD_TOLERANCE, ReferenceFrame, delaunay, folded_share, signed_areas, triangles_from_edges
from liaam.model.shape import align

FLATTEST = 0.02
"""Least ratio of the landmarks' minor to major spread: that of a rod 80 times as long as wide. Measured on generated
rods: the search finds those up to 20 times as long as wide, and fits from a start converge up to 40 times."""


@dataclass(frozen=True)
class Entry:
    """A validated training sample: a name for messages, a function that reads the image, and its landmarks."""

    name: str
    read_image: Callable[[], np.ndarray]
    points: np.ndarray


def read_entries(data: Iterable) -> tuple[list[Entry], tuple, np.ndarray, tuple[str, ...]]:
    """Read and validate samples.

    Also return the contours and connectivity of the first sample that has any, and the names of the landmarks if all
    samples that name them agree.
    """
    entries: list[Entry] = []
    contours: tuple = ()
    named: dict[tuple[str, ...], tuple[tuple[str, ...], str]] = {}  # names and first image, by the names in any order
    if isinstance(data, (str, os.PathLike)) or not isinstance(data, Iterable):
        raise TrainingError(f"{data!r} is not a set of landmarked images; for a folder give liaam.load_folder(folder)")
    for i, item in enumerate(data):
        entry, own, names = _entry(item, i)
        if entries and len(entry.points) != len(entries[0].points):
            raise TrainingError(
                f"{entry.name} has {len(entry.points)} landmarks but {entries[0].name} has {len(entries[0].points)}; "
                "every image needs the same points in the same order"
            )
        entries.append(entry)
        contours = contours or own
        if names:
            _check_order(names, entry.name, *named.setdefault(tuple(sorted(names)), (names, entry.name)))
    if len(entries) < 3:
        few = count_of(len(entries), "landmarked image")
        raise TrainingError(f"{few}: too few to learn from; at least 3 are needed, 5 to 20 are better")
    edges = [pair for indices, closed in contours for pair in pairwise([*indices, indices[0]] if closed else indices)]
    names = next(iter(named.values()))[0] if len(named) == 1 else ()
    return entries, contours, np.array(edges, dtype=int).reshape(-1, 2), names


def _size_for(landmarks: str | os.PathLike, image: Any) -> tuple[int, int] | None:
    """Return (width, height) of an image, (h, w, ...) or a path, if the format of a landmark file needs it."""
    if Path(landmarks).suffix.lower() not in (".asf", ".tps", ".nts"):
        return None
    if isinstance(image, str | os.PathLike):
        return image_size(image)
    height, width = np.shape(image)[:2] if np.ndim(image) > 1 else (0, 0)
    return (width, height) if width else None


def _check_order(names: tuple[str, ...], image: str, first: tuple[str, ...], other: str) -> None:
    """Raise if an image has the names of another's landmarks in another order."""
    for i, (own, usual) in enumerate(zip(names, first, strict=True)):
        if own != usual:
            raise TrainingError(
                f"landmark {i + 1} is {usual!r} in {other} but {own!r} in {image}; every image needs the same points "
                "in the same order"
            )


def _entry(item, i: int) -> tuple[Entry, tuple, tuple[str, ...]]:
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
            landmarks = read_landmarks(landmarks, _size_for(landmarks, image), file_name)
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
    missing = ~np.isfinite(points).all(axis=1)
    if missing.any():
        which = some_names([str(j + 1) for j in np.flatnonzero(missing)])
        raise TrainingError(
            f"{name}: {missing.sum()} of {len(points)} landmarks are missing (NaN; point {which} counting from 1); "
            "place them or remove this image"
        )
    if np.ptp(points, axis=0).max() < 2:
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


def check_fold(entry: Entry, frame: ReferenceFrame) -> None:
    """Raise if the landmarks of a sample fold the mesh."""
    upright = align(entry.points, frame.points)(entry.points)
    share = folded_share(upright, frame.triangles)
    if share > FOLD_TOLERANCE:
        raise TrainingError(
            f"{entry.name}: its landmarks fold the mesh ({share:.0%} of the area is flipped); check that its points "
            "are in the same order as in the other images, that none is misplaced, and that the image is not mirrored "
            "('liaam check' finds such points)"
        )
