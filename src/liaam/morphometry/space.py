"""The shape space of a sample: shapes about their mean, principal components, unusual shapes, and thin-plate grids.

The spline of a grid is the interpolation of the landmarks' displacements that bends least (Bookstein 1991, 2.2).
It is linear in the displacements, so that each principal component has a grid of its own, and the grid of any change of
shape is their sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import short_repr
from liaam.io.files import count_of
from liaam.morphometry.specimens import Specimen, has_shape
from liaam.morphometry.superimposition import superimpose
from liaam.morphometry.variation import principal_components

FEWEST = 3
"""Specimens from which a sample has a space."""

COMPONENTS = 20
"""Principal components that are kept at most, all of 12 landmarks."""

GRID_CELLS = 16
"""Cells of a grid along its longer side."""

MARGIN = 0.12
"""Space around the landmarks in a grid, as a fraction of the longer side."""

FENCE = 1.5
"""Interquartile ranges above the third quartile beyond which a distance is unusual (Tukey 1977), as in geomorph."""

THINNEST = 1e-6
"""Width of a shape, relative to its length, below which its points lie on one line."""


@dataclass(frozen=True, eq=False)
class ShapeSpace:
    """The shapes of a sample.

    Attributes
    ----------
    specimens : (m,) int
        Indices of the specimens that have a shape.
    shapes : (m, k, 2) float64
        Tangent coordinates of their shapes, of centroid size about 1, y upwards.
    mean : (k, 2) float64
        Mean shape.
    scores : (m, c) float64
        Scores of the first principal components.
    axes : (c, k, 2) float64
        Directions of these: the mean plus scores times axes is a shape.
    shares : (c,) float64
        Share of each component in the variance.
    """

    specimens: np.ndarray
    shapes: np.ndarray
    mean: np.ndarray
    scores: np.ndarray
    axes: np.ndarray
    shares: np.ndarray

    __repr__ = short_repr

    @property
    def distances(self) -> np.ndarray:
        """Distance of each shape from the mean, (m,) float64, in units of centroid size."""
        return np.linalg.norm(self.shapes - self.mean, axis=(1, 2))

    @property
    def limit(self) -> float:
        """Distance from the mean beyond which a shape is unusual: 1.5 interquartile ranges above the third quartile."""
        first, third = np.quantile(self.distances, [0.25, 0.75])
        return float(third + FENCE * (third - first))

    def grid(self, cells: int = GRID_CELLS) -> Grid:
        """Return the grid over the mean shape, and how it bends along each component.

        Raises
        ------
        LiaamError
            If the mean's landmarks lie on one line, or two in one place, so that no spline is defined.
        """
        low = self.mean.min(axis=0)
        high = self.mean.max(axis=0)
        margin = MARGIN * (high - low).max()
        step = ((high - low).max() + 2 * margin) / cells
        columns, rows = (int(np.ceil(side)) + 1 for side in (high - low + 2 * margin) / step)
        corner = (low + high) / 2 - step * np.array([columns - 1, rows - 1]) / 2
        across, down = np.meshgrid(np.arange(columns), np.arange(rows))
        places = corner + step * np.stack([across, down], axis=-1).reshape(-1, 2)
        weights = thin_plate_weights(self.mean, places)
        return Grid(rows, columns, places, np.einsum("gk,ckx->cgx", weights, self.axes))


@dataclass(frozen=True, eq=False)
class Grid:
    """A grid over the mean shape.

    Attributes
    ----------
    rows, columns : int
        Numbers of its points.
    points : (g, 2) float64
        Its points, row by row.
    bends : (c, g, 2) float64
        How these move along each principal component, for a score of 1.
    """

    rows: int
    columns: int
    points: np.ndarray
    bends: np.ndarray

    __repr__ = short_repr


def shape_space(specimens: Sequence[Specimen], most: int = COMPONENTS) -> ShapeSpace:
    """Superimpose the shapes of specimens, and find the principal components of their variation.

    Parameters
    ----------
    specimens : sequence of Specimen
        As :func:`liaam.morphometry.alike` gives them. Those that lack landmarks have no shape.
    most : int
        Number of components that are kept at most.

    Returns
    -------
    ShapeSpace

    Raises
    ------
    LiaamError
        If fewer than 3 specimens have a shape.
    """
    used = [index for index, specimen in enumerate(specimens) if has_shape(specimen.points)]
    if len(used) < FEWEST:
        raise LiaamError(
            f"{count_of(len(used), 'specimen')} with all landmarks: a sample has a space of shapes from {FEWEST} on"
        )
    fit = superimpose(np.array([specimens[index].points for index in used]) * (1.0, -1.0))
    flat = fit.shapes.reshape(len(used), -1)
    scores, axes, shares = principal_components(flat, most)
    mean = flat.mean(axis=0)
    return ShapeSpace(
        specimens=np.array(used),
        shapes=fit.shapes,
        mean=mean.reshape(-1, 2),
        scores=scores,
        axes=axes.reshape(len(axes), -1, 2),
        shares=shares,
    )


def thin_plate_weights(shape: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the matrix W (g, k) with which places (g, 2) move by W d if the landmarks of a shape (k, 2) move by d.

    Raises
    ------
    LiaamError
        If landmarks lie on one line, or two in one place.
    """
    from scipy.interpolate import RBFInterpolator

    spread = np.linalg.svd(shape - shape.mean(axis=0), compute_uv=False)
    apart = np.linalg.norm(shape[:, None] - shape[None], axis=2) + np.eye(len(shape)) * spread[0]
    if len(shape) < 3 or spread[1] < THINNEST * spread[0] or apart.min() < THINNEST * spread[0]:
        raise LiaamError("the landmarks lie on one line, or two in one place: there is no thin-plate spline of them")
    return RBFInterpolator(shape, np.eye(len(shape)), kernel="thin_plate_spline")(places)
