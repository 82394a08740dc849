"""Refining fits by regression: what it learns, what it does to results, and its mirror image."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save

from liaam import Fitter, load_model, train
from liaam.datasets import Sample
from liaam.errors import ModelFileError
from liaam.io import Landmarks
from liaam.model.mirror import mirrored_model
from liaam.model.regressor import LandmarkRegressor, OrientationHistograms, _mirrored_features
from liaam.model.shape import rotation
from liaam.training.refiner import learn_refiner

OUTLINE = np.array([[-1.0, -1.0], [0.0, -1.3], [1.0, -1.0], [1.0, 0.2], [0.6, 1.0], [-0.6, 1.0], [-1.0, 0.2]])
ORDER = np.array([2, 1, 0, 6, 5, 4, 3])
"""Mirror image of each landmark."""

WIDTH = 160


def drawn(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a shield on paper; return the image and its corners."""
    corners = OUTLINE + rng.normal(0.0, 0.12, OUTLINE.shape)
    points = 34.0 * corners @ rotation(rng.normal(0.0, 0.1)).T + 80.0 + rng.normal(0.0, 3.0, 2)
    picture = np.full((WIDTH, WIDTH, 3), 0.65, np.float32)
    outline = np.rint(points * 16).astype(np.int32)
    cv2.fillPoly(picture, [outline], (0.25, 0.3, 0.2), cv2.LINE_AA, shift=4)
    cv2.polylines(picture, [outline], True, (0.1, 0.1, 0.1), 2, cv2.LINE_AA, shift=4)
    picture += rng.normal(0.0, 0.01, picture.shape).astype(np.float32)
    return np.clip(255.0 * picture, 0, 255).astype(np.uint8), points


def mirrored(points: np.ndarray) -> np.ndarray:
    """Landmarks of the mirror image of a picture."""
    return (points * [-1.0, 1.0] + [WIDTH - 1.0, 0.0])[ORDER]


@pytest.fixture(scope="module")
def shields() -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(6)
    return [drawn(rng) for _ in range(50)]


@pytest.fixture(scope="module")
def plain(shields):
    """A model with too few modes for shields, so that fits are off."""
    return train(shields[:6], regressor=False, shapes=1, diagonal=60, leave_out=False, variance=2)


@pytest.fixture(scope="module")
def refined(shields, plain):
    samples = [Sample(f"{i:02d}", image, Landmarks(points)) for i, (image, points) in enumerate(shields[:35])]
    return replace(plain, refiner=learn_refiner(samples, plain.shape_model.mean))


def refiner_of(model):
    assert model.refiner is not None
    return model.refiner


def results_of(model, shields):
    fitter = Fitter(model)
    return [fitter.fit(image, np.r_[truth.min(0), truth.max(0)]) for image, truth in shields]


def test_of_several_fits_only_the_result_is_refined(shields, refined, monkeypatch):
    refine = LandmarkRegressor.refined
    starts = []

    def counted(refiner, image, response, shape):
        starts.append(shape)
        return refine(refiner, image, response, shape)

    monkeypatch.setattr(LandmarkRegressor, "refined", counted)
    image, truth = shields[35]
    result = Fitter(refined, rotations="all").fit(image, np.r_[truth.min(0), truth.max(0)])
    assert len(starts) == 1
    np.testing.assert_allclose(starts[0], result.registered, atol=1e-9)


def test_refined_fits_are_nearer(shields, plain, refined):
    new = shields[35:]
    before, after = (
        [
            np.linalg.norm(result.landmarks - truth, axis=1).mean()
            for result, (_, truth) in zip(results_of(model, new), new, strict=True)
        ]
        for model in (plain, refined)
    )
    assert np.median(after) < 0.85 * np.median(before)


def test_what_is_compared_with_the_image_stays(shields, plain, refined):
    before, after = (results_of(model, shields[40:41])[0] for model in (plain, refined))
    np.testing.assert_allclose(after.registered, before.registered, atol=1e-9)
    np.testing.assert_array_equal(after.p, before.p)
    assert after.shift is not None
    assert 0.0 < np.abs(after.shift).max() < 20.0


def test_features_have_mirror_images(shields, plain):
    image, truth = shields[12]
    mean = plain.shape_model.mean * (120.0 / plain.diagonal)
    own = OrientationHistograms(image, "srgb", truth, mean)
    other = OrientationHistograms(
        np.ascontiguousarray(image[:, ::-1]), "srgb", mirrored(truth), (mean * [-1.0, 1.0])[ORDER]
    )
    there = other.features(mirrored(truth), other.pose, 5.0)[ORDER]
    here = own.features(truth, own.pose, 5.0)
    np.testing.assert_allclose(there, here[:, _mirrored_features()], atol=0.06)
    assert np.abs(there - here).max() > 0.1


def test_the_mirror_image_of_a_model_refines_mirror_images_alike(shields, refined):
    image, truth = shields[42]
    expected = refiner_of(refined).refined(image, "srgb", truth + 1.5)
    other = refiner_of(mirrored_model(refined, ORDER))
    found = other.refined(np.ascontiguousarray(image[:, ::-1]), "srgb", mirrored(truth + 1.5))
    np.testing.assert_allclose(mirrored(found), expected, atol=0.3)
    assert np.abs(expected - truth - 1.5).max() > 0.6


def test_a_model_file_holds_the_refiner(shields, refined, tmp_path, run):
    refined.save(tmp_path / "shield.liaam")
    loaded = load_model(tmp_path / "shield.liaam")
    image, truth = shields[43]
    expected = refiner_of(refined).refined(image, "srgb", truth)
    np.testing.assert_allclose(refiner_of(loaded).refined(image, "srgb", truth), expected, atol=1e-6)
    code, out, _ = run("show", tmp_path / "shield.liaam")
    assert code == 0
    assert "fits are averaged with landmarks by regression" in out


@pytest.mark.parametrize("name", ["weights", "offsets", "variances", "shape.modes", "errors"])
def test_a_forged_refiner_is_refused(refined, tmp_path, name):
    path = tmp_path / "forged.liaam"
    refined.save(path)
    with safe_open(path, "np") as file:
        header = file.metadata()
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    tensors[f"refiner.{name}"] = np.full_like(tensors[f"refiner.{name}"], np.nan if name == "weights" else 1e30)
    path.write_bytes(save(tensors, header))
    with pytest.raises(ModelFileError):
        load_model(path)
