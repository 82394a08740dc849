"""Fits from the points of another landmarker, which are weighed in."""

from dataclasses import replace

import numpy as np
import pytest

from liaam import load_model
from liaam.errors import StartError, TrainingError
from liaam.fitting import Fitter, SolverOptions
from liaam.fitting.loop.levels import solve_levels
from liaam.fitting.quality import covariance
from liaam.io import write_landmarks
from liaam.model.shape import diagonal_of
from liaam.training.entries import Entry
from liaam.training.points import map_of_points
from setups import model_pixels, train_on, without_core

COUNT = 20


def points_of(shape: np.ndarray, rng: np.random.Generator, jitter: float = 0.02) -> np.ndarray:
    """Return other points of an object: means of four landmarks, which jitter by a share of its diagonal."""
    members = np.random.default_rng(3).integers(len(shape), size=(COUNT, 4))
    return shape[members].mean(axis=1) + jitter * diagonal_of(shape) * rng.normal(size=(COUNT, 2))


@pytest.fixture(scope="module")
def trained(scenes):
    rng = np.random.default_rng(5)
    return train_on(scenes, diagonal=80.0, points=[points_of(scene.landmarks, rng) for scene in scenes])


def test_a_fit_starts_from_their_points_and_ends_at_the_object(trained, same_light_scene, rng):
    result = Fitter(trained).fit(same_light_scene.image, points_of(same_light_scene.landmarks, rng))
    assert result.status.ok
    assert model_pixels(trained, result.landmarks, same_light_scene.landmarks) < 1.0


def test_without_a_step_the_result_is_the_mapped_shape(trained, same_light_scene, rng):
    points = points_of(same_light_scene.landmarks, rng)
    result = Fitter(trained, options=SolverOptions(max_iterations=0)).fit(same_light_scene.image, points)
    expected = trained.points(points)
    assert model_pixels(trained, result.landmarks, expected) < 1.0  # but for what the shape model lacks


@pytest.mark.parametrize("method", ["soft-li", "grey", "li"])
def test_points_that_are_certain_outweigh_the_image(trained, same_light_scene, rng, method):
    """The result moves from the image's minimum to their points as their errors shrink."""
    points = points_of(same_light_scene.landmarks, rng)
    mapped, ends = trained.points(points), []
    for factor in (1.0, 1e-3, 1e-6):
        errors, noise = np.sqrt(factor) * trained.points.errors, factor * trained.points.noise
        model = replace(trained, points=replace(trained.points, errors=errors, noise=noise))
        fitter = Fitter(model, method, restarts=False)
        result = fitter.fit(same_light_scene.image, points)
        ends.append(model_pixels(model, result.landmarks, fitter.shapes.project(mapped)))
    assert ends[0] > ends[1] > ends[2]
    assert ends[2] < 0.05


def test_both_engines_weigh_their_points_in_alike(trained, same_light_scene, rng):
    points, options = points_of(same_light_scene.landmarks, rng), SolverOptions(max_iterations=3)
    core = Fitter(trained, "grey", options).fit(same_light_scene.image, points)
    with without_core():
        reference = Fitter(trained, "grey", options).fit(same_light_scene.image, points)
    np.testing.assert_allclose(core.landmarks, reference.landmarks, atol=0.02)
    np.testing.assert_allclose(core.covariance, reference.covariance, rtol=0.02, atol=1e-3)


def test_the_covariance_includes_their_points(trained, same_light_scene, rng):
    fitter = Fitter(trained)
    target, _ = fitter.target(same_light_scene.image, points_of(same_light_scene.landmarks, rng))
    stage = solve_levels(fitter.objectives[-1:], target, fitter.options)[-1]
    difference = np.linalg.inv(covariance(stage, pull=target.pull)) - np.linalg.inv(covariance(stage))
    np.testing.assert_allclose(difference, target.pull, rtol=1e-6, atol=1e-8 * np.abs(target.pull).max())


