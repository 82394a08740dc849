"""Block means of any size, in linear light, straight from stored pixels (numba)."""

import numba
import numpy as np

_jit = numba.njit(cache=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")
_F = np.float32


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
    height, width = image.shape[:2]
    rows, columns = means.shape[:2]
    first_x, share_x = _shares(width, columns, start_x, size)
    first_y, share_y = _shares(height, rows, start_y, size)
    rest = _F(1.0 / size)
    row = np.empty((columns + 2, 4), np.float32)  # one block more on each side: no test in the loop
    for y in range(height):
        block_y = first_y[y]
        if block_y < -1:
            continue
        row[:] = _F(0.0)
        for x in range(width):
            block = first_x[x]
            if block < -1:
                continue
            r, g, b = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            usable = low <= min(r, min(g, b)) and max(r, max(g, b)) <= high
            red, green, blue = table[r], table[g], table[b]
            known = _F(1.0) if usable else _F(0.0)
            w = share_x[x]
            row[block + 1, 0] += w * red
            row[block + 1, 1] += w * green
            row[block + 1, 2] += w * blue
            row[block + 1, 3] += w * known
            w = rest - w
            row[block + 2, 0] += w * red
            row[block + 2, 1] += w * green
            row[block + 2, 2] += w * blue
            row[block + 2, 3] += w * known
        _add_row(row, means, block_y, share_y[y])
        _add_row(row, means, block_y + 1, rest - share_y[y])


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
    _stored_means(image, table, *usable, float(start[0]), float(start[1]), float(size), means)
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
def _finish_soft(logs, masks, turn, softness, out):
    height, width = logs.shape[:2]
    for y in range(height):
        up, down = max(y - 1, 0), min(y + 1, height - 1)
        by_y = _F(1.0) / _F(max(down - up, 1))
        for x in range(width):
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            gx = (logs[y, right, 0] - logs[y, left, 0]) / _F(max(right - left, 1))
            gy = (logs[down, x, 0] - logs[up, x, 0]) * by_y
            tx, ty = turn[0, 0] * gx + turn[0, 1] * gy, turn[1, 0] * gx + turn[1, 1] * gy
            scale = _F(1.0) / np.sqrt(tx * tx + ty * ty + softness * softness)
            out[y, x, 0], out[y, x, 1] = tx * scale, ty * scale
            out[y, x, 2], out[y, x, 3], out[y, x, 4] = logs[y, x, 1], logs[y, x, 2], logs[y, x, 3]
            out[y, x, 5], out[y, x, 6] = masks[y, x, 0], masks[y, x, 1]


def soft_channels(logs: np.ndarray, masks: np.ndarray, turn: np.ndarray, softness: float) -> np.ndarray:
    """Lay out the channels of ``soft``: the softly normalised gradient, log R, G, B, and the two masks.

    Parameters
    ----------
    logs : (h, w, 4) float32
        Logarithms of luminance, R, G and B.
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
    _finish_soft(logs, masks, np.asarray(turn, np.float32), np.float32(softness), out)
    return out
