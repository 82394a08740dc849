"""Compiled loops over pixels: means of blocks of any size, blurs, and directions of gradients (numba)."""

from typing import NamedTuple

import numpy as np

from liaam.kernels.compiled import Compiled, compiled
from liaam.kernels.fields import Byte1, Byte2, Long1, Short1, Single1, Single2, Single3, Word1, Word2
from liaam.kernels.jit import F as _F
from liaam.kernels.jit import jit as _jit

# Callers allocate the arrays: compiling np.empty takes as long as compiling a loop.


@compiled
def _taps(n_in: int, start: float, size: float, first: Long1, shares: Single2) -> None:
    """First pixel of each block, and the weights of that pixel and the following ones in the block's mean."""
    for j in range(shares.shape[0]):
        low = start + j * size
        high = low + size if low + size < n_in else float(n_in)
        at = int(low) if low < n_in - 1 else n_in - 1
        first[j] = at
        for k in range(shares.shape[1]):
            left, right = float(at + k), float(at + k + 1)
            left, right = left if left > low else low, right if right < high else high
            shares[j, k] = (right - left) / size if right > left else 0.0


class _Cuts(NamedTuple):
    """Weights of pixels in blocks along both axes, and buffers for sums of rows of pixels."""

    first_x: np.ndarray
    shares_x: np.ndarray
    first_y: np.ndarray
    shares_y: np.ndarray
    light: np.ndarray
    sums: np.ndarray

    @classmethod
    def of(cls, size_in: tuple[int, int], start: tuple[float, float], size: float, shape: tuple[int, int]) -> "_Cuts":
        """Make the weights for an image of size (rows, columns)."""
        n_taps, arrays = int(np.ceil(size)) + 1, []
        for axis in (1, 0):
            first, shares = np.empty(shape[axis], np.int64), np.empty((shape[axis], n_taps), np.float32)
            _taps(size_in[axis], start[1 - axis], size, first, shares)
            arrays += [first, shares]
        # Blocks at the border read pixels outside, with weight 0.
        return cls(*arrays, *np.zeros((2, 4 * (size_in[1] + n_taps)), np.float32))


@compiled
def _cut(
    sums: Single1, across: int, between: int, known_at: int, first: Long1, shares: Single2, means: Single3, row: int
) -> None:
    """Average a sum of rows of pixels, with strides ``across`` of pixels and ``between`` colours, into a row of blocks.

    The fourth channel is contiguous from ``known_at``.
    """
    n_taps = shares.shape[1]
    reds, greens, blues, knowns = sums[0:], sums[between:], sums[2 * between :], sums[known_at:]
    for j in range(len(first)):
        at = first[j]
        red = green = blue = known = _F(0.0)
        for k in range(n_taps):
            w, x = shares[j, k], at + k
            own = across * x
            red += w * reds[own]
            green += w * greens[own]
            blue += w * blues[own]
            known += w * knowns[x]
        means[0, row, j], means[1, row, j], means[2, row, j], means[3, row, j] = red, green, blue, known


def _stored_means(
    lines: Byte2,
    table: Single1,
    limits: Byte1,
    first_x: Long1,
    shares_x: Single2,
    first_y: Long1,
    shares_y: Single2,
    light: Single1,
    sums: Single1,
    means: Single3,
) -> None:
    # Whole rows of pixels are converted to linear light and summed, which the compiler vectorises; only the sums are
    # averaged into blocks.
    width, reach, at, low, high = lines.shape[1] // 3, len(sums) // 4, -1, limits[0], limits[1]
    known = light[3 * reach :]
    for i in range(len(first_y)):
        for x in range(4 * reach):
            sums[x] = _F(0.0)
        for k in range(shares_y.shape[1]):
            y, share = first_y[i] + k, shares_y[i, k]
            if share <= _F(0.0):
                continue
            if y != at:  # blocks that cut through pixels share a row
                at, row = y, lines[y]
                for x in range(3 * width):
                    light[x] = table[row[x]]
                for x in range(width):
                    r, g, b = row[3 * x], row[3 * x + 1], row[3 * x + 2]
                    known[x] = _F((low <= r) & (low <= g) & (low <= b) & (r <= high) & (g <= high) & (b <= high))
            for x in range(4 * reach):
                sums[x] += share * light[x]
        _cut(sums, 3, 1, 3 * reach, first_x, shares_x, means, i)


_MEANS_OF = {
    np.dtype(np.uint8): Compiled(_stored_means),
    np.dtype(np.uint16): Compiled(_stored_means, lines=Word2, limits=Word1),
}


