"""The loop of a level in NumPy: weighted, damped Gauss-Newton steps of p and the free angles (paper section 4).

Two kinds of step share the loop. With the image's own gradient, J, a step is a damped Gauss-Newton step (Levenberg).
Noise in the gradient makes these steps short, and gives the cost spurious local minima. With the gradient that the
model expects, E, the estimate is as accurate as the noise allows (Fisher scoring). The derivative of E'r is E'J. Unlike
E'E it contains the image's actual gradient, and unlike J'J it has no noise bias, so steps converge fast. The step uses
its symmetric part, raised to a fraction of E'E in directions in which it is smaller.

The two eliminations differ in lambda only. Variable projection solves for it at every state, so it compares reduced
costs. The joint form (the paper's) updates it by its own part of the step.
"""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from liaam.fitting.reference import GRADIENT_ROWS, Problem, contrast
from liaam.fitting.thresholds import THRESHOLDS

T = THRESHOLDS


class Controls(NamedTuple):
    """Options of one run of the loop; see ``src/core/level.hpp``."""

    options: Any
    max_iterations: int
    early_tolerance: float
    early_steps: float
    damping: float
    expected: bool
    reweigh: bool
    evaluate_last: bool


@dataclass
class Trace:
    """The start and every accepted state, and how the loop ended."""

    costs: list[float] = field(default_factory=list)
    path: list[np.ndarray] = field(default_factory=list)
    angle_history: list[np.ndarray] = field(default_factory=list)
    n_iterations: int = 0
    converged: bool = False
    held: bool = False
    flat: bool = False


