"""The one objective of all methods: encoding, metric, appearance, free angles (DESIGN section 1).

The residual at model pixel x, for shape parameters p, angles theta = (theta_1, theta_2) and appearance
coordinates lambda (paper eq 9, generalised):

    r(x) = w(x) [ P(theta_2) E(I(W(x; p))) - P(theta_1) A0(x) - sum_i lambda_i P(theta_1) A_i(x) ]

Extra modes (gain, bias, illumination) stand behind the appearance's own in lambda. The weights w(x) are the
model's own, or those of a :class:`Trust` worked out between iterations.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from liaam.appearance import AppearanceModel
from liaam.errors import MethodError
from liaam.fitting.losses import LOSSES, robust_scale
from liaam.fitting.methods import Method
from liaam.fitting.normal_equations import NormalEquations, gram, regular_inverse
from liaam.kernels import get_kernel
from liaam.model import AAM
from liaam.photometry import LUMINANCE, NoiseModel, Response, from_linear, log_slope, noise_deviation
from liaam.photometry.encoding import LOG_FLOOR, SOFTNESS
from liaam.sampling import Patch, make_patch
from liaam.shape import Similarity
from liaam.warp import Warp


@dataclass(frozen=True, eq=False)
class State:
    """Where a fit stands.

    Attributes
    ----------
    p : (n_p,) float64
        Warp parameters.
    angles : (2,) float64
        theta_1 (model) and theta_2 (image), radians.
    lam : (m,) float64
        Appearance coordinates, extra modes last.
    """

    p: np.ndarray
    angles: np.ndarray
    lam: np.ndarray


MARGIN = 0.6
"""Surroundings of the start that a fit may visit, as a share of the object's diagonal."""


@dataclass(frozen=True, eq=False)
class FitProblem:
    """One image to be fitted, as a method sees it.

    Attributes
    ----------
    patch : Patch
        Encoded surroundings of the start.
    pose : Similarity
        Model pixels to patch pixels.
    response : Response
        Of the image's camera.
    noise : float or NoiseModel
        Standard deviation of the noise that the patch's averaging leaves, in stored values of [0, 1]; or what is known
        of the camera's noise, in linear light.
    noise_left : float
        Share of it that the blur of the encoded channels leaves.
    slope_left : float
        Standard deviation of a gradient per model pixel that noise of unit deviation leaves after the blur.
    blur : float
        Model pixels.
    """

    patch: Patch
    pose: Similarity
    response: Response = "srgb"
    noise: float | NoiseModel = 0.0
    noise_left: float = 1.0
    slope_left: float = 1.0
    blur: float = 0.0

    @classmethod
    def at(
        cls,
        image: np.ndarray,
        shape: np.ndarray,
        pose: Similarity,
        method: Method,
        response: Response,
        blur: float,
        noise: NoiseModel | None = None,
    ) -> "FitProblem":
        """Cut and encode an image around a shape.

        Parameters
        ----------
        image : (h, w, 3) uint8, uint16 or float32
        shape : (n, 2) float
            Start, image pixels.
        pose : Similarity
            Model pixels to image pixels.
        method : Method
        response : Response
            Of the image's camera.
        blur : float
            Model pixels.
        noise : NoiseModel, optional
            Of the image's camera; measured in the image if left out.
        """
        patch = make_patch(image, shape, pose, encoding=method.encoding, response=response, blur=blur, margin=MARGIN)
        to_patch = Similarity(patch.from_image.matrix @ pose.matrix, patch.from_image(pose.offset[None])[0])
        if not method.weighs_noise:
            return cls(patch, to_patch, response, blur=blur)
        left, slope_left = _noise_left(to_patch.scale, blur)
        return cls(patch, to_patch, response, _noise(image, shape, patch, noise), left, slope_left, blur)


def tied_together(blur: float) -> float:
    """Pixels that a Gaussian blur ties together to one independent value, 4 pi blur^2 or 1.

    It is also what the blur divides white noise's variance by.

    Parameters
    ----------
    blur : float
        Standard deviation, pixels.
    """
    return max(1.0, 4.0 * np.pi * blur**2)


def slope_left(blur: float) -> float:
    """Standard deviation of a central difference of white noise of unit deviation under a Gaussian blur, pixels."""
    return float(np.sqrt((1.0 - np.exp(-1.0 / blur**2)) / (8.0 * np.pi * blur**2))) if blur > 0.3 else np.sqrt(0.5)


