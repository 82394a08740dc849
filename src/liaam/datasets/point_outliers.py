"""Find misplaced landmarks: points that are far from where the other points of their image predict them.

The aligned shapes are taken as normal, with a sample covariance shrunk towards independent points. With K, its inverse
on the shapes orthogonal to the similarities, and y, the deviation of a shape from the mean of the other images, point k
is (K_kk)^-1 (K y)_k from where the other points predict it, with covariance (K_kk)^-1. Points are left out one by one,
the most unusual first, until the shape is ordinary. They are replaced by their predictions, and the mean and the
covariance are estimated again, so that misplaced points do not hide each other.
"""

from dataclasses import dataclass

import numpy as np

from liaam.model.shape import align, diagonal_of, procrustes_mean, similarity_modes
from liaam.progress import Progress

LEAST_POINTS = 4  # Least number of landmarks: any three points have a usual shape when one is left out
RISK = 0.015  # Probability that a set of images without misplaced points has any reported, if its shapes vary normally
PRECISION = 0.003  # Usual precision of landmarks, as a fraction of the shape's diagonal

LEAST_SPREAD, ALWAYS = 3.5, 0.05
# Least distance of a misplaced landmark in its standard deviations, or in the usual precision where landmarks are
# placed more precisely; and at most this fraction of the diagonal, which allows for turned faces and open mouths, and
# is that for fewer images than MANY
LEAST = LEAST_SPREAD * PRECISION
MANY = 30  # Least number of images whose landmarks' standard deviations are relied on
# Candidate variances of independent points, as fractions of the mean variance of a coordinate
SHRINKAGES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
# Images that the landmarks' common scale counts for, when each landmark's own scale is estimated: as many as tell the
# scale from an upper decile to a quarter, which is about how much landmarks differ
POOLED = 30
ALIKE = 6.0  # Points whose test statistics differ by less may each explain an unusual shape
PRECISE = 0.8  # Precision of a scale from the smaller nine tenths of squared distances, relative to that from all
FAR = 4.0  # Distance to the guesses, in medians, above which landmarks do not count for the first covariance
PASSES = 4  # Number of estimates of the mean and the covariance
DOUBTFUL = 0.0015  # Share of points that do not count for the next estimate if none is misplaced


@dataclass(frozen=True, eq=False)
class Outliers:
    """Misplaced points of one shape.

    Attributes
    ----------
    points : tuple of int
        Points left out, the most unusual first.
    instead : tuple of int
        Points that explain the unusual shape nearly as well, if one point is left out.
    expected : (n, 2) float64
        Position of each point as predicted by those not left out.
    """

    points: tuple[int, ...]
    instead: tuple[int, ...]
    expected: np.ndarray


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal distribution of deviations ``own`` (m, 2 n), with its ``precision`` (2 n, 2 n) and ``scales`` (n,).

    ``freedom`` is the number of degrees of freedom of the covariance, ``least`` (n,) the least distances of misplaced
    points.
    """

    own: np.ndarray
    precision: np.ndarray
    scales: np.ndarray
    freedom: float
    least: np.ndarray

    def without(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and precision of the shapes but shape ``i``."""
        m, centre = len(self.own), self.own.mean(axis=0)
        away = self.own[i] - centre
        across, share = self.precision @ away, m / (m - 1) ** 2
        left = max(1 - share * float(across @ away), 0.01)
        return centre - away / (m - 1), self.precision + np.outer(across, across) * (share / left)


