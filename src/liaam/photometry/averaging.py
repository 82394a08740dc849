"""Compiled loops over pixels: means of blocks of any size, blurs, and directions of gradients (numba)."""

from math import prod

import numpy as np

from liaam.kernels.compiled import Compiled, compiled
from liaam.kernels.fields import Byte2, Byte3, Double1, F, Long1, Long2, Short1, Single1, Single2, Single3, Word2, Word3
from liaam.kernels.vectors import SIZE, every, halves, interleave, load, store

# Callers allocate the arrays: compiling np.empty takes as long as compiling a loop. Loops with vectors of eight numbers
# may write beyond a row: the next row overwrites that, and arrays have room after the last.

ROOM = SIZE * SIZE
"""Room after the last row, numbers."""


@compiled
def _taps(n_in: int, start: float, size: float, first: Long1, shares: Single2, begin: int, end: int) -> None:
    """First pixel of blocks ``begin`` to ``end``, and the weights of it and the following ones in the block's mean."""
    for j in range(begin, end):
        low = start + (j - begin) * size
        high = low + size if low + size < n_in else float(n_in)
        at = int(low) if low < n_in - 1 else n_in - 1
        first[j] = at
        for k in range(shares.shape[1]):
            left, right = float(at + k), float(at + k + 1)
            left, right = left if left > low else low, right if right < high else high
            shares[j, k] = (right - left) / size if right > left else 0.0


@compiled
def _cut(sums: Single1, first: Long1, shares: Single2, n: int, means: Single1, to: int) -> None:
    """Average a sum of rows of pixels, four numbers each, into a row of n blocks, two at a time."""
    for j in range(0, n, 2):
        total = F(0.0) * load(sums, 0)
        for k in range(shares.shape[1]):
            weights, a, b = halves(every(shares[j, k]), every(shares[j + 1, k])), first[j] + k, first[j + 1] + k
            total = total + weights * halves(load(sums, 4 * a), load(sums, 4 * b))
        store(means, to + 4 * j, total)


def _stored_means(
    lines: Byte2, tables: Single2, grid: Double1, first: Long1, shares: Single2, rows: Single2, means: Single1, n: int
) -> None:
    # Rows of pixels are converted to linear light and summed; only the sums are averaged into blocks.
    even, at, sums, light = n + n % 2, -1, rows[0], rows[1]
    width, reds, greens, blues = lines.shape[1] // 3, tables[0], tables[1], tables[2]
    _taps(width, grid[0], grid[2], first, shares, 0, even)
    _taps(lines.shape[0], grid[1], grid[2], first, shares, even, len(first))
    for i in range(even, len(first)):
        for x in range(len(sums)):
            sums[x] = F(0.0)
        for k in range(shares.shape[1]):
            y, share = first[i] + k, shares[i, k]
            if share <= F(0.0):
                continue
            known, at, row = y == at, y, lines[y]  # blocks that cut through pixels share a row
            if known:
                for x in range(len(sums)):
                    sums[x] += share * light[x]
                continue
            for x in range(0, width, 2):
                a = 3 * x
                b = a + 3 if x + 1 < width else a
                two = halves(load(reds, 4 * int(row[a])), load(reds, 4 * int(row[b])))
                two = two * halves(load(greens, 4 * int(row[a + 1])), load(greens, 4 * int(row[b + 1])))
                two = two * halves(load(blues, 4 * int(row[a + 2])), load(blues, 4 * int(row[b + 2])))
                store(light, 4 * x, two)
                store(sums, 4 * x, load(sums, 4 * x) + share * two)
        _cut(sums, first, shares, n, means, 4 * n * (i - even))


