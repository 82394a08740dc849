"""Principal components."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam.errors import TrainingError
from liaam.model.pca import (
    check_variance,
    count_by_evidence,
    leave_out,
    left_out_variances,
    log_evidence,
    principal_components,
    some_folds,
)


def test_components_are_those_of_the_covariance(rng):
    vectors = rng.normal(size=(40, 6)) * [5, 4, 3, 2, 1, 0.5] + 7
    found = principal_components(vectors, 1.0)
    values, directions = np.linalg.eigh(np.cov(vectors.T))
    np.testing.assert_allclose(found.eigenvalues, values[::-1], rtol=1e-9)
    np.testing.assert_allclose(np.abs(found.modes @ directions[:, ::-1]), np.eye(6), atol=1e-7)
    np.testing.assert_allclose(found.mean, vectors.mean(axis=0))


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


@pytest.mark.parametrize("variance", [0.0, 1.5, -0.1, -1, np.nan, np.inf, True, "0.9", "Auto", None])
def test_a_share_of_variance_that_makes_no_sense_is_refused(variance):
    with pytest.raises(TrainingError, match=r"give a fraction in \(0, 1\]"):
        check_variance(variance)


def drawn(rng, n: int, d: int, deviations, noise: float) -> np.ndarray:
    """Vectors of a few strong directions, and noise in all."""
    directions = np.linalg.qr(rng.normal(size=(d, len(deviations))))[0].T
    return rng.normal(size=(n, len(deviations))) * deviations @ directions + noise * rng.normal(size=(n, d)) + 3.0


@pytest.mark.parametrize("true", [1, 3, 6])
@pytest.mark.parametrize("d", [20, 400])
def test_the_evidence_finds_how_many_modes_there_are(rng, true, d):
    vectors = drawn(rng, 60, d, np.linspace(12, 8, true), 0.5)
    assert count_by_evidence(vectors, some_folds(60)) == true


def test_noise_alone_has_no_modes(rng):
    assert count_by_evidence(rng.normal(size=(40, 30)), some_folds(40)) == 0


def test_pictures_of_one_object_do_not_vouch_for_each_other(rng):
    """Ten objects seen five times: as many modes as objects, if each picture is left out alone."""
    objects = np.repeat(rng.normal(size=(10, 50)), 5, axis=0) + 0.05 * rng.normal(size=(50, 50))
    by_object, alone = np.split(np.arange(50), 10), np.split(np.arange(50), 50)
    assert count_by_evidence(objects, by_object) == 0
    assert count_by_evidence(objects, alone) == 9


@pytest.mark.parametrize("d", [4, 30])
def test_the_evidence_is_the_density_of_vectors_left_out(rng, d):
    from scipy.stats import multivariate_normal

    vectors, fold = rng.normal(size=(9, d)) * np.linspace(3, 1, d), np.array([1, 5])
    (left_out,) = leave_out(vectors, [fold])
    others = np.delete(vectors, fold, axis=0)
    found = principal_components(others, 1.0)
    for count, value in enumerate(log_evidence(left_out, d)):
        noise = found.eigenvalues[count:].sum() / (d - count)
        strong = found.modes[:count].T * (found.eigenvalues[:count] - noise) @ found.modes[:count]
        density = multivariate_normal(found.mean, strong + noise * np.eye(d))
        assert value == pytest.approx(density.logpdf(vectors[fold]).sum(), rel=1e-6)


def test_variances_of_vectors_left_out_are_nearer_the_truth_than_the_eigenvalues(rng):
    """On draws of one covariance: errors of logarithms, against the variance that there is along each mode."""
    truth = np.geomspace(100, 1, 30)
    errors = []
    for _ in range(20):
        vectors = rng.normal(size=(25, 30)) * np.sqrt(truth)
        found = principal_components(vectors, 1.0)
        along = np.square(found.modes) @ truth
        shrunk = left_out_variances(vectors, some_folds(25), len(along))
        assert (np.diff(shrunk) <= 1e-12).all()
        errors.append([np.abs(np.log(each / along)).mean() for each in (found.eigenvalues, shrunk)])
    sample, shrunk = np.mean(errors, axis=0)
    assert shrunk < 0.5 * sample


def test_of_equal_vectors_there_is_no_evidence():
    assert count_by_evidence(np.ones((5, 7)), some_folds(5)) == 0
    np.testing.assert_array_equal(left_out_variances(np.ones((5, 7)), some_folds(5), 2), 0)
