"""Normal equations from Gram matrices agree with dense least squares in float64."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from liaam.fitting.normal_equations import (
    BLOCK,
    NormalEquations,
    Sums,
    _negative_count,
    diagonal_of_inverse,
    gram,
    positive_inverse,
    solve_lifted,
)


@given(rows=st.sampled_from([1, 7, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK + 5]), seed=st.integers(0, 9))
def test_gram_is_the_float64_product(rows, seed):
    rng = np.random.default_rng(seed)
    left, right = (rng.normal(3, 1, (n, rows)).astype(np.float32) for n in (3, 4))
    exact = left.astype(np.float64) @ right.astype(np.float64).T
    found = gram(left, right)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, exact, rtol=3e-6)


def test_gram_keeps_what_float32_would_lose():
    row = np.ones((1, 10 * BLOCK + 1), np.float32)
    row[:, :BLOCK] = np.sqrt(2**24 / BLOCK)  # reaches 2**24, where a float32 sum stops to feel a one
    assert gram(row, row)[0, 0] == 2**24 + 9 * BLOCK + 1


class Dense:
    """A random linearisation, dense and as normal equations."""

    def __init__(self, rng: np.random.Generator, n_q: int = 5, m: int = 4, n: int = 300) -> None:
        self.J = rng.normal(size=(n, n_q)).astype(np.float32)
        self.A = rng.normal(size=(n, m)).astype(np.float32)
        self.r = (rng.normal(size=n) + self.J[:, 0] - 2 * self.A[:, :1].sum(axis=1)).astype(np.float32)
        J, A, r = (a.astype(np.float64) for a in (self.J, self.A, self.r))
        self.equations = NormalEquations(
            jj=J.T @ J, jr=J.T @ r, aj=A.T @ J, aa=A.T @ A, ar=A.T @ r, rr=float(r @ r), weight=float(n)
        )


@pytest.fixture
def dense(rng) -> Dense:
    return Dense(rng)


def test_best_lambda_step_is_least_squares(dense):
    expected = np.linalg.lstsq(dense.A, dense.r, rcond=None)[0]
    np.testing.assert_allclose(dense.equations.best_lambda_step(), expected, rtol=1e-5)


def test_the_joint_step_is_least_squares_over_q_and_lambda(dense):
    n_q = dense.J.shape[1]
    expected = np.linalg.lstsq(np.hstack([dense.J, -dense.A]), -dense.r, rcond=None)[0]
    hessian, gradient = dense.equations.reduced()
    step = np.linalg.solve(hessian, -gradient)
    np.testing.assert_allclose(step, expected[:n_q], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(dense.equations.lambda_step(step), expected[n_q:], rtol=1e-4, atol=1e-6)


def test_equations_after_a_lambda_step_are_those_of_the_new_residual(dense, rng):
    step = rng.normal(size=dense.A.shape[1])
    r = dense.r - dense.A @ step
    after = dense.equations.after_lambda_step(step)
    np.testing.assert_allclose(after.jr, dense.J.T @ r, atol=1e-3)
    np.testing.assert_allclose(after.ar, dense.A.T @ r, atol=1e-3)
    assert after.rr == pytest.approx(r @ r, rel=1e-5)
    assert after.cost == pytest.approx(np.square(r).mean(), rel=1e-5)


def test_the_reduced_system_is_that_of_projected_columns(dense):
    Q = np.eye(len(dense.r)) - dense.A @ np.linalg.pinv(dense.A)
    hessian, gradient = dense.equations.reduced()
    np.testing.assert_allclose(hessian, dense.J.T @ Q @ dense.J, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(gradient, dense.J.T @ Q @ dense.r, rtol=1e-4, atol=1e-3)
    assert np.array_equal(hessian, hessian.T)


def test_lambda_where_it_is_best_leaves_the_reduced_system_alone(dense):
    after = dense.equations.after_lambda_step(dense.equations.best_lambda_step())
    for ours, theirs in zip(after.reduced(), dense.equations.reduced(), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-5)


def test_a_mode_that_no_pixel_sees_does_not_explode(dense):
    for matrix in (dense.equations.aa, dense.equations.aa.T):
        matrix[1] = 0
    dense.equations.aj[1] = 0
    dense.equations.ar[1] = 0
    assert dense.equations.best_lambda_step()[1] == 0
    assert np.isfinite(dense.equations.reduced()[0]).all()


def test_two_equal_modes_do_not_explode(rng):
    dense = Dense(rng)
    dense.A[:, 1] = dense.A[:, 0]
    A = dense.A.astype(np.float64)
    step = Sums(aa=A.T @ A, ar=A.T @ dense.r, rr=1.0, weight=1.0).best_lambda_step()
    np.testing.assert_allclose(A @ step, A @ np.linalg.pinv(A) @ dense.r, atol=1e-4)
    assert np.abs(step).max() < 100


def test_without_pixels_the_cost_is_infinite():
    assert Sums(aa=np.zeros((2, 2)), ar=np.zeros(2), rr=0.0, weight=0.0).cost == np.inf


@pytest.mark.parametrize(
    "ratios",
    [(2.0, 0.1, 1.0, -3.0, 0.6, 0.2), (2.0, 0.4, 1.0, 3.0, 0.6, 0.9), (2.0, 0.7, 1.0, 3.0, 0.6, 0.9)],
    ids=["many", "one", "none"],
)
@pytest.mark.parametrize("rank", [6, 4])
def test_a_lifted_solution_is_nowhere_flatter_than_the_base(rng, rank, ratios):
    """Curvature below the lift is lifted to it, more is kept, and a base that is flat somewhere is no fault."""
    n, lift, damping = 6, 0.5, 0.1
    base = np.diag(np.where(np.arange(n) < rank, np.arange(1.0, n + 1), 0.0))
    ratios = np.array(ratios)
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    right = turn @ np.where(np.arange(n) < rank, 1.0, 0.0)
    found = solve_lifted(turn @ base @ turn.T, turn @ (ratios * base) @ turn.T, right, lift, damping)
    expected = 1.0 / ((np.maximum(ratios, lift) + damping) * np.arange(1.0, n + 1))
    np.testing.assert_allclose((turn.T @ found)[:rank], expected[:rank], rtol=1e-8)
    assert np.isfinite(found).all()


@given(n=st.integers(1, 8), zeros=st.booleans(), seed=st.integers(0, 99))
def test_negative_eigenvalues_are_counted(n, zeros, seed):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(n, n))
    matrix += matrix.T
    if zeros:  # on the diagonal: pivots of 2 by 2
        np.fill_diagonal(matrix, 0.0)
    assert _negative_count(matrix) == np.count_nonzero(np.linalg.eigvalsh(matrix) < 0)


def test_what_is_steep_by_rounding_only_is_lifted():
    """A base that is flat but for rounding is lifted out of it, whatever the Hessian says there."""
    right = np.array([0.0, 1e-6])
    for least, slope in ((1e-9, 2e-9), (0.0, 1e-14)):
        step = solve_lifted(np.diag([1.0, least]), np.diag([1.0, slope]), right, 0.5, 0.0)
        assert np.abs(step).max() <= 20.0 + 1e-6


@pytest.mark.parametrize("condition", [1.0, 1e3, 1e8])
def test_the_inverse_of_a_positive_matrix(rng, condition):
    turn = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    matrix = (turn * np.geomspace(1.0, condition, 5)) @ turn.T
    inverse, diagonal = positive_inverse(matrix), diagonal_of_inverse(matrix)
    assert inverse is not None and diagonal is not None
    np.testing.assert_allclose(inverse, np.linalg.inv(matrix), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(diagonal, inverse.diagonal(), rtol=1e-9)
    assert np.array_equal(inverse, inverse.T)


@pytest.mark.parametrize("values", [(1.0, 0.0), (1.0, -1.0), (1.0, 1e-15), (1.0, np.nan), (0.0, 0.0)])
def test_what_is_not_positive_has_no_inverse(values):
    assert positive_inverse(np.diag(values)) is None and diagonal_of_inverse(np.diag(values)) is None
