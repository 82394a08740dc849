"""Scale bars in saved pictures have round lengths, and are as long as they say."""

import numpy as np
import pytest
from small_projects import POINTS, put

from liaam.studio.scale_bars import bar_length, with_scale_bar


@pytest.mark.parametrize(("width", "length"), [(10.0, 2.0), (8.0, 2.0), (7.9, 1.0), (0.3, 0.05), (4000.0, 1000.0)])
def test_the_length_is_round_and_at_most_a_quarter_of_the_picture(width, length):
    assert bar_length(width) == pytest.approx(length)


@pytest.mark.parametrize("shape", [(300, 400), (30, 40), (2000, 300)])
def test_the_bar_is_as_long_as_it_says(shape):
    image = np.full((*shape, 3), 128, np.uint8)
    drawn = with_scale_bar(image, 0.05, "mm")
    assert (image == 128).all()  # the given image is left as it is
    white = (drawn == 255).all(axis=2)
    bar = white.sum(axis=1).max()  # of the row that is white longest
    assert bar == pytest.approx(bar_length(shape[1] * 0.05) / 0.05, abs=2)


def test_a_picture_knows_the_length_of_its_pixels(small):
    put(small, "p1.png", POINTS)
    assert small.pixel_length("p1.png") is None
    revision = small.marks("p1.png")["revision"]
    bar = {"ends": [[0, 0], [40, 0]], "length": 1, "unit": "cm"}
    small.save_marks("p1.png", {"points": POINTS, "revision": revision, "bar": bar})
    assert small.pixel_length("p1.png") == (0.25, "mm")