def point_outliers(shapes: np.ndarray, near: np.ndarray, progress: Progress | None = None) -> list[Outliers]:
    """Find the misplaced points of each shape.

    Parameters
    ----------
    shapes : (m, n, 2) float64
    near : (m, n, 2) float64
        Robust guesses of the landmarks, such as the median of similar shapes.
    progress : callable(done, total, what), optional
    """
    m, n = shapes.shape[:2]
    away = np.linalg.norm(shapes - near, axis=2)
    own, filled = shapes, np.where((away > FAR * np.median(away, axis=0))[..., None], near, shapes)
    found = []
    for done in range(PASSES):
        if progress:
            progress(done, PASSES, "comparing landmarks")
        mean = procrustes_mean(filled)
        mean = (mean - mean.mean(axis=0)) / diagonal_of(mean)
        poses = [align(shape, mean) for shape in filled]
        own = np.array([pose(shape) for pose, shape in zip(poses, own, strict=True)])
        filled = np.array([pose(shape) for pose, shape in zip(poses, filled, strict=True)])
        normal = _normal((filled - mean).reshape(m, -1), similarity_modes(mean))
        least = normal.least if m >= MANY else np.full(n, ALWAYS)
        if done < PASSES - 1 and m >= MANY:
            found = _unusual(normal, own - mean, max(DOUBTFUL, RISK / (m * n)), np.full(n, LEAST))
        else:
            # As Benjamini and Hochberg control false discoveries: the more are found, the more usual ones are reported.
            n_found, n_before = 1, 0
            while n_found > n_before:
                found = _unusual(normal, own - mean, RISK * n_found / (m * n), least)
                n_found, n_before = sum(len(outliers.points) for outliers in found), n_found
        filled = own.copy()
        for i, outliers in enumerate(found):
            at = list(outliers.points)
            filled[i, at] = mean[at] + outliers.expected[at]
    back = [align(placed, shape) for placed, shape in zip(own, shapes, strict=True)]
    return [Outliers(o.points, o.instead, b(mean + o.expected)) for o, b in zip(found, back, strict=True)]


def _unusual(normal: _Normal, away: np.ndarray, share: float, least: np.ndarray) -> list[Outliers]:
    """Return the points of each shape that are as unusual as a share of those that are not misplaced."""
    # Quantile of Hotelling's statistic of two dimensions, 2 F(2, freedom).
    limit = normal.freedom * (share ** (-2 / normal.freedom) - 1)
    return [_outliers(normal, i, own, limit, least) for i, own in enumerate(away)]


