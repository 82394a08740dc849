"""The order in which the objects of an image are read, and which of them touch."""

import numpy as np
import pytest

from liaam.trays import reading_order, touching, unplaced
from liaam.trays.order import gap, is_inside

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def grid(rows: int, columns: int, turn: float = 0.0, size: float = 60.0) -> list[np.ndarray]:
    """Give squares in rows, 100 pixels apart, turned together by degrees."""
    angle = np.deg2rad(turn)
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return [(size * SQUARE + (100 * j, 100 * i)) @ matrix.T for i in range(rows) for j in range(columns)]


@pytest.mark.parametrize("turn", [0, 4, -4, 12, -12])
@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (2, 3), (5, 4), (6, 1)])
def test_rows_are_read_from_the_left_and_the_top(rng, shape, turn):
    shapes = grid(*shape, turn=turn)
    moved = rng.permutation(len(shapes))
    order = reading_order([shapes[i] + rng.uniform(-8, 8, 2) for i in moved])
    assert [int(moved[i]) for i in order] == list(range(len(shapes)))


def test_objects_of_several_sizes_are_in_one_row():
    shapes = [40 * SQUARE + (200, 30), 100 * SQUARE, 60 * SQUARE + (300, 10), 90 * SQUARE + (50, 130)]
    assert reading_order(shapes) == [1, 0, 2, 3]


def test_objects_without_a_place_come_last():
    nothing = np.full((4, 2), np.nan)
    partly = np.concatenate([SQUARE, nothing])
    assert reading_order([nothing, SQUARE + 5, partly]) == [2, 1, 0]
    assert reading_order([]) == []


def test_touching_objects_are_found():
    apart = grid(2, 3)
    assert touching(apart) == []
    assert touching([*apart, apart[4] + (59, 0)]) == [(4, 6), (5, 6)]  # 19 pixels beyond 5's edge
    assert touching([60 * SQUARE, 60 * SQUARE + (60.5, 0)]) == [(0, 1)]
    assert touching([60 * SQUARE, 60 * SQUARE + (63, 0)]) == []
    assert touching([60 * SQUARE, np.full((4, 2), np.nan), 20 * SQUARE + 20]) == [(0, 2)]  # one lies in the other


@pytest.mark.parametrize(("shift", "right"), [((1.5, 0), 0.5), ((2, 2), np.sqrt(2)), ((0.5, 0.2), 0), ((0, 0), 0)])
def test_gaps_of_polygons(shift, right):
    assert gap(SQUARE, SQUARE + shift) == pytest.approx(right, abs=1e-6)
    assert gap(SQUARE + shift, SQUARE) == pytest.approx(right, abs=1e-6)


def test_half_of_a_shape_inside():
    assert is_inside(SQUARE, SQUARE + np.array([0.4, 0]))
    assert not is_inside(SQUARE, SQUARE + np.array([0.6, 0]))
    assert not is_inside(3 * SQUARE - 1, SQUARE)
    assert not is_inside(np.full((4, 2), np.nan), SQUARE)


@pytest.mark.parametrize(
    "place, is_placed",
    [((1, 0), True), ((2, 1), True), ((0.5, 0.5), False), ((3, 0), False), ((0, 2), False)],
)
def test_an_uncertain_object_has_a_place_in_a_row_and_a_column(place, is_placed) -> None:
    certain = [(0, 0), (2, 0), (0, 1), (1, 1)]
    shapes = [SQUARE + 300.0 * np.array(each) for each in [*certain, place]]
    assert unplaced(shapes, [True] * 4 + [False]) == ([] if is_placed else [4])
    assert unplaced([*shapes[:4], 5 * SQUARE + 300.0 * np.array(place)], [True] * 4 + [False]) == [4]  # of another size


def test_in_a_single_row_steps_are_even() -> None:
    shapes = [SQUARE + 300.0 * np.array([along, 0]) for along in (0, 1, 3, 2)]
    assert unplaced(shapes, [True] * 3 + [False]) == []
    assert unplaced([*shapes[:3], SQUARE + 300.0 * np.array([1.5, 0])], [True] * 3 + [False]) == [3]
    assert unplaced(shapes[2:], [True, False]) == []  # nothing is known


def test_two_certain_objects_at_one_place_do_not_hide_the_step() -> None:
    shapes = [SQUARE + 300.0 * np.array([along, 0]) for along in (0, 1, 1, 2, 3)]
    assert unplaced(shapes, [True] * 4 + [False]) == []
    assert unplaced([*shapes[:4], SQUARE + 300.0 * np.array([3.5, 0])], [True] * 4 + [False]) == [4]
