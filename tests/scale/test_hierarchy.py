"""Longer ticks: they tell rulers from combs, and millimetres from inches."""

import cv2
import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.scale import Length, find_ruler, hierarchy, parse_length
from liaam.scale.hierarchy import expected, may_be

FINE = 4
MILLIMETRES = {10: 1.8, 5: 1.4}  # lengths of every tenth and fifth tick
SIXTEENTHS = {16: 2.2, 8: 1.9, 4: 1.6, 2: 1.3}
ALIKE: dict[int, float] = {}


def ticks(
    canvas: np.ndarray,
    y: float,
    period: float,
    longer: dict[int, float],
    n: int = 60,
    *,
    up: bool = False,
    shortest: float = 9.0,
) -> None:
    """Draw dark ticks from the left of a canvas of fine pixels, down from a height, or up."""
    for i in range(n):
        length = shortest * next((times for step, times in longer.items() if i % step == 0), 1.0)
        rows = sorted((y, y - length if up else y + length))
        left, right = (20 + i * period + shift * 0.2 * period for shift in (-0.5, 0.5))
        box = np.rint(np.array([left, rows[0], right, rows[1]]) * FINE).astype(int)
        canvas[box[1] : box[3], box[0] : box[2]] = 20


def photograph(canvas: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    small = cv2.resize(canvas, None, fx=1 / FINE, fy=1 / FINE, interpolation=cv2.INTER_AREA).astype(float)
    return np.clip(cv2.GaussianBlur(small, (0, 0), 0.7) + rng.normal(0, 2, small.shape), 0, 255).astype(np.uint8)


def blank() -> np.ndarray:
    return np.full((300 * FINE, 640 * FINE), 220, np.uint8)


@pytest.mark.parametrize(
    "tick, longest",
    [
        ("1 mm", 10),
        ("0.5 mm", 20),
        ("0.1 in", 10),
        ("0.0625 in", 16),
        ("1.5875 mm", 16),
        ("3.175 mm", 8),
        ("0.01 mm", 10),
        ("1 in", 10),
        ("0.7 mm", 0),
    ],
)
def test_the_length_says_which_ticks_are_the_longest(tick: str, longest: int) -> None:
    assert expected(parse_length(tick)) == longest


def test_longest_ticks_that_contradict_the_length_are_told() -> None:
    assert may_be(10, 10) and may_be(16, 0) and may_be(5, 10)
    assert not may_be(16, 10) and not may_be(10, 16)  # inches and millimetres
    assert not may_be(10, 20) and not may_be(20, 10) and not may_be(8, 16)  # some are not seen, or not meant


@pytest.mark.parametrize("longer, longest", [(MILLIMETRES, 10), ({10: 1.8}, 10), (SIXTEENTHS, 16), (ALIKE, 0)])
def test_longer_ticks_are_seen(longer: dict[int, float], longest: int, rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 100, 9.0, longer, n=66)
    assert find_ruler(photograph(canvas, rng)).longest == longest


EIGHTHS = {8: 2.2, 4: 1.9, 2: 1.5}
TENTHS = {10: 2.2, 5: 1.6}


@pytest.mark.parametrize(
    "tick, longer, n",
    [("0.125 in", EIGHTHS, 19), ("0.0625 in", SIXTEENTHS, 26), ("0.0625 in", SIXTEENTHS, 20), ("0.1 in", TENTHS, 14)],
)
def test_two_inches_or_one_are_enough_beside_a_comb(tick: str, longer: dict[int, float], n: int, rng) -> None:
    canvas = blank()
    ticks(canvas, 60, 23.0, longer, n=n, shortest=24.0)
    ticks(canvas, 200, 13.0, ALIKE, n=40)
    ruler = find_ruler(photograph(canvas, rng), parse_length(tick))
    assert ruler.period == pytest.approx(23, rel=1e-3) and ruler.longest == expected(parse_length(tick))


def test_eighths_are_not_sixteenths(rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 100, 24.0, EIGHTHS, n=25, shortest=18.0)
    with pytest.raises(LiaamError, match=r"of which every 8th is the longest, and not every 16th"):
        find_ruler(photograph(canvas, rng), parse_length("0.0625 in"))


@pytest.mark.parametrize("covered", [(7, 12), (9, 11), (0, 9)])
def test_ticks_that_are_covered_do_not_hide_the_longest(covered: tuple[int, int], rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 100, 12.0, MILLIMETRES, n=41)
    left, right = (round((14 + 12 * i) * FINE) for i in covered)
    canvas[90 * FINE : 130 * FINE, left:right] = 150
    assert find_ruler(photograph(canvas, rng), Length(1, "mm")).longest == 10


def test_lengths_by_chance_are_hardly_ever_those_of_a_scale(rng: np.random.Generator) -> None:
    lengths = rng.choice([8.0, 17.0, 26.0, 39.0], (500, 16))
    assert sum(hierarchy._is_shown(each, step, True) for each in lengths for step in hierarchy.MARKS) <= 2


@pytest.mark.parametrize("slope", [0.0, 0.2])
@pytest.mark.parametrize("step", hierarchy.MARKS)
def test_lengths_of_each_scale_are_its_own(step: int, slope: float, rng: np.random.Generator) -> None:
    place = np.arange(max(2 * step + 4, 21))
    lengths = 20.0 + 8 * np.sum([place % mark == 0 for mark in hierarchy.MARKS[step]], axis=0)
    lengths = np.rint(lengths + slope * place + rng.normal(0, 0.3, len(place)))
    assert hierarchy._is_shown(lengths, step, False)
    assert not any(hierarchy._is_shown(lengths, other, True) for other in hierarchy.MARKS if other > step)


def test_the_gaps_of_short_periods_show_the_longest_ticks(rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 100, 9.0, MILLIMETRES, n=60)
    grey = photograph(canvas, rng).astype(np.float32)
    first, last = 20.0, 20.0 + 59 * 9
    for shift in (0.0, 4.5):
        ends = np.array([[first - shift, 104.0], [last + shift, 104.0]])
        assert hierarchy.longest_ticks(grey, ends, 60 + (shift > 0)) == 10


def test_short_ticks_of_half_millimetres_are_seen(rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 100, 16.0, MILLIMETRES, n=36)
    ends = np.array([[20.0, 102.0], [580.0, 102.0]])
    assert not hierarchy.has_halves(photograph(canvas, rng).astype(np.float32), ends, 36)
    for i in range(35):
        left, right = (round((28 + 16 * i + shift * 3) * FINE) for shift in (-0.5, 0.5))
        canvas[100 * FINE : 105 * FINE, left:right] = 20
    image = photograph(canvas, rng)
    assert hierarchy.has_halves(image.astype(np.float32), ends, 36)
    ruler = find_ruler(image, Length(0.5, "mm"))
    assert ruler.period == pytest.approx(8, rel=1e-3) and ruler.longest == 20


def test_numbers_beyond_the_ticks_do_not_count(rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 100, 6.0, MILLIMETRES, n=101)
    for i in range(0, 101, 20):
        left, right = (round((20 + 6 * i + shift) * FINE) for shift in (-2, 2))
        canvas[122 * FINE : 134 * FINE, left:right] = 20
    assert find_ruler(photograph(canvas, rng), Length(1, "mm")).longest == 10


def test_tenths_of_inches_are_told_from_millimetres_at_the_other_side(rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 100, 7.4, MILLIMETRES, n=80)
    ticks(canvas, 200, 18.8, MILLIMETRES, n=32, up=True)
    image = photograph(canvas, rng)
    for tick, period in ((Length(0.1, "in"), 18.8), (Length(1, "mm"), 7.4)):
        assert find_ruler(image, tick).period == pytest.approx(period, rel=2e-3)


def test_a_comb_beside_a_ruler_is_none(rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 60, 8.0, MILLIMETRES)
    ticks(canvas, 200, 13.0, ALIKE, n=40)
    assert find_ruler(photograph(canvas, rng)).period == pytest.approx(8, rel=1e-3)


@pytest.mark.parametrize("tick, period", [(Length(1, "mm"), 8.0), (Length(1 / 16, "in"), 12.7)])
def test_the_length_of_a_tick_chooses_the_side_of_a_ruler(tick: Length, period: float, rng) -> None:
    canvas = blank()
    ticks(canvas, 100, 8.0, MILLIMETRES)
    ticks(canvas, 200, 12.7, SIXTEENTHS, n=45, up=True)
    image = photograph(canvas, rng)
    assert find_ruler(image, tick).period == pytest.approx(period, rel=1e-3)
    with pytest.raises(LiaamError, match="two rulers, or two sides of one"):
        find_ruler(image)


def test_a_length_that_the_longer_ticks_contradict_is_refused(rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 100, 12.7, SIXTEENTHS, n=45)
    message = r"ticks are found every 12\.7 pixels, of which every (8|16)th is the longest, and not every 10th as where"
    with pytest.raises(LiaamError, match=message):
        find_ruler(photograph(canvas, rng), Length(1, "mm"))


def test_half_millimetres_at_the_other_side_are_the_smallest_ticks(rng: np.random.Generator) -> None:
    canvas = blank()
    ticks(canvas, 100, 16.0, MILLIMETRES, n=35)
    ticks(canvas, 200, 8.0, {20: 2.8, 10: 2.0, 2: 1.4}, n=70, up=True)
    assert find_ruler(photograph(canvas, rng), Length(0.5, "mm")).period == pytest.approx(8, rel=1e-3)


def graph_paper(period: float, heavy: int) -> np.ndarray:
    """Draw lines in both directions, of which every so many are heavier; 0 if none is."""
    canvas = blank()
    for axis in (0, 1):
        for i in range(int(canvas.shape[axis] / FINE / period)):
            half = 0.12 * period * (2.0 if heavy and i % heavy == 0 else 1.0)
            left, right = (round((2 + i * period + side * half) * FINE) for side in (-1, 1))
            np.moveaxis(canvas, axis, 0)[left:right] = 120
    return canvas


@pytest.mark.parametrize(
    "tick, heavy, is_clear",
    [
        ("1.5875 mm", 0, False),
        ("1 mm", 0, False),
        ("1 mm", 4, False),
        ("1 mm", 5, True),
        ("1 mm", 10, True),
        ("5 mm", 0, True),
    ],
)
def test_graph_paper_counts_if_its_heavier_lines_suit_the_length(tick: str, heavy: int, is_clear: bool, rng) -> None:
    image = photograph(graph_paper(9.3, heavy), rng)
    if is_clear:
        assert find_ruler(image, parse_length(tick)).period == pytest.approx(9.3, rel=1e-3)
        return
    with pytest.raises(LiaamError, match=r"are found every 9\.\d+ pixels, .*not every 1\dth (is heavier|as where)"):
        find_ruler(image, parse_length(tick))


@pytest.mark.parametrize(
    "width, length, is_ruler", [(0.5, 60, False), (0.5, 28, False), (0.3, 66, False), (0.15, 40, True), (0.5, 12, True)]
)
def test_teeth_are_wide_and_long_and_ticks_are_not(width: float, length: int, is_ruler: bool, rng) -> None:
    canvas = blank()
    for i in range(40):
        left, right = (round((60 + 12 * i + shift * 12) * FINE) for shift in (0, width))
        canvas[100 * FINE : (100 + length) * FINE, left:right] = 20
    image = photograph(canvas, rng)
    if is_ruler:
        assert find_ruler(image).period == pytest.approx(12, rel=1e-3)
        return
    with pytest.raises(LiaamError, match="no ruler"):
        find_ruler(image)
