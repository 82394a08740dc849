"""What the search compares: directions of gradients in a picture, and those that a small model expects."""

import numpy as np
import pytest

from liaam.fitting.search.templates import TEMPLATE, Grey, make_templates, shrink, soft_directions
from liaam.training.compacting import compact
from setups import train_on


def test_grey_of_integers_is_that_of_floats(rng):
    image = rng.integers(0, 256, (120, 160, 3), dtype=np.uint8)
    whole, shares = (Grey.of(given, "srgb", 3.4) for given in (image, (image / 255).astype(np.float32)))
    assert (whole.reduce, whole.values.shape) == (3, (40, 53))
    np.testing.assert_allclose(whole.values, shares.values, atol=1e-5)


def test_the_small_model_is_the_model_made_small(model):
    small = shrink(model)
    assert small.diagonal == pytest.approx(TEMPLATE)
    appearance = small.levels[0].appearances["orientation"]
    assert appearance.mean.shape == (small.n_pixels, 2)
    assert np.linalg.norm(appearance.mean, axis=1).max() <= 1.001


def test_the_pixels_that_a_file_keeps_make_the_same_small_model(scenes):
    whole = train_on(scenes[:4], diagonal=150.0, variance=1.0, methods=())  # is not compact
    few = compact(whole)
    kept = few.levels[0].appearances["search"].mask
    assert kept.mean() < 0.27
    ours, theirs = (shrink(each).levels[0].appearances["orientation"] for each in (few, whole))
    # Averages at the border of the mesh have few pixels.
    assert np.abs(ours.mean - theirs.mean).mean() < 0.01
    assert np.corrcoef(ours.modes.ravel(), theirs.modes.ravel())[0, 1] > 0.98


def test_templates_turn_with_their_directions(model):
    small = shrink(model)
    templates = make_templates(small)
    straight = {round(np.rad2deg(t.turn)): t for t in templates if not t.p.any()}
    assert sorted(straight) == [-20, -10, 0, 10, 20]
    # The sum of all vectors turns with the object.
    sums = {turn: complex(*template.field.sum(axis=(1, 2))) for turn, template in straight.items()}
    for turn, total in sums.items():
        # Pixels in and out of the mesh at its border change the sum a little.
        assert abs(total * np.exp(-1j * np.deg2rad(turn)) - sums[0]) < 0.03 * np.hypot(*straight[0].field).sum()


def test_soft_directions_fade_in_flat_regions():
    x = np.tile(np.arange(40, dtype=np.float32), (30, 1))
    steep, flat = soft_directions(0.5 * x, 0.0), soft_directions(1e-4 * x, 0.0)
    assert np.abs(steep[5:-5, 5:-5] - 1).max() < 0.01
    assert np.abs(flat).max() < 0.01
