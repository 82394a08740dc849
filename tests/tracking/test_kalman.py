"""The Kalman mathematics: what must hold for all numbers, and what the second differences tell."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam.tracking import kalman

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(1, 6)


def spread(rng: np.random.Generator, k: int) -> np.ndarray:
    """Any covariance, of variances over some decades."""
    a = rng.standard_normal((k, k)) * np.exp(rng.normal(0, 1.5, k))
    return a @ a.T + 1e-3 * np.eye(k)


def any_belief(rng: np.random.Generator, k: int) -> kalman.Belief:
    whole = spread(rng, 2 * k)
    return kalman.Belief(rng.normal(size=k), rng.normal(size=k), whole[:k, :k], whole[:k, k:], whole[k:, k:])


def whole_of(belief: kalman.Belief) -> np.ndarray:
    """Joint covariance of positions and velocities."""
    return np.block([[belief.pp, belief.pv], [belief.pv.T, belief.vv]])


def least(matrix: np.ndarray) -> float:
    """Smallest eigenvalue, relative to the largest number."""
    return float(np.linalg.eigvalsh(matrix)[0] / np.abs(matrix).max())


@given(SEEDS, SIZES)
def test_a_measurement_leaves_less_doubt_than_it_and_the_prediction_have(seed, k):
    rng = np.random.default_rng(seed)
    belief, noise, measured = any_belief(rng, k), spread(rng, k), rng.normal(size=k)
    after = kalman.update(belief, measured, noise)
    assert 0.0 <= kalman.gain(belief, after, slice(None)) <= 1.0
    scale = np.abs(noise).max() + np.abs(belief.pp).max()
    assert least(noise - after.pp + 1e-9 * scale * np.eye(k)) >= 0
    assert least(belief.pp - after.pp + 1e-9 * scale * np.eye(k)) >= 0
    assert least(whole_of(belief) - whole_of(after)) > -1e-9


@given(SEEDS, SIZES)
def test_an_update_adds_the_information(seed, k):
    rng = np.random.default_rng(seed)
    belief, noise, measured = any_belief(rng, k), spread(rng, k), rng.normal(size=k)
    seen = np.zeros((2 * k, 2 * k))
    seen[:k, :k] = np.linalg.inv(noise)
    before = np.linalg.inv(whole_of(belief))
    covariance = np.linalg.inv(before + seen)
    mean = covariance @ (
        before @ np.concatenate([belief.position, belief.velocity])
        + np.concatenate([np.linalg.solve(noise, measured), np.zeros(k)])
    )
    after = kalman.update(belief, measured, noise)
    np.testing.assert_allclose(whole_of(after), covariance, rtol=1e-5, atol=1e-6 * np.abs(covariance).max())
    found = np.concatenate([after.position, after.velocity])
    np.testing.assert_allclose(found, mean, rtol=1e-5, atol=1e-5 * np.abs(mean).max())


@given(SEEDS, SIZES)
def test_a_prediction_is_that_of_white_noise_acceleration(seed, k):
    rng = np.random.default_rng(seed)
    belief, drive = any_belief(rng, k), np.exp(rng.normal(size=k))
    step = np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(k))
    noise = np.kron([[1 / 3, 1 / 2], [1 / 2, 1.0]], np.diag(drive))
    after = kalman.predict(belief, drive)
    np.testing.assert_allclose(after.position, belief.position + belief.velocity)
    covariance = step @ whole_of(belief) @ step.T + noise
    np.testing.assert_allclose(whole_of(after), covariance, rtol=1e-8, atol=1e-8 * np.abs(covariance).max())


@given(SEEDS, SIZES)
def test_covariances_stay_covariances(seed, k):
    rng = np.random.default_rng(seed)
    belief, drive = any_belief(rng, k), np.exp(rng.normal(size=k))
    for _ in range(20):
        measured, noise = 10 * rng.normal(size=k), spread(rng, k)
        belief = kalman.predict(belief, drive)
        belief = kalman.update(kalman.widened(belief, measured, noise), measured, noise)
        assert least(whole_of(belief)) > -1e-9
        assert np.isfinite(belief.position).all()


@given(SEEDS, st.floats(-1e3, 1e3))
def test_a_surprise_is_followed_to_within_three_deviations(seed, jump):
    rng = np.random.default_rng(seed)
    belief, noise = any_belief(rng, 1), spread(rng, 1)
    measured = belief.position + jump
    after = kalman.update(kalman.widened(belief, measured, noise), measured, noise)
    assert abs(after.position - measured) <= np.sqrt(kalman.GATE * noise[0, 0]) * (1 + 1e-9)


def test_what_is_expected_widens_nothing(rng):
    belief, noise = any_belief(rng, 4), spread(rng, 4)
    assert kalman.widened(belief, belief.position + 0.01, noise + np.eye(4)) is belief


def test_steady_motion_is_learnt_and_followed_without_lag():
    velocity, noise = np.array([2.0, -1.0]), 0.25 * np.eye(2)
    belief = kalman.first_belief(np.zeros(2), noise, np.array([5.0, 5.0]))
    for i in range(1, 30):
        belief = kalman.update(kalman.predict(belief, np.full(2, 1e-9)), i * velocity, noise)
    np.testing.assert_allclose(belief.velocity, velocity, rtol=1e-3)
    np.testing.assert_allclose(belief.position, 29 * velocity, rtol=1e-3)


def simulated(rng: np.random.Generator, n: int, noise: float, drive: float) -> np.ndarray:
    """Noisy positions of 40 coordinates that white noise accelerates, (n, 40)."""
    k = 40
    exact = np.linalg.cholesky(drive * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]) + 1e-15 * np.eye(2))
    position, velocity, rows = np.zeros(k), np.zeros(k), []
    for _ in range(n):
        step = exact @ rng.normal(size=(2, k))
        position, velocity = position + velocity + step[0], velocity + step[1]
        rows.append(position + np.sqrt(noise) * rng.normal(size=k))
    return np.array(rows)


@pytest.mark.parametrize(("noise", "drive"), [(0.3, 1e-6), (0.3, 0.1), (0.3, 3.0)])
def test_noise_and_drive_are_told_from_second_differences(rng, noise, drive):
    variances = np.ones(40)
    moments = kalman.first_moments(variances)
    for row in simulated(rng, 300, noise, drive):
        moments = kalman.observed(moments, row)
    share, found = kalman.noise_and_drive(moments, variances)
    assert share == pytest.approx(noise, rel=0.3, abs=0.1 * drive)
    # On average: chance makes some of the estimates too large, and none is negative.
    assert found.mean() == pytest.approx(drive, rel=0.5, abs=0.25 * noise)


def test_a_gap_takes_no_difference_over_itself():
    moments = kalman.first_moments(np.ones(1))
    for value in (0.0, 0.0, 0.0, 0.0):
        moments = kalman.observed(moments, np.array([value]))
    before, moments = moments, replace(moments, last=())
    for value in (1e6, 1e6, 1e6):
        moments = kalman.observed(moments, np.array([value]))
    assert moments.mean_square == before.mean_square
    assert kalman.observed(moments, np.array([1e6])).mean_square < before.mean_square


def test_the_first_guess_is_what_the_moments_say():
    variances = np.array([0.5, 2.0, 8.0])
    share, drive = kalman.noise_and_drive(kalman.first_moments(variances), variances)
    assert share == pytest.approx(kalman.FIRST_SHARE)
    np.testing.assert_allclose(drive, kalman.FIRST_DRIVE * variances)
