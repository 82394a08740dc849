"""Principal components."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from liaam.errors import TrainingError
from liaam.pca import check_variance, principal_components


def test_components_are_those_of_the_covariance(rng):
    vectors = rng.normal(size=(40, 6)) * [5, 4, 3, 2, 1, 0.5] + 7
    found = principal_components(vectors, 1.0)
    values, directions = np.linalg.eigh(np.cov(vectors.T))
    np.testing.assert_allclose(found.eigenvalues, values[::-1], rtol=1e-9)
    np.testing.assert_allclose(np.abs(found.modes @ directions[:, ::-1]), np.eye(6), atol=1e-7)
    np.testing.assert_allclose(found.mean, vectors.mean(axis=0))
    assert found.total_variance == pytest.approx(values.sum())


@given(n=st.integers(1, 12), d=st.integers(1, 30), seed=st.integers(0, 99))
def test_modes_are_orthonormal_and_rebuild_the_data(n, d, seed):
    vectors = np.random.default_rng(seed).normal(size=(n, d))
    found = principal_components(vectors, 1.0)
    assert len(found.modes) <= min(n - 1, d)
    np.testing.assert_allclose(found.modes @ found.modes.T, np.eye(len(found.modes)), atol=1e-9)
    deviations = vectors - found.mean
    np.testing.assert_allclose(deviations @ found.modes.T @ found.modes, deviations, atol=1e-4)


def test_the_sign_of_a_mode_is_fixed(rng):
    vectors = rng.normal(size=(9, 5))
    a, b = principal_components(vectors, 1.0), principal_components(vectors[::-1], 1.0)
    np.testing.assert_allclose(a.modes, b.modes, atol=1e-8)
    assert (np.take_along_axis(a.modes, np.abs(a.modes).argmax(1)[:, None], 1) > 0).all()


@pytest.fixture
def spread(rng) -> np.ndarray:
    """Exactly 60, 30, 9 and 1 % of the variance along four axes."""
    basis = rng.normal(size=(50, 4))
    basis = np.linalg.qr(basis - basis.mean(axis=0))[0]
    return basis * np.sqrt([60, 30, 9, 1])


@pytest.mark.parametrize(
    ("variance", "count"),
    [(0.5, 1), (0.6, 1), (0.61, 2), (0.9, 2), (0.98, 3), (0.995, 4), (1.0, 4), (0, 0), (2, 2), (99, 4)],
)
def test_as_many_modes_as_the_variance_needs(spread, variance, count):
    assert len(principal_components(spread, variance).modes) == count


def test_equal_vectors_have_no_modes():
    found = principal_components(np.ones((5, 7)), 0.98)
    assert found.modes.shape == (0, 7)
    assert found.total_variance == 0


@pytest.mark.parametrize("variance", [0.0, 1.5, -0.1, -1, np.nan, np.inf, True, "0.9", None])
def test_a_share_of_variance_that_makes_no_sense_is_refused(variance):
    with pytest.raises(TrainingError, match=r"give a fraction in \(0, 1\]"):
        check_variance(variance)
