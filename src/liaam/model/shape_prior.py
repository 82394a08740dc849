"""Covariance of shapes learnt from few images: the sample covariance shrunk towards smooth deformations.

The sample covariance S of n shapes has rank n - 1: shapes outside its span would be impossible. Here it is mixed with
smooth deformations of the mean shape and with annotation noise:

    C = (1 - share) S + share tr(S) K(width),        shapes are N(mean, C + noise tr(S) / d I)

K is the covariance of a Gaussian process on the mean shape, orthogonal to the similarities, of trace 1 (Cootes and
Taylor, BMVC 1995, likewise mix in the modes of a finite element model). ``share``, ``width`` and ``noise`` maximise
the likelihood of left-out shapes. The modes are the eigenvectors of C.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import lgamma

import numpy as np

from liaam.model.pca import LeftOutCoordinates

SHARES = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6)  # Candidate fractions of smooth deformations
WIDTHS = (0.1, 0.2)  # Candidate standard deviations of the kernel, as fractions of the mean shape's diagonal
# Candidate variances of the annotation noise, as fractions of the mean variance of a coordinate
NOISES = (0.01, 0.02, 0.05, 0.1, 0.2)
# Candidate degrees of freedom of the shapes' distribution; the last is a normal distribution
FREEDOMS = (3.0, 5.0, 10.0, 20.0, 50.0, np.inf)
# Largest number of landmarks used to choose the mixture. A Gaussian process on a subset of points has the same
# parameters, and the time grows with the cube of their number.
MOST_POINTS = 80


@dataclass(frozen=True)
class SmoothPrior:
    """Parameters of the mixture (see :data:`SHARES`, :data:`WIDTHS`, :data:`NOISES`).

    ``evidence`` is the mean log-likelihood of a left-out shape.
    """

    share: float
    width: float
    noise: float
    evidence: float = -np.inf


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariances of deviations whose landmarks are partly estimated.

    ``rows`` (r, 2 n_points) float64 are displacements. The outer products of those of a shape sum up to its
    covariance. ``owners`` (r,) int are the shapes that they belong to, and ``known`` (n, n_points) bool says which
    landmarks of the shapes are known. ``further`` are the rows of mirrored shapes in the same order, or no rows.
    """

    rows: np.ndarray
    owners: np.ndarray
    known: np.ndarray
    further: np.ndarray

    def of(self, kept: np.ndarray) -> "Spread":
        """Return the covariances of some of the shapes."""
        places = np.full(len(self.known), -1)
        places[kept] = np.arange(len(kept))
        owners = places[self.owners]
        are_kept = owners >= 0
        further = self.further[are_kept] if len(self.further) else self.further
        return Spread(self.rows[are_kept], owners[are_kept], self.known[kept], further)

    def moments(self) -> np.ndarray:
        """Sum of the covariances of all examples, (2 n_points, 2 n_points) float64."""
        everything = np.concatenate([self.rows, self.further])
        return everything.T @ everything

    def squares_along(self, modes: np.ndarray) -> np.ndarray:
        """Return the variance of each shape along modes (k, 2 n_points), (n, k) float64."""
        squares = np.zeros((len(self.known), len(modes)))
        np.add.at(squares, self.owners, np.square(self.rows @ modes.T))
        return squares


@dataclass(frozen=True, eq=False)
class Deviations:
    """Aligned shapes as deviations ``own`` (n, 2 n_points) from a mean shape (n_points, 2).

    They are orthogonal to the similarity vectors ``rigid`` (4, 2 n_points), which are orthonormal. ``further`` are
    examples such as mirrored shapes, in which row i belongs to ``own[i]``, or no rows. ``spread`` are the covariances
    of both if landmarks are missing.
    """

    mean: np.ndarray
    rigid: np.ndarray
    own: np.ndarray
    further: np.ndarray
    spread: Spread | None = None

    @property
    def dimension(self) -> int:
        """Dimension of the space in which shapes vary."""
        return self.own.shape[1] - len(self.rigid)

    def of(self, kept: np.ndarray) -> "Deviations":
        """Return the deviations of some of the shapes."""
        further = self.further[kept] if len(self.further) else self.further
        spread = None if self.spread is None else self.spread.of(kept)
        return Deviations(self.mean, self.rigid, self.own[kept], further, spread)

    def thinned(self, count: int) -> "Deviations":
        """Return the deviations of at most ``count`` landmarks, spread over the mean shape."""
        if len(self.mean) <= count:
            return self
        chosen = spread_points(self.mean, count)
        columns = np.arange(self.own.shape[1]).reshape(-1, 2)[chosen].ravel()
        rigid = np.linalg.qr(self.rigid[:, columns].T)[0].T

        def part(rows: np.ndarray) -> np.ndarray:
            return rows[:, columns] - rows[:, columns] @ rigid.T @ rigid

        spread = self.spread
        if spread is not None:
            spread = Spread(part(spread.rows), spread.owners, spread.known[:, chosen], part(spread.further))
        return Deviations(self.mean[chosen], rigid, part(self.own), part(self.further), spread)

    def sample_covariance(self) -> np.ndarray:
        """Second moments of all examples about the mean of ``own``, (d, d) float64.

        Of missing landmarks these are expected values: the M-step of expectation maximisation.
        """
        everything = np.concatenate([self.own, self.further]) - self.own.mean(axis=0)
        moments = everything.T @ everything
        if self.spread is not None:
            moments += self.spread.moments()
        return moments / max(len(everything) - 1, 1)


