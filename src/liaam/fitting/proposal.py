"""The step that an iteration of the loop proposes (paper eq 5), and its damping."""

import numpy as np

from liaam.fitting.equations import copy_matrix
from liaam.fitting.evaluate import movement
from liaam.fitting.level import LEAST, PULL, SCALE, UNIT, Controls, Picture, Row, Template, Work
from liaam.fitting.steps import (
    add_points,
    add_prior,
    along_with,
    free_entries,
    goes_back,
    has_texture,
    next_scale,
    squared_length,
)
from liaam.fitting.weights import BY_ROWS
from liaam.kernels.compiled import compiled, inlined

TRUSTED_DAMPING = 1e-2
"""Largest damping at which a small step means convergence."""

LEAST_DAMPING, FIRST_DAMPING, FIRST_EXPECTED_DAMPING = 1e-7, 1e-3, 1.0
"""Damping with the image's gradient: lower bound after accepted steps, and value after the first refused step. The
third is that value with the expected gradient, relative to the expected curvature."""

LONGEST_UNSEEN = 1.0
"""Longest step, in model pixels, that may be accepted without another evaluation."""


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
    negligible : bool
        Whether the step is short compared with its standard deviation.
    """
    expects = controls.expected and not ends
    if expects:
        row.expect(template, work)
        if fresh:
            row.differentiate(template, row, work, work.expected, work.expected)
            copy_matrix(work.hessian, work.base)
        row.differentiate(template, row, work, work.image_slopes, work.expected)
    else:
        row.differentiate(template, row, work, work.image_slopes, work.image_slopes)
        copy_matrix(work.hessian, work.base)
    held, found, negligible = not free_entries(row, work, controls.observable), has_texture(work), False
    if not found or ends:
        return found, held, negligible
    known = row.weights == BY_ROWS and np.isfinite(work.scales[UNIT])
    unit = work.scales[UNIT] if known else template.correlated * work.sums[0] / work.sums[1]
    work.scales[PULL] = unit
    copy_matrix(work.base, work.damper)
    add_points(picture, work)
    if controls.shape_prior > 0.0 and np.isfinite(template.freedom):
        work.scales[SCALE] = next_scale(template, work, controls.shape_prior, unit)
    add_prior(template, work, controls.shape_prior * (unit / work.scales[SCALE]))
    found = row.raised(work, damping) if expects else row.damped(work, damping)
    if expects and goes_back(work.step, work.last_step, work.damper):
        work.scales[LEAST] *= 2.0
    if controls.joint:
        along_with(work)
    short = squared_length(work.step, work.damper) < controls.relative_tolerance**2 * len(work.step) * unit
    negligible = known and short and damping <= 0.1 and movement(template, work) < LONGEST_UNSEEN
    return found, held, negligible


@inlined
def raised_damping(damping, expected):
    """Return the damping after a refused step."""
    first = FIRST_EXPECTED_DAMPING if expected else FIRST_DAMPING
    return 10.0 * damping if 10.0 * damping > first else first


@inlined
def eased_damping(damping, expected, asked):
    """Return the damping after an accepted step; 0 if undamped steps were asked for."""
    if expected:
        return 0.1 * damping if damping > TRUSTED_DAMPING else 0.0
    eased = 0.1 * damping if 0.1 * damping > LEAST_DAMPING else LEAST_DAMPING
    return eased if asked > 0.0 else 0.0
