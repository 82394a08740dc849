"""soft-li: gradients and the invariant, each as far as the picture lets it be trusted."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.encoding_constants import BRIGHTNESS
from liaam.fitting import FitStatus, Fitter, SolverOptions
from liaam.fitting.loop.levels import averaged_image, prepare_level, solve_levels
from liaam.fitting.solution import residual_at, solution_at
from liaam.model import MESH, SURROUNDINGS
from liaam.photometry import linear_to_srgb, srgb_to_linear
from liaam.photometry.invariant import LUMINANCE
from setups import disturb, finest_objective, make_level, model_pixels, train_on


@pytest.mark.parametrize("picture", ["lit_scene", "same_light_scene"])
def test_it_finds_the_object_under_both_lights(fine_model, picture, request):
    scene = request.getfixturevalue(picture)
    result = Fitter(fine_model).fit(scene.image, disturb(scene.landmarks))
    assert result.method.name == "soft-li"
    assert result.status is FitStatus.CONVERGED
    assert model_pixels(fine_model, result.landmarks, scene.landmarks) < 0.5


def test_where_it_starts_does_not_matter(fine_model, lit_scene):
    fitter = Fitter(fine_model, options=SolverOptions(tolerance=1e-4))
    near, far = (fitter.fit(lit_scene.image, disturb(lit_scene.landmarks, scale)) for scale in (1.02, 0.85))
    assert np.abs(near.landmarks - far.landmarks).max() < 0.05


def test_it_ends_at_the_zero_of_the_expected_gradients_equation(fine_model, lit_scene):
    fitter = Fitter(fine_model, options=SolverOptions(tolerance=1e-4, relative_tolerance=0.0))
    target, _ = fitter.target(lit_scene.image, disturb(lit_scene.landmarks))
    stages = solve_levels(fitter.objectives, target, fitter.options)
    objective, solution = fitter.objectives[-1], stages[-1].solution
    assert solution.converged
    target = target.measured(objective.method)
    about = stages[:-1], fitter.options, averaged_image(fitter.objectives, target)
    problem = objective.problem(prepare_level(objective, target, *about)[0])
    problem.begin(solution.p, tuple(solution.angles), solution.lam)
    problem.evaluate(True)
    problem.reweigh(True)
    problem.differentiate(True, False)
    seen = problem.arrays()
    precision = objective.noise_variance(solution) / solution.prior_scale * objective.prior
    step = np.linalg.solve(seen["hessian"] + np.diag(precision), seen["gradient"] + precision * solution.p)
    # Weights are kept while steps are short, so that those at the end are a little newer than the last step's.
    assert objective.warp.movement(step) < 0.02


def test_steps_with_the_expected_gradient_are_few(fine_model, lit_scene):
    result = Fitter(fine_model).fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert result.status.ok
    assert result.n_iterations <= 6 * len(fine_model.views[SURROUNDINGS].levels)


@pytest.mark.parametrize("gain", [0.3, 2.0])
def test_exposure_hardly_moves_it(fine_model, same_light_scene, gain):
    start = disturb(same_light_scene.landmarks)
    plain = Fitter(fine_model).fit(same_light_scene.image, start)
    exposed = np.clip(gain * same_light_scene.image.astype(np.float32), 0.0, 1.0)
    found = Fitter(fine_model).fit(exposed, start)
    assert model_pixels(fine_model, found.landmarks, plain.landmarks) < 0.25


def test_grey_pictures_are_fitted_by_their_gradients(fine_model, lit_scene):
    grey = np.repeat(lit_scene.image @ LUMINANCE[0].astype(np.float32)[:, None], 3, axis=2)
    result = Fitter(fine_model).fit(grey, disturb(lit_scene.landmarks))
    assert result.status.ok
    assert model_pixels(fine_model, result.landmarks, lit_scene.landmarks) < 1.0
    assert result.without_colour and "The image is grey, unlike those of training" in result.message
    assert not Fitter(fine_model).fit(lit_scene.image, disturb(lit_scene.landmarks)).without_colour
    assert not Fitter(fine_model, "grey").fit(grey, disturb(lit_scene.landmarks)).without_colour


def test_a_model_of_grey_pictures_fits_colour(scenes, lit_scene):
    luminance = LUMINANCE[0].astype(np.float32)[:, None]
    grey = [replace(scene, image=np.repeat(scene.image @ luminance, 3, axis=2)) for scene in scenes]
    model = train_on(grey, diagonal=100.0, variance=1.0)
    result = Fitter(model).fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert result.status.ok
    assert model_pixels(model, result.landmarks, lit_scene.landmarks) < 1.0


def trust_in(model, image: np.ndarray, shape: np.ndarray) -> list[float]:
    """Weights of gradient and invariant, averaged over the pixels, once lambda has settled at a shape."""
    objective = finest_objective(model, "soft-li")
    encoded, p = make_level(model, image, shape, objective, blur=1.0)
    seen = objective.evaluate(encoded, objective.start(p), weigh=1, solves=True)
    absolute = 1.0 / seen["variance"].reshape(-1, 3)
    return [float(absolute[:, rows].mean()) for rows in (slice(0, 2), slice(2, 3))]


def test_noise_costs_trust(fine_model, same_light_scene, rng):
    shape, image = same_light_scene.landmarks, same_light_scene.image
    noise = 0.1 * rng.standard_normal(image.shape)
    stored = np.clip(linear_to_srgb(image.astype(np.float64)) + noise, 0, 1)
    noisy = srgb_to_linear(stored).astype(np.float32)
    gradient, invariant = trust_in(fine_model, image, shape)
    noisy_gradient, noisy_invariant = trust_in(fine_model, noisy, shape)
    assert noisy_gradient < 0.7 * gradient
    assert noisy_invariant < 0.7 * invariant


def test_colours_out_of_place_cost_the_invariant_its_trust(fine_model, same_light_scene, rng):
    import cv2

    shape, image = same_light_scene.landmarks, same_light_scene.image
    tint = cv2.GaussianBlur(rng.standard_normal(image.shape).astype(np.float32), (0, 0), 12.0)
    tint -= tint @ BRIGHTNESS.astype(np.float32)[:, None]
    tinted = np.clip(image * np.exp(0.3 * tint / tint.std()), 0, 1).astype(np.float32)
    plain, changed = trust_in(fine_model, image, shape), trust_in(fine_model, tinted, shape)
    assert changed[1] / plain[1] < 0.5 * changed[0] / plain[0]


def test_every_landmark_has_its_covariance(fine_model, lit_scene):
    result = Fitter(fine_model).fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert result.landmark_covariances.shape == (fine_model.n_points, 2, 2)
    np.testing.assert_allclose(result.landmark_covariances, result.landmark_covariances.transpose(0, 2, 1))
    assert (np.linalg.eigvalsh(result.landmark_covariances) > 0).all()
    assert np.isnan(result.quality)  # trained without leaving out
    lost = Fitter(fine_model).fit(lit_scene.image, lit_scene.landmarks + 50.0)
    assert max(0.0, lost.evidence[0]) < result.evidence[0] <= 1.0


def test_the_angle_of_the_picture_is_that_of_its_camera(fine_model, lit_scene):
    start, camera = disturb(lit_scene.landmarks), replace(fine_model.camera, theta=2.0)
    assert Fitter(fine_model).fit(lit_scene.image, start).theta == fine_model.theta
    assert Fitter(fine_model, camera=camera).fit(lit_scene.image, start).theta == 2.0


def test_a_fit_that_explains_nothing_is_doubtful(fine_model, rng):
    noise = rng.integers(0, 255, (240, 180, 3), dtype=np.uint8)
    assert not Fitter(fine_model).fit(noise, (40, 40, 140, 200)).status.ok


def test_its_residual_is_a_picture_of_the_surrounded_frame(fine_model, lit_scene):
    fitter = Fitter(fine_model)
    result = fitter.fit(lit_scene.image, disturb(lit_scene.landmarks))
    residual, usable = residual_at(fitter, lit_scene.image, result)
    picture = fine_model.views[SURROUNDINGS].warp.frame.picture(residual)
    assert picture.shape[2] == 3
    assert picture.any()
    assert 0.5 < usable.mean() <= 1.0


def test_soft_li_fits_with_shapes_of_its_own(model, lit_scene):
    own = replace(model.shape_model, modes=model.shape_model.modes[:2], eigenvalues=model.shape_model.eigenvalues[:2])
    both = model.with_view(SURROUNDINGS, warp=replace(model.views[SURROUNDINGS].warp, shape_model=own))
    start = disturb(lit_scene.landmarks)
    soft, plain = Fitter(both).fit(lit_scene.image, start), Fitter(both, "li").fit(lit_scene.image, start)
    assert (len(soft.p), len(plain.p)) == (2 + 4, len(model.shape_model.basis))
    everywhere = both.with_view(MESH, warp=replace(model.warp, shape_model=own))
    alone = Fitter(everywhere).fit(lit_scene.image, start)
    np.testing.assert_array_equal(soft.landmarks, alone.landmarks)
    np.testing.assert_array_equal(soft.landmark_covariances, alone.landmark_covariances)
    np.testing.assert_array_equal(plain.landmarks, Fitter(model, "li").fit(lit_scene.image, start).landmarks)
    # What one method has found another can look at.
    assert np.isfinite(solution_at(Fitter(both, "li"), lit_scene.image, soft)["lam"]).all()
