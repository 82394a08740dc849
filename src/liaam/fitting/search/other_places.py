"""Fits at other places of an image, where a first fit has low quality and the object may be elsewhere.

The other detections are fitted at the blurred levels, and the best of them at the sharpest. At most one place is the
object, so each other likely one lowers the odds.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from liaam.fitting.detection import Detection, are_apart
from liaam.fitting.loop.levels import Target
from liaam.fitting.one_shape_fitter import OneShapeFitter
from liaam.fitting.result import FitResult, FitStatus
from liaam.fitting.search.finder import OTHERS, Finder

if TYPE_CHECKING:
    from liaam.fitting.low_quality import PlaceOdds

# What was measured for these is in experiments/notes/engine.md.
BRIEF = 12  # Largest number of steps per level of fits to other detections: right fits take fewer, wrong ones take more
# Number of other detections that are fitted at the sharpest level, which takes most of the time: those of the highest
# odds at the level before
PROMISING = 3


@dataclass(frozen=True, eq=False)
class PlacedFit:
    """A fit, and the place that it was started at."""

    result: FitResult
    target: Target
    detection: Detection | None  # of the place, if it was searched for


def likeliest(
    fitter: OneShapeFitter,
    finder: Finder,
    first: PlacedFit,
    region: tuple[np.ndarray, np.ndarray],
    odds: "PlaceOdds",
) -> tuple[PlacedFit, float]:
    """Return the most likely of the first fit and those at other places, and the factor on its odds.

    The places are in a region (its corners).
    """
    brief = replace(fitter.options, max_iterations=BRIEF)
    blurred = []  # each with its place
    for place, start in other_starts_in(finder, first.target, region):
        blurred.append((fitter.fit_blurred(first.target._replace(start=start), brief), place))
    blurred.sort(key=lambda each: odds.of_blurred(each[0]), reverse=True)

    fits = [first]
    for fit, place in blurred[:PROMISING]:
        # What else the search found is the same for all places.
        detection = None if first.detection is None else replace(place, others=first.detection.others)
        fits.append(PlacedFit(fitter.fit_sharpest(fit, brief), fit.target, detection))
    best = fits[_finish_best(fits, fitter, odds.of_result)]

    shape = best.result.landmarks
    odds_elsewhere = [odds.of_result(fit.result) for fit in fits if are_apart(shape, fit.result.landmarks)]
    odds_elsewhere += [odds.of_blurred(fit) for fit, _ in blurred[PROMISING:] if are_apart(shape, fit.shape)]
    prior = odds.prior(shape, best.result.quality)
    share = prior / (prior + sum(odds_elsewhere)) if prior > 0 else 1.0
    result = replace(best.result, n_starts=1 + len(blurred))
    return replace(best, result=result), min(prior, 1.0) * share


def other_starts_in(
    finder: Finder, target: Target, region: tuple[np.ndarray, np.ndarray], most: int = OTHERS
) -> list[tuple[Detection, np.ndarray]]:
    """Return other places in a region (its corners), at most so many, each with its start (n, 2) in the image."""
    low, high = region
    places = finder.others_in(target.linear.crop(low, high), most)
    return [(place, place.landmarks + low) for place in places]


def _finish_best(fits: list[PlacedFit], fitter: OneShapeFitter, odds_of_result: Callable[[FitResult], float]) -> int:
    """Fit the best of some fits again until it is one that was not stopped early; return its index.

    The first fit was not. Others are replaced in the list by those with all steps.
    """
    unfinished = {i for i, fit in enumerate(fits) if i > 0 and fit.result.status is FitStatus.MAX_ITERATIONS}
    while True:
        best = int(np.argmax([odds_of_result(fit.result) for fit in fits]))
        if best not in unfinished:
            return best
        unfinished.remove(best)
        fits[best] = replace(fits[best], result=fitter.fit_target(fits[best].target))
