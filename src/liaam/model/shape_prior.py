"""What shapes may look like besides those of a few pictures: a covariance drawn towards smooth deformations.

The sample covariance S of n shapes has rank n - 1 and says that everything else is impossible. Here it is mixed with
smooth deformations of the mean shape, and with the scatter of landmarks placed by hand:

    C = (1 - share) S + share tr(S) K(width),        a shape is N(mean, C + noise tr(S) / d I)

K is the covariance of a Gaussian process on the mean shape, orthogonal to the similarities, of trace 1 (Cootes and
Taylor, BMVC 1995, mix in a finite element model's modes likewise). ``share``, ``width`` and ``noise`` are those under
which shapes left out of the sample are most likely. The modes are the eigenvectors of C.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import lgamma

import numpy as np

from liaam.model.pca import LeftOutCoordinates

SHARES = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6)
"""Shares of smooth deformations that are tried."""

WIDTHS = (0.1, 0.2)
"""Over how much of the mean shape's diagonal landmarks move together (standard deviation of the kernel)."""

NOISES = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Variances of landmarks that are no shape, as shares of the mean variance of a coordinate."""

FREEDOMS = (3.0, 5.0, 10.0, 20.0, 50.0, np.inf)
"""Degrees of freedom that are tried for the distribution of shapes; the last is a normal one."""

MOST_POINTS = 80
"""Landmarks by which the mixture is chosen: a Gaussian process on some of its points has the same parameters, and the
time grows with the third power of their number."""


@dataclass(frozen=True)
class SmoothPrior:
    """How much of the covariance is smooth deformation and noise.

    Attributes
    ----------
    share : float
        Of the variance, in smooth deformations.
    width : float
        Standard deviation of their kernel, as a share of the mean shape's diagonal.
    noise : float
        Variance of a coordinate that is no shape, as a share of the mean variance of a coordinate.
    evidence : float
        Logarithm of the density of the shapes left out, by shape.
    """

    share: float
    width: float
    noise: float
    evidence: float = -np.inf


@dataclass(frozen=True, eq=False)
class Deviations:
    """Aligned shapes as deviations from a mean shape, orthogonal to the similarities.

    Attributes
    ----------
    mean : (n_points, 2) float64
    rigid : (4, 2 n_points) float64
        Similarity vectors, orthonormal.
    own : (n, 2 n_points) float64
    further : (m, 2 n_points) float64
        Further examples that belong to those (row i to ``own[i]``, if there are any), such as mirrored ones.
    """

    mean: np.ndarray
    rigid: np.ndarray
    own: np.ndarray
    further: np.ndarray

    @property
    def dimension(self) -> int:
        """Of the space that shapes vary in."""
        return self.own.shape[1] - len(self.rigid)

    def of(self, kept: np.ndarray) -> "Deviations":
        """Deviations of some of the shapes."""
        return Deviations(
            self.mean, self.rigid, self.own[kept], self.further[kept] if len(self.further) else self.own[:0]
        )

    def thinned(self, count: int) -> "Deviations":
        """The same at so many landmarks at most, spread over the mean shape."""
        if len(self.mean) <= count:
            return self
        chosen = spread_points(self.mean, count)
        columns = np.arange(self.own.shape[1]).reshape(-1, 2)[chosen].ravel()
        rigid = np.linalg.qr(self.rigid[:, columns].T)[0].T  # similarities of the shape are those of its part

        def part(rows: np.ndarray) -> np.ndarray:
            return rows[:, columns] - rows[:, columns] @ rigid.T @ rigid

        return Deviations(self.mean[chosen], rigid, part(self.own), part(self.further))

    def sample_covariance(self) -> np.ndarray:
        """Second moments about the mean of ``own``, (d, d) float64; further examples need not have the same mean."""
        everything = np.concatenate([self.own, self.further]) - self.own.mean(axis=0)
        return everything.T @ everything / max(len(everything) - 1, 1)


def spread_points(points: np.ndarray, count: int) -> np.ndarray:
    """Choose points (n, 2) far from each other, (count,) int, rising: each is the farthest from those before it."""
    chosen = [int(np.square(points - points.mean(axis=0)).sum(axis=1).argmax())]
    nearest = np.full(len(points), np.inf)
    while len(chosen) < count:
        nearest = np.minimum(nearest, np.square(points - points[chosen[-1]]).sum(axis=1))
        chosen.append(int(nearest.argmax()))
    return np.array(sorted(chosen))


def smooth_covariance(mean: np.ndarray, rigid: np.ndarray, width: float) -> np.ndarray:
    """Covariance of smooth deformations, orthogonal to the similarities and of trace 1, (2 n, 2 n) float64.

    Parameters
    ----------
    mean : (n, 2) float
    rigid : (4, 2 n) float
        Orthonormal similarity vectors.
    width : float
        Standard deviation of the Gaussian kernel, as a share of the shape's diagonal.
    """
    reach = width * np.hypot(*np.ptp(mean, axis=0))
    apart = np.square(mean[:, None] - mean[None]).sum(axis=2)
    kernel = np.kron(np.exp(-0.5 * apart / reach**2), np.eye(2))
    beyond = np.eye(len(kernel)) - rigid.T @ rigid
    kernel = beyond @ kernel @ beyond
    return kernel / np.trace(kernel)


def covariance(deviations: Deviations, prior: SmoothPrior) -> np.ndarray:
    """Mixed covariance C of shapes, without the noise, (2 n_points, 2 n_points) float64."""
    sample = deviations.sample_covariance()
    smooth = smooth_covariance(deviations.mean, deviations.rigid, prior.width)
    return (1.0 - prior.share) * sample + prior.share * np.trace(sample) * smooth


def modes_of(spread: np.ndarray, rigid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvectors (m, d) of a covariance orthogonal to the similarities, strongest first, and eigenvalues (m,)."""
    # The similarities, whose variance is 0, are put last by a variance below 0.
    total = max(float(np.trace(spread)), 1e-12)
    values, vectors = np.linalg.eigh(spread - total * rigid.T @ rigid)
    values, modes = values[::-1][: -len(rigid)], vectors.T[::-1][: -len(rigid)]
    largest = np.take_along_axis(modes, np.abs(modes).argmax(axis=1)[:, None], axis=1)
    return np.ascontiguousarray(modes * np.where(largest < 0, -1.0, 1.0)), np.where(values > 1e-12 * total, values, 0.0)


