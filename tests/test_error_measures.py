"""Measures of how well landmarks and angles were found."""

import numpy as np
import pytest

from liaam.error_measures import (
    angle_difference,
    cumulative_errors,
    error_statistics,
    nme,
    point_error,
)


def test_point_error_leaves_out_unknown_landmarks_and_counts_lost_ones():
    truth = np.array([[0.0, 0.0], [np.nan, 1.0], [10.0, 0.0]])
    shape = np.array([[3.0, 4.0], [99.0, 99.0], [10.0, 1.0]])
    assert point_error(shape, truth) == 3.0
    assert nme(shape, truth, 60.0) == 0.05
    shape[2] = np.nan
    assert point_error(shape, truth) == np.inf


def test_statistics_count_lost_fits_as_failures():
    assert error_statistics(np.array([3.0, 4.0, 0.0])) == {
        "median": 3.0,
        "p90": pytest.approx(3.8),
        "rms": pytest.approx(np.sqrt(25 / 3)),
    }
    lost = error_statistics(np.array([1.0, 2.0, 3.0, np.nan]))
    assert lost == {"median": 2.5, "p90": None, "rms": None}
    assert set(error_statistics(np.array([np.nan, np.inf])).values()) == {None}


@pytest.mark.parametrize(
    ("angle", "expected"), [(0.1, 0.1), (-0.1, -0.1), (2 * np.pi, 0.0), (np.pi, np.pi), (4.0, 4.0 - 2 * np.pi)]
)
def test_angles_differ_by_half_a_turn_at_most(angle, expected):
    assert angle_difference(2.5 + angle, 2.5) == pytest.approx(expected, abs=1e-12)


def test_cumulative_errors_count_nan_as_failure():
    assert np.allclose(cumulative_errors(np.array([0.1, np.nan, 0.3, 0.2]), np.array([0.05, 0.2, 1.0])), [0, 0.5, 0.75])