def test_precise_points_need_fewer_levels_and_steps(trained, same_light_scene, rng):
    box = (*same_light_scene.landmarks.min(axis=0), *same_light_scene.landmarks.max(axis=0))
    near = replace(trained, points=replace(trained.points, errors=0.0 * trained.points.errors))
    far = replace(trained, points=replace(trained.points, errors=trained.points.errors + 5.0))
    points = points_of(same_light_scene.landmarks, rng)
    starts = ((near, points), (far, points), (trained, box))
    fits = [Fitter(model).fit(same_light_scene.image, start) for model, start in starts]
    assert [fit.history[-1].level for fit in fits] == [0, 2, 2]
    assert fits[0].n_iterations < fits[2].n_iterations


def test_a_start_of_the_model_s_own_points_is_not_weighed_in(trained, same_light_scene):
    target, _ = Fitter(trained).target(same_light_scene.image, same_light_scene.landmarks)
    assert target.pull is None
    np.testing.assert_array_equal(target.start, same_light_scene.landmarks)


def test_the_map_is_in_the_model_file(trained, tmp_path):
    trained.save(tmp_path / "m.liaam")
    again = load_model(tmp_path / "m.liaam")
    assert again.points is not None
    for field in ("weights", "errors", "noise"):
        np.testing.assert_array_equal(getattr(again.points, field), getattr(trained.points, field))


def test_a_folder_a_function_and_a_list_give_the_same_map(scenes, trained, tmp_path):
    rng = np.random.default_rng(5)
    points = [points_of(scene.landmarks, rng) for scene in scenes]
    for i, each in enumerate(points, 1):
        write_landmarks(tmp_path / f"image {i}.pts", each)
    by_image = {scene.image.tobytes(): each for scene, each in zip(scenes, points, strict=True)}
    for given in (tmp_path, lambda image: by_image[image.tobytes()]):
        again = train_on(scenes, diagonal=80.0, points=given)
        np.testing.assert_allclose(again.points.weights, trained.points.weights, atol=1e-3)


def test_images_without_points_are_left_out(scenes):
    rng = np.random.default_rng(5)
    some = [points_of(scene.landmarks, rng) if i % 2 else None for i, scene in enumerate(scenes)]
    assert train_on(scenes, diagonal=80.0, points=some).points.n_theirs == COUNT


def test_points_belong_to_the_nearest_of_several_objects_in_an_image(scenes):
    """A function finds the same points for each object of an image."""
    rng, mean = np.random.default_rng(5), scenes[0].landmarks
    found = [points_of(scene.landmarks, rng) for scene in scenes]
    entries = [Entry(str(i), lambda: scenes[0].image, scene.landmarks) for i, scene in enumerate(scenes)]
    party = [Entry("0#2", entries[0].read_image, mean + np.array([500.0, 0])), *entries]
    together = map_of_points([found[0], *found], party, mean)
    np.testing.assert_array_equal(together.weights, map_of_points(found, entries, mean).weights)


def test_a_start_of_unknown_points_names_the_option(model, trained, same_light_scene):
    for each, told in ((model, "the model has 58;"), (trained, f"the model has 58 or {COUNT} points of the other")):
        with pytest.raises(StartError, match="liaam train --points FOLDER") as error:
            Fitter(each).fit(same_light_scene.image, np.zeros((68, 2)))
        assert told in str(error.value)
    missing = np.full((COUNT, 2), np.nan)
    with pytest.raises(StartError, match="points are not finite"):
        Fitter(trained).fit(same_light_scene.image, missing)


@pytest.mark.parametrize(
    ("points", "match"),
    [
        ("nowhere", "nowhere is not a folder"),
        ([np.zeros((4, 2))], "points for 1 images, but 8 images"),
        ([None] * 8, "0 of 8 images; at least 3"),
        (
            [np.eye(4, 2)] * 7 + [np.eye(5, 2)],
            r"image 8: the points of the other landmarker, of shape \(5, 2\), are not 4",
        ),
        ([np.full((4, 2), np.nan)] * 8, "image 1: .* are not 4 finite"),
        ([np.random.default_rng(0).normal(size=(58, 2))] * 8, "has 58 points, as the model has"),
    ],
)
def test_points_that_cannot_be_used_are_refused(scenes, points, match):
    with pytest.raises(TrainingError, match=match):
        train_on(scenes, diagonal=80.0, points=points)
