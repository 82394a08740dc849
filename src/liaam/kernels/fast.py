"""Fast kernel: numba, one pass over the model's pixels, no temporaries (contract: ``reference``)."""

import numba
import numpy as np

# fastmath without "no NaNs": images are finite by contract, but points of a diverging fit need not be.
_jit = numba.njit(cache=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")


@_jit
def _linearise(channels, points, warp_jacobian, turn, metric, root_weights, columns, values, projected, weights):
    height, width = channels.shape[0], channels.shape[1]
    n, n_p, k, n_c = points.shape[0], warp_jacobian.shape[2], metric.shape[0], metric.shape[1]
    for i in range(n):
        px, py = points[i, 0], points[i, 1]
        # Written so that NaN counts as outside.
        inside = px >= 0.0 and py >= 0.0 and px <= width - 1 and py <= height - 1
        weight = np.float32(0.0)
        if inside:
            x, y = min(int(px), width - 2), min(int(py), height - 2)
            weight = min(
                min(channels[y, x, n_c], channels[y, x + 1, n_c]),
                min(channels[y + 1, x, n_c], channels[y + 1, x + 1, n_c]),
            )
        weights[i] = weight
        if not inside:
            values[i, :] = 0.0
            projected[i, :] = 0.0
            for r in range(k):
                for j in range(n_p):
                    columns[i * k + r, j] = 0.0
            continue
        u, v = px - x, py - y
        w00, w10, w01, w11 = (1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v
        for r in range(k):
            projected[i, r] = 0.0
        for r in range(k):
            root = np.float64(root_weights[i, r] * weight)
            value = gx = gy = 0.0
            for c in range(n_c):
                c00, c10 = np.float64(channels[y, x, c]), np.float64(channels[y, x + 1, c])
                c01, c11 = np.float64(channels[y + 1, x, c]), np.float64(channels[y + 1, x + 1, c])
                sampled = w00 * c00 + w10 * c10 + w01 * c01 + w11 * c11
                values[i, c] = sampled
                m = metric[r, c]
                value += m * sampled
                gx += m * ((1 - v) * (c10 - c00) + v * (c11 - c01))
                gy += m * ((1 - u) * (c01 - c00) + u * (c11 - c10))
            projected[i, r] = value
            a = np.float32(root * (gx * turn[0, 0] + gy * turn[1, 0]))
            b = np.float32(root * (gx * turn[0, 1] + gy * turn[1, 1]))
            row = i * k + r
            for j in range(n_p):
                columns[row, j] = a * warp_jacobian[i, 0, j] + b * warp_jacobian[i, 1, j]


def linearise(
    channels: np.ndarray,
    points: np.ndarray,
    warp_jacobian: np.ndarray,
    turn: np.ndarray,
    metric: np.ndarray,
    root_weights: np.ndarray,
    columns: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """See :func:`liaam.kernels.reference.linearise`."""
    n = len(points)
    values = np.empty((n, metric.shape[1]), dtype=np.float32)
    projected = np.empty((n, len(metric)), dtype=np.float32)
    weights = np.empty(n, dtype=np.float32)
    points, turn, metric = (np.ascontiguousarray(a, dtype=np.float64) for a in (points, turn, metric))
    _linearise(channels, points, warp_jacobian, turn, metric, root_weights, columns, values, projected, weights)
    return values, projected, weights
