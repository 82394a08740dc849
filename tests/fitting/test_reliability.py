"""Quality of fits: calibrated on pictures left out, it tells right from wrong."""

from dataclasses import replace

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from liaam.errors import ModelFileError
from liaam.fitting import METHODS, Detection, FitStatus, Fitter
from liaam.fitting.quality import FEATURES, landmark_covariances
from liaam.model import MESH, SURROUNDINGS, load_model
from liaam.model.shape import Recipe, Similarity, diagonal_of, shape_model_on
from liaam.model.views import N_QUALITY_FEATURES
from liaam.training import train
from liaam.training.covariances import (
    LARGEST_FACTOR,
    Alike,
    beyond,
    learn_covariances,
    surprise,
    variance_factor,
)
from liaam.training.reliability import _logistic, _weights
from setups import disturb

SCATTERED = Alike.of(np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]]), ())


def known_by(model):
    """Calibration of the default method."""
    return model.views[SURROUNDINGS].reliabilities["soft-li"]


def changed(model, **changes):
    """Model whose calibration of the default method is changed."""
    return model.with_view(SURROUNDINGS, reliabilities={"soft-li": replace(known_by(model), **changes)})


def test_it_tells_right_fits_from_wrong_ones(calibrated, lit_scene, same_light_scene):
    fitter = Fitter(calibrated)
    for scene in (lit_scene, same_light_scene):
        right = fitter.fit(scene.image, disturb(scene.landmarks))
        away = scene.landmarks - scene.landmarks.mean(axis=0) + 0.25 * np.array(scene.image.shape[1::-1])
        wrong = fitter.fit(scene.image, 0.5 * away)
        assert right.quality > 0.5
        assert right.status.ok
        if np.linalg.norm(wrong.landmarks - scene.landmarks, axis=1).mean() > 0.1 * diagonal_of(scene.landmarks):
            assert wrong.quality < 0.5
            assert not wrong.status.ok


def test_a_settled_fit_of_low_quality_is_doubtful(calibrated, rng):
    import cv2

    blots = cv2.GaussianBlur(rng.random((180, 240, 3)).astype(np.float32), (0, 0), 6.0)
    blots = (blots - blots.min()) / np.ptp(blots)
    result = Fitter(calibrated).fit(blots, (60, 40, 180, 150))
    assert not result.status.ok
    assert result.quality < 0.5


@pytest.mark.parametrize("value", [0, 255])
def test_what_is_lost_by_its_status_has_no_chance_to_be_right(calibrated, value):
    result = Fitter(calibrated).fit(np.full((180, 240, 3), value, np.uint8), (60, 40, 180, 150))
    assert result.status.lost
    assert result.quality == 0.0


def test_a_method_that_training_was_asked_for_is_calibrated_too(scenes, same_light_scene, tmp_path):
    pairs = [(scene.image, scene.landmarks) for scene in scenes]
    options = {"lamps": None, "regressor": False, "methods": ["li", "li-lit"]}
    train(pairs, diagonal=60.0, **options).save(tmp_path / "m.liaam")
    model = load_model(tmp_path / "m.liaam")
    assert list(model.views[SURROUNDINGS].reliabilities) == ["soft-li"]
    assert list(model.views[MESH].reliabilities) == ["li"]  # what li-lit fits is not learnt again without images
    image, start = same_light_scene.image, disturb(same_light_scene.landmarks)
    right, wrong = (Fitter(model, "li").fit(image, shape) for shape in (start, 0.5 * start))
    assert right.calibrated and right.status.ok
    assert wrong.quality < 0.5 < right.quality
    assert np.isnan(Fitter(model, "li-lit").fit(image, start).quality)


def test_other_methods_have_no_quality(calibrated, lit_scene):
    result = Fitter(calibrated, "li").fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert np.isnan(result.quality)
    assert not result.calibrated


