"""Principal component analysis, once for shapes and appearances."""

from dataclasses import dataclass

import numpy as np

from liaam.errors import TrainingError


@dataclass(frozen=True, eq=False)
class Components:
    """Principal components of a set of vectors.

    Attributes
    ----------
    mean : (d,) float64
    modes : (m, d) float64
        Orthonormal rows, strongest first, each with its largest entry positive.
    eigenvalues : (m,) float64
        Variance along each mode (divisor n - 1).
    total_variance : float
        Variance of all directions together, kept or not.
    """

    mean: np.ndarray
    modes: np.ndarray
    eigenvalues: np.ndarray
    total_variance: float


def check_variance(variance: float | int) -> None:
    """Raise unless variance is a fraction in (0, 1] (float) or a count of modes (int >= 0)."""
    is_count = isinstance(variance, (int, np.integer)) and not isinstance(variance, bool)
    if (is_count and variance >= 0) or (isinstance(variance, float) and 0.0 < variance <= 1.0):
        return
    raise TrainingError(f"variance {variance!r}: give a fraction in (0, 1] such as 0.98, or a whole count of modes")


def principal_components(vectors: np.ndarray, variance: float | int) -> Components:
    """Principal components of row vectors by their Gram matrix (few vectors, many dimensions).

    Parameters
    ----------
    vectors : (n, d) float
    variance : float or int
        Fraction of the variance to keep (1.0 keeps every direction), or the number of modes.
    """
    check_variance(variance)
    vectors = np.asarray(vectors, dtype=np.float64)
    n = len(vectors)
    mean = vectors.mean(axis=0)
    deviations = vectors - mean
    squares, combinations = np.linalg.eigh(deviations @ deviations.T)
    squares, combinations = squares[::-1], combinations[:, ::-1]
    kept = count_modes(squares, variance)
    modes = combinations[:, :kept].T @ deviations
    # Orthonormalise once more: the Gram matrix squares the condition number.
    modes = np.ascontiguousarray(np.linalg.qr(modes.T)[0].T) if kept else modes
    largest = np.abs(modes).argmax(axis=1) if kept else np.zeros(0, dtype=int)
    modes *= np.sign(modes[np.arange(kept), largest])[:, None]
    return Components(mean, modes, squares[:kept] / max(n - 1, 1), float(squares.clip(0).sum()) / max(n - 1, 1))


def count_modes(squares: np.ndarray, variance: float | int) -> int:
    """Give the number of modes to keep of descending squares; numerically empty directions never count."""
    rank = int((squares > 1e-10 * max(squares[0], 1e-300)).sum()) if squares[0] > 0 else 0
    if not isinstance(variance, float):
        return min(int(variance), rank)
    if variance == 1.0 or rank == 0:
        return rank
    share = np.cumsum(squares[:rank]) / squares[:rank].sum()
    return min(int(np.searchsorted(share, variance - 1e-12)) + 1, rank)


FOLDS = 10
"""Folds of the leave-out residuals, at most; with fewer images each is left out alone."""


def unexplained_by_others(vectors: np.ndarray, variance: float | int) -> np.ndarray:
    """What the principal components of the other vectors leave of each vector, (n, d) float32.

    Worked out on the vectors' Gram matrix: the components of a fold are combinations of vectors, so the
    long vectors are touched twice in all.
    """
    n = len(vectors)
    if n < 2:
        return np.zeros_like(vectors, dtype=np.float32)
    centred = vectors - vectors.mean(axis=0, dtype=np.float64).astype(vectors.dtype)
    products = np.asarray(centred @ centred.T, dtype=np.float64)
    explained = np.zeros((n, n))  # row: the combination of vectors that stands for each
    for fold in np.array_split(np.arange(n), min(n, FOLDS)):
        others = np.setdiff1d(np.arange(n), fold)
        explained[np.ix_(fold, others)] = _combinations(products, others, fold, variance)
    return (centred - explained.astype(vectors.dtype) @ centred).astype(np.float32)


def _combinations(products: np.ndarray, others: np.ndarray, fold: np.ndarray, variance: float | int) -> np.ndarray:
    """Combinations of the others that are nearest to the fold's vectors in the others' components."""
    within = products[np.ix_(others, others)]
    centring = np.eye(len(others)) - 1.0 / len(others)
    squares, axes = np.linalg.eigh(centring @ within @ centring)
    squares, axes = squares[::-1], axes[:, ::-1]
    kept = count_modes(squares, variance)
    axes = centring @ axes[:, :kept] / np.sqrt(squares[:kept])
    from_mean = products[np.ix_(fold, others)] - within.mean(axis=0)
    return 1.0 / len(others) + from_mean @ axes @ axes.T
