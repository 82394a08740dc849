"""Rasterise triangles: a z-buffer with interpolated attributes, and depth maps for shadows."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def transform(points, frame):
    """Apply an affine map (3, 4) to points (n, 3); unlike a BLAS product it uses one core."""
    out = np.empty(points.shape)
    for i in range(points.shape[0]):
        for k in range(3):
            out[i, k] = (
                frame[k, 0] * points[i, 0] + frame[k, 1] * points[i, 1] + frame[k, 2] * points[i, 2] + frame[k, 3]
            )
    return out


@njit(cache=True)
def _fill(points, triangles, attributes, depth, image):
    """Draw triangles over a z-buffer, and interpolate their attributes (n, k) to an image (height, width, k)."""
    height, width = depth.shape
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t]
        ax, ay = points[a, 0], points[a, 1]
        bx, by = points[b, 0], points[b, 1]
        cx, cy = points[c, 0], points[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        x0, x1 = max(0, int(np.ceil(min(ax, bx, cx)))), min(width - 1, int(np.floor(max(ax, bx, cx))))
        y0, y1 = max(0, int(np.ceil(min(ay, by, cy)))), min(height - 1, int(np.floor(max(ay, by, cy))))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                wb = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                wc = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                wa = 1.0 - wb - wc
                if wa < -1e-9 or wb < -1e-9 or wc < -1e-9:
                    continue
                z = wa * points[a, 2] + wb * points[b, 2] + wc * points[c, 2]
                if z > depth[y, x]:
                    depth[y, x] = z
                    for i in range(attributes.shape[1]):
                        image[y, x, i] = wa * attributes[a, i] + wb * attributes[b, i] + wc * attributes[c, i]


def draw(
    points: np.ndarray, triangles: np.ndarray, attributes: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Draw triangles (m, 3) int32 with a z-buffer.

    The vertices (n, 3) are (column, row, nearness); the largest nearness is visible. Returns their interpolated
    attributes (height, width, k) float32, 0 where nothing is drawn, and the mask (height, width) of what is covered.
    """
    image, depth = np.zeros((height, width, attributes.shape[1]), np.float32), np.full((height, width), -np.inf)
    _fill(points, triangles, attributes, depth, image)
    return image, depth > -np.inf


def depth_map(points: np.ndarray, triangles: np.ndarray, size: int) -> np.ndarray:
    """Nearness map (size, size) of triangles whose vertices (n, 3) are in the map's pixels."""
    depth = np.full((size, size), -1e9, np.float32)
    _fill(points, triangles, np.empty((len(points), 0), np.float32), depth, np.empty((0, 0, 0), np.float32))
    return depth


@njit(cache=True)
def visibility(points, depth, bias):
    """Fraction of light (n,) that reaches points (n, 3) of a depth map: 2 x 2 comparisons, bilinear."""
    size = depth.shape[0]
    seen = np.ones(points.shape[0], np.float32)
    for i in range(points.shape[0]):
        x, y = int(np.floor(points[i, 0])), int(np.floor(points[i, 1]))
        if x < 0 or y < 0 or x >= size - 1 or y >= size - 1:
            continue
        fx, fy, z = points[i, 0] - x, points[i, 1] - y, points[i, 2] + bias
        top = (1 - fx) * (depth[y, x] <= z) + fx * (depth[y, x + 1] <= z)
        bottom = (1 - fx) * (depth[y + 1, x] <= z) + fx * (depth[y + 1, x + 1] <= z)
        seen[i] = (1 - fy) * top + fy * bottom
    return seen


@njit(cache=True)
def splat_map(points, size):
    """Nearness map (size, size) of a cloud of points (n, 3), each drawn as one pixel."""
    depth = np.full((size, size), -np.float32(1e9), np.float32)
    for i in range(points.shape[0]):
        x, y = int(np.floor(points[i, 0] + 0.5)), int(np.floor(points[i, 1] + 0.5))
        if 0 <= x < size and 0 <= y < size and points[i, 2] > depth[y, x]:
            depth[y, x] = points[i, 2]
    return depth
