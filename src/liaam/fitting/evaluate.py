"""What a fit does at a state: look at the picture, weigh what it sees, and differentiate it (paper eq 9, 10 and 5)."""

import numpy as np

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
from liaam.fitting.level import Picture, Row, Template, Work
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
    BY_ROWS,
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
from liaam.jit import spliced

UNIT, GAIN, OFFSET, SHOWN, SCALE, LEAST = 0, 1, 2, 3, 4, 5
"""Places in :attr:`liaam.fitting.level.Work.scales`."""


@spliced
def sample_picture(template: Template, picture: Picture, work: Work) -> None:
    """P(theta_2) E(I(W(x; p))), and its derivative by the place."""
    mesh = template.warp
    vertices_at(mesh.rest, mesh.basis, work.p, work.points)
    where = mesh.beta, mesh.starts, mesh.triangles, work.points, picture.similarity, picture.size
    place(*where, work.corner, work.between)
    seen = work.values, work.residual, work.steep, work.usable
    sample(picture.pixels, picture.size[1], work.corner, work.between, picture.similarity, work.metric, *seen)


@spliced
def look(template: Template, picture: Picture, row: Row, work: Work, solves: bool) -> None:
    """The residual of a state (paper eq 9), without an appearance where that is to be solved for."""
    set_metric(row.metric, work.angles[1], work.metric, work.slope)
    if len(template.parts):
        turn(template.parts, work.angles[0], work.rows)
        turn(template.slope_parts, work.angles[0], work.slopes)
        transpose(work.rows, work.lines)
    sample_picture(template, picture, work)
    work.scales[SHOWN] = 1.0
    for j in range(len(work.lam)):  # lambda from nothing: what it was before does not matter
        work.lam[j] = 0.0 if solves else work.lam[j]
    if not row.normalise:
        take_off(work.residual, work.rows, work.lam)


@spliced
def weigh(template: Template, picture: Picture, row: Row, work: Work) -> bool:
    """Work out weights by what the pixels look like now, as far as they do not turn with an angle.

    Steps are judged under the weights they were made with: a step that lowers the weighted squares lowers a robust loss
    of the same scale too.

    Returns
    -------
    bool
        Whether they are others.
    """
    by_loss, is_other, n_variances = row.loss >= 0, False, 0
    if row.weights == BY_ROWS:
        made = work.planes, work.variance, work.known_now, work.row_sums
        noise = work.metric, picture.noise, picture.span, picture.kept, template.colours
        row_variances(work.values, work.residual, work.usable, template.own, *noise, *made)
        counted = unexplained_by(work.row_sums, work.unexplained)
        is_other = counted > 0.0 and (by_loss or changed(work.known_now, work.known, work.unexplained))
        if is_other:
            copy(work.known_now, work.known)
            own = work.unexplained, picture.correlated, template.own, work.usable
            work.scales[UNIT] = weigh_by_rows(work.variance, *own, work.weighed)
            n_variances = len(work.variance)
    elif row.weights == BY_NOISE or by_loss or row.normalise:
        is_other = any_of(work.usable)
        if is_other:
            copy(template.own, work.weighed)
            if row.normalise:
                scales = work.values, work.metric, work.usable, template.own, work.scales[GAIN:SHOWN]
                normalisation(work.rows, *scales)
            if row.weights == BY_NOISE:
                made = template.errors, work.noise, work.by_model, work.variance
                noise = work.metric, picture.noise, picture.span, picture.kept
                seen = work.values, work.residual, work.usable, template.own
                work.scales[UNIT] = weigh_by_noise(*seen, *noise, *made)
                n_variances = len(work.variance)
    if is_other and by_loss:
        by = work.residual, work.usable, template.own, work.variance[:n_variances], template.errors
        weigh_by_loss(row.loss, row.median, *by, work.sizes, work.weighed)
    return is_other


