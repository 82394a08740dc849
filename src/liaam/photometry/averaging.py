"""What is worked out pixel by pixel: block means of any size, and directions of gradients (numba)."""

import numpy as np

from liaam.jit import F as _F
from liaam.jit import jit as _jit


@_jit
def _shares(n_in, n_out, start, size):
    """Give the first block that each pixel belongs to (-1: outside; -2: and so is the next) and its share in that."""
    first, share = np.empty(n_in, np.int64), np.empty(n_in, np.float32)
    for i in range(n_in):
        left = (i - start) / size
        block = int(np.floor(left))
        within = min((block + 1) * size + start - i, 1.0)
        first[i] = block if -1 <= block < n_out else -2
        share[i] = within / size
    return first, share


@_jit
def _add_row(row, means, y, weight):
    """Add a row of blocks, and one more on each side that does not count, to the means' row y if there is one."""
    if not 0 <= y < len(means):
        return
    line, inner = means[y], row[1:-1]
    width, channels = inner.shape
    for x in range(width):
        for c in range(channels):
            line[x, c] += weight * inner[x, c]


@_jit
def _stored_means(image, table, low, high, start_x, start_y, size, means):
    # Rows of pixels are brought to light and added up as they are, which the compiler does many at a time; only what
    # they add up to, a row of blocks, is cut into blocks.
    height, width = image.shape[:2]
    first_x, share_x = _shares(width, means.shape[1], start_x, size)
    first_y, share_y = _shares(height, means.shape[0], start_y, size)
    rest, at, left = _F(1.0 / size), -2, _F(0.0)
    light, usable = np.zeros(3 * width, np.float32), np.zeros(width, np.float32)
    sums, known = np.zeros(3 * width, np.float32), np.zeros(width, np.float32)
    blocks = np.empty((means.shape[1] + 2, 4), np.float32)  # one more on each side: no test in the loop
    for y in range(height):
        block, share = first_y[y], share_y[y]
        if block < -1:
            continue
        at = block if at < -1 else at
        while at < block:
            _cut(sums, known, first_x, share_x, rest, at, blocks, means)
            _set(sums, left, light)  # the last row's share in the next block
            _set(known, left, usable)
            at, left = at + 1, _F(0.0)
        pixels, left = image[y].reshape(-1), rest - share
        for i in range(3 * width):
            light[i] = table[pixels[i]]
        for x in range(width):
            r, g, b = pixels[3 * x], pixels[3 * x + 1], pixels[3 * x + 2]
            usable[x] = _F((low <= min(r, min(g, b))) & (max(r, max(g, b)) <= high))
        for i in range(3 * width):
            sums[i] += share * light[i]
        for x in range(width):
            known[x] += share * usable[x]
    _cut(sums, known, first_x, share_x, rest, at, blocks, means)
    _set(sums, left, light)
    _set(known, left, usable)
    _cut(sums, known, first_x, share_x, rest, at + 1, blocks, means)


@_jit
def _set(total, share, row):
    for i in range(len(total)):
        total[i] = share * row[i]


@_jit
def _cut(sums, known, first_x, share_x, rest, row, blocks, means):
    """Cut sums of rows of pixels into a row of blocks, if there is one."""
    if not 0 <= row < len(means):
        return
    blocks[:] = _F(0.0)
    at = -2
    red = green = blue = usable = _F(0.0)  # of the block at hand, added when the next one begins
    for x in range(len(known)):
        block, w = first_x[x], share_x[x]
        if block < -1:
            continue
        if block != at:
            if at >= -1:
                _add_to(blocks[at + 1], red, green, blue, usable)
            at = block
            red = green = blue = usable = _F(0.0)
        own_red, own_green, own_blue, own_usable = sums[3 * x], sums[3 * x + 1], sums[3 * x + 2], known[x]
        red += w * own_red
        green += w * own_green
        blue += w * own_blue
        usable += w * own_usable
        if w < rest:  # the last pixel of its block has a share in the next
            w = rest - w
            _add_to(blocks[block + 2], w * own_red, w * own_green, w * own_blue, w * own_usable)
    if at >= -1:
        _add_to(blocks[at + 1], red, green, blue, usable)
    means[row] = blocks[1:-1]


