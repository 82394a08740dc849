"""Coarse-to-fine fitting: each level starts from the solution of the one before.

:class:`CompiledLevels` is one call of the core. :func:`solve_levels` does the same level by level in Python, for what
the core leaves out, and where it could not be built.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from liaam import _core
from liaam.fitting.angles import best_image_angle
from liaam.fitting.level_image import (
    LOG_RANGE,
    MARGIN,
    NEAR,
    NO_NOISE,
    LevelImage,
    noise_around,
    noise_table,
    similarity_of,
)
from liaam.fitting.methods import Method
from liaam.fitting.objective import Objective, State
from liaam.fitting.reference_loop import THRESHOLDS
from liaam.fitting.solver import SolverOptions
from liaam.model.sampling import Light
from liaam.model.shape import Similarity, align, diagonal_of, own_parameters
from liaam.photometry import NoiseModel, Response, is_grey
from liaam.photometry.encoding import ENCODINGS, Encoding, Means, light_of_floats, light_table, log_floor

LARGEST_FLOATS = 4_000_000
"""Pixels of an image of floats up to which its light is computed once for all levels and starts; else by level."""


@dataclass(frozen=True, eq=False)
class FittedLevel:
    """Solution of one level.

    Attributes
    ----------
    objective : Objective
    pose : Similarity
        Model pixels to image pixels, to which the solution refers.
    solution : LevelFit
        Of the core or of :mod:`liaam.fitting.reference_loop`.
    to_patch : Similarity
        Image pixels to pixels of the encoded patch.
    patch_size : (int, int)
        Its height and width.
    beyond : (n, 2) float64
        What the level's modes, fewer than those of the sharpest level, cannot show of its start, image pixels. It stays
        as it is.
    """

    objective: Objective
    pose: Similarity
    solution: Any
    to_patch: Similarity
    patch_size: tuple[int, int]
    beyond: np.ndarray | float = 0.0

    def begun_at(self, shape: np.ndarray) -> "FittedLevel":
        """Return the level with what it cannot show of the shape (n, 2) that it began at."""
        return replace(self, beyond=shape - self.pose(self.objective.warp.shape(self.solution.path[0])))

    @property
    def path(self) -> list[tuple[float, np.ndarray, float]]:
        """Cost, shape (n, 2) and theta_2 at the start and after every accepted step."""
        solution = self.solution
        shapes = self.pose(self.objective.warp.shape(solution.path)) + self.beyond
        return list(zip(solution.costs.tolist(), shapes, solution.angle_history[:, 1].tolist(), strict=True))

    @cached_property
    def reached(self) -> np.ndarray:
        """Shape of the solution, (n, 2) float64, image pixels."""
        return self.pose(self.objective.warp.shape(self.solution.p)) + self.beyond


class LinearImage:
    """An image, and what all fits to it share.

    Attributes
    ----------
    image : (h, w, 3) uint8, uint16 or float32
        Corrected for vignetting.
    response : Response
    """

    def __init__(self, image: np.ndarray, response: Response) -> None:
        self.image = image
        self.response: Response = response

    @cached_property
    def grey(self) -> bool:
        """Whether the image is grey, so that its colours cannot be used."""
        return is_grey(self.image)

    @cached_property
    def lights(self) -> dict[bool, Means]:
        """Light of an image of floats, by whether the encoding is logarithmic."""
        return {}

    def light_of(self, encoding: Encoding) -> Means:
        """Return the light of each pixel of an image of floats."""
        logarithmic = encoding in ("log", "soft")
        if logarithmic not in self.lights:
            self.lights[logarithmic] = light_of_floats(self.image, encoding, self.response)
        return self.lights[logarithmic]

    def crop(self, low: np.ndarray, high: np.ndarray) -> "LinearImage":
        """Return the image between two corners (x, y), the second excluded; itself if that is all."""
        if not low.any() and (high == self.image.shape[1::-1]).all():
            return self
        return LinearImage(self.image[low[1] : high[1], low[0] : high[0]], self.response)


class Target(NamedTuple):
    """An image to fit, its start and its camera's properties, the same for all levels."""

    linear: LinearImage
    start: np.ndarray
    """(n, 2) float: initial positions of the landmarks (of a homography, the corners), image pixels."""
    noise: NoiseModel | float | None = None
    """Noise of the image's camera."""
    theta: float | None = None
    """Angle of the image's camera if the method does not estimate it, radians; by default the model's."""
    margin: float = MARGIN
    """Margin around the start that the fit may use, as a fraction of the object's diagonal."""
    light: Light | None = None
    """The image averaged around the start for all levels; by default each level averages for itself."""
    pull: np.ndarray | None = None
    """(n_p, n_p) float64: precision of the parameters of ``mapped``; None if there is no such prior."""
    mapped: np.ndarray | None = None
    """(n, 2) float64: landmarks mapped from another landmarker's points, weighed in as a Gaussian prior."""

    @property
    def image(self) -> np.ndarray:
        """(h, w, 3) uint8, uint16 or float32, corrected for vignetting."""
        return self.linear.image

    @property
    def response(self) -> Response:
        """Response of the image's camera."""
        return self.linear.response

    def measured(self, method: Method) -> "Target":
        """Return a target with the noise measured in the image, if the method needs it and it is unknown."""
        if self.noise is not None or not method.weighs_noise:
            return self
        return self._replace(noise=noise_around(self.image, self.start))

    def on_model(self, objective: Objective) -> "Target":
        """Return a target that starts from the nearest shape of the model (eq 2)."""
        warp, pose = objective.warp, align(objective.warp.rest, self.start)
        return self._replace(start=pose(warp.shape(warp.parameters(pose.inverse()(self.start)))))

    def averaged(self, levels: Sequence[tuple[Objective, float]]) -> "Target":
        """Return a target with the image averaged once for all levels (objectives with their blurs)."""
        objective, blurs = levels[0][0], [blur for _, blur in levels]
        pose, encoding = align(objective.warp.rest, self.start), objective.method.encoding
        light = Light.around(
            self.image, self.start, pose, encoding=encoding, response=self.response, blurs=blurs, margin=self.margin
        )
        return self._replace(light=light)


