"""Gram matrices and small systems agree with dense least squares in float64, in both kernels."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam.fitting.kernel import KERNELS
from liaam.fitting.level import BLOCK, RIDGE, Template, Work
from setups import Kernel

seeds = st.integers(0, 999)


@pytest.fixture(params=KERNELS, scope="module")
def kernel(request) -> Kernel:
    return Kernel(request.param)


def positive(rng: np.random.Generator, n: int, condition: float) -> np.ndarray:
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return (turn * np.geomspace(1.0, condition, n)) @ turn.T


def gram_of(kernel, modes: np.ndarray, root: np.ndarray) -> np.ndarray:
    gram = np.full((len(modes), len(modes)), np.nan)
    rows = np.concatenate([np.full((1, modes.shape[1]), np.nan, np.float32), modes])  # the mean, which does not count
    kernel.weighted_gram(rows, root, np.empty((len(modes), BLOCK), np.float32), gram)
    return gram


@given(n=st.integers(0, 9), condition=st.sampled_from([1.0, 1e3, 1e8]), b=st.integers(1, 3), seed=seeds)
def test_systems_are_solved(kernel, n, condition, b, seed):
    rng = np.random.default_rng(seed)
    matrix = positive(rng, n, condition)
    factor, columns, right = matrix.copy(), rng.normal(size=(n, b)), rng.normal(size=n)
    assert kernel.cholesky(factor)
    lower = np.tril(factor)
    np.testing.assert_allclose(lower @ lower.T, matrix, atol=1e-12 * condition)
    found, half = right.copy(), columns.copy()
    kernel.solve(factor, found)
    np.testing.assert_allclose(matrix @ found, right, atol=1e-13 * condition)
    kernel.solve_lower(factor, half)
    np.testing.assert_allclose(lower @ half, columns, atol=1e-12 * condition)


@pytest.mark.parametrize("diagonal", [(1.0, 0.0), (1.0, -1.0), (1.0, np.nan), (np.nan, 1.0), (0.0, 0.0), (-1.0, 2.0)])
def test_what_is_not_positive_has_no_factor(kernel, diagonal):
    assert not kernel.cholesky(np.diag(diagonal))


class Dense:
    """Random columns [J | r] and A, and their products."""

    def __init__(self, rng: np.random.Generator, n_q: int = 5, m: int = 4, n: int = 300) -> None:
        self.J, self.A = rng.normal(size=(n, n_q)), rng.normal(size=(n, m))
        self.r = rng.normal(size=n) + self.J[:, 0] - 2 * self.A.sum(axis=1)
        self.factor = np.linalg.cholesky(self.A.T @ self.A) if m else np.zeros((0, 0))
        self.aj, self.ar = self.A.T @ self.J, self.A.T @ self.r

    def eliminated(self, kernel) -> tuple[np.ndarray, np.ndarray]:
        hessian, gradient = self.J.T @ self.J, self.J.T @ self.r
        m, n_q = self.aj.shape
        room = {"eliminated": np.empty((m, n_q)), "along": np.empty((m, 1)), "small": np.empty((1, n_q, n_q))}
        given = {"factor": self.factor, "aj": self.aj, "ar": self.ar, "hessian": hessian, "gradient": gradient}
        kernel.eliminate(kernel.record(Work, **given, **room))
        return hessian, gradient


@given(n_q=st.integers(1, 19), m=st.sampled_from([0, 1, 3, 8, 13]), seed=seeds)
def test_the_reduced_system_is_that_of_projected_columns(kernel, n_q, m, seed):
    """J'QJ and J'Qr: the Schur complement of A'A."""
    dense = Dense(np.random.default_rng(seed), n_q, m)
    Q = np.eye(len(dense.r)) - dense.A @ np.linalg.pinv(dense.A)
    hessian, gradient = dense.eliminated(kernel)
    np.testing.assert_allclose(hessian, dense.J.T @ Q @ dense.J, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(gradient, dense.J.T @ Q @ dense.r, rtol=1e-9, atol=1e-9)
    assert np.array_equal(hessian, hessian.T)


def test_the_joint_step_is_least_squares_over_q_and_lambda(kernel, rng):
    dense = Dense(rng)
    n_q = dense.J.shape[1]
    expected = np.linalg.lstsq(np.hstack([dense.J, -dense.A]), -dense.r, rcond=None)[0]
    hessian, gradient = dense.eliminated(kernel)
    step = np.linalg.solve(hessian, -gradient)
    lam = np.full(len(dense.ar), np.nan)
    kernel.along_with(kernel.record(Work, factor=dense.factor, ar=dense.ar, aj=dense.aj, step=step, lam_step=lam))
    np.testing.assert_allclose(step, expected[:n_q], rtol=1e-9)
    np.testing.assert_allclose(lam, expected[n_q:], rtol=1e-9)


@given(
    n=st.sampled_from([1, 7, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK + 5]), m=st.integers(0, 5), seed=st.integers(0, 9)
)
def test_products_are_those_of_float64(kernel, n, m, seed):
    rng = np.random.default_rng(seed)
    rows, residual, root = (rng.normal(3, 1, shape).astype(np.float32) for shape in ((1 + m, n), n, n))
    exact, weights = rows[1:].astype(np.float64), np.square(root.astype(np.float64))
    np.testing.assert_allclose(gram_of(kernel, rows[1:], root), exact * weights @ exact.T, rtol=1e-5)
    out, line = np.empty(m), np.empty(BLOCK, np.float32)
    kernel.with_modes(rows, root, residual, line, out)
    np.testing.assert_allclose(out, exact @ (weights * residual), rtol=1e-5)
    lam, left, sums = rng.normal(size=m), residual.copy(), np.empty(2)
    kernel.subtract(kernel.record(Work, residual=left, rows=rows, lam_step=lam, root=root, sums=sums))
    np.testing.assert_allclose(left, residual - lam @ exact, atol=1e-5)
    np.testing.assert_allclose(sums, [weights @ np.square(left.astype(np.float64)), weights.sum()], rtol=1e-5)


def test_sums_keep_what_float32_would_lose(kernel):
    row = np.ones((1, 10 * BLOCK + 1), np.float32)
    row[:, :BLOCK] = 128.0  # reaches 2**25, where a float32 sum does not feel a one
    total, one, sums, out = BLOCK * 2**14 + 9 * BLOCK + 1, np.ones_like(row[0]), np.empty(2), np.empty(1)
    assert gram_of(kernel, row, one)[0, 0] == total
    kernel.with_modes(np.concatenate([row, row]), one, row[0], np.empty(BLOCK, np.float32), out)
    kernel.subtract(kernel.record(Work, residual=row[0].copy(), rows=row, root=one, sums=sums))
    assert out[0] == sums[0] == total
    assert sums[1] == row.size


class Seen:
    """Modes under weights, some of whose pixels say nothing, and the best appearance of a residual."""

    def __init__(self, kernel, modes: np.ndarray, residual: np.ndarray, usable: np.ndarray, k: int = 1) -> None:
        m, e = modes.shape
        wide = -(-m // 8) * 8
        self.modes, self.residual = modes.astype(np.float32), residual.astype(np.float32)
        own, usable = np.ones(e, np.float32), usable.astype(np.float32)
        self.root, lines = np.empty(e, np.float32), np.zeros((e, wide), np.float32)
        lines[:, :m] = self.modes.T
        unseen = kernel.mask(own, usable, self.root)
        assert unseen == (usable == 0).sum()
        np.testing.assert_array_equal(self.root, np.repeat(usable, k))
        self.gram, self.factor, self.lam = gram_of(kernel, self.modes, own), np.full((m, m), np.nan), np.empty(m)
        self.ridge = np.maximum(RIDGE * np.square(self.modes, dtype=np.float64).sum(axis=1), 1e-12)
        given = {"gram": self.gram, "lines": lines.ravel(), "own": own, "usable": usable, "factor": self.factor}
        kernel.factorise(kernel.record(Template, ridge=self.ridge), kernel.record(Work, **given), unseen)
        rows = np.concatenate([np.zeros((1, e), np.float32), self.modes])
        kernel.with_modes(rows, self.root, self.residual, np.empty(BLOCK, np.float32), self.lam)
        kernel.solve(self.factor, self.lam)

    @property
    def left(self) -> float:
        """Squares that the best appearance leaves."""
        return float(np.square(self.root * (self.residual - self.lam @ self.modes)).sum())


@given(m=st.sampled_from([0, 1, 5, 8, 11]), k=st.integers(1, 3), blind=st.sampled_from([0.0, 0.1, 0.6]), seed=seeds)
def test_the_best_appearance_is_least_squares_over_what_is_seen(kernel, m, k, blind, seed):
    rng = np.random.default_rng(seed)
    n = 60
    seen = Seen(kernel, rng.normal(size=(m, n * k)), rng.normal(size=n * k), rng.random(n) >= blind, k)
    A, r = (seen.modes * seen.root).T, seen.root * seen.residual
    factor = np.tril(seen.factor)
    scale = np.abs(seen.gram).max(initial=0.0)
    np.testing.assert_allclose(factor @ factor.T, A.T @ A + np.diag(seen.ridge), atol=1e-6 * scale)
    np.testing.assert_allclose(seen.lam, np.linalg.lstsq(A, r, rcond=None)[0], atol=1e-4)


def test_a_mode_that_no_pixel_sees_does_not_explode(kernel, rng):
    modes = rng.normal(size=(3, 50))
    modes[1] = 0.0
    seen = Seen(kernel, modes, rng.normal(size=50), np.ones(50))
    assert seen.lam[1] == 0
    hidden = Seen(kernel, np.where(np.arange(50) < 5, [[1.0], [0.0], [0.0]], modes), seen.residual, np.arange(50) >= 5)
    assert np.isfinite(hidden.lam).all()
    assert np.abs(hidden.lam).max() < 10


def test_two_equal_modes_do_not_explode(kernel, rng):
    modes = rng.normal(size=(3, 50))
    modes[1] = modes[0]
    residual = modes.sum(axis=0) + rng.normal(size=50)
    both, one = (Seen(kernel, each, residual, np.ones(50)) for each in (modes, modes[1:]))
    assert np.abs(both.lam).max() < 100
    assert both.left == pytest.approx(one.left, rel=1e-4)


@pytest.mark.parametrize("of_nothing", ["pixels", "modes", "numbers"])
def test_where_nothing_is_seen_the_appearance_stays_at_its_mean(kernel, rng, of_nothing):
    modes, usable = rng.normal(size=(4, 30)), np.ones(30)
    if of_nothing == "pixels":
        usable[:] = 0.0
    elif of_nothing == "modes":
        modes[:] = 0.0
    else:
        modes = modes[:0]
    seen = Seen(kernel, modes, rng.normal(size=30), usable)
    assert not seen.lam.any()
    assert np.isfinite(seen.factor).all()


def test_modes_that_all_but_one_pixel_hide_move_little(kernel, rng):
    """What is left of a Gram matrix after many subtractions need not be positive."""
    modes = (1e3 * rng.normal(size=(6, 500))).astype(np.float32)
    seen = Seen(kernel, modes, rng.normal(size=500), np.arange(500) == 0)
    assert np.isfinite(seen.lam).all()
    assert np.abs(seen.lam).max() < 1.0


def test_a_bias_does_not_hold_the_modes_beside_it(kernel, rng):
    """Its squared length is the number of pixels, that of a mode learnt is 1, and less after a projection."""
    modes, n = rng.normal(size=(4, 2500)), 2500
    modes *= 0.1 / np.linalg.norm(modes, axis=1)[:, None]
    modes[0] = 1.0
    truth = np.array([0.3, 2.0, -1.0, 3.0])
    seen = Seen(kernel, modes, truth @ modes + 1e-3 * rng.normal(size=n), np.ones(n))
    np.testing.assert_allclose(seen.lam, truth, atol=0.1)
