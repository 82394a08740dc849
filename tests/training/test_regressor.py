"""Landmarks by regression: what it learns, what it states of its errors, and fits that weigh it in."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save

from liaam import FitStatus, Fitter, load_model, train
from liaam.errors import ModelFileError, TrainingError
from liaam.fitting.one_shape_fitter import OneShapeFitter
from liaam.model.regressor import SIZE, OrientationHistograms
from liaam.model.shape import align, diagonal_of, procrustes_mean, rotation
from liaam.training.regressor import _ridge_regression

CORNERS = np.array([[-1.0, -1.0], [0.0, -1.3], [1.0, -1.0], [1.0, 0.2], [0.6, 1.0], [-0.6, 1.0], [-1.0, 0.2]])


def drawn(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a shield on paper, squat or slender; return the image and its corners."""
    stretch = np.exp(rng.normal(0.0, 0.3))
    corners = CORNERS * np.array([stretch, 1.0 / stretch]) + rng.normal(0.0, 0.05, CORNERS.shape)
    points = 34.0 * corners @ rotation(rng.normal(0.0, 0.1)).T + 80.0 + rng.normal(0.0, 3.0, 2)
    picture = np.full((160, 160, 3), 0.65, np.float32)
    outline = np.rint(points * 16).astype(np.int32)
    cv2.fillPoly(picture, [outline], (0.25, 0.3, 0.2), cv2.LINE_AA, shift=4)
    cv2.polylines(picture, [outline], True, (0.1, 0.1, 0.1), 2, cv2.LINE_AA, shift=4)
    picture += rng.normal(0.0, 0.01, picture.shape).astype(np.float32)
    return np.clip(255.0 * picture, 0, 255).astype(np.uint8), points


@pytest.fixture(scope="module")
def shields() -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(5)
    return [drawn(rng) for _ in range(24)]


@pytest.fixture(scope="module")
def shield_model(shields):
    return train(shields[:14], regressor=True, shapes=1, diagonal=80, leave_out=False)


def start_of(model, truth: np.ndarray) -> np.ndarray:
    """The mean shape in the box of the true one."""
    mean = model.shape_model.mean
    scale = diagonal_of(truth) / diagonal_of(mean)
    return scale * (mean - 0.5 * (mean.min(0) + mean.max(0))) + 0.5 * (truth.min(0) + truth.max(0))


def error_of(points: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(points - truth, axis=1).mean() / diagonal_of(truth))


def test_a_regressor_finds_the_landmarks_of_new_images(shields, shield_model):
    starts, ends = [], []
    for image, truth in shields[14:]:
        start = start_of(shield_model, truth)
        starts.append(error_of(start, truth))
        ends.append(error_of(shield_model.regressor(image, "srgb", start), truth))
    assert np.median(ends) < 0.3 * np.median(starts)
    assert max(ends) < max(starts)


def test_a_regressor_states_its_errors(shields, shield_model):
    squares = []
    for image, truth in shields[14:]:
        found = shield_model.regressor(image, "srgb", start_of(shield_model, truth))
        to_frame = align(truth, shield_model.shape_model.mean).scale
        squares.append(to_frame**2 * np.square(found - truth).sum(axis=1).mean())
    stated = shield_model.regressor.left_out.deviation
    assert 0.5 * stated < np.sqrt(np.median(squares)) * 1.3 < 2.0 * stated


def test_a_regressor_does_not_see_the_strength_of_light(shields, shield_model):
    image, truth = shields[15]
    start = start_of(shield_model, truth)
    linear = np.float32(image / 255.0)
    bright = shield_model.regressor(linear, "linear", start)
    dim = shield_model.regressor(np.float32(0.6 * linear), "linear", start)
    np.testing.assert_allclose(dim, bright, atol=0.05)


def test_a_regressor_turns_with_the_image(shields, shield_model):
    image, truth = shields[16]
    found = shield_model.regressor(image, "srgb", start_of(shield_model, truth))
    turned = np.ascontiguousarray(np.rot90(image))  # (x, y) becomes (y, width - 1 - x)
    start = start_of(shield_model, truth)
    there = shield_model.regressor(turned, "srgb", np.stack([start[:, 1], 159.0 - start[:, 0]], axis=1))
    np.testing.assert_allclose(np.stack([159.0 - there[:, 1], there[:, 0]], axis=1), found, atol=0.5)