def resistant_fit(shapes: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Align shapes (m, n, 2) to another (n, 2) by similarities, fitted to the nearest three quarters of landmarks."""
    # Similarities are complex factors.
    own, aim = shapes[..., 0] + 1j * shapes[..., 1], target[:, 0] + 1j * target[:, 1]
    placed, near = own, np.ones(own.shape)
    for _ in range(3):
        weights = near / near.sum(axis=1, keepdims=True)
        centre, middle = (weights * own).sum(axis=1, keepdims=True), weights @ aim
        away = own - centre
        power = (weights * np.abs(away) ** 2).sum(axis=1)
        factor = (weights * away.conj() * (aim - middle[:, None])).sum(axis=1) / np.maximum(power, 1e-300)
        placed = factor[:, None] * away + middle[:, None]
        distances = np.abs(placed - aim)
        near = (distances <= np.quantile(distances, 0.75, axis=1, keepdims=True)).astype(float)
    return np.stack([np.real(placed), np.imag(placed)], axis=-1)


def _normal(own: np.ndarray, rigid: np.ndarray) -> _Normal:
    """Estimate the normal distribution that predicts the points of left-out shapes best."""
    m, n = len(own), own.shape[1] // 2
    own = own - own @ rigid.T @ rigid
    away = own - own.mean(axis=0)
    spread = away.T @ away / (m - 1)
    values, modes = np.linalg.eigh(spread - (np.trace(spread) + 1) * rigid.T @ rigid)
    values, modes = np.maximum(values[len(rigid) :], 0.0), modes[:, len(rigid) :]
    noises = np.maximum(np.array(SHRINKAGES) * values.mean(), PRECISION**2)
    best, kept = np.inf, (spread, away, 1.0)
    for noise in np.unique(noises):
        precision = (modes / (values + noise)) @ modes.T
        squares, distances = _left_out(away, precision)
        score = np.log(np.median(distances, axis=0) + 1e-12).mean()
        if score < best:
            best, kept = score, (precision, squares, float((values / (values + noise)).mean()))
    precision, squares, share = kept
    # Normal deviations have exponentially distributed squares of mean 2, of which the lower nine tenths have 1.488.
    # Of landmarks that slide along a contour, such as the ends of a jaw, most lie near and a few far: the upper decile
    # says how far, the median does not.
    each, most = np.quantile(squares, 0.9, axis=0) / np.log(100), np.quantile(squares, 0.9)
    common = max(squares[squares <= most].mean() / 1.488, most / np.log(100))
    scales = (m + POOLED) / np.maximum(m * each + POOLED * common, 1e-3)
    # The variances are those of single modes by this share; the rest is one variance of all coordinates.
    freedom = 1 / (share / (m - 2) + (1 - share) / (PRECISE * (m - 1) * (2 * n - 4)))
    deviations = np.sqrt(np.diagonal(spread).reshape(n, 2).mean(axis=1))
    return _Normal(own, precision, scales, freedom, np.clip(LEAST_SPREAD * deviations, LEAST, ALWAYS))


def _left_out(away: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared Mahalanobis distances and distances (m, n) of points to predictions without their own shape."""
    m = len(away)
    across = away @ precision
    share, lever = m / (m - 1) ** 2, np.einsum("ij,ij->i", across, away)[:, None]
    across = across.reshape(m, -1, 2)
    moves = np.einsum("kab,ikb->ika", np.linalg.inv(_blocks(precision)), across)
    squares = np.einsum("ika,ika->ik", moves, across)
    left = np.maximum(1 - share * lever, 0.01)  # without the shape itself, by the formula of Sherman and Morrison
    return squares / left / (left + share * squares), np.linalg.norm(moves, axis=2) / (left + share * squares)


def _blocks(precision: np.ndarray) -> np.ndarray:
    """Blocks (n, 2, 2) of each point in a matrix (2 n, 2 n)."""
    n, every = len(precision) // 2, np.arange(len(precision) // 2)
    return precision.reshape(n, 2, n, 2)[every, :, every]


def _outliers(normal: _Normal, i: int, own: np.ndarray, limit: float, least: np.ndarray) -> Outliers:
    """Leave out points of shape ``i``, with deviations ``own`` (n, 2) from the mean, until it is ordinary."""
    centre, precision = normal.without(i)
    away = (own.ravel() - centre).reshape(-1, 2)
    n, gone, instead = len(own), [], ()
    while True:
        across, blocks = (precision @ away.ravel()).reshape(n, 2), _blocks(precision).copy()
        blocks[gone], across[gone] = np.eye(2), 0.0
        moves = np.linalg.solve(blocks, across[..., None])[..., 0]
        squares = (moves * across).sum(axis=1) * normal.scales
        unusual = np.where(np.linalg.norm(moves, axis=1) > least, squares, 0.0)
        worst = int(unusual.argmax())
        if unusual[worst] <= limit or len(gone) >= max((n - 2) // 2, 1):
            break
        if not gone:
            instead = tuple(np.flatnonzero(unusual > unusual[worst] - ALIKE).tolist())
        gone.append(worst)
        columns = precision[:, 2 * worst : 2 * worst + 2]
        precision = precision - columns @ np.linalg.solve(blocks[worst], columns.T)
    if gone:
        at = np.add.outer(2 * np.array(gone), [0, 1]).ravel()
        whole = normal.without(i)[1]
        moves[gone] = np.linalg.solve(whole[np.ix_(at, at)], (whole @ away.ravel())[at]).reshape(-1, 2)
    others = tuple(k for k in instead if k not in gone) if len(gone) == 1 else ()
    return Outliers(tuple(gone), others, own - moves)
