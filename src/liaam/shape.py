"""Statistical shape models: Procrustes alignment, PCA, and the four similarity vectors (paper eq 1-2)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from liaam.pca import principal_components, unexplained_by_others


def diagonal_of(shape: np.ndarray) -> float:
    """Length of the diagonal of a shape's bounding box."""
    return float(np.hypot(*(shape.max(axis=0) - shape.min(axis=0))))


def rotation(angle: float) -> np.ndarray:
    """Matrix that turns (x, y) by an angle in radians, from x towards y, (2, 2) float64."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, eq=False)
class Similarity:
    """Similarity x -> matrix @ x + offset of the plane (rotation, one scale, translation).

    Attributes
    ----------
    matrix : (2, 2) float64
    offset : (2,) float64
    """

    matrix: np.ndarray
    offset: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Apply to (..., 2) points."""
        return points @ self.matrix.T + self.offset

    @property
    def scale(self) -> float:
        """Length after / length before."""
        return float(np.sqrt(abs(np.linalg.det(self.matrix))))

    def inverse(self) -> "Similarity":
        """Give the similarity that undoes this one."""
        matrix = np.linalg.inv(self.matrix)
        return Similarity(matrix, -matrix @ self.offset)


def align(shape: np.ndarray, target: np.ndarray) -> Similarity:
    """Least-squares similarity (no reflection) that brings a shape onto a target.

    Parameters
    ----------
    shape, target : (n, 2) float
        Corresponding points. Points that are NaN in either are left out.

    Returns
    -------
    Similarity
    """
    seen = np.isfinite(shape).all(axis=1) & np.isfinite(target).all(axis=1)
    a, b = shape[seen], target[seen]
    a_mean, b_mean = a.mean(axis=0), b.mean(axis=0)
    # A similarity without reflection is a complex factor: z_b = factor * z_a.
    za, zb = (a - a_mean) @ [1, 1j], (b - b_mean) @ [1, 1j]
    power = float(np.vdot(za, za).real)
    factor = np.vdot(za, zb) / power if power > 0 else 1.0 + 0j
    matrix = np.array([[factor.real, -factor.imag], [factor.imag, factor.real]])
    return Similarity(matrix, b_mean - matrix @ a_mean)


def procrustes_mean(shapes: np.ndarray, iterations: int = 100, tolerance: float = 1e-10) -> np.ndarray:
    """Generalised Procrustes mean of shapes: centred, unit norm, oriented like the shapes on average.

    Parameters
    ----------
    shapes : (n_shapes, n_points, 2) float

    Returns
    -------
    (n_points, 2) float64
    """
    mean = _normalised(shapes[0])
    for _ in range(iterations):
        new = _normalised(np.mean([align(shape, mean)(shape) for shape in shapes], axis=0))
        # Keep the gauge: the mean may not turn while it settles.
        new = _normalised(align(new, mean)(new))
        moved = float(np.abs(new - mean).max())
        mean = new
        if moved < tolerance:
            break
    return _upright(mean, shapes)


def _normalised(shape: np.ndarray) -> np.ndarray:
    centred = shape - shape.mean(axis=0)
    return centred / np.linalg.norm(centred)


