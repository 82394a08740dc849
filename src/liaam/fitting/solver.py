"""The one solver: Levenberg-damped Gauss-Newton on (p, free angles) with lambda eliminated or joint.

Paper eq 5, 9 and 10 give the additive Gauss-Newton step of the joint system (p, lambda, theta). Both
eliminations take that step for p and theta; they differ in lambda:

``varpro``  variable projection: lambda is solved afresh at every state, the cost compared is the reduced one;
``joint``   the paper's form: lambda moves by its own part of the joint step.
"""

from dataclasses import dataclass, fields

import numpy as np

from liaam.errors import MethodError
from liaam.fitting.normal_equations import NormalEquations, on_diagonal
from liaam.fitting.objective import FitProblem, Linearisation, Objective, State, Trust
from liaam.fitting.prior import next_scale

ELIMINATIONS = ("varpro", "joint")
ANGLE_STARTS = ("best", "model")


@dataclass(frozen=True)
class SolverOptions:
    """How to iterate.

    Attributes
    ----------
    max_iterations : int
        Gauss-Newton steps to try at most.
    tolerance : float
        Stop when a step moves the landmarks by less than this root mean square, model pixels.
    notice : float
        Stop too when a step is shorter than this share of its own standard deviation, root mean square over the
        parameters, where the method knows it (``soft-li``): what nobody can tell is not worth an iteration. Measured
        on IMM: at 0.03 a third fewer iterations and the same errors; at 0.1 fits stop on the way.
    elimination : {"varpro", "joint"}
        How lambda is treated.
    damping : float
        Initial Levenberg damping, relative to the Hessian's diagonal; 0 for pure Gauss-Newton as in the
        paper (every step is taken).
    shape_prior : float
        Strength of the Gaussian prior on the shape modes: 1 as learnt, 0 none (the paper).
    observable : float
        A turn of both angles together is estimated only where its curvature exceeds this multiple of what
        noise alone would give. Measured: 1-16 without a change of light (the model's own errors are not
        quite noise), 100 and more under a lateral light in scenes.
    angle_start : {"best", "model"}
        Where theta_2 starts: at its closed-form optimum for the start's shape, or at the model's angle.
    scoring : int
        Fisher scoring steps to end the finest level with, at most (see :func:`_score`); methods that weigh by noise
        take some at any rate.
    """

    max_iterations: int = 50
    tolerance: float = 0.01
    notice: float = 0.03
    elimination: str = "varpro"
    damping: float = 1e-3
    shape_prior: float = 1.0
    observable: float = 25.0
    angle_start: str = "best"
    scoring: int = 0

    @classmethod
    def of(cls, **options) -> "SolverOptions":
        """Options by name; a name that does not exist is refused with those that do."""
        known = [field.name for field in fields(cls)]
        for name in options:
            if name not in known:
                raise MethodError(f"option {name!r} does not exist; there are {', '.join(known)}")
        return cls(**options)

    def __post_init__(self) -> None:
        """Refuse options that make no sense."""
        if self.elimination not in ELIMINATIONS:
            raise MethodError(f"elimination {self.elimination!r} does not exist; there are {', '.join(ELIMINATIONS)}")
        if self.angle_start not in ANGLE_STARTS:
            raise MethodError(f"angle_start {self.angle_start!r} does not exist; there are {', '.join(ANGLE_STARTS)}")
        if not np.isfinite([self.tolerance, self.notice, self.damping, self.shape_prior, self.observable]).all():
            raise MethodError("tolerance, notice, damping, shape_prior and observable must be finite numbers")
        least = min(self.max_iterations, self.tolerance, self.notice, self.damping, self.shape_prior, self.scoring)
        if least < 0:
            raise MethodError("max_iterations, tolerance, notice, damping, shape_prior and scoring may not be negative")


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the solver stopped.

    Attributes
    ----------
    state : State
    last : Linearisation
        At that state.
    path : tuple of (cost, State)
        The start and every accepted state.
    n_iterations : int
    settled : bool
        The last step was below the tolerance.
    angles_held : bool
        The angles, or one combination of them, could not be observed at the end.
    flat : bool
        There was nothing to descend on: no texture under the model.
    trust : Trust, optional
        What the last pixels were weighed by.
    scale : float
        Of the shape prior's variances, in this picture.
    """

    state: State
    last: Linearisation
    path: tuple[tuple[float, State], ...]
    n_iterations: int
    settled: bool
    angles_held: bool
    flat: bool
    trust: Trust | None = None
    scale: float = 1.0


DAMPING_RANGE = (1e-7, 1e7)

TRUSTED_DAMPING = 1e-2
"""Damping up to which the size of a step says that the fit has settled."""

OBSERVABLE_APART = 2.0
"""As ``SolverOptions.observable``, for the image's angle against the model's: the object's own colours show it."""


