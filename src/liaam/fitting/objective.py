"""The objective of a model, a method and a level: the model's side of the residual, and the calls of the loop."""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from liaam.errors import MethodError
from liaam.fitting.kernel import get_kernel
from liaam.fitting.level import (
    COLOUR,
    CORRELATED,
    GRADIENTS,
    LEAST_CURVATURE,
    RIDGE,
    UNIT,
    Controls,
    Picture,
    Row,
    Template,
    Work,
    without,
    work_shapes,
)
from liaam.fitting.losses import LOSSES, gaussian_median
from liaam.fitting.methods import WEIGHTS, Method
from liaam.fitting.problem import FitProblem, correlated_pixels
from liaam.model import AAM, Level
from liaam.model.appearance import AppearanceModel
from liaam.model.warp import Mesh, Warp, padded
from liaam.photometry.features import Encoder, name_of

MOST_IDLE = 8
"""Number of works kept for later fits; more are in use only while more threads fit at the same time."""


class State(NamedTuple):
    """The unknowns of a fit."""

    p: np.ndarray
    """(n_p,) float64: parameters of the warp."""
    angles: np.ndarray
    """(2,) float64: theta_1 (model) and theta_2 (image), radians."""
    lam: np.ndarray
    """(m,) float64: coordinates of the appearance, extra modes last."""