@spliced
def settle(template: Template, row: Row, work: Work, weighed: bool, solves: bool) -> None:
    """Sum what is seen, under the weights; or first move lambda to its best, and the residual with it."""
    if row.normalise:  # samples are compared as gain * E(I) + offset
        project(work.values, work.metric, work.scales, work.residual, work.steep)
        take_off(work.residual, work.rows, work.lam)
    if row.weights == BY_NOISE:
        turned = work.metric, work.slope, work.noise, work.by_model, work.scales[UNIT]
        root_by_noise(work.weighed, *turned, work.own, work.growth)
    elif weighed:
        copy(work.weighed, work.own)
    if weighed or row.weights == BY_NOISE or len(template.parts):
        weighted_gram(work.rows, work.own, work.block, work.gram)
    unseen = mask(work.own, work.usable, work.root)
    factorise(work.gram, template.ridge, work.lines, work.own, work.usable, unseen, work.factor)
    with_modes(work.rows, 1, work.root, work.residual, work.line, work.ar)
    for j in range(len(work.lam)):
        work.lam_step[j] = work.ar[j] - template.ridge[j] * work.lam[j] if solves else 0.0
    if solves:
        solve(work.factor, work.lam_step)
        for j in range(len(work.lam)):
            work.lam[j] += work.lam_step[j]
            work.ar[j] = 0.0
    subtract(work.residual, work.rows, work.lam_step, work.root, work.sums)


@spliced
def expect(template: Template, work: Work) -> None:
    """The derivative of the residual by the place as the model expects it: that of the fitted appearance."""
    combine(work.slopes, work.lam, work.at_rest)
    mesh = template.warp
    vertices_at(mesh.rest, mesh.basis, work.p, work.points)
    pull(mesh.starts, mesh.triangles, mesh.rest, work.points, work.at_rest, work.expected)


@spliced
def sum_products(template: Template, work: Work, steep: np.ndarray, expected: np.ndarray) -> None:
    """Products of the derivatives by p: E'J, A'J and E'r, and E' with the columns of the angles."""
    mesh, n_p, n_free = template.warp, len(work.p), len(work.columns)
    for f in range(n_free if n_free else 1):
        weigh_columns(steep, work.root, work.residual, work.columns, f, work.fours)
        by_mesh = mesh.beta, mesh.starts, mesh.triangles, mesh.basis
        add_squares(*by_mesh, work.fours, expected, work.room, work.squares)
        to_parameters(work.squares, mesh.basis, work.carried_squares)
        for i in range(n_p if n_free else 0):
            work.hessian[i, n_p + f] = work.hessian[n_p + f, i] = work.carried_squares[i, n_p + 1]
    by_mesh = mesh.beta, mesh.starts, mesh.triangles
    add_modes(*by_mesh, work.fours, work.lines, work.room, work.products)
    to_parameters(work.products, mesh.basis, work.carried_products)
    for i in range(n_p):
        work.gradient[i] = work.carried_squares[i, n_p]
        for j in range(n_p):
            work.hessian[i, j] = work.carried_squares[i, j]
        for j in range(len(work.lam)):
            work.aj[j, i] = work.carried_products[i, j]


@spliced
def differentiate(template: Template, row: Row, work: Work, steep: np.ndarray, expected: np.ndarray) -> None:
    """Hessian E'QJ and gradient E'Qr (paper eq 10 and 5), of J by ``steep`` and E by ``expected``, (2 n k,) float32."""
    n_p, n_free = len(work.p), len(work.columns)
    for f in range(n_free):
        by = row.directions[0, f], row.directions[1, f], work.slope, work.values, work.growth, work.residual
        angle_column(*by, template.parts, work.angles[0], work.lam, work.columns[f])
    sum_products(template, work, steep, expected)
    for f in range(n_free):
        with_modes(work.rows, 1, work.root, work.columns[f], work.line, work.lam_step)
        for j in range(len(work.lam)):
            work.aj[j, n_p + f] = work.lam_step[j]
        dots(work.columns, work.columns[f], work.residual, work.root, work.hessian, work.gradient, f)
    eliminate(work.factor, work.aj, work.ar, work.hessian, work.gradient, work.eliminated, work.along)


@spliced
def movement(template: Template, work: Work) -> float:
    """Root mean square movement of the landmarks by a step, model pixels."""
    return template.warp.movement * length(work.step, len(work.p))
