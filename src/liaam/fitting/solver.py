"""The one solver: damped steps on (p, free angles) with lambda eliminated or joint.

Paper eq 5, 9 and 10 give the additive Gauss-Newton step of the joint system (p, lambda, theta). Both
eliminations take that step for p and theta; they differ in lambda:

``varpro``  variable projection: lambda is solved afresh at every state, the cost compared is the reduced one;
``joint``   the paper's form: lambda moves by its own part of the joint step.

Steps are made with the picture's own gradient (:func:`_own_step`) or, by ``soft-li`` and at the end of methods that
weigh by noise, with the one that the model expects (:func:`_expected_step`); the loop is the same (:func:`_iterate`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from math import isfinite
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from liaam.errors import MethodError
from liaam.fitting.normal_equations import NormalEquations, Sums, on_diagonal, solve_lifted
from liaam.fitting.objective import Linearisation, Objective, State
from liaam.fitting.prior import next_scale_of_one
from liaam.fitting.problem import FitProblem
from liaam.fitting.trust import Trust
from liaam.kernels import get_kernel

ELIMINATIONS = ("varpro", "joint")
ANGLE_STARTS = ("best", "model")


@dataclass(frozen=True)
class SolverOptions:
    """How to iterate.

    Attributes
    ----------
    max_iterations : int
        Steps to try at most.
    tolerance : float
        Stop when a step moves the landmarks by less than this root mean square, model pixels.
    notice : float
        Stop too when a step is shorter than this share of its own standard deviation, root mean square over the
        parameters, where the method knows it (``soft-li``): what nobody can tell is not worth an iteration, and such a
        step is taken without another look. Measured on IMM: at 0.03 a third fewer iterations and the same errors; at
        0.1 fits from far off stop on the way.
    elimination : {"varpro", "joint"}
        How lambda is treated.
    damping : float
        Initial Levenberg damping, relative to the Hessian's diagonal (with the model's own gradient: to the expected
        Hessian); 0 for pure Gauss-Newton as in the paper (every step is taken).
    shape_prior : float
        Strength of the Gaussian prior on the shape modes: 1 as learnt, 0 none (the paper).
    observable : float
        A turn of both angles together is estimated only where its curvature exceeds this multiple of what
        noise alone would give. Measured: 1-16 without a change of light (the model's own errors are not
        quite noise), 100 and more under a lateral light in scenes.
    angle_start : {"best", "model"}
        Where theta_2 starts: at its closed-form optimum for the start's shape, or at the model's angle.
    scoring : int
        Steps with the model's own gradient to end the finest level with, at most (see :func:`_expected_step`);
        ``soft-li`` takes no others, and methods with ``+noise`` take some at any rate.
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
        At that state, or at the one before it where the last step was too short to be noticed.
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

EXPECTED_RISE = 1.25
"""By how much more than the least cost a step with the expected gradient may leave: its zero is not the cost's minimum,
which noise dents. Measured: 2 % more at a noise of 10 of 255, and a limit of 5 % refused good steps at 15 and 20."""

LEAST_CURVATURE = 0.5
"""Least curvature in a step with the expected gradient, as a share of the expected one: where picture and model are
apart, their gradients agree less, and undamped steps would run off. Measured on strangers of IMM: a third more fits end
beyond 8 % without; 1 would be Fisher scoring, which takes twice as many steps."""

TO_AND_FRO = 0.5
"""Share of the step before it that a step back may have; a longer one says that steps go to and fro about a kink of
bilinear samples, which noise makes sharp, and doubles the least curvature."""

SCORING_STEPS = 5
"""Steps with the expected gradient that methods with weights by noise end each level with, at most, under the weights
that they have come to. From the start, as ``soft-li`` takes them, they lose more strangers than Gauss-Newton's."""

REFUSED_DAMPING = 1.0
"""Damping after the first refused step with the expected gradient, relative to the expected curvature."""


