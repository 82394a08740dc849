"""Coarse-to-fine fitting: each level starts from the solution of the one before.

:class:`CoarseToFine` is one call of the core. :func:`solve_levels` does the same level by level in Python, for what the
core leaves out, and where it could not be built.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from liaam import _core
from liaam.fitting.loop.angles import best_image_angle
from liaam.fitting.loop.encoded_image import (
    LOG_RANGE,
    MARGIN,
    NEAR,
    NO_NOISE,
    EncodedImage,
    noise_around,
    noise_table,
)
from liaam.fitting.loop.objective import Objective, State
from liaam.fitting.loop.options import SolverOptions, coarse_options
from liaam.fitting.methods import Method
from liaam.fitting.thresholds import THRESHOLDS
from liaam.model.sampling import AveragedImage, after_every, block_size, every, stride_for
from liaam.model.shape import Similarity, align, diagonal_of, own_parameters
from liaam.photometry import NoiseModel, Response, is_grey
from liaam.photometry.encoding import (
    ENCODINGS,
    Encoding,
    Means,
    is_logarithmic,
    light_of_floats,
    light_table,
    log_floor,
)
from liaam.workers import one_numpy_thread

# Pixels of an image of floats up to which its light, 16 bytes a pixel, is computed once for all levels and starts; for
# larger ones it is computed at each level around the object only.
LARGEST_FLOATS = 4_000_000


@dataclass(frozen=True, eq=False)
class FittedLevel:
    """Solution of one level."""

    objective: Objective
    pose: Similarity  # model pixels to image pixels, to which the solution refers
    solution: Any  # Solution of the core, or its like of liaam.fitting.reference.loop
    to_patch: Similarity  # image pixels to pixels of the encoded patch
    patch_size: tuple[int, int]  # its height and width
    begun_at: np.ndarray | None = None  # (n, 2) shape that it began at, if it has fewer modes than the last level

    @cached_property
    def beyond(self) -> np.ndarray | float:
        """What the level's modes cannot show of the shape that it began at; it stays as it is."""
        if self.begun_at is None:
            return 0.0
        return self.begun_at - self.pose(self.objective.warp.shape(self.solution.path[0]))

    @cached_property
    def reached(self) -> np.ndarray:
        """Shape of the solution, (n, 2) float64, image pixels."""
        return self.shapes(self.solution.p)

    def shapes(self, p: np.ndarray) -> np.ndarray:
        """Return the shapes (..., n, 2) of parameters (..., n_p), image pixels."""
        return self.pose(self.objective.warp.shape(p)) + self.beyond

    def seen_every(self, stride: int) -> "FittedLevel":
        """Return the level in the pixels of an image, of which it was fitted to every so many (`LinearImage.every`)."""
        offset = stride // 2
        return replace(
            self,
            pose=Similarity(stride * self.pose.matrix, stride * self.pose.offset + offset),
            to_patch=after_every(self.to_patch, stride),
            begun_at=None if self.begun_at is None else stride * self.begun_at + offset,
        )


@dataclass(frozen=True, eq=False)
class LinearImage:
    """An image without vignetting, and what all fits to it share."""

    image: np.ndarray  # (h, w, 3) uint8, uint16 or float32
    response: Response
    lights: dict[bool, Means] = field(default_factory=dict)  # of an image of floats, by whether of logarithms
    searches: dict[int, Any] = field(default_factory=dict)  # that may go on, by the identity of their detector
    sparse: dict[int, "LinearImage"] = field(default_factory=dict)  # every so many rows and columns of it

    @cached_property
    def grey(self) -> bool:
        """Whether the image is grey, so that its colours cannot be used."""
        return is_grey(self.image)

    def light_of(self, encoding: Encoding) -> Means:
        """Return the light of each pixel of an image of floats."""
        logarithmic = is_logarithmic(encoding)
        if logarithmic not in self.lights:
            self.lights[logarithmic] = light_of_floats(self.image, encoding, self.response)
        return self.lights[logarithmic]

    def every(self, stride: int) -> "LinearImage":
        """Return every so many rows and columns, from pixel ``stride // 2`` on."""
        if stride not in self.sparse:
            self.sparse[stride] = LinearImage(every(self.image, stride), self.response)
        return self.sparse[stride]

    def crop(self, low: np.ndarray, high: np.ndarray) -> "LinearImage":
        """Return the image between two corners (x, y), the second excluded; itself if that is all."""
        if not low.any() and (high == self.image.shape[1::-1]).all():
            return self
        return LinearImage(self.image[low[1] : high[1], low[0] : high[0]], self.response)


