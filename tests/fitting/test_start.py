"""Where a fit starts: a shape, a box, or a point and a size."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from liaam.errors import StartError
from liaam.fitting.low_quality import region_of
from liaam.fitting.search.starts import start_shape
from liaam.io import Landmarks
from liaam.model.shape import diagonal_of

SIZE = (180, 240)


@pytest.fixture
def shape(model) -> np.ndarray:
    return model.shape_model.mean * 1.3 + [90, 120]


def test_a_shape_is_taken_as_it_is(model, shape):
    np.testing.assert_array_equal(start_shape(model, shape, SIZE), shape)


def test_missing_landmarks_are_filled_in_from_the_mean(model, shape):
    holed = shape.copy()
    holed[5:40] = np.nan
    np.testing.assert_allclose(start_shape(model, holed, SIZE), shape, atol=1e-9)


def test_a_box_gives_centre_and_diagonal(model):
    shape = start_shape(model, (40, 60, 120, 160), SIZE)
    np.testing.assert_allclose(0.5 * (shape.min(axis=0) + shape.max(axis=0)), [80, 110])
    assert diagonal_of(shape) == pytest.approx(np.hypot(80, 100))


def test_a_point_and_a_size(model):
    shape = start_shape(model, (80, 110, 90), SIZE)
    np.testing.assert_allclose(0.5 * (shape.min(axis=0) + shape.max(axis=0)), [80, 110])
    assert diagonal_of(shape) == pytest.approx(90)


def straying(far: float) -> np.ndarray:
    shape = np.linspace(20, 150, 116).reshape(58, 2)
    shape[7, 1] = far
    return shape


def beside(right: float) -> np.ndarray:
    shape = np.linspace(20, 150, 116).reshape(58, 2)
    shape[6:, 0] = right
    return shape


def few(n_numbers: int) -> np.ndarray:
    shape = np.full((58, 2), np.nan)
    shape[:n_numbers] = 50
    return shape


@pytest.mark.parametrize(
    ("init", "match"),
    [
        (np.zeros((57, 2)), "57 landmarks but the model has 58"),
        (few(2), "only 2 of the start's landmarks are finite; give at least 3"),
        (few(0), "only 0 of the start's landmarks"),
        ((10, 10, 10, 50), "the box 10, 10, 10, 50 is empty"),
        ((50, 50, 10, 10), "is empty"),
        ((0, 0, np.nan, 10), "is empty"),
        ((50, 50, 0), "a positive size"),
        ((50, np.nan, 10), "a positive size"),
        ((50, 50), r"a start of shape \(2,\) is neither"),
        (7, "is neither landmarks"),
        ("middle", "is not a shape, box, or point"),
        (Path("new.pts"), r"'new\.pts' is not a shape, .*; for a landmark file give liaam\.read_landmarks\(path\)"),
        (None, "neither|is not a shape"),
        ((5000, 5000, 80), "lies outside the image .*180×240 pixels"),
        ((-500, 20, -400, 120), "lies outside the image"),
        (np.full((58, 2), 1e9), "lies outside the image"),
        (beside(SIZE[0] - 0.5), "lies outside the image"),  # the centre of the last pixel is at 179
        (np.full((58, 2), 80.0), "only 0.0 pixels large"),
        ((80, 80, 1e-300), "only 0.0 pixels large"),
        (straying(1e5), "the start is 417 times as large as the image"),
        (straying(-1e30), "times as large as the image"),
        (straying(1e308), "times as large as the image"),
    ],
)
def test_a_start_that_makes_no_sense_is_refused(model, init, match):
    with pytest.raises(StartError, match=f"portrait.*({match})"):
        start_shape(model, init, SIZE, "portrait")


def test_landmarks_at_the_last_pixel_lie_inside(model):
    shape = beside(SIZE[0] - 1)
    shape[0, 0] = -1  # so that not all of them do
    np.testing.assert_array_equal(start_shape(model, shape, SIZE), shape)


def test_the_region_around_a_box_ends_with_the_image():
    low, high = region_of((0, 0, 179, 239), np.zeros((*SIZE[::-1], 3), np.uint8))
    np.testing.assert_array_equal([low, high], [(0, 0), SIZE])


def test_names_decide_the_order_of_a_start(model, shape):
    names = tuple(f"p{i}" for i in range(len(shape)))
    named, order = replace(model, landmark_names=names), [1, 0, *range(2, len(shape))]
    other = Landmarks(shape[order], names=tuple(names[i] for i in order))
    np.testing.assert_array_equal(start_shape(named, other, (10_000, 10_000)), shape)
    with pytest.raises(StartError, match="the start cannot be used: its names lack p0"):
        start_shape(named, Landmarks(shape, names=("other", *names[1:])), (10_000, 10_000))