class _Run(NamedTuple):  # made anew twice an iteration: of a tuple that takes a quarter of a dataclass's time
    """Where an iteration stands: fields as those of :class:`Solution`.

    Attributes
    ----------
    free : (n_q,) bool
        Entries of q that may move.
    damping : float
    least : float
        Lowest merit under these weights.
    curvature : (n_q, n_q) float64, optional
        Expected Hessian, E'E with lambda eliminated, under these weights.
    lift : float
        Least curvature as a share of it.
    before : (n_q,) float64, optional
        The last step taken.
    """

    state: State
    last: Linearisation
    trust: Trust | None
    free: np.ndarray
    damping: float
    path: tuple[tuple[float, State], ...]
    least: float = np.inf
    curvature: np.ndarray | None = None
    lift: float = LEAST_CURVATURE
    before: np.ndarray | None = None
    n_iterations: int = 0
    settled: bool = False
    flat: bool = False
    scale: float = 1.0

    @property
    def solution(self) -> Solution:
        """Give what the solver answers."""
        return Solution(
            self.state,
            self.last,
            self.path,
            self.n_iterations,
            self.settled,
            not self.free.all(),
            self.flat,
            self.trust,
            self.scale,
        )


def solve(objective: Objective, problem: FitProblem, start: State, options: SolverOptions) -> Solution:
    """Minimise an objective over one image from a start.

    Never raises for a fit that goes wrong and never loops beyond ``max_iterations``, and ``scoring`` more.
    """
    run = _begin(objective, problem, start, options)
    if objective.method.soft:
        return _iterate(objective, problem, run, options, options.max_iterations, _expected_step).solution
    run = _iterate(objective, problem, run, options, options.max_iterations, _own_step)
    most = min(options.scoring or (SCORING_STEPS if objective.method.noise_weights else 0), options.max_iterations)
    if not most or run.flat:
        return run.solution
    start_of_scoring = run._replace(damping=0.0, before=None)
    scored = _iterate(objective, problem, start_of_scoring, options, most, _expected_step, weighs=options.scoring > 0)
    good = scored.last.cost <= EXPECTED_RISE * run.last.cost
    return (scored._replace(settled=run.settled, flat=False) if good else run).solution


def _iterate(
    objective: Objective,
    problem: FitProblem,
    run: _Run,
    options: SolverOptions,
    most: int,
    propose: "_Proposes",
    weighs: bool = True,
) -> _Run:
    """Step on, at most so many times, until steps are too small to matter; weigh pixels anew on the way, or do not."""
    run = run._replace(least=np.inf, settled=False)
    for _ in range(most):
        tried = propose(objective, run, options)
        if tried is None:
            return run._replace(flat=True)
        now: dict[str, Any] = {"n_iterations": run.n_iterations + 1, "scale": tried.scale, **tried.expected}
        stepped = objective.update(run.state, tried.step, tried.lambda_step)
        if tried.unnoticed:
            return run._replace(state=stepped, path=(*run.path, (run.last.cost, stepped)), settled=True, **now)
        new, there = _evaluate(objective, problem, stepped, options, run.trust)
        merit = _merit(there.sums, new, tried.precision)
        least = min(run.least, _merit(run.last.sums, run.state, tried.precision))
        if not merit <= tried.rise * least and tried.refused is not None:
            if tried.small or run.damping >= DAMPING_RANGE[1]:
                return run._replace(settled=True, **now)
            run = run._replace(damping=min(tried.refused, DAMPING_RANGE[1]), **now)
            continue
        trust = run.trust
        if weighs and not (_averages(objective) and _moved(objective, tried.step) < STILL):
            new, there, trust = _weigh_anew(objective, problem, new, there, options, trust)
        settled = tried.small and tried.accepted <= TRUSTED_DAMPING  # small of itself, not by damping
        # Neither holds under other weights.
        now |= {"least": min(merit, least)} if trust is run.trust else {"least": np.inf, "curvature": None}
        run = run._replace(
            state=new,
            last=there,
            trust=trust,
            free=_free_directions(objective, new, there, options.observable),
            damping=tried.accepted,
            path=(*run.path, (there.cost, new)),
            before=tried.step,
            settled=settled,
            **now,
        )
        if settled or not isfinite(there.cost):
            break
    return run


