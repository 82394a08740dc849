"""The one finite-difference checker: every Jacobian of the library passes through it."""

from collections.abc import Callable

import numpy as np


def assert_jacobian(
    function: Callable[[np.ndarray], np.ndarray],
    jacobian: np.ndarray,
    at: np.ndarray,
    *,
    steps: float | np.ndarray,
    tolerance: float = 1e-6,
    valid: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> None:
    """Compare a Jacobian with central differences.

    Parameters
    ----------
    function : callable
        Maps (n,) parameters to (m,) values.
    jacobian : (m, n)
        Its derivative at ``at``.
    at : (n,)
    steps : float or (n,)
        Half the distance between the two points of each difference.
    tolerance : float
        Largest error, relative to the largest entry of the column.
    valid : callable, optional
        Maps the two points of a difference to the mask (m,) of values that are smooth between them.
    """
    at = np.asarray(at, dtype=np.float64)
    assert jacobian.shape[1] == len(at)
    for i, step in enumerate(np.broadcast_to(steps, at.shape)):
        low, high = at.copy(), at.copy()
        low[i] -= step
        high[i] += step
        rows = np.ones(len(jacobian), dtype=bool) if valid is None else valid(low, high)
        assert rows.mean() > 0.5, f"column {i}: only {rows.mean():.0%} of the values can be checked"
        numeric = (function(high) - function(low))[rows] / (2 * step)
        analytic = jacobian[rows, i]
        scale = np.abs(analytic).max()
        assert scale > 0, f"column {i} is zero"
        error = np.abs(numeric - analytic).max() / scale
        assert error <= tolerance, f"column {i} is off by {error:.1e} of its largest entry"
