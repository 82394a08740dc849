"""Normal equations with the appearance eliminated (paper eq 5).

The residual is linear in lambda and linearised in q = (p, free angles):

    r(q + dq, lambda + dl) = r + J dq - A dl

With Q the projection on the complement of A, a step solves J'QJ dq = -J'Qr. Q and QJ are never formed, only Gram
matrices of the columns: J'QJ = J'J - (A'J)' (A'A)^-1 (A'J). The systems are so small that calls of LAPACK would take
longer than solving.

Compiled loops write to arrays passed to them: allocating inside them takes longer to compile.
"""

import numpy as np

from liaam.fitting.level import Work
from liaam.kernels.compiled import compiled, inlined
from liaam.kernels.fields import Double1, Double2
from liaam.kernels.vectors import SIZE, every, load, store


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


@inlined
def add_row(out, row, scale):
    """Add a multiple of a row."""
    for j in range(len(out)):
        out[j] += scale * row[j]


@inlined
def add_rows(out, rows, i, a, b, c, d):
    """Add multiples of rows i to i + 3: each number of the sum is loaded and stored once for four products."""
    row_a, row_b, row_c, row_d = rows[i], rows[i + 1], rows[i + 2], rows[i + 3]
    for j in range(len(out)):
        out[j] += (a * row_a[j] + b * row_b[j]) + (c * row_c[j] + d * row_d[j])


@compiled
def solve_lower(factor: Double2, right: Double2) -> None:
    """Replace columns R (n, b) by L^-1 R, with L lower triangular (n, n)."""
    for i in range(len(factor)):
        own, row, even = factor[i], right[i], i - i % 4
        for j in range(0, even, 4):
            add_rows(row, right, j, -own[j], -own[j + 1], -own[j + 2], -own[j + 3])
        for j in range(even, i):
            add_row(row, right[j], -own[j])
        scale = 1.0 / own[i]
        for c in range(len(row)):
            row[c] *= scale


@compiled
def multiply(left: Double2, right: Double2, out: Double2) -> None:
    """Write the product L'R of L (n, a or more) and R (n, b) to a matrix (a, b).

    Blocks of four rows and eight columns are summed in registers. The last block begins earlier, to fit in.
    """
    n, last, wide = len(left), len(out) - 1, right.shape[1]
    if wide < SIZE:
        clear(out)
        for i in range(n):
            for j in range(len(out)):
                add_row(out[j], right[i], left[i, j])
        return
    for j in range(0, len(out), 4):
        k, m, o = j + 1 if j < last else last, j + 2 if j + 1 < last else last, j + 3 if j + 2 < last else last
        for column in range(0, wide, SIZE):
            at = column if column + SIZE <= wide else wide - SIZE
            a = b = c = d = every(0.0)
            for i in range(n):
                scales, row = left[i], load(right[i], at)
                a, b, c, d = a + scales[j] * row, b + scales[k] * row, c + scales[m] * row, d + scales[o] * row
            store(out[j], at, a)
            store(out[k], at, b)
            store(out[m], at, c)
            store(out[o], at, d)


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


TINY = 1e-13
"""Entries beside the diagonal that count as 0, as a fraction of the largest entry."""


@compiled
def tridiagonalise(matrix: Double2, lines: Double2, right: Double1) -> None:
    """Reduce a symmetric matrix M to a tridiagonal T = Q'MQ by Householder's reflections, and replace r by Q'r.

    Parameters
    ----------
    matrix : (n, n) float64
        M; afterwards row k holds, right of the diagonal, the vector v of reflection k, I - f v v'.
    lines : (4, n) float64
        Outputs: the diagonal of T, the entries beside it, and the factors f; and scratch.
    right : (n,) float64
    """
    n, diagonal, beside, factors, moved = len(right), lines[0], lines[1], lines[2], lines[3]
    for k in range(n):
        v, squares, along = matrix[k], 0.0, 0.0
        diagonal[k], beside[k], factors[k] = v[k], 0.0, 0.0
        for j in range(k + 1, n):
            squares += v[j] * v[j]
        if not squares > 1e-300:
            continue
        first = v[k + 1]
        beside[k] = -np.sqrt(squares) if first > 0.0 else np.sqrt(squares)  # the sign without cancellation
        v[k + 1] = first - beside[k]
        factors[k] = 1.0 / (squares - first * beside[k])
        for i in range(k + 1, n):
            row, total = matrix[i], 0.0
            for j in range(k + 1, n):
                total += row[j] * v[j]
            moved[i] = factors[k] * total
            along += moved[i] * v[i]
        for i in range(k + 1, n):
            moved[i] -= 0.5 * factors[k] * along * v[i]
        for i in range(k + 1, n):
            row, own, other = matrix[i], v[i], moved[i]
            for j in range(k + 1, n):
                row[j] -= own * moved[j] + other * v[j]
        reflect(v, k + 1, factors[k], right)


