"""A result evaluated at all pixels of the sharpest level."""

from typing import Any

import numpy as np

from liaam.fitting.angles import best_image_angle
from liaam.fitting.fitter import Fitter
from liaam.fitting.level_image import MARGIN, LevelImage
from liaam.fitting.objective import Objective, State
from liaam.fitting.picture import load_picture
from liaam.fitting.result import FitResult


def solution_at(fitter: Fitter, image, result: FitResult) -> dict[str, Any]:
    """Evaluate a result at all pixels of the sharpest level, with the best lambda there.

    Parameters
    ----------
    fitter : Fitter
    image : (h, w, 3) array or path
        The fitted image.
    result : FitResult
        Result of this or another method.

    Returns
    -------
    dict
        Arrays of :meth:`liaam.fitting.reference.Problem.arrays` at the shape and angles of ``result``.
    """
    if fitter.model.others:
        return solution_at(fitter.part_for(result), image, result)
    objective, encoded, state = _end_of(fitter, result, image)
    method = objective.method
    if method.free_angles == "image" and not np.isfinite(result.theta):
        state = state._replace(angles=np.array([state.angles[0], best_image_angle(objective, encoded, state)]))
    weigh = 0 if not method.reweighs else 1 if method.loss == "squares" else 3
    return objective.evaluate(encoded, state, weigh=weigh, solves=True)


def residual_at(fitter: Fitter, image, result: FitResult) -> tuple[np.ndarray, np.ndarray]:
    """Compute the residual (paper eq 10) in the method's encoding, at all pixels of the sharpest level.

    Parameters
    ----------
    fitter : Fitter
    image : (h, w, 3) array or path
        The fitted image.
    result : FitResult
        Result of this fitter.

    Returns
    -------
    residual : (n_pixels, k) float32
        Image minus model, in the raster order of the frame of ``fitter.view``; 0 at unusable pixels. Of a model of
        several shapes, :meth:`Fitter.part_for` gives the fitter with that view.
    usable : (n_pixels,) float32
        1 at usable pixels, else 0.
    """
    if fitter.model.others:
        return residual_at(fitter.part_for(result), image, result)
    kept, k = fitter.view.warp.every(0.0), fitter.objectives[0].method.n_rows
    residual, usable = np.zeros((len(kept), k), np.float32), np.zeros(len(kept), np.float32)
    if np.isfinite(result.landmarks).all():
        objective, encoded, state = _end_of(fitter, result, image)
        if len(result.lam) == objective.n_lambda:  # else the fit did not reach the sharpest level
            state = state._replace(lam=result.lam)
        seen = objective.evaluate(encoded, state, weigh=int(objective.method.normalise))
        usable[kept] = seen["usable"]
        residual[kept] = np.where(seen["usable"][:, None] > 0, seen["residual"].reshape(-1, k), 0.0)
    return residual, usable


def _end_of(fitter: Fitter, result: FitResult, image) -> tuple[Objective, LevelImage, State]:
    """Return the objective over all pixels of the sharpest level, its image, and a result's state (lambda 0)."""
    linear, objective = fitter.linear(load_picture(image, "image")[0]), fitter.dense
    blur, noise = fitter.view.levels[-1].blur, fitter.image_camera.noise
    about = objective.method, linear.response, blur, noise, MARGIN, objective.density
    encoded = LevelImage.at(linear.image, result.landmarks, result.pose, *about)
    # From the shape, because p refers to the shape model of the fit's method, which may be another one.
    state = objective.start(fitter.shapes.parameters(result.pose.inverse()(result.landmarks)))
    if objective.method.has_angles and np.isfinite(result.theta):
        state = state._replace(angles=np.array([result.theta_model, result.theta]))
    return objective, encoded, state
