"""Principal component analysis of shapes and appearances."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from liaam.errors import TrainingError

Variance = float | int | Literal["auto"]
"""Modes to keep: a fraction of the variance, a number of modes, or ``auto`` for the number of highest evidence."""


@dataclass(frozen=True, eq=False)
class Components:
    """Mean (d,) and principal components of a set of vectors.

    ``modes`` (m, d) are orthonormal rows, strongest first, each with its largest entry positive. ``eigenvalues`` (m,)
    are the variances along them (divisor n - 1).
    """

    mean: np.ndarray
    modes: np.ndarray
    eigenvalues: np.ndarray


def check_variance(variance: Variance) -> None:
    """Raise unless variance is a fraction in (0, 1] (float), a number of modes (int >= 0), or ``auto``."""
    is_count = isinstance(variance, (int, np.integer)) and not isinstance(variance, bool) and variance >= 0
    if is_count or (isinstance(variance, float) and 0.0 < variance <= 1.0) or variance == "auto":
        return
    raise TrainingError(
        f"variance {variance!r}: give a fraction in (0, 1] such as 0.98, a number of modes (0 for none), or 'auto'"
    )


CHUNK = 4096  # Columns of long vectors that are processed at once, in double precision


def chunks(length: int) -> Iterator[slice]:
    """Yield consecutive slices that cover a length."""
    return (slice(first, min(first + CHUNK, length)) for first in range(0, length, CHUNK))


def principal_components(vectors: np.ndarray, variance: float | int) -> Components:
    """Compute principal components of vectors (n, d) from the Gram matrix (for few vectors of many dimensions)."""
    return components_by(vectors, vectors.mean(axis=0, dtype=np.float64), gram_about(vectors), variance)


def gram_about(vectors: np.ndarray, centre: np.ndarray | None = None) -> np.ndarray:
    """Gram matrix, (n, n) float64, of vectors (n, d) about a point (d,), by default their mean.

    Chunks of columns are multiplied in the precision of the point, and summed in double precision.
    """
    origin = vectors.mean(axis=0, dtype=np.float64) if centre is None else centre
    products = np.zeros((len(vectors), len(vectors)))
    for part in chunks(vectors.shape[1]):
        away = vectors[:, part] - origin[part]
        products += away @ away.T
    return products


def centred(products: np.ndarray) -> np.ndarray:
    """Gram matrix about the mean, from a Gram matrix about any point."""
    means = products.mean(axis=0)
    return products - means - means[:, None] + means.mean()


def strongest(products: np.ndarray, variance: float | int) -> tuple[np.ndarray, np.ndarray]:
    """Leading principal components from the Gram matrix (n, n) about the mean.

    Return the sums of squares along the components, descending (m,), and orthonormal eigenvectors (n, m), which divided
    by the roots of these combine the centred vectors to the components.
    """
    squares, combinations = np.linalg.eigh(products)
    squares = squares[::-1]
    combinations = combinations[:, ::-1]
    count = count_modes(squares, variance)
    return squares[:count], combinations[:, :count]


def components_by(vectors: np.ndarray, mean: np.ndarray, products: np.ndarray, variance: float | int) -> Components:
    """Principal components of vectors (n, d) from their mean (d,) and their Gram matrix (n, n) about it."""
    squares, combinations = strongest(products, variance)
    weights = (combinations / np.sqrt(squares)).T
    n = len(squares)
    modes = np.empty((n, vectors.shape[1]))
    products = np.zeros((n, n))
    for part in chunks(vectors.shape[1]):
        modes[:, part] = weights @ (vectors[:, part] - mean[part])
        products += modes[:, part] @ modes[:, part].T
    # The Gram matrix squares the condition number, so orthonormalise once more (Cholesky QR).
    back = np.linalg.inv(np.linalg.cholesky(products))
    largest = np.zeros(n)
    for part in chunks(vectors.shape[1]):
        modes[:, part] = back @ modes[:, part]
        candidates = np.take_along_axis(modes[:, part], np.abs(modes[:, part]).argmax(axis=1)[:, None], axis=1)[:, 0]
        largest = np.where(np.abs(candidates) > np.abs(largest), candidates, largest)
    return Components(mean, modes * np.sign(largest)[:, None], squares / max(len(vectors) - 1, 1))


def count_modes(squares: np.ndarray, variance: float | int) -> int:
    """Number of modes to keep, from descending sums of squares; numerically empty directions never count."""
    rank = int((squares > 1e-10 * max(squares[0], 1e-300)).sum()) if len(squares) and squares[0] > 0 else 0
    if not isinstance(variance, float):
        return min(int(variance), rank)
    if variance == 1.0 or rank == 0:
        return rank
    share = np.cumsum(squares[:rank]) / squares[:rank].sum()
    return min(int(np.searchsorted(share, variance - 1e-12)) + 1, rank)


FOLDS = 10  # Largest number of folds for leave-out residuals; with fewer images each is a fold of its own


def some_folds(n: int) -> list[np.ndarray]:
    """Split the indices of n vectors into at most :data:`FOLDS` folds."""
    return np.array_split(np.arange(n), max(min(n, FOLDS), 1))


def unexplained_by_others(vectors: np.ndarray, variance: float | int, folds: Sequence[np.ndarray]) -> np.ndarray:
    """Residual of each vector from the principal components of the vectors outside its fold, (n, d) float32."""
    if len(vectors) < 2:
        return np.zeros_like(vectors, dtype=np.float32)
    away = vectors - vectors.mean(axis=0, dtype=np.float64)
    return (away - explained_by_others(gram_about(vectors), variance, folds) @ away).astype(np.float32)


def explained_by_others(products: np.ndarray, variance: float | int, folds: Sequence[np.ndarray]) -> np.ndarray:
    """Reconstruct each vector from the vectors outside its fold: rows of weights, (n, n) float64, that sum to 1.

    ``products`` is the Gram matrix (n, n) about any point. It suffices, since components are combinations of vectors.
    """
    n = len(products)
    explained = np.zeros((n, n))
    for fold in folds:
        others = np.setdiff1d(np.arange(n), fold)
        squares, axes, from_mean = _components_of(products, others, fold)
        axes = axes[:, : count_modes(squares, variance)]
        explained[np.ix_(fold, others)] = 1.0 / len(others) + from_mean @ axes @ axes.T
    return explained


def _components_of(
    products: np.ndarray, others: np.ndarray, fold: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Principal components of the vectors outside a fold, from the Gram matrix.

    Return the sums of squares along them (r,), descending, above rounding errors; the components as combinations of
    the others (len(others), r); and the scalar products of the fold's vectors, less the others' mean, with the others
    (len(fold), len(others)). The last times the combinations are coordinates.
    """
    within = products[np.ix_(others, others)]
    squares, axes = np.linalg.eigh(centred(within))
    squares = squares[::-1]
    axes = axes[:, ::-1]
    rank = count_modes(squares, 1.0)
    axes = (axes - axes.mean(axis=0))[:, :rank] / np.sqrt(squares[:rank])
    return squares[:rank], axes, products[np.ix_(fold, others)] - within.mean(axis=0)