@compiled
def reflect(v: Double1, first: int, factor: float, right: Double1) -> None:
    """Replace r (n,) by (I - f v v') r; v begins at index ``first``."""
    along = 0.0
    for j in range(first, len(right)):
        along += v[j] * right[j]
    for j in range(first, len(right)):
        right[j] -= factor * along * v[j]


@compiled
def diagonalise(lines: Double2, rotations: Double2, right: Double1) -> int:
    """Reduce a tridiagonal T to a diagonal D = S'TS by implicit QL steps, and replace r by S'r.

    Parameters
    ----------
    lines : (4, n) float64
        See :func:`tridiagonalise`; the first becomes the diagonal of D.
    rotations : (3 n^2, 3) float64
        Output: cosine, sine and index of each rotation of two neighbours, whose product is S.
    right : (n,) float64

    Returns
    -------
    int
        Number of rotations; -1 if there is no room for more.
    """
    n, d, e, count, least = len(right), lines[0], lines[1], 0, 0.0
    for i in range(n):
        size = abs(d[i]) + abs(e[i])
        least = TINY * size if TINY * size > least else least
    for low in range(n):
        while True:
            high = low
            while high + 1 < n and abs(e[high]) > least:
                high += 1
            if high == low:
                break
            if count + high - low > len(rotations):
                return -1
            shift = (d[low + 1] - d[low]) / (2.0 * e[low])
            root = np.sqrt(shift * shift + 1.0)
            g, s, c, back = d[high] - d[low] + e[low] / (shift + (root if shift >= 0.0 else -root)), 1.0, 1.0, 0.0
            for i in range(high - 1, low - 1, -1):
                f, b = s * e[i], c * e[i]
                size = np.sqrt(f * f + g * g)
                e[i + 1] = size
                inverse = 1.0 / size if size > 0.0 else 0.0
                s, c = f * inverse, g * inverse if size > 0.0 else 1.0
                g = d[i + 1] - back
                more = (d[i] - g) * s + 2.0 * c * b
                back = s * more
                d[i + 1], g = g + back, c * more - b
                rotations[count, 0], rotations[count, 1], rotations[count, 2] = c, s, float(i)
                count += 1
                right[i + 1], right[i] = s * right[i] + c * right[i + 1], c * right[i] - s * right[i + 1]
            d[low], e[low], e[high] = d[low] - back, g, 0.0
    return count


@compiled
def solve_raised(matrix: Double2, least: float, lines: Double2, rotations: Double2, right: Double1) -> bool:
    """Replace r (n,) by (M+ + least)^-1 r, where M+ is a symmetric M with 0 in place of its negative eigenvalues.

    Only r passes the transformations that make M diagonal (Golub and Van Loan, Matrix Computations, section 8.3), and
    returns through them: eigenvectors are not needed. False if it fails; M is overwritten.
    """
    tridiagonalise(matrix, lines, right)
    n, count = len(right), diagonalise(lines, rotations, right)
    for i in range(n):
        right[i] /= (lines[0, i] if lines[0, i] > 0.0 else 0.0) + least
    for t in range(count - 1, -1, -1):
        c, s, i = rotations[t, 0], rotations[t, 1], int(rotations[t, 2])
        right[i], right[i + 1] = c * right[i] + s * right[i + 1], c * right[i + 1] - s * right[i]
    for k in range(n - 1, -1, -1):
        reflect(matrix[k], k + 1, lines[2, k], right)
    return count >= 0 and np.isfinite(right[0])


@compiled
def eliminate(work: Work) -> None:
    """Replace J'J and J'r by the symmetrised Hessian J'QJ and the gradient J'Qr (eq 5), in place."""
    factor, aj, ar, hessian, gradient = work.factor, work.aj, work.ar, work.hessian, work.gradient
    whitened, along, room = work.eliminated, work.along, work.small[0]  # L^-1 A'J, L^-1 A'r, and a product
    n = len(gradient)
    for i in range(len(ar)):
        along[i, 0] = ar[i]
    copy_matrix(aj, whitened)
    solve_lower(factor, whitened)
    solve_lower(factor, along)
    for i in range(len(ar)):
        add_row(gradient, whitened[i], -along[i, 0])
    multiply(whitened, whitened, room)
    for a in range(n):
        for b in range(a + 1):
            hessian[a, b] = hessian[b, a] = 0.5 * (hessian[a, b] + hessian[b, a]) - room[a, b]


@compiled
def length(numbers: Double1, n: int) -> float:
    """Return the Euclidean norm of the first n entries."""
    squares = 0.0
    for i in range(n):
        squares += numbers[i] * numbers[i]
    return np.sqrt(squares)


@inlined
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
