"""Options of the solver, and a level's solution: the loop itself is :mod:`liaam.fitting.loop`."""

from dataclasses import dataclass, fields, replace

import numpy as np

from liaam.errors import MethodError
from liaam.fitting.level import SCALE, Controls, Work
from liaam.fitting.methods import Method
from liaam.fitting.objective import Objective, State
from liaam.fitting.problem import FitProblem

ELIMINATIONS = ("varpro", "joint")
ANGLE_STARTS = ("best", "model")


HURRY = {"expected": (0.25, 3), "own": (0.1, 10)}
"""Share of a level's blur that is near enough in the first steps, and how many steps these are, by the kind of step.
Measured with ``soft-li`` on IMM: 7 steps instead of 9 on the spot protocol (4.11 % either way), on strangers 4.82 /
4.23 / 4.89 % instead of 4.84 / 4.21 / 4.88, and as many lost; twice the share in all steps loses twice as many
strangers."""


@dataclass(frozen=True)
class SolverOptions:
    """How to iterate.

    Attributes
    ----------
    max_iterations : int
        Steps to try at most.
    tolerance : float
        Stop when a step moves the landmarks by less than this root mean square, model pixels.
    hurry : float, optional
        Stop sooner in the first steps of a level: when one moves the landmarks by less than this share of the level's
        blur; 0 for never, and :data:`HURRY` by the method's steps if left out. Most fits are so near after two or three
        steps. Those that are not are the difficult ones, and go on until ``tolerance``.
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
    scoring : int, optional
        Steps with the gradient that the model expects to end the finest level with, at most, weights worked out anew.
        If left out, methods that compare logarithms end each level with up to :data:`SCORING_STEPS` of them, under the
        weights that they have come to, and others with none. ``soft-li`` takes no others.
    """

    max_iterations: int = 50
    tolerance: float = 0.01
    hurry: float | None = None
    notice: float = 0.03
    elimination: str = "varpro"
    damping: float = 1e-3
    shape_prior: float = 1.0
    observable: float = 25.0
    angle_start: str = "best"
    scoring: int | None = None

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
        hurry = 0.0 if self.hurry is None else self.hurry
        if not np.isfinite([hurry, self.tolerance, self.notice, self.damping, self.shape_prior, self.observable]).all():
            raise MethodError("tolerance, hurry, notice, damping, shape_prior and observable must be finite numbers")
        scoring = 0 if self.scoring is None else self.scoring
        least = min(self.max_iterations, hurry, self.tolerance, self.notice, self.damping, self.shape_prior, scoring)
        if least < 0:
            raise MethodError(
                "max_iterations, tolerance, hurry, notice, damping, shape_prior and scoring may not be negative"
            )

    def controls(
        self, expected: bool, reweigh: bool, look: bool, blur: float = 0.0, max_iterations: int | None = None
    ) -> Controls:
        """Give the options as the loop takes them; see :class:`liaam.fitting.level.Controls`."""
        hurry, first = HURRY["expected" if expected else "own"]
        return Controls(
            max_iterations=int(self.max_iterations if max_iterations is None else max_iterations),
            tolerance=float(self.tolerance),
            loose=float(blur * (hurry if self.hurry is None else self.hurry)),
            quick=first if blur > 0.0 else 0,
            notice=float(self.notice),
            damping=float(self.damping),
            shape_prior=float(self.shape_prior),
            observable=float(self.observable),
            joint=self.elimination == "joint",
            expected=expected,
            reweigh=reweigh,
            solve=True,
            look=look,
        )


SCORING_STEPS = 10
"""Steps with the expected gradient that methods that compare logarithms end each level with, at most. Measured with
``li`` on IMM: 4.48 instead of 4.62 % on the spot protocol, 19 instead of 48 % of strangers lost under the spot light,
and ends hang on the picture's last bit a fifth as often. From the start, as ``soft-li`` takes them, they lose
more strangers; and pictures that ``grey`` and ``rgb`` compare in another light end 0.3 to 0.8 % worse with them."""

