"""Fits at other places of an image, where a first fit has low quality and the object may be elsewhere.

The other detections are fitted at the blurred levels, and the best of them at the sharpest. At most one place is the
object, so each other likely one lowers the odds.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from liaam.fitting.detection import Detection, are_apart
from liaam.fitting.loop.levels import Target
from liaam.fitting.loop.options import SolverOptions
from liaam.fitting.one_shape_fitter import Blurred, OneShapeFitter
from liaam.fitting.result import LEAST_QUALITY, FitResult, FitStatus, with_prior
from liaam.fitting.search.finder import OTHERS, Finder
from liaam.fitting.search.parts import HOPEFUL, PartFit, fit_coarsest, fit_further, targets_at
from liaam.model.shape import diagonal_of

if TYPE_CHECKING:
    from liaam.fitting.low_quality import PlaceOdds

# What was measured for these is in experiments/notes/engine.md.
BRIEF = 12  # Largest number of steps per level of fits to other detections: right fits take fewer, wrong ones take more
# Number of other detections that are fitted at the sharpest level, which takes most of the time: those of the highest
# odds at the level before
PROMISING = 3
PROMISING_OF_PARTS = 2  # The same for models of several parts, in each turn


@dataclass(frozen=True, eq=False)
class PlacedFit:
    """A fit, and the place that it was started at."""

    result: FitResult
    target: Target
    detection: Detection | None  # of the place, if it was searched for
    part: int = 0  # index of the model's part that was fitted

    @property
    def diagonal(self) -> float:
        """Diagonal of the start if it was given, pixels, which is about that of the object; else 0."""
        return 0.0 if self.detection is not None else diagonal_of(self.target.start)


def likeliest(
    fitters: Sequence[OneShapeFitter],
    finder: Finder,
    first: PlacedFit,
    region: tuple[np.ndarray, np.ndarray],
    odds: "PlaceOdds",
) -> tuple[PlacedFit, float]:
    """Return the most likely of the first fit and those at other places, and the factor on its odds.

    The places are in a region (its corners). Each fit is by one of the model's parts.
    """
    brief = replace(fitters[0].options, max_iterations=BRIEF)
    fits = [first]
    unpromising: list[Blurred] = []
    n_starts = 1
    best = first
    prior = odds.prior_of(first.result)
    for places in _other_starts_in_turn(finder, first, region):
        blurred = _fit_blurred(fitters, finder, first.target, places, brief, odds)
        n_starts += len(blurred)
        promising = blurred[:PROMISING]
        if len(fitters) > 1:
            promising = [each for each in blurred[:PROMISING_OF_PARTS] if each[2].quality >= HOPEFUL]
        for place, part, fit in promising:
            # What else the search found is the same for all places.
            detection = None if first.detection is None else replace(place, others=first.detection.others)
            fits.append(PlacedFit(fitters[part].fit_sharpest(fit, brief), fit.target, detection, part))
        unpromising += [fit for *_, fit in blurred[len(promising) :]]
        best = fits[_finish_best(fits, fitters, odds.of_result)]
        prior = _prior_beside(best, fits, unpromising, odds)
        if with_prior(best.result, prior).quality >= LEAST_QUALITY:
            break
    if n_starts == 1:  # there are no other places
        best = fits[_finish_best(fits, fitters, odds.of_result)]
    return replace(best, result=replace(best.result, n_starts=n_starts)), prior


def _prior_beside(
    best: PlacedFit, fits: Sequence[PlacedFit], unpromising: Sequence[Blurred], odds: "PlaceOdds"
) -> float:
    """Return the factor on the odds of the best fit, by its place and by the odds of those elsewhere."""
    shape = best.result.landmarks
    elsewhere = [odds.of_result(fit.result) for fit in fits if are_apart(shape, fit.result.landmarks)]
    elsewhere += [odds.of_blurred(fit) for fit in unpromising if are_apart(shape, fit.shape)]
    prior = odds.prior(shape, best.result.quality)
    share = prior / (prior + sum(elsewhere)) if prior > 0 else 1.0
    return min(prior, 1.0) * share


def _fit_blurred(
    fitters: Sequence[OneShapeFitter],
    finder: Finder,
    target: Target,
    places: Sequence[tuple[Detection, np.ndarray]],
    options: SolverOptions,
    odds: "PlaceOdds",
) -> list[tuple[Detection, int, Blurred]]:
    """Fit places (each with its start) at the blurred levels; return them with their part and fit, the best first.

    Of several parts, as many fits as there are places go on from the coarsest level: those of the highest odds.
    """
    if len(fitters) == 1:
        fits = [(place, 0, fitters[0].fit_blurred(target._replace(start=start), options)) for place, start in places]
        return sorted(fits, key=lambda each: odds.of_blurred(each[2]), reverse=True)

    def odds_of_part(fit: tuple[Detection, PartFit]) -> float:
        return odds.prior(fit[1].fit.shape, fit[1].fit.quality) * fit[1].odds

    coarsest = []
    for place, start in places:
        targets = targets_at(target._replace(start=start), finder.parts)
        coarsest += [(place, fit) for fit in fit_coarsest(fitters, targets, options)]
    coarsest.sort(key=odds_of_part, reverse=True)
    further = [(place, fit_further(fitters, fit, options)) for place, fit in coarsest[: len(places)]]
    of_places: dict[int, tuple[Detection, int, Blurred]] = {}
    for place, fit in sorted(further, key=odds_of_part, reverse=True):
        of_places.setdefault(id(place), (place, fit.part, fit.fit))
    return list(of_places.values())


def _other_starts_in_turn(
    finder: Finder, first: PlacedFit, region: tuple[np.ndarray, np.ndarray]
) -> Iterator[list[tuple[Detection, np.ndarray]]]:
    """Yield other places in a region in turn, each with its start; of several parts without that of the first fit."""
    low, high = region
    for places in finder.others_in_turn(first.target.linear.crop(low, high), first.diagonal):
        starts = [(place, place.landmarks + low) for place in places]
        if len(finder.parts) > 1:
            starts = [(place, start) for place, start in starts if are_apart(first.target.start, start)]
        if starts:
            yield starts


def other_starts_in(
    finder: Finder, fit: PlacedFit, region: tuple[np.ndarray, np.ndarray], most: int = OTHERS
) -> list[tuple[Detection, np.ndarray]]:
    """Return other places in a region (its corners), at most so many, each with its start (n, 2) in the image."""
    low, high = region
    places = finder.others_in(fit.target.linear.crop(low, high), most, fit.diagonal)
    return [(place, place.landmarks + low) for place in places]


def _finish_best(
    fits: list[PlacedFit], fitters: Sequence[OneShapeFitter], odds_of_result: Callable[[FitResult], float]
) -> int:
    """Fit the best of some fits again until it is one that was not stopped early; return its index.

    The first fit of a model of one shape was not. Others are replaced in the list by those with all steps, or, of
    several parts, said to be doubtful if there is no hope.
    """
    first = 0 if len(fitters) > 1 else 1
    unfinished = {i for i, fit in enumerate(fits) if i >= first and fit.result.status is FitStatus.MAX_ITERATIONS}
    while True:
        best = int(np.argmax([odds_of_result(fit.result) for fit in fits]))
        if best not in unfinished:
            return best
        unfinished.remove(best)
        result = fits[best].result
        if len(fitters) > 1 and result.quality < HOPEFUL:
            result = replace(result, status=FitStatus.DOUBTFUL)
        else:
            result = fitters[fits[best].part].fit_target(fits[best].target)
        fits[best] = replace(fits[best], result=result)
