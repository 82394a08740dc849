"""Learn to place landmarks by regression, from the images of a model (:mod:`liaam.model.regressor`)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.fitting.methods import DEFAULT_METHOD
from liaam.model import AAM
from liaam.model.point_map import LEAST_NOISE, SHRINK, PointErrors
from liaam.model.regressor import (
    N_FEATURES,
    SIZE,
    LandmarkRegressor,
    OrientationHistograms,
    RegressionStep,
    combined,
    frame_covariance,
    gain_of,
)
from liaam.model.shape import ShapeModel, align, corners_of, diagonal_of, in_box, rotation
from liaam.photometry.encoding import as_colour
from liaam.training.entries import Entry
from liaam.training.reliability import LeftOutFits
from liaam.workers import in_threads

# Distances of the histograms around a landmark in each step, pixels of SIZE: from the surroundings of a start that is
# off to the detail at a landmark. A fifth step changes no error.
SPACINGS = (12.0, 8.0, 5.0, 3.0)
# Starts of an image: half are the mean shape in a box that is off, half the mean shape moved, turned and scaled.
STARTS = 10
MOST_SAMPLES = 1000  # Largest number of starts of all images, of which each takes N_FEATURES numbers a landmark
MOST_IMAGES = 100  # Largest number of images to learn from: each takes two megabytes
LEAST_OBJECTS = 4  # Least number of objects to learn from, also of refiners: errors are those of left-out ones
ENOUGH = 15  # Number of fits to left-out images that fail if one in six does
CLEARLY = 0.85  # Ratio of mean errors below which fits are clearly nearer
# Standard deviations of starts: of the position as a fraction of the diagonal, of the logarithm of the size, and of the
# rotation in degrees. Those of searches of objects that vary are larger, and those of boxes smaller.
SHIFT = 0.06
SCALE = 0.15
TURN = 10.0
# Ridge on the weights of the features, as a fraction of the mean squared length of an image's features
RIDGE = 0.3
# Mean distance of the landmarks of a left-out image, as a fraction of the diagonal, beyond which it counts as lost, and
# its errors do not count among those of the regressor: fits do not start from there.
LOST = 0.06
MOST_ROWS = 24  # Largest number of directions of the errors that are kept apart


@dataclass(frozen=True, eq=False)
class RegressorData:
    """What regressors of a model, and of the model without some images, are learnt from.

    Attributes
    ----------
    images : (k,) int
        The training images that are used, by index.
    views : Views
        These images.
    groups : list of arrays of int
        Training images that are left out together to measure errors, by index.
    """

    images: np.ndarray
    views: "Views"
    groups: Sequence[np.ndarray]

    @classmethod
    def of(
        cls, entries: Sequence[Entry], shapes: np.ndarray, model: AAM, groups: Sequence[np.ndarray]
    ) -> "RegressorData":
        """Read the images of a model whose landmarks are all known, at even distances if there are many.

        ``shapes`` (m, n, 2) are the landmarks of all images.
        """
        complete = np.array([i for i, entry in enumerate(entries) if entry.known is None], int)
        count = min(len(complete), MOST_IMAGES)
        images = complete[np.linspace(0, max(len(complete) - 1, 0), count).astype(int)]
        mean = model.shape_model.mean * (SIZE / model.diagonal)

        def histograms_of(i: int) -> OrientationHistograms:
            image = as_colour(entries[i].read_image(), entries[i].name)
            return OrientationHistograms(image, model.response, shapes[i], align(mean, shapes[i]))

        histograms = in_threads(histograms_of, images.tolist())
        return cls(images, Views(histograms, shapes[images]), groups)

    def learn(self, shapes: ShapeModel, without: np.ndarray | None = None) -> LandmarkRegressor | None:
        """Learn a regressor, also ``without`` some training images; None if too few are left."""
        left_out = np.zeros(0, int) if without is None else without
        used = np.flatnonzero(~np.isin(self.images, left_out))
        groups = [np.flatnonzero(np.isin(self.images[used], group)) for group in self.groups]
        groups = [group for group in groups if len(group)]
        if len(groups) < LEAST_OBJECTS:
            return None
        return learn_regressor(self.views.of(used), shapes, groups)


@dataclass(frozen=True, eq=False)
class Regression:
    """Whether a model needs a regressor, and what it is learnt from.

    Attributes
    ----------
    data : callable
        Reads the images and returns the RegressorData.
    n_objects : int
        Number of objects in the training images.
    forced : bool
        Whether the model gets a regressor in any case.
    """

    data: Callable[[], RegressorData]
    n_objects: int
    forced: bool = False

    def is_needed(self, fits: Mapping[str, LeftOutFits]) -> bool:
        """Return whether a fit to a left-out image from near the object is not right, or too few were tried to say."""
        method = fits.get(DEFAULT_METHOD)
        if method is None or self.n_objects <= LEAST_OBJECTS:  # of which one is left out
            return False
        return self.forced or method.n_near_right < method.n_near or method.n_near < ENOUGH

    def helps(self, fits: Mapping[str, LeftOutFits], regressed: Mapping[str, LeftOutFits]) -> bool:
        """Return whether more fits from near the object are right with a regressor, or as many clearly nearer."""
        before = fits[DEFAULT_METHOD]
        after = regressed[DEFAULT_METHOD]
        if self.forced or after.n_near_right != before.n_near_right:
            return self.forced or after.n_near_right > before.n_near_right
        return after.near_error < CLEARLY * before.near_error


@dataclass(frozen=True, eq=False)
class Views:
    """Images as the regressor sees them, and their true shapes (m, n, 2)."""

    histograms: Sequence[OrientationHistograms]
    shapes: np.ndarray

    def of(self, images: np.ndarray) -> "Views":
        """Return some of the images."""
        return Views([self.histograms[i] for i in images.tolist()], self.shapes[images])


def learn_regressor(views: Views, shapes: ShapeModel, groups: Sequence[np.ndarray]) -> LandmarkRegressor:
    """Learn a regressor from images.

    Parameters
    ----------
    views : Views
    shapes : ShapeModel
        The shapes of the model.
    groups : sequence of arrays of int
        Images by index that are left out together to measure errors, such as those of one object.
    """
    mean = shapes.mean * (SIZE / shapes.diagonal)
    n_starts = int(np.clip(MOST_SAMPLES // len(views.shapes), 2, STARTS))
    samples = _samples(views, mean, n_starts, groups)
    return learn_steps(samples, shapes, SPACINGS, RIDGE * n_starts)


def learn_steps(samples: "Samples", shapes: ShapeModel, spacings: Sequence[float], ridge: float) -> LandmarkRegressor:
    """Learn steps with histograms at some distances from samples, whose landmarks are combined under some shapes."""
    mean = shapes.mean * (SIZE / shapes.diagonal)
    covariance = frame_covariance(shapes)
    steps = []
    for spacing in spacings:
        step, samples = _learn_step(samples, mean, covariance, spacing, ridge)
        steps.append(step)
    return LandmarkRegressor(shape_model=shapes, steps=tuple(steps), left_out=_left_out_errors(samples, shapes))


@dataclass(frozen=True, eq=False)
class Samples:
    """Shapes on their way from a start to the true landmarks.

    Attributes
    ----------
    histograms : list of OrientationHistograms
        By sample, like the other fields.
    truths, shapes : (N, n, 2) float64
        True and present landmarks.
    blocks : list of arrays of int
        Samples that are left out together.
    known : (N, n) bool
        Which of the true landmarks are known; the others are estimates, which nothing is learnt from.
    """

    histograms: list[OrientationHistograms]
    truths: np.ndarray
    shapes: np.ndarray
    blocks: list[np.ndarray]
    known: np.ndarray


def _samples(views: Views, mean: np.ndarray, n_starts: int, groups: Sequence[np.ndarray]) -> Samples:
    """Return the starts of all images."""
    shapes = []
    for i, truth in enumerate(views.shapes):
        rng = np.random.default_rng([11, i])
        for k in range(n_starts):
            shapes.append(_in_box(mean, truth, rng) if k % 2 else _moved(mean, truth, rng))
    owners = np.repeat(np.arange(len(views.shapes)), n_starts)
    return Samples(
        histograms=[views.histograms[i] for i in owners.tolist()],
        truths=views.shapes[owners],
        shapes=np.array(shapes),
        blocks=[np.flatnonzero(np.isin(owners, group)) for group in groups],
        known=np.ones((len(owners), len(mean)), bool),
    )


def _in_box(mean: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the mean shape in the box of the true one, which is off."""
    diagonal = diagonal_of(truth)
    low, high = corners_of(truth)
    shift = rng.normal(0.0, 0.5 * SHIFT, 2)
    low = low + diagonal * (shift + rng.normal(0.0, 0.25 * SHIFT, 2))
    high = high + diagonal * (shift + rng.normal(0.0, 0.25 * SHIFT, 2))
    return in_box(mean, 0.5 * (low + high), float(np.hypot(*(high - low))))


