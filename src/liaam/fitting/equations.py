"""Normal equations with the appearance eliminated (paper eq 5).

The residual is linear in lambda and linearised in q = (p, free angles):

    r(q + dq, lambda + dl) = r + J dq - A dl

All that a step needs are Gram matrices of [J | r] and A. QJ, with Q the projection on the complement of A, is never
formed: J'QJ = J'J - (A'J)' (A'A)^-1 (A'J). Small systems, in which calls of LAPACK take longer than solving.

Compiled loops write to arrays that they are given: what they would make themselves takes the compiler longer.
"""

import numpy as np

from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Double1, Double2
from liaam.kernels.jit import jit


@compiled
def cholesky(matrix: Double2) -> bool:
    """Turn the lower triangle of a matrix (n, n) into its Cholesky factor; False where it is not positive."""
    n = len(matrix)
    for j in range(n):
        own = matrix[j]
        for i in range(j, n):
            left, other = matrix[i, j], matrix[i]
            for k in range(j):
                left -= own[k] * other[k]
            if i > j:
                matrix[i, j] = left / own[j]
            elif left > 0.0:  # written so that NaN fails
                own[j] = np.sqrt(left)
            else:
                return False
    return True


@compiled
def solve_lower(factor: Double2, right: Double2) -> None:
    """Replace columns R (n, b) by L^-1 R, of a lower triangle (n, n)."""
    for i in range(len(factor)):
        row = right[i]
        for j in range(i):
            share, other = factor[i, j], right[j]
            for c in range(len(row)):
                row[c] -= share * other[c]
        scale = 1.0 / factor[i, i]
        for c in range(len(row)):
            row[c] *= scale


@compiled
def solve(factor: Double2, right: Double1) -> None:
    """Replace r (n,) by (L L')^-1 r."""
    n = len(factor)
    for i in range(n):
        for j in range(i):
            right[i] -= factor[i, j] * right[j]
        right[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        right[i] /= factor[i, i]
        for j in range(i):
            right[j] -= factor[i, j] * right[i]


@compiled
def multiply(left: Double2, right: Double2, out: Double2) -> None:
    """Product of two matrices (n, n)."""
    for i in range(len(left)):
        line, to = left[i], out[i]
        for j in range(len(line)):
            to[j] = 0.0
        for k in range(len(line)):
            share, row = line[k], right[k]
            for j in range(len(line)):
                to[j] += share * row[j]


@compiled
def eliminate(
    factor: Double2,
    aj: Double2,
    ar: Double1,
    hessian: Double2,
    gradient: Double1,
    carried: Double2,
    along: Double2,
) -> None:
    """Turn J'J (n_q, n_q) and J'r (n_q,) into the Hessian J'QJ, made symmetric, and the gradient J'Qr, in place.

    Parameters
    ----------
    factor : (m, m) float64
        Cholesky factor of A'A.
    aj, ar : (m, n_q), (m,) float64
        A'J and A'r.
    hessian, gradient : (n_q, n_q), (n_q,) float64
    carried, along : (m, n_q), (m, 1) float64
        Room.
    """
    n = len(gradient)
    for i in range(len(ar)):
        along[i, 0] = ar[i]
    copy_matrix(aj, carried)
    solve_lower(factor, carried)
    solve_lower(factor, along)
    for i in range(len(ar)):
        row = carried[i]
        for a in range(n):
            share, own = row[a], hessian[a]
            gradient[a] -= share * along[i, 0]
            for b in range(n):
                own[b] -= share * row[b]
    for a in range(n):
        for b in range(a):
            hessian[a, b] = hessian[b, a] = 0.5 * (hessian[a, b] + hessian[b, a])


@compiled
def length(numbers: Double1, n: int) -> float:
    """Length of the first n numbers as a vector."""
    squares = 0.0
    for i in range(n):
        squares += numbers[i] * numbers[i]
    return np.sqrt(squares)


@jit
def copy(source: np.ndarray, out: np.ndarray) -> None:
    """Copy an array (n,), of float32 or float64; compiled for each."""
    for i in range(len(source)):
        out[i] = source[i]


@compiled
def copy_matrix(source: Double2, out: Double2) -> None:
    """Copy an array (n, m)."""
    for i in range(len(source)):
        for j in range(source.shape[1]):
            out[i, j] = source[i, j]


@compiled
def clear(out: Double2) -> None:
    """Write noughts all over an array (n, m)."""
    for i in range(len(out)):
        for j in range(out.shape[1]):
            out[i, j] = 0.0
