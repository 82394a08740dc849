"""Residuals and their derivatives, for every method and engine: finite differences, and dense products of columns."""

from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest

from finite_differences import assert_jacobian
from liaam.fitting import METHODS, get_method
from liaam.fitting.loop.objective import State
from setups import ENGINES, disturb, finest_objective, make_level, problem_of

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
UNLIKE = ("grey", "grey-norm+huber", "rgb", "chroma+noise", "li-pcs", "igo+geman-mcclure", "soft-li", FREE_SOFT)
"""Methods whose images are encoded or projected in different ways: all gradients in the image that there are."""
ANGLED = tuple(method for method in ALL if get_method(method).free_angles != "none")


def name_of(method) -> str:
    return get_method(method).name


every_method = pytest.mark.parametrize("method", ALL, ids=name_of)
methods_with_angles = pytest.mark.parametrize("method", ANGLED, ids=name_of)


@pytest.fixture(params=ENGINES)
def engine(request) -> str:
    return request.param


objective_of = lru_cache(maxsize=None)(finest_objective)  # most of the time, were each test to make its own


class Setting:
    """A fit away from its minimum: lambda, angles and p all off, and weights as they are while it runs."""

    def __init__(self, model, scene, method, engine: str, rng: np.random.Generator) -> None:
        self.engine, self.objective = engine, objective_of(model, method)
        self.image, p = make_level(model, scene.image, disturb(scene.landmarks), self.objective)
        angles = self.objective.start(p).angles + np.array([0.1, -0.2])
        self.state = State(p, angles, 0.5 * rng.normal(size=self.objective.n_lambda))
        self.problem = self.begun(self.image)

    def begun(self, image):
        """Return a problem whose weights are those after two updates."""
        problem = problem_of(self.objective, image, self.engine)
        problem.begin(self.state.p, tuple(self.state.angles), self.state.lam)
        problem.evaluate(False)
        for _ in range(2):
            problem.reweigh(False)
        return problem

    def evaluate(self, solves: bool = False, **changes) -> SimpleNamespace:
        """Look from another state, under the same weights."""
        return self.look_at(self.problem, solves, **changes)

    def look_at(self, problem, solves: bool = False, expects: bool = False, **changes) -> SimpleNamespace:
        p, angles, lam = self.state._replace(**changes)
        problem.set_state(p, tuple(angles), lam)
        problem.evaluate(solves)
        problem.differentiate(True, not expects)
        return SimpleNamespace(**problem.arrays(), p=p)

    def weighted_residual(self, **changes) -> np.ndarray:
        seen = self.evaluate(**changes)
        return seen.masked.astype(np.float64) * seen.residual

    def turned(self, free: np.ndarray) -> np.ndarray:
        """Angles after a turn of the free ones."""
        return self.state.angles + self.objective.method.angle_directions @ free

    def by_parameters(self, gradients: np.ndarray, p: np.ndarray) -> np.ndarray:
        """dr/dp = dr/dW dW/dp, (n k, n_p), from spatial gradients (n k, 2)."""
        by_warp = self.objective.warp.jacobian(p).astype(np.float64)
        by_place = gradients.reshape(len(by_warp), -1, 2).astype(np.float64)
        return np.einsum("nka,nai->nki", by_place, by_warp).reshape(-1, by_warp.shape[2])

    def cells(self, p: np.ndarray) -> np.ndarray:
        return np.floor(self.image.from_model(self.objective.warp.points(p)))


@pytest.mark.parametrize("method", ["grey", "li-pcs", "soft-li"])
def test_arrays_of_the_core_have_the_shapes_of_the_reference(model, lit_scene, method, rng):
    core, reference = (vars(Setting(model, lit_scene, method, each, rng).evaluate()) for each in ENGINES)
    # The core leaves empty what a method does not use.
    shared = {name for name in core.keys() & reference.keys() if np.size(core[name])}
    assert {"residual", "gradients", "hessian"} <= shared
    assert {name: np.shape(core[name]) for name in shared} == {name: np.shape(reference[name]) for name in shared}


