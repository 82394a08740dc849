"""The piecewise-affine warp."""

import numpy as np
import pytest

from finite_differences import assert_jacobian
from liaam.shape import align


def test_jacobian_of_the_warp(model, rng):
    p = rng.normal(size=model.warp.n_parameters)
    jacobian = model.warp.jacobian(p).reshape(-1, model.warp.n_parameters)
    assert_jacobian(lambda q: model.warp.points(q).ravel(), jacobian, p, steps=1.0, tolerance=1e-6)


def test_at_rest_pixels_stay_in_place(model):
    points = model.warp.points(np.zeros(model.warp.n_parameters))
    np.testing.assert_allclose(points, model.frame.pixels[:, ::-1] + model.frame.origin, atol=1e-9)


def test_a_similarity_of_the_vertices_is_one_of_the_pixels(model):
    mean = model.shape_model.mean
    pose = align(mean, mean @ [[0, 2], [-2, 0]] + [7, 5])
    rest = model.warp.points(np.zeros(model.warp.n_parameters))
    np.testing.assert_allclose(model.warp.interpolate(pose(mean)), pose(rest), atol=1e-9)
    p = np.zeros(model.warp.n_parameters)
    np.testing.assert_allclose(model.warp.points(p, pose), pose(rest), atol=1e-9)


def test_movement_is_that_of_the_landmarks(model, rng):
    p, step = rng.normal(size=(2, model.warp.n_parameters))
    moved = model.shape_model.shape(model.warp.update(p, step)) - model.shape_model.shape(p)
    assert model.warp.movement(step) == pytest.approx(np.sqrt(np.square(moved).sum(axis=1).mean()))
