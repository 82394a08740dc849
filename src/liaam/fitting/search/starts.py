"""The start of a fit: as text or a file (numbers, landmarks, the name of a landmarker), and as a shape of a model."""

import errno
import stat
from os import PathLike
from pathlib import Path

import numpy as np

from liaam.errors import LandmarkError, StartError
from liaam.fitting.landmarkers import LANDMARKERS
from liaam.io.files import companions, existing_file, read_bytes
from liaam.io.images import read_image
from liaam.io.landmarks import LANDMARK_SUFFIXES, Landmarks, read_landmarks
from liaam.model import AAM
from liaam.model.shape import align, corners_of, in_box

_SHOWN = 100  # characters of a start in a message, at most
BOX_SUFFIX = ".box"  # of a text file that holds a detector's box, x0,y0,x1,y1 or x,y,size
LEAST_REGION = 16  # smallest width and height of a region that is searched, pixels
WIDEST = 10.0  # largest size of a start, relative to the larger side of the image


def read_start(text: str, image: Path, size: tuple[int, int]) -> Landmarks | list[float]:
    """Read the start of one image of a size (width, height), in a form that :meth:`liaam.fitting.Fitter.fit` takes.

    The text is a box ``x0,y0,x1,y1``; a centre and a size ``x,y,size``; a landmark file; a text file ``.box`` with such
    numbers; a folder that holds such a file with the image's name; or a name of
    :data:`liaam.fitting.landmarkers.LANDMARKERS`.
    """
    path = start_file(text, image)
    if path is not None:
        return _read(path, image, size)
    if text in LANDMARKERS:
        points = LANDMARKERS[text](read_image(image))
        if points is None:
            raise StartError(f"{image.name}: {text} finds nothing in this image; give a box, or leave --init out")
        return Landmarks(points)
    if _kind(text) == "folder":
        raise StartError(f"{image.name}: {Path(text)} holds no landmark file for it; add one such as {image.stem}.pts")
    shown = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
    return _parsed(text, f"--init {shown}: there is no such file or folder, and it")


def read_with_start(image: Path, init: str | None) -> tuple[np.ndarray, Landmarks | list[float] | None]:
    """Read an image, and its start if one is given (:func:`read_start`)."""
    pixels = read_image(image)
    return pixels, None if init is None else read_start(init, image, pixels.shape[1::-1])


def start_file(text: str, image: Path) -> Path | None:
    """Return the file that holds the start of an image, or None if there is no such file."""
    path = Path(text)
    kind = _kind(text)
    if kind == "folder":
        candidates = companions(path, [image.stem], (*LANDMARK_SUFFIXES, BOX_SUFFIX))
        return next((candidate for candidate in candidates if _kind(str(candidate)) == "file"), None)
    return path if kind == "file" else None


def check_start(text: str) -> None:
    """Raise if a text cannot be a start for any image: not a file, a folder, or numbers."""
    if not _kind(text) and text not in LANDMARKERS:
        read_start(text, Path(), (1, 1))


def _kind(text: str) -> str:
    """Return "file", "folder" or "other" for an existing path, or else ""."""
    try:
        mode = Path(text).stat().st_mode
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return ""
    except OSError as fault:
        if fault.errno == errno.ENAMETOOLONG:
            return ""
        raise StartError(f"--init: {text} cannot be read ({fault.strerror or fault}): check its permissions") from fault
    return "folder" if stat.S_ISDIR(mode) else "file" if stat.S_ISREG(mode) else "other"


def _read(path: Path, image: Path, size: tuple[int, int]) -> Landmarks | list[float]:
    if path.suffix.lower() != BOX_SUFFIX:
        return read_landmarks(path, size, image.name)
    text = read_bytes(existing_file(path, StartError, "box"), StartError, limit=1000).decode("utf-8-sig", "replace")
    return _parsed(",".join(text.replace(",", " ").split()), f"{path}: it")


