"""Fitting a model to an image: preparation, start, solution, and status."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import ImageError, StartError, check_options
from liaam.fitting.angles import best_image_angle
from liaam.fitting.level_image import MARGIN, NEAR, LevelImage
from liaam.fitting.levels import CompiledLevels, FittedLevel, LinearImage, Target, is_sane, solve_levels
from liaam.fitting.methods import DEFAULT_METHOD, METHODS, Method, get_method
from liaam.fitting.objective import Objective, State, make_objectives
from liaam.fitting.picture import load_picture
from liaam.fitting.restarts import other_starts
from liaam.fitting.result import LEAST_QUALITY, FitResult, FitStatus, Iteration, trace
from liaam.fitting.search import DOUBTFUL, LARGE, Detection, Finder, are_apart
from liaam.fitting.solver import SolverOptions, scored
from liaam.fitting.start import mapped_points, part_of_start, start_shape
from liaam.fitting.uncertainty import covariance, explains_more_than_noise, landmark_covariances, quality_features
from liaam.model import AAM, Level, Reliability, View
from liaam.model.mesh import folded_share
from liaam.model.sampling import within
from liaam.model.shape import ShapeModel, align, diagonal_of
from liaam.photometry import CameraModel, exposure_faults, is_grey
from liaam.photometry.camera import check_camera
from liaam.photometry.encoding import refuse_unscaled, stored_values

FOLD_LIMIT = 0.3
"""Fraction of the mesh's area flipped beyond which a fit has diverged."""

SHAPE_LIMIT = 5.0
"""Standard deviations of a shape mode beyond which a fit has diverged, plus half a model pixel, since a few training
images underestimate the variance."""

AROUND_BOX, LEAST_REGION = 0.3, 16
"""Margin searched around a box given as a start, as a fraction of its sides, and the smallest width in pixels. A box,
as of a detector, is approximate; a shape given as a start is not searched for."""

SLOW = 25
"""Number of steps beyond which a fit of low quality is restarted, even if its status is not doubtful. Correct fits may
have low quality in harder light than that of training, but converge in about 15 steps. The fastest of 11 wrong fits of
unseen persons of IMM took 27."""

BRIEF = 12
"""Largest number of steps per level of fits to other detections. Right fits take fewer; wrong ones, and most are, take
up to ``max_iterations``. Photographs without a face take two thirds of the time, and nothing is lost. (Fits to only two
or three of the detections, by their quality at the other levels, lose one in a hundred faces under hard light.)"""

REACH = 0.35
"""Largest blur of the levels that a fit from another landmarker's points uses, as a multiple of the points' root mean
square error on left-out images. Measured on the spot protocol with simulated points, on average 5, 10 and 20 % of the
distance between the eyes off: errors as with all levels, within 0.1 %."""

MAPPED_TOLERANCE = 1.0
"""``SolverOptions.early_tolerance`` of these fits, unless it is set: a start of known precision needs fewer steps. On
the spot protocol two steps instead of three, and the same errors within 0.1 %."""

