"""The loop of a level: weighted, damped steps of p and the free angles with lambda eliminated (paper section 4).

Paper eq 5, 9 and 10 give the Gauss-Newton step of the joint system (p, lambda, theta). Both eliminations take that step
for p and theta. They differ in lambda: variable projection solves it afresh at every state, so that the cost compared
is the reduced one; the joint form, the paper's, moves it by its own part of the step.

A level is one call of :func:`solve_level`, compiled; kernel ``reference`` runs the same lines over plain NumPy.
"""

import numpy as np

from liaam.fitting.equations import copy, copy_matrix
from liaam.fitting.evaluate import LEAST, SCALE, UNIT, differentiate, expect, look, movement, settle, weigh
from liaam.fitting.level import Controls, Outcome, Picture, Row, Template, Work
from liaam.fitting.steps import (
    add_prior,
    along_with,
    damped_step,
    free_entries,
    go_back,
    goes_back,
    has_texture,
    merit_of,
    move,
    next_scale,
    raised_step,
    record,
    squared_length,
)
from liaam.fitting.weights import BY_ROWS
from liaam.jit import jit, spliced

TRUSTED_DAMPING, DAMPING_LIMIT = 1e-2, 1e7
"""Damping up to which the size of a step says that the fit has settled, and at which it stops."""

LEAST_DAMPING, FIRST_DAMPING, FIRST_EXPECTED_DAMPING = 1e-7, 1e-3, 1.0
"""Damping that accepted steps with the picture's gradient do not go below, and that after a first refused step; with
the expected gradient, where it is relative to the expected curvature."""

RISE, EXPECTED_RISE = 1.0 + 1e-6, 1.25
"""By how much more than the least cost a step may leave. With the picture's gradient: rounding. With the expected one
its zero is not the cost's minimum, which noise dents; measured: 2 % more at a noise of 10 of 255, and a limit of 5 %
refused good steps at 15 and 20."""

STILL = 0.2
"""Step, in model pixels, after which weights by rows are kept: what they are averaged from has hardly changed."""

LONGEST_UNSEEN = 1.0
"""Step, in model pixels, that is not taken without another look however uncertain the object is."""


@jit
def solve_level(template: Template, picture: Picture, row: Row, controls: Controls, work: Work) -> Outcome:
    """Minimise a method's cost over one picture at one level, from where ``work`` stands. It ends, whatever it sees."""
    averages, rise = row.weights == BY_ROWS and row.loss < 0, EXPECTED_RISE if controls.expected else RISE
    # Weights twice where each pixel's depends on its own residual, and so on the weights before.
    rounds = (1 if averages else 2) if controls.reweigh else 0
    damping, least, length, moved, n_taken, n_tried = controls.damping, np.inf, 0.0, 0.0, 0, 0
    solves, fresh, tried, refused, small = controls.solve, True, False, False, False
    settled, held, flat = False, False, False
    while True:
        look(template, picture, row, work, solves)  # eq 9
        for i in range(rounds + 1):
            if i > 0 and not weigh(template, picture, row, work):
                break
            settle(template, row, work, i > 0, solves)
            if i > 0:  # neither the least cost nor the expected curvature holds under other weights
                least, fresh = np.inf, True
            elif tried:
                merit = _merit(work)
                refused = controls.damping > 0.0 and not merit <= rise * least  # NaN is refused, too
                least = merit if merit < least else least
                if refused:
                    break
        if refused:  # look again where the step began
            _restore(work)
            settled, damping = small or damping >= DAMPING_LIMIT, _raised(damping, controls.expected)
            tried, refused, rounds = False, False, 0
            continue
        if tried:
            n_taken, moved, damping = n_taken + 1, length, _eased(damping, controls.expected, controls.damping)
            copy(work.step, work.last_step)
            settled = small and damping <= TRUSTED_DAMPING  # small of itself, not by damping
        record(n_taken, work.p, work.angles, work.sums, work.costs, work.path, work.turns)
        ends = settled or n_tried >= controls.max_iterations or not np.isfinite(work.costs[n_taken])
        if ends and not controls.look:
            break
        found, held, unnoticed = propose(template, row, controls, work, damping, fresh, ends)  # eq 10, eq 5
        flat = not found
        if ends or flat:
            break
        solves = not controls.joint
        merit, length, fresh, tried = _merit(work), movement(template, work), False, True
        least = merit if merit < least else least
        small = unnoticed or length < controls.tolerance or (n_tried < controls.quick and length < controls.loose)
        n_tried += 1
        _take(row, work)
        if small and not controls.look and damping <= TRUSTED_DAMPING:  # another look would tell nothing
            settled, moved, n_taken = True, length, n_taken + 1
            record(n_taken, work.p, work.angles, work.sums, work.costs, work.path, work.turns)
            break
        rounds = 1 if controls.reweigh and not small and not (averages and length < STILL) else 0
    return Outcome(n_taken, n_tried, moved, settled, held, flat)


