"""Fitting an image: prepare, start, solve, judge."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from liaam.errors import ImageError, StartError
from liaam.fitting.angles import best_image_angle
from liaam.fitting.level import GAIN
from liaam.fitting.levels import Stage, Target, is_sane, solve_levels, trace
from liaam.fitting.methods import DEFAULT_METHOD, METHODS, Method, get_method
from liaam.fitting.objective import Objective, State, make_objectives
from liaam.fitting.picture import load_picture
from liaam.fitting.problem import MARGIN, FitProblem
from liaam.fitting.restarts import other_starts
from liaam.fitting.result import LEAST_QUALITY, FitResult, FitStatus, Iteration
from liaam.fitting.search import DOUBTFUL, LARGE, Candidate, Finder, are_apart
from liaam.fitting.solver import Solution, SolverOptions, scored, settle_lambda
from liaam.fitting.start import start_shape
from liaam.model import AAM, Level, Reliability, View
from liaam.model.mesh import folded_share
from liaam.model.shape import ShapeModel, Similarity, align, diagonal_of
from liaam.photometry import CameraModel, exposure_faults, is_grey
from liaam.photometry.encoding import stored_values

FOLD_LIMIT = 0.3
"""Share of the mesh turned over beyond which a fit has diverged."""

SHAPE_LIMIT = 5.0
"""Standard deviations of a shape mode beyond which a fit has diverged; half a model pixel is granted on top,
since a few training images understate the variance."""

AROUND_BOX, LEAST_REGION = 0.3, 16
"""What is searched around a box that is given as a start, as a share of its sides, and pixels across at least. A
detector's box tells about where and how large an object is; a shape is where to start."""

SLOW = 25
"""Steps beyond which a fit of little quality is begun again, though it is not doubtful. Right fits may have little
quality in a light that is harder than that of training, but settle in some 15 steps; of 11 strangers of IMM that ended
in a wrong place the soonest took 27."""

USABLE_LIMIT = 0.25
"""Share of the object's pixels that must be usable."""


