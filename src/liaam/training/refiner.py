"""Learn to refine fits: regression from landmarks that are as far off as those of fits (:mod:`liaam.model.regressor`).

What a fit leaves is learnt from images of which the appearance model need not know: under other lamps, of faces that
turn or speak. The objective's minimum lies where the image is like the model's; a regressor sees what the landmarks
themselves look like, as the corner of a wide smile.
"""

from collections.abc import Iterable

import numpy as np

from liaam.datasets import Sample
from liaam.model.pca import components_by, gram_about
from liaam.model.regressor import OF_FITS, SIZE, LandmarkRegressor, OrientationHistograms
from liaam.model.shape import ShapeModel, align, diagonal_of, rotation, similarity_modes
from liaam.photometry import Response
from liaam.photometry.encoding import as_colour
from liaam.training.left_out import groups_of
from liaam.training.regressor import RIDGE, Samples, learn_steps

# Distances of the histograms around a landmark in each step, pixels of SIZE. A fourth step changes no error.
SPACINGS = (5.0, 3.0, 3.0)
STARTS = 2  # Starts of an image
MARGIN = 0.25  # Of what is seen around the true landmarks: room for starts
# Errors of starts, as those of fits: standard deviations of the position as a fraction of the diagonal, of the
# logarithm of the size, and of the rotation in degrees; and the share of the deviation of shapes
SHIFT = 0.008
SCALE = 0.02
TURN = 1.5
SHAPE = 0.35
VARIANCE = 0.99  # Fraction of the variance of shapes that their modes explain


def learn_refiner(data: Iterable[Sample], mean: np.ndarray, response: Response = "srgb") -> LandmarkRegressor:
    """Learn a refiner of fits.

    Parameters
    ----------
    data : iterable of Sample
        Images and all of their landmarks. Those of one object, by their names, are left out together to measure errors.
    mean : (n, 2) float64
        Mean shape of the model, pixels of its reference frame.
    response
        Response of the images' camera.
    """
    at_size = mean * (SIZE / diagonal_of(mean))
    histograms = []
    truths = []
    names = []
    for sample in data:
        points = np.asarray(sample.landmarks.points)
        image = as_colour(sample.read_image(), sample.name)
        histograms.append(OrientationHistograms(image, response, points, at_size, OF_FITS._replace(margin=MARGIN)))
        truths.append(points)
        names.append(sample.name)
    shapes = _shapes(np.array(truths), mean)
    starts = []
    for i, truth in enumerate(truths):
        rng = np.random.default_rng([12, i])
        starts += [_like_a_fit(truth, shapes, rng) for _ in range(STARTS)]
    owners = np.repeat(np.arange(len(truths)), STARTS)
    samples = Samples(
        histograms=[histograms[i] for i in owners.tolist()],
        truths=np.array(truths)[owners],
        shapes=np.array(starts),
        blocks=[np.flatnonzero(np.isin(owners, group)) for group in groups_of(names)],
    )
    return learn_steps(samples, shapes, SPACINGS, RIDGE * STARTS)


def _shapes(truths: np.ndarray, mean: np.ndarray) -> ShapeModel:
    """Return the shapes (m, n, 2) as modes about the mean shape of a model, which may be of other images."""
    deviations = np.array([align(truth, mean)(truth) - mean for truth in truths]).reshape(len(truths), -1)
    rigid = similarity_modes(mean)
    deviations -= deviations @ rigid.T @ rigid
    centre = np.zeros(deviations.shape[1])
    components = components_by(deviations, centre, gram_about(deviations, centre), VARIANCE)
    left = deviations - deviations @ components.modes.T @ components.modes
    left = left.reshape(len(truths), -1, 2)
    unexplained = np.einsum("mna,mnb->nab", left, left) / len(left)
    return ShapeModel(mean, components.modes, components.eigenvalues, unexplained)


def _like_a_fit(truth: np.ndarray, shapes: ShapeModel, rng: np.random.Generator) -> np.ndarray:
    """Return landmarks (n, 2) that are off as those of a fit are."""
    weights = rng.normal(0.0, SHAPE * np.sqrt(shapes.eigenvalues))
    off = (weights @ shapes.modes).reshape(-1, 2) @ align(shapes.mean, truth).matrix.T
    shape = truth + off
    centre = shape.mean(axis=0)
    turn = rotation(np.deg2rad(rng.normal(0.0, TURN)))
    scale = np.exp(rng.normal(0.0, SCALE))
    return centre + scale * (shape - centre) @ turn.T + diagonal_of(truth) * rng.normal(0.0, SHIFT, 2)
