"""Check the training images before any work: landmarks outside the image, exposure, and grey among colour images."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from liaam.errors import ImageError, TrainingError
from liaam.io.files import some_names
from liaam.model.shape import diagonal_of
from liaam.model.warp import PiecewiseAffineWarp
from liaam.photometry import Response, exposure_faults, is_grey
from liaam.photometry.encoding import as_colour, refuse_unscaled
from liaam.training.entries import Entry
from liaam.workers import in_threads

# Least fraction of the mesh inside the image. Pixels outside have no weight, and their values are estimated from the
# other images; fits stop at the same fraction (FitStatus.LEFT_IMAGE).
LEAST_INSIDE = 0.5
# Largest distance of a landmark from the image, in diagonals of the landmarks' box. Landmarks a little outside are
# usual in photographs that cut an object off, by up to half of it; farther ones are mistakes that distort the shapes.
FAR = 0.35
LEAST_USABLE = 0.2  # Least fraction of the object that is neither black nor saturated
LEAST_COLOUR = 3  # Least number of colour images to learn colours from


def grey_use(grey: Sequence[str], colour: Sequence[str]) -> str:
    """Describe what training does with images of which some are grey, from the names of both."""
    total = len(grey) + len(colour)
    if len(colour) < LEAST_COLOUR:
        few = f"only {len(colour)} of {total} images {_is(colour)} in colour ({', '.join(colour)})"
        return f"{few}; all are used as grey"
    use = "soft-li learns from their brightness, the other methods leave them out"
    return f"{len(grey)} of {total} images {_is(grey)} grey ({some_names(grey, 20)}): {use}"


def _is(names: Sequence[str]) -> str:
    return "is" if len(names) == 1 else "are"


def check_images(
    entries: Sequence[Entry], warp: PiecewiseAffineWarp, response: Response
) -> tuple[list[Entry], np.ndarray]:
    """Read and check all images, and return them with whether each is grey, (n,) bool.

    If too few are in colour, all are converted to grey; there is a warning if only some are grey. Raises an ImageError
    if images cannot be read, and a TrainingError if objects, which the warp's mesh covers, are outside their images,
    black or saturated. The messages name all these images.
    """

    def read_grey(entry: Entry) -> np.ndarray:
        import cv2  # heavy: imported when first needed

        image = as_colour(entry.read_image(), entry.name)
        return cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)

    seen, *faults = zip(*in_threads(partial(_look, warp, response), entries), strict=True)
    damaged, outside, exposure = ([fault for fault in each if fault] for each in faults)
    if damaged:
        raise ImageError(some_names(damaged, joint="; "))
    if outside:
        raise TrainingError(
            f"{some_names(outside, joint='; ')}. Check that these landmarks belong to their images, and to images of "
            "this size; correct or remove them"
        )
    if exposure:
        raise TrainingError(f"{some_names(exposure, joint='; ')}. Remove these images or correct their exposure")
    grey = np.array(seen)
    if not grey.any() or grey.all():
        return list(entries), grey
    names, others = ([entry.name for entry, own in zip(entries, grey, strict=True) if own == g] for g in (True, False))
    warnings.warn(grey_use(names, others), stacklevel=5)  # the caller of train, which is decorated
    if len(others) < LEAST_COLOUR:
        return [replace(entry, read_image=partial(read_grey, entry)) for entry in entries], np.ones(len(entries), bool)
    return list(entries), grey


def _look(warp: PiecewiseAffineWarp, response: Response, entry: Entry) -> tuple[bool, str, str, str]:
    """Whether an image is grey, and its faults (empty if there are none): damage, landmarks outside, and exposure."""
    try:
        image = as_colour(entry.read_image(), entry.name)
        refuse_unscaled(image, entry.name, response)
    except ImageError as fault:
        return False, str(fault), "", ""
    points = warp.interpolate(entry.points)
    outside, exposure = describe_outside(entry.points, image.shape, points), ""
    x, y = np.clip(np.rint(points).astype(int), 0, np.array(image.shape[1::-1]) - 1).T
    dark, clipped = exposure_faults(image[y, x], response)
    usable = max(0.0, 1.0 - dark - clipped)
    if usable < LEAST_USABLE:
        what = f"almost completely {'black' if dark >= clipped else 'saturated'}"
        exposure = f"{entry.name}: the object is {what} ({usable:.0%} of its pixels are usable)"
    return is_grey(image), "", f"{entry.name}: {outside}" if outside else "", exposure


def describe_outside(landmarks: np.ndarray, shape: tuple[int, ...], points: np.ndarray | None = None) -> str:
    """Describe how far landmarks (n, 2) lie outside an image of a shape (h, w, ...). Empty if that is no fault.

    Most of the points (k, 2), pixels of the mesh, must lie inside; by default the landmarks, which is less strict.
    """
    points, inside = landmarks if points is None else points, np.array(shape[1::-1]) - 0.5
    beyond = np.maximum(-0.5 - landmarks, landmarks - inside).max(axis=1)
    covered = float(((points > -0.5) & (points < inside)).all(axis=1).mean())
    if covered >= LEAST_INSIDE and beyond.max() <= FAR * diagonal_of(landmarks):
        return ""
    n, worst = int((beyond > 0).sum()), int(beyond.argmax())
    size = "×".join(f"{side + 0.5:.0f}" for side in inside)
    return (
        f"{n} of {len(landmarks)} landmarks lie outside the image of {size} pixels (point {worst + 1} by "
        f"{beyond[worst]:.0f} pixels)"
    )