@dataclass(frozen=True, eq=False)
class Fitter:
    """A model and a method, ready for many images: what can be worked out once is worked out once.

    Attributes
    ----------
    model : AAM
    method : str or Method
        A name of :data:`liaam.fitting.METHODS`, or a row of your own.
    options : SolverOptions
    kernel : {"fast", "reference"}
    camera : CameraModel, optional
        Camera of the images to be fitted, which gives response, vignetting, noise, and the angle where the
        method does not estimate it; the training camera if left out.
    margin : float
        Surroundings of a start that fits may visit, as a share of the object's diagonal: less where starts are near.
    restarts : bool
        Whether fits from a start that are doubtful, or slow and of little quality
        (:attr:`liaam.model.Reliability.little`), are begun again from elsewhere
        (:func:`liaam.fitting.restarts.other_starts`), of which the one of most quality is kept: more heads that are
        turned away are found, at some ten times the time of a fit. For methods and models that know no quality, and for
        fits of so few iterations that they say nothing, it makes no difference.
    rotations : {"upright", "all"}
        How objects that are searched for may lie: about as in the pictures of training, or turned in any way.

    Examples
    --------
    >>> fitter = Fitter(model)                                          # doctest: +SKIP
    >>> results = [fitter.fit(image, box) for image, box in pictures]   # doctest: +SKIP
    """

    model: AAM
    method: str | Method = DEFAULT_METHOD
    options: SolverOptions = field(default_factory=SolverOptions)
    kernel: str = "fast"
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
        kernel: str = "fast",
        **options,
    ) -> "Fitter":
        """Make a fitter from its own fields and those of :class:`SolverOptions`, all by name."""
        return cls(model, method, SolverOptions.of(**options), kernel, camera, margin, restarts, rotations)

    def __post_init__(self) -> None:
        self.objectives  # noqa: B018 (complain now, not at the first image)
        self.finder  # noqa: B018

    @cached_property
    def objectives(self) -> tuple[Objective, ...]:
        """The model seen through the method, one objective per level, coarse to fine."""
        return make_objectives(self.model, scored(get_method(self.method), self.options), self.kernel)

    @cached_property
    def finder(self) -> Finder:
        """The model's search (see :mod:`liaam.fitting.search`)."""
        return Finder(self.model, self.rotations)

    @property
    def _method(self) -> Method:
        return self.objectives[0].method

    def find(self, image, *, limit: int | None = 1, least: float = 0.0, name: str = "image") -> list[Candidate]:
        """Find the object in a picture (see :func:`liaam.fitting.search.find`); a candidate is a start for :meth:`fit`.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float array, or path
        limit : int or None
            How many objects to look for; None for all.
        least : float
            Score that an object must have.
        name : str
            What to call the image in errors; a path's own name is used for paths.

        Returns
        -------
        list of Candidate
        """
        image, camera = load_picture(image, name)[0], self._camera
        return self.finder.find(camera.flatten(image), limit=limit, least=least, response=camera.response)

    def find_all(self, image, name: str = "image") -> list[Candidate]:
        """Find all objects of a picture, those in doubt left out.

        Raises
        ------
        StartError
            If there is none, with the best score that there was.
        """
        found = self.find(image, limit=None, name=name)
        sure = [candidate for candidate in found if not candidate.doubtful]
        if not sure:
            raise StartError(
                f"{name}: the search finds no object (the best score is {found[0].score:.2f}, {DOUBTFUL:g} is needed); "
                "say where to start (--init), or fit the best place all the same (without --all)"
            )
        return sure

    def fit(self, image, init=None, name: str = "image") -> FitResult:
        """Fit the model to one image.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float array, or path
        init : (n, 2) shape, (x0, y0, x1, y1) box, (x, y, diagonal), or Candidate, optional
            Where to start, image pixels (see :func:`liaam.fitting.start.start_shape`); if left out, the object is
            searched for, and ``result.found`` says how sure that is. A shape is a start; a box, as of a detector, is
            a hint: where the fit from it comes to little, the object is searched for around it.
        name : str
            What to call the image in errors; a path's own name is used for paths.

        Returns
        -------
        FitResult
            Also for a fit that fails: see its ``status``.

        Raises
        ------
        ImageError, StartError
            For input that makes no sense.
        """
        target, found = self.target(image, init, name)
        result, prior = self._fit_from(target), 1.0
        region = self._region(init, target.image)
        if region is not None and self._says_much(result):
            result, prior, target, found = self._likeliest(target, result, found, region)
        if self.restarts and self._falls_short(_believed(result, prior)):
            result = self._fit_again(target, result)
        path = Path(image) if isinstance(image, (str, os.PathLike)) else None
        return replace(_believed(result, prior), found=found, contours=self.model.contours, image=path)

    def _fit_from(self, target: Target) -> FitResult:
        levels = [(objective, level.blur) for objective, level in zip(self.objectives, self._levels, strict=True)]
        return self.judged(target.image, solve_levels(levels, target, self.options))

    def _falls_short(self, result: FitResult) -> bool:
        """Whether a fit may be wrong for want of a better start; cut short, it says nothing about its start."""
        least = max(LEAST_QUALITY, self._little) if result.n_iterations > SLOW else LEAST_QUALITY
        return self._says_much(result) and result.quality < least

    def _says_much(self, result: FitResult) -> bool:
        """Whether its quality tells whether a fit is right: it is known, and the fit was not cut short."""
        short = self.options.max_iterations <= SLOW
        return self.reliability is not None and not result.status.unusable and not short

    @property
    def _little(self) -> float:
        return 0.0 if self.reliability is None else self.reliability.little

    def _region(self, init, image: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Corners of where else the object may be: anywhere without a start, about a box, and not about a shape."""
        limits = np.array(image.shape[1::-1])
        if init is None:
            return np.zeros(2, int), limits
        if not self.restarts or isinstance(init, Candidate) or np.shape(getattr(init, "points", init)) != (4,):
            return None
        low, high = np.asarray(init, np.float64).reshape(2, 2)
        low, high = low - AROUND_BOX * (high - low), high + AROUND_BOX * (high - low)
        low = np.clip(low, 0, limits - LEAST_REGION).astype(int)
        return low, np.clip(np.ceil(high).astype(int), low + LEAST_REGION, limits)

    def _likeliest(
        self, target: Target, first: FitResult, found: Candidate | None, region: tuple[np.ndarray, np.ndarray]
    ) -> tuple[FitResult, float, Target, Candidate | None]:
        """Likeliest place of a fit in a region, and what its odds are to be multiplied by; with its start.

        There are the more places of a size, the smaller they are, so the less likely is each to begin with. Where the
        first fit comes to little, other places that a search finds are fitted, of which at most one is the object's:
        where several look right, each is the less likely to be.
        """
        tried, (low, high) = [(first, target, found)], region
        large = LARGE * float((high - low).min())

        def prior(result: FitResult) -> float:
            return (diagonal_of(result.landmarks) / large) ** 2 if result.quality > 0 else 0.0

        if not _believed(first, min(prior(first), 1.0)).quality >= self._little:
            for other in self.finder.others(target.image[low[1] : high[1], low[0] : high[0]], target.response):
                there = target._replace(start=other.landmarks + low)
                tried.append((self._fit_from(there), there, None if found is None else other))
        odds = [prior(each) * _odds(each.quality) for each, *_ in tried]
        best, its_target, its_start = tried[int(np.argmax(odds))]
        others = sum(o for o, (each, *_) in zip(odds, tried, strict=True) if are_apart(best.landmarks, each.landmarks))
        own = prior(best)
        shared = own / (own + others) if own > 0 else 1.0
        return replace(best, n_starts=len(tried)), min(own, 1.0) * shared, its_target, its_start

    def _fit_again(self, target: Target, first: FitResult) -> FitResult:
        """Best of a fit and of those from other starts, by their quality; the first ordinary one ends the search."""
        known, best, n_starts = self.reliability, first, first.n_starts
        for start in other_starts(self.objectives[0], self._levels[0].blur, target, self.options):
            other, n_starts = self._fit_from(target._replace(start=start)), n_starts + 1
            if other.quality > best.quality and is_sane(other.landmarks, target.start):
                best = other
            if known is not None and best.quality >= known.ordinary:
                break
        return replace(best, n_starts=n_starts)

    def target(self, image, init=None, name: str = "image") -> tuple[Target, Candidate | None]:
        """Picture and start, checked, with what is known of the camera, and what a search found; as :meth:`fit`."""
        image, name = load_picture(image, name)
        # A picture of one value (black, white) is not refused: its status says more.
        if self._method.needs_colour and is_grey(image) and np.ptp(stored_values(image)) > 0:
            raise ImageError(
                f"{name}: the image is grey (three equal channels), but method {self._method.name} "
                "compares colours; use method 'grey'"
            )
        init = self.find(image, name=name)[0] if init is None else init
        found = init if isinstance(init, Candidate) else None
        given = init if found is None else found.landmarks
        start = start_shape(self.model, given, (image.shape[1], image.shape[0]), name)
        camera = self._camera
        picture = camera.flatten(image)
        return Target(picture, start, camera.response, camera.noise, camera.theta, self.margin), found

    def settled_at(self, image, result: FitResult) -> tuple[Objective, Solution]:
        """Look at a result with all pixels of the sharpest level, and the appearance that fits best there.

        Parameters
        ----------
        image : (h, w, 3) array or path
            The picture that was fitted.
        result : FitResult
            Of this or another method.

        Returns
        -------
        objective : Objective
        solution : Solution
            Its state has the appearance's coordinates.
        """
        objective, problem, state = self._end_of(result, image)
        if self._method.free_angles == "image" and not np.isfinite(result.theta):
            state = state._replace(angles=np.array([state.angles[0], best_image_angle(objective, problem, state)]))
        return objective, settle_lambda(objective, problem, state, self.options)

    def residual(self, image, result: FitResult) -> tuple[np.ndarray, np.ndarray]:
        """Image minus model, in the method's own terms, at all pixels of the sharpest level (paper eq 9).

        Parameters
        ----------
        image : (h, w, 3) array or path
            The picture that was fitted.
        result : FitResult
            Of this fitter.

        Returns
        -------
        residual : (n_pixels, k) float32
            In the raster order of the frame of :attr:`view`; 0 where the image says nothing.
        usable : (n_pixels,) float32
            1 where it does, else 0.
        """
        kept, k = self.view.warp.every(0.0), self._method.n_rows
        residual, usable = np.zeros((len(kept), k), np.float32), np.zeros(len(kept), np.float32)
        if np.isfinite(result.landmarks).all():
            objective, problem, state = self._end_of(result, image)
            if len(result.lam) == objective.n_lambda:  # else the fit did not come to the sharpest level
                state = state._replace(lam=result.lam)
            work = objective.look(problem, state, weigh=int(self._method.normalise))
            usable[kept] = work.usable
            residual[kept] = np.where(work.usable[:, None] > 0, work.residual.reshape(-1, k), 0.0)
        return residual, usable

    def _end_of(self, result: FitResult, image) -> tuple[Objective, FitProblem, State]:
        """All pixels of the sharpest level where a fit ended, with the mean appearance."""
        image, camera = load_picture(image, "image")[0], self._camera
        objective, blur = self.objectives[-1].of_all_pixels, self._levels[-1].blur
        picture = camera.flatten(image), result.landmarks, result.pose
        problem = FitProblem.at(*picture, self._method, camera.response, blur, camera.noise)
        # By the shape: p belongs to the shapes of the method that was fitted, which need not be this one's.
        state = objective.start(self.shapes.parameters(result.pose.inverse()(result.landmarks)))
        if self._method.has_angles and np.isfinite(result.theta):
            state = state._replace(angles=np.array([result.theta_model, result.theta]))
        return objective, problem, state

    @property
    def _levels(self) -> tuple[Level, ...]:
        return self.view.levels

    @property
    def view(self) -> View:
        """The model's view that the method fits with."""
        return self.model.views[self._method.view]

    @property
    def shapes(self) -> ShapeModel:
        """Shapes that the method fits with."""
        return self.view.shape_model

    @property
    def reliability(self) -> Reliability | None:
        """What tells right fits from wrong ones; it is known of the method that training fits with, by any name."""
        return self.view.reliability if self._method == METHODS[DEFAULT_METHOD] else None

    @property
    def _camera(self) -> CameraModel:
        return self.model.camera if self.camera is None else self.camera

    def judged(self, image: np.ndarray, stages: Sequence[Stage]) -> FitResult:
        """Result of the stages of a fit to an image (flattened), its status and its covariances."""
        stage, has_angle = stages[-1], self._method.has_angles
        solution, history = stage.solution, trace(stages)
        known = self.reliability
        spread = covariance(stage, self.options.shape_prior / solution.scale)
        spread = spread if known is None else known.understated * spread
        seen = evidence(stage)
        status = self._status(image, history, stage)
        quality = np.nan if known is None else 0.0 if status.lost else known.quality(seen)
        # Without calibration, too, what explains nothing is no fit.
        explains = seen[0] > 0.0 if known is not None else explains_more_than_noise(stage)
        if status.ok and (quality < LEAST_QUALITY or not explains):
            status = FitStatus.DOUBTFUL
        return FitResult(
            landmarks=history[-1].landmarks,
            status=status,
            theta=float(solution.state.angles[1]) if has_angle else np.nan,
            theta_model=float(solution.state.angles[0]) if has_angle else np.nan,
            p=solution.state.p,
            pose=stage.pose,
            lam=solution.state.lam,
            cost=float(solution.costs[-1]),
            n_iterations=sum(stage.solution.n_iterations for stage in stages),
            history=history,
            covariance=spread,
            landmark_covariances=landmark_covariances(self.shapes, stage.pose, spread, known),
            evidence=seen,
            quality=quality,
            method=self._method,
        )

    def _status(self, image: np.ndarray, history: tuple[Iteration, ...], stage: Stage) -> FitStatus:
        shape, objective, solution = history[-1].landmarks, stage.objective, stage.solution
        if not is_sane(shape, history[0].landmarks):
            return FitStatus.DIVERGED
        usable = solution.work.usable
        if not usable.all():  # some pixel is outside, or says nothing
            points = stage.pose(objective.warp.points(solution.state.p))
            inside = ((points >= 0) & (points <= np.array(image.shape[1::-1]) - 1)).all(axis=1)
            if inside.mean() < 0.5:
                return FitStatus.LEFT_IMAGE
            if usable[inside].mean() < USABLE_LIMIT:
                return self._why_unusable(image, points[inside])
        if folded_share(shape, self.model.triangles) > FOLD_LIMIT or self._largest_mode(shape) > SHAPE_LIMIT:
            return FitStatus.DIVERGED
        if solution.flat:
            return FitStatus.NO_TEXTURE
        if not solution.settled:
            return FitStatus.MAX_ITERATIONS
        return FitStatus.LIGHT_UNOBSERVABLE if solution.held else FitStatus.CONVERGED

    def _largest_mode(self, shape: np.ndarray) -> float:
        """Largest shape mode in standard deviations, under the similarity that suits the shape best."""
        shape_model = self.shapes
        upright = align(shape, shape_model.mean)(shape)
        # A mode is an orthonormal vector over all landmarks: half a pixel each makes sqrt(n) / 2.
        allowed = np.sqrt(shape_model.eigenvalues) + 0.5 * np.sqrt(shape_model.n_points) / SHAPE_LIMIT
        return float((np.abs(shape_model.parameters(upright)[:-4]) / allowed).max(initial=0.0))

    def _why_unusable(self, image: np.ndarray, points: np.ndarray) -> FitStatus:
        """Tell a dark object from an overexposed one."""
        x, y = np.rint(points).astype(int).T
        dark, clipped = exposure_faults(image[y, x])
        return FitStatus.TOO_DARK if dark >= clipped else FitStatus.SATURATED


def covariance(stage: Stage, strength: float = 1.0) -> np.ndarray:
    """Covariance of q by the picture and a prior of some strength; infinite where neither says anything.

    The evidence of the pixels is counted as what they are worth together: a blur makes neighbours alike, and so do the
    errors of the model (:meth:`Objective.unit`).
    """
    objective, solution = stage.objective, stage.solution
    unit = max(objective.unit(solution.work), 1e-12)
    # Of a fit that has run off it need not be a number, and then says nothing.
    precision = np.nan_to_num(solution.work.base / unit, posinf=0.0, neginf=0.0)
    n_p = objective.warp.n_parameters
    precision[np.arange(n_p), np.arange(n_p)] += strength * objective.prior
    values, vectors = np.linalg.eigh(precision)
    inverse = np.divide(1.0, values, out=np.full_like(values, 1e12), where=values > 1e-12 * max(values[-1], 1e-300))
    return (vectors * inverse) @ vectors.T


def _odds(probability: float) -> float:
    return probability / max(1.0 - probability, 1e-9)


def _believed(result: FitResult, prior: float) -> FitResult:
    """Result whose odds of being right are multiplied by what else is known of its place, at most 1."""
    if prior == 1.0:
        return result
    odds = prior * _odds(result.quality)
    quality = odds / (1.0 + odds)
    doubtful = result.status.ok and quality < LEAST_QUALITY
    return replace(result, quality=quality, status=FitStatus.DOUBTFUL if doubtful else result.status)


BY_CHANCE, MOST_BY_CHANCE = 4.0, 0.25
"""How many times what a fit's freedom explains of white noise it has to explain of a picture, and the share of this
that is enough at any rate. Set by IMM without calibration, 15 methods, 15 pictures of 5 strangers, some spot-lit:
fits to a box in noise of grains of 1 to 8 pixels explain 3.5 times as much at most, right fits 14 times or more. Models
of few pixels explain more of coarse noise than the share, and are not told."""


def explains_more_than_noise(stage: Stage) -> bool:
    """Whether a fit explains more of its picture than so many free parameters do of noise, by the fit's own weights."""
    objective, solution = stage.objective, stage.solution
    samples, residual = _shown(stage)
    weights = np.square(
        solution.work.root.reshape(-1, objective.method.n_rows)[:, : samples.shape[1]], dtype=np.float64
    )
    if objective.method.encoding in ("value", "log"):
        samples = samples - (weights * samples).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-300)
    contrast, left = (float((weights * np.square(each)).sum()) for each in (samples, residual))
    count = objective.n_q + objective.n_lambda
    by_chance = BY_CHANCE * count * objective.correlated / max(np.count_nonzero(weights), 1)
    return left < (1.0 - min(by_chance, MOST_BY_CHANCE)) * contrast


