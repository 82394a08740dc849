"""Steps of the warp's parameters and the free angles (paper eq 5), the prior's scale, and the angles' observability.

Two kinds of step share the loop. With the image's own gradient, J, a step is a damped Gauss-Newton step (Levenberg).
Noise in the gradient makes these steps short, and gives the cost spurious local minima. With the gradient that the
model expects, E, the estimate is as accurate as the noise allows (Fisher scoring). The derivative of E'r is E'J. Unlike
E'E it contains the image's actual gradient, and unlike J'J it has no noise bias, so steps converge fast. The step uses
its symmetric part, raised to a fraction of E'E in directions in which it is smaller.
"""

import numpy as np

from liaam.fitting.equations import cholesky, solve, solve_lower, solve_raised
from liaam.fitting.level import LEAST, Work
from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Bool1, Double1, Double2, Single1

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
def damped_step(
    hessian: Double2, gradient: Double1, free: Bool1, damping: float, matrix: Double2, step: Double1
) -> bool:
    """Compute the Levenberg step, (H + damping diag H) step = -gradient, over free entries; False if there is none.

    Parameters
    ----------
    hessian, gradient : (n, n), (n,) float64
        Including the prior.
    free : (n,) bool
        Entries that may move; the step of the others is 0.
    damping : float
    matrix, step : (n, n), (n,) float64
        Scratch, and the step.
    """
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
def raised_step(
    base: Double2,
    hessian: Double2,
    gradient: Double1,
    free: Bool1,
    least: float,
    damping: float,
    factor: Double2,
    matrix: Double2,
    lines: Double2,
    rotations: Double2,
    step: Double1,
) -> bool:
    """Compute the Newton step of a symmetric matrix H whose curvature is raised to a fraction of that of B.

    Each generalised eigenvalue rho of H v = rho B v is replaced by max(rho, least) + damping. False if there is none.

    Parameters
    ----------
    base, hessian, gradient : (n, n), (n, n), (n,) float64
        B, H and the gradient, including the prior.
    free : (n,) bool
        Entries that may move; the step of the others is 0.
    least, damping : float
        Lower bound (:data:`liaam.fitting.level.LEAST_CURVATURE`) and damping, as fractions of B.
    factor, matrix, lines, rotations : (n, n), (n, n), (4, n), (3 n^2, 3) float64
        Scratch.
    step : (n,) float64
    """
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
    return cholesky(factor) and _whitened_step(factor, matrix, least, damping, lines, rotations, step)


@compiled
def _take_free(source: Double2, free: Bool1, more: float, out: Double2) -> None:
    """Copy the free entries, with ``more`` added to the diagonal; the others become those of the identity."""
    for i in range(len(free)):
        for j in range(len(free)):
            out[i, j] = source[i, j] if free[i] and free[j] else 0.0
        out[i, i] += more if free[i] else 1.0


@compiled
def _whitened_step(
    factor: Double2, matrix: Double2, least: float, damping: float, lines: Double2, rotations: Double2, step: Double1
) -> bool:
    """Compute the step with max(H, least B) + damping B, in coordinates in which B = L L' is the identity.

    Raising the pivots of a Cholesky factorisation instead (Gill and Murray) takes two steps more. Shifting all of H
    makes fits of unseen persons of IMM 0.1 % worse.
    """
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
    if not finite or not solve_raised(matrix, least + damping, lines, rotations, step):
        return False
    for i in range(n - 1, -1, -1):  # L'^-1 times that
        step[i] /= factor[i, i]
        for j in range(i):
            step[j] -= factor[i, j] * step[i]
    return True


@compiled
def next_scale(
    hessian: Double2,
    p: Double1,
    prior: Double1,
    strength: float,
    unit: float,
    freedom: float,
    scale: float,
    matrix: Double2,
    inverse: Double2,
) -> float:
    """Update the scale of the shape prior by one step of the evidence's fixed point (MacKay, Neural Comput. 4, 1992).

    The prior is a Student distribution: p ~ N(0, scale Lambda), where the scale is drawn for each shape with
    ``freedom`` degrees of freedom. Estimating the scale keeps a shape near the mean close to it, and leaves a distant
    one free to move.

    Parameters
    ----------
    hessian : (n_q, n_q) float64
        Hessian of the squared residuals, p first, with the appearance eliminated.
    p, prior : (n_p,) float64
        Parameters, and their precision at a scale of 1; 0 for none.
    strength : float
        Strength of the prior.
    unit : float
        Variance of a residual of weight 1.
    freedom, scale : float
        Degrees of freedom, and the last scale.
    matrix, inverse : (n_q, n_q) float64
        Scratch.

    Returns
    -------
    float
        (freedom + p' Lambda^-1 p) / (freedom + gamma), with gamma the number of parameters that the image determines.
        The last scale if this is not finite.
    """
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
def free_entries(
    directions: Double2,
    metric: Single1,
    slope: Single1,
    hessian: Double2,
    sums: Double1,
    observable: float,
    free: Bool1,
) -> bool:
    """Mark the entries of q that may move, (n_q,) bool: p and the observable angles; return whether all may.

    Without a change of light, a common turn of both angles changes only noise: |dr/dtheta|^2 is then
    |r|^2 |L'|^2 / |L|^2. The common turn is fixed if its curvature is less than ``observable`` times that, so that
    noise cannot make the angles drift. If both angles are free, theta_1 is then kept and theta_2 alone moves.
    """
    for i in range(len(free)):
        free[i] = True
    n_free = directions.shape[1]
    if not n_free:
        return True
    n_p, image_slopes, size = len(free) - n_free, 0.0, 0.0
    for c in range(len(metric)):
        image_slopes, size = image_slopes + slope[c] * slope[c], size + metric[c] * metric[c]
    noise = sums[0] * image_slopes / size + 1e-12 * sums[1]
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
def has_texture(own: Double2, base: Double2, sums: Double1, n_p: int) -> bool:
    """Return whether image and model both have texture (prior and angles excluded), and all sums are finite.

    The image's own curvature is 0 for a flat image, the expected curvature for a mesh folded to zero area.
    """
    curved, expected, finite = 0.0, 0.0, np.isfinite(sums[0])
    for i in range(len(own)):
        for j in range(len(own)):
            finite = finite and np.isfinite(own[i, j]) and np.isfinite(base[i, j])
    for i in range(n_p):
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
def add_prior(
    prior: Double1,
    strength: float,
    variance: float,
    p: Double1,
    precision: Double1,
    metric: Double2,
    hessian: Double2,
    gradient: Double1,
) -> None:
    """Add the prior on p to the normal equations, in place and in units of squared residuals.

    Parameters
    ----------
    prior : (n_p,) float64
        Precision of p.
    strength, variance : float
        Factors on the precision.
    p : (n_p,) float64
    precision : (n_p,) float64
        Output: the product of the precision and both factors.
    metric, hessian, gradient : (n_q, n_q), (n_q, n_q), (n_q,) float64
        Expected Hessian, Hessian and gradient.
    """
    for i in range(len(p)):
        precision[i] = strength * variance * prior[i]
        metric[i, i] += precision[i]
        hessian[i, i] += precision[i]
        gradient[i] += precision[i] * p[i]