Levels = Sequence[tuple[Objective, float]]
"""Objective and blur of the image in model pixels, coarse to fine."""


class CompiledLevels:
    """Levels prepared for the core, which fits an image in one call without the interpreter's lock."""

    def __init__(self, levels: Levels, keeps_samples: bool = False) -> None:
        self.objectives = [objective for objective, _ in levels]
        method = self.objectives[0].method
        self.method, self.encoding = method, method.encoding
        self.theta = self.objectives[0].theta_model
        self.compiled = _core.prepare(
            {
                "levels": [_level_fields(each, blur) for each, blur in levels],
                "mean": np.ascontiguousarray(self.objectives[0].warp.rest, np.float64).ravel(),
                "encoding": ENCODINGS.index(method.encoding),
                "theta_1": float(self.theta),
                "has_invariant": method.solves_angle,
                "keeps_samples": keeps_samples,
            }
        )

    @staticmethod
    def can_fit(levels: Levels) -> bool:
        """Return whether the core can fit these levels."""
        return all(each.is_compiled and isinstance(each.method.encoding, str) for each, _ in levels)

    @staticmethod
    def can_take(target: Target, options: SolverOptions) -> bool:
        """Return whether the core can fit an image in one call with these options."""
        floats = target.image.dtype.kind == "f" and target.image[..., 0].size > LARGEST_FLOATS
        return options.elimination == "varpro" and not floats

    def fit(self, target: Target, options: SolverOptions) -> list[FittedLevel]:
        """Fit an image; fewer levels if the fit diverges."""
        target = target.measured(self.method).on_model(self.objectives[-1])
        noise = NO_NOISE if target.noise is None else _noise_of(target.noise, target.response)
        about = {
            "start": np.ascontiguousarray(target.start, np.float64).ravel(),
            "points": _flat(target.mapped),
            "point_precision": _NOTHING if target.pull is None else np.ascontiguousarray(target.pull, np.float64),
            "margin": float(target.margin),
            "theta_2": float(self.theta if target.theta is None else target.theta),
            "log_noise": noise,
            "first_log": LOG_RANGE[0],
            "last_log": LOG_RANGE[1],
        }
        levels, shape = [], target.start
        for objective, each in zip(self.objectives, self._call(target.linear, about, options.as_dict), strict=False):
            own = similarity_of(each.pose), each.fit, similarity_of(each.to_patch), each.patch_size
            level = FittedLevel(objective, *own)
            levels.append(level if objective is self.objectives[-1] else level.begun_at(shape))
            shape = levels[-1].reached
        return levels

    def _call(self, linear: LinearImage, about: dict, options: dict) -> list:
        image, grey = linear.image, self.encoding == "soft" and linear.grey
        floor = log_floor(linear.response)
        if image.dtype.kind == "f":
            means = linear.light_of(self.encoding)
            return self.compiled.fit_light(means.light, means.finite, grey, floor, about, options)
        table = light_table(image.dtype.str, self.encoding, linear.response)
        return self.compiled.fit(image, table, grey, floor, about, options)


