"""Fast products of the residual, its derivatives and the appearance modes (contract: ``reference``).

Those of a mesh are sums over triangles of a few dozen pixels, in which a compiler's own vector code spends its time
adding up lanes. So the columns of one factor lie side by side, :data:`LANES` of them to a register, and are multiplied
by one number of the other factor at a time; the few instructions that say so are written out (:func:`_square_sums`,
:func:`_mode_sums`).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from liaam.jit import F as _F
from liaam.jit import jit as _jit

LANES = 8
"""Columns that are summed at a time: a register of AVX; elsewhere two of SSE's or NEON's."""

_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_ZERO = ir.Constant(_VECTOR, [0.0] * LANES)
_INT, _I32 = ir.IntType(64), ir.IntType(32)


class _Lanes(NamedTuple):
    """Writes instructions for float32 in vectors: a builder of LLVM, and the data of the arrays among the arguments."""

    builder: Any
    data: Callable[[int], Any]

    @classmethod
    def of(cls, context: Any, builder: Any, signature: Any, args: Any) -> "_Lanes":
        def data(i: int) -> Any:
            return context.make_array(signature.args[i])(context, builder, args[i]).data

        return cls(builder, data)

    def after(self, at: Any, step: int | Any, count: int | Any) -> Any:
        """Give at + step * count."""
        step, count = (ir.Constant(_INT, n) if isinstance(n, int) else n for n in (step, count))
        return self.builder.add(at, self.builder.mul(step, count))

    def sums(self, count: int) -> list[Any]:
        """Vectors to add up in, nought."""
        sums = [cgutils.alloca_once(self.builder, _VECTOR) for _ in range(count)]
        self.clear(sums)
        return sums

    def clear(self, sums: list[Any]) -> None:
        for each in sums:
            self.builder.store(_ZERO, each)

    def add(self, total: Any, factor: Any, vector: Any) -> None:
        """Add factor * vector to a sum, in one instruction where the machine has it."""
        flags = ("contract",)
        product = self.builder.fmul(self.every(factor), vector, flags=flags)
        self.builder.store(self.builder.fadd(product, self.builder.load(total), flags=flags), total)

    def number(self, array: int, at: Any) -> Any:
        return self.builder.load(self.builder.gep(self.data(array), [at]))

    def vector(self, array: int, at: Any, size: int = LANES) -> Any:
        """Read numbers that lie side by side."""
        place = self.builder.gep(self.data(array), [at])
        loaded = self.builder.load(self.builder.bitcast(place, ir.VectorType(ir.FloatType(), size).as_pointer()))
        loaded.align = 4
        return loaded

    def put(self, total: Any, array: int, at: Any) -> None:
        place = self.builder.gep(self.data(array), [at])
        stored = self.builder.store(self.builder.load(total), self.builder.bitcast(place, _VECTOR.as_pointer()))
        stored.align = 4

    def pair(self, first: Any, second: Any) -> Any:
        """Vector of two numbers."""
        nothing = ir.Constant(ir.VectorType(ir.FloatType(), 2), ir.Undefined)
        return self.builder.insert_element(self.builder.insert_element(nothing, first, _I32(0)), second, _I32(1))

    def mixed(self, first: Any, second: Any, order: Sequence[int]) -> Any:
        """Vector of numbers of two others, by their places in both."""
        return self.builder.shuffle_vector(first, second, ir.Constant(ir.VectorType(_I32, LANES), list(order)))

    def every(self, number: Any) -> Any:
        """One number in all lanes."""
        nothing = ir.Constant(_VECTOR, ir.Undefined)
        return self.mixed(self.builder.insert_element(nothing, number, _I32(0)), nothing, [0] * LANES)

    def for_each(self, first: Any, count: int | Any, work: Callable[[Any], None]) -> None:
        """Do something for ``first``, ``first + 1``, ...: written out where it is known how often."""
        if isinstance(count, int):
            for i in range(count):
                work(self.builder.add(first, ir.Constant(_INT, i)))
            return
        with cgutils.for_range(self.builder, count, intp=_INT) as loop:
            work(self.builder.add(first, loop.index))


PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Corners of a triangle, two by two."""


