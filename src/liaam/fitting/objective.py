"""The one objective of all methods: encoding, metric, appearance, free angles (DESIGN section 1).

The residual at model pixel x, for shape parameters p, angles theta = (theta_1, theta_2) and appearance
coordinates lambda (paper eq 9, generalised):

    r(x) = w(x) [ P(theta_2) E(I(W(x; p))) - P(theta_1) A0(x) - sum_i lambda_i P(theta_1) A_i(x) ]

Extra modes (gain, bias, illumination) stand behind the appearance's own in lambda. The weights w(x) are the
model's own, or those of a :class:`Trust` worked out between iterations.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from liaam.appearance import AppearanceModel
from liaam.errors import MethodError
from liaam.fitting.losses import LOSSES, robust_scale
from liaam.fitting.methods import Method
from liaam.fitting.normal_equations import WIDE, NormalEquations, Sums, gram, regular_inverse
from liaam.kernels import get_kernel
from liaam.model import AAM, Level
from liaam.photometry import LUMINANCE, NoiseModel, Response, from_linear, log_slope, noise_deviation
from liaam.photometry.encoding import LOG_FLOOR, SOFTNESS
from liaam.sampling import Patch, make_patch
from liaam.shape import ShapeModel, Similarity
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


MARGIN = 0.4
"""Surroundings of the start that a fit may visit, as a share of the object's diagonal."""

