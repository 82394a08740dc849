"""Robust losses, noise weights and normalisation: what each is for, on scenes with known truth."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from liaam.fitting import Fitter, SolverOptions, get_method
from liaam.fitting.methods import LOSSES
from liaam.fitting.reference import loop as reference_loop
from liaam.fitting.thresholds import THRESHOLDS
from liaam.photometry import linear_to_srgb, noise_deviation
from setups import disturb, finest_objective, make_level, model_pixels


def covered(image: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """Image with a patch over the mouth's side of the face (about a seventh of it)."""
    covered = image.copy()
    x, y = np.rint(landmarks.mean(axis=0) + 0.16 * np.ptp(landmarks, axis=0)).astype(int)
    size = int(0.38 * np.ptp(landmarks[:, 0]))
    covered[y : y + size, x : x + size] = (0.5, 0.45, 0.1)
    return covered


@pytest.mark.parametrize("loss", LOSSES)
def test_a_robust_loss_sees_past_a_patch(fine_model, same_light_scene, loss):
    image = covered(same_light_scene.image, same_light_scene.landmarks)
    start = disturb(same_light_scene.landmarks)
    plain, robust = (
        model_pixels(fine_model, Fitter(fine_model, name).fit(image, start).landmarks, same_light_scene.landmarks)
        for name in ("grey", f"grey+{loss}")
    )
    assert robust < (0.8 if loss in ("huber", "l1") else 0.5) * plain


def test_normalisation_stands_a_change_of_gain_and_offset(fine_model, same_light_scene):
    """As stored values see it, where the model's textures live."""
    scene = same_light_scene
    stored = 0.6 * linear_to_srgb(np.clip(scene.image, 0, 1)) + 0.15
    image = np.where(stored > 0.04045, ((stored + 0.055) / 1.055) ** 2.4, stored / 12.92).astype(np.float32)
    errors = {
        name: model_pixels(
            fine_model, Fitter(fine_model, name).fit(image, disturb(scene.landmarks)).landmarks, scene.landmarks
        )
        for name in ("grey-plain", "grey-norm", "grey")
    }
    assert errors["grey-norm"] < 0.3 * errors["grey-plain"]
    assert errors["grey"] < 0.3 * errors["grey-plain"]


def test_noise_weights_pay_where_pixels_differ_in_noise(fine_model, lit_scene, rng):
    errors = {"li": [], "li+noise": []}
    for _ in range(3):
        noisy = np.clip(lit_scene.image + rng.normal(0, 0.015, lit_scene.image.shape), 0, 1).astype(np.float32)
        for name, found in errors.items():
            result = Fitter(fine_model, name, SolverOptions(scoring=0)).fit(noisy, disturb(lit_scene.landmarks))
            found.append(model_pixels(fine_model, result.landmarks, lit_scene.landmarks))
    assert np.mean(errors["li+noise"]) < 0.7 * np.mean(errors["li"])


def test_kinks_of_noisy_samples_do_not_keep_it_from_settling(fine_model, lit_scene, rng):
    method = replace(get_method("li+noise"), step="expected")
    objective = finest_objective(fine_model, method)
    for _ in range(6):
        noisy = np.clip(lit_scene.image + rng.normal(0, 0.03, lit_scene.image.shape), 0, 1).astype(np.float32)
        image, p = make_level(fine_model, noisy, disturb(lit_scene.landmarks), objective)
        solution = objective.solve(image, objective.start(p), SolverOptions())
        assert solution.converged
        assert solution.n_iterations <= 30


def test_no_iterations_are_none_with_weights_by_noise_too(fine_model, lit_scene):
    start = fine_model.shape_model.project(lit_scene.landmarks)
    result = Fitter(fine_model, "li+noise", SolverOptions(max_iterations=0)).fit(lit_scene.image, start)
    np.testing.assert_allclose(result.landmarks, start, atol=1e-6)
    assert result.n_iterations == 0


def test_scoring_steps_are_counted_and_bounded(fine_model, lit_scene):
    options = SolverOptions(max_iterations=2)
    result = Fitter(fine_model, "li+noise", options).fit(lit_scene.image, disturb(lit_scene.landmarks))
    levels = len(fine_model.levels)
    assert 2 * levels < result.n_iterations <= 4 * levels
    assert len(result.history) <= result.n_iterations + levels


@pytest.mark.parametrize("scoring", [1, 9])
def test_as_many_scoring_steps_are_taken_as_asked_at_the_sharpest_level(fine_model, lit_scene, scoring):
    method = replace(get_method("li"), step="scored")
    # No step is so short that it ends the fit.
    patient = {"tolerance": 0.0, "early_tolerance": 0.0, "relative_tolerance": 0.0}
    options = SolverOptions(max_iterations=2, scoring=scoring, **patient)
    result = Fitter(fine_model, method, options).fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert result.n_iterations == 2 * len(fine_model.levels) + min(scoring, 2)


def test_scoring_steps_that_leave_more_are_not_taken(fine_model, lit_scene, monkeypatch):
    """The solution before them stands, all of it: its history, and what is seen there."""
    objective, options = finest_objective(fine_model, "li+noise"), SolverOptions(early_tolerance=0.0)
    image, p = make_level(fine_model, lit_scene.image, disturb(lit_scene.landmarks), objective)
    start = objective.start(p)

    def solved(**thresholds):
        for name, value in thresholds.items():
            monkeypatch.setitem(THRESHOLDS, name, value)
        found = reference_loop.solve_level(objective, image, *start, options, image.blur, True)
        monkeypatch.undo()
        return found

    plain, kept = solved(SCORING_STEPS=0), solved(SCORING_RISE=0.0)
    for name in ("path", "costs", "angle_history", "p"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(plain, name))
    for name in ("residual", "usable", "lam", "expected_hessian"):
        ours, theirs = getattr(kept, name), getattr(plain, name)
        np.testing.assert_allclose(ours, theirs, atol=1e-6 * np.abs(theirs).max(), err_msg=name)


def test_a_model_can_be_pickled_after_any_fit(fine_model, lit_scene):
    """As worker processes need it; the spline's factors cannot be."""
    Fitter(fine_model, "li+noise").fit(lit_scene.image, disturb(lit_scene.landmarks))
    again = pickle.loads(pickle.dumps(fine_model))
    values = np.arange(fine_model.n_pixels, dtype=float)[:, None]
    np.testing.assert_array_equal(again.frame.gradient(values), fine_model.frame.gradient(values))


@pytest.mark.parametrize(("sigma", "close"), [(2, 0.3), (10, 0.1)])
def test_noise_is_told_from_one_picture(same_light_scene, sigma, close, rng):
    """A small picture full of hair: its texture counts as some noise."""
    stored = linear_to_srgb(np.clip(same_light_scene.image, 0, 1))
    noisy = stored + rng.normal(0, sigma / 255, stored.shape)
    assert noise_deviation(noisy.astype(np.float32)) == pytest.approx(sigma / 255, rel=close)


@pytest.mark.parametrize("picture", [np.zeros((9, 9, 3), np.uint8), np.full((2, 2, 3), 7, np.uint16)])
def test_a_flat_picture_has_the_noise_of_rounding(picture):
    assert noise_deviation(picture) == pytest.approx(1 / 255 / np.sqrt(12))