def _moved(mean: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the mean shape on the true one, moved, turned and scaled."""
    shape = align(mean, truth)(mean)
    centre = shape.mean(axis=0)
    turn = rotation(np.deg2rad(rng.normal(0.0, TURN)))
    scale = np.exp(rng.normal(0.0, SCALE))
    return centre + scale * (shape - centre) @ turn.T + diagonal_of(truth) * rng.normal(0.0, SHIFT, 2)


def _learn_step(
    samples: Samples, mean: np.ndarray, covariance: np.ndarray, spacing: float, ridge: float
) -> tuple[RegressionStep, Samples]:
    """Learn a step, and take it with each sample as a left-out one; return the step and the samples after it."""
    poses = [align(mean, shape) for shape in samples.shapes]
    features = np.array(
        [
            histograms.features(shape, pose, spacing)
            for histograms, shape, pose in zip(samples.histograms, samples.shapes, poses, strict=True)
        ]
    )
    wanted = np.array(
        [
            (truth - shape) @ pose.inverse().matrix.T
            for truth, shape, pose in zip(samples.truths, samples.shapes, poses, strict=True)
        ]
    )
    n = len(mean)
    weights = np.zeros((n, N_FEATURES, 2), np.float32)
    offsets = np.zeros((n, 2))
    predicted = np.zeros_like(wanted)
    errors = np.zeros((n, 2, 2))
    for j in range(n):
        known = samples.known[:, j]
        fitted = _ridge_regression(features[:, j], wanted[:, j], ridge, samples.blocks, known)
        weights[j] = fitted.weights
        offsets[j] = fitted.offset
        predicted[:, j] = fitted.left_out
        away = (wanted[:, j] - fitted.left_out)[known]
        errors[j] = away.T @ away / len(away)
    step = RegressionStep(spacing, weights, offsets, errors)
    gain = gain_of(covariance, errors)
    shapes = [
        combined(shape, displacements, mean, gain)
        for shape, displacements in zip(samples.shapes, predicted, strict=True)
    ]
    return step, replace(samples, shapes=np.array(shapes))


@dataclass(frozen=True, eq=False)
class _LinearFit:
    """A linear function of features, and what those that are learnt without a sample predict for it."""

    weights: np.ndarray  # (f, 2) float32
    offset: np.ndarray  # (2,)
    left_out: np.ndarray  # (N, 2)


def _ridge_regression(
    features: np.ndarray, wanted: np.ndarray, ridge: float, blocks: Sequence[np.ndarray], known: np.ndarray
) -> _LinearFit:
    """Regress (N, 2) numbers on features (N, f), and predict each block of samples from the others.

    Without the samples of block b, residuals r become (I - H_bb)^-1 r_b, with H = X (X'X + ridge I)^-1 X'. Of samples
    whose numbers are not ``known`` (N,) nothing is learnt, so that they are predicted as they are.
    """
    middle = features[known].mean(axis=0, dtype=np.float64)
    x = features - middle
    mean_wanted = wanted[known].mean(axis=0)
    y = wanted - mean_wanted
    learnt = x[known]
    normal = learnt.T @ learnt
    normal[np.diag_indices_from(normal)] += ridge * np.square(learnt).sum() / len(learnt) + 1e-12
    inverse = np.linalg.inv(normal)
    # Rounded to half precision, as a file holds them
    weights = (inverse @ (learnt.T @ y[known])).astype(np.float16).astype(np.float32)
    left_out = (x @ weights).astype(y.dtype)
    for all_of_block in blocks:
        block = all_of_block[known[all_of_block]]
        of_block = x[block]
        leverage = of_block @ inverse @ of_block.T
        residual = np.linalg.solve(np.eye(len(block)) - leverage, y[block] - left_out[block])
        left_out[block] = y[block] - residual
    return _LinearFit(weights, mean_wanted - middle @ weights, mean_wanted + left_out)


def _left_out_errors(samples: Samples, shapes: ShapeModel) -> PointErrors:
    """Return the errors of left-out images after the last step, pixels of the reference frame."""
    away = []
    lost = []
    for truth, shape in zip(samples.truths, samples.shapes, strict=True):
        error = (truth - shape) @ align(shape, shapes.mean).matrix.T
        away.append(error.ravel())
        lost.append(np.linalg.norm(error, axis=1).mean() > LOST * shapes.diagonal)
    errors = np.array(away)
    kept = ~np.array(lost)
    if kept.any():
        errors = errors[kept]
    share = len(samples.blocks) / (len(samples.blocks) + SHRINK)
    values, vectors = np.linalg.eigh(share * errors.T @ errors / len(errors))
    values = np.maximum(values, 0.0)
    strongest = slice(max(0, len(values) - MOST_ROWS), None)
    rest = values[: strongest.start].sum() / len(values)
    noise = max((1.0 - share) * float(np.square(errors).mean()) + rest, LEAST_NOISE)
    return PointErrors((np.sqrt(values) * vectors).T[strongest], noise)