@pytest.mark.parametrize("method", UNLIKE, ids=name_of)
def test_columns_of_the_warp_parameters(model, lit_scene, method, engine, rng):
    setting = Setting(model, lit_scene, method, engine, rng)
    seen, warp = setting.evaluate(), setting.objective.warp
    # Between pixel lines the samples are quadratic along any line: central differences are exact.
    movement = np.abs(warp.jacobian(setting.state.p)).max(axis=(0, 1))
    assert_jacobian(
        lambda p: setting.weighted_residual(p=p),
        seen.masked[:, None] * setting.by_parameters(seen.gradients, setting.state.p),
        setting.state.p,
        steps=0.04 / movement,
        tolerance=1e-3,
        valid=lambda a, b: np.repeat(
            (setting.cells(a) == setting.cells(b)).all(axis=1), setting.objective.method.n_rows
        ),
    )


@methods_with_angles
def test_columns_of_the_angles(model, lit_scene, method, engine, rng):
    setting = Setting(model, lit_scene, method, engine, rng)
    seen = setting.evaluate()
    assert bool(np.any(seen.weight_slope)) == (setting.objective.method.weights == "noise")
    assert_jacobian(
        lambda free: setting.weighted_residual(angles=setting.turned(free)),
        seen.masked[:, None] * seen.columns.T.astype(np.float64),
        np.zeros(len(seen.columns)),
        steps=1e-2,
        tolerance=1e-3,
    )


@pytest.mark.parametrize("method", METHODS)
def test_columns_of_lambda(model, lit_scene, method, engine, rng):
    setting = Setting(model, lit_scene, method, engine, rng)
    seen = setting.evaluate()
    assert_jacobian(
        lambda lam: setting.weighted_residual(lam=lam),
        -(seen.modes[1:] * seen.masked).T.astype(np.float64),
        setting.state.lam,
        steps=1.0,
        tolerance=1e-3,
    )


@every_method
def test_the_residual_is_that_of_the_image_and_the_model(model, lit_scene, method, engine, rng):
    """P(theta_2) E(I) - P(theta_1) (A0 + lambda A), its squares under the weights, and none where nothing is seen."""
    setting = Setting(model, lit_scene, method, engine, rng)
    seen, objective = setting.evaluate(), setting.objective
    metric = objective.method.image_metric(setting.state.angles[1])
    shown = seen.values[:, : metric.shape[1]] @ metric.T
    if objective.method.normalise:
        shown = seen.gain * shown + seen.offset * metric.sum(axis=1)
    # What is projected before it is learnt does not turn.
    theta = setting.state.angles[0] if objective.method.angle_directions[0].any() else model.theta
    appearance = np.tensordot(setting.state.lam[: objective.appearance.n_modes], objective.appearance.modes, axes=1)
    appearance = (objective.appearance.mean + appearance) @ objective.method.model_metric(theta).T
    extra = setting.state.lam[objective.appearance.n_modes :] @ seen.modes[1 + objective.appearance.n_modes :]
    expected = shown - appearance - extra.reshape(appearance.shape)
    np.testing.assert_allclose(seen.residual, expected.ravel(), atol=3e-5 * max(1.0, np.abs(shown).max()))
    weighted = seen.masked.astype(np.float64) * seen.residual
    assert seen.squares == pytest.approx(weighted @ weighted, rel=1e-5)
    assert seen.weight == pytest.approx(np.square(seen.masked.astype(np.float64)).sum(), rel=1e-5)
    np.testing.assert_array_equal(seen.masked, seen.sqrt_weights * np.repeat(seen.usable, objective.method.n_rows))