def test_model_and_results_say_whether_they_are_calibrated(calibrated, lit_scene):
    plain = calibrated.with_view(SURROUNDINGS, reliabilities={})
    assert calibrated.calibrated and not plain.calibrated
    for model in (calibrated, plain):
        result = Fitter(model).fit(lit_scene.image, disturb(lit_scene.landmarks))
        assert result.calibrated == result.to_dict()["calibrated"] == model.calibrated
        assert ("ellipses are not calibrated" in result.message) == (not model.calibrated)
    assert result.status is not FitStatus.DOUBTFUL


def test_it_is_kept_in_the_model_file(calibrated, tmp_path):
    calibrated.save(tmp_path / "m.liaam")
    loaded = known_by(load_model(tmp_path / "m.liaam"))
    assert loaded is not None
    np.testing.assert_array_equal(loaded.landmarks, known_by(calibrated).landmarks)
    np.testing.assert_array_equal(loaded.bias, known_by(calibrated).bias)
    assert loaded.unit == known_by(calibrated).unit
    np.testing.assert_array_equal(loaded.weights, known_by(calibrated).weights)
    assert loaded.variance_factor == known_by(calibrated).variance_factor
    assert loaded.prior == known_by(calibrated).prior
    assert loaded.typical == known_by(calibrated).typical
    assert 0.5 < loaded.low < loaded.typical < 1.0


def rewritten(calibrated, path, **tensors):
    """Model file whose reliability is changed; None takes a tensor out."""
    calibrated.save(path)
    with safe_open(path, framework="numpy") as file:
        header, known = file.metadata(), {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    known |= {f"surroundings/reliability.{name}": value for name, value in tensors.items()}
    save_file({key: value for key, value in known.items() if value is not None}, path, header)
    return path


def test_a_copy_of_the_method_under_another_name_is_judged_alike(calibrated, lit_scene):
    copy, start = replace(METHODS["soft-li"], name="mine", summary="a copy"), disturb(lit_scene.landmarks)
    ours, theirs = (Fitter(calibrated, method).fit(lit_scene.image, start) for method in ("soft-li", copy))
    assert theirs.method.name == "mine"
    assert 0.0 < ours.quality == theirs.quality
    np.testing.assert_array_equal(theirs.covariance, ours.covariance)
    np.testing.assert_array_equal(theirs.landmark_covariances, ours.landmark_covariances)


def test_another_row_on_the_same_view_has_no_quality(calibrated, lit_scene):
    other = replace(METHODS["soft-li"], loss="huber")
    assert np.isnan(Fitter(calibrated, other).fit(lit_scene.image, disturb(lit_scene.landmarks)).quality)


def test_the_quality_is_for_the_rate_of_right_fits_and_the_status_for_equal_odds(calibrated, lit_scene):
    known, start = known_by(calibrated), disturb(lit_scene.landmarks)
    assert known.prior > 3.0  # of right to wrong fits of left-out images
    models = (changed(calibrated, prior=prior) for prior in (1.0, 9.0))
    equal, likely = (Fitter(model) for model in models)
    one, other = equal.fit(lit_scene.image, start), likely.fit(lit_scene.image, start)
    assert (one.least_quality, other.least_quality) == (0.5, pytest.approx(0.9))
    assert other.quality / (1 - other.quality) == pytest.approx(9 * one.quality / (1 - one.quality))
    assert one.status is other.status
    sure, unsure = (Detection(start, score, 0.0, 1.0) for score in (0.9, 0.3))
    assert likely.fit(lit_scene.image, sure).quality == other.quality
    assert likely.fit(lit_scene.image, unsure).quality == one.quality


def test_a_file_without_a_prior_is_for_equal_odds(calibrated, tmp_path):
    assert known_by(load_model(rewritten(calibrated, tmp_path / "m.liaam", prior=None))).prior == 1.0
    for prior in (0.0, -1.0, np.nan):
        with pytest.raises(ModelFileError):
            load_model(rewritten(calibrated, tmp_path / "m.liaam", prior=np.array([prior])))


def test_a_file_without_a_typical_quality_is_refused(calibrated, tmp_path):
    with pytest.raises(ModelFileError, match="typical"):
        load_model(rewritten(calibrated, tmp_path / "m.liaam", typical=None))


@pytest.mark.parametrize("typical", [-0.1, 1.1, np.nan])
def test_a_typical_quality_that_is_no_probability_is_refused(calibrated, tmp_path, typical):
    with pytest.raises(ModelFileError):
        load_model(rewritten(calibrated, tmp_path / "m.liaam", typical=np.array([typical])))


@pytest.mark.parametrize(("typical", "low"), [(0.5, 0.5), (0.9, 0.8123), (0.99, 0.9554), (0.0, 0.0), (1.0, 1.0)])
def test_low_is_two_thirds_of_the_log_odds(calibrated, typical, low):
    assert replace(known_by(calibrated), typical=typical).low == pytest.approx(low, abs=1e-3)


def test_nearly_all_right_fits_are_typical(calibrated, scenes):
    fits, known = (
        [Fitter(calibrated).fit(scene.image, disturb(scene.landmarks)) for scene in scenes],
        known_by(calibrated),
    )
    least = known.with_prior(known.typical)
    assert np.mean([fit.quality >= least for fit in fits]) >= 0.8


def test_variances_grow_by_what_fits_understate(calibrated, lit_scene):
    models = (changed(calibrated, variance_factor=k) for k in (1.0, 2.0))
    one, two = (Fitter(model).fit(lit_scene.image, disturb(lit_scene.landmarks)) for model in models)
    np.testing.assert_allclose(two.covariance, 2 * one.covariance)
    grown = np.linalg.eigvalsh(two.landmark_covariances - one.landmark_covariances)
    assert (grown > 0).all()


def test_surprises_of_what_is_stated_rightly_are_one_on_average(rng):
    own = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.5], [0.0, 0.5, 1.0]])
    errors = rng.multivariate_normal(np.zeros(3), own, 4000)
    assert np.mean([surprise(error, own) for error in errors]) == pytest.approx(1.0, abs=0.05)
    assert np.isnan(surprise(errors[0], np.zeros((3, 3))))
    # What follows p, an angle, does not count.
    assert surprise(errors[0][:2], own) == pytest.approx(surprise(errors[0][:2], own[:2, :2]))


