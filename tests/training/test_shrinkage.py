"""How much the prior shrinks shapes is learnt from left-out fits, and taken off as far as their errors allow."""

from dataclasses import replace

import numpy as np
import pytest

from liaam.fitting.quality import expanded_covariance, fitted_covariances
from liaam.model.shape import ShapeModel, similarity_modes
from liaam.training.left_out_fits import RIGHT, LeftOutFit, LeftOutFits
from liaam.training.shrinkage import SHARE, expansion_of, least_shrunk, most_reliable, reliability

N = 8  # landmarks


@pytest.fixture
def shapes(rng) -> ShapeModel:
    """Eight landmarks on a circle, with three orthonormal modes that no similarity can make."""
    turns = 2.0 * np.pi * np.arange(N) / N
    mean = 30.0 * np.column_stack([np.cos(turns), np.sin(turns)])
    similarities = similarity_modes(mean)
    modes = rng.normal(size=(3, 2 * N))
    modes -= modes @ similarities.T @ similarities
    modes = np.linalg.qr(modes.T)[0].T
    return ShapeModel(mean, modes, np.array([9.0, 4.0, 1.0]))


def fits_of(shapes, rng, shrunk=0.7, noise=0.3, count=20, final_prior=1.0, error=0.01, known=None) -> LeftOutFits:
    """Fits of which each mode is a share of the true one, plus noise."""
    fits = []
    for _ in range(count):
        p = np.zeros(7)
        p[:3] = rng.normal(size=3) * np.sqrt(shapes.eigenvalues)
        fitted = p.copy()
        fitted[:3] = shrunk * p[:3] + noise * rng.normal(size=3)
        fit = LeftOutFit(
            near=True,
            error=error,
            evidence=np.array([1.0, 0.5]),
            unit=1.0,
            shapes=shapes,
            contours=(),
            truth=shapes.shape(p),
            known=np.ones(N, bool) if known is None else known,
            p=fitted,
            covariance=np.eye(7),
        )
        fits.append(fit)
    return LeftOutFits(final_prior, fits=fits, n_near=count)


def test_shapes_that_vary_too_little_are_expanded(shapes, rng):
    fits = fits_of(shapes, rng, shrunk=0.7, noise=0.0)
    assert expansion_of(fits, fits) == pytest.approx(1.0 + SHARE * (1.0 / 0.7 - 1.0), rel=0.02)
    expanded = least_shrunk([fits])
    before = np.mean([np.square(fit.errors).sum() for fit in fits.fits])
    assert np.mean([np.square(fit.errors).sum() for fit in expanded.fits]) < 0.1 * before


def test_shapes_that_vary_enough_stay(shapes, rng):
    fits = fits_of(shapes, rng, shrunk=1.1, noise=0.0)
    assert expansion_of(fits, fits) == 1.0


def test_an_expansion_does_not_cost_much_error(shapes, rng):
    """Fits that are mostly noise vary too little as well, and would only become worse."""
    fits = fits_of(shapes, rng, shrunk=0.1, noise=1.2)
    factor = expansion_of(fits, fits)

    def error(each):
        return np.mean([np.linalg.norm(fit.errors, axis=1).mean() for fit in each.fits])

    assert error(fits.expanded(factor)) <= 1.05 * error(fits) + 1e-9
    few = LeftOutFits(fits=fits.fits[:8], n_near=8)
    assert error(few.expanded(expansion_of(few, few))) <= error(few) + 1e-9


def test_the_weaker_prior_is_taken_unless_it_is_less_reliable_or_loses_fits(shapes, rng):
    usual = fits_of(shapes, np.random.default_rng(1), noise=0.3)
    as_good = fits_of(shapes, np.random.default_rng(1), noise=0.3, final_prior=0.3)
    noisy = fits_of(shapes, np.random.default_rng(1), noise=1.5, final_prior=0.3)
    lost = replace(as_good, fits=as_good.fits[:-1])
    assert most_reliable([usual, as_good]).final_prior == 0.3
    assert most_reliable([usual, noisy]).final_prior == 1.0
    assert most_reliable([usual, lost]).final_prior == 1.0
    assert reliability(usual) > reliability(noisy) > 0.0


def test_a_difference_that_is_chance_between_few_images_is_none_between_many(shapes):
    usual = fits_of(shapes, np.random.default_rng(1), noise=0.3)
    other = fits_of(shapes, np.random.default_rng(1), noise=0.32, final_prior=0.3)
    assert 0.991 < reliability(other) / reliability(usual) < 0.997
    assert most_reliable([usual, other]).final_prior == 0.3
    usual_of_many, other_of_many = (replace(each, fits=16 * each.fits, n_near=16 * 20) for each in (usual, other))
    assert most_reliable([usual_of_many, other_of_many]).final_prior == 1.0


@pytest.mark.parametrize("count", [0, 1])
def test_without_right_fits_nothing_is_learnt(shapes, rng, count):
    fits = fits_of(shapes, rng, count=count, error=2.0 * RIGHT)
    best = least_shrunk([fits, fits_of(shapes, rng, count=count, error=2.0 * RIGHT, final_prior=0.3)])
    assert best.expansion == 1.0


def test_landmarks_that_are_not_known_count_neither_way(shapes, rng):
    known = np.arange(N) != 3
    fits = fits_of(shapes, np.random.default_rng(2), known=known)
    wrong = [replace(fit, truth=np.where(known[:, None], fit.truth, 1e3)) for fit in fits.fits]
    assert expansion_of(replace(fits, fits=wrong), fits) == pytest.approx(expansion_of(fits, fits))
    assert np.isnan(wrong[0].errors[3]).all()


def test_the_covariance_of_an_expanded_shape_is_that_of_its_landmarks(shapes, rng):
    root = rng.normal(size=(8, 8))
    spread = root @ root.T
    drawn = rng.multivariate_normal(np.zeros(8), spread, size=20000, method="cholesky")[:, :7]
    landmarks = np.array([shapes.shape(shapes.expanded(p, 1.4)) for p in drawn])
    expected = fitted_covariances(shapes, expanded_covariance(spread, 7, 1.4))
    measured = np.einsum("mna,mnb->nab", landmarks - shapes.mean, landmarks - shapes.mean) / len(drawn)
    np.testing.assert_allclose(measured, expected, rtol=0.1, atol=0.05 * np.abs(expected).max())


def test_expanded_fits_state_the_error_that_they_then_have(shapes, rng):
    fits = fits_of(shapes, rng, shrunk=0.7, noise=0.0, error=0.02)
    expanded = fits.expanded(1.0 / 0.7)
    assert expanded.near_error == pytest.approx(0.0, abs=1e-9)
    assert fits.expanded(1.0) is not fits and fits.expanded(1.0).near_error == pytest.approx(0.02)
