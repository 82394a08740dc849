"""The solver: it descends, it stops, both eliminations agree, and what cannot be seen is not moved."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from liaam.errors import MethodError
from liaam.fitting import METHODS, FitStatus, Fitter, SolverOptions, get_method
from liaam.fitting.loop.levels import prepare_level
from liaam.fitting.loop.objective import Objective, make_objectives
from liaam.fitting.reference.problem import Problem
from liaam.fitting.solution import residual_at
from liaam.model import SURROUNDINGS
from liaam.model.shape import diagonal_of
from liaam.photometry import CameraModel
from setups import disturb, finest_objective, make_level, model_pixels

EXACT = {"tolerance": 1e-4, "early_tolerance": 0.0, "max_iterations": 300, "shape_prior": 0.0}


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"elimination": "magic"}, "'magic'; choose from varpro, joint"),
        ({"max_iterations": -1}, "of at least 0|from 0 to"),
        ({"tolerance": -0.1}, "of at least 0|from 0 to"),
        ({"early_tolerance": -0.1}, "of at least 0|from 0 to"),
        ({"early_tolerance": np.nan}, "finite"),
        ({"relative_tolerance": np.inf}, "finite"),
        ({"damping": -1.0}, "of at least 0|from 0 to"),
        ({"shape_prior": -1.0}, "of at least 0|from 0 to"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, match):
    with pytest.raises(MethodError, match=match):
        SolverOptions(**options)


@pytest.mark.parametrize("elimination", ["varpro", "joint"])
@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if not method.reweighs])
def test_the_cost_never_rises_within_a_level(model, lit_scene, method, elimination):
    options = SolverOptions(shape_prior=0.0, elimination=elimination, scoring=0)
    result = Fitter(model, method, options).fit(lit_scene.image, disturb(lit_scene.landmarks, 1.08, (0.05, 0.03)))
    steps = [(a.cost, b.cost) for a, b in pairwise(result.history) if a.level == b.level]
    assert len(steps) > 3
    assert all(after <= before * (1 + 2e-6) for before, after in steps)  # but for rounding


@pytest.mark.parametrize("method", ["li", "rgb", "li-pc"])
def test_joint_and_varpro_reach_the_same_minimum(fine_model, lit_scene, same_light_scene, method):
    # rgb has a minimum worth the name only without a change of light; under one it diverges, each way its own.
    scene = same_light_scene if method == "rgb" else lit_scene
    start = disturb(scene.landmarks)
    varpro, joint = (
        Fitter(fine_model, method, SolverOptions(elimination=elimination, **EXACT)).fit(scene.image, start)
        for elimination in ("varpro", "joint")
    )
    assert model_pixels(fine_model, joint.landmarks, varpro.landmarks) < 1e-2
    assert joint.cost == pytest.approx(varpro.cost, rel=1e-4)


def test_pure_gauss_newton_reaches_the_minimum_too(fine_model, lit_scene):
    start = disturb(lit_scene.landmarks)
    damped = Fitter(fine_model, "li").fit(lit_scene.image, start)
    pure = Fitter(fine_model, "li", SolverOptions(damping=0.0)).fit(lit_scene.image, start)
    assert model_pixels(fine_model, pure.landmarks, damped.landmarks) < 0.05


@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_iterations_are_never_exceeded(model, lit_scene, damping):
    options = SolverOptions(max_iterations=3, tolerance=0.0, early_tolerance=0.0, damping=damping)
    for scoring, most in ((0, 3), (None, 6)):  # so many of each kind
        fitter = Fitter(model, "li", replace(options, scoring=scoring))
        result = fitter.fit(lit_scene.image, disturb(lit_scene.landmarks))
        assert result.n_iterations <= most * len(model.levels)
        assert result.status == FitStatus.MAX_ITERATIONS


@pytest.mark.parametrize("method", ["soft-li", "li"])
def test_a_step_within_the_tolerance_is_the_last(model, lit_scene, method):
    fitter = Fitter(
        model, method, SolverOptions(tolerance=100.0, early_tolerance=0.0, relative_tolerance=0.0, scoring=0)
    )
    result = fitter.fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert result.n_iterations == len(fitter.objectives)


@pytest.mark.parametrize("method", ["soft-li", "li", "rgb"])
def test_a_fit_that_sees_nothing_stays_where_it_is(model, lit_scene, method):
    objective = finest_objective(model, method)
    problem, p = make_level(model, lit_scene.image, lit_scene.landmarks, objective)
    p[-2:] = 1e6
    start = objective.start(p)
    solution = objective.solve(problem, start._replace(lam=start.lam + 1.0), SolverOptions())
    assert solution.no_texture
    assert not solution.converged
    assert solution.costs.tolist() == [np.inf]
    np.testing.assert_array_equal(solution.p, p)
    assert not solution.lam.any()  # the mean appearance


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_start_that_is_no_number_ends_at_once(model, lit_scene, bad):
    objective = finest_objective(model, "li")
    problem, p = make_level(model, lit_scene.image, lit_scene.landmarks, objective)
    p[0] = bad
    solution = objective.solve(problem, objective.start(p), SolverOptions())
    assert solution.no_texture
    assert solution.n_iterations == 0


def test_without_iterations_the_start_comes_back(model, lit_scene):
    start = disturb(lit_scene.landmarks)
    result = Fitter(model, "rgb", SolverOptions(max_iterations=0)).fit(lit_scene.image, start)
    assert result.n_iterations == 0
    assert result.status == FitStatus.MAX_ITERATIONS
    bound = np.abs(model.shape_model.project(start) - start).max()
    np.testing.assert_allclose(result.landmarks, start, atol=2 * bound + 1e-9)


def test_history_runs_from_the_start_to_the_result(model, lit_scene):
    result = Fitter(model, "li").fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert [h.level for h in result.history] == sorted(h.level for h in result.history)
    np.testing.assert_array_equal(result.history[-1].landmarks, result.landmarks)
    np.testing.assert_array_equal(result.start, result.history[0].landmarks)
    assert result.history[-1].cost == pytest.approx(result.cost, rel=1e-5)
    assert result.theta == result.history[-1].theta


def test_the_result_describes_itself(model, lit_scene):
    fitter = Fitter(model, "li")
    result = fitter.fit(lit_scene.image, disturb(lit_scene.landmarks))
    np.testing.assert_allclose(result.pose(model.shape_model.shape(result.p)), result.landmarks)
    residual, usable = residual_at(fitter, lit_scene.image, result)
    assert residual.shape == (model.n_pixels, 1) and usable.shape == (model.n_pixels,)
    assert not residual[usable == 0].any()
    values = np.linalg.eigvalsh(result.covariance)
    assert (values > 0).all()
    assert len(result.covariance) == len(result.p) + 1


@pytest.mark.parametrize("method", ["li-pc", "li-pcs"])
def test_without_a_change_of_light_the_angle_is_held(model, same_light_scene, method):
    result = Fitter(model, method).fit(same_light_scene.image, disturb(same_light_scene.landmarks))
    assert result.status == FitStatus.LIGHT_UNOBSERVABLE
    assert result.status.ok
    assert np.rad2deg(result.theta_model) == pytest.approx(np.rad2deg(model.theta), abs=0.1)
    assert np.rad2deg(result.theta) == pytest.approx(np.rad2deg(model.theta), abs=0.1)
    assert model_pixels(model, result.landmarks, same_light_scene.landmarks) < 0.5


@pytest.mark.parametrize("method", ["li-pc", "li-pcs"])
def test_with_a_change_of_light_the_angle_is_seen(model, lit_scene, method):
    result = Fitter(model, method).fit(lit_scene.image, disturb(lit_scene.landmarks))
    assert result.status == FitStatus.CONVERGED
    assert np.rad2deg(result.theta) == pytest.approx(np.rad2deg(lit_scene.theta), abs=1.0)


def test_every_status_says_what_to_do():
    for status in FitStatus:
        assert len(status.message) > 15 and status.message.endswith("."), status


@pytest.mark.parametrize(("turn", "size"), [(0.0, 1.0), (15.0, 1.0), (0.0, 1.4), (-12.0, 0.8)])
def test_the_result_does_not_depend_on_the_pose_of_the_start(fine_model, same_light_scene, turn, size):
    truth = same_light_scene.landmarks
    centre, angle = truth.mean(axis=0), np.deg2rad(turn)
    matrix = size * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    fitter = Fitter(fine_model, "li")
    result = fitter.fit(same_light_scene.image, (truth - centre) @ matrix.T + centre)
    assert model_pixels(fine_model, result.landmarks, fitter.fit(same_light_scene.image, truth).landmarks) < 0.1


def test_steps_that_nobody_can_tell_are_not_made(fine_model, lit_scene):
    starts = [disturb(lit_scene.landmarks, shift=shift) for shift in ((0.02, -0.015), (-0.02, 0.01), (0.0, 0.03))]
    patient, sparing = (
        [fitter.fit(lit_scene.image, start) for start in starts]
        for fitter in (
            Fitter(fine_model, "soft-li", SolverOptions(relative_tolerance=relative_tolerance, early_tolerance=0.0))
            for relative_tolerance in (0.0, 0.3)
        )
    )
    assert sum(result.n_iterations for result in sparing) < sum(result.n_iterations for result in patient)
    for spared, full in zip(sparing, patient, strict=True):
        off = np.linalg.norm(spared.landmarks - full.landmarks, axis=1)
        assert np.sqrt(np.square(off / full.sd).mean()) < 0.3


def test_a_last_step_that_nobody_can_tell_is_taken_without_another_look(fine_model, lit_scene, monkeypatch):
    """Where another level follows; at the sharpest one the result is what is seen there."""
    evaluations = []
    objective = finest_objective(fine_model, "soft-li")
    problem, p = make_level(fine_model, lit_scene.image, disturb(lit_scene.landmarks), objective, blur=1.0)
    evaluate = Problem.evaluate
    monkeypatch.setattr(Objective, "is_compiled", False)
    monkeypatch.setattr(Problem, "evaluate", lambda *args: evaluations.append(args) or evaluate(*args))
    options = SolverOptions(tolerance=0.0, early_tolerance=0.0)
    sparing = objective.solve(problem, objective.start(p), options, evaluate_last=False)
    # One for the start, and one for each step but the last.
    assert sparing.converged
    assert len(evaluations) == sparing.n_iterations
    assert sparing.costs[-1] == sparing.costs[-2]
    assert not np.array_equal(sparing.path[-1], sparing.path[-2])
    evaluations.clear()
    whole = objective.solve(problem, objective.start(p), options, evaluate_last=True)
    assert len(evaluations) == whole.n_iterations + 1
    assert whole.costs[-1] != whole.costs[-2]
    np.testing.assert_array_equal(whole.path, sparing.path)


def test_a_patch_reaches_as_far_as_it_is_asked_to(fine_model, lit_scene):
    def width(margin):
        fitter = Fitter(fine_model, "soft-li", margin=margin)
        target = fitter.target(lit_scene.image, lit_scene.landmarks)[0]
        objective = replace(fitter.objectives[-1], blur=1.0)
        problem = prepare_level(objective, target.measured(objective.method), [], fitter.options)[0]
        return problem.channels.shape[1] / problem.patch.from_image.scale

    reach = 0.1 * diagonal_of(lit_scene.landmarks)
    assert width(0.2) - width(0.1) == pytest.approx(2 * reach, abs=6)


def test_few_pixels_tell_what_all_tell(fine_model, lit_scene):
    start = disturb(lit_scene.landmarks)
    fitter, dense = (Fitter(fine_model, "soft-li", SolverOptions(relative_tolerance=0.0)) for _ in range(2))
    dense.__dict__["objectives"] = make_objectives(fine_model, get_method("soft-li"), thinning=0.0)
    assert fitter.objectives[0].density < 0.1
    few, all_of_them = (each.fit(lit_scene.image, start) for each in (fitter, dense))
    assert model_pixels(fine_model, few.landmarks, all_of_them.landmarks) < 0.2
    n_pixels = fine_model.views[SURROUNDINGS].warp.frame.n_pixels
    for each, result in ((fitter, few), (dense, all_of_them)):
        assert residual_at(each, lit_scene.image, result)[0].shape == (n_pixels, 3)


def test_some_rows_and_columns_of_a_large_object_are_enough(model, lit_scene):
    """Pixels that are not needed are black; the others are those of an image of half the size."""
    fitter = Fitter(model, "igo", camera=CameraModel(response="linear"))
    half = np.kron(lit_scene.image, np.ones((3, 3, 1), np.float32))
    whole = np.zeros((2 * half.shape[0], 2 * half.shape[1], 3), np.float32)
    whole[1::2, 1::2] = half
    target, _ = fitter.target(half, 3 * disturb(lit_scene.landmarks))
    target = target._replace(noise=0.01)
    expected = fitter.coarse_to_fine.fit(target, fitter.options)[-1]
    of_whole = target._replace(linear=fitter.linear(whole), start=2 * target.start + 1)
    found = fitter.coarse_to_fine.fit(of_whole, fitter.options)[-1]
    np.testing.assert_allclose(found.reached, 2 * expected.reached + 1, atol=1e-6)
    np.testing.assert_allclose(found.to_patch(2 * target.start + 1), expected.to_patch(target.start), atol=1e-9)


def test_directions_are_looked_at_everywhere(fine_model):
    # Each is normalised by itself: a blur does not make one say what its neighbours do.
    assert [objective.density for objective in Fitter(fine_model, "igo").objectives] == [1.0, 1.0]
    assert Fitter(fine_model, "grey").objectives[0].density < 0.1


@pytest.mark.parametrize("method", ["grey", "grey-norm", "rgb", "li"])
def test_the_residual_is_that_of_the_cost(fine_model, same_light_scene, method):
    image, fitter = (0.6 * same_light_scene.image).astype(np.float32), Fitter(fine_model, method)
    result = fitter.fit(image, disturb(same_light_scene.landmarks))
    residual, usable = residual_at(fitter, image, result)
    appearance = fine_model.levels[-1].appearances[get_method(method).appearance]
    weights = np.repeat((appearance.usable * usable)[:, None], residual.shape[1], axis=1)
    mean = float(np.average(np.square(residual), weights=weights))
    assert mean == pytest.approx(result.cost, rel=0.05, abs=1e-9)
