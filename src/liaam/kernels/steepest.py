"""Fast samples of an encoded image and their derivatives (contract: ``reference.steepest``).

The channels of a pixel lie side by side. For the metrics of the methods most used they are read and interpolated
together, several pixels at a time, in instructions that are written out (:mod:`liaam.kernels.lanes`): a third of what
the same takes channel by channel.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from liaam.jit import F as _F
from liaam.jit import jit as _jit
from liaam.kernels.lanes import Lanes
from liaam.kernels.layout import Carried, points_of

_AT = types.intp  # where something lies, or how much there is of it

BLOCK = 256
"""Pixels whose places are worked out at a time: a multiple of those that are written together."""


@_jit
def _steepest(channels, points, turn, metric, values, projected, steep, weights):
    height, width = channels.shape[0], channels.shape[1]
    n, k, n_c = points.shape[0], metric.shape[0], metric.shape[1]
    along_x, along_y = np.empty(n_c, np.float32), np.empty(n_c, np.float32)
    for i in range(n):
        px, py = points[i, 0], points[i, 1]
        # Written so that NaN counts as outside.
        if not (px >= 0.0 and py >= 0.0 and px <= width - 1 and py <= height - 1):
            weights[i] = _F(0.0)
            values[i, :] = _F(0.0)
            projected[i, :] = _F(0.0)
            steep[i, :, :] = _F(0.0)
            continue
        x, y = min(int(px), width - 2), min(int(py), height - 2)
        u, v = _F(px - x), _F(py - y)
        left, above = _F(1.0) - u, _F(1.0) - v
        weights[i] = min(
            min(channels[y, x, n_c], channels[y, x + 1, n_c]),
            min(channels[y + 1, x, n_c], channels[y + 1, x + 1, n_c]),
        )
        for c in range(n_c):
            c00, c10, c01, c11 = (
                channels[y, x, c],
                channels[y, x + 1, c],
                channels[y + 1, x, c],
                channels[y + 1, x + 1, c],
            )
            top, bottom = left * c00 + u * c10, left * c01 + u * c11
            values[i, c] = above * top + v * bottom
            along_x[c] = above * (c10 - c00) + v * (c11 - c01)
            along_y[c] = bottom - top
        for r in range(k):
            value = gx = gy = _F(0.0)
            for c in range(n_c):
                m = metric[r, c]
                value += m * values[i, c]
                gx += m * along_x[c]
                gy += m * along_y[c]
            projected[i, r] = value
            steep[i, r, 0] = gx * turn[0, 0] + gy * turn[1, 0]
            steep[i, r, 1] = gx * turn[0, 1] + gy * turn[1, 1]


@_jit
def _carry(vertices, beta, starts, triangles, t, begin, end, x, y):
    """Where a stretch of a mesh's pixels lie, from triangle ``t`` on; gives the triangle of the last of them."""
    at = begin
    while at < end:
        while starts[t + 1] <= at:
            t += 1
        stop = min(starts[t + 1], end)
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay = vertices[a, 0], vertices[a, 1]
        bx, by, cx, cy = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[c, 0] - ax, vertices[c, 1] - ay
        # Slices rather than indices in the loops: only then does the compiler see that they never wrap around.
        own, to_x, to_y = beta[at:stop], x[at - begin : stop - begin], y[at - begin : stop - begin]
        for i in range(stop - at):
            to_x[i] = ax + np.float64(own[i, 1]) * bx + np.float64(own[i, 2]) * cx
        for i in range(stop - at):
            to_y[i] = ay + np.float64(own[i, 1]) * by + np.float64(own[i, 2]) * cy
        at = stop
    return t


@_jit
def _place(x, y, height, width, at, u, v, keep):
    """Number of the first of points' four pixels, where they lie between them, and whether they are inside."""
    right, below = width - 2, height - 2
    for i in range(len(x)):
        px, py = x[i], y[i]
        # Written so that NaN counts as outside.
        inside = (px >= 0.0) & (py >= 0.0) & (px <= width - 1) & (py <= height - 1)
        px, py = px if inside else 0.0, py if inside else 0.0
        column, row = min(np.floor(px), float(right)), min(np.floor(py), float(below))
        at[i] = np.int32(row * width + column)
        u[i], v[i], keep[i] = _F(px - column), _F(py - row), _F(1.0) if inside else _F(0.0)


