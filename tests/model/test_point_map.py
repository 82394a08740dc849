"""The map from another landmarker's points to the landmarks."""

import numpy as np
import pytest

from liaam.model.point_map import PointMap, learn_point_map
from liaam.model.shape import ShapeModel, Similarity, rotation

MEAN = 40.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [0.2, 0.1]])
MEAN -= MEAN.mean(axis=0)


def views(rng: np.random.Generator, n: int, jitter: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Views of a rigid object from far away: 12 points of the other landmarker, and five landmarks."""
    solid = np.random.default_rng(1).normal(size=(12, 3))
    ours = np.column_stack([MEAN / 40.0, [0.0, 0.2, 0.0, 0.1, 0.8]])
    theirs, shapes = [], []
    for _ in range(n):
        turned = np.linalg.qr(np.eye(3) + 0.4 * rng.normal(size=(3, 3)))[0]
        turned, size, shift = turned * np.sign(np.diag(turned)), rng.uniform(20, 60), rng.uniform(100, 200, 2)
        view = size * turned[:, :2]
        theirs.append(solid @ view + shift + size * jitter * rng.normal(size=(12, 2)))
        shapes.append(ours @ view + shift)
    return np.array(theirs), np.array(shapes)


def folds(n: int) -> list[np.ndarray]:
    return [np.array([i]) for i in range(n)]


def test_few_views_of_a_rigid_object_are_enough(rng):
    theirs, shapes = views(rng, 12)
    found = learn_point_map(theirs[:6], shapes[:6], MEAN, folds(6))
    assert found.n_theirs == 12
    for points, truth in zip(theirs[6:], shapes[6:], strict=True):
        size = np.linalg.norm(truth - truth.mean(axis=0))
        assert np.linalg.norm(found(points) - truth) < 0.03 * size


def test_the_map_commutes_with_similarities(rng):
    theirs, shapes = views(rng, 8, jitter=0.05)
    found = learn_point_map(theirs, shapes, MEAN, folds(8))
    move = Similarity(2.5 * rotation(0.7), np.array([30.0, -10.0]))
    np.testing.assert_allclose(found(move(theirs[0])), move(found(theirs[0])), atol=1e-9)
    moved = learn_point_map(np.array([move(each) for each in theirs]), move(shapes), MEAN, folds(8))
    np.testing.assert_allclose(moved.weights, found.weights, atol=1e-9)


def test_the_errors_are_those_on_images_that_were_left_out(rng):
    """The deviation that is stated is that of new images, also where points outnumber images."""
    theirs, shapes = views(rng, 400, jitter=0.05)
    for n in (8, 40):
        found = learn_point_map(theirs[:n], shapes[:n], MEAN, folds(n))
        scales = [np.linalg.norm(MEAN) / np.linalg.norm(each - each.mean(axis=0)) for each in shapes[40:]]
        errors = [s * (found(y) - x) for s, y, x in zip(scales, theirs[40:], shapes[40:], strict=True)]
        actual = np.sqrt(np.square(errors).sum(axis=2).mean())
        assert found.deviation == pytest.approx(actual, rel=0.4)


def test_the_precision_is_the_inverse_covariance_of_the_parameters(rng):
    shapes = ShapeModel(MEAN, np.zeros((0, 10)), np.zeros(0))
    found = PointMap(np.zeros((5, 12)), rng.normal(size=(3, 10)), 0.5)
    covariance = shapes.basis @ (found.errors.T @ found.errors + 0.5 * np.eye(10)) @ shapes.basis.T
    np.testing.assert_allclose(found.left_out.precision(shapes) @ covariance, np.eye(4), atol=1e-9)
