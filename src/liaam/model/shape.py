"""Statistical shape models: Procrustes alignment, PCA, and the four similarity vectors (paper eq 2)."""

from cmath import isfinite
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, nan

import numpy as np

from liaam.errors import TrainingError
from liaam.model import pca
from liaam.model.missing import Missing
from liaam.model.shape_prior import Deviations, SmoothPrior, Spread, covariance, fit_freedom, fit_prior, modes_of


def corners_of(shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (x, y) of a shape's bounding box; NaN if a point is."""
    across = np.ascontiguousarray(shape.T)  # long rows: twice as fast
    return np.minimum.reduce(across, axis=1), np.maximum.reduce(across, axis=1)


def expanded_about(mean: np.ndarray, shape: np.ndarray, factor: float) -> np.ndarray:
    """Return a shape (n, 2) at a multiple of its distance from a mean shape (n, 2), in the same pose."""
    return shape + (factor - 1.0) * (shape - align(mean, shape)(mean))


def diagonal_of(shape: np.ndarray) -> float:
    """Length of the diagonal of a shape's bounding box."""
    low, high = corners_of(shape)
    return hypot(*(high - low).tolist())


def rotation(angle: float) -> np.ndarray:
    """Matrix that rotates (x, y) by an angle in radians, from x towards y, (2, 2) float64."""
    c = np.cos(angle)
    s = np.sin(angle)
    return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, eq=False)
class Similarity:
    """Similarity x -> matrix @ x + offset of the plane (rotation, one scale, translation)."""

    matrix: np.ndarray
    offset: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Apply to (..., 2) points."""
        return points @ self.matrix.T + self.offset

    @property
    def scale(self) -> float:
        """Ratio of lengths after and before."""
        (a, b), (c, d) = self.matrix.tolist()
        return abs(a * d - b * c) ** 0.5

    @property
    def angle(self) -> float:
        """Angle of the rotation, radians: clockwise as seen in an image."""
        return float(np.arctan2(self.matrix[1, 0], self.matrix[0, 0]))

    def inverse(self) -> "Similarity":
        """Return the inverse similarity."""
        (a, b), (c, d) = self.matrix.tolist()
        matrix = np.array([[d, -b], [-c, a]]) / np.float64(a * d - b * c)  # a quarter of the time of np.linalg.inv
        return Similarity(matrix, -matrix @ self.offset)


def align(shape: np.ndarray, target: np.ndarray) -> Similarity:
    """Least-squares similarity, without reflection, that maps a shape (n, 2) to a target.

    Points that are NaN in either are ignored.
    """
    # A similarity without reflection is a complex factor: z_b = factor * z_a.
    za = _as_complex(shape)
    zb = _as_complex(target)
    a_mean = _mean(za)
    b_mean = _mean(zb)
    if not isfinite(a_mean + b_mean):
        finite = np.isfinite(za) & np.isfinite(zb)
        za = za[finite]
        zb = zb[finite]
        a_mean = _mean(za)
        b_mean = _mean(zb)
    za = za - a_mean
    power = float(np.vdot(za, za).real)
    factor = complex(np.vdot(za, zb - b_mean)) / power if power > 0 else 1.0 + 0j
    offset = b_mean - factor * a_mean
    matrix = np.array([[factor.real, -factor.imag], [factor.imag, factor.real]])
    return Similarity(matrix, np.array([offset.real, offset.imag]))


def _mean(points: np.ndarray) -> complex:
    """Mean of complex numbers; NaN without any."""
    return complex(np.add.reduce(points)) / (len(points) or nan)


def aligned_to(target: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Return each of some shapes (m, n, 2), aligned to a target (n, 2) by :func:`align`."""
    return np.array([align(shape, target)(shape) for shape in shapes])


def _as_complex(shape: np.ndarray) -> np.ndarray:
    """Points (n, 2) as x + i y, (n,) complex128."""
    return np.ascontiguousarray(shape, dtype=np.float64).reshape(-1).view(np.complex128)


