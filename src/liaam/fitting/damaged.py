"""Fits to incomplete objects: without the image where it is not what the model expects.

A wing whose tip is torn off, or a face behind a hand, pulls the whole fit. It is repeated without the pixels of absent
parts, until these no longer change: iteratively reweighted least squares whose weights are those of regions, 0 or 1,
because the residual of one pixel does not tell a missing part from a varied one.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from liaam.fitting.loop.levels import CoarseToFine, FittedLevel, Target, is_sane
from liaam.fitting.one_shape_fitter import OneShapeFitter
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


def without_absent(
    fitter: OneShapeFitter, target: Target, result: FitResult, other_places: Callable[[], Iterable[np.ndarray]]
) -> FitResult:
    """Repeat a fit of which a landmark is absent, without the pixels of absent parts.

    If most landmarks remain absent, the fits from other places (shapes (n, 2), image pixels, most likely first) are
    tried too, and if they do everywhere, the fit is doubtful, with at most the quality that it had.

    Returns
    -------
    FitResult
        The fit of which most landmarks are likely present.
    """
    best = _fitted_without_absent(fitter, target, result)
    if not _is_mostly_present(best):
        for place in other_places():
            start = target._replace(start=place)
            elsewhere = fitter.result_of(start, fitter.coarse_to_fine.fit(start, fitter.options))
            elsewhere = _fitted_without_absent(fitter, start, elsewhere)
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


def _fitted_without_absent(fitter: OneShapeFitter, target: Target, result: FitResult) -> FitResult:
    """Repeat a fit without the pixels of absent parts, until these no longer change.

    One that was lost, as absent parts pulled it away, is repeated from where it started.
    """
    best = result
    least = _n_present(result) - max(1, int(PULLED * len(result.landmarks)))
    start = result.registered if is_sane(result.landmarks, target.start) else target.start
    for fit in _rounds(fitter, target._replace(start=start, mapped=None, pull=None)):
        if _n_present(fit) >= least:
            best = fit
            least = _n_present(fit)
    if best is result or best.absent.any():
        return best
    whole = target._replace(start=best.registered)  # nothing is absent: the first fit was only in the wrong place
    fit = fitter.result_of(whole, fitter.coarse_to_fine.fit(whole, fitter.options))
    return best if fit.absent.any() else fit


def _rounds(fitter: OneShapeFitter, start: Target) -> Iterator[FitResult]:
    """Yield fits with the pixels that the one before agreed with, the first with those of a fit from the start.

    There are none if a fit agreed with nearly all of the pixels that it used.
    """
    sharpest = len(fitter.objectives) - 1
    last = fitter.coarse_to_fine.fit(start, fitter.options, first=sharpest)[-1]
    used = np.ones(len(fitter.objectives[sharpest].appearance.usable), bool)
    for _ in range(ROUNDS):
        before = used
        used = _present_pixels(fitter, last)
        if used.mean() < LEAST_SHARE or (used != before).mean() <= ALIKE:
            return
        stages = _fit_with(fitter, start._replace(start=last.reached), used)
        last = stages[-1]
        if len(stages) <= sharpest or not is_sane(last.reached, start.start):
            return
        yield fitter.result_of(start, stages)


def _n_present(result: FitResult) -> int:
    """Return the number of landmarks that are likely present; -1 of a lost fit."""
    return -1 if result.status.lost else int((~result.absent).sum())


def _is_mostly_present(result: FitResult) -> bool:
    """Return whether enough landmarks are present."""
    return _n_present(result) >= LEAST_PRESENT * len(result.landmarks)


def _present_pixels(fitter: OneShapeFitter, stage: FittedLevel) -> np.ndarray:
    """Return at which pixels of the sharpest level the image is what the model expects, (n_pixels,) bool."""
    assert fitter.presence is not None
    return fitter.surroundings.present_pixels(fitter.presence, stage.solution)


def _fit_with(fitter: OneShapeFitter, target: Target, used: np.ndarray) -> list[FittedLevel]:
    """Fit all levels with the pixels that are used at the sharpest one."""
    objectives = [
        objective.with_weights(used[nearest])
        for objective, nearest in zip(fitter.objectives, fitter.nearest_pixels, strict=True)
    ]
    return CoarseToFine(objectives, keeps_samples=True).fit(target, fitter.options)
