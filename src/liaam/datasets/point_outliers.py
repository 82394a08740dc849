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

# Least distance of a misplaced landmark from its prediction, in standard deviations of that landmark.
LEAST_SPREAD = 3.5
# The same as a fraction of the diagonal, for landmarks that vary by less than the usual precision of labels.
LEAST = LEAST_SPREAD * PRECISION
# Distance, as a fraction of the diagonal, that is enough for any landmark. It allows for turned faces and open mouths.
# In sets of fewer than MANY images, whose standard deviations are not relied on, all landmarks need it.
ALWAYS = 0.05
MANY = 30  # Least number of images whose landmarks' standard deviations are relied on

# Candidate variances of independent points, as fractions of the mean variance of a coordinate.
SHRINKAGES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
# Images that the landmarks' common scale counts for, when each landmark's own scale is estimated: as many as tell the
# scale from an upper decile to a quarter, which is about how much landmarks differ.
POOLED = 30
PRECISE = 0.8  # Precision of a scale from the smaller nine tenths of squared distances, relative to that from all
# Squared distances of normal deviations in the plane are exponentially distributed with mean 2. Their upper decile is
# 2 log 10, and the mean of those below it is 2 (1 - log(10) / 9) = 1.488.
UPPER_DECILE = 0.9
DECILE_OF_NORMAL = np.log(100)
MEAN_BELOW_DECILE = 1.488

