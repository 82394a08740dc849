"""A surface for the mesh of any object: a model knows no depth, so its outline is blown up like a balloon."""

from functools import lru_cache

import numpy as np

from liaam.model.mesh import ReferenceFrame
from liaam.relighting.shading import neighbours

STEEPEST = np.tan(np.deg2rad(65.0))
"""Slope that the surface tends to at the mesh's border."""

ROUNDING = 0.03
"""Width over which the surface's normals are smoothed, as a share of the frame's diagonal: the corners of an outline
leave no ridges."""


@lru_cache(maxsize=4)
def normals_of(frame: ReferenceFrame) -> np.ndarray:
    """Unit normals of an inflated surface over a mesh, (n_pixels, 3) float32: x to the right, y down, z to the viewer.

    A bulge u solves Poisson's equation, laplacian(u) = -1 inside and 0 on the border; twice its root, the height,
    is half a ball over a disc, and round over any outline.
    """
    from scipy.ndimage import gaussian_filter
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    (a, b), n = neighbours(frame), frame.n_pixels
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
    slope = slope / np.sqrt(1.0 + np.square(steep / STEEPEST))  # never steeper, and no kink
    normals = np.column_stack([-slope, np.ones(n)])
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
