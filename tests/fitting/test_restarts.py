"""Fits that came to little are begun again from elsewhere, and never end worse than they were."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.fitting import Fitter, SolverOptions
from liaam.fitting.loop.levels import is_sane
from liaam.fitting.loop.objective import Objective
from liaam.fitting.quality import SLOW
from liaam.fitting.search import restarts
from liaam.fitting.search.restarts import APART, MODES, fit_again, other_starts
from liaam.model import SURROUNDINGS
from liaam.model.cost import STARTS
from liaam.model.shape import diagonal_of
from liaam.tracking import Tracker
from setups import MOVING_FRAMES, disturb, model_pixels, moving_scene, train_on

FAR = ((0.7, (0.12, -0.04)), (1.2, (-0.15, 0.1)))
"""Scales and shifts of starts from which single fits are lost."""


@pytest.fixture(scope="module")
def both(calibrated, lit_scene):
    """Give the fits from far starts without and with restarts."""
    rng = np.random.default_rng(5)
    far = [(np.exp(rng.uniform(np.log(0.7), np.log(1.35))), tuple(rng.uniform(-0.2, 0.2, 2))) for _ in range(20)]
    starts = [disturb(lit_scene.landmarks, *by) for by in far]
    return [[Fitter(calibrated, restarts=on).fit(lit_scene.image, start) for start in starts] for on in (False, True)]


def test_the_cost_of_a_model_counts_the_starts_at_the_coarsest_level(calibrated, lit_scene, monkeypatch):
    own = Fitter(calibrated)
    target, _ = own.target(lit_scene.image, lit_scene.landmarks)
    begun = []
    solve = Objective.solve

    def counted(objective, *given, **named):
        begun.append(objective)
        return solve(objective, *given, **named)

    monkeypatch.setattr(Objective, "solve", counted)
    monkeypatch.setattr(restarts, "_best", lambda stages, count, _start: stages[:count])  # as if all were apart
    other_starts(own.objectives[0], target, SolverOptions())
    assert own.objectives[0].warp.n_parameters - 4 >= MODES
    assert len(begun) == STARTS.coarsest


@pytest.mark.slow
def test_fits_from_far_starts_are_saved(calibrated, lit_scene, both):
    once, again = ([model_pixels(calibrated, fit.landmarks, lit_scene.landmarks) for fit in fits] for fits in both)
    lost = np.array(once) > 3.0
    assert lost.sum() >= 8, "these starts are no longer far"
    assert np.mean(np.array(again)[lost] < 1.0) >= 0.4


def test_no_fit_ends_with_less_quality(both):
    # Fits that reach one place from different starts stop within their tolerance of each other.
    assert all(again.quality >= once.quality - 1e-3 for once, again in zip(*both, strict=True))
    assert all(once.n_starts == 1 for once in both[0])
    assert any(again.n_starts > 1 for again in both[1])


def test_right_fits_are_not_begun_again(calibrated, lit_scene, same_light_scene, monkeypatch):
    monkeypatch.setattr(restarts, "other_starts", None)  # not to be called
    for scene in (lit_scene, same_light_scene):
        result = Fitter(calibrated).fit(scene.image, disturb(scene.landmarks))
        assert result.n_starts == 1
        assert result.status.ok


@pytest.mark.parametrize("value", [0, 255, 128])
def test_where_the_picture_says_nothing_no_start_is_tried(calibrated, value, monkeypatch):
    monkeypatch.setattr(restarts, "other_starts", None)
    picture = np.full((180, 240, 3), value, np.uint8)
    picture[0, 0] = (90, 100, 110)  # not grey all over
    result = Fitter(calibrated).fit(picture, (60, 40, 180, 150))
    assert result.status.unusable
    assert result.n_starts == 1


def test_where_no_quality_is_known_no_start_is_tried(scenes, lit_scene, monkeypatch):
    monkeypatch.setattr(restarts, "other_starts", None)
    start = disturb(lit_scene.landmarks, *FAR[0])
    model = train_on(scenes, diagonal=60.0)
    assert np.isnan(Fitter(model).fit(lit_scene.image, start).quality)


def test_results_say_how_many_starts_were_tried_and_are_of_the_one_kept(calibrated, lit_scene, both):
    # One that is right: a wrong fit may stop anywhere.
    again = next(new for old, new in zip(*both, strict=True) if new.status.ok and new.quality > old.quality)
    assert again.to_dict()["starts_tried"] == again.n_starts > 1
    alone = Fitter(calibrated, restarts=False).fit(lit_scene.image, again.start)
    # Restarts go on from the blurred levels, so that the sharpest one averages the image around another shape; and each
    # fit may stop a tenth of a standard deviation from where it would end.
    apart = np.linalg.norm(alone.landmarks - again.landmarks, axis=1) / again.sd
    assert apart.mean() < 0.25
    assert alone.status == again.status


@pytest.mark.parametrize(
    ("quality", "steps", "again"),
    [(0.3, 10, True), (0.3, 40, True), (0.7, 40, True), (0.7, 10, False), (0.85, 40, False), (np.nan, 40, False)],
)
def test_doubtful_fits_are_begun_again_and_slow_ones_of_little_quality(calibrated, lit_scene, quality, steps, again):
    own = replace(calibrated.views[SURROUNDINGS].reliabilities["soft-li"], typical=0.9)  # 0.81 is little then
    ours = Fitter(calibrated.with_view(SURROUNDINGS, reliabilities={"soft-li": own}))
    made = Fitter(calibrated, restarts=False).fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert ours.judge.falls_short(replace(made, quality=quality, n_iterations=steps)) is again
    few = replace(ours, options=SolverOptions(max_iterations=SLOW))
    assert not few.judge.falls_short(replace(made, quality=quality, n_iterations=steps))


def test_no_iterations_leave_the_start_as_it_is(calibrated, lit_scene):
    start = disturb(lit_scene.landmarks, *FAR[0])
    result = Fitter(calibrated, options=SolverOptions(max_iterations=0)).fit(lit_scene.image, start)
    assert result.n_starts == 1
    np.testing.assert_allclose(result.start, result.registered)


def test_a_fit_that_ran_off_is_not_kept(calibrated, lit_scene, monkeypatch):
    ours = Fitter(calibrated)
    start = disturb(lit_scene.landmarks, *FAR[0])
    target, _ = ours.target(lit_scene.image, start)
    first = Fitter(calibrated, restarts=False).fit(lit_scene.image, start)
    off = replace(first, quality=1.0, landmarks=10 * first.landmarks)
    monkeypatch.setattr(Fitter, "fit_sharpest", lambda *_: off)
    kept = fit_again(ours, target, first)
    assert kept.quality == first.quality
    assert kept.n_starts > 1


def test_only_the_best_of_the_other_starts_is_fitted_at_the_sharpest_level(calibrated, lit_scene, monkeypatch):
    ours, fitted = Fitter(calibrated), []
    target, _ = ours.target(lit_scene.image, disturb(lit_scene.landmarks, *FAR[0]))
    first = replace(Fitter(calibrated, restarts=False).fit(lit_scene.image, target.start), quality=0.1)
    good = replace(first, quality=0.99, landmarks=target.start)
    monkeypatch.setattr(restarts, "other_starts", lambda *_: [target.start, lit_scene.landmarks])
    monkeypatch.setattr(Fitter, "fit_sharpest", lambda _own, fit, _options: fitted.append(fit) or good)
    assert fit_again(ours, target, first).quality == 0.99
    (best,) = fitted
    np.testing.assert_array_equal(best.target.start, lit_scene.landmarks)


def test_trackers_search_instead(calibrated):
    tracker = Tracker(calibrated)
    assert not tracker.fitter.restarts
    assert not tracker._near.restarts


@pytest.mark.parametrize(("far", "least"), [(FAR[0], 1), (FAR[1], 2)])
def test_other_starts_lie_apart_and_within_reason(calibrated, lit_scene, far, least):
    start = disturb(lit_scene.landmarks, *far)
    own = Fitter(calibrated)
    target, _ = own.target(lit_scene.image, start)
    shapes = other_starts(own.objectives[0], target, SolverOptions(), count=4)
    assert least <= len(shapes) <= 4
    for i, shape in enumerate(shapes):
        assert is_sane(shape, start)
        distances = [np.sqrt(np.square(shape - other).sum(axis=1).mean()) for other in shapes[:i]]
        assert all(distance > APART * diagonal_of(start) for distance in distances)


@pytest.mark.parametrize("n_modes", [0, 1])
def test_models_of_few_modes_are_bent_as_far_as_they_go(scenes, lit_scene, n_modes):
    model = train_on(scenes[:1] * 3 if n_modes == 0 else scenes, diagonal=60.0, variance=max(n_modes, 1))
    own = Fitter(model)
    target, _ = own.target(lit_scene.image, disturb(lit_scene.landmarks, *FAR[1]))
    assert len(model.views[SURROUNDINGS].shape_model.eigenvalues) == n_modes
    shapes = other_starts(own.objectives[0], target, SolverOptions())
    assert all(np.isfinite(shape).all() for shape in shapes)
    assert shapes


# A box is a hint, a shape is a start.


def test_a_box_beside_the_object_is_searched_around(head_model):
    scene = moving_scene(3 / MOVING_FRAMES)
    image = np.pad(scene.image, ((30, 30), (60, 60), (0, 0)), mode="edge")
    truth = scene.landmarks + np.array([60, 30])
    low, high = truth.min(axis=0), truth.max(axis=0)
    side = high - low
    box = np.concatenate([low, high]) + np.tile(0.45 * side, 2)
    fitter = Fitter(head_model)
    found = fitter.fit(image, box)
    assert found.status.ok and found.found is None and found.n_starts > 1
    assert model_pixels(head_model, found.landmarks, truth) < 1.0
    # The same place given as a shape is believed, and so is a box that is fitted once.
    once = Fitter(head_model, restarts=False).fit(image, box)
    assert once.n_starts == 1 and not once.status.ok


def test_a_box_at_the_border_is_searched_in_the_picture(head_model):
    image = moving_scene(0.0).image
    height, width = image.shape[:2]
    for box in ((-30, -30, 50, 50), (width - 50, height - 50, width + 30, height + 30), (5, 5, 9, 12)):
        result = Fitter(head_model).fit(image, box)
        assert np.isfinite(result.quality)