@dataclass(frozen=True, eq=False)
class LeftOutCoordinates:
    """Left-out vectors in the principal components of the others.

    ``eigenvalues`` (r,) are those of the others (divisor n - 1), ``squares`` (m, r) squared coordinates of the left-out
    vectors, and ``distances`` (m,) their squared distances from the others' mean.
    """

    eigenvalues: np.ndarray
    squares: np.ndarray
    distances: np.ndarray


def leave_out(vectors: np.ndarray, folds: Sequence[np.ndarray]) -> Iterator[LeftOutCoordinates]:
    """Leave out the vectors (n, d) of each fold in turn. Vectors of the same object belong in the same fold."""
    vectors = np.asarray(vectors)
    products = gram_about(vectors)
    for fold in folds:
        others = np.setdiff1d(np.arange(len(vectors)), fold)
        if len(others) < 2:
            continue
        squares, axes, from_mean = _components_of(products, others, fold)
        to_mean = products[np.ix_(others, others)].mean()
        distances = np.diag(products)[fold] - 2.0 * products[np.ix_(fold, others)].mean(axis=1) + to_mean
        yield LeftOutCoordinates(squares / (len(others) - 1), np.square(from_mean @ axes), distances)


def log_evidence(left_out: LeftOutCoordinates, dimension: int) -> np.ndarray:
    """Log-likelihood of the left-out vectors under probabilistic PCA with 0 ... r - 1 modes, (r,)."""
    values = left_out.eigenvalues
    counts = np.arange(len(left_out.eigenvalues))
    # The noise is the mean of the eigenvalues not kept (Tipping and Bishop, J. R. Stat. Soc. B 61, 1999, eq 8).
    explained = np.concatenate([[0.0], np.cumsum(values)[:-1]])
    noise = np.maximum(values.sum() - explained, 0.0) / np.maximum(dimension - counts, 1)
    along = np.cumsum(np.pad(left_out.squares / values, ((0, 0), (1, 0))), axis=1)[:, :-1]
    across = left_out.distances[:, None] - np.cumsum(np.pad(left_out.squares, ((0, 0), (1, 0))), axis=1)[:, :-1]
    volume = np.concatenate([[0.0], np.cumsum(np.log(values))[:-1]]) + (dimension - counts) * np.log(noise)
    return -0.5 * (along + across / noise + volume + dimension * np.log(2.0 * np.pi)).sum(axis=0)


def count_by_evidence(vectors: np.ndarray, folds: Sequence[np.ndarray], dimension: int | None = None) -> int:
    """Choose the number of modes that maximises the likelihood of left-out vectors, of (n, d), in some dimensions.

    The vectors of each fold are evaluated under probabilistic PCA of the others. Minka's evidence (NIPS 2000) needs no
    folds, but treats images of one object as independent.
    """
    d = vectors.shape[1] if dimension is None else dimension
    evidence = [log_evidence(left_out, d) for left_out in leave_out(vectors, folds)]
    counts = min((len(each) for each in evidence), default=0)
    return int(np.sum([each[:counts] for each in evidence], axis=0).argmax()) if counts else 0


def left_out_variances(vectors: np.ndarray, folds: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Variance of left-out vectors along the others' 1st, 2nd, ... mode, non-increasing, (count,) float64.

    The sample's eigenvalues are biased, since the modes are fitted to the sample: the first are too large, the last too
    small (cross-validated non-linear shrinkage; Bartz, 2016).
    """
    from scipy.optimize import isotonic_regression  # heavy: imported when first needed

    parts = list(leave_out(vectors, folds))
    n_modes = min((left_out.squares.shape[1] for left_out in parts), default=0)
    if not n_modes:
        return np.zeros(count)
    variances = np.concatenate([left_out.squares[:, :n_modes] for left_out in parts]).mean(axis=0)
    # The folds have fewer modes than all vectors together: repeat their last variance.
    padded = np.pad(variances, (0, max(count - n_modes, 0)), mode="edge")[:count]
    return isotonic_regression(padded, increasing=False).x if count else padded