EXPECTED_RISE = 1.25
"""By how much more than the cost before such steps may leave in all."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a level's loop stopped.

    Attributes
    ----------
    work : Work
        What is seen there: at the last state, or one short step before it.
    costs : (i + 1,) float64
        Mean squared residual at the start and after every accepted step.
    path : (i + 1, n_p) float64
        Parameters p there.
    angles : (i + 1, 2) float64
        theta_1 and theta_2 there.
    n_iterations : int
        Steps tried.
    moved : float
        Root mean square movement of the landmarks by the last accepted step, model pixels.
    settled : bool
        The last step was too small to matter.
    held : bool
        The angles, or one combination of them, could not be observed at the end.
    flat : bool
        There was nothing to descend on: no texture under the model.
    """

    work: Work
    costs: np.ndarray
    path: np.ndarray
    angles: np.ndarray
    n_iterations: int
    moved: float
    settled: bool
    held: bool
    flat: bool

    @property
    def state(self) -> State:
        """The last state."""
        return State(self.work.p, self.work.angles, self.work.lam)

    @property
    def scale(self) -> float:
        """Scale of the shape prior's variances, in this picture."""
        return float(self.work.scales[SCALE])


def scored(method: Method, options: SolverOptions) -> Method:
    """A method whose steps are those that options ask for."""
    return replace(method, step="scored") if options.scoring and method.step == "own" else method


def solve(
    objective: Objective, problem: FitProblem, start: State, options: SolverOptions, look: bool = True
) -> Solution:
    """Minimise an objective over one image from a start.

    Never raises for a fit that goes wrong and never loops beyond ``max_iterations``, and ``scoring`` more.

    Parameters
    ----------
    objective : Objective
    problem : FitProblem
    start : State
    options : SolverOptions
    look : bool
        Look at the picture once more where the last step was too short to be noticed.
    """
    method = objective.method
    expected = method.step == "expected"
    # Steps with the picture's own gradient creep: where no others follow they are to reach the minimum.
    most = min(_scoring_steps(method, options), options.max_iterations)
    hurries = expected or not look or most > 0
    controls = options.controls(expected, method.reweighs, look, problem.blur if hurries else 0.0)
    solution = _run(objective, problem, objective.work(start, controls.max_iterations), controls)
    if not most or solution.flat:
        return solution
    # Under the weights that they have come to, unless more is asked for than usual.
    reweighs = method.reweighs and options.scoring is not None
    controls = options.controls(True, reweighs, look, max_iterations=most)._replace(damping=0.0)
    work = solution.work._replace(
        **{name: getattr(solution.work, name).copy() for name in _KEPT}, **_trace(most, start)
    )
    ended = _run(objective, problem, work, controls)
    if not ended.costs[-1] <= EXPECTED_RISE * solution.costs[-1]:
        # What is seen was written over: look once more where the steps before had come to.
        controls = options.controls(False, False, True, max_iterations=0)
        objective.solve(problem, solution.work._replace(**_trace(0, start)), controls)
        return solution
    return replace(
        ended,
        costs=np.concatenate([solution.costs, ended.costs[1:]]),
        path=np.concatenate([solution.path, ended.path[1:]]),
        angles=np.concatenate([solution.angles, ended.angles[1:]]),
        n_iterations=solution.n_iterations + ended.n_iterations,
        settled=solution.settled,
        flat=False,
    )


def _scoring_steps(method: Method, options: SolverOptions) -> int:
    """How many steps with the expected gradient a level ends with at most."""
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
"""What the loop goes on from; all else it writes anew."""


def _trace(n: int, start: State) -> dict[str, np.ndarray]:
    """Room for costs, parameters and angles after n steps."""
    return {"costs": np.empty(n + 1), "path": np.empty((n + 1, len(start.p))), "turns": np.empty((n + 1, 2))}


def _run(objective: Objective, problem: FitProblem, work: Work, controls: Controls) -> Solution:
    """Call the loop."""
    outcome = objective.solve(problem, work, controls)
    n = outcome.n_taken + 1
    seen = work.costs[:n], work.path[:n], work.turns[:n]
    return Solution(work, *seen, outcome.n_tried, outcome.moved, outcome.settled, outcome.held, outcome.flat)


def settle_lambda(objective: Objective, problem: FitProblem, state: State, options: SolverOptions) -> Solution:
    """Give a state its best appearance, under the weights that go with it, and look there."""
    controls = options.controls(False, objective.method.reweighs, True, max_iterations=0)
    return _run(objective, problem, objective.work(state), controls)
