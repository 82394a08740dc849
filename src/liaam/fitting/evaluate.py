"""What a fit does at a state: look at the picture, weigh what it sees, and differentiate it (paper eq 9, 10 and 5).

A method's :class:`liaam.fitting.level.Row` names those of these functions that it is made of.
"""

from liaam.fitting.equations import copy, eliminate, length, solve
from liaam.fitting.jacobian import (
    add_modes,
    add_squares,
    angle_column,
    combine,
    dots,
    pull,
    to_parameters,
    weigh_columns,
)
from liaam.fitting.level import SHOWN, UNIT, Picture, Row, Template, Work
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
from liaam.fitting.weights import (
    BY_NOISE,
    any_of,
    changed,
    normalisation,
    root_by_noise,
    row_variances,
    unexplained_by,
    weigh_by_loss,
    weigh_by_noise,
    weigh_by_rows,
)
from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Single1


@compiled
def look(template: Template, picture: Picture, row: Row, work: Work, solves: bool) -> None:
    """The residual of a state (paper eq 9), without an appearance where that is to be solved for."""
    set_metric(row.metric, work.angles[1], work.metric, work.slope)
    if len(template.parts):
        row.turn(template, work)
    sample_picture(template, picture, work)
    work.scales[SHOWN] = 1.0
    for j in range(len(work.lam)):  # lambda from nothing: what it was before does not matter
        work.lam[j] = 0.0 if solves else work.lam[j]
    if not row.normalise:
        take_off(work.residual, work.rows, work.lam)


@compiled
def sample_picture(template: Template, picture: Picture, work: Work) -> None:
    """P(theta_2) E(I(W(x; p))), and its derivative by the place."""
    mesh = template.warp
    vertices_at(mesh.rest, mesh.basis, work.p, work.points)
    similarity, corner, between = picture.similarity, work.corner, work.between
    height, width, metric = picture.height, picture.width, work.metric
    place(mesh.beta, mesh.starts, mesh.triangles, work.points, similarity, height, width, corner, between)
    values, residual, steep = work.values, work.residual, work.steep
    sample(picture.pixels, width, corner, between, similarity, metric, values, residual, steep, work.usable)


@compiled
def turn_model(template: Template, work: Work) -> None:
    """Bring the model's rows to theta_1."""
    turn(template.parts, work.angles[0], work.rows)
    turn(template.slope_parts, work.angles[0], work.slopes)
    transpose(work.rows, work.lines)


@compiled
def by_model(template: Template, _picture: Picture, row: Row, work: Work) -> bool:
    """Weigh as the model says, and bring samples to its mean; says whether there are any."""
    if not any_of(work.usable):
        return False
    copy(template.own, work.weighed)
    if row.normalise:
        normalisation(work.rows, work.values, work.metric, work.usable, template.own, work.scales)
    return True


@compiled
def by_noise(template: Template, picture: Picture, _row: Row, work: Work) -> bool:
    """Work out weights by noise as far as they do not turn with an angle; says whether there are any."""
    if not any_of(work.usable):
        return False
    copy(template.own, work.weighed)
    values, residual, usable, own = work.values, work.residual, work.usable, template.own
    table, span, kept, errors = picture.noise, picture.span, picture.kept, template.errors
    work.scales[UNIT] = weigh_by_noise(
        values, residual, usable, own, work.metric, table, span, kept, errors, work.noise, work.by_model, work.variance
    )
    return True


@compiled
def by_rows(template: Template, picture: Picture, row: Row, work: Work) -> bool:
    """Weigh each row by noise and by what the model leaves unexplained now; says whether weights are others."""
    values, residual, usable, own = work.values, work.residual, work.usable, template.own
    table, span, kept, colours = picture.noise, picture.span, picture.kept, template.colours
    planes, variance, known, sums = work.planes, work.variance, work.known_now, work.row_sums
    row_variances(values, residual, usable, own, work.metric, table, span, kept, colours, planes, variance, known, sums)
    counted = unexplained_by(sums, work.unexplained)
    if not counted > 0.0 or not (row.loss >= 0 or changed(known, work.known, work.unexplained)):
        return False
    copy(known, work.known)
    work.scales[UNIT] = weigh_by_rows(variance, work.unexplained, picture.correlated, own, usable, work.weighed)
    return True


@compiled
def by_loss(template: Template, row: Row, work: Work) -> None:
    """Multiply weights by those of a robust loss."""
    residual, usable, own, errors = work.residual, work.usable, template.own, template.errors
    weigh_by_loss(row.loss, row.median, residual, usable, own, work.variance, errors, work.sizes, work.weighed)


@compiled
def normalise_samples(row: Row, work: Work) -> None:
    """Samples as gain * E(I) + offset, less the appearance."""
    project(work.values, work.metric, work.scales, work.residual, work.steep)
    take_off(work.residual, work.rows, work.lam)


