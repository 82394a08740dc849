"""Helpers shared by tests: scenes between scenes, disturbed starts, errors in model pixels, fit problems."""

from dataclasses import fields

import numpy as np

from liaam.fitting import get_method
from liaam.fitting.objective import FitProblem, Objective, make_objectives
from liaam.model import AAM
from liaam.shape import align, diagonal_of


def between(a, b):
    """Pose or expression half-way between two: inside the span of a training set that holds both."""
    return type(a)(**{f.name: 0.5 * (getattr(a, f.name) + getattr(b, f.name)) for f in fields(a)})


def disturb(shape: np.ndarray, scale: float = 1.03, shift: tuple[float, float] = (0.02, -0.015)) -> np.ndarray:
    """Scale a shape about its centre, and shift it by a share of its diagonal."""
    centre = shape.mean(axis=0)
    return (shape - centre) * scale + centre + np.array(shift) * diagonal_of(shape)


def model_pixels(model: AAM, shape: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance of landmarks from the truth, in pixels of the model's reference frame."""
    scale = align(model.shape_model.mean, truth).scale
    return float(np.linalg.norm(shape - truth, axis=1).mean()) / scale


def make_problem(
    model: AAM, image: np.ndarray, start: np.ndarray, objective: Objective, blur: float = 0.5
) -> tuple[FitProblem, np.ndarray]:
    """One image ready for an objective, and the warp parameters of the start."""
    pose = align(model.shape_model.mean, start)
    problem = FitProblem.at(image, start, pose, objective.method, model.response, blur)
    return problem, model.shape_model.parameters(pose.inverse()(start))


def finest_objective(model: AAM, method, kernel: str = "fast") -> Objective:
    """Objective of a method at the model's sharpest level."""
    return make_objectives(model, get_method(method), kernel)[-1]
