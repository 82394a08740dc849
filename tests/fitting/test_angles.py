"""The image angle starts at the global minimum on its arc."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam.fitting import SolverOptions
from liaam.fitting.loop.angles import SEARCH, _minimise_on_arc, best_image_angle
from setups import disturb, finest_objective, make_level


@given(seed=st.integers(0, 10**6), kind=st.sampled_from(["general", "round", "nearly round", "flat", "nothing"]))
def test_no_angle_on_the_arc_is_better(seed, kind):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, 2))
    S = {
        "general": root @ root.T,
        "round": np.eye(2),
        "nearly round": np.eye(2) + 1e-15 * np.diag([1, 0]),
        "flat": np.zeros((2, 2)),
        "nothing": np.zeros((2, 2)),
    }[kind]
    b = np.zeros(2) if kind == "nothing" else rng.normal(size=2) * rng.choice([0.01, 1, 10])
    centre = rng.uniform(-4, 4)

    def cost(t):
        u = np.array([np.cos(t), np.sin(t)])
        return np.einsum("i...,ij,j...->...", u, S, u) - 2 * b @ u

    found = _minimise_on_arc(S, b, centre, SEARCH)
    assert abs(found - centre) <= SEARCH + 1e-12
    assert cost(found) <= cost(np.linspace(centre - SEARCH, centre + SEARCH, 2001)).min() + 1e-9


@pytest.mark.parametrize("method", ["li", "li-lit"])
@pytest.mark.parametrize("at", ["truth", "start"])
def test_the_start_angle_beats_a_brute_force_search(model, lit_scene, method, at):
    objective = finest_objective(model, method)
    shape = lit_scene.landmarks if at == "truth" else disturb(lit_scene.landmarks, 1.1, (0.1, 0.1))
    problem, p = make_level(model, lit_scene.image, shape, objective)
    state = objective.start(p)

    def cost(theta):
        there = state._replace(angles=np.array([state.angles[0], theta]))
        return objective.solve(problem, there, SolverOptions(max_iterations=0)).costs[-1]

    grid = state.angles[0] + np.linspace(-SEARCH, SEARCH, 241)
    costs = np.array([cost(theta) for theta in grid])
    found = best_image_angle(objective, problem, state)
    assert cost(found) <= costs.min() * (1 + 1e-4)
    assert abs(found - grid[costs.argmin()]) < 2 * (grid[1] - grid[0])


def test_at_the_truth_the_start_angle_is_the_cameras(model, lit_scene):
    objective = finest_objective(model, "li")
    problem, p = make_level(model, lit_scene.image, lit_scene.landmarks, objective)
    found = best_image_angle(objective, problem, objective.start(p))
    assert np.rad2deg(found) == pytest.approx(np.rad2deg(lit_scene.theta), abs=1.0)


def test_where_no_pixel_counts_the_angle_stays(model):
    objective = finest_objective(model, "li")
    start = model.shape_model.mean + 80
    problem, p = make_level(model, np.zeros((160, 160, 3), np.float32), start, objective)
    state = objective.start(p)
    assert best_image_angle(objective, problem, state) == state.angles[1]
