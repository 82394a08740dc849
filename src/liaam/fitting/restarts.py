"""Where else a fit may begin that came to little: the shape bent and moved, fitted coarsely (multi-start).

A coarse fit reaches a few pixels and a part of a mode's deviation. A head turned by forty degrees lies beyond: starts
from the mean shape stop half-way, where the outline's far side hangs in the background.
"""

from collections.abc import Sequence

import numpy as np

from liaam.fitting.levels import Stage, Target, is_sane, prepare_level, spare
from liaam.fitting.objective import Objective
from liaam.fitting.solver import SolverOptions, solve
from liaam.model.shape import diagonal_of

BENT = 2.5
"""Standard deviations by which the mean shape is bent along its strongest mode, either way."""

SHIFT = 0.06
"""Way that it is moved right, left, down and up, as a share of its diagonal."""

BENT_ON, MODES = 2.0, 3
"""Standard deviations by which the best of these are bent on, either way, along so many of the strongest modes.
Strongly turned heads lie far out along several: without, 9 of 34 fits that can be saved are lost, and 4 with it."""

BEST = 3
"""How many of them."""

KEPT = 2
"""How many places to fit from in the end; a third saves no more."""

APART = 0.02
"""Root mean square distance, as a share of the diagonal, below which two shapes count as the same."""


def other_starts(
    objective: Objective, blur: float, target: Target, options: SolverOptions, kept: int = KEPT
) -> list[np.ndarray]:
    """Find other shapes to begin a fit from.

    The mean shape, in the pose of the start, is bent and moved, and the best of what the coarsest level makes of these
    is bent on; given are those that fit the picture best there.

    Parameters
    ----------
    objective : Objective
        Of the coarsest level.
    blur : float
        Its blur, model pixels.
    target : Target
    options : SolverOptions
    kept : int
        How many at most.

    Returns
    -------
    list of (n, 2) float64
        Shapes in image pixels, best first.
    """
    options = spare(options)
    problem, state, pose = prepare_level(objective, blur, target.measured(objective.method), (), options)
    warp, n_modes = objective.warp, objective.warp.n_parameters - 4  # the similarities stand last
    deviations = objective.prior[:n_modes] ** -0.5

    def bent(p: np.ndarray, mode: int, by: float) -> np.ndarray:
        p = p.copy()
        p[mode] += by * deviations[mode]
        return p

    def reached(p: np.ndarray, moved: Sequence[float] = (0.0, 0.0)) -> Stage:
        shape = warp.shape(p) + np.array(moved) * diagonal_of(warp.rest)
        start = state._replace(p=warp.parameters(shape))
        return Stage(objective, problem, pose, solve(objective, problem, start, options, look=False))

    mean = state.p.copy()
    mean[:n_modes] = 0.0
    directions = ((0.0, 0.0), (-SHIFT, 0.0), (SHIFT, 0.0), (0.0, SHIFT), (0.0, -SHIFT))
    shapes = [bent(mean, 0, by) for by in (-BENT, 0.0, BENT)] if n_modes else [mean]
    stages = [reached(p, moved) for p in shapes for moved in directions]
    for stage in _best(stages, BEST, target.start):
        p = stage.solution.state.p
        stages += [reached(bent(p, mode, by)) for mode in range(min(MODES, n_modes)) for by in (-BENT_ON, BENT_ON)]
    return [stage.reached for stage in _best(stages, kept, target.start)]


def _best(stages: Sequence[Stage], count: int, start: np.ndarray) -> list[Stage]:
    """Stages of least cost that lie apart from each other, best first."""
    best: list[Stage] = []
    apart = APART * diagonal_of(start)
    for stage in sorted(stages, key=lambda stage: stage.solution.costs[-1]):
        shape = stage.reached
        if len(best) < count and is_sane(shape, start) and all(_distance(shape, b.reached) > apart for b in best):
            best.append(stage)
    return best


def _distance(shape: np.ndarray, other: np.ndarray) -> float:
    """Root mean square distance of the landmarks."""
    return float(np.sqrt(np.square(shape - other).sum(axis=1).mean()))
