"""Fits at other places of an image, where a first fit has low quality and the object may be elsewhere.

The other detections are fitted at the blurred levels, and the best of them at the sharpest. The prior of a place is
proportional to its area, because there are more small places than large ones. At most one place is the object, so each
other likely one lowers the odds.
"""

from dataclasses import replace

import numpy as np

from liaam.fitting.detection import Detection, are_apart
from liaam.fitting.loop.levels import Target
from liaam.fitting.one_shape_fitter import OneShapeFitter
from liaam.fitting.result import LEAST_QUALITY, FitResult, FitStatus, odds_of, with_prior
from liaam.fitting.search.finder import LARGE, Finder
from liaam.model.shape import diagonal_of

# Largest number of steps per level of fits to other detections: right fits take fewer, wrong ones take more. Number of
# detections that are fitted at the sharpest level, which takes most of the time: those of the highest odds at the level
# before. What was measured for these is in experiments/notes/engine.md.
BRIEF, PROMISING = 12, 3

Start = tuple[Target, Detection | None]
"""A start, and the detection that it is from."""


def likeliest(
    fitter: OneShapeFitter, finder: Finder, first: FitResult, start: Start, region: tuple[np.ndarray, np.ndarray]
) -> tuple[FitResult, float, Start]:
    """Return the most likely fit in a region (its corners), the factor on its odds, and its start.

    That is the first one if it is more likely right than wrong.
    """
    (low, high), (target, detection) = region, start
    large = LARGE * float((high - low).min())

    def prior(shape: np.ndarray, quality: float) -> float:
        return (diagonal_of(shape) / large) ** 2 if quality > 0 else 0.0

    def odds(shape: np.ndarray, quality: float) -> float:
        return prior(shape, quality) * odds_of(quality)

    factor, brief = prior(first.landmarks, first.quality), replace(fitter.options, max_iterations=BRIEF)
    if with_prior(first, min(factor, 1.0)).quality >= LEAST_QUALITY:
        return first, min(factor, 1.0), start

    blurred = []
    for place in finder.others_in(target.linear.crop(low, high)):
        fit = fitter.fit_blurred(target._replace(start=place.landmarks + low), brief)
        blurred.append((fit, detection and replace(place, others=detection.others)))
    blurred.sort(key=lambda each: odds(each[0].shape, each[0].quality), reverse=True)
    tried = [(first, start)]
    tried += [(fitter.fit_sharpest(fit, brief), (fit.target, place)) for fit, place in blurred[:PROMISING]]
    unfinished = {i for i, (each, _) in enumerate(tried) if i and each.status is FitStatus.MAX_ITERATIONS}
    while True:
        i = int(np.argmax([odds(each.landmarks, each.quality) for each, _ in tried]))
        best, start = tried[i]
        if i not in unfinished:
            break
        unfinished.remove(i)
        tried[i] = fitter.fit_target(start[0]), start
    seen = [(each.landmarks, each.quality) for each, _ in tried]
    seen += [(fit.shape, fit.quality) for fit, _ in blurred[PROMISING:]]
    others = sum(odds(*each) for each in seen if are_apart(best.landmarks, each[0]))
    factor = prior(best.landmarks, best.quality)
    shared = factor / (factor + others) if factor > 0 else 1.0
    return replace(best, n_starts=1 + len(blurred)), min(factor, 1.0) * shared, start