def _interpolated(lanes: Lanes, own: int, corner: Callable[[Any], Any], first: Any, right: Any, below: Any) -> Any:
    """Read 16 / ``own`` pixels (of so many lanes each) and interpolate.

    Arguments 1 to 4 of the function are their numbers, where they lie between others, and whether inside, from
    ``first`` on; ``right`` and ``below`` are how far the others are.

    Returns
    -------
    values, along_x, along_y : vectors of 16
    least : vector of 16
        Of the four pixels, lane by lane.
    keep : vector of 16
    """
    count = 16 // own
    begins = [lanes.times(right, lanes.number(1, lanes.plus(first, i))) for i in range(count)]
    spread = [i for i in range(count) for _ in range(own)]
    u, v, keep = (lanes.mixed(lanes.vector(array, first, count), None, spread) for array in (2, 3, 4))

    def read(*further: Any) -> Any:
        vectors = [corner(lanes.plus(begin, *further)) for begin in begins]
        while len(vectors) > 1:
            size = vectors[0].type.count
            vectors = [lanes.mixed(a, b, range(2 * size)) for a, b in zip(vectors[::2], vectors[1::2], strict=True)]
        return vectors[0]

    c00, c10, c01, c11 = read(), read(right), read(below), read(right, below)
    upper, lower = lanes.less(c10, c00), lanes.less(c11, c01)
    top = lanes.sum(lanes.product(u, upper), c00)
    along_y = lanes.less(lanes.sum(lanes.product(u, lower), c01), top)
    along_x = lanes.sum(lanes.product(v, lanes.less(lower, upper)), upper)
    value = lanes.product(keep, lanes.sum(lanes.product(v, along_y), top))
    least = lanes.product(keep, lanes.least(lanes.least(c00, c10), lanes.least(c01, c11)))
    return value, along_x, along_y, least, keep


def _intrinsic_of(write: Callable[[Lanes, Any, Any, Any, Any], None]) -> Any:
    """Make the function of a few pixels: ``write`` gets their place in the block and in all, and how far others are."""

    @intrinsic
    def pixels(
        _context, flat, at, u, v, keep, factors, turn, values, projected, steep, weights, first, i, right, below
    ):
        arrays = flat, at, u, v, keep, factors, turn, values, projected, steep, weights
        signature = types.void(*arrays, _AT, _AT, _AT, _AT)

        def codegen(context, builder, signature, args):
            write(Lanes(context, builder, signature, args), *args[11:15])
            return context.get_dummy_value()

        return signature, codegen

    return pixels