def _shown(stage: Stage) -> tuple[np.ndarray, np.ndarray]:
    """What the picture shows where a fit ended, and what the fit leaves of it, (n, rows) each; of gradients and colour
    the gradients, which every picture has.
    """
    seen, method = stage.solution.work, stage.objective.method
    rows = slice(0, 2) if method.weights == "rows" else slice(None)
    metric = method.image_metric(stage.solution.state.angles[1])[rows].astype(np.float32)
    samples = float(seen.scales[GAIN]) * (seen.values.reshape(-1, 8)[:, : metric.shape[1]] @ metric.T)
    return samples, seen.residual.reshape(-1, method.n_rows)[:, rows]


def evidence(stage: Stage) -> np.ndarray:
    """What tells a right fit from a wrong one, (2,) float64.

    How much of the picture the fit explains: the share of its contrast under the model, less what an unlikely
    appearance costs, times the root of this contrast, so that it says little to explain what is blurred or half outside
    the picture. Then how far its shape is from the mean: log(1 + mean squared mode in standard deviations).
    """
    objective, solution = stage.objective, stage.solution
    seen, method = solution.work, objective.method
    weights = (seen.usable * objective.appearance.usable).astype(np.float64)
    samples, residual = _shown(stage)
    if method.encoding in ("value", "log"):
        samples = samples - (weights @ samples / weights.sum() if weights.any() else 0.0)
    contrast = float((weights @ np.square(samples)).sum())
    left = float((weights @ np.square(residual)).sum())
    if not np.isfinite(left):
        return np.array([-1.0, 14.0])
    unlikely = float(objective.template.ridge @ np.square(solution.state.lam))
    # The mean is over all of the model's pixels: those that are not seen are not explained.
    strength = np.sqrt(contrast / max(float(objective.appearance.usable.sum()), 1e-9))
    explained = (1.0 - (left + unlikely) / contrast) * strength if contrast > 0 else -1.0
    modes = np.square(solution.state.p) * objective.prior
    far = modes[: objective.warp.n_parameters - 4].mean() if objective.warp.n_parameters > 4 else 0.0
    return np.array([max(explained, -1.0), np.log1p(min(far, 1e6))])


