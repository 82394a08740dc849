"""Lengths with units, as people write them, and which of a batch are unlike the others."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam.errors import LiaamError
from liaam.scale import UNITS, Length, lengths, parse_length, unlike


@pytest.mark.parametrize(
    ("text", "value", "unit", "se"),
    [
        ("0.0031 mm", 0.0031, "mm", 0),
        ("0.0031mm", 0.0031, "mm", 0),
        (" 3.1 um ", 3.1, "um", 0),
        ("3.1µm", 3.1, "um", 0),
        ("3.1 μm/px", 3.1, "um", 0),
        ("3.1 microns per pixel", 3.1, "um", 0),
        (".5 Millimetres", 0.5, "mm", 0),
        ("5e-3 cm", 0.005, "cm", 0),
        ("1 inch", 1, "in", 0),
        ("0.0031 ± 0.0001 mm", 0.0031, "mm", 0.0001),
        ("0.0031+-0.0001mm", 0.0031, "mm", 0.0001),
        ("3.1 +/- 0.1 um", 3.1, "um", 0.1),
        ("0,0031 ± 0,0001 mm", 0.0031, "mm", 0.0001),
        ("0,005 mm", 0.005, "mm", 0),
        ("12,345678 mm", 12.345678, "mm", 0),
        ("250 px/mm", 0.004, "mm", 0),
        ("250,5 px/mm", 1 / 250.5, "mm", 0),
        ("250 pixels per mm", 0.004, "mm", 0),
        ("254 dpi", 0.1, "mm", 0),
        ("0.012", 0.012, "", 0),
        ("5", 5, "", 0),
    ],
)
def test_lengths_as_people_write_them(text: str, value: float, unit: str, se: float) -> None:
    length = parse_length(text)
    assert (length.value, length.unit, length.se) == (pytest.approx(value), unit, se)


WRONG = ["", "mm", "0 mm", "-1 mm", "nan", "inf mm", "1e999", "5 apples", "5 mm 3", "0 dpi", "5 px/apple"]
COMMAS = ["0,5,1 mm", "1.000,5 mm"]  # of what is no decimal comma


@pytest.mark.parametrize("text", [*WRONG, *COMMAS, "1" * 5000, "1 ± mm", "1 ± -1 mm"])
def test_what_is_no_length_is_named_with_the_remedy(text: str) -> None:
    with pytest.raises(LiaamError, match=r"length '.*': give a positive number and its unit, such as 0\.0031 mm"):
        parse_length(text)


def test_a_comma_that_may_separate_thousands_is_refused_with_both_meanings() -> None:
    with pytest.raises(LiaamError, match=r"'1,250' may be 1\.250 or 1250: write one of these"):
        parse_length("1,250 mm")


@given(st.sampled_from(sorted(UNITS)), st.sampled_from(sorted(UNITS)), st.floats(1e-6, 1e6))
def test_there_and_back_in_another_unit(unit: str, other: str, value: float) -> None:
    length = Length(value, unit, value / 10)
    back = length.within(other).within(unit)
    assert (back.value, back.se) == (pytest.approx(value), pytest.approx(value / 10))
    assert length.within(other).value * UNITS[other] == pytest.approx(value * UNITS[unit])


@pytest.mark.parametrize("arguments", [(0.0,), (math.nan,), (1.0, "mm", -1.0), (1.0, "mm", math.inf), (1.0, "miles")])
def test_lengths_that_are_none(arguments: tuple) -> None:
    with pytest.raises(LiaamError):
        Length(*arguments)


def test_scales_unlike_the_others_of_a_batch() -> None:
    same = [0.01] * 9
    assert unlike([*same, 0.0101]).tolist() == [False] * 10  # 1 %: rounding, or a ruler read a little differently
    assert unlike([*same, 0.1]).tolist() == [False] * 9 + [True]
    assert unlike([*same, math.nan, 0.001]).tolist() == [False] * 10 + [True]
    by_hand = np.exp(np.linspace(-0.3, 0.3, 9))
    assert not unlike(by_hand.tolist()).any()
    assert unlike([*by_hand, 10.0]).tolist() == [False] * 9 + [True]
    assert not unlike([0.01] * 5 + [0.02] * 5).any()  # two set-ups
    assert not unlike([0.01, 0.01, 0.01, 5.0]).any()  # too few
    assert not unlike([]).any()


@pytest.mark.parametrize("free, factor", [(9.0, 1.154), (1e6, 1.0)])
def test_errors_of_few_degrees_of_freedom_are_widened(free: float, factor: float) -> None:
    assert lengths.widened(free) == pytest.approx(factor, abs=1e-3)
