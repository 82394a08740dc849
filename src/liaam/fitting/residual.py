"""The residual of a state, and the normal equations of lambda (paper eq 3, 4 and 9).

    r(x) = P(theta_2) E(I(W(x; p))) - P(theta_1) A0(x) - sum_i lambda_i P(theta_1) A_i(x)

Compiled; arrays of pixels are flat, residual e = i k + r is row r of pixel i. :mod:`liaam.fitting.reference` defines
the result of each function.
"""

import numpy as np

from liaam.fitting.equations import cholesky, clear, copy_matrix
from liaam.fitting.level import BLOCK, GAIN, OFFSET, SHOWN, Picture, Row, Template, Work
from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Double1, Double2, F, Single1, Single2, Single3
from liaam.kernels.vectors import SIZE, lane, load, store, total


@compiled
def set_metric(row: Row, work: Work) -> None:
    """Compute P(theta_2) on the image's channels and its derivative."""
    parts, metric, slope, theta = row.metric, work.metric, work.slope, work.angles[1]
    along, across = F(np.cos(theta)), F(np.sin(theta))
    for c in range(len(metric)):
        metric[c] = parts[0, c] + along * parts[1, c] + across * parts[2, c]
        slope[c] = along * parts[2, c] - across * parts[1, c]


@compiled
def turn(parts: Single3, theta: float, rows: Single2) -> None:
    """Compute rows (b, e) float32 at an angle theta_1 from their constant, cos and sin parts (3, b, e)."""
    along, across = F(np.cos(theta)), F(np.sin(theta))
    for i in range(len(rows)):
        own, fixed, by_cos, by_sin = rows[i], parts[0, i], parts[1, i], parts[2, i]
        for e in range(len(own)):
            own[e] = fixed[e] + along * by_cos[e] + across * by_sin[e]


@compiled
def transpose(rows: Single2, lines: Single1) -> None:
    """Transpose all rows but the first, (1 + m, e), to lines (e w,) with w at least m."""
    wide = len(lines) // rows.shape[1]
    for e in range(rows.shape[1]):
        for j in range(len(rows) - 1):
            lines[e * wide + j] = rows[1 + j, e]


@compiled
def vertices_at(template: Template, work: Work) -> None:
    """Compute the mesh's vertices in model pixels from those at rest and the shape basis (eq 1)."""
    rest, basis, p, points = template.warp.rest, template.warp.basis, work.p, work.points
    for v in range(len(points)):
        xs, ys, x, y = basis[2 * v], basis[2 * v + 1], rest[v, 0], rest[v, 1]
        for j in range(len(p)):
            x += xs[j] * p[j]
            y += ys[j] * p[j]
        points[v, 0], points[v, 1] = x, y


@compiled
def place(template: Template, picture: Picture, work: Work) -> None:
    """Map the model's pixels to the image by the piecewise affine warp (eq 3).

    Writes the index of the upper left of the four image pixels around each point to ``work.corner``, and the offset
    (x, y) from that pixel, and 1 if the point is inside the image, else 0, to ``work.between``.
    """
    beta, starts, triangles = template.warp.beta, template.warp.starts, template.warp.triangles
    points, similarity, corner, between = work.points, picture.similarity, work.corner, work.between
    a00, a01, a02 = similarity[0, 0], similarity[0, 1], similarity[0, 2]
    a10, a11, a12 = similarity[1, 0], similarity[1, 1], similarity[1, 2]
    right, bottom = float(picture.width), float(picture.height)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        vx, vy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        x0, y0 = a00 * points[a, 0] + a01 * points[a, 1] + a02, a10 * points[a, 0] + a11 * points[a, 1] + a12
        bx, by, cx, cy = a00 * ux + a01 * uy, a10 * ux + a11 * uy, a00 * vx + a01 * vy, a10 * vx + a11 * vy
        for i in range(starts[t], starts[t + 1]):
            second, third = np.float64(beta[i, 1]), np.float64(beta[i, 2])
            x, y = x0 + second * bx + third * cx, y0 + second * by + third * cy
            # Written so that NaN counts as outside.
            inside = (x >= 0.0) & (y >= 0.0) & (x <= right - 1.0) & (y <= bottom - 1.0)
            x, y = x if inside else 0.0, y if inside else 0.0
            column, line = np.floor(x), np.floor(y)
            column, line = (
                column if column < right - 2.0 else right - 2.0,
                line if line < bottom - 2.0 else bottom - 2.0,
            )
            corner[i] = np.int32(line * right + column)
            between[3 * i], between[3 * i + 1] = F(x - column), F(y - line)
            between[3 * i + 2] = F(1.0) if inside else F(0.0)


