"""Lamps learnt from objects that were photographed under each without having moved."""

from collections import Counter
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from liaam.errors import TrainingError
from liaam.evaluation import point_error
from liaam.lamps.bank import DARK, Lamps, anchors, as_srgb, square
from liaam.model.shape import diagonal_of, procrustes_mean
from liaam.photometry import Response
from liaam.photometry.encoding import as_colour
from liaam.progress import Progress

BLUR = 0.016
"""Blur of a ratio of two pictures, as a share of the object's diagonal: the light stays, the grain of skin or fur goes,
and so does what a breath has moved."""

MOVED = 0.03
"""Mean distance of the landmarks of an object's pictures, as a share of its diagonal, beyond which it has moved."""


class _Picture(NamedTuple):
    name: str
    lamp: str
    read: Callable[[], np.ndarray]
    points: np.ndarray


def learn_lamps(
    data: Iterable,
    training_lamp: str | None = None,
    *,
    response: Response = "srgb",
    progress: Progress | None = None,
) -> Lamps:
    """Learn lamps from a few objects, each in the light of training and under other lamps.

    Parameters
    ----------
    data : Dataset or iterable of Sample
        Named by object and lamp with a ``-`` between them: ``037-00`` and ``037-07`` show object ``037`` under the
        lamps ``00`` and ``07``. An object may not have moved between its pictures.
    training_lamp : str, optional
        Name of the lamp that is the light of the pictures to train on. It may be left out where each object has but one
        lamp in common with all others.
    response
        Of the camera.
    progress : callable, optional
        Called with (done, total, what) before each picture, and at the end.

    Returns
    -------
    Lamps
        One for each picture in another light.

    Raises
    ------
    TrainingError
        If names do not tell objects and lamps, an object has no picture in the light of training, or has moved.
    """
    objects = _by_object(data)
    training_lamp = _training_lamp(objects, training_lamp)
    bases = {name: _base(name, pictures, training_lamp) for name, pictures in objects.items()}
    mean = unit_shape(procrustes_mean(np.array([base.points for base in bases.values()])))
    fields, names, total = [], [], sum(map(len, objects.values())) - len(objects)
    for name, pictures in objects.items():
        base = bases[name]
        before = as_srgb(as_colour(base.read(), base.name), response)
        for picture in pictures:
            if picture is base:
                continue
            if progress:
                progress(len(fields), total, picture.name)
            after = as_srgb(as_colour(picture.read(), picture.name), response)
            fields.append(_field(before, after, base, picture, mean))
            names.append(picture.name)
    if progress:
        progress(total, total, "learnt")
    return Lamps(mean, np.array(fields), tuple(names))


def unit_shape(mean: np.ndarray) -> np.ndarray:
    """A shape with the middle of its box at the origin and a diagonal of 1."""
    low, high = mean.min(axis=0), mean.max(axis=0)
    return (mean - 0.5 * (low + high)) / diagonal_of(mean)


def _by_object(data: Iterable) -> dict[str, list[_Picture]]:
    objects: dict[str, list[_Picture]] = {}
    for sample in data:
        if not hasattr(sample, "landmarks"):
            raise TrainingError("lamps are learnt from named pictures; for a folder give liaam.load_folder(folder)")
        name, _, lamp = sample.name.rpartition("-")
        if not name:
            raise TrainingError(
                f"{sample.name}: name the pictures to learn lamps from by object and lamp, such as 037-00 and 037-07"
            )
        points = np.asarray(sample.landmarks.points, np.float64)
        if not np.isfinite(points).all():
            raise TrainingError(f"{sample.name}: landmarks are missing (NaN); place them or leave this picture out")
        objects.setdefault(name, []).append(_Picture(sample.name, lamp, sample.read_image, points))
    if not objects:
        raise TrainingError("there are no pictures to learn lamps from")
    counts = {len(picture.points) for pictures in objects.values() for picture in pictures}
    if len(counts) > 1:
        raise TrainingError(
            f"the pictures to learn lamps from have {min(counts)} to {max(counts)} landmarks; make all alike"
        )
    return objects


def _training_lamp(objects: dict[str, list[_Picture]], asked: str | None) -> str:
    """Name of the lamp of training: the one that is asked for, or the only one that every object has."""
    counts = Counter(lamp for pictures in objects.values() for lamp in {picture.lamp for picture in pictures})
    if asked is not None:
        if asked not in counts:
            raise TrainingError(f"no picture is named after the lamp {asked!r}; there are {', '.join(sorted(counts))}")
        return asked
    common = [lamp for lamp, count in counts.items() if count == len(objects)]
    if len(common) != 1:
        raise TrainingError(
            f"which lamp is the light of training? Say so (--training-lamp, or training_lamp=...); there are "
            f"{', '.join(sorted(counts))}"
        )
    return common[0]


def _base(name: str, pictures: list[_Picture], training_lamp: str) -> _Picture:
    """The picture of an object in the light of training, checked against its others."""
    base = next((picture for picture in pictures if picture.lamp == training_lamp), None)
    if base is None:
        raise TrainingError(
            f"object {name} has no picture under lamp {training_lamp}, the light of training; add one, or leave it out"
        )
    if len(pictures) == 1:
        raise TrainingError(f"object {name} has a picture under lamp {training_lamp} only; add some under other lamps")
    for picture in pictures:
        moved = point_error(picture.points, base.points) / diagonal_of(base.points)
        if moved > MOVED:
            raise TrainingError(
                f"{picture.name}: its landmarks lie {moved:.0%} of the object's size from those of {base.name}; lamps "
                "are learnt from objects that have not moved"
            )
    return base


def _field(before: np.ndarray, after: np.ndarray, base: _Picture, picture: _Picture, mean: np.ndarray) -> np.ndarray:
    """What a lamp does to values, carried to the mean shape, (SIDE, SIDE, 3) float16."""
    import cv2  # heavy: imported when first needed
    from scipy.interpolate import LinearNDInterpolator

    if before.shape != after.shape:
        raise TrainingError(f"{picture.name} and {base.name} differ in size; lamps are learnt from pictures that match")
    ratio = np.log((after + np.float32(DARK)) / (before + np.float32(DARK)))
    blur = BLUR * diagonal_of(base.points)
    if blur > 0.2:
        ratio = cv2.GaussianBlur(ratio, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
    carry = LinearNDInterpolator(*anchors(mean, base.points))
    x, y = np.moveaxis(carry(square()).astype(np.float32), -1, 0)
    field = cv2.remap(ratio, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.nan_to_num(field).astype(np.float16)
