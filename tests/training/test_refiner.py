"""Refining fits by regression: what it learns, what it does to results, and its mirror image."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save

from liaam import Fitter, load_model, train
from liaam.datasets import Sample
from liaam.errors import ModelFileError, TrainingError
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.io import Landmarks
from liaam.model.mirror import mirrored_model
from liaam.model.regressor import OF_FITS, LandmarkRegressor, OrientationHistograms, _mirrored_features
from liaam.model.shape import ShapeModel, align, expanded_about, rotation
from liaam.training.left_out_fits import LeftOutFit, LeftOutFits
from liaam.training.refiner import Refinement, RefinerLearner, learn_refiner, seen_of

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

    def counted(refiner, image, response, shape, **of_image):
        starts.append(shape)
        return refine(refiner, image, response, shape, **of_image)

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


@pytest.fixture(scope="module")
def trained(shields):
    """Models that are trained on the same shields as usual, without and with a refiner."""
    options = {"regressor": False, "shapes": 1, "diagonal": 60, "variance": 4}
    return train(shields[:20], refiner=False, **options), train(shields[:20], **options)


def test_training_learns_a_refiner_where_it_helps(shields, trained):
    without, with_refiner = trained
    assert without.refiner is None
    assert with_refiner.refiner is not None
    errors = [
        [
            np.linalg.norm(result.landmarks - truth, axis=1).mean()
            for result, (_, truth) in zip(results_of(model, shields[20:]), shields[20:], strict=True)
        ]
        for model in trained
    ]
    assert np.mean(errors[1]) < 0.95 * np.mean(errors[0])


def test_errors_that_are_stated_are_those_of_refined_fits(shields, trained):
    new = shields[20:]
    squares = []
    for result, (_, truth) in zip(results_of(trained[1], new), new, strict=True):
        away = truth - result.landmarks
        squares.append(np.einsum("na,nab,nb->n", away, np.linalg.inv(result.landmark_covariances), away))
    within = np.mean(np.array(squares) < 5.991)  # of 95 % of the ellipses
    assert 0.85 < within < 0.995


def test_refined_shapes_are_as_far_from_the_mean_as_the_model_says(shields, trained):
    model = trained[1]
    image, _ = shields[30]
    result = results_of(model, shields[30:31])[0]
    refined = refiner_of(model).refined(image, "srgb", result.registered)
    expected = expanded_about(model.shape_model.mean, refined, result.expansion)
    np.testing.assert_allclose(result.landmarks, expected, atol=1e-9)


def test_without_left_out_fits_nothing_says_that_a_refiner_helps(shields):
    options = {"regressor": False, "shapes": 1, "diagonal": 60, "leave_out": False}
    assert train(shields[:6], **options).refiner is None
    assert train(shields[:6], refiner=True, **options).refiner is not None
    with pytest.warns(UserWarning, match="the model has no refiner"):
        assert train(shields[:3], refiner=True, **options).refiner is None


def test_an_unknown_choice_is_refused(shields):
    with pytest.raises(TrainingError, match="refiner 'never'"):
        train(shields[:6], refiner="never")


def fits_that_refining_moves(scale: float) -> dict[str, LeftOutFits]:
    """Fits that are off by 1 pixel, and refined by so many times as much."""
    rng = np.random.default_rng(4)
    shapes = ShapeModel(60.0 * OUTLINE, np.zeros((0, 14)), np.zeros(0))
    fits = []
    for _ in range(12):
        off = rng.normal(0.0, 1.0, OUTLINE.shape)
        fit = LeftOutFit(
            near=True,
            error=0.0,
            evidence=np.zeros(2),
            unit=1.0,
            shapes=shapes,
            contours=(),
            truth=shapes.mean + off,
            known=np.ones(len(OUTLINE), bool),
            p=np.zeros(4),
            covariance=np.eye(4),
            refinement=scale * off + rng.normal(0.0, 0.01, off.shape),
        )
        fits.append(fit.expanded(1.0))  # with its error
    return {DEFAULT_METHOD: LeftOutFits(fits=fits, n_near=len(fits))}


@pytest.mark.parametrize(("scale", "helps"), [(0.5, True), (-0.5, False), (2.0, False)])
def test_a_refiner_helps_if_fits_are_nearer(scale, helps):
    owners = np.arange(5)
    refinement = Refinement(RefinerLearner(60.0 * OUTLINE), seen_of(owners), owners, list(owners[:, None]))
    assert refinement.helps(fits_that_refining_moves(scale)) == helps


@pytest.mark.parametrize(("scale", "share"), [(0.5, 1.0), (1.25, 0.4), (-0.5, 0.0)])
def test_fits_are_nearest_at_the_share_that_is_learnt(scale, share):
    fits = fits_that_refining_moves(scale)  # with half of the way to where refiners lead
    owners = np.arange(5)
    refinement = Refinement(RefinerLearner(60.0 * OUTLINE), seen_of(owners), owners, list(owners[:, None]))
    learnt = refinement.best_share({name: [of_method] for name, of_method in fits.items()})
    assert learnt == pytest.approx(share, abs=0.01)
    near = fits[DEFAULT_METHOD].refined_by(learnt).near_error
    assert near <= min(fits[DEFAULT_METHOD].refined_by(other).near_error for other in (0.2, 0.5, 0.8))


def test_images_and_copies_to_learn_from():
    np.testing.assert_array_equal(seen_of(np.repeat(np.arange(3), 4)), np.arange(12))
    many = np.repeat(np.arange(300), 3)  # two copies of each
    seen = seen_of(many)
    assert len(seen) == 200
    assert len(np.unique(many[seen])) == 100
    assert (np.bincount(many[seen])[many[seen]] == 2).all()  # each with one copy


def test_absent_landmarks_follow_from_the_others(shields, refined):
    image, truth = shields[44]
    absent = np.arange(len(truth)) == 3
    refiner = refiner_of(refined)
    blind = [replace(step, offsets=step.offsets + 30.0 * absent[:, None]) for step in refiner.steps]
    misled = replace(refiner, steps=tuple(blind))
    expected = refiner.refined(image, "srgb", truth + 1.0, absent=absent)
    np.testing.assert_allclose(misled.refined(image, "srgb", truth + 1.0, absent=absent), expected, atol=0.01)
    assert np.abs(misled.refined(image, "srgb", truth + 1.0) - expected).max() > 1.0


def test_what_is_estimated_in_training_teaches_nothing(shields):
    rng = np.random.default_rng(9)
    mean = 20.0 * OUTLINE
    learners = RefinerLearner(mean), RefinerLearner(mean)
    for image, truth in shields[:20]:
        known = rng.random(len(truth)) > 0.2
        estimates = np.where(known[:, None], truth, truth + np.array([4.0, 0.0]))  # all on the wrong side
        learners[0].add(image, truth)
        learners[1].add(image, estimates, known)
    groups = [np.array([i]) for i in range(20)]
    complete, incomplete = (learner.learn(groups) for learner in learners)
    assert complete is not None
    assert incomplete is not None
    away = []
    for image, truth in shields[30:]:
        start = truth + rng.normal(0.0, 1.0, truth.shape)
        away.append([refiner(image, "srgb", start, OF_FITS) - truth for refiner in (complete, incomplete)])
    error = np.linalg.norm(np.array(away), axis=-1).mean(axis=(0, 2))
    assert error[1] < 1.3 * error[0]
    assert abs(np.array(away)[:, 1, :, 0].mean()) < 0.4  # of the four pixels


def test_features_have_mirror_images(shields, plain):
    image, truth = shields[12]
    mean = plain.shape_model.mean * (120.0 / plain.diagonal)
    pose = align(mean, truth)
    there_pose = align((mean * [-1.0, 1.0])[ORDER], mirrored(truth))
    own = OrientationHistograms(image, "srgb", truth, pose)
    other = OrientationHistograms(np.ascontiguousarray(image[:, ::-1]), "srgb", mirrored(truth), there_pose)
    there = other.features(mirrored(truth), there_pose, 5.0)[ORDER]
    here = own.features(truth, pose, 5.0)
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
    model = replace(refined, refiner=replace(refiner_of(refined), share=0.7, sharpness=0.8))
    model.save(tmp_path / "shield.liaam")
    loaded = load_model(tmp_path / "shield.liaam")
    image, truth = shields[43]
    expected = refiner_of(model).refined(image, "srgb", truth)
    np.testing.assert_allclose(refiner_of(loaded).refined(image, "srgb", truth), expected, atol=1e-6)
    code, out, _ = run("show", tmp_path / "shield.liaam")
    assert code == 0
    assert "fits are moved 70% of the way to landmarks by regression" in out


def test_a_refiner_of_an_older_file_sees_what_it_learnt_from(refined, tmp_path):
    path = tmp_path / "older.liaam"
    refined.save(path)
    with safe_open(path, "np") as file:
        header = file.metadata()
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    del tensors["refiner.share"], tensors["refiner.sharpness"]
    path.write_bytes(save(tensors, header))
    refiner = refiner_of(load_model(path))
    assert (refiner.share, refiner.sharpness) == (0.5, 1.0)


@pytest.mark.parametrize("name", ["weights", "offsets", "variances", "shape.modes", "errors", "share", "sharpness"])
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
