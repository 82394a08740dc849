"""Options of the solver, and the solution of one level. The loop itself is :mod:`liaam.fitting.loop`."""

from dataclasses import dataclass, replace
from numbers import Integral, Real
from typing import Any

import numpy as np

from liaam.errors import MethodError
from liaam.fitting.level import SCALE, Controls, Work
from liaam.fitting.methods import Method
from liaam.fitting.objective import Objective, State
from liaam.fitting.problem import FitProblem

ELIMINATIONS = ("varpro", "joint")
ANGLE_STARTS = ("best", "model")

MOST_ITERATIONS = 1_000_000
"""Largest number of steps that makes sense."""


EARLY = {"expected": (0.25, 3), "own": (0.1, 10)}
"""Tolerance of the first steps as a fraction of a level's blur, and the number of these steps, by the kind of step.
Measured with ``soft-li`` on IMM: 7 steps instead of 9 on the spot protocol with the same error (4.11 %), and the same
errors on unseen persons within 0.02 %. Twice the fraction in all steps loses twice as many unseen persons."""


@dataclass(frozen=True)
class SolverOptions:
    """Options of the iteration.

    Attributes
    ----------
    max_iterations : int
        Maximum number of steps per level, rejected ones included.
    tolerance : float
        Stop when a step moves the landmarks by less than this root mean square, model pixels.
    early_tolerance : float, optional
        Tolerance in the first steps of a level, as a fraction of its blur; 0 disables it. By default 0.25 in the first
        3 steps with the expected gradient, and 0.1 in the first 10 of the other kind. Most fits get so near after two
        or three steps. The others are difficult, and continue until ``tolerance``.
    relative_tolerance : float
        Stop also when a step is shorter than this fraction of its own standard deviation, root mean square over the
        parameters. Applies to ``soft-li``, which estimates that deviation. Measured on IMM: 0.03 saves a third of the
        iterations at the same errors; with 0.1, fits from distant starts stop too early.
    elimination : {"varpro", "joint"}
        Solve for lambda at every state (variable projection), or update it by the joint step (the paper, eq 5).
    damping : float
        Initial Levenberg damping, relative to the Hessian's diagonal (with the expected gradient: to the expected
        Hessian). 0 is pure Gauss-Newton as in the paper, which accepts every step.
    shape_prior : float
        Strength of the Gaussian prior on the shape modes: 1 as learnt, 0 none (the paper).
    observable : float
        Estimate a common change of both angles only if its curvature exceeds this multiple of the curvature due to
        noise. Measured: 1-16 without a change of light, since the model's errors are not pure noise; 100 and more under
        a lateral light in generated scenes.
    angle_start : {"best", "model"}
        Start theta_2 at its closed-form optimum for the initial shape, or at the model's angle.
    scoring : int, optional
        Maximum number of steps with the expected gradient at the end of the finest level, with weights updated. By
        default, methods that compare logarithms end each level with up to 10 such steps, with fixed
        weights, and other methods with none. All steps of ``soft-li`` use the expected gradient.
    """

    max_iterations: int = 50
    tolerance: float = 0.01
    early_tolerance: float | None = None
    relative_tolerance: float = 0.03
    elimination: str = "varpro"
    damping: float = 1e-3
    shape_prior: float = 1.0
    observable: float = 25.0
    angle_start: str = "best"
    scoring: int | None = None

    def __post_init__(self) -> None:
        """Raise an error for invalid options."""
        if self.elimination not in ELIMINATIONS:
            raise MethodError(f"elimination {self.elimination!r} does not exist; there are {', '.join(ELIMINATIONS)}")
        if self.angle_start not in ANGLE_STARTS:
            raise MethodError(f"angle_start {self.angle_start!r} does not exist; there are {', '.join(ANGLE_STARTS)}")
        for name in ("tolerance", "early_tolerance", "relative_tolerance", "damping", "shape_prior", "observable"):
            value = getattr(self, name)
            if value is None and name == "early_tolerance":
                continue
            if not isinstance(value, Real) or not 0.0 <= float(value) < np.inf:
                raise MethodError(f"{name} {value!r}: give a finite number of at least 0")
        for name in ("max_iterations", "scoring"):
            value = getattr(self, name)
            if value is None and name == "scoring":
                continue
            if not isinstance(value, Integral) or not 0 <= int(value) <= MOST_ITERATIONS:
                raise MethodError(f"{name} {value!r}: give a whole number from 0 to {MOST_ITERATIONS:,}")

    def controls(
        self, expected: bool, reweigh: bool, evaluate_last: bool, blur: float = 0.0, max_iterations: int | None = None
    ) -> Controls:
        """Return the options of one level's loop; see :class:`liaam.fitting.level.Controls`."""
        fraction, first = EARLY["expected" if expected else "own"]
        return Controls(
            max_iterations=int(self.max_iterations if max_iterations is None else max_iterations),
            tolerance=float(self.tolerance),
            early_tolerance=float(blur * (fraction if self.early_tolerance is None else self.early_tolerance)),
            early_steps=first if blur > 0.0 else 0,
            relative_tolerance=float(self.relative_tolerance),
            damping=float(self.damping),
            shape_prior=float(self.shape_prior),
            observable=float(self.observable),
            joint=self.elimination == "joint",
            expected=expected,
            reweigh=reweigh,
            solve=True,
            evaluate_last=evaluate_last,
        )


