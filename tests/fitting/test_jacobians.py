"""Residuals and their derivatives, for every method and kernel: finite differences, and dense products of columns."""

from dataclasses import replace

import numpy as np
import pytest

from finite_differences import assert_jacobian
from liaam.fitting import METHODS, get_method
from liaam.fitting.kernel import KERNELS, get_kernel
from liaam.fitting.level import Work
from liaam.fitting.objective import State
from liaam.fitting.reference import jacobian
from setups import differentiate, disturb, finest_objective, look_again, make_problem

FREE_SOFT = replace(METHODS["soft-li"], name="soft-li with a free angle", free_angles="image")
WEIGHED = (
    "soft-li+tukey",
    "grey+tukey",
    "grey-norm+huber",
    "rgb+learnt",
    "chroma+noise",
    "li+noise",
    "li-lit+noise",
    "li-pc+noise+huber",
    "li-pcs+cauchy",
    "li-pcs+noise",
    "igo+geman-mcclure",
    "li+l1",
)
ALL = (*METHODS, *WEIGHED, FREE_SOFT)
ANGLED = tuple(method for method in ALL if get_method(method).free_angles != "none")


def name_of(method) -> str:
    return get_method(method).name


every_method = pytest.mark.parametrize("method", ALL, ids=name_of)
methods_with_angles = pytest.mark.parametrize("method", ANGLED, ids=name_of)


@pytest.fixture(params=KERNELS)
def kernel(request) -> str:
    return request.param


class Setting:
    """A fit away from its minimum: lambda, angles and p all off, and weights as they are while it runs."""

    def __init__(self, model, scene, method, kernel: str, rng: np.random.Generator) -> None:
        self.kernel, self.objective = get_kernel(kernel), finest_objective(model, method, kernel)
        self.problem, p = make_problem(model, scene.image, disturb(scene.landmarks), self.objective)
        angles = self.objective.start(p).angles + np.array([0.1, -0.2])
        self.state = State(p, angles, 0.5 * rng.normal(size=self.objective.n_lambda))
        self.seen = self.objective.evaluate(self.problem, self.state, weigh=2)
        assert np.ptp(self.seen.weighed) > 0 or not self.objective.method.reweighs or self.objective.method.normalise

    def evaluate(self, solves: bool = False, **changes) -> Work:
        """Look from another state, under the same weights."""
        return self.look_at(self.problem, solves, **changes)

    def look_at(self, problem, solves: bool = False, **changes) -> Work:
        work = Work(*(array.copy() for array in self.seen))
        for name, value in self.state._replace(**changes)._asdict().items():
            getattr(work, name)[:] = value
        return look_again(self.objective, problem, work, solves)

    def weighted_residual(self, **changes) -> np.ndarray:
        work = self.evaluate(**changes)
        return work.root.astype(np.float64) * work.residual

    def turned(self, free: np.ndarray) -> np.ndarray:
        """Angles after a turn of the free ones."""
        return self.state.angles + self.objective.method.angle_directions @ free

    def angle_columns(self, work: Work) -> np.ndarray:
        """Columns of the free angles, (n k, n_free)."""
        columns = np.empty_like(work.columns)
        record = self.kernel.by_reference(work._replace(columns=columns))
        for f in range(len(columns)):
            self.kernel.angle_column(*self.objective.given, record, f)
        return columns.T.astype(np.float64)

    def cells(self, p: np.ndarray) -> np.ndarray:
        return np.floor(self.problem.pose(self.objective.warp.points(p)))


@every_method
def test_columns_of_the_warp_parameters(model, lit_scene, method, kernel, rng):
    setting = Setting(model, lit_scene, method, kernel, rng)
    work, warp = setting.evaluate(), setting.objective.warp
    # Between pixel lines the samples are quadratic along any line: central differences are exact.
    movement = np.abs(warp.jacobian(setting.state.p)).max(axis=(0, 1))
    assert_jacobian(
        lambda p: setting.weighted_residual(p=p),
        work.root[:, None] * jacobian(warp, setting.state.p, work.image_slopes),
        setting.state.p,
        steps=0.04 / movement,
        tolerance=1e-3,
        valid=lambda a, b: np.repeat(
            (setting.cells(a) == setting.cells(b)).all(axis=1), setting.objective.method.n_rows
        ),
    )


