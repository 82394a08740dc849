"""Steps of the warp's parameters and the free angles (paper eq 5), the prior's scale, and the angles' observability.

Two kinds of step share the loop. With the image's own gradient, J, a step is a damped Gauss-Newton step (Levenberg).
Noise in the gradient makes these steps short, and gives the cost spurious local minima. With the gradient that the
model expects, E, the estimate is as accurate as the noise allows (Fisher scoring). The derivative of E'r is E'J. Unlike
E'E it contains the image's actual gradient, and unlike J'J it has no noise bias, so steps converge fast. The step uses
its symmetric part, raised to a fraction of E'E in directions in which it is smaller.
"""

import numpy as np

from liaam.fitting.equations import cholesky, solve, solve_lower, solve_raised
from liaam.fitting.level import LEAST, PULL, SCALE, Picture, Row, Template, Work
from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Bool1, Double1, Double2

DAMPING_FLOOR = 1e-9
"""Lower bound on the curvature that damping is relative to, as a fraction of the largest curvature."""

TEXTURE = 1e-10
"""Curvature per unit of weight below which an image has no texture."""

ROUNDING = 1e-7
"""Ridge on the expected curvature, as a fraction of the largest: the error of single precision."""

OBSERVABLE_APART = 2.0
"""As ``SolverOptions.observable``, for the image's angle relative to the model's. The object's colours determine it
even without a change of light."""

LEAST_PRECISION = 1e-9
"""Lower bound on the precision of a parameter, as a fraction of the largest precision."""


@compiled
def damped(work: Work, damping: float) -> bool:
    """Compute the Levenberg step, (H + damping diag H) step = -gradient, over the free entries; False if there is none.

    Hessian and gradient include the prior; the step of the other entries is 0.
    """
    hessian, gradient, free, matrix, step = work.hessian, work.gradient, work.free, work.small[0], work.step
    n, most = len(free), 0.0
    for i in range(n):
        step[i] = -gradient[i] if free[i] else 0.0
        most = hessian[i, i] if free[i] and hessian[i, i] > most else most
    for i in range(n):
        for j in range(n):
            matrix[i, j] = hessian[i, j] if free[i] and free[j] else 0.0
        least = DAMPING_FLOOR * most
        matrix[i, i] += damping * (hessian[i, i] if hessian[i, i] > least else least) + least if free[i] else 1.0
    if not most > 0.0 or not cholesky(matrix):
        for i in range(n):
            step[i] = 0.0
        return False
    solve(matrix, step)
    return True


@compiled
def raised(work: Work, damping: float) -> bool:
    """Compute the Newton step of a symmetric matrix H whose curvature is raised to a fraction of that of B.

    H is the Hessian and B the expected curvature (``work.damper``), both with the prior. Each generalised eigenvalue
    rho of H v = rho B v is replaced by max(rho, least) + damping, with the lower bound in ``work.scales``
    (:data:`liaam.fitting.level.LEAST_CURVATURE`). The step of entries that are not free is 0. False if there is none.
    """
    base, hessian, gradient, free, step = work.damper, work.hessian, work.gradient, work.free, work.step
    least, factor, matrix = work.scales[LEAST], work.small[0], work.small[1]
    n, largest = len(free), 0.0
    for i in range(n):
        largest = base[i, i] if free[i] and base[i, i] > largest else largest
    _take_free(base, free, ROUNDING * largest, factor)  # rounding may have made B indefinite
    _take_free(hessian, free, 0.0, matrix)
    for i in range(n):
        step[i] = -gradient[i] if free[i] else 0.0
        for j in range(n):
            matrix[i, j] -= least * factor[i, j]
    if not largest > 0.0:
        return False
    if cholesky(matrix):  # H >= least B already, as it is near the solution
        _take_free(hessian, free, 0.0, matrix)
        for i in range(n):
            for j in range(n):
                matrix[i, j] += damping * factor[i, j]
        found = cholesky(matrix)
        if found:
            solve(matrix, step)
        return found
    _take_free(hessian, free, 0.0, matrix)
    return cholesky(factor) and _whitened_step(work, damping)


@compiled
def _take_free(source: Double2, free: Bool1, more: float, out: Double2) -> None:
    """Copy the free entries, with ``more`` added to the diagonal; the others become those of the identity."""
    for i in range(len(free)):
        for j in range(len(free)):
            out[i, j] = source[i, j] if free[i] and free[j] else 0.0
        out[i, i] += more if free[i] else 1.0