def fitted_covariances(shapes: ShapeModel, spread: np.ndarray) -> np.ndarray:
    """Covariance of each landmark by that of p (first in ``spread``), (n, 2, 2) float64, model pixels squared."""
    n_p = len(shapes.basis)
    basis = shapes.basis.reshape(n_p, -1, 2)
    carried = (spread[:n_p, :n_p] @ shapes.basis).reshape(n_p, -1, 2)
    return np.einsum("ina,inb->nab", basis, carried)


def landmark_covariances(
    shapes: ShapeModel, pose: Similarity, spread: np.ndarray, reliability: Reliability | None = None
) -> np.ndarray:
    """Covariance of each landmark, (n, 2, 2) float64, image pixels squared: of the fit, and of what no fit can reach.

    Parameters
    ----------
    shapes : ShapeModel
    pose : Similarity
        Model pixels to image pixels.
    spread : (n_q, n_q) float64
        Covariance of p, and of what follows it, as results hold it.
    reliability : Reliability, optional
        How far fits to pictures left out erred; what the shape model left of such pictures' landmarks if left out.
    """
    fitted = fitted_covariances(shapes, spread)
    unexplained = shapes.unexplained if reliability is None else reliability.landmarks
    own = fitted if unexplained is None else fitted + unexplained
    return pose.matrix @ own @ pose.matrix.T


