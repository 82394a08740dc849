"""A video without its shading: near the picture without it, and steady."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.errors import MethodError
from liaam.fitting import Fitter
from liaam.relighting.painting import log_light
from liaam.tracking import Tracker
from liaam.tracking.shading import ShadingRemover
from scenes import lateral
from setups import MOVING_FRAMES, moving_scene


def under_side_light(i: int):
    return moving_scene(i / MOVING_FRAMES, lateral("left", ambient_strength=0.4))


@pytest.fixture(scope="module")
def taken_off(head_model):
    return without_shading(head_model, 10)


def without_shading(model, n):
    """Frames under side light, and without shading, by smoothed landmarks; of a head that holds still, with noise."""
    rng = np.random.default_rng(4)
    tracker = Tracker(model)
    remover = ShadingRemover(tracker.fitter)
    scene, pairs = under_side_light(2), []
    for _ in range(n):
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
    """What varies is the noise of the frames, which a multiplication leaves as it is in logarithms."""
    scene, pairs = taken_off
    before, after = (
        np.array([log_light(each, "srgb")[scene.mask].mean(axis=1) for each in pictures])[2:]
        for pictures in zip(*pairs, strict=True)
    )
    assert after.std(axis=0).mean() < 1.02 * before.std(axis=0).mean()
    assert after.mean(axis=1).std() < 0.02


def test_far_from_the_object_nothing_changes_without_lamps(head_model):
    """What is learnt from lamps reaches beyond the mesh."""
    scene, pairs = without_shading(replace(head_model, light=None), 2)
    for image, fresh in pairs:
        changed = (image != fresh).any(axis=2)
        assert changed.mean() > 0.1
        reach = 20
        size = (2 * reach + 1, 2 * reach + 1)
        outside = ~np.lib.stride_tricks.sliding_window_view(np.pad(scene.mask, reach), size).any(axis=(2, 3))
        assert outside.mean() > 0.1
        assert not changed[outside].any()


def test_what_moves_is_of_each_frame(taken_off, head_model):
    """A mark that appears in one frame is there, and gone in the next."""
    scene, _ = taken_off
    tracker = Tracker(head_model)
    remover, pictures = ShadingRemover(tracker.fitter), []
    frame = tracker.update(scene.image)
    x, y = frame.landmarks.mean(axis=0).astype(int)
    marked = scene.image.copy()
    marked[y - 2 : y + 3, x - 2 : x + 3] = [20, 200, 20]
    pictures = [remover.remove(each, tracker.result, frame.landmarks) for each in (scene.image, marked, scene.image)]
    greener = [int(each[y, x, 1]) - int(each[y, x, 0]) for each in pictures]
    assert greener[1] > 100
    assert abs(greener[2] - greener[0]) < 15


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
    with pytest.raises(MethodError, match="use 'soft-li'"):
        ShadingRemover(Fitter(head_model, "grey"))


def test_grey_is_refused(head_model, moving):
    tracker = Tracker(head_model)
    frame = tracker.update(moving[0].image)
    grey = np.full_like(moving[0].image, 90)
    with pytest.raises(MethodError, match="grey"):
        ShadingRemover(tracker.fitter).remove(grey, tracker.result, frame.landmarks)
    with pytest.raises(MethodError, match="the model was trained on grey images"):
        ShadingRemover(Fitter(replace(head_model, is_colour=False)))