def solve(objective: Objective, problem: FitProblem, start: State, options: SolverOptions) -> Solution:
    """Minimise an objective over one image from a start.

    Never raises for a fit that goes wrong and never loops beyond ``max_iterations``, and at most
    ``SCORING_STEPS`` more for methods that weigh by noise.
    """
    state, last, trust = _begin(objective, problem, start, options)
    path = [(last.equations.cost, state)]
    damping, settled, flat, iteration, scale = options.damping, False, False, 0, 1.0
    free = _free_directions(objective, state, last.equations, options.observable)
    for iteration in range(1, options.max_iterations + 1):  # noqa: B007 (reported)
        scale = _next_scale(objective, state, last.equations, options.shape_prior, scale)
        precision = _prior_precision(objective, last.equations, options.shape_prior / scale)
        steps = _step(last.equations, state, precision, free, damping)
        if steps is None:
            flat = True
            break
        step, lambda_step = steps
        small = _is_small(objective, step, last.equations, precision, options)
        moved_to = objective.update(state, step, lambda_step)
        new, there = _evaluate(objective, problem, moved_to, options, trust)
        worse = not _merit(there.equations, new, precision) <= _merit(last.equations, state, precision)
        if options.damping > 0 and worse:
            if small or damping >= DAMPING_RANGE[1]:
                settled = True
                break
            damping = min(max(damping, 1e-4) * 10, DAMPING_RANGE[1])
            continue
        state, last = new, there
        if not (_averages(objective) and _moved(objective, step) < STILL):
            state, last, trust = _weigh_anew(objective, problem, state, last, options, trust)
        path.append((last.equations.cost, state))
        damping = max(damping / 10, DAMPING_RANGE[0]) if options.damping > 0 else 0.0
        free = _free_directions(objective, state, last.equations, options.observable)
        if small and damping <= TRUSTED_DAMPING:  # small of itself, not by damping
            settled = True
            break
        if not np.isfinite(last.equations.cost):
            break
    if (options.scoring or (trust is not None and trust.noise is not None)) and not flat:
        scored = _score(objective, problem, state, last, options, trust, free, scale)
        if scored and scored[-1][1].equations.cost <= SCORING_RISE * last.equations.cost:
            state, last = scored[-1]
            path += [(seen.equations.cost, there) for there, seen in scored]
            iteration += len(scored)
    return Solution(state, last, tuple(path), iteration, settled, not free.all(), flat, trust, scale)


SCORING_STEPS = 5
"""Scoring steps at most, where none are asked for; they settle in two or three."""

SCORING_RISE = 1.25
"""Scoring that raises the cost by more than this has left the minimum for another reason than noise's dents, and is
undone. Measured: the cost rises by 2 % at a noise of 10 of 255, and a limit of 5 % undid good steps at 15 and 20."""


