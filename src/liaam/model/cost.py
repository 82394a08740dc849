"""What fits with a model cost at most, in work and in memory: known from its size, before anything is fitted.

A step of a fit multiplies, at each sampled pixel and channel, all pairs of modes of the appearance and of the shape. A
fit of low quality is started again, mostly at the coarsest level. So a small file can ask for much: by many modes on
few pixels, or by coarse levels that are not blurred, of which every pixel is sampled.
"""

from collections.abc import Collection

import numpy as np

from liaam.model.appearance import CHANNELS, AppearanceModel
from liaam.model.views import Level, View

# Largest work of a fit: multiplications in one step of every start. Those of the faces that come with liaam take 5e8,
# and with a second of processor time for 3e8 about 15 s are the most; models of 300 pixels instead of 150 take 2e9.
MOST_WORK = 5e9
# Largest memory of a model and of a fitter for one method, bytes. Those faces take 4e8.
MOST_MEMORY = 2e9

# Distance between sampled pixels, in standard deviations of the blur (liaam.fitting.loop.objective.THINNING);
# orientations are compared at every pixel.
THINNING, EVERYWHERE = 1.5, "orientation"
# Fits at the coarsest level, at those between and at the sharpest, of a fit that is started again (liaam.fitting):
# other starts are 15 at first and 18 later, few of which are fitted further.
STARTS = 33, 5, 2
# Bytes of a number of the appearance: as it is loaded, as textures are projected, and as a fitter keeps it with its
# gradients at sampled pixels. Measured with 40 times the modes of a small model.
LOADED, PROJECTED, KEPT = 4, 48, 64


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
    shapes = view.shape_model
    total = 0.0
    for i, level in enumerate(view.levels):
        if kind not in level.appearances:
            continue
        appearance = level.appearances[kind]
        finest = i == len(view.levels) - 1
        n_shape = len(shapes.modes) if finest else len(shapes.seen_at(level.blur).modes)
        n_starts = STARTS[0 if i == 0 else 2 if finest else 1] if view.reliabilities else 1
        n_modes = 1 + appearance.n_modes + n_shape + 4  # with the mean, and the similarities
        total += n_starts * _n_samples(level, appearance, kind) * appearance.mean.shape[1] * float(n_modes) ** 2
    return total


def memory_of(views: Collection[View]) -> float:
    """Return the bytes that a model and a fitter for one method take."""
    levels = [level for view in views for level in view.levels]
    numbers = [_n_numbers(each) for level in levels for each in level.appearances.values()]
    per_kind = [sum(_n_kept(level, kind) for level in view.levels) for view in views for kind in CHANNELS]
    return LOADED * sum(numbers) + PROJECTED * max(numbers, default=0.0) + KEPT * max(per_kind, default=0.0)


def _n_numbers(appearance: AppearanceModel) -> float:
    return float(appearance.mean.size) * (1 + appearance.n_modes)


def _n_kept(level: Level, kind: str) -> float:
    """Return how many numbers of an appearance a fitter keeps."""
    if kind not in level.appearances:
        return 0.0
    appearance = level.appearances[kind]
    return _n_samples(level, appearance, kind) * appearance.mean.shape[1] * (1.0 + appearance.n_modes)


def _n_samples(level: Level, appearance: AppearanceModel, kind: str) -> float:
    """Return how many pixels a fit compares, about."""
    step = 1.0 if kind == EVERYWHERE else max(1.0, float(np.rint(THINNING * level.blur)))
    return len(appearance.mean) / step**2
