"""Derivatives of the residual, and their products (paper eq 10).

A pixel moves only with the three vertices of its triangle (eq 3), so its row of derivatives by the vertices,

    dr(x) / d(vertex v) = beta_v(x) image_slopes(x),

has six non-zero entries. Products are summed by triangle, and mapped to the warp's parameters at the end.

Compiled; arrays of pixels are flat, residual e = i k + r is row r of pixel i. :mod:`liaam.fitting.reference` defines
the result of each function.
"""

import numpy as np

from liaam.fitting.equations import clear
from liaam.fitting.level import Row, Template, Work
from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Double1, F, Single1, Single2
from liaam.kernels.vectors import SIZE, every, halves, load, store

FLAT = 0.05
"""Fraction of its rest area below which a triangle counts as degenerate; its gradient is set to 0."""

PAIR = ((0, 1, 2), (1, 3, 4), (2, 4, 5))
"""Index of each pair of a triangle's corners."""


@compiled
def combine(rows: Single2, lam: Double1, out: Single1) -> None:
    """Write the first row plus lambda times the others, of rows (1 + m, e) float32 (eq 4)."""
    first = rows[0]
    for e in range(len(out)):
        out[e] = first[e]
    for j in range(len(lam)):
        row, scale = rows[1 + j], F(lam[j])
        for e in range(len(out)):
            out[e] += scale * row[e]


@compiled
def pull(template: Template, work: Work) -> None:
    """Transform gradients from the reference frame to the image: if V(W(x; p)) = A(x), grad V = (dW/dx)^-T grad A.

    Reads ``work.appearance_slopes``, for each pixel k derivatives by x and k by y, and writes ``work.expected``, for
    each residual its derivatives by x and y.
    """
    starts, triangles, rest = template.warp.starts, template.warp.triangles, template.warp.rest
    points, slopes, out = work.points, work.appearance_slopes, work.expected
    n_pixels = starts[len(starts) - 1]
    k = len(slopes) // (2 * n_pixels) if n_pixels else 0
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        x0, y0 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        x1, y1 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        u0, v0 = rest[b, 0] - rest[a, 0], rest[b, 1] - rest[a, 1]
        u1, v1 = rest[c, 0] - rest[a, 0], rest[c, 1] - rest[a, 1]
        twice, least = x0 * y1 - x1 * y0, FLAT * abs(u0 * v1 - u1 * v0)
        factor = 1.0 / twice if (twice > least) | (twice < -least) else 0.0  # written so that NaN counts as flat
        xx, xy = F((u0 * y1 - u1 * y0) * factor), F((u1 * x0 - u0 * x1) * factor)
        yx, yy = F((v0 * y1 - v1 * y0) * factor), F((v1 * x0 - v0 * x1) * factor)
        for i in range(starts[t], starts[t + 1]):
            for r in range(k):
                x, y, e = slopes[2 * i * k + r], slopes[(2 * i + 1) * k + r], i * k + r
                out[2 * e], out[2 * e + 1] = xx * x + yx * y, xy * x + yy * y


@compiled
def angle_column(template: Template, row: Row, work: Work, f: int) -> None:
    """Derivative of the weighted residual by free angle f, divided by the square root of the weight (eq 10).

    The columns are L'(theta_2) log I and -L'(theta_1) A.
    """
    slope, values, own_derivative, residual = work.slope, work.values, work.own_derivative, work.residual
    by_model, by_image, theta = row.directions[0, f], row.directions[1, f], work.angles[0]
    parts, lam, out = template.parts, work.lam, work.columns[f]
    k = len(slope) // SIZE
    for e in range(len(out)):
        i, r, change = e // k, e % k, F(0.0)
        for c in range(SIZE - 1):
            change += slope[SIZE * r + c] * values[SIZE * i + c]
        if len(own_derivative):
            change += own_derivative[e] * residual[e]
        out[e] = F(by_image) * change
    along, across = F(by_model * np.cos(theta)), F(by_model * np.sin(theta))
    for j in range(parts.shape[1]):
        scale = F(1.0) if j == 0 else F(lam[j - 1])
        by_cos, by_sin = parts[1, j], parts[2, j]
        for e in range(len(out)):
            out[e] -= scale * (along * by_sin[e] - across * by_cos[e])


@compiled
def weigh_columns(work: Work, image_slopes: Single1, f: int) -> None:
    """Write w^2 (slope by x, by y, residual, angle column f or 0) for each residual to ``work.fours``."""
    root, residual, columns, fours = work.root, work.residual, work.columns, work.fours
    for e in range(len(root)):
        square = root[e] * root[e]
        fours[4 * e], fours[4 * e + 1] = square * image_slopes[2 * e], square * image_slopes[2 * e + 1]
        fours[4 * e + 2] = square * residual[e]
        fours[4 * e + 3] = square * columns[f, e] if len(columns) else F(0.0)


