"""A result evaluated at all pixels of the sharpest level."""

from typing import Any

import numpy as np

from liaam.fitting.fitter import Fitter
from liaam.fitting.loop.angles import best_image_angle
from liaam.fitting.loop.encoded_image import MARGIN, EncodedImage
from liaam.fitting.loop.objective import Objective, State
from liaam.fitting.result import FitResult
from liaam.fitting.sides import as_fitted
from liaam.fitting.thresholds import THRESHOLDS
from liaam.photometry.picture import load_picture


def solution_at(fitter: Fitter, image, result: FitResult) -> dict[str, Any]:
    """Evaluate a result, of this or another method, at all pixels of the sharpest level, with the best lambda there.

    The result are the arrays of :meth:`liaam.fitting.reference.problem.Problem.arrays` at its shape and angles.
    """
    if fitter.model.others:
        return solution_at(fitter.part_for(result), image, result)
    objective, encoded, state = _end_of(fitter, result, image)
    method = objective.method
    if method.free_angles == "image" and not np.isfinite(result.theta):
        state = state._replace(angles=np.array([state.angles[0], best_image_angle(objective, encoded, state)]))
    if not method.reweighs:
        n_updates = 0
    elif method.loss == "squares":
        n_updates = 1
    else:  # the weights of a robust loss and lambda depend on each other
        n_updates = int(THRESHOLDS["ROUNDS"])
    return objective.evaluate(encoded, state, weigh=n_updates, solves=True)


def residual_at(fitter: Fitter, image, result: FitResult) -> tuple[np.ndarray, np.ndarray]:
    """Compute the residual (paper eq 10) of this fitter's result in the method's encoding, at the sharpest level.

    That is image minus model, (n_pixels, k) float32, in the raster order of the frame of ``fitter.view``; 0 at unusable
    pixels, and which are usable, (n_pixels,) float32. Of a model of several shapes, :meth:`Fitter.part_for` gives the
    fitter with that view.
    """
    if fitter.model.others:
        return residual_at(fitter.part_for(result), image, result)
    pixels = fitter.view.warp.every(0.0)
    k = fitter.objectives[0].method.n_rows
    residual = np.zeros((len(pixels), k), np.float32)
    usable = np.zeros(len(pixels), np.float32)
    if np.isfinite(result.landmarks).all():
        objective, encoded, state = _end_of(fitter, result, image)
        if len(result.lam) == objective.n_lambda:  # else the fit did not reach the sharpest level
            state = state._replace(lam=result.lam)
        seen = objective.evaluate(encoded, state, weigh=int(objective.method.normalise))
        usable[pixels] = seen["usable"]
        residual[pixels] = np.where(seen["usable"][:, None] > 0, seen["residual"].reshape(-1, k), 0.0)
    return residual, usable


def _end_of(fitter: Fitter, result: FitResult, image) -> tuple[Objective, EncodedImage, State]:
    """Return the objective over all pixels of the sharpest level, its image, and a result's state (lambda 0)."""
    picture, result = as_fitted(load_picture(image, "image")[0], result)
    linear = fitter.linear(picture)
    objective = fitter.dense
    encoded = EncodedImage.at(
        linear.image,
        result.registered,
        result.pose,
        method=objective.method,
        response=linear.response,
        blur=fitter.view.levels[-1].blur,
        noise=fitter.image_camera.noise,
        margin=MARGIN,
        density=objective.density,
    )
    # From the shape, because p refers to the shape model of the fit's method, which may be another one.
    state = objective.start(fitter.shapes.parameters(result.pose.inverse()(result.registered)))
    if objective.method.has_angles and np.isfinite(result.theta):
        state = state._replace(angles=np.array([result.theta_model, result.theta]))
    return objective, encoded, state