@compiled
def sample(picture: Picture, work: Work) -> None:
    """Sample an image bilinearly at the points of :func:`place`, and project samples and gradients by P(theta_2).

    Writes ``work.values``, ``residual`` (the projected samples), ``image_slopes`` and ``usable``.
    """
    pixels, width, similarity = picture.pixels, picture.width, picture.similarity
    corner, between, metric, values = work.corner, work.between, work.metric, work.values
    projected, image_slopes, usable = work.residual, work.image_slopes, work.usable
    k, below = len(metric) // SIZE, SIZE * width
    xx, xy, yx, yy = F(similarity[0, 0]), F(similarity[0, 1]), F(similarity[1, 0]), F(similarity[1, 1])
    for i in range(len(usable)):
        at, u, v, keep = SIZE * np.int64(corner[i]), between[3 * i], between[3 * i + 1], between[3 * i + 2]
        c00, c10 = load(pixels, at), load(pixels, at + SIZE)
        c01, c11 = load(pixels, at + below), load(pixels, at + below + SIZE)
        upper, lower = c10 - c00, c11 - c01
        top = c00 + u * upper
        along_y = keep * (c01 + u * lower - top)
        along_x = keep * (upper + v * (lower - upper))
        value = keep * top + v * along_y
        store(values, SIZE * i, value)
        all_four = (lane(c00, 7) > F(0.0)) & (lane(c10, 7) > F(0.0)) & (lane(c01, 7) > F(0.0)) & (lane(c11, 7) > F(0.0))
        usable[i] = keep if all_four else F(0.0)
        by_x, by_y = xx * along_x + yx * along_y, xy * along_x + yy * along_y
        for r in range(k):
            weigh, e = load(metric, SIZE * r), i * k + r
            projected[e] = total(weigh * value)
            image_slopes[2 * e], image_slopes[2 * e + 1] = total(weigh * by_x), total(weigh * by_y)


@compiled
def project(work: Work) -> None:
    """Project samples (8 n,) as gain * E(I) + offset, and scale their derivatives by the gain."""
    values, metric, scales = work.values, work.metric, work.scales
    projected, image_slopes = work.residual, work.image_slopes
    k, gain, more = len(metric) // SIZE, F(scales[GAIN]), F(scales[GAIN] / scales[SHOWN])
    for e in range(len(projected)):
        i, r, shown, shift = e // k, e % k, F(0.0), F(0.0)
        for c in range(SIZE - 1):
            shown += metric[SIZE * r + c] * values[SIZE * i + c]
            shift += metric[SIZE * r + c]
        projected[e] = gain * shown + F(scales[OFFSET]) * shift
        image_slopes[2 * e] *= more
        image_slopes[2 * e + 1] *= more
    scales[SHOWN] = scales[GAIN]


@compiled
def take_off(work: Work) -> None:
    """Subtract the appearance (eq 4), the first of rows (1 + m, e) plus lambda times the others, from the residual."""
    residual, rows, lam = work.residual, work.rows, work.lam
    for j in range(len(lam) + 1):
        scale, row = F(1.0) if j == 0 else F(lam[j - 1]), rows[j]
        if scale != F(0.0):
            for e in range(len(residual)):
                residual[e] -= scale * row[e]


@compiled
def mask(own: Single1, usable: Single1, root: Single1) -> int:
    """Copy the square root of the weights, with 0 at unusable pixels, and return the number of these."""
    k, unseen = len(own) // len(usable), 0
    for i in range(len(usable)):
        unseen += 1 if usable[i] == F(0.0) else 0
    for r in range(k):
        for i in range(len(usable)):
            root[i * k + r] = own[i * k + r] * usable[i]
    return unseen


@compiled
def sum_squares(work: Work, own: Single1, sums: Double2) -> None:
    """Sum weights, weighted samples and their squares, and weighted squares of the residual, over the usable pixels.

    ``own`` (n k,) is the square root of the weights; ``sums`` (rows, 4) float64 is the output, for the first rows of
    the metric.
    """
    values, residual, metric, usable, gain = work.values, work.residual, work.metric, work.usable, work.scales[GAIN]
    k = len(own) // len(usable)
    clear(sums)
    for i in range(len(usable)):
        value = load(values, SIZE * i)
        for r in range(len(sums)):
            e = i * k + r
            weight = np.float64(usable[i]) * own[e] * own[e]
            sample, left = gain * total(load(metric, SIZE * r) * value), np.float64(residual[e])
            sums[r, 0] += weight
            sums[r, 1] += weight * sample
            sums[r, 2] += weight * sample * sample
            sums[r, 3] += weight * left * left


