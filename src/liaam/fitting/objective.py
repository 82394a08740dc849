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
from math import isfinite

import numpy as np

from liaam.appearance import AppearanceModel
from liaam.errors import MethodError
from liaam.fitting.methods import Method
from liaam.fitting.normal_equations import NormalEquations, Sums, gram
from liaam.fitting.problem import FitProblem, Look, tied_together
from liaam.fitting.trust import (
    SoftRows,
    Trust,
    Weighted,
    noise_variances,
    normalisation,
    robust_weights,
    soft_trust,
    weigh,
)
from liaam.kernels import get_kernel
from liaam.kernels.layout import Packed, pack
from liaam.model import AAM, Level
from liaam.shape import ShapeModel
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


@dataclass(frozen=True, eq=False)
class LambdaStep:
    """A step of lambda from where a picture was weighed.

    Attributes
    ----------
    before : Linearisation
    step : (m,) float64
    taken : callable
        Gives the residual after the step for the one before it.
    """

    before: "Linearisation"
    step: np.ndarray
    taken: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A picture weighed at a state: what it sums up to, and the normal equations, worked out when asked for.

    Attributes
    ----------
    sums : Sums
        What the cost and lambda hang on.
    weighed : Look
        What the pixels looked like when they were weighed.
    products : callable
        Gives the normal equations for a look, its sums, and the gradient that is expected (None for the picture's).
    last : LambdaStep, optional
        Step that lambda has taken since then, if it has.
    bends : bool
        Whether derivatives by the angles change with the residual.
    """

    sums: Sums
    weighed: Look
    products: Callable[[Look, Sums, np.ndarray | None], NormalEquations]
    last: "LambdaStep | None" = None
    bends: bool = False

    @classmethod
    def of(cls, equations: NormalEquations, look: Look) -> "Linearisation":
        """Linearisation of which the normal equations with the picture's own gradient are known, and no others."""

        def known(other: Look, _sums: Sums, expected: np.ndarray | None) -> NormalEquations:
            if other is not look or expected is not None:
                raise ValueError("only the equations with the picture's own gradient are known here")
            return equations

        return cls(equations, look, known)

    @cached_property
    def look(self) -> Look:
        """What the pixels look like now."""
        if self.last is None:
            return self.weighed
        look = self.last.before.look
        return look.with_residual(self.last.taken(look.residual))

    @cached_property
    def equations(self) -> NormalEquations:
        """Normal equations with the picture's own gradient."""
        if self.last is None or self.bends:
            return self.products(self.look, self.sums, None)
        # They follow from those before: nobody has to look at pixels again.
        return self.last.before.equations.after_lambda_step(self.last.step, self.sums)

    def expecting(self, gradient: np.ndarray) -> NormalEquations:
        """Equations of the zero of E'r (E'J, A'J and E'r), E being the derivatives by a gradient (n_pixels, k, 2)."""
        return self.products(self.look, self.sums, gradient)

    def with_gradient(self, gradient: np.ndarray) -> NormalEquations:
        """Normal equations with another gradient, (n_pixels, k, 2), in the place of the picture's."""
        look = Look(self.look.values, self.look.columns, gradient, self.look.weights)
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
    packed : Packed
        Modes (m, n_pixels * k).
    """

    mean: np.ndarray
    packed: Packed

    @cached_property
    def modes(self) -> np.ndarray:
        """The same modes as they are, (m, n_pixels * k) float32."""
        return self.packed.rows


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

    @cached_property
    def prior_of_all(self) -> np.ndarray:
        """The prior's precision of p and of the free angles, which have none, (n_q,) float64."""
        return np.concatenate([self.prior, np.zeros(self.n_q - len(self.prior))])

    def unit(self, equations: Sums) -> float:
        """Variance, correlation included, that a residual of weight 1 stands for: the weights' own, or the cost's."""
        if isfinite(equations.unit):
            return equations.unit
        return self.tied * equations.cost if isfinite(equations.cost) else 0.0

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
        return len(self._fixed_design.packed.steps)

    def design(self, theta: float) -> _Design:
        """Model side at an angle theta_1; made once where the method keeps it fixed, else kept while theta_1 stays."""
        if theta == self.theta_model and not self._turns:
            return self._fixed_design
        last = self.__dict__.get("_last_design")
        if last is None or last[0] != theta:
            last = theta, self._make_design(theta)
            self.__dict__["_last_design"] = last  # at once: others may fit with this objective in other threads
        return last[1]

    @cached_property
    def _turns(self) -> bool:
        """Whether the model side turns with a free angle."""
        return bool(self.method.angle_directions[0].any())

    @cached_property
    def _fixed_design(self) -> _Design:
        return self._make_design(self.theta_model)

    def _make_design(self, theta: float) -> _Design:
        metric = self.method.model_metric(theta).astype(np.float32)
        mean = self.appearance.mean @ metric.T
        modes = np.concatenate([self.appearance.modes @ metric.T, *self._extra_modes(mean, metric)])
        return _Design(mean, pack(modes.reshape(-1, mean.size)))

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
    def _slopes(self) -> Packed:
        """Slopes at rest of the mean, the appearance and the illumination modes, (1 + m, n_pixels * 2 * c)."""
        of = self.of_all_pixels
        textures = [of.appearance.mean[None], of.appearance.modes]
        if self.method.illumination and of.illumination is not None:
            textures.append(of.illumination.modes)
        return pack(np.stack([self.warp.slopes(texture).ravel() for texture in np.concatenate(textures)]))

    def model_gradient(self, state: State) -> np.ndarray:
        """Derivative of the fitted appearance, as the picture shows it, by the place: (n_pixels, k, 2) float32."""
        packed, (n, c) = self._slopes, self.appearance.mean.shape
        n_own = len(packed.steps) - 1
        coordinates = np.ones(n_own + 1)
        coordinates[1:] = state.lam[:n_own]
        if self.method.gain:  # its mode is the mean
            coordinates[0] += state.lam[n_own]
        slopes = get_kernel(self.kernel).combined(packed, coordinates).reshape(n, 2, c)
        if self.method.projects_appearance:
            slopes = slopes @ self.method.model_metric(state.angles[0]).T.astype(np.float32)
        return self.warp.pulled(slopes, state.p)

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
        look, values = self._beside_mean(problem, state, trust)
        return self.weighed(look, state, trust, values, state.lam if state.lam.any() else None)

    def look(self, problem: FitProblem, state: State, trust: Trust | None = None) -> Look:
        """Residual and derivatives at a state, before they are weighed; of a trust only its gain and offset count."""
        look, values = self._beside_mean(problem, state, trust)
        packed = self.design(state.angles[0]).packed
        look.columns[-1] = get_kernel(self.kernel).less(values, packed, state.lam).reshape(-1)
        return look

    def _beside_mean(self, problem: FitProblem, state: State, trust: Trust | None) -> tuple[Look, np.ndarray]:
        """What a picture shows, its residual yet to be written, and P E(I) - P A0, of which that is what is left."""
        design, metric = self.design(state.angles[0]), self.method.image_metric(state.angles[1])
        gain, offset = (1.0, 0.0) if trust is None else (trust.gain, trust.offset)
        places = self.warp.places(state.p, problem.pose)
        turn = problem.pose.matrix if gain == 1.0 else gain * problem.pose.matrix
        kernel = get_kernel(self.kernel)
        values, projected, steep, weights = kernel.steepest(problem.patch.channels, places, turn, metric)
        if (gain, offset) != (1.0, 0.0):  # rows of P see a common offset by their sum
            projected = gain * projected + (offset * metric.sum(axis=1)).astype(np.float32)
        beside = np.subtract(projected, design.mean, out=projected)
        return Look(values, self._angle_columns(state, values), steep, weights), beside

    def moved(self, seen: Linearisation, state: State, step: np.ndarray) -> Linearisation:
        """The same after a step of lambda."""
        packed = self.design(state.angles[0]).packed
        taken = partial(get_kernel(self.kernel).less, packed=packed, factors=step)
        sums = seen.sums.after_lambda_step(step)
        return Linearisation(sums, seen.weighed, seen.products, LambdaStep(seen, step, taken), seen.bends)

    def weighed(
        self,
        look: Look,
        state: State,
        trust: Trust | None = None,
        values: np.ndarray | None = None,
        lam: np.ndarray | None = None,
    ) -> Linearisation:
        """Weigh what is seen at a state, under weights worked out at this or an earlier one.

        Where values (n_pixels, k) are given the look's residual is yet to be written: as what lambda's modes leave of
        them, if there is a lambda.
        """
        own_root, slope = self._root_weights(state.angles[1], trust)
        design = self.design(state.angles[0])
        weighted = self._weighted_of(design, own_root, trust)
        kernel = get_kernel(self.kernel)
        root, all_seen, weight, by_modes, by_columns = kernel.column_sums(
            look.columns, design.packed, own_root, look.weights, values, lam
        )
        aa, inverse = weighted.aa, weighted.inverse
        if not all_seen:
            blind = np.flatnonzero(look.weights == 0)
            entries = (blind[:, None] * root.shape[1] + np.arange(root.shape[1])).ravel()
            unseen = kernel.weighted_gram(design.modes.take(entries, axis=1), weighted.root[blind])
            aa, inverse = aa - unseen, None
        unit = trust.unit if trust is not None and self.method.soft else np.nan
        ar, rr = by_modes[-1], float(by_columns[-1, -1])
        sums = Sums(aa=aa, ar=ar, rr=rr, weight=weight, inverse=inverse, unit=unit)
        known = _ColumnProducts(look.columns, by_modes, by_columns)
        products = partial(self._equations, state.p, design, root, slope, known)
        return Linearisation(sums, look, products, bends=slope is not None)

    def _weighted_of(self, design: _Design, own_root: np.ndarray, trust: Trust | None) -> Weighted:
        """Gram matrix of the modes under the model's and the trust's weights, all pixels of the image usable."""
        if trust is not None and trust.weighted is not None:
            return trust.weighted
        return (
            self._fixed_weighted
            if trust is None and design is self._fixed_design
            else weigh(self.kernel, design.modes, own_root)
        )

    @cached_property
    def _fixed_weighted(self) -> Weighted:
        return weigh(self.kernel, self._fixed_design.modes, self.root_weights)

    def _equations(
        self,
        p: np.ndarray,
        design: _Design,
        root: np.ndarray,
        slope: np.ndarray | None,
        known: "_ColumnProducts",
        look: Look,
        sums: Sums,
        expected: np.ndarray | None,
    ) -> NormalEquations:
        """Normal equations of (p, angles) and lambda at the warp's parameters p."""
        columns = self._turning(look, slope)
        jj, aj, rj = self._warp_products(look.steep, expected, root, design, columns, p)
        n, jr = len(columns) - 1, rj[-1]
        if n:  # the angles' rows and columns
            if columns is not known.columns:
                kernel = get_kernel(self.kernel)
                known = _ColumnProducts(columns, *kernel.column_sums(columns, design.packed, root, look.weights)[3:])
            jj = _bordered(jj, rj[:n], known.by_columns[:n, :n])
            aj = np.concatenate([aj, known.by_modes[:n].T], axis=1)
            jr = np.concatenate([jr, known.by_columns[n, :n]])
        return NormalEquations.of(sums, jj, jr, aj)

    def _turning(self, look: Look, slope: np.ndarray | None) -> np.ndarray:
        """The look's columns, with derivatives of the *weighted* residual, over the root of the weights."""
        if slope is None:
            return look.columns
        columns, directions = look.columns.copy(), self.method.angle_directions[1].astype(np.float32)
        columns[:-1] += directions[:, None] * (slope * look.residual).reshape(1, -1)
        return columns

    def _warp_products(
        self,
        steep: np.ndarray,
        expected: np.ndarray | None,
        root: np.ndarray,
        design: _Design,
        right: np.ndarray,
        p: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Give E'J, A'J and right'E for the warp's parameters (E is J where nothing is expected), sparse by a mesh."""
        mesh = self.warp.mesh_pixels()
        if mesh is None:
            columns, by_root = _rows_of(steep, root, self.warp.jacobian(p)), root.reshape(-1)
            own = columns if expected is None else _rows_of(expected, root, self.warp.jacobian(p))
            return gram(own, columns), gram(design.modes * by_root, columns), gram(right * by_root, own)
        return get_kernel(self.kernel).mesh_products(steep, root, design.packed, right, mesh, expected)

    def columns(self, problem: FitProblem, state: State, trust: Trust | None = None) -> np.ndarray:
        """Weighted columns [J | r] in full, (n_pixels * k, n_q + 1) float32: what the products are made of."""
        look = self.look(problem, state, trust)
        own_root, slope = self._root_weights(state.angles[1], trust)
        root = own_root * look.weights[:, None]
        own = self._turning(look, slope).T * root.reshape(-1, 1)
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
            where little has changed, or a soft method sees no pixel that counts.
        """
        method = self.method
        if not method.reweighs:
            return None
        if method.soft:
            return self._soft_trust(problem, state, seen, before)
        usable = seen.weights * self.appearance.usable > 0
        if not usable.any():
            return None
        metric, trust = method.image_metric(state.angles[1]), Trust(np.ones(len(usable), np.float32))
        if method.normalise:
            gain, offset = normalisation(self._fixed_design.mean, seen.values @ metric.T, usable)
            trust = replace(trust, gain=gain, offset=offset)
        if method.noise_weights:
            by_model = self._unexplained(state.angles[0])
            trust = replace(trust, **noise_variances(problem, seen.look, metric, by_model, usable))
        return self._with_products(self._robust(trust, state, seen.look))

    def _soft_trust(self, problem: FitProblem, state: State, seen: Linearisation, before: Trust | None) -> Trust | None:
        metric, colours = self.method.image_metric(state.angles[1]), self._knows_colours
        rows = SoftRows(metric, self.tied_in(problem), self.root_weights, colours)
        robust = self.method.loss != "squares"
        made = soft_trust(self.kernel, problem, seen.look, rows, None if robust else before)
        if made is None:
            return before
        if robust or self.method.angle_directions.any():
            return self._with_products(self._robust(made[0], state, seen.look))
        return replace(made[0], weighted=weigh(self.kernel, self._fixed_design.modes, made[1]))

    @cached_property
    def _knows_colours(self) -> bool:
        """Whether a soft appearance was learnt from colour pictures."""
        return bool(self.appearance.mean[:, 2].any())

    def _robust(self, trust: Trust, state: State, look: Look) -> Trust:
        """Trust with weights by the method's loss."""
        if self.method.loss == "squares":
            return trust
        variance = trust.variance(self.method.image_metric(state.angles[1]))
        usable = look.weights * self.appearance.usable > 0
        by_model = self._unexplained(self.theta_model) if self.method.loss == "learnt" else np.zeros(len(usable))
        return replace(trust, weights=robust_weights(self.method.loss, look.residual, variance, by_model, usable))

    def _with_products(self, trust: Trust) -> Trust:
        """Trust with the model side under it, where it does not turn with a free angle, as weights by noise do."""
        turns = trust.noise is not None and self.method.angle_directions.any()
        if turns or self.method.angle_directions[0].any():
            return trust
        root = self._root_weights(self.theta_model, trust)[0]
        return replace(trust, weighted=weigh(self.kernel, self._fixed_design.modes, root))

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

    def _angle_columns(self, state: State, values: np.ndarray) -> np.ndarray:
        """dr/d(free angles), the angle terms of paper eq 10, and room for the residual, (n_free + 1, n_pixels * k)."""
        directions = self.method.angle_directions.astype(np.float32)
        n, k = len(values), self.method.n_rows
        columns = np.empty((directions.shape[1] + 1, n * k), np.float32)
        if len(columns) == 1:
            return columns
        across = self.method.image_metric_derivative(state.angles[1]).T.astype(np.float32)
        if not self._turns:  # the image's angle alone is free
            np.matmul(values, across, out=columns[0].reshape(n, k))
            return columns
        texture = self.appearance.texture(state.lam[: self.appearance.n_modes])
        by_model = texture @ self.method.model_metric_derivative(state.angles[0]).T.astype(np.float32)
        of_model, of_image = directions[..., None]
        columns[:-1] = of_image * (values @ across).reshape(1, -1) - of_model * by_model.reshape(1, -1)
        return columns


@dataclass(frozen=True, eq=False)
class _ColumnProducts:
    """Weighted products of a look's columns.

    Attributes
    ----------
    columns : (n_free + 1, n_pixels * k) float32
    by_modes : (n_free + 1, m) float64
    by_columns : (n_free + 1, n_free + 1) float64
    """

    columns: np.ndarray
    by_modes: np.ndarray
    by_columns: np.ndarray


def _bordered(inner: np.ndarray, border: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Matrix (n + b, n + b) of an inner one, rows (b, n) below it, the same beside it, and a corner."""
    n = len(inner)
    whole = np.empty((n + len(border), n + len(border)))
    whole[:n, :n], whole[n:, :n], whole[:n, n:], whole[n:, n:] = inner, border, border.T, corner
    return whole


def _rows_of(steep: np.ndarray, root: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Rows root * steep . dW/dp of J', (n_p, n * k) float32."""
    columns = np.einsum("nka,naj->jnk", root[:, :, None] * steep, jacobian, optimize=True)
    return columns.reshape(jacobian.shape[2], -1)


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
