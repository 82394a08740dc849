"""Convert positions as a file counts them to pixels of the upright image, centres counted from 0.

Where a file states the size of its image, positions are scaled or turned along if the image has another size or an EXIF
orientation, and refused if the size fits neither.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.reading import Reading

Size = tuple[float, float]

_SMALL = 16
"""Width and height in pixels up to which all landmarks may lie within one pixel."""

SCALED = "positions are for another size of the image, and are scaled along"
TURNED = "positions are for the photo before its EXIF orientation turns it, and are turned along"
UNDECIDED = (
    "photos have an EXIF orientation, and nothing says whether positions are for the photos before they are turned; "
    "they are taken for the turned ones (--stored-orientation if not)"
)


def place(
    landmarks: Landmarks, size: Size, orientation: int, reading: Reading, say: Callable[[str], object]
) -> Landmarks:
    """Place landmarks and the others of their image.

    Parameters
    ----------
    landmarks : Landmarks
    size : (float, float)
        Width and height of the upright image.
    orientation : int
        Its EXIF orientation, 1 to 8.
    reading : Reading
    say : callable
        Called with what was done, for the user.
    """
    placing = landmarks.placing
    stored = (size[1], size[0]) if orientation >= 5 else size
    declared = placing.size
    turned = reading.stored
    if declared is not None:
        turned = _is_turned(declared, size, stored, reading.stored)
    if (
        orientation != 1
        and not reading.stored
        and (declared is None or _fits(declared, size) == _fits(declared, stored))
    ):
        say(UNDECIDED)
    frame, target = declared or (stored if turned else size), stored if turned else size
    if not placing.fractions:
        _check_pixels(landmarks, frame)
    points = landmarks.points * frame if placing.fractions else landmarks.points
    if placing.upwards and not reading.y_down:
        points = np.stack([points[:, 0], frame[1] - 1 - points[:, 1]], axis=1)
    if frame != target:
        say(SCALED)
        points = (points + 0.5) * np.divide(target, frame) - 0.5
    if turned and orientation != 1:
        say(TURNED)
        points = turn(points, size, orientation)
    others = tuple(place(other, size, orientation, reading, say) for other in landmarks.others)
    return replace(landmarks, points=points, others=others, placing=Placing())


def _check_pixels(landmarks: Landmarks, size: Size) -> None:
    """Raise if positions in an image seem to be fractions of its size."""
    known = landmarks.points[~landmarks.missing]
    if len(known) > 2 and 0 <= known.min() <= known.max() <= 1 and min(size) > _SMALL:
        raise LandmarkError("all positions lie between 0 and 1, as fractions of the image's size do: give pixels.")


def turn(points: np.ndarray, size: Size, orientation: int) -> np.ndarray:
    """Turn points (n, 2) on a stored image along with its EXIF orientation; `size` is that of the upright image."""
    x, y = points.T[::-1] if orientation >= 5 else points.T
    y = size[1] - 1 - y if orientation in (3, 4, 7, 8) else y
    x = size[0] - 1 - x if orientation in (2, 3, 6, 7) else x
    return np.stack([x, y], axis=1)


def _is_turned(declared: Size, size: Size, stored: Size, preferred: bool) -> bool:
    """Return whether a declared size is that of the stored image. Raise if it is of neither."""
    upright = _fits(declared, size)
    if not upright and not _fits(declared, stored):
        raise LandmarkError(
            f"the file is for an image of {declared[0]:g} x {declared[1]:g} pixels, but the image has {size[0]:g} x "
            f"{size[1]:g}, which is no scaled copy: give the image that was annotated, or annotate this one."
        )
    return preferred and _fits(declared, stored) if upright else True


def _fits(declared: Size, size: Size) -> bool:
    """Return whether sizes have one ratio, but for rounding to whole pixels."""
    return abs(declared[0] * size[1] - declared[1] * size[0]) <= max(*declared, *size)