class Target(NamedTuple):
    """An image to fit, its start and its camera's properties, the same for all levels."""

    linear: LinearImage
    start: np.ndarray  # (n, 2): initial positions of the landmarks (of a homography, the corners), image pixels
    noise: NoiseModel | float | None = None  # of the image's camera
    theta: float | None = None  # angle of the image's camera if it is not estimated, radians; by default the model's
    margin: float = MARGIN  # around the start that the fit may use, as a fraction of the object's diagonal
    # A Gaussian prior: landmarks (n, 2) mapped from another landmarker's points, and the precision of their parameters.
    mapped: np.ndarray | None = None
    pull: np.ndarray | None = None

    @property
    def image(self) -> np.ndarray:
        """(h, w, 3) uint8, uint16 or float32, corrected for vignetting."""
        return self.linear.image

    def prepared(self, objectives: Sequence[Objective]) -> "Target":
        """Return a target with the noise measured if it is needed, and the nearest shape of the model as start (eq 2).

        A single level starts from that shape anyway, since it projects its start. Of several levels the coarse ones
        have fewer modes: they keep what these cannot show of the start, also what no mode of the model can show.
        """
        target = self.measured(objectives[-1].method)
        if len(objectives) == 1:
            return target
        warp = objectives[-1].warp
        pose = align(warp.rest, self.start)
        p = warp.parameters(pose.inverse()(self.start))
        return target._replace(start=pose(warp.shape(p)))

    def every(self, stride: int) -> "Target":
        """Return a target in an image of every so many rows and columns; the noise of a pixel is the same."""
        offset = stride // 2
        return self._replace(
            linear=self.linear.every(stride),
            start=(self.start - offset) / stride,
            mapped=None if self.mapped is None else (self.mapped - offset) / stride,
        )

    def measured(self, method: Method) -> "Target":
        """Return a target with the noise measured in the image, if the method needs it and it is unknown."""
        if self.noise is not None or not method.weighs_noise:
            return self
        return self._replace(noise=noise_around(self.image, self.start, self.linear.response))


