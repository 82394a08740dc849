"""From the coarsest level to the finest: what is fitted, where each level starts, and where it came to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
"""Change of size from the start beyond which a fit has diverged."""

COARSE, COARSE_NOTICE = 10.0, 5.0
"""How much sooner than the finest level the coarser ones may stop: in pixels, and in standard deviations. Measured on
starts far off: at 10 standard deviations 4 % of the fits are lost instead of 1."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One level's solution, with the similarity from model pixels to image pixels it was found in."""

    objective: Objective
    problem: FitProblem
    pose: Similarity
    solution: Solution

    def shape(self, state: State) -> np.ndarray:
        """Shape of a state, (n, 2) float64, image pixels."""
        return self.pose(self.objective.warp.shape(state.p))

    @property
    def path(self) -> list[tuple[float, np.ndarray, float]]:
        """Cost, shape (n, 2) and theta_2 at the start and after every accepted step."""
        solution = self.solution
        states = zip(solution.costs, solution.path, solution.angles[:, 1], strict=True)
        return [(float(cost), self.pose(self.objective.warp.shape(p)), float(theta)) for cost, p, theta in states]

    @property
    def reached(self) -> np.ndarray:
        """Shape of the solution, (n, 2) float64, image pixels."""
        return self.shape(self.solution.state)


class Target(NamedTuple):
    """What is to be fitted: a picture and what is known of it, the same for all levels."""

    image: np.ndarray
    """(h, w, 3) uint8, uint16 or float32, flattened."""
    start: np.ndarray
    """(n, 2) float: where the warp's handles start, image pixels."""
    response: Response
    """Of the image's camera."""
    noise: NoiseModel | float | None = None
    """Of the image's camera."""
    theta: float | None = None
    """Angle of the image's camera where the method does not estimate it, radians; the model's if left out."""
    margin: float = MARGIN
    """Surroundings of the start that the fit may visit, as a share of the object's diagonal."""
    light: Light | None = None
    """The picture, averaged around the start for all levels; each averages for itself, if left out."""

    def measured(self, method: Method) -> "Target":
        """Target whose noise is measured in the image where the method weighs by it and nobody knows it."""
        if self.noise is not None or not method.weighs_noise:
            return self
        return self._replace(noise=noise_around(self.image, self.start))

    def averaged(self, levels: Sequence[tuple[Objective, float]]) -> "Target":
        """Target whose picture is averaged once for all levels (objectives with their blurs)."""
        objective, blurs = levels[0][0], [blur for _, blur in levels]
        pose, encoding = align(objective.warp.rest, self.start), objective.method.encoding
        light = Light.around(
            self.image, self.start, pose, encoding=encoding, response=self.response, blurs=blurs, margin=self.margin
        )
        return self._replace(light=light)


def solve_levels(levels: Sequence[tuple[Objective, float]], target: Target, options: SolverOptions) -> list[Stage]:
    """Solve from the coarsest level to the finest, each from where the one before it stopped.

    Parameters
    ----------
    levels : sequence of (Objective, float)
        What to minimise, and the blur of the image in model pixels; coarse to fine.
    target : Target
    options : SolverOptions

    Returns
    -------
    list of Stage
        Fewer than there are levels where a fit has blown up or collapsed.
    """
    target, stages = target.measured(levels[0][0].method).averaged(levels), []
    for objective, blur in levels:
        last = objective is levels[-1][0]
        own = options if last else spare(options)
        problem, state, pose = prepare_level(objective, blur, target, stages, own)
        stages.append(Stage(objective, problem, pose, solve(objective, problem, state, own, look=last)))
        if not is_sane(stages[-1].reached, target.start):
            break
    return stages


def prepare_level(
    objective: Objective, blur: float, target: Target, stages: Sequence[Stage], options: SolverOptions
) -> tuple[FitProblem, State, Similarity]:
    """Fit problem, first state and pose of a level, after the stages before it (none for the first).

    Anew for each level: shape modes turn and grow with the pose, and the patch with its resolution belongs where the
    object is now, not where the start was.
    """
    shape, margin = (stages[-1].reached, NEAR) if stages else (target.start, target.margin)
    warp = objective.warp
    pose = align(warp.rest, shape)
    image = target.image if target.light is None else target.light
    problem = FitProblem.at(image, shape, pose, objective.method, target.response, blur, target.noise, margin)
    state = objective.start(warp.parameters(pose.inverse()(shape)))
    angles = (
        stages[-1].solution.state.angles if stages else _first_angles(objective, problem, state, options, target.theta)
    )
    return problem, state._replace(angles=np.array(angles, np.float64)), pose


def spare(options: SolverOptions) -> SolverOptions:
    """Options for a coarse level, whose solution is a start for the next."""
    scoring = None if options.scoring is None else 0
    tolerance, notice = COARSE * options.tolerance, COARSE_NOTICE * options.notice
    return replace(options, tolerance=tolerance, notice=notice, scoring=scoring)


def _first_angles(
    objective: Objective, problem: FitProblem, state: State, options: SolverOptions, theta: float | None
) -> np.ndarray:
    if theta is not None and objective.method.free_angles == "none":
        return np.array([state.angles[0], theta])
    if objective.method.free_angles != "image" or not objective.method.solves_angle or options.angle_start == "model":
        return state.angles
    return np.array([state.angles[0], best_image_angle(objective, problem, state)])


def trace(stages: Sequence[Stage]) -> tuple[Iteration, ...]:
    """Every accepted state of all levels, each level's start included."""
    return tuple(
        Iteration(cost, shape, theta if stage.objective.method.has_angles else np.nan, level)
        for level, stage in enumerate(stages)
        for cost, shape, theta in stage.path
    )


def is_sane(shape: np.ndarray, start: np.ndarray) -> bool:
    """Tell whether a shape is finite and of a size that can still be called that of the start."""
    return (
        bool(np.isfinite(shape).all()) and SCALE_LIMITS[0] < diagonal_of(shape) / diagonal_of(start) < SCALE_LIMITS[1]
    )
