"""The objective's columns [J | r] are the derivative of its residual, for every method and kernel."""

from dataclasses import replace

import numpy as np
import pytest

from finite_differences import assert_jacobian
from liaam.fitting import METHODS, get_method
from liaam.kernels import KERNELS
from setups import disturb, finest_objective, make_problem

FREE_SOFT = replace(METHODS["soft-li"], name="soft-li with a free angle", free_angles="image")
ANGLED = ("li", "li-lit", "li-pc", "li-pcs", "li+noise", "li-pc+noise+huber", "li-pcs+cauchy", FREE_SOFT)
WEIGHED = (
    "soft-li+tukey",
    "grey+tukey",
    "rgb+learnt",
    "chroma+noise",
    "li+noise",
    "li-pc+noise+huber",
    "igo+geman-mcclure",
)
ALL = (*METHODS, *WEIGHED)


@pytest.fixture(params=KERNELS)
def kernel(request) -> str:
    return request.param


class Setting:
    """An objective away from its minimum: lambda, angles and p all off."""

    def __init__(self, model, scene, method: str, kernel: str, rng: np.random.Generator) -> None:
        self.objective = finest_objective(model, method, kernel)
        self.problem, p = make_problem(model, scene.image, disturb(scene.landmarks), self.objective)
        state = self.objective.start(p)
        lam = rng.normal(size=self.objective.n_lambda) * 0.5
        self.state = replace(state, angles=state.angles + np.array([0.1, -0.2]), lam=lam)
        self.trust = None
        for _ in range(2):  # weights as they are while a fit runs
            seen = self.objective.linearise(self.problem, self.state, trust=self.trust)
            self.trust = self.objective.trust(self.problem, self.state, seen)
        assert (self.trust is not None) == get_method(method).reweighs

    def root(self, theta: float) -> np.ndarray:
        return self.objective._root_weights(theta, self.trust)[0]

    def weighted_residual(self, state) -> np.ndarray:
        return self.objective.columns(self.problem, state, self.trust)[:, -1].astype(np.float64)

    def columns(self) -> np.ndarray:
        return self.objective.columns(self.problem, self.state, self.trust)

    def cells(self, p: np.ndarray) -> np.ndarray:
        return np.floor(self.problem.pose(self.objective.warp.points(p)))


@pytest.mark.parametrize("method", ALL)
def test_columns_of_the_warp_parameters(model, lit_scene, method, kernel, rng):
    setting = Setting(model, lit_scene, method, kernel, rng)
    n_p = setting.objective.warp.n_parameters
    # Between pixel lines the samples are quadratic along any line: central differences are exact.
    movement = np.abs(setting.objective.warp.jacobian(setting.state.p)).max(axis=(0, 1))
    assert_jacobian(
        lambda p: setting.weighted_residual(replace(setting.state, p=p)),
        setting.columns()[:, :n_p],
        setting.state.p,
        steps=0.04 / movement,
        tolerance=1e-3,
        valid=lambda a, b: np.repeat(
            (setting.cells(a) == setting.cells(b)).all(axis=1), setting.objective.method.n_rows
        ),
    )


@pytest.mark.parametrize("method", ANGLED)
def test_columns_of_the_angles(model, lit_scene, method, kernel, rng):
    setting = Setting(model, lit_scene, method, kernel, rng)
    n_p, directions = setting.objective.warp.n_parameters, get_method(method).angle_directions
    at = np.zeros(directions.shape[1])
    assert_jacobian(
        lambda free: setting.weighted_residual(replace(setting.state, angles=setting.state.angles + directions @ free)),
        setting.columns()[:, n_p:-1],
        at,
        steps=1e-2,
        tolerance=1e-3,
    )


@pytest.mark.parametrize("method", ALL)
def test_columns_of_lambda(model, lit_scene, method, kernel, rng):
    setting = Setting(model, lit_scene, method, kernel, rng)
    objective = setting.objective
    weights = objective.linearise(setting.problem, setting.state).weights
    root = setting.root(setting.state.angles[1]) * weights[:, None]
    modes = objective.design(float(setting.state.angles[0])).modes
    assert_jacobian(
        lambda lam: setting.weighted_residual(replace(setting.state, lam=lam)),
        -modes.T * root.reshape(-1, 1),
        setting.state.lam,
        steps=1.0,
        tolerance=1e-3,
    )


