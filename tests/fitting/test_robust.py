"""Robust losses, noise weights and normalisation: what each is for, on scenes with known truth."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from liaam.fitting import Fitter, SolverOptions, get_method, solver
from liaam.fitting.losses import LOSSES, robust_scale
from liaam.fitting.objective import make_objectives
from liaam.photometry import linear_to_srgb, noise_deviation
from setups import disturb, make_problem, model_pixels


@given(name=st.sampled_from(sorted(LOSSES)), a=st.floats(0, 1e6), b=st.floats(0, 1e6))
def test_weights_fall_with_the_residual_and_stay_in_range(name, a, b):
    low, high = LOSSES[name](np.array([min(a, b)])), LOSSES[name](np.array([max(a, b)]))
    assert 0 <= high[0] <= low[0] <= 1


@pytest.mark.parametrize("name", LOSSES)
def test_no_residual_weighs_one(name):
    assert LOSSES[name](np.zeros(1))[0] == 1


def test_the_scale_is_that_of_most_residuals(rng):
    residuals = np.abs(rng.normal(0, 3, 20000))
    residuals[:4000] = 1e6
    assert robust_scale(residuals[4000:]) == pytest.approx(3, rel=0.03)
    assert robust_scale(residuals) < 4.5
    assert robust_scale(np.zeros(0)) == 0


@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_scale_does_not_depend_on_the_rows(k, rng):
    sizes = np.sqrt(np.square(rng.normal(0, 3, (20000, k))).mean(axis=1))
    assert robust_scale(sizes, k) == pytest.approx(3, rel=0.03)


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
        model_pixels(fine_model, Fitter(fine_model, name).fit(image, start).shape, same_light_scene.landmarks)
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
            fine_model, Fitter(fine_model, name).fit(image, disturb(scene.landmarks)).shape, scene.landmarks
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
            shape = Fitter(fine_model, name).fit(noisy, disturb(lit_scene.landmarks)).shape
            found.append(model_pixels(fine_model, shape, lit_scene.landmarks))
    assert np.mean(errors["li+noise"]) < 0.7 * np.mean(errors["li"])


def test_kinks_of_noisy_samples_do_not_keep_it_from_settling(fine_model, lit_scene, rng):
    objective = make_objectives(fine_model, get_method("li+noise"))[-1]
    options = SolverOptions()
    for _ in range(6):
        noisy = np.clip(lit_scene.image + rng.normal(0, 0.03, lit_scene.image.shape), 0, 1).astype(np.float32)
        problem, p = make_problem(fine_model, noisy, disturb(lit_scene.landmarks), objective)
        run = solver._begin(objective, problem, objective.start(p), options)
        run = solver._iterate(objective, problem, run, options, 50, solver._expected_step)
        assert run.settled
        assert run.n_iterations <= 30


def test_no_iterations_are_none_with_weights_by_noise_too(fine_model, lit_scene):
    start = fine_model.shape_model.project(lit_scene.landmarks)
    result = Fitter(fine_model, "li+noise", SolverOptions(max_iterations=0)).fit(lit_scene.image, start)
    np.testing.assert_allclose(result.shape, start, atol=1e-6)
    assert result.n_iterations == 0


def test_scoring_steps_are_counted_and_bounded(fine_model, lit_scene):
    options = SolverOptions(max_iterations=2)
    result = Fitter(fine_model, "li+noise", options).fit(lit_scene.image, disturb(lit_scene.landmarks))
    levels = len(fine_model.levels)
    assert 2 * levels < result.n_iterations <= 4 * levels
    assert len(result.history) <= result.n_iterations + levels


@pytest.mark.parametrize("scoring", [1, 9])
def test_as_many_scoring_steps_are_taken_as_asked_at_the_sharpest_level(fine_model, lit_scene, scoring):
    options = SolverOptions(max_iterations=2, scoring=scoring)
    result = Fitter(fine_model, "li", options).fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert result.n_iterations == 2 * len(fine_model.levels) + min(scoring, 2)


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
