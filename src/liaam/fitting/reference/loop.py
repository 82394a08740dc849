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

from liaam.fitting.methods import GRADIENT_ROWS
from liaam.fitting.reference.problem import BY_ROWS, Problem, contrast
from liaam.fitting.thresholds import THRESHOLDS

T = THRESHOLDS

# Attributes of a loop that later steps depend on. A run that is undone must not change them.
CARRIED = ("prior_scale", "least_curvature", "point_variance", "last_step")


class Controls(NamedTuple):
    """Options of one run of the loop; see ``src/core/level.hpp``."""

    options: Any  # SolverOptions
    max_iterations: int
    early_tolerance: float  # of the first steps, model pixels
    early_steps: float  # number of these
    damping: float  # at first; 0 accepts every step
    expected: bool  # steps with the expected gradient; else with the image's own
    reweigh: bool  # update the weights between steps
    evaluate_last: bool  # evaluate the residual once more after a last step that is too short to matter


@dataclass
class Trace:
    """The start and every accepted state, and how the loop ended."""

    costs: list[float] = field(default_factory=list)
    path: list[np.ndarray] = field(default_factory=list)
    angle_history: list[np.ndarray] = field(default_factory=list)
    n_iterations: int = 0
    converged: bool = False
    angle_fixed: bool = False  # an angle was not observable
    no_texture: bool = False  # there is none under the model


@dataclass
class LoopVariables:
    """What a run of the loop carries from one iteration to the next."""

    damping: float
    rounds: int  # updates of the weights before the next step
    lowest: float = np.inf  # penalised cost under the current weights
    tried: bool = False  # a step was taken and is not judged yet
    small: bool = False  # it was too short to matter
    fresh: bool = True  # the weights are new, so that the expected curvature is out of date


@dataclass(frozen=True)
class Proposal:
    """What can be said of the next step, which is not computed at the last state."""

    has_step: bool  # there is texture under the model, and the equations have a solution
    negligible: bool = False  # the step is short compared with its standard deviation


