"""Fast kernels: numba, one pass over the model's pixels, no large temporaries (contract: ``reference``)."""

import numpy as np

from liaam.jit import F as _F
from liaam.jit import jit as _jit
from liaam.kernels.products import (  # noqa: F401 (of the contract)
    column_sums,
    combined,
    less,
    mesh_products,
    weighted_gram,
)
from liaam.kernels.reference import FLAT, ON_EDGE
from liaam.kernels.soft_weights import soft_roots, soft_variances  # noqa: F401 (of the contract)
from liaam.kernels.steepest import SOFT, steepest  # noqa: F401 (of the contract)
from liaam.kernels.steps import damped_step  # noqa: F401 (of the contract)


@_jit
def _carry(positions, corners, beta, points):
    for i in range(len(corners)):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        points[i, 0] = beta[i, 0] * positions[a, 0] + beta[i, 1] * positions[b, 0] + beta[i, 2] * positions[c, 0]
        points[i, 1] = beta[i, 0] * positions[a, 1] + beta[i, 1] * positions[b, 1] + beta[i, 2] * positions[c, 1]


def carry(positions: np.ndarray, corners: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """See :func:`liaam.kernels.reference.carry`."""
    points = np.empty((len(corners), 2))
    _carry(np.ascontiguousarray(positions, dtype=np.float64), corners, beta, points)
    return points


@_jit
def _inverse_affinities(points, shape, triangles, inverse):
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        # Edges, there and at rest.
        x0, y0 = shape[b, 0] - shape[a, 0], shape[b, 1] - shape[a, 1]
        x1, y1 = shape[c, 0] - shape[a, 0], shape[c, 1] - shape[a, 1]
        u0, v0 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        u1, v1 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        twice = x0 * y1 - x1 * y0
        factor = 0.0 if abs(twice) <= FLAT * abs(u0 * v1 - u1 * v0) else 1.0 / twice
        inverse[t, 0, 0], inverse[t, 0, 1] = (u0 * y1 - u1 * y0) * factor, (u1 * x0 - u0 * x1) * factor
        inverse[t, 1, 0], inverse[t, 1, 1] = (v0 * y1 - v1 * y0) * factor, (v1 * x0 - v0 * x1) * factor


def inverse_affinities(points: np.ndarray, shape: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """See :func:`liaam.kernels.reference.inverse_affinities`."""
    inverse = np.empty((len(triangles), 2, 2))
    _inverse_affinities(np.ascontiguousarray(points), np.ascontiguousarray(shape), triangles, inverse)
    return inverse


@_jit
def _pull_one(slopes, back, pulled, rows):
    for r in range(rows):
        x, y = slopes[0, r], slopes[1, r]
        pulled[r, 0] = back[0, 0] * x + back[1, 0] * y
        pulled[r, 1] = back[0, 1] * x + back[1, 1] * y


@_jit
def _pull(slopes, inverse, owners, pulled):
    if slopes.shape[2] == 3:  # most often, and in half of the time if the compiler knows
        for i in range(len(slopes)):
            _pull_one(slopes[i], inverse[owners[i]], pulled[i], 3)
    else:
        for i in range(len(slopes)):
            _pull_one(slopes[i], inverse[owners[i]], pulled[i], slopes.shape[2])


def pull(slopes: np.ndarray, inverse: np.ndarray, owners: np.ndarray) -> np.ndarray:
    """See :func:`liaam.kernels.reference.pull`."""
    pulled = np.empty((len(slopes), slopes.shape[2], 2), np.float32)
    _pull(slopes, inverse.astype(np.float32), owners, pulled)
    return pulled


@_jit
def _raster(points, triangles, owner, weights):
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        x0, y0 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        x1, y1 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        determinant = x0 * y1 - x1 * y0
        if determinant == 0.0:
            continue
        left, right = min(points[a, 0], points[b, 0], points[c, 0]), max(points[a, 0], points[b, 0], points[c, 0])
        above, below = min(points[a, 1], points[b, 1], points[c, 1]), max(points[a, 1], points[b, 1], points[c, 1])
        for y in range(int(np.floor(above)), int(np.ceil(below)) + 1):
            for x in range(int(np.floor(left)), int(np.ceil(right)) + 1):
                dx, dy = x - points[a, 0], y - points[a, 1]
                v, w = (y1 * dx - x1 * dy) / determinant, (x0 * dy - y0 * dx) / determinant
                u = 1.0 - v - w
                if owner[y, x] < 0 and u >= -ON_EDGE and v >= -ON_EDGE and w >= -ON_EDGE:
                    owner[y, x] = t
                    weights[y, x, 0], weights[y, x, 1], weights[y, x, 2] = u, v, w


def raster(points: np.ndarray, triangles: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """See :func:`liaam.kernels.reference.raster`."""
    owner, weights = np.full((height, width), -1, np.int32), np.zeros((height, width, 3))
    _raster(np.ascontiguousarray(points, dtype=np.float64), np.ascontiguousarray(triangles), owner, weights)
    return owner, weights


@_jit
def _add_line(a, b, total):
    """Add a conj(b) to a total; lines of 1 real number, pairs of real and imaginary part, and 1 real if even."""
    n = len(a)
    total[0] += a[0] * b[0]
    for i in range(1, n - 1, 2):
        total[i] += a[i] * b[i] + a[i + 1] * b[i + 1]
        total[i + 1] += a[i + 1] * b[i] - a[i] * b[i + 1]
    if n % 2 == 0:
        total[n - 1] += a[n - 1] * b[n - 1]


@_jit
def _correlate(left, right, total):
    height, width = total.shape
    for y in range(height):
        # Slices rather than indices in the inner loop: only then does the compiler see that they never wrap around.
        a, b, c, d, out = left[0, y, 1:], right[0, y, 1:], left[1, y, 1:], right[1, y, 1:], total[y, 1:]
        for i in range((width - 1) // 2):
            re, im = 2 * i, 2 * i + 1
            out[re] = a[re] * b[re] + a[im] * b[im] + c[re] * d[re] + c[im] * d[im]
            out[im] = a[im] * b[re] - a[re] * b[im] + c[im] * d[re] - c[re] * d[im]
    for x in (0, width - 1) if width % 2 == 0 else (0, 0):
        total[:, x] = _F(0.0)
        for c in range(2):
            _add_line(left[c, :, x], right[c, :, x], total[:, x])


def correlate(left: np.ndarray, right: np.ndarray, out: np.ndarray) -> np.ndarray:
    """See :func:`liaam.kernels.reference.correlate`."""
    _correlate(left, right, out)
    return out


@_jit
def _best_peaks(picture, least, reach, places, values):
    height, width = picture.shape
    count, found, limit = len(values), 0, least
    above = np.zeros(8 * ((width + 7) // 8), np.uint8)
    eights = above.view(np.uint64)
    for y in range(height):
        row = picture[y]
        for x in range(width):
            above[x] = row[x] > limit
        for chunk in range(len(eights)):
            if eights[chunk] == 0:
                continue
            for x in range(8 * chunk, min(8 * chunk + 8, width)):
                value = row[x]
                if not value > limit or not _is_peak(picture, y, x, reach):
                    continue
                at = min(found, count - 1)
                found = min(found + 1, count)
                while at > 0 and values[at - 1] < value:
                    values[at], places[at, 0], places[at, 1] = values[at - 1], places[at - 1, 0], places[at - 1, 1]
                    at -= 1
                values[at], places[at, 0], places[at, 1] = value, y, x
                if found == count:
                    limit = values[count - 1]
    return found


@_jit
def _is_peak(picture, y, x, reach):
    value, (height, width) = picture[y, x], picture.shape
    # The direct neighbours tell most that are none.
    if picture[y, min(x + 1, width - 1)] > value or picture[min(y + 1, height - 1), x] > value:
        return False
    for i in range(max(y - reach, 0), min(y + reach + 1, height)):
        for j in range(max(x - reach, 0), min(x + reach + 1, width)):
            if picture[i, j] > value:
                return False
    return True


def best_peaks(picture: np.ndarray, count: int, least: float, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """See :func:`liaam.kernels.reference.best_peaks`."""
    places, values = np.empty((count, 2), np.int64), np.empty(count, np.float32)
    found = _best_peaks(picture, np.float32(least), reach, places, values)
    return places[:found], values[:found]
