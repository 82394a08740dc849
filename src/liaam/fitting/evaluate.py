"""Evaluation of a state: residual (paper eq 9), weights, lambda, and derivatives (eq 10) with lambda eliminated (eq 5).

A method's :class:`liaam.fitting.level.Row` lists the functions that it uses.
"""

from liaam.fitting.equations import copy, eliminate, length, multiply, solve
from liaam.fitting.jacobian import add_modes, add_squares, angle_column, combine, dots, pull, weigh_columns
from liaam.fitting.level import SHOWN, Picture, Row, Template, Work
from liaam.fitting.residual import (
    factorise,
    mask,
    place,
    project,
    sample,
    set_metric,
    subtract,
    take_off,
    transpose,
    turn,
    vertices_at,
    weighted_gram,
    with_modes,
)
from liaam.fitting.weights import BY_NOISE
from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Single1


@compiled
def evaluate_residual(template: Template, picture: Picture, row: Row, work: Work, solves: bool) -> None:
    """Compute the residual of a state (eq 9), with the mean appearance only if lambda is to be solved for."""
    set_metric(row, work)
    if len(template.parts):
        row.turn(template, work)
    sample_picture(template, picture, work)
    work.scales[SHOWN] = 1.0
    for j in range(len(work.lam) if solves else 0):
        work.lam[j] = 0.0
    if not row.normalise:
        take_off(work)


@compiled
def sample_picture(template: Template, picture: Picture, work: Work) -> None:
    """Sample the image term of eq 9, P(theta_2) E(I(W(x; p))), and its spatial gradient."""
    vertices_at(template, work)
    place(template, picture, work)
    sample(picture, work)


@compiled
def turn_model(template: Template, work: Work) -> None:
    """Project mean, modes and their slopes by P(theta_1)."""
    turn(template.parts, work.angles[0], work.rows)
    turn(template.slope_parts, work.angles[0], work.slopes)
    transpose(work.rows, work.lines)


@compiled
def normalise_samples(work: Work) -> None:
    """Compute the residual of the normalised samples, gain * E(I) + offset minus the appearance."""
    project(work)
    take_off(work)


@compiled
def solve_lambda(template: Template, row: Row, work: Work, weighed: bool, solves: bool) -> None:
    """Sum squared residuals under the weights, after solving for lambda (A'A + ridge) dl = A'r if ``solves``."""
    if row.normalise:
        row.normalise_samples(work)
    if row.weights == BY_NOISE:
        row.whiten(work)
    elif weighed:
        copy(work.weighed, work.own)
    if weighed or row.weights == BY_NOISE or len(template.parts):
        weighted_gram(work.rows, work.own, work.block, work.gram)
    unseen = mask(work.own, work.usable, work.root)
    factorise(template, work, unseen)
    with_modes(work.rows, work.root, work.residual, work.line, work.ar)
    for j in range(len(work.lam)):
        work.ar[j] -= template.ridge[j] * work.lam[j]
        work.lam_step[j] = work.ar[j] if solves else 0.0
    if solves:
        solve(work.factor, work.lam_step)
        for j in range(len(work.lam)):
            work.lam[j] += work.lam_step[j]
            work.ar[j] = 0.0
    subtract(work)


@compiled
def expect(template: Template, work: Work) -> None:
    """Compute the expected spatial gradient of the residual: that of the fitted appearance (eq 4)."""
    combine(work.slopes, work.lam, work.appearance_slopes)
    vertices_at(template, work)
    pull(template, work)


@compiled
def sum_products(template: Template, work: Work, image_slopes: Single1, expected: Single1) -> None:
    """Sum the products E'J, A'J and E'r of the derivatives by p, and those of E with the columns of the angles."""
    basis, n_p, n_free = template.warp.basis, len(work.p), len(work.columns)
    wide = basis.shape[1]
    for f in range(n_free if n_free else 1):
        weigh_columns(work, image_slopes, f)
        add_squares(template, work, expected)
        multiply(basis, work.squares, work.carried_squares)  # to the warp's parameters
        for i in range(n_p if n_free else 0):
            work.hessian[i, n_p + f] = work.hessian[n_p + f, i] = work.carried_squares[i, wide + 1]
    add_modes(template, work)
    multiply(basis, work.products, work.carried_products)
    for i in range(n_p):
        work.gradient[i] = work.carried_squares[i, wide]
        for j in range(n_p):
            work.hessian[i, j] = work.carried_squares[i, j]
        for j in range(len(work.lam)):
            work.aj[j, i] = work.carried_products[i, j]


@compiled
def differentiate(template: Template, row: Row, work: Work, image_slopes: Single1, expected: Single1) -> None:
    """Compute the Hessian E'QJ and the gradient E'Qr (eq 10 and 5).

    J follows from the spatial gradients ``image_slopes`` and E from ``expected``, both (2 n k,) float32. If they
    differ, the term eliminated is still that of J: E'J - (A'J)' (A'A)^-1 A'J.
    """
    if len(work.columns):
        row.add_angles(template, row, work)
    sum_products(template, work, image_slopes, expected)
    eliminate(work)


@compiled
def add_angles(template: Template, row: Row, work: Work) -> None:
    """Differentiate the residual by the free angles (eq 10), and sum the products of these columns."""
    n_p = len(work.p)
    for f in range(len(work.columns)):
        angle_column(template, row, work, f)
        with_modes(work.rows, work.root, work.columns[f], work.line, work.lam_step)
        for j in range(len(work.lam)):
            work.aj[j, n_p + f] = work.lam_step[j]
    for f in range(len(work.columns)):
        dots(work, f)


@compiled
def movement(template: Template, work: Work) -> float:
    """Return the root mean square movement of the landmarks by a step, model pixels."""
    return template.warp.movement * length(work.step, len(work.p))