class Loop:
    """The loop of a level over a problem."""

    def __init__(self, problem: Problem, objective: Any) -> None:
        self.problem, self.objective, self.f = problem, objective, objective.fields
        self.prior_scale, self.least_curvature, self.point_variance = 1.0, T["LEAST_CURVATURE"], 0.0
        self.precision = np.zeros(len(self.f["prior"]))
        self.last_step = np.zeros(objective.n_q)

    def run(self, controls: Controls) -> Trace:
        """Minimise the cost from the problem's state. Always terminates."""
        problem, joint = self.problem, controls.options.elimination == "joint"
        averages = self.f["weighting"] == 2 and not self.f["loss"]
        again = int(T["ROUNDS"]) if self.f["loss"] else 1
        # Twice at first if each pixel's weight depends on its own residual, and so on the weights before.
        rounds = (1 if averages else max(again, 2)) if controls.reweigh else 0
        damping, least, trace = controls.damping, np.inf, Trace()
        solves, fresh, tried, small = True, True, False, False
        while True:
            problem.evaluate(solves)  # residual of eq 10, with the best lambda if it is solved for at every state
            if tried:
                cost = self.penalised_cost()
                if controls.damping > 0.0 and not cost <= T["EXPECTED_RISE" if controls.expected else "RISE"] * least:
                    problem.set_state(*self.before)
                    trace.converged = small or damping >= T["DAMPING_LIMIT"]
                    damping = max(10.0 * damping, T["FIRST_EXPECTED_DAMPING" if controls.expected else "FIRST_DAMPING"])
                    tried, rounds = False, 0
                    continue
                damping = eased(damping, controls)
                self.last_step, least = self.step, min(least, cost)
                trace.converged = small and damping <= T["TRUSTED_DAMPING"]
            for _ in range(rounds):
                if not problem.reweigh(solves):
                    break
                least, fresh = np.inf, True  # new weights invalidate the lowest cost and the expected curvature
            self.record(trace, tried or not trace.costs)
            ends = trace.converged or trace.n_iterations >= controls.max_iterations or not np.isfinite(trace.costs[-1])
            if ends and not controls.evaluate_last:
                break
            found, negligible = self.propose(controls, damping, fresh, ends, trace)
            trace.flat = not found
            if ends or trace.flat:
                break
            length, least = self.movement(), min(least, self.penalised_cost())
            solves, fresh, tried = not joint, False, True
            early = trace.n_iterations < controls.early_steps and length < controls.early_tolerance
            small = negligible or length < controls.options.tolerance or early
            trace.n_iterations += 1
            self.take_step(joint)
            if small and not controls.evaluate_last and damping <= T["TRUSTED_DAMPING"]:  # skip the last evaluation
                trace.converged = True
                self.record(trace, True)
                break
            rounds = again if controls.reweigh and not small and not (averages and length < T["STILL"]) else 0
        return trace

    def record(self, trace: Trace, is_new: bool) -> None:
        """Record the state, or its cost anew."""
        problem = self.problem
        cost = problem.squares / problem.weight if problem.weight > 0.0 else np.inf
        if not is_new:
            trace.costs[-1] = cost
            return
        trace.costs.append(cost)
        trace.path.append(problem.p.copy())
        trace.angle_history.append(problem.angles.copy())

    def propose(self, controls: Controls, damping: float, fresh: bool, ends: bool, trace: Trace) -> tuple[bool, bool]:
        """Compute the step; at the end, only the Hessian. Return whether there is one, and whether it is short."""
        problem, expects = self.problem, controls.expected and not ends
        if expects:
            if fresh:
                problem.differentiate(False, False)
                problem.expected_hessian = problem.hessian.copy()
            problem.differentiate(True, False)
        else:
            problem.differentiate(True, True)
            problem.expected_hessian = problem.hessian.copy()
        self.free = observable_parameters(problem, self.f["directions"], controls.options.observable)
        trace.held = not self.free.all()
        if not self.has_texture() or ends:
            return self.has_texture(), False
        known = self.f["weighting"] == 2 and np.isfinite(problem.noise_variance)
        variance = problem.noise_variance if known else self.f["correlated"] * problem.squares / problem.weight
        self.add_priors(controls.options.shape_prior, variance)
        system = problem.hessian, problem.gradient, self.free, damping
        if expects:
            found, self.step = clamped_newton_step(self.damping_matrix, *system, self.least_curvature)
            if goes_back(self.step, self.last_step, self.damping_matrix):
                self.least_curvature *= 2.0
        else:
            found, self.step = damped_step(*system)
        short = float(self.step @ self.damping_matrix @ self.step)
        short = short < controls.options.relative_tolerance**2 * len(self.step) * variance
        negligible = known and short and damping <= T["MOST_NEGLIGIBLE_DAMPING"]
        return found, bool(negligible and self.movement() < T["LONGEST_UNSEEN"])

    def has_texture(self) -> bool:
        """Return whether image and model both have texture, and all sums are finite."""
        problem, n_p = self.problem, len(self.problem.p)
        own, base = problem.hessian, problem.expected_hessian
        if not (np.isfinite(own).all() and np.isfinite(base).all() and np.isfinite(problem.squares)):
            return False
        curved = np.abs(own.diagonal()[:n_p]).max(initial=0.0)
        expected = base.diagonal()[:n_p].max(initial=0.0)
        return problem.weight > 0 and curved > T["TEXTURE"] * problem.weight and expected > 0

    def add_priors(self, strength: float, variance: float) -> None:
        """Add the priors on p to the normal equations, where a residual of weight 1 has the given variance."""
        problem, n_p, image = self.problem, len(self.problem.p), self.problem.image
        self.point_variance = variance
        self.damping_matrix = problem.expected_hessian.copy()
        if len(image.points):
            precision = variance * image.point_precision
            self.damping_matrix[:n_p, :n_p] += precision
            problem.hessian[:n_p, :n_p] += precision
            problem.gradient[:n_p] += precision @ (problem.p - image.points)
        if strength > 0.0 and np.isfinite(self.f["dof"]):
            self.prior_scale = next_prior_scale(
                self.damping_matrix, problem.p, self.f["prior"], self.f["dof"], self.prior_scale, strength, variance
            )
        self.precision = strength * (variance / self.prior_scale) * self.f["prior"]
        for matrix in (self.damping_matrix, problem.hessian):
            matrix[np.arange(n_p), np.arange(n_p)] += self.precision
        problem.gradient[:n_p] += self.precision * problem.p

    def penalised_cost(self) -> float:
        """Return the cost that an accepted step must not raise: mean squared residual plus the priors."""
        problem, image = self.problem, self.problem.image
        squares = problem.squares + float(self.precision @ np.square(problem.p))
        if len(image.points):
            off = problem.p - image.points
            squares += self.point_variance * float(off @ image.point_precision @ off)
        squares += float(self.f["ridge"] @ np.square(problem.lam))
        return squares / problem.weight if problem.weight > 0.0 else np.inf

    def movement(self) -> float:
        """Root mean square movement of the landmarks by the step, model pixels."""
        return self.problem.warp.movement(self.step[: len(self.problem.p)])

    def take_step(self, joint: bool) -> None:
        """Take the step (forward-additive), and keep the state before it; jointly with lambda's part (section 4)."""
        problem, n_p = self.problem, len(self.problem.p)
        self.before = problem.p.copy(), problem.angles.copy(), problem.lam.copy()
        lam = problem.lam + problem.solve_modes(problem.ar + problem.aj @ self.step) if joint else problem.lam
        angles = problem.angles + self.f["directions"] @ self.step[n_p:]
        problem.set_state(problem.p + self.step[:n_p], angles, lam)


