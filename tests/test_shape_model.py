"""Shapes: alignment, the mean, the modes, the bound."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from liaam.shape import Similarity, align, diagonal_of, procrustes_mean, similarity_modes, train_shape_model


def similarity(scale: float, angle: float, x: float, y: float) -> Similarity:
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return Similarity(np.array([[c, -s], [s, c]]), np.array([x, y]))


poses = st.builds(similarity, st.floats(0.1, 10), st.floats(-3, 3), st.floats(-500, 500), st.floats(-500, 500))


def random_shapes(seed: int, n: int = 7, n_points: int = 9) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n_points, 2)) * 50 + rng.normal(size=(n, n_points, 2)) * 4


@given(pose=poses, seed=st.integers(0, 99))
def test_align_finds_the_similarity(pose, seed):
    shape = random_shapes(seed, 1)[0]
    found = align(shape, pose(shape))
    np.testing.assert_allclose(found(shape), pose(shape), atol=1e-8)
    np.testing.assert_allclose(found.inverse()(pose(shape)), shape, atol=1e-8)
    assert found.scale == pytest.approx(pose.scale)


def test_align_is_least_squares(rng):
    a, b = rng.normal(size=(2, 9, 2))
    design = np.concatenate(
        [
            np.column_stack([a[:, 0], -a[:, 1], np.ones(9), np.zeros(9)]),
            np.column_stack([a[:, 1], a[:, 0], np.zeros(9), np.ones(9)]),
        ]
    )
    residual = np.linalg.lstsq(design, np.concatenate([b[:, 0], b[:, 1]]), rcond=None)[1][0]
    assert np.square(align(a, b)(a) - b).sum() == pytest.approx(residual)


def test_align_never_mirrors(rng):
    shape = rng.normal(size=(9, 2))
    assert np.linalg.det(align(shape, shape * [-1, 1]).matrix) >= 0


def test_align_leaves_missing_points_out(rng):
    shape = rng.normal(size=(9, 2))
    holed = shape.copy()
    holed[[2, 5], [0, 1]] = np.nan
    np.testing.assert_allclose(align(holed, 3 * shape)(shape), 3 * shape, atol=1e-12)


def test_the_mean_of_moved_copies_is_the_shape(rng):
    shape = rng.normal(size=(9, 2))
    copies = np.array(
        [similarity(s, a, 3 * a, s)(shape) for s, a in zip(rng.uniform(1, 9, 6), rng.normal(0, 0.3, 6), strict=True)]
    )
    mean = procrustes_mean(copies)
    np.testing.assert_allclose(align(mean, shape)(mean), shape, atol=1e-8)
    assert np.linalg.norm(mean) == pytest.approx(1)


@given(seed=st.integers(0, 99))
def test_shape_vectors_are_orthonormal_and_the_last_four_are_the_similarities(seed):
    model = train_shape_model(random_shapes(seed), 100.0, 1.0)
    np.testing.assert_allclose(model.basis @ model.basis.T, np.eye(len(model.basis)), atol=1e-9)
    np.testing.assert_allclose(model.basis[-4:], similarity_modes(model.mean))
    np.testing.assert_allclose(model.mean.mean(axis=0), 0, atol=1e-9)
    assert diagonal_of(model.mean) == pytest.approx(100)


@given(seed=st.integers(0, 99), pose=poses)
def test_projection_is_idempotent_and_moves_with_the_shape(seed, pose):
    shapes = random_shapes(seed)
    model = train_shape_model(shapes[:-1], 100.0, 2)
    unseen = shapes[-1]
    once = model.project(unseen)
    tolerance = 1e-6 * diagonal_of(unseen)
    np.testing.assert_allclose(model.project(once), once, atol=tolerance)
    np.testing.assert_allclose(model.project(pose(unseen)), pose(once), atol=pose.scale * tolerance)
    assert np.linalg.norm(once - unseen) > tolerance  # two modes do not hold everything


@given(seed=st.integers(0, 99))
def test_no_small_change_of_the_parameters_beats_the_projection(seed):
    shapes = random_shapes(seed)
    model = train_shape_model(shapes[:-1], 100.0, 2)
    best = model.project(shapes[-1])
    to_model = align(best, model.mean)
    p = model.parameters(to_model(best))
    bound = np.linalg.norm(best - shapes[-1])
    rng = np.random.default_rng(seed)
    for _ in range(10):
        near = to_model.inverse()(model.shape(p + rng.normal(0, 0.3, len(p))))
        assert np.linalg.norm(near - shapes[-1]) > bound - 1e-5


@given(seed=st.integers(0, 99))
def test_a_model_with_all_modes_holds_its_training_shapes(seed):
    shapes = random_shapes(seed)
    model = train_shape_model(shapes, 100.0, 1.0)
    for shape in shapes:
        np.testing.assert_allclose(model.project(shape), shape, atol=0.05)


def test_parameters_undo_shape(rng):
    model = train_shape_model(random_shapes(3), 100.0, 1.0)
    p = rng.normal(size=len(model.basis))
    np.testing.assert_allclose(model.parameters(model.shape(p)), p, atol=1e-10)


def test_a_step_of_the_last_two_parameters_shifts():
    model = train_shape_model(random_shapes(3), 100.0, 1.0)
    p = np.zeros(len(model.basis))
    p[-2] = 6.0
    np.testing.assert_allclose(model.shape(p) - model.mean, np.tile([2.0, 0.0], (9, 1)), atol=1e-12)
