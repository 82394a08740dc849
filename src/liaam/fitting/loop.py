"""The loop of a level: weighted, damped Gauss-Newton steps of p and the free angles (paper section 4).

Each iteration evaluates the residual (eq 9), differentiates it (eq 10) and solves the normal equations (eq 5). The
steps of p and theta are those of the joint system (p, lambda, theta). The two eliminations differ in lambda only.
Variable projection solves for it at every state, so it compares reduced costs. The joint form (the paper's) updates it
by its own part of the step.

:func:`solve_level` is one compiled call; kernel ``reference`` runs the same code over NumPy.
"""

import numpy as np

from liaam.fitting.equations import copy
from liaam.fitting.evaluate import movement
from liaam.fitting.level import Controls, Picture, Row, Template, Work
from liaam.fitting.proposal import TRUSTED_DAMPING, eased_damping, propose, raised_damping
from liaam.fitting.steps import go_back, merit_of, move, record
from liaam.fitting.weights import BY_ROWS
from liaam.kernels.compiled import compiled

DAMPING_LIMIT = 1e7
"""Damping at which the loop gives up."""

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


@compiled
def solve_level(template: Template, picture: Picture, row: Row, controls: Controls, work: Work) -> None:
    """Minimise a method's cost over one image at one level, from the state in ``work``. Always terminates."""
    averages, rise = row.weights == BY_ROWS and row.loss < 0, EXPECTED_RISE if controls.expected else RISE
    again = ROUNDS if row.loss >= 0 else 1
    # Twice at first if each pixel's weight depends on its own residual, and so on the weights before.
    rounds = (1 if averages else max(again, 2)) if controls.reweigh else 0
    damping, least, n_taken, n_tried = controls.damping, np.inf, 0, 0
    solves, fresh, tried, small, converged, held, flat = controls.solve, True, False, False, False, False, False
    while True:
        row.evaluate_residual(template, picture, row, work, solves)  # eq 9
        row.solve_lambda(template, row, work, False, solves)  # lambda, where it is solved for at every state
        merit = merit_of(template, picture, work)
        if tried and controls.damping > 0.0 and not merit <= rise * least:  # NaN is refused, too
            go_back(work)
            converged, damping = small or damping >= DAMPING_LIMIT, raised_damping(damping, controls.expected)
            tried, rounds = False, 0
            continue
        if tried:
            n_taken, damping = n_taken + 1, eased_damping(damping, controls.expected, controls.damping)
            copy(work.step, work.last_step)
            least = merit if merit < least else least
            converged = small and damping <= TRUSTED_DAMPING  # else damping may be what makes the step small
        for _ in range(rounds):
            if not row.weigh(template, picture, row, work):
                break
            if row.loss >= 0:
                row.weigh_by_loss(template, row, work)
            row.solve_lambda(template, row, work, True, solves)
            least, fresh = np.inf, True  # new weights invalidate the lowest cost and the expected curvature
        record(n_taken, work)
        ends = converged or n_tried >= controls.max_iterations or not np.isfinite(work.costs[n_taken])
        if ends and not controls.evaluate_last:
            break
        found, held, negligible = propose(template, picture, row, controls, work, damping, fresh, ends)  # eq 10, eq 5
        flat = not found
        if ends or flat:
            break
        merit, length = merit_of(template, picture, work), movement(template, work)
        solves, least, fresh, tried = not controls.joint, merit if merit < least else least, False, True
        small = (
            negligible
            or length < controls.tolerance
            or (n_tried < controls.early_steps and length < controls.early_tolerance)
        )
        n_tried += 1
        move(row, work)
        if small and not controls.evaluate_last and damping <= TRUSTED_DAMPING:  # skip the last evaluation
            converged, n_taken = True, n_taken + 1
            record(n_taken, work)
            break
        rounds = again if controls.reweigh and not small and not (averages and length < STILL) else 0
    out = work.outcome
    out[0], out[1], out[2], out[3], out[4] = n_taken, n_tried, converged, held, flat