@methods_with_angles
def test_columns_of_the_angles(model, lit_scene, method, kernel, rng):
    setting = Setting(model, lit_scene, method, kernel, rng)
    work = setting.evaluate()
    assert bool(len(work.own_derivative)) == (setting.objective.method.weights == "noise")
    assert_jacobian(
        lambda free: setting.weighted_residual(angles=setting.turned(free)),
        work.root[:, None] * setting.angle_columns(work),
        np.zeros(len(work.columns)),
        steps=1e-2,
        tolerance=1e-3,
    )


@every_method
def test_columns_of_lambda(model, lit_scene, method, kernel, rng):
    setting = Setting(model, lit_scene, method, kernel, rng)
    work = setting.evaluate()
    assert_jacobian(
        lambda lam: setting.weighted_residual(lam=lam),
        -(work.rows[1:] * work.root).T.astype(np.float64),
        setting.state.lam,
        steps=1.0,
        tolerance=1e-3,
    )


@every_method
def test_the_residual_is_that_of_the_picture_and_the_model(model, lit_scene, method, kernel, rng):
    """P(theta_2) E(I) - P(theta_1) (A0 + lambda A), its squares under the weights, and none where nothing is seen."""
    setting = Setting(model, lit_scene, method, kernel, rng)
    work, objective = setting.evaluate(), setting.objective
    metric = objective.method.image_metric(setting.state.angles[1])
    seen = work.values.reshape(-1, 8)[:, : metric.shape[1]] @ metric.T
    if objective.method.normalise:
        seen = work.scales[1] * seen + work.scales[2] * metric.sum(axis=1)
    # What is projected before it is learnt does not turn.
    theta = setting.state.angles[0] if objective.method.angle_directions[0].any() else model.theta
    shown = np.tensordot(setting.state.lam[: objective.appearance.n_modes], objective.appearance.modes, axes=1)
    shown = (objective.appearance.mean + shown) @ objective.method.model_metric(theta).T
    extra = setting.state.lam[objective.appearance.n_modes :] @ work.rows[1 + objective.appearance.n_modes :]
    expected = seen - shown - extra.reshape(shown.shape)
    np.testing.assert_allclose(work.residual, expected.ravel(), atol=3e-5 * max(1.0, np.abs(seen).max()))
    weighted = work.root.astype(np.float64) * work.residual
    assert work.sums[0] == pytest.approx(weighted @ weighted, rel=1e-5)
    assert work.sums[1] == pytest.approx(np.square(work.root.astype(np.float64)).sum(), rel=1e-5)
    np.testing.assert_array_equal(work.root, work.own * np.repeat(work.usable, objective.method.n_rows))