@compiled
def _whitened_step(work: Work, damping: float) -> bool:
    """Compute the step with max(H, least B) + damping B, in coordinates in which B = L L' is the identity.

    Raising the pivots of a Cholesky factorisation instead (Gill and Murray) takes two steps more. Shifting all of H
    makes fits of unseen persons of IMM 0.1 % worse.
    """
    factor, matrix, step, least = work.small[0], work.small[1], work.step, work.scales[LEAST]
    n, finite = len(step), True
    solve_lower(factor, matrix)
    for i in range(n):
        for j in range(i):
            matrix[i, j], matrix[j, i] = matrix[j, i], matrix[i, j]
    solve_lower(factor, matrix)
    for i in range(n):
        for j in range(i):
            matrix[i, j] = matrix[j, i] = 0.5 * (matrix[i, j] + matrix[j, i])
            finite = finite and np.isfinite(matrix[i, j])
        finite = finite and np.isfinite(matrix[i, i])
        matrix[i, i] -= least
        for j in range(i):  # L^-1 times the right side
            step[i] -= factor[i, j] * step[j]
        step[i] /= factor[i, i]
    if not finite or not solve_raised(matrix, least + damping, work.spectrum, work.rotations, step):
        return False
    for i in range(n - 1, -1, -1):  # L'^-1 times that
        step[i] /= factor[i, i]
        for j in range(i):
            step[j] -= factor[i, j] * step[i]
    return True


@compiled
def next_scale(template: Template, work: Work, strength: float, unit: float) -> float:
    """Update the scale of the shape prior by one step of the evidence's fixed point (MacKay, Neural Comput. 4, 1992).

    The prior is a Student distribution: p ~ N(0, scale Lambda), where the scale is drawn for each shape with
    ``template.freedom`` degrees of freedom. Estimating the scale keeps a shape near the mean close to it, and leaves a
    distant one free to move. The image determines p by ``work.damper``, the Hessian of the squared residuals with the
    appearance eliminated, in which a residual of weight 1 has the variance ``unit``.

    Returns
    -------
    float
        (freedom + p' Lambda^-1 p) / (freedom + gamma), with gamma the number of parameters that the image determines.
        The last scale if this is not finite.
    """
    hessian, p, prior, matrix, inverse = work.damper, work.p, template.prior, work.small[0], work.small[1]
    freedom, scale = template.freedom, work.scales[SCALE]
    if not (unit > 0.0 and unit < np.inf):
        return scale
    n, largest = len(p), 0.0
    for i in range(len(matrix)):
        for j in range(len(matrix)):
            inverse[i, j] = 1.0 if i == j else 0.0
            matrix[i, j] = hessian[i, j] / unit if i < n and j < n else inverse[i, j]  # the angles are left out
        if i < n:
            matrix[i, i] += strength * prior[i] / scale
            largest = matrix[i, i] if matrix[i, i] > largest else largest
    for i in range(n):
        matrix[i, i] += LEAST_PRECISION * largest + 1e-300
    if not cholesky(matrix):
        return scale
    solve_lower(matrix, inverse)
    gamma, squares = 0.0, 0.0
    for i in range(n):
        if prior[i] > 0.0:
            variance = 0.0
            for j in range(n):
                variance += inverse[j, i] * inverse[j, i]
            gamma += 1.0 - strength * prior[i] / scale * variance
            squares += strength * prior[i] * p[i] * p[i]
    new = (freedom + squares) / (freedom + gamma)
    return new if new < np.inf else scale


@compiled
def free_entries(row: Row, work: Work, observable: float) -> bool:
    """Mark the entries of q that may move in ``work.free``: p and the observable angles; return whether all may.

    Without a change of light, a common turn of both angles changes only noise: |dr/dtheta|^2 is then
    |r|^2 |L'|^2 / |L|^2. The common turn is fixed if its curvature is less than ``observable`` times that, so that
    noise cannot make the angles drift. If both angles are free, theta_1 is then kept and theta_2 alone moves.
    """
    directions, hessian, free, metric, slope = row.directions, work.hessian, work.free, work.metric, work.slope
    for i in range(len(free)):
        free[i] = True
    n_free = directions.shape[1]
    if not n_free:
        return True
    n_p, by_angle, size = len(free) - n_free, 0.0, 0.0  # |L'|^2 and |L|^2
    for c in range(len(metric)):
        by_angle, size = by_angle + slope[c] * slope[c], size + metric[c] * metric[c]
    noise = work.sums[0] * by_angle / size + 1e-12 * work.sums[1]
    limit = OBSERVABLE_APART if observable > OBSERVABLE_APART else observable  # 0 keeps all free, as in the paper
    own = hessian[n_p, n_p]
    if n_free == 1:
        free[n_p] = own > (observable if directions[0, 0] != 0.0 else limit) * noise
        return bool(free[n_p])
    # In coordinates (common turn, theta_2 alone), with the second eliminated from the first.
    cross, apart = hessian[n_p, n_p + 1], hessian[n_p + 1, n_p + 1]
    together, mixed = own + 2.0 * cross + apart, cross + apart
    free[n_p + 1] = apart > limit * noise
    together -= mixed * mixed / apart if free[n_p + 1] else 0.0
    free[n_p] = free[n_p + 1] and together > observable * noise
    return bool(free[n_p])


