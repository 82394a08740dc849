"""Motion coordinates of a shape: four for the similarity and one per shape mode, all in image pixels.

A shape is y0 s0 + y1 (-v, u) + y2 (1, 0, ...) + y3 (0, 1, ...) + R (y4 s1 + y5 s2 + ...), with unit vectors of the
shape model (paper eq 2) and R the rotation given by y0 and y1. All columns are orthonormal, so distances in y equal
distances of landmarks, and a projection on the columns converts covariances.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from liaam.fitting import FitResult
from liaam.model.mirror import mirrored_shapes
from liaam.model.shape import ShapeModel, similarity_modes


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion coordinates of the shapes of a model in an image.

    Attributes
    ----------
    shape_model : ShapeModel
        The shapes as they are in the image.
    fitted : ShapeModel
        The shapes with which the model is fitted: of objects of the other side, the mirror images of these.
    """

    shape_model: ShapeModel
    fitted: ShapeModel

    @classmethod
    def of(cls, shapes: ShapeModel, *, is_reflected: bool = False) -> "Motion":
        """Return the motion of fits with a shape model, as they are or of the image reversed left to right."""
        order = np.arange(len(shapes.mean))
        return cls(mirrored_shapes(shapes, order) if is_reflected else shapes, shapes)

    @cached_property
    def similarity(self) -> np.ndarray:
        """Similarity vectors, (4, 2 n) float64."""
        return similarity_modes(self.shape_model.mean)

    @cached_property
    def modes(self) -> np.ndarray:
        """Modes as complex numbers, (m, n) complex128, which a factor rotates."""
        return np.ascontiguousarray(self.shape_model.modes).view(np.complex128)

    def coordinates(self, shape: np.ndarray) -> np.ndarray:
        """Project a shape (n, 2) on the coordinates y, (m + 4,) float64."""
        flat = np.asarray(shape, dtype=np.float64).ravel()
        return self.basis(self.similarity @ flat) @ flat

    def shape(self, y: np.ndarray) -> np.ndarray:
        """Return the shape (n, 2) float64 of coordinates (m + 4,)."""
        return (y @ self.basis(y)).reshape(-1, 2)

    def rest(self, shape: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return what of a shape (n, 2) lies outside its coordinates y, (n,) complex128, in the directions of the mean.

        It is relative to the size of the shape.
        """
        outside = np.ascontiguousarray(shape - self.shape(y)).view(np.complex128)[:, 0]
        return outside / (complex(y[0], y[1]) or 1.0)

    def shape_with(self, y: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Return the shape (n, 2) of coordinates y, with what lies outside of them (:meth:`rest`)."""
        outside = rest * complex(y[0], y[1])
        return self.shape(y) + np.stack([outside.real, outside.imag], axis=1)

    def basis(self, y: np.ndarray) -> np.ndarray:
        """Return orthonormal directions of the coordinates at `y`, (m + 4, 2 n) float64."""
        turn = complex(y[0], y[1])
        turned = self.modes * (turn / abs(turn) if abs(turn) > 0 else 1.0)
        return np.concatenate([self.similarity, turned.view(np.float64)])

    def measured(self, result: FitResult) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the coordinates of a fit, (m + 4,), their covariance by the fit, and their directions (m + 4, 2 n)."""
        y = self.coordinates(result.landmarks)
        basis = self.basis(y)
        n_p = len(result.p)
        moved = (self.fitted.basis.reshape(n_p, -1, 2) @ result.pose.matrix.T).reshape(n_p, -1)
        transformed = basis @ moved.T
        covariance = transformed @ _bounded(result.covariance[:n_p, :n_p]) @ transformed.T
        covariance[np.arange(len(y)), np.arange(len(y))] += LEAST
        return y, 0.5 * (covariance + covariance.T), basis


def landmark_covariances(basis: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the covariance of each landmark, (n, 2, 2) float64, from that of the coordinates and their directions."""
    columns = basis.reshape(len(basis), -1, 2)
    transformed = (covariance @ basis).reshape(columns.shape)
    return columns.transpose(1, 2, 0) @ transformed.transpose(1, 0, 2)


# Upper bound of variances, in square pixels. A fit has infinite variance in directions without information.
LARGEST = 1e6
LEAST = 1e-6  # Minimum variance of a coordinate, in square pixels, since the filter divides by it


def rescaled(shape: np.ndarray, before: tuple[int, int], after: tuple[int, int]) -> np.ndarray:
    """Transform a shape (n, 2) to an image of another (height, width). (0, 0) is a pixel centre."""
    ratio = np.array(after[::-1]) / np.array(before[::-1])
    return (shape + 0.5) * ratio - 0.5


def _bounded(covariance: np.ndarray) -> np.ndarray:
    """Replace infinite variances by large ones."""
    if np.trace(covariance) < LARGEST:
        return covariance
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance))
    return (vectors * np.clip(values, 0.0, LARGEST)) @ vectors.T