def stored_means(
    image: np.ndarray,
    table: np.ndarray,
    usable: tuple[int, int],
    start: tuple[float, float],
    size: float,
    shape: tuple[int, int],
) -> np.ndarray:
    """Average blocks of integer pixels (h, w, 3) in linear light, by a table of the light of each stored value.

    ``usable`` is the range of usable stored values, both included. The first block starts at ``start`` (x, y), where 0
    is the border of the first pixel. Blocks of side ``size``, at least 1, may cut through pixels, and ``shape`` is
    their number. Returns the mean R, G, B, and the fraction of usable pixels, (4, rows, columns) float32.
    """
    means = np.empty((4, *shape), np.float32)
    limits, lines = np.array(usable, image.dtype), np.ascontiguousarray(image).reshape(len(image), -1)
    _MEANS_OF[image.dtype](lines, table, limits, *_Cuts.of(image.shape[:2], start, size, shape), means)
    return means


@compiled
def _value_means(
    values: Single3,
    first_x: Long1,
    shares_x: Single2,
    first_y: Long1,
    shares_y: Single2,
    sums: Single1,
    means: Single3,
) -> None:
    width, reach = values.shape[2], len(sums) // 4
    for i in range(len(first_y)):
        for x in range(4 * reach):
            sums[x] = _F(0.0)
        for k in range(shares_y.shape[1]):
            y, share = first_y[i] + k, shares_y[i, k]
            if share <= _F(0.0):
                continue
            for c in range(4):
                total, row = sums[c * reach :], values[c, y]
                for x in range(width):
                    total[x] += share * row[x]
        _cut(sums, 1, reach, 3 * reach, first_x, shares_x, means, i)


def value_means(values: np.ndarray, start: tuple[float, float], size: float, shape: tuple[int, int]) -> np.ndarray:
    """Average blocks of four planes (4, h, w) float32 to (4, rows, columns); see :func:`stored_means`."""
    means = np.empty((4, *shape), np.float32)
    cuts = _Cuts.of(values.shape[1:], start, size, shape)
    _value_means(np.ascontiguousarray(values), *cuts[:4], cuts.sums, means)
    return means


@_jit
def _area_shares(n_in, n_out):
    """First and last pixel of each block that tiles a side, and their weights; pixels in between have full weight."""
    ends, shares = np.empty((n_out, 2), np.int64), np.empty((n_out, 2), np.float32)
    size = n_in / n_out
    for i in range(n_out):
        low, high = i * size, min((i + 1) * size, float(n_in))
        first = min(int(low + 1e-9), n_in - 1)
        last = max(min(int(np.ceil(high - 1e-9)) - 1, n_in - 1), first)
        ends[i, 0], ends[i, 1] = first, last
        # A block inside one pixel has only that pixel.
        shares[i, 0] = (min(first + 1.0, high) - low) / size
        shares[i, 1] = (high - last) / size if last > first else 0.0
    return ends, shares


@_jit
def _area_means(image, means):
    rows, columns = means.shape
    ends_y, shares_y = _area_shares(image.shape[0], rows)
    ends_x, shares_x = _area_shares(image.shape[1], columns)
    full_y, full_x = _F(rows / image.shape[0]), _F(columns / image.shape[1])
    line = np.empty(image.shape[1], np.float32)
    for i in range(rows):
        first, last = ends_y[i, 0], ends_y[i, 1]  # unpacking a row would count references, which takes 40 ns
        top, bottom, w0, w1 = image[first], image[last], shares_y[i, 0], shares_y[i, 1]
        for x in range(len(line)):
            line[x] = w0 * top[x] + w1 * bottom[x]
        for y in range(first + 1, last):
            between = image[y]
            for x in range(len(line)):
                line[x] += full_y * between[x]
        for j in range(columns):
            left, right = ends_x[j, 0], ends_x[j, 1]
            total = _F(0.0)
            for x in range(left + 1, right):
                total += line[x]
            means[i, j] = shares_x[j, 0] * line[left] + full_x * total + shares_x[j, 1] * line[right]