def half_blind(image):
    """The same image, whose upper half says nothing."""
    channels = image.channels.copy()
    channels[: len(channels) // 2, :, -1] = 0
    return replace(image, patch=replace(image.patch, channels=channels))


@pytest.mark.parametrize(
    ("method", "expects"),
    [(method, expects) for method in ALL for expects in sorted({False, get_method(method).expects})],
    ids=lambda value: "expected" if value is True else "own" if value is False else name_of(value),
)
def test_equations_are_those_of_dense_columns_where_half_of_the_image_is_blind(
    model, lit_scene, method, engine, expects, rng
):
    setting = Setting(model, lit_scene, method, engine, rng)
    seen = setting.look_at(setting.begun(half_blind(setting.image)), expects=expects)
    assert 0.05 < (seen.usable == 0).mean() < 0.95
    root, n_p = seen.masked.astype(np.float64), len(seen.p)
    J, E = (
        root[:, None] * np.hstack([setting.by_parameters(gradients, seen.p), seen.columns.T])
        for gradients in (seen.gradients, seen.expected if expects else seen.gradients)
    )
    A, r, ridge = (seen.modes[1:] * root).T, root * seen.residual, setting.objective.fields["ridge"]
    aa, aj, hessian = A.T @ A, A.T @ J, E.T @ J
    hessian[n_p:, :n_p] = hessian[:n_p, n_p:].T  # with the angles' columns what is expected counts
    inverse = np.linalg.inv(aa + np.diag(ridge))
    hessian -= aj.T @ inverse @ aj
    hessian = 0.5 * (hessian + hessian.T)
    gradient = E.T @ r - aj.T @ inverse @ (A.T @ r - ridge * seen.lam)
    factor = np.tril(seen.factor)
    np.testing.assert_allclose(factor @ factor.T, aa + np.diag(ridge), atol=2e-5 * np.abs(aa).max(initial=0.0))
    np.testing.assert_allclose(seen.aj, aj, atol=1e-5 * np.abs(aj).max(initial=0.0))
    np.testing.assert_allclose(seen.hessian, hessian, atol=3e-5 * np.abs(hessian).max())
    np.testing.assert_allclose(seen.gradient, gradient, atol=1e-4 * np.abs(gradient).max())
    np.testing.assert_array_equal(seen.hessian, seen.hessian.T)


@every_method
def test_the_best_appearance_leaves_nothing_to_gain(model, lit_scene, method, engine, rng):
    """Its lambda is that of least squares over the columns and the prior, and the residual is that of another look."""
    setting = Setting(model, lit_scene, method, engine, rng)
    seen = setting.evaluate(solves=True)
    again = setting.evaluate(lam=seen.lam)
    np.testing.assert_allclose(seen.residual, again.residual, atol=1e-5 * max(1.0, np.abs(again.residual).max()))
    assert again.squares == pytest.approx(seen.squares, rel=1e-4, abs=1e-6)
    pull = np.sqrt(setting.objective.fields["ridge"])
    A = np.vstack([(again.modes[1:] * again.masked).T.astype(np.float64), np.diag(pull)])
    r = np.concatenate([again.masked.astype(np.float64) * again.residual, -pull * seen.lam])
    left = r - A @ np.linalg.lstsq(A, r, rcond=1e-9)[0]
    assert r @ r <= (left @ left) * (1 + 1e-3) + 1e-9
    assert not seen.ar.any()


@methods_with_angles
def test_the_reduced_gradient_is_that_of_the_cost_with_the_best_lambda(model, lit_scene, method, engine, rng):
    setting = Setting(model, lit_scene, method, engine, rng)
    n_p = setting.objective.warp.n_parameters

    def reduced(free):
        return setting.evaluate(solves=True, angles=setting.turned(free))

    at = np.zeros(setting.objective.n_q - n_p)
    gradient = reduced(at).gradient[n_p:]
    assert_jacobian(lambda free: np.array([reduced(free).squares]), 2 * gradient[None], at, steps=1e-2, tolerance=2e-2)


@pytest.mark.parametrize("method", ["li", "li-pc", "li-lit", "li+noise", "chroma"])
def test_a_constant_grey_bias_is_a_null_vector(model, lit_scene, method, engine, rng):
    """L(theta) (1, 1, 1) = 0: light of another strength does not move a residual, whatever the angle."""
    setting = Setting(model, lit_scene, method, engine, rng)
    patch = setting.image.patch
    channels = patch.channels.copy()
    channels[..., :3] += 1.5
    brighter = problem_of(setting.objective, replace(setting.image, patch=replace(patch, channels=channels)), engine)
    brighter.begin(setting.state.p, tuple(setting.state.angles), setting.state.lam)
    brighter, own = setting.look_at(brighter), setting.evaluate()
    np.testing.assert_allclose(brighter.residual, own.residual, atol=1e-5)
    np.testing.assert_allclose(brighter.gradients, own.gradients, atol=1e-5)
