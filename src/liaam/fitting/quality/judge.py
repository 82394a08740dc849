"""From the levels of a fit to its result: status, quality, covariances, and which landmarks are present."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from liaam.fitting.loop.levels import FittedLevel, Target
from liaam.fitting.loop.objective import Objective
from liaam.fitting.loop.options import SolverOptions, scored
from liaam.fitting.methods import METHODS, Method, get_method
from liaam.fitting.quality.features import explains_more_than_noise, quality_features
from liaam.fitting.quality.presence import Surroundings
from liaam.fitting.quality.status import status_of
from liaam.fitting.quality.uncertainty import covariance, expanded_covariance, landmark_covariances
from liaam.fitting.result import LEAST_QUALITY, FitResult, FitStatus, trace
from liaam.model import AAM, Reliability
from liaam.model.presence import Presence
from liaam.model.shape import ShapeModel, own_parameters

# Number of steps beyond which a fit of low quality is restarted, even if its status is not doubtful. Correct fits may
# have low quality in harder light than that of training, but take about 15 steps; 11 wrong ones took 27 and more.
SLOW = 25


@dataclass(frozen=True, eq=False)
class Calibration:
    """What training has learnt of the fits of a method to left-out images.

    Attributes
    ----------
    reliability : Reliability, optional
        Calibration of quality and covariances; None if training has not calibrated the method.
    is_failing : bool
        Whether too few fits to left-out images were right to calibrate it.
    """

    reliability: Reliability | None = None
    is_failing: bool = False

    @classmethod
    def of(cls, model: AAM, method: str | Method, options: SolverOptions) -> "Calibration":
        """Return the calibration of a method of a model, by the method's values rather than by its name."""
        row = scored(get_method(method), options)
        view = model.views.get(row.view)
        reliabilities = {} if view is None else view.reliabilities
        reliability = next((each for name, each in reliabilities.items() if METHODS.get(name) == row), None)
        is_failing = any(METHODS.get(name) == row for name in model.failing_methods)
        return cls(reliability, is_failing)

    @property
    def final_prior(self) -> float:
        """Weight of the prior on the shape at the finest level, as the model has learnt it."""
        return 1.0 if self.reliability is None else self.reliability.final_prior

    @property
    def presence(self) -> Presence | None:
        """Calibration of whether landmarks are present; None if training has not learnt it for the method."""
        return None if self.reliability is None else self.reliability.presence


@dataclass(frozen=True, eq=False)
class Judge:
    """Makes the results of fits from their levels.

    Attributes
    ----------
    model : AAM
        A model of one shape.
    sharpest : Objective
        The objective of the sharpest level.
    options : SolverOptions
    calibration : Calibration
    """

    model: AAM
    sharpest: Objective
    options: SolverOptions
    calibration: Calibration

    @property
    def shapes(self) -> ShapeModel:
        """The shape model that the method fits with."""
        return self.model.views[self.sharpest.method.view].shape_model

    @cached_property
    def surroundings(self) -> Surroundings:
        """Windows in which image and fit are compared at the sharpest level."""
        return Surroundings(self.sharpest)

    def reliability_for(self, result: FitResult) -> Reliability | None:
        """Return the calibration if it says something about a fit: not if that was limited to few iterations."""
        if result.status.unusable or self.is_limited:
            return None
        return self.calibration.reliability

    @property
    def is_limited(self) -> bool:
        """Whether fits are limited to few iterations, so that a low quality does not say that another is better."""
        return self.options.max_iterations <= SLOW

    def falls_short(self, result: FitResult) -> bool:
        """Return whether a fit has low quality, so that another start may be better."""
        reliability = self.reliability_for(result)
        if reliability is None:
            return False
        least = LEAST_QUALITY
        if result.n_iterations > SLOW:
            least = max(least, reliability.low)
        return result.quality < least

    def quality_of(self, stage: FittedLevel) -> float:
        """Return the quality of a fit that ends with a level, as if it had not failed; 0 if it is not calibrated."""
        reliability = self.calibration.reliability
        return 0.0 if reliability is None else reliability.quality(quality_features(stage))

    def result_of(self, target: Target, stages: Sequence[FittedLevel], doubt: float = 0.0) -> FitResult:
        """Make the result of a fit from its levels: compute status, quality and covariances.

        ``doubt`` is the squared distance to where the model's regressor leads from there, in its mean squared error.
        """
        last = stages[-1]
        history = trace(stages)
        solution = last.solution
        method = last.objective.method
        reliability = self.calibration.reliability

        fitted_p = np.zeros(len(self.shapes.basis))  # the last level may have fewer modes
        fitted_p[own_parameters(len(solution.p), len(fitted_p))] = solution.p
        theta_model, theta = solution.angles if method.has_angles else (np.nan, np.nan)

        spread = self._spread(target, last)
        landmarks = history[-1].landmarks
        shift = None
        p = fitted_p
        expansion = 1.0 if reliability is None else reliability.expansion
        if expansion > 1.0:
            p = self.shapes.expanded(fitted_p, expansion)
            spread = expanded_covariance(spread, len(p), expansion)
            shift = last.pose(self.shapes.shape(p)) - landmarks
            landmarks = landmarks + shift
        residual_variance = last.objective.noise_variance(solution)
        result = FitResult(
            landmarks=landmarks,
            status=status_of(target.linear, history, last, self.model, self.shapes),
            theta=float(theta),
            theta_model=float(theta_model),
            p=p,
            pose=last.pose,
            lam=solution.lam,
            cost=float(solution.costs[-1]),
            n_iterations=sum(stage.solution.n_iterations for stage in stages),
            history=history,
            covariance=spread,
            landmark_covariances=landmark_covariances(
                self.shapes,
                pose=last.pose,
                p=p,
                spread=spread,
                contours=self.model.contours,
                reliability=reliability,
                unit=residual_variance,
            ),
            residual_variance=residual_variance,
            evidence=quality_features(last, doubt),
            quality=np.nan,
            method=method,
            expansion=expansion,
            shift=shift,
            present=self._present_in(last),
            without_colour=method.encoding == "soft" and self.model.is_colour and target.linear.grey,
        )
        return self._with_quality(result, last)

    def _spread(self, target: Target, last: FittedLevel) -> np.ndarray:
        """Return the covariance of (p, free angles) at the last level, (n_q, n_q) float64, with all modes."""
        strength = self.options.shape_prior / last.solution.prior_scale
        spread = covariance(last, whole=self.sharpest, strength=strength, pull=target.pull)
        reliability = self.calibration.reliability
        return spread if reliability is None else reliability.variance_factor * spread

    def _with_quality(self, result: FitResult, last: FittedLevel) -> FitResult:
        """Return a result with its quality, doubtful if that is low.

        Also without calibration, a fit is doubtful that explains nothing, or whose like were wrong in training.
        """
        reliability = self.calibration.reliability
        quality = np.nan
        if reliability is None:
            explains = explains_more_than_noise(last)
        else:
            quality = 0.0 if result.status.lost else reliability.quality(result.evidence)
            explains = result.evidence[0] > 0.0
        status = result.status
        if status.ok and (quality < LEAST_QUALITY or not explains or self.calibration.is_failing):
            status = FitStatus.DOUBTFUL
        return replace(result, quality=quality, status=status)

    def _present_in(self, stage: FittedLevel) -> np.ndarray | None:
        """Return the probability that each landmark is present, (n,); None if the fit does not say."""
        presence = self.calibration.presence
        if presence is None or stage.objective.blur != self.sharpest.blur:
            return None
        return self.surroundings.probabilities(presence, stage.solution)
