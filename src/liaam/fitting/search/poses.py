"""Starts of fits of an object whose parts move against each other: the shapes of training images.

Such an object is far from its mean shape in most poses, on which its parts shrink and overlap, and a fit from there
ends in another pose. A model whose mesh is in pieces therefore keeps shapes of its training images
(:attr:`liaam.AAM.poses`). Each is fitted at the coarsest level, in all rotations that are searched for, and those that
explain most go on.
"""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from liaam.fitting.loop.encoded_image import NEAR
from liaam.fitting.loop.levels import FittedLevel, Target, is_sane
from liaam.fitting.loop.options import coarse_options
from liaam.fitting.quality import quality_features
from liaam.fitting.result import FitResult, likeliness
from liaam.model.file_format import ALL_ROTATIONS
from liaam.model.shape import corners_of, diagonal_of, in_box, rotation

if TYPE_CHECKING:
    from liaam.fitting.one_shape_fitter import OneShapeFitter

N_ROTATIONS = 6  # Number of rotations of each pose if objects are turned in any direction, evenly spaced
BRIEF = 12  # Largest number of steps of a level before the sharpest
GO_ON = 12  # Number of coarse fits that go on to the next levels
FINISHED = 5  # Number of these that are fitted at the sharpest level
APART = 0.05  # Root mean square distance, as a fraction of the diagonal, below which two fits count as the same


def fit_from_poses(fitter: "OneShapeFitter", target: Target, rotations: str) -> FitResult:
    """Fit from the poses of a model, in the box of the target's start, and return the most likely fit.

    ``rotations`` are those searched for, as of :class:`liaam.fitting.Fitter`.
    """
    target = target.measured(fitter.objectives[-1].method)
    brief = replace(fitter.options, max_iterations=min(BRIEF, fitter.options.max_iterations))
    fit_levels = partial(fitter.coarse_to_fine.fit, options=coarse_options(brief))
    last = len(fitter.objectives) - 1
    starts = posed_starts(fitter, target.start, rotations)
    fits = [fit_levels(target._replace(start=start), last=1) for start in starts]
    fits = _best_apart(fits, target.start, GO_ON)
    if last == 0:
        results = [fitter.fit_target(target._replace(start=levels[-1].reached)) for levels in fits[:FINISHED]]
    else:
        if last > 1:
            fits = [[*levels, *fit_levels(_from(levels, target), first=1, last=last)] for levels in fits]
        fits = _best_apart(fits, target.start, FINISHED)
        results = [fitter.fit_after(target, levels, fitter.options) for levels in fits]
    if not results:
        return fitter.fit_target(target)
    return replace(max(results, key=likeliness), n_starts=len(starts))


def _from(levels: list[FittedLevel], target: Target) -> Target:
    """Return a target whose start is the shape that levels have reached."""
    return target._replace(start=levels[-1].reached, margin=NEAR)


def posed_starts(fitter: "OneShapeFitter", start: np.ndarray, rotations: str) -> list[np.ndarray]:
    """Return the poses of a model in the box of a start (n, 2), in all rotations that are searched for."""
    assert fitter.model.poses is not None
    low, high = corners_of(start)
    n_rotations = N_ROTATIONS if rotations == ALL_ROTATIONS else 1
    starts = []
    for i, pose in enumerate(fitter.model.poses.astype(np.float64)):
        between = 0.5 * (i % 2)  # every other pose lies between the rotations of the others
        for k in range(n_rotations):
            turn = 2.0 * np.pi * (k + between) / n_rotations if n_rotations > 1 else 0.0
            starts.append(in_box(pose @ rotation(turn).T, 0.5 * (low + high), diagonal_of(start)))
    return starts


def _best_apart(fits: list[list[FittedLevel]], start: np.ndarray, most: int) -> list[list[FittedLevel]]:
    """Return the fits that explain most, the best first, of which no two are the same; without those that diverged."""
    apart = APART * diagonal_of(start)
    sane = [levels for levels in fits if levels and is_sane(levels[-1].reached, start)]
    best: list[list[FittedLevel]] = []
    for levels in sorted(sane, key=_explained, reverse=True):
        shape = levels[-1].reached
        distances = [np.sqrt(np.square(shape - other[-1].reached).sum(axis=1).mean()) for other in best]
        if min(distances, default=np.inf) > apart:
            best.append(levels)
            if len(best) == most:
                break
    return best


def _explained(levels: list[FittedLevel]) -> float:
    """Return what the last level explains of the image."""
    return float(quality_features(levels[-1])[0])
