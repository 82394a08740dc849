"""Rulers in generated scenes: found with their period and its error, and refused where it is not clear."""

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.scale import Length, Ruler, find_ruler
from scenes.ruler import GROUNDS, RULERS, draw


@pytest.mark.parametrize("kind", RULERS)
def test_rulers_of_all_kinds_are_found(kind: str, rng: np.random.Generator) -> None:
    ground = GROUNDS[RULERS.index(kind) % len(GROUNDS)]
    scene = draw(kind, rng, ground=ground, size=11.37, angle=float(rng.uniform(-80, 80)), blur=1.0, noise=3.0)
    ruler = find_ruler(scene.image)
    assert ruler.period == pytest.approx(scene.size, rel=1e-3)
    assert abs(ruler.period - scene.size) < 5 * ruler.period_se < 5e-3 * scene.size
    assert abs((ruler.angle - scene.angle + 90) % 180 - 90) < 1
    assert ruler.n_ticks >= 25
    gaps = np.hypot(*(ruler.ends[1] - ruler.ends[0])) / (ruler.n_ticks - 1)
    assert gaps == pytest.approx(ruler.period, rel=1e-3)


@pytest.mark.parametrize("period", [15.016, 8.006])
def test_a_period_of_nearly_a_whole_number_of_pixels_is_found_as_it_is(period: float) -> None:
    y, x = np.mgrid[:160, :760].astype(float)
    number = np.rint((x - 30) / period)
    length = np.where(number % 10 == 0, 60, np.where(number % 5 == 0, 48, 36))
    is_ruler = (number >= 0) & (number <= 45) & (y > 40) & (y < 40 + length)
    away = x - 30 - number * period
    ruler = find_ruler(np.rint(230 - 200 * np.exp(-0.5 * np.square(away / 0.9)) * is_ruler).astype(np.uint8))
    assert abs(ruler.period - period) * (ruler.n_ticks - 1) < 0.005


def test_the_larger_the_image_the_same_the_ruler(rng: np.random.Generator) -> None:
    scene = draw("plain", rng, size=12.0, angle=7.0, noise=0.0)
    large = np.kron(scene.image, np.ones((4, 4, 1), np.uint8))  # 2560 pixels wide, which is reduced
    small = find_ruler(scene.image)
    found = find_ruler(large)
    assert found.period == pytest.approx(4 * small.period, rel=1e-3)
    assert abs(found.n_ticks - small.n_ticks) <= 2


@pytest.mark.parametrize("ground", GROUNDS)
def test_no_ruler_is_found_where_there_is_none(ground: str, rng: np.random.Generator) -> None:
    with pytest.raises(LiaamError, match="no ruler with 10 even ticks or more is found: crop the image to its ruler"):
        find_ruler(draw("none", rng, ground=ground, shape=(300, 400)).image)


def test_two_rulers_that_disagree_are_refused(rng: np.random.Generator) -> None:
    above = draw("plain", rng, size=9.0, shape=(300, 640)).image
    below = draw("plain", rng, size=14.0, shape=(300, 640)).image
    with pytest.raises(LiaamError, match=r"two rulers, or two sides of one, have ticks every \S+ and \S+ pixels: crop"):
        find_ruler(np.concatenate([above, below]))


def test_stripes_all_over_are_no_ruler() -> None:
    x = np.arange(640)
    stripes = np.repeat((128 + 100 * np.sign(np.sin(2 * np.pi * x / 12)))[None], 480, axis=0)
    with pytest.raises(LiaamError, match="no ruler"):
        find_ruler(stripes.astype(np.uint8))


@pytest.mark.filterwarnings("error")
def test_images_of_nothing_have_a_defined_answer(image_of_nothing: np.ndarray) -> None:
    with pytest.raises(LiaamError, match="no ruler"):
        find_ruler(image_of_nothing)


def test_the_length_of_a_pixel_has_both_errors() -> None:
    ruler = Ruler(20.0, 0.02, np.zeros((2, 2)), 30)
    assert ruler.pixel(Length(1, "mm")) == Length(0.05, "mm", 5e-5, "a ruler in the image")
    assert ruler.pixel(Length(1, "mm", 0.001)).se == pytest.approx(0.05 * np.hypot(1e-3, 1e-3))