def _noise_left(scale: float, blur: float) -> tuple[float, float]:
    """What a blur (model pixels; ``scale`` patch pixels each) leaves of noise, and of its gradient per model pixel."""
    return 1.0 / np.sqrt(tied_together(scale * blur)), scale * slope_left(scale * blur)


def _noise(image: np.ndarray, shape: np.ndarray, patch: Patch, known: NoiseModel | None) -> float | NoiseModel:
    """Noise around a shape after a patch's averaging."""
    reduce = 1.0 / patch.from_image.scale
    if known is not None:
        return NoiseModel(known.slope / reduce**2, known.offset / reduce**2)
    low = np.maximum(shape.min(axis=0).astype(int), 0)
    high = np.maximum(shape.max(axis=0).astype(int) + 2, low + 8)
    return noise_deviation(image[low[1] : high[1], low[0] : high[0]]) / reduce


@dataclass(frozen=True, eq=False)
class _Weighted:
    """Model side under weights that do not turn with an angle: worked out once for all iterations they are used in.

    Attributes
    ----------
    root : (n_pixels, k) float32
        Root of the weights.
    modes : (n_pixels * k, m) float32
    aa : (m, m) float64
        Gram matrix of the weighted modes.
    inverse : (m, m) float64
        Its inverse.
    """

    root: np.ndarray
    modes: np.ndarray
    aa: np.ndarray
    inverse: np.ndarray