class CoarseToFine:
    """Objectives from coarse to fine, which the core fits in one call without the interpreter's lock.

    :func:`solve_levels` does the same for what the core leaves out, and where it could not be built.
    """

    def __init__(self, objectives: Sequence[Objective], keeps_samples: bool = False) -> None:
        self.objectives = tuple(objectives)
        self.keeps_samples = keeps_samples
        self._compiled: dict[tuple[int, int | None], Any] = {}

    def __getstate__(self) -> dict:
        """Leave out what the core holds, which is valid in this process only."""
        return {**vars(self), "_compiled": {}}

    def can_take(self, target: Target, options: SolverOptions) -> bool:
        """Return whether the core can fit an image in one call with these options."""
        if options.elimination != "varpro" or not all(each.is_compiled for each in self.objectives):
            return False
        if not isinstance(self.objectives[0].method.encoding, str):  # a function of the user
            return False
        has_large_floats = target.image.dtype.kind == "f" and target.image[..., 0].size > LARGEST_FLOATS
        return not has_large_floats

    def fit(self, target: Target, options: SolverOptions, first: int = 0, last: int | None = None) -> list[FittedLevel]:
        """Fit an image at the levels ``first`` to ``last``, excluded; fewer levels if the fit diverges.

        Of an object that is large in a photograph, not all rows and columns are read.
        """
        objectives = self.objectives[first:last]
        target = target.prepared(objectives)
        stride = _enough_of(target, objectives)
        if stride == 1:
            return self._fit(target, options, first, last)
        return [level.seen_every(stride) for level in self._fit(target.every(stride), options, first, last)]

    def _fit(self, target: Target, options: SolverOptions, first: int, last: int | None) -> list[FittedLevel]:
        """Fit a prepared target, with all pixels around the object."""
        objectives = self.objectives[first:last]
        if not self.can_take(target, options):
            return solve_levels(objectives, target, options)
        if (first, last) not in self._compiled:
            self._compiled[first, last] = self._prepare(objectives)
        solved = self._call(self._compiled[first, last], target, options)
        levels = []
        shape = target.start
        for objective, of_core in zip(objectives, solved, strict=False):  # fewer are solved if the fit diverges
            level = FittedLevel(
                objective=objective,
                pose=_similarity(of_core.pose),
                solution=of_core.fit,
                to_patch=_similarity(of_core.to_patch),
                patch_size=of_core.patch_size,
                begun_at=None if objective is objectives[-1] else shape,
            )
            levels.append(level)
            shape = level.reached
        return levels

    @one_numpy_thread()  # so that the bits of a fit do not depend on the number of threads
    def _prepare(self, objectives: Sequence[Objective]) -> Any:
        """Give the core what it needs of some levels for all images."""
        warps: list[Any] = [objective.warp for objective in objectives]  # of a mesh: that is what the core can fit
        method = objectives[0].method
        levels = [
            {
                "objective": each.compiled,
                "blur": float(each.blur),
                "density": float(each.density),
                "basis": np.ascontiguousarray(warp.shape_model.basis, np.float64),
            }
            for each, warp in zip(objectives, warps, strict=True)
        ]
        return _core.prepare(
            {
                "levels": levels,
                "mean": _flat(warps[0].rest),
                "encoding": ENCODINGS.index(method.encoding),
                "theta_1": float(objectives[0].theta_model),
                "has_invariant": method.solves_angle,
                "keeps_samples": self.keeps_samples,
            }
        )

    def _call(self, compiled: Any, target: Target, options: SolverOptions) -> list:
        """Fit an image with the core; return its solutions of the levels, fewer if the fit diverges."""
        objective = self.objectives[0]
        encoding = objective.method.encoding
        linear = target.linear
        points = np.zeros(0) if target.mapped is None else target.mapped
        precision = np.zeros((0, 0)) if target.pull is None else target.pull
        theta_2 = objective.theta_model if target.theta is None else target.theta
        target_fields = {
            "start": _flat(target.start),
            "points": _flat(points),
            "point_precision": np.ascontiguousarray(precision),
            "margin": float(target.margin),
            "theta_2": float(theta_2),
            "log_noise": NO_NOISE if target.noise is None else noise_table(target.noise).astype(np.float32),
            "first_log": LOG_RANGE[0],
            "last_log": LOG_RANGE[1],
        }
        is_grey_soft = encoding == "soft" and linear.grey  # then it compares brightness only
        floor = log_floor(linear.response)
        if linear.image.dtype.kind == "f":
            means = linear.light_of(encoding)
            return compiled.fit_light(means.light, means.finite, is_grey_soft, floor, target_fields, options.as_dict)
        table = light_table(linear.image.dtype.str, encoding, linear.response)
        return compiled.fit(linear.image, table, is_grey_soft, floor, target_fields, options.as_dict)


def _enough_of(target: Target, objectives: Sequence[Objective]) -> int:
    """Return of how many rows and columns one is enough, for blocks that are averaged to the pixels of patches."""
    scale = align(objectives[0].warp.rest, target.start).scale
    if not np.isfinite(scale):
        return 1
    size = min(block_size(each.method.encoding, scale, each.blur) for each in objectives)
    return stride_for(target.image, size)


def _similarity(rows: np.ndarray) -> Similarity:
    """Return the similarity that the core writes as (2, 3): a matrix, and an offset in the last column."""
    return Similarity(rows[:, :2], rows[:, 2])


