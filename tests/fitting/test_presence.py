"""How well image and fit agree around landmarks, and what that makes of them."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.fitting import Fitter
from liaam.fitting.quality import Surroundings
from liaam.model.mirror import mirrored_model
from liaam.model.presence import PRIOR_ODDS, Agreement, Presence, fisher_z
from liaam.model.shape import mirror_order

KNOWN = Presence(
    usual=fisher_z(np.array([0.9, 0.9, 0.0])),
    other=np.zeros(3),
    variances=np.full(3, 0.07),
    contrasts=np.zeros(3),
    spreads=np.full(3, 0.1),
)


@pytest.fixture(scope="module")
def surroundings(calibrated):
    """Windows of the sharpest level of a small model."""
    return Surroundings(Fitter(calibrated).objectives[-1])


def rows(surroundings, gradients):
    """Samples of all rows from gradients (n, 2); the third row is colour, which does not count."""
    return np.column_stack([gradients, np.full(len(gradients), 7.0)])


def test_an_image_as_expected_agrees_and_another_does_not(surroundings, rng):
    n = len(surroundings.objective.appearance.mean)
    expected = rows(surroundings, rng.normal(0.0, 0.5, (n, 2)))
    seen = np.ones(n)
    same = surroundings.compared(expected, 0.0 * expected, seen).landmarks
    assert (same.concordances > 0.9).all()
    np.testing.assert_allclose(same.contrasts, 0.0, atol=1e-9)
    opposite = surroundings.compared(-expected, -2.0 * expected, seen).landmarks
    np.testing.assert_allclose(opposite.concordances, -same.concordances)
    other = rows(surroundings, rng.normal(0.0, 0.5, (n, 2)))
    assert np.abs(surroundings.compared(other, other - expected, seen).landmarks.concordances).max() < 0.5


def test_blank_and_unseen_places_agree_with_nothing(surroundings, rng):
    n = len(surroundings.objective.appearance.mean)
    expected = rows(surroundings, rng.normal(0.0, 0.5, (n, 2)))
    blank = surroundings.compared(0.0 * expected, -expected, np.ones(n)).landmarks
    unseen = surroundings.compared(
        np.full_like(expected, np.nan), np.full_like(expected, np.nan), np.zeros(n)
    ).landmarks
    np.testing.assert_array_equal(blank.concordances, 0.0)
    np.testing.assert_array_equal(unseen.concordances, 0.0)
    assert (blank.contrasts < -1.0).all()


def test_a_hole_is_seen_around_the_landmarks_in_it_only(surroundings):
    warp = surroundings.objective.warp
    places = warp.points(np.zeros(warp.n_parameters))
    expected = rows(surroundings, np.full((len(places), 2), 0.5))
    hole = warp.rest[0]
    size = np.hypot(*np.ptp(warp.rest, axis=0))
    apart = np.linalg.norm(places - hole, axis=1)
    samples = np.where(apart[:, None] < 0.1 * size, 0.0, expected)
    agreement = surroundings.compared(samples, samples - expected, np.ones(len(places)))
    of_landmarks = agreement.landmarks.concordances
    far = np.linalg.norm(warp.rest - hole, axis=1) > 0.2 * size
    assert of_landmarks[0] < 0.1
    assert (of_landmarks[far] > 0.9).all()
    assert (agreement.pixels.concordances[apart > 0.2 * size] > 0.9).all()
    assert (agreement.pixels.concordances[apart < 0.03 * size] < 0.2).all()


def test_a_mirrored_model_has_the_mirrored_calibration(calibrated):
    order = mirror_order(calibrated.shape_model.mean)
    presence = Fitter(calibrated).presence
    mirrored = Fitter(mirrored_model(replace(calibrated, light=None), order)).presence
    for name, values in vars(presence).items():
        np.testing.assert_array_equal(getattr(mirrored, name), values[order])


def test_probabilities_rise_with_agreement():
    def at(concordances):
        return KNOWN.probabilities(Agreement(np.array(concordances), np.zeros(3)))

    assert (at([0.9, 0.9, 0.9])[:2] > 0.98).all()
    assert (at([0.0, 0.3, 0.0])[:2] < 0.1).all()
    assert at([0.6, 0.7, 0.0])[0] < at([0.7, 0.7, 0.0])[0]


def test_a_landmark_whose_surroundings_do_not_tell_is_as_likely_as_before():
    likely = KNOWN.probabilities(Agreement(np.array([0.9, 0.9, -0.5]), np.zeros(3)))
    assert likely[2] == pytest.approx(PRIOR_ODDS / (1.0 + PRIOR_ODDS))


def test_a_loss_of_contrast_counts_only_beside_the_others():
    concordances = np.array([0.62, 0.9, 0.05])
    usual = KNOWN.probabilities(Agreement(concordances, np.zeros(3)))
    all_dim = KNOWN.probabilities(Agreement(concordances, np.full(3, -2.0)))
    blank = KNOWN.probabilities(Agreement(concordances, np.array([-2.0, 0.0, 0.0])))
    np.testing.assert_allclose(all_dim, usual)
    assert blank[0] < usual[0]
    np.testing.assert_allclose(blank[1:], usual[1:])