NEAR = 0.1
"""The same for levels that start where a coarser one stopped."""


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

    @cached_property
    def relative_noise(self) -> np.ndarray:
        """Standard deviation of the logarithm by noise, at evenly spaced logarithms over :data:`LOGS`."""
        return _relative_noise(np.exp(np.linspace(*LOGS, 512)), self)

    @classmethod
    def at(
        cls,
        image: np.ndarray,
        shape: np.ndarray,
        pose: Similarity,
        method: Method,
        response: Response,
        blur: float,
        noise: NoiseModel | float | None = None,
        margin: float | None = None,
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
        noise : NoiseModel or float, optional
            Of the image's camera, or as measured in the image; measured here if left out.
        margin : float, optional
            Surroundings that the fit may visit, as a share of the object's diagonal; :data:`MARGIN` if left out.
        """
        margin = MARGIN if margin is None else margin
        patch = make_patch(image, shape, pose, encoding=method.encoding, response=response, blur=blur, margin=margin)
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


def _noise(image: np.ndarray, shape: np.ndarray, patch: Patch, known: NoiseModel | float | None) -> float | NoiseModel:
    """Noise around a shape after a patch's averaging."""
    reduce = 1.0 / patch.from_image.scale
    if isinstance(known, NoiseModel):
        return NoiseModel(known.slope / reduce**2, known.offset / reduce**2)
    return (noise_around(image, shape) if known is None else known) / reduce


def noise_around(image: np.ndarray, shape: np.ndarray) -> float:
    """Standard deviation of the noise around a shape, in stored values of [0, 1]."""
    low = np.maximum(shape.min(axis=0).astype(int), 0)
    high = np.maximum(shape.max(axis=0).astype(int) + 2, low + 8)
    return noise_deviation(image[low[1] : high[1], low[0] : high[0]])


@dataclass(frozen=True, eq=False)
class _Weighted:
    """Model side under weights that do not turn with an angle: worked out once for all iterations they are used in.

    Attributes
    ----------
    root : (n_pixels, k) float32
        Root of the weights.
    aa : (m, m) float64
        Gram matrix of the weighted modes.
    inverse : (m, m) float64
        Its inverse.
    """

    root: np.ndarray
    aa: np.ndarray
    inverse: np.ndarray


@dataclass(frozen=True, eq=False)
class Trust:
    """How far each pixel is trusted: worked out between iterations, frozen within one.

    Attributes
    ----------
    weights : (n_pixels,) float32
        By the robust loss; 1 without one.
    noise : (n_pixels, c) float, optional
        Variance of the encoded channels by the image's noise.
    model : (n_pixels, 1) or (1, k) float, optional
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
        """Variance of the residual in each row of P, (n_pixels, k); None where it is not modelled."""
        if self.noise is None or self.model is None:
            return None
        return self.noise @ np.square(metric).T.astype(self.noise.dtype) + self.model


@dataclass(frozen=True, eq=False)
class Look:
    """What a picture shows at a state, before it is weighed.

    Attributes
    ----------
    values : (n_pixels, c) float32
        Encoded samples of the image.
    residual : (n_pixels, k) float32
        P E(I) - P A.
    steep : (n_pixels, k, 2) float32
        Derivative of the residual by the place, x and y in the model's pixels.
    by_angles : (n_free, n_pixels * k) float32
        Derivative of the residual by the free angles.
    weights : (n_pixels,) float32
        Image weight in {0, 1}.
    """

    values: np.ndarray
    residual: np.ndarray
    steep: np.ndarray
    by_angles: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A picture weighed at a state: what it sums up to, and the normal equations, worked out when asked for.

    Attributes
    ----------
    sums : Sums
        What the cost and lambda hang on.
    look : Look
        What the pixels looked like.
    products : callable
        Gives the normal equations for a look, its sums, and the gradient that is expected (None for the picture's).
    """

    sums: Sums
    look: Look
    products: Callable[[Look, Sums, np.ndarray | None], NormalEquations]

    @classmethod
    def of(cls, equations: NormalEquations, look: Look) -> "Linearisation":
        """Linearisation of which the normal equations with the picture's own gradient are known, and no others."""

        def known(other: Look, _sums: Sums, expected: np.ndarray | None) -> NormalEquations:
            if other is not look or expected is not None:
                raise ValueError("only the equations with the picture's own gradient are known here")
            return equations

        return cls(equations, look, known)

    @cached_property
    def equations(self) -> NormalEquations:
        """Normal equations with the picture's own gradient."""
        return self.products(self.look, self.sums, None)

    def expecting(self, gradient: np.ndarray) -> NormalEquations:
        """Equations of the zero of E'r (E'J, A'J and E'r), E being the derivatives by a gradient (n_pixels, k, 2)."""
        return self.products(self.look, self.sums, gradient)

    def with_gradient(self, gradient: np.ndarray) -> NormalEquations:
        """Normal equations with another gradient, (n_pixels, k, 2), in the place of the picture's."""
        look = Look(self.look.values, self.look.residual, gradient, self.look.by_angles, self.look.weights)
        return self.products(look, self.sums, None)

    @property
    def cost(self) -> float:
        """Mean squared residual; infinite where no pixel counts."""
        return self.sums.cost

    @property
    def residual(self) -> np.ndarray:
        """P E(I) - P A, unweighted, (n_pixels, k) float32."""
        return self.look.residual

    @property
    def values(self) -> np.ndarray:
        """Encoded samples of the image, (n_pixels, c) float32."""
        return self.look.values

    @property
    def weights(self) -> np.ndarray:
        """Image weight in {0, 1}, (n_pixels,) float32."""
        return self.look.weights


@dataclass(frozen=True, eq=False)
class _Design:
    """Model side of the residual at one theta_1.

    Attributes
    ----------
    mean : (n_pixels, k) float32
    modes : (m, n_pixels * k) float32
    """

    mean: np.ndarray
    modes: np.ndarray


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
    density : float
        Share of the frame's pixels that are looked at.
    freedom : float
        Degrees of freedom of the prior's scale (:mod:`liaam.fitting.prior`); infinite where it is 1.
    whole : Objective, optional
        The same over all of the frame's pixels; this one itself if left out.
    """

    method: Method
    warp: Warp
    appearance: AppearanceModel
    theta_model: float
    prior: np.ndarray
    kernel: str = "fast"
    illumination: AppearanceModel | None = None
    tied: float = 1.0
    density: float = 1.0
    freedom: float = np.inf
    whole: "Objective | None" = None

    def unit(self, equations: Sums) -> float:
        """Variance, correlation included, that a residual of weight 1 stands for: the weights' own, or the cost's."""
        if np.isfinite(equations.unit):
            return equations.unit
        return self.tied * equations.cost if np.isfinite(equations.cost) else 0.0

    @property
    def of_all_pixels(self) -> "Objective":
        """The same objective over all of the frame's pixels in raster order."""
        return self if self.whole is None else self.whole

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
        return len(self._fixed_design.modes)

    def design(self, theta: float) -> _Design:
        """Model side at an angle theta_1; made once where the method keeps it fixed."""
        if not self.method.angle_directions[0].any() and theta == self.theta_model:
            return self._fixed_design
        return self._make_design(theta)

    @cached_property
    def _fixed_design(self) -> _Design:
        return self._make_design(self.theta_model)

    def _make_design(self, theta: float) -> _Design:
        metric = self.method.model_metric(theta).astype(np.float32)
        mean = self.appearance.mean @ metric.T
        modes = np.concatenate([self.appearance.modes @ metric.T, *self._extra_modes(mean, metric)])
        return _Design(mean, np.ascontiguousarray(modes.reshape(-1, mean.size), dtype=np.float32))

    def _extra_modes(self, mean: np.ndarray, metric: np.ndarray) -> list[np.ndarray]:
        n, k = mean.shape
        extra = []
        if self.method.illumination and self.illumination is not None:
            extra.append(self.illumination.modes @ metric.T)
        if self.method.gain:
            extra.append(mean[None])
        if self.method.bias == "common":
            extra.append(np.ones((1, n, k), np.float32))
        if self.method.bias == "rows":
            extra.append(np.broadcast_to(np.eye(k, dtype=np.float32)[:, None], (k, n, k)))
        return extra

    @cached_property
    def _slopes(self) -> np.ndarray:
        """Slopes at rest of the mean, the appearance and the illumination modes, (1 + m, n_pixels * 2 * c) float32."""
        of = self.of_all_pixels
        textures = [of.appearance.mean[None], of.appearance.modes]
        if self.method.illumination and of.illumination is not None:
            textures.append(of.illumination.modes)
        slopes = [self.warp.slopes(texture).ravel() for texture in np.concatenate(textures)]
        return np.stack(slopes, dtype=np.float32, casting="same_kind")

    def model_gradient(self, state: State) -> np.ndarray:
        """Derivative of the fitted appearance, as the picture shows it, by the place: (n_pixels, k, 2) float32."""
        n_own = len(self._slopes) - 1
        scale = 1.0 + (state.lam[n_own] if self.method.gain else 0.0)  # a gain's mode is the mean
        coordinates = np.concatenate([[scale], state.lam[:n_own]]).astype(np.float32)
        slopes = (coordinates @ self._slopes).reshape(-1, self.appearance.mean.shape[1])
        slopes = slopes @ self.method.model_metric(state.angles[0]).T.astype(np.float32)
        return self.warp.pulled(slopes.reshape(len(self.appearance.mean), 2, -1), state.p)

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

    def linearise(self, problem: FitProblem, state: State, trust: Trust | None = None) -> Linearisation:
        """Look at a picture at a state, and weigh what is seen there.

        Parameters
        ----------
        problem : FitProblem
        state : State
        trust : Trust, optional
            Of :meth:`trust` at an earlier state, for methods that re-weigh.
        """
        return self.weighed(self.look(problem, state, trust), state, trust)

    def look(self, problem: FitProblem, state: State, trust: Trust | None = None) -> Look:
        """Residual and derivatives at a state, before they are weighed; of a trust only its gain and offset count."""
        design, metric = self.design(state.angles[0]), self.method.image_metric(state.angles[1])
        gain, offset = (1.0, 0.0) if trust is None else (trust.gain, trust.offset)
        points = self.warp.points(state.p, problem.pose)
        turn = problem.pose.matrix if gain == 1.0 else gain * problem.pose.matrix
        values, projected, steep, weights = get_kernel(self.kernel).steepest(
            problem.patch.channels, points, turn, metric
        )
        residual = projected - design.mean
        lam = state.lam.astype(np.float32)
        with np.errstate(over="ignore", invalid="ignore"):  # a fit that blows up; its cost says so
            residual -= (lam @ design.modes).reshape(residual.shape)
        if (gain, offset) != (1.0, 0.0):  # rows of P see a common offset by their sum
            residual += (gain - 1.0) * projected + (offset * metric.sum(axis=1)).astype(np.float32)
        return Look(values, residual, steep, self._by_angles(state, values), weights)

    def moved(self, seen: Linearisation, state: State, step: np.ndarray) -> Linearisation:
        """The same after a step of lambda."""
        look = seen.look
        change = (step.astype(np.float32) @ self.design(state.angles[0]).modes).reshape(look.residual.shape)
        look = Look(look.values, look.residual - change, look.steep, look.by_angles, look.weights)
        return Linearisation(seen.sums.after_lambda_step(step), look, seen.products)

    def weighed(self, look: Look, state: State, trust: Trust | None = None) -> Linearisation:
        """Weigh what is seen at a state, under weights worked out at this or an earlier one."""
        own_root, slope = self._root_weights(state.angles[1], trust)
        root, design = own_root * look.weights[:, None], self.design(state.angles[0])
        squares, residual = np.square(root), look.residual.reshape(1, -1)
        weighted = residual * squares.reshape(-1)
        known = self._weighted_of(design, own_root, trust)
        aa, inverse = known.aa, known.inverse
        blind = look.weights == 0
        if blind.any():
            unseen = known.root[blind].reshape(-1) * design.modes[:, np.repeat(blind, root.shape[1])]
            aa, inverse = aa - gram(unseen, unseen), None
        sums = Sums(
            aa=aa,
            ar=gram(design.modes, weighted, WIDE)[:, 0],
            rr=float(gram(residual, weighted, WIDE)[0, 0]),
            weight=float(squares.sum(dtype=np.float64)),
            inverse=inverse,
            unit=trust.unit if trust is not None and self.method.soft else np.nan,
        )
        return Linearisation(sums, look, partial(self._equations, state.p, design, root, slope))

    def _weighted_of(self, design: _Design, own_root: np.ndarray, trust: Trust | None) -> _Weighted:
        """Gram matrix of the modes under the model's and the trust's weights, all pixels of the image usable."""
        if trust is not None and trust.weighted is not None:
            return trust.weighted
        return self._fixed_weighted if trust is None and design is self._fixed_design else weigh(design.modes, own_root)

    @cached_property
    def _fixed_weighted(self) -> _Weighted:
        return weigh(self._fixed_design.modes, self.root_weights)

    def _equations(
        self,
        p: np.ndarray,
        design: _Design,
        root: np.ndarray,
        slope: np.ndarray | None,
        look: Look,
        sums: Sums,
        expected: np.ndarray | None,
    ) -> NormalEquations:
        """Normal equations of (p, angles) and lambda at the warp's parameters p."""
        right = np.concatenate([self._turning(look, slope), look.residual.reshape(1, -1)])
        jj, aj, rj = self._warp_products(look.steep, expected, root, design.modes, right, p)
        n, jr = len(right) - 1, rj[-1]
        if n:  # the angles' rows and columns
            by_angles = right[:n]
            weighted = by_angles * np.square(root).reshape(-1)
            mixed, own = gram(design.modes, weighted, WIDE), gram(right, weighted, WIDE)
            jj = np.concatenate([np.concatenate([jj, rj[:n]]), np.concatenate([rj[:n].T, own[:n]])], axis=1)
            aj, jr = np.concatenate([aj, mixed], axis=1), np.concatenate([jr, own[n]])
        return NormalEquations.of(sums, jj, jr, aj)

    def _turning(self, look: Look, slope: np.ndarray | None) -> np.ndarray:
        """Derivative of the weighted residual by the free angles, over the root of the weights."""
        if slope is None:
            return look.by_angles
        directions = self.method.angle_directions[1].astype(np.float32)
        return look.by_angles + directions[:, None] * (slope * look.residual).reshape(1, -1)

    def _warp_products(
        self,
        steep: np.ndarray,
        expected: np.ndarray | None,
        root: np.ndarray,
        modes: np.ndarray,
        right: np.ndarray,
        p: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Give E'J, A'J and right'E for the warp's parameters (E is J where nothing is expected), sparse by a mesh."""
        mesh = self.warp.mesh_pixels()
        if mesh is None:
            columns, by_root = _rows_of(steep, root, self.warp.jacobian(p)), root.reshape(-1)
            own = columns if expected is None else _rows_of(expected, root, self.warp.jacobian(p))
            return gram(own, columns), gram(modes * by_root, columns), gram(right * by_root, own)
        products = get_kernel(self.kernel).mesh_products
        where = mesh.beta, mesh.starts, mesh.triangles, mesh.n_vertices
        jj, aj, rj = products(steep, root, modes, right, *where, expected)
        return mesh.modes.T @ (jj @ mesh.modes), aj @ mesh.modes, rj @ mesh.modes

    def columns(self, problem: FitProblem, state: State, trust: Trust | None = None) -> np.ndarray:
        """Weighted columns [J | r] in full, (n_pixels * k, n_q + 1) float32: what the products are made of."""
        look = self.look(problem, state, trust)
        own_root, slope = self._root_weights(state.angles[1], trust)
        root = own_root * look.weights[:, None]
        own = np.concatenate([self._turning(look, slope).T, look.residual.reshape(-1, 1)], axis=1)
        own *= root.reshape(-1, 1)
        return np.concatenate([_rows_of(look.steep, root, self.warp.jacobian(state.p)).T, own], axis=1)

    def _root_weights(self, theta: float, trust: Trust | None) -> tuple[np.ndarray, np.ndarray | None]:
        """Root of the weights (n, k), and its relative derivative by theta_2 where noise makes it depend on that.

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
        return root, (-0.5 * growth / variance).astype(np.float32)

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
        facts = {"weights": np.ones(len(usable), np.float32), "gain": gain, "offset": offset}
        if method.noise_weights:
            facts |= self._variances(problem, state, seen, usable)
        if method.soft:
            facts |= self._soft_variances(problem, metric, seen, usable)
        trust = Trust(**facts)
        if method.soft and before is not None and method.loss == "squares" and _alike(before, trust):
            return before
        if method.loss != "squares":
            trust = replace(trust, weights=self._robust_weights(seen.residual, trust.variance(metric), usable))
        # Weights by noise turn with a free angle.
        turns = trust.noise is not None and method.angle_directions.any()
        return trust if turns or method.angle_directions[0].any() else replace(trust, weighted=self._weighted(trust))

    def _weighted(self, trust: Trust) -> _Weighted:
        return weigh(self._fixed_design.modes, self._root_weights(self.theta_model, trust)[0])

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
        tied = self.tied_in(problem)
        noise = get_kernel(self.kernel).soft_noise(
            seen.values,
            problem.relative_noise,
            LOGS,
            (problem.noise_left, problem.slope_left),
            SOFTNESS,
            LOG_FLOOR,
            LUMINANCE[0],
            UNKNOWN,
            MOST_DIRECTION_NOISE,
        )
        if not self.appearance.mean[:, 2].any():  # learnt from grey pictures
            noise[:, 2:5] = UNKNOWN
        by_noise = noise @ np.square(metric).T.astype(np.float32)
        sums = get_kernel(self.kernel).beyond_noise(seen.residual, by_noise, usable, 0.5 * UNKNOWN)
        model, found = np.empty((1, len(metric)), np.float32), []
        for rows, correlated in SOFT_ROWS:
            count, squares, beyond = sums[rows].sum(axis=0) / max(sums[rows, 0].sum(), 1.0)
            found.append(max(beyond, LEAST_UNEXPLAINED * squares + 1e-9) if count else 1e-9)
            model[:, rows] = correlated * tied * found[-1]
        unit = 1.0 / float(np.reciprocal(tied * by_noise + model)[usable].mean(dtype=np.float64))
        return {"noise": tied * noise, "model": model, "unit": unit, "unexplained": tuple(found)}

    def tied_in(self, problem: FitProblem) -> float:
        """Pixels looked at that stand for one independent residual of a soft method."""
        # Pixels of a picture smaller than the model's frame are spread over several of the frame's.
        return max(1.0, self.density * max(tied_together(problem.blur), 1.0 / problem.pose.scale**2))

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

    def _by_angles(self, state: State, values: np.ndarray) -> np.ndarray:
        """dr/d(free angles), (n_free, n_pixels * k): the angle terms of paper eq 10."""
        directions = self.method.angle_directions.astype(np.float32)
        if not directions.size:
            return np.empty((0, len(values) * self.method.n_rows), np.float32)
        by_image = values @ self.method.image_metric_derivative(state.angles[1]).T.astype(np.float32)
        columns = directions[1][:, None] * by_image.reshape(1, -1)
        if directions[0].any():
            texture = self.appearance.texture(state.lam[: self.appearance.n_modes])
            by_model = texture @ self.method.model_metric_derivative(state.angles[0]).T.astype(np.float32)
            columns -= directions[0][:, None] * by_model.reshape(1, -1)
        return columns


def weigh(modes: np.ndarray, root: np.ndarray) -> _Weighted:
    """Gram matrix of modes (m, n * k) under weights (n, k), and its inverse."""
    weighted = modes * root.reshape(-1)
    aa = gram(weighted, weighted)
    return _Weighted(root, aa, regular_inverse(aa))


def _rows_of(steep: np.ndarray, root: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Rows root * steep . dW/dp of J', (n_p, n * k) float32."""
    columns = np.einsum("nka,naj->jnk", root[:, :, None] * steep, jacobian, optimize=True)
    return columns.reshape(jacobian.shape[2], -1)


def _relative_noise(linear: np.ndarray, problem: FitProblem) -> np.ndarray:
    """Standard deviation of the logarithm of linear light (any shape) by the image's noise."""
    if isinstance(problem.noise, NoiseModel):
        return np.sqrt(problem.noise.variance(linear)) / np.maximum(linear, 1e-6)
    stored = np.maximum(from_linear(linear, problem.response), 1e-3)
    return problem.noise * log_slope(stored, problem.response)


LOGS = (-7.0, 0.5)
"""Logarithms of linear light between which its noise is worked out: from black to highlights."""

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


FACTORS = np.concatenate([[0.0], np.geomspace(1e-3, 30.0, 19)])


def _likeliest_factor(squares: np.ndarray, by_noise: np.ndarray, by_model: np.ndarray) -> float:
    """Factor f for which squared residuals are most likely under variances by_noise + f * by_model."""
    variances = by_noise + FACTORS[:, None] * by_model + 1e-300
    cost = (np.log(variances) + squares / variances).mean(axis=1)
    return float(FACTORS[cost.argmin()])


THINNING = 1.5
"""Distance between the pixels that are looked at, in standard deviations of a level's blur: closer ones say the same
again. Measured on the spot protocol with ``soft-li``: a median of 4.03 % with all pixels, 4.05 with half of the
sharpest level's, 4.11 with a quarter, and a 90th percentile of 5.6 with each."""


def make_objectives(
    model: AAM, method: Method, kernel: str = "fast", thinning: float | None = None
) -> tuple[Objective, ...]:
    """Bring a model and a method together: one objective per level of the model, coarse to fine.

    Parameters
    ----------
    model : AAM
    method : Method
    kernel : {"fast", "reference"}
    thinning : float, optional
        Distance between the pixels that are looked at, in standard deviations of a level's blur; :data:`THINNING` if
        left out, and nought (every pixel) for directions: each is normalised by itself after the blur, so that it does
        not say what its neighbours say. Measured on strangers of IMM: ``igo`` 6.1 % with all pixels, 7.1 without.

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
    if thinning is None:
        thinning = 0.0 if method.encoding == "orientation" else THINNING
    return tuple(_objective(model, method, kernel, level, thinning) for level in model.levels_of(method.appearance))


def _objective(model: AAM, method: Method, kernel: str, level: Level, thinning: float) -> Objective:
    """One level seen through a method, at as many pixels as its blur leaves worth looking at."""
    appearance, illumination = level.appearances[method.appearance], level.appearances.get("illumination")
    warp = model.warp_of(method.appearance)
    # What a picture tells of its shape has to be counted well for its scale: by soft weights only.
    shapes = warp.shape_model
    freedom = shapes.freedom if method.soft else np.inf
    prior = _shape_prior(shapes)
    whole = Objective(method, warp, appearance, model.theta, prior, kernel, illumination, freedom=freedom)
    kept = warp.every(thinning * level.blur)
    density = len(kept) / len(appearance.mean)
    return replace(
        whole,
        warp=warp.at(kept),
        appearance=appearance.at(kept),
        illumination=None if illumination is None else illumination.at(kept),
        tied=max(1.0, density * tied_together(level.blur)),
        density=density,
        whole=whole,
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


def _shape_prior(shapes: ShapeModel) -> np.ndarray:
    """Prior of the shape modes, N(0, eigenvalue); the four similarity vectors have none."""
    return np.concatenate([1.0 / np.maximum(shapes.eigenvalues, 1e-12), np.zeros(4)])
