"""Normal equations with the appearance eliminated (paper eq 5).

The residual is linear in lambda and linearised in q = (p, free angles):

    r(q + dq, lambda + dl) = r + J dq - A dl

With Q the projection on the complement of A, a step solves J'QJ dq = -J'Qr. Q and QJ are never formed, only Gram
matrices of the columns: J'QJ = J'J - (A'J)' (A'A)^-1 (A'J). The systems are so small that calls of LAPACK would take
longer than solving.

Compiled loops write to arrays passed to them: allocating inside them takes longer to compile.
"""

import numpy as np

from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Double1, Double2
from liaam.kernels.jit import jit


@compiled
def cholesky(matrix: Double2) -> bool:
    """Replace the lower triangle of a matrix (n, n) by its Cholesky factor; return False if not positive definite."""
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
    """Replace columns R (n, b) by L^-1 R, with L lower triangular (n, n)."""
    for i in range(len(factor)):
        row = right[i]
        for j in range(i):
            scale, other = factor[i, j], right[j]
            for c in range(len(row)):
                row[c] -= scale * other[c]
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
    """Write the product of two matrices (n, n) to a third."""
    for i in range(len(left)):
        line, to = left[i], out[i]
        for j in range(len(line)):
            to[j] = 0.0
        for k in range(len(line)):
            factor, row = line[k], right[k]
            for j in range(len(line)):
                to[j] += factor * row[j]


@compiled
def eliminate(
    factor: Double2,
    aj: Double2,
    ar: Double1,
    hessian: Double2,
    gradient: Double1,
    whitened: Double2,
    along: Double2,
) -> None:
    """Replace J'J (n_q, n_q) and J'r (n_q,) by the symmetrised Hessian J'QJ and the gradient J'Qr (eq 5), in place.

    Parameters
    ----------
    factor : (m, m) float64
        Cholesky factor of A'A.
    aj, ar : (m, n_q), (m,) float64
        A'J and A'r.
    hessian, gradient : (n_q, n_q), (n_q,) float64
    whitened, along : (m, n_q), (m, 1) float64
        Scratch: L^-1 A'J and L^-1 A'r.
    """
    n = len(gradient)
    for i in range(len(ar)):
        along[i, 0] = ar[i]
    copy_matrix(aj, whitened)
    solve_lower(factor, whitened)
    solve_lower(factor, along)
    for i in range(len(ar)):
        row = whitened[i]
        for a in range(n):
            scale, own = row[a], hessian[a]
            gradient[a] -= scale * along[i, 0]
            for b in range(n):
                own[b] -= scale * row[b]
    for a in range(n):
        for b in range(a):
            hessian[a, b] = hessian[b, a] = 0.5 * (hessian[a, b] + hessian[b, a])


@compiled
def length(numbers: Double1, n: int) -> float:
    """Return the Euclidean norm of the first n entries."""
    squares = 0.0
    for i in range(n):
        squares += numbers[i] * numbers[i]
    return np.sqrt(squares)


@jit
def copy(source: np.ndarray, out: np.ndarray) -> None:
    """Copy an array (n,) of float32 or float64."""
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
    """Fill an array (n, m) with zeros."""
    for i in range(len(out)):
        for j in range(out.shape[1]):
            out[i, j] = 0.0