def test_understatement_is_learnt_from_many_doubted_from_few_and_bounded():
    assert variance_factor(np.full(200, 4.0)) == pytest.approx(4.0, rel=0.1)
    assert 1.0 < variance_factor(np.full(3, 4.0)) < 2.0
    assert variance_factor(np.full(20, 0.1)) == 1.0  # nothing is ever surer than it says
    assert variance_factor(np.full(20, 1e9)) == LARGEST_FACTOR
    assert variance_factor(np.array([np.nan, np.inf])) == 1.0


def test_the_covariance_of_landmarks_makes_up_for_what_fits_do_not_state(rng):
    true = np.array([[4.0, 1.0], [1.0, 2.0]])
    errors = rng.multivariate_normal(np.zeros(2), true, (4000, 3))
    stated = np.broadcast_to(0.5 * np.eye(2), (4000, 3, 2, 2))
    shapes = np.broadcast_to(0.3 * np.eye(2), (3, 2, 2))
    found = beyond(errors, stated, shapes, SCATTERED)
    np.testing.assert_allclose(found + shapes + stated[0], np.broadcast_to(true, (3, 2, 2)), atol=0.3)
    assert not beyond(errors, stated, 9.0 * shapes / 0.3, SCATTERED).any()


def test_what_an_image_leaves_unexplained_widens_its_covariances(calibrated, same_light_scene):
    known, start = known_by(calibrated), disturb(same_light_scene.landmarks)
    fit = Fitter(calibrated).fit(same_light_scene.image, start)
    assert fit.residual_variance > 0
    harder = changed(calibrated, unit=known.unit / 3)
    grown = Fitter(harder).fit(same_light_scene.image, start).landmark_covariances - fit.landmark_covariances
    scale = fit.pose.scale**2 * fit.residual_variance / known.unit
    assert np.trace(grown, axis1=1, axis2=2) == pytest.approx(2 * scale * np.trace(known.bias, axis1=1, axis2=2))