SCORING_STEPS = 10
"""Maximum number of steps with the expected gradient at the end of each level, for methods that compare logarithms.
Measured with ``li`` on IMM: 4.48 instead of 4.62 % on the spot protocol, and 19 instead of 48 % of unseen persons lost
under the spot light. ``li`` loses more persons if all its steps use it; ``grey`` and ``rgb`` end 0.3 to 0.8 % worse
with it under another light."""

SCORING_RISE = 1.25
"""Largest ratio of the cost after these steps to the cost before them."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of one level.

    Attributes
    ----------
    work : Work
        Residual, weights and derivatives at the last state, or one short step before it.
    costs : (i + 1,) float64
        Mean squared residual at the start and after every accepted step.
    path : (i + 1, n_p) float64
        Parameters p there.
    angles : (i + 1, 2) float64
        theta_1 and theta_2 there.
    n_iterations : int
        Number of steps, refused ones included.
    converged : bool
        The loop converged: the last step was too small to matter.
    held : bool
        An angle, or the common turn of both, was unobservable at the end and kept fixed.
    flat : bool
        The image has no texture under the model.
    given : optional
        The form of ``work`` that the kernel takes, if other fits may use its arrays (:meth:`Objective.release`). None
        after further steps with the expected gradient, which have arrays of their own.
    """

    work: Work
    costs: np.ndarray
    path: np.ndarray
    angles: np.ndarray
    n_iterations: int
    converged: bool
    held: bool
    flat: bool
    given: Any = None

    @property
    def state(self) -> State:
        """The last state."""
        return State(self.work.p, self.work.angles, self.work.lam)

    @property
    def scale(self) -> float:
        """Scale of the shape prior's variances, estimated for this image."""
        return float(self.work.scales[SCALE])


def scored(method: Method, options: SolverOptions) -> Method:
    """Return a method with the kind of steps that the options ask for."""
    return replace(method, step="scored") if options.scoring and method.step == "own" else method


def solve(
    objective: Objective, problem: FitProblem, start: State, options: SolverOptions, evaluate_last: bool = True
) -> Solution:
    """Minimise an objective over one image.

    A fit that fails is returned, not raised. Takes at most ``max_iterations`` plus ``scoring`` steps.

    Parameters
    ----------
    objective : Objective
    problem : FitProblem
    start : State
    options : SolverOptions
    evaluate_last : bool
        Evaluate the residual once more after a last step that is too short to matter.
    """
    method = objective.method
    expected = method.step == "expected"
    # Steps with the image's own gradient converge slowly: if no others follow, they need the full tolerance.
    most = min(_scoring_steps(method, options), options.max_iterations)
    early = expected or not evaluate_last or most > 0
    controls = options.controls(expected, method.reweighs, evaluate_last, problem.blur if early else 0.0)
    solution = _run(objective, problem, *objective.borrow(start, controls.max_iterations), controls)
    if not most or solution.flat:
        return solution
    # With fixed weights, unless ``scoring`` was set.
    reweighs = method.reweighs and options.scoring is not None
    controls = options.controls(True, reweighs, evaluate_last, max_iterations=most)._replace(damping=0.0)
    kept = {name: getattr(solution.work, name).copy() for name in _KEPT}
    work = solution.work._replace(**kept, **objective.trace(most))
    ended = _run(objective, problem, work, None, controls)
    if not ended.costs[-1] <= SCORING_RISE * solution.costs[-1]:
        # The steps raised the cost: restore the solution before them, whose residual was overwritten.
        controls = options.controls(False, False, True, max_iterations=0)
        objective.solve(problem, solution.work._replace(**objective.trace(0)), controls)
        return solution
    return replace(
        ended,
        costs=np.concatenate([solution.costs, ended.costs[1:]]),
        path=np.concatenate([solution.path, ended.path[1:]]),
        angles=np.concatenate([solution.angles, ended.angles[1:]]),
        n_iterations=solution.n_iterations + ended.n_iterations,
        converged=solution.converged,
        flat=False,
        given=None,
    )


def _scoring_steps(method: Method, options: SolverOptions) -> int:
    """Return the maximum number of steps with the expected gradient at the end of a level."""
    if method.step != "scored":
        return 0
    return SCORING_STEPS if options.scoring is None else options.scoring


_KEPT = (
    "p",
    "angles",
    "lam",
    "weighed",
    "own",
    "scales",
    "gram",
    "noise",
    "by_model",
    "known",
    "unexplained",
    "last_step",
)
"""Fields of :class:`Work` that the loop continues from; it overwrites the others."""


def _run(objective: Objective, problem: FitProblem, work: Work, given: Any, controls: Controls) -> Solution:
    """Run the loop and collect its solution."""
    objective.solve(problem, work, controls, given)
    n_taken, n_tried, converged, held, flat = map(int, work.outcome)
    seen = work.costs[: n_taken + 1], work.path[: n_taken + 1], work.turns[: n_taken + 1]
    return Solution(work, *seen, n_tried, bool(converged), bool(held), bool(flat), given)


def solve_at(objective: Objective, problem: FitProblem, state: State, options: SolverOptions) -> Solution:
    """Solve for lambda at fixed p and angles, under updated weights, and evaluate the residual there."""
    controls = options.controls(False, objective.method.reweighs, True, max_iterations=0)
    return _run(objective, problem, objective.work(state), None, controls)
