"""Which pixels and landmarks are in a part that is absent."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from liaam.fitting import Fitter
from liaam.fitting.quality import Surroundings
from liaam.fitting.quality.segmentation import segmented
from liaam.io.landmarks.base import PRESENT
from liaam.model.presence import Presence


@pytest.fixture(scope="module")
def objective(calibrated):
    return Fitter(calibrated).objectives[-1]


@pytest.fixture(scope="module")
def surroundings(objective):
    return Surroundings(objective)


@pytest.fixture
def expected(surroundings, rng):
    """Gradients of a fit."""
    return rng.normal(0.0, 0.4, (len(surroundings.weights), 2))


@pytest.fixture
def hole(surroundings):
    """Distances of pixels and landmarks from the edge of a hole about a landmark, in diagonals, less than 0 in it."""
    warp = surroundings.objective.warp
    diagonal = np.hypot(*np.ptp(warp.rest, axis=0))
    centre = warp.rest[0]
    places = warp.points(np.zeros(warp.n_parameters))
    return [np.linalg.norm(each - centre, axis=1) / diagonal - 0.15 for each in (places, warp.rest)]


def seen_as(surroundings, expected, rng):
    """Gradients of an image that differ from those expected as much as the model's errors."""
    return expected + rng.normal(size=expected.shape) * np.sqrt(surroundings.error_variances)[:, None]


def solution_of(surroundings, seen, expected):
    """A solution with gradients of the image and those of the fit."""
    rows = np.zeros((2, len(seen), surroundings.objective.method.n_rows), np.float32)
    rows[0, :, :2] = seen
    rows[1, :, :2] = seen - expected
    return SimpleNamespace(samples=rows[0].ravel(), residual=rows[1].ravel(), usable=np.ones(len(seen), np.float32))


def test_all_of_an_image_as_expected_is_present(surroundings, expected, rng):
    found = segmented(surroundings, seen_as(surroundings, expected, rng), expected)
    assert (found.landmarks > 0.9).all() and (found.pixels > 0.8).all()


@pytest.mark.parametrize("of", ["blank", "other"])
def test_what_is_in_a_hole_is_absent_and_what_is_beside_it_present(surroundings, expected, hole, rng, of):
    of_pixels, of_landmarks = hole
    other = np.zeros_like(expected) if of == "blank" else rng.normal(0.0, 0.4, expected.shape)
    seen = np.where(of_pixels[:, None] < 0.0, other, seen_as(surroundings, expected, rng))
    found = segmented(surroundings, seen, expected)
    assert (found.landmarks[of_landmarks < -0.03] < PRESENT).all()
    assert (found.landmarks[of_landmarks > 0.04] > PRESENT).all()
    assert ((found.pixels < PRESENT) == (of_pixels < 0.0)).mean() > 0.9


def test_a_strong_edge_does_not_hide_the_landmarks_beside_it(surroundings, expected, hole, rng):
    """They are absent by their windows, which contain the edge."""
    of_pixels, of_landmarks = hole
    seen = np.where(of_pixels[:, None] < 0.0, 0.0, seen_as(surroundings, expected, rng))
    seen[np.abs(of_pixels) < 0.01] = [0.7, 0.7]
    found = segmented(surroundings, seen, expected)
    assert (found.landmarks[of_landmarks > 0.05] > PRESENT).all()


def test_landmarks_are_judged_by_windows_where_the_models_errors_are_unknown(objective, surroundings, expected):
    unknown = replace(objective, appearance=replace(objective.appearance, unexplained=None))
    unknown.__dict__["fields"] = objective.fields
    windows = Surroundings(unknown)
    assert surroundings.can_segment and not windows.can_segment
    n = len(objective.warp.rest)
    ones = np.ones(n)
    presence = Presence(usual=2.0 * ones, other=0.0 * ones, variances=0.1 * ones, contrasts=0.0 * ones, spreads=ones)
    rows = np.column_stack([expected, np.zeros(len(expected))])[:, : objective.method.n_rows].astype(np.float32)
    right = SimpleNamespace(samples=rows.ravel(), residual=0.0 * rows.ravel(), usable=np.ones(len(rows), np.float32))
    assert windows.present_pixels(presence, right).mean() > 0.95
    np.testing.assert_array_equal(windows.probabilities(presence, right), surroundings.probabilities(presence, right))


@pytest.mark.parametrize("radius", [0.0, 0.07, 0.25])
def test_a_small_hole_is_seen_where_windows_have_nothing_to_compare(surroundings, expected, hole, rng, radius):
    """In a larger one are landmarks that windows can judge."""
    of_pixels, of_landmarks = (distance + 0.15 - radius for distance in hole)
    seen = np.where(of_pixels[:, None] < 0.0, 0.0, seen_as(surroundings, expected, rng))
    all_present = SimpleNamespace(probabilities=lambda _: np.full(len(of_landmarks), 0.999))
    absent = surroundings.probabilities(all_present, solution_of(surroundings, seen, expected)) < PRESENT
    is_seen = (of_landmarks < -0.03) & (radius < 0.1)
    assert absent[is_seen].all()
    assert not absent[(of_landmarks > 0.04) | (radius > 0.1)].any()
