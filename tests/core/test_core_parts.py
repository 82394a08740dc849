"""Small systems, steps and weights of the core and of the reference do what their formulas say."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar

from liaam import _core
from liaam.encoding_constants import ENCODINGS, TABLE
from liaam.fitting import METHODS
from liaam.fitting.loop.angles import SEARCH, _minimise_on_arc
from liaam.fitting.loop.encoded_image import LEAST_BLUR, NEAR
from liaam.fitting.loop.objective import CodedModes
from liaam.fitting.methods import CORRELATED, GRADIENT_ROWS, LOSSES, gaussian_median
from liaam.fitting.reference import loop as reference_loop, problem as reference
from liaam.fitting.thresholds import THRESHOLDS
from liaam.image_reference import CHANNELS
from liaam.model.sampling import FINENESS, ROUNDING_OF_COUNT, SIZE_TOLERANCE

ROOT = Path(__file__).resolve().parents[2]
seeds, dampings = st.integers(0, 999), st.sampled_from([0.0, 1e-3, 1.0, 1e4])
entries = st.lists(st.booleans(), min_size=8, max_size=8).map(np.array)
LEAST, ROUNDING, DAMPING_FLOOR = (THRESHOLDS[name] for name in ("LEAST_CURVATURE", "ROUNDING", "DAMPING_FLOOR"))
OBSERVABLE_APART = THRESHOLDS["OBSERVABLE_APART"]

built = pytest.mark.skipif(not _core.BUILT, reason="the core is not built")


@pytest.fixture(
    scope="module", params=[_core, reference_loop] if _core.BUILT else [reference_loop], ids=lambda m: m.__name__
)
def module(request):
    return request.param


def symmetric(rng: np.random.Generator, eigenvalues: np.ndarray) -> np.ndarray:
    turn = np.linalg.qr(rng.normal(size=(len(eigenvalues), len(eigenvalues))))[0]
    return (turn * eigenvalues) @ turn.T


def test_thresholds_are_the_same():
    header = (ROOT / "src/core/thresholds.hpp").read_text(encoding="utf-8")
    found = dict(re.findall(r"constexpr \w+ k(\w+) = ([^;]+);", header))
    names = {re.sub(r"(?<!^)(?=[A-Z])", "_", name).upper(): eval(value) for name, value in found.items()}
    assert names == THRESHOLDS


def test_the_core_has_no_values_of_its_own_for_the_encodings():
    header = (ROOT / "src/core/encoding.hpp").read_text(encoding="utf-8")
    (fields,) = re.findall(r"struct EncodingConstants \{(.*?)\};", header, re.DOTALL)
    code = " ".join(line.partition("//")[0] for line in fields.splitlines())
    assert "=" not in code
    assert {name for name in re.findall(r"\w+", code) if name not in ("float", "std", "array", "3")} == set(TABLE)


def test_the_core_numbers_the_encodings_as_their_table():
    header = (ROOT / "src/core/encoding.hpp").read_text(encoding="utf-8")
    ((names, last),) = re.findall(r"enum class Encoding \{ (.*?) \};.*?kLastEncoding = Encoding::(\w+);", header, re.S)
    assert names.split(", ") == list(ENCODINGS)
    assert last == list(ENCODINGS)[-1]


def test_the_core_numbers_the_losses_as_their_table():
    header = (ROOT / "src/core/objective.hpp").read_text(encoding="utf-8")
    ((names, last),) = re.findall(r"enum class Loss \{ none, (.*?) \};.*?kLastLoss = Loss::(\w+);", header, re.DOTALL)
    assert tuple(name.replace("_", "-") for name in names.split(", ")) == LOSSES
    assert last.replace("_", "-") == LOSSES[-1]


@pytest.mark.parametrize(
    ("file", "name", "value"),
    [
        ("weights.cpp", "kCorrelated[2]", set(CORRELATED)),
        ("weights.cpp", "kGradientRows", {GRADIENT_ROWS}),
        ("weights.cpp", "kUnknown", {reference.UNKNOWN}),
        ("weights.cpp", "kLeastUnexplained", {reference.LEAST_UNEXPLAINED}),
        ("weights.cpp", "kMostDirectionNoise", {reference.MOST_DIRECTION_NOISE}),
        ("encoding.hpp", "kChannels", {CHANNELS}),
        ("fit.cpp", "kNear", {NEAR}),
        ("fit.cpp", "kFineness", {FINENESS}),
        ("fit.cpp", "kSizeTolerance", {SIZE_TOLERANCE}),
        ("fit.cpp", "kRoundingOfCount", {ROUNDING_OF_COUNT}),
        ("fit.cpp", "kLeastBlur", {LEAST_BLUR}),
    ],
)
def test_other_constants_are_the_same(file, name, value):
    (text,) = re.findall(rf"constexpr .*\b{re.escape(name)} = ([^;]+);", (ROOT / "src/core" / file).read_text())
    assert {float(each) for each in re.findall(r"\d[\d.e-]*", text)} == value


@pytest.mark.parametrize("file", ["level.cpp", "step.cpp"])
def test_the_loop_has_no_other_thresholds(file):
    assert "constexpr" not in (ROOT / "src/core" / file).read_text()


@built
@given(n=st.integers(0, 13), condition=st.sampled_from([1.0, 1e3, 1e8]), seed=seeds)
def test_factors_are_cholesky_s(n, condition, seed):
    matrix = symmetric(np.random.default_rng(seed), np.geomspace(1.0, condition, n))
    found, factor = _core.cholesky(matrix)
    lower = np.tril(factor)
    assert found
    np.testing.assert_allclose(lower @ lower.T, matrix, atol=1e-12 * condition)


@built
@pytest.mark.parametrize("diagonal", [(1.0, 0.0), (1.0, -1.0), (1.0, np.nan), (np.nan, 1.0), (0.0, 0.0), (-1.0, 2.0)])
def test_what_is_not_positive_definite_has_no_factor(diagonal):
    assert not _core.cholesky(np.diag(diagonal))[0]


@built
@given(n=st.integers(0, 20), rank=st.integers(0, 20), negative=st.booleans(), seed=seeds)
def test_clamped_systems_are_solved_by_their_eigenvalues(n, rank, negative, seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=n) * (np.arange(n) < rank) if negative else rng.random(n)
    matrix, right = symmetric(rng, values), rng.normal(size=n)
    matrix = 0.5 * (matrix + matrix.T)
    own, vectors = np.linalg.eigh(matrix)
    expected = vectors @ ((vectors.T @ right) / (np.maximum(own, 0.0) + 0.5))
    found, solution = _core.solve_clamped(matrix, 0.5, right)
    assert found
    np.testing.assert_allclose(solution, expected, atol=1e-9)


@built
@given(n=st.sampled_from([1, 7, 2047, 2048, 2049, 4101]), m=st.integers(0, 10), seed=st.integers(0, 9))
def test_gram_matrices_are_those_of_float64(n, m, seed):
    rng = np.random.default_rng(seed)
    modes, root = CodedModes.of(rng.normal(3, 1, (1, m, n))), rng.normal(3, 1, n).astype(np.float32)
    exact = modes.decoded(m)[0].astype(np.float64) * root
    np.testing.assert_allclose(_core.weighted_gram(modes.codes[0], modes.scales, m, root), exact @ exact.T, rtol=1e-5)


@built
def test_sums_keep_what_float32_would_lose():
    codes = np.zeros((10 * 2048 + 1, 8), np.int16)
    codes[:, 0] = 1
    codes[:2048, 0] = 128  # reaches 2**25, where a float32 sum does not feel a one
    scales = np.ones(8, np.float32)
    assert _core.weighted_gram(codes, scales, 1, np.ones(len(codes), np.float32))[0, 0] == 2048 * 2**14 + 9 * 2048 + 1


@pytest.mark.parametrize(("n_parts", "m"), [(1, 0), (1, 7), (3, 8), (3, 9)])
def test_modes_are_stored_to_half_a_step_of_their_codes(rng, n_parts, m):
    """Codes of 16 bits: a step is the largest value of a mode, over all its parts, divided by 2^15 - 1."""
    parts = rng.normal(size=(n_parts, m, 50)) * 10.0 ** rng.uniform(-6, 6, (1, m, 1))
    modes = CodedModes.of(parts)
    largest = np.abs(parts).max(axis=(0, 2), initial=0.0)
    assert modes.codes.dtype == np.int16 and not modes.codes[:, :, m:].any()
    error = np.abs(modes.decoded(m) - parts).max(axis=(0, 2), initial=0.0)
    assert (error <= 0.501 * largest / 32767).all()


def test_a_mode_of_zeros_stays_zero():
    assert not CodedModes.of(np.zeros((1, 3, 5))).decoded(3).any()


# Steps


@given(n=st.integers(1, 8), rank=st.integers(1, 8), free=entries, damping=dampings, seed=seeds)
def test_a_damped_step_solves_its_system(module, n, rank, free, damping, seed):
    """(H + damping diag H) step = -gradient, with a floor that only a flat direction feels."""
    rng, free = np.random.default_rng(seed), free[:n]
    half = rng.normal(size=(n, min(rank, n)))
    hessian, gradient = half @ half.T, half @ rng.normal(size=half.shape[1])
    found, step = module.damped_step(hessian, gradient, free.tolist(), damping)
    assert found == free.any()
    assert not step[~free].any()
    if not found:
        return
    own, floor = hessian[np.ix_(free, free)], DAMPING_FLOOR * hessian.diagonal()[free].max()
    system = own + np.diag(damping * np.maximum(own.diagonal(), floor) + floor)
    np.testing.assert_allclose(system @ step[free], -gradient[free], atol=1e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("hessian", [np.zeros((2, 2)), np.full((2, 2), np.nan), -np.eye(2), np.diag([1.0, -1.0])])
def test_a_system_without_a_solution_gives_no_step(module, hessian):
    found, step = module.damped_step(hessian, np.ones(2), [True, True], 0.0)
    assert not found and not step.any()
    assert not module.clamped_newton_step(hessian, -np.eye(2), np.ones(2), [True, True], 0.0, LEAST)[0]


def formula(base, hessian, gradient, damping, least) -> np.ndarray:
    """With H v = rho B v: rho becomes max(rho, least) + damping."""
    rho, axes = eigh(hessian, base + ROUNDING * base.diagonal().max() * np.eye(len(base)))
    return axes @ ((axes.T @ -gradient) / (np.maximum(rho, least) + damping))


@given(
    n=st.integers(1, 8),
    flattest=st.sampled_from([-5.0, -0.1, 0.0, 0.3, 0.49, 0.51, 2.0]),
    free=entries,
    least=st.sampled_from([LEAST, 2.0]),
    damping=dampings,
    seed=seeds,
)
def test_a_newton_step_is_clamped_to_a_fraction_of_the_expected_curvature(
    module, n, flattest, free, least, damping, seed
):
    rng, free = np.random.default_rng(seed), free[:n]
    base, gradient = symmetric(rng, np.geomspace(1.0, 1e3, n)), rng.normal(size=n)
    root = np.linalg.cholesky(base)
    hessian = root @ symmetric(rng, rng.uniform(flattest, flattest + 2.0, n)) @ root.T
    hessian = 0.5 * (hessian + hessian.T)
    found, step = module.clamped_newton_step(base, hessian, gradient, free.tolist(), damping, least)
    assert found == free.any()
    assert np.abs(step[~free]).max(initial=0.0) < 1e-12
    if found:
        own = np.ix_(free, free)
        expected = formula(base[own], hessian[own], gradient[free], damping, least)
        np.testing.assert_allclose(step[free], expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_a_base_that_is_flat_somewhere_is_no_fault(module, rng):
    base, gradient = symmetric(rng, np.array([3.0, 2.0, 1.0, 0.0])), rng.normal(size=4)
    gradient = base @ gradient  # nothing is asked for along what is flat
    found, step = module.clamped_newton_step(base, 0.8 * base, gradient, [True] * 4, 0.0, LEAST)
    assert found
    np.testing.assert_allclose(base @ step, -gradient / 0.8, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("of_base", [False, True])
def test_no_step_is_made_of_what_is_not_finite(module, bad, of_base):
    base, hessian = np.eye(3), 0.1 * np.eye(3)
    (base if of_base else hessian)[[1, 0], [0, 1]] = bad
    found, step = module.clamped_newton_step(base, hessian, np.ones(3), [True] * 3, 0.0, LEAST)
    assert not found or not np.isfinite(step).all()


# Angles that the image determines


class Told:
    """A problem's Hessian and noise; |L'|^2 / |L|^2 is 1."""

    def __init__(self, hessian: np.ndarray) -> None:
        self.hessian, self.metric, self.metric_slope, self.squares, self.weight = (
            hessian,
            np.ones(8),
            np.ones(8),
            1.0,
            1.0,
        )


def observable(module, free_angles: str, hessian: np.ndarray, limit: float = 25.0) -> list[bool]:
    """Which of (a parameter, the free angles) may move."""
    directions = np.ascontiguousarray(METHODS[free_angles].angle_directions, dtype=np.float64)
    whole = np.eye(1 + len(hessian))
    whole[1:, 1:] = hessian
    if module is reference_loop:
        return reference_loop.observable_parameters(Told(whole), directions, limit).tolist()
    return module.observable_parameters(whole, directions, 1.0, 1.0, limit)


@pytest.mark.parametrize(("curvature", "free"), [(24.0, False), (26.0, True), (np.nan, False)])
def test_a_shared_angle_is_held_where_noise_would_turn_it(module, curvature, free):
    assert observable(module, "li-pcs", np.array([[curvature]])) == [True, free]


@pytest.mark.parametrize(("curvature", "free"), [(0.9 * OBSERVABLE_APART, False), (1.1 * OBSERVABLE_APART, True)])
def test_an_angle_of_the_image_alone_is_observable_sooner(module, curvature, free):
    assert observable(module, "li", np.array([[curvature]])) == [True, free]
    assert observable(module, "li", np.array([[curvature]]), 0.0) == [True, True]  # the paper holds none


@pytest.mark.parametrize(
    ("together", "apart", "free"),
    [(30.0, 30.0, (True, True)), (20.0, 30.0, (False, True)), (30.0, 1.0, (False, False))],
)
def test_of_two_angles_the_image_s_is_observable_first(module, together, apart, free):
    """In (both turned together, theta_2 alone), without cross terms; the Hessian is of (theta_1, theta_2)."""
    hessian = np.array([[together + apart, -apart], [-apart, apart]])
    assert observable(module, "li-pc", hessian) == [True, *free]


def test_without_angles_all_may_move(module):
    assert observable(module, "grey", np.zeros((0, 0))) == [True]


@built
@given(seed=st.integers(0, 10**6), kind=st.sampled_from(["general", "round", "nearly round", "flat", "nothing"]))
def test_both_find_the_same_angle(seed, kind):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, 2))
    nearly = np.eye(2) + 1e-15 * np.diag([1, 0])
    S = {"general": root @ root.T, "round": np.eye(2), "nearly round": nearly}.get(kind, np.zeros((2, 2)))
    b = np.zeros(2) if kind == "nothing" else rng.normal(size=2) * rng.choice([0.01, 1, 10])
    centre = rng.uniform(-4, 4)

    def cost(t):
        u = np.array([np.cos(t), np.sin(t)])
        return u @ S @ u - 2 * b @ u

    found = _core.minimise_on_arc((S[0, 0], S[0, 1], S[1, 1]), tuple(b), centre, SEARCH)
    assert abs(found - centre) <= SEARCH + 1e-12
    assert cost(found) <= cost(_minimise_on_arc(S, b, centre, SEARCH)) + 1e-9


# The scale of the shape prior's variances


def seen_by_an_image(rng, scale, n=30, rigid=4):
    """Give what an image tells of p: Hessian, variance, precision of the prior, and where alone it would end."""
    root = rng.normal(size=(n + rigid, n + rigid)) / 6
    hessian, variance = root @ root.T + 0.01 * np.eye(n + rigid), 0.3
    prior = np.concatenate([rng.uniform(0.5, 20.0, n), np.zeros(rigid)])
    truth = np.concatenate([rng.normal(size=n) * np.sqrt(scale / prior[:n]), rng.normal(size=rigid)])
    seen = truth + np.linalg.cholesky(variance * np.linalg.inv(hessian)) @ rng.normal(size=n + rigid)
    return hessian, variance, prior, seen


def converged(module, hessian, variance, prior, seen, dof, strength=1.0):
    scale = 1.0
    for _ in range(2000):
        p = np.linalg.solve(hessian / variance + np.diag(strength * prior / scale), hessian @ seen / variance)
        new = module.next_prior_scale(hessian, p, prior, dof, scale, strength, variance)
        if abs(new / scale - 1) < 1e-9:
            break
        scale = new
    return scale


@pytest.mark.parametrize("scale", [0.1, 1.0, 8.0])
@pytest.mark.parametrize("dof", [3.0, 20.0])
def test_the_scale_is_the_most_probable_one(module, rng, scale, dof):
    hessian, variance, prior, seen = seen_by_an_image(rng, scale)
    n = int((prior > 0).sum())
    spread = (variance * np.linalg.inv(hessian))[:n, :n]  # the similarity may be anything

    def unlikely(log_scale):
        s, y = np.exp(log_scale), seen[:n]
        whole = np.diag(s / prior[:n]) + spread
        return 0.5 * (y @ np.linalg.solve(whole, y) + np.linalg.slogdet(whole)[1] + dof * (np.log(s) + 1 / s))

    best = np.exp(minimize_scalar(unlikely, bounds=(-6, 6), method="bounded", options={"xatol": 1e-9}).x)
    assert converged(module, hessian, variance, prior, seen, dof) == pytest.approx(best, rel=1e-2)


def test_angles_do_not_count_for_the_scale(module, rng):
    hessian, variance, prior, p = seen_by_an_image(rng, 1.0)
    wider = np.zeros((len(p) + 1, len(p) + 1))
    wider[:-1, :-1], wider[-1, -1] = hessian, 1e6
    wider[-1, 0] = wider[0, -1] = 3.0
    expected = module.next_prior_scale(hessian, p, prior, 3.0, 0.7, 1.0, variance)
    assert module.next_prior_scale(wider, p, prior, 3.0, 0.7, 1.0, variance) == pytest.approx(expected)


def test_an_image_that_tells_nothing_leaves_the_scale_alone(module, rng):
    hessian, variance, prior, p = seen_by_an_image(rng, 1.0)
    for bad in (np.full_like(hessian, np.nan), np.full_like(hessian, np.inf)):
        assert module.next_prior_scale(bad, p, prior, 3.0, 0.7, 1.0, variance) == 0.7
    for bad in (0.0, np.nan, np.inf):
        assert module.next_prior_scale(hessian, p, prior, 3.0, 0.7, 1.0, bad) == 0.7
    # A flat image: nothing is told, so that the squares alone count.
    assert module.next_prior_scale(0 * hessian, 0 * p, prior, 3.0, 0.7, 1.0, 1.0) == pytest.approx(1.0, abs=1e-3)


# Robust losses

PUBLISHED = {
    "huber": lambda u: np.where(u <= 1.345, 0.5 * u**2, 1.345 * (u - 0.5 * 1.345)),
    "l1": lambda u: np.where(u <= 0.1, 0.5 * u**2, 0.1 * (u - 0.05)),
    "cauchy": lambda u: 0.5 * 2.385**2 * np.log1p((u / 2.385) ** 2),
    "geman-mcclure": lambda u: 0.5 * u**2 / (1.0 + (u / 3.65) ** 2),
    "tukey": lambda u: 4.685**2 / 6.0 * (1.0 - np.maximum(1.0 - (u / 4.685) ** 2, 0.0) ** 3),
}
"""Losses rho(u) of residuals u >= 0 in standard deviations; weights are rho'(u) / u."""


