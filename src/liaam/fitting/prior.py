"""How far shapes of a picture lie from the mean, beyond what the variances of training say.

A Student distribution is a normal one whose variance is drawn for each shape: p ~ N(0, scale Lambda) with ``freedom``
degrees of freedom for the scale. Few degrees say that shapes come near and far; a picture's own scale is then
estimated with its shape, so that a shape that lies near the mean is held there, and one that lies far off may go.
"""

from math import isfinite

import numpy as np
from array_api_compat import array_namespace, device

from liaam.fitting.normal_equations import diagonal_of_inverse, on_diagonal

FLOOR = 1e-9
"""Least precision, as a share of the largest one."""


def next_scale(hessian, p, prior, unit, freedom: float, scale):
    """One step towards the scale under which a picture is most likely (MacKay, Neural Comput. 4 (1992) 415).

    Parameters
    ----------
    hessian : (..., n_q, n_q) float64
        Of the residual's squares, p first, with the appearance eliminated.
    p : (..., n_p) float64
    prior : (n_p,) float64
        Precision of p at a scale of 1; 0 for what has none.
    unit : (...,) float64
        Variance that a residual stands for.
    freedom : float
    scale : (...,) float64
        The last one.

    Returns
    -------
    (...,) float64
        (freedom + squares of p) / (freedom + number of parameters that the picture tells); the last scale where the
        picture tells nothing.
    """
    xp, n = array_namespace(hessian), p.shape[-1]
    held = prior / scale[..., None]
    seen = xp.all(xp.isfinite(hessian), axis=(-2, -1)) & xp.isfinite(unit) & (unit > 0)
    own = xp.where(seen[..., None, None], hessian[..., :n, :n], xp.zeros_like(hessian[..., :n, :n]))
    own = own / xp.where(seen, unit, xp.ones_like(unit))[..., None, None]
    diagonal = xp.linalg.diagonal(own) + held
    floor = FLOOR * xp.max(diagonal, axis=-1)[..., None] + 1e-300
    identity = xp.eye(n, dtype=own.dtype, device=device(own))
    spread = xp.linalg.diagonal(xp.linalg.inv(own + (held + floor)[..., None, :] * identity))
    told = xp.sum(xp.where(prior > 0, 1.0 - held * spread, xp.zeros_like(held)), axis=-1)
    squares = xp.sum(prior * p**2, axis=-1)
    new = (freedom + squares) / (freedom + told)
    return xp.where(seen & xp.isfinite(new), new, scale)


def next_scale_of_one(
    hessian: np.ndarray, p: np.ndarray, prior: np.ndarray, unit: float, freedom: float, scale: float
) -> float:
    """As :func:`next_scale`, of one picture: without what batches need, in a tenth of the time."""
    if not (isfinite(unit) and unit > 0):
        return scale
    held = prior / scale
    precision = hessian[: len(p), : len(p)] / unit
    diagonal = on_diagonal(precision)  # a view
    diagonal += held
    diagonal += FLOOR * diagonal.max() + 1e-300
    spread = diagonal_of_inverse(precision)
    if spread is None:
        return scale
    told = np.count_nonzero(prior) - float(held @ spread)
    new = (freedom + float(prior @ np.square(p))) / (freedom + told)
    return new if isfinite(new) else scale