class Loop:
    """The loop of a level over a problem.

    Attributes
    ----------
    prior_scale, least_curvature : float
        Scale of the shape prior, and lower bound on the curvature of steps with the expected gradient, relative to the
        expected curvature. Both change from step to step.
    point_variance : float
        Variance of a residual of weight 1, for the prior of another landmarker's points.
    precision : (n_p,) float64
        Diagonal of the shape prior in the units of the normal equations.
    free : (n_q,) bool
        Which entries of q = (p, free angles) may move.
    damping_matrix : (n_q, n_q) float64
        The expected curvature with the priors, relative to which steps are damped.
    step, last_step : (n_q,) float64
        The proposed step of q, and the last accepted one.
    before : tuple of arrays
        p, angles and lambda before the proposed step.
    """

    free: np.ndarray
    damping_matrix: np.ndarray
    step: np.ndarray
    before: tuple[np.ndarray, np.ndarray, np.ndarray]

    def __init__(self, problem: Problem, objective: Any) -> None:
        self.problem = problem
        self.fields = objective.fields
        self.prior_scale = 1.0
        self.least_curvature = T["LEAST_CURVATURE"]
        self.point_variance = 0.0
        self.precision = np.zeros(len(self.fields["prior"]))
        self.last_step = np.zeros(objective.n_q)

    def run(self, controls: Controls) -> Trace:
        """Minimise the cost from the problem's state. Always terminates."""
        problem = self.problem
        is_joint = controls.options.elimination == "joint"
        solves = True  # whether lambda is solved for at the state; in the joint form only at the first one
        trace = Trace()
        current = LoopVariables(damping=controls.damping, rounds=self.first_rounds() if controls.reweigh else 0)
        while True:
            problem.evaluate(solves)  # residual of eq 10, with the best lambda if it is solved for at every state
            if current.tried and not self.accept(controls, current, trace):
                continue
            self.reweigh(solves, current)
            self.record(trace, is_new=current.tried or not trace.costs)
            is_over = trace.n_iterations >= controls.max_iterations or not np.isfinite(trace.costs[-1])
            ends = trace.converged or is_over
            if ends and not controls.evaluate_last:
                break
            self.linearise(controls, current.fresh, ends)
            trace.angle_fixed = not self.free.all()
            proposal = self.propose(controls, current.damping, ends)
            trace.no_texture = not proposal.has_step
            if ends or trace.no_texture:
                break
            length = self.movement()
            current.lowest = min(current.lowest, self.penalised_cost())
            current.small = proposal.negligible or is_short(length, trace.n_iterations, controls)
            current.fresh = False
            current.tried = True
            trace.n_iterations += 1
            self.take_step(is_joint)
            solves = not is_joint
            if current.small and not controls.evaluate_last and current.damping <= T["TRUSTED_DAMPING"]:
                trace.converged = True
                self.record(trace, is_new=True)
                break
            current.rounds = self.next_rounds(controls, current.small, length)
        return trace

    @property
    def averages(self) -> bool:
        """Whether weights depend only on means over many pixels, so that one update suffices."""
        return self.fields["weighting"] == BY_ROWS and not self.fields["loss"]

    def first_rounds(self) -> int:
        """Return the number of updates of the weights at the start.

        There are two at least if each pixel's weight depends on its own residual, and so on the weights before.
        """
        if self.averages:
            return 1
        return max(int(T["ROUNDS"]), 2) if self.fields["loss"] else 2

    def next_rounds(self, controls: Controls, small: bool, length: float) -> int:
        """Return the number of updates of the weights after a step of a length."""
        changes_nothing = small or (self.averages and length < T["STILL"])
        if not controls.reweigh or changes_nothing:
            return 0
        return int(T["ROUNDS"]) if self.fields["loss"] else 1

    def accept(self, controls: Controls, current: LoopVariables, trace: Trace) -> bool:
        """Judge the last step by its cost; return False, at the state before, if it is refused."""
        cost = self.penalised_cost()
        rise = T["EXPECTED_RISE"] if controls.expected else T["RISE"]
        if controls.damping > 0.0 and not cost <= rise * current.lowest:  # NaN is refused, too
            self.problem.set_state(*self.before)
            trace.converged = current.small or current.damping >= T["DAMPING_LIMIT"]
            current.damping = raised(current.damping, controls)
            current.tried = False
            current.rounds = 0
            return False
        current.damping = eased(current.damping, controls)
        current.lowest = min(current.lowest, cost)
        self.last_step = self.step
        trace.converged = current.small and current.damping <= T["TRUSTED_DAMPING"]  # else it is small by damping
        return True

    def reweigh(self, solves: bool, current: LoopVariables) -> None:
        """Update the weights, as often as is due or until they no longer change."""
        for _ in range(current.rounds):
            if not self.problem.reweigh(solves):
                break
            current.lowest = np.inf  # new weights invalidate the lowest cost and the expected curvature
            current.fresh = True

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

    def linearise(self, controls: Controls, fresh: bool, ends: bool) -> None:
        """Compute the normal equations at the state, the expected Hessian, and which entries of q may move.

        The equations have the expected gradient in E if the steps use it, unless this is the end: then the Hessian of
        the image's own gradient is what covariances need. The expected Hessian is computed anew after new weights
        (``fresh``); without the expected gradient it is that of the image's own.
        """
        problem = self.problem
        if controls.expected and not ends:
            if fresh:
                problem.differentiate(image_in_j=False, image_in_e=False)
                problem.expected_hessian = problem.hessian.copy()
            problem.differentiate(image_in_j=True, image_in_e=False)
        else:
            problem.differentiate(image_in_j=True, image_in_e=True)
            problem.expected_hessian = problem.hessian.copy()
        self.free = observable_parameters(problem, self.fields["directions"], controls.options.observable)

    def propose(self, controls: Controls, damping: float, ends: bool) -> Proposal:
        """Compute the next step of q = (p, free angles) from the normal equations with the priors; none at the end."""
        has_texture = self.has_texture()
        if not has_texture or ends:
            return Proposal(has_step=has_texture)
        problem = self.problem
        # The variance of a residual of weight 1: of the weights if they have one, else of the residuals.
        has_variance = self.fields["weighting"] == BY_ROWS and np.isfinite(problem.noise_variance)
        if has_variance:
            variance = problem.noise_variance
        else:
            variance = self.fields["correlated"] * problem.squares / problem.weight
        self.add_priors(controls.options.shape_prior, variance)
        if controls.expected:
            has_step, self.step = clamped_newton_step(
                base=self.damping_matrix,
                hessian=problem.hessian,
                gradient=problem.gradient,
                free=self.free,
                damping=damping,
                least=self.least_curvature,
            )
            if goes_back(self.step, self.last_step, self.damping_matrix):
                self.least_curvature *= 2.0
        else:
            has_step, self.step = damped_step(problem.hessian, problem.gradient, self.free, damping)
        return Proposal(has_step, negligible=bool(has_variance) and self.is_negligible(controls, damping, variance))

    def is_negligible(self, controls: Controls, damping: float, variance: float) -> bool:
        """Return whether the step is short compared with its own standard deviation."""
        squared_length = float(self.step @ self.damping_matrix @ self.step)
        limit = controls.options.relative_tolerance**2 * len(self.step) * variance
        is_in_noise = squared_length < limit and damping <= T["MOST_NEGLIGIBLE_DAMPING"]
        return bool(is_in_noise and self.movement() < T["LONGEST_UNSEEN"])

    def has_texture(self) -> bool:
        """Return whether image and model both have texture, and all sums are finite."""
        problem = self.problem
        n_p = len(problem.p)
        of_image = problem.hessian
        of_model = problem.expected_hessian
        if not (np.isfinite(of_image).all() and np.isfinite(of_model).all() and np.isfinite(problem.squares)):
            return False
        image_curvature = np.abs(of_image.diagonal()[:n_p]).max(initial=0.0)
        model_curvature = of_model.diagonal()[:n_p].max(initial=0.0)
        return problem.weight > 0 and image_curvature > T["TEXTURE"] * problem.weight and model_curvature > 0

    def add_priors(self, strength: float, variance: float) -> None:
        """Add the priors on p to the normal equations, where a residual of weight 1 has the given variance."""
        problem = self.problem
        image = self.problem.image
        n_p = len(problem.p)
        self.point_variance = variance
        self.damping_matrix = problem.expected_hessian.copy()
        if len(image.points):
            point_precision = variance * image.point_precision
            self.damping_matrix[:n_p, :n_p] += point_precision
            problem.hessian[:n_p, :n_p] += point_precision
            problem.gradient[:n_p] += point_precision @ (problem.p - image.points)
        if strength > 0.0 and np.isfinite(self.fields["dof"]):
            self.prior_scale = next_prior_scale(
                hessian=self.damping_matrix,
                p=problem.p,
                prior=self.fields["prior"],
                dof=self.fields["dof"],
                scale=self.prior_scale,
                strength=strength,
                variance=variance,
            )
        self.precision = strength * (variance / self.prior_scale) * self.fields["prior"]
        diagonal = np.arange(n_p)
        self.damping_matrix[diagonal, diagonal] += self.precision
        problem.hessian[diagonal, diagonal] += self.precision
        problem.gradient[:n_p] += self.precision * problem.p

    def penalised_cost(self) -> float:
        """Return the cost that an accepted step must not raise: mean squared residual plus the priors."""
        problem = self.problem
        image = self.problem.image
        squares = problem.squares + float(self.precision @ np.square(problem.p))
        if len(image.points):
            off = problem.p - image.points
            squares += self.point_variance * float(off @ image.point_precision @ off)
        squares += float(self.fields["ridge"] @ np.square(problem.lam))
        return squares / problem.weight if problem.weight > 0.0 else np.inf

    def movement(self) -> float:
        """Root mean square movement of the landmarks by the step, model pixels."""
        return self.problem.warp.movement(self.step[: len(self.problem.p)])

    def take_step(self, joint: bool) -> None:
        """Take the step (forward-additive), and keep the state before it; jointly with lambda's part (section 4)."""
        problem = self.problem
        n_p = len(problem.p)
        self.before = problem.p.copy(), problem.angles.copy(), problem.lam.copy()
        lam = problem.lam
        if joint:
            lam = lam + problem.solve_modes(problem.ar + problem.aj @ self.step)
        angles = problem.angles + self.fields["directions"] @ self.step[n_p:]
        problem.set_state(problem.p + self.step[:n_p], angles, lam)