@compiled
def dots(work: Work, f: int) -> None:
    """Write the weighted products of angle column f with all angle columns to E'J, and with the residual to E'r."""
    columns, column, residual, root = work.columns, work.columns[f], work.residual, work.root
    hessian, gradient = work.hessian, work.gradient
    n_p = len(gradient) - len(columns)
    for g in range(len(columns) + 1):
        product, other = 0.0, columns[g] if g < len(columns) else residual
        for e in range(len(column)):
            product += np.float64(root[e] * root[e] * column[e] * other[e])
        if g < len(columns):
            hessian[n_p + f, n_p + g] = product
        else:
            gradient[n_p + f] = product


@compiled
def add_squares(template: Template, work: Work, expected: Single1) -> None:
    """Sum E'J, E'r and E' times an angle column by vertex, from the output of :func:`weigh_columns`.

    ``expected`` (2 n k,) float32 is the expected spatial gradient. The sums are for x and y of each vertex: E'J by the
    warp's parameters, E'r, and E' times the angle column.
    """
    beta, starts, triangles = template.warp.beta, template.warp.starts, template.warp.triangles
    basis, fours, room, lines = template.warp.basis, work.fours, work.room, work.squares
    clear(lines)
    wide, n = basis.shape[1], starts[len(starts) - 1]
    k = len(expected) // (2 * n) if n else 0
    for t in range(len(triangles)):
        if starts[t] == starts[t + 1]:
            continue
        aa = ab = ac = bb = bc = cc = every(F(0.0))
        for i in range(starts[t], starts[t + 1]):
            a, b, c = beta[i, 0], beta[i, 1], beta[i, 2]
            by_x = by_y = every(F(0.0))
            for e in range(i * k, i * k + k):
                four = load(fours, 4 * e)
                by_x = by_x + expected[2 * e] * four
                by_y = by_y + expected[2 * e + 1] * four
            both = halves(by_x, by_y)
            by_a, by_b, by_c = a * both, b * both, c * both
            aa, ab, ac = aa + a * by_a, ab + a * by_b, ac + a * by_c
            bb, bc, cc = bb + b * by_b, bc + b * by_c, cc + c * by_c
        store(room, 0, aa)
        store(room, 8, ab)
        store(room, 16, ac)
        store(room, 24, bb)
        store(room, 32, bc)
        store(room, 40, cc)
        at_a, at_b, at_c = 2 * triangles[t, 0], 2 * triangles[t, 1], 2 * triangles[t, 2]
        xa, ya, xb, yb = basis[at_a], basis[at_a + 1], basis[at_b], basis[at_b + 1]
        xc, yc = basis[at_c], basis[at_c + 1]
        for corner in range(3):
            for axis in range(2):
                own, (pa, pb, pc) = lines[2 * triangles[t, corner] + axis], PAIR[corner]
                pa, pb, pc = SIZE * pa + 4 * axis, SIZE * pb + 4 * axis, SIZE * pc + 4 * axis
                by_xa, by_ya, by_xb = np.float64(room[pa]), np.float64(room[pa + 1]), np.float64(room[pb])
                by_yb, by_xc, by_yc = np.float64(room[pb + 1]), np.float64(room[pc]), np.float64(room[pc + 1])
                for j in range(0, wide, SIZE):
                    total = load(own, j) + by_xa * load(xa, j) + by_ya * load(ya, j) + by_xb * load(xb, j)
                    store(own, j, total + by_yb * load(yb, j) + by_xc * load(xc, j) + by_yc * load(yc, j))
                # Barycentric weights sum to 1, so the sum over the other corner drops out.
                own[wide] += np.float64(room[pa + 2]) + room[pb + 2] + room[pc + 2]
                own[wide + 1] += np.float64(room[pa + 3]) + room[pb + 3] + room[pc + 3]


@compiled
def add_modes(template: Template, work: Work) -> None:
    """Sum J'A for x and y of each vertex, from the output of :func:`weigh_columns` and the transposed modes."""
    beta, starts, triangles = template.warp.beta, template.warp.starts, template.warp.triangles
    fours, modes, room, lines = work.fours, work.lines, work.room, work.products
    clear(lines)
    n = starts[len(starts) - 1]
    k, wide = (len(fours) - SIZE) // (4 * n) if n else 0, lines.shape[1]
    for t in range(len(triangles)):
        for column in range(0, wide, SIZE):
            ax = ay = bx = by = cx = cy = every(F(0.0))
            for i in range(starts[t], starts[t + 1]):
                x = y = every(F(0.0))
                for e in range(i * k, i * k + k):
                    line = load(modes, e * wide + column)
                    x = x + fours[4 * e] * line
                    y = y + fours[4 * e + 1] * line
                a, b, c = beta[i, 0], beta[i, 1], beta[i, 2]
                ax, ay, bx = ax + a * x, ay + a * y, bx + b * x
                by, cx, cy = by + b * y, cx + c * x, cy + c * y
            store(room, 0, ax)
            store(room, 8, ay)
            store(room, 16, bx)
            store(room, 24, by)
            store(room, 32, cx)
            store(room, 40, cy)
            for corner in range(3):
                for axis in range(2):
                    at = SIZE * (2 * corner + axis)
                    out = lines[2 * triangles[t, corner] + axis][column : column + SIZE]
                    own = room[at : at + SIZE]
                    for j in range(SIZE):
                        out[j] += own[j]
