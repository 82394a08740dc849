"""The one solver for many pictures at once: the rules of :mod:`liaam.fitting.solver`, masked instead of branched.

Every fit has its own damping, its own steps accepted or refused, and its own end; fits that have ended are set aside
as soon as they are half of a batch. Nothing is ever summed over fits, so none disturbs another. A test holds this
module to :func:`liaam.fitting.solver.solve`, state by state.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from array_api_compat import array_namespace
from array_api_compat import device as device_of

from liaam.fitting.batched.equations import (
    Array,
    Equations,
    after_lambda_step,
    apply,
    choose,
    cost,
    identity,
    map_arrays,
    reduced,
)
from liaam.fitting.batched.objective import BatchObjective, Look, Pictures, Seen, Shared, States, Trusts, recurring
from liaam.fitting.batched.trust import alike, soft_trust
from liaam.fitting.normal_equations import ROUNDING, NormalEquations
from liaam.fitting.objective import Linearisation, State
from liaam.fitting.prior import next_scale
from liaam.fitting.problem import FitProblem
from liaam.fitting.problem import Look as OneLook
from liaam.fitting.solver import (
    DAMPING_RANGE,
    EXPECTED_RISE,
    LEAST_CURVATURE,
    OBSERVABLE_APART,
    REFUSED_DAMPING,
    STILL,
    TO_AND_FRO,
    TRUSTED_DAMPING,
    Solution,
    SolverOptions,
)


class Run(NamedTuple):
    """Where the fits of a batch stand.

    Attributes
    ----------
    item : (b,) int64
        Number of the fit.
    state : States
    last : Seen
        At those states.
    trust : Trusts, or () for methods that do not weigh anew
    damping : (b,) float64
    free : (b, n_q) bool
        Directions that may move.
    settled, flat, done : (b,) bool
    n_iterations : (b,) int64
    scale : (b,) float64
        Of the shape prior's variances.
    least : (b,) float64
        Lowest merit under these weights.
    curvature : (b, n_q, n_q) float64
        Expected Hessian under these weights.
    curved : (b,) bool
        Whether it has been worked out.
    lift : (b,) float64
        Least curvature as a share of it.
    before : (b, n_q) float64
        The last step taken; 0 if there is none.
    """

    item: Array
    state: States
    last: Seen
    trust: Any
    damping: Array
    free: Array
    settled: Array
    flat: Array
    done: Array
    n_iterations: Array
    scale: Array
    least: Array
    curvature: Array
    curved: Array
    lift: Array
    before: Array


class Proposal(NamedTuple):
    """Steps to be tried.

    The states they lead to, which are too small to matter (b,) or to weigh anew after (b,), where there was something
    to see (b,), the precision of the prior that they reckon with (b, n_p), the steps of q (b, n_q), and which
    go back where the last ones came from (b,).
    """

    state: States
    small: Array
    still: Array
    sees: Array
    precision: Array
    step: Array
    back: Array


class Step(NamedTuple):
    """Fits after a step was tried: which accepted it, and which found it too small to matter or to weigh anew."""

    run: Run
    accepted: Array
    small: Array
    still: Array


@dataclass(frozen=True, eq=False)
class BatchSolver:
    """An objective, an array library and options, ready for batches.

    Attributes
    ----------
    objective : BatchObjective
    options : SolverOptions
    """

    objective: BatchObjective
    options: SolverOptions

    def solve(self, problems: Sequence[FitProblem], starts: Sequence[State]) -> list[Solution]:
        """Minimise the objective over many images: what :func:`liaam.fitting.solver.solve` gives for each.

        Parameters
        ----------
        problems : sequence of FitProblem
        starts : sequence of State

        Returns
        -------
        list of Solution
        """
        n, library = len(problems), self.objective.backend
        repeated = recurring(n) - n if library.compiles else 0
        problems = [*problems, *[problems[-1]] * repeated]
        starts = [*starts, *[starts[-1]] * repeated]
        with library.working():
            return self._solve(self.objective.pictures(problems), self.objective.states(starts))[:n]

    def _solve(self, pictures: Pictures, start: States) -> list[Solution]:
        shared, record = self.objective.shared, _Record(self.objective, self.options, start.p.shape[0])
        run = self._begin(shared, pictures, start)
        record.accept(run, None)
        for _ in range(self.options.max_iterations):
            run = self._turn(shared, pictures, run, record.accept, expects=self._weighs)
            going = ~record.fetch(run.done)
            if not going.any():
                break
            if going.sum() <= len(going) // 2 and not self.objective.backend.compiles:
                self._set_aside(shared, pictures, run, np.flatnonzero(~going), record)
                run, pictures = self._take(run, going), self._take(pictures, going)
        self._set_aside(shared, pictures, run, np.arange(run.item.shape[0]), record)
        return record.solutions()

    def _take(self, arrays: Any, mask: np.ndarray) -> Any:
        index = self.objective.backend.put(np.flatnonzero(mask))
        return map_arrays(lambda array: self.xp.take(array, index, axis=0), arrays)

    def _set_aside(self, shared: Shared, pictures: Pictures, run: Run, which: np.ndarray, record: "_Record") -> None:
        """Score fits that have ended, where their method asks for it, and keep what came out."""
        mask = np.isin(np.arange(run.item.shape[0]), which)
        run, pictures = self._take(run, mask), self._take(pictures, mask)
        if self.options.scoring and not self._weighs:
            run = self._score(shared, pictures, run, record)
        record.keep(run, self.objective.backend.fetch(self._held(shared, run)))

    @property
    def xp(self) -> Any:
        """Namespace of the array library."""
        return self.objective.xp

    @property
    def _weighs(self) -> bool:
        return self.objective.objective.method.soft

    @cached_property
    def _functions(self) -> dict[str, Callable]:
        """What is compiled, by name: the long ones only once each."""
        compiled = self.objective.backend.compiled
        solves = self.options.elimination == "varpro"
        evaluate, weigh = compiled(self._solved), compiled(self._weighed_and_solved)
        return {
            "solved": evaluate,
            "seen": evaluate if solves else compiled(self._as_it_is),
            "weighed_and_solved": weigh,
            "weighed": weigh if solves else compiled(self._weighed),
            "expected": compiled(self._expected),
            "curvature": compiled(self._curvature),
            "trust": compiled(partial(soft_trust, self.objective)),
            "propose": compiled(self._propose),
            "propose_expected": compiled(self._propose_expected),
            "rescale": compiled(self._rescaled),
            "judge": compiled(self._judge),
            "judge_expected": compiled(partial(self._judge, expects=True)),
            "free": compiled(self._free),
            "finish": compiled(self._finished),
            "finish_expected": compiled(partial(self._finished, expects=True)),
        }

    def _begin(self, shared: Shared, pictures: Pictures, start: States) -> Run:
        xp, batch = self.xp, start.p.shape[0]
        state, last = self._functions["solved"](shared, pictures, start, None)
        trust: Any = ()
        if self._weighs:
            trust = self._functions["trust"](shared, pictures, state, last.look)
            state, last = self._functions["weighed_and_solved"](shared, last.look, state, trust)
        zeros = xp.zeros_like(last.equations.rr)
        no = zeros > 1
        item = self.objective.backend.put(np.arange(batch))
        every = xp.ones((batch, self.objective.objective.n_q), dtype=xp.bool, device=device_of(zeros))
        damping = zeros + self.options.damping
        unknown = xp.zeros_like(last.equations.jj)
        least = xp.full_like(zeros, float("inf"))
        nowhere = xp.zeros_like(last.equations.jr)
        lift = zeros + LEAST_CURVATURE
        facts = damping, every, no, no, no, 0 * item, zeros + 1.0, least, unknown, no, lift, nowhere
        run = Run(item, state, last, trust, *facts)
        return run._replace(free=self._functions["free"](shared, run.state, run.last.equations))

    def _turn(
        self, shared: Shared, pictures: Pictures, run: Run, accept: Callable[[Run, Array], None], expects: bool
    ) -> Run:
        """One turn of the loop: steps, those that are taken, and what follows from them (``solver._iterate``)."""
        name = "_expected" if expects else ""
        tried = self._try_step(shared, pictures, run, name)
        trust = tried.run.trust
        run = self._weigh_anew(shared, pictures, tried.run, tried.accepted & ~tried.still)
        if run.trust is not trust:  # another trust's merits and curvature say nothing
            same = self.xp.all(run.trust.root == trust.root, axis=(1, 2))
            run = run._replace(least=self.xp.where(same, run.least, float("inf")), curved=run.curved & same)
        accept(run, tried.accepted)
        return self._functions["finish" + name](shared, run, tried.accepted, tried.small)

    def _try_step(self, shared: Shared, pictures: Pictures, run: Run, name: str) -> Step:
        """Steps with the picture's own or the expected gradient, and whether they are taken."""
        equations, hessian = run.last.equations, None
        if name:
            if not bool(self.xp.all(run.curved | run.done)):
                curvature = self._functions["curvature"](shared, run.last.look, run.state, run.trust or None)
                curvature = choose(run.curved, (run.curvature,), (curvature,))[0]
                run = run._replace(curvature=curvature, curved=self.xp.ones_like(run.curved))
            equations = self._functions["expected"](shared, run.last.look, run.state, run.trust or None)
            hessian = run.curvature
        if self._rescales:
            run = self._functions["rescale"](
                shared, run, reduced(run.last.equations)[0] if hessian is None else hessian
            )
        proposed = self._functions["propose" + name](shared, run, equations, run.damping)
        there = self._functions["seen"](shared, pictures, proposed.state, run.trust or None)
        return self._functions["judge" + name](run, proposed, there)

    def _propose(self, shared: Shared, run: Run, equations: Equations, damping: Array) -> Proposal:
        """Where a step with the picture's own gradient leads (``solver._own_step``)."""
        precision = self._precision(shared, run)
        step, lambda_step, sees = self._step(equations, run.state, precision, run.free, damping)
        small = self._is_small(step, reduced(equations)[0], equations.unit, precision)
        there = self._update(shared, run.state, step, lambda_step)
        nowhere_back = self.xp.zeros_like(small)
        return Proposal(there, small, self._movement(step) < STILL, sees, precision, step, nowhere_back)

    def _propose_expected(self, shared: Shared, run: Run, equations: Equations, damping: Array) -> Proposal:
        """Where a step with the expected gradient leads (``solver._expected_step``)."""
        precision = self._precision(shared, run)
        metric = run.curvature + self._on_diagonal(precision, run.curvature)
        step, sees = self._guarded_step(equations, metric, run, precision, damping)
        small = self._is_small(step, run.curvature, run.last.equations.unit, precision)
        lambda_step = apply(equations.inverse, equations.ar + apply(equations.aj, step))
        there = self._update(shared, run.state, step, lambda_step)
        ahead, length = (self.xp.sum(run.before * apply(metric, other), axis=-1) for other in (step, run.before))
        back = ahead < -TO_AND_FRO * length
        return Proposal(there, small, self._movement(step) < STILL, sees, precision, step, back)

    def _on_diagonal(self, precision: Array, like: Array) -> Array:
        """Precision of the prior on p (b, n_p) as diagonal matrices (b, n_q, n_q); angles have none."""
        xp = self.xp
        rest = xp.zeros_like(like[:, 0, self.objective.n_p :])
        return xp.concat([precision, rest], axis=-1)[:, None, :] * identity(like)

    def _is_small(self, step: Array, hessian: Array, unit: Array, precision: Array) -> Array:
        """Which steps are too small to matter, (b,): in pixels, or in standard deviations where they are known."""
        xp, n_p = self.xp, self.objective.n_p
        information = xp.sum(step * apply(hessian, step), axis=-1)
        information = information + xp.sum(precision * step[:, :n_p] ** 2, axis=-1)
        unseen = information < self.options.notice**2 * step.shape[1] * unit  # not where it is NaN
        return (self._movement(step) < self.options.tolerance) | unseen

    def _judge(self, run: Run, proposed: Proposal, there: tuple[States, Seen], expects: bool = False) -> Step:
        """Take the steps that do not raise the merit (by too much); damp the others more."""
        xp, options = self.xp, self.options
        before = _merit(run.last.equations, run.state, proposed.precision)
        merit = _merit(there[1].equations, there[0], proposed.precision)
        least = xp.where(run.least < before, run.least, before)
        worse = ~(merit <= (EXPECTED_RISE if expects else 1.0) * least)
        going = ~run.done
        flat = run.flat | (going & ~proposed.sees)
        going = going & proposed.sees
        refused = going & worse if options.damping > 0 else going & ~going
        stuck = refused & (proposed.small | (run.damping >= DAMPING_RANGE[1]))
        accepted = going & ~refused
        state, last = choose(accepted, there, (run.state, run.last))
        raised = xp.clip(run.damping * 10, REFUSED_DAMPING if expects else 1e-3, DAMPING_RANGE[1])
        after = run._replace(
            state=state,
            last=last,
            damping=xp.where(refused & ~stuck, raised, run.damping),
            settled=run.settled | stuck,
            flat=flat,
            done=run.done | stuck | flat,
            n_iterations=run.n_iterations + xp.astype(going, run.n_iterations.dtype),
            least=xp.where(accepted & (merit < least), merit, least),
            lift=xp.where(going & proposed.back, 2.0 * run.lift, run.lift),
            before=xp.where(accepted[:, None], proposed.step, run.before),
        )
        return Step(after, accepted, proposed.small, proposed.still)

    def _weigh_anew(self, shared: Shared, pictures: Pictures, run: Run, which: Array) -> Run:
        """Weigh the pixels of some fits anew, and solve lambda again under the weights that have changed."""
        if not self._weighs:
            return run
        trust = self._functions["trust"](shared, pictures, run.state, run.last.look)
        changed = which & ~alike(run.trust, trust) & ~self.xp.isnan(trust.unit)
        if not bool(self.xp.any(changed)):
            return run
        state, last = self._functions["weighed"](shared, run.last.look, run.state, trust)
        new = choose(changed, (state, last, trust), (run.state, run.last, run.trust))
        return run._replace(state=new[0], last=new[1], trust=new[2])

    def _finished(self, shared: Shared, run: Run, accepted: Array, small: Array, expects: bool = False) -> Run:
        """End of a turn, for those that took the step: damping, directions, and whether the fit has settled."""
        xp, options = self.xp, self.options
        if expects:
            lowered = xp.where(run.damping > TRUSTED_DAMPING, run.damping / 10, 0.0 * run.damping)
        else:
            lowered = xp.clip(run.damping / 10, DAMPING_RANGE[0], None) if options.damping > 0 else 0.0 * run.damping
        damping = xp.where(accepted, lowered, run.damping)
        free = xp.where(accepted[:, None], self._free(shared, run.state, run.last.equations), run.free)
        small = accepted & small & (damping <= TRUSTED_DAMPING)  # small of itself, not by damping
        blown = accepted & ~xp.isfinite(cost(run.last.equations))
        return run._replace(damping=damping, free=free, settled=run.settled | small, done=run.done | small | blown)

    def _as_it_is(self, shared: Shared, pictures: Pictures, state: States, trust: Trusts | None) -> tuple[States, Seen]:
        """Linearise, and leave lambda: joint steps move it themselves."""
        return state, self.objective.linearise(shared, pictures, state, trust)

    def _solved(self, shared: Shared, pictures: Pictures, state: States, trust: Trusts | None) -> tuple[States, Seen]:
        """Linearise, and solve lambda there: any start, and every state of variable projection."""
        return self._solve_lambda(shared, state, self.objective.linearise(shared, pictures, state, trust))

    def _weighed(self, shared: Shared, look: Look, state: States, trust: Trusts) -> tuple[States, Seen]:
        """Weigh what was seen under another trust, and leave lambda."""
        return state, self.objective.weighed(shared, look, state, trust)

    def _weighed_and_solved(self, shared: Shared, look: Look, state: States, trust: Trusts) -> tuple[States, Seen]:
        """The same, with lambda solved under the new weights."""
        return self._solve_lambda(shared, *self._weighed(shared, look, state, trust))

    def _solve_lambda(self, shared: Shared, state: States, seen: Seen) -> tuple[States, Seen]:
        """Give states the lambda that fits best there, by the products alone."""
        equations = seen.equations
        step = apply(equations.inverse, equations.ar)
        step = self.xp.where((equations.weight > 0)[:, None], step, self.xp.zeros_like(step))
        look = self.objective.moved(shared, seen.look, state, step)
        return state._replace(lam=state.lam + step), Seen(after_lambda_step(equations, step), look)

    def _expected(self, shared: Shared, look: Look, state: States, trust: Trusts | None) -> Equations:
        """Equations of the zero of E'r, by the gradient of the model: ``Linearisation.expecting``."""
        gradient = self.objective.model_gradient(shared, look, state)
        return self.objective.weighed(shared, look, state, trust, gradient).equations

    def _curvature(self, shared: Shared, look: Look, state: States, trust: Trusts | None) -> Array:
        """Expected Hessians, (b, n_q, n_q): ``Linearisation.with_gradient``."""
        look = look._replace(steep=self.objective.model_gradient(shared, look, state))
        return reduced(self.objective.weighed(shared, look, state, trust).equations)[0]

    def _update(self, shared: Shared, state: States, step: Array, lambda_step: Array) -> States:
        n_p = self.objective.n_p
        angles = state.angles + step[:, n_p:] @ self.xp.matrix_transpose(shared.directions)
        return States(state.p + step[:, :n_p], angles, state.lam + lambda_step)

    def _movement(self, step: Array) -> Array:
        """Root mean square movement of the landmarks, (b,): ``Warp.movement``, which is a multiple of the norm."""
        n_p = self.objective.n_p
        unit = self.objective.objective.warp.movement(np.eye(n_p)[0])
        return unit * self.xp.sqrt(self.xp.sum(step[:, :n_p] ** 2, axis=-1))

    def _precision(self, shared: Shared, run: Run) -> Array:
        """Precision of the prior on p, in units of squared residuals, (b, n_p)."""
        return (self.options.shape_prior * self._unit(run.last.equations) / run.scale)[:, None] * shared.prior

    def _unit(self, equations: Equations) -> Array:
        """Variance that a residual of weight 1 stands for, (b,): ``Objective.unit``."""
        xp, mean = self.xp, cost(equations)
        own = self.objective.objective.tied * xp.where(xp.isfinite(mean), mean, xp.zeros_like(mean))
        return xp.where(xp.isfinite(equations.unit), equations.unit, own)

    @property
    def _rescales(self) -> bool:
        return bool(np.isfinite(self.objective.objective.freedom)) and self.options.shape_prior > 0

    def _rescaled(self, shared: Shared, run: Run, hessian: Array) -> Run:
        """Scale of the prior's variances in each picture, a step further."""
        prior, unit = self.options.shape_prior * shared.prior, self._unit(run.last.equations)
        freedom = self.objective.objective.freedom
        scale = next_scale(hessian, run.state.p, prior, unit, freedom, run.scale)
        return run._replace(scale=self.xp.where(run.done, run.scale, scale))

    def _step(
        self, equations: Equations, state: States, precision: Array, free: Array, damping: Array
    ) -> tuple[Array, Array, Array]:
        """Damped Gauss-Newton step of q, its lambda step, and where there was something to see."""
        xp, n_p = self.xp, self.objective.n_p
        hessian, gradient = reduced(equations)
        seen = xp.max(xp.linalg.diagonal(hessian)[:, :n_p], axis=-1) > 1e-10 * equations.weight
        sees = (equations.weight > 0) & xp.isfinite(equations.rr) & seen
        rest = xp.zeros_like(gradient[:, n_p:])
        gradient = gradient + xp.concat([precision * state.p, rest], axis=-1)
        unit = identity(hessian)
        hessian = hessian + self._on_diagonal(precision, hessian)
        sees = sees & xp.all(xp.isfinite(hessian), axis=(1, 2))
        # Directions that are held, and fits with nothing to see, give steps of 0.
        moves = free & sees[:, None]
        both = moves[:, :, None] & moves[:, None, :]
        hessian = xp.where(both, hessian, xp.zeros_like(hessian))
        diagonal = xp.linalg.diagonal(hessian)
        floor = 1e-9 * xp.max(diagonal, axis=-1)[:, None]
        added = damping[:, None] * xp.maximum(diagonal, floor) + floor
        damped = hessian + xp.where(moves, added, xp.ones_like(added))[:, None, :] * unit
        gradient = xp.where(moves, gradient, xp.zeros_like(gradient))
        step = xp.linalg.solve(damped, -gradient[..., None])[..., 0]
        lambda_step = apply(equations.inverse, equations.ar + apply(equations.aj, step))
        return step, lambda_step, sees

    def _guarded_step(
        self, equations: Equations, base: Array, run: Run, precision: Array, damping: Array
    ) -> tuple[Array, Array]:
        """Steps to the zero of a gradient (``solver._guarded_step``), and where there was something to see."""
        xp, n_p = self.xp, self.objective.n_p
        hessian, gradient = reduced(equations)
        seen = xp.max(xp.abs(xp.linalg.diagonal(hessian)[:, :n_p]), axis=-1) > 1e-10 * equations.weight
        sees = (equations.weight > 0) & xp.isfinite(equations.rr) & seen
        sees = sees & xp.all(xp.isfinite(hessian) & xp.isfinite(base), axis=(1, 2))
        sees = sees & (xp.max(xp.linalg.diagonal(base)[:, :n_p], axis=-1) > 0)
        rest = xp.zeros_like(gradient[:, n_p:])
        gradient = gradient + xp.concat([precision * run.state.p, rest], axis=-1)
        moves, unit = run.free & sees[:, None], identity(hessian)
        both = moves[:, :, None] & moves[:, None, :]
        # Directions that are held, and fits with nothing to see, give steps of 0.
        hessian = hessian + self._on_diagonal(precision, hessian)
        base, hessian = (xp.where(both, matrix, xp.zeros_like(matrix)) for matrix in (base, hessian))
        base = xp.where(sees[:, None, None], base, unit + xp.zeros_like(base))
        sizes, axes = xp.linalg.eigh(base)
        whiten = axes / xp.sqrt(xp.maximum(sizes, ROUNDING * sizes[:, -1:]))[:, None, :]
        ratios, axes = xp.linalg.eigh(xp.matrix_transpose(whiten) @ hessian @ whiten)
        axes = whiten @ axes
        gradient = xp.where(moves, gradient, xp.zeros_like(gradient))
        along = apply(xp.matrix_transpose(axes), gradient)
        return -apply(axes, along / (xp.maximum(ratios, run.lift[:, None]) + damping[:, None])), sees

    def _free(self, shared: Shared, state: States, equations: Equations) -> Array:
        """Directions of q that may move, (b, n_q): all of p, and the angles that the image can tell."""
        xp, method = self.xp, self.objective.objective.method
        every = xp.ones_like(state.p, dtype=xp.bool)
        if method.free_angles == "none":
            return every
        n_p, observable = self.objective.n_p, self.options.observable
        hessian = reduced(equations)[0][:, n_p:, n_p:]
        terms = [self.objective._at(shared.metric, state.angles[:, 1], slope) for slope in (True, False)]
        slope, size = (xp.sum(xp.square(term), axis=(1, 2)) for term in terms)
        noise = xp.clip(equations.rr, 0.0, None) * slope / size + 1e-12 * equations.weight
        limit = min(OBSERVABLE_APART, observable)
        if method.free_angles != "both":
            needed = limit if method.free_angles == "image" else observable
            return xp.concat([every, hessian[:, :1, 0] > needed * noise[:, None]], axis=-1)
        apart, mixed = hessian[:, 1, 1], hessian[:, 0, 1] + hessian[:, 1, 1]
        image_seen = apart > limit * noise
        carried = xp.where(image_seen, mixed**2 / xp.where(image_seen, apart, xp.ones_like(apart)), 0.0 * apart)
        together = xp.sum(hessian, axis=(1, 2)) - carried
        seen = xp.stack([image_seen & (together > observable * noise), image_seen], axis=-1)
        return xp.concat([every, seen], axis=-1)

    def _held(self, shared: Shared, run: Run) -> Array:
        return ~self.xp.all(run.free, axis=-1)

    def _score(self, shared: Shared, pictures: Pictures, run: Run, record: "_Record") -> Run:
        """Step on with the expected gradient, as far as the cost does not say that the minimum was left."""
        going, path = ~run.flat, []
        least = self.xp.full_like(run.least, float("inf"))
        start = {"damping": 0.0 * run.damping, "done": run.flat, "least": least, "before": 0.0 * run.before}
        scored = run._replace(**start)
        for _ in range(min(self.options.scoring, self.options.max_iterations)):
            scored = self._turn(shared, pictures, scored, lambda *taken: path.append(taken), expects=True)
            if bool(self.xp.all(scored.done)):
                break
        good = going & (cost(scored.last.equations) <= EXPECTED_RISE * cost(run.last.equations))
        for there, mask in path:
            record.accept(there, good & mask)
        return choose(good, scored._replace(settled=run.settled, flat=run.flat), run)