def spread_points(points: np.ndarray, count: int) -> np.ndarray:
    """Choose points (n, 2) far from each other by farthest-point sampling; return sorted indices, (count,) int."""
    chosen = [int(np.square(points - points.mean(axis=0)).sum(axis=1).argmax())]
    nearest = np.full(len(points), np.inf)
    while len(chosen) < count:
        nearest = np.minimum(nearest, np.square(points - points[chosen[-1]]).sum(axis=1))
        chosen.append(int(nearest.argmax()))
    return np.array(sorted(chosen))


def smooth_covariance(mean: np.ndarray, rigid: np.ndarray, width: float) -> np.ndarray:
    """Covariance of smooth deformations, orthogonal to the similarities ``rigid`` and of trace 1, (2 n, 2 n)."""
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
    """Eigenvectors (m, d) and descending eigenvalues (m,) of a covariance orthogonal to the similarities."""
    # Give the similarities, whose variance is 0, a negative variance, so that they come last.
    total = max(float(np.trace(spread)), 1e-12)
    values, vectors = np.linalg.eigh(spread - total * rigid.T @ rigid)
    values = values[::-1][: -len(rigid)]
    modes = vectors.T[::-1][: -len(rigid)]
    largest = np.take_along_axis(modes, np.abs(modes).argmax(axis=1)[:, None], axis=1)
    return np.ascontiguousarray(modes * np.where(largest < 0, -1.0, 1.0)), np.where(values > 1e-12 * total, values, 0.0)


def log_density(
    away: np.ndarray, spread: np.ndarray, noises: np.ndarray, rigid: np.ndarray, uncertain: np.ndarray | None = None
) -> np.ndarray:
    """Return the log-density of deviations (n, d) under N(0, spread + noise), summed over them, for each noise, (k,).

    Both live in the space orthogonal to the similarities ``rigid`` (r, d), where the noise is white. If the deviations
    are expected values, ``uncertain`` (k, d) are the rows of their covariances, and the density is an expected value.
    """
    from scipy.linalg import solve_triangular  # heavy: imported when first needed

    similar = rigid.T @ rigid
    beyond = np.eye(len(similar)) - similar
    n = len(away)
    away = (away if uncertain is None else np.concatenate([away, uncertain])) @ beyond
    densities = []
    for noise in noises:
        # A variance of 1 along the similarities, where nothing deviates, adds nothing to the density.
        factor = np.linalg.cholesky(spread + noise * beyond + similar)
        whitened = solve_triangular(factor, away.T, lower=True, check_finite=False)
        log_determinant = 2.0 * np.log(np.diag(factor)).sum()
        constant = (len(similar) - len(rigid)) * np.log(2.0 * np.pi) + log_determinant
        densities.append(-0.5 * (np.square(whitened).sum() + n * constant))
    return np.array(densities)


def fit_prior(deviations: Deviations, folds: Sequence[np.ndarray]) -> SmoothPrior:
    """Find the mixture that maximises the likelihood of left-out shapes. Those of one object belong in one fold."""
    deviations = deviations.thinned(MOST_POINTS)
    # Without smooth deformations, their width is no matter.
    mixtures = [(share, width) for share, width in product(SHARES, WIDTHS) if share > 0.0 or width == WIDTHS[0]]
    total = np.zeros((len(mixtures), len(NOISES)))
    count = 0
    for fold in folds:
        others = np.setdiff1d(np.arange(len(deviations.own)), fold)
        if len(others) < 2:
            continue
        part = deviations.of(others)
        sample = part.sample_covariance()
        away = deviations.own[fold] - part.own.mean(axis=0)
        trace = np.trace(sample)
        if not trace > 0:
            continue
        count += len(fold)
        uncertain = None if deviations.spread is None else deviations.spread.of(fold).rows
        smooth = {width: smooth_covariance(part.mean, part.rigid, width) for width in WIDTHS}
        noises = np.array(NOISES) * trace / part.dimension
        for i, (share, width) in enumerate(mixtures):
            spread = (1.0 - share) * sample + share * trace * smooth[width]
            total[i] += log_density(away, spread, noises, part.rigid, uncertain)
    if not count:
        return SmoothPrior(0.0, WIDTHS[0], NOISES[0])
    best, noise = np.unravel_index(total.argmax(), total.shape)
    return SmoothPrior(*mixtures[best], NOISES[noise], float(total.max() / count))


def fit_freedom(left_out: Sequence[LeftOutCoordinates], kept: int) -> float:
    """Find the degrees of freedom, of :data:`FREEDOMS`, that maximise the likelihood of left-out shapes.

    The model is a multivariate Student distribution on the modes kept, whose scale is the covariance of the others.
    """
    squares = [(part.squares[:, :kept] / part.eigenvalues[:kept]).sum(axis=1) for part in left_out]
    if not squares or not kept:
        return np.inf
    together = np.concatenate(squares)
    half = 0.5 * kept
    densities = [(-0.5 * together).sum()]  # up to a constant, of the normal distribution
    for freedom in FREEDOMS[:-1]:
        constant = lgamma(0.5 * freedom + half) - lgamma(0.5 * freedom) - half * np.log(0.5 * freedom)
        densities.insert(-1, (constant - (0.5 * freedom + half) * np.log1p(together / freedom)).sum())
    return FREEDOMS[int(np.argmax(densities))] if np.isfinite(densities).all() else np.inf