@dataclass(frozen=True, eq=False)
class Trust:
    """How far each pixel is trusted: worked out between iterations, frozen within one.

    Attributes
    ----------
    weights : (n_pixels,) float32
        By the robust loss; 1 without one.
    noise : (n_pixels, c) float64, optional
        Variance of the encoded channels by the image's noise.
    model : (n_pixels, k) or (n_pixels, 1) float64, optional
        Variance of the residual by the model's errors; goes with ``noise``.
    unit : float
        Variance that weighs 1: weights are 1 on average, so that a cost is the variance of such a residual.
    gain, offset : float
        Normalisation of the image's samples: they are compared as gain * E(I) + offset.
    unexplained : tuple of float
        Variance of the model's errors by group of rows, where it is estimated so.
    weighted : _Weighted, optional
        The model side under these weights, where they hold for every angle.
    """

    weights: np.ndarray
    noise: np.ndarray | None = None
    model: np.ndarray | None = None
    unit: float = 1.0
    gain: float = 1.0
    offset: float = 0.0
    unexplained: tuple[float, ...] = ()
    weighted: _Weighted | None = None

    def variance(self, metric: np.ndarray) -> np.ndarray | None:
        """Variance of the residual in each row of P, (n_pixels, k) float64; None where it is not modelled."""
        if self.noise is None or self.model is None:
            return None
        return self.noise @ np.square(metric).T + self.model


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Normal equations at a state, and what the pixels looked like there.

    Attributes
    ----------
    equations : NormalEquations
    residual : (n_pixels, k) float32
        P E(I) - P A, unweighted.
    values : (n_pixels, c) float32
        Encoded samples of the image.
    weights : (n_pixels,) float32
        Image weight in {0, 1}.
    """

    equations: NormalEquations
    residual: np.ndarray
    values: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True, eq=False)
class _Design:
    """Model side of the residual at one theta_1: weighted columns, ready for BLAS.

    Attributes
    ----------
    mean : (n, k) float32, unweighted
    modes : (n * k, m) float32, unweighted
    weighted : (n * k, m) float32
    aa : (m, m) float64
        Gram matrix of the weighted modes.
    inverse : (m, m) float64
        Its inverse.
    """

    mean: np.ndarray
    modes: np.ndarray
    weighted: np.ndarray
    aa: np.ndarray
    inverse: np.ndarray


@dataclass(frozen=True, eq=False)
class Objective:
    """A model seen through a method.

    Attributes
    ----------
    method : Method
    warp : Warp
    appearance : AppearanceModel
    theta_model : float
        The training camera's angle, radians.
    prior : (n_p,) float64
        Precision of a Gaussian prior on p, 0 where there is none. The sum of squares over all pixels overstates the
        evidence by as many pixels as are tied together; :meth:`unit` makes up for it.
    kernel : {"fast", "reference"}
    illumination : AppearanceModel, optional
        Illumination basis, for methods that add one.
    tied : float
        Pixels that stand for one independent residual, where the weights do not know it themselves.
    """

    method: Method
    warp: Warp
    appearance: AppearanceModel
    theta_model: float
    prior: np.ndarray
    kernel: str = "fast"
    illumination: AppearanceModel | None = None
    tied: float = 1.0

    def unit(self, equations: NormalEquations) -> float:
        """Variance, correlation included, that a residual of weight 1 stands for: the weights' own, or the cost's."""
        if np.isfinite(equations.unit):
            return equations.unit
        return self.tied * equations.cost if np.isfinite(equations.cost) else 0.0

    @cached_property
    def root_weights(self) -> np.ndarray:
        """Square root of the weight of each model pixel and row of P, (n_pixels, k) float32."""
        return np.repeat(np.sqrt(self.appearance.usable)[:, None], self.method.n_rows, axis=1)

    @property
    def n_q(self) -> int:
        """Warp parameters plus free angles."""
        return self.warp.n_parameters + self.method.angle_directions.shape[1]

    @property
    def n_lambda(self) -> int:
        """Appearance modes plus extra modes."""
        return self._fixed_design.modes.shape[1]

    @cached_property
    def _fixed_design(self) -> _Design:
        return self._make_design(self.theta_model)

    def design(self, theta: float) -> _Design:
        """Model side at an angle theta_1; made once where the method keeps it fixed."""
        if not self.method.angle_directions[0].any() and theta == self.theta_model:
            return self._fixed_design
        return self._make_design(theta)

    def _make_design(self, theta: float) -> _Design:
        metric = self.method.model_metric(theta).astype(np.float32)
        mean = self.appearance.mean @ metric.T
        modes = np.einsum("mnc,kc->nkm", self.appearance.modes, metric)
        modes = np.concatenate([modes, *self._extra_modes(mean, metric)], axis=2)
        modes = np.ascontiguousarray(modes.reshape(mean.size, -1), dtype=np.float32)
        weighted = modes * self.root_weights.reshape(-1, 1)
        aa = gram(weighted, weighted)
        return _Design(mean, modes, weighted, aa, regular_inverse(aa))

    def _extra_modes(self, mean: np.ndarray, metric: np.ndarray) -> list[np.ndarray]:
        n, k = mean.shape
        extra = []
        if self.method.illumination and self.illumination is not None:
            extra.append(np.einsum("mnc,kc->nkm", self.illumination.modes, metric))
        if self.method.gain:
            extra.append(mean[:, :, None])
        if self.method.bias == "common":
            extra.append(np.ones((n, k, 1), np.float32))
        if self.method.bias == "rows":
            extra.append(np.broadcast_to(np.eye(k, dtype=np.float32), (n, k, k)))
        return extra

    def start(self, p: np.ndarray) -> State:
        """State with mean appearance and the model's own angle for both cameras."""
        return State(p, np.array([self.theta_model, self.theta_model]), np.zeros(self.n_lambda))

    def update(self, state: State, step: np.ndarray, lambda_step: np.ndarray) -> State:
        """State after a Gauss-Newton step of (p, free angles) and lambda."""
        n_p = self.warp.n_parameters
        return State(
            self.warp.update(state.p, step[:n_p]),
            state.angles + self.method.angle_directions @ step[n_p:],
            state.lam + lambda_step,
        )

    def linearise(
        self,
        problem: FitProblem,
        state: State,
        workspace: np.ndarray | None = None,
        trust: Trust | None = None,
        own_gradient: bool = False,
    ) -> Linearisation:
        """Residual and normal equations at a state.

        Parameters
        ----------
        problem : FitProblem
        state : State
        workspace : (n_pixels * k, n_q + 1) float32, optional
            Overwritten with the weighted columns [J | r]; pass the same array every time to allocate
            nothing large in the loop.
        trust : Trust, optional
            Of :meth:`trust` at an earlier state, for methods that re-weigh.
        own_gradient : bool
            Take the gradient of the model's appearance instead of the image's: the same where they agree,
            and free of the image's noise.
        """
        theta_model, theta_image = state.angles
        design = self.design(theta_model)
        metric = self.method.image_metric(theta_image)
        columns = self.workspace() if workspace is None else workspace
        gain, offset = (1.0, 0.0) if trust is None else (trust.gain, trust.offset)
        own_root, root_slope = self._root_weights(theta_image, trust)
        values, projected, weights = get_kernel(self.kernel).linearise(
            problem.patch.channels,
            self.warp.points(state.p, problem.pose),
            self.warp.jacobian(state.p),
            problem.pose.matrix if gain == 1.0 else gain * problem.pose.matrix,
            metric,
            own_root,
            columns,
        )
        lam = state.lam.astype(np.float32)
        residual = projected - design.mean
        with np.errstate(over="ignore", invalid="ignore"):  # a fit that blows up; its cost says so
            residual -= (design.modes @ lam).reshape(residual.shape)
        if (gain, offset) != (1.0, 0.0):  # rows of P see a common offset by their sum
            residual += (gain - 1.0) * projected + (offset * metric.sum(axis=1)).astype(np.float32)
        root = own_root * weights[:, None]
        n_p = self.warp.n_parameters
        if own_gradient:
            columns[:, :n_p] = self._model_columns(state, design, root)
        if self.n_q > n_p:
            columns[:, n_p : self.n_q] = self.angle_columns(state, values, lam, root)
        if root_slope is not None:
            by_weight = root_slope * weights[:, None] * residual
            columns[:, n_p : self.n_q] += by_weight.reshape(-1, 1) * self.method.angle_directions[1].astype(np.float32)
        columns[:, -1] = (root * residual).ravel()
        equations = self._equations(columns, design, weights, own_root, trust)
        return Linearisation(equations, residual, values, weights)

    def _model_columns(self, state: State, design: _Design, root: np.ndarray) -> np.ndarray:
        """Weighted dr/dp by the gradient of the fitted appearance instead of the image's, (n * k, n_p)."""
        predicted = design.mean + (design.modes @ state.lam.astype(np.float32)).reshape(design.mean.shape)
        slope = root[:, None, :] * self.warp.pulled_gradient(predicted, state.p)
        columns = np.einsum("nak,naj->nkj", slope, self.warp.jacobian(state.p), optimize=True)
        return columns.reshape(predicted.size, -1)

    def _root_weights(self, theta: float, trust: Trust | None) -> tuple[np.ndarray, np.ndarray | None]:
        """Root of the weights (n, k), and its derivative by theta_2 where noise makes it depend on that.

        Whitening by the noise is differentiated along with the residual: var L(theta) depends on the angle, and
        a weight frozen at the old angle leaves the plain sum of squares' pull towards angles of little noise.
        """
        if trust is None:
            return self.root_weights, None
        if trust.weighted is not None:
            return trust.weighted.root, None
        root = self.root_weights * np.sqrt(trust.weights)[:, None]
        metric = self.method.image_metric(theta)
        variance = trust.variance(metric)
        if variance is None or trust.noise is None:
            return root, None
        root = (root * np.sqrt(trust.unit / variance)).astype(np.float32)
        if not self.method.angle_directions[1].any():
            return root, None
        growth = trust.noise @ (2.0 * metric * self.method.image_metric_derivative(theta)).T
        return root, (-0.5 * root * growth / variance).astype(np.float32)

    def trust(
        self, problem: FitProblem, state: State, seen: Linearisation, before: Trust | None = None
    ) -> Trust | None:
        """Work out what the next iteration freezes, from what the pixels look like at a state.

        Returns
        -------
        Trust or None
            None for methods that weigh all pixels as the model does, and where no pixel counts; ``before`` itself
            where little has changed.
        """
        method, usable = self.method, seen.weights * self.appearance.usable > 0
        if not method.reweighs or not usable.any():
            return None
        metric = method.image_metric(state.angles[1])
        gain, offset = self._normalisation(seen.values @ metric.T, usable) if method.normalise else (1.0, 0.0)
        trust = Trust(np.ones(len(usable), np.float32), gain=gain, offset=offset)
        if method.noise_weights:
            trust = replace(trust, **self._variances(problem, state, seen, usable))
        if method.soft:
            trust = replace(trust, **self._soft_variances(problem, metric, seen, usable))
            if before is not None and method.loss == "squares" and _alike(before, trust):
                return before
        if method.loss != "squares":
            trust = replace(trust, weights=self._robust_weights(seen.residual, trust.variance(metric), usable))
        # Weights by noise turn with a free angle.
        turns = trust.noise is not None and method.angle_directions.any()
        return trust if turns or method.angle_directions[0].any() else replace(trust, weighted=self._weighted(trust))

    def _weighted(self, trust: Trust) -> _Weighted:
        root = self._root_weights(self.theta_model, trust)[0]
        modes = self._fixed_design.modes * root.reshape(-1, 1)
        aa = gram(modes, modes)
        return _Weighted(root, modes, aa, regular_inverse(aa))

    def _normalisation(self, samples: np.ndarray, usable: np.ndarray) -> tuple[float, float]:
        """Gain and offset that bring samples to the mean and deviation of the model's mean."""
        own, seen = self._fixed_design.mean[usable], samples[usable]
        spread = float(seen.std(dtype=np.float64))
        gain = float(own.std(dtype=np.float64)) / spread if spread > 1e-6 else 1.0
        return gain, float(own.mean(dtype=np.float64) - gain * seen.mean(dtype=np.float64))

    def _variances(self, problem: FitProblem, state: State, seen: Linearisation, usable: np.ndarray) -> dict:
        """Variance by noise and by the model's errors, and the one that weighs 1.

        The model's errors are those of leaving one training image out, times a factor that makes the residuals
        at hand most likely: nought where noise alone explains them.
        """
        relative = _relative_noise(np.exp(seen.values.astype(np.float64)), problem)
        # A blur averages noise away, but not what the logarithm's curvature makes of it: log(rho + n) is low by
        # up to half its relative variance on average.
        noise = np.square(problem.noise_left * relative) + np.square(0.5 * np.square(relative))
        metric = self.method.image_metric(state.angles[1])
        by_noise = noise @ np.square(metric).mean(axis=0)
        by_model = self._unexplained(state.angles[0])
        squares = np.square(seen.residual, dtype=np.float64).mean(axis=1)[usable]
        factor = _likeliest_factor(squares, by_noise[usable], by_model[usable])
        model = factor * by_model
        unit = float(1.0 / np.mean(1.0 / (by_noise + model)[usable]))
        return {"noise": noise, "model": model[:, None], "unit": unit}

    def _soft_variances(self, problem: FitProblem, metric: np.ndarray, seen: Linearisation, usable: np.ndarray) -> dict:
        """Variance by noise and by what the model leaves unexplained, both as strong as their correlation makes them.

        What is unexplained is alike within the gradient's rows and within the invariant's, and is what the residual at
        hand has beyond noise: where the light is as in training the invariant is precise, where it is not, or where
        colours carry JPEG's errors, it steps back behind the gradient, and the other way round in noise.
        """
        # Pixels of a picture smaller than the model's frame are spread over several of the frame's.
        tied = max(tied_together(problem.blur), 1.0 / problem.pose.scale**2)
        noise = _soft_noise(seen.values.astype(np.float64), problem)
        if not self.appearance.mean[:, 2].any():  # learnt from grey pictures
            noise[:, 2:5] = UNKNOWN
        by_noise = noise @ np.square(metric).T
        squares = np.square(seen.residual, dtype=np.float64)
        model, found = np.empty_like(by_noise), []
        for rows, correlated in SOFT_ROWS:
            known = usable[:, None] & (by_noise[:, rows] < 0.5 * UNKNOWN)
            unexplained = _mean(squares[:, rows] - by_noise[:, rows], known)
            floor = LEAST_UNEXPLAINED * _mean(squares[:, rows], known) + 1e-9
            found.append(max(unexplained, floor))
            model[:, rows] = correlated * tied * found[-1]
        noise *= tied
        variance = (noise @ np.square(metric).T + model)[usable]
        unit = float(1.0 / np.mean(1.0 / variance))
        return {"noise": noise, "model": model, "unit": unit, "unexplained": tuple(found)}

    def _unexplained(self, theta: float) -> np.ndarray:
        """Variance of the model's errors in rows of P on average, (n_pixels,) float64; 0 where it is not known."""
        unexplained = self.appearance.unexplained
        if unexplained is None:
            return np.zeros(len(self.appearance.mean))
        metric = self.method.model_metric(theta)
        return np.einsum("kc,ncd,kd->n", metric, unexplained, metric, optimize=True) / len(metric)

    def _robust_weights(self, residual: np.ndarray, variance: np.ndarray | None, usable: np.ndarray) -> np.ndarray:
        """Weights by the method's loss, (n_pixels,) float32."""
        loss = LOSSES[self.method.loss]
        squares = np.square(residual, dtype=np.float64)
        sizes = np.sqrt(squares.mean(axis=1))
        if self.method.loss == "learnt":
            # A picture under another light leaves more everywhere: the median pixel still counts.
            deviation = np.sqrt(self._unexplained(self.theta_model) + 1e-12)
            u = sizes / deviation
            weights = loss(u / max(robust_scale(u[usable], residual.shape[1]), 1.0)) / deviation
            return (weights / max(weights[usable].mean(), 1e-300)).astype(np.float32)
        u = sizes if variance is None else np.sqrt((squares / variance).mean(axis=1))
        return loss(u / max(robust_scale(u[usable], residual.shape[1]), 1e-9)).astype(np.float32)

    def workspace(self) -> np.ndarray:
        """Give an array for the columns [J | r] of one linearisation."""
        n = len(self.appearance.mean) * self.method.n_rows
        return np.empty((n, self.n_q + 1), dtype=np.float32)

    def angle_columns(self, state: State, values: np.ndarray, lam: np.ndarray, root: np.ndarray) -> np.ndarray:
        """Weighted dr/d(free angles), (n * k, n_free): the angle terms of paper eq 10."""
        directions = self.method.angle_directions.astype(np.float32)
        by_image = values @ self.method.image_metric_derivative(state.angles[1]).T.astype(np.float32)
        columns = (root * by_image).reshape(-1, 1) * directions[1]
        if directions[0].any():
            texture = self.appearance.texture(lam[: self.appearance.n_modes])
            by_model = texture @ self.method.model_metric_derivative(state.angles[0]).T.astype(np.float32)
            columns -= (root * by_model).reshape(-1, 1) * directions[0]
        return columns

    def _equations(
        self, columns: np.ndarray, design: _Design, weights: np.ndarray, root: np.ndarray, trust: Trust | None
    ) -> NormalEquations:
        """Normal equations of the weighted columns; ``root`` gives the pixels' own weights."""
        rows = self.method.n_rows
        weighted, aa, inverse, own_weights = design.weighted, design.aa, design.inverse, rows * self.appearance.usable
        if trust is not None:
            own_weights = np.square(root).sum(axis=1)
            if trust.weighted is not None:
                weighted, aa, inverse = trust.weighted.modes, trust.weighted.aa, trust.weighted.inverse
            else:
                weighted = design.modes * root.reshape(-1, 1)
                aa, inverse = gram(weighted, weighted), None
        own, cross = gram(columns, columns), gram(columns, weighted).T
        blind = weights == 0
        if blind.any():
            unseen = weighted[np.repeat(blind, rows)]
            aa, inverse = aa - gram(unseen, unseen), None
        weight = float(own_weights @ weights)
        unit = trust.unit if trust is not None and self.method.soft else np.nan
        return NormalEquations(
            own[:-1, :-1], own[:-1, -1], cross[:, :-1], aa, cross[:, -1], float(own[-1, -1]), weight, inverse, unit
        )