USABLE_LIMIT = 0.25
"""Fraction of the object's pixels that must be usable."""


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
        return self.finder.find_in(self._linear(load_picture(image, name)[0]), limit=limit, least=least)

    def _linear(self, image: np.ndarray) -> LinearImage:
        return LinearImage(self._camera.flatten(image), self._camera.response)

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
        path = _path_of(image)
        parts = self._parts_for(init, name)
        if len(parts) > 1:
            image, name = load_picture(image, name)  # once for all
        firsts = []
        for part in parts:
            target, found = part.target(image, init, name)
            firsts.append((part._fit_from(target), part, target, found))
        results = []
        for first, part, target, found in sorted(firsts, key=lambda each: _explained(each[0]), reverse=True):
            results.append(replace(part._completed(first, target, found, init), part=self.parts.index(part)))
            if results[-1].status.ok:
                break
        result = max(results, key=lambda each: (each.status.ok, np.nan_to_num(each.quality), _explained(each)))
        return replace(result, image=path)

    def fit_all(self, image, name: str = "image") -> list[FitResult]:
        """Fit every object that the search finds in an image, the best detection first.

        Raises
        ------
        ImageError, StartError
            For invalid input, and if no object is found.
        """
        path = _path_of(image)
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

    def _completed(self, result: FitResult, target: Target, found: Detection | None, init) -> FitResult:
        """Look elsewhere and start again if a first fit has low quality; see :meth:`fit`."""
        prior, region = 1.0, self._region(init, target.image)
        if region is not None and self._has_quality(result):
            result, prior, target, found = self._likeliest(target, result, found, region)
        if self.restarts and self._falls_short(_with_prior(result, prior)):
            result = self._fit_again(target, result)
        result, model, known = _with_prior(result, prior), self.model, self.reliability
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
        levels = self._pairs[first:]
        if CompiledLevels.can_fit(levels) and CompiledLevels.can_take(target, options):
            return self.result_of(target, self._compiled(first).fit(target, options))
        return self.result_of(target, solve_levels(levels, target, options))

    @cached_property
    def _pairs(self) -> list[tuple[Objective, float]]:
        """Objectives and blurs of the levels, coarse to fine."""
        return [(objective, level.blur) for objective, level in zip(self.objectives, self._levels, strict=True)]

    @cached_property
    def _prepared(self) -> dict[int, CompiledLevels]:
        return {}

    def _compiled(self, first: int) -> CompiledLevels:
        """Return the levels from one on, prepared for the core."""
        if first not in self._prepared:
            self._prepared[first] = CompiledLevels(self._pairs[first:], self.shapes)
        return self._prepared[first]

    def __getstate__(self) -> dict:
        """Leave out what the core holds, which is valid in this process only."""
        return {name: value for name, value in self.__dict__.items() if name != "_prepared"}

    def _falls_short(self, result: FitResult) -> bool:
        """Return whether a fit has low quality, so that another start may be better."""
        least = max(LEAST_QUALITY, self._low) if result.n_iterations > SLOW else LEAST_QUALITY
        return self._has_quality(result) and result.quality < least

    def _has_quality(self, result: FitResult) -> bool:
        """Return whether the quality is meaningful: it is known, and the fit was not limited to few iterations."""
        short = self.options.max_iterations <= SLOW
        return self.reliability is not None and not result.status.unusable and not short

    @property
    def _low(self) -> float:
        return 0.0 if self.reliability is None else self.reliability.low

    def _region(self, init, image: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the corners of the region to search: all without a start, around a box, None for a shape."""
        limits = np.array(image.shape[1::-1])
        if init is None:
            return np.zeros(2, int), limits
        if not self.restarts or isinstance(init, Detection) or np.shape(getattr(init, "points", init)) != (4,):
            return None
        low, high = np.asarray(init, np.float64).reshape(2, 2)
        low, high = low - AROUND_BOX * (high - low), high + AROUND_BOX * (high - low)
        low = np.clip(low, 0, limits - LEAST_REGION).astype(int)
        return low, np.clip(np.ceil(high).astype(int), low + LEAST_REGION, limits)

    def _likeliest(
        self, target: Target, first: FitResult, found: Detection | None, region: tuple[np.ndarray, np.ndarray]
    ) -> tuple[FitResult, float, Target, Detection | None]:
        """Return the most likely fit in a region, the factor on its odds, and its start.

        The prior of a place is proportional to its area, because there are more small places than large ones. If the
        first fit has low quality, other detections are fitted too. At most one is the object, so each other likely one
        lowers the odds.
        """
        tried, (low, high) = [(first, target, found)], region
        large = LARGE * float((high - low).min())

        def prior(result: FitResult) -> float:
            return (diagonal_of(result.landmarks) / large) ** 2 if result.quality > 0 else 0.0

        if not _with_prior(first, min(prior(first), 1.0)).quality >= self._low:
            brief = replace(self.options, max_iterations=BRIEF)
            for other in self.finder.others_in(target.linear.crop(low, high)):
                there = target._replace(start=other.landmarks + low)
                tried.append((self._fit_from(there, brief), there, found and replace(other, others=found.others)))
        unfinished = {i for i, (each, *_) in enumerate(tried) if i and each.status is FitStatus.MAX_ITERATIONS}
        while True:
            odds = [prior(each) * _odds(each.quality) for each, *_ in tried]
            at = int(np.argmax(odds))
            best, its_target, its_start = tried[at]
            if at not in unfinished:
                break
            unfinished.remove(at)
            tried[at] = self._fit_from(its_target), its_target, its_start
        others = sum(o for o, (each, *_) in zip(odds, tried, strict=True) if are_apart(best.landmarks, each.landmarks))
        own = prior(best)
        shared = own / (own + others) if own > 0 else 1.0
        return replace(best, n_starts=len(tried)), min(own, 1.0) * shared, its_target, its_start

    def _fit_again(self, target: Target, first: FitResult) -> FitResult:
        """Return the best fit by quality, of the first and those from other starts; stop at a typical quality."""
        known, best, n_starts = self.reliability, first, first.n_starts
        for start in other_starts(self.objectives[0], self._levels[0].blur, target, self.options):
            other, n_starts = self._fit_from(target._replace(start=start)), n_starts + 1
            if other.quality > best.quality and is_sane(other.landmarks, target.start):
                best = other
            if known is not None and best.quality >= known.typical:
                break
        return replace(best, n_starts=n_starts)

    def target(self, image, init=None, name: str = "image") -> tuple[Target, Detection | None]:
        """Check image and start (see :meth:`fit`); return them as a target, and the detection if there was a search."""
        image, name = load_picture(image, name)
        refuse_unscaled(image, name, self._camera.response)
        # An image of one value (black, white) is not refused: the status of its fit is more specific.
        if self._method.needs_colour and is_grey(image) and np.ptp(stored_values(image)) > 0:
            raise ImageError(
                f"{name}: the image is grey (three equal channels), but method {self._method.name} "
                "compares colours; use method 'soft-li' or 'grey'"
            )
        camera, linear = self._camera, self._linear(image)
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

    def solution_at(self, image, result: FitResult) -> dict[str, Any]:
        """Evaluate a result at all pixels of the sharpest level, with the best lambda there.

        Parameters
        ----------
        image : (h, w, 3) array or path
            The fitted image.
        result : FitResult
            Result of this or another method.

        Returns
        -------
        dict
            Arrays of :meth:`liaam.fitting.reference.Problem.arrays` at the shape and angles of ``result``.
        """
        if self.model.others:
            return self.part_for(result).solution_at(image, result)
        objective, encoded, state = self._end_of(result, image)
        if self._method.free_angles == "image" and not np.isfinite(result.theta):
            state = state._replace(angles=np.array([state.angles[0], best_image_angle(objective, encoded, state)]))
        weigh = 0 if not self._method.reweighs else 1 if self._method.loss == "squares" else 3
        return objective.evaluate(encoded, state, weigh=weigh, solves=True)

    def residual(self, image, result: FitResult) -> tuple[np.ndarray, np.ndarray]:
        """Compute the residual (paper eq 10) in the method's encoding, at all pixels of the sharpest level.

        Parameters
        ----------
        image : (h, w, 3) array or path
            The fitted image.
        result : FitResult
            Result of this fitter.

        Returns
        -------
        residual : (n_pixels, k) float32
            Image minus model, in the raster order of the frame of :attr:`view`; 0 at unusable pixels. Of a model of
            several shapes, :meth:`part_for` gives the fitter with that view.
        usable : (n_pixels,) float32
            1 at usable pixels, else 0.
        """
        if self.model.others:
            return self.part_for(result).residual(image, result)
        kept, k = self.view.warp.every(0.0), self._method.n_rows
        residual, usable = np.zeros((len(kept), k), np.float32), np.zeros(len(kept), np.float32)
        if np.isfinite(result.landmarks).all():
            objective, encoded, state = self._end_of(result, image)
            if len(result.lam) == objective.n_lambda:  # else the fit did not reach the sharpest level
                state = state._replace(lam=result.lam)
            seen = objective.evaluate(encoded, state, weigh=int(self._method.normalise))
            usable[kept] = seen["usable"]
            residual[kept] = np.where(seen["usable"][:, None] > 0, seen["residual"].reshape(-1, k), 0.0)
        return residual, usable

    def _end_of(self, result: FitResult, image) -> tuple[Objective, LevelImage, State]:
        """Return the objective over all pixels of the sharpest level, its image, and a result's state (lambda 0)."""
        linear = self._linear(load_picture(image, "image")[0])
        objective, blur, noise = self.objectives[-1].of_all_pixels, self._levels[-1].blur, self._camera.noise
        about = self._method, linear.response, blur, noise, MARGIN, objective.density
        encoded = LevelImage.at(linear.image, result.landmarks, result.pose, *about)
        # From the shape, because p refers to the shape model of the fit's method, which may be another one.
        state = objective.start(self.shapes.parameters(result.pose.inverse()(result.landmarks)))
        if self._method.has_angles and np.isfinite(result.theta):
            state = state._replace(angles=np.array([result.theta_model, result.theta]))
        return objective, encoded, state

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
        """Calibration of quality and covariances; None unless the method is the one that training calibrates."""
        return self.view.reliability if self._method == METHODS[DEFAULT_METHOD] else None

    @property
    def _camera(self) -> CameraModel:
        return self.model.camera if self.camera is None else self.camera

    def result_of(self, target: Target, stages: Sequence[FittedLevel]) -> FitResult:
        """Make the result of a fit from its levels: compute status, quality and covariances."""
        stage, known, history = stages[-1], self.reliability, trace(stages)
        solution, p, lam = stage.solution, stage.solution.p, stage.solution.lam
        theta_model, theta = solution.angles if self._method.has_angles else (np.nan, np.nan)
        spread = covariance(stage, self.options.shape_prior / solution.prior_scale, target.pull)
        spread = spread if known is None else known.variance_factor * spread
        seen = quality_features(stage)
        status, unit = self._status(target.image, history, stage), stage.objective.noise_variance(solution)
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
            landmark_covariances=landmark_covariances(self.shapes, stage.pose, spread, known, unit),
            residual_variance=unit,
            evidence=seen,
            quality=quality,
            method=self._method,
        )

    def _status(self, image: np.ndarray, history: tuple[Iteration, ...], stage: FittedLevel) -> FitStatus:
        shape, objective, solution = history[-1].landmarks, stage.objective, stage.solution
        usable, sane = solution.usable, is_sane(shape, history[0].landmarks)
        if not usable.all() and np.isfinite(shape).all():  # some pixels are outside the image, dark or saturated
            points = stage.pose(objective.warp.points(solution.p))
            inside = within(points, image)
            if sane and inside.mean() < 0.5:
                return FitStatus.LEFT_IMAGE
            # Few usable pixels are a better reason than the size that a fit to them happens to reach. Pixels beyond the
            # patch do not count: they are not usable, whatever their exposure.
            on_patch, (height, width) = stage.to_patch(points), stage.patch_size
            inside &= np.asarray(((on_patch >= 0) & (on_patch <= (width - 1, height - 1))).all(axis=1))
            if inside.any() and usable[inside].mean() < USABLE_LIMIT:
                return self._why_unusable(image, points[inside])
        if (
            not sane
            or folded_share(shape, self.model.triangles) > FOLD_LIMIT
            or self._largest_mode(shape) > SHAPE_LIMIT
        ):
            return FitStatus.DIVERGED
        if solution.flat:
            return FitStatus.NO_TEXTURE
        if not solution.converged:
            return FitStatus.MAX_ITERATIONS
        return FitStatus.LIGHT_UNOBSERVABLE if solution.held else FitStatus.CONVERGED

    def _largest_mode(self, shape: np.ndarray) -> float:
        """Return the largest shape mode in standard deviations, after alignment to the mean shape."""
        shape_model = self.shapes
        upright = align(shape, shape_model.mean)(shape)
        # Modes are orthonormal over all landmarks: half a pixel at each is sqrt(n) / 2.
        allowed = np.sqrt(shape_model.eigenvalues) + 0.5 * np.sqrt(shape_model.n_points) / SHAPE_LIMIT
        return float((np.abs(shape_model.parameters(upright)[:-4]) / allowed).max(initial=0.0))

    def _why_unusable(self, image: np.ndarray, points: np.ndarray) -> FitStatus:
        """Return whether most unusable pixels are without values, dark or saturated."""
        x, y = np.rint(points).astype(int).T
        pixels = image[y, x]
        valid = np.isfinite(pixels).all(axis=1)
        dark, clipped = exposure_faults(pixels[valid]) if valid.any() else (0.0, 0.0)
        if 1.0 - valid.mean() >= max(dark, clipped) * valid.mean():
            return FitStatus.NO_TEXTURE
        return FitStatus.TOO_DARK if dark >= clipped else FitStatus.SATURATED


def _explained(result: FitResult) -> float:
    """Return the fraction of the image that a fit explains, by which fits of different shapes are compared."""
    return -np.inf if result.status.lost else float(np.nan_to_num(result.evidence[0], nan=-np.inf))


def _odds(probability: float) -> float:
    return probability / max(1.0 - probability, 1e-9)


def _path_of(image) -> Path | None:
    return Path(image).absolute() if isinstance(image, (str, os.PathLike)) else None


def _with_prior(result: FitResult, prior: float) -> FitResult:
    """Return a result whose odds of being right are multiplied by the prior odds of its place, at most 1."""
    if prior == 1.0:
        return result
    odds = prior * _odds(result.quality)
    quality = odds / (1.0 + odds)
    doubtful = result.status.ok and quality < LEAST_QUALITY
    return replace(result, quality=quality, status=FitStatus.DOUBTFUL if doubtful else result.status)