@dataclass(frozen=True, eq=False)
class Objective:
    """The cost of a method for a model at one level (eq 9, generalised).

    Attributes
    ----------
    method : Method
    warp : Warp
    appearance : AppearanceModel
    theta_model : float
        The training camera's angle, radians.
    prior : (n_p,) float64
        Precision of a Gaussian prior on p; 0 for none. The loop scales it to correct for correlated pixels.
    kernel : {"fast", "reference"}
    illumination : AppearanceModel, optional
        Illumination basis, for methods that add one.
    correlated : float
        Number of pixels per independent residual, for weights that do not account for correlation.
    density : float
        Fraction of the frame's pixels that are used.
    freedom : float
        Degrees of freedom of the prior's scale (:func:`liaam.fitting.steps.next_scale`); infinite for a scale of 1.
    whole : Objective, optional
        The same objective over all of the frame's pixels, in the order of ``warp.kept``; by default this one.
    in_frame : (AppearanceModel, AppearanceModel or None), optional
        Appearance and illumination at all of the frame's pixels in raster order, for spatial gradients; by default
        those at the warp's pixels.
    """

    method: Method
    warp: Warp
    appearance: AppearanceModel
    theta_model: float
    prior: np.ndarray
    kernel: str = "fast"
    illumination: AppearanceModel | None = None
    correlated: float = 1.0
    density: float = 1.0
    freedom: float = np.inf
    whole: "Objective | None" = None
    in_frame: tuple[AppearanceModel, AppearanceModel | None] | None = None

    @property
    def of_all_pixels(self) -> "Objective":
        """The same objective over all of the frame's pixels."""
        return self if self.whole is None else self.whole

    @property
    def n_q(self) -> int:
        """Number of warp parameters plus free angles."""
        return self.warp.n_parameters + self.method.angle_directions.shape[1]

    @property
    def n_lambda(self) -> int:
        """Number of appearance modes plus extra modes."""
        return len(self.template.rows) - 1

    @cached_property
    def row(self) -> Row:
        """The method as arrays, numbers and functions."""
        method, kernel = self.method, get_kernel(self.kernel)
        loss = LOSSES.index(method.loss) if method.loss in LOSSES else -1
        weigh = {"model": kernel.weigh_by_model, "noise": kernel.weigh_by_noise, "rows": kernel.weigh_by_rows}
        return Row(
            metric=method.metric_parts.astype(np.float32).reshape(3, -1),
            directions=np.ascontiguousarray(method.angle_directions, dtype=np.float64),
            weights=WEIGHTS.index(method.weights),
            loss=loss,
            median=gaussian_median(method.n_rows) if loss >= 0 else 1.0,
            normalise=method.normalise,
            evaluate_residual=kernel.evaluate_residual,
            turn=kernel.turn_model if self._turns else without,
            weigh=weigh[method.weights] if method.reweighs else without,
            weigh_by_loss=kernel.weigh_by_loss if loss >= 0 else without,
            solve_lambda=kernel.solve_lambda,
            normalise_samples=kernel.normalise_samples if method.normalise else without,
            whiten=kernel.whiten if method.weights == "noise" else without,
            expect=kernel.expect if method.expects else without,
            differentiate=kernel.differentiate,
            add_angles=kernel.add_angles if method.free_angles != "none" else without,
            damped=kernel.damped if method.step != "expected" else without,
            raised=kernel.raised if method.expects else without,
        )

    @cached_property
    def template(self) -> Template:
        """The model's side of the residual, P(theta_1) A0 and P(theta_1) A_i."""
        n, k = len(self.appearance.mean), self.method.n_rows
        parts = self._rows_of(self.appearance, self.illumination)
        rows = self._at_model_angle(parts).reshape(-1, n * k)
        slope_parts, m = self._slope_parts, len(rows) - 1
        lines = np.zeros((n * k, padded(m)), np.float32)
        lines[:, :m] = rows[1:].T
        own = np.repeat(np.sqrt(self.appearance.usable), k).astype(np.float32)
        weighted = rows[1:].astype(np.float64) * own
        return Template(
            warp=self.warp if self.kernel == "reference" else self._mesh(),
            rows=rows,
            lines=lines.ravel(),
            slopes=self._at_model_angle(slope_parts) if self._turns else slope_parts[0],
            parts=parts.reshape(3, -1, n * k) if self._turns else np.zeros((0, 0, 0), np.float32),
            slope_parts=slope_parts if self._turns else np.zeros((0, 0, 0), np.float32),
            own=own,
            gram=weighted @ weighted.T,
            ridge=self._ridge(),
            errors=self._errors(),
            prior=np.array(self.prior, np.float64),
            correlated=float(self.correlated),
            freedom=float(self.freedom),
            colours=self._knows_colours,
        )

    def __getstate__(self) -> dict:
        """Leave out compiled functions and addresses, which are valid in this process only."""
        return {name: value for name, value in self.__dict__.items() if name not in ("row", "given", "_idle")}

    @cached_property
    def given(self) -> tuple[Any, Any]:
        """The template and the row in the form that the kernel takes."""
        return get_kernel(self.kernel).by_reference(self.template), get_kernel(self.kernel).by_reference(self.row)

    @property
    def _turns(self) -> bool:
        """Whether theta_1, and so the model's side, changes during a fit."""
        return bool(self.method.angle_directions[0].any())

    @cached_property
    def _idle(self) -> list[tuple[Work, Any]]:
        """Works that fits have released, and their form for the kernel: making both takes 0.1 ms a level."""
        return []

    def borrow(self, state: State, max_iterations: int) -> tuple[Work, Any]:
        """Return the arrays of a fit (see :meth:`work`), perhaps of an earlier fit, and their form for the kernel."""
        idle = None
        with suppress(IndexError):  # there are none, or another thread has taken the last
            idle = self._idle.pop()
        if idle and len(idle[0].costs) > max_iterations:
            work, given = idle
            return self._begin(work, state), given
        work = self.work(state, max_iterations)
        return work, get_kernel(self.kernel).by_reference(work)

    def release(self, work: Work, given: Any) -> None:
        """Let another fit use the arrays of :meth:`borrow`."""
        if given is not None and len(self._idle) < MOST_IDLE:
            self._idle.append((work, given))

    def _begin(self, work: Work, state: State) -> Work:
        """Set the arrays of a fit to a state, to the model's weights, and to what is unknown before the first step."""
        work.p[:], work.angles[:], work.lam[:] = state
        work.own[:] = work.weighed[:] = self.template.own
        work.gram[:] = self.template.gram
        work.known[:] = work.unexplained[:] = np.nan
        work.last_step[:] = work.base[:] = work.noise[:] = 0.0
        work.by_model[:] = 1.0
        unit = 1.0 if self.method.weights == "noise" else np.nan
        work.scales[:] = unit, 1.0, 0.0, 1.0, 1.0, LEAST_CURVATURE, 0.0
        return work

    def work(self, state: State, max_iterations: int = 0) -> Work:
        """Allocate the arrays of a fit, at a state and with the model's weights."""
        names, template = ("rows", "lines", "slopes"), self.template
        turned = {name: getattr(template, name).copy() if self._turns else getattr(template, name) for name in names}
        arrays = {name: np.zeros(shape, dtype) for name, (dtype, shape) in self._shapes.items()}
        return self._begin(Work(**arrays, **turned, **self.trace(max_iterations)), state)

    def trace(self, n_steps: int) -> dict[str, np.ndarray]:
        """Allocate the arrays of :class:`Work` for costs, parameters and angles of so many steps."""
        n = n_steps + 1
        return {"costs": np.empty(n), "path": np.empty((n, self.warp.n_parameters)), "turns": np.empty((n, 2))}

    @cached_property
    def _shapes(self) -> dict[str, tuple[str, tuple[int, ...]]]:
        """Type and shape of the arrays of a fit."""
        method, n, n_p, n_q, m = self.method, len(self.appearance.mean), self.warp.n_parameters, self.n_q, self.n_lambda
        by_noise = method.weights == "noise"
        pixels = {
            "n_noise": by_noise,
            "n_turned": by_noise and n_q > n_p,
            "n_known": method.weighs_noise,
            "n_expected": method.expects,
        }
        sizes = {"n": n, "k": method.n_rows, "v": len(self.template.warp.rest), "n_p": n_p, "n_free": n_q - n_p}
        sizes |= {"n_q": n_q, "m": m, "w_p": padded(n_p), "w_m": padded(m)}
        sizes |= {name: n if used else 0 for name, used in pixels.items()}
        return work_shapes(sizes)

    def _rows_of(self, appearance: AppearanceModel, illumination: AppearanceModel | None) -> np.ndarray:
        """Return mean and modes projected by the parts of P (constant, cos, sin), (3, 1 + m, n, k) float32."""
        k, parts = self.method.n_rows, []
        textures = [appearance.mean[None], appearance.modes]
        if self.method.illumination and illumination is not None:
            textures.append(illumination.modes)
        for metric in self.method.model_metric_parts.astype(np.float32):
            rows = [texture @ metric.T for texture in textures]
            if self.method.gain:  # the gain's mode is the mean
                rows.append(rows[0])
            parts.append(np.concatenate(rows))
        biases = {"none": np.zeros((0, 1, k)), "common": np.ones((1, 1, k)), "rows": np.eye(k)[:, None]}
        constant = np.broadcast_to(biases[self.method.bias], (len(biases[self.method.bias]), *parts[0].shape[1:]))
        parts = [np.concatenate([part, constant if i == 0 else 0.0 * constant]) for i, part in enumerate(parts)]
        return np.stack(parts).astype(np.float32)

    def _mesh(self) -> Mesh:
        make = getattr(self.warp, "mesh", None)
        if make is None:
            raise MethodError(f"kernel {self.kernel!r} takes meshes only; use kernel 'reference'")
        return make()

    def _ridge(self) -> np.ndarray:
        """Return the ridge on the diagonal of A'A, (m,) float64, from the norms of the modes before projection."""
        appearance, k = self.appearance, self.method.n_rows
        modes = [appearance.modes]
        if self.method.illumination and self.illumination is not None:
            modes.append(self.illumination.modes)
        if self.method.gain:
            modes.append(appearance.mean[None])
        sizes = [np.square(own, dtype=np.float64).sum(axis=(1, 2)) for own in modes]
        biases = {"none": [], "common": [k * len(appearance.mean)], "rows": [len(appearance.mean)] * k}
        ridge = RIDGE * np.maximum(np.concatenate([*sizes, biases[self.method.bias]]), 1e-12)
        ridge[: appearance.n_modes] += self._ordinary_unit() / np.maximum(appearance.eigenvalues, 1e-12)
        return ridge

    def _ordinary_unit(self) -> float:
        """Return the variance at weight 1 in images like those of training, for weights by rows; else 0.

        It converts the prior of lambda, N(0, eigenvalues), to units of squared residuals. If an image leaves more
        unexplained than training images do, its appearance may deviate as much more: the common scale cancels.
        """
        unexplained, usable = self.appearance.unexplained, self.appearance.usable
        if self.method.weights != "rows" or unexplained is None or not usable.any():
            return 0.0
        variances = np.average(np.einsum("ncc->nc", unexplained), axis=0, weights=usable)
        group = np.where(np.arange(len(variances)) < 2, GRADIENTS, COLOUR)
        precisions = 1.0 / (np.array(CORRELATED)[group] * np.maximum(variances, 1e-9))
        return float(self.correlated / np.where(self._knows_colours | (group == GRADIENTS), precisions, 0.0).mean())

    @property
    def _knows_colours(self) -> bool:
        return bool(self.appearance.mean[:, -1].any())

    def _at_model_angle(self, parts: np.ndarray) -> np.ndarray:
        """Combine parts (3, ...) float32 that are constant and multiplied by cos and sin of theta_1."""
        at = np.array([1.0, np.cos(self.theta_model), np.sin(self.theta_model)], np.float32)
        return np.ascontiguousarray(np.tensordot(at, parts, axes=1))

    @cached_property
    def _slope_parts(self) -> np.ndarray:
        """Spatial gradients of mean and modes, (1 or 3, 1 + m, 2 n k) float32; empty for methods that use none.

        Three parts, as of :meth:`_rows_of`, if theta_1 is free; else one at the model's angle.
        """
        parts = self._rows_of(*(self.in_frame or (self.appearance, self.illumination)))
        parts = parts if self._turns else self._at_model_angle(parts)[None]
        if not self.method.expects:
            return np.zeros((*parts.shape[:2], 0), np.float32)
        n_parts, n_modes, n_all, k = parts.shape
        columns = parts.transpose(2, 0, 1, 3).reshape(n_all, -1)
        slopes = self.warp.slopes(columns).reshape(-1, 2, n_parts, n_modes, k)
        return np.ascontiguousarray(slopes.transpose(2, 3, 0, 1, 4), np.float32).reshape(n_parts, n_modes, -1)

    def _errors(self) -> np.ndarray:
        """Return the variance of the model's errors, mean over the rows of P, (n,) float64; 0 if unknown."""
        unexplained = self.appearance.unexplained
        if unexplained is None:
            return np.zeros(len(self.appearance.mean))
        metric = self.method.model_metric(self.theta_model)
        return np.einsum("kc,ncd,kd->n", metric, unexplained, metric, optimize=True) / len(metric)

    def picture(self, problem: FitProblem) -> Picture:
        """Return a problem's image in the form that the loop takes."""
        # In an image smaller than the model's frame, one image pixel covers several model pixels.
        tied = max(correlated_pixels(problem.blur), 1.0 / problem.pose.scale**2)
        return problem.picture(max(1.0, self.density * tied), self.method.weighs_noise)

    def start(self, p: np.ndarray) -> State:
        """Return a state with the mean appearance and the model's angle for both cameras."""
        return State(np.array(p, np.float64), np.full(2, self.theta_model), np.zeros(self.n_lambda))

    def evaluate(self, problem: FitProblem, state: State, weigh: int = 0) -> Work:
        """Evaluate the residual of a state without solving for lambda, and update the weights ``weigh`` times."""
        kernel, work = get_kernel(self.kernel), self.work(state)
        (template, row), seen = self.given, kernel.by_reference(work)
        picture = kernel.by_reference(self.picture(problem))
        kernel.evaluate_residual(template, picture, row, seen, False)
        kernel.solve_lambda(template, row, seen, False, False)
        for _ in range(weigh if self.method.reweighs else 0):
            if self.row.weigh(template, picture, row, seen):
                if self.row.loss >= 0:
                    self.row.weigh_by_loss(template, row, seen)
                kernel.solve_lambda(template, row, seen, True, False)
        return work

    def equations(self, work: Work) -> tuple[np.ndarray, np.ndarray]:
        """Return the Hessian J'QJ (n_q, n_q) and the gradient J'Qr (n_q,) of eq 5, from the image's own gradient."""
        kernel = get_kernel(self.kernel)
        kernel.differentiate(*self.given, kernel.by_reference(work), work.image_slopes, work.image_slopes)
        return work.hessian, work.gradient

    def unit(self, work: Work) -> float:
        """Return the variance at weight 1, including correlation, from the weights or else from the cost."""
        if self.method.weights == "rows" and np.isfinite(work.scales[UNIT]):
            return float(work.scales[UNIT])
        return float(self.correlated * work.sums[0] / work.sums[1]) if work.sums[1] > 0 else 0.0

    def solve(self, problem: FitProblem, work: Work, controls: Controls, given: Any = None) -> None:
        """Minimise the cost over one image from the state in ``work``: one call of the loop.

        ``given`` is the form of ``work`` that the kernel takes, if known (:meth:`borrow`).
        """
        kernel = get_kernel(self.kernel)
        expects = controls.expected or self.method.step == "expected"
        if expects > self.method.expects or controls.reweigh > self.method.reweighs:
            raise MethodError(f"method {self.method.name} has no such steps or weights")
        if expects and not controls.expected and controls.max_iterations:
            raise MethodError(f"method {self.method.name} takes no steps with the image's own gradient")
        template, row = self.given
        picture, controls = map(kernel.by_reference, (self.picture(problem), controls))
        kernel.solve_level(template, picture, row, controls, kernel.by_reference(work) if given is None else given)


