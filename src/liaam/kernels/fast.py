"""Compiled loops over the pixels of images, for the search and for painting."""

import numpy as np

from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Byte1, Double2, Double3, F, Int2, Long2, Single1, Single2, Single3, Wide1
from liaam.kernels.reference import ON_EDGE as _ON_EDGE


@compiled
def correlate(left: Single3, right: Single3, total: Single2) -> None:
    """Compute the spectrum of the correlation of two images (2, h, w), left conj(right), summed over their channels.

    All are Fourier transforms of real channels as packed by OpenCV's ``dft``: in each row a real number, pairs of real
    and imaginary part, and another real number if w is even. The columns of real numbers are packed in the same way.
    ``total`` (h, w) is the output.
    """
    height, width = total.shape[0], total.shape[1]
    for y in range(height):
        # Slices instead of indices let the compiler see that the inner loop's indices are never negative.
        a, b, c, d = left[0, y][1:width], right[0, y][1:width], left[1, y][1:width], right[1, y][1:width]
        out = total[y][1:width]
        for i in range((width - 1) // 2):
            re, im = 2 * i, 2 * i + 1
            out[re] = a[re] * b[re] + a[im] * b[im] + c[re] * d[re] + c[im] * d[im]
            out[im] = a[im] * b[re] - a[re] * b[im] + c[im] * d[re] - c[re] * d[im]
    _correlate_column(left, right, total, 0)
    if width % 2 == 0:
        _correlate_column(left, right, total, width - 1)


@compiled
def _correlate_column(left: Single3, right: Single3, total: Single2, x: int) -> None:
    """Correlate a column: 1 real number, pairs of real and imaginary part, and 1 real number if there are even many."""
    n = total.shape[0]
    for y in range(n):
        total[y, x] = F(0.0)
    for c in range(2):
        a, b = left[c], right[c]
        total[0, x] += a[0, x] * b[0, x]
        for y in range(1, n - 1, 2):
            total[y, x] += a[y, x] * b[y, x] + a[y + 1, x] * b[y + 1, x]
            total[y + 1, x] += a[y + 1, x] * b[y, x] - a[y, x] * b[y + 1, x]
        if n % 2 == 0:
            total[n - 1, x] += a[n - 1, x] * b[n - 1, x]


@compiled
def _best_peaks(
    picture: Single2, least: float, reach: int, above: Byte1, eights: Wide1, places: Long2, values: Single1
) -> int:
    # ``eights`` is ``above`` as numbers of eight bytes: most are 0, and skipped at once.
    height, width, count, found, limit = picture.shape[0], picture.shape[1], len(values), 0, F(least)
    for y in range(height):
        row = picture[y]
        for x in range(width):
            above[x] = 1 if row[x] > limit else 0
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


@compiled
def _is_peak(picture: Single2, y: int, x: int, reach: int) -> bool:
    value, height, width = picture[y, x], picture.shape[0], picture.shape[1]
    # Two direct neighbours rule out most pixels.
    if picture[y, min(x + 1, width - 1)] > value or picture[min(y + 1, height - 1), x] > value:
        return False
    for i in range(max(y - reach, 0), min(y + reach + 1, height)):
        for j in range(max(x - reach, 0), min(x + reach + 1, width)):
            if picture[i, j] > value:
                return False
    return True


def best_peaks(picture: np.ndarray, count: int, least: float, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Find up to `count` local maxima above `least` of a finite image (h, w), the largest first; ties in raster order.

    No pixel within a square of `reach` pixels around a maximum is larger. Return rows and columns (k, 2), and values
    (k,).
    """
    places, values = np.empty((count, 2), np.int64), np.empty(count, np.float32)
    above = np.zeros(picture.shape[1] + -picture.shape[1] % 8, np.uint8)
    picture = np.ascontiguousarray(picture, np.float32)
    found = _best_peaks(picture, least, reach, above, above.view(np.uint64), places, values)
    return places[:found], values[:found]


@compiled
def _carry(points: Double2, triangles: Int2, values: Double2, owner: Int2, carried: Double3) -> None:
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        a, b, c = points[i], points[j], points[k]
        x0, y0, x1, y1 = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
        determinant = x0 * y1 - x1 * y0
        if determinant == 0:
            continue
        left, right = min(min(a[0], b[0]), c[0]), max(max(a[0], b[0]), c[0])
        above, below = min(min(a[1], b[1]), c[1]), max(max(a[1], b[1]), c[1])
        for y in range(max(int(np.floor(above)), 0), min(int(np.ceil(below)) + 1, owner.shape[0])):
            for x in range(max(int(np.floor(left)), 0), min(int(np.ceil(right)) + 1, owner.shape[1])):
                dx, dy = x - a[0], y - a[1]
                v, w = (y1 * dx - x1 * dy) / determinant, (x0 * dy - y0 * dx) / determinant
                u = 1.0 - v - w
                if owner[y, x] >= 0 or u < -_ON_EDGE or v < -_ON_EDGE or w < -_ON_EDGE:
                    continue
                owner[y, x] = t
                for n in range(values.shape[1]):
                    carried[y, x, n] = u * values[i, n] + v * values[j, n] + w * values[k, n]


def carry(
    points: np.ndarray, triangles: np.ndarray, values: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate values of a mesh's vertices, (n, c) float64, at the pixels of an image.

    Return the triangle of each pixel as :func:`liaam.kernels.reference.raster` does, and the values, (height, width, c)
    float64, 0 outside the mesh. Vertices (n, 2) may lie outside the image.
    """
    owner, carried = np.full((height, width), -1, np.int32), np.zeros((height, width, values.shape[1]))
    points, values = (np.ascontiguousarray(each, np.float64) for each in (points, values))
    _carry(points, np.ascontiguousarray(triangles, np.int32), values, owner, carried)
    return owner, carried