def in_box(shape: np.ndarray, centre: np.ndarray, diagonal: float) -> np.ndarray:
    """Return a shape (n, 2) with its bounding box at a centre (x, y), and of a diagonal."""
    low, high = corners_of(shape)
    return (shape - 0.5 * (low + high)) * (diagonal / diagonal_of(shape)) + centre


def mean_in_box(shapes: np.ndarray) -> np.ndarray:
    """Return the mean position of each landmark in the bounding box of its shape (m, n, 2), (n, 2), from -0.5 to 0.5.

    They are relative to the centre of the box, in units of its width and height.
    """
    low = shapes.min(axis=1, keepdims=True)
    size = np.ptp(shapes, axis=1, keepdims=True)
    return np.clip(((shapes - low) / np.maximum(size, 1e-9)).mean(axis=0) - 0.5, -0.5, 0.5)


def shifted_into(shape: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Shift a shape (n, 2) into an image of size (width, height), if it fits."""
    return shape - np.minimum(shape.min(axis=0), 0.0) - np.maximum(shape.max(axis=0) - (np.array(size) - 1.0), 0.0)


def procrustes_mean(shapes: np.ndarray) -> np.ndarray:
    """Generalised Procrustes mean (n, 2) of shapes (n_shapes, n, 2): centred, unit norm, in their mean orientation.

    Some shapes may lack points (NaN).
    """
    mean = _normalised(shapes[np.isfinite(shapes).sum(axis=(1, 2)).argmax()])
    for _ in range(100):
        new = _normalised(np.nanmean(aligned_to(mean, shapes), axis=0))
        # Fix the gauge: the mean must not rotate between iterations.
        new = _normalised(align(new, mean)(new))
        moved = float(np.abs(new - mean).max())
        mean = new
        if moved < 1e-10:
            break
    # Rotate the mean to the average orientation of the shapes.
    turns = [align(mean, shape).matrix for shape in shapes]
    total = np.sum([turn / np.sqrt(abs(np.linalg.det(turn))) for turn in turns], axis=0)
    return mean @ rotation(np.arctan2(total[1, 0], total[0, 0])).T


def _normalised(shape: np.ndarray) -> np.ndarray:
    centred = shape - np.nanmean(shape, axis=0)
    return centred / np.linalg.norm(centred[np.isfinite(centred)])


def similarity_modes(mean: np.ndarray) -> np.ndarray:
    """Orthonormal similarity vectors s0, (-v, u), (1, 0, ...), (0, 1, ...) of a centred mean shape, (4, 2 n)."""
    turned = mean[:, ::-1] * [-1.0, 1.0]
    rows = [mean, turned, np.tile([1.0, 0.0], (len(mean), 1)), np.tile([0.0, 1.0], (len(mean), 1))]
    return np.array([row.ravel() / np.linalg.norm(row) for row in rows])


LEAST_NOISE = 0.01  # Least variance of a coordinate in the likelihood of shapes, square pixels of the reference frame


# Root mean square movement of the landmarks by one standard deviation of a mode, as a fraction of a level's blur, below
# which the mode is left out there. Of a model of 152 faces, 23 of 64 modes are left at a blur of 4 pixels, and 47 at 2.
# Doubtful fits take a quarter less time, and right fits end where they did.
UNSEEN = 0.05


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Shapes s(p) = s0 + sum_i p_i s_i (paper eq 2).

    Attributes
    ----------
    mean : (n, 2) float64
        s0, centred, in pixels of the reference frame.
    modes : (m, 2 n) float64
        Orthonormal PCA modes, orthogonal to the similarity vectors.
    eigenvalues : (m,) float64
        Variance along each mode, square pixels of the reference frame.
    unexplained : (n, 2, 2) float64, optional
        Second moments of the leave-out residuals of each landmark, square pixels of the reference frame: the error of
        a perfect fit to an unseen shape.
    freedom : float
        Degrees of freedom of the shapes' Student distribution
        (:func:`liaam.fitting.reference.loop.next_prior_scale`); infinite for a normal distribution.
    """

    mean: np.ndarray
    modes: np.ndarray
    eigenvalues: np.ndarray
    unexplained: np.ndarray | None = None
    freedom: float = np.inf

    @cached_property
    def basis(self) -> np.ndarray:
        """All shape vectors, PCA modes first and the four similarity vectors last, (m + 4, 2 n)."""
        return np.concatenate([self.modes, similarity_modes(self.mean)])

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the mean shape's bounding box, pixels of the reference frame."""
        return diagonal_of(self.mean)

    @property
    def n_points(self) -> int:
        """Number of landmarks."""
        return len(self.mean)

    @property
    def left_out_bound(self) -> float:
        """Root mean square error of perfect fits to left-out shapes, over landmarks and shapes (pixels)."""
        return np.nan if self.unexplained is None else float(np.sqrt(np.trace(self.unexplained, 0, 1, 2).mean()))

    def shape(self, p: np.ndarray) -> np.ndarray:
        """Return the shapes s(p), (..., n, 2) float64, for p (..., m + 4)."""
        moved = np.asarray(p) @ self.basis
        return self.mean + moved.reshape(*moved.shape[:-1], -1, 2)

    def expanded(self, p: np.ndarray, factor: float) -> np.ndarray:
        """Return the parameters (m + 4,) of a shape at a multiple of its distance from the mean, in the same pose."""
        return np.concatenate([factor * p[:-4], p[-4:]])

    def parameters(self, shape: np.ndarray) -> np.ndarray:
        """Return the coordinates p of a shape's orthogonal projection on the model, (m + 4,) float64."""
        return self.basis @ (np.asarray(shape) - self.mean).ravel()

    def seen_at(self, blur: float) -> "ShapeModel":
        """Return the model of the modes that move the landmarks enough to be seen under a blur, pixels."""
        moved = np.sqrt(self.eigenvalues / self.n_points)
        n_seen = max(1, int((moved >= UNSEEN * blur).sum()))
        return replace(self, modes=self.modes[:n_seen], eigenvalues=self.eigenvalues[:n_seen])

    def project(self, shape: np.ndarray) -> np.ndarray:
        """Find the nearest shape of the model under any similarity: the result of a perfect fit, (n, 2) float64."""
        pose = align(self.mean, shape)
        local = self.mean
        moved = np.inf
        for _ in range(21):  # alternate pose and modes: the modes move with the pose
            p = self.parameters(pose.inverse()(shape))
            p[-4:] = 0.0
            local = self.shape(p)
            if moved < 1e-9 * diagonal_of(shape):
                break
            new = align(local, shape)
            pose, moved = new, float(np.abs(new(local) - pose(local)).max())
        return pose(local)

    def log_density(self, shape: np.ndarray) -> float:
        """Log-likelihood of a shape (n, 2), whatever its position, size and rotation, up to a constant."""
        upright = align(shape, self.mean)(shape)
        p = self.parameters(upright)[:-4]
        noise = max(0.5 * np.nan_to_num(self.left_out_bound) ** 2, LEAST_NOISE)  # variance of a coordinate
        variances = self.eigenvalues + noise
        n_beyond = 2 * self.n_points - 4 - len(p)
        beyond = np.square(upright - self.mean).sum() - np.square(p).sum()
        inside = (np.square(p) / variances + np.log(variances)).sum()
        return float(-0.5 * (inside + beyond / noise + n_beyond * np.log(noise)))


def own_parameters(n: int, n_all: int) -> np.ndarray:
    """Return which of all parameters a model of fewer modes has: those of the first modes, and of the similarity."""
    return np.arange(n) + (n_all - n) * (np.arange(n) >= n - 4)


# Estimators of the shapes' covariance. sample: the sample covariance. shrunk: with the variances of left-out shapes as
# its eigenvalues. smooth: shrunk towards smooth deformations (shape_prior), and with mirrored shapes as further
# examples if they raise the likelihood of left-out shapes. wide: WIDER times the covariance of smooth, for objects that
# differ more from those of training than these do from each other.
PRIORS = ("sample", "shrunk", "smooth", "wide")
# Ratio of the variances of wide to those of smooth. The faces that come with liaam are of one studio; factors of 2 to
# 10 were tried on people of three other sets.
WIDER = 4.0


@dataclass(frozen=True, eq=False)
class Recipe:
    """Settings for the covariance of shapes: chosen on all shapes, and reused when some are left out.

    ``prior`` is one of :data:`PRIORS`. ``mirrored`` (n_points,) holds the index of each landmark's mirror image, if
    mirrored shapes are further examples.
    """

    prior: str = "sample"
    smooth: SmoothPrior | None = None
    mirrored: np.ndarray | None = None


def check_prior(prior: str) -> None:
    """Raise unless a prior exists."""
    if prior not in PRIORS:
        raise TrainingError(f"unknown prior {prior!r}; choose from {', '.join(PRIORS)}")


def scaled_mean(shapes: np.ndarray, diagonal: float) -> np.ndarray:
    """Procrustes mean of shapes, scaled to a diagonal of its bounding box, (n_points, 2) float64."""
    mean = procrustes_mean(shapes)
    return mean * (diagonal / diagonal_of(mean))


def choose_recipe(
    mean: np.ndarray,
    shapes: np.ndarray,
    prior: str,
    folds: Sequence[np.ndarray],
    missing: Missing | None = None,
) -> Recipe:
    """Choose the settings under which left-out shapes are most likely. The shapes of a fold are left out together."""
    if prior not in ("smooth", "wide"):
        return Recipe(prior)
    plain = fit_prior(deviations_from(mean, shapes, missing=missing), folds)
    # The mean may be asymmetric, such as of turned heads; a single shape may still be symmetric.
    tries = min(MIRRORED_TRIES, MIRRORED_POINTS // len(mean))
    orders = (mirror_order(shape) for shape in (mean, *shapes[:tries]))
    order = next((order for order in orders if order is not None), None)
    if order is None:
        return Recipe(prior, plain)
    mirrored = fit_prior(deviations_from(mean, shapes, order, missing), folds)
    return Recipe(prior, mirrored, order) if mirrored.evidence > plain.evidence else Recipe(prior, plain)


def shape_model_on(
    mean: np.ndarray,
    shapes: np.ndarray,
    variance: pca.Variance,
    recipe: Recipe,
    folds: Sequence[np.ndarray] | None = None,
    missing: Missing | None = None,
) -> ShapeModel:
    """Learn the modes of shapes (n_shapes, n_points, 2) around a given mean shape (n_points, 2).

    If ``missing`` says that landmarks are estimates, their uncertainty is part of the variance, and the error on unseen
    shapes is that of the known ones.
    """
    folds = pca.some_folds(len(shapes)) if folds is None else folds
    deviations = deviations_from(mean, shapes, recipe.mirrored, missing)
    if recipe.smooth is not None:
        model = _smooth_model(deviations, variance, recipe.smooth, folds)
        return replace(model, eigenvalues=WIDER * model.eigenvalues) if recipe.prior == "wide" else model
    vectors = deviations.own
    if variance == "auto":
        variance = pca.count_by_evidence(vectors, folds, deviations.dimension)
    components = _components(deviations, variance)
    modes = components.modes - components.modes @ deviations.rigid.T @ deviations.rigid
    eigenvalues = components.eigenvalues
    if recipe.prior == "shrunk":
        eigenvalues = pca.left_out_variances(vectors, folds, len(modes))
    left = pca.unexplained_by_others(vectors, variance, folds).astype(np.float64)
    return ShapeModel(mean, np.ascontiguousarray(modes), eigenvalues, _moments(left, deviations.spread))


def _components(deviations: Deviations, variance: float | int) -> pca.Components:
    """Principal components of deviations, of which those of missing landmarks are expected values."""
    own = deviations.own
    if deviations.spread is None:
        return pca.principal_components(own, variance)
    mean = own.mean(axis=0)
    examples = np.concatenate([own, mean + deviations.spread.rows])
    components = pca.components_by(examples, mean, pca.gram_about(examples, mean), variance)
    # The rows of the spread are no further shapes.
    degrees_of_freedom = max(len(own) - 1, 1)
    return replace(components, eigenvalues=components.eigenvalues * (len(examples) - 1) / degrees_of_freedom)


def deviations_from(
    mean: np.ndarray, shapes: np.ndarray, order: np.ndarray | None = None, missing: Missing | None = None
) -> Deviations:
    """Deviations of shapes from a mean; also those of the mirrored shapes if an order is given.

    ``missing`` says which landmarks are estimates, and how uncertain these are; None if all are known.
    """
    rigid = similarity_modes(mean)
    n = len(shapes)
    if order is not None:
        shapes = np.concatenate([shapes, (shapes * [-1.0, 1.0])[:, order]])
    deviations = (aligned_to(mean, shapes) - mean).reshape(len(shapes), -1)
    # Modes are orthogonal to the similarities, so that p and pose do not trade off.
    deviations -= deviations @ rigid.T @ rigid
    deviations[np.abs(deviations) < 1e-9 * diagonal_of(mean)] = 0.0  # rounding must not become a mode
    spread = None if missing is None else _spread(mean, shapes, order, missing, rigid)
    return Deviations(mean, rigid, deviations[:n], deviations[n:], spread)


def _spread(
    mean: np.ndarray, shapes: np.ndarray, order: np.ndarray | None, missing: Missing, rigid: np.ndarray
) -> Spread:
    """Return the covariances of the deviations of shapes, of which the second half are mirrored if there is an order.

    The deviations are orthogonal to the similarities ``rigid`` (4, 2 n_points), so their covariances are too.
    """

    def aligned_rows(factors: np.ndarray, shape: np.ndarray) -> np.ndarray:
        """Return displacements of a shape as displacements of the mean."""
        rows = (factors @ align(shape, mean).matrix.T).reshape(len(factors), shape.size)
        return rows - rows @ rigid.T @ rigid

    n = len(missing.factors)
    owners = np.repeat(np.arange(n), [len(factors) for factors in missing.factors])
    rows = np.concatenate([aligned_rows(missing.factors[i], shapes[i]) for i in range(n)])
    further = rows[:0]
    if order is not None:
        mirrored = [(factors * [-1.0, 1.0])[:, order] for factors in missing.factors]
        further = np.concatenate([aligned_rows(mirrored[i], shapes[n + i]) for i in range(n)])
    return Spread(rows, owners, missing.known, further)


def _smooth_model(
    deviations: Deviations, variance: pca.Variance, prior: SmoothPrior, folds: Sequence[np.ndarray]
) -> ShapeModel:
    """Shape model from a covariance shrunk towards smooth deformations."""
    spread = covariance(deviations, prior)
    modes, values = modes_of(spread, deviations.rigid)
    folds = [fold for fold in folds if len(deviations.own) - len(fold) >= 2]
    parts = []  # deviations of each fold from the mean of the others, and the others' modes and eigenvalues
    for fold in folds:
        part = deviations.of(np.setdiff1d(np.arange(len(deviations.own)), fold))
        away = deviations.own[fold] - part.own.mean(axis=0)
        parts.append((away, *modes_of(covariance(part, prior), deviations.rigid)))
    left_out = [
        pca.LeftOutCoordinates(v + prior.noise * v.mean(), np.square(away @ part_modes.T), np.square(away).sum(axis=1))
        for away, part_modes, v in parts
    ]
    if deviations.spread is not None:
        left_out = [
            _expected(part, deviations.spread.of(fold), part_modes)
            for part, fold, (_, part_modes, _) in zip(left_out, folds, parts, strict=True)
        ]
    if variance == "auto":
        evidence = [pca.log_evidence(part, len(part.eigenvalues)) for part in left_out if part.eigenvalues[0] > 0]
        count = int(np.sum(evidence, axis=0).argmax()) if evidence else 0
    else:
        count = pca.count_modes(values, variance)
    freedom = fit_freedom(left_out, count)
    left = np.zeros_like(deviations.own)
    for fold, (away, own_modes, _) in zip(folds, parts, strict=True):
        left[fold] = away - away @ own_modes[:count].T @ own_modes[:count]
    unexplained = _moments(left, deviations.spread)
    return ShapeModel(deviations.mean, modes[:count], values[:count], unexplained, freedom)


def _expected(part: pca.LeftOutCoordinates, spread: Spread, modes: np.ndarray) -> pca.LeftOutCoordinates:
    """Add the variances of estimated landmarks to the squared coordinates of left-out shapes in modes (r, d)."""
    squares = part.squares + spread.squares_along(modes)
    # The modes span the space of the deviations.
    distances = part.distances + spread.squares_along(modes).sum(axis=1)
    return replace(part, squares=squares, distances=distances)


def _moments(left: np.ndarray, spread: Spread | None = None) -> np.ndarray:
    """Second moments (n_points, 2, 2) of residuals (n, 2 n_points) of shapes, at their known landmarks."""
    by_landmark = left.reshape(len(left), -1, 2)
    if spread is None:
        return np.einsum("ina,inb->nab", by_landmark, by_landmark) / len(left)
    by_landmark = by_landmark * spread.known[..., None]
    counts = np.maximum(spread.known.sum(axis=0), 1)
    return np.einsum("ina,inb->nab", by_landmark, by_landmark) / counts[:, None, None]


# Largest root mean square distance between a symmetric shape and its mirror image, as a fraction of its diagonal.
# Mirrored shapes are used only if they raise the likelihood of left-out shapes.
MIRRORED = 0.02
# Largest number of shapes, and of their points in total, to test for symmetry if the mean is not symmetric
MIRRORED_TRIES = 20
MIRRORED_POINTS = 2000


def mirror_order(shape: np.ndarray, limit: float = MIRRORED, tilt: float = 90.0) -> np.ndarray | None:
    """Find the order in which ``(shape * [-1, 1])[order]`` is nearly a rotation of a shape (n, 2), if there is one.

    The limit is that of :data:`MIRRORED`. The axis is tilted from the vertical by ``tilt`` degrees at most.
    """
    from scipy.optimize import linear_sum_assignment

    shape = shape - shape.mean(axis=0)
    mirrored = shape * [-1.0, 1.0]
    best = np.inf
    order = None
    limit = limit * diagonal_of(shape)
    turns = np.arange(12)
    for angle in turns[30 * np.minimum(turns, 12 - turns) <= 2 * tilt] * np.pi / 6:
        moved, matches = _closest(shape, mirrored, mirrored @ rotation(angle).T, lambda apart: apart.argmin(axis=1))
        # Cheap rejection: the distances of a one-to-one assignment are at least those of the nearest points.
        if np.sqrt(np.square(shape - moved[matches]).sum(axis=1).mean()) > limit:
            continue
        moved, matches = _closest(shape, mirrored, moved, lambda apart: linear_sum_assignment(apart)[1])
        error = float(np.square(shape - moved[matches]).sum(axis=1).mean())
        if error < best and np.array_equal(matches[matches], np.arange(len(shape))):
            best = error
            order = matches
    return order if np.sqrt(best) < limit else None


def _closest(
    shape: np.ndarray, other: np.ndarray, moved: np.ndarray, pair: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Alternate pose and correspondences from a first pose; return the moved other shape and the correspondences."""
    matches = np.empty(0, int)
    for _ in range(5):
        last = matches
        matches = pair(np.square(shape[:, None] - moved[None]).sum(axis=2))
        if np.array_equal(matches, last):
            break
        moved = align(other[matches], shape)(other)
    return moved, matches
