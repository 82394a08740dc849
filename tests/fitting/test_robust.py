"""Robust losses, noise weights and normalisation: what each is for, on scenes with known truth."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam.fitting import Fitter, SolverOptions, get_method, solver
from liaam.fitting.kernel import KERNELS
from liaam.fitting.level import Row, Template, Work
from liaam.fitting.losses import LOSSES, gaussian_median
from liaam.photometry import linear_to_srgb, noise_deviation
from setups import Kernel, disturb, finest_objective, make_problem, model_pixels

kernels = pytest.mark.parametrize("kernel", list(map(Kernel, KERNELS)), ids=repr)

PUBLISHED = {
    "huber": lambda u: np.where(u <= 1.345, 0.5 * u**2, 1.345 * (u - 0.5 * 1.345)),
    "l1": lambda u: np.where(u <= 0.1, 0.5 * u**2, 0.1 * (u - 0.05)),
    "cauchy": lambda u: 0.5 * 2.385**2 * np.log1p((u / 2.385) ** 2),
    "geman-mcclure": lambda u: 0.5 * u**2 / (1.0 + (u / 3.65) ** 2),
    "tukey": lambda u: 4.685**2 / 6.0 * (1.0 - np.maximum(1.0 - (u / 4.685) ** 2, 0.0) ** 3),
}
"""Losses rho(u) of residuals u >= 0 in standard deviations; weights are rho'(u) / u."""


@kernels
@pytest.mark.parametrize("loss", PUBLISHED)
@given(u=st.floats(1e-3, 20.0))
def test_weights_are_those_of_the_published_losses(kernel, loss, u):
    step, rho = 1e-4 * max(u, 0.1), PUBLISHED[loss]
    slope = float(rho(u + step) - rho(u - step)) / (2 * step)
    assert kernel.loss_weight(LOSSES.index(loss), u) == pytest.approx(slope / u, abs=1e-3)


@kernels
@given(u=st.floats(0.0, 30.0))
def test_learnt_weights_are_the_density_of_a_gaussian(kernel, u):
    assert kernel.loss_weight(LOSSES.index("learnt"), u) == pytest.approx(np.exp(-0.5 * u**2))


@kernels
@given(loss=st.integers(0, len(LOSSES) - 1), a=st.floats(0, 1e6), b=st.floats(0, 1e6))
def test_weights_fall_with_the_residual_and_stay_in_range(kernel, loss, a, b):
    low, high = kernel.loss_weight(loss, min(a, b)), kernel.loss_weight(loss, max(a, b))
    assert 0 <= high <= low <= 1


@kernels
@pytest.mark.parametrize("loss", range(len(LOSSES)), ids=LOSSES)
def test_no_residual_weighs_one(kernel, loss):
    assert kernel.loss_weight(loss, 0.0) == 1


@pytest.mark.parametrize("loss", ["huber", "cauchy", "geman-mcclure", "tukey"])
def test_gaussian_residuals_lose_a_twentieth_of_their_efficiency(loss):
    """(E psi')^2 / E psi^2 of an M-estimator of a place, by the constants of the losses."""
    u = np.linspace(1e-6, 12.0, 200_001)
    density = np.exp(-0.5 * u**2)
    psi = u * np.array([Kernel("fast").loss_weight(LOSSES.index(loss), each) for each in u])
    slope = np.gradient(psi, u)
    efficiency = (slope * density).sum() ** 2 / ((psi**2 * density).sum() * density.sum())
    assert efficiency == pytest.approx(0.95, abs=0.01)