@compiled
def _value_means(
    lines: Single2, grid: Double1, first: Long1, shares: Single2, sums: Single1, means: Single1, n: int
) -> None:
    even = n + n % 2
    _taps(lines.shape[1] // 4, grid[0], grid[2], first, shares, 0, even)
    _taps(lines.shape[0], grid[1], grid[2], first, shares, even, len(first))
    for i in range(even, len(first)):
        for x in range(len(sums)):
            sums[x] = F(0.0)
        for k in range(shares.shape[1]):
            share = shares[i, k]
            if share > F(0.0):
                row = lines[first[i] + k]
                for x in range(lines.shape[1]):
                    sums[x] += share * row[x]
        _cut(sums, first, shares, n, means, 4 * n * (i - even))


_MEANS_OF = {
    np.dtype(np.uint8): Compiled(_stored_means),
    np.dtype(np.uint16): Compiled(_stored_means, lines=Word2),
}


def light_tables(light: np.ndarray, usable: tuple[int, int]) -> np.ndarray:
    """Make the tables for :func:`stored_means`, (3, 4 n + 4) float32, from the light (n,) of each stored value.

    ``usable`` is the range of usable stored values, both included. The product of the entries of a pixel's R, G and B
    is its light R, G and B, and 1 if all three are usable, else 0.
    """
    n, values = len(light), np.arange(len(light))
    tables = np.ones((3, n + 1, 4), np.float32)  # room for a vector after the last entry
    for channel in range(3):
        tables[channel, :n, channel] = light
        tables[channel, :n, 3] = (usable[0] <= values) & (values <= usable[1])
    return tables.reshape(3, -1)


def stored_means(
    image: np.ndarray, tables: np.ndarray, start: tuple[float, float], size: float, shape: tuple[int, int]
) -> np.ndarray:
    """Average blocks of integer pixels (h, w, 3) in linear light, by tables from :func:`light_tables`.

    The first block starts at ``start`` (x, y), where 0 is the border of the first pixel. Blocks of side ``size``, at
    least 1, may cut through pixels, and ``shape`` is their number. Returns the mean R, G, B, and the fraction of usable
    pixels, (rows, columns, 4) float32.
    """
    lines, grid, first, shares, sums, means = _means_buffers(image, start, size, shape)
    _MEANS_OF[image.dtype](lines, tables, grid, first, shares, sums, means, shape[1])
    return means[:-4].reshape(*shape, 4)


def value_means(values: np.ndarray, start: tuple[float, float], size: float, shape: tuple[int, int]) -> np.ndarray:
    """Average blocks of pixels of four numbers (h, w, 4) float32 to (rows, columns, 4); see :func:`stored_means`."""
    lines, grid, first, shares, sums, means = _means_buffers(values, start, size, shape)
    _value_means(lines, grid, first, shares, sums[0], means, shape[1])
    return means[:-4].reshape(*shape, 4)


def _means_buffers(
    image: np.ndarray, start: tuple[float, float], size: float, shape: tuple[int, int]
) -> tuple[np.ndarray, ...]:
    """Return an image's rows, the grid of blocks, and room for taps, two sums of rows, and means."""
    (rows, columns), n_taps = shape, int(np.ceil(size)) + 1
    n = columns + columns % 2 + rows
    lines, grid = np.ascontiguousarray(image).reshape(len(image), -1), np.array([*start, size], np.float64)
    # Blocks at the border read pixels outside, with weight 0.
    sums = np.zeros((2, 4 * (image.shape[1] + n_taps + 2)), np.float32)
    first, shares = np.empty(n, np.int64), np.empty((n, n_taps), np.float32)
    return lines, grid, first, shares, sums, np.empty(4 * (rows * columns + 1), np.float32)


@compiled
def _area_shares(n_in: int, n_out: int, at: int, ends: Long2, shares: Single2) -> None:
    """First and last pixel of each block that tiles a side, and their weights; pixels in between have full weight.

    The results are written from row ``at`` on.
    """
    size = n_in / n_out
    for j in range(n_out):
        i = at + j
        low, high = j * size, min((j + 1) * size, float(n_in))
        first = min(int(low + 1e-9), n_in - 1)
        last = max(min(int(np.ceil(high - 1e-9)) - 1, n_in - 1), first)
        ends[i, 0], ends[i, 1] = first, last
        # A block inside one pixel has only that pixel.
        shares[i, 0] = (min(first + 1.0, high) - low) / size
        shares[i, 1] = (high - last) / size if last > first else 0.0


@compiled
def _area_means(image: Single2, ends: Long2, shares: Single2, line: Single1, means: Single2) -> None:
    rows, columns = means.shape[0], means.shape[1]
    _area_shares(image.shape[0], rows, 0, ends, shares)
    _area_shares(image.shape[1], columns, rows, ends, shares)
    full_y, full_x = F(rows / image.shape[0]), F(columns / image.shape[1])
    for i in range(rows):
        first, last = ends[i, 0], ends[i, 1]
        top, bottom, w0, w1 = image[first], image[last], shares[i, 0], shares[i, 1]
        for x in range(len(line)):
            line[x] = w0 * top[x] + w1 * bottom[x]
        for y in range(first + 1, last):
            between = image[y]
            for x in range(len(line)):
                line[x] += full_y * between[x]
        for j in range(columns):
            at = rows + j
            left, right = ends[at, 0], ends[at, 1]
            total = F(0.0)
            for x in range(left + 1, right):
                total += line[x]
            means[i, j] = shares[at, 0] * line[left] + full_x * total + shares[at, 1] * line[right]


def area_means(picture: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Downsample an image (h, w) float32 to means of the blocks that tile it.

    Equivalent to OpenCV's ``INTER_AREA``; averaging rows first takes a fifth of its time.
    """
    means, line = np.empty(shape, np.float32), np.empty(picture.shape[1], np.float32)
    ends, shares = np.empty((sum(shape), 2), np.int64), np.empty((sum(shape), 2), np.float32)
    _area_means(np.ascontiguousarray(picture, np.float32), ends, shares, line, means)
    return means


def _stored_luminance(image: Byte3, tables: Single2, luminance: Single2) -> None:
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            r, g, b = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            luminance[y, x] = tables[0, r] + tables[1, g] + tables[2, b]


_LUMINANCE_OF = {
    np.dtype(np.uint8): Compiled(_stored_luminance),
    np.dtype(np.uint16): Compiled(_stored_luminance, image=Word3),
}


def stored_luminance(image: np.ndarray, table: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted sum (h, w) float32 of the encoded channels of integer pixels, by a table of encoded values."""
    luminance = np.empty(image.shape[:2], np.float32)
    tables = np.outer(weights, table).astype(np.float32)
    _LUMINANCE_OF[image.dtype](np.ascontiguousarray(image), tables, luminance)
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
def _soft_row(
    flat: Single1, height: int, width: int, y: int, turn: Single2, softness: float, across: Single1, down: Single1
) -> None:
    """Rotated gradient g along a row, by differences of neighbours, normalised to g / sqrt(|g|^2 + softness^2).

    Rows are contiguous, so that the compiler can vectorise.
    """
    right, square, at = width - 1, F(softness * softness), y * width
    over, under = at - (width if y > 0 else 0), at + (width if y < height - 1 else 0)
    own, above, below = flat[at : at + width], flat[over : over + width], flat[under : under + width]
    half = F(0.5 if 0 < y < height - 1 else 1.0)
    xx, xy, yx, yy = turn[0, 0], turn[0, 1], turn[1, 0], turn[1, 1]
    for x in range(1, right):
        across[x] = F(0.5) * (own[x + 1] - own[x - 1])
    across[0], across[right] = own[1 if right > 0 else 0] - own[0], own[right] - own[right - 1 if right > 0 else 0]
    for x in range(width):
        gx, gy = across[x], half * (below[x] - above[x])
        tx, ty = xx * gx + xy * gy, yx * gx + yy * gy
        scale = F(1.0) / np.sqrt(tx * tx + ty * ty + square)
        across[x], down[x] = tx * scale, ty * scale


@compiled
def _soft_directions(flat: Single1, turn: Single2, softness: float, lines: Single2, out: Single3) -> None:
    height, width = out.shape[0], out.shape[1]
    for y in range(height):
        _soft_row(flat, height, width, y, turn, softness, lines[0], lines[1])
        for x in range(width):
            out[y, x, 0], out[y, x, 1] = lines[0, x], lines[1, x]


def soft_directions(picture: np.ndarray, turn: np.ndarray, softness: float) -> np.ndarray:
    """Softly normalised gradient (h, w, 2) float32 of an image (h, w): g / sqrt(|g|^2 + softness^2).

    ``softness`` is the gradient per pixel for which the squared length is normalised to one half, and ``turn`` (2, 2)
    the rotation from the image's to the object's axes.
    """
    out = np.empty((*picture.shape, 2), np.float32)
    turn = np.ascontiguousarray(turn, dtype=np.float32)
    lines = np.empty((2, picture.shape[1]), np.float32)
    _soft_directions(np.ascontiguousarray(picture, dtype=np.float32).reshape(-1), turn, softness, lines, out)
    return out


@compiled
def _light_planes(means: Single1, weights: Single1, limits: Single1, planes: Single1) -> float:
    n, by_red, by_green, by_blue, count = len(means) // 4, weights[0], weights[1], weights[2], F(0.0)
    least, floor, dark = limits[0], limits[1], limits[2]
    bright, reds, greens = planes[0:n], planes[n : 2 * n], planes[2 * n : 3 * n]
    blues, known, usable = planes[3 * n : 4 * n], planes[4 * n : 5 * n], planes[5 * n : 6 * n]
    for i in range(n):
        red, green, blue = means[4 * i], means[4 * i + 1], means[4 * i + 2]
        own = F(1.0) if means[4 * i + 3] > least else F(0.0)
        bright[i] = by_red * red + by_green * green + by_blue * blue + dark
        reds[i], greens[i], blues[i] = max(red, floor), max(green, floor), max(blue, floor)
        known[i], usable[i] = own, F(1.0)
        count += own
    return float(count)


def light_planes(
    means: np.ndarray, weights: np.ndarray, least: float, grey: bool, floor: float, dark: float
) -> tuple[np.ndarray, bool]:
    """Prepare linear light (h, w, 4) of blocks for logarithms, and mask unusable colours.

    Colours are usable where the fraction of usable pixels exceeds ``least``, unless the image is grey. ``weights`` are
    those of R, G and B in brightness, ``floor`` their lower bound, and ``dark`` is added to brightness. Returns planes
    from :func:`with_room`, all pixels usable, and whether the colours are usable everywhere.
    """
    planes, limits = with_room((6, *means.shape[:2])), np.array([np.inf if grey else least, floor, dark], np.float32)
    means = np.ascontiguousarray(means).reshape(-1)
    n_known = _light_planes(means, np.asarray(weights, np.float32), limits, planes.base)
    return planes, n_known == len(means) // 4


def with_room(shape: tuple[int, ...]) -> np.ndarray:
    """Allocate an array of float32, whose base is flat and has room for eight vectors more."""
    n = prod(shape)
    return np.empty(n + ROOM, np.float32)[:n].reshape(shape)


@compiled
def _blur_row(
    planes: Single1, plane: int, height: int, width: int, y: int, taps: Single1, line: Single1, to: Single1, at: int
) -> None:
    """Blur a row of the plane that begins at an index: along columns into a line, then along the line."""
    reach, begin = len(taps) - 1, plane + y * width
    for x in range(0, width, 2 * SIZE):
        up = down = begin + x
        low, high = taps[0] * load(planes, up), taps[0] * load(planes, up + SIZE)
        for k in range(1, reach + 1):
            up -= width if k <= y else 0
            down += width if y + k < height else 0
            low = low + taps[k] * (load(planes, up) + load(planes, down))
            high = high + taps[k] * (load(planes, up + SIZE) + load(planes, down + SIZE))
        store(line, reach + x, low)
        store(line, reach + x + SIZE, high)
    for k in range(reach):
        line[k], line[reach + width + k] = line[reach], line[reach + width - 1]
    for x in range(0, width, 2 * SIZE):
        left = right = reach + x
        low, high = taps[0] * load(line, left), taps[0] * load(line, left + SIZE)
        for k in range(1, reach + 1):
            left, right = left - 1, right + 1
            low = low + taps[k] * (load(line, left) + load(line, right))
            high = high + taps[k] * (load(line, left + SIZE) + load(line, right + SIZE))
        store(to, at + x, low)
        store(to, at + x + SIZE, high)


@compiled
def _blur(planes: Single1, height: int, width: int, taps: Single1, line: Single1, blurred: Single1) -> None:
    for row in range((len(planes) - ROOM) // width):
        y = row % height
        _blur_row(planes, (row - y) * width, height, width, y, taps, line, blurred, row * width)


REACH = 3.0
"""Standard deviations at which a blur kernel is truncated."""


def _blur_buffers(sigma: float, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return half of a blur kernel, with an even number of taps beside the centre, and room for a row to blur."""
    reach = int(np.ceil(REACH * sigma))
    reach += reach % 2
    taps = np.exp(-0.5 * np.square(np.arange(reach + 1) / max(sigma, 1e-9)))
    taps /= 2.0 * taps.sum() - 1.0
    return taps.astype(np.float32), np.empty(width + 2 * (reach + SIZE), np.float32)


def blur_planes(planes: np.ndarray, sigma: float) -> np.ndarray:
    """Blur planes (n, h, w) with standard deviation ``sigma``; border pixels are replicated."""
    given, blurred = with_room(planes.shape), with_room(planes.shape)
    given[...] = planes
    _blur(given.base, *planes.shape[1:], *_blur_buffers(sigma, planes.shape[2]), blurred.base)
    return blurred


@compiled
def _divide(line: Single1, weights: Single1, least: float, n: int) -> None:
    for x in range(n):
        line[x] /= weights[x] + F(least)


@compiled
def _lay_out(
    planes: Single1, height: int, width: int, soft: bool, by_usable: bool, by_known: bool, least: float, turn: Single2,
    softness: float, taps: Single1, line: Single1, bright: Single1, lines: Single1, channels: Single1,
) -> None:  # fmt: skip
    n, stride, colours, room = height * width, len(lines) // 9, 2 if soft else 0, F(least)
    known, usable, weights = lines[5 * stride :], lines[7 * stride :], lines[8 * stride :]
    for x in range(n):  # pixels count in the blur by their weight, but for a little
        if soft and by_usable:
            planes[x] *= planes[5 * n + x] + room
        if by_known:
            planes[n + x] *= planes[4 * n + x] + room
            planes[2 * n + x] *= planes[4 * n + x] + room
            planes[3 * n + x] *= planes[4 * n + x] + room
    for y in range(height if soft else 0):
        _blur_row(planes, 0, height, width, y, taps, line, bright, y * width)
        if by_usable:
            _blur_row(planes, 5 * n, height, width, y, taps, line, weights, 0)
            _divide(bright[y * width : (y + 1) * width], weights, least, width)
    for y in range(height):
        own = y * width
        for c in range(3):
            _blur_row(planes, (c + 1) * n, height, width, y, taps, line, lines, (colours + c) * stride)
        if by_known:
            _blur_row(planes, 4 * n, height, width, y, taps, line, weights, 0)
            for c in range(3):
                _divide(lines[(colours + c) * stride :], weights, least, width)
        if soft:
            _soft_row(bright, height, width, y, turn, softness, lines[0:], lines[stride:])
            for x in range(width):
                known[x] = planes[4 * n + own + x]
        for x in range(width):
            usable[x] = planes[(5 if soft else 4) * n + own + x]
        for x in range(0, width, SIZE):
            interleave(channels, SIZE * (own + x), lines, x, stride)


def lay_out(
    planes: np.ndarray,
    weighed: tuple[bool, bool],
    sigma: float,
    unusable: float,
    soft: bool,
    turn: np.ndarray,
    softness: float,
) -> np.ndarray:
    """Blur planes (6, h, w) and interleave them to the channels (h, w, 8) float32 that the kernels sample.

    The planes, from :func:`with_room`, are overwritten: brightness, three colours, the weight of the colours, and the
    weight of the pixel. If ``soft``, the channels are directions (see :func:`soft_directions`), colours, their weight,
    0, and the weight of the pixel. Otherwise they are the colours, zeros, and the weight of the colours. ``sigma`` is
    the standard deviation of the blur, ``weighed`` whether brightness, and colours, are blurred with the weights of the
    pixels plus ``unusable``.
    """
    height, width = planes.shape[1:]
    channels, switches = with_room((height, width, 8)), (soft, *(each and sigma > 0.0 for each in weighed))
    bright, lines = np.empty(height * width + ROOM, np.float32), np.zeros(9 * (width + -width % (2 * SIZE)), np.float32)
    blur, turn = _blur_buffers(sigma, width), np.ascontiguousarray(turn, np.float32)
    _lay_out(planes.base, height, width, *switches, unusable, turn, softness, *blur, bright, lines, channels.base)
    return channels
