"""Starts of fits of an object whose parts move: the shapes of training images."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.fitting import Fitter
from liaam.fitting.search.poses import N_ROTATIONS, posed_starts
from liaam.fitting.search.starts import start_shape
from liaam.model.shape import align, corners_of, diagonal_of
from liaam.training.poses import MOST, most_different, poses_of
from liaam.training.reliability import LeftOutImage, starts_of
from setups import disturb


def boxes_agree(shape: np.ndarray, start: np.ndarray) -> bool:
    """Whether two shapes have the same centre and diagonal."""
    centres = [np.mean(corners_of(each), axis=0) for each in (shape, start)]
    return bool(np.allclose(*centres) and np.isclose(diagonal_of(shape), diagonal_of(start)))


@pytest.fixture
def posed(calibrated):
    """A model with poses, though its object does not need them."""
    mean = calibrated.shape_model.mean
    return replace(calibrated, poses=np.array([mean, 1.1 * mean], np.float32))


def test_starts_are_the_poses_in_the_box_of_a_start(posed, lit_scene):
    start = lit_scene.landmarks
    upright = posed_starts(Fitter(posed), start, "upright")
    assert len(upright) == 2 and all(boxes_agree(shape, start) for shape in upright)
    turned = posed_starts(Fitter(posed), start, "all")
    assert len(turned) == 2 * N_ROTATIONS and all(boxes_agree(shape, start) for shape in turned)
    angles = np.sort([align(posed.shape_model.mean, shape).angle % (2.0 * np.pi) for shape in turned])
    np.testing.assert_allclose(np.diff(angles), np.pi / N_ROTATIONS, atol=1e-6)


def test_fits_in_a_box_start_from_poses_and_others_do_not(posed, calibrated, lit_scene):
    truth = lit_scene.landmarks
    box = np.concatenate(corners_of(truth))
    from_poses = Fitter(posed).fit(lit_scene.image, box)
    assert from_poses.n_starts == 2 and from_poses.status.ok
    np.testing.assert_allclose(from_poses.landmarks, truth, atol=0.1 * diagonal_of(truth))
    shape = disturb(truth)
    assert Fitter(posed).fit(lit_scene.image, shape).n_starts == 1
    assert Fitter(calibrated).fit(lit_scene.image, box).n_starts == 1


def test_poses_that_differ_most_are_kept(rng):
    mean = rng.normal(0.0, 10.0, (5, 2))
    few = mean + rng.normal(0.0, 1.0, (MOST, 5, 2))
    assert len(poses_of(few, mean)) == MOST
    many = np.concatenate([few, mean + rng.normal(0.0, 0.01, (MOST, 5, 2))])
    assert len(poses_of(many, mean)) == MOST
    # Of two clusters and one shape apart, one of each.
    shapes = np.concatenate([mean + np.zeros((4, 1, 1)), mean + np.full((4, 1, 1), 5.0), mean[None] - 9.0])
    chosen = most_different(shapes, 3)
    assert sorted(min(i // 4, 2) for i in chosen) == [0, 1, 2]


def test_left_out_images_at_the_border_are_fitted_from_boxes_in_them(posed, lit_scene):
    low, high = corners_of(lit_scene.landmarks)
    x, y = low.astype(int)
    right, bottom = np.ceil(high).astype(int)
    image = lit_scene.image[y:bottom, x:right]
    picture = LeftOutImage(posed, image, lit_scene.landmarks - (x, y))
    for number in range(40):
        for box in starts_of(picture, number=number):
            start = start_shape(posed, box, (right - x, bottom - y))  # raises StartError for one outside
            assert boxes_agree(start, box.reshape(2, 2))
