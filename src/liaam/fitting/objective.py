"""The one objective of all methods: encoding, metric, appearance, free angles (DESIGN section 1).

The residual at model pixel x, for shape parameters p, angles theta = (theta_1, theta_2) and appearance
coordinates lambda (paper eq 9, generalised):

    r(x) = w(x) [ P(theta_2) E(I(W(x; p))) - P(theta_1) A0(x) - sum_i lambda_i P(theta_1) A_i(x) ]

Extra modes (gain, bias) stand behind the appearance's own in lambda.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from liaam.appearance import AppearanceModel
from liaam.errors import MethodError
from liaam.fitting.methods import Method
from liaam.fitting.normal_equations import NormalEquations, gram, regular_inverse
from liaam.kernels import get_kernel
from liaam.model import AAM
from liaam.photometry import Response
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
    """

    patch: Patch
    pose: Similarity

    @classmethod
    def at(
        cls, image: np.ndarray, shape: np.ndarray, pose: Similarity, method: Method, response: Response, blur: float
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
        """
        patch = make_patch(
            image, shape, pose.scale, encoding=method.encoding, response=response, blur=blur, margin=MARGIN
        )
        to_patch = Similarity(patch.from_image.matrix @ pose.matrix, patch.from_image(pose.offset[None])[0])
        return cls(patch, to_patch)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Normal equations at a state, and what the pixels looked like there.

    Attributes
    ----------
    equations : NormalEquations
    residual : (n_pixels, k) float32
        P E(I) - P A, unweighted.
    values : (n_pixels, 3) float32
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
        Precision of a Gaussian prior on p relative to the variance of a residual: what a unit of squared p
        weighs against a unit of squared residual of unit variance. 0 where there is no prior.
    kernel : {"fast", "reference"}
    """

    method: Method
    warp: Warp
    appearance: AppearanceModel
    theta_model: float
    prior: np.ndarray
    kernel: str = "fast"

    @cached_property
    def root_weights(self) -> np.ndarray:
        """Square root of each model pixel's weight, (n_pixels,) float32."""
        return np.sqrt(self.appearance.usable)

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
        modes = np.concatenate([modes, *self._extra_modes(mean)], axis=2)
        modes = np.ascontiguousarray(modes.reshape(mean.size, -1), dtype=np.float32)
        weighted = modes * np.repeat(self.root_weights, len(metric))[:, None]
        aa = gram(weighted, weighted)
        return _Design(mean, modes, weighted, aa, regular_inverse(aa))

    def _extra_modes(self, mean: np.ndarray) -> list[np.ndarray]:
        n, k = mean.shape
        extra = []
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

    def linearise(self, problem: FitProblem, state: State, workspace: np.ndarray | None = None) -> Linearisation:
        """Residual and normal equations at a state.

        Parameters
        ----------
        problem : FitProblem
        state : State
        workspace : (n_pixels * k, n_q + 1) float32, optional
            Overwritten with the weighted columns [J | r]; pass the same array every time to allocate
            nothing large in the loop.
        """
        theta_model, theta_image = state.angles
        design = self.design(theta_model)
        metric = self.method.image_metric(theta_image)
        columns = self.workspace() if workspace is None else workspace
        values, projected, weights = get_kernel(self.kernel).linearise(
            problem.patch.channels,
            self.warp.points(state.p, problem.pose),
            self.warp.jacobian(state.p),
            problem.pose.matrix,
            metric,
            self.root_weights,
            columns,
        )
        lam = state.lam.astype(np.float32)
        residual = projected - design.mean
        residual -= (design.modes @ lam).reshape(residual.shape)
        root = (self.root_weights * weights)[:, None]
        n_p = self.warp.n_parameters
        if self.n_q > n_p:
            columns[:, n_p : self.n_q] = self._angle_columns(state, values, lam, root)
        columns[:, -1] = (root * residual).ravel()
        return Linearisation(self._equations(columns, design, weights), residual, values, weights)

    def workspace(self) -> np.ndarray:
        """Give an array for the columns [J | r] of one linearisation."""
        n = len(self.appearance.mean) * self.method.n_rows
        return np.empty((n, self.n_q + 1), dtype=np.float32)

    def _angle_columns(self, state: State, values: np.ndarray, lam: np.ndarray, root: np.ndarray) -> np.ndarray:
        """Weighted dr/d(free angles), (n * k, n_free): the angle terms of paper eq 10."""
        directions = self.method.angle_directions.astype(np.float32)
        by_image = values @ self.method.image_metric_derivative(state.angles[1]).T.astype(np.float32)
        columns = (root * by_image).reshape(-1, 1) * directions[1]
        if directions[0].any():
            texture = self.appearance.texture(lam[: self.appearance.n_modes])
            by_model = texture @ self.method.model_metric_derivative(state.angles[0]).T.astype(np.float32)
            columns -= (root * by_model).reshape(-1, 1) * directions[0]
        return columns

    def _equations(self, columns: np.ndarray, design: _Design, weights: np.ndarray) -> NormalEquations:
        own, cross = gram(columns, columns), gram(columns, design.weighted).T
        aa, inverse = design.aa, design.inverse
        blind = weights == 0
        if blind.any():
            rows = design.weighted[np.repeat(blind, self.method.n_rows)]
            aa, inverse = aa - gram(rows, rows), None
        weight = float(self.appearance.usable @ weights) * self.method.n_rows
        return NormalEquations(
            own[:-1, :-1], own[:-1, -1], cross[:, :-1], aa, cross[:, -1], float(own[-1, -1]), weight, inverse
        )


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
    get_kernel(kernel)
    return tuple(
        Objective(
            method,
            model.warp,
            level.appearances[method.appearance],
            model.theta,
            _shape_prior(model, level.blur),
            kernel,
        )
        for level in model.levels
    )


def _shape_prior(model: AAM, blur: float) -> np.ndarray:
    """Prior of the shape modes, N(0, eigenvalue); the four similarity vectors have none.

    A blur of standard deviation s leaves one independent residual in about 4 pi s^2 pixels, so the sum of
    squares over all pixels overstates the evidence by that factor and the prior is scaled up by it.
    """
    modes = max(1.0, 4.0 * np.pi * blur**2) / np.maximum(model.shape_model.eigenvalues, 1e-12)
    return np.concatenate([modes, np.zeros(4)])