def _score(
    objective: Objective,
    problem: FitProblem,
    state: State,
    last: Linearisation,
    options: SolverOptions,
    trust: Trust | None,
    free: np.ndarray,
    scale: float,
) -> list[tuple[State, Linearisation]]:
    """Step on by Fisher scoring: with the gradient of the model, which has no noise.

    A noisy image's own gradient makes Gauss-Newton steps short, and the minimum they creep to is one of a cost
    with small dents, since noise sampled between pixels is smoother. From there a step or two with the expected
    gradient is as good an estimate as the noise allows (Le Cam's one-step estimator). The cost may rise by the
    depth of a dent.
    """
    scored: list[tuple[State, Linearisation]] = []
    for _ in range(min(options.scoring or SCORING_STEPS, options.max_iterations)):
        expected = objective.weighed(objective.own_gradient(last.look, state), state, trust).equations
        precision = _prior_precision(objective, expected, options.shape_prior / scale)
        steps = _step(expected, state, precision, free, damping=0.0)
        if steps is None:
            break
        state, last = _evaluate(objective, problem, objective.update(state, *steps), options, trust)
        if options.scoring:  # asked for more than a step or two: the weights move along
            state, last, trust = _weigh_anew(objective, problem, state, last, options, trust)
        scored.append((state, last))
        if _is_small(objective, steps[0], expected, precision, options):
            break
    return scored


def settle_lambda(
    objective: Objective, problem: FitProblem, state: State, options: SolverOptions
) -> tuple[State, Linearisation]:
    """Give a state its best appearance, under the weights that go with it, and linearise there."""
    state, last, _ = _begin(objective, problem, state, options)
    return state, last


def _begin(
    objective: Objective, problem: FitProblem, start: State, options: SolverOptions
) -> tuple[State, Linearisation, Trust | None]:
    state, last = _solve_lambda(objective, start, objective.linearise(problem, start))
    # Twice: what the weights are worked out from depends on the weights.
    state, last, trust = _weigh_anew(objective, problem, state, last, options, None)
    return _weigh_anew(objective, problem, state, last, options, trust)


def _weigh_anew(
    objective: Objective,
    problem: FitProblem,
    state: State,
    seen: Linearisation,
    options: SolverOptions,
    trust: Trust | None,
) -> tuple[State, Linearisation, Trust | None]:
    """Weigh the pixels by what they look like now; variable projection solves lambda again under the new weights.

    Steps are judged under the weights they were made with: a step that lowers the weighted squares lowers a
    robust loss of the same scale too.
    """
    new = objective.trust(problem, state, seen, trust)
    if new is None or new is trust:
        return state, seen, trust
    look = objective.look(problem, state, new) if objective.method.normalise else seen.look
    seen = objective.weighed(look, state, new)
    if options.elimination == "joint" and trust is not None:
        return state, seen, new
    return *_solve_lambda(objective, state, seen), new


def _evaluate(
    objective: Objective, problem: FitProblem, state: State, options: SolverOptions, trust: Trust | None
) -> tuple[State, Linearisation]:
    """Linearise at a state; variable projection also solves lambda there."""
    seen = objective.linearise(problem, state, trust)
    return (state, seen) if options.elimination == "joint" else _solve_lambda(objective, state, seen)


def _solve_lambda(objective: Objective, state: State, seen: Linearisation) -> tuple[State, Linearisation]:
    """Give a state the lambda that fits best there, by the products alone."""
    if not seen.equations.weight > 0:
        return state, seen
    step = seen.equations.best_lambda_step()
    look = objective.moved(seen.look, state, step)
    return State(state.p, state.angles, state.lam + step), Linearisation(seen.equations.after_lambda_step(step), look)


STILL = 0.1
"""Step, in model pixels, after which soft weights are kept: what they are averaged from has hardly changed."""


def _averages(objective: Objective) -> bool:
    """Whether weights are made of averages over many pixels; a robust loss looks at each."""
    return objective.method.soft and objective.method.loss == "squares"


def _moved(objective: Objective, step: np.ndarray) -> float:
    """Root mean square movement of what the warp carries by a step of q, model pixels."""
    return objective.warp.movement(step[: objective.warp.n_parameters])


def _is_small(
    objective: Objective, step: np.ndarray, equations: NormalEquations, precision: np.ndarray, options: SolverOptions
) -> bool:
    """Tell whether a step is too small to matter: in pixels, or in standard deviations where they are known."""
    if _moved(objective, step) < options.tolerance:
        return True
    if not np.isfinite(equations.unit):
        return False
    information = step @ equations.reduced()[0] @ step + precision @ np.square(step)
    return bool(information < options.notice**2 * len(step) * equations.unit)


