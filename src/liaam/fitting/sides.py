"""Fits to objects of two sides, by a model of one: of the image as it is, and of the image reversed left to right.

What is reflected is image and start; the fit is then that of any image, and its result is reflected back.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from liaam.errors import LandmarkError, MethodError
from liaam.fitting.detection import Detection, are_beside, choose
from liaam.fitting.result import FitResult, explained_fraction
from liaam.model import AAM
from liaam.model.mesh import signed_areas
from liaam.model.shape import Similarity, align, corners_of, diagonal_of
from liaam.model.sides import ORIGINAL, Sides, reflected_covariances, reflected_image, reflected_points

AUTO = "auto"
BOTH = "both"

# Least quality of a fit, and least ratio of the score of its detection to that of the other side, at which the other
# side is not looked at further, which takes ten times as long. Of 156 wings and shells, the first fit of the wrong side
# had such a quality once, with the lower score.
SURE = 0.9
BETTER_FOUND = 1.1

SAME = 1e-3  # Largest distance of a landmark from the mean shape, as a fraction of the diagonal, to be that shape
AS_IT_IS = (False,)
EITHER = (False, True)
"""Whether to reflect the image, in the order in which fits are tried."""


def sides_of(model: AAM, side: str) -> Sides | None:
    """Return the sides that fits may have; None if the model knows of one only, and no other was asked for."""
    if side != AUTO and model.sides is None:
        return Sides(ORIGINAL)
    return model.sides


def reflections_of(model: AAM, side: str) -> tuple[bool, ...]:
    """Return whether to fit an image as it is, reflected, or both.

    ``side`` is :attr:`liaam.fitting.Fitter.side`. Raises a MethodError if the model has no such side.
    """
    sides = sides_of(model, side)
    if sides is None:
        return AS_IT_IS
    if side in (AUTO, BOTH):
        return EITHER
    if side not in (sides.own, sides.other):
        choices = ", ".join((AUTO, BOTH, sides.own, sides.other))
        unstated = ""
        if sides.own == ORIGINAL:
            unstated = f" (nothing told training which side is left: {ORIGINAL} is that of most training images)"
        raise MethodError(f"unknown side {side!r}; choose from {choices}{unstated}")
    return (side == sides.other,)


def reflections_of_start(model: AAM, init, width: int) -> tuple[bool, ...]:
    """Return which of both reflections a start may have: one if it is a detection or a whole shape, or else both."""
    if isinstance(init, Detection):
        return (init.reflected,)
    points = _whole_shape(model, init)
    if points is None or is_mean_shape(model, points):
        return EITHER
    shapes = (points, reflected_points(points, width))
    as_it_is, reversed_ = (max(part.shape_model.log_density(shape) for part in model.parts) for shape in shapes)
    return (bool(reversed_ > as_it_is),)


def _whole_shape(model: AAM, init) -> np.ndarray | None:
    """Return a start that is a whole shape, (n, 2) in the order of the model's landmarks; None if it is none."""
    try:
        points = np.asarray(getattr(init, "in_order_of", lambda _: init)(model.landmark_names), dtype=np.float64)
    except (TypeError, ValueError, LandmarkError):  # which is refused elsewhere
        return None
    if points.shape != (model.n_points, 2) or not np.isfinite(points).all():
        return None
    return points


def is_mean_shape(model: AAM, points: np.ndarray) -> bool:
    """Return whether points (n, 2) are the mean shape at some place, whatever the side of the object."""
    means = [align(part.shape_model.mean, points)(part.shape_model.mean) for part in model.parts]
    return any(np.abs(mean - points).max() <= SAME * diagonal_of(points) for mean in means)


def reflected_start(model: AAM, init, width: int):
    """Return a start in an image of a width once that is reversed left to right; see :meth:`Fitter.fit`."""
    if init is None:
        return None
    if isinstance(init, Detection):
        return reflected_detection(init, width)
    try:
        given = np.asarray(getattr(init, "points", init), dtype=np.float64)
    except (TypeError, ValueError):
        return init
    if given.shape == (4,):
        left, top, right, bottom = given.tolist()
        return np.array([width - 1.0 - right, top, width - 1.0 - left, bottom])
    if given.shape == (3,):
        return np.array([width - 1.0 - given[0], given[1], given[2]])
    shape = _whole_shape(model, init)
    if shape is not None and is_mean_shape(model, shape):
        low, high = corners_of(reflected_points(shape, width))
        return np.array([*(0.5 * (low + high)), diagonal_of(shape)])  # its mirror image is not the mean shape
    if given.ndim != 2 or given.shape[1] != 2:
        return init
    points = reflected_points(given, width)
    return replace(init, points=points) if hasattr(init, "points") else points