class _Tried(NamedTuple):
    """A step to be tried.

    Attributes
    ----------
    step, lambda_step : (n_q,), (m,) float64
    precision : (n_q,) float64
        Of the prior.
    scale : float
        Of the prior's variances.
    small : bool
        Whether it is too small to matter.
    unnoticed : bool
        Whether nobody can tell it from none, so that it is taken without another look at the picture.
    rise : float
        By how much more than the least merit it may leave.
    accepted : float
        Damping after it, if it is taken.
    refused : float, optional
        Damping after it, if it is not; None for a step that is taken in any case.
    expected : dict
        What is known of the expected gradient: fields of :class:`_Run`.
    """

    step: np.ndarray
    lambda_step: np.ndarray
    precision: np.ndarray
    scale: float
    small: bool
    unnoticed: bool
    rise: float
    accepted: float
    refused: float | None
    expected: Mapping[str, Any] = MappingProxyType({})


_Proposes = Callable[[Objective, _Run, SolverOptions], _Tried | None]


def _own_step(objective: Objective, run: _Run, options: SolverOptions) -> _Tried | None:
    """Gauss-Newton step with the picture's own gradient (paper eq 10), damped; None where there is nothing to see."""
    state, equations = run.state, run.last.equations
    scale, precision = _prior(objective, run, equations.reduced()[0], options)
    steps = _step(objective, equations, state, precision, run.free, run.damping)
    if steps is None:
        return None
    damped = options.damping > 0
    accepted = max(run.damping / 10, DAMPING_RANGE[0]) if damped else 0.0
    refused = max(run.damping, 1e-4) * 10 if damped else None
    matters = _matters(objective, steps[0], equations.reduced()[0], equations.unit, precision, accepted, options)
    return _Tried(*steps, precision, scale, *matters, 1.0, accepted, refused)


def _expected_step(objective: Objective, run: _Run, options: SolverOptions) -> _Tried | None:
    """Newton step towards the zero of E'r, with E by the model's gradient, which has no noise; None as above.

    A noisy image's own gradient makes Gauss-Newton steps short, and the minimum they creep to is one of a cost with
    small dents, since noise sampled between pixels is smoother. With the expected gradient instead the estimate is
    as good as the noise allows (Fisher scoring). The derivative of E'r is E'J with the picture's J: unlike E'E it knows
    how steep the picture is, and unlike J'J it has no noise on average (J is E's instrument, as statisticians say), so
    that steps converge fast. Its symmetric part is used, and where it falls short of E'E it is lifted
    (:data:`LEAST_CURVATURE`).
    """
    state = run.state
    gradient = objective.model_gradient(state)
    curvature = run.last.with_gradient(gradient).reduced()[0] if run.curvature is None else run.curvature
    scale, precision = _prior(objective, run, curvature, options)
    equations = run.last.expecting(gradient)
    metric = curvature.copy()
    diagonal = on_diagonal(metric)  # a view
    diagonal += precision
    step = _guarded_step(equations, metric, state, precision, run.free, run.lift, run.damping)
    if step is None:
        return None
    accepted = run.damping / 10 if run.damping > TRUSTED_DAMPING else 0.0
    refused = max(run.damping * 10, REFUSED_DAMPING) if options.damping > 0 else None
    lift = 2.0 * run.lift if _goes_back(step, run.before, metric) else run.lift
    expected = {"curvature": curvature, "lift": lift}
    matters = _matters(objective, step, curvature, equations.unit, precision, accepted, options)
    lambda_step = equations.lambda_step(step)
    return _Tried(step, lambda_step, precision, scale, *matters, EXPECTED_RISE, accepted, refused, expected)


def settle_lambda(
    objective: Objective, problem: FitProblem, state: State, options: SolverOptions
) -> tuple[State, Linearisation]:
    """Give a state its best appearance, under the weights that go with it, and linearise there."""
    run = _begin(objective, problem, state, options)
    return run.state, run.last


