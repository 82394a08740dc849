"""Rays against a surface of triangles, by Embree: a tool for making data, which liaam itself never needs."""

from dataclasses import dataclass

import numpy as np

from liaam.errors import LiaamError

LIFT = 0.02
"""Distance by which rays start above the surface, centimetres, so that it does not shadow itself by rounding."""


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays meet the surface.

    Attributes
    ----------
    triangle : (n,) int32
        Index of the triangle; -1 where a ray meets nothing.
    weights : (n, 3) float32
        Barycentric coordinates of the point in the triangle.
    """

    triangle: np.ndarray
    weights: np.ndarray

    def interpolated(self, triangles: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Interpolate values (v, ...) of the vertices of triangles (m, 3) at the points, (n, ...) float32."""
        corners = values.astype(np.float32)[triangles[self.triangle]]
        return np.einsum("nc,nc...->n...", self.weights, corners)

    def __getitem__(self, which: np.ndarray) -> "Hits":
        return Hits(self.triangle[which], self.weights[which])


class Rays:
    """A surface with vertices (v, 3) and triangles (m, 3) that rays can meet."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh  # pyright: ignore[reportMissingImports]
            from embreex.rtcore_scene import EmbreeScene  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise LiaamError("rendering heads needs Embree: run 'pip install embreex'") from error
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, vertices.astype(np.float32), triangles.astype(np.int32))

    def first_hits(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """Return where rays from origins (n, 3) in directions (n, 3) first meet the surface."""
        found = self._scene.run(_rays(origins), _rays(directions), output=1)
        u = found["u"]
        v = found["v"]
        return Hits(found["primID"], np.stack([1.0 - u - v, u, v], axis=-1))

    def are_blocked(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Whether anything lies between origins (n, 3) and the origins plus directions (n, 3), (n,) bool."""
        ends = np.ones(len(directions), np.float32)  # in units of the directions' lengths
        found = self._scene.run(_rays(origins), _rays(directions), dists=ends, query="OCCLUDED")
        return found >= 0


def _rays(vectors: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(vectors, np.float32)
