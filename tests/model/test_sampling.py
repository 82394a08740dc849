"""Patches: a region of the image at about the model's resolution, with coordinates that fit."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam import _core, image_reference
from liaam.model.sampling import AveragedImage, BrightnessPatch, block_size, make_patch, sample_texture
from liaam.model.shape import Similarity

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
    counts = BrightnessPatch.around(
        ramp(), BOX + shift, at_scale(scale), response="srgb", blur=1.0, margin=0.5
    ).count_orientations()
    for each in (patch.channels, counts):
        assert min(each.shape[:2]) >= 2
        assert np.isfinite(each).all()


def test_orientations_are_counted_in_some_of_the_pixels_of_large_images(rng):
    image = rng.integers(0, 256, (160, 200, 3), dtype=np.uint8)
    options: dict[str, Any] = {"response": "srgb", "blur": 1.0, "margin": 0.2}
    expected = BrightnessPatch.around(image, BOX, at_scale(4.2), **options)
    three_times = image.repeat(3, axis=0).repeat(3, axis=1)
    enlarged = Similarity(3.0 * np.eye(2), np.ones(2))
    found = BrightnessPatch.around(three_times, enlarged(BOX), at_scale(12.6), **options)
    np.testing.assert_allclose(found.count_orientations(), expected.count_orientations(), atol=1e-6)
    np.testing.assert_allclose(found.from_image(enlarged(BOX)), expected.from_image(BOX), atol=1e-9)


def test_orientations_of_grey_images_are_counted_alike(rng):
    grey = rng.integers(0, 256, (160, 200, 1), dtype=np.uint8).repeat(3, axis=2)
    options: dict[str, Any] = {"response": "srgb", "blur": 1.0, "margin": 0.2}
    patches = [BrightnessPatch.around(grey, BOX, at_scale(2.2), grey=known, **options) for known in (True, False)]
    found, expected = (patch.count_orientations() for patch in patches)
    np.testing.assert_allclose(found, expected, atol=1e-5)


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


@pytest.mark.parametrize(("encoding", "n"), [("value", 3), ("log", 3), ("orientation", 3), ("soft", 6)])
def test_patches_are_as_wide_for_all_encodings(encoding, n, rng):
    image = rng.integers(0, 256, (160, 200, 3), dtype=np.uint8)
    patch = make_patch(image, BOX, at_scale(1.5), encoding=encoding, response="srgb", blur=1.0, margin=0.2)
    assert (patch.channels.shape[2], patch.channels.dtype, patch.n_channels) == (8, np.float32, n)
    assert patch.channels.flags.c_contiguous and patch.channels.flags.writeable
    assert not patch.channels[..., n:7].any()
    assert set(np.unique(patch.channels[..., 7])) <= {0.0, 1.0}
    pixel = at_scale(1.0) if encoding != "soft" else patch.from_image.inverse()
    assert sample_texture(patch, pixel(np.array([[3.0, 4.0]])))[0].shape == (1, n)


@pytest.mark.parametrize("encoding", ["log", "soft"])
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_patches_of_light_averaged_once_are_those_of_the_picture(encoding, kind, rng):
    image = rng.integers(60, 200, (160, 200, 3), dtype=np.uint8)
    image[70, 80] = 0
    image = image if kind == np.uint8 else (image / 255).astype(np.float32)
    if kind == np.float32:
        image[90:93, 100] = np.nan
    pose = at_scale(2.3)
    options: dict[str, Any] = {"encoding": encoding, "response": "srgb"}
    light = AveragedImage.around(image, BOX, pose, blurs=(4.0, 2.0, 1.0), margin=0.4, **options)
    for blur, margin, moved in ((4.0, 0.4, 0.0), (2.0, 0.1, 2.5), (1.0, 0.1, -4.0)):
        alone, shared = (
            make_patch(of, BOX + moved, pose, blur=blur, margin=margin, **options) for of in (image, light)
        )
        np.testing.assert_allclose(shared.from_image.offset, alone.from_image.offset)
        np.testing.assert_allclose(shared.channels, alone.channels, atol=1e-4)
        size = block_size(encoding, 2.3, blur)
        assert light.blocks.coarser(np.array([50, 40]), np.array([110, 100]), size) is not None


def test_patches_elsewhere_are_made_of_the_picture_itself(rng):
    image = rng.integers(60, 200, (300, 400, 3), dtype=np.uint8)
    options: dict[str, Any] = {"encoding": "soft", "response": "srgb"}
    light = AveragedImage.around(image, BOX, at_scale(2.0), blurs=(2.0, 1.0), margin=0.1, **options)
    for shape, scale in ((BOX + 150.0, 2.0), (BOX, 3.1)):  # beyond what was averaged; and much larger than thought
        alone, shared = (
            make_patch(of, shape, at_scale(scale), blur=1.0, margin=0.1, **options) for of in (image, light)
        )
        assert np.array_equal(shared.channels, alone.channels)


def test_compiled_samples_are_those_of_the_reference(rng):
    channels = rng.normal(size=(7, 9, 8)).astype(np.float32)
    channels[..., -1] = rng.random((7, 9)) > 0.2
    edges = [[0.0, 0.0], [8.0, 6.0], [8.0, 3.2], [-1e-9, 2.0], [8.001, 2.0], [2.0, np.nan], [np.nan, 1.0], [4.0, 5.0]]
    points = np.concatenate([rng.uniform(-1, 9, (200, 2)), edges])
    values, usable = _core.sample_channels(channels, points)
    expected, _, weights = image_reference.sample(channels, points)
    np.testing.assert_allclose(values, expected[:, :7], atol=1e-6)
    np.testing.assert_array_equal(usable, weights)
    assert 0 < usable.sum() < len(points)