@_jit
def _add_to(block, red, green, blue, known):
    block[0] += red
    block[1] += green
    block[2] += blue
    block[3] += known


def stored_means(
    image: np.ndarray,
    table: np.ndarray,
    usable: tuple[int, int],
    start: tuple[float, float],
    size: float,
    shape: tuple[int, int],
) -> np.ndarray:
    """Average blocks of integer pixels in linear light.

    Parameters
    ----------
    image : (h, w, 3) uint8 or uint16
    table : (256,) or (65536,) float32
        Linear light of each stored value.
    usable : (low, high)
        Stored values between which a channel's logarithm says something, both included.
    start : (x, y)
        Where the first block begins: 0 at the border of the first pixel.
    size : float
        Of a block, pixels, at least 1; blocks may cut through pixels.
    shape : (rows, columns)
        How many blocks.

    Returns
    -------
    (rows, columns, 4) float32
        Mean R, G, B, and the share of usable pixels.
    """
    means = np.zeros((*shape, 4), np.float32)
    low, high = (image.dtype.type(value) for value in usable)
    _stored_means(image, table, low, high, float(start[0]), float(start[1]), float(size), means)
    return means


@_jit
def _value_means(values, start_x, start_y, size, means):
    height, width, channels = values.shape
    rows, columns = means.shape[:2]
    first_x, share_x = _shares(width, columns, start_x, size)
    first_y, share_y = _shares(height, rows, start_y, size)
    rest = _F(1.0 / size)
    row = np.empty((columns + 2, channels), np.float32)
    for y in range(height):
        block_y = first_y[y]
        if block_y < -1:
            continue
        row[:] = _F(0.0)
        for x in range(width):
            block = first_x[x]
            if block < -1:
                continue
            for c in range(channels):
                row[block + 1, c] += share_x[x] * values[y, x, c]
                row[block + 2, c] += (rest - share_x[x]) * values[y, x, c]
        _add_row(row, means, block_y, share_y[y])
        _add_row(row, means, block_y + 1, rest - share_y[y])


def value_means(values: np.ndarray, start: tuple[float, float], size: float, shape: tuple[int, int]) -> np.ndarray:
    """Average blocks of any channels (h, w, c) float32 as they are; see :func:`stored_means`."""
    means = np.zeros((*shape, values.shape[2]), np.float32)
    _value_means(values, float(start[0]), float(start[1]), float(size), means)
    return means


@_jit
def _area_shares(n_in, n_out):
    """First and last pixel of each of the blocks that tile a side, and their shares in it; those between count full."""
    ends, shares = np.empty((n_out, 2), np.int64), np.empty((n_out, 2), np.float32)
    size = n_in / n_out
    for i in range(n_out):
        low, high = i * size, min((i + 1) * size, float(n_in))
        first = min(int(low + 1e-9), n_in - 1)
        last = max(min(int(np.ceil(high - 1e-9)) - 1, n_in - 1), first)
        ends[i, 0], ends[i, 1] = first, last
        # Of a block within one pixel, that pixel is all.
        shares[i, 0] = (min(first + 1.0, high) - low) / size
        shares[i, 1] = (high - last) / size if last > first else 0.0
    return ends, shares