def is_short(length: float, n_iterations: int, controls: Controls) -> bool:
    """Return whether a step, the landmarks' movement in model pixels, is too short to matter."""
    is_early = n_iterations < controls.early_steps
    return length < controls.options.tolerance or (is_early and length < controls.early_tolerance)


def raised(damping: float, controls: Controls) -> float:
    """Return the damping after a refused step."""
    first = T["FIRST_EXPECTED_DAMPING"] if controls.expected else T["FIRST_DAMPING"]
    return max(10.0 * damping, first)


def eased(damping: float, controls: Controls) -> float:
    """Return the damping after an accepted step; 0 if undamped steps were asked for."""
    if controls.expected:
        return 0.1 * damping if damping > T["TRUSTED_DAMPING"] else 0.0
    if controls.damping > 0.0:
        return max(0.1 * damping, T["LEAST_DAMPING"])
    return 0.0


def observable_parameters(problem: Any, directions: np.ndarray, observable: float) -> np.ndarray:
    """Return which entries of q may move: p, and the angles that the image determines, (n_q,) bool.

    Without a change of light, a common turn of both angles changes only noise: |dr/dtheta|^2 is then
    |r|^2 |L'|^2 / |L|^2. The common turn is held if its curvature is less than ``observable`` times that. If both
    angles are free, theta_1 is then kept and theta_2 alone moves.
    """
    hessian = problem.hessian
    n_free = directions.shape[1]
    free = np.ones(len(hessian), bool)
    if not n_free:
        return free
    slope_of_metric = float(np.square(problem.metric_slope).sum() / np.square(problem.metric).sum())
    noise = problem.squares * slope_of_metric + T["LEAST_ANGLE_NOISE"] * problem.weight
    observable_apart = min(T["OBSERVABLE_APART"], observable)  # 0 keeps all free, as in the paper
    first = len(hessian) - n_free
    if n_free == 1:
        turns_both = bool(directions[0, 0])
        free[first] = hessian[first, first] > (observable if turns_both else observable_apart) * noise
        return free
    theta_1 = hessian[first, first]
    cross = hessian[first, first + 1]
    theta_2 = hessian[first + 1, first + 1]
    free[first + 1] = theta_2 > observable_apart * noise
    # In coordinates (common turn, theta_2 alone), with the second eliminated from the first.
    eliminated = (cross + theta_2) ** 2 / theta_2 if free[first + 1] else 0.0
    together = theta_1 + 2.0 * cross + theta_2 - eliminated
    free[first] = free[first + 1] and together > observable * noise
    return free