def area_means(picture: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Downsample an image (h, w) float32 to means of the blocks that tile it.

    Equivalent to OpenCV's ``INTER_AREA``; averaging rows first takes a fifth of its time.
    """
    means = np.empty(shape, np.float32)
    _area_means(np.ascontiguousarray(picture), means)
    return means


@_jit
def _stored_luminance(image, tables, luminance):
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            r, g, b = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            luminance[y, x] = tables[0, r] + tables[1, g] + tables[2, b]


def stored_luminance(image: np.ndarray, table: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted sum (h, w) float32 of the encoded channels of integer pixels, by a table of encoded values."""
    luminance = np.empty(image.shape[:2], np.float32)
    _stored_luminance(np.ascontiguousarray(image), np.outer(weights, table).astype(np.float32), luminance)
    return luminance


@compiled
def _bent_counts(lines: Byte2, rows: Long1, bent: Short1, sizes: Short1, counts: Long1) -> None:
    n = lines.shape[1]
    for k in range(len(rows)):
        y = rows[k]
        for i in range(n):
            bent[i] = np.int16(lines[y - 1, i]) - np.int16(2) * np.int16(lines[y, i]) + np.int16(lines[y + 1, i])
        for i in range(3, n - 3):  # an offset of 3: the same channel of the neighbour
            sizes[i] = abs(bent[i - 3] - np.int16(2) * bent[i] + bent[i + 3])
        for i in range(3, n - 3):
            counts[sizes[i]] += 1


def bent_counts(image: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Histogram (4081,) of the absolute response of the filter (1, -2, 1)' (1, -2, 1), which is zero on planes.

    The image is (h, w, 3) uint8, and the filter is centred on the given rows.
    """
    counts = np.zeros(16 * 255 + 1, np.int64)
    lines = np.ascontiguousarray(image).reshape(len(image), -1)
    bent, sizes = np.empty(lines.shape[1], np.int16), np.empty(lines.shape[1], np.int16)
    _bent_counts(lines, np.asarray(rows, np.int64), bent, sizes, counts)
    return counts


@compiled
def _soft_row(picture: Single2, y: int, turn: Single2, softness: float, across: Single1, down: Single1) -> None:
    """Rotated gradient g along a row, by differences of neighbours, normalised to g / sqrt(|g|^2 + softness^2).

    Rows are contiguous, so that the compiler can vectorise.
    """
    last, right = len(picture) - 1, picture.shape[1] - 1
    own, above, below = picture[y], picture[y - 1 if y > 0 else 0], picture[y + 1 if y < last else last]
    half, square = _F(1.0 if y == 0 or y == last else 0.5), _F(softness * softness)
    xx, xy, yx, yy = turn[0, 0], turn[0, 1], turn[1, 0], turn[1, 1]
    for x in range(1, right):
        across[x] = _F(0.5) * (own[x + 1] - own[x - 1])
    across[0], across[right] = own[1 if right > 0 else 0] - own[0], own[right] - own[right - 1 if right > 0 else 0]
    for x in range(right + 1):
        gx, gy = across[x], half * (below[x] - above[x])
        tx, ty = xx * gx + xy * gy, yx * gx + yy * gy
        scale = _F(1.0) / np.sqrt(tx * tx + ty * ty + square)
        across[x], down[x] = tx * scale, ty * scale


@compiled
def _soft_directions(
    picture: Single2, turn: Single2, softness: float, across: Single1, down: Single1, out: Single3
) -> None:
    for y in range(picture.shape[0]):
        _soft_row(picture, y, turn, softness, across, down)
        for x in range(picture.shape[1]):
            out[y, x, 0], out[y, x, 1] = across[x], down[x]


def soft_directions(picture: np.ndarray, turn: np.ndarray, softness: float) -> np.ndarray:
    """Softly normalised gradient (h, w, 2) float32 of an image (h, w): g / sqrt(|g|^2 + softness^2).

    ``softness`` is the gradient per pixel for which the squared length is normalised to one half, and ``turn`` (2, 2)
    the rotation from the image's to the object's axes.
    """
    out = np.empty((*picture.shape, 2), np.float32)
    turn = np.ascontiguousarray(turn, dtype=np.float32)
    across, down = np.empty((2, picture.shape[1]), np.float32)
    _soft_directions(np.ascontiguousarray(picture, dtype=np.float32), turn, softness, across, down, out)
    return out


@compiled
def _light_planes(
    means: Single3, weights: Single1, limits: Single1, grey: bool, planes: Single3, known: Single2
) -> bool:
    every, by_red, by_green, by_blue = True, weights[0], weights[1], weights[2]
    least, floor, dark, unusable = limits[0], limits[1], limits[2], limits[3]
    for y in range(means.shape[1]):
        for x in range(means.shape[2]):
            red, green, blue = means[0, y, x], means[1, y, x], means[2, y, x]
            planes[0, y, x] = by_red * red + by_green * green + by_blue * blue + dark
            planes[1, y, x] = red if red > floor else floor
            planes[2, y, x] = green if green > floor else floor
            planes[3, y, x] = blue if blue > floor else floor
            own = (means[3, y, x] > least) & (not grey)
            known[y, x] = _F(own)
            planes[4, y, x] = _F(own) + unusable
            every &= own
    return every


def light_planes(
    means: np.ndarray, weights: np.ndarray, least: float, grey: bool, floor: float, dark: float, unusable: float
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Prepare linear light (4, h, w) of blocks for logarithms, and mask unusable colours.

    Colours are usable where the fraction of usable pixels exceeds ``least``, unless the image is grey; otherwise they
    have weight ``unusable`` in a blur. ``weights`` are those of R, G and B in brightness, ``floor`` their lower bound,
    and ``dark`` is added to brightness. Returns brightness, R, G, B and the weights of the colours in a blur, (5, h, w)
    float32; 1 where colours are usable, else 0, (h, w) float32; and whether they are usable everywhere.
    """
    planes, known = np.empty((5, *means.shape[1:]), np.float32), np.empty(means.shape[1:], np.float32)
    means, weights = np.ascontiguousarray(means), np.asarray(weights, np.float32)
    limits = np.array([least, floor, dark, unusable], np.float32)
    return planes, known, _light_planes(means, weights, limits, bool(grey), planes, known)


@compiled
def _blur(planes: Single3, taps: Single1, line: Single1, blurred: Single3) -> None:
    # Blur along columns into a line, then along the line.
    reach, height, width = len(taps) - 1, planes.shape[1], planes.shape[2]
    middle = line[reach:]
    for p in range(planes.shape[0]):
        for y in range(height):
            own, to, tap = planes[p, y], blurred[p, y], taps[0]
            for x in range(width):
                middle[x] = tap * own[x]
            for k in range(1, reach, 2):  # two at a time halves the reads and writes of the line
                near, far = taps[k], taps[k + 1]
                above, below = planes[p, y - k if y > k else 0], planes[p, y + k if y + k < height else height - 1]
                top, bottom = (
                    planes[p, y - k - 1 if y > k else 0],
                    planes[p, y + k + 1 if y + k + 1 < height else height - 1],
                )
                for x in range(width):
                    middle[x] += near * (above[x] + below[x]) + far * (top[x] + bottom[x])
            for k in range(reach):
                line[k], line[reach + width + k] = line[reach], line[reach + width - 1]
            for x in range(width):
                to[x] = tap * middle[x]
            for k in range(1, reach, 2):
                near, far, left, right = taps[k], taps[k + 1], line[reach - k :], line[reach + k :]
                first, last = line[reach - k - 1 :], line[reach + k + 1 :]
                for x in range(width):
                    to[x] += near * (left[x] + right[x]) + far * (first[x] + last[x])


REACH = 3.0
"""Standard deviations at which a blur kernel is truncated."""


def blur_planes(planes: np.ndarray, sigma: float, blurred: np.ndarray) -> None:
    """Blur planes (n, h, w) with standard deviation ``sigma`` above 0 to ``blurred``; border pixels are replicated."""
    reach = int(np.ceil(REACH * sigma))
    # An even number of taps on each side, for the loop over pairs.
    taps = np.exp(-0.5 * np.square(np.arange(reach + reach % 2 + 1) / sigma))
    taps /= 2.0 * taps.sum() - taps[0]
    _blur(planes, taps.astype(np.float32), np.empty(planes.shape[2] + 2 * len(taps), np.float32), blurred)


@compiled
def _lay_out(
    planes: Single3,
    known: Single2,
    usable: Single2,
    soft: bool,
    turn: Single2,
    softness: float,
    across: Single1,
    down: Single1,
    channels: Single3,
) -> None:
    height, width, zero = known.shape[0], known.shape[1], _F(0.0)
    for y in range(height):
        if soft:
            _soft_row(planes[0], y, turn, softness, across, down)
        for x in range(width):
            own = channels[y, x]
            red, green, blue = planes[1, y, x], planes[2, y, x], planes[3, y, x]
            if soft:
                own[0], own[1], own[2], own[3], own[4], own[5] = across[x], down[x], red, green, blue, known[y, x]
            else:
                own[0], own[1], own[2], own[3], own[4], own[5] = red, green, blue, zero, zero, zero
            own[6], own[7] = zero, usable[y, x]


def lay_out(
    planes: np.ndarray, known: np.ndarray, usable: np.ndarray, soft: bool, turn: np.ndarray, softness: float
) -> np.ndarray:
    """Interleave planes (4, h, w) to the eight channels (h, w, 8) float32 that the kernels sample, last ``usable``.

    The planes are brightness and three colours, and ``known`` is the weight of the colours. If ``soft``, the channels
    are directions (see :func:`soft_directions`), colours and ``known``, otherwise only the colours.
    """
    channels = np.empty((*known.shape, 8), np.float32)
    turn = np.ascontiguousarray(turn, np.float32)
    across, down = np.empty(known.shape[1], np.float32), np.empty(known.shape[1], np.float32)
    _lay_out(planes, known, usable, bool(soft), turn, softness, across, down, channels)
    return channels
