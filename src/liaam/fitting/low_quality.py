"""What is done about a first fit of low quality: where else liaam looks, in which order, and what it believes then.

- The object may be elsewhere: other places of the search are fitted (:mod:`liaam.fitting.search.other_places`).
- Its shape may be far from the mean: other shapes are started from (:mod:`liaam.fitting.search.restarts`).
- Parts of it may be absent: it is fitted without them (:mod:`liaam.fitting.damaged`).
- If the fit still fails, its start may be nearer to the object (:mod:`liaam.fitting.fallback`).

What low quality is, says :meth:`liaam.fitting.quality.Judge.falls_short`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from liaam.fitting.damaged import PLACES, without_absent
from liaam.fitting.fallback import is_in_box, shape_without_fit, start_if_failed_far
from liaam.fitting.one_shape_fitter import Blurred, OneShapeFitter
from liaam.fitting.result import LEAST_QUALITY, FitResult, FitStatus, odds_of, with_prior
from liaam.fitting.search.finder import LARGE, Finder
from liaam.fitting.search.other_places import PlacedFit, likeliest, other_starts_in
from liaam.fitting.search.parts import HOPEFUL
from liaam.fitting.search.restarts import fit_again
from liaam.fitting.search.starts import region_in
from liaam.model.shape import diagonal_of

# Margin searched around a box given as a start, as a fraction of its sides. A box, as of a detector, is approximate; a
# shape given as a start is not searched for.
AROUND_BOX = 0.3

Region = tuple[np.ndarray, np.ndarray]
"""Corners of the part of an image that is searched: (x, y) of the first pixel, and of that beyond the last."""


@dataclass(frozen=True)
class PlaceOdds:
    """Odds that fits are right, with the prior of their place.

    That is proportional to the place's area, because there are more small places than large ones.
    """

    large: float  # diagonal of an object whose prior is 1, image pixels

    @classmethod
    def in_region(cls, region: Region) -> "PlaceOdds":
        """Return the odds of places in a region (its corners)."""
        low, high = region
        return cls(large=LARGE * float((high - low).min()))

    def prior(self, shape: np.ndarray, quality: float) -> float:
        """Return the prior odds of the place of a shape (n, 2); 0 if the fit has no quality."""
        return (diagonal_of(shape) / self.large) ** 2 if quality > 0 else 0.0

    def prior_of(self, result: FitResult) -> float:
        """Return the prior odds of the place of a fit, at most 1."""
        return min(self.prior(result.landmarks, result.quality), 1.0)

    def of(self, shape: np.ndarray, quality: float) -> float:
        """Return the odds that a fit with this shape and quality is right."""
        return self.prior(shape, quality) * odds_of(quality)

    def of_blurred(self, fit: Blurred) -> float:
        """Return the odds that a fit at the blurred levels is right."""
        return self.of(fit.shape, fit.quality)

    def of_result(self, result: FitResult) -> float:
        """Return the odds that a fit at all levels is right."""
        return self.of(result.landmarks, result.quality)


@dataclass(frozen=True, eq=False)
class Elsewhere:
    """Where else a fit may look.

    Attributes
    ----------
    finder : Finder
        Search for other places.
    region : Region, optional
        Where it searches; None for not at all.
    """

    finder: Finder
    region: Region | None

    def starts_of(self, fit: PlacedFit) -> list[np.ndarray]:
        """Return shapes (n, 2) of the part of a fit to start from at other places, the most likely first."""
        if self.region is None:
            return []
        places = other_starts_in(self.finder, fit, self.region, PLACES)
        part = self.finder.parts[fit.part]
        return [start if place.part == fit.part else part.mean_at(start) for place, start in places]


def fit_elsewhere(
    fitters: Sequence[OneShapeFitter], finder: Finder, first: PlacedFit, init: Any, *, restarts: bool
) -> FitResult:
    """Look elsewhere and start again if a first fit has low quality, and say how far the result is believed.

    If the model has a refiner, the landmarks of the result are refined.

    Parameters
    ----------
    fitters : sequence of OneShapeFitter
        Those of the model's parts, by one of which the first fit is.
    finder : Finder
        The search of the model.
    first : PlacedFit
    init : start, optional
        As for :meth:`liaam.fitting.Fitter.fit`. Without one, the whole image is searched for other places, and around
        a box its surroundings. Other starts are taken for places of the object.
    restarts : bool
        Whether to look elsewhere although there is a start, and to start again from other shapes.
    """
    elsewhere = Elsewhere(finder, searched_region(init, first.target.image, restarts=restarts))
    fit, prior = _fit_at_likeliest_place(fitters, first, elsewhere)
    fitter = fitters[fit.part]
    result = fit.result
    is_hopeful = len(fitters) == 1 or result.quality >= HOPEFUL
    if restarts and is_hopeful and fitter.judge.falls_short(with_prior(result, prior)):
        result = fit_again(fitter, fit.target, result)
    if result.absent.any():
        # Of a model of several parts, they were fitted already if the first fit was doubtful.
        are_fitted = len(fitters) > 1 and fit.result.n_starts > 1
        other_places = list if are_fitted else partial(elsewhere.starts_of, fit)
        result = without_absent(fitter, fit.target, result, other_places)
    result = with_prior(result, prior)
    # The pose that a fit started from has another box than the one that was given.
    may_be_far = fitter.model.poses is None or not is_in_box(result.landmarks, init)
    if may_be_far and is_judged(fitter) and (result.status.lost or _is_likely_wrong(fitter, result)):
        # A fit from a start that was given is not compared with a place that was searched for.
        start = (fit if init is None else first).target.start
        result = start_if_failed_far(result, shape_without_fit(init, start, fitter.model.in_box), fitter.shapes)
    result = fitter.refined(fit.target, result)
    if fit.detection is None or not fit.detection.doubtful:  # the start is near the object
        result = _with_prior_near(fitter, result)
    return replace(result, found=fit.detection, part=fit.part)


def searched_region(init: Any, image: np.ndarray, *, restarts: bool) -> Region | None:
    """Return the corners of the region where a fit of low quality is searched for elsewhere; None for nowhere."""
    return region_of(init, image) if init is None or restarts else None


def region_of(init: Any, image: np.ndarray) -> Region | None:
    """Return the corners of the region to search: all without a start, around a box, None for other starts."""
    if init is None:
        return np.zeros(2, int), np.array(image.shape[1::-1])
    box = getattr(init, "points", init)
    if np.shape(box) != (4,):
        return None
    low, high = np.asarray(box, np.float64).reshape(2, 2)
    around = AROUND_BOX * (high - low)
    return region_in(image, low - around, high + around)


def is_judged(fitter: OneShapeFitter) -> bool:
    """Return whether training has tried to calibrate the method. Its fits to left-out images are as they are."""
    return fitter.reliability is not None or fitter.calibration.is_failing


def _fit_at_likeliest_place(
    fitters: Sequence[OneShapeFitter], first: PlacedFit, elsewhere: Elsewhere
) -> tuple[PlacedFit, float]:
    """Return the first fit, or the most likely one of all places if that is likely wrong, and the factor on its odds.

    A place can be judged by its fit only if that has a quality.
    """
    if elsewhere.region is None or fitters[first.part].judge.reliability_for(first.result) is None:
        return first, 1.0
    odds = PlaceOdds.in_region(elsewhere.region)
    prior = odds.prior_of(first.result)
    if with_prior(first.result, prior).quality >= LEAST_QUALITY:
        return _finished(fitters, first), prior
    return likeliest(fitters, elsewhere.finder, first, elsewhere.region, odds)


def _finished(fitters: Sequence[OneShapeFitter], first: PlacedFit) -> PlacedFit:
    """Return a first fit with all its steps: that of a model of several parts may have been stopped after a few."""
    if len(fitters) == 1 or first.result.status is not FitStatus.MAX_ITERATIONS:
        return first
    return replace(first, result=fitters[first.part].fit_target(first.target))


def _is_likely_wrong(fitter: OneShapeFitter, result: FitResult) -> bool:
    """Return whether a fit is doubtful, or would be if it had converged within its iterations."""
    if result.status is FitStatus.DOUBTFUL:
        return True
    return fitter.judge.reliability_for(result) is not None and result.quality < LEAST_QUALITY


def _with_prior_near(fitter: OneShapeFitter, result: FitResult) -> FitResult:
    """Return a result with the prior odds of fits near the object in its quality and in the limit of that."""
    reliability = fitter.reliability
    if reliability is None:
        return result
    return replace(
        result,
        quality=reliability.with_prior(result.quality),
        least_quality=reliability.with_prior(LEAST_QUALITY),
    )