@pytest.mark.parametrize("method", ALL)
def test_columns_carry_the_root_of_the_weights(model, lit_scene, method, kernel, rng):
    setting = Setting(model, lit_scene, method, kernel, rng)
    objective = setting.objective
    columns = setting.columns()
    seen = objective.linearise(setting.problem, setting.state, setting.trust)
    root = setting.root(setting.state.angles[1]) * seen.weights[:, None]
    np.testing.assert_allclose(columns[:, -1], (root * seen.residual).ravel(), rtol=1e-6)
    assert not columns[np.repeat(seen.weights == 0, objective.method.n_rows)].any()
    rr = np.square(columns[:, -1].astype(np.float64)).sum()
    assert seen.equations.rr == pytest.approx(rr, rel=1e-5)


@pytest.mark.parametrize("method", ALL)
def test_gram_matrices_leave_out_pixels_without_weight(model, lit_scene, method, rng):
    setting = Setting(model, lit_scene, method, "fast", rng)
    objective = setting.objective
    channels = setting.problem.patch.channels.copy()
    channels[: len(channels) // 2, :, -1] = 0
    problem = replace(setting.problem, patch=replace(setting.problem.patch, channels=channels))
    columns = objective.columns(problem, setting.state, setting.trust)
    seen = objective.linearise(problem, setting.state, setting.trust)
    assert 0.05 < (seen.weights == 0).mean() < 0.95
    weights = np.repeat(seen.weights, objective.method.n_rows)[:, None].astype(np.float64)
    root = setting.root(setting.state.angles[1]).reshape(-1, 1)
    A = objective.design(float(setting.state.angles[0])).modes.T * root * weights
    J = columns[:, :-1].astype(np.float64)
    scale = np.abs(A.T @ A).max()
    np.testing.assert_allclose(seen.equations.aa, A.T @ A, rtol=1e-5, atol=1e-5 * scale)
    np.testing.assert_allclose(seen.equations.aj, A.T @ J, atol=1e-5 * np.abs(A.T @ J).max())
    np.testing.assert_allclose(seen.equations.jj, J.T @ J, rtol=1e-4, atol=1e-5 * np.abs(J.T @ J).max())


@pytest.mark.parametrize("method", ALL)
def test_equations_after_a_step_of_lambda_are_those_of_another_look(model, lit_scene, method, rng):
    setting = Setting(model, lit_scene, method, "fast", rng)
    seen = setting.objective.linearise(setting.problem, setting.state, setting.trust)
    step = rng.normal(size=setting.objective.n_lambda) * np.abs(seen.sums.best_lambda_step())
    moved = setting.objective.moved(seen, setting.state, step)
    there = setting.objective.linearise(
        setting.problem, replace(setting.state, lam=setting.state.lam + step), setting.trust
    )
    np.testing.assert_allclose(moved.residual, there.residual, atol=1e-5 * np.abs(there.residual).max())
    direct = moved.products(moved.look, moved.sums, None)
    for name in ("jj", "aj", "jr"):
        own, other = getattr(moved.equations, name), getattr(direct, name)
        np.testing.assert_allclose(own, other, atol=1e-5 * np.abs(other).max(), err_msg=name)
    assert moved.cost == pytest.approx(there.cost, rel=1e-4)


@pytest.mark.parametrize("method", ANGLED)
def test_the_reduced_gradient_is_that_of_the_cost_with_lambda_at_its_best(model, lit_scene, method, rng):
    setting = Setting(model, lit_scene, method, "fast", rng)
    directions, n_p = get_method(method).angle_directions, setting.objective.warp.n_parameters

    def reduced_cost(free):
        state = replace(setting.state, angles=setting.state.angles + directions @ free)
        equations = setting.objective.linearise(setting.problem, state, trust=setting.trust).equations
        return np.array([equations.after_lambda_step(equations.best_lambda_step()).rr])

    at = setting.objective.linearise(setting.problem, setting.state, trust=setting.trust)
    gradient = at.equations.reduced()[1][n_p:]
    assert_jacobian(reduced_cost, 2 * gradient[None], np.zeros(directions.shape[1]), steps=1e-2, tolerance=2e-2)