def _relative_noise(linear: np.ndarray, problem: FitProblem) -> np.ndarray:
    """Standard deviation of the logarithm of linear light (any shape) by the image's noise."""
    if isinstance(problem.noise, NoiseModel):
        return np.sqrt(problem.noise.variance(linear)) / np.maximum(linear, 1e-6)
    stored = np.maximum(from_linear(linear, problem.response), 1e-3)
    return problem.noise * log_slope(stored, problem.response)


SOFT_ROWS = ((slice(0, 2), 8.0), (slice(2, 3), 30.0))
"""Rows of the metric ``soft`` whose unexplained part is alike, and by how much more it is correlated than the blur
makes noise: model errors are patches, not grains, and those of colour are the widest."""

UNKNOWN = 1e5
"""Variance that stands for a pixel whose logarithm says nothing."""

LEAST_UNEXPLAINED = 0.02
"""Share of the residual's variance that is never put down to noise."""

MOST_DIRECTION_NOISE = 0.5
"""Variance of each component of a direction that says nothing."""


ALIKE = 0.1
"""Relative change of a variance below which pixels are not weighed anew."""


MOVED = 0.02
"""Share of the pixels that may have come to say something, or ceased to, before they are weighed anew."""


def _alike(before: Trust, now: Trust) -> bool:
    """Tell whether soft weights have hardly changed: what is unexplained, and which pixels' logarithm says nothing."""
    if before.noise is None or now.noise is None or len(before.unexplained) != len(now.unexplained):
        return False
    changed = (before.noise[:, 2] >= UNKNOWN) != (now.noise[:, 2] >= UNKNOWN)
    growth = np.log(np.array(now.unexplained) / np.array(before.unexplained))
    return bool((np.abs(growth) < ALIKE).all()) and float(changed.mean()) < MOVED


