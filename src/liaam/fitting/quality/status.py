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
# Standard deviations of a shape mode beyond which a fit has diverged, plus half a model pixel, since a few training
# images underestimate the variance.
SHAPE_LIMIT = 5.0


def status_of(
    linear: LinearImage, history: tuple[Iteration, ...], stage: FittedLevel, model: AAM, shapes: ShapeModel
) -> FitStatus:
    """Return the status of a fit to an image from its steps and its last level.

    ``shapes`` is the shape model of the fit's method.
    """
    shape, objective, solution = history[-1].landmarks, stage.objective, stage.solution
    usable, sane = solution.usable, is_sane(shape, history[0].landmarks)
    # Else most pixels are inside the image, and enough of these usable.
    if not usable.mean() >= 0.5 and np.isfinite(shape).all():
        points = stage.pose(objective.warp.points(solution.p))
        inside = within(points, linear.image)
        if sane and inside.mean() < 0.5:
            return FitStatus.LEFT_IMAGE
        # Few usable pixels are a better reason than the size that a fit to them happens to reach. Pixels beyond the
        # patch do not count: they are not usable, whatever their exposure.
        on_patch, (height, width) = stage.to_patch(points), stage.patch_size
        inside &= np.asarray(((on_patch >= 0) & (on_patch <= (width - 1, height - 1))).all(axis=1))
        if inside.any() and usable[inside].mean() < USABLE_LIMIT:
            return _why_unusable(linear, points[inside])
    if not sane or folded_share(shape, model.triangles) > FOLD_LIMIT or _largest_mode(shape, shapes) > SHAPE_LIMIT:
        return FitStatus.DIVERGED
    if solution.flat:
        return FitStatus.NO_TEXTURE
    if not solution.converged:
        return FitStatus.MAX_ITERATIONS
    return FitStatus.LIGHT_UNOBSERVABLE if solution.held else FitStatus.CONVERGED


def _largest_mode(shape: np.ndarray, shape_model: ShapeModel) -> float:
    """Return the largest shape mode in standard deviations, after alignment to the mean shape."""
    upright = align(shape, shape_model.mean)(shape)
    # Modes are orthonormal over all landmarks: half a pixel at each is sqrt(n) / 2.
    allowed = np.sqrt(shape_model.eigenvalues) + 0.5 * np.sqrt(shape_model.n_points) / SHAPE_LIMIT
    return float((np.abs(shape_model.parameters(upright)[:-4]) / allowed).max(initial=0.0))


def _why_unusable(linear: LinearImage, points: np.ndarray) -> FitStatus:
    """Return whether most unusable pixels are without values, dark or saturated."""
    x, y = np.rint(points).astype(int).T
    pixels = linear.image[y, x]
    valid = np.isfinite(pixels).all(axis=1)
    dark, clipped = exposure_faults(pixels[valid], linear.response) if valid.any() else (0.0, 0.0)
    if 1.0 - valid.mean() >= max(dark, clipped) * valid.mean():
        return FitStatus.NO_TEXTURE
    return FitStatus.TOO_DARK if dark >= clipped else FitStatus.SATURATED