ALIKE = 6.0  # Points whose test statistics differ by less may each explain an unusual shape
FAR = 4.0  # Distance to the guesses, in medians, above which landmarks do not count for the first covariance
PASSES = 4  # Number of estimates of the mean and the covariance
DOUBTFUL = 0.0015  # Share of points that do not count for the next estimate if none is misplaced
# Least denominator in the formula of Sherman and Morrison, which leaves a shape out. It is near 0 if no other shape
# deviates in the same direction.
LEAST_LEFT = 0.01


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
    """Normal distribution of the deviations of shapes from a mean, from which points are predicted.

    Attributes
    ----------
    deviations : (m, 2 n) float64
        Deviations of all shapes, without their similarities.
    precision : (2 n, 2 n) float64
        Inverse covariance of deviations.
    scales : (n,) float64
        Factors that make the squared Mahalanobis distances of each point those of a normal distribution.
    freedom : float
        Degrees of freedom of the covariance.
    least : (n,) float64
        Least distance of each point from its prediction if it is misplaced.
    """

    deviations: np.ndarray
    precision: np.ndarray
    scales: np.ndarray
    freedom: float
    least: np.ndarray

    def without(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean and the precision of all shapes but shape ``i``, by the formula of Sherman and Morrison."""
        m = len(self.deviations)
        centre = self.deviations.mean(axis=0)
        away = self.deviations[i] - centre
        weighted = self.precision @ away
        share = m / (m - 1) ** 2
        left = max(1 - share * float(weighted @ away), LEAST_LEFT)
        mean = centre - away / (m - 1)
        precision = self.precision + np.outer(weighted, weighted) * (share / left)
        return mean, precision


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
    distances = np.linalg.norm(shapes - near, axis=2)
    are_far = distances > FAR * np.median(distances, axis=0)
    placed = shapes  # all shapes, aligned to the mean of the last pass
    filled = np.where(are_far[..., None], near, shapes)  # the same, with predictions instead of misplaced points
    outliers: list[Outliers] = []
    for i_pass in range(PASSES):
        if progress:
            progress(i_pass, PASSES, "comparing landmarks")
        mean = procrustes_mean(filled)
        mean = (mean - mean.mean(axis=0)) / diagonal_of(mean)
        poses = [align(shape, mean) for shape in filled]
        placed = np.array([pose(shape) for pose, shape in zip(poses, placed, strict=True)])
        filled = np.array([pose(shape) for pose, shape in zip(poses, filled, strict=True)])
        normal = _learn_normal((filled - mean).reshape(m, -1), similarity_modes(mean))
        if i_pass < PASSES - 1 and m >= MANY:
            share = max(DOUBTFUL, RISK / (m * n))
            outliers = _unusual(normal, placed - mean, share, np.full(n, LEAST))
        else:
            outliers = _discovered(normal, placed - mean, normal.least if m >= MANY else np.full(n, ALWAYS))
        filled = placed.copy()
        for shape, of_shape in zip(filled, outliers, strict=True):
            misplaced = list(of_shape.points)
            shape[misplaced] = mean[misplaced] + of_shape.expected[misplaced]
    back = [align(aligned, shape) for aligned, shape in zip(placed, shapes, strict=True)]
    return [
        Outliers(of_shape.points, of_shape.instead, to_image(mean + of_shape.expected))
        for of_shape, to_image in zip(outliers, back, strict=True)
    ]


def _discovered(normal: _Normal, deviations: np.ndarray, least: np.ndarray) -> list[Outliers]:
    """Return the misplaced points of shapes with deviations (m, n, 2) from the mean.

    As Benjamini and Hochberg control false discoveries: the more points are found, the more usual ones are reported.
    """
    m, n = deviations.shape[:2]
    outliers: list[Outliers] = []
    n_found = 1
    n_before = 0
    while n_found > n_before:
        outliers = _unusual(normal, deviations, RISK * n_found / (m * n), least)
        n_before = n_found
        n_found = sum(len(of_shape.points) for of_shape in outliers)
    return outliers


def _unusual(normal: _Normal, deviations: np.ndarray, share: float, least: np.ndarray) -> list[Outliers]:
    """Return the points of each shape that are as unusual as a share of those that are not misplaced."""
    # Quantile of Hotelling's statistic of two dimensions, 2 F(2, freedom).
    limit = normal.freedom * (share ** (-2 / normal.freedom) - 1)
    return [_outliers(normal, i, deviation, limit, least) for i, deviation in enumerate(deviations)]


def resistant_fit(shapes: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Align shapes (m, n, 2) to another (n, 2) by similarities, fitted to the nearest three quarters of landmarks."""
    # Landmarks are complex numbers, so that similarities are complex factors.
    moving = shapes[..., 0] + 1j * shapes[..., 1]
    fixed = target[:, 0] + 1j * target[:, 1]
    placed = moving
    are_near = np.ones(moving.shape)
    for i in range(3):
        if i:
            distances = np.abs(placed - fixed)
            are_near = (distances <= np.quantile(distances, 0.75, axis=1, keepdims=True)).astype(float)
        weights = are_near / are_near.sum(axis=1, keepdims=True)
        centre = (weights * moving).sum(axis=1, keepdims=True)
        target_centre = (weights @ fixed)[:, None]
        centred = moving - centre
        power = (weights * np.abs(centred) ** 2).sum(axis=1)
        product = (weights * centred.conj() * (fixed - target_centre)).sum(axis=1)
        factor = product / np.maximum(power, 1e-300)
        placed = factor[:, None] * centred + target_centre
    return np.stack([np.real(placed), np.imag(placed)], axis=-1)


@dataclass(frozen=True, eq=False)
class _Shrunk:
    """An inverse covariance that is shrunk towards independent points, and how well it predicts left-out shapes.

    Attributes
    ----------
    precision : (2 n, 2 n) float64
    squares : (m, n) float64
        Squared Mahalanobis distances of points to their predictions without their own shape.
    share : float
        Mean share of the sample covariance in the variances along its modes.
    score : float
        Mean over the points of the logarithm of the median distance to their predictions: the smaller, the better.
    """

    precision: np.ndarray
    squares: np.ndarray
    share: float
    score: float


def _learn_normal(deviations: np.ndarray, rigid: np.ndarray) -> _Normal:
    """Estimate the normal distribution that predicts the points of left-out shapes best.

    ``rigid`` (4, 2 n) are the modes of similarities, which are taken out of the deviations (m, 2 n).
    """
    m = len(deviations)
    n = deviations.shape[1] // 2
    deviations = deviations - deviations @ rigid.T @ rigid
    centred = deviations - deviations.mean(axis=0)
    spread = centred.T @ centred / (m - 1)
    # The similarities get the lowest eigenvalues, and are left out.
    values, modes = np.linalg.eigh(spread - (np.trace(spread) + 1) * rigid.T @ rigid)
    values = np.maximum(values[len(rigid) :], 0.0)
    modes = modes[:, len(rigid) :]
    noises = np.maximum(np.array(SHRINKAGES) * values.mean(), PRECISION**2)
    shrunk = [_shrunk(centred, values, modes, noise) for noise in np.unique(noises)]
    best = min(shrunk, key=lambda each: each.score)
    # The variances are those of single modes by this share; the rest is one variance of all coordinates.
    freedom = 1 / (best.share / (m - 2) + (1 - best.share) / (PRECISE * (m - 1) * (2 * n - 4)))
    standard_deviations = np.sqrt(np.diagonal(spread).reshape(n, 2).mean(axis=1))
    return _Normal(
        deviations=deviations,
        precision=best.precision,
        scales=_scales(best.squares),
        freedom=freedom,
        least=np.clip(LEAST_SPREAD * standard_deviations, LEAST, ALWAYS),
    )


def _shrunk(centred: np.ndarray, values: np.ndarray, modes: np.ndarray, noise: float) -> _Shrunk:
    """Add the variance ``noise`` of independent points to a covariance, of which eigenvalues and modes are given."""
    precision = (modes / (values + noise)) @ modes.T
    squares, distances = _left_out(centred, precision)
    return _Shrunk(
        precision=precision,
        squares=squares,
        share=float((values / (values + noise)).mean()),
        score=np.log(np.median(distances, axis=0) + 1e-12).mean(),
    )


def _scales(squares: np.ndarray) -> np.ndarray:
    """Return the factors that make squared distances (m, n) of points those of normal deviations, (n,).

    Of landmarks that slide along a contour, such as the ends of a jaw, most lie near and a few far: the upper decile
    says how far, the median does not. Each point's own scale is estimated together with the common one.
    """
    m = len(squares)
    by_point = np.quantile(squares, UPPER_DECILE, axis=0) / DECILE_OF_NORMAL
    decile = np.quantile(squares, UPPER_DECILE)
    common = max(squares[squares <= decile].mean() / MEAN_BELOW_DECILE, decile / DECILE_OF_NORMAL)
    return (m + POOLED) / np.maximum(m * by_point + POOLED * common, 1e-3)


def _left_out(centred: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared Mahalanobis distances and distances (m, n) of points to predictions without their own shape."""
    m = len(centred)
    weighted = centred @ precision
    share = m / (m - 1) ** 2
    leverage = np.einsum("ij,ij->i", weighted, centred)[:, None]
    weighted = weighted.reshape(m, -1, 2)
    moves = np.einsum("kab,ikb->ika", np.linalg.inv(_blocks(precision)), weighted)
    squares = np.einsum("ika,ika->ik", moves, weighted)
    # Without the shape itself, by the formula of Sherman and Morrison.
    left = np.maximum(1 - share * leverage, LEAST_LEFT)
    growth = left + share * squares
    return squares / left / growth, np.linalg.norm(moves, axis=2) / growth


def _blocks(precision: np.ndarray) -> np.ndarray:
    """Blocks (n, 2, 2) of each point in a matrix (2 n, 2 n)."""
    n = len(precision) // 2
    every = np.arange(n)
    return precision.reshape(n, 2, n, 2)[every, :, every]


def _outliers(normal: _Normal, i: int, deviation: np.ndarray, limit: float, least: np.ndarray) -> Outliers:
    """Leave out points of shape ``i``, with a deviation (n, 2) from the mean, until it is ordinary.

    Points are unusual if their test statistic is above ``limit`` and their distance from the prediction above
    ``least`` (n,). At most about half of the points are left out.
    """
    n = len(deviation)
    most = max((n - 2) // 2, 1)
    centre, whole = normal.without(i)
    away = (deviation.ravel() - centre).reshape(-1, 2)
    precision = whole  # of the points that are not left out; 0 for the others
    left_out: list[int] = []
    instead: tuple[int, ...] = ()
    while True:
        weighted = (precision @ away.ravel()).reshape(n, 2)
        blocks = _blocks(precision).copy()
        blocks[left_out] = np.eye(2)
        weighted[left_out] = 0.0
        moves = np.linalg.solve(blocks, weighted[..., None])[..., 0]
        squares = (moves * weighted).sum(axis=1) * normal.scales
        unusual = np.where(np.linalg.norm(moves, axis=1) > least, squares, 0.0)
        worst = int(unusual.argmax())
        if unusual[worst] <= limit or len(left_out) >= most:
            break
        if not left_out:
            instead = tuple(np.flatnonzero(unusual > unusual[worst] - ALIKE).tolist())
        left_out.append(worst)
        columns = precision[:, 2 * worst : 2 * worst + 2]
        precision = precision - columns @ np.linalg.solve(blocks[worst], columns.T)
    if left_out:  # predict them together from all others
        at = np.add.outer(2 * np.array(left_out), [0, 1]).ravel()
        right = (whole @ away.ravel())[at]
        moves[left_out] = np.linalg.solve(whole[np.ix_(at, at)], right).reshape(-1, 2)
    others = tuple(point for point in instead if point not in left_out) if len(left_out) == 1 else ()
    return Outliers(tuple(left_out), others, deviation - moves)
