"""Directions of contours, and errors along and across them."""

import numpy as np

from liaam.error_measures import landmark_errors
from liaam.model.contours import (
    along_and_across,
    contour_directions,
    contour_turns,
    outline_errors,
    within_intervals,
)

ARC = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [30.0, 10.0], [30.0, 20.0]])
LINES = [((0, 1, 2), False), ((3, 4), False)]


def test_contours_have_directions_and_their_ends_and_pairs_of_points_too():
    found = contour_directions(ARC, LINES)
    np.testing.assert_allclose(found, [[1, 0], [1, 0], [1, 0], [np.nan] * 2, [np.nan] * 2])
    closed = contour_directions(np.add(ARC[:3], [[0, 0], [0, 5], [0, 0]]), [((0, 1, 2), True)])
    np.testing.assert_allclose(closed[1], [1.0, 0.0])  # from neighbour to neighbour, around the end too
    np.testing.assert_allclose(closed[0], [-np.sqrt(0.8), np.sqrt(0.2)])
    both = contour_directions(np.stack([ARC, 2 * ARC]), LINES)
    np.testing.assert_allclose(both, [found, found])


def test_landmarks_where_contours_meet_do_not_slide():
    found = contour_directions(ARC, [((0, 1, 2), False), ((2, 3, 4), False)])
    assert np.isnan(found[2]).all() and np.isfinite(found[[0, 1, 3, 4]]).all()
    assert np.isnan(contour_directions(ARC, ())).all()


def test_contours_turn_with_their_shape_and_other_landmarks_do_not():
    turned = np.asarray(ARC) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    turns, before = contour_turns(np.asarray(ARC), turned, LINES), contour_directions(ARC, LINES)
    on = np.isfinite(before[:, 0])
    assert 0 < on.sum() < len(on)
    after = np.einsum("nab,nb->na", turns[on], before[on])
    np.testing.assert_allclose(after, contour_directions(turned, LINES)[on], atol=1e-12)
    np.testing.assert_array_equal(turns[~on], np.broadcast_to(np.eye(2), turns[~on].shape))


def test_a_slide_along_a_contour_is_no_error_of_the_outline():
    shape = np.add(ARC, [[4.0, 0.0], [4.0, 3.0], [4.0, 0.0], [3.0, 4.0], [0.0, 1.0]])
    assert outline_errors(shape, ARC, LINES).tolist() == [0.0, 3.0, 4.0, 5.0, 1.0]  # beyond the end, from the end
    assert outline_errors(shape, ARC, ()).tolist() == landmark_errors(shape, ARC).tolist()
    truth = np.where(np.arange(5)[:, None] == 1, np.nan, ARC)
    np.testing.assert_array_equal(outline_errors(shape, truth, LINES), [4.0, np.nan, 4.0, 5.0, 1.0])
    assert outline_errors(np.full((5, 2), np.nan), ARC, LINES).tolist() == [np.inf] * 5


def test_errors_and_intervals_along_and_across():
    directions = contour_directions(ARC, LINES)
    errors = np.array([[1.0, 2.0], [-3.0, 0.5], [9.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    np.testing.assert_array_equal(along_and_across(errors, directions)[:2], errors[:2])
    inside = within_intervals(errors, np.tile(np.diag([4.0, 1.0]), (5, 1, 1)), directions)
    np.testing.assert_array_equal(inside, [[1, 0], [1, 1], [0, 1], [np.nan] * 2, [np.nan] * 2])


def test_a_contour_without_landmarks_says_nothing():
    shape = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    some = (((0, 1, 2), False),)
    with_none = (((), False), *some)
    np.testing.assert_array_equal(contour_directions(shape, with_none), contour_directions(shape, some))