def damped_step(hessian: np.ndarray, gradient: np.ndarray, free, damping: float) -> tuple[bool, np.ndarray]:
    """Compute the Levenberg step, (H + damping diag H) step = -gradient, over the free entries.

    Return whether there is one, and the step, 0 where an entry is not free.
    """
    free = np.asarray(free)
    step = np.zeros(len(gradient))
    largest = hessian.diagonal()[free].max(initial=0.0)
    if not largest > 0.0:
        return False, step
    damped = hessian[np.ix_(free, free)].copy()
    floor = T["DAMPING_FLOOR"] * largest
    damped[np.diag_indices_from(damped)] += damping * np.maximum(damped.diagonal(), floor) + floor
    try:
        factor = np.linalg.cholesky(damped)
    except np.linalg.LinAlgError:
        return False, step
    step[free] = np.linalg.solve(factor.T, np.linalg.solve(factor, -gradient[free]))
    return bool(np.isfinite(factor).all()), step


def clamped_newton_step(
    base: np.ndarray, hessian: np.ndarray, gradient: np.ndarray, free, damping: float, least: float
) -> tuple[bool, np.ndarray]:
    """Compute the Newton step of a symmetric matrix H whose curvature is raised to a fraction of that of B.

    Each generalised eigenvalue rho of H v = rho B v is replaced by max(rho, least) + damping. B is ``base``. Return
    whether there is a step, and the step, 0 where an entry is not free.
    """
    free = np.asarray(free)
    step = np.zeros(len(gradient))
    largest = base.diagonal()[free].max(initial=0.0)
    if not largest > 0.0:
        return False, step
    entries = np.ix_(free, free)
    ridge = T["ROUNDING"] * largest * np.eye(int(free.sum()))
    try:
        factor = np.linalg.cholesky(base[entries] + ridge)
        whitened = np.linalg.solve(factor, np.linalg.solve(factor, hessian[entries]).T)
        values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    except np.linalg.LinAlgError:
        return False, step
    descent = vectors.T @ np.linalg.solve(factor, -gradient[free])
    curvatures = np.maximum(values, least) + damping
    step[free] = np.linalg.solve(factor.T, vectors @ (descent / curvatures))
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
    n = len(p)
    prior_precision = strength * prior / scale
    precision = hessian[:n, :n] / variance + np.diag(prior_precision)  # the angles are left out
    least = T["LEAST_PRECISION"] * precision.diagonal().max(initial=0.0) + 1e-300
    precision[np.arange(n), np.arange(n)] += least
    try:
        inverse_factor = np.linalg.inv(np.linalg.cholesky(precision))
    except np.linalg.LinAlgError:
        return scale
    variances = np.square(inverse_factor).sum(axis=0)
    gamma = float((1.0 - prior_precision * variances)[prior > 0].sum())
    new = (dof + strength * float(prior @ np.square(p))) / (dof + gamma)
    return new if new < np.inf else scale


