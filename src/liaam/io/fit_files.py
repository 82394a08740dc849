"""Fit results: all values as .json, and landmarks as .pts, .csv and .tps."""

import json
import os
from pathlib import Path

import numpy as np

from liaam.errors import LandmarkError
from liaam.formatting import json_value
from liaam.io.atomic import write_text_atomically
from liaam.io.files import companions, fingerprint_of, json_object, real_path
from liaam.io.landmarks import LandmarkFile, Landmarks, write_landmarks
from liaam.io.landmarks.annotations import is_fit
from liaam.io.landmarks.reading import read_text
from liaam.io.landmarks.writers import csv_text, tps_text, upwards

FIT_SUFFIXES = (".pts", ".csv", ".tps", ".json")
"""Suffixes of the files that a fit can have."""

STATELESS = (".pts", ".tps")
"""Those of them that cannot hold the status of a fit."""

ROUNDING = 0.02
"""Difference in pixels below which points of two files are the same."""
FARTHEST = 1e6
"""Coordinate beyond which all points are the same."""


def write_fit(path: Path, landmarks: Landmarks, facts: dict, image_size: tuple[int, int]) -> None:
    """Write the landmarks of a fit, in a .json file its further facts, and in a .csv file its side and status.

    Landmarks are in pixels from the centre of the top-left one, and ``image_size`` is width and height. In .json files,
    numbers that are not finite become null.
    """
    if path.suffix.lower() == ".tps":
        text = tps_text(upwards(landmarks, image_size))
        return write_text_atomically(path, text, LandmarkError)
    if path.suffix.lower() == ".csv":
        more = {name: str(facts[name]) for name in ("side", "status") if facts.get(name)}
        return write_text_atomically(path, csv_text(landmarks, more), LandmarkError)
    if path.suffix.lower() != ".json":
        return write_landmarks(path, landmarks, image_size)
    return write_text_atomically(path, fit_text(landmarks, {**facts, "image_size": image_size}))


def read_fit(path: Path) -> dict | None:
    """Read the .json file of a fit; None if there is none, or if it is something else."""
    content = json_object(read_text(path)) if path.is_file() else None
    return content if content is not None and is_fit(content) else None


def image_facts(image: Path, fingerprint: str, folder: Path) -> dict[str, str]:
    """Return what the .json file of a fit in a folder says of the image's file: its path from there and fingerprint."""
    try:
        path = os.path.relpath(real_path(image), real_path(folder))
    except ValueError:  # on another drive
        path = str(real_path(image))
    return {"path": Path(path).as_posix(), "fingerprint": fingerprint}


def is_of_other_image(path: Path, image: Path) -> bool:
    """Return whether the .json file of a fit is that of another image than a file, by its path and its content.

    An image that was changed since, or moved, is the same.
    """
    fit = read_fit(path) or {}
    place, known = fit.get("path"), fit.get("fingerprint")
    if not (isinstance(place, str) and isinstance(known, str) and place and known) or "\0" in place:
        return False
    if real_path(path.parent / place) == real_path(image):
        return False
    return fingerprint_of(image) not in ("", known)


def corrected_file(path: Path, fit: dict) -> Path | None:
    """Return the landmark file beside a fit's .json file that was changed since.

    If there are several, it is the newest of those that can be read.
    """
    try:
        fitted = np.array(fit["landmarks"] or [], np.float64).reshape(-1, 2)
    except (TypeError, ValueError) as fault:
        raise LandmarkError(
            f"{path}: the landmarks are damaged ({fault}): remove it, and fit the image again"
        ) from fault
    files = companions(path.parent, [path.stem], FIT_SUFFIXES[:-1])
    points = {file: _points_or_none(file, fit) for file in files if file.is_file()}
    changed = [file for file, placed in points.items() if placed is None or _differ(placed, fitted)]
    return max(changed, key=lambda file: (points[file] is not None, file.stat().st_mtime), default=None)


def points_of_fit(file: Path, fit: dict) -> np.ndarray:
    """Read the points (n, 2), in pixels, of a landmark file beside a fit's .json file."""
    read = LandmarkFile.read(file)
    if len(read.entries) != 1:
        raise LandmarkError(f"{file} holds the landmarks of {len(read.entries)} images, not of one fit")
    return read.placed(next(iter(read.entries)), _image_size(fit)).points


def _image_size(fit: dict) -> tuple[float, float] | None:
    size = fit.get("image_size")
    if isinstance(size, list) and len(size) == 2 and all(isinstance(side, int) for side in size):
        return size[0], size[1]
    return None


def _points_or_none(file: Path, fit: dict) -> np.ndarray | None:
    """Read the points of a landmark file; None if it cannot be read, so that liaam has not written it like this."""
    if file.suffix.lower() == ".tps" and _image_size(fit) is None:  # its points depend on the height
        return np.array(fit["landmarks"] or [], np.float64).reshape(-1, 2)
    try:
        return points_of_fit(file, fit)
    except LandmarkError:
        return None


def _differ(points: np.ndarray, fitted: np.ndarray) -> bool:
    """Return whether points (m, 2) are not those of a fit (n, 2)."""
    if points.shape != fitted.shape:
        return True
    points, fitted = (np.clip(each, -FARTHEST, FARTHEST) for each in (points, fitted))
    return not np.allclose(points, fitted, rtol=0, atol=ROUNDING, equal_nan=True)


def fit_text(landmarks: Landmarks, facts: dict) -> str:
    """Return the text of a fit's .json file; see :func:`write_fit`."""
    lines = {"contours": [(line.indices, line.closed) for line in landmarks.contours]} if landmarks.contours else {}
    content = {**facts, **lines, "landmarks": landmarks.points}
    return json.dumps(json_value(content), indent=1, allow_nan=False) + "\n"
