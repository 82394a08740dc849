"""Missing landmarks: expectation maximisation recovers made-up shapes, whatever their pose and order."""

import numpy as np
import pytest

from liaam.model.missing import Missing
from liaam.model.pca import some_folds
from liaam.model.shape import (
    align,
    choose_recipe,
    deviations_from,
    rotation,
    scaled_mean,
    shape_model_on,
    similarity_modes,
)
from liaam.training.filling import filled, is_enough, unlinked


def low_rank_shapes(rng: np.random.Generator, m: int, n: int, rank: int, noise: float = 0.0) -> np.ndarray:
    """Draw shapes (m, n, 2) of a mean and a few modes, each in a pose of its own."""
    mean = rng.uniform(-50, 50, (n, 2))
    mean -= mean.mean(axis=0)
    rigid = similarity_modes(mean)
    modes = rng.normal(size=(rank, 2 * n))
    modes -= modes @ rigid.T @ rigid
    local = mean + (rng.normal(size=(m, rank)) @ modes).reshape(m, n, 2) + noise * rng.normal(size=(m, n, 2))
    return np.array([shape @ rotation(rng.normal()).T * rng.uniform(0.5, 3) + rng.normal(0, 99, 2) for shape in local])


def holed(rng: np.random.Generator, shapes: np.ndarray, share: float) -> np.ndarray:
    """Leave landmarks out at random, but at least four in each shape and three of each landmark."""
    known = rng.uniform(size=shapes.shape[:2]) >= share
    known[:, :4] |= known.sum(axis=1, keepdims=True) < 4
    known[:3] = True
    return np.where(known[..., None], shapes, np.nan)


def sizes(shapes: np.ndarray) -> np.ndarray:
    """Distances of landmarks from their centre, root mean squares, (m, 1)."""
    away = shapes - shapes.mean(axis=1, keepdims=True)
    return np.sqrt(np.square(away).sum(axis=2).mean(axis=1, keepdims=True))


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.square(errors).mean()))


def test_a_low_rank_model_is_recovered(rng):
    shapes = low_rank_shapes(rng, 60, 10, 2)
    partial = holed(rng, shapes, 0.2)
    missing = np.isnan(partial[..., 0])
    found, said = filled(partial, some_folds(60))
    np.testing.assert_array_equal(said.known, ~missing)
    errors = (np.linalg.norm(found - shapes, axis=2) / sizes(shapes))[missing]
    # The mean of the shapes is what is known without the modes.
    of_mean = [align(scaled_mean(shapes, 1.0), shape)(scaled_mean(shapes, 1.0)) for shape in shapes]
    plain = (np.linalg.norm(of_mean - shapes, axis=2) / sizes(shapes))[missing]
    assert rms(errors) < 0.05 * rms(plain)


def test_known_landmarks_stay_as_they_are(rng):
    partial = holed(rng, low_rank_shapes(rng, 9, 8, 3, 1.0), 0.4)
    found, said = filled(partial, some_folds(9))
    np.testing.assert_array_equal(found[said.known], partial[said.known])
    assert np.isfinite(found).all()
    for factors, known in zip(said.factors, said.known, strict=True):
        assert factors.shape == (2 * (~known).sum(), 8, 2)
        assert not factors[:, known].any()


def test_moved_copies_of_a_shape_are_recovered_exactly(rng):
    shape = rng.normal(size=(9, 2))
    copies = np.array([shape @ rotation(i).T * (i + 1) + [3 * i, -i] for i in range(6)])
    partial = copies.copy()
    for i, missing in enumerate(((0, 1), (2,), (3, 4), (5,), (6, 8), (0, 7))):
        partial[i, list(missing)] = np.nan  # no copy is whole
    found, said = filled(partial, some_folds(6))
    np.testing.assert_allclose(found, copies, atol=1e-5)
    assert max(np.abs(factors).max() for factors in said.factors) < 1e-4


def test_shapes_without_landmarks_in_common_are_linked_by_others(rng):
    shape = rng.normal(size=(12, 2))
    partial = np.array([shape @ rotation(i).T * (i + 1) for i in range(3)])
    whole = partial.copy()
    partial[0, 5:] = partial[1, :7] = partial[2, [0, 1, 2, 9, 10, 11]] = np.nan
    found, _ = filled(partial, some_folds(3))
    np.testing.assert_allclose(found, whole, atol=1e-5)


def test_the_order_of_shapes_does_not_matter(rng):
    partial = holed(rng, low_rank_shapes(rng, 20, 8, 3, 2.0), 0.2)
    order = rng.permutation(20)
    folds = some_folds(20)
    found, said = filled(partial, folds)
    places = np.argsort(order)
    shuffled, also = filled(partial[order], [np.sort(places[fold]) for fold in folds])
    np.testing.assert_allclose(shuffled, found[order], atol=1e-6 * np.abs(found).max())
    np.testing.assert_allclose(_covariance(also, 3), _covariance(said, int(order[3])), atol=1e-6)


def test_neither_pose_nor_size_matters(rng):
    partial = holed(rng, low_rank_shapes(rng, 20, 8, 3, 2.0), 0.2)
    found, _ = filled(partial, some_folds(20))
    turned, _ = filled(1e3 * partial @ rotation(1.0).T + [4e3, -1e3], some_folds(20))
    np.testing.assert_allclose(turned, 1e3 * found @ rotation(1.0).T + [4e3, -1e3], atol=3.0)  # of 1e5 pixels