@compiled
def has_texture(work: Work) -> bool:
    """Return whether image and model both have texture (prior and angles excluded), and all sums are finite.

    The image's own curvature is 0 for a flat image, the expected curvature for a mesh folded to zero area.
    """
    own, base, sums = work.hessian, work.base, work.sums
    curved, expected, finite = 0.0, 0.0, np.isfinite(sums[0])
    for i in range(len(own)):
        for j in range(len(own)):
            finite = finite and np.isfinite(own[i, j]) and np.isfinite(base[i, j])
    for i in range(len(work.p)):
        curved = abs(own[i, i]) if abs(own[i, i]) > curved else curved
        expected = base[i, i] if base[i, i] > expected else expected
    return finite and sums[1] > 0.0 and curved > TEXTURE * sums[1] and expected > 0.0


TO_AND_FRO = 0.5
"""Largest fraction of the last step that a step may undo. If more is undone, steps oscillate about a kink of the
bilinear interpolant, which noise sharpens; the lower bound on the curvature is then doubled."""


@compiled
def goes_back(step: Double1, last: Double1, metric: Double2) -> bool:
    """Return whether a step (n,) undoes more than :data:`TO_AND_FRO` of the last one, in a metric (n, n)."""
    along, squares = 0.0, 0.0
    for i in range(len(step)):
        for j in range(len(step)):
            along += step[i] * metric[i, j] * last[j]
            squares += last[i] * metric[i, j] * last[j]
    return along < -TO_AND_FRO * squares


@compiled
def squared_length(step: Double1, metric: Double2) -> float:
    """Return the squared length of a step (n,) in a metric (n, n)."""
    squares = 0.0
    for i in range(len(step)):
        for j in range(len(step)):
            squares += step[i] * metric[i, j] * step[j]
    return squares


@compiled
def add_prior(template: Template, work: Work, factor: float) -> None:
    """Add the prior on p, with its precision times a factor, to the normal equations, in units of squared residuals."""
    p, precision, metric, hessian, gradient = work.p, work.precision, work.damper, work.hessian, work.gradient
    for i in range(len(p)):
        precision[i] = factor * template.prior[i]
        metric[i, i] += precision[i]
        hessian[i, i] += precision[i]
        gradient[i] += precision[i] * p[i]


@compiled
def add_points(picture: Picture, work: Work) -> None:
    """Add the points of another landmarker to the normal equations: a Gaussian of p around ``picture.towards``."""
    pull, towards, p, variance = picture.pull, picture.towards, work.p, work.scales[PULL]
    metric, hessian, gradient = work.damper, work.hessian, work.gradient
    for i in range(len(pull)):
        for j in range(len(pull)):
            more = variance * pull[i, j]
            metric[i, j] += more
            hessian[i, j] += more
            gradient[i] += more * (p[j] - towards[j])


@compiled
def along_with(work: Work) -> None:
    """Compute the step of lambda (m,) in the joint system (eq 5), (A'A)^-1 (A'r + A'J dq)."""
    aj, step, out = work.aj, work.step, work.lam_step
    for j in range(len(out)):
        out[j] = work.ar[j]
        for i in range(len(step)):
            out[j] += aj[j, i] * step[i]
    solve(work.factor, out)


@compiled
def merit_of(template: Template, picture: Picture, work: Work) -> float:
    """Return the cost that an accepted step must not raise: mean squared residual plus the priors on p and lambda."""
    p, precision, lam, ridge, sums = work.p, work.precision, work.lam, template.ridge, work.sums
    pull, towards, variance = picture.pull, picture.towards, work.scales[PULL]
    squares = sums[0]
    for i in range(len(p)):
        squares += precision[i] * p[i] * p[i]
    for i in range(len(towards)):
        for j in range(len(towards)):
            squares += variance * (p[i] - towards[i]) * pull[i, j] * (p[j] - towards[j])
    for j in range(len(lam)):
        squares += ridge[j] * lam[j] * lam[j]
    return squares / sums[1] if sums[1] > 0.0 else np.inf


@compiled
def move(row: Row, work: Work) -> None:
    """Take a step (forward-additive), and keep the last state in ``work.before``."""
    p, angles, lam, before, step, lam_step = work.p, work.angles, work.lam, work.before, work.step, work.lam_step
    n = len(p)
    for i in range(n):
        before[i], p[i] = p[i], p[i] + step[i]
    for i in range(2):
        before[n + i] = angles[i]
        for f in range(row.directions.shape[1]):
            angles[i] += row.directions[i, f] * step[n + f]
    for j in range(len(lam)):
        before[n + 2 + j], lam[j] = lam[j], lam[j] + lam_step[j]


@compiled
def go_back(work: Work) -> None:
    """Undo :func:`move`."""
    p, angles, lam, before = work.p, work.angles, work.lam, work.before
    n = len(p)
    for i in range(n):
        p[i] = before[i]
    for i in range(2):
        angles[i] = before[n + i]
    for j in range(len(lam)):
        lam[j] = before[n + 2 + j]


@compiled
def record(n: int, work: Work) -> None:
    """Record cost, parameters and angles after n steps."""
    work.costs[n] = work.sums[0] / work.sums[1] if work.sums[1] > 0.0 else np.inf
    for i in range(len(work.p)):
        work.path[n, i] = work.p[i]
    work.turns[n, 0], work.turns[n, 1] = work.angles[0], work.angles[1]
