"""The loop of a level: weighted, damped Gauss-Newton steps of p and the free angles (paper section 4).

Each iteration evaluates the residual (eq 9), differentiates it (eq 10) and solves the normal equations (eq 5). The
steps of p and theta are those of the joint system (p, lambda, theta). The two eliminations differ in lambda only.
Variable projection solves for it at every state, so it compares reduced costs. The joint form (the paper's) updates it
by its own part of the step.

:func:`solve_level` is one compiled call; kernel ``reference`` runs the same code over NumPy.
"""

import numpy as np

from liaam.fitting.equations import copy, copy_matrix
from liaam.fitting.evaluate import movement
from liaam.fitting.level import PULL, SCALE, UNIT, Controls, Picture, Row, Template, Work
from liaam.fitting.steps import (
    LEAST,
    add_points,
    add_prior,
    along_with,
    free_entries,
    go_back,
    goes_back,
    has_texture,
    merit_of,
    move,
    next_scale,
    record,
    squared_length,
)
from liaam.fitting.weights import BY_ROWS
from liaam.kernels.compiled import compiled
from liaam.kernels.jit import jit

TRUSTED_DAMPING, DAMPING_LIMIT = 1e-2, 1e7
"""Largest damping at which a small step means convergence, and damping at which the loop gives up."""

LEAST_DAMPING, FIRST_DAMPING, FIRST_EXPECTED_DAMPING = 1e-7, 1e-3, 1.0
"""Damping with the image's gradient: lower bound after accepted steps, and value after the first refused step. The
third is that value with the expected gradient, relative to the expected curvature."""

RISE, EXPECTED_RISE = 1.0 + 1e-6, 1.25
"""Largest ratio of a step's cost to the lowest cost so far. With the image's gradient it allows for rounding. The zero
of the expected gradient is not the cost's minimum. Its cost is 2 % higher at noise of 10/255, and a limit of 5 %
refused good steps at 15/255 and 20/255."""

STILL = 0.2
"""Length of a step, in model pixels, below which weights by rows are kept: their averages hardly change."""

ROUNDS = 3
"""Alternations between robust weights and lambda before the next residual, since outliers and lambda depend on each
other. With a patch over a fifth of a face (experiment ``baselines``), Tukey's loss loses 4 of 24 fits with one round
and none with three, in half the steps. Five rounds gain nothing."""

LONGEST_UNSEEN = 1.0
"""Longest step, in model pixels, that may be accepted without another evaluation."""


@compiled
def solve_level(template: Template, picture: Picture, row: Row, controls: Controls, work: Work) -> None:
    """Minimise a method's cost over one image at one level, from the state in ``work``. Always terminates."""
    averages, rise = row.weights == BY_ROWS and row.loss < 0, EXPECTED_RISE if controls.expected else RISE
    again = ROUNDS if row.loss >= 0 else 1
    # Twice at first if each pixel's weight depends on its own residual, and so on the weights before.
    rounds = (1 if averages else max(again, 2)) if controls.reweigh else 0
    damping, least, length, moved, n_taken, n_tried = controls.damping, np.inf, 0.0, 0.0, 0, 0
    solves, fresh, tried, small, settled, held, flat = controls.solve, True, False, False, False, False, False
    while True:
        row.look(template, picture, row, work, solves)  # eq 9
        row.settle(template, row, work, False, solves)  # lambda, where it is solved for at every state
        merit = merit_in(template, picture, work)
        if tried and controls.damping > 0.0 and not merit <= rise * least:  # NaN is refused, too
            go_back(work.before, work.p, work.angles, work.lam)
            settled, damping = small or damping >= DAMPING_LIMIT, _raised(damping, controls.expected)
            tried, rounds = False, 0
            continue
        if tried:
            n_taken, moved, damping = n_taken + 1, length, _eased(damping, controls.expected, controls.damping)
            copy(work.step, work.last_step)
            least = merit if merit < least else least
            settled = small and damping <= TRUSTED_DAMPING  # else damping may be what makes the step small
        for _ in range(rounds):
            if not row.weigh(template, picture, row, work):
                break
            if row.loss >= 0:
                row.weigh_by_loss(template, row, work)
            row.settle(template, row, work, True, solves)
            least, fresh = np.inf, True  # new weights invalidate the lowest cost and the expected curvature
        record(n_taken, work.p, work.angles, work.sums, work.costs, work.path, work.turns)
        ends = settled or n_tried >= controls.max_iterations or not np.isfinite(work.costs[n_taken])
        if ends and not controls.look:
            break
        found, held, unnoticed = propose(template, picture, row, controls, work, damping, fresh, ends)  # eq 10, eq 5
        flat = not found
        if ends or flat:
            break
        merit, length = merit_in(template, picture, work), movement(template, work)
        solves, least, fresh, tried = not controls.joint, merit if merit < least else least, False, True
        small = unnoticed or length < controls.tolerance or (n_tried < controls.quick and length < controls.loose)
        n_tried += 1
        move(row.directions, work.step, work.lam_step, work.p, work.angles, work.lam, work.before)
        if small and not controls.look and damping <= TRUSTED_DAMPING:  # skip the last evaluation
            settled, moved, n_taken = True, length, n_taken + 1
            record(n_taken, work.p, work.angles, work.sums, work.costs, work.path, work.turns)
            break
        rounds = again if controls.reweigh and not small and not (averages and length < STILL) else 0
    out = work.outcome
    out[0], out[1], out[2], out[3], out[4], out[5] = n_taken, n_tried, moved, settled, held, flat