def _mean(values: np.ndarray, kept: np.ndarray) -> float:
    return float(values[kept].mean()) if kept.any() else 0.0


def _soft_noise(values: np.ndarray, problem: FitProblem) -> np.ndarray:
    """Variance of the six channels of ``soft`` by the image's noise, (n, 6) float64, to first order.

    With o = g / sqrt(|g|^2 + e^2), do/dg = (I - o o') / sqrt(|g|^2 + e^2), and the root follows from |o| itself.
    """
    direction, log_rgb, known = values[:, :2], values[:, 2:5], values[:, 5]
    linear = np.exp(log_rgb)
    relative = _relative_noise(linear, problem)
    luminance = linear @ LUMINANCE[0] + LOG_FLOOR
    slope = np.square(problem.slope_left * relative * linear) @ np.square(LUMINANCE[0]) / np.square(luminance)
    left = np.maximum(1.0 - np.square(direction).sum(axis=1), 0.0)
    by_component = 1.0 - np.square(direction) * (1.0 + left[:, None])
    noise = np.zeros(values.shape)
    noise[:, :2] = np.minimum((slope * left / SOFTNESS**2)[:, None] * by_component, MOST_DIRECTION_NOISE)
    noise[:, 2:5] = np.square(problem.noise_left * relative) + np.square(0.5 * np.square(relative))
    noise[known < 0.99, 2:5] = UNKNOWN
    return noise


