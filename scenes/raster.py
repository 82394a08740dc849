"""Rasterise triangles: a z-buffer with interpolated attributes, and depth maps for shadows."""

import numpy as np

from liaam import _core


def transform(points: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Apply an affine map (3, 4) to points (n, 3); unlike a BLAS product it uses one core."""
    return np.ascontiguousarray(coordinates(np.ascontiguousarray(points.T), frame).T)


def coordinates(points: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Apply an affine map (3, 4) to points that are given by coordinate, (3, n), as is the result."""
    x, y, z = points
    found, term = np.empty((len(frame), len(x))), np.empty(len(x))  # filled in place: new memory costs as much again
    for own, (a, b, c, d) in zip(found, frame.tolist(), strict=True):
        np.multiply(x, a, out=own)
        own += np.multiply(y, b, out=term)
        own += np.multiply(z, c, out=term)
        own += d
    return found


def draw(
    points: np.ndarray, triangles: np.ndarray, attributes: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Draw triangles (m, 3) int32 with a z-buffer.

    The vertices (n, 3) are (column, row, nearness); the largest nearness is visible. Returns their interpolated
    attributes (height, width, k) float32, 0 where nothing is drawn, and the mask (height, width) of what is covered.
    """
    owner, image = _core.draw_triangles(_double(points), _int(triangles), _double(attributes), height, width)
    return image.astype(np.float32), owner >= 0


def shown_triangles(points: np.ndarray, triangles: np.ndarray, height: int, width: int) -> np.ndarray:
    """Mask (m,) of the triangles that :func:`draw` shows."""
    owner, _ = _core.draw_triangles(_double(points), _int(triangles), np.zeros((len(points), 0)), height, width)
    shown = np.zeros(len(triangles), bool)
    shown[owner[owner >= 0]] = True
    return shown


def depth_map(points: np.ndarray, triangles: np.ndarray, size: int) -> np.ndarray:
    """Nearness map (size, size) of triangles whose vertices (n, 3) are in the map's pixels."""
    owner, nearness = _core.draw_triangles(_double(points), _int(triangles), _double(points[:, 2:]), size, size)
    depth = nearness[..., 0].astype(np.float32)
    depth[owner < 0] = -1e9
    return depth


def _double(numbers: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(numbers, np.float64)


def _int(numbers: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(numbers, np.int32)


def visibility(points: np.ndarray, depth: np.ndarray, bias: float) -> np.ndarray:
    """Fraction of light (n,) float32 that reaches points (3, n) of a depth map: 2 x 2 comparisons, bilinear."""
    size, seen = len(depth), np.ones(points.shape[1], np.float32)
    x, y, z = points
    column, row = np.floor(x), np.floor(y)
    inside = np.flatnonzero((column >= 0) & (row >= 0) & (column < size - 1) & (row < size - 1))
    x, y, z, column, row = (each.take(inside) for each in (x, y, z + bias, column, row))
    across, down, at, flat = x - column, y - row, (row * size + column).astype(np.intp), depth.ravel()
    top = (1 - across) * (flat.take(at) <= z) + across * (flat.take(at + 1) <= z)
    bottom = (1 - across) * (flat.take(at + size) <= z) + across * (flat.take(at + size + 1) <= z)
    seen[inside] = (1 - down) * top + down * bottom
    return seen


def splat_map(points: np.ndarray, size: int) -> np.ndarray:
    """Nearness map (size, size) of a cloud of points (3, n), each drawn as one pixel."""
    depth = np.full(size * size, -np.float32(1e9), np.float32)
    x, y, z = points
    column, row = np.floor(x + 0.5), np.floor(y + 0.5)
    inside = np.flatnonzero((column >= 0) & (row >= 0) & (column < size) & (row < size))
    at = (row.take(inside) * size + column.take(inside)).astype(np.intp)
    np.maximum.at(depth, at, z.take(inside).astype(np.float32))
    return depth.reshape(size, size)