def _parsed(text: str, what: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise StartError(f"{what} is neither a box x0,y0,x1,y1 nor x,y,size") from None
    if len(numbers) not in (3, 4):
        raise StartError(
            f"{what.partition(':')[0]}: give four numbers x0,y0,x1,y1 (a box) or three x,y,size, not {len(numbers)}"
        )
    return numbers


def start_shape(model: AAM, init, image_size: tuple[int, int], name: str = "image") -> np.ndarray:
    """Convert a start given by the user to a shape, (n, 2) float64; ``image_size`` is width and height.

    It may be a shape in image pixels, in which up to n - 3 landmarks may be NaN: they are filled in from the mean shape
    aligned to the others. Or a box (x0, y0, x1, y1): the mean shape takes its centre and diagonal. Or (x, y, size): the
    centre of the mean shape's bounding box, and its diagonal. StartError is raised if it has the wrong number of
    points, is not numeric, or lies outside the image.
    """
    shape = _shape(model, _numbers(_by_name(model, init, name), name), name)
    width, height = image_size
    low, high = corners_of(shape)
    if low.min() < 0 or (high > (width - 1, height - 1)).any():
        inside = ((shape >= 0) & (shape <= (width - 1, height - 1))).all(axis=1).mean()
        if inside < 0.2:
            x, y = 0.5 * (low + high)
            raise StartError(
                f"{name}: the start lies outside the image (centre {x:.0f}, {y:.0f}; the image is {width}×{height} "
                "pixels); give a start in pixels of this image"
            )
    longest = max(width, height)
    extent = (high / longest - low / longest).max()
    if not extent <= WIDEST:
        raise StartError(
            f"{name}: the start is {extent:.3g} times as large as the image ({width}×{height} pixels), but at most "
            f"{WIDEST:g} times is allowed; give a start in pixels of this image"
        )
    # Size of the aligned mean shape: it is 0 if all points coincide.
    size = model.diagonal * align(model.shape_model.mean, shape).scale
    if not size >= 4.0:
        raise StartError(f"{name}: the start is only {size:.1f} pixels large; give a start as large as the object")
    return shape


def region_in(image: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (x, y), in whole pixels, of a region between two points of an image, cut off at its border."""
    limits = np.array(image.shape[1::-1])
    first = np.clip(low, 0, limits - LEAST_REGION).astype(int)
    return first, np.clip(np.ceil(high).astype(int), first + LEAST_REGION, limits)


def is_box(init) -> bool:
    """Return whether a start is a box (x0, y0, x1, y1), or a centre and a size (x, y, diagonal)."""
    return np.shape(getattr(init, "points", init)) in ((4,), (3,))


def part_of_start(model: AAM, init, name: str = "image") -> int | None:
    """Return the index of the model's part that a whole shape belongs to; None for other starts."""
    if init is None or not model.others:
        return None
    shape = _numbers(_by_name(model, init, name), name)
    whole = shape.shape == (model.n_points, 2) and np.isfinite(shape).all()
    return model.part_of(shape) if whole else None


def mapped_points(model: AAM, init, name: str = "image") -> np.ndarray | None:
    """Map the points of another landmarker to landmarks, (n, 2) float64; None if the start is something else."""
    given = _numbers(init, name)
    if model.points is None or given.shape != (model.points.n_theirs, 2):
        return None
    if not np.isfinite(given).all():
        raise StartError(f"{name}: some of the other landmarker's points are not finite; start from a box, or search")
    return model.points(given)


def _by_name(model: AAM, init, name: str):
    """Return landmarks in the order of the model's names, if both have names."""
    order = getattr(init, "in_order_of", None)
    try:
        return init if order is None else order(model.landmark_names)
    except LandmarkError as error:
        raise StartError(f"{name}: the start cannot be used: {error}") from error


def _numbers(init, name: str) -> np.ndarray:
    try:
        return np.asarray(getattr(init, "points", init), dtype=np.float64)
    except (TypeError, ValueError) as error:
        if isinstance(init, str | PathLike):
            raise StartError(
                f"{name}: the start {str(init)!r} is not a shape, box, or point and size; for a landmark file give "
                "liaam.read_landmarks(path)"
            ) from error
        raise StartError(f"{name}: the start {init!r} is not a shape, box, or point and size ({error})") from error


def _shape(model: AAM, given: np.ndarray, name: str) -> np.ndarray:
    mean = model.shape_model.mean
    if given.shape == (model.n_points, 2):
        seen = np.asarray(np.isfinite(given).all(axis=1))
        if not seen.all() and seen.sum() < 3:
            raise StartError(f"{name}: only {seen.sum()} of the start's landmarks are finite; give at least 3")
        return given if seen.all() else np.where(seen[:, None], given, align(mean, given)(mean))
    if given.shape == (4,):
        x0, y0, x1, y1 = given
        if not np.isfinite(given).all() or x1 <= x0 or y1 <= y0:
            box = ", ".join(f"{v:g}" for v in given)
            raise StartError(f"{name}: the box {box} is empty; give left, top, right, bottom in pixels")
        centre = np.array([x0 + x1, y0 + y1]) / 2
        diagonal = float(np.hypot(x1 - x0, y1 - y0))
    elif given.shape == (3,):
        if not np.isfinite(given).all() or given[2] <= 0:
            raise StartError(f"{name}: give the start as x, y and a positive size (the object's diagonal in pixels)")
        centre = given[:2]
        diagonal = float(given[2])
    elif given.ndim == 2 and given.shape[1] == 2:
        theirs = f" or {model.points.n_theirs} points of the other landmarker" if model.points is not None else ""
        raise StartError(
            f"{name}: the start has {len(given)} landmarks but the model has {model.n_points}{theirs}; to start from "
            "another landmarker's points, train with them ('liaam train --points FOLDER', or train(..., points=...))"
        )
    else:
        raise StartError(
            f"{name}: a start of shape {given.shape} is neither landmarks ({model.n_points}, 2), nor a box "
            "(x0, y0, x1, y1), nor a point and a size (x, y, diagonal)"
        )
    return in_box(mean, centre, diagonal)