@compiled
def add_points(
    pull: Double2,
    towards: Double1,
    variance: float,
    p: Double1,
    metric: Double2,
    hessian: Double2,
    gradient: Double1,
) -> None:
    """Add the points of another landmarker to the normal equations: a Gaussian around ``towards``, in place.

    Parameters
    ----------
    pull, towards : (n_p, n_p), (n_p,) float64
        Precision and mean of p; empty for none.
    variance : float
        Factor that converts the precision to units of squared residuals.
    p, metric, hessian, gradient
        See :func:`add_prior`.
    """
    for i in range(len(pull)):
        for j in range(len(pull)):
            more = variance * pull[i, j]
            metric[i, j] += more
            hessian[i, j] += more
            gradient[i] += more * (p[j] - towards[j])


@compiled
def along_with(factor: Double2, ar: Double1, aj: Double2, step: Double1, out: Double1) -> None:
    """Compute the step of lambda (m,) in the joint system (eq 5), (A'A)^-1 (A'r + A'J dq)."""
    for j in range(len(ar)):
        out[j] = ar[j]
        for i in range(len(step)):
            out[j] += aj[j, i] * step[i]
    solve(factor, out)


@compiled
def merit_of(
    sums: Double1,
    p: Double1,
    precision: Double1,
    lam: Double1,
    ridge: Double1,
    pull: Double2,
    towards: Double1,
    variance: float,
) -> float:
    """Return the cost that an accepted step must not raise: mean squared residual plus the priors on p and lambda."""
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
def move(
    directions: Double2,
    step: Double1,
    lam_step: Double1,
    p: Double1,
    angles: Double1,
    lam: Double1,
    before: Double1,
) -> None:
    """Take a step (forward-additive), in place, and keep the last state in ``before`` (n_p + 2 + m,)."""
    n = len(p)
    for i in range(n):
        before[i], p[i] = p[i], p[i] + step[i]
    for i in range(2):
        before[n + i] = angles[i]
        for f in range(directions.shape[1]):
            angles[i] += directions[i, f] * step[n + f]
    for j in range(len(lam)):
        before[n + 2 + j], lam[j] = lam[j], lam[j] + lam_step[j]


@compiled
def go_back(before: Double1, p: Double1, angles: Double1, lam: Double1) -> None:
    """Undo :func:`move`."""
    n = len(p)
    for i in range(n):
        p[i] = before[i]
    for i in range(2):
        angles[i] = before[n + i]
    for j in range(len(lam)):
        lam[j] = before[n + 2 + j]


@compiled
def record(
    n: int,
    p: Double1,
    angles: Double1,
    sums: Double1,
    costs: Double1,
    path: Double2,
    turns: Double2,
) -> None:
    """Record cost, parameters and angles after n steps."""
    costs[n] = sums[0] / sums[1] if sums[1] > 0.0 else np.inf
    for i in range(len(p)):
        path[n, i] = p[i]
    turns[n, 0], turns[n, 1] = angles[0], angles[1]


@compiled
def damped(work: Work, damping: float) -> bool:
    """Write the damped Gauss-Newton step to ``work.step``; return False if there is none."""
    return damped_step(work.hessian, work.gradient, work.free, damping, work.small[0], work.step)


@compiled
def raised(work: Work, damping: float) -> bool:
    """Write the step with the expected gradient to ``work.step``; return False if there is none."""
    expected, least, step = work.damper, work.scales[LEAST], work.step
    hessian, gradient, free, factor, matrix = work.hessian, work.gradient, work.free, work.small[0], work.small[1]
    lines, rotations = work.spectrum, work.rotations
    return raised_step(expected, hessian, gradient, free, least, damping, factor, matrix, lines, rotations, step)
