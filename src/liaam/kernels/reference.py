"""Loops over pixels in plain NumPy: the bilinear samples that define a fit, and the raster of a mesh."""

import numpy as np


def sample(channels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample an encoded image bilinearly, with the exact gradient of the interpolant.

    The Jacobian is thus the derivative of the cost that is minimised. The gradient is discontinuous at pixel lines; on
    a line it is the derivative from the right (from below). Channels are (h, w, 8) and points (n, 2). Return the values
    (n, 8), the derivatives by x and y (n, 2, 8), both 0 outside the image, and the weights (n,): 1 where all four
    pixels around the point are inside the image and usable, else 0.
    """
    height, width = channels.shape[:2]
    with np.errstate(invalid="ignore"):  # points of a diverging fit may be NaN
        inside = np.asarray(((points >= 0) & (points <= [width - 1, height - 1])).all(axis=1))
    safe = np.where(inside[:, None], points, 0.0)
    x, y = np.minimum(np.floor(safe), [width - 2, height - 2]).astype(int).T
    u, v = (safe - np.stack([x, y], axis=1)).T[..., None]
    pixels, corner = channels.reshape(-1, 8), y * width + x
    c00, c10, c01, c11 = (pixels.take(corner + by, axis=0).astype(np.float64) for by in (0, 1, width, width + 1))
    usable = (c00[:, 7] > 0) & (c10[:, 7] > 0) & (c01[:, 7] > 0) & (c11[:, 7] > 0) & inside
    upper, lower = c10 - c00, c11 - c01
    along_y = c01 + u * lower - (top := c00 + u * upper)
    values, gradients = top + v * along_y, np.stack([upper + v * (lower - upper), along_y], axis=1)
    values[~inside], gradients[~inside] = 0.0, 0.0
    return values, gradients, usable.astype(float)


ON_EDGE = 1e-9
"""Tolerance on negative barycentric weights of pixels on an edge."""


def raster(points: np.ndarray, triangles: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Rasterise a mesh: find the triangle of each pixel, and the pixel's barycentric weights (paper eq 3).

    All vertices (n, 2) lie within the image. A pixel on a common edge belongs to the first triangle. Return the index
    of the triangle, (height, width) int32, -1 outside the mesh, and the weights, (height, width, 3), 0 outside it.
    """
    owner, weights = np.full((height, width), -1, dtype=np.int32), np.zeros((height, width, 3))
    for t, (a, b, c) in enumerate(points[triangles]):
        (left, above), (right, below) = np.floor(np.min([a, b, c], axis=0)), np.ceil(np.max([a, b, c], axis=0))
        x, y = np.mgrid[int(left) : int(right) + 1, int(above) : int(below) + 1].reshape(2, -1)
        (x0, y0), (x1, y1) = b - a, c - a
        determinant = x0 * y1 - x1 * y0
        if determinant == 0:
            continue
        dx, dy = x - a[0], y - a[1]
        v, w = (y1 * dx - x1 * dy) / determinant, (x0 * dy - y0 * dx) / determinant
        own = np.column_stack([1.0 - v - w, v, w])
        inside = (own >= -ON_EDGE).all(axis=1) & (owner[y, x] < 0)
        owner[y[inside], x[inside]], weights[y[inside], x[inside]] = t, own[inside]
    return owner, weights