def _upright(mean: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Turn the mean by the average rotation towards the shapes as photographed."""
    turns = [align(mean, shape).matrix for shape in shapes]
    total = np.sum([turn / np.sqrt(abs(np.linalg.det(turn))) for turn in turns], axis=0)
    return mean @ rotation(np.arctan2(total[1, 0], total[0, 0])).T


def similarity_modes(mean: np.ndarray) -> np.ndarray:
    """Orthonormal similarity vectors s0, (-v, u), (1, 0, ...), (0, 1, ...) of a centred mean shape.

    Returns
    -------
    (4, 2 n) float64
        Flattened as x0, y0, x1, y1, ...
    """
    n = len(mean)
    turned = np.stack([-mean[:, 1], mean[:, 0]], axis=1)
    ones, zeros = np.ones(n), np.zeros(n)
    rows = [mean, turned, np.stack([ones, zeros], 1), np.stack([zeros, ones], 1)]
    return np.array([row.ravel() / np.linalg.norm(row) for row in rows])


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Shapes s(p) = s0 + sum_i p_i s_i (paper eq 1-2).

    Attributes
    ----------
    mean : (n, 2) float64
        s0, centred, in pixels of the reference frame.
    modes : (m, 2 n) float64
        Orthonormal PCA modes, orthogonal to the similarity vectors.
    eigenvalues : (m,) float64
        Variance along each mode, square pixels of the reference frame.
    unexplained : (n, 2, 2) float64, optional
        Second moments, by landmark, of what the modes of the other training shapes leave of each (leave one out),
        square pixels of the reference frame: how far even the best fit is from a person's landmarks.
    """

    mean: np.ndarray
    modes: np.ndarray
    eigenvalues: np.ndarray
    unexplained: np.ndarray | None = None

    @cached_property
    def basis(self) -> np.ndarray:
        """All shape vectors, PCA modes first and the four similarity vectors last, (m + 4, 2 n)."""
        return np.concatenate([self.modes, similarity_modes(self.mean)])

    @property
    def n_points(self) -> int:
        """Number of landmarks."""
        return len(self.mean)

    @property
    def left_out_bound(self) -> float:
        """Root mean square distance, over landmarks and shapes left out, that a perfect fit leaves (pixels)."""
        return np.nan if self.unexplained is None else float(np.sqrt(np.trace(self.unexplained, 0, 1, 2).mean()))

    def shape(self, p: np.ndarray) -> np.ndarray:
        """Shape s(p) for p of length m + 4, as (n, 2) float64."""
        return self.mean + (np.asarray(p) @ self.basis).reshape(-1, 2)

    def parameters(self, shape: np.ndarray) -> np.ndarray:
        """Coordinates p of a shape's orthogonal projection on the model, (m + 4,) float64."""
        return self.basis @ (np.asarray(shape) - self.mean).ravel()

    def project(self, shape: np.ndarray) -> np.ndarray:
        """Nearest shape of the model under any similarity: what a perfect fit could reach (the bound).

        Parameters
        ----------
        shape : (n, 2) float
            In any coordinates.

        Returns
        -------
        (n, 2) float64
            In the coordinates of the input.
        """
        pose = align(self.mean, shape)
        for _ in range(20):  # alternate pose and modes: the modes move with the pose
            local = self.shape(self._modes_only(pose.inverse()(shape)))
            new = align(local, shape)
            moved = float(np.abs(new(local) - pose(local)).max())
            pose = new
            if moved < 1e-9 * diagonal_of(shape):
                break
        return pose(self.shape(self._modes_only(pose.inverse()(shape))))

    def _modes_only(self, shape: np.ndarray) -> np.ndarray:
        p = self.parameters(shape)
        p[-4:] = 0.0
        return p


def train_shape_model(shapes: np.ndarray, diagonal: float, variance: float | int) -> ShapeModel:
    """Learn a shape model.

    Parameters
    ----------
    shapes : (n_shapes, n_points, 2) float
        Landmarks of the training images, finite.
    diagonal : float
        Diagonal of the mean shape's bounding box, pixels of the reference frame.
    variance : float or int
        Fraction of variance or number of modes to keep.
    """
    mean = procrustes_mean(shapes)
    return shape_model_on(mean * (diagonal / diagonal_of(mean)), shapes, variance)


def shape_model_on(mean: np.ndarray, shapes: np.ndarray, variance: float | int) -> ShapeModel:
    """Learn the modes of shapes (n_shapes, n_points, 2) around a given mean shape (n_points, 2)."""
    aligned = np.array([align(shape, mean)(shape) for shape in shapes])
    rigid = similarity_modes(mean)
    deviations = (aligned - mean).reshape(len(shapes), -1)
    # Modes live in the space orthogonal to the similarities, so that p and pose do not trade off.
    deviations -= deviations @ rigid.T @ rigid
    deviations[np.abs(deviations) < 1e-9 * diagonal_of(mean)] = 0.0  # rounding is no mode
    components = principal_components(deviations, variance)
    modes = components.modes - components.modes @ rigid.T @ rigid
    left = unexplained_by_others(deviations, variance).astype(np.float64).reshape(len(shapes), -1, 2)
    unexplained = np.einsum("ina,inb->nab", left, left) / len(shapes)
    return ShapeModel(mean, np.ascontiguousarray(modes), components.eigenvalues, unexplained)
