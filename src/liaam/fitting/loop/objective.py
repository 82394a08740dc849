"""The objective of a model, a method and a level: the model's side of the residual (eq 10, generalised)."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from liaam import _core
from liaam.errors import MethodError
from liaam.fitting.loop.encoded_image import EncodedImage, correlated_pixels
from liaam.fitting.methods import (
    CORRELATED,
    GRADIENT_ROWS,
    LOSSES,
    STEPS,
    WEIGHTS,
    Method,
    at_angle,
    check_holds,
    gaussian_median,
)
from liaam.fitting.reference.loop import solve_level
from liaam.fitting.reference.problem import Problem
from liaam.model import AAM, Level
from liaam.model.appearance import AppearanceModel
from liaam.model.warp import THINNING, PiecewiseAffineWarp, Warp, padded, thinning_of
from liaam.photometry.features import Encoder, name_of

RIDGE = 1e-6
"""Ridge on A'A relative to the mode's squared norm before projection by the metric. It keeps modes that the metric
cannot observe, such as pure shading under L(theta), at the mean; otherwise rounding errors determine them."""
# Weight of the prior on the shape of models whose fits start from poses: a Gaussian is wrong about parts that turn, and
# pulls them to a mean on which they are short. Of fits to 24 pictures of jointed bars from the true shape, 5 are lost
# with 1, and 1 with 0.1.
PRIOR_OF_POSES = 0.1

MOST_CODE = 32767
"""Largest code of a mode in 16 bits, as in the files of models."""


class CodedModes(NamedTuple):
    """Modes in 16 bits: each is its scale times its codes."""

    codes: np.ndarray  # (parts, n, w) int16, w = m padded with zeros to a multiple of eight
    scales: np.ndarray  # (w,) float32

    @classmethod
    def of(cls, parts: np.ndarray) -> "CodedModes":
        """Round modes (parts, m, n): a constant part, or that and those by cos and sin of an angle."""
        n_parts, m, n = parts.shape
        largest = np.abs(parts).max(axis=(0, 2), initial=0.0)
        scales = (largest / MOST_CODE).astype(np.float32)
        scales[scales < np.finfo(np.float32).tiny] = 1.0  # its codes are 0
        codes = np.zeros((n_parts, n, padded(m)), np.int16)
        for part, rounded in zip(parts, codes, strict=True):
            rounded[:, :m] = np.rint(part / scales[:, None]).T
        return cls(codes, np.pad(scales, (0, padded(m) - m)))

    def decoded(self, m: int) -> np.ndarray:
        """Return the modes, (parts, m, n) float32."""
        return (self.codes * self.scales)[:, :, :m].swapaxes(1, 2)


class State(NamedTuple):
    """The unknowns of a fit."""

    p: np.ndarray  # (n_p,) float64: parameters of the warp
    angles: np.ndarray  # (2,) float64: theta_1 (model) and theta_2 (image), radians
    lam: np.ndarray  # (m,) float64: coordinates of the appearance, extra modes last


@dataclass(frozen=True, eq=False)
class Objective:
    """The cost of a method for a model at one level (eq 10, generalised)."""

    method: Method
    warp: Warp
    appearance: AppearanceModel
    theta_model: float  # the training camera's angle, radians
    # (n_p,): precision of a Gaussian prior on p; 0 for none. The loop scales it to correct for correlated pixels, with
    # ``dof`` degrees of freedom (fitting.reference.loop.next_prior_scale); infinite for a scale of 1.
    prior: np.ndarray
    illumination: AppearanceModel | None = None  # basis, for methods that add one
    blur: float = 0.0  # of the image: its standard deviation, model pixels
    density: float = 1.0  # fraction of the frame's pixels that are used
    dof: float = np.inf
    # Appearance and illumination at all of the frame's pixels in raster order, for spatial gradients; by default those
    # at the warp's pixels.
    in_frame: tuple[AppearanceModel, AppearanceModel | None] | None = None
    prior_weight: float = 1.0  # what fits multiply the precision of the prior by
    # Number of usable pixels of the model, if the appearance has weights of 0 where the object is not complete
    n_usable_of_all: float | None = None

    @cached_property
    def weighted_prior(self) -> np.ndarray:
        """Precision of the prior on p that fits use, (n_p,) float64."""
        return self.prior_weight * np.array(self.prior, np.float64)

    @property
    def correlated(self) -> float:
        """Number of pixels per independent residual, for weights that do not account for correlation."""
        return max(1.0, self.density * correlated_pixels(self.blur))

    @property
    def n_q(self) -> int:
        """Number of warp parameters plus free angles."""
        return self.warp.n_parameters + self.method.angle_directions.shape[1]

    @property
    def n_lambda(self) -> int:
        """Number of appearance modes plus extra modes."""
        return len(self.fields["ridge"])

    @property
    def n_usable(self) -> float:
        """Number of usable pixels of the model, also of those that do not count in this image."""
        return float(self.appearance.usable.sum()) if self.n_usable_of_all is None else self.n_usable_of_all

    @property
    def is_compiled(self) -> bool:
        """Whether the core fits this objective; where it could not be built, the reference does.

        Photometric normalisation (the paper's [1]), which the experiments compare with, is in the reference only.
        """
        return _core.BUILT and not self.method.normalise

    @cached_property
    def compiled(self) -> Any:
        """The objective in the form that the core takes."""
        return _core.make_objective(self.fields)

    @cached_property
    def fields(self) -> dict[str, Any]:
        """Arrays and numbers of the objective, as ``src/core/objective.hpp`` names and describes them.

        ``mean`` and ``modes`` are P(theta_1) A_0 and P(theta_1) A_i: one part, or where theta_1 is free the constant,
        cos and sin part.
        """
        method = self.method
        mean, modes = self._coded(self._modes_of(self.appearance, self.illumination))
        mean_gradients, mode_gradients = self._coded(self._mode_gradient_parts)
        root_weights = self._root_weights()
        ridge = self._ridge()
        return {
            **(self.warp.mesh()._asdict() if isinstance(self.warp, PiecewiseAffineWarp) else {}),
            "mean": mean,
            "modes": modes.codes,
            "mode_scales": modes.scales,
            "mean_gradients": mean_gradients,
            "mode_gradients": mode_gradients.codes,
            "mode_gradient_scales": mode_gradients.scales,
            "sqrt_weights": root_weights,
            "gram": self._gram(modes, root_weights, len(ridge)),
            "ridge": ridge,
            "errors": self.error_variances(),
            "prior": self.weighted_prior,
            "correlated": float(self.correlated),
            "dof": float(self.dof),
            "colours": self._knows_colours,
            "metric": method.metric_parts.astype(np.float32).reshape(3, -1),
            "directions": np.ascontiguousarray(method.angle_directions, dtype=np.float64),
            "weighting": WEIGHTS.index(method.weights),
            "loss": LOSSES.index(method.loss) + 1 if method.loss in LOSSES else 0,
            "gaussian_median": gaussian_median(method.n_rows) if method.loss in LOSSES else 1.0,
            "step": STEPS.index(method.step),
        }

    def _coded(self, parts: np.ndarray) -> tuple[np.ndarray, CodedModes]:
        """Return the mean (parts, n k), and the modes in 16 bits, of both (parts, 1 + m, ...)."""
        flat = parts.reshape(*parts.shape[:2], -1)
        return np.ascontiguousarray(flat[:, 0]), CodedModes.of(flat[:, 1:])

    def _gram(self, modes: CodedModes, root_weights: np.ndarray, m: int) -> np.ndarray:
        """A'A under weights, (m, m) float64, at the model's angle."""
        if len(modes.codes) == 1 and self.is_compiled:
            return _core.weighted_gram(modes.codes[0], modes.scales, m, root_weights)
        parts = modes.decoded(m)
        own = at_angle(parts, self.theta_model) if len(parts) > 1 else parts[0]
        weighted = own.astype(np.float64) * root_weights
        return weighted @ weighted.T

    @property
    def mean_and_modes(self) -> np.ndarray:
        """P(theta_1) A_0 and P(theta_1) A_i as fits use them, (parts, 1 + m, n k) float32."""
        return self._decoded("mean", "modes", "mode_scales")

    @property
    def gradients_of_modes(self) -> np.ndarray:
        """Spatial gradients of the same, (parts, 1 + m, 2 n k) float32."""
        return self._decoded("mean_gradients", "mode_gradients", "mode_gradient_scales")

    def _decoded(self, mean: str, codes: str, scales: str) -> np.ndarray:
        modes = CodedModes(self.fields[codes], self.fields[scales]).decoded(self.n_lambda)
        return np.concatenate([self.fields[mean][:, None], modes], axis=1)

    def _root_weights(self) -> np.ndarray:
        """Square roots of the model's weights, (n k,) float32."""
        return np.repeat(np.sqrt(self.appearance.usable), self.method.n_rows).astype(np.float32)

    def with_weights(self, weights: np.ndarray) -> "Objective":
        """Return the objective with the model's weights multiplied by others, (n,) of [0, 1].

        The prior of lambda stays that of all pixels.
        """
        usable = (self.appearance.usable * weights).astype(self.appearance.usable.dtype)
        other = replace(self, appearance=replace(self.appearance, usable=usable), n_usable_of_all=self.n_usable)
        root_weights = other._root_weights()
        gram = self._gram(CodedModes(self.fields["modes"], self.fields["mode_scales"]), root_weights, self.n_lambda)
        # The other fields are the same, and take long to make.
        other.__dict__["fields"] = {**self.fields, "sqrt_weights": root_weights, "gram": gram}
        return other

    def __getstate__(self) -> dict:
        """Leave out what the core holds, which is valid in this process only."""
        return {name: value for name, value in self.__dict__.items() if name != "compiled"}

    @property
    def _turns(self) -> bool:
        """Whether theta_1, and so the model's side, changes during a fit."""
        return bool(self.method.angle_directions[0].any())

    def _textures(self, appearance: AppearanceModel, illumination: AppearanceModel | None) -> list[np.ndarray]:
        """Return the mean, the modes and what the method adds to them, each (count, n, c)."""
        added = [illumination.modes] if self.method.illumination and illumination is not None else []
        gain = [appearance.mean[None]] if self.method.gain else []  # its mode is the mean
        return [appearance.mean[None], appearance.modes, *added, *gain]

    def _modes_of(self, appearance: AppearanceModel, illumination: AppearanceModel | None) -> np.ndarray:
        """Return mean and modes projected by the parts of P, (1 or 3, 1 + m, n, k) float32.

        Three parts, constant, cos and sin, if theta_1 is free; else one at the model's angle.
        """
        n = len(appearance.mean)
        k = self.method.n_rows
        metrics = self.method.model_metric_parts
        if not self._turns:
            metrics = at_angle(metrics, self.theta_model)[None]
        textures = self._textures(appearance, illumination)
        bias = {"none": np.zeros((0, 1, k)), "common": np.ones((1, 1, k)), "rows": np.eye(k)[:, None]}[self.method.bias]
        parts = np.empty((len(metrics), sum(map(len, textures)) + len(bias), n, k), np.float32)
        begin = 0
        for texture in textures:
            end = begin + len(texture)
            for part, metric in zip(parts, metrics.astype(np.float32), strict=True):
                np.matmul(texture, metric.T, out=part[begin:end])
            begin = end
        parts[0, begin:] = bias
        parts[1:, begin:] = 0.0
        return parts

    def _ridge(self) -> np.ndarray:
        """Return the ridge on the diagonal of A'A, (m,) float64, from the norms of the modes before projection."""
        appearance = self.appearance
        k = self.method.n_rows
        textures = self._textures(appearance, self.illumination)[1:]
        sizes = [np.square(texture, dtype=np.float64).sum(axis=(1, 2)) for texture in textures]
        biases = {"none": [], "common": [k * len(appearance.mean)], "rows": [len(appearance.mean)] * k}
        ridge = RIDGE * np.maximum(np.concatenate([*sizes, biases[self.method.bias]]), 1e-12)
        ridge[: appearance.n_modes] += self._ordinary_unit() / np.maximum(appearance.eigenvalues, 1e-12)
        return ridge

    def _ordinary_unit(self) -> float:
        """Return the variance at weight 1 in images like those of training, for weights by rows; else 0.

        It converts the prior of lambda, N(0, eigenvalues), to units of squared residuals. If an image leaves more
        unexplained than training images do, its appearance may deviate as much more: the common scale cancels.
        """
        unexplained = self.appearance.unexplained
        usable = self.appearance.usable
        if self.method.weights != "rows" or unexplained is None or not usable.any():
            return 0.0
        variances = np.average(np.einsum("ncc->nc", unexplained), axis=0, weights=usable)
        group = np.where(np.arange(len(variances)) < GRADIENT_ROWS, 0, 1)
        precisions = 1.0 / (CORRELATED[group] * np.maximum(variances, 1e-9))
        return float(self.correlated / np.where(self._knows_colours | (group == 0), precisions, 0.0).mean())

    @property
    def _knows_colours(self) -> bool:
        return bool(self.appearance.mean[:, -1].any())

    @cached_property
    def _mode_gradient_parts(self) -> np.ndarray:
        """Spatial gradients of what :meth:`_modes_of` returns, (1 or 3, 1 + m, 2 n k) float32.

        They are empty for methods that use none.
        """
        parts = self._modes_of(*(self.in_frame or (self.appearance, self.illumination)))
        if not self.method.expects:
            return np.zeros((*parts.shape[:2], 0), np.float32)
        n_parts, n_modes, n_all, k = parts.shape
        columns = parts.transpose(2, 0, 1, 3).reshape(n_all, -1)
        slopes = self.warp.slopes(columns).reshape(-1, 2, n_parts, n_modes, k)
        return np.ascontiguousarray(slopes.transpose(2, 3, 0, 1, 4), np.float32).reshape(n_parts, n_modes, -1)

    def error_variances(self, n_rows: int | None = None) -> np.ndarray:
        """Return the variance of the model's errors, mean over all or the first rows of P, (n,); 0 if unknown."""
        unexplained = self.appearance.unexplained
        if unexplained is None:
            return np.zeros(len(self.appearance.mean))
        metric = self.method.model_metric(self.theta_model)[:n_rows]
        return np.einsum("kc,ncd,kd->n", metric, unexplained, metric, optimize=True) / len(metric)

    def start(self, p: np.ndarray) -> State:
        """Return a state with the mean appearance and the model's angle for both cameras."""
        return State(np.array(p, np.float64), np.full(2, self.theta_model), np.zeros(self.n_lambda))

    def mean_at(self, theta: float) -> np.ndarray:
        """Return P(theta_1) A_0, (n k,)."""
        mean = self.fields["mean"]
        return mean[0] if len(mean) == 1 else np.array([1.0, np.cos(theta), np.sin(theta)]) @ mean

    def problem(self, image: EncodedImage) -> Any:
        """Return the objective at an image, in the parts that the loop calls (:class:`Problem`)."""
        return _core.Problem(self.compiled, image.compiled) if self.is_compiled else Problem(self, image)

    def evaluate(self, image: EncodedImage, state: State, weigh: int = 0, solves: bool = False) -> dict[str, Any]:
        """Evaluate the residual of a state, solve for lambda there if asked, and update the weights ``weigh`` times.

        The result are the arrays of :meth:`Problem.arrays`.
        """
        problem = self.problem(image)
        problem.begin(state.p, tuple(state.angles), state.lam)
        problem.evaluate(solves)
        for _ in range(weigh):
            problem.reweigh(solves)
        return problem.arrays()

    def solve(self, image: EncodedImage, state: State, options: Any, evaluate_last: bool = True) -> Any:
        """Minimise the cost over one image from a state (:class:`liaam.fitting.loop.options.SolverOptions`).

        A fit that fails is returned, not raised. The solution is a ``Solution`` of the core or of the reference, which
        alone has the joint elimination of the appearance (the paper's, for the experiments).
        """
        p = state.p
        angles = tuple(state.angles.tolist())
        lam = state.lam
        if self.is_compiled and options.elimination == "varpro":
            controls = options.as_dict, image.blur, evaluate_last
            return _core.solve_level(self.compiled, image.compiled, p, angles, lam, *controls)
        return solve_level(self, image, p, angles, lam, options, image.blur, evaluate_last)

    def noise_variance(self, solution: Any) -> float:
        """Return the variance at weight 1, including correlation, from the weights or else from the cost."""
        if self.method.weights == "rows" and np.isfinite(solution.noise_variance):
            return float(solution.noise_variance)
        return float(self.correlated * solution.squares / solution.weight) if solution.weight > 0 else 0.0


def pixels_for(warp: PiecewiseAffineWarp, blur: float) -> np.ndarray:
    """Return a mask of the pixels that fits at a level need: those sampled, and the rows and columns through them.

    The gradients of the model's textures are those of splines along rows and columns.
    """
    pixels = warp.frame.pixels
    sampled = pixels[warp.every(THINNING * blur)]
    return np.isin(pixels[:, 0], sampled[:, 0]) | np.isin(pixels[:, 1], sampled[:, 1])


def make_objectives(
    model: AAM, method: Method, thinning: float | None = None, final_prior: float = 1.0
) -> tuple[Objective, ...]:
    """Make the objectives of a model and a method, one per level, coarse to fine.

    ``final_prior`` is the weight of the prior on the shape at the finest level. Coarser levels have all of it, to find
    the object, unless fits start from poses, which are near it.
    ``thinning`` is the distance between sampled pixels, in standard deviations of a level's blur; by default that of
    :func:`liaam.model.warp.thinning_of`. MethodError is raised if the model lacks what the method needs, such as
    colour.
    """
    if method.needs_colour and not model.is_colour:
        raise MethodError(
            f"method {method.name} compares colours, but the model was trained on grey images; "
            "use method 'soft-li' or 'grey'"
        )
    method = _encoded(model, method)
    check_holds(model, method)
    if thinning is None:
        thinning = thinning_of(method.encoding_name)
    warp = model.views[method.view].warp
    levels = model.views[method.view].levels
    seen = [replace(warp, shape_model=warp.shape_model.seen_at(level.blur)) for level in levels[:-1]]
    objectives = [_objective(model, method, *each, thinning) for each in zip([*seen, warp], levels, strict=True)]
    if model.poses is not None:
        return tuple(replace(each, prior_weight=final_prior) for each in objectives)
    objectives[-1] = replace(objectives[-1], prior_weight=final_prior)
    return tuple(objectives)


def _objective(model: AAM, method: Method, warp: PiecewiseAffineWarp, level: Level, thinning: float) -> Objective:
    """Make the objective of one level, on a thinned set of pixels."""
    appearance = level.appearances[method.appearance]
    illumination = level.appearances.get("illumination")
    # Estimating the prior's scale needs weights that account for correlation.
    dof = warp.shape_model.freedom if method.weights == "rows" else np.inf
    # N(0, eigenvalue) for the shape modes; the four similarity vectors have no prior.
    prior = np.concatenate([1.0 / np.maximum(warp.shape_model.eigenvalues, 1e-12), np.zeros(4)])

    pixels = warp.every(thinning * level.blur)
    return Objective(
        method,
        warp.at(pixels),
        appearance.at(pixels),
        model.theta,
        prior,
        None if illumination is None else illumination.at(pixels),
        blur=level.blur,
        density=len(pixels) / len(appearance.mean),
        dof=dof,
        in_frame=(appearance, illumination),
    )


def _encoded(model: AAM, method: Method) -> Method:
    """Return a method whose encoding, if it is a function of the user, ends with the model's projection."""
    if not callable(method.encoding) or isinstance(method.encoding, Encoder):
        return method
    function: Any = method.encoding
    features = model.features
    name = name_of(function)
    if features is None or features.name != name:
        given = "was trained without features" if features is None else f"was trained with the features {features.name}"
        raise MethodError(
            f"method {method.name} compares the features {name}, but the model {given}; train it with this function "
            "(train(..., features=function))"
        )
    return replace(method, encoding=Encoder(function, features))