@compiled
def merit_in(template: Template, picture: Picture, work: Work) -> float:
    """Return the cost of the current state that an accepted step must not raise."""
    pull, towards, factor = picture.pull, picture.towards, work.scales[PULL]
    return merit_of(work.sums, work.p, work.precision, work.lam, template.ridge, pull, towards, factor)


@compiled
def propose(
    template: Template,
    picture: Picture,
    row: Row,
    controls: Controls,
    work: Work,
    damping: float,
    fresh: bool,
    ends: bool,
) -> tuple[bool, bool, bool]:
    """Compute the step of q = (p, free angles) and of lambda (eq 5); at the end, only the Gauss-Newton Hessian.

    Returns
    -------
    found : bool
        Whether there is a step.
    held : bool
        Whether an angle is kept fixed.
    unnoticed : bool
        Whether the step is short compared with its standard deviation.
    """
    n_p, n_q = len(work.p), len(work.step)
    expects = controls.expected and not ends
    if expects:
        row.expect(template, work)
        if fresh:
            row.differentiate(template, row, work, work.expected, work.expected)
            copy_matrix(work.hessian, work.base)
        row.differentiate(template, row, work, work.steep, work.expected)
    else:
        row.differentiate(template, row, work, work.steep, work.steep)
        copy_matrix(work.hessian, work.base)
    held = not free_entries(
        row.directions, work.metric, work.slope, work.hessian, work.sums, controls.observable, work.free
    )
    found, unnoticed = has_texture(work.hessian, work.base, work.sums, n_p), False
    if not found or ends:
        return found, held, unnoticed
    known = row.weights == BY_ROWS and np.isfinite(work.scales[UNIT])
    unit = work.scales[UNIT] if known else template.correlated * work.sums[0] / work.sums[1]
    work.scales[PULL] = unit
    copy_matrix(work.base, work.damper)
    add_points(picture.pull, picture.towards, unit, work.p, work.damper, work.hessian, work.gradient)
    prior, strength, freedom, scale = template.prior, controls.shape_prior, template.freedom, work.scales[SCALE]
    if strength > 0.0 and np.isfinite(freedom):
        scale = next_scale(work.damper, work.p, prior, strength, unit, freedom, scale, work.small[0], work.small[1])
        work.scales[SCALE] = scale
    variance = unit / scale
    add_prior(prior, strength, variance, work.p, work.precision, work.damper, work.hessian, work.gradient)
    found = row.raised(work, damping) if expects else row.damped(work, damping)
    if expects and goes_back(work.step, work.last_step, work.damper):
        work.scales[LEAST] *= 2.0
    if controls.joint:
        along_with(work.factor, work.ar, work.aj, work.step, work.lam_step)
    short = squared_length(work.step, work.damper) < controls.notice**2 * n_q * unit
    unnoticed = known and short and damping <= 0.1 and movement(template, work) < LONGEST_UNSEEN
    return found, held, unnoticed


@jit
def _raised(damping, expected):
    """Return the damping after a refused step."""
    first = FIRST_EXPECTED_DAMPING if expected else FIRST_DAMPING
    return 10.0 * damping if 10.0 * damping > first else first


@jit
def _eased(damping, expected, asked):
    """Return the damping after an accepted step; 0 if undamped steps were asked for."""
    if expected:
        return 0.1 * damping if damping > TRUSTED_DAMPING else 0.0
    eased = 0.1 * damping if 0.1 * damping > LEAST_DAMPING else LEAST_DAMPING
    return eased if asked > 0.0 else 0.0
