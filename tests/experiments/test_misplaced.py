"""Misplaced landmarks of made specimens."""

import numpy as np

from experiments.misplaced import found_in_faces, found_in_specimens, specimens
from liaam.model.shape import diagonal_of


def test_a_moved_point_is_found_and_nothing_else():
    assert found_in_specimens(7, 3, 1) == {"false": 0, "specimen": 1, "point": 1}


def test_shares_of_moved_points():
    made = specimens(np.random.default_rng(2), 12, 40)
    found = found_in_faces(made, diagonal_of, 2, 3, 35)
    assert found["far points named"] > 0.9
    assert found["right points named"] < 0.01 and found["without moves"] == 0
