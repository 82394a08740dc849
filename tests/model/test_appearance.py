"""Appearance models learn from what the images show, not from where they show nothing."""

import numpy as np
import pytest

from liaam.model.appearance import Textures, train_appearance_model, train_illumination
from liaam.model.pca import principal_components, some_folds, unexplained_by_others


def test_unusable_pixels_are_filled_in_not_learnt(rng):
    n, n_pixels = 12, 200
    modes = np.linalg.qr(rng.normal(size=(n_pixels * 3, 2)))[0].T
    textures = (rng.normal(size=(n, 2)) * [4.0, 2.0]) @ modes + rng.normal(size=n_pixels * 3)
    textures = textures.reshape(n, n_pixels, 3).astype(np.float32)
    usable = np.ones((n, n_pixels), np.float32)
    clean = train_appearance_model(Textures.of(textures, usable), 2)
    blotted = textures.copy()
    for i in range(4):  # a dark patch in a third of the images
        usable[i, 20 * i : 20 * i + 30] = 0
        blotted[i, 20 * i : 20 * i + 30] = -7.0
    model = train_appearance_model(Textures.of(blotted, usable), 2)
    np.testing.assert_allclose(model.mean, clean.mean, atol=0.02)
    np.testing.assert_allclose(model.eigenvalues, clean.eigenvalues, rtol=0.05)
    overlap = np.linalg.svd(model.modes.reshape(2, -1) @ clean.modes.reshape(2, -1).T, compute_uv=False)
    assert overlap.min() > 0.99
    assert model.usable[25] == pytest.approx(10 / 12)


def test_pixels_that_no_landmarks_place_do_not_count(rng):
    textures = rng.normal(size=(8, 30, 3)).astype(np.float32)
    usable = np.ones((8, 30), np.float32)
    usable[5, 7] = 0
    known = np.ones((8, 30), bool)
    known[:4, 7] = False
    known[:, 9] = False
    spoilt = textures.copy()
    spoilt[:4, 7] = 99.0
    model, other = (train_appearance_model(Textures.of(values, usable, known), 3) for values in (textures, spoilt))
    np.testing.assert_array_equal(other.mean, model.mean)
    np.testing.assert_array_equal(other.modes, model.modes)
    assert model.usable[7] == pytest.approx(3 / 4)  # of the four images in which it could be observed
    assert model.usable[9] == 0
    assert (np.delete(model.usable, [7, 9]) == 1).all()


def test_pixels_no_image_shows_keep_a_value_and_weigh_nothing(rng):
    textures = rng.normal(size=(5, 30, 3)).astype(np.float32)
    usable = np.ones((5, 30), np.float32)
    usable[:, 7] = 0
    model = train_appearance_model(Textures.of(textures, usable), 0.9)
    assert model.usable[7] == 0
    assert np.isfinite(model.mean).all()
    assert np.isfinite(model.modes).all()


def left_out_residuals(vectors: np.ndarray, variance: float | int) -> np.ndarray:
    """What :func:`unexplained_by_others` gives, by its definition."""
    residuals = np.zeros_like(vectors)
    for fold in np.array_split(np.arange(len(vectors)), min(len(vectors), 10)):
        components = principal_components(np.delete(vectors, fold, axis=0), variance)
        deviations = vectors[fold] - components.mean
        residuals[fold] = deviations - deviations @ components.modes.T @ components.modes
    return residuals


@pytest.mark.parametrize("n", [2, 3, 11, 24])
@pytest.mark.parametrize("variance", [0, 2, 50, 0.6, 1.0])
def test_what_others_leave_is_that_of_leaving_out(n, variance, rng):
    vectors = rng.normal(size=(n, 40)) @ np.diag(0.8 ** np.arange(40)) + 3
    expected = left_out_residuals(vectors, variance)
    assert np.abs(expected).max() > 0.03
    np.testing.assert_allclose(unexplained_by_others(vectors, variance, some_folds(len(vectors))), expected, atol=1e-5)
    single = unexplained_by_others(vectors.astype(np.float32), variance, some_folds(len(vectors)))
    np.testing.assert_allclose(single, expected, atol=2e-3)
    assert single.dtype == np.float32


def test_others_that_span_a_vector_leave_nothing(rng):
    vectors = rng.normal(size=(9, 3)) @ rng.normal(size=(3, 50)) + rng.normal(size=50)
    np.testing.assert_allclose(unexplained_by_others(vectors, 1.0, some_folds(len(vectors))), 0, atol=1e-5)
    assert np.abs(unexplained_by_others(vectors, 2, some_folds(len(vectors)))).max() > 0.1


def test_one_vector_has_no_others_and_equal_ones_explain_each_other(rng):
    assert not unexplained_by_others(rng.normal(size=(1, 20)), 0.9, some_folds(1)).any()
    np.testing.assert_allclose(
        unexplained_by_others(np.repeat(rng.normal(size=(1, 20)), 5, axis=0), 1.0, some_folds(5)), 0, atol=1e-6
    )


def test_the_covariance_counts_images_that_show_the_pixel(rng):
    textures = rng.normal(size=(6, 25, 2)).astype(np.float32)
    usable = np.ones((6, 25), np.float32)
    usable[2:, 4] = 0
    usable[:, 9] = 0
    model = train_appearance_model(Textures.of(textures, usable), 0, left_out=some_folds(6))
    # With no modes kept, an image differs from the mean of the others.
    residuals = 6 / 5 * (textures - textures.mean(axis=0))
    covariance = np.einsum("inc,ind->ncd", residuals, residuals) / 6
    elsewhere = np.setdiff1d(np.arange(25), [4, 9])
    assert model.unexplained.shape == (25, 2, 2)
    np.testing.assert_allclose(model.unexplained[elsewhere], covariance[elsewhere], rtol=1e-4, atol=1e-5)
    assert (model.unexplained[9] == 0).all()
    # Two images show it, the rest were filled in with their mean: each is off by 6/5 of half their difference.
    half = 0.6 * (textures[0, 4] - textures[1, 4])
    np.testing.assert_allclose(model.unexplained[4], np.outer(half, half), rtol=1e-4, atol=1e-5)


def test_illumination_is_what_the_identity_does_not_explain(rng):
    n_pixels = 60
    faces = rng.normal(size=(5, n_pixels, 3)).astype(np.float32)
    ones = np.ones((5, n_pixels), np.float32)
    values = train_appearance_model(Textures.of(faces, ones), 1.0)
    light = rng.normal(size=(2, n_pixels, 3)).astype(np.float32)
    lit = faces[:4] + light[[0, 0, 1, 1]] * np.array([1.0, 2.0, 1.0, -1.0], np.float32)[:, None, None]
    basis = train_illumination(values, Textures.of(lit, ones[:4]), 1.0)
    assert basis.n_modes == 2
    flat = basis.modes.reshape(2, -1)
    np.testing.assert_allclose(flat @ flat.T, np.eye(2), atol=1e-5)
    np.testing.assert_allclose(flat @ values.modes.reshape(4, -1).T, 0, atol=1e-5)
    np.testing.assert_allclose(flat @ values.mean.ravel(), 0, atol=1e-4)
    assert not basis.mean.any()
    # Together with the identity, they span what the lights did.
    together = np.concatenate([flat, values.modes.reshape(4, -1), values.mean.reshape(1, -1)]).T
    left = np.linalg.lstsq(together, light.reshape(2, -1).T, rcond=None)[1]
    np.testing.assert_allclose(left, 0, atol=1e-6)
