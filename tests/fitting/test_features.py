"""Methods that compare the channels of a function of the user."""

from functools import partial

import numpy as np
import pytest

from experiments.cramer_rao import cramer_rao_bound
from liaam import load_model
from liaam.errors import MethodError
from liaam.fitting import Fitter, Method, features_method, fit
from liaam.registration import register
from setups import disturb, model_pixels, train_on, without_core


def orientations(image: np.ndarray) -> np.ndarray:
    """Histogram of gradient orientations of each pixel, normalised: ten channels."""
    down, across = np.gradient(image.mean(axis=2))
    angle, size = np.arctan2(down, across), np.hypot(down, across)
    bins = np.stack([size * np.maximum(np.cos(angle - at), 0.0) for at in np.linspace(0, 2 * np.pi, 10, False)], axis=2)
    return bins / (np.linalg.norm(bins, axis=2, keepdims=True) + 0.01)


def logs(image: np.ndarray) -> np.ndarray:
    return np.log(image + 0.02)


@pytest.fixture(scope="module")
def trained(scenes):
    return train_on(scenes, diagonal=80.0, features=orientations)


@pytest.fixture(scope="module")
def few(scenes):
    return train_on(scenes, diagonal=80.0, features=logs)


@pytest.mark.parametrize("changes", [{}, {"loss": "huber"}, {"step": "scored"}, {"gain": True, "bias": "rows"}])
def test_fits_with_a_function_end_at_the_object(trained, same_light_scene, changes):
    result = fit(
        trained, same_light_scene.image, disturb(same_light_scene.landmarks), features_method(orientations, **changes)
    )
    assert result.status.ok
    assert result.method.name == "orientations"
    assert model_pixels(trained, result.landmarks, same_light_scene.landmarks) < 1.0


def test_both_engines_agree(few, same_light_scene):
    start = disturb(same_light_scene.landmarks)
    core = Fitter(few, features_method(logs)).fit(same_light_scene.image, start)
    with without_core():
        reference = Fitter(few, features_method(logs)).fit(same_light_scene.image, start)
    np.testing.assert_allclose(core.landmarks, reference.landmarks, atol=0.02)


def test_a_function_that_equals_an_encoding_gives_its_fit(few, scenes, same_light_scene):
    """Values by a function are those of the encoding; so are the fits."""

    def same(image: np.ndarray) -> np.ndarray:
        return image

    model = train_on(scenes, diagonal=80.0, features=same)
    start = disturb(same_light_scene.landmarks)
    own = Fitter(model, features_method(same, gain=True, bias="common")).fit(same_light_scene.image, start)
    usual = Fitter(model, "rgb").fit(same_light_scene.image, start)
    np.testing.assert_allclose(own.landmarks, usual.landmarks, atol=0.01)
    np.testing.assert_allclose(own.landmark_covariances, usual.landmark_covariances, rtol=0.01)


def test_many_channels_are_projected_to_their_principal_components(trained, few):
    known = trained.features
    assert (known.name, known.projection.shape) == ("orientations", (10, 7))
    np.testing.assert_allclose(known.projection.T @ known.projection, np.eye(7), atol=1e-9)
    assert few.features.width == 3
    assert few.levels[0].appearances["features"].mean.shape[1] == 3


def test_the_file_keeps_the_name_and_not_the_function(trained, same_light_scene, tmp_path):
    trained.save(tmp_path / "m.liaam")
    again, start = load_model(tmp_path / "m.liaam"), disturb(same_light_scene.landmarks)
    first, second = (
        fit(each, same_light_scene.image, start, features_method(orientations)) for each in (trained, again)
    )
    np.testing.assert_allclose(first.landmarks, second.landmarks, atol=1e-6)
    with pytest.raises(MethodError, match="features logs, but the model was trained with the features orientations"):
        Fitter(again, features_method(logs))


def test_a_model_without_features_says_how_to_train_them(model):
    with pytest.raises(MethodError, match=r"was trained without features; train it with this function \(train\("):
        Fitter(model, features_method(logs))


def wrong_size(image):
    return image[1:]


def flat(image):
    return image[..., 0]


def endless(image):
    return image / 0.0


def failing(image):
    raise ValueError("no such thing")


@pytest.mark.parametrize(
    ("function", "match"),
    [
        (wrong_size, "wrong_size returns an array of shape"),
        (flat, r"it must return \(height, width, channels\)"),
        (endless, "endless returns values that are not finite"),
        (failing, "failing fails on an image of shape .*: no such thing"),
        (lambda image: image, "give a function with a name"),
        (partial(logs), "give a function with a name"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_function_that_cannot_be_used_is_refused(scenes, function, match):
    with pytest.raises(MethodError, match=match):
        train_on(scenes[:3], diagonal=40.0, features=function)


def test_other_channels_than_in_training_are_refused(few, same_light_scene):
    def changed(image: np.ndarray) -> np.ndarray:
        return np.concatenate([image, image], axis=2)

    changed.__name__ = "logs"
    with pytest.raises(MethodError, match="logs returns 6 channels, but returned 3 when the model was trained"):
        fit(few, same_light_scene.image, disturb(same_light_scene.landmarks), features_method(changed))


def test_a_function_needs_the_appearance_and_the_metric_of_features():
    with pytest.raises(MethodError, match="features images do not suit a value appearance"):
        Method("x", "", logs, "value", "rgb")
    with pytest.raises(MethodError, match="metric rgb does not suit encoding features"):
        Method("x", "", logs, "features", "rgb")
    with pytest.raises(MethodError, match="metric features does not suit encoding value"):
        Method("x", "", "value", "value", "features")


def test_what_needs_a_known_encoding_refuses_a_function(few, same_light_scene):
    with pytest.raises(MethodError, match="logs"):
        register(same_light_scene.image, same_light_scene.image, method=features_method(logs))
    with pytest.raises(MethodError, match="logs"):
        cramer_rao_bound(few, same_light_scene.image, same_light_scene.landmarks, features_method(logs), 0.01)
