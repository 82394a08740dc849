"""Coordinates of shapes in a picture, and covariances carried to them and back."""

import numpy as np
import pytest

from liaam.fitting import Fitter
from liaam.fitting.quality import fitted_covariances
from liaam.model import SURROUNDINGS
from liaam.model.shape import rotation
from liaam.tracking.motion import LARGEST, Motion, landmark_covariances, rescaled
from setups import disturb


@pytest.fixture(scope="module")
def motion(head_model):
    return Motion.of(head_model.views[SURROUNDINGS].shape_model)


def posed(motion: Motion, rng: np.random.Generator) -> np.ndarray:
    """A shape of the model under any similarity."""
    model = motion.shape_model
    p = np.concatenate([rng.normal(0, np.sqrt(model.eigenvalues)), np.zeros(4)])
    turn = rotation(rng.uniform(-3, 3)) * rng.uniform(0.5, 3)
    return model.shape(p) @ turn.T + rng.normal(0, 100, 2)


def test_a_shape_comes_back_from_its_coordinates(motion, rng):
    for _ in range(20):
        shape = posed(motion, rng)
        y = motion.coordinates(shape)
        np.testing.assert_allclose(motion.shape(y), shape, atol=1e-8)
        np.testing.assert_allclose(motion.coordinates(motion.shape(y)), y, atol=1e-8)


def test_directions_are_orthonormal_and_the_modes_derivatives(motion, rng):
    y = motion.coordinates(posed(motion, rng))
    basis = motion.basis(y)
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(y)), atol=1e-9)
    for i in range(2, len(y)):
        step = np.eye(len(y))[i]
        np.testing.assert_allclose((motion.shape(y + step) - motion.shape(y)).ravel(), basis[i], atol=1e-9)


def test_what_lies_outside_the_coordinates_turns_and_grows_with_the_shape(motion, rng):
    shape = posed(motion, rng) + rng.normal(0.0, 1.0, motion.shape_model.mean.shape)
    y = motion.coordinates(shape)
    rest = motion.rest(shape, y)
    np.testing.assert_allclose(motion.shape_with(y, rest), shape, atol=1e-9)
    turned = 2.0 * shape @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    np.testing.assert_allclose(motion.rest(turned, motion.coordinates(turned)), rest, atol=1e-9)
    assert np.abs(rest).max() > 1e-3


def test_a_shape_of_no_size_has_coordinates(motion):
    y = motion.coordinates(np.full((motion.shape_model.n_points, 2), 5.0))
    assert np.isfinite(motion.shape(y)).all()


def test_covariances_of_a_fit_survive_the_way_there_and_back(motion, head_model, moving):
    scene = moving[3]
    result = Fitter(head_model).fit(scene.image, disturb(scene.landmarks))
    _, covariance, basis = motion.measured(result)
    back = landmark_covariances(basis, covariance)
    own = (
        result.pose.matrix
        @ fitted_covariances(head_model.views[SURROUNDINGS].shape_model, result.covariance)
        @ result.pose.matrix.T
    )
    np.testing.assert_allclose(back, own, atol=0.05 * own.max())
    assert np.linalg.eigvalsh(covariance)[0] > 0
    assert np.trace(covariance) < LARGEST


def test_a_shape_grows_with_the_picture_about_pixel_centres():
    corners = np.array([[-0.5, -0.5], [9.5, 19.5]])
    np.testing.assert_allclose(rescaled(corners, (20, 10), (40, 30)), [[-0.5, -0.5], [29.5, 39.5]])
