"""Boxes of crops around landmarks."""

import numpy as np
import pytest

from liaam.trays import crop_box

POINTS = np.array([[20.0, 30.0], [50.0, 70.0], [30.2, 50.7]])  # with a diagonal of 50


@pytest.mark.parametrize(
    ("size", "margin", "box"),
    [((200, 200), 0.1, (15, 25, 56, 76)), ((200, 200), 0.0, (20, 30, 51, 71)), ((52, 72), 1.0, (0, 0, 52, 72))],
)
def test_the_box_has_a_margin_inside_the_image(size, margin, box):
    assert crop_box(POINTS, size, margin) == box


def test_nothing_in_the_image_is_no_crop():
    assert crop_box(POINTS, (10, 10)) is None
    assert crop_box(np.full((3, 2), np.nan), (100, 100)) is None
    lacking = np.concatenate([POINTS, [[np.nan, np.nan]]])
    assert crop_box(lacking, (200, 200)) == crop_box(POINTS, (200, 200))
