"""Check the training images before any work: landmarks outside the image, exposure, and grey among colour images."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
# Least number of colour images to learn colours from, which is that of images at all (liaam.training.entries.FEWEST)
LEAST_COLOUR = 3


@dataclass(frozen=True)
class _Inspection:
    """What was seen in an image: whether it is grey, and a message for each kind of fault, empty if there is none."""

    is_grey: bool = False
    damage: str = ""
    outside: str = ""  # landmarks outside the image, too many or too far
    outside_of: tuple[int, int] = (0, 0)  # how many landmarks are outside, and how many are known
    exposure: str = ""


def grey_use(grey: Sequence[str], colour: Sequence[str]) -> str:
    """Describe what training does with images of which some are grey, from the names of both."""
    n_images = len(grey) + len(colour)
    if len(colour) < LEAST_COLOUR:
        return (
            f"only {len(colour)} of {n_images} images {_is_or_are(colour)} in colour ({', '.join(colour)}); all are "
            "used as grey"
        )
    return (
        f"{len(grey)} of {n_images} images {_is_or_are(grey)} grey ({some_names(grey, 20)}): soft-li learns from their "
        "brightness, the other methods leave them out"
    )


def _is_or_are(names: Sequence[str]) -> str:
    """Return the verb for a list of names."""
    return "is" if len(names) == 1 else "are"


def check_images(
    entries: Sequence[Entry], warp: PiecewiseAffineWarp, response: Response
) -> tuple[list[Entry], np.ndarray]:
    """Read and check all images, and return them with whether each is grey, (n,) bool.

    If too few are in colour, all are converted to grey; there is a warning if only some are grey, and one if landmarks
    are outside of their images. Raises an ImageError if images cannot be read, and a TrainingError if objects, which
    the warp's mesh covers, are outside their images, black or saturated. The messages name all these images.
    """
    inspections = in_threads(partial(_inspect, warp, response), entries)
    _refuse_faults(inspections)
    counts = {entry.name: each.outside_of for entry, each in zip(entries, inspections, strict=True)}
    if cut_off := describe_cut_off(counts):
        warnings.warn(cut_off, stacklevel=5)  # the caller of train, which is decorated
    grey = np.array([inspection.is_grey for inspection in inspections])
    if not grey.any() or grey.all():
        return list(entries), grey
    grey_names = [entry.name for entry, inspection in zip(entries, inspections, strict=True) if inspection.is_grey]
    colour_names = [
        entry.name for entry, inspection in zip(entries, inspections, strict=True) if not inspection.is_grey
    ]
    warnings.warn(grey_use(grey_names, colour_names), stacklevel=5)  # the caller of train, which is decorated
    if len(colour_names) < LEAST_COLOUR:
        converted = [replace(entry, read_image=partial(_read_grey, entry)) for entry in entries]
        return converted, np.ones(len(entries), bool)
    return list(entries), grey


def _inspect(warp: PiecewiseAffineWarp, response: Response, entry: Entry) -> _Inspection:
    """Read an image, and look for faults; a damaged one has no others."""
    try:
        image = as_colour(entry.read_image(), entry.name)
        refuse_unscaled(image, entry.name, response)
    except ImageError as fault:
        return _Inspection(damage=str(fault))
    pixels = _known_pixels(entry, warp)
    outside = describe_outside(entry.points, image.shape, pixels, entry.known)
    exposure = _describe_exposure(image, pixels, response)
    return _Inspection(
        is_grey=is_grey(image),
        outside=f"{entry.name}: {outside}" if outside else "",
        outside_of=count_outside(entry.points, image.shape, entry.known),
        exposure=f"{entry.name}: {exposure}" if exposure else "",
    )


def _known_pixels(entry: Entry, warp: PiecewiseAffineWarp) -> np.ndarray:
    """Positions of the mesh's pixels that known landmarks place, (k, 2); of these landmarks if there are none."""
    pixels = warp.interpolate(entry.points)
    if entry.known is None:
        return pixels
    pixels = pixels[warp.are_known(entry.known)]
    return pixels if len(pixels) else entry.points[entry.known]