@spliced
def propose(
    template: Template, row: Row, controls: Controls, work: Work, damping: float, fresh: bool, ends: bool
) -> tuple:
    """Write a step of q = (p, free angles), and of lambda with it; at the end the picture's own curvature only.

    Returns
    -------
    found : bool
        Whether there is any.
    held : bool
        Whether an angle is held.
    unnoticed : bool
        Whether nobody can tell the step from none.
    """
    n_p, n_q = len(work.p), len(work.step)
    if controls.expected and not ends:
        expect(template, work)
    for i in range(2 if ends else 0 if controls.expected and fresh else 1, 3 if ends else 2):
        steep = work.expected if i == 0 else work.steep
        expected = work.expected if controls.expected and not ends else work.steep
        differentiate(template, row, work, steep, expected)
        if i != 1 or not controls.expected:
            copy_matrix(work.hessian, work.base)
    shown = row.directions, work.metric, work.slope, work.hessian, work.sums
    held = not free_entries(*shown, controls.observable, work.free)
    found, unnoticed = has_texture(work.hessian, work.base, work.sums, n_p), False
    if found and not ends:
        known = row.weights == BY_ROWS and np.isfinite(work.scales[UNIT])
        unit = work.scales[UNIT] if known else template.correlated * work.sums[0] / work.sums[1]
        prior = template.prior, controls.shape_prior
        if controls.shape_prior > 0.0 and np.isfinite(template.freedom):
            by = unit, template.freedom, work.scales[SCALE], work.small[0], work.small[1]
            work.scales[SCALE] = next_scale(work.base, work.p, *prior, *by)
        metric = work.small[2]
        add_prior(
            *prior, unit / work.scales[SCALE], work.p, work.precision, work.base, metric, work.hessian, work.gradient
        )
        if controls.expected:
            system = metric, work.hessian, work.gradient, work.free, work.scales[LEAST], damping
            found = raised_step(*system, work.small[0], work.small[1], work.step)
            if goes_back(work.step, work.last_step, metric):
                work.scales[LEAST] *= 2.0
        else:
            found = damped_step(work.hessian, work.gradient, work.free, damping, work.small[0], work.step)
        if controls.joint:
            along_with(work.factor, work.ar, work.aj, work.step, work.lam_step)
        short = squared_length(work.step, metric) < controls.notice**2 * n_q * unit
        unnoticed = known and short and damping <= 0.1 and movement(template, work) < LONGEST_UNSEEN
    return found, held, unnoticed


@spliced
def _merit(work):
    return merit_of(work.sums, work.p, work.precision)


@spliced
def _take(row, work):
    """Take a step, remembering where it began."""
    move(row.directions, work.step, work.lam_step, work.p, work.angles, work.lam, work.before)


@spliced
def _restore(work):
    """Go back to where the last step began."""
    go_back(work.before, work.p, work.angles, work.lam)


@jit
def _raised(damping, expected):
    """Damping after a step was refused."""
    first = FIRST_EXPECTED_DAMPING if expected else FIRST_DAMPING
    return 10.0 * damping if 10.0 * damping > first else first


@jit
def _eased(damping, expected, asked):
    """Damping after a step was taken; none where none was asked for."""
    if expected:
        return 0.1 * damping if damping > TRUSTED_DAMPING else 0.0
    eased = 0.1 * damping if 0.1 * damping > LEAST_DAMPING else LEAST_DAMPING
    return eased if asked > 0.0 else 0.0
