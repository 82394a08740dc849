"""Warps W(x; p) from the reference frame to the image: one interface, so that every solver serves all.

A warp gives the points, their derivative and the update. Derivatives are with respect to the points'
own coordinates; the fitting problem adds the constant similarity between model and image pixels.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from liaam.mesh import ReferenceFrame
from liaam.shape import ShapeModel, Similarity


class Warp(Protocol):
    """What the solver needs of a warp."""

    @property
    def n_parameters(self) -> int:
        """Length of p."""
        ...

    def movement(self, step: np.ndarray) -> float:
        """Size of a step of p: root mean square movement of what the warp carries, model pixels."""
        ...

    def points(self, p: np.ndarray, pose: Similarity | None = None) -> np.ndarray:
        """W(x; p) of every model pixel, carried on by a similarity if one is given, (n_pixels, 2) float64."""
        ...

    def jacobian(self, p: np.ndarray) -> np.ndarray:
        """dW/dp of every model pixel, (n_pixels, 2, n_parameters) float32, C-contiguous."""
        ...

    def update(self, p: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Parameters after a Gauss-Newton step."""
        ...

    def pulled_gradient(self, values: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Gradient at W(x; p) of what has the given values (n_pixels, k) at x, (n_pixels, 2, k), model pixels."""
        ...


@dataclass(frozen=True, eq=False)
class PiecewiseAffineWarp:
    """Piecewise-affine warp of a mesh whose vertices follow a shape model (paper eq 3).

    W(x; p) = sum_v beta_v(x) s_v(p) is linear in p, so dW/dp_i = sum_v beta_v(x) s_i[v] is constant and
    worked out once.
    """

    frame: ReferenceFrame
    shape_model: ShapeModel

    @property
    def n_parameters(self) -> int:
        """Number of shape modes plus the four similarity vectors."""
        return len(self.shape_model.basis)

    def movement(self, step: np.ndarray) -> float:
        """Root mean square movement of the landmarks by a step of p, model pixels."""
        # The shape vectors are orthonormal over the 2 n landmark coordinates.
        return float(np.linalg.norm(step) / np.sqrt(self.shape_model.n_points))

    def points(self, p: np.ndarray, pose: Similarity | None = None) -> np.ndarray:
        """W(x; p) of every model pixel, carried on by a similarity if one is given, (n_pixels, 2) float64."""
        vertices = self.shape_model.shape(p)
        # Barycentric weights sum to 1, so carrying the few vertices carries all pixels.
        return self.interpolate(vertices if pose is None else pose(vertices))

    def interpolate(self, vertices: np.ndarray) -> np.ndarray:
        """Carry (n_points, 2) vertex positions to all model pixels, (n_pixels, 2) float64."""
        return self._interpolation @ np.asarray(vertices, dtype=np.float64)

    @cached_property
    def _interpolation(self):
        from scipy.sparse import csr_array

        n = self.frame.n_pixels
        starts = np.arange(0, 3 * n + 1, 3)
        data = (self.frame.weights.ravel(), self.frame.vertices.ravel(), starts)
        return csr_array(data, shape=(n, len(self.frame.points)))

    @cached_property
    def _jacobian(self) -> np.ndarray:
        modes = self.shape_model.basis.reshape(self.n_parameters, -1, 2)
        carried = np.einsum("nv,inva->nai", self.frame.weights, modes[:, self.frame.vertices])
        return np.ascontiguousarray(carried, dtype=np.float32)

    def jacobian(self, p: np.ndarray) -> np.ndarray:
        """dW/dp of every model pixel, (n_pixels, 2, n_parameters) float32; the same for every p."""
        return self._jacobian

    def update(self, p: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Forward-additive update p + step."""
        return p + step

    def pulled_gradient(self, values: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Gradient at W(x; p) of what has the given values (n_pixels, k) at x, (n_pixels, 2, k) float32.

        If V(W(x; p)) = values(x), then grad V = (dW/dx)^-T grad values. Triangles of next to no area give 0.
        """
        inverse = _inverse_affinities(self.frame.points, self.shape_model.shape(p), self.frame.triangles)
        return np.einsum("nba,nbk->nak", inverse[self.frame.owners], self.frame.gradient(values)).astype(np.float32)


def _inverse_affinities(points: np.ndarray, shape: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Linear parts (t, 2, 2) of the maps from each triangle on a shape back to the one on the points."""

    def edges(vertices: np.ndarray) -> np.ndarray:
        a, b, c = (vertices[triangles[:, i]] for i in range(3))
        return np.stack([b - a, c - a], axis=2)

    there, here = edges(shape), edges(points)
    flat = np.abs(np.linalg.det(there)) < 0.05 * np.abs(np.linalg.det(here))
    there[flat] = np.eye(2)
    return np.where(flat[:, None, None], 0.0, here @ np.linalg.inv(there))