def test_ellipses_of_a_turned_contour_are_long_along_it(rng):
    at = np.linspace(0.0, np.pi, 20)
    arc = 50.0 * np.column_stack([np.cos(at), np.sin(at)])
    tangents = np.column_stack([-np.sin(at), np.cos(at)])
    errors = 4.0 * tangents[:, :, None] * tangents[:, None]  # of standard deviation 2, along the arc only
    shapes = arc + rng.standard_normal((8, 20, 2))
    model = replace(shape_model_on(arc, shapes, 0.9, Recipe()), unexplained=errors)
    p = model.parameters(np.column_stack([-arc[:, 1], arc[:, 0]]))  # a quarter turn
    still = np.zeros((len(p), len(p)))
    found = landmark_covariances(model, Similarity(np.eye(2), np.zeros(2)), p, still, [(range(20), False)])
    across = np.column_stack([np.cos(at + np.pi / 2), np.sin(at + np.pi / 2)])
    inside = slice(1, -1)  # the ends have only one neighbour
    assert np.einsum("na,nab,nb->n", across, found, across)[inside].max() < 0.05
    assert np.trace(found, axis1=1, axis2=2) == pytest.approx(4.0)


def test_few_errors_on_contours_are_shrunk_along_and_across_them(rng):
    at = np.linspace(0.0, np.pi, 20)
    arc = 50.0 * np.column_stack([np.cos(at), np.sin(at)])
    shape = np.vstack([arc, rng.uniform(-20, 20, (20, 2))])
    alike = Alike.of(shape, [(range(20), False)])
    tangents = np.column_stack([-np.sin(at), np.cos(at)])
    slid = 4.0 * rng.standard_normal((8, 20, 1)) * tangents + 0.5 * rng.standard_normal((8, 20, 2))
    errors = np.concatenate([slid, rng.standard_normal((8, 20, 2))], axis=1)
    found = beyond(errors, np.zeros((8, 40, 2, 2)), np.zeros((40, 2, 2)), alike)
    along = np.einsum("na,nab,nb->n", tangents, found[:20], tangents)
    across = np.trace(found[:20], axis1=1, axis2=2) - along
    assert along.mean() == pytest.approx(16.0, rel=0.5)
    assert across.max() < 2.0
    assert np.trace(found[20:], axis1=1, axis2=2).max() < 10.0


def stated_by(known: dict, spread: np.ndarray) -> np.ndarray:
    """The covariances (n, 2, 2) of landmarks whose fits state ``spread`` and leave a residual of variance 1."""
    return known["scales"] @ (known["variance_factor"] * spread + known["landmarks"] + known["bias"]) @ known["scales"]


def test_variances_along_and_across_contours_are_calibrated_apart(rng):
    shape = np.column_stack([np.arange(30.0), np.zeros(30)])
    errors = rng.standard_normal((400, 30, 2)) * [3.0, 0.5]
    spreads, shapes = np.tile(np.eye(2), (400, 30, 1, 1)), np.tile(0.1 * np.eye(2), (30, 1, 1))
    ratios = []
    for contours in ((), [(range(30), False)]):
        known = learn_covariances(errors, spreads, 1.5, np.ones(400), shapes, Alike.of(shape, contours))
        stated = stated_by(known, spreads[0])
        ratios.append(stated[:, 0, 0].mean() / stated[:, 1, 1].mean())
    assert ratios[0] < 7.0  # what fits state themselves is no direction's
    assert ratios[1] == pytest.approx(36.0, rel=0.1)


