"""Fits that failed far from their start are replaced by it: no fit is worse than the start for want of a limit."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.fitting import FitStatus, Fitter
from liaam.fitting.fallback import LEAST_OVERLAP, is_in_box, overlap, shape_without_fit, start_if_failed_far
from liaam.fitting.low_quality import is_judged
from liaam.model import SURROUNDINGS
from liaam.model.shape import mean_in_box
from setups import disturb

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (SQUARE, 1.0),
        (SQUARE + np.array([5.0, 0.0]), 1 / 3),
        (SQUARE + 10, 0.0),
        (SQUARE + 1e9, 0.0),
        (3 * SQUARE, 1 / 9),
        (SQUARE * np.nan, 0.0),
        (SQUARE * np.array([1.0, 0.0]), 0.0),
    ],
)
def test_the_overlap_of_boxes(shape, expected):
    assert overlap(shape, SQUARE) == overlap(SQUARE, shape) == pytest.approx(expected)


@pytest.fixture(scope="module")
def fit(calibrated, lit_scene):
    return Fitter(calibrated).fit(lit_scene.image, disturb(lit_scene.landmarks))


@pytest.mark.parametrize(
    "status", [FitStatus.DOUBTFUL, FitStatus.MAX_ITERATIONS, FitStatus.DIVERGED, FitStatus.LEFT_IMAGE]
)
def test_a_failed_fit_far_from_its_start_is_replaced_by_that(calibrated, fit, status):
    shapes = calibrated.views[SURROUNDINGS].shape_model
    start = fit.landmarks + 0.5 * np.ptp(fit.landmarks, axis=0)
    failed = replace(fit, status=status)
    result = start_if_failed_far(failed, start, shapes)
    np.testing.assert_array_equal(result.landmarks, start)
    np.testing.assert_array_equal(result.registered, start)
    np.testing.assert_array_equal(result.history[-1].landmarks, start)
    assert result.at_start and result.to_dict()["at_start"]
    assert result.status is status and "the landmarks are those of the start" in result.message
    np.testing.assert_allclose(result.pose(shapes.shape(result.p)), start, atol=0.2 * fit.sd.max() + 1.0)


@pytest.mark.parametrize(
    "status", [FitStatus.CONVERGED, FitStatus.LIGHT_UNOBSERVABLE, FitStatus.TOO_DARK, FitStatus.NO_TEXTURE]
)
def test_fits_that_may_be_used_stay_wherever_they_are(calibrated, fit, status):
    shapes = calibrated.views[SURROUNDINGS].shape_model
    far = replace(fit, status=status)
    assert start_if_failed_far(far, fit.landmarks + 1e4, shapes) is far


def test_a_doubtful_fit_near_its_start_stays(calibrated, fit):
    shapes = calibrated.views[SURROUNDINGS].shape_model
    doubtful = replace(fit, status=FitStatus.DOUBTFUL)
    start = disturb(fit.landmarks)
    assert overlap(start, fit.landmarks) > LEAST_OVERLAP
    assert start_if_failed_far(doubtful, start, shapes) is doubtful


def test_a_fit_to_something_else_is_where_it_was_started(calibrated, rng):
    """On a wall of noise, a box is all that is known."""
    wall = (255 * rng.random((180, 240, 3))).astype(np.uint8)
    fitter = Fitter(calibrated)
    result = fitter.fit(wall, (60, 40, 180, 150))
    assert not result.status.ok
    start = fitter.target(wall, (60, 40, 180, 150))[0].start
    assert overlap(result.landmarks, start) >= LEAST_OVERLAP


def test_fits_to_left_out_images_are_as_they_are(calibrated, rng):
    """The start of a fit in training is near the truth: a failed fit would be taken for a right one."""
    wall = (255 * rng.random((180, 240, 3))).astype(np.uint8)
    bare = calibrated.with_view(SURROUNDINGS, reliabilities={})
    assert not Fitter(bare).fit(wall, (60, 40, 180, 150)).at_start
    assert is_judged(Fitter(replace(bare, failing_methods=("soft-li",))))


def test_without_a_fit_landmarks_are_where_they_lie_in_a_box_on_average():
    start = SQUARE + 3.0
    in_box = np.array([[-0.5, -0.5], [0.4, -0.4], [0.5, 0.5], [0.0, 0.0]])
    expected = [[10, 20], [28, 21], [30, 30], [20, 25]]
    np.testing.assert_allclose(shape_without_fit((10, 20, 30, 30), start, in_box), expected)
    # Other starts say more, and not every model knows.
    assert shape_without_fit(start, start, in_box) is start
    assert shape_without_fit(None, start, in_box) is start
    assert shape_without_fit((10, 20, 30, 30), start, None) is start


def test_models_know_where_landmarks_lie_in_their_box(calibrated, rng):
    shapes = rng.normal(0.0, 1.0, (50, 4, 2)) + SQUARE
    positions = mean_in_box(shapes)
    boxes = [(shape - shape.min(axis=0)) / np.ptp(shape, axis=0) for shape in shapes]
    np.testing.assert_allclose(positions, np.mean(boxes, axis=0) - 0.5)
    assert calibrated.in_box.shape == (calibrated.n_points, 2)
    np.testing.assert_array_equal(calibrated.reflected.in_box, calibrated.in_box * [-1.0, 1.0])


def test_whether_landmarks_fill_a_box():
    assert is_in_box(SQUARE, (0, 0, 10, 10)) and is_in_box(SQUARE, (1, 1, 10, 10))
    assert not is_in_box(SQUARE, (5, 5, 15, 15)) and not is_in_box(SQUARE * np.nan, (0, 0, 10, 10))
    assert not is_in_box(SQUARE, SQUARE) and not is_in_box(SQUARE, None)
