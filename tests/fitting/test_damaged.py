"""Fits to incomplete objects: absent landmarks are found, and do not pull the others."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.fitting import FitStatus, Fitter
from liaam.fitting.damaged import LEAST_PRESENT, without_absent
from liaam.model import SURROUNDINGS
from setups import disturb


def without_calibration(model):
    """Model as older files have it: without a calibration of what is present."""
    known = model.views[SURROUNDINGS].reliabilities
    return model.with_view(
        SURROUNDINGS, reliabilities={name: replace(each, presence=None) for name, each in known.items()}
    )


@pytest.fixture
def covered(same_light_scene):
    """Give a picture whose mouth and chin are covered, and which landmarks those are."""
    landmarks = same_light_scene.landmarks
    below = landmarks[:, 1] > landmarks[:, 1].max() - 0.3 * np.ptp(landmarks[:, 1])
    image = same_light_scene.image.copy()
    image[int(landmarks[below][:, 1].min() - 3) :] = 0.5
    return image, below


def test_what_is_covered_is_absent_and_does_not_pull_the_rest(calibrated, same_light_scene, covered):
    image, below = covered
    start = disturb(same_light_scene.landmarks)
    whole = Fitter(calibrated).fit(same_light_scene.image, start)
    fit = Fitter(calibrated).fit(image, start)
    before = Fitter(without_calibration(calibrated)).fit(image, start)

    def error(landmarks):
        return np.linalg.norm(landmarks - same_light_scene.landmarks, axis=1)[~below].mean()

    assert not whole.absent.any()
    depth = same_light_scene.landmarks[:, 1] - same_light_scene.landmarks[below][:, 1].min() + 3.0
    assert fit.absent[depth > 6.0].all()
    assert not fit.absent[depth < -9.0].any()
    assert fit.status is FitStatus.CONVERGED
    # The fit itself: the refiner brings back much of what covered pixels have pulled away.
    assert error(fit.registered) < 1.5 * error(whole.registered) < error(before.registered)
    assert error(fit.landmarks) < error(before.landmarks)


def test_absent_landmarks_are_estimates_with_larger_covariances(calibrated, same_light_scene, covered):
    image, below = covered
    start = disturb(same_light_scene.landmarks)
    whole = Fitter(calibrated).fit(same_light_scene.image, start)
    fit = Fitter(calibrated).fit(image, start)
    assert np.isfinite(fit.landmarks).all()
    assert (fit.sd > whole.sd)[below].all()


def test_complete_objects_are_fitted_as_without_the_calibration(calibrated, same_light_scene):
    start = disturb(same_light_scene.landmarks)
    fit = Fitter(calibrated).fit(same_light_scene.image, start)
    before = Fitter(without_calibration(calibrated)).fit(same_light_scene.image, start)
    np.testing.assert_array_equal(fit.landmarks, before.landmarks)
    assert fit.quality == before.quality
    assert before.present is None
    assert not before.absent.any()


def test_a_fit_of_which_most_is_absent_is_doubtful_and_looks_elsewhere(calibrated, same_light_scene):
    fitter = Fitter(calibrated)
    target, _ = fitter.target(same_light_scene.image, disturb(same_light_scene.landmarks))
    away = target._replace(start=target.start + 60.0)
    wrong = fitter.result_of(away, fitter.coarse_to_fine.fit(away, fitter.options))
    wrong = replace(wrong, status=FitStatus.CONVERGED)
    assert (~wrong.absent).mean() < LEAST_PRESENT
    assert without_absent(fitter, away, wrong, list).status is not FitStatus.CONVERGED
    found = without_absent(fitter, away, wrong, lambda: [target.start])
    assert not found.absent.any()
    assert found.status is FitStatus.CONVERGED


def test_a_lost_fit_is_repeated_from_its_start(calibrated, same_light_scene, covered):
    fitter = Fitter(calibrated)
    image, below = covered
    target, _ = fitter.target(image, same_light_scene.landmarks)
    right = fitter.fit_target(target)
    pulled_away = replace(right, status=FitStatus.DIVERGED, landmarks=100.0 * right.landmarks, present=None)
    found = without_absent(fitter, target, pulled_away, list)
    assert found.absent[below].any() and not found.status.lost
    errors = np.linalg.norm(found.landmarks - same_light_scene.landmarks, axis=1)
    assert errors[~below].mean() < 2.0


def test_a_fit_that_was_pulled_away_is_repeated_from_other_places(calibrated, same_light_scene, covered):
    fitter = Fitter(calibrated)
    image, below = covered
    target, _ = fitter.target(image, fitter.finder.mean_at(same_light_scene.landmarks))
    away = target._replace(start=target.start - 25.0)
    pulled_away = fitter.result_of(away, fitter.coarse_to_fine.fit(away, fitter.options))
    assert (~pulled_away.absent).mean() < LEAST_PRESENT
    found = without_absent(fitter, target, pulled_away, lambda: [target.start])
    assert found.absent[below].any() and not found.status.lost
    errors = np.linalg.norm(found.landmarks - same_light_scene.landmarks, axis=1)
    assert errors[~below].mean() < 1.0


def test_other_places_are_looked_for_only_if_most_is_absent(calibrated, same_light_scene, covered):
    fitter = Fitter(calibrated)
    image, _ = covered
    target, _ = fitter.target(image, disturb(same_light_scene.landmarks))

    def refuse():
        raise AssertionError("another place was looked for")

    result = without_absent(fitter, target, fitter.fit_target(target), refuse)
    assert result.absent.any()


def test_the_reference_masks_like_the_core(calibrated, rng):
    objective = Fitter(calibrated).objectives[0]
    weights = (rng.random(len(objective.appearance.usable)) > 0.3).astype(np.float32)
    masked = objective.with_weights(weights)
    plain = replace(objective, appearance=masked.appearance)
    np.testing.assert_allclose(masked.fields["gram"], plain.fields["gram"], rtol=1e-5, atol=1e-6 * objective.n_usable)
    np.testing.assert_array_equal(masked.fields["sqrt_weights"], plain.fields["sqrt_weights"])
    assert masked.n_usable == objective.n_usable > masked.appearance.usable.sum()
