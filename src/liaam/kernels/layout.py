"""How what kernels read again and again lies in memory: appearance modes in 16 bits, pixels by their triangles."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

LANES = 8
"""Columns that lie side by side: lines are filled up to a multiple of it."""

LARGEST = 32767
"""Step that stands for a row's largest entry."""


@dataclass(frozen=True, eq=False)
class Packed:
    """Rows of numbers, each in steps of a 32767th of its largest.

    An iteration passes over a model's modes again and again, and much of its time is moving them: in 16 bits they fit
    the second-level cache at sizes where in single precision they do not. What is lost is a few hundred-thousandths of
    a mode's largest entry, far below what a model knows of it.

    Attributes
    ----------
    steps : (m, n) int16
    sizes : (m,) float32
        What a step is worth, row by row.
    """

    steps: np.ndarray
    sizes: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """The numbers that are stood for, (m, n) float32."""
        return self.steps * self.sizes[:, None]

    @cached_property
    def lines(self) -> np.ndarray:
        """Steps column after column, filled up with noughts, (n, wide) int16: for sparse products."""
        m, n = self.steps.shape
        lines = np.zeros((n, (m + LANES - 1) // LANES * LANES), np.int16)
        lines[:, :m] = self.steps.T
        return lines


def pack(rows: np.ndarray) -> Packed:
    """Pack rows (m, n); one that holds what is no number, as of an angle that has blown up, is none as a whole."""
    largest = np.abs(rows).max(axis=1, initial=0.0)
    sizes = np.where(largest > LARGEST * np.finfo(np.float32).tiny, largest / LARGEST, 1.0).astype(np.float32)
    steps = np.empty(rows.shape, np.int16)
    with np.errstate(invalid="ignore"):
        np.rint(rows / sizes[:, None], out=steps, casting="unsafe")
    lost = ~np.isfinite(largest)
    steps[lost], sizes[lost] = 0, np.nan
    return Packed(steps, sizes)


@dataclass(frozen=True, eq=False)
class MeshPixels:
    """Pixels in the order of their triangles, for sparse products (:func:`liaam.kernels.reference.mesh_products`).

    Attributes
    ----------
    beta : (n, 3) float32
        Barycentric weights of the triangle's vertices.
    starts : (t + 1,) int64
        First pixel of each triangle, and the end.
    triangles : (t, 3) int64
    basis : (2 n_vertices, n_p) float64
        Derivative of the vertices' coordinates, x and y in turn, by the warp's parameters.
    """

    beta: np.ndarray
    starts: np.ndarray
    triangles: np.ndarray
    basis: np.ndarray

    @cached_property
    def _edges(self) -> tuple[np.ndarray, np.ndarray]:
        corners = np.sort(self.triangles[:, np.array(PAIRS)], axis=2).reshape(-1, 2)
        edges, numbers = np.unique(corners, axis=0, return_inverse=True)
        return edges, numbers.reshape(len(self.triangles), len(PAIRS))

    @cached_property
    def edges(self) -> np.ndarray:
        """Vertices that share a triangle, (e, 2) int64, each with itself among them."""
        return self._edges[0]

    @cached_property
    def sides(self) -> np.ndarray:
        """Which edge :data:`PAIRS` of a triangle's corners are, (t, 6) int64."""
        return self._edges[1]


PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Corners of a triangle, two by two."""


@dataclass(frozen=True, eq=False)
class Carried:
    """Places of a mesh's pixels, told by those of its vertices: x0 + beta_1 (x1 - x0) + beta_2 (x2 - x0).

    Attributes
    ----------
    vertices : (n_vertices, 2) float64
    mesh : MeshPixels
    """

    vertices: np.ndarray
    mesh: MeshPixels

    def __len__(self) -> int:
        return len(self.mesh.beta)

    @cached_property
    def points(self) -> np.ndarray:
        """The places, (n, 2) float64."""
        triangles = np.repeat(self.mesh.triangles, np.diff(self.mesh.starts), axis=0)
        first, *others = (self.vertices[triangles[:, i]] for i in range(3))
        beta = self.mesh.beta.astype(np.float64)
        with np.errstate(over="ignore", invalid="ignore"):  # vertices of a diverging fit need not be numbers
            return first + sum(beta[:, i, None] * (other - first) for i, other in enumerate(others, 1))


def points_of(places: np.ndarray | Carried) -> np.ndarray:
    """Places as they are, (n, 2) float64."""
    return places.points if isinstance(places, Carried) else places