def fit(
    model: AAM,
    image,
    init=None,
    method: str | Method = DEFAULT_METHOD,
    *,
    camera: CameraModel | None = None,
    rotations: str = "upright",
    restarts: bool = True,
    margin: float = MARGIN,
    kernel: str = "fast",
    **options,
) -> FitResult:
    """Fit a model to one image. For many images use :func:`fit_many`, or make a :class:`Fitter` once.

    Parameters
    ----------
    model : AAM
    image : (h, w, 3) uint8, uint16 or float array, or path
    init : (n, 2) shape, (x0, y0, x1, y1) box, (x, y, diagonal), or Candidate, optional
        Where to start, image pixels. If None, the object is searched for.
    method : str or Method
        See :data:`liaam.fitting.METHODS`.
    camera, rotations, restarts, margin, kernel
        As for :class:`Fitter`.
    **options
        Fields of :class:`liaam.fitting.SolverOptions`, such as ``max_iterations``.

    Returns
    -------
    FitResult
        Also for a fit that fails: see its ``status``.

    Raises
    ------
    ImageError, StartError, MethodError
        If an argument is invalid.
    """
    fitter = Fitter.of(
        model, method, camera=camera, rotations=rotations, restarts=restarts, margin=margin, kernel=kernel, **options
    )
    result = fitter.fit(image, init)
    return result if result.image is not None else replace(result, image=image)
