"""Learning curves: a power law is continued, and its interval holds what comes."""

import json

import numpy as np
import pytest

import liaam
from liaam.errors import LiaamError
from liaam.evaluation import LearningCurve


def curve(rng: np.random.Generator, exponent: float, m: int = 20, level: float = 0.02, **more) -> LearningCurve:
    """Errors of m pictures that fall by a power law, and differ between pictures."""
    sizes = (5, 10, 16)
    own = rng.lognormal(0, 0.3, m)
    errors = [level * size**-exponent * own * rng.lognormal(0, 0.1, m) for size in sizes]
    return LearningCurve(sizes, np.array(errors), np.zeros(3), np.full(3, np.nan), 20, "the diagonal", **more)


@pytest.mark.parametrize("exponent", [0.05, 0.25, 0.5])
def test_a_power_law_is_continued_within_the_interval(rng, exponent):
    held = 0
    for _ in range(40):
        _, low, high = curve(rng, exponent).forecast(40)
        later = 0.02 * 40**-exponent * rng.lognormal(0, 0.3, 20) * rng.lognormal(0, 0.1, 20)
        held += low <= np.median(later) <= high
    assert held >= 34  # 38 are expected; fewer than 34 in one of 30 cases


def test_many_pictures_decide_the_exponent(rng):
    measured = curve(rng, 0.5, 2000)
    error, low, high = measured.forecast()
    assert error == pytest.approx(0.02 * 40**-0.5, rel=0.05)
    assert low < error < high < 1.3 * low


def test_the_report_says_whether_more_pictures_help(rng):
    falling = curve(rng, 0.5, 500)
    assert "images are enough" not in falling.report()
    flat = curve(rng, 0.0, 500, people=0.03)
    assert "would lower the error by only 0.0" in flat.report() and "the images are enough" in flat.report()
    assert "people's landmarks are 3.00 % apart; models of 5 images or more are as near" in flat.report()
    assert "no model is as near yet" in curve(rng, 0.0, 500, people=0.001).report()


def test_the_curve_is_kept_as_numbers(rng):
    measured = curve(rng, 0.3)
    read = json.loads(measured.to_json())
    assert read["pictures"] == [5, 10, 16] and read["slope"] == [None] * 3 and read["people_percent"] is None
    assert read["forecast"]["pictures"] == 40
    assert measured.plot().get_xscale() == "log"


def test_one_size_alone_has_the_usual_exponent(rng):
    three = curve(rng, 0.3)
    one = LearningCurve((16,), three.errors[2:], three.lost[2:], three.slopes[2:], 20, "the diagonal")
    error, low, high = one.forecast()
    assert 0 < low < error < high


def test_too_few_pictures_are_refused():
    image = np.zeros((50, 50, 3), np.uint8)
    pairs = [(image.copy(), np.random.default_rng(i).uniform(5, 45, (5, 2))) for i in range(7)]
    with pytest.raises(LiaamError, match="7 pictures: a learning curve is measured from 8 pictures on"):
        liaam.evaluation.learning_curve(pairs)