def _next_scale(objective: Objective, state: State, equations: NormalEquations, strength: float, scale: float) -> float:
    """Scale of the shape prior's variances at a state, where shapes come near and far; 1 where they do not."""
    if not np.isfinite(objective.freedom) or not strength > 0:
        return 1.0
    hessian, unit = equations.reduced()[0], np.asarray(objective.unit(equations))
    return float(next_scale(hessian, state.p, strength * objective.prior, unit, objective.freedom, np.asarray(scale)))


def _prior_precision(objective: Objective, equations: NormalEquations, strength: float) -> np.ndarray:
    """Precision of the prior on q in units of squared residuals, (n_q,); angles have none."""
    precision = np.zeros(objective.n_q)
    precision[: objective.warp.n_parameters] = strength * objective.unit(equations) * objective.prior
    return precision


def _merit(equations: NormalEquations, state: State, precision: np.ndarray) -> float:
    """Give what an accepted step must not raise: mean squared residual plus the prior's share."""
    prior = float(precision[: len(state.p)] @ np.square(state.p))
    return equations.cost + (prior / equations.weight if equations.weight > 0 else 0.0)


def _step(
    equations: NormalEquations, state: State, precision: np.ndarray, free: np.ndarray, damping: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Damped Gauss-Newton step of q and its lambda step; None where there is nothing to see."""
    if not equations.weight > 0 or not np.isfinite(equations.rr):
        return None
    hessian, gradient = equations.reduced()
    # Neither the prior nor an angle makes up for a picture that is flat under the model.
    if not hessian.diagonal()[: len(state.p)].max() > 1e-10 * equations.weight:
        return None
    gradient = gradient.copy()  # the equations keep theirs
    gradient[: len(state.p)] += precision[: len(state.p)] * state.p
    hessian = hessian.copy() if free.all() else hessian[np.ix_(free, free)]
    diagonal = on_diagonal(hessian)  # a view
    diagonal += precision[free]
    floor = 1e-9 * diagonal.max()
    diagonal += damping * np.maximum(diagonal, floor) + floor
    step = np.zeros(len(free))
    try:
        step[free] = np.linalg.solve(hessian, -gradient[free])
    except np.linalg.LinAlgError:
        return None
    return step, equations.lambda_step(step)


def _free_directions(objective: Objective, state: State, equations: NormalEquations, observable: float) -> np.ndarray:
    """Which entries of q may move, (n_q,) bool: all of p, and the angles that the image can tell.

    Where the light has not changed, turning both angles together changes nothing but noise: the energy of
    dr/dtheta is that of the residual itself, scaled by |L'|^2 / |L|^2. With less than ``observable`` times that
    they are not turned together, so that noise cannot make them drift; ``li-pc`` then keeps theta_1 and moves
    theta_2 only, as ``li`` does.
    """
    n_p, n_q = objective.warp.n_parameters, objective.n_q
    free = np.ones(n_q, dtype=bool)
    if n_q > n_p:
        free[n_p:] = _observable_angles(objective, state, equations, observable)
    return free


def _observable_angles(objective: Objective, state: State, equations: NormalEquations, observable: float) -> list[bool]:
    """Whether each free angle of the method can be told."""
    n_p, metric = objective.warp.n_parameters, objective.method
    hessian = equations.reduced()[0][n_p:, n_p:]
    theta = state.angles[1]
    slope = np.square(metric.image_metric_derivative(theta)).sum() / np.square(metric.image_metric(theta)).sum()
    noise = max(equations.rr, 0.0) * slope + 1e-12 * equations.weight
    limit = min(OBSERVABLE_APART, observable)  # 0 holds nothing, as in the paper
    if metric.free_angles == "image":
        return [bool(hessian[0, 0] > limit * noise)]
    if metric.free_angles == "shared":
        return [bool(hessian[0, 0] > observable * noise)]
    # In coordinates (theta_1 = theta_2 turned together, theta_2 alone), with the second eliminated from the first.
    apart, mixed = hessian[1, 1], hessian[:, 1].sum()
    image_seen = bool(apart > limit * noise)
    together = hessian.sum() - (mixed**2 / apart if image_seen else 0.0)
    return [image_seen and bool(together > observable * noise), image_seen]