@compiled
def with_modes(rows: Single2, root: Single1, column: Single1, line: Single1, out: Double1) -> None:
    """Compute A'c: weighted products of a column (e,) with the modes (all rows but the first)."""
    for j in range(len(rows) - 1):
        out[j] = 0.0
    for begin in range(0, len(root), BLOCK):
        size = BLOCK if begin + BLOCK < len(root) else len(root) - begin
        own, values = root[begin : begin + size], column[begin : begin + size]
        for e in range(size):
            line[e] = own[e] * own[e] * values[e]
        for j in range(len(rows) - 1):
            mode, product = rows[1 + j][begin : begin + size], F(0.0)
            for e in range(size):
                product += mode[e] * line[e]
            out[j] += product


@compiled
def subtract(work: Work) -> None:
    """Subtract the step of lambda times the modes from the residual; write r'r and the sum of the weights."""
    residual, rows, lam, root, sums = work.residual, work.rows, work.lam_step, work.root, work.sums
    sums[0] = sums[1] = 0.0
    for begin in range(0, len(residual), BLOCK):
        size = BLOCK if begin + BLOCK < len(residual) else len(residual) - begin
        out, own = residual[begin : begin + size], root[begin : begin + size]
        for j in range(len(lam)):
            mode, scale = rows[1 + j][begin : begin + size], F(lam[j])
            for e in range(size):
                out[e] -= scale * mode[e]
        squares = weight = F(0.0)
        for e in range(size):
            square = own[e] * own[e]
            squares += square * out[e] * out[e]
            weight += square
        sums[0] += squares
        sums[1] += weight


@compiled
def weighted_gram(rows: Single2, root: Single1, block: Single2, gram: Double2) -> None:
    """Compute A'A (m, m) of the modes (all rows but the first) under weights with square root ``root`` (e,)."""
    m = len(gram)
    clear(gram)
    for begin in range(0, len(root), BLOCK):
        size = BLOCK if begin + BLOCK < len(root) else len(root) - begin
        own = root[begin : begin + size]
        for j in range(m):
            mode, weighted = rows[1 + j][begin : begin + size], block[j]
            for e in range(size):
                weighted[e] = mode[e] * own[e]
        for i in range(0, m, 2):  # in blocks of 2 by 2: each number loaded is used twice
            after = i + 1 if i + 1 < m else i
            a, b = block[i][:size], block[after][:size]
            for j in range(0, i + 1, 2):
                beside = j + 1 if j + 1 < m else j
                c, d = block[j][:size], block[beside][:size]
                ac = ad = bc = bd = F(0.0)
                for e in range(size):
                    ac += a[e] * c[e]
                    ad += a[e] * d[e]
                    bc += b[e] * c[e]
                    bd += b[e] * d[e]
                gram[i, j] += ac
                if beside > j:
                    gram[i, beside] += ad
                if after > i:
                    gram[after, j] += bc
                    if beside > j:
                        gram[after, beside] += bd
    for i in range(m):
        for j in range(i):
            gram[j, i] = gram[i, j]


@compiled
def factorise(template: Template, work: Work, unseen: int) -> None:
    """Compute the Cholesky factor of A'A over the usable pixels (all but ``unseen``), with a ridge on its diagonal."""
    gram, ridge, lines, own, usable = work.gram, template.ridge, work.lines, work.own, work.usable
    factor = work.factor
    m, k = len(gram), len(own) // len(usable)
    wide = len(lines) // len(own)
    copy_matrix(gram, factor)
    if unseen:
        for i in range(len(usable)):
            if usable[i] > F(0.0):
                continue
            for e in range(i * k, i * k + k):
                line, square = lines[e * wide : e * wide + m], np.float64(own[e]) * own[e]
                for a in range(m):
                    scale, row = square * line[a], factor[a]
                    for b in range(a + 1):
                        row[b] -= scale * line[b]
    for a in range(m):
        factor[a, a] += ridge[a]
    if cholesky(factor):
        return
    clear(factor)  # not positive definite, by rounding: use the diagonal, for small steps of lambda
    for a in range(m):
        factor[a, a] = np.sqrt((gram[a, a] if gram[a, a] > 0.0 else 0.0) + ridge[a])
