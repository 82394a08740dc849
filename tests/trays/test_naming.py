"""Names of specimens by position, by the codes beside them, and after the only code."""

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.trays import Code, check_name_by, name_specimens
from tests.trays.test_order import SQUARE, grid


def codes_at(places, texts) -> list[Code]:
    return [Code(text, 20 * SQUARE + place) for place, text in zip(places, texts, strict=True)]


def below(shapes, gap: float) -> list[np.ndarray]:
    """Give places of codes of 20 pixels below shapes of 60."""
    return [shape.min(axis=0) + np.array([20, 60 + gap]) for shape in shapes]


def names(named) -> list[str]:
    return [each.name for each in named]


def test_positions_are_numbers():
    named, faults = name_specimens(grid(2, 3), [], "tray")
    assert names(named) == ["tray#1", "tray#2", "tray#3", "tray#4", "tray#5", "tray#6"]
    assert faults == [] and not any(each.code for each in named)
    assert names(name_specimens(grid(1, 1), [], "leaf", single=True)[0]) == ["leaf"]


@pytest.mark.parametrize("gap", [2, 8, 10, 15])  # 10 is in the middle between two rows
def test_each_is_named_by_its_code(rng, gap):
    shapes = grid(2, 3)
    codes = codes_at(below(shapes, gap), "ABCDEF")
    rng.shuffle(codes)
    named, faults = name_specimens(shapes, codes, "tray", "code")
    assert names(named) == list("ABCDEF") == [each.code for each in named]
    assert faults == []


def test_a_code_that_is_not_read_leaves_a_position():
    shapes = grid(2, 3)
    codes = codes_at(below(shapes, 3), "ABCDEF")
    named, faults = name_specimens(shapes, codes[:4] + codes[5:], "tray", "code")
    assert names(named) == ["A", "B", "C", "D", "tray#5", "F"]
    assert faults == ["positions name tray#5 (no code is beside it)"]


def test_what_may_belong_to_two_specimens_names_none():
    shapes = grid(2, 1)
    named, faults = name_specimens(shapes, codes_at(below(shapes[:1], 10), "A"), "tray", "code")
    assert [each.code for each in named] == ["", ""]
    assert "the code 'A' may be another's" in faults[0]
    one = name_specimens([shapes[1]], codes_at(below(shapes, 10), "AB"), "tray", "code")
    assert names(one[0]) == ["tray#1"] and "may be another's" in one[0][0].fault


def test_a_code_at_two_places_names_none():
    shapes = grid(1, 3)
    named, faults = name_specimens(shapes, codes_at(below(shapes, 3), "ABA"), "tray", "code")
    assert names(named) == ["tray#1", "B", "tray#3"]
    assert faults[0] == "the code 'A' is at 2 places, so that it names no specimen"
    assert "several places" in named[0].fault and "several places" in named[2].fault


def test_codes_without_a_specimen_are_said():
    shapes = grid(1, 2)
    codes = codes_at([*below(shapes, 3), np.array([600.0, 600.0])], "ABT")
    named, faults = name_specimens(shapes, codes, "tray", "code")
    assert names(named) == ["A", "B"]
    assert faults == ["no specimen is beside the code 'T'"]


def test_the_only_code_names_the_photograph():
    shapes = grid(1, 2)
    label = codes_at([np.array([600.0, 600.0])], "T")
    assert names(name_specimens(shapes, label, "tray", "label")[0]) == ["T#1", "T#2"]
    assert names(name_specimens(shapes, label * 2, "tray", "label")[0]) == ["T#1", "T#2"]  # printed twice
    assert names(name_specimens(shapes[:1], label, "tray", "label", single=True)[0]) == ["T"]
    named, faults = name_specimens(shapes, codes_at(below(shapes, 3), "AB"), "tray", "label")
    assert names(named) == ["tray#1", "tray#2"]
    assert faults == ["2 codes (A, B) where one names the photograph, so that positions name them"]


@pytest.mark.parametrize("by", ["code", "label"])
def test_no_code_is_said(by):
    named, faults = name_specimens(grid(1, 2), [], "tray", by)
    assert names(named) == ["tray#1", "tray#2"]
    assert faults == ["no code is read, so that positions name the specimens"]


def test_specimens_without_a_place_have_no_code():
    shapes = [np.full((4, 2), np.nan), np.zeros((4, 2)), 60 * SQUARE]
    named, _ = name_specimens(shapes, codes_at(below(shapes[2:], 3), "A"), "tray", "code")
    assert names(named) == ["tray#1", "tray#2", "A"]


def test_unknown_ways_are_refused():
    with pytest.raises(LiaamError, match="named by position, code, label, not by 'size'"):
        check_name_by("size")