@pytest.mark.parametrize("image", [np.zeros((160, 160, 3), np.uint8), np.full((9, 7, 3), 90, np.uint8)])
def test_a_regressor_sees_nothing_in_an_image_without_gradients(image, shield_model):
    start = start_of(shield_model, 30.0 * CORNERS + 80.0)
    assert np.isfinite(shield_model.regressor(image, "srgb", start)).all()


def test_histograms_turn_with_the_shape(shields):
    image, truth = shields[3]
    mean = procrustes_mean(np.array([truth]))
    mean = mean * (SIZE / diagonal_of(mean))
    pose = align(mean, truth)
    upright = OrientationHistograms(image, "srgb", truth, pose)
    turned = OrientationHistograms(image, "srgb", truth, align(mean @ rotation(0.05).T, truth))
    # The same axes of cells on an image that was encoded along other axes
    np.testing.assert_allclose(turned.features(truth, pose, 6.0), upright.features(truth, pose, 6.0), atol=0.06)


def test_left_out_predictions_are_those_without_the_samples(rng):
    x = rng.normal(size=(30, 5)).astype(np.float32)
    y = x[:, :2] + rng.normal(0.0, 0.1, (30, 2))
    x[:, 0] -= x[:, 0].mean()
    block = np.arange(6)
    everything = _ridge_regression(x, y, 0.01, [block, np.arange(6, 30)], np.ones(30, bool))
    middle = x.mean(axis=0)
    away = x - middle
    ridge = 0.01 * np.square(away).sum() / len(x)
    rest = away[6:].astype(float)
    wanted = y - y.mean(axis=0)
    weights = np.linalg.solve(rest.T @ rest + ridge * np.eye(5), rest.T @ wanted[6:])
    expected = away[block] @ weights + y.mean(axis=0)
    np.testing.assert_allclose(everything.left_out[block], expected, atol=2e-3)  # weights are rounded


def test_samples_that_are_not_known_are_predicted_from_the_others(rng):
    x = rng.normal(size=(30, 5)).astype(np.float32)
    y = x[:, :2] + rng.normal(0.0, 0.1, (30, 2))
    known = np.arange(30) >= 4
    blocks = [np.arange(6), np.arange(6, 30)]
    without = _ridge_regression(x[4:], y[4:], 0.01, [np.arange(2), np.arange(2, 26)], np.ones(26, bool))
    wrong = np.where(known[:, None], y, 100.0)
    learnt = _ridge_regression(x, wrong, 0.01, blocks, known)
    np.testing.assert_array_equal(learnt.weights, without.weights)
    np.testing.assert_allclose(learnt.left_out[4:], without.left_out, atol=1e-6)
    np.testing.assert_allclose(learnt.left_out[:4], x[:4] @ without.weights + without.offset, atol=1e-6)


def test_fits_of_varied_objects_are_nearer_with_a_regressor(shields, shield_model):
    def errors_of(model) -> list[float]:
        fitter = Fitter(model)
        return [error_of(fitter.fit(image, start_of(model, truth)).landmarks, truth) for image, truth in shields[14:]]

    errors = errors_of(shield_model)
    assert max(errors) < 0.05
    assert np.mean(errors) < 0.5 * np.mean(errors_of(replace(shield_model, regressor=None)))


@pytest.mark.parametrize("lost", [0, 1])
def test_of_two_fits_with_a_regressor_a_lost_one_is_not_returned(shields, shield_model, monkeypatch, lost):
    image, truth = shields[17]
    right = Fitter(shield_model).fit(image, start_of(shield_model, truth))
    fits = [right, replace(right, evidence=right.evidence - 0.1)]
    fits[lost] = replace(right, status=FitStatus.DIVERGED, evidence=right.evidence + 1.0)
    monkeypatch.setattr(OneShapeFitter, "_fit_regressed", lambda *_: fits[0])
    monkeypatch.setattr(OneShapeFitter, "_fit_blurred_and_regressed", lambda *_: fits[1])
    fitter = OneShapeFitter(shield_model)  # without a quality, both are tried
    assert fitter.fit_target(Fitter(shield_model).target(image, truth)[0]) is fits[1 - lost]


