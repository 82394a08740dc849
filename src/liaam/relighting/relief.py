"""A surface for the mesh of any object. Models have no depth, so the outline is inflated."""

from functools import lru_cache

import numpy as np

from liaam.model.mesh import ReferenceFrame

STEEPEST = np.tan(np.deg2rad(65.0))
"""Limit of the surface's slope, at the mesh's border."""

ROUNDING = 0.03
"""Standard deviation of the smoothing of normals, as a fraction of the frame's diagonal. It removes ridges at the
outline's corners."""


@lru_cache(maxsize=4)
def normals_of(frame: ReferenceFrame) -> np.ndarray:
    """Compute unit normals of an inflated surface, (n_pixels, 3) float32: x to the right, y down, z to the viewer.

    u solves Poisson's equation, laplacian(u) = -1 with 0 on the border. The height 2 sqrt(u) is a hemisphere over a
    disc, and smooth over other outlines.
    """
    from scipy.ndimage import gaussian_filter
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    n = frame.n_pixels
    number = frame.picture(np.arange(n) + 1.0).astype(int)  # 0 around the frame
    pairs = np.hstack([[g[:, :-1].ravel(), g[:, 1:].ravel()] for g in (number, number.T)])
    a, b = pairs[:, (pairs > 0).all(axis=0)] - 1
    links = coo_array((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n))
    bulge = splu((diags_array(np.full(n, 4.0)) - links).tocsc()).solve(np.ones(n))
    diagonal = float(np.hypot(*frame.size))
    height = np.pad(frame.picture(2.0 * np.sqrt(bulge)), round(3 * ROUNDING * diagonal))
    inside = height > 0
    down, right = np.gradient(height)
    slopes = [
        gaussian_filter(slope * inside, ROUNDING * diagonal)
        / np.maximum(gaussian_filter(inside.astype(float), ROUNDING * diagonal), 1e-6)
        for slope in (right, down)
    ]
    slope = np.stack([axis[inside] for axis in slopes], axis=1)
    steep = np.linalg.norm(slope, axis=1, keepdims=True)
    slope = slope / np.sqrt(1.0 + np.square(steep / STEEPEST))  # smooth saturation
    normals = np.column_stack([-slope, np.ones(n)])
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