def _flat(points: np.ndarray) -> np.ndarray:
    """Return points (n, 2) as (2 n,) float64: x, y, x, y ..."""
    return np.ascontiguousarray(points, np.float64).ravel()


def solve_levels(objectives: Sequence[Objective], target: Target, options: SolverOptions) -> list[FittedLevel]:
    """Solve the levels from coarse to fine, each from the solution of the one before; fewer if the fit diverges."""
    finest = objectives[-1]
    stages = []
    target = target.prepared(objectives)
    averaged = averaged_image(objectives, target)
    shape = target.start
    for objective in objectives:
        level_options = options if objective is finest else coarse_options(options)
        image, state, pose = prepare_level(objective, target, stages, level_options, averaged)
        solution = objective.solve(image, state, level_options, evaluate_last=objective is finest)
        stage = FittedLevel(
            objective=objective,
            pose=pose,
            solution=solution,
            to_patch=image.patch.from_image,
            patch_size=image.channels.shape[:2],
            begun_at=None if objective is finest else shape,
        )
        stages.append(stage)
        shape = stage.reached
        if not is_sane(shape, target.start):
            break
    return stages


def averaged_image(objectives: Sequence[Objective], target: Target) -> AveragedImage:
    """Return the image averaged once for all levels."""
    return AveragedImage.around(
        target.image,
        target.start,
        pose=align(objectives[0].warp.rest, target.start),
        encoding=objectives[0].method.encoding,
        response=target.linear.response,
        blurs=[objective.blur for objective in objectives],
        margin=target.margin,
    )


def prepare_level(
    objective: Objective,
    target: Target,
    stages: Sequence[FittedLevel],
    options: SolverOptions,
    averaged: AveragedImage | None = None,
) -> tuple[EncodedImage, State, Similarity]:
    """Return the encoded image, the initial state and the pose of a level, given the levels before it.

    The pose is updated at each level because shape modes rotate and scale with it, and the patch is cut around the
    current shape. ``averaged`` is the image averaged for all levels; by default it is averaged here.
    """
    if stages:
        shape = stages[-1].reached
        margin = NEAR
    else:
        shape = target.start
        margin = target.margin
    warp = objective.warp
    method = objective.method
    pose = align(warp.rest, shape)
    image = EncodedImage.at(
        target.image if averaged is None else averaged,
        shape,
        pose,
        method=method,
        response=target.linear.response,
        blur=objective.blur,
        noise=target.noise,
        margin=margin,
        density=objective.density,
    )
    if target.pull is not None and target.mapped is not None:
        points = warp.parameters(pose.inverse()(target.mapped))
        indices = own_parameters(len(points), len(target.pull))
        image = replace(image, point_precision=target.pull[np.ix_(indices, indices)], points=points)
    state = objective.start(warp.parameters(pose.inverse()(shape)))
    angles = stages[-1].solution.angles if stages else _first_angles(objective, image, state, options, target.theta)
    return image, state._replace(angles=np.array(angles, np.float64)), pose


def _first_angles(
    objective: Objective, image: EncodedImage, state: State, options: SolverOptions, theta: float | None
) -> np.ndarray:
    """Return the angles (theta_1, theta_2) that the first level starts from.

    ``theta`` is that of the image's camera, for methods that estimate no angle. Of those that estimate theta_2 alone,
    it is at its optimum for the start (:mod:`liaam.fitting.loop.angles`).
    """
    if theta is not None and objective.method.free_angles == "none":
        return np.array([state.angles[0], theta])
    has_optimum = objective.method.free_angles == "image" and objective.method.solves_angle
    if not has_optimum or options.angle_start == "model":
        return state.angles
    return np.array([state.angles[0], best_image_angle(objective, image, state)])


def is_sane(shape: np.ndarray, start: np.ndarray) -> bool:
    """Return whether a shape is finite and its size not too far from that of the start."""
    if not np.isfinite(shape).all():
        return False
    return THRESHOLDS["LEAST_GROWTH"] < diagonal_of(shape) / diagonal_of(start) < THRESHOLDS["MOST_GROWTH"]
