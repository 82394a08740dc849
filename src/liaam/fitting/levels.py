"""Coarse-to-fine fitting: each level starts from the solution of the one before."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from liaam.fitting.angles import best_image_angle
from liaam.fitting.methods import Method
from liaam.fitting.objective import Objective, State
from liaam.fitting.problem import MARGIN, NEAR, FitProblem, noise_around
from liaam.fitting.result import Iteration
from liaam.fitting.solver import Solution, SolverOptions, solve
from liaam.model.sampling import Light
from liaam.model.shape import Similarity, align, diagonal_of
from liaam.photometry import NoiseModel, Response

SCALE_LIMITS = (1 / 3, 3.0)
"""Limits on the change of size from the start; beyond them a fit has diverged."""

COARSE, COARSE_RELATIVE = 10.0, 5.0
"""Factors on ``tolerance`` and ``relative_tolerance`` at all levels but the finest. With 10 for the second, 4 % of the
fits from distant starts are lost instead of 1 %."""


@dataclass(frozen=True, eq=False)
class Stage:
    """Solution of one level, with the similarity from model pixels to image pixels that it refers to."""

    objective: Objective
    problem: FitProblem
    pose: Similarity
    solution: Solution

    def release(self) -> None:
        """Let other fits use the arrays of the solution, which is then no longer valid."""
        self.objective.release(self.solution.work, self.solution.given)

    @property
    def path(self) -> list[tuple[float, np.ndarray, float]]:
        """Cost, shape (n, 2) and theta_2 at the start and after every accepted step."""
        solution = self.solution
        shapes = self.pose(self.objective.warp.shape(solution.path))
        return list(zip(solution.costs.tolist(), shapes, solution.angles[:, 1].tolist(), strict=True))

    @property
    def reached(self) -> np.ndarray:
        """Shape of the solution, (n, 2) float64, image pixels."""
        return self.pose(self.objective.warp.shape(self.solution.state.p))


class Target(NamedTuple):
    """An image to fit, its start and its camera's properties, the same for all levels."""

    image: np.ndarray
    """(h, w, 3) uint8, uint16 or float32, corrected for vignetting."""
    start: np.ndarray
    """(n, 2) float: initial positions of the landmarks (of a homography, the corners), image pixels."""
    response: Response
    """Response of the image's camera."""
    noise: NoiseModel | float | None = None
    """Noise of the image's camera."""
    theta: float | None = None
    """Angle of the image's camera if the method does not estimate it, radians; by default the model's."""
    margin: float = MARGIN
    """Margin around the start that the fit may use, as a fraction of the object's diagonal."""
    light: Light | None = None
    """The image averaged around the start for all levels; by default each level averages for itself."""
    pull: np.ndarray | None = None
    """(n_p, n_p) float64: precision of the parameters of ``mapped``; None if there is no such prior."""
    mapped: np.ndarray | None = None
    """(n, 2) float64: landmarks mapped from another landmarker's points, weighed in as a Gaussian prior."""

    def measured(self, method: Method) -> "Target":
        """Return a target with the noise measured in the image, if the method needs it and it is unknown."""
        if self.noise is not None or not method.weighs_noise:
            return self
        return self._replace(noise=noise_around(self.image, self.start))

    def averaged(self, levels: Sequence[tuple[Objective, float]]) -> "Target":
        """Return a target with the image averaged once for all levels (objectives with their blurs)."""
        objective, blurs = levels[0][0], [blur for _, blur in levels]
        pose, encoding = align(objective.warp.rest, self.start), objective.method.encoding
        light = Light.around(
            self.image, self.start, pose, encoding=encoding, response=self.response, blurs=blurs, margin=self.margin
        )
        return self._replace(light=light)


def solve_levels(levels: Sequence[tuple[Objective, float]], target: Target, options: SolverOptions) -> list[Stage]:
    """Solve the levels from coarse to fine, each from the solution of the one before.

    Parameters
    ----------
    levels : sequence of (Objective, float)
        Objective and blur of the image in model pixels, coarse to fine.
    target : Target
    options : SolverOptions

    Returns
    -------
    list of Stage
        One per level; fewer if the fit diverged.
    """
    target, stages = target.measured(levels[0][0].method).averaged(levels), []
    for objective, blur in levels:
        last = objective is levels[-1][0]
        own = options if last else spare(options)
        problem, state, pose = prepare_level(objective, blur, target, stages, own)
        stages.append(Stage(objective, problem, pose, solve(objective, problem, state, own, evaluate_last=last)))
        if not is_sane(stages[-1].reached, target.start):
            break
    return stages


def prepare_level(
    objective: Objective, blur: float, target: Target, stages: Sequence[Stage], options: SolverOptions
) -> tuple[FitProblem, State, Similarity]:
    """Return the problem, the initial state and the pose of a level, given the stages before it.

    The pose is updated at each level because shape modes rotate and scale with it, and the patch is cut around the
    current shape.
    """
    shape, margin = (stages[-1].reached, NEAR) if stages else (target.start, target.margin)
    warp = objective.warp
    pose = align(warp.rest, shape)
    image = target.image if target.light is None else target.light
    problem = FitProblem.at(image, shape, pose, objective.method, target.response, blur, target.noise, margin)
    if target.pull is not None and target.mapped is not None:
        problem = replace(problem, pull=target.pull, towards=warp.parameters(pose.inverse()(target.mapped)))
    state = objective.start(warp.parameters(pose.inverse()(shape)))
    angles = (
        stages[-1].solution.state.angles if stages else _first_angles(objective, problem, state, options, target.theta)
    )
    return problem, state._replace(angles=np.array(angles, np.float64)), pose


@lru_cache(maxsize=16)
def spare(options: SolverOptions) -> SolverOptions:
    """Return looser options for a coarse level, whose solution only starts the next."""
    scoring = None if options.scoring is None else 0
    tolerance, relative_tolerance = COARSE * options.tolerance, COARSE_RELATIVE * options.relative_tolerance
    return replace(options, tolerance=tolerance, relative_tolerance=relative_tolerance, scoring=scoring)


def _first_angles(
    objective: Objective, problem: FitProblem, state: State, options: SolverOptions, theta: float | None
) -> np.ndarray:
    if theta is not None and objective.method.free_angles == "none":
        return np.array([state.angles[0], theta])
    if objective.method.free_angles != "image" or not objective.method.solves_angle or options.angle_start == "model":
        return state.angles
    return np.array([state.angles[0], best_image_angle(objective, problem, state)])


def trace(stages: Sequence[Stage]) -> tuple[Iteration, ...]:
    """Return the start and every accepted state of all levels."""
    return tuple(
        Iteration(cost, shape, theta if stage.objective.method.has_angles else np.nan, level)
        for level, stage in enumerate(stages)
        for cost, shape, theta in stage.path
    )


def is_sane(shape: np.ndarray, start: np.ndarray) -> bool:
    """Return whether a shape is finite and its size within :data:`SCALE_LIMITS` of the start's."""
    return (
        bool(np.isfinite(shape).all()) and SCALE_LIMITS[0] < diagonal_of(shape) / diagonal_of(start) < SCALE_LIMITS[1]
    )
