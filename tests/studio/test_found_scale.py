"""The scale of a picture from the ruler or the scale bar in it, as the page asks for it."""

import math

import pytest

from liaam.studio.contract import ScaleQuery
from liaam.studio.found_scale import found_scale
from liaam.studio.landmark_files import parse_bar
from liaam.studio.refusal import Refusal
from scenes.ruler import draw


def asked(kind="ruler", length="1", unit="mm"):
    return ScaleQuery(kind=kind, length=length, unit=unit)


def test_a_ruler_is_a_bar_from_its_first_tick_to_its_last(rng):
    scene = draw("hierarchical", rng, size=9.7, angle=12.0)
    found = found_scale(scene.image, (640, 480), asked())
    bar = found["bar"]
    assert found["ticks"] and bar["unit"] == "mm" and bar["length"] == found["ticks"] - 1
    assert parse_bar(bar) == bar
    assert math.dist(*bar["ends"]) / bar["length"] == pytest.approx(scene.size, rel=1e-3)
    assert abs(found["pixel"] * scene.size - 1) < 5 * found["error"] < 5e-3


def test_a_scale_bar_in_a_reduced_copy_is_one_of_the_whole_picture(rng):
    scene = draw("black", rng, size=150.0)
    found = found_scale(scene.image, (1280, 960), asked("bar", "200", "µm"))
    assert found["ticks"] is None and found["bar"]["length"] == 200 and found["bar"]["unit"] == "µm"
    assert math.dist(*found["bar"]["ends"]) == pytest.approx(300, abs=3)
    assert found["pixel"] == pytest.approx(200 / 300, rel=0.01)


@pytest.mark.parametrize(
    "what, message",
    [
        (asked("coin"), "send kind, ruler or bar"),
        (asked(unit="ells"), "one of µm, mm"),
        (asked(length="-1"), "enter a positive number"),
        (asked(length="nan"), "enter a positive number"),
        (asked(), "^No ruler with 10 even ticks or more is found. If the picture shows a scale bar"),
        (asked("bar"), "could be a scale bar. If the picture shows a ruler"),
    ],
)
def test_what_is_not_clear_is_refused(what, message, rng):
    with pytest.raises(Refusal, match=message):
        found_scale(draw("none", rng, shape=(240, 320)).image, (320, 240), what)
