"""Fast steps of small systems, in which checks and calls take longer than solving (contract: ``reference``)."""

import numpy as np

from liaam.jit import jit as _jit
from liaam.kernels import reference


@_jit
def _solve(matrix, right):
    """Turn a matrix's lower triangle into its Cholesky factor and what is on the right into the solution, if it can."""
    n = len(right)
    for i in range(n):
        for j in range(i + 1):
            left = matrix[i, j]
            for k in range(j):
                left -= matrix[i, k] * matrix[j, k]
            if j < i:
                matrix[i, j] = left / matrix[j, j]
                right[i] -= matrix[i, j] * right[j]
            elif left > 0.0:
                matrix[i, i] = np.sqrt(left)
                right[i] /= matrix[i, i]
            else:
                return False
    for i in range(n - 1, -1, -1):
        right[i] /= matrix[i, i]
        for j in range(i):
            right[j] -= matrix[i, j] * right[i]
    return True


@_jit
def _damped_step(hessian, gradient, precision, free, damping, step):
    n, largest = len(free), 0.0
    for i in range(n):
        largest = max(largest, hessian[i, i] + precision[i] if free[i] else 0.0)
    floor, matrix = 1e-9 * largest, np.empty((n, n))
    for i in range(n):
        for j in range(i):
            matrix[i, j] = hessian[i, j] if free[i] and free[j] else 0.0
        own = hessian[i, i] + precision[i]
        matrix[i, i] = own + damping * max(own, floor) + floor if free[i] else 1.0
        step[i] = -gradient[i] if free[i] else 0.0
    return _solve(matrix, step)


def damped_step(
    hessian: np.ndarray, gradient: np.ndarray, precision: np.ndarray, free: np.ndarray, damping: float
) -> np.ndarray | None:
    """See :func:`liaam.kernels.reference.damped_step`."""
    step, hessian = np.empty(len(free)), np.ascontiguousarray(hessian)
    if _damped_step(hessian, gradient, precision, free, float(damping), step):
        return step
    return reference.damped_step(hessian, gradient, precision, free, damping)
