"""The map from the points of another landmarker to a model's landmarks, with the covariance of its errors.

Each landmark is a linear combination of their points, relative to their centroid:

    x = c + W (y - c)

The map commutes with similarities, so no alignment is needed. For points of a rigid object seen from far away one W is
right for all views, because any four of its points determine the others. W maximises the likelihood of the training
images under a Gaussian prior on W (ridge regression): two equations for each image and landmark. The strength of the
prior and the covariance of the errors come from left-out images.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from liaam.formatting import short_repr
from liaam.model.shape import ShapeModel, align

# Candidate ridges, as fractions of the squared size of a shape of theirs. Measured with MediaPipe on the spot protocol,
# with maps from five images of a person: median errors of 4.4 % for a ridge of 2e-6, 4.0 % for 6e-5, and 3.9 to 4.0 %
# between 2e-4 and 2e-2.
RIDGES = (1e-4, 1e-3, 1e-2, 1e-1)
SHRINK = 5.0  # Weight, in images, of uncorrelated errors of equal variance in the estimate of the errors' covariance


LEAST_NOISE = 1e-4  # Lower bound on the variance of uncorrelated errors, square pixels of the reference frame


@dataclass(frozen=True, eq=False)
class PointErrors:
    """Errors of another landmarker's landmarks on left-out images.

    Attributes
    ----------
    errors : (k, 2 n) float64
        Rows whose products sum to the covariance: ``errors' errors + noise I``, pixels of the reference frame.
    noise : float
        Variance of the part of the errors that is independent for each coordinate.
    """

    errors: np.ndarray
    noise: float

    __repr__ = short_repr

    @property
    def deviation(self) -> float:
        """Root mean square error of a landmark, pixels of the reference frame."""
        return float(np.sqrt(2.0 * (np.square(self.errors).sum() / self.errors.shape[1] + self.noise)))

    def precision(self, shapes: ShapeModel) -> np.ndarray:
        """Return the inverse covariance of the errors in the parameters of a shape model, (n_p, n_p) float64."""
        errors = self.errors @ shapes.basis.T
        values, vectors = np.linalg.eigh(errors.T @ errors)
        return (vectors / (np.maximum(values, 0.0) + self.noise)) @ vectors.T


@dataclass(frozen=True, eq=False)
class PointMap:
    """A map from the points of another landmarker to the model's landmarks.

    Attributes
    ----------
    weights : (n, m) float64
        W: weights of their m points for each of the n landmarks.
    errors : (k, 2 n) float64
        Errors on left-out images, pixels of the reference frame. Their covariance is ``errors' errors + noise I``.
    noise : float
        Variance of the part of the errors that is independent for each coordinate.
    """

    weights: np.ndarray
    errors: np.ndarray
    noise: float

    __repr__ = short_repr

    @property
    def n_theirs(self) -> int:
        """Number of points of the other landmarker."""
        return self.weights.shape[1]

    @property
    def left_out(self) -> PointErrors:
        """Errors on left-out images."""
        return PointErrors(self.errors, self.noise)

    @property
    def deviation(self) -> float:
        """Root mean square error of a landmark, pixels of the reference frame."""
        return self.left_out.deviation

    def __call__(self, theirs: np.ndarray) -> np.ndarray:
        """Map their points (m, 2) to landmarks (n, 2), in the same coordinates."""
        centre = theirs.mean(axis=0)
        return centre + self.weights @ (theirs - centre)


def learn_point_map(theirs: np.ndarray, shapes: np.ndarray, mean: np.ndarray, folds: Sequence[np.ndarray]) -> PointMap:
    """Learn the map from their points (n_images, m, 2) and landmarks (n_images, n, 2).

    ``mean`` (n, 2) is the model's mean shape, pixels of the reference frame; images of a fold are left out together.
    """
    left_out = [_left_out(theirs, shapes, mean, folds, ridge) for ridge in RIDGES]
    best = int(np.argmin([np.square(errors).sum() for errors in left_out]))
    errors = left_out[best]
    n = len(shapes)
    variance = float(np.square(errors).mean())
    share = n / (n + SHRINK)
    noise = max((1.0 - share) * variance, LEAST_NOISE)
    return PointMap(_weights(theirs, shapes, RIDGES[best]), np.sqrt(share / n) * errors, noise)


def _left_out(
    theirs: np.ndarray, shapes: np.ndarray, mean: np.ndarray, folds: Sequence[np.ndarray], ridge: float
) -> np.ndarray:
    """Return errors on left-out images (n_images, 2 n), pixels of the reference frame."""
    errors = np.empty((len(shapes), mean.size))
    for fold in folds:
        others = np.setdiff1d(np.arange(len(shapes)), fold)
        mapped = PointMap(_weights(theirs[others], shapes[others], ridge), errors[:0], 0.0)
        for i in fold:
            guess = mapped(theirs[i])
            errors[i] = ((shapes[i] - guess) @ align(guess, mean).matrix.T).ravel()
    return errors


def _weights(theirs: np.ndarray, shapes: np.ndarray, ridge: float) -> np.ndarray:
    """Return W, (n, m) float64, for a ridge relative to the squared size of their shapes."""
    centres = theirs.mean(axis=1, keepdims=True)
    sizes = np.sqrt(np.square(theirs - centres).sum(axis=(1, 2), keepdims=True))
    given, wanted = (((points - centres) / sizes).transpose(0, 2, 1) for points in (theirs, shapes))
    given = given.reshape(-1, theirs.shape[1])
    wanted = wanted.reshape(-1, shapes.shape[1])
    gram = given @ given.T + ridge * np.eye(len(given))
    return np.linalg.solve(gram, wanted).T @ given
