"""Appearance models learn from what the images show, not from where they show nothing."""

import numpy as np
import pytest

from liaam.appearance import train_appearance_model


def test_unusable_pixels_are_filled_in_not_learnt(rng):
    n, n_pixels = 12, 200
    modes = np.linalg.qr(rng.normal(size=(n_pixels * 3, 2)))[0].T
    textures = (rng.normal(size=(n, 2)) * [4.0, 2.0]) @ modes + rng.normal(size=n_pixels * 3)
    textures = textures.reshape(n, n_pixels, 3).astype(np.float32)
    usable = np.ones((n, n_pixels), np.float32)
    clean = train_appearance_model(textures, usable, 2)
    blotted = textures.copy()
    for i in range(4):  # a dark patch in a third of the images
        usable[i, 20 * i : 20 * i + 30] = 0
        blotted[i, 20 * i : 20 * i + 30] = -7.0
    model = train_appearance_model(blotted, usable, 2)
    np.testing.assert_allclose(model.mean, clean.mean, atol=0.02)
    np.testing.assert_allclose(model.eigenvalues, clean.eigenvalues, rtol=0.05)
    overlap = np.linalg.svd(model.modes.reshape(2, -1) @ clean.modes.reshape(2, -1).T, compute_uv=False)
    assert overlap.min() > 0.99
    assert model.usable[25] == pytest.approx(10 / 12)


def test_pixels_no_image_shows_keep_a_value_and_weigh_nothing(rng):
    textures = rng.normal(size=(5, 30, 3)).astype(np.float32)
    usable = np.ones((5, 30), np.float32)
    usable[:, 7] = 0
    model = train_appearance_model(textures, usable, 0.9)
    assert model.usable[7] == 0
    assert np.isfinite(model.mean).all()
    assert np.isfinite(model.modes).all()