def _covariance(missing: Missing, i: int) -> np.ndarray:
    rows = missing.factors[i].reshape(len(missing.factors[i]), -1)
    return rows.T @ rows


def test_stated_covariances_are_those_of_the_errors(rng):
    shapes = low_rank_shapes(rng, 150, 8, 2, 4.0)
    partial = holed(rng, shapes, 0.15)
    found, said = filled(partial, some_folds(150))
    squares = []
    for i in np.flatnonzero(~said.known.all(axis=1)):
        coordinates = np.repeat(~said.known[i], 2)
        covariance = _covariance(said, i)[np.ix_(coordinates, coordinates)]
        error = (found[i] - shapes[i]).ravel()[coordinates]
        squares.append(error @ np.linalg.solve(covariance, error) / len(error))
    n_values = 2 * int((~said.known).sum())
    # The mean of that many squares of standard normal values, whose variance is 2.
    assert np.mean(squares) == pytest.approx(1.0, abs=5 * np.sqrt(2.0 / n_values))


@pytest.mark.parametrize("prior", ["sample", "smooth"])
def test_the_variance_of_a_landmark_that_is_often_missing_is_not_underestimated(rng, prior):
    shapes = low_rank_shapes(rng, 200, 6, 1, 5.0)
    partial = shapes.copy()
    partial[::2, 4] = np.nan
    folds = some_folds(200)
    found, said = filled(partial, folds)
    variances = []
    for known, missing in ((shapes, None), (found, said), (found, None)):
        mean = scaled_mean(known, 100.0)
        model = shape_model_on(mean, known, 1.0, choose_recipe(mean, known, prior, folds, missing), folds, missing)
        variances.append(float((model.eigenvalues[:, None] * np.square(model.modes[:, 8:10])).sum()))
    whole, honest, naive = variances
    assert honest == pytest.approx(whole, rel=0.2)
    assert naive < 0.8 * whole


@pytest.mark.parametrize("prior", ["sample", "shrunk", "smooth"])
def test_shapes_of_which_nothing_is_missing_give_the_same_model_bit_for_bit(rng, prior):
    shapes = low_rank_shapes(rng, 12, 7, 3, 1.0)
    mean = scaled_mean(shapes, 100.0)
    nothing = Missing(np.ones((12, 7), bool), tuple(np.zeros((0, 7, 2)) for _ in shapes))
    models = []
    for missing in (None, nothing):
        recipe = choose_recipe(mean, shapes, prior, some_folds(12), missing)
        models.append(shape_model_on(mean, shapes, 0.98, recipe, None, missing))
    plain, same = models
    np.testing.assert_array_equal(plain.modes, same.modes)
    np.testing.assert_array_equal(plain.eigenvalues, same.eigenvalues)
    np.testing.assert_array_equal(plain.unexplained, same.unexplained)
    assert plain.freedom == same.freedom


def test_uncertainty_is_mirrored_with_the_shapes(rng):
    half = rng.uniform(5, 50, (4, 2))
    mean = np.concatenate([half, half * [-1, 1]])
    order = np.roll(np.arange(8), 4)
    shapes = mean + rng.normal(size=(5, 8, 2))
    factors = [np.zeros((0, 8, 2)) for _ in shapes]
    factors[2] = np.zeros((2, 8, 2))
    factors[2][:, 1] = [[3, 0], [0, 1]]
    known = np.ones((5, 8), bool)
    known[2, 1] = False
    mean -= mean.mean(axis=0)
    deviations = deviations_from(mean, shapes, order, Missing(known, tuple(factors)))
    spread = deviations.spread
    assert spread is not None
    rows = spread.rows.reshape(2, 8, 2)
    mirrored = spread.further.reshape(2, 8, 2)
    # But for what the alignment takes away, the displacements of landmark 1 are those of its mirror image.
    assert np.abs(rows[:, 1]).max() > 2 and np.abs(mirrored[:, 5]).max() > 2
    np.testing.assert_allclose(np.abs(mirrored[:, 5]), np.abs(rows[:, 1]), atol=0.3)
    np.testing.assert_array_equal(spread.owners, [2, 2])
    some = spread.of(np.array([1, 2]))
    np.testing.assert_array_equal(some.owners, [1, 1])
    assert not len(spread.of(np.array([0, 4])).rows)


def test_it_takes_links_and_every_landmark_to_estimate_what_is_missing():
    known = np.ones((4, 6), bool)
    known[0, 2] = False
    assert is_enough(known)
    known[:, 2] = False
    assert not is_enough(known)
    known[:2, 2:] = False
    known[2:, :2] = False
    known[2:, 2] = True
    assert not is_enough(known)


def test_images_without_a_link_are_told_apart():
    known = np.zeros((5, 9), bool)
    known[:2, :4] = known[2:, 3:] = True  # one landmark in common
    groups = unlinked(known)
    assert [group.tolist() for group in groups] == [[2, 3, 4], [0, 1]]
    known[0, 4] = True
    (group,) = unlinked(known)
    assert group.tolist() == [0, 1, 2, 3, 4]