@compiled
def whiten(work: Work) -> None:
    """Weights by noise at theta_2."""
    metric, slope, noise, by_errors = work.metric, work.slope, work.noise, work.by_model
    root_by_noise(work.weighed, metric, slope, noise, by_errors, work.scales[UNIT], work.own, work.growth)


@compiled
def settle(template: Template, row: Row, work: Work, weighed: bool, solves: bool) -> None:
    """Sum what is seen, under the weights; or first move lambda to its best, and the residual with it."""
    if row.normalise:
        row.normalise_samples(row, work)
    if row.weights == BY_NOISE:
        row.whiten(work)
    elif weighed:
        copy(work.weighed, work.own)
    if weighed or row.weights == BY_NOISE or len(template.parts):
        weighted_gram(work.rows, work.own, work.block, work.gram)
    unseen = mask(work.own, work.usable, work.root)
    factorise(work.gram, template.ridge, work.lines, work.own, work.usable, unseen, work.factor)
    with_modes(work.rows, work.root, work.residual, work.line, work.ar)
    for j in range(len(work.lam)):
        work.ar[j] -= template.ridge[j] * work.lam[j]
        work.lam_step[j] = work.ar[j] if solves else 0.0
    if solves:
        solve(work.factor, work.lam_step)
        for j in range(len(work.lam)):
            work.lam[j] += work.lam_step[j]
            work.ar[j] = 0.0
    subtract(work.residual, work.rows, work.lam_step, work.root, work.sums)


@compiled
def expect(template: Template, work: Work) -> None:
    """The derivative of the residual by the place as the model expects it: that of the fitted appearance."""
    combine(work.slopes, work.lam, work.at_rest)
    mesh = template.warp
    vertices_at(mesh.rest, mesh.basis, work.p, work.points)
    pull(mesh.starts, mesh.triangles, mesh.rest, work.points, work.at_rest, work.expected)


@compiled
def sum_products(template: Template, work: Work, steep: Single1, expected: Single1) -> None:
    """Products of the derivatives by p: E'J, A'J and E'r, and E' with the columns of the angles."""
    mesh, n_p, n_free = template.warp, len(work.p), len(work.columns)
    fours, room = work.fours, work.room
    for f in range(n_free if n_free else 1):
        weigh_columns(steep, work.root, work.residual, work.columns, f, fours)
        add_squares(mesh.beta, mesh.starts, mesh.triangles, mesh.basis, fours, expected, room, work.squares)
        to_parameters(work.squares, mesh.basis, work.carried_squares)
        for i in range(n_p if n_free else 0):
            work.hessian[i, n_p + f] = work.hessian[n_p + f, i] = work.carried_squares[i, n_p + 1]
    add_modes(mesh.beta, mesh.starts, mesh.triangles, fours, work.lines, room, work.products)
    to_parameters(work.products, mesh.basis, work.carried_products)
    for i in range(n_p):
        work.gradient[i] = work.carried_squares[i, n_p]
        for j in range(n_p):
            work.hessian[i, j] = work.carried_squares[i, j]
        for j in range(len(work.lam)):
            work.aj[j, i] = work.carried_products[i, j]


@compiled
def differentiate(template: Template, row: Row, work: Work, steep: Single1, expected: Single1) -> None:
    """Hessian E'QJ and gradient E'Qr (paper eq 10 and 5), of J by ``steep`` and E by ``expected``, (2 n k,) float32.

    Where they differ, what is eliminated is J's on both sides: E'J - (A'J)' (A'A)^-1 A'J.
    """
    if len(work.columns):
        row.add_angles(template, row, work)
    sum_products(template, work, steep, expected)
    eliminate(work.factor, work.aj, work.ar, work.hessian, work.gradient, work.eliminated, work.along)


@compiled
def add_angles(template: Template, row: Row, work: Work) -> None:
    """Derivatives of the residual by the free angles, and their products with A, the residual and each other."""
    n_p, by = len(work.p), row.directions
    for f in range(len(work.columns)):
        column, values, growth, residual = work.columns[f], work.values, work.growth, work.residual
        angle_column(
            by[0, f], by[1, f], work.slope, values, growth, residual, template.parts, work.angles[0], work.lam, column
        )
        with_modes(work.rows, work.root, column, work.line, work.lam_step)
        for j in range(len(work.lam)):
            work.aj[j, n_p + f] = work.lam_step[j]
    for f in range(len(work.columns)):
        dots(work.columns, work.columns[f], work.residual, work.root, work.hessian, work.gradient, f)


@compiled
def movement(template: Template, work: Work) -> float:
    """Root mean square movement of the landmarks by a step, model pixels."""
    return template.warp.movement * length(work.step, len(work.p))
