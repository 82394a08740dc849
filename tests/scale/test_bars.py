"""Scale bars in generated scenes: found with their length and its error, and refused where it is not clear."""

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.scale import Bar, Length, find_bar
from scenes.ruler import BARS, GROUNDS, draw


@pytest.mark.parametrize("kind", BARS)
@pytest.mark.parametrize("ground", ["paper", "cloudy", "gradient"])
def test_bars_of_all_kinds_are_found(kind: str, ground: str, rng: np.random.Generator) -> None:
    scene = draw(kind, rng, ground=ground, size=181.3, angle=float(rng.uniform(-80, 80)), blur=0.8)
    bar = find_bar(scene.image)
    assert abs(bar.length - scene.size) < 4 * bar.length_se
    assert bar.length_se < (2.0 if kind == "ended" else 0.3)
    assert abs((bar.angle - scene.angle + 90) % 180 - 90) < 1
    assert np.hypot(*(bar.ends[1] - bar.ends[0])) == pytest.approx(bar.length)


@pytest.mark.parametrize("ground", GROUNDS)
def test_no_bar_is_found_where_there_is_none(ground: str, rng: np.random.Generator) -> None:
    with pytest.raises(LiaamError, match="no even, straight stroke with sharp ends is found"):
        find_bar(draw("none", rng, ground=ground).image)


def test_two_bars_that_disagree_are_refused_and_one_printed_twice_is_not(rng: np.random.Generator) -> None:
    above = draw("black", rng, size=150.0, shape=(200, 640)).image
    with pytest.raises(LiaamError, match=r"several strokes may be the scale bar, of 150\.\d and 90\.\d pixels: crop"):
        find_bar(np.concatenate([above, draw("black", rng, size=90.0, shape=(200, 640)).image]))
    assert find_bar(np.concatenate([above, above])).length == pytest.approx(150, abs=0.3)


def test_a_stroke_that_is_cut_by_the_border_is_no_bar(rng: np.random.Generator) -> None:
    scene = draw("black", rng, size=400.0)
    with pytest.raises(LiaamError, match="no even, straight stroke"):
        find_bar(scene.image[:, :320])


@pytest.mark.filterwarnings("error")
def test_images_of_nothing_have_a_defined_answer(image_of_nothing: np.ndarray) -> None:
    with pytest.raises(LiaamError, match="no even, straight stroke"):
        find_bar(image_of_nothing)


def test_the_length_of_a_pixel_has_both_errors() -> None:
    bar = Bar(200.0, 0.2, np.zeros((2, 2)))
    pixel = bar.pixel(Length(5, "mm"))
    assert (pixel.value, pixel.unit, pixel.source) == (0.025, "mm", "a scale bar in the image")
    assert pixel.se == pytest.approx(2.5e-5)
