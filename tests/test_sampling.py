"""Patches: a region of the image at about the model's resolution, with coordinates that fit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from liaam.sampling import make_patch, sample_texture
from liaam.shape import Similarity

BOX = np.array([[60.0, 50.0], [110.0, 50.0], [110.0, 100.0], [60.0, 100.0]])


def at_scale(scale: float) -> Similarity:
    return Similarity(scale * np.eye(2), np.zeros(2))


def ramp(height: int = 160, width: int = 200) -> np.ndarray:
    """Linear light that is linear in x and y: averages and blurs do not bend it."""
    y, x = np.mgrid[:height, :width]
    return np.stack([x / width, y / height, (x + y) / 400], axis=2).astype(np.float32)


@given(scale=st.floats(0.3, 6.0), seed=st.integers(0, 9))
def test_coordinates_survive_the_cut_and_the_reduction(scale, seed):
    points = np.random.default_rng(seed).uniform(70, 90, (20, 2))
    patch = make_patch(ramp(), BOX, at_scale(scale), encoding="log", response="linear", blur=0.0, margin=0.5)
    values, usable = sample_texture(patch, points)
    expected = np.column_stack([points[:, 0] / 200, points[:, 1] / 160, points.sum(axis=1) / 400])
    assert usable.all()
    # Interpolating a logarithm bends it a little, the more the larger the blocks.
    np.testing.assert_allclose(np.exp(values), expected, rtol=2e-4 * max(scale, 1))


@pytest.mark.parametrize(("scale", "size"), [(0.5, 1), (1.9, 1), (2.0, 2), (3.99, 3)])
def test_reduction_is_never_coarser_than_the_model(scale, size):
    patch = make_patch(ramp(), BOX, at_scale(scale), encoding="value", response="srgb", blur=0.0, margin=0.5)
    assert 1 / patch.from_image.scale == pytest.approx(size)


@pytest.mark.parametrize("shift", [(-500, 0), (500, 0), (0, -500), (0, 500), (1e6, 1e6), (-60, -50)])
@pytest.mark.parametrize("scale", [0.5, 3.0, 1000.0])
def test_a_shape_outside_the_image_still_gives_a_patch(shift, scale):
    patch = make_patch(ramp(), BOX + shift, at_scale(scale), encoding="log", response="srgb", blur=1.0, margin=0.5)
    assert min(patch.channels.shape[:2]) >= 2
    assert np.isfinite(patch.channels).all()


@pytest.mark.parametrize("scale", [2.0, 3.3])
def test_blocks_are_those_of_the_image_whatever_the_margin(scale, rng):
    """Else training (small margin) and fitting (large margin) average other pixels into one."""
    image = rng.uniform(0.1, 0.9, (160, 200, 3)).astype(np.float32)
    points = rng.uniform(70, 90, (20, 2))
    textures = [
        sample_texture(
            make_patch(image, BOX, at_scale(scale), encoding="value", response="linear", blur=0.0, margin=margin),
            points,
        )[0]
        for margin in (0.1, 0.13, 0.17, 0.6)
    ]
    for texture in textures[1:]:
        np.testing.assert_allclose(texture, textures[0], atol=1e-5)


def test_outside_the_patch_nothing_is_usable():
    patch = make_patch(ramp(), BOX, at_scale(1.0), encoding="log", response="srgb", blur=0.0, margin=0.1)
    values, usable = sample_texture(patch, np.array([[-1.0, 5.0], [199.5, 80.0], [80.0, 80.0]]))
    assert usable.tolist() == [0, 0, 1]
    assert not values[:2].any()
