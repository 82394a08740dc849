"""Landmarks by regression: from the gradient orientations around each landmark to where it should be.

The objective's own minimum is not always right: of objects that vary much, the appearance model explains a wrong place
as well as the right one. A regressor learns from the same images in which direction the landmarks lie. In each of a few
steps, from coarse to fine, a linear function of the histograms of gradient orientations around a landmark predicts the
landmark's displacement (supervised descent: Xiong and De la Torre, CVPR 2013), for each landmark by itself. What the
landmarks predict is then combined under the covariance of shapes: with C that covariance, S that of the predictions'
errors on left-out images, and d the predicted deviation from the mean shape,

    d' = C (C + S)^-1 d.

The last step's errors on left-out images are the covariance with which a fit weighs the regressor's landmarks in.

A regressor that is learnt from starts as near as fits are to the landmarks refines fits: what lies between the two is
nearer than either, as they see different things. Left-out images say how far to go from the fit.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from liaam import _core
from liaam.formatting import short_repr
from liaam.model.point_map import PointErrors
from liaam.model.sampling import BrightnessPatch
from liaam.model.shape import LEAST_NOISE, ShapeModel, Similarity, align, similarity_modes
from liaam.photometry import Response
from liaam.workers import one_numpy_thread

BINS = 8  # Orientations of gradients that are counted apart
CELLS = 4  # Histograms around a landmark, in each direction
N_FEATURES = CELLS * CELLS * BINS  # Numbers that describe the surroundings of a landmark
SIZE = 120.0  # Diagonal of the mean shape at the resolution of the histograms, pixels
LEAST_CONTRAST = 0.05  # Length of the features of a landmark around which there are half as many gradients as counted
MOST_OF_A_BIN = 0.25  # Largest feature: one strong edge must not outweigh the rest (Lowe, IJCV 2004)
# Change of the scale, or of the angle in radians, of a shape since the image was encoded, after which it is encoded
# again: histograms then differ from those of training, which are encoded at the true scale and angle.
MOST_CHANGE = 0.1
# Least blur of counts of orientations, in their pixels: with less, interpolation between pixels would blur them too.
# With 2, features differ by 4 % from those at small pixels, and with 3 by 1 %.
LEAST_BLUR = 3.0
USUAL_SHARE = 0.5  # Share of a refiner unless left-out images have said another: the mean of the fit and its landmarks
# Variance of the similarity in the covariance of shapes, square pixels: position, size and rotation are free
FREE = 1e4
# Variance of the prediction of a landmark that is absent, square pixels: it must outweigh the free similarity
UNKNOWN = 1e8


class Sight(NamedTuple):
    """How much a regressor sees of an image.

    Attributes
    ----------
    margin : float
        Margin around the start that is encoded, as a fraction of its diagonal: room for a start that is off, and for
        cells.
    sharpness : float
        Standard deviation of the blur of the image before gradients are taken, pixels of :data:`SIZE`, which is also
        the size of the pixels that are encoded.
    """

    margin: float
    sharpness: float


OF_STARTS = Sight(margin=0.5, sharpness=0.6)
OF_FITS = Sight(margin=0.15, sharpness=0.5)  # with twice the blur, errors are 2 % larger, and 0.2 ms of 0.8 are saved


class OrientationHistograms:
    """Histograms of gradient orientations of an image around a shape, at the resolution of :data:`SIZE`."""

    def __init__(
        self,
        image: np.ndarray,
        response: Response,
        shape: np.ndarray,
        pose: Similarity,
        sight: Sight = OF_STARTS,
        *,
        grey: bool = False,
        keep_counts: bool = True,
    ) -> None:
        """Encode an image around a shape (n, 2); the pose is that of the mean shape with a diagonal of SIZE.

        If the image is known to be ``grey``, that takes less time. Unless counts of orientations are kept, an eighth of
        the memory suffices, and orientations are counted for each shape.
        """
        self.pose = pose
        self._patch = BrightnessPatch.around(
            image, shape, pose, response=response, blur=sight.sharpness, margin=sight.margin, grey=grey
        )
        self._kept = self._counted() if keep_counts else None

    def _counted(self) -> "_Counts":
        return _Counts(self._patch.count_orientations())

    def suits(self, pose: Similarity) -> bool:
        """Return whether scale and rotation of a pose of the mean shape are about those of the encoded image."""
        turned = abs(_between(pose.angle, self.pose.angle))
        return turned <= MOST_CHANGE and abs(np.log(pose.scale / self.pose.scale)) <= MOST_CHANGE

    def features(self, shape: np.ndarray, pose: Similarity, spacing: float) -> np.ndarray:
        """Return the normalised histograms around the landmarks of a shape (n, 2), (n, N_FEATURES) float32.

        Cells are ``spacing`` pixels of SIZE apart, along the axes of the mean shape, whose pose in the image is given.
        """
        from_image = self._patch.from_image
        to_patch = from_image.scale
        cells = _cells(spacing) @ (to_patch * pose.matrix.T)
        points = (from_image(shape)[:, None] + cells).reshape(-1, 2)
        counted = self._kept or self._counted()
        counts = counted.blurred_at(points, blur=0.5 * spacing * self.pose.scale * to_patch)
        counts = _turned(counts, _between(pose.angle, self.pose.angle)).reshape(len(shape), -1)
        length = np.sqrt(np.einsum("nf,nf->n", counts, counts))
        return np.minimum(counts / (length[:, None] + np.float32(LEAST_CONTRAST)), np.float32(MOST_OF_A_BIN))


def _between(angle: float, other: float) -> float:
    """Return the difference of two angles, from -pi to pi."""
    return float((angle - other + np.pi) % (2.0 * np.pi) - np.pi)


@dataclass(frozen=True, eq=False)
class _Counts:
    """Counts of each orientation at pixels of a patch, or at larger ones.

    Attributes
    ----------
    values : (h, w, BINS) float32
    reduction : int
        Size of the pixels, pixels of the patch.
    """

    values: np.ndarray
    reduction: int = 1

    def reduced_for(self, blur: float) -> "_Counts":
        """Return the counts in the largest pixels that still show a blur well, pixels of the patch."""
        enough_pixels = min(self.values.shape[:2]) >= 4  # so that there is something left to interpolate between
        if enough_pixels and LEAST_BLUR * 2 * self.reduction <= blur:
            return self.halved.reduced_for(blur)
        return self

    @cached_property
    def halved(self) -> "_Counts":
        """The means of two by two pixels; a last row or column that has no other is left out."""
        height = self.values.shape[0] // 2
        width = self.values.shape[1] // 2
        even = self.values[: 2 * height, : 2 * width]
        return _Counts(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), 2 * self.reduction)

    def blurred_at(self, points: np.ndarray, blur: float) -> np.ndarray:
        """Return the counts (m, BINS) after a Gaussian blur at points (m, 2), pixels of the patch."""
        counts = self.reduced_for(blur)
        if counts is not self:
            points = (points + 0.5) / counts.reduction - 0.5
            blur /= counts.reduction
        return _core.blurred_at(counts.values, points, blur)


@lru_cache(maxsize=16)
def _cells(spacing: float) -> np.ndarray:
    """Return the centres of the cells around a landmark, (CELLS^2, 2)."""
    steps = spacing * (np.arange(CELLS) - 0.5 * (CELLS - 1))
    across, down = np.meshgrid(steps, steps)
    return np.stack([across.ravel(), down.ravel()], axis=1)


def _turned(counts: np.ndarray, angle: float) -> np.ndarray:
    """Return counts of orientations (m, BINS) relative to axes that are turned by an angle, radians."""
    if angle == 0.0:  # as in the first step
        return counts
    shift = angle * (BINS / (2.0 * np.pi))
    whole = int(np.floor(shift))
    share = np.float32(shift - whole)
    twice = np.concatenate([counts, counts], axis=1)
    lower = whole % BINS
    upper = (whole + 1) % BINS
    return twice[:, lower : lower + BINS] * (1.0 - share) + twice[:, upper : upper + BINS] * share


def _mirrored_features() -> np.ndarray:
    """Return the index of each feature's mirror image, (N_FEATURES,)."""
    number = np.arange(N_FEATURES).reshape(CELLS, CELLS, BINS)
    orientations = (BINS // 2 - np.arange(BINS)) % BINS
    return number[:, ::-1][..., orientations].ravel()


@dataclass(frozen=True, eq=False)
class RegressionStep:
    """One step of a regressor.

    Attributes
    ----------
    spacing : float
        Distance of the histograms around a landmark, pixels of :data:`SIZE`.
    weights : (n, N_FEATURES, 2) float32
        Displacement of each landmark by a feature, pixels of SIZE.
    offsets : (n, 2) float64
        Displacement without features.
    errors : (n, 2, 2) float64
        Covariance of the errors of each landmark's displacement on left-out images.
    """

    spacing: float
    weights: np.ndarray
    offsets: np.ndarray
    errors: np.ndarray

    __repr__ = short_repr

    def displacements(self, features: np.ndarray) -> np.ndarray:
        """Return the displacements (..., n, 2) that features (..., n, N_FEATURES) predict."""
        return (features[..., None, :] @ self.weights)[..., 0, :] + self.offsets


@dataclass(frozen=True, eq=False)
class LandmarkRegressor:
    """Steps of regression from a start to the landmarks.

    Attributes
    ----------
    shape_model : ShapeModel
        The shapes that the landmarks' predictions are combined under, pixels of the reference frame.
    steps : tuple of RegressionStep
        From coarse to fine.
    left_out : PointErrors
        Errors of the landmarks on left-out images, pixels of the reference frame.
    share : float
        Of a regressor that refines fits, how far refined landmarks are from the fit, as a fraction of the way to where
        the regressor leads.
    sharpness : float
        Of a regressor that refines fits, the sharpness of its :class:`Sight`.
    """

    shape_model: ShapeModel
    steps: tuple[RegressionStep, ...]
    left_out: PointErrors
    share: float = USUAL_SHARE
    sharpness: float = OF_FITS.sharpness

    __repr__ = short_repr

    @cached_property
    def frame_mean(self) -> np.ndarray:
        """The mean shape with a diagonal of :data:`liaam.model.regressor.SIZE`, (n, 2)."""
        return self.shape_model.mean * (SIZE / self.shape_model.diagonal)

    def __call__(
        self,
        image: np.ndarray,
        response: Response,
        start: np.ndarray,
        sight: Sight = OF_STARTS,
        *,
        absent: np.ndarray | None = None,
        grey: bool = False,
    ) -> np.ndarray:
        """Return the landmarks (n, 2) of the object in an image near a start (n, 2), image pixels.

        Landmarks that are ``absent`` (n,) follow from the others. If the image is known to be ``grey``, that takes less
        time.
        """
        shape = start
        histograms = None
        gains = self._gains if absent is None or not absent.any() else self._gains_without(absent)
        for step, gain in zip(self.steps, gains, strict=True):
            pose = align(self.frame_mean, shape)
            if histograms is None or not histograms.suits(pose):
                histograms = OrientationHistograms(image, response, shape, pose, sight, grey=grey)
            predicted = step.displacements(histograms.features(shape, pose, step.spacing))
            shape = combined(shape, predicted, self.frame_mean, gain)
        return shape

    def refined(
        self,
        image: np.ndarray,
        response: Response,
        shape: np.ndarray,
        *,
        absent: np.ndarray | None = None,
        grey: bool = False,
    ) -> np.ndarray:
        """Return landmarks (n, 2) between those of a fit (n, 2) and where the regressor leads from there, image pixels.

        ``absent`` and ``grey`` are as of a call.
        """
        sight = OF_FITS._replace(sharpness=self.sharpness)
        led_to = self(image, response, shape, sight, absent=absent, grey=grey)
        return shape + self.share * (led_to - shape)

    def mirrored(self, shapes: ShapeModel, order: np.ndarray) -> "LandmarkRegressor":
        """Return the regressor of the mirror images of objects, with their shapes.

        ``order`` (n,) is the index of each landmark's mirror image.
        """
        features = _mirrored_features()
        across = np.array([-1.0, 1.0])
        steps = [
            RegressionStep(
                spacing=step.spacing,
                weights=np.ascontiguousarray((step.weights[:, features] * across.astype(np.float32))[order]),
                offsets=(step.offsets * across)[order],
                errors=(step.errors * np.outer(across, across))[order],
            )
            for step in self.steps
        ]
        errors = self.left_out.errors
        rows = (errors.reshape(len(errors), -1, 2) * across)[:, order].reshape(errors.shape)
        left_out = PointErrors(rows, self.left_out.noise)
        return replace(self, shape_model=shapes, steps=tuple(steps), left_out=left_out)

    @cached_property
    def _gains(self) -> list[np.ndarray]:
        """C (C + S)^-1 of each step, (2 n, 2 n)."""
        return self._gains_without(np.zeros(self.shape_model.n_points, bool))

    def _gains_without(self, absent: np.ndarray) -> list[np.ndarray]:
        """C (C + S)^-1 of each step, (2 n, 2 n), where nothing is known of landmarks that are ``absent`` (n,)."""
        of_nothing = absent[:, None, None] * (UNKNOWN * np.eye(2))
        with one_numpy_thread():  # so that the bits are the same with any number of threads
            covariance = frame_covariance(self.shape_model)
            return [gain_of(covariance, step.errors + of_nothing) for step in self.steps]


def frame_covariance(shapes: ShapeModel) -> np.ndarray:
    """Return the covariance C (2 n, 2 n) of shapes whose mean has a diagonal of :data:`SIZE`, with a free similarity.

    Beyond the modes, coordinates vary as they do in left-out shapes.
    """
    noise = max(0.5 * np.nan_to_num(shapes.left_out_bound) ** 2, LEAST_NOISE)
    within = (shapes.modes.T * shapes.eigenvalues) @ shapes.modes + noise * np.eye(shapes.modes.shape[1])
    rigid = similarity_modes(shapes.mean)
    return (SIZE / shapes.diagonal) ** 2 * within + FREE * rigid.T @ rigid


def gain_of(covariance: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return C (C + S)^-1 for a covariance of shapes C (2 n, 2 n) and errors (n, 2, 2), the blocks of S."""
    n = len(errors)
    total = covariance.copy()
    at = np.arange(n)
    total.reshape(n, 2, n, 2)[at, :, at, :] += errors
    return np.linalg.solve(total, covariance).T


def combined(shape: np.ndarray, predicted: np.ndarray, mean: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Move a shape (n, 2) by predicted displacements (n, 2), in pixels of the mean shape, under a gain (2 n, 2 n)."""
    to_mean = align(shape, mean)
    aligned = to_mean(shape)
    deviation = (aligned + predicted - mean).ravel()
    moved = np.einsum("ij,j->i", gain, deviation)  # the bits of a product by BLAS depend on its threads
    return to_mean.inverse()(mean + moved.reshape(-1, 2))
