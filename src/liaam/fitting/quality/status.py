"""What became of a fit: its status."""

import numpy as np

from liaam.fitting.loop.levels import FittedLevel, LinearImage, is_sane
from liaam.fitting.result import FitStatus, Iteration
from liaam.model import AAM
from liaam.model.mesh import folded_share
from liaam.model.sampling import within
from liaam.model.shape import ShapeModel, align
from liaam.photometry import exposure_faults

FOLD_LIMIT = 0.3  # fraction of the mesh's area flipped beyond which a fit has diverged
USABLE_LIMIT = 0.25  # fraction of the object's pixels that must be usable
INSIDE_LIMIT = 0.5  # fraction of the object's pixels that must lie in the image, as in training
# Standard deviations of a shape mode beyond which a fit has diverged, plus half a model pixel, since a few training
# images underestimate the variance.
SHAPE_LIMIT = 5.0


def status_of(
    linear: LinearImage, history: tuple[Iteration, ...], stage: FittedLevel, model: AAM, shapes: ShapeModel
) -> FitStatus:
    """Return the status of a fit to an image from its steps and its last level.

    ``shapes`` is the shape model of the fit's method.
    """
    shape = history[-1].landmarks
    solution = stage.solution
    sane = is_sane(shape, history[0].landmarks)
    unseen = _status_of_unseen(linear, history[0].landmarks, stage, sane) if np.isfinite(shape).all() else None
    # Few usable pixels are a better reason than the size that a fit to them happens to reach.
    if unseen is not None:
        return unseen
    if not sane or folded_share(shape, model.triangles) > FOLD_LIMIT or _largest_mode(shape, shapes) > SHAPE_LIMIT:
        return FitStatus.DIVERGED
    if solution.no_texture:
        return FitStatus.NO_TEXTURE
    if not solution.converged:
        return FitStatus.MAX_ITERATIONS
    return FitStatus.LIGHT_UNOBSERVABLE if solution.angle_fixed else FitStatus.CONVERGED


def _status_of_unseen(linear: LinearImage, start: np.ndarray, stage: FittedLevel, sane: bool) -> FitStatus | None:
    """Return the status of a fit of which too few pixels are in the image or usable; None of other fits.

    A fit that is not ``sane`` has not left the image: it has diverged. From a start (n, 2) where the image is dark or
    saturated, a fit may go anywhere: it has not left the image either.
    """
    usable = stage.solution.usable
    if usable.mean() >= INSIDE_LIMIT:  # then most pixels are in the image, and enough of these are usable
        return None
    points = stage.pose(stage.objective.warp.points(stage.solution.p))
    inside = within(points, linear.image)
    if sane and inside.mean() < INSIDE_LIMIT:
        return _why_unusable_at(linear, start) or FitStatus.LEFT_IMAGE
    # Pixels beyond the patch do not count: they are not usable, whatever their exposure.
    on_patch = stage.to_patch(points)
    height, width = stage.patch_size
    inside &= np.asarray(((on_patch >= 0) & (on_patch <= (width - 1, height - 1))).all(axis=1))
    if inside.any() and usable[inside].mean() < USABLE_LIMIT:
        return _why_unusable(linear, points[inside])
    return None


def _why_unusable_at(linear: LinearImage, landmarks: np.ndarray) -> FitStatus | None:
    """Return whether the image is dark or saturated at most landmarks (n, 2) that lie in it; None if it is neither."""
    points = landmarks[within(landmarks, linear.image)]
    if not len(points):
        return None
    dark, clipped = exposure_faults(_pixels_at(linear, points), linear.response)
    return _why_unusable(linear, points) if dark + clipped > 1.0 - USABLE_LIMIT else None


def _largest_mode(shape: np.ndarray, shape_model: ShapeModel) -> float:
    """Return the largest shape mode in standard deviations, after alignment to the mean shape."""
    upright = align(shape, shape_model.mean)(shape)
    # Modes are orthonormal over all landmarks: half a pixel at each is sqrt(n) / 2.
    allowed = np.sqrt(shape_model.eigenvalues) + 0.5 * np.sqrt(shape_model.n_points) / SHAPE_LIMIT
    return float((np.abs(shape_model.parameters(upright)[:-4]) / allowed).max(initial=0.0))


def _why_unusable(linear: LinearImage, points: np.ndarray) -> FitStatus:
    """Return whether most unusable pixels are without values, dark or saturated."""
    pixels = _pixels_at(linear, points)
    valid = np.isfinite(pixels).all(axis=1)
    if not valid.any():
        return FitStatus.NO_TEXTURE
    dark, clipped = exposure_faults(pixels[valid], linear.response)  # fractions of the valid pixels
    share_valid = valid.mean()
    if 1.0 - share_valid >= max(dark, clipped) * share_valid:
        return FitStatus.NO_TEXTURE
    return FitStatus.TOO_DARK if dark >= clipped else FitStatus.SATURATED


def _pixels_at(linear: LinearImage, points: np.ndarray) -> np.ndarray:
    """Return the pixels of an image nearest to points (n, 2) in it, (n, 3)."""
    x, y = np.rint(points).astype(int).T
    return linear.image[y, x]