@kernels
@given(numbers=st.lists(st.one_of(st.floats(-1e9, 1e9), st.sampled_from([0.0, 1.0])), max_size=40))
def test_the_median_is_in_the_middle_of_sorted_numbers(kernel, numbers):
    found = kernel.median(np.array(numbers, np.float64))
    assert found == (sorted(numbers)[len(numbers) // 2] if numbers else 0.0)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_median_of_gaussian_residuals_is_known(k, rng):
    sizes = np.sqrt(np.square(rng.normal(size=(40000, k))).mean(axis=1))
    assert gaussian_median(k) == pytest.approx(np.median(sizes), rel=0.01)
    assert gaussian_median(1) == pytest.approx(1 / 1.4826, rel=1e-4)


def scale_of(kernel, residuals: np.ndarray, variance: np.ndarray | None = None) -> float:
    """Scale that residuals (n, k) are weighed by, as a weight by Cauchy's loss tells it."""
    n, k = residuals.shape
    flat, weighed = residuals.astype(np.float32).ravel(), np.ones(n * k, np.float32)
    by = np.zeros(0, np.float32) if variance is None else variance.astype(np.float32).ravel()
    template = kernel.record(Template, own=np.ones(n * k, np.float32), errors=np.zeros(n))
    row = kernel.record(Row, loss=LOSSES.index("cauchy"), median=gaussian_median(k))
    seen = {"residual": flat, "usable": np.ones(n, np.float32), "variance": by, "sizes": np.empty((2, n))}
    kernel.weigh_by_loss(template, row, kernel.record(Work, **seen, weighed=weighed))
    sizes = np.sqrt((np.square(residuals) / (1.0 if variance is None else variance)).mean(axis=1))
    middle = int(np.argsort(sizes)[n // 2])
    weight = float(weighed[middle * k]) ** 2
    return float(sizes[middle] / (2.385 * np.sqrt(1.0 / weight - 1.0)))


@kernels
@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_scale_is_that_of_most_residuals_whatever_the_rows(kernel, k, rng):
    residuals = rng.normal(0, 3, (20000, k))
    assert scale_of(kernel, residuals) == pytest.approx(3, rel=0.03)
    residuals[:4000] = 1e6
    assert scale_of(kernel, residuals) < 4.5


@kernels
def test_residuals_are_told_in_their_own_deviations_where_these_are_known(kernel, rng):
    variance = rng.uniform(0.5, 8.0, (20000, 2))
    residuals = np.sqrt(variance) * rng.normal(size=(20000, 2))
    assert scale_of(kernel, residuals, variance) == pytest.approx(1.0, rel=0.03)


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
        problem, p = make_problem(fine_model, noisy, disturb(lit_scene.landmarks), objective)
        solution = solver.solve(objective, problem, objective.start(p), SolverOptions())
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
    start, options = disturb(lit_scene.landmarks), SolverOptions(max_iterations=2, tolerance=0.0, scoring=scoring)
    result = Fitter(fine_model, method, options).fit(lit_scene.image, start)
    assert result.n_iterations == 2 * len(fine_model.levels) + min(scoring, 2)


def test_scoring_steps_that_leave_more_are_not_taken(fine_model, lit_scene, monkeypatch):
    """The solution before them stands, all of it: its history, and what is seen there."""
    objective = finest_objective(fine_model, "li+noise")
    problem, p = make_problem(fine_model, lit_scene.image, disturb(lit_scene.landmarks), objective)
    monkeypatch.setattr(solver, "SCORING_STEPS", 0)
    plain = solver.solve(objective, problem, objective.start(p), SolverOptions(early_tolerance=0.0))
    monkeypatch.undo()
    monkeypatch.setattr(solver, "SCORING_RISE", 0.0)
    kept = solver.solve(objective, problem, objective.start(p), SolverOptions(early_tolerance=0.0))
    np.testing.assert_array_equal(kept.path, plain.path)
    np.testing.assert_array_equal(kept.costs, plain.costs)
    np.testing.assert_array_equal(kept.angles, plain.angles)
    np.testing.assert_array_equal(kept.state.p, plain.state.p)
    for name in ("residual", "root", "usable", "lam"):
        ours, theirs = getattr(kept.work, name), getattr(plain.work, name)
        np.testing.assert_allclose(ours, theirs, atol=1e-3 * np.abs(theirs).max(), err_msg=name)


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