def _level_fields(objective: Objective, blur: float) -> dict[str, Any]:
    warp: Any = objective.warp  # of a mesh: that is what the core can fit
    basis = np.ascontiguousarray(warp.shape_model.basis, np.float64)
    return {"objective": objective.compiled, "blur": float(blur), "density": float(objective.density), "basis": basis}


_NOTHING = np.zeros((0, 0))


def _flat(points: np.ndarray | None) -> np.ndarray:
    return np.zeros(0) if points is None else np.ascontiguousarray(points, np.float64).ravel()


def _noise_of(noise: NoiseModel | float, response: Response) -> np.ndarray:
    return noise_table(noise, response).astype(np.float32)


def solve_levels(levels: Levels, target: Target, options: SolverOptions) -> list[FittedLevel]:
    """Solve the levels from coarse to fine, each from the solution of the one before; fewer if the fit diverges."""
    target, stages = target.measured(levels[0][0].method).on_model(levels[-1][0]).averaged(levels), []
    shape = target.start
    for objective, blur in levels:
        last = objective is levels[-1][0]
        own = options if last else spare(options)
        image, state, pose = prepare_level(objective, blur, target, stages, own)
        solution = objective.solve(image, state, own, evaluate_last=last)
        level = FittedLevel(objective, pose, solution, image.patch.from_image, image.channels.shape[:2])
        stages.append(level if last else level.begun_at(shape))
        shape = stages[-1].reached
        if not is_sane(shape, target.start):
            break
    return stages


def prepare_level(
    objective: Objective, blur: float, target: Target, stages: Sequence[FittedLevel], options: SolverOptions
) -> tuple[LevelImage, State, Similarity]:
    """Return the encoded image, the initial state and the pose of a level, given the levels before it.

    The pose is updated at each level because shape modes rotate and scale with it, and the patch is cut around the
    current shape.
    """
    shape, margin = (stages[-1].reached, NEAR) if stages else (target.start, target.margin)
    warp, method = objective.warp, objective.method
    pose = align(warp.rest, shape)
    pixels = target.image if target.light is None else target.light
    about = method, target.response, blur, target.noise, margin, objective.density
    image = LevelImage.at(pixels, shape, pose, *about)
    if target.pull is not None and target.mapped is not None:
        points = warp.parameters(pose.inverse()(target.mapped))
        own = own_parameters(len(points), len(target.pull))
        image = replace(image, point_precision=target.pull[np.ix_(own, own)], points=points)
    state = objective.start(warp.parameters(pose.inverse()(shape)))
    angles = stages[-1].solution.angles if stages else _first_angles(objective, image, state, options, target.theta)
    return image, state._replace(angles=np.array(angles, np.float64)), pose


@lru_cache(maxsize=16)
def spare(options: SolverOptions) -> SolverOptions:
    """Return looser options for a coarse level, whose solution only starts the next."""
    scoring = None if options.scoring is None else 0
    tolerance = THRESHOLDS["COARSE"] * options.tolerance
    relative_tolerance = THRESHOLDS["COARSE_RELATIVE"] * options.relative_tolerance
    return replace(options, tolerance=tolerance, relative_tolerance=relative_tolerance, scoring=scoring)


def _first_angles(
    objective: Objective, image: LevelImage, state: State, options: SolverOptions, theta: float | None
) -> np.ndarray:
    if theta is not None and objective.method.free_angles == "none":
        return np.array([state.angles[0], theta])
    if objective.method.free_angles != "image" or not objective.method.solves_angle or options.angle_start == "model":
        return state.angles
    return np.array([state.angles[0], best_image_angle(objective, image, state)])


def is_sane(shape: np.ndarray, start: np.ndarray) -> bool:
    """Return whether a shape is finite and its size not too far from that of the start."""
    if not np.isfinite(shape).all():
        return False
    return THRESHOLDS["LEAST_GROWTH"] < diagonal_of(shape) / diagonal_of(start) < THRESHOLDS["MOST_GROWTH"]
