"""Fast products of the residual, its derivatives and the appearance modes (contract: ``reference``).

Those of a mesh are sums over triangles of a few dozen pixels, in which a compiler's own vector code spends its time
adding up lanes. So the columns of one factor lie side by side, a register of them, and are multiplied by one number of
the other factor at a time; the few instructions that say so are written out (:mod:`liaam.kernels.lanes`).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from liaam.jit import F as _F
from liaam.jit import jit as _jit
from liaam.kernels.lanes import Lanes
from liaam.kernels.layout import LANES, PAIRS, MeshPixels, Packed

LONG, SHORT = 2 * LANES, LANES
"""Columns that are summed at a time, and those at the end: a register of AVX-512 and of AVX, elsewhere several.
Lines are as wide as these make up."""

_AT = types.intp  # where something lies, or how much there is of it


def _by_columns(lanes: Lanes, wide: Any, work: Callable[[Any, int], None]) -> None:
    """Do something for each :data:`LONG` columns, and for the :data:`SHORT` that may be left."""
    rest = lanes.builder.and_(wide, lanes.whole(LONG - 1))
    long = lanes.builder.sub(wide, rest)
    lanes.for_each(long, lambda j: work(j, LONG), LONG)
    lanes.where(long, wide, lambda j: work(j, SHORT))


def _square_sums(rows: int | None) -> Any:
    """Make what E'J and right'E of a triangle's pixels are made of, for a known number of rows, or any.

    With Q = sum_r w^2 (ex jx, ex jy, ey jx, ey jy) and u = sum_r w^2 right (ex, ey), of two further columns, of a
    pixel, out[pair] = sum beta_a beta_b (Q, u, u') and out[6 + a] = sum beta_a (Q, u, u'): nine lines of 8 numbers.
    ``fours`` keeps w^2 (jx, jy, right, right') of each entry. Arrays are flat; ``pixel`` is the first of n.
    """

    @intrinsic
    def square_sums(_context, beta, slopes, theirs, roots, one, other, pixel, n, k, fours, out):
        signature = types.void(beta, slopes, theirs, roots, one, other, _AT, _AT, _AT, fours, out)

        def codegen(context, builder, signature, args):
            lanes = Lanes(context, builder, signature, args)
            pixel, n, k = args[6:9]
            sums, own = lanes.sums(9, 8), lanes.sums(1, 8)
            begin = lanes.times(pixel, k)

            def add_entry(at):
                entry = lanes.plus(begin, at)
                root, slope = lanes.number(3, entry), lanes.vector(2, lanes.times(2, entry), 2)
                four = lanes.with_number(lanes.mixed(slope, None, (0, 1, 0, 1)), lanes.number(4, entry), 2, 4)
                four = lanes.with_number(four, lanes.number(5, entry), 3, 4)
                four = lanes.product(four, lanes.every(lanes.product(root, root), 4))
                lanes.put(four, 9, lanes.times(4, at))
                expected = lanes.vector(1, lanes.times(2, entry), 2)
                left = lanes.mixed(expected, None, (0, 0, 1, 1, 0, 1, 0, 1))
                lanes.add(own[0], left, lanes.mixed(four, None, (0, 1, 0, 1, 2, 2, 3, 3)))

            def add_pixel(i):
                lanes.set(own, [lanes.nought(8)])
                first = lanes.times(i, k)
                lanes.for_each(k if rows is None else rows, lambda r: add_entry(lanes.plus(first, r)))
                at = lanes.times(3, lanes.plus(pixel, i))
                corners = [lanes.every(lanes.number(0, lanes.plus(at, a)), 8) for a in range(3)]
                by_corner = [lanes.product(corner, lanes.get(own)[0]) for corner in corners]
                for total, (a, b) in zip(sums, PAIRS, strict=False):
                    lanes.add(total, corners[a], by_corner[b])
                for total, vector in zip(sums[6:], by_corner, strict=True):
                    lanes.add(total, vector)

            lanes.for_each(n, add_pixel)
            for line, total in enumerate(lanes.get(sums)):
                lanes.put(total, 10, lanes.whole(8 * line))
            return context.get_dummy_value()

        return signature, codegen

    return square_sums


def _mode_sums(rows: int | None) -> Any:
    """Make A'J of a triangle's pixels: ``out[2 a + c] = sum beta_a sum_r w^2 j_c modes``, a < 3, c < 2.

    Arrays as those of :func:`_square_sums`, ``modes`` with ``wide`` columns.
    """

    @intrinsic
    def mode_sums(_context, beta, fours, modes, pixel, n, k, wide, out):
        signature = types.void(beta, fours, modes, _AT, _AT, _AT, _AT, out)

        def codegen(context, builder, signature, args):
            lanes = Lanes(context, builder, signature, args)
            pixel, n, k, wide = args[3:7]
            begin = lanes.times(lanes.times(pixel, k), wide)

            def sum_columns(column, size):
                sums, own = lanes.sums(6, size), lanes.sums(2, size)

                def add_entry(at):
                    line = lanes.steps(2, lanes.plus(begin, lanes.times(at, wide), column), size)
                    for c, total in enumerate(own):
                        steep = lanes.number(1, lanes.plus(lanes.times(4, at), c))
                        lanes.add(total, lanes.every(steep, size), line)

                def add_pixel(i):
                    lanes.set(own, [lanes.nought(size)] * 2)
                    first = lanes.times(i, k)
                    lanes.for_each(k if rows is None else rows, lambda r: add_entry(lanes.plus(first, r)))
                    at, by_axis = lanes.times(3, lanes.plus(pixel, i)), lanes.get(own)
                    for a in range(3):
                        corner = lanes.every(lanes.number(0, lanes.plus(at, a)), size)
                        for c in range(2):
                            lanes.add(sums[2 * a + c], corner, by_axis[c])

                lanes.for_each(n, add_pixel)
                for line, total in enumerate(lanes.get(sums)):
                    lanes.put(total, 7, lanes.plus(lanes.times(wide, line), column))

            _by_columns(lanes, wide, sum_columns)
            return context.get_dummy_value()

        return signature, codegen

    return mode_sums


_squares_of_one, _squares_of_two, _squares_of_three, _squares = (_square_sums(rows) for rows in (1, 2, 3, None))
_modes_of_one, _modes_of_two, _modes_of_three, _modes = (_mode_sums(rows) for rows in (1, 2, 3, None))

BLOCK = 2048
"""Residuals whose products are summed in float32 before they are added up in float64."""


@_jit
def _weighted_gram(modes, roots, total):
    m, n = modes.shape
    block = np.empty((m, BLOCK), np.float32)
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        root = roots[start : start + size]
        for j in range(m):
            mode, own = modes[j, start : start + size], block[j]
            for e in range(size):
                own[e] = mode[e] * root[e]
        for i in range(0, m, 2):  # two by two: each number that is fetched is used twice
            a, b = block[i, :size], block[min(i + 1, m - 1), :size]
            for j in range(0, i + 1, 2):
                c, d = block[j, :size], block[min(j + 1, m - 1), :size]
                ac = ad = bc = bd = _F(0.0)
                for e in range(size):
                    ac += a[e] * c[e]
                    ad += a[e] * d[e]
                    bc += b[e] * c[e]
                    bd += b[e] * d[e]
                total[i, j] += ac
                if j < i:
                    total[i, j + 1] += ad
                if i + 1 < m:
                    total[i + 1, j] += bc
                    total[i + 1, j + 1] += bd
    for i in range(m):
        for j in range(i):
            total[j, i] = total[i, j]


def weighted_gram(modes: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """See :func:`liaam.kernels.reference.weighted_gram`."""
    total = np.zeros((len(modes), len(modes)))
    _weighted_gram(modes, roots.reshape(-1), total)
    return total


@_jit
def _take_off(steps, sizes, factors, begin, end, out):
    """Take a stretch of combined rows off what stands there."""
    m = len(steps)
    for j in range(0, m, 4):  # four at a time: what is left is fetched and stored less often
        a, b = steps[j, begin:end], steps[min(j + 1, m - 1), begin:end]
        c, d = steps[min(j + 2, m - 1), begin:end], steps[min(j + 3, m - 1), begin:end]
        p, q = _F(factors[j] * sizes[j]), _F(factors[j + 1] * sizes[j + 1] if j + 1 < m else 0.0)
        r = _F(factors[j + 2] * sizes[j + 2] if j + 2 < m else 0.0)
        s = _F(factors[j + 3] * sizes[j + 3] if j + 3 < m else 0.0)
        for e in range(end - begin):
            out[e] -= p * _F(a[e]) + q * _F(b[e]) + r * _F(c[e]) + s * _F(d[e])


@_jit
def _less(values, steps, sizes, factors, left):
    for begin in range(0, steps.shape[1], BLOCK):
        end = min(begin + BLOCK, steps.shape[1])
        out = left[begin:end]
        if len(values):
            out[:] = values[begin:end]
        else:
            out[:] = _F(0.0)
        _take_off(steps, sizes, factors, begin, end, out)


def less(values: np.ndarray, packed: Packed, factors: np.ndarray) -> np.ndarray:
    """See :func:`liaam.kernels.reference.less`."""
    values = np.ascontiguousarray(values, dtype=_F)
    left = np.empty_like(values)
    _less(values.reshape(-1), packed.steps, packed.sizes, np.asarray(factors, np.float64), left.reshape(-1))
    return left


def combined(packed: Packed, factors: np.ndarray) -> np.ndarray:
    """See :func:`liaam.kernels.reference.combined`."""
    total = np.empty(packed.steps.shape[1], _F)
    _less(total[:0], packed.steps, packed.sizes, -np.asarray(factors, np.float64), total)
    return total


@_jit
def _add_products(steps, begin, end, line, total):
    """Add the products of a stretch of all rows with a line."""
    m = len(steps)
    for j in range(0, m, 2):  # two by two: each number that is fetched is used twice
        a, b = steps[j, begin:end], steps[min(j + 1, m - 1), begin:end]
        first = second = _F(0.0)
        for e in range(end - begin):
            first += _F(a[e]) * line[e]
            second += _F(b[e]) * line[e]
        total[j] += first
        if j + 1 < m:
            total[j + 1] += second


@_jit
def _unseen(weights):
    """Count of noughts."""
    count = 0
    for i in range(len(weights)):
        count += weights[i] == _F(0.0)
    return count


@_jit
def _column_sums(values, steps, sizes, factors, root, columns, by_modes, by_columns):
    line, last, weight = np.empty(BLOCK, np.float32), len(columns) - 1, 0.0
    for begin in range(0, len(root), BLOCK):
        end = min(begin + BLOCK, len(root))
        # Slices rather than indices in the inner loops: only then does the compiler see that they never wrap around.
        own, total = root[begin:end], _F(0.0)
        if len(values):
            columns[last, begin:end] = values[begin:end]
            if len(factors):  # while the same stretch of the modes is at hand
                _take_off(steps, sizes, factors, begin, end, columns[last, begin:end])
        for e in range(end - begin):
            total += own[e] * own[e]
        weight += total
        for c in range(last + 1):
            column = columns[c, begin:end]
            for e in range(end - begin):
                line[e] = own[e] * own[e] * column[e]
            for b in range(c + 1):
                other, product = columns[b, begin:end], _F(0.0)
                for e in range(end - begin):
                    product += other[e] * line[e]
                by_columns[c, b] += product
            _add_products(steps, begin, end, line, by_modes[c])
    for c in range(last + 1):
        for j in range(len(sizes)):
            by_modes[c, j] *= sizes[j]
        for b in range(c):
            by_columns[b, c] = by_columns[c, b]
    return weight


def column_sums(
    columns: np.ndarray,
    packed: Packed,
    own: np.ndarray,
    weights: np.ndarray,
    values: np.ndarray | None = None,
    factors: np.ndarray | None = None,
) -> tuple[np.ndarray, bool, float, np.ndarray, np.ndarray]:
    """See :func:`liaam.kernels.reference.column_sums`."""
    n_columns = len(columns)
    by_modes, by_columns = np.zeros((n_columns, len(packed.steps))), np.zeros((n_columns, n_columns))
    all_seen = not _unseen(weights)
    roots = own if all_seen else own * weights[:, None]
    values = columns[0, :0] if values is None else np.ascontiguousarray(values, dtype=_F).reshape(-1)
    off = by_modes[0, :0] if factors is None else np.asarray(factors, np.float64)
    flat = values, packed.steps, packed.sizes, off, roots.reshape(-1)
    weight = _column_sums(*flat, columns, by_modes, by_columns)
    return roots, all_seen, float(weight), by_modes, by_columns


@_jit
def _sum_squares(beta, slopes, theirs, roots, one, other, first, n, k, fours, sums):
    if k == 1:
        _squares_of_one(beta, slopes, theirs, roots, one, other, first, n, k, fours, sums)
    elif k == 2:
        _squares_of_two(beta, slopes, theirs, roots, one, other, first, n, k, fours, sums)
    elif k == 3:
        _squares_of_three(beta, slopes, theirs, roots, one, other, first, n, k, fours, sums)
    else:
        _squares(beta, slopes, theirs, roots, one, other, first, n, k, fours, sums)


@_jit
def _sum_modes(beta, fours, lines, first, n, k, wide, sums):
    if k == 1:
        _modes_of_one(beta, fours, lines, first, n, k, wide, sums)
    elif k == 2:
        _modes_of_two(beta, fours, lines, first, n, k, wide, sums)
    elif k == 3:
        _modes_of_three(beta, fours, lines, first, n, k, wide, sums)
    else:
        _modes(beta, fours, lines, first, n, k, wide, sums)


@_jit
def _add_edges(by_edge, edges, basis, total):
    """Add E'J of pairs of vertices times the basis to the vertices' lines."""
    for e in range(len(edges)):
        a, b, q, r, s, t = edges[e, 0], edges[e, 1], by_edge[e, 0], by_edge[e, 1], by_edge[e, 2], by_edge[e, 3]
        for _ in range(1 if a == b else 2):
            x, y, to_x, to_y = basis[2 * b], basis[2 * b + 1], total[2 * a], total[2 * a + 1]
            for p in range(len(x)):
                to_x[p] += q * x[p] + r * y[p]
                to_y[p] += s * x[p] + t * y[p]
            a, b = b, a


@_jit
def _mesh_products(steep, expected, root, lines, right, beta, starts, triangles, edges, sides, basis, total):
    k, wide, n_right, n_p, longest = root.shape[1], lines.shape[1], len(right), basis.shape[1], 0
    for t in range(len(triangles)):
        longest = max(longest, starts[t + 1] - starts[t])
    corners, roots, columns = beta.reshape(-1), root.reshape(-1), lines.reshape(-1)
    slopes, theirs, flat = expected.reshape(-1), steep.reshape(-1), total.reshape(-1)
    squares, sums, fours = np.empty(72, _F), np.empty(6 * wide, _F), np.empty(4 * longest * k, _F)
    by_edge = np.zeros((len(edges), 4))
    for t in range(len(triangles)):
        first, n = starts[t], starts[t + 1] - starts[t]
        if n == 0:
            continue
        for c in range(0, n_right, 2):  # two further columns at a time
            one, other = right[c], right[min(c + 1, n_right - 1)]
            _sum_squares(corners, slopes, theirs, roots, one, other, first, n, k, fours, squares)
            for r in range(6):
                line = 2 * triangles[t, r // 2] + r % 2
                for side in range(min(2, n_right - c)):
                    total[line, n_p + c + side] += squares[8 * (6 + r // 2) + 4 + 2 * side + r % 2]
        for pair in range(6):
            for q in range(4):
                by_edge[sides[t, pair], q] += squares[8 * pair + q]
        _sum_modes(corners, fours, columns, first, n, k, wide, sums)
        for r in range(6):
            begin = (2 * triangles[t, r // 2] + r % 2) * total.shape[1] + n_p + n_right
            for j in range(wide):  # no sign, no wrapping around: see above, of lines too short for slices to pay
                flat[np.uint64(begin + j)] += sums[np.uint64(r * wide + j)]
    _add_edges(by_edge, edges, basis, total)


def mesh_products(
    steep: np.ndarray,
    root: np.ndarray,
    packed: Packed,
    right: np.ndarray,
    mesh: MeshPixels,
    expected: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """See :func:`liaam.kernels.reference.mesh_products`."""
    basis, n_right = mesh.basis, len(right)
    n_p, (wide, m) = basis.shape[1], (packed.lines.shape[1], len(packed.steps))
    # By the vertices: E'J on its way to the parameters, further columns and modes, side by side.
    total = np.zeros((len(basis), n_p + n_right + wide))
    # The instructions above look at memory as it is: float32, line by line.
    floats = steep, steep if expected is None else expected, root, right, mesh.beta
    steep, own, root, right, beta = (np.ascontiguousarray(array, dtype=_F) for array in floats)
    pixels = beta, mesh.starts, mesh.triangles, mesh.edges, mesh.sides
    _mesh_products(steep, own, root, packed.lines, right, *pixels, basis, total)
    carried = (basis.T @ total).T
    aj = carried[n_p + n_right :][:m] * packed.sizes[:, None]
    return carried[:n_p].T, aj, carried[n_p : n_p + n_right]