def fit_prior(deviations: Deviations, folds: Sequence[np.ndarray]) -> SmoothPrior:
    """Find the mixture under which the shapes of each fold, left out in turn, are most likely.

    Of shapes of many landmarks, :data:`MOST_POINTS` are looked at.

    Parameters
    ----------
    deviations : Deviations
    folds : sequence of int arrays
        Shapes to leave out together: those of one object belong into one fold.
    """
    deviations, mixtures = deviations.thinned(MOST_POINTS), list(product(SHARES, WIDTHS))
    total = np.zeros((len(mixtures), len(NOISES)))
    count = 0
    for fold in folds:
        others = np.setdiff1d(np.arange(len(deviations.own)), fold)
        if len(others) < 2:
            continue
        part = deviations.of(others)
        sample, away = part.sample_covariance(), deviations.own[fold] - part.own.mean(axis=0)
        if not np.trace(sample) > 0:
            continue
        count += len(fold)
        total += np.array(list(_densities(sample, away, part, mixtures)))
    if not count:
        return SmoothPrior(0.0, WIDTHS[0], NOISES[0])
    best, noise = np.unravel_index(total.argmax(), total.shape)
    return SmoothPrior(*mixtures[best], NOISES[noise], float(total.max() / count))


def fit_freedom(left_out: Sequence[LeftOutCoordinates], kept: int) -> float:
    """Find the degrees of freedom under which shapes left out are most likely, of :data:`FREEDOMS`.

    A multivariate Student distribution on the modes kept, whose scale is the others' covariance.
    """
    squares = [(part.squares[:, :kept] / part.eigenvalues[:kept]).sum(axis=1) for part in left_out]
    if not squares or not kept:
        return np.inf
    densities = [_log_student(np.concatenate(squares), kept, freedom).sum() for freedom in FREEDOMS]
    return FREEDOMS[int(np.argmax(densities))] if np.isfinite(densities).all() else np.inf


def _log_student(squares: np.ndarray, dimension: int, freedom: float) -> np.ndarray:
    """Log density of a Student distribution by squared distances in standard deviations, but for a constant."""
    if not np.isfinite(freedom):
        return -0.5 * squares
    half = 0.5 * dimension
    constant = lgamma(0.5 * freedom + half) - lgamma(0.5 * freedom) - half * np.log(0.5 * freedom)
    return constant - (0.5 * freedom + half) * np.log1p(squares / freedom)


def _densities(
    sample: np.ndarray, away: np.ndarray, part: Deviations, mixtures: list[tuple[float, float]]
) -> Iterator[np.ndarray]:
    """Log density of deviations ``away`` from the mean under each mixture, one for each of the noises."""
    smooth = {width: smooth_covariance(part.mean, part.rigid, width) for width in WIDTHS}
    total = np.trace(sample)
    noises = np.array(NOISES)[:, None] * total / part.dimension
    for share, width in mixtures:
        modes, values = modes_of((1.0 - share) * sample + share * total * smooth[width], part.rigid)
        squares, variances = np.square(away @ modes.T).sum(axis=0), values + noises
        yield -0.5 * (squares / variances + len(away) * np.log(2.0 * np.pi * variances)).sum(axis=1)