def _square_sums(rows: int | None) -> Any:
    """Make what E'J and right'E of a triangle's pixels are made of, for a known number of rows, or any.

    With Q = sum_r w^2 (ex jx, ex jy, ey jx, ey jy) and u = sum_r w^2 right (ex, ey), of two further columns, of a
    pixel, out[pair] = sum beta_a beta_b (Q, u, u') and out[6 + a] = sum beta_a (Q, u, u'): nine lines of :data:`LANES`
    numbers. Arrays are flat; ``pixel`` is the first of n.
    """

    @intrinsic
    def square_sums(_context, beta, slopes, theirs, roots, one, other, pixel, n, k, out):
        signature = types.void(beta, slopes, theirs, roots, one, other, types.intp, types.intp, types.intp, out)

        def codegen(context, builder, signature, args):
            lanes, k = _Lanes.of(context, builder, signature, args), args[8] if rows is None else rows
            sums, own = lanes.sums(9), lanes.sums(1)

            def add_entry(entry):
                root, at = lanes.number(3, entry), lanes.after(_INT(0), 2, entry)
                slope, further = lanes.vector(1, at, 2), lanes.pair(lanes.number(4, entry), lanes.number(5, entry))
                left = lanes.mixed(slope, slope, (0, 0, 1, 1, 0, 1, 0, 1))
                right = lanes.mixed(lanes.vector(2, at, 2), further, (0, 1, 0, 1, 2, 2, 3, 3))
                lanes.add(own[0], builder.fmul(root, root), builder.fmul(left, right))

            def add_pixel(i):
                lanes.clear(own)
                lanes.for_each(lanes.after(_INT(0), k, i), k, add_entry)
                vector = builder.load(own[0])
                corners = [lanes.number(0, lanes.after(_INT(a), 3, i)) for a in range(3)]
                for total, (a, b) in zip(sums, PAIRS, strict=False):
                    lanes.add(total, builder.fmul(corners[a], corners[b]), vector)
                for total, corner in zip(sums[6:], corners, strict=True):
                    lanes.add(total, corner, vector)

            lanes.for_each(args[6], args[7], add_pixel)
            for line, total in enumerate(sums):
                lanes.put(total, 9, _INT(LANES * line))
            return context.get_dummy_value()

        return signature, codegen

    return square_sums


def _mode_sums(rows: int | None) -> Any:
    """Make A'J of a triangle's pixels: ``out[2 a + c] = sum beta_a sum_r w^2 j_c modes``, a < 3, c < 2.

    Arrays as those of :func:`_square_sums`; ``modes_at`` is where :data:`LANES` columns of ``modes`` begin at the first
    pixel, ``step`` from one residual to the next, as ``out_at`` and ``out_step`` of the sums.
    """

    @intrinsic
    def mode_sums(_context, beta, theirs, roots, modes, pixel, n, k, modes_at, step, out, out_at, out_step):
        at = types.intp
        signature = types.void(beta, theirs, roots, modes, at, at, at, at, at, out, at, at)

        def codegen(context, builder, signature, args):
            lanes, k = _Lanes.of(context, builder, signature, args), args[6] if rows is None else rows
            begin = lanes.after(_INT(0), k, args[4])
            sums, own = lanes.sums(6), lanes.sums(2)

            def add_entry(entry):
                vector = lanes.vector(3, lanes.after(args[7], args[8], builder.sub(entry, begin)))
                root = lanes.number(2, entry)
                for c, total in enumerate(own):
                    steep = lanes.number(1, lanes.after(_INT(c), 2, entry))
                    lanes.add(total, builder.fmul(builder.fmul(root, root), steep), vector)

            def add_pixel(i):
                lanes.clear(own)
                lanes.for_each(lanes.after(_INT(0), k, i), k, add_entry)
                for a in range(3):
                    corner = lanes.number(0, lanes.after(_INT(a), 3, i))
                    for c in range(2):
                        lanes.add(sums[2 * a + c], corner, builder.load(own[c]))

            lanes.for_each(args[4], args[5], add_pixel)
            for line, total in enumerate(sums):
                lanes.put(total, 9, lanes.after(args[10], args[11], line))
            return context.get_dummy_value()

        return signature, codegen

    return mode_sums


_squares_of_one, _squares_of_two, _squares_of_three, _squares = (_square_sums(rows) for rows in (1, 2, 3, None))
_modes_of_one, _modes_of_two, _modes_of_three, _modes = (_mode_sums(rows) for rows in (1, 2, 3, None))

BLOCK = 512
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
def _residual_sums(residual, modes, own, weights, roots, ar):
    n, k = residual.shape
    for i in range(n):
        for r in range(k):
            roots[i, r] = own[i, r] * weights[i]
    line, by_root, flat = np.empty(BLOCK, np.float32), roots.reshape(-1), residual.reshape(-1)
    rr = weight = 0.0
    for begin in range(0, n * k, BLOCK):
        end = min(begin + BLOCK, n * k)
        # Slices rather than indices in the inner loops: only then does the compiler see that they never wrap around.
        root, part = by_root[begin:end], flat[begin:end]
        squares = total = _F(0.0)
        for e in range(end - begin):
            square = root[e] * root[e]
            line[e] = square * part[e]
            squares += line[e] * part[e]
            total += square
        rr += squares
        weight += total
        for j in range(len(modes)):
            mode = modes[j, begin:end]
            product = _F(0.0)
            for e in range(end - begin):
                product += mode[e] * line[e]
            ar[j] += product
    return rr, weight