def half_blind(problem):
    """The same picture, whose upper half says nothing."""
    channels = problem.patch.channels.copy()
    channels[: len(channels) // 2, :, -1] = 0
    return replace(problem, patch=replace(problem.patch, channels=channels))


def dense(objective, work, by_angles, expects: bool) -> tuple[np.ndarray, ...]:
    """A'A, A'J, the Hessian and the gradient from columns formed in full, and A."""
    root, p = work.root.astype(np.float64), work.p
    by_place = work.expected if expects else work.image_slopes
    J, E = (
        root[:, None] * np.hstack([jacobian(objective.warp, p, image_slopes), by_angles])
        for image_slopes in (work.image_slopes, by_place)
    )
    A, r = (work.rows[1:] * root).T, root * work.residual
    ridge = objective.template.ridge
    inverse, aj = np.linalg.inv(A.T @ A + np.diag(ridge)), A.T @ J
    hessian, n_p = E.T @ J, len(p)
    hessian[n_p:, :n_p] = hessian[:n_p, n_p:].T  # with the angles' columns what is expected counts
    hessian -= aj.T @ inverse @ aj
    return A.T @ A, aj, 0.5 * (hessian + hessian.T), E.T @ r - aj.T @ inverse @ (A.T @ r - ridge * work.lam)


@pytest.mark.parametrize(
    ("method", "expects"),
    [(method, expects) for method in ALL for expects in sorted({False, get_method(method).expects})],
    ids=lambda value: "expected" if value is True else "own" if value is False else name_of(value),
)
def test_equations_are_those_of_dense_columns_where_half_of_the_picture_is_blind(
    model, lit_scene, method, kernel, expects, rng
):
    setting = Setting(model, lit_scene, method, kernel, rng)
    objective, work = setting.objective, setting.look_at(half_blind(setting.problem))
    assert 0.05 < (work.usable == 0).mean() < 0.95
    differentiate(objective, work, expects)
    aa, aj, hessian, gradient = dense(objective, work, setting.angle_columns(work), expects)
    factor = np.tril(work.factor)
    held = aa + np.diag(setting.objective.template.ridge)
    np.testing.assert_allclose(factor @ factor.T, held, atol=2e-5 * np.abs(aa).max(initial=0.0))
    np.testing.assert_allclose(work.aj, aj, atol=1e-5 * np.abs(aj).max(initial=0.0))
    np.testing.assert_allclose(work.hessian, hessian, atol=3e-5 * np.abs(hessian).max())
    np.testing.assert_allclose(work.gradient, gradient, atol=1e-4 * np.abs(gradient).max())
    np.testing.assert_array_equal(work.hessian, work.hessian.T)


@every_method
def test_the_appearance_at_its_best_leaves_nothing_to_gain(model, lit_scene, method, kernel, rng):
    """Its lambda is that of least squares over the columns and the prior, and the residual is that of another look."""
    setting = Setting(model, lit_scene, method, kernel, rng)
    work = setting.evaluate(solves=True)
    again = setting.evaluate(lam=work.lam)
    np.testing.assert_allclose(work.residual, again.residual, atol=1e-5 * max(1.0, np.abs(again.residual).max()))
    assert again.sums[0] == pytest.approx(work.sums[0], rel=1e-4, abs=1e-6)
    pull = np.sqrt(setting.objective.template.ridge)
    A = np.vstack([(again.rows[1:] * again.root).T.astype(np.float64), np.diag(pull)])
    r = np.concatenate([again.root.astype(np.float64) * again.residual, -pull * work.lam])
    left = r - A @ np.linalg.lstsq(A, r, rcond=1e-9)[0]
    assert r @ r <= (left @ left) * (1 + 1e-3) + 1e-9
    assert not work.ar.any()


@methods_with_angles
def test_the_reduced_gradient_is_that_of_the_cost_with_lambda_at_its_best(model, lit_scene, method, kernel, rng):
    setting = Setting(model, lit_scene, method, kernel, rng)
    objective = setting.objective

    def reduced(free):
        return setting.evaluate(solves=True, angles=setting.turned(free))

    at = np.zeros(objective.n_q - objective.warp.n_parameters)
    gradient = differentiate(objective, reduced(at)).gradient[objective.warp.n_parameters :]
    assert_jacobian(lambda free: np.array([reduced(free).sums[0]]), 2 * gradient[None], at, steps=1e-2, tolerance=2e-2)


@pytest.mark.parametrize("method", ["li", "li-pc", "li-lit", "li+noise", "chroma"])
def test_a_constant_grey_bias_is_a_null_vector(model, lit_scene, method, kernel, rng):
    """L(theta) (1, 1, 1) = 0: light of another strength does not move a residual, whatever the angle."""
    setting = Setting(model, lit_scene, method, kernel, rng)
    patch = setting.problem.patch
    channels = patch.channels.copy()
    channels[..., :3] += 1.5
    brighter = setting.look_at(replace(setting.problem, patch=replace(patch, channels=channels)))
    np.testing.assert_allclose(brighter.residual, setting.evaluate().residual, atol=1e-5)
    np.testing.assert_allclose(brighter.image_slopes, setting.evaluate().image_slopes, atol=1e-5)