FACTORS = np.concatenate([[0.0], np.geomspace(1e-3, 30.0, 19)])


def _likeliest_factor(squares: np.ndarray, by_noise: np.ndarray, by_model: np.ndarray) -> float:
    """Factor f for which squared residuals are most likely under variances by_noise + f * by_model."""
    variances = by_noise + FACTORS[:, None] * by_model + 1e-300
    cost = (np.log(variances) + squares / variances).mean(axis=1)
    return float(FACTORS[cost.argmin()])


def make_objectives(model: AAM, method: Method, kernel: str = "fast") -> tuple[Objective, ...]:
    """Bring a model and a method together: one objective per level of the model, coarse to fine.

    Raises
    ------
    MethodError
        If the method needs colour and the model was trained on grey pictures.
    """
    if method.needs_colour and not model.is_colour:
        raise MethodError(
            f"method {method.name} compares colours, but the model was trained on grey pictures; use method 'grey'"
        )
    _check_holds(model, method)
    get_kernel(kernel)
    return tuple(
        Objective(
            method,
            model.warp_of(method.appearance),
            level.appearances[method.appearance],
            model.theta,
            _shape_prior(model),
            kernel,
            level.appearances.get("illumination"),
            tied_together(level.blur),
        )
        for level in model.levels_of(method.appearance)
    )


