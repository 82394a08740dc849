"""Offsets of the landmarks to one side, estimated from symmetric objects."""

import warnings

import cv2
import numpy as np
import pytest

from liaam.model import SURROUNDINGS
from liaam.model.shape import mirror_order
from liaam.photometry import CameraModel
from liaam.training import train
from liaam.training.entries import read_entries
from liaam.training.lamps import Copies
from liaam.training.symmetry import describe_offset, sideways_offset
from scenes import DIFFUSE, Head, Pose, lateral, random_expression, render

FAST = {"diagonal": 40.0, "blurs": (0.5,), "lamps": None, "leave_out": False}


def heads(light) -> list[tuple[np.ndarray, np.ndarray]]:
    """Six images of a head and their landmarks; every second image is twice as large."""
    pairs = []
    for i in range(6):
        draw = np.random.default_rng(i)
        pose = Pose(roll=draw.normal(0, 0.05), scale=draw.uniform(0.8, 1.0))
        scene = render(Head(5), pose, random_expression(draw), light, size=(160, 120))
        image, points = scene.image, scene.landmarks
        pairs.append((cv2.resize(image, None, fx=2, fy=2), 2 * points + 0.5) if i % 2 else (image, points))
    return pairs


@pytest.fixture(scope="module")
def frontal():
    return heads(DIFFUSE)


@pytest.fixture(scope="module")
def from_the_left():
    return heads(lateral("left"))


def shifted(pairs, offset: float):
    return [(image, points + np.array([offset, 0.0])) for image, points in pairs]


@pytest.fixture(scope="module")
def offset_of(frontal):
    """Give the function that estimates the offset; all of these landmarks have one mean shape."""
    shapes = train(frontal, copies=0, **FAST).views[SURROUNDINGS]
    order = mirror_order(shapes.shape_model.mean)
    assert order is not None
    return lambda pairs: sideways_offset(read_entries(pairs).entries, order, shapes.warp, CameraModel(), 0.5)


@pytest.mark.parametrize("offset", [-0.6, 1.0])
def test_an_offset_in_image_pixels_is_found(offset_of, frontal, offset):
    assert offset_of(shifted(frontal, offset)) == pytest.approx(offset, rel=0.15)


def test_without_an_offset_none_is_found(offset_of, frontal):
    assert offset_of(frontal) == 0.0


def test_light_from_one_side_is_no_offset(offset_of, from_the_left):
    assert offset_of(from_the_left) == 0.0


def test_training_says_in_one_line_that_mirrored_copies_allow_for_it(frontal, monkeypatch):
    seen, of_picture = [], Copies.of_picture
    monkeypatch.setattr(Copies, "of_picture", lambda self, *a: seen.append(self.offset) or of_picture(self, *a))
    with pytest.warns(UserWarning, match=r"^the landmarks lie 0\.[67] pixels to the left of where") as caught:
        train(shifted(frontal, -0.6), **FAST)
    assert len(caught) == 1 and caught[0].filename == __file__
    assert seen == pytest.approx([-0.6] * 6, rel=0.15)
    assert "to the right" in describe_offset(0.5)


def test_asymmetric_objects_and_training_without_copies_are_left_alone(frontal):
    left = [(image, points[5:]) for image, points in shifted(frontal, 1.0)]
    assert mirror_order(left[0][1]) is None
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        train(left, **FAST)
        train(shifted(frontal, 1.0), copies=0, **FAST)
