"""A model and a method, prepared for many images: fits of targets and their results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from liaam.fitting.loop.encoded_image import NEAR
from liaam.fitting.loop.levels import CoarseToFine, FittedLevel, Target, is_sane
from liaam.fitting.loop.objective import PRIOR_OF_POSES, Objective, make_objectives
from liaam.fitting.loop.options import SolverOptions, coarse_options, scored
from liaam.fitting.methods import DEFAULT_METHOD, Method, get_method
from liaam.fitting.quality import Calibration, Judge, Surroundings
from liaam.fitting.result import FitResult, explained_fraction
from liaam.model import AAM, Reliability, View
from liaam.model.presence import Presence
from liaam.model.regressor import LandmarkRegressor
from liaam.model.sampling import within
from liaam.model.shape import ShapeModel, align, expanded_about

# Largest blur of the levels that a fit from another landmarker's points uses, as a multiple of the points' root mean
# square error on left-out images. Measured on the spot protocol with simulated points, on average 5, 10 and 20 % of the
# distance between the eyes off: errors as with all levels, within 0.1 %.
REACH = 0.35
# SolverOptions.early_tolerance of these fits, unless it is set: a start of known precision needs fewer steps. On the
# spot protocol two steps instead of three, and the same errors within 0.1 %.
MAPPED_TOLERANCE = 1.0

# Margin of fits from another landmarker's points, besides NEAR: so many times their root mean square error.
MAPPED_DEVIATIONS = 2.0
# Squared distance to where the regressor leads from a result, in its mean squared error on left-out images, beyond
# which the fit is repeated from there. Of right fits to shells, 95 % are below 0.2; wrong ones have 5 and more.
MOST_DOUBT = 1.0
# Least share of the landmarks in the image, of those that the regressor finds
LEAST_INSIDE = 0.5

USUAL = SolverOptions()


class Blurred(NamedTuple):
    """A fit at the coarsest level, or at all but the sharpest."""

    target: Target
    stages: list[FittedLevel]  # its levels; none if it diverged, or if the method is not calibrated
    shape: np.ndarray  # (n, 2) reached, image pixels; the start without levels
    quality: float  # 0 without levels


@dataclass(frozen=True, eq=False)
class OneShapeFitter:
    """A model of one shape, a method and the solver's options; :class:`liaam.fitting.Fitter` is for several shapes."""

    model: AAM
    method: str | Method = DEFAULT_METHOD
    options: SolverOptions = USUAL

    @cached_property
    def objectives(self) -> tuple[Objective, ...]:
        """The objectives of model and method, one per level, coarse to fine."""
        method = scored(get_method(self.method), self.options)
        final_prior = self.options.final_prior
        if final_prior is None:
            final_prior = self.calibration.final_prior
            if self.reliability is None and self.model.poses is not None:
                final_prior = PRIOR_OF_POSES
        return make_objectives(self.model, method, final_prior=final_prior)

    @cached_property
    def calibration(self) -> Calibration:
        """What training has learnt of the method's fits."""
        return Calibration.of(self.model, self.method, self.options)

    @cached_property
    def judge(self) -> Judge:
        """What makes the results of fits."""
        return Judge(self.model, self.objectives[-1], self.options, self.calibration)

    @cached_property
    def coarse_to_fine(self) -> CoarseToFine:
        """The objectives, ready to fit images."""
        return CoarseToFine(self.objectives, keeps_samples=self.presence is not None)

    @property
    def presence(self) -> Presence | None:
        """Calibration of whether landmarks are present; None if training has not learnt it for the method."""
        return self.calibration.presence

    @property
    def surroundings(self) -> Surroundings:
        """Windows in which image and fit are compared at the sharpest level."""
        return self.judge.surroundings

    @cached_property
    def surroundings_of_levels(self) -> tuple[Surroundings, ...]:
        """The same of every level, coarse to fine."""
        return (*map(Surroundings, self.objectives[:-1]), self.surroundings)

    @cached_property
    def nearest_pixels(self) -> tuple[np.ndarray, ...]:
        """The sampled pixel of the sharpest level that is nearest to each of every level, by index."""
        return tuple(self.surroundings.nearest_of(objective) for objective in self.objectives)

    @cached_property
    def dense(self) -> Objective:
        """The objective of the sharpest level at all pixels of its frame."""
        return make_objectives(self.model, self.objectives[-1].method, thinning=0.0)[-1]

    @property
    def view(self) -> View:
        """The model's view that the method fits with."""
        return self.model.views[self.objectives[0].method.view]

    @property
    def shapes(self) -> ShapeModel:
        """The shape model that the method fits with."""
        return self.view.shape_model

    @property
    def reliability(self) -> Reliability | None:
        """Calibration of quality and covariances; None if training has not calibrated the method."""
        return self.calibration.reliability

    def fit_target(self, target: Target, options: SolverOptions | None = None) -> FitResult:
        """Fit all levels; from another landmarker's points those that are sharp enough.

        If the model has a regressor, its landmarks are such points: those that it finds from the start, and those from
        where the blurred levels lead if the first fit has low quality, or if there is no quality.
        """
        options = self.options if options is None else options
        points = self.model.points
        if target.pull is not None and points is not None:
            return self.result_of(target, self._levels_from_points(target, points.deviation, options))
        if self.regressor is None:
            return self.result_of(target, self.coarse_to_fine.fit(target, options))
        first = self._fit_regressed(target, options)
        if first is not None and self.reliability is not None and not self.judge.falls_short(first):
            return first
        second = self._fit_blurred_and_regressed(target, options)
        if first is None or explained_fraction(second) > explained_fraction(first):
            return second
        return first

    def _fit_blurred_and_regressed(self, target: Target, options: SolverOptions) -> FitResult:
        """Fit all levels but the sharpest, and then from where the regressor leads."""
        shape = self._blurred_levels(target, options)[-1].reached
        if is_sane(shape, target.start):
            regressed = self._fit_regressed(target._replace(start=shape), options)
            if regressed is not None:
                return regressed
        return self.result_of(target, self.coarse_to_fine.fit(target, options))

    def weighing_in(
        self, target: Target, landmarks: np.ndarray, precision: np.ndarray | None, deviation: float
    ) -> Target:
        """Return a target that weighs in landmarks (n, 2) of another landmarker, by their precision in p.

        The margin around the start allows for their root mean square error, pixels of the frame.
        """
        margin = NEAR + MAPPED_DEVIATIONS * deviation / self.model.diagonal
        return target._replace(mapped=landmarks, pull=precision, margin=min(target.margin, margin))

    def _levels_from_points(self, target: Target, deviation: float, options: SolverOptions) -> list[FittedLevel]:
        """Fit the levels that are sharp enough for points with a root mean square error, pixels of the frame."""
        first = self._first_level(REACH * deviation)
        if options.early_tolerance is None:
            options = replace(options, early_tolerance=MAPPED_TOLERANCE)
        return self.coarse_to_fine.fit(target, options, first)

    def _fit_regressed(self, target: Target, options: SolverOptions) -> FitResult | None:
        """Fit from where the regressor leads from a start; None if that is no object, or outside the image.

        If the regressor leads elsewhere from the result, the fit is repeated from there, once.
        """
        landmarks = self._regressed(target, target.start)
        if landmarks is None:
            return None
        regressed, stages = self._fit_at(target, landmarks, options)
        doubt, again = self._doubt_about(regressed, stages[-1].reached)
        if doubt > MOST_DOUBT and again is not None:
            regressed, stages = self._fit_at(target, again, options)
            doubt, _ = self._doubt_about(regressed, stages[-1].reached)
        return self.result_of(regressed, stages, doubt)

    def _regressed(self, target: Target, start: np.ndarray) -> np.ndarray | None:
        """Return the regressor's landmarks (n, 2) from a start; None if that is no object, or outside the image."""
        assert self.regressor is not None
        landmarks = self.regressor(target.image, target.linear.response, start)
        if not is_sane(landmarks, start) or within(landmarks, target.image).mean() < LEAST_INSIDE:
            return None
        return landmarks

    def _fit_at(
        self, target: Target, landmarks: np.ndarray, options: SolverOptions
    ) -> tuple[Target, list[FittedLevel]]:
        """Fit from the regressor's landmarks (n, 2), and weigh them in; return the target with them, and the levels."""
        assert self.regressor is not None
        deviation = self.regressor.left_out.deviation
        from_there = target._replace(start=landmarks)
        regressed = self.weighing_in(from_there, landmarks, self._regressor_precision, deviation)
        return regressed, self._levels_from_points(regressed, deviation, options)

    def _doubt_about(self, target: Target, shape: np.ndarray) -> tuple[float, np.ndarray | None]:
        """Return how far, and to which landmarks (n, 2), the regressor leads from the shape that a fit has reached.

        The squared distance is in units of its mean squared error on left-out images. From a right shape it leads to
        about the same; from a shape where it is of no use, infinitely far and to None.
        """
        assert self.regressor is not None
        if not is_sane(shape, target.start):
            return np.inf, None
        landmarks = self._regressed(target, shape)
        if landmarks is None:
            return np.inf, None
        pixel = align(self.shapes.mean, shape).scale
        deviation = pixel * self.regressor.left_out.deviation
        return float(np.square(landmarks - shape).sum(axis=1).mean() / deviation**2), landmarks

    @property
    def regressor(self) -> LandmarkRegressor | None:
        """The model's regressor, for methods that fit with the shapes that its landmarks are combined under."""
        regressor = self.model.regressor
        if regressor is None or regressor.shape_model is not self.shapes:
            return None
        return regressor

    @cached_property
    def _regressor_precision(self) -> np.ndarray | None:
        """Precision of the parameters of the regressor's landmarks, (n_p, n_p)."""
        return None if self.regressor is None else self.regressor.left_out.precision(self.shapes)

    def _first_level(self, largest_blur: float) -> int:
        """Return the index of the first level whose blur is not larger, or else of the sharpest."""
        for i, objective in enumerate(self.objectives):
            if objective.blur <= largest_blur:
                return i
        return len(self.objectives) - 1

    def _blurred_levels(self, target: Target, options: SolverOptions) -> list[FittedLevel]:
        """Fit all levels but the sharpest, or the only one.

        The last of these stops as early as in a whole fit. Those before it stop earlier than there, because their
        tolerances are loosened twice: here, and as those of coarse levels of this fit.
        """
        return self.coarse_to_fine.fit(target, coarse_options(options), last=max(1, len(self.objectives) - 1))

    def fit_blurred(self, target: Target, options: SolverOptions) -> Blurred:
        """Fit all levels but the sharpest."""
        return self._blurred(target, self._blurred_levels(target, options))

    def fit_coarsest(self, target: Target, options: SolverOptions) -> Blurred:
        """Fit the coarsest level of at least two."""
        return self._blurred(target, self.coarse_to_fine.fit(target, coarse_options(options), last=1))

    def fit_other_blurred(self, fit: Blurred, options: SolverOptions) -> Blurred:
        """Fit the blurred levels that remain, from the shape that the others have reached."""
        n_blurred = len(self.objectives) - 1
        n_fitted = len(fit.stages)
        if not n_fitted or n_fitted >= n_blurred:
            return fit
        from_there = fit.target._replace(start=fit.shape, margin=NEAR)
        others = self.coarse_to_fine.fit(from_there, coarse_options(options), first=n_fitted, last=n_blurred)
        return self._blurred(fit.target, [*fit.stages, *others])

    def _blurred(self, target: Target, stages: list[FittedLevel]) -> Blurred:
        """Judge a fit at blurred levels."""
        shape = stages[-1].reached
        if self.reliability is None or not is_sane(shape, target.start):
            return Blurred(target, stages=[], shape=target.start, quality=0.0)
        return Blurred(target, stages, shape, quality=self.judge.quality_of(stages[-1]))

    def fit_sharpest(self, fit: Blurred, options: SolverOptions) -> FitResult:
        """Fit the sharpest level, from the shape that the others have reached."""
        if len(self.objectives) == 1 or not fit.stages:
            return self.fit_target(fit.target, options)
        return self.fit_after(fit.target, fit.stages, options)

    def fit_after(self, target: Target, stages: Sequence[FittedLevel], options: SolverOptions) -> FitResult:
        """Fit the last level of at least two, from the shape that the others have reached."""
        shape = stages[-1].reached
        if self.regressor is not None:
            regressed = self._fit_regressed(target._replace(start=shape), options)
            if regressed is not None:
                return regressed
        from_there = target._replace(start=shape, margin=NEAR)
        last = self.coarse_to_fine.fit(from_there, options, first=len(self.objectives) - 1)
        return self.result_of(target, [*stages, *last])

    def result_of(self, target: Target, stages: Sequence[FittedLevel], doubt: float = 0.0) -> FitResult:
        """Make the result of a fit from its levels; see :meth:`liaam.fitting.quality.Judge.result_of`."""
        return self.judge.result_of(target, stages, doubt)

    def refined(self, target: Target, result: FitResult) -> FitResult:
        """Return the result of a fit with the landmarks that the model's refiner leads to; itself if there is none.

        The fit itself, and so its quality, stays. Of several fits only the one that is returned needs it. Absent
        landmarks follow from the others.
        """
        refiner = self.model.refiner
        if refiner is None or result.at_start or result.status.lost:
            return result
        refined = refiner.refined(
            target.image, target.linear.response, result.registered, absent=result.absent, grey=target.linear.grey
        )
        if not is_sane(refined, result.registered):
            return result
        landmarks = expanded_about(self.shapes.mean, refined, result.expansion)
        return replace(result, landmarks=landmarks, shift=landmarks - result.registered)
