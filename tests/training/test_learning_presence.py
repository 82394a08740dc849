"""Training learns how well image and fit agree at present landmarks, and elsewhere."""

import numpy as np

from liaam.fitting import METHODS
from liaam.model.presence import Agreement
from liaam.training.presence import LEAST_FITS, AgreementOfFit, can_be_judged, learn_presence


def fit(rng, here, n_elsewhere=8, missing=()):
    """Agreement of a fit whose landmarks agree by about `here` (n,), and by 0 elsewhere."""
    concordances = np.array(here) + rng.normal(0.0, 0.02, len(here))
    concordances[list(missing)] = np.nan
    elsewhere = [Agreement(rng.normal(0.0, 0.1, len(here)), np.zeros(len(here))) for _ in range(n_elsewhere)]
    return AgreementOfFit(Agreement(concordances, np.full(len(here), 0.3)), tuple(elsewhere))


def test_the_clearer_landmarks_agree_the_steeper_their_odds(rng):
    presence = learn_presence([fit(rng, [0.9, 0.5, 0.0]) for _ in range(20)])
    assert presence is not None
    np.testing.assert_allclose(np.tanh(presence.usual), [0.9, 0.5, 0.0], atol=0.03)
    np.testing.assert_allclose(presence.other, 0.0, atol=0.1)
    np.testing.assert_allclose(presence.contrasts, 0.3)
    clear = presence.probabilities(Agreement(np.array([0.85, 0.45, 0.0]), np.full(3, 0.3)))
    gone = presence.probabilities(Agreement(np.zeros(3), np.full(3, 0.3)))
    assert clear[0] >= clear[1] > clear[2] > 0.5
    assert gone[0] <= gone[1] < 0.1
    np.testing.assert_allclose(gone[2], clear[2], atol=0.01)


def test_missing_landmarks_do_not_count(rng):
    some = [fit(rng, [0.9, 0.5], missing=[1]) for _ in range(10)]
    presence = learn_presence([*some, *(fit(rng, [0.9, 0.5]) for _ in range(10))])
    never = learn_presence(some)
    assert presence is not None and never is not None
    np.testing.assert_allclose(np.tanh(presence.usual), [0.9, 0.5], atol=0.03)
    assert np.isfinite(never.usual).all() and np.isfinite(never.variances).all()


def test_few_fits_and_relit_ones_alone_are_not_enough(rng):
    assert learn_presence([]) is None
    assert learn_presence([fit(rng, [0.9]) for _ in range(LEAST_FITS - 1)]) is None
    assert learn_presence([fit(rng, [0.9], n_elsewhere=0) for _ in range(20)]) is None


def test_methods_that_compare_gradients_are_judged():
    assert can_be_judged(METHODS["soft-li"])
    assert not can_be_judged(METHODS["grey"])