def _write_one(lanes: Lanes, first: Any, i: Any, right: Any, below: Any) -> None:
    """Four pixels of three channels and a weight, one row; ``factors`` are the row's, nought, and 0, 0, 0, 1."""
    value, along_x, along_y, least, keep = _interpolated(
        lanes, 4, lambda at: lanes.vector(0, at, 4), first, right, below
    )
    row, last = (lanes.mixed(lanes.vector(5, lanes.whole(begin), 4), None, 4 * [0, 1, 2, 3]) for begin in (0, 4))
    kept = lanes.product(keep, row)
    slopes = lanes.neighbours(lanes.product(kept, along_x), lanes.product(kept, along_y))
    rest = lanes.neighbours(lanes.product(row, value), lanes.product(last, least))
    both = lanes.neighbours(slopes, rest)  # along x, along y, projected, weight; pixel by pixel
    by_x, by_y = (lanes.mixed(both, None, [4 * (j // 2) + axis for j in range(8)]) for axis in (0, 1))
    turn = lanes.vector(6, lanes.whole(0), 4)
    to_x, to_y = (lanes.mixed(turn, None, 4 * [2 * axis, 2 * axis + 1]) for axis in (0, 1))
    lanes.put(lanes.sum(lanes.product(by_x, to_x), lanes.product(by_y, to_y)), 9, lanes.times(2, i))
    lanes.put(lanes.mixed(both, None, (2, 6, 10, 14)), 8, i)
    lanes.put(lanes.mixed(both, None, (3, 7, 11, 15)), 10, i)
    _put_twelve(lanes, lanes.mixed(value, None, [4 * pixel + c for pixel in range(4) for c in range(3)]), 7, i, 3)


def _write_soft(lanes: Lanes, first: Any, i: Any, right: Any, below: Any) -> None:
    """Two pixels of six channels and a weight: two rows of a channel each, one over the three that follow them.

    A pixel's lanes are its channels with the fourth twice, so that its seven numbers fill two vectors of four;
    ``factors`` are those of the metric, lane by lane, and nought.
    """

    def corner(at: Any) -> Any:
        return lanes.mixed(lanes.vector(0, at, 4), lanes.vector(0, lanes.plus(at, 3), 4), range(8))

    value, along_x, along_y, least, keep = _interpolated(lanes, 8, corner, first, right, below)
    row = lanes.mixed(lanes.vector(5, lanes.whole(0), 8), None, 2 * list(range(8)))
    kept = lanes.product(keep, row)
    xx, xy, yx, yy = (lanes.every(lanes.number(6, lanes.whole(j)), 16) for j in range(4))
    by_x = lanes.product(kept, lanes.sum(lanes.product(along_x, xx), lanes.product(along_y, yx)))
    by_y = lanes.product(kept, lanes.sum(lanes.product(along_x, xy), lanes.product(along_y, yy)))
    projected = lanes.product(row, value)
    steep = _three_rows(lanes, by_x, by_y, [(lane, 16 + lane) for lane in range(16)])
    _put_twelve(lanes, steep, 9, i, 6)
    rows = _three_rows(lanes, projected, None, [(lane,) for lane in range(16)])
    lanes.put(lanes.mixed(rows, None, range(4)), 8, lanes.times(3, i))
    lanes.put(lanes.mixed(rows, None, (4, 5)), 8, lanes.plus(lanes.times(3, i), 4))
    _put_twelve(lanes, lanes.mixed(value, None, [8 * pixel + c for pixel in (0, 1) for c in CHANNEL_LANES]), 7, i, 6)
    lanes.put(lanes.mixed(least, None, (7, 15)), 10, i)


CHANNEL_LANES = (0, 1, 2, 3, 5, 6)
"""Lanes of the six channels."""

ROW_LANES = ((0, 1, 2), (6, 6, 3), (6, 6, 5))
"""Lanes whose sums are the three rows; there is nought in lane 6."""


def _three_rows(lanes: Lanes, a: Any, b: Any | None, of: Sequence[tuple[int, ...]]) -> Any:
    """Sums over the channels of each row, row by row of two pixels: of lanes of a and b in turn where there are two."""
    orders = [[at for pixel in (0, 8) for lane in row for at in of[pixel + lane]] for row in ROW_LANES]
    first, second, third = (lanes.mixed(a, b, order) for order in orders)
    return lanes.sum(lanes.sum(first, second), third)


def _put_twelve(lanes: Lanes, vector: Any, array: int, i: Any, each: int) -> None:
    """Store a vector of 12, ``each`` of them for a pixel."""
    at = lanes.times(each, i)
    lanes.put(lanes.mixed(vector, None, range(8)), array, at)
    lanes.put(lanes.mixed(vector, None, range(8, 12)), array, lanes.plus(at, 8))


_four_of_one, _two_of_soft = _intrinsic_of(_write_one), _intrinsic_of(_write_soft)


@_jit
def _room():
    """Room for where a block's points lie, their first pixels, where between those, and whether inside.

    One by one: rows of one array are not known to be without gaps once it has been taken apart, and loops over them
    stay scalar, at four times the time.
    """
    x, y, at = np.empty(BLOCK), np.empty(BLOCK), np.zeros(BLOCK, np.int64)
    return x, y, at, np.zeros(BLOCK, _F), np.zeros(BLOCK, _F), np.zeros(BLOCK, _F)


NO_POINTS = np.empty((0, 2))
NO_MESH = NO_POINTS, np.empty((0, 3), np.float32), np.zeros(1, np.int64), np.empty((0, 3), np.int64)


@_jit
def _fetch(points, vertices, beta, starts, triangles, t, begin, end, x, y):
    """Fetch a stretch of points, given or carried by a mesh from its triangle ``t`` on; gives the last one's."""
    if not len(points):
        return _carry(vertices, beta, starts, triangles, t, begin, end, x, y)
    x[: end - begin] = points[begin:end, 0]
    y[: end - begin] = points[begin:end, 1]
    return t


# Two loops that differ in what they call: in one, with a branch around either, both take a quarter longer.
@_jit
def _steepest_one(
    channels, points, vertices, beta, starts, triangles, turn, factors, values, projected, steep, weights
):
    height, width, stride = channels.shape
    flat, by_row, below = channels.reshape(-1), turn.reshape(-1), stride * width
    outer = values.reshape(-1), projected.reshape(-1), steep.reshape(-1), weights
    (x, y, at, u, v, keep), n_pixels, t = _room(), max(len(points), len(beta)), 0
    for begin in range(0, n_pixels, BLOCK):
        n = min(BLOCK, n_pixels - begin)
        t = _fetch(points, vertices, beta, starts, triangles, t, begin, begin + n, x, y)
        _place(x[:n], y[:n], height, width, at, u, v, keep)
        for i in range(0, n, 4):
            _four_of_one(flat, at, u, v, keep, factors, by_row, *outer, i, begin + i, stride, below)


@_jit
def _steepest_soft(
    channels, points, vertices, beta, starts, triangles, turn, factors, values, projected, steep, weights
):
    height, width, stride = channels.shape
    flat, by_row, below = channels.reshape(-1), turn.reshape(-1), stride * width
    outer = values.reshape(-1), projected.reshape(-1), steep.reshape(-1), weights
    (x, y, at, u, v, keep), n_pixels, t = _room(), max(len(points), len(beta)), 0
    for begin in range(0, n_pixels, BLOCK):
        n = min(BLOCK, n_pixels - begin)
        t = _fetch(points, vertices, beta, starts, triangles, t, begin, begin + n, x, y)
        _place(x[:n], y[:n], height, width, at, u, v, keep)
        for i in range(0, n, 2):
            _two_of_soft(flat, at, u, v, keep, factors, by_row, *outer, i, begin + i, stride, below)


SOFT = np.array([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 1, 1, 0]], bool)
"""Entries of the metric ``soft`` that are not zero."""


def _loop_for(metric: np.ndarray) -> tuple[Callable, np.ndarray]:
    """Loop for a metric, and the metric as the loop wants it."""
    return _loop_for_entries(metric.shape, metric.astype(np.float64).tobytes())


@lru_cache(maxsize=16)
def _loop_for_entries(shape: tuple[int, int], entries: bytes) -> tuple[Callable, np.ndarray]:
    """The same for a metric's float64 entries: fits ask for the same again and again."""
    metric = np.frombuffer(entries).reshape(shape)
    if shape == (1, 3):
        loop, factors = _steepest_one, np.array([*metric[0], 0, 0, 0, 0, 1], np.float32)
    elif shape == SOFT.shape and not metric[~SOFT].any():
        a, b, (c, d, e) = metric[0, 0], metric[1, 1], metric[2, 2:5]
        loop, factors = _steepest_soft, np.array([a, b, c, d, 0, e, 0, 0], np.float32)
    else:
        loop, factors = _steepest, metric.astype(np.float32)
    factors.flags.writeable = False
    return loop, factors


MOST_AT_A_TIME = 4
"""Pixels that are written together."""


def steepest(
    channels: np.ndarray, points: np.ndarray | Carried, turn: np.ndarray, metric: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """See :func:`liaam.kernels.reference.steepest`."""
    (loop, factors), (k, c) = _loop_for(metric), metric.shape
    if loop is _steepest:
        places = (np.ascontiguousarray(points_of(points), np.float64),)
    elif isinstance(points, Carried):
        mesh = points.mesh
        places = NO_POINTS, np.ascontiguousarray(points.vertices), mesh.beta, mesh.starts, mesh.triangles
    else:
        places = np.ascontiguousarray(points, np.float64), *NO_MESH
    n = len(points)
    room = n + MOST_AT_A_TIME - 1  # the last pixels are written together with what is beyond them
    values, projected = np.empty((room, c), np.float32), np.empty((room, k), np.float32)
    steep, weights = np.empty((room, k, 2), np.float32), np.empty(room, np.float32)
    # The instructions above look at memory as it is.
    channels, turn = np.ascontiguousarray(channels, np.float32), np.ascontiguousarray(turn, np.float32)
    loop(channels, *places, turn, factors, values, projected, steep, weights)
    return values[:n], projected[:n], steep[:n], weights[:n]