def reflected_detection(detection: Detection, width: int) -> Detection:
    """Return a detection in an image of a width once that is reversed left to right."""
    return replace(
        detection,
        landmarks=reflected_points(detection.landmarks, width),
        rotation=-detection.rotation,
        others=tuple(reflected_detection(other, width) for other in detection.others),
        reflected=not detection.reflected,
    )


def reflected_result(result: FitResult, width: int) -> FitResult:
    """Return a fit in an image of a width once that is reversed left to right: of a reflected one, as it was made."""
    reversal = np.diag([-1.0, 1.0])
    pose = result.pose
    return replace(
        result,
        landmarks=reflected_points(result.landmarks, width),
        pose=Similarity(reversal @ pose.matrix, reflected_points(pose.offset, width)),
        history=tuple(replace(step, landmarks=reflected_points(step.landmarks, width)) for step in result.history),
        landmark_covariances=reflected_covariances(result.landmark_covariances),
        shift=None if result.shift is None else result.shift * [-1.0, 1.0],
        found=None if result.found is None else reflected_detection(result.found, width),
        reflected=not result.reflected,
    )


def as_fitted(image: np.ndarray, result: FitResult) -> tuple[np.ndarray, FitResult]:
    """Return an image and its fit as the fit was made: both reversed left to right if the object was reflected."""
    if not result.reflected:
        return image, result
    return reflected_image(image), reflected_result(result, image.shape[1])


def is_clear(result: FitResult, other: FitResult) -> bool:
    """Return whether a fit is so good, beside the first fit of the other side, that this need not be completed."""
    if not (result.status.ok and result.quality >= SURE):
        return False
    if result.found is None or other.found is None:
        return explained_fraction(other) <= 0.0
    return result.found.score >= BETTER_FOUND * other.found.score


def likelier_side(first: FitResult, second: FitResult, model: AAM) -> FitResult:
    """Return the likelier of two fits of different sides to an image: that which explains more of its contrast."""
    return max(first, second, key=lambda fit: (fit.status.ok, explained_contrast(fit, model)))


def explained_contrast(result: FitResult, model: AAM) -> float:
    """Return the contrast that a fit explains, summed over the area where it is present; -inf if it is lost.

    Fits of one side are compared by the fraction that they explain. A fit of the wrong side may find a small part of
    the object, or of what is left without absent landmarks, that it explains better.
    """
    fraction = explained_fraction(result)
    if not np.isfinite(fraction):
        return -np.inf
    share = 1.0 if result.present is None else float(result.present.mean())
    area = float(np.abs(signed_areas(result.landmarks, model.parts[result.part].triangles)).sum())
    return fraction * share * area


def with_detections(result: FitResult, detections: Sequence[Detection]) -> FitResult:
    """Return a result that was searched for, with further objects of the other side.

    ``detections`` are those of the other side from which fits are right: a place that only looks like an object, such
    as a ruler, may score as one.
    """
    if result.found is None:
        return result
    certain = [each for each in detections if not each.doubtful and are_beside(each.landmarks, result.landmarks)]
    others = [*result.found.others, *certain, *(other for each in certain for other in each.others)]
    beside = choose([result.found, *others], are_beside)[1:]
    return replace(result, found=replace(result.found, others=tuple(beside)))


def find_on_sides(
    image: np.ndarray, search: Callable[[np.ndarray], list[Detection]], reflections: Sequence[bool], limit: int | None
) -> list[Detection]:
    """Search an image as it is, reversed left to right, or both; return the detections, the best first."""
    if reflections == AS_IT_IS:
        return search(image)
    found: list[Detection] = []
    for is_reflected in reflections:
        if is_reflected:
            found += [reflected_detection(each, image.shape[1]) for each in search(reflected_image(image))]
        else:
            found += search(image)
    return sorted(found, key=lambda each: each.score, reverse=True)[:limit]


def one_at_each_place(fits: Sequence[FitResult], model: AAM) -> list[FitResult]:
    """Return fits, of any side, without those that lie on one which explains more: they are of parts of its object."""

    def worth(fit: FitResult) -> tuple[bool, float]:
        return fit.status.ok, explained_contrast(fit, model)

    kept: list[FitResult] = []
    for fit in sorted(fits, key=worth, reverse=True):
        if all(are_beside(fit.place, other.place) for other in kept):
            kept.append(fit)
    return kept
