"""Learn the map from the points of another landmarker on the training images."""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from liaam.errors import TrainingError
from liaam.fitting.landmarkers import LANDMARKERS
from liaam.io import LANDMARK_SUFFIXES, read_landmarks
from liaam.io.files import companions
from liaam.model.file_format import MAX_POINTS
from liaam.model.point_map import PointMap, learn_point_map
from liaam.model.sides import reflected_points
from liaam.photometry.encoding import as_colour
from liaam.training.entries import Entry, image_of
from liaam.training.objects import folds_of

Points = str | os.PathLike[str] | Callable[[np.ndarray], np.ndarray | None] | Sequence[np.ndarray | None] | np.ndarray
"""A folder of landmark files or a name of :data:`liaam.fitting.landmarkers.LANDMARKERS`; a function from an image to
its points; or the points of each image."""


def _apart(pair: tuple[Entry, np.ndarray]) -> float:
    return float(np.linalg.norm(pair[0].points.mean(axis=0) - pair[1].mean(axis=0)))


def map_of_points(points: Points, entries: Sequence[Entry], mean: np.ndarray) -> PointMap:
    """Learn the map from the points of another landmarker to the landmarks of samples with a mean shape (n, 2)."""
    pairs = [
        (entry, theirs)
        for entry, theirs in zip(entries, _points_of(points, entries), strict=True)
        if theirs is not None
    ]
    # Of several objects in an image for which the landmarker found the same points, keep the nearest to them.
    nearest: dict[tuple[str, bytes], tuple[Entry, np.ndarray]] = {}
    m = len(getattr(pairs[0][1], "points", pairs[0][1])) if pairs else 0
    for entry, theirs in pairs:
        array = np.array(getattr(theirs, "points", theirs), dtype=np.float64)
        if array.shape != (m, 2) or m < 3 or m > MAX_POINTS or not np.isfinite(array).all() or not np.ptp(array):
            raise TrainingError(
                f"{entry.name}: the points of the other landmarker, of shape {array.shape}, are not {max(m, 3)} finite "
                f"(x, y); every image needs the same 3 to {MAX_POINTS} points in the same order"
            )
        pair = entry, array
        key = image_of(entry.name), array.tobytes()
        nearest[key] = min(nearest.get(key, pair), pair, key=_apart)
    pairs = list(nearest.values())
    if len(pairs) < 3:
        where = f" of {points}" if isinstance(points, (str, os.PathLike)) else ""
        raise TrainingError(
            f"points{where}: there are points of another landmarker for {len(pairs)} of {len(entries)} images; at "
            f"least 3 are needed, in files named as the images, such as {Path(entries[0].name).stem}.pts"
        )
    shapes = np.array([theirs for _, theirs in pairs])
    if shapes.shape[1] == len(mean):
        raise TrainingError(
            f"points: the other landmarker has {len(mean)} points, as the model has; fits tell them apart by their "
            "number: add a point to theirs (such as their mean), or leave one out"
        )
    folds = folds_of([entry.name for entry, _ in pairs])
    return learn_point_map(shapes, np.array([entry.points for entry, _ in pairs]), mean, folds)


def points_of(points: Points | None, group: np.ndarray) -> Points | None:
    """Return the points of some images (indices ``group``) if they were given for each image in turn."""
    if points is None or isinstance(points, str | os.PathLike) or callable(points):
        return points
    return [points[i] for i in group if i < len(points)]


def _points_of(points: Points, entries: Sequence[Entry]) -> Iterator[np.ndarray | None]:
    """Yield the points of each sample, or None."""
    if isinstance(points, (str, os.PathLike)):
        folder = Path(points)
        if str(points) in LANDMARKERS and not folder.exists():
            yield from _points_of(LANDMARKERS[str(points)], entries)
            return
        if not folder.is_dir():
            raise TrainingError(f"points: {folder} is not a folder; give the folder of the other landmarker's files")
        for entry in entries:  # a file has the name of the sample, with or without its subfolder
            names = dict.fromkeys((entry.name, Path(entry.name).name))
            files = companions(folder, names, LANDMARK_SUFFIXES)
            file_of_entry = next((file for file in files if file.is_file()), None)
            yield (
                None
                if file_of_entry is None
                else _as_read(entry, read_landmarks(file_of_entry, entry.read_image().shape[1::-1]).points)
            )
    elif callable(points):
        yield from (points(as_colour(entry.read_image(), entry.name)) for entry in entries)
    elif len(points) != len(entries):
        raise TrainingError(f"points: there are points for {len(points)} images, but {len(entries)} images")
    else:
        yield from map(_as_read, entries, points)


def _as_read(entry: Entry, points: np.ndarray | None) -> np.ndarray | None:
    """Return points of the image of a sample as it is read: reflected if that is."""
    if points is None or not entry.reflected:
        return points
    array = np.array(getattr(points, "points", points), dtype=np.float64)
    is_reflectable = array.ndim == 2 and array.shape[1] == 2
    return reflected_points(array, entry.width) if is_reflectable else array  # others are refused