def test_a_regressor_that_cannot_be_learnt_is_said(shields):
    with pytest.warns(UserWarning, match="has no regressor, .* 5 objects with all landmarks at least: give more"):
        model = train(shields[:3], regressor=True, shapes=1, diagonal=40, leave_out=False)
    assert model.regressor is None


@pytest.mark.slow
def test_shells_of_many_species_are_found_by_a_regressor(shells):
    """Without one, one in six shells is lost from the box of its landmarks."""
    model, others = shells
    assert model.regressor is not None
    fitter = Fitter(model)
    errors = []
    for sample in others:
        truth = sample.landmarks.points
        result = fitter.fit(sample.image, np.r_[truth.min(axis=0), truth.max(axis=0)])
        errors.append(error_of(result.landmarks, truth))
    assert np.median(errors) < 0.0135
    assert np.mean(np.array(errors) > 0.05) <= 0.05


def test_a_model_file_holds_the_regressor(shields, shield_model, tmp_path):
    shield_model.save(tmp_path / "shield.liaam")
    loaded = load_model(tmp_path / "shield.liaam")
    image, truth = shields[20]
    start = start_of(shield_model, truth)
    expected = shield_model.regressor(image, "srgb", start)
    np.testing.assert_array_equal(loaded.regressor(image, "srgb", start), expected)
    before = Fitter(shield_model).fit(image, start)
    after = Fitter(loaded).fit(image, start)
    np.testing.assert_allclose(after.landmarks, before.landmarks, atol=1e-6)


def test_a_model_gets_a_regressor_only_where_fits_need_one(shields, model):
    assert model.regressor is None  # no fit to a left-out image failed
    assert train(shields[:6], regressor=False, shapes=1, diagonal=60).regressor is None
    with pytest.raises(TrainingError, match="regressor 'maybe': give True, False or 'auto'"):
        train(shields[:6], regressor="maybe")


def test_a_mirrored_model_has_no_regressor(shield_model):
    from liaam.model.mirror import mirrored_model

    order = np.array([2, 1, 0, 6, 5, 4, 3])
    assert mirrored_model(replace(shield_model, features=None), order).regressor is None


FORGED = {
    "a step less": ("spacings", lambda a: a[:-1], "regressor.weights"),
    "a cell of no size": ("spacings", lambda a: 0.0 * a, "regressor.spacings are not 1 to 10 distances"),
    "endless steps": ("spacings", lambda a: np.tile(a, 5), "regressor.spacings are not 1 to 10 distances"),
    "weights of fewer features": ("weights", lambda a: a[:, :, 1:], "regressor.weights"),
    "weights without bound": ("weights", lambda a: a * np.float32(np.nan), "regressor.weights"),
    "offsets without bound": ("offsets", lambda a: a + 1e300, "regressor.offsets"),
    "an indefinite covariance": ("variances", lambda a: -a, "regressor.variances"),
    "a certain landmark": ("noise", lambda a: 0.0 * a, "regressor.errors or regressor.noise are out of range"),
    "errors without bound": ("errors", lambda a: a + 1e30, "regressor.errors or regressor.noise are out of range"),
}


@pytest.mark.parametrize(("name", "change", "message"), FORGED.values(), ids=FORGED)
def test_a_forged_regressor_is_refused_by_name(shield_model, tmp_path, name, change, message):
    path = tmp_path / "forged.liaam"
    shield_model.save(path)
    with safe_open(path, framework="numpy") as file:
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        header = file.metadata()
    key = f"regressor.{name}"
    tensors[key] = np.ascontiguousarray(change(tensors[key].astype(np.float64)).astype(tensors[key].dtype))
    path.write_bytes(save(tensors, header))
    with pytest.raises(ModelFileError, match=message):
        load_model(path)
