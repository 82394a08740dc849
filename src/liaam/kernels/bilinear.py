"""Compiled bilinear sampling without gradients, for training."""

import numpy as np

from liaam.kernels.compiled import compiled
from liaam.kernels.fields import Double2, Single1, Single2, Single3


@compiled
def _sample(channels: Single3, points: Double2, values: Single2, usable: Single1) -> None:
    height, width, last = channels.shape[0], channels.shape[1], channels.shape[2] - 1
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if not (0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0):  # also NaN
            for c in range(last):
                values[i, c] = 0.0
            usable[i] = 0.0
            continue
        column, row = min(int(x), width - 2), min(int(y), height - 2)
        u, v = x - column, y - row
        above, below = channels[row], channels[row + 1]
        for c in range(last):
            top = above[column, c] + u * (above[column + 1, c] - above[column, c])
            bottom = below[column, c] + u * (below[column + 1, c] - below[column, c])
            values[i, c] = top + v * (bottom - top)
        usable[i] = min(
            min(above[column, last], above[column + 1, last]), min(below[column, last], below[column + 1, last])
        )


def sample(channels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sample an image (h, w, c + 1) bilinearly: values (n, c) and weights (n,), float32.

    The last channel is the weight. See :func:`liaam.kernels.reference.sample`.
    """
    values = np.empty((len(points), channels.shape[2] - 1), np.float32)
    usable = np.empty(len(points), np.float32)
    _sample(np.ascontiguousarray(channels, np.float32), np.ascontiguousarray(points, np.float64), values, usable)
    return values, usable
