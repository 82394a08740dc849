"""Coordinates in which a shape moves: four of similarity, and the shape model's modes, all in image pixels.

A shape is y0 s0 + y1 (-v, u) + y2 (1, 0, ...) + y3 (0, 1, ...) + R (y4 s1 + y5 s2 + ...), with unit vectors of the
shape model (paper eq 1-2) and R the rotation of the first two. All columns are orthonormal, so distances in y are
distances of landmarks, and a covariance of landmarks is one of y by the columns alone.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from liaam.fitting import FitResult
from liaam.model.shape import ShapeModel, similarity_modes


@dataclass(frozen=True, eq=False)
class Motion:
    """The coordinates of a shape model's shapes in a picture.

    Attributes
    ----------
    shape_model : ShapeModel
    """

    shape_model: ShapeModel

    @cached_property
    def similarity(self) -> np.ndarray:
        """The four similarity vectors, (4, 2 n) float64."""
        return similarity_modes(self.shape_model.mean)

    @cached_property
    def modes(self) -> np.ndarray:
        """The modes as points of the complex plane, (m, n) complex128: a rotation is a factor."""
        return _complex(self.shape_model.modes)

    def coordinates(self, shape: np.ndarray) -> np.ndarray:
        """Coordinates y of a shape (n, 2), (m + 4,) float64; what the modes do not show of it is left out."""
        flat = np.asarray(shape, dtype=np.float64).ravel()
        pose = self.similarity @ flat
        turned_back = _complex((flat - pose @ self.similarity)[None])[0] * np.conj(_turn(pose))
        return np.concatenate([pose, (np.conj(self.modes) @ turned_back).real])

    def shape(self, y: np.ndarray) -> np.ndarray:
        """Shape of coordinates (m + 4,), (n, 2) float64."""
        rigid = (y[:4] @ self.similarity).reshape(-1, 2)
        return rigid + _real(((y[4:] @ self.modes) * _turn(y[:4]))[None]).reshape(-1, 2)

    def basis(self, y: np.ndarray) -> np.ndarray:
        """Orthonormal directions of the coordinates about a place, (m + 4, 2 n) float64."""
        return np.concatenate([self.similarity, _real(self.modes * _turn(y[:4]))])

    def measured(self, result: FitResult) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates of a fit, their covariance as the fit has it, and their directions.

        Returns
        -------
        y : (m + 4,) float64
        covariance : (m + 4, m + 4) float64
        basis : (m + 4, 2 n) float64
        """
        y = self.coordinates(result.landmarks)
        basis, n_p = self.basis(y), len(result.p)
        moved = (self.shape_model.basis.reshape(n_p, -1, 2) @ result.pose.matrix.T).reshape(n_p, -1)
        carried = basis @ moved.T
        covariance = carried @ _bounded(result.covariance[:n_p, :n_p]) @ carried.T
        covariance[np.arange(len(y)), np.arange(len(y))] += LEAST
        return y, 0.5 * (covariance + covariance.T), basis


def landmark_covariances(basis: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Covariance of each landmark, (n, 2, 2) float64, by that of the coordinates and their directions."""
    columns = basis.reshape(len(basis), -1, 2)
    carried = (covariance @ basis).reshape(columns.shape)
    return columns.transpose(1, 2, 0) @ carried.transpose(1, 0, 2)


LARGEST = 1e6
"""Variance that stands for knowing nothing, square pixels; a fit says infinity there."""

LEAST = 1e-6
"""Variance that any coordinate has at least, square pixels: a filter divides by it."""


def rescaled(shape: np.ndarray, before: tuple[int, int], after: tuple[int, int]) -> np.ndarray:
    """Shape (n, 2) in a picture whose (height, width) has changed; pixels are counted by their centres."""
    ratio = np.array(after[::-1]) / np.array(before[::-1])
    return (shape + 0.5) * ratio - 0.5


def _bounded(covariance: np.ndarray) -> np.ndarray:
    """Covariance whose infinities have become large numbers."""
    if np.trace(covariance) < LARGEST:
        return covariance
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance))
    return (vectors * np.clip(values, 0.0, LARGEST)) @ vectors.T


def _turn(pose: np.ndarray) -> complex:
    """Rotation of the first two coordinates, as a complex number of length 1."""
    turn = complex(pose[0], pose[1])
    return turn / abs(turn) if abs(turn) > 0 else 1.0 + 0.0j


def _complex(rows: np.ndarray) -> np.ndarray:
    return rows[:, ::2] + 1j * rows[:, 1::2]


def _real(rows: np.ndarray) -> np.ndarray:
    return np.stack([np.real(rows), np.imag(rows)], axis=2).reshape(len(rows), -1)