THINNING = 1.5
"""Distance between sampled pixels, in standard deviations of a level's blur. Closer pixels are redundant. On the spot
protocol ``soft-li`` has a median error of 4.03 % with all pixels, 4.05 with half of the sharpest level's and 4.11 with
a quarter. The 90th percentile is 5.6 in each case."""


def make_objectives(
    model: AAM, method: Method, kernel: str = "fast", thinning: float | None = None
) -> tuple[Objective, ...]:
    """Make the objectives of a model and a method, one per level, coarse to fine.

    Parameters
    ----------
    model : AAM
    method : Method
    kernel : {"fast", "reference"}
    thinning : float, optional
        Distance between sampled pixels, in standard deviations of a level's blur. By default :data:`THINNING`, and 0
        (every pixel) for orientations: they are normalised after the blur, so neighbours are less redundant. Measured
        with ``igo`` on unseen persons of IMM: 6.1 % with all pixels, 7.1 % otherwise.

    Raises
    ------
    MethodError
        If the model lacks what the method needs, such as colour.
    """
    if method.needs_colour and not model.is_colour:
        raise MethodError(
            f"method {method.name} compares colours, but the model was trained on grey images; "
            "use method 'soft-li' or 'grey'"
        )
    method = _encoded(model, method)
    _check_holds(model, method)
    get_kernel(kernel)
    if thinning is None:
        thinning = 0.0 if method.encoding == "orientation" else THINNING
    return tuple(_objective(model, method, kernel, level, thinning) for level in model.views[method.view].levels)