def _begin(objective: Objective, problem: FitProblem, start: State, options: SolverOptions) -> _Run:
    state, last = _solve_lambda(objective, start, objective.linearise(problem, start))
    state, last, trust = _weigh_anew(objective, problem, state, last, options, None)
    if not _averages(objective):  # again: what the weights are worked out from depends on the weights
        state, last, trust = _weigh_anew(objective, problem, state, last, options, trust)
    free = _free_directions(objective, state, last, options.observable)
    return _Run(state, last, trust, free, options.damping, ((last.cost, state),))


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
    if options.elimination == "joint":
        return state, objective.linearise(problem, state, trust)
    if not objective.method.soft:
        return _solve_lambda(objective, state, objective.linearise(problem, state, trust))
    # From nothing, which is one pass over the modes less. Other methods judge steps by differences of costs that sums
    # about the mean appearance would drown in rounding.
    bare = State(state.p, state.angles, np.zeros_like(state.lam))
    seen = objective.linearise(problem, bare, trust)
    return _solve_lambda(objective, bare, seen) if seen.sums.weight > 0 else (state, seen)


def _solve_lambda(objective: Objective, state: State, seen: Linearisation) -> tuple[State, Linearisation]:
    """Give a state the lambda that fits best there, by the products alone."""
    if not seen.sums.weight > 0:
        return state, seen
    step = seen.sums.best_lambda_step()
    return State(state.p, state.angles, state.lam + step), objective.moved(seen, state, step)


LONGEST_UNSEEN = 1.0
"""Step, in model pixels, that is not taken without another look however uncertain the object is."""

STILL = 0.2
"""Step, in model pixels, after which soft weights are kept: what they are averaged from has hardly changed."""


def _averages(objective: Objective) -> bool:
    """Whether weights are made of averages over many pixels; a robust loss looks at each."""
    return objective.method.soft and objective.method.loss == "squares"


def _moved(objective: Objective, step: np.ndarray) -> float:
    """Root mean square movement of what the warp carries by a step of q, model pixels."""
    return objective.warp.movement(step[: objective.warp.n_parameters])


def _matters(
    objective: Objective,
    step: np.ndarray,
    hessian: np.ndarray,
    unit: float,
    precision: np.ndarray,
    damping: float,
    options: SolverOptions,
) -> tuple[bool, bool]:
    """Tell whether a step is too small to matter, and whether that is so short of its standard deviation.

    The latter is told only where deviations are known, and of steps that are short in pixels too, and small of
    themselves, not by damping.
    """
    moved, unnoticed = _moved(objective, step), False
    small = moved < options.tolerance
    if isfinite(unit):
        information = step @ (hessian @ step + precision * step)
        unnoticed = bool(information < options.notice**2 * len(step) * unit)
    return small or unnoticed, unnoticed and moved < LONGEST_UNSEEN and damping <= TRUSTED_DAMPING


def _prior(objective: Objective, run: _Run, hessian: np.ndarray, options: SolverOptions) -> tuple[float, np.ndarray]:
    """Scale of the shape prior's variances, and its precision on q in units of squared residuals, (n_q,).

    The scale is 1 where shapes do not come near and far; angles have no precision.
    """
    strength, unit, scale = options.shape_prior, objective.unit(run.last.sums), 1.0
    if isfinite(objective.freedom) and strength > 0:
        scale = next_scale_of_one(hessian, run.state.p, strength * objective.prior, unit, objective.freedom, run.scale)
    return scale, strength / scale * unit * objective.prior_of_all


def _merit(equations: Sums, state: State, precision: np.ndarray) -> float:
    """Give what an accepted step must not raise: mean squared residual plus the prior's share."""
    prior = float(precision[: len(state.p)] @ (state.p * state.p))
    return equations.cost + (prior / equations.weight if equations.weight > 0 else 0.0)


