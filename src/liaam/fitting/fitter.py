"""Fitting a model to an image: preparation, start, solution, and status."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from liaam.errors import ImageError, StartError, check_options
from liaam.fitting.detection import DOUBTFUL, Detection
from liaam.fitting.level_image import MARGIN, NEAR
from liaam.fitting.levels import CompiledLevels, FittedLevel, LinearImage, Target, is_sane, solve_levels
from liaam.fitting.methods import DEFAULT_METHOD, METHODS, Method, get_method
from liaam.fitting.objective import Objective, make_objectives
from liaam.fitting.other_places import fit_blurred, fit_sharpest, likeliest
from liaam.fitting.picture import load_picture, path_of
from liaam.fitting.restarts import other_starts
from liaam.fitting.result import LEAST_QUALITY, FitResult, FitStatus, likeliness, trace, with_prior
from liaam.fitting.search import Finder
from liaam.fitting.solver import SolverOptions, scored
from liaam.fitting.start import mapped_points, part_of_start, region_of, start_shape
from liaam.fitting.status import status_of
from liaam.fitting.uncertainty import covariance, explains_more_than_noise, landmark_covariances, quality_features
from liaam.model import AAM, Level, Reliability, View
from liaam.model.shape import ShapeModel, own_parameters
from liaam.photometry import CameraModel, is_grey
from liaam.photometry.camera import check_camera
from liaam.photometry.encoding import refuse_unscaled, stored_values

SLOW = 25
"""Number of steps beyond which a fit of low quality is restarted, even if its status is not doubtful. Correct fits may
have low quality in harder light than that of training, but take about 15 steps; 11 wrong ones took 27 and more."""

REACH = 0.35
"""Largest blur of the levels that a fit from another landmarker's points uses, as a multiple of the points' root mean
square error on left-out images. Measured on the spot protocol with simulated points, on average 5, 10 and 20 % of the
distance between the eyes off: errors as with all levels, within 0.1 %."""

MAPPED_TOLERANCE = 1.0
"""``SolverOptions.early_tolerance`` of these fits, unless it is set: a start of known precision needs fewer steps. On
the spot protocol two steps instead of three, and the same errors within 0.1 %."""


@dataclass(frozen=True, eq=False)
class Fitter:
    """A model and a method, prepared for fitting many images.

    Attributes
    ----------
    model : AAM
    method : str or Method
        A name of :data:`liaam.fitting.METHODS`, or a custom row.
    options : SolverOptions
    camera : CameraModel, optional
        Camera of the images to be fitted: response, vignetting, noise, and the angle if the method does not estimate
        it. By default the training camera.
    margin : float
        Margin around a start that fits may use, as a fraction of the object's diagonal; less for accurate starts.
    restarts : bool
        Restart fits that are doubtful, or slow and of low quality (:attr:`liaam.model.Reliability.low`), from other
        shapes (:func:`liaam.fitting.restarts.other_starts`), and keep the fit of highest quality. This finds more
        turned heads, at about ten times the time of a fit. It has no effect for methods and models without a quality,
        or if ``max_iterations`` is at most 25.
    rotations : {"upright", "all"}
        Rotations to search for: about as in the training images, or any.

    Examples
    --------
    >>> fitter = Fitter(model)                                          # doctest: +SKIP
    >>> results = [fitter.fit(image, box) for image, box in pictures]   # doctest: +SKIP
    """

    model: AAM
    method: str | Method = DEFAULT_METHOD
    options: SolverOptions = field(default_factory=SolverOptions)
    camera: CameraModel | None = None
    margin: float = MARGIN
    restarts: bool = True
    rotations: str = "upright"

    @classmethod
    def of(
        cls,
        model: AAM,
        method: str | Method = DEFAULT_METHOD,
        *,
        camera: CameraModel | None = None,
        margin: float = MARGIN,
        restarts: bool = True,
        rotations: str = "upright",
        **options,
    ) -> "Fitter":
        """Make a fitter from its own fields and those of :class:`SolverOptions`, all by name."""
        own = ("camera", "rotations", "restarts", "margin")
        check_options(options, [*own, *(option.name for option in fields(SolverOptions))])
        return cls(model, method, SolverOptions(**options), camera, margin, restarts, rotations)

    def __post_init__(self) -> None:
        self.finder  # noqa: B018 (raise errors now, not at the first image)
        if self.camera is not None:
            check_camera(self.camera)
        for part in self.parts:
            part.objectives  # noqa: B018

    @cached_property
    def objectives(self) -> tuple[Objective, ...]:
        """The objectives of model and method, one per level, coarse to fine."""
        return make_objectives(self.model, scored(get_method(self.method), self.options))

    @cached_property
    def finder(self) -> Finder:
        """The model's detector (see :mod:`liaam.fitting.search`)."""
        return Finder(self.model, self.rotations)

    @property
    def _method(self) -> Method:
        return self.objectives[0].method

    def find(self, image, *, limit: int | None = 1, least: float = 0.0, name: str = "image") -> list[Detection]:
        """Find the object in an image (see :func:`liaam.fitting.search.find`).

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float array, or path
        limit : int or None
            Largest number of objects; None for all.
        least : float
            Minimum score.
        name : str
            Name of the image in errors; for a path its file name is used.

        Returns
        -------
        list of Detection
            Starts for :meth:`fit`, the best first.
        """
        return self.finder.find_in(self.linear(load_picture(image, name)[0]), limit=limit, least=least)

    def linear(self, image: np.ndarray) -> LinearImage:
        """Return an image in linear light, without the vignetting of its camera."""
        return LinearImage(self.image_camera.flatten(image), self.image_camera.response)

    def find_all(self, image, name: str = "image") -> list[Detection]:
        """Find all objects in an image, without uncertain detections.

        Raises
        ------
        StartError
            If there are none; the message has the best score.
        """
        image, name = load_picture(image, name)
        found = self.find(image, limit=None, name=name)
        sure = [detection for detection in found if not detection.doubtful]
        if not sure:
            raise StartError(
                f"{name}: no object was found (the best score is {found[0].score:.2f}, {DOUBTFUL:g} is needed); "
                "give a start (--init), search for rotated objects (--rotations all), or fit the best place anyway "
                "(without --all)"
            )
        return sure

    def fit(self, image, init=None, name: str = "image") -> FitResult:
        """Fit the model to one image.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float array, or path
        init : (n, 2) shape, (m, 2) points, (x0, y0, x1, y1) box, (x, y, diagonal), or Detection, optional
            Start, image pixels (see :func:`liaam.fitting.start.start_shape`). By default the object is searched for,
            and ``result.found`` has the score. A box may be approximate: if the fit from it has low quality, the object
            is searched for around it. The m points of another landmarker, if the model was trained with such points,
            are mapped to the landmarks, and weighed in with the covariance of their errors.
        name : str
            Name of the image in errors; for a path its file name is used.

        Returns
        -------
        FitResult
            Also if the fit fails: see its ``status``.

        Raises
        ------
        ImageError, StartError
            For invalid input.
        """
        path = path_of(image)
        parts = self._parts_for(init, name)
        if len(parts) > 1:
            image, name = load_picture(image, name)  # once for all
        firsts = []
        for part in parts:
            target, found = part.target(image, init, name)
            firsts.append((part._fit_from(target), part, target, found))
        results = []
        for first, part, target, found in sorted(firsts, key=lambda each: likeliness(each[0]), reverse=True):
            results.append(replace(part._completed(first, target, found, init), part=self.parts.index(part)))
            if results[-1].status.ok:
                break
        result = max(results, key=lambda each: (each.status.ok, *likeliness(each)))
        return replace(result, image=path)

    def fit_all(self, image, name: str = "image") -> list[FitResult]:
        """Fit every object that the search finds in an image, the best detection first.

        Raises
        ------
        ImageError, StartError
            For invalid input, and if no object is found.
        """
        path = path_of(image)
        image, name = load_picture(image, name)
        return [replace(self.fit(image, found, name), image=path) for found in self.find_all(image, name)]

    def _parts_for(self, init, name: str) -> tuple["Fitter", ...]:
        """Return the fitters of the shapes that a start may belong to."""
        given = init.landmarks if isinstance(init, Detection) else init
        own = part_of_start(self.model, given, name)
        return self.parts if own is None else self.parts[own : own + 1]

    @property
    def parts(self) -> tuple["Fitter", ...]:
        """A fitter for each shape of the model: in general only this one."""
        return self._several or (self,)

    @cached_property
    def _several(self) -> tuple["Fitter", ...]:
        return tuple(replace(self, model=part) for part in self.model.parts) if self.model.others else ()

    def part_for(self, fit: FitResult | np.ndarray) -> "Fitter":
        """Return the fitter of the model's part that made a fit, or to which a shape (n, 2) belongs."""
        if not self._several:
            return self
        return self.parts[fit.part if isinstance(fit, FitResult) else self.model.part_of(fit)]

    def lit_part_for(self, fit: FitResult) -> "Fitter":
        """Return the part that relights a fit: that which made it, or the first one if only that has learnt light."""
        part, first = self.part_for(fit), self.parts[0]
        return first if part.model.light is None and first.model.light is not None else part

    def _completed(self, result: FitResult, target: Target, found: Detection | None, init) -> FitResult:
        """Look elsewhere and start again if a first fit has low quality; see :meth:`fit`."""
        prior, known, region = 1.0, self._known_for(result), region_of(init, target.image)
        if known is not None and region is not None and (init is None or self.restarts):
            result, prior, (target, found) = likeliest(self, result, (target, found), region)
        if self.restarts and self._falls_short(with_prior(result, prior)):
            result = self._fit_again(target, result)
        result, model, known = with_prior(result, prior), self.model, self.reliability
        if known is not None and (found is None or not found.doubtful):
            likely = {"quality": known.with_prior(result.quality), "least_quality": known.with_prior(LEAST_QUALITY)}
            result = replace(result, **likely)
        return replace(result, found=found, contours=model.contours, landmark_names=model.landmark_names)

    def _fit_from(self, target: Target, options: SolverOptions | None = None) -> FitResult:
        options, points = self.options if options is None else options, self.model.points
        first = 0
        if target.pull is not None and points is not None:
            near = [i for i, level in enumerate(self._levels) if level.blur <= REACH * points.deviation]
            first = near[0] if near else len(self._levels) - 1
            early_tolerance = MAPPED_TOLERANCE if options.early_tolerance is None else options.early_tolerance
            options = replace(options, early_tolerance=early_tolerance)
        return self.result_of(target, self._solved(target, options, first))

    def _solved(
        self, target: Target, options: SolverOptions, first: int = 0, last: int | None = None
    ) -> list[FittedLevel]:
        """Fit the levels from one on, up to another."""
        levels = self._pairs[first:last]
        if not (CompiledLevels.can_fit(levels) and CompiledLevels.can_take(target, options)):
            return solve_levels(levels, target, options)
        if (first, last) not in self._prepared:
            self._prepared[first, last] = CompiledLevels(levels)
        return self._prepared[first, last].fit(target, options)

    @cached_property
    def _pairs(self) -> list[tuple[Objective, float]]:
        """Objectives and blurs of the levels, coarse to fine."""
        return [(objective, level.blur) for objective, level in zip(self.objectives, self._levels, strict=True)]

    @cached_property
    def _prepared(self) -> dict[tuple[int, int | None], CompiledLevels]:
        """Levels prepared for the core, by the first and the end."""
        return {}

    def __getstate__(self) -> dict:
        """Leave out what the core holds, which is valid in this process only."""
        return {name: value for name, value in self.__dict__.items() if name != "_prepared"}

    def _known_for(self, result: FitResult) -> Reliability | None:
        """Return the calibration if it says something about a fit: not if that was limited to few iterations."""
        return None if result.status.unusable or self.options.max_iterations <= SLOW else self.reliability

    def _falls_short(self, result: FitResult) -> bool:
        """Return whether a fit has low quality, so that another start may be better."""
        known = self._known_for(result)
        least = max(LEAST_QUALITY, known.low if known is not None and result.n_iterations > SLOW else 0.0)
        return known is not None and result.quality < least

    def _fit_again(self, target: Target, first: FitResult) -> FitResult:
        """Return the better fit by quality, of the first and the best from other starts."""
        starts = other_starts(self.objectives[0], self._levels[0].blur, target, self.options)
        if not starts:
            return first
        fits = [fit_blurred(self, target._replace(start=start), self.options) for start in starts]
        best = fit_sharpest(self, max(fits, key=lambda each: each.quality), self.options)
        better = best.quality > first.quality and is_sane(best.landmarks, target.start)
        return replace(best if better else first, n_starts=first.n_starts + len(fits))

    def target(self, image, init=None, name: str = "image") -> tuple[Target, Detection | None]:
        """Check image and start (see :meth:`fit`); return them as a target, and the detection if there was a search."""
        image, name = load_picture(image, name)
        refuse_unscaled(image, name, self.image_camera.response)
        # An image of one value (black, white) is not refused: the status of its fit is more specific.
        if self._method.needs_colour and is_grey(image) and np.ptp(stored_values(image)) > 0:
            raise ImageError(
                f"{name}: the image is grey (three equal channels), but method {self._method.name} "
                "compares colours; use method 'soft-li' or 'grey'"
            )
        camera, linear = self.image_camera, self.linear(image)
        init = self.finder.find_in(linear)[0] if init is None else init
        found = init if isinstance(init, Detection) else None
        given = init if found is None else found.landmarks
        mapped = mapped_points(self.model, given, name)
        start = start_shape(self.model, given if mapped is None else mapped, (image.shape[1], image.shape[0]), name)
        target = Target(linear, start, camera.noise, camera.theta, self.margin)
        points = self.model.points
        if mapped is None or points is None:
            return target, found
        margin = min(self.margin, NEAR + 2.0 * points.deviation / self.model.diagonal)
        return target._replace(mapped=mapped, pull=self._pull, margin=margin), found

    @cached_property
    def _pull(self) -> np.ndarray | None:
        """Precision of the parameters of landmarks that are mapped from another landmarker's points, (n_p, n_p)."""
        return None if self.model.points is None else self.model.points.precision(self.shapes)

    @property
    def _levels(self) -> tuple[Level, ...]:
        return self.view.levels

    @property
    def view(self) -> View:
        """The model's view that the method fits with."""
        return self.model.views[self._method.view]

    @property
    def shapes(self) -> ShapeModel:
        """The shape model that the method fits with."""
        return self.view.shape_model

    @property
    def reliability(self) -> Reliability | None:
        """Calibration of quality and covariances; None if training has not calibrated the method."""
        known = self.view.reliabilities
        return next((each for name, each in known.items() if METHODS.get(name) == self._method), None)

    @property
    def image_camera(self) -> CameraModel:
        """The camera of the images: :attr:`camera`, or else that of the training images."""
        return self.model.camera if self.camera is None else self.camera

    def result_of(self, target: Target, stages: Sequence[FittedLevel]) -> FitResult:
        """Make the result of a fit from its levels: compute status, quality and covariances."""
        stage, known, history = stages[-1], self.reliability, trace(stages)
        solution, lam, p = stage.solution, stage.solution.lam, np.zeros(len(self.shapes.basis))
        p[own_parameters(len(solution.p), len(p))] = solution.p
        theta_model, theta = solution.angles if self._method.has_angles else (np.nan, np.nan)
        spread = covariance(stage, self.objectives[-1], self.options.shape_prior / solution.prior_scale, target.pull)
        spread = spread if known is None else known.variance_factor * spread
        seen, unit = quality_features(stage), stage.objective.noise_variance(solution)
        status = status_of(target.image, history, stage, self.model, self.shapes)
        quality = np.nan if known is None else 0.0 if status.lost else known.quality(seen)
        # A fit that explains nothing is doubtful, also without calibration.
        explains = seen[0] > 0.0 if known is not None else explains_more_than_noise(stage)
        if status.ok and (quality < LEAST_QUALITY or not explains):
            status = FitStatus.DOUBTFUL
        return FitResult(
            landmarks=history[-1].landmarks,
            status=status,
            theta=float(theta),
            theta_model=float(theta_model),
            p=p,
            pose=stage.pose,
            lam=lam,
            cost=float(solution.costs[-1]),
            n_iterations=sum(stage.solution.n_iterations for stage in stages),
            history=history,
            covariance=spread,
            landmark_covariances=landmark_covariances(
                self.shapes, stage.pose, p, spread, self.model.contours, known, unit
            ),
            residual_variance=unit,
            evidence=seen,
            quality=quality,
            method=self._method,
        )