def _objective(model: AAM, method: Method, kernel: str, level: Level, thinning: float) -> Objective:
    """Make the objective of one level, on a thinned set of pixels."""
    appearance, illumination = level.appearances[method.appearance], level.appearances.get("illumination")
    warp = model.views[method.view].warp
    # Estimating the prior's scale needs weights that account for correlation.
    freedom = warp.shape_model.freedom if method.weights == "rows" else np.inf
    # N(0, eigenvalue) for the shape modes; the four similarity vectors have no prior.
    prior = np.concatenate([1.0 / np.maximum(warp.shape_model.eigenvalues, 1e-12), np.zeros(4)])

    def at(kept: np.ndarray, whole: Objective | None = None) -> Objective:
        density = len(kept) / len(appearance.mean)
        return Objective(
            method,
            warp.at(kept),
            appearance.at(kept),
            model.theta,
            prior,
            kernel,
            None if illumination is None else illumination.at(kept),
            correlated=max(1.0, density * correlated_pixels(level.blur)),
            density=density,
            freedom=freedom,
            whole=whole,
            in_frame=(appearance, illumination),
        )

    return at(warp.every(thinning * level.blur), at(warp.every(0.0)))


def _encoded(model: AAM, method: Method) -> Method:
    """Return a method whose encoding, if it is a function of the user, ends with the model's projection."""
    if not callable(method.encoding) or isinstance(method.encoding, Encoder):
        return method
    function: Any = method.encoding
    known, name = model.features, name_of(function)
    if known is None or known.name != name:
        given = "was trained without features" if known is None else f"was trained with the features {known.name}"
        raise MethodError(
            f"method {method.name} compares the features {name}, but the model {given}; train it with this function "
            "(train(..., features=function))"
        )
    return replace(method, encoding=Encoder(function, known))


def _check_holds(model: AAM, method: Method) -> None:
    """Raise an error if the model lacks what the method needs."""
    if method.view not in model.views:
        raise MethodError(
            f"method {method.name}: the model has no view {method.view}; train it again, or use method "
            f"'{'li' if model.is_colour else 'grey'}'"
        )
    for level in model.views[method.view].levels:
        missing = {method.appearance, *(["illumination"] if method.illumination else [])} - set(level.appearances)
        if missing & {"varied", "illumination"}:
            raise MethodError(
                f"method {method.name} needs a model trained on relit images; train it with lamps "
                "and at least one copy of each image ('liaam train --lamps', or train(..., lamps=...))"
            )
        if missing:
            raise MethodError(f"method {method.name}: the model has no appearance of this kind; train it again")
        if method.loss == "learnt" and level.appearances[method.appearance].unexplained is None:
            raise MethodError(f"method {method.name}: the model has no variances of its errors; train it again")
