"""Multi-start: other starts for a fit of low quality, from deformed and shifted mean shapes fitted coarsely.

A coarse fit converges only from nearby. From the mean shape it does not reach a head turned by forty degrees: it stops
half-way, with the far side of the outline in the background.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from liaam.fitting.loop.levels import FittedLevel, Target, is_sane, prepare_level
from liaam.fitting.loop.objective import Objective
from liaam.fitting.loop.options import SolverOptions, coarse_options
from liaam.fitting.one_shape_fitter import OneShapeFitter
from liaam.fitting.result import FitResult
from liaam.model.shape import diagonal_of

BENT = 2.5  # deformation of the mean shape along its strongest mode, in standard deviations, in both directions
SHIFT = 0.06  # of the mean shape to the right, left, bottom and top, as a fraction of its diagonal

# Further deformation of the best of these, in standard deviations, number of modes it is applied to, and of shapes.
# Strongly turned heads deviate along several modes: of 34 fits that restarts can save, 4 are lost with it, 9 without.
BENT_ON = 2.0
MODES = 3
BEST = 3
KEPT = 2  # starts returned; a third saves no more fits
APART = 0.02  # root mean square distance, as a fraction of the diagonal, below which two shapes count as the same


def fit_again(fitter: OneShapeFitter, target: Target, first: FitResult) -> FitResult:
    """Return the better fit by quality, of the first and the best from other starts."""
    starts = other_starts(fitter.objectives[0], target, fitter.options)
    options = fitter.options
    if not starts:
        return first
    fits = [fitter.fit_blurred(target._replace(start=start), options) for start in starts]
    best = fitter.fit_sharpest(max(fits, key=lambda each: each.quality), options)
    better = best.quality > first.quality and is_sane(best.landmarks, target.start)
    return replace(best if better else first, n_starts=first.n_starts + len(fits))


def other_starts(objective: Objective, target: Target, options: SolverOptions, count: int = KEPT) -> list[np.ndarray]:
    """Find other shapes to start a fit from: (n, 2) float64, image pixels, the best first, at most ``count``.

    The mean shape in the pose of the start is deformed and shifted, and fitted at the coarsest level, whose objective
    is given. The best of these are deformed further and fitted again. The shapes of least cost are returned.
    """
    options = coarse_options(options)
    image, state, pose = prepare_level(objective, target.measured(objective.method), (), options)
    n_modes = objective.warp.n_parameters - 4  # the similarity vectors come last
    warp = objective.warp
    deviations = objective.prior[:n_modes] ** -0.5

    def bent(p: np.ndarray, mode: int, by: float) -> np.ndarray:
        p = p.copy()
        p[mode] += by * deviations[mode]
        return p

    def reached(p: np.ndarray, moved: Sequence[float] = (0.0, 0.0)) -> FittedLevel:
        shape = warp.shape(p) + np.array(moved) * diagonal_of(warp.rest)
        start = state._replace(p=warp.parameters(shape))
        solution = objective.solve(image, start, options, evaluate_last=False)
        return FittedLevel(objective, pose, solution, image.patch.from_image, image.channels.shape[:2])

    mean = state.p.copy()
    mean[:n_modes] = 0.0
    directions = ((0.0, 0.0), (-SHIFT, 0.0), (SHIFT, 0.0), (0.0, SHIFT), (0.0, -SHIFT))
    bends = [bent(mean, 0, by) for by in (-BENT, 0.0, BENT)] if n_modes else [mean]
    stages = [reached(p, moved) for p in bends for moved in directions]
    for stage in _best(stages, BEST, target.start):
        p = stage.solution.p
        stages += [reached(bent(p, mode, by)) for mode in range(min(MODES, n_modes)) for by in (-BENT_ON, BENT_ON)]
    return [stage.reached for stage in _best(stages, count, target.start)]


def _best(stages: Sequence[FittedLevel], count: int, start: np.ndarray) -> list[FittedLevel]:
    """Return the stages of least cost whose shapes differ, best first."""
    best: list[FittedLevel] = []
    apart = APART * diagonal_of(start)
    for stage in sorted(stages, key=lambda stage: stage.solution.costs[-1]):
        shape = stage.reached
        if len(best) < count and is_sane(shape, start) and all(_distance(shape, b.reached) > apart for b in best):
            best.append(stage)
    return best


def _distance(shape: np.ndarray, other: np.ndarray) -> float:
    """Return the root mean square distance of the landmarks."""
    return float(np.sqrt(np.square(shape - other).sum(axis=1).mean()))
