"""Shapes: alignment, the mean, the modes, the bound."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import multivariate_normal

from liaam.errors import TrainingError
from liaam.model.pca import LeftOutCoordinates, some_folds
from liaam.model.shape import (
    PRIORS,
    Similarity,
    align,
    check_prior,
    choose_recipe,
    diagonal_of,
    mirror_order,
    procrustes_mean,
    rotation,
    scaled_mean,
    shape_model_on,
    similarity_modes,
)
from liaam.model.shape_prior import SHARES, fit_freedom, log_density, smooth_covariance, spread_points


def similarity(scale: float, angle: float, x: float, y: float) -> Similarity:
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return Similarity(np.array([[c, -s], [s, c]]), np.array([x, y]))


def train_shape_model(shapes: np.ndarray, diagonal: float, variance, prior: str = "sample"):
    mean = scaled_mean(shapes, diagonal)
    return shape_model_on(mean, shapes, variance, choose_recipe(mean, shapes, prior, some_folds(len(shapes))))


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


@pytest.mark.parametrize("prior", PRIORS)
@pytest.mark.parametrize("variance", [0.98, 2, "auto"])
def test_shape_vectors_are_orthonormal_under_every_prior(prior, variance):
    model = train_shape_model(random_shapes(5), 100.0, variance, prior)
    np.testing.assert_allclose(model.basis @ model.basis.T, np.eye(len(model.basis)), atol=1e-9)
    assert (model.eigenvalues > 0).all()
    assert (np.diff(model.eigenvalues) <= 1e-9).all()
    assert np.isfinite(model.left_out_bound)


@pytest.mark.parametrize("prior", PRIORS)
def test_equal_shapes_have_no_modes_under_any_prior(prior):
    shapes = np.repeat(random_shapes(5, 1), 4, axis=0)
    assert len(train_shape_model(shapes, 100.0, 0.98, prior).modes) == 0


def test_a_wide_prior_has_the_modes_of_a_smooth_one_and_four_times_its_variances():
    smooth, wide = (train_shape_model(random_shapes(8), 100.0, 0.98, prior) for prior in ("smooth", "wide"))
    np.testing.assert_array_equal(wide.modes, smooth.modes)
    np.testing.assert_allclose(wide.eigenvalues, 4.0 * smooth.eigenvalues, rtol=1e-12)
    assert wide.freedom == smooth.freedom
    assert wide.left_out_bound == smooth.left_out_bound


def test_densities_are_those_in_the_space_that_similarities_leave(rng):
    mean = rng.normal(size=(5, 2))
    rigid = similarity_modes(mean - mean.mean(axis=0))
    others = np.linalg.svd(rigid)[2][4:]  # an orthonormal basis of what is orthogonal to them
    root = rng.normal(size=(3, 6)) @ others
    away = rng.normal(size=(4, 6)) @ others
    expected = [
        multivariate_normal(cov=others @ root.T @ root @ others.T + noise * np.eye(6)).logpdf(away @ others.T).sum()
        for noise in (0.1, 2.0)
    ]
    np.testing.assert_allclose(log_density(away, root.T @ root, np.array([0.1, 2.0]), rigid), expected, rtol=1e-9)


def test_a_prior_that_does_not_exist_is_refused():
    with pytest.raises(TrainingError, match="unknown prior 'rough'; choose from sample, shrunk, smooth, wide"):
        check_prior("rough")


def smooth_shapes(rng, n: int, side: int = 5) -> np.ndarray:
    """Grids of points under random smooth deformations, and a little noise."""
    grid = np.stack(np.meshgrid(np.linspace(-50, 50, side), np.linspace(-60, 60, side)), axis=2).reshape(-1, 2)
    apart = np.square(grid[:, None] - grid[None]).sum(axis=2)
    root = np.linalg.cholesky(np.exp(-0.5 * apart / 30.0**2) + 1e-6 * np.eye(len(grid)))
    return grid + 5 * root @ rng.normal(size=(n, len(grid), 2)) + 0.3 * rng.normal(size=(n, len(grid), 2))


def test_smooth_deformations_hold_more_of_shapes_to_come(rng):
    shapes = smooth_shapes(rng, 26)
    few, new = shapes[:6], shapes[6:]
    sample, smooth = (train_shape_model(few, 150.0, 0.98, prior) for prior in ("sample", "smooth"))
    left = [[np.linalg.norm(model.project(shape) - shape) for shape in new] for model in (sample, smooth)]
    assert np.median(left[1]) < 0.4 * np.median(left[0])
    # What it says of new shapes itself is of the right size.
    beyond = [np.linalg.norm(align(shape, smooth.mean)(smooth.project(shape) - shape)) for shape in new]
    assert smooth.left_out_bound < 0.4 * sample.left_out_bound
    assert np.isfinite(beyond).all()


def test_smooth_deformations_have_the_variance_that_shapes_to_come_have(rng):
    shapes = smooth_shapes(rng, 208)
    model = train_shape_model(shapes[:8], 150.0, 0.98, "smooth")
    p = np.array([model.parameters(align(shape, model.mean)(shape))[:-4] for shape in shapes[8:]])
    ratio = np.square(p).mean(axis=0) / model.eigenvalues
    assert 0.5 < np.median(ratio) < 2.0


def left_out_coordinates(rng, scales: np.ndarray, kept: int = 20) -> list[LeftOutCoordinates]:
    """Shapes each with a scale of its variances of its own."""
    values = rng.uniform(0.5, 20.0, kept)
    squares = scales[:, None] * values * rng.normal(size=(len(scales), kept)) ** 2
    return [LeftOutCoordinates(values, squares, squares.sum(axis=1))]


def test_degrees_of_freedom_are_those_that_shapes_left_out_have(rng):
    for freedom in (3.0, 10.0):
        near_and_far = left_out_coordinates(rng, freedom / rng.chisquare(freedom, 400))
        assert fit_freedom(near_and_far, 20) == freedom
    assert fit_freedom(left_out_coordinates(rng, np.ones(400)), 20) == np.inf
    assert fit_freedom([], 20) == np.inf
    assert fit_freedom(left_out_coordinates(rng, np.ones(4)), 0) == np.inf


def test_some_of_many_landmarks_tell_how_smooth_deformations_are(rng, monkeypatch):
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    mean = 40.0 * np.column_stack([np.cos(angles), 1.3 * np.sin(angles)])
    smooth = np.linalg.cholesky(smooth_covariance(mean, similarity_modes(mean), 0.2) + 1e-9 * np.eye(120))
    shapes = mean + (30.0 * smooth @ rng.normal(size=(120, 24))).T.reshape(24, 60, 2)
    recipes = []
    for count in (60, 25):
        monkeypatch.setattr("liaam.model.shape_prior.MOST_POINTS", count)
        recipes.append(choose_recipe(scaled_mean(shapes, 100.0), shapes, "smooth", some_folds(len(shapes))).smooth)
    every, some = recipes
    assert every.share > 0.0 and some.share > 0.0
    assert every.width == some.width == 0.2
    assert abs(SHARES.index(every.share) - SHARES.index(some.share)) <= 1


def test_points_that_are_spread_leave_no_gap(rng):
    points = rng.normal(size=(300, 2))
    chosen = spread_points(points, 40)
    assert len(np.unique(chosen)) == 40
    gaps = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
    own = np.linalg.norm(points[chosen][:, None] - points[chosen], axis=2) + 1e9 * np.eye(40)
    assert gaps.max() <= own.min() + 1e-9  # else the farthest would have been taken instead


def test_many_shapes_need_no_help(rng):
    """Where the sample says it all, the evidence leaves it as it is."""
    modes = np.linalg.qr(rng.normal(size=(50, 3)))[0].T
    shapes = smooth_shapes(rng, 1)[0] + (rng.normal(size=(60, 3)) * [40, 30, 20] @ modes).reshape(60, 25, 2)
    recipe = choose_recipe(
        procrustes_mean(shapes) * 250, shapes + 0.1 * rng.normal(size=shapes.shape), "smooth", some_folds(len(shapes))
    )
    assert recipe.smooth is not None
    assert recipe.smooth.share == 0


def symmetric_shape(rng) -> tuple[np.ndarray, np.ndarray]:
    """Points of both sides and of the mid-line, in any order, and each one's counterpart."""
    right = rng.uniform([10, -60], [60, 60], (8, 2))
    shape = np.concatenate([right, right * [-1, 1], np.stack([np.zeros(3), [-50.0, 5.0, 40.0]], axis=1)])
    order = np.concatenate([np.arange(8, 16), np.arange(8), [16, 17, 18]])
    mixed = rng.permutation(19)
    place = np.argsort(mixed)
    return (shape - shape.mean(axis=0))[mixed], place[order[mixed]]


@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0])
def test_the_counterparts_of_a_symmetric_shape_are_found(rng, angle):
    shape, order = symmetric_shape(rng)
    np.testing.assert_array_equal(mirror_order(shape @ rotation(angle).T), order)


def test_a_shape_without_symmetry_has_no_counterparts(rng):
    assert mirror_order(rng.normal(size=(19, 2)) * 50) is None


def test_a_head_that_was_seen_turned_one_way_may_turn_the_other(rng):
    """Mirrored shapes are learnt from where they make shapes left out likelier."""
    shape, order = symmetric_shape(rng)
    turned = 0.3 * np.abs(shape[:, :1]) * [1.0, 0.0] + 0.1 * shape[:, 1:] * [1.0, 0.0]
    ways = np.array([-1.0, 0.2, -0.6, 1.0, 0.8, -0.3])
    noise = rng.normal(size=(8, 19, 2)) * 0.5
    shapes = shape + ways[:6, None, None] * turned + noise[:6]
    recipe = choose_recipe(procrustes_mean(shapes) * 300, shapes, "smooth", some_folds(len(shapes)))
    assert recipe.mirrored is None or np.array_equal(recipe.mirrored, order)
