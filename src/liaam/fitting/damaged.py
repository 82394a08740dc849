"""Fits to incomplete objects: without the image where it is not what the model expects.

A wing whose tip is torn off, or a face behind a hand, pulls the whole fit. It is repeated without the pixels of absent
parts, until these no longer change: iteratively reweighted least squares whose weights are those of regions, 0 or 1,
because the residual of one pixel does not tell a missing part from a varied one.

A fit that was pulled far away agrees with hardly any pixels where it ended. Fits from other places leave out at each
level what disagrees with the shape that they start from: the blurred levels pull most, as edges reach far there.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from liaam.fitting.loop.levels import CoarseToFine, FittedLevel, Target, is_sane
from liaam.fitting.loop.options import SolverOptions, coarse_options
from liaam.fitting.one_shape_fitter import OneShapeFitter
from liaam.fitting.quality import Surroundings
from liaam.fitting.result import LEAST_PRESENT, FitResult, FitStatus, with_prior

ROUNDS = 5  # Largest number of fits from a start; most take two
ALIKE = 0.02  # Share of the pixels up to which two sets of them are the same
# Least share of the model's pixels to fit with: a fit to less follows the image wherever it agrees by chance
LEAST_SHARE = 0.15
PLACES = 4  # Largest number of other places to try if that is not so
# Share of the landmarks, one at least, by which a first fit may have more present ones than the next: pulled by what is
# absent, it agrees with its border.
PULLED = 0.05
# Odds that a fit is right which may be used only without the pixels that disagree with it. A model agrees with some of
# the pixels of anything: without the others, a fit to noise has a quality of 0.6.
SELECTED = 0.2
STILL = SolverOptions(max_iterations=0)  # of a shape that is only looked at


def without_absent(
    fitter: OneShapeFitter, target: Target, result: FitResult, other_places: Callable[[], Iterable[np.ndarray]]
) -> FitResult:
    """Repeat a fit of which a landmark is absent, without the pixels of absent parts.

    If most landmarks remain absent, fits from other places (shapes (n, 2), image pixels, most likely first) go without
    absent parts at every level; so do those from the start of a lost fit. A fit that was not lost is not repeated so
    from its start: what is no object would often agree with some parts. If most are absent everywhere, the fit is
    doubtful, with at most the quality that it had.

    Returns
    -------
    FitResult
        The fit of which most landmarks are likely present.
    """
    best = _fitted_without_absent(fitter, target, result)
    if not _is_mostly_present(best):
        for start in _starts(target, result, other_places):
            elsewhere = _fit_levels_without_absent(fitter, target._replace(start=start))
            if _n_present(elsewhere) > _n_present(best):
                best = elsewhere
            if _is_mostly_present(best):
                break
    best = replace(best, n_starts=result.n_starts)
    if not result.status.ok:
        best = with_prior(best, SELECTED)
    if _is_mostly_present(best):
        return best
    # A fit to the few pixels that agree with it, many of them by chance, is believed no more than one to all pixels.
    status = FitStatus.DOUBTFUL if best.status.ok else best.status
    return replace(best, status=status, quality=min(best.quality, result.quality))


def _starts(
    target: Target, result: FitResult, other_places: Callable[[], Iterable[np.ndarray]]
) -> Iterator[np.ndarray]:
    """Yield the start of a lost fit, and then other places, which are searched for only if they are needed."""
    if not is_sane(result.landmarks, target.start):
        yield target.start
    yield from other_places()


def _fitted_without_absent(fitter: OneShapeFitter, target: Target, result: FitResult) -> FitResult:
    """Repeat a fit without the pixels of absent parts, from where it ended, until these no longer change."""
    if not is_sane(result.landmarks, target.start):
        return result
    start = target._replace(start=result.registered, mapped=None, pull=None)
    sharpest = len(fitter.objectives) - 1
    first = fitter.coarse_to_fine.fit(start, fitter.options, first=sharpest)[-1]
    every = np.ones(len(fitter.objectives[sharpest].appearance.usable), bool)
    return _repeated(fitter, start, result, first, every)


def _fit_levels_without_absent(fitter: OneShapeFitter, target: Target) -> FitResult:
    """Fit from a start, each level without the pixels that disagree with the shape that it starts from."""
    start = target._replace(mapped=None, pull=None).measured(fitter.objectives[-1].method)
    stages: list[FittedLevel] = []
    shape = start.start
    used = np.ones(0, bool)
    for level, surroundings in enumerate(fitter.surroundings_of_levels):
        is_sharpest = level == len(fitter.objectives) - 1
        here = start._replace(start=shape)
        unmoved = fitter.coarse_to_fine.fit(here, STILL, first=level, last=level + 1)[-1]
        used = _present_pixels(fitter, surroundings, unmoved)
        options = fitter.options if is_sharpest else coarse_options(fitter.options)
        masked = CoarseToFine([fitter.objectives[level].with_weights(used)], keeps_samples=True)
        stage = masked.fit(here, options)[-1]
        stages.append(stage if is_sharpest else replace(stage, begun_at=shape))
        shape = stages[-1].reached
        if not is_sane(shape, start.start):
            break
    result = fitter.result_of(start, stages)
    return result if result.status.lost else _repeated(fitter, start, result, stages[-1], used)


def _repeated(
    fitter: OneShapeFitter, start: Target, result: FitResult, last: FittedLevel, used: np.ndarray
) -> FitResult:
    """Repeat a fit with the pixels that agree with its sharpest level ``last``, whose fit has ``used`` some."""
    best = result
    least = _n_present(result) - max(1, int(PULLED * len(result.landmarks)))
    for fit in _rounds(fitter, start, last, used):
        if _n_present(fit) >= least:
            best = fit
            least = _n_present(fit)
    if best is result or best.absent.any():
        return best
    whole = start._replace(start=best.registered)  # nothing is absent: the first fit was only in the wrong place
    fit = fitter.result_of(whole, fitter.coarse_to_fine.fit(whole, fitter.options))
    return best if fit.absent.any() else fit


def _rounds(fitter: OneShapeFitter, start: Target, last: FittedLevel, used: np.ndarray) -> Iterator[FitResult]:
    """Yield fits at all levels with the pixels that the one before agreed with, the first with those of ``last``.

    There are none if that agreed with nearly all of the pixels that it ``used``.
    """
    for _ in range(ROUNDS):
        before = used
        used = _present_pixels(fitter, fitter.surroundings, last)
        if used.mean() < LEAST_SHARE or (used != before).mean() <= ALIKE:
            return
        stages = _fit_with(fitter, start._replace(start=last.reached), used)
        last = stages[-1]
        if len(stages) < len(fitter.objectives) or not is_sane(last.reached, start.start):
            return
        yield fitter.result_of(start, stages)


def _n_present(result: FitResult) -> int:
    """Return the number of landmarks that are likely present; -1 of a lost fit."""
    return -1 if result.status.lost else int((~result.absent).sum())


def _is_mostly_present(result: FitResult) -> bool:
    """Return whether enough landmarks are present."""
    return _n_present(result) >= LEAST_PRESENT * len(result.landmarks)


def _present_pixels(fitter: OneShapeFitter, surroundings: Surroundings, stage: FittedLevel) -> np.ndarray:
    """Return at which pixels of a level the image is what the model expects, (n_pixels,) bool."""
    assert fitter.presence is not None
    return surroundings.present_pixels(fitter.presence, stage.solution)


def _fit_with(fitter: OneShapeFitter, target: Target, used: np.ndarray) -> list[FittedLevel]:
    """Fit all levels with the pixels that are used at the sharpest one."""
    objectives = [
        objective.with_weights(used[nearest])
        for objective, nearest in zip(fitter.objectives, fitter.nearest_pixels, strict=True)
    ]
    return CoarseToFine(objectives, keeps_samples=True).fit(target, fitter.options)
