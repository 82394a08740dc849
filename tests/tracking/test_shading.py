"""A video without its shading: near the picture without it, and steady."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.errors import MethodError
from liaam.fitting import Fitter
from liaam.relighting.blending import blended
from liaam.relighting.painting import soft_edge
from liaam.tracking import Tracker
from liaam.tracking.shading import ShadingRemover, filtered
from scenes import lateral
from setups import MOVING_FRAMES, moving_scene


def under_side_light(i: int):
    return moving_scene(i / MOVING_FRAMES, lateral("left", ambient_strength=0.4))


@pytest.fixture(scope="module")
def taken_off(head_model):
    """Frames under side light, and without shading, by smoothed landmarks; of a head that holds still, with noise."""
    rng = np.random.default_rng(4)
    tracker = Tracker(head_model)
    remover = ShadingRemover(tracker.fitter)
    scene, pairs = under_side_light(2), []
    for _ in range(10):
        image = np.clip(scene.image + rng.normal(0, 4, scene.image.shape), 0, 255).astype(np.uint8)
        frame = tracker.update(image)
        pairs.append((image, remover.remove(image, tracker.result, frame.landmarks)))
    return scene, pairs


def test_the_shading_is_gone(taken_off):
    scene, pairs = taken_off
    diffuse = moving_scene(2 / MOVING_FRAMES).image.astype(float)
    for image, fresh in pairs:
        assert fresh.dtype == np.uint8
        errors = [np.abs(picture[scene.mask] - diffuse[scene.mask]).mean() for picture in (image, fresh)]
        assert errors[1] < 0.5 * errors[0]


def test_nothing_flickers(taken_off):
    scene, pairs = taken_off
    before, after = (np.array(pictures, dtype=float)[2:] for pictures in zip(*pairs, strict=True))
    assert after[:, scene.mask].std(axis=0).mean() < 0.5 * before[:, scene.mask].std(axis=0).mean()
    assert after[:, scene.mask].std(axis=0).max() < 2 * before[:, scene.mask].std(axis=0).max()


def test_far_from_the_object_nothing_changes(taken_off):
    scene, pairs = taken_off
    for image, fresh in pairs:
        changed = (image != fresh).any(axis=2)
        assert changed.mean() > 0.1
        reach = 20
        size = (2 * reach + 1, 2 * reach + 1)
        outside = ~np.lib.stride_tricks.sliding_window_view(np.pad(scene.mask, reach), size).any(axis=(2, 3))
        assert outside.mean() > 0.1
        assert not changed[outside].any()


def test_the_edge_is_soft(head_model):
    weights = soft_edge(head_model)
    picture = head_model.frame.picture(weights, 0.0)
    assert weights.min() == 0.0
    assert weights.max() == 1.0
    assert max(np.abs(np.diff(picture, axis=axis)).max() for axis in (0, 1)) < 0.5


def test_weights_of_zero_and_one():
    image = np.full((30, 30, 3), 100, np.uint8)
    painted = np.zeros((30, 30, 4), np.float32)
    assert (blended(image, painted, "srgb", 1.0) == image).all()
    painted[5:10, 5:10] = [0.0, 0.0, 0.0, 1.0]  # white
    painted[20, 20] = [-9.0, -9.0, -9.0, 0.0]
    fresh = blended(image, painted, "srgb", 1.0)
    assert (fresh[5:10, 5:10] == 255).all()
    assert (fresh[15:] == 100).all()
    fading = fresh[7, 9:16, 0].astype(int)  # the shading next to it is taken off, too, and less and less
    assert (np.diff(fading) <= 0).all()
    assert 100 < fading[1] <= 255
    assert fading[-1] == 100


def test_values_that_wander_are_filtered(rng):
    mean, variance = np.zeros(1), np.ones(1)
    found = []
    for _ in range(400):
        mean, variance = filtered(mean, variance, rng.normal(size=1), np.ones(1), np.full(1, 0.01))
        found.append(mean[0])
    assert np.std(found[50:]) < 0.4
    assert 0 < variance[0] < 1


def test_after_a_loss_it_begins_anew(head_model, moving):
    tracker = Tracker(head_model)
    remover = ShadingRemover(tracker.fitter)
    pictures = []
    for i in (0, 12):
        tracker.reset()
        frame = tracker.update(moving[i].image)
        remover.reset()
        pictures.append(remover.remove(moving[i].image, tracker.result, frame.landmarks))
    fresh = ShadingRemover(tracker.fitter).remove(moving[12].image, tracker.result, frame.landmarks)
    np.testing.assert_array_equal(pictures[1], fresh)


def test_methods_that_fit_no_logarithms_are_refused(head_model):
    with pytest.raises(MethodError, match="track with 'soft-li'"):
        ShadingRemover(Fitter(head_model, "grey"))


def test_grey_is_refused(head_model, moving):
    tracker = Tracker(head_model)
    frame = tracker.update(moving[0].image)
    grey = np.full_like(moving[0].image, 90)
    with pytest.raises(MethodError, match="grey"):
        ShadingRemover(tracker.fitter).remove(grey, tracker.result, frame.landmarks)
    with pytest.raises(MethodError, match="the model was trained on grey images"):
        ShadingRemover(Fitter(replace(head_model, is_colour=False)))