def test_each_landmark_is_calibrated_as_far_as_differences_are_not_chance(rng):
    sizes = np.array([0.8, 1.5, 1.5, 3.0])
    shape = rng.uniform(-20, 20, (4, 2))
    nothing = np.zeros((4, 2, 2))

    def factors(m: int, sizes: np.ndarray) -> np.ndarray:
        errors = rng.standard_normal((m, 4, 2)) * sizes[:, None]
        known = learn_covariances(
            errors, np.tile(4 * np.eye(2), (m, 4, 1, 1)), 1.0, np.ones(m), nothing, Alike.of(shape, ())
        )
        return np.trace(stated_by(known, 4 * np.eye(2)), axis1=1, axis2=2) / (2 * np.square(sizes))

    np.testing.assert_allclose(factors(400, sizes), 1.0, rtol=0.25)
    equal = factors(10, np.ones(4))  # whose mean squared errors differ by 1 / sqrt(10)
    assert np.ptp(equal) < 0.3 * equal.mean()
    assert equal.mean() > 1.2  # few errors underestimate the tails


def test_errors_of_landmarks_that_are_not_known_are_left_out(rng):
    shape = rng.uniform(-20, 20, (6, 2))
    errors = rng.standard_normal((200, 6, 2)) * np.array([1, 1, 1, 1, 1, 3.0])[:, None]
    spreads = np.tile(0.1 * np.eye(2), (200, 6, 1, 1))
    shapes = np.tile(0.01 * np.eye(2), (6, 1, 1))
    alike = Alike.of(shape, ())
    whole = learn_covariances(errors, spreads, 1.0, np.ones(200), shapes, alike)
    holed = errors.copy()
    holed[::2, 5] = np.nan
    holed[:, 2] = np.nan
    part = learn_covariances(holed, spreads, 1.0, np.ones(200), shapes, alike)
    sizes = [np.trace(each["bias"], axis1=1, axis2=2) for each in (whole, part)]
    assert sizes[1][5] == pytest.approx(sizes[0][5], rel=0.3)  # of half as many errors
    np.testing.assert_allclose(sizes[1][[0, 1, 3, 4]], sizes[0][[0, 1, 3, 4]], rtol=0.1)
    assert sizes[1][[0, 1, 3, 4]].max() < sizes[1][2] < sizes[1][5]  # that of a landmark without errors is the mean


def test_the_logistic_regression_separates_and_does_not_care_how_many_of_each():
    features = np.array([[0.8], [0.7], [0.75], [-0.2], [-0.3]])
    right = np.array([True, True, True, False, False])
    weights = _logistic(features, right)
    odds = weights[0] + features @ weights[1:]
    assert ((odds > 0) == right).all()
    assert -weights[0] / weights[1] == pytest.approx(0.25, abs=0.15)


def test_a_strange_shape_never_speaks_for_a_fit(rng):
    evidence = np.column_stack([np.repeat([0.7, -0.2], 10), np.repeat([1.0, 0.0], 10)]) + 0.01 * rng.random((20, 2))
    weights = _weights(evidence, np.repeat([True, False], 10))
    assert weights[1] > 0
    assert weights[2] == 0


def test_the_model_knows_how_many_features_the_quality_has():
    assert len(FEATURES) == N_QUALITY_FEATURES


def test_a_model_that_is_older_than_a_feature_gives_it_no_weight(calibrated):
    known = calibrated.views[SURROUNDINGS].reliabilities["soft-li"]
    evidence = np.full(len(known.weights) - 1, 0.5)
    assert known.quality(np.append(evidence, 99.0)) == known.quality(evidence)


def test_the_quality_is_one_half_where_right_and_wrong_fits_come_closest():
    """Not halfway between their means, where few but right fits under hard light may lie."""
    features = np.repeat([0.45, 0.12, -0.1], [17, 3, 20])
    weights = _logistic(features[:, None], features > 0.0)
    border, closest, halfway = -weights[0] / weights[1], 0.01, 0.15
    assert abs(border - closest) < abs(border - halfway)