def eased(damping: float, controls: Controls) -> float:
    """Return the damping after an accepted step; 0 if undamped steps were asked for."""
    if controls.expected:
        return 0.1 * damping if damping > T["TRUSTED_DAMPING"] else 0.0
    return max(0.1 * damping, T["LEAST_DAMPING"]) if controls.damping > 0.0 else 0.0


def observable_parameters(problem: Any, directions: np.ndarray, observable: float) -> np.ndarray:
    """Return which entries of q may move: p, and the angles that the image determines, (n_q,) bool.

    Without a change of light, a common turn of both angles changes only noise: |dr/dtheta|^2 is then
    |r|^2 |L'|^2 / |L|^2. The common turn is held if its curvature is less than ``observable`` times that. If both
    angles are free, theta_1 is then kept and theta_2 alone moves.
    """
    n_free = directions.shape[1]
    hessian, n_p = problem.hessian, len(problem.hessian) - n_free
    free = np.ones(len(hessian), bool)
    if not n_free:
        return free
    by_angle = float(np.square(problem.metric_slope).sum() / np.square(problem.metric).sum())
    noise = problem.squares * by_angle + T["LEAST_ANGLE_NOISE"] * problem.weight
    limit, own = min(T["OBSERVABLE_APART"], observable), hessian[n_p, n_p]  # 0 keeps all free, as in the paper
    if n_free == 1:
        free[n_p] = own > (observable if directions[0, 0] else limit) * noise
        return free
    # In coordinates (common turn, theta_2 alone), with the second eliminated from the first.
    cross, apart = hessian[n_p, n_p + 1], hessian[n_p + 1, n_p + 1]
    free[n_p + 1] = apart > limit * noise
    together = own + 2.0 * cross + apart - ((cross + apart) ** 2 / apart if free[n_p + 1] else 0.0)
    free[n_p] = free[n_p + 1] and together > observable * noise
    return free


def damped_step(hessian: np.ndarray, gradient: np.ndarray, free, damping: float) -> tuple[bool, np.ndarray]:
    """Compute the Levenberg step, (H + damping diag H) step = -gradient, over the free entries; 0 if there is none."""
    free, step = np.asarray(free), np.zeros(len(gradient))
    most = hessian.diagonal()[free].max(initial=0.0)
    if not most > 0.0:
        return False, step
    own = hessian[np.ix_(free, free)].copy()
    floor = T["DAMPING_FLOOR"] * most
    own[np.diag_indices_from(own)] += damping * np.maximum(own.diagonal(), floor) + floor
    try:
        factor = np.linalg.cholesky(own)
    except np.linalg.LinAlgError:
        return False, step
    step[free] = np.linalg.solve(factor.T, np.linalg.solve(factor, -gradient[free]))
    return bool(np.isfinite(factor).all()), step


def clamped_newton_step(
    base: np.ndarray, hessian: np.ndarray, gradient: np.ndarray, free, damping: float, least: float
) -> tuple[bool, np.ndarray]:
    """Compute the Newton step of a symmetric matrix H whose curvature is raised to a fraction of that of B.

    Each generalised eigenvalue rho of H v = rho B v is replaced by max(rho, least) + damping.
    """
    free, step = np.asarray(free), np.zeros(len(gradient))
    largest = base.diagonal()[free].max(initial=0.0)
    if not largest > 0.0:
        return False, step
    own = np.ix_(free, free)
    try:
        factor = np.linalg.cholesky(base[own] + T["ROUNDING"] * largest * np.eye(int(free.sum())))
        whitened = np.linalg.solve(factor, np.linalg.solve(factor, hessian[own]).T)
        values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    except np.linalg.LinAlgError:
        return False, step
    along = vectors.T @ np.linalg.solve(factor, -gradient[free])
    step[free] = np.linalg.solve(factor.T, vectors @ (along / (np.maximum(values, least) + damping)))
    return bool(np.isfinite(step).all()), step


def goes_back(step: np.ndarray, last: np.ndarray, metric: np.ndarray) -> bool:
    """Return whether a step undoes much of the last one: it oscillates about a kink of the bilinear interpolant."""
    return float(step @ metric @ last) < -T["TO_AND_FRO"] * float(last @ metric @ last)