def residual_sums(
    residual: np.ndarray, modes: np.ndarray, own: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """See :func:`liaam.kernels.reference.residual_sums`."""
    roots, ar = np.empty_like(own), np.zeros(len(modes))
    rr, weight = _residual_sums(residual, modes, own, weights, roots, ar)
    return roots, ar, float(rr), float(weight)


@_jit
def _lanes_for(n):
    """Columns that hold n, so many that they fill whole vectors."""
    return (n + LANES - 1) // LANES * LANES


@_jit
def _readable(values, begin, n, beyond, spare):
    """Where n numbers from a place on can be read, and so many beyond them: as they are, or in a copy."""
    if begin + n + beyond <= len(values):
        return values, begin
    spare[:n] = values[begin : begin + n]
    return spare, 0


@_jit
def _sum_squares(beta, slopes, theirs, roots, one, other, first, n, k, sums):
    if k == 1:
        _squares_of_one(beta, slopes, theirs, roots, one, other, first, n, k, sums)
    elif k == 2:
        _squares_of_two(beta, slopes, theirs, roots, one, other, first, n, k, sums)
    elif k == 3:
        _squares_of_three(beta, slopes, theirs, roots, one, other, first, n, k, sums)
    else:
        _squares(beta, slopes, theirs, roots, one, other, first, n, k, sums)


@_jit
def _sum_modes(beta, theirs, roots, block, first, n, k, at, m, sums, wide):
    for j in range(0, wide, LANES):
        if k == 1:
            _modes_of_one(beta, theirs, roots, block, first, n, k, at + j, m, sums, j, wide)
        elif k == 2:
            _modes_of_two(beta, theirs, roots, block, first, n, k, at + j, m, sums, j, wide)
        elif k == 3:
            _modes_of_three(beta, theirs, roots, block, first, n, k, at + j, m, sums, j, wide)
        else:
            _modes(beta, theirs, roots, block, first, n, k, at + j, m, sums, j, wide)


@_jit
def _add_squares(squares, at, basis, total):
    """Add E'J of one triangle times the basis to the lines of its corners."""
    block = np.empty((6, 6))
    for pair in range(len(PAIRS)):
        (a, b), q = PAIRS[pair], squares[pair]
        i, j = 2 * a, 2 * b
        block[i, j] = block[j, i] = q[0]
        block[i, j + 1] = block[j, i + 1] = q[1]
        block[i + 1, j] = block[j + 1, i] = q[2]
        block[i + 1, j + 1] = block[j + 1, i + 1] = q[3]
    b0, b1, b2, b3, b4, b5 = basis[at[0]], basis[at[1]], basis[at[2]], basis[at[3]], basis[at[4]], basis[at[5]]
    for r in range(6):
        c, line = block[r], total[at[r]]
        c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
        for p in range(len(b0)):
            line[p] += c0 * b0[p] + c1 * b1[p] + c2 * b2[p] + c3 * b3[p] + c4 * b4[p] + c5 * b5[p]


@_jit
def _mesh_products(steep, expected, root, modes, right, beta, starts, triangles, basis, total):
    k, m, n_right, n_p, longest = root.shape[1], modes.shape[1], len(right), basis.shape[1], 0
    for t in range(len(triangles)):
        longest = max(longest, starts[t + 1] - starts[t])
    corners, roots, values = beta.reshape(-1), root.reshape(-1), modes.reshape(-1)
    slopes, theirs, wide = expected.reshape(-1), steep.reshape(-1), _lanes_for(m)
    squares, sums = np.empty((9, LANES), np.float32), np.empty((6, wide), np.float32)
    spare, at = np.zeros(longest * k * m + wide, np.float32), np.empty(6, np.int64)
    for t in range(len(triangles)):
        first, n = starts[t], starts[t + 1] - starts[t]
        if n == 0:
            continue
        for r in range(6):
            at[r] = 2 * triangles[t, r // 2] + r % 2
        for c in range(0, n_right, 2):  # two further columns at a time
            one, other = right[c], right[min(c + 1, n_right - 1)]
            _sum_squares(corners, slopes, theirs, roots, one, other, first, n, k, squares.reshape(-1))
            for r in range(6):
                for side in range(min(2, n_right - c)):
                    total[at[r], n_p + c + side] += squares[6 + r // 2, 4 + 2 * side + r % 2]
        _add_squares(squares, at, basis, total)
        block, begin = _readable(values, first * k * m, n * k * m, wide, spare)
        _sum_modes(corners, theirs, roots, block, first, n, k, begin, m, sums.reshape(-1), wide)
        for r in range(6):
            line, own = total[at[r], n_p + n_right :], sums[r]
            for j in range(m):
                line[j] += own[j]


def mesh_products(
    steep: np.ndarray,
    root: np.ndarray,
    modes: np.ndarray,
    right: np.ndarray,
    beta: np.ndarray,
    starts: np.ndarray,
    triangles: np.ndarray,
    basis: np.ndarray,
    expected: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """See :func:`liaam.kernels.reference.mesh_products`; fastest with modes in Fortran's order."""
    n_p, n_right = basis.shape[1], len(right)
    # By the vertices: E'J on its way to the parameters, further columns and modes, side by side.
    total = np.zeros((len(basis), n_p + n_right + len(modes)))
    # The instructions above look at memory as it is: float32, line by line.
    floats = steep, steep if expected is None else expected, root, modes.T, right, beta
    steep, own, root, lines, right, beta = (np.ascontiguousarray(array, dtype=_F) for array in floats)
    _mesh_products(steep, own, root, lines, right, beta, starts, triangles, basis, total)
    carried = (basis.T @ total).T
    return carried[:n_p].T, carried[n_p + n_right :], carried[n_p : n_p + n_right]
