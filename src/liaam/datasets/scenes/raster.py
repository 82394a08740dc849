"""Rasterise triangles: a z-buffer with interpolated attributes, and depth maps for shadows."""

import numpy as np

from liaam import _core


def transform(points: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Apply an affine map (3, 4) to points (n, 3); unlike a BLAS product it uses one core."""
    x, y, z = points.T[..., None]
    return x * frame[:, 0] + y * frame[:, 1] + z * frame[:, 2] + frame[:, 3]


def draw(
    points: np.ndarray, triangles: np.ndarray, attributes: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Draw triangles (m, 3) int32 with a z-buffer.

    The vertices (n, 3) are (column, row, nearness); the largest nearness is visible. Returns their interpolated
    attributes (height, width, k) float32, 0 where nothing is drawn, and the mask (height, width) of what is covered.
    """
    image, depth = _core.draw_triangles(_double(points), _int(triangles), _double(attributes), height, width, -np.inf)
    return image, depth > -np.inf


def depth_map(points: np.ndarray, triangles: np.ndarray, size: int) -> np.ndarray:
    """Nearness map (size, size) of triangles whose vertices (n, 3) are in the map's pixels."""
    nothing = np.zeros((len(points), 0))
    return _core.draw_triangles(_double(points), _int(triangles), nothing, size, size, -1e9)[1].astype(np.float32)


def _double(numbers: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(numbers, np.float64)


def _int(numbers: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(numbers, np.int32)


def visibility(points: np.ndarray, depth: np.ndarray, bias: float) -> np.ndarray:
    """Fraction of light (n,) float32 that reaches points (n, 3) of a depth map: 2 x 2 comparisons, bilinear."""
    size = len(depth)
    x, y = np.floor(points[:, :2]).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < size - 1) & (y < size - 1)
    seen, (x, y), points = np.ones(len(points), np.float32), (x[inside], y[inside]), points[inside]
    across, down, z = points[:, 0] - x, points[:, 1] - y, points[:, 2] + bias
    top = (1 - across) * (depth[y, x] <= z) + across * (depth[y, x + 1] <= z)
    bottom = (1 - across) * (depth[y + 1, x] <= z) + across * (depth[y + 1, x + 1] <= z)
    seen[inside] = (1 - down) * top + down * bottom
    return seen


def splat_map(points: np.ndarray, size: int) -> np.ndarray:
    """Nearness map (size, size) of a cloud of points (n, 3), each drawn as one pixel."""
    depth = np.full((size, size), -np.float32(1e9), np.float32)
    x, y = np.floor(points[:, :2] + 0.5).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < size) & (y < size)
    np.maximum.at(depth, (y[inside], x[inside]), points[inside, 2].astype(np.float32))
    return depth