def weight(module, loss: str, u: float) -> float:
    number = LOSSES.index(loss) + 1
    if module is reference_loop:
        return float(reference.loss_weights(number, np.array([u]))[0])
    return module.loss_weight(number, u)


@pytest.mark.parametrize("loss", PUBLISHED)
@given(u=st.floats(0.01, 20.0))
def test_weights_are_those_of_the_published_losses(module, loss, u):
    slope = (PUBLISHED[loss](u * (1 + 1e-5)) - PUBLISHED[loss](u * (1 - 1e-5))) / (2e-5 * u)
    assert weight(module, loss, u) == pytest.approx(slope / u, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("loss", LOSSES)
@given(a=st.floats(0.0, 50.0), b=st.floats(0.0, 50.0))
def test_weights_fall_with_the_residual_and_stay_in_range(module, loss, a, b):
    low, high = sorted((a, b))
    assert 1.0 + 1e-12 >= weight(module, loss, low) >= weight(module, loss, high) - 1e-12 >= -1e-12


@pytest.mark.parametrize("loss", LOSSES)
def test_no_residual_weighs_one(module, loss):
    assert weight(module, loss, 0.0) == 1.0


@pytest.mark.parametrize("loss", ["huber", "cauchy", "geman-mcclure", "tukey"])
def test_gaussian_residuals_lose_a_twentieth_of_their_efficiency(loss):
    u = np.linspace(-8, 8, 100_001)
    density = np.exp(-0.5 * u**2) / np.sqrt(2 * np.pi)
    psi = reference.loss_weights(LOSSES.index(loss) + 1, np.abs(u)) * u
    step = u[1] - u[0]
    efficiency = (np.gradient(psi, step) * density).sum() ** 2 * step / (psi**2 * density).sum()
    assert efficiency == pytest.approx(0.95, abs=0.006)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_median_of_gaussian_residuals_is_known(k, rng):
    sizes = np.sqrt(np.square(rng.normal(size=(200_000, k))).mean(axis=1))
    assert gaussian_median(k) == pytest.approx(np.median(sizes), rel=0.01)


@built
@given(numbers=st.lists(st.floats(-1e6, 1e6), max_size=40))
def test_the_median_is_in_the_middle_of_sorted_numbers(numbers):
    assert _core.median(numbers) == (sorted(numbers)[len(numbers) // 2] if numbers else 0.0)