@_jit
def _area_means(picture, means):
    rows, columns = means.shape
    ends_y, shares_y = _area_shares(picture.shape[0], rows)
    ends_x, shares_x = _area_shares(picture.shape[1], columns)
    full_y, full_x = _F(rows / picture.shape[0]), _F(columns / picture.shape[1])
    line = np.empty(picture.shape[1], np.float32)
    for i in range(rows):
        first, last = ends_y[i, 0], ends_y[i, 1]  # taking a row apart would count references to it, for 40 ns
        top, bottom, w0, w1 = picture[first], picture[last], shares_y[i, 0], shares_y[i, 1]
        for x in range(len(line)):
            line[x] = w0 * top[x] + w1 * bottom[x]
        for y in range(first + 1, last):
            between = picture[y]
            for x in range(len(line)):
                line[x] += full_y * between[x]
        for j in range(columns):
            left, right = ends_x[j, 0], ends_x[j, 1]
            total = _F(0.0)
            for x in range(left + 1, right):
                total += line[x]
            means[i, j] = shares_x[j, 0] * line[left] + full_x * total + shares_x[j, 1] * line[right]


def area_means(picture: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Make a picture smaller: means of the blocks that tile it, whatever their height and width.

    What OpenCV's ``INTER_AREA`` gives, rows first, which takes a fifth of its time.

    Parameters
    ----------
    picture : (h, w) float32
    shape : (rows, columns)
        At most (h, w).

    Returns
    -------
    (rows, columns) float32
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
    """Weighted sum of the encoded channels of integer pixels.

    Parameters
    ----------
    image : (h, w, 3) uint8 or uint16
    table : (256,) or (65536,) float32
        Encoded value of each stored one.
    weights : (3,) float

    Returns
    -------
    (h, w) float32
    """
    luminance = np.empty(image.shape[:2], np.float32)
    _stored_luminance(np.ascontiguousarray(image), np.outer(weights, table).astype(np.float32), luminance)
    return luminance


@_jit
def _bent_counts(lines, rows, counts):
    n = lines.shape[1]
    bent, sizes = np.empty(n, np.int16), np.empty(n - 6, np.int16)
    for y in rows:
        above, own, below = lines[y - 1], lines[y], lines[y + 1]
        for i in range(n):
            bent[i] = np.int16(above[i]) - np.int16(2) * np.int16(own[i]) + np.int16(below[i])
        left, middle, right = bent[:-6], bent[3:-3], bent[6:]  # the same channel of the neighbours
        for i in range(n - 6):
            sizes[i] = abs(left[i] - np.int16(2) * middle[i] + right[i])
        for i in range(n - 6):
            counts[np.uint64(sizes[i])] += 1


def bent_counts(image: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """How often each size of the mask (1, -2, 1)' (1, -2, 1) occurs, which is blind to planes.

    Parameters
    ----------
    image : (h, w, 3) uint8
    rows : (n,) int
        Rows of the mask's middle.

    Returns
    -------
    (4081,) int64
        Sizes from 0 on.
    """
    counts = np.zeros(16 * 255 + 1, np.int64)
    _bent_counts(np.ascontiguousarray(image).reshape(len(image), -1), rows, counts)
    return counts


@_jit
def _soft_row(picture, y, turn, softness, across, down):
    """Turned gradient along a row, as differences to its neighbours tell it, over the root of its square and another.

    Rows are contiguous, so that the compiler works out many pixels at a time.
    """
    last, right = len(picture) - 1, picture.shape[1] - 1
    own, above, below = picture[y], picture[max(y - 1, 0)], picture[min(y + 1, last)]
    half, square = _F(1.0 if y == 0 or y == last else 0.5), softness * softness
    for x in range(1, right):
        across[x] = _F(0.5) * (own[x + 1] - own[x - 1])
    across[0], across[right] = own[min(1, right)] - own[0], own[right] - own[max(right - 1, 0)]
    for x in range(right + 1):
        gx, gy = across[x], half * (below[x] - above[x])
        tx, ty = turn[0, 0] * gx + turn[0, 1] * gy, turn[1, 0] * gx + turn[1, 1] * gy
        scale = _F(1.0) / np.sqrt(tx * tx + ty * ty + square)
        across[x], down[x] = tx * scale, ty * scale


@_jit
def _soft_directions(picture, turn, softness, out):
    across, down = np.empty(picture.shape[1], np.float32), np.empty(picture.shape[1], np.float32)
    for y in range(picture.shape[0]):
        _soft_row(picture, y, turn, softness, across, down)
        for x in range(picture.shape[1]):
            out[y, x, 0], out[y, x, 1] = across[x], down[x]


def soft_directions(picture: np.ndarray, turn: np.ndarray, softness: float) -> np.ndarray:
    """Directions of a picture's gradient; see :func:`liaam.photometry.encoding.soft_direction`.

    Parameters
    ----------
    picture : (h, w) float32
    turn : (2, 2) float
    softness : float

    Returns
    -------
    (h, w, 2) float32
    """
    out = np.empty((*picture.shape, 2), np.float32)
    turn = np.ascontiguousarray(turn, dtype=np.float32)
    _soft_directions(np.ascontiguousarray(picture, dtype=np.float32), turn, np.float32(softness), out)
    return out


@_jit
def _soft_light(means, all_, grey, weights, dark, floor, light, masks):
    every = True
    for y in range(means.shape[0]):
        for x in range(means.shape[1]):
            red, green, blue = means[y, x, 0], means[y, x, 1], means[y, x, 2]
            light[y, x, 0] = weights[0] * red + weights[1] * green + weights[2] * blue + dark
            light[y, x, 1], light[y, x, 2], light[y, x, 3] = max(red, floor), max(green, floor), max(blue, floor)
            known = means[y, x, 3] > all_ and not grey
            finite = means.shape[2] < 5 or means[y, x, 4] > all_
            masks[y, x, 0], masks[y, x, 1] = _F(known), _F(finite)
            every = every and known and finite
    return every


def soft_light(
    means: np.ndarray, least: float, grey: bool, weights: np.ndarray, dark: float, floor: float
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Light whose logarithms ``soft`` takes, and where they may be used.

    Parameters
    ----------
    means : (h, w, 5) float32
        Mean linear R, G, B, and the shares of pixels whose logarithm says something, and of finite ones (all, if left
        out).
    least : float
        Share above which all are meant.
    grey : bool
        Whether colours say nothing.
    weights : (3,) float
        Of R, G and B in brightness.
    dark : float
        Added to brightness.
    floor : float
        Least R, G and B.

    Returns
    -------
    light : (h, w, 4) float32
        Brightness, R, G, B.
    masks : (h, w, 2) float32
        Where colour, and brightness, may be used: 1, else 0.
    every : bool
        Whether both may be used everywhere.
    """
    light, masks = np.empty((*means.shape[:2], 4), np.float32), np.empty((*means.shape[:2], 2), np.float32)
    numbers = np.float32(least), bool(grey), np.asarray(weights, np.float32), np.float32(dark), np.float32(floor)
    return light, masks, bool(_soft_light(means, *numbers, light, masks))


@_jit
def _stored_light(image, table, low, high, grey, weights, dark, floor, light, masks):
    every = not grey
    for y in range(image.shape[0]):
        pixels, row, own = image[y].reshape(-1), light[y].reshape(-1), masks[y].reshape(-1)
        for x in range(image.shape[1]):
            r, g, b = pixels[3 * x], pixels[3 * x + 1], pixels[3 * x + 2]
            red, green, blue = table[r], table[g], table[b]
            row[4 * x] = weights[0] * red + weights[1] * green + weights[2] * blue + dark
            row[4 * x + 1], row[4 * x + 2], row[4 * x + 3] = max(red, floor), max(green, floor), max(blue, floor)
            known = (low <= min(r, min(g, b))) & (max(r, max(g, b)) <= high) & (not grey)
            own[2 * x], own[2 * x + 1] = _F(known), _F(1.0)
            every = every & known
    return every


def stored_light(
    image: np.ndarray,
    table: np.ndarray,
    usable: tuple[int, int],
    grey: bool,
    weights: np.ndarray,
    dark: float,
    floor: float,
) -> tuple[np.ndarray, np.ndarray, bool]:
    """As :func:`soft_light`, of integer pixels that are not averaged; table and range as of :func:`stored_means`."""
    light, masks = np.empty((*image.shape[:2], 4), np.float32), np.empty((*image.shape[:2], 2), np.float32)
    low, high = (image.dtype.type(value) for value in usable)
    numbers = low, high, bool(grey), np.asarray(weights, np.float32), np.float32(dark), np.float32(floor)
    return light, masks, bool(_stored_light(np.ascontiguousarray(image), table, *numbers, light, masks))


@_jit
def _weigh(logs, masks, least, weights):
    both = weights.shape[2] == 2
    for y in range(logs.shape[0]):
        for x in range(logs.shape[1]):
            known = masks[y, x, 0] + least
            weights[y, x, 0] = known
            for c in range(1, 4):
                logs[y, x, c] *= known
            if both:
                weights[y, x, 1] = masks[y, x, 1] + least
                logs[y, x, 0] *= weights[y, x, 1]


def weigh(logs: np.ndarray, masks: np.ndarray, least: float, finite: bool = False) -> np.ndarray:
    """Multiply log brightness and log RGB, in place, by weights of their masks.

    Parameters
    ----------
    logs : (h, w, 4) float32
    masks : (h, w, 2) float32
        Of RGB and of brightness.
    least : float
        Weight of what is masked, beside 1.
    finite : bool
        Whether brightness is masked nowhere, and left as it is.

    Returns
    -------
    (h, w, 1 or 2) float32
        Weights of RGB, and of brightness if it has any.
    """
    weights = np.empty((*masks.shape[:2], 1 if finite else 2), np.float32)
    _weigh(logs, masks, np.float32(least), weights)
    return weights


@_jit
def _divide(logs, shares):
    both = shares.shape[2] == 2
    for y in range(logs.shape[0]):
        for x in range(logs.shape[1]):
            known = _F(1.0) / shares[y, x, 0]
            for c in range(1, 4):
                logs[y, x, c] *= known
            if both:
                logs[y, x, 0] /= shares[y, x, 1]


def divide(logs: np.ndarray, shares: np.ndarray) -> None:
    """Divide log brightness and log RGB (h, w, 4), in place, by the shares (h, w, 1 or 2) that :func:`weigh` gave."""
    _divide(logs, shares)


@_jit
def _finish_soft(logs, masks, turn, softness, out):
    height, width = logs.shape[:2]
    luminance = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            luminance[y, x] = logs[y, x, 0]
    across, down = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(height):
        _soft_row(luminance, y, turn, softness, across, down)
        for x in range(width):
            out[y, x, 0], out[y, x, 1] = across[x], down[x]
            out[y, x, 2], out[y, x, 3], out[y, x, 4] = logs[y, x, 1], logs[y, x, 2], logs[y, x, 3]
            out[y, x, 5], out[y, x, 6] = masks[y, x, 0], masks[y, x, 1]


def soft_channels(logs: np.ndarray, masks: np.ndarray, turn: np.ndarray, softness: float) -> np.ndarray:
    """Lay out the channels of ``soft``: the softly normalised gradient, log R, G, B, and the two masks.

    Parameters
    ----------
    logs : (h, w, 4) float32
        Logarithms of brightness, R, G and B.
    masks : (h, w, 2) float32
    turn : (2, 2) float
        Rotation from the image's to the object's axes.
    softness : float
        Gradient per pixel at which half of its square is normalised away.

    Returns
    -------
    (h, w, 7) float32
    """
    out = np.empty((*logs.shape[:2], 7), np.float32)
    _finish_soft(logs, masks, np.ascontiguousarray(turn, dtype=np.float32), np.float32(softness), out)
    return out