def solve_level(
    objective: Any, image: Any, p: np.ndarray, angles, lam: np.ndarray, options: Any, blur: float, evaluate_last: bool
) -> SimpleNamespace:
    """Minimise an objective over one encoded image, from a start; see ``src/core/level.cpp``."""
    method = objective.method
    problem = Problem(objective, image)
    problem.begin(p, angles, lam)
    loop = Loop(problem, objective)
    n_scoring = scoring_steps(options, method)
    fraction, early_steps = early_of(options, method, is_finest=evaluate_last, is_scored=n_scoring > 0)
    controls = Controls(
        options=options,
        max_iterations=options.max_iterations,
        early_tolerance=blur * fraction,
        early_steps=early_steps,
        damping=options.damping,
        expected=method.step == "expected",
        reweigh=method.reweighs,
        evaluate_last=evaluate_last,
    )
    trace = loop.run(controls)
    if n_scoring and not trace.no_texture:
        scoring = controls._replace(
            max_iterations=n_scoring,
            early_tolerance=0.0,
            early_steps=0,
            damping=0.0,
            expected=True,
            # The weights are fixed, unless the number of steps was asked for.
            reweigh=method.reweighs and options.scoring is not None,
        )
        score(loop, trace, scoring)
    return collect(loop, trace)


def scoring_steps(options: Any, method: Any) -> int:
    """Return the most steps with the expected gradient at the end of a level, after those with the image's own."""
    if method.step != "scored":
        return 0
    most = int(T["SCORING_STEPS"]) if options.scoring is None else options.scoring
    return min(most, options.max_iterations)


def early_of(options: Any, method: Any, is_finest: bool, is_scored: bool) -> tuple[float, float]:
    """Return the tolerance of the first steps of a level, as a fraction of the blur, and their number."""
    if method.step == "expected":
        fraction = T["EARLY_EXPECTED"]
        steps = T["EARLY_EXPECTED_STEPS"]
    elif is_finest and is_scored and not method.reweighs:
        # Weights that the steps update are those of the solution only at the end.
        fraction = T["EARLY_SCORED"]
        steps = options.max_iterations
    elif not is_finest or is_scored:
        fraction = T["EARLY_OWN"]
        steps = T["EARLY_OWN_STEPS"]
    else:  # these steps are the last: they converge slowly, and need the full tolerance
        return 0.0, 0
    return fraction if options.early_tolerance is None else options.early_tolerance, steps


def score(loop: Loop, trace: Trace, controls: Controls) -> None:
    """Take steps with the expected gradient from the solution of a level; none if they raise the cost."""
    problem = loop.problem
    problem_before = dict(vars(problem))
    loop_before = {name: getattr(loop, name) for name in CARRIED}
    state = problem.p.copy(), problem.angles.copy(), problem.lam.copy()  # lambda changes in place
    more = loop.run(controls)
    if more.costs[-1] <= T["SCORING_RISE"] * trace.costs[-1]:
        append(more, trace)
        return
    # Undo the run: with no more steps, the loop only computes again what the solution consists of.
    vars(problem).update(problem_before)
    vars(loop).update(loop_before)
    problem.set_state(*state)
    loop.run(controls._replace(max_iterations=0, expected=False, reweigh=False, evaluate_last=True))


def append(more: Trace, trace: Trace) -> None:
    """Append a run that began at the last state of another to that."""
    trace.costs += more.costs[1:]
    trace.path += more.path[1:]
    trace.angle_history += more.angle_history[1:]
    trace.n_iterations += more.n_iterations
    trace.angle_fixed = more.angle_fixed


def collect(loop: Loop, trace: Trace) -> SimpleNamespace:
    """Collect the solution, with the names of the core's ``Solution``."""
    problem = loop.problem
    # Rows that count as contrast: for weights by rows those of the gradients.
    n_rows = GRADIENT_ROWS if loop.fields["weighting"] == BY_ROWS else problem.k
    return SimpleNamespace(
        p=problem.p,
        angles=problem.angles,
        lam=problem.lam,
        noise_variance=problem.noise_variance,
        squares=problem.squares,
        weight=problem.weight,
        expected_hessian=problem.expected_hessian,
        usable=problem.usable,
        samples=problem.samples,
        residual=problem.residual,
        costs=np.array(trace.costs),
        path=np.array(trace.path),
        angle_history=np.array(trace.angle_history),
        n_iterations=trace.n_iterations,
        converged=trace.converged,
        angle_fixed=trace.angle_fixed,
        no_texture=trace.no_texture,
        prior_scale=loop.prior_scale,
        contrast=contrast(problem, problem.model_sqrt_weights, n_rows),
        weighted_contrast=contrast(problem, problem.masked, n_rows),
        n_counted=int(np.count_nonzero(problem.masked[:, :n_rows])),
    )