def _step(
    objective: Objective,
    equations: NormalEquations,
    state: State,
    precision: np.ndarray,
    free: np.ndarray,
    damping: float,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Damped Gauss-Newton step of q and its lambda step; None where there is nothing to see."""
    n_p, (hessian, gradient) = len(state.p), equations.reduced()
    # Neither the prior nor an angle makes up for a picture that is flat under the model.
    if not (isfinite(equations.rr) and hessian.diagonal()[:n_p].max() > 1e-10 * equations.weight > 0):
        return None
    pulled = _pulled(gradient, state, precision)
    step = get_kernel(objective.kernel).damped_step(hessian, pulled, precision, free, damping)
    return None if step is None else (step, equations.lambda_step(step))


def _pulled(gradient: np.ndarray, state: State, precision: np.ndarray) -> np.ndarray:
    """Gradient (n_q,) with the prior's pull on p; a copy."""
    pulled, n_p = gradient.copy(), len(state.p)
    pulled[:n_p] += precision[:n_p] * state.p
    return pulled


def _goes_back(step: np.ndarray, before: np.ndarray | None, metric: np.ndarray) -> bool:
    """Tell whether a step goes back where the last one came from, by more than a share of it."""
    if before is None:
        return False
    return bool(step @ metric @ before < -TO_AND_FRO * (before @ metric @ before))


def _guarded_step(
    equations: NormalEquations,
    base: np.ndarray,
    state: State,
    precision: np.ndarray,
    free: np.ndarray,
    lift: float,
    damping: float,
) -> np.ndarray | None:
    """Step to the zero of a gradient, by a Hessian no flatter than a share of another one, prior included."""
    n_p, (hessian, gradient) = len(state.p), equations.reduced()
    if not (isfinite(equations.rr) and isfinite(hessian.sum() + base.sum())):
        return None
    # A picture that is flat under the model has no gradient of its own, whatever is expected; nor is there a step where
    # none is expected, as where the model lies folded to nothing.
    seen, expected = np.abs(hessian.diagonal()[:n_p]).max(), base.diagonal()[:n_p].max()
    if not (seen > 1e-10 * equations.weight > 0 and expected > 0):
        return None
    gradient, hessian = _pulled(gradient, state, precision), hessian.copy()  # the equations keep theirs
    diagonal = on_diagonal(hessian)  # a view
    diagonal += precision
    if len(free) == n_p or free.all():
        return -solve_lifted(base, hessian, gradient, lift, damping)
    step, own = np.zeros(len(free)), np.ix_(free, free)
    step[free] = -solve_lifted(base[own], hessian[own], gradient[free], lift, damping)
    return step


def _free_directions(objective: Objective, state: State, last: Linearisation, observable: float) -> np.ndarray:
    """Which entries of q may move, (n_q,) bool: all of p, and the angles that the image can tell.

    Where the light has not changed, turning both angles together changes nothing but noise: the energy of
    dr/dtheta is that of the residual itself, scaled by |L'|^2 / |L|^2. With less than ``observable`` times that
    they are not turned together, so that noise cannot make them drift; ``li-pc`` then keeps theta_1 and moves
    theta_2 only, as ``li`` does.
    """
    n_p, n_q = objective.warp.n_parameters, objective.n_q
    free = np.ones(n_q, dtype=bool)
    if n_q > n_p:
        free[n_p:] = _observable_angles(objective, state, last.equations, observable)
    return free


def _observable_angles(objective: Objective, state: State, equations: NormalEquations, observable: float) -> list[bool]:
    """Whether each free angle of the method can be told."""
    n_p, method = objective.warp.n_parameters, objective.method
    hessian = equations.reduced()[0][n_p:, n_p:]
    noise = max(equations.rr, 0.0) * method.noise_slope(state.angles[1]) + 1e-12 * equations.weight
    limit = min(OBSERVABLE_APART, observable)  # 0 holds nothing, as in the paper
    if method.free_angles == "image":
        return [bool(hessian[0, 0] > limit * noise)]
    if method.free_angles == "shared":
        return [bool(hessian[0, 0] > observable * noise)]
    # In coordinates (theta_1 = theta_2 turned together, theta_2 alone), with the second eliminated from the first.
    apart, mixed = hessian[1, 1], hessian[:, 1].sum()
    image_seen = bool(apart > limit * noise)
    together = hessian.sum() - (mixed**2 / apart if image_seen else 0.0)
    return [image_seen and bool(together > observable * noise), image_seen]