def _refuse_faults(inspections: Sequence[_Inspection]) -> None:
    """Raise an error that lists all images with faults of one kind, the most basic first."""
    damaged = [each.damage for each in inspections if each.damage]
    if damaged:
        raise ImageError(some_names(damaged, joint="; "))
    outside = [each.outside for each in inspections if each.outside]
    if outside:
        raise TrainingError(
            f"{some_names(outside, joint='; ')}. Check that these landmarks belong to their images, and to images of "
            "this size; correct or remove them"
        )
    exposure = [each.exposure for each in inspections if each.exposure]
    if exposure:
        raise TrainingError(f"{some_names(exposure, joint='; ')}. Remove these images or correct their exposure")


def _read_grey(entry: Entry) -> np.ndarray:
    """Read an image as three equal channels."""
    import cv2  # heavy: imported when first needed

    image = as_colour(entry.read_image(), entry.name)
    return cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)


def _describe_exposure(image: np.ndarray, points: np.ndarray, response: Response) -> str:
    """Describe an object that is black or saturated at almost all points (k, 2) of its mesh. Empty otherwise."""
    last = np.array(image.shape[1::-1]) - 1  # points outside the image count as the nearest pixel
    x, y = np.clip(np.rint(points).astype(int), 0, last).T
    dark, clipped = exposure_faults(image[y, x], response)
    usable = max(0.0, 1.0 - dark - clipped)
    if usable >= LEAST_USABLE:
        return ""
    fault = "black" if dark >= clipped else "saturated"
    return f"the object is almost completely {fault} ({usable:.0%} of its pixels are usable)"


def describe_outside(
    landmarks: np.ndarray,
    shape: tuple[int, ...],
    points: np.ndarray | None = None,
    known: np.ndarray | None = None,
) -> str:
    """Describe how far landmarks (n, 2) lie outside an image of a shape (h, w, ...). Empty if that is no fault.

    Most of the points (k, 2), pixels of the mesh, must lie inside; by default the landmarks, which is less strict.
    Estimated landmarks, which are not ``known`` (n,), may lie anywhere.
    """
    known = _placed(landmarks) if known is None else known
    points = landmarks[known] if points is None else points
    height, width = shape[:2]
    distances = _distances_outside(landmarks, shape, known)
    inside = float((_distances_outside(points, shape) < 0).mean())
    if inside >= LEAST_INSIDE and distances.max() <= FAR * diagonal_of(landmarks[_placed(landmarks)]):
        return ""
    n_outside, n_known = count_outside(landmarks, shape, known)
    farthest = int(distances.argmax())
    return (
        f"{n_outside} of {n_known} landmarks lie outside the image of {width}×{height} pixels (point "
        f"{farthest + 1} by {distances[farthest]:.0f} pixels)"
    )


def _placed(landmarks: np.ndarray) -> np.ndarray:
    """Return which landmarks (n, 2) have a place, (n,) bool; those that are missing are NaN."""
    return np.asarray(np.isfinite(landmarks).all(axis=1))


def _distances_outside(points: np.ndarray, shape: tuple[int, ...], known: np.ndarray | None = None) -> np.ndarray:
    """Return how far points (n, 2) lie outside an image, pixels; negative inside, and -inf for those not known."""
    height, width = shape[:2]
    # The borders of the first and of the last pixel, whose centres are 0 and the number of pixels less 1.
    first = -0.5
    last = np.array([width, height]) - 0.5
    distances = np.maximum(first - points, points - last).max(axis=1)
    return distances if known is None else np.where(known, distances, -np.inf)


def count_outside(landmarks: np.ndarray, shape: tuple[int, ...], known: np.ndarray | None = None) -> tuple[int, int]:
    """Return how many of the known landmarks (n, 2) lie outside an image, and how many are known."""
    known = _placed(landmarks) if known is None else known
    return int((_distances_outside(landmarks, shape, known) > 0).sum()), int(known.sum())


def describe_cut_off(counts: Mapping[str, tuple[int, int]]) -> str:
    """Say which images have some landmarks outside, from the results of :func:`count_outside`; empty if none has."""
    outside = [f"{name} ({n} of {n_known})" for name, (n, n_known) in counts.items() if n]
    if not outside:
        return ""
    have = "image has" if len(outside) == 1 else "images have"
    return (
        f"{len(outside)} {have} landmarks outside of the image: {some_names(outside)}; correct them, unless the object "
        "is cut off there"
    )