def _merit(equations: Equations, state: States, precision: Array) -> Array:
    """What an accepted step must not raise, (b,): mean squared residual plus the prior's share."""
    xp = array_namespace(precision)
    prior = xp.sum(precision * state.p**2, axis=-1)
    return cost(equations) + xp.where(equations.weight > 0, prior / equations.weight, 0.0 * equations.weight)


class _Record:
    """What is to be kept of the fits of a batch, in NumPy's arrays."""

    def __init__(self, objective: BatchObjective, options: SolverOptions, n: int) -> None:
        self.fetch = objective.backend.fetch
        self._paths: list[list[tuple[float, State]]] = [[] for _ in range(n)]
        self._ends: dict[int, tuple] = {}

    def accept(self, run: Run, accepted: Array | None) -> None:
        """Add the states of those that took a step (all, if left out) to their paths."""
        items, costs = self.fetch(run.item), self.fetch(cost(run.last.equations))
        state = map_arrays(self.fetch, run.state)
        taken = np.ones(len(items), bool) if accepted is None else self.fetch(accepted)
        for i in np.flatnonzero(taken):
            self._paths[items[i]].append((float(costs[i]), State(state.p[i], state.angles[i], state.lam[i])))

    def keep(self, run: Run, held: np.ndarray) -> None:
        """Keep what fits have come to."""
        items, last = self.fetch(run.item), map_arrays(self.fetch, run.last)
        ends = [self.fetch(array) for array in (run.n_iterations, run.settled, run.flat, run.scale)]
        for i, item in enumerate(items):
            equations = last.equations
            own = NormalEquations(
                **{name: getattr(equations, name)[i] for name in ("jj", "jr", "aj", "aa", "ar")},
                rr=float(equations.rr[i]),
                weight=float(equations.weight[i]),
                inverse=equations.inverse[i],
                unit=float(equations.unit[i]),
            )
            seen = Linearisation.of(own, OneLook.of(*(array[i] for array in last.look)))
            self._ends[int(item)] = (seen, *(end[i].item() for end in ends), bool(held[i]))

    def solutions(self) -> list[Solution]:
        """Solutions in the order of the problems."""
        found = []
        for item, path in enumerate(self._paths):
            last, n_iterations, settled, flat, scale, held = self._ends[item]
            found.append(Solution(path[-1][1], last, tuple(path), n_iterations, settled, held, flat, scale=scale))
        return found
