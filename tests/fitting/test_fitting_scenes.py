"""Fits to simulated pictures whose truth is known: where the paper's theory is exact, the fit has to be good."""

import numpy as np
import pytest

from liaam.fitting import FitStatus, Fitter, SolverOptions, fit
from liaam.io import write_image
from liaam.model.shape import diagonal_of
from setups import disturb, model_pixels, train_on, without_core

STARTS = [(1.03, (0.02, -0.015)), (0.97, (-0.02, 0.02)), (1.0, (0.03, 0.0))]


@pytest.mark.parametrize(("scale", "shift"), STARTS)
def test_under_lateral_light_li_lands_and_finds_the_camera(fine_model, lit_scene, scale, shift):
    result = Fitter(fine_model, "li").fit(lit_scene.image, disturb(lit_scene.landmarks, scale, shift))
    assert result.status == FitStatus.CONVERGED
    assert model_pixels(fine_model, result.landmarks, lit_scene.landmarks) < 0.5
    assert np.rad2deg(result.theta) == pytest.approx(np.rad2deg(lit_scene.theta), abs=1.0)


@pytest.mark.parametrize("method", ["grey", "rgb"])
@pytest.mark.parametrize(("scale", "shift"), STARTS)
def test_under_lateral_light_values_do_not_land(fine_model, lit_scene, method, scale, shift):
    result = Fitter(fine_model, method).fit(lit_scene.image, disturb(lit_scene.landmarks, scale, shift))
    assert model_pixels(fine_model, result.landmarks, lit_scene.landmarks) > 0.5


@pytest.mark.parametrize("method", ["grey", "rgb", "li", "li-lit", "chroma"])
def test_under_the_light_of_training_every_method_lands(fine_model, same_light_scene, method):
    result = Fitter(fine_model, method).fit(same_light_scene.image, disturb(same_light_scene.landmarks))
    assert result.status.ok
    assert model_pixels(fine_model, result.landmarks, same_light_scene.landmarks) < 0.5


def test_the_truth_lies_in_the_span_of_the_shape_model(fine_model, lit_scene):
    bound = fine_model.shape_model.project(lit_scene.landmarks)
    assert model_pixels(fine_model, bound, lit_scene.landmarks) < 0.2


def test_li_and_lit_agree_when_all_modes_are_kept(fine_model, lit_scene):
    options = SolverOptions(tolerance=1e-4, max_iterations=300)
    start = disturb(lit_scene.landmarks)
    li, lit = (Fitter(fine_model, method, options).fit(lit_scene.image, start) for method in ("li", "li-lit"))
    assert model_pixels(fine_model, lit.landmarks, li.landmarks) < 1e-3
    assert lit.theta == pytest.approx(li.theta, abs=1e-5)


def test_li_and_lit_differ_when_modes_are_dropped(scenes, lit_scene):
    model = train_on(scenes, diagonal=80.0, variance=1.0, appearance_variance=2)
    start = disturb(lit_scene.landmarks)
    li, lit = (Fitter(model, method).fit(lit_scene.image, start) for method in ("li", "li-lit"))
    assert model_pixels(model, lit.landmarks, li.landmarks) > 1e-2


def test_the_angle_of_another_camera_is_found(scenes, lit_scene):
    from scenes import Head, lateral, make_set, narrow_band_camera

    other = narrow_band_camera((620.0, 520.0, 450.0))
    # The same colours through another camera differ by more than the angle, so train on what it sees.
    own = make_set(5, Head(7), camera=other, seed=1, size=(200, 150), mixing="planckian")
    seen = make_set(1, Head(7), lateral("right"), other, seed=1, size=(200, 150), mixing="planckian")[0]
    model = train_on(own, diagonal=80.0)
    result = Fitter(model, "li").fit(seen.image, disturb(seen.landmarks))
    assert abs(np.rad2deg(own[0].theta - scenes[0].theta)) > 2
    assert np.rad2deg(result.theta) == pytest.approx(np.rad2deg(seen.theta), abs=1.0)


@pytest.mark.parametrize("method", ["li", "rgb"])
def test_both_engines_give_the_same_fit(model, lit_scene, method):
    start = disturb(lit_scene.landmarks)
    core = Fitter(model, method).fit(lit_scene.image, start)
    with without_core():
        reference = Fitter(model, method).fit(lit_scene.image, start)
    assert model_pixels(model, core.landmarks, reference.landmarks) < 1e-2
    assert core.status == reference.status


@pytest.mark.parametrize("method", ["li", "rgb", "chroma"])
def test_the_depth_of_an_image_does_not_change_its_fit(model, same_light_scene, method):
    eight = np.round(same_light_scene.image * 255).astype(np.uint8)
    start = disturb(same_light_scene.landmarks)
    fitter = Fitter(model, method)
    first = fitter.fit(eight, start)
    for image in (eight.astype(np.uint16) * 257, eight.astype(np.float32) / 255, eight / 255.0):
        assert model_pixels(model, fitter.fit(image, start).landmarks, first.landmarks) < 1e-2


def test_a_file_fits_like_its_array(model, same_light_scene, tmp_path):
    eight = np.round(same_light_scene.image * 255).astype(np.uint8)
    write_image(tmp_path / "face.png", eight)
    start = disturb(same_light_scene.landmarks)
    from_file, from_array = (fit(model, image, start) for image in (tmp_path / "face.png", eight))
    np.testing.assert_array_equal(from_file.landmarks, from_array.landmarks)


def test_a_box_and_a_point_will_do_to_start(model, same_light_scene):
    truth = same_light_scene.landmarks
    low, high = truth.min(axis=0), truth.max(axis=0)
    for init in ((*low, *high), (*(low + high) / 2, diagonal_of(truth))):
        result = Fitter(model, "li").fit(same_light_scene.image, init)
        assert result.status.ok
        assert model_pixels(model, result.landmarks, truth) < 0.5


def test_a_moved_picture_gives_a_moved_fit(model, lit_scene):
    start = disturb(lit_scene.landmarks)
    moved = np.pad(lit_scene.image, ((30, 0), (50, 0), (0, 0)), mode="edge")
    here, there = (
        Fitter(model, "li").fit(image, s)
        for image, s in ((lit_scene.image, start), (moved, start + np.array([50, 30])))
    )
    assert model_pixels(model, there.landmarks - [50, 30], here.landmarks) < 1e-2