def _check_holds(model: AAM, method: Method) -> None:
    """Complain about what a method needs and a model lacks."""
    if not model.levels_of(method.appearance):
        raise MethodError(
            f"method {method.name}: the model was trained by an earlier version of liaam, which did not learn what it "
            f"compares; train it again, or use method '{'li' if model.is_colour else 'grey'}'"
        )
    for level in model.levels_of(method.appearance):
        if method.illumination and "illumination" not in level.appearances:
            raise MethodError(
                f"method {method.name} needs a model that has learnt what light does; train it with pictures under "
                "other lights ('liaam train --lit FOLDER', or train(..., lit=...))"
            )
        if method.appearance not in level.appearances:
            lit = (
                " with pictures under other lights ('liaam train --lit FOLDER')"
                if method.appearance == "varied"
                else ""
            )
            raise MethodError(f"method {method.name}: the model has no such appearance; train it again{lit}")
        if method.loss == "learnt" and level.appearances[method.appearance].unexplained is None:
            raise MethodError(f"method {method.name}: the model has not learnt how far it errs; train it again")


def _shape_prior(model: AAM) -> np.ndarray:
    """Prior of the shape modes, N(0, eigenvalue); the four similarity vectors have none."""
    return np.concatenate([1.0 / np.maximum(model.shape_model.eigenvalues, 1e-12), np.zeros(4)])