def next_prior_scale(
    hessian: np.ndarray, p: np.ndarray, prior: np.ndarray, dof: float, scale: float, strength: float, variance: float
) -> float:
    """Update the scale of the shape prior by one step of the evidence's fixed point (MacKay, Neural Comput. 4, 1992).

    The prior is a Student distribution: p ~ N(0, scale Lambda), where the scale is drawn for each shape with ``dof``
    degrees of freedom. Estimating the scale keeps a shape near the mean close to it, and leaves a distant one free to
    move. The image determines p by ``hessian``, in which a residual of weight 1 has the given variance. The result is
    (dof + p' Lambda^-1 p) / (dof + gamma), with gamma the number of parameters that the image determines; the last
    scale if this is not finite.
    """
    if not 0.0 < variance < np.inf:
        return scale
    n, precision = len(p), strength * prior / scale
    matrix = hessian[:n, :n] / variance + np.diag(precision)  # the angles are left out
    matrix[np.arange(n), np.arange(n)] += T["LEAST_PRECISION"] * matrix.diagonal().max(initial=0.0) + 1e-300
    try:
        half = np.linalg.inv(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        return scale
    variances = np.square(half).sum(axis=0)
    gamma = float((1.0 - precision * variances)[prior > 0].sum())
    new = (dof + strength * float(prior @ np.square(p))) / (dof + gamma)
    return new if new < np.inf else scale


def solve_level(
    objective: Any, image: Any, p: np.ndarray, angles, lam: np.ndarray, options: Any, blur: float, evaluate_last: bool
) -> SimpleNamespace:
    """Minimise an objective over one encoded image, from a start; see ``src/core/level.cpp``."""
    step = objective.method.step
    problem, expected = Problem(objective, image), step == "expected"
    problem.begin(p, angles, lam)
    loop = Loop(problem, objective)
    scoring = int(T["SCORING_STEPS"]) if options.scoring is None else options.scoring
    more = min(scoring, options.max_iterations) if step == "scored" else 0
    fraction, steps = early_of(options, objective.method, evaluate_last, more > 0)
    early, reweighs = (blur * fraction, steps), objective.method.reweighs
    controls = Controls(options, options.max_iterations, *early, options.damping, expected, reweighs, evaluate_last)
    trace = loop.run(controls)
    if more and not trace.flat:
        # With fixed weights, unless ``scoring`` was set.
        reweighs = reweighs and options.scoring is not None
        score(loop, trace, Controls(options, more, 0.0, 0, 0.0, True, reweighs, evaluate_last))
    return collect(loop, trace)


def early_of(options: Any, method: Any, is_finest: bool, is_scored: bool) -> tuple[float, float]:
    """Return the tolerance of the first steps of a level, as a fraction of the blur, and their number."""
    if method.step == "expected":
        fraction, steps = T["EARLY_EXPECTED"], T["EARLY_EXPECTED_STEPS"]
    elif is_finest and is_scored and not method.reweighs:
        fraction, steps = T["EARLY_SCORED"], options.max_iterations
    elif not is_finest or is_scored:
        fraction, steps = T["EARLY_OWN"], T["EARLY_OWN_STEPS"]
    else:  # these steps are the last: they converge slowly, and need the full tolerance
        return 0.0, 0
    return fraction if options.early_tolerance is None else options.early_tolerance, steps


def score(loop: Loop, trace: Trace, controls: Controls) -> None:
    """Take steps with the expected gradient from the solution of a level; none if they raise the cost."""
    problem, kept = loop.problem, ("prior_scale", "least_curvature", "point_variance", "last_step")
    before, loops = {**vars(problem)}, {name: getattr(loop, name) for name in kept}
    state = problem.p.copy(), problem.angles.copy(), problem.lam.copy()
    more = loop.run(controls)
    if more.costs[-1] <= T["SCORING_RISE"] * trace.costs[-1]:
        for name in ("costs", "path", "angle_history"):
            getattr(trace, name).extend(getattr(more, name)[1:])
        trace.n_iterations, trace.held = trace.n_iterations + more.n_iterations, more.held
        return
    vars(problem).update(before)
    vars(loop).update(loops)
    problem.set_state(*state)
    loop.run(controls._replace(max_iterations=0, expected=False, reweigh=False, evaluate_last=True))


def collect(loop: Loop, trace: Trace) -> SimpleNamespace:
    """Collect the solution, with the names of the core's ``LevelFit``."""
    problem = loop.problem
    shown = GRADIENT_ROWS if loop.f["weighting"] == 2 else problem.k
    own = ("p", "angles", "lam", "noise_variance", "squares", "weight", "expected_hessian", "usable", "samples")
    return SimpleNamespace(
        **{name: getattr(problem, name) for name in (*own, "residual")},
        **{name: np.array(each) if isinstance(each, list) else each for name, each in vars(trace).items()},
        prior_scale=loop.prior_scale,
        contrast=contrast(problem, problem.own, shown),
        weighted_contrast=contrast(problem, problem.masked, shown),
        n_counted=int(np.count_nonzero(problem.masked[:, :shown])),
    )
