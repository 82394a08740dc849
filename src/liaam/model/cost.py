"""What fits with a model cost at most, in work and in memory: known from its size, before anything is fitted.

A step of a fit multiplies, at each sampled pixel and channel, all pairs of modes of the appearance and of the shape. A
fit of low quality is started again, mostly at the coarsest level. So a small file can ask for much: by many modes on
few pixels, or by coarse levels that are not blurred, of which every pixel is sampled.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from liaam.model.appearance import CHANNELS, AppearanceModel
from liaam.model.views import Level, View
from liaam.model.warp import thinning_of

# Largest work of a fit: multiplications in one step of every start. Those of the faces that come with liaam take 5e8,
# and with a second of processor time for 3e8 about 15 s are the most; models of 300 pixels instead of 150 take 2e9.
MOST_WORK = 5e9
# Largest memory of a model and of a fitter for one method, bytes. Those faces take 4e8.
MOST_MEMORY = 2e9


class Starts(NamedTuple):
    """Fits at each level, of a fit that is started again (liaam.fitting)."""

    coarsest: int
    between: int  # at each level between the coarsest and the sharpest
    sharpest: int


# Other starts are 15 at first and 18 later, few of which are fitted further.
STARTS = Starts(coarsest=33, between=5, sharpest=2)

# Bytes of a number of the appearance, measured with 40 times the modes of a small model
LOADED = 4  # As it is loaded
PROJECTED = 48  # As textures are projected on it
KEPT = 64  # As a fitter keeps it, with its gradients at sampled pixels


class TooLargeError(ValueError):
    """A model takes too much time or memory."""


def check_cost(views: Collection[View]) -> None:
    """Raise TooLargeError if a fit with a model of one shape takes too long, or too much memory."""
    work = work_of(views)
    if work > MOST_WORK:
        fault = f"{work:.2g} multiplications a step, more than the {MOST_WORK:.2g} allowed"
        raise TooLargeError(f"a fit would take {fault}")
    check_memory(memory_of(views))


def check_memory(memory: float) -> None:
    """Raise TooLargeError if a model takes too much memory, bytes."""
    if memory > MOST_MEMORY:
        fault = f"{memory / 1e6:,.0f} MB, more than the {MOST_MEMORY / 1e6:,.0f} allowed"
        raise TooLargeError(f"it would take {fault}")


def work_of(views: Collection[View]) -> float:
    """Return the multiplications of one step of every start, of the costliest appearance of a model."""
    return max((_work(view, kind) for view in views for kind in CHANNELS), default=0.0)


def _work(view: View, kind: str) -> float:
    """Return the multiplications of one step of every start, of one appearance of a view; 0 without it."""
    shapes = view.shape_model
    total = 0.0
    for i, level in enumerate(view.levels):
        if kind not in level.appearances:
            continue
        appearance = level.appearances[kind]
        is_sharpest = i == len(view.levels) - 1
        n_shape = len(shapes.modes) if is_sharpest else len(shapes.seen_at(level.blur).modes)
        n_modes = 1 + appearance.n_modes + n_shape + 4  # with the mean, and the similarities
        n_starts = _n_starts(view, i)
        total += n_starts * _n_samples(level, appearance, kind) * appearance.mean.shape[1] * float(n_modes) ** 2
    return total


def _n_starts(view: View, i: int) -> int:
    """Return how many fits there are at level i of a view; only fits whose quality is known are started again."""
    if not view.reliabilities:
        return 1
    if i == 0:
        return STARTS.coarsest
    return STARTS.sharpest if i == len(view.levels) - 1 else STARTS.between


def memory_of(views: Collection[View]) -> float:
    """Return the bytes that a model and a fitter for one method take."""
    levels = [level for view in views for level in view.levels]
    numbers = [_n_numbers(each) for level in levels for each in level.appearances.values()]
    per_kind = [sum(_n_kept(level, kind) for level in view.levels) for view in views for kind in CHANNELS]
    return LOADED * sum(numbers) + PROJECTED * max(numbers, default=0.0) + KEPT * max(per_kind, default=0.0)


def _n_numbers(appearance: AppearanceModel) -> float:
    """Return how many numbers the mean and the modes of an appearance have."""
    return float(appearance.mean.size) * (1 + appearance.n_modes)


def _n_kept(level: Level, kind: str) -> float:
    """Return how many numbers of an appearance a fitter keeps of a level; 0 without it."""
    if kind not in level.appearances:
        return 0.0
    appearance = level.appearances[kind]
    return _n_samples(level, appearance, kind) * appearance.mean.shape[1] * (1.0 + appearance.n_modes)


def _n_samples(level: Level, appearance: AppearanceModel, kind: str) -> float:
    """Return how many pixels a fit compares, about."""
    step = max(1.0, float(np.rint(thinning_of(kind) * level.blur)))
    return len(appearance.mean) / step**2
