"""The Cramer-Rao bound: how it depends on what is measured, and that an efficient estimator meets it."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.cramer_rao import cramer_rao_bound
from experiments.simulated import make_case
from experiments.solvers import PAPER
from experiments.subjects import PAPER_THETA, Subject, get_subject
from liaam.error_measures import rms_error
from liaam.errors import MethodError
from liaam.fitting import Fitter, Method, SolverOptions, get_method
from liaam.model import AAM
from liaam.photometry import CameraModel
from liaam.training import TrainingOptions, train

SIGMA = 1 / 255

PLAIN_LOG = Method("log", "log-RGB", "log", "log", "rgb")
MEASURED_LESS = (
    PLAIN_LOG,
    replace(PLAIN_LOG, metric="chromaticity"),
    replace(PLAIN_LOG, metric="invariant"),
    get_method("li"),
    get_method("li-pc"),
)
"""Each a projection of the one before it, or the same with one angle more to be found."""


@pytest.fixture(scope="module")
def subject() -> Subject:
    return get_subject(None)


@pytest.fixture(scope="module")
def sharp(subject) -> AAM:
    """A model that rebuilds its training pictures, without blur: a pixel's noise is its own."""
    options = TrainingOptions(variance=1.0, prior="sample", blurs=(0.0,), leave_out=False)
    return train(subject.pairs, options, camera=CameraModel(theta=PAPER_THETA), methods="all")


@pytest.fixture
def picture(subject) -> tuple[np.ndarray, np.ndarray]:
    return subject.pairs[0]


@pytest.fixture
def shadowed(subject) -> tuple[np.ndarray, np.ndarray]:
    case = make_case(subject, 0, 0, gamma=0.0, sigma_n=0.0)
    return case.image, case.truth


@pytest.mark.parametrize("method", ["grey", "rgb", "li", "li-pc"])
def test_it_grows_in_proportion_to_the_noise(sharp, shadowed, method):
    one, seven = (cramer_rao_bound(sharp, *shadowed, method, sigma * SIGMA) for sigma in (1, 7))
    assert seven.rms == pytest.approx(7 * one.rms, rel=1e-6)
    assert seven.mean_distance == pytest.approx(7 * one.mean_distance, rel=1e-6)
    np.testing.assert_allclose(seven.landmarks, 49 * one.landmarks, rtol=1e-6)
    assert seven.theta == pytest.approx(7 * one.theta, rel=1e-6, nan_ok=True)


@pytest.mark.parametrize("lit", ["picture", "shadowed"])
def test_measuring_less_of_a_pixel_can_only_lose(sharp, lit, request):
    image, truth = request.getfixturevalue(lit)
    for chain in (("grey-plain", "grey"), ("rgb", "grey"), MEASURED_LESS):
        bounds = [cramer_rao_bound(sharp, image, truth, method, SIGMA).rms for method in chain]
        assert (np.diff(bounds) > -1e-3 * np.array(bounds[:-1])).all()  # float32 information
    full, chroma, invariant, *_ = bounds
    assert chroma > 2 * full
    assert invariant > 1.1 * chroma


def test_weights_and_losses_do_not_move_it_and_lit_is_li(sharp, shadowed):
    li = cramer_rao_bound(sharp, *shadowed, "li", SIGMA)
    for method in ("li+noise", "li+noise+huber", "li-lit"):
        assert cramer_rao_bound(sharp, *shadowed, method, SIGMA).rms == pytest.approx(li.rms, rel=1e-4)


@pytest.mark.parametrize("method", ["rgb", "li"])
def test_hidden_pixels_cost(sharp, picture, method):
    image, truth = picture
    before = cramer_rao_bound(sharp, image, truth, method, SIGMA)
    hidden = image.copy()
    middle = truth.mean(axis=0).astype(int)
    hidden[middle[1] :] = np.nan
    after = cramer_rao_bound(sharp, hidden, truth, method, SIGMA)
    assert after.rms > 1.3 * before.rms
    wholly = cramer_rao_bound(sharp, np.full_like(image, np.nan), truth, method, SIGMA)
    assert not np.isfinite(wholly.rms) or wholly.rms > 100 * before.rms


def test_darkness_costs_logarithms(sharp, picture):
    image, truth = picture
    logs, values = (
        [cramer_rao_bound(sharp, share * image, truth, method, SIGMA).rms for share in (1.0, 0.8, 0.6)]
        for method in ("li", "grey")
    )
    assert (np.diff(logs) > 0.1 * logs[0]).all()
    # A gain hardly matters where gain is unknown anyway: contrast falls with it, and noise does not.
    np.testing.assert_allclose(values, values[0] / np.array([1.0, 0.8, 0.6]), rtol=0.02)


@pytest.mark.parametrize("method", ["rgb", "li", "li-pc"])
def test_covariances_of_landmarks_are_covariances(sharp, shadowed, method):
    bound = cramer_rao_bound(sharp, *shadowed, method, SIGMA)
    assert bound.landmarks.shape == (sharp.n_points, 2, 2)
    np.testing.assert_allclose(bound.landmarks, bound.landmarks.transpose(0, 2, 1), rtol=1e-9)
    assert np.linalg.eigvalsh(bound.landmarks).min() > 0
    assert np.trace(bound.landmarks, axis1=1, axis2=2).mean() == pytest.approx(bound.rms**2)


def test_the_mean_distance_is_that_of_gaussian_errors(sharp, shadowed, rng):
    bound = cramer_rao_bound(sharp, *shadowed, "li", SIGMA)
    roots = np.linalg.cholesky(bound.landmarks)
    errors = np.einsum("nab,tnb->tna", roots, rng.normal(size=(2000, sharp.n_points, 2)))
    assert bound.mean_distance == pytest.approx(np.linalg.norm(errors, axis=2).mean(), rel=0.01)


@pytest.mark.parametrize("method", ["grey", "rgb", "chroma"])
def test_methods_without_an_angle_have_no_bound_of_it(sharp, picture, method):
    assert np.isnan(cramer_rao_bound(sharp, *picture, method, SIGMA).theta)


@pytest.mark.parametrize("method", ["li-pc", "li-pcs"])
def test_angles_that_turn_together_show_in_a_change_of_light_only(sharp, picture, shadowed, method):
    same, changed = (cramer_rao_bound(sharp, *pair, method, SIGMA) for pair in (picture, shadowed))
    one_angle = cramer_rao_bound(sharp, *picture, "li", SIGMA)
    assert same.theta == np.inf
    assert np.isfinite(same.landmarks).all()
    assert same.rms == pytest.approx(one_angle.rms, rel=1e-3)
    assert 0 < np.rad2deg(changed.theta) < 1
    assert 0 < np.rad2deg(one_angle.theta) < 1


def test_orientations_of_gradients_are_refused(sharp, picture):
    with pytest.raises(MethodError, match="igo"):
        cramer_rao_bound(sharp, *picture, "igo", SIGMA)


# The bound against what fits reach

N_DRAWS = 48

GAUSS_NEWTON = SolverOptions(damping=0.0, shape_prior=0.0, tolerance=1e-3)


@pytest.mark.parametrize(("method", "sigma_n"), [("grey", 0.5), ("rgb", 2.0)])
def test_least_squares_under_white_noise_reaches_it(subject, sharp, method, sigma_n, rng):
    fitter = Fitter(sharp, method, GAUSS_NEWTON)
    errors = []
    for draw in range(N_DRAWS):
        image, truth = subject.pairs[draw % len(subject.pairs)]
        noisy = image + rng.normal(0, sigma_n / 255, image.shape).astype(np.float32)
        errors.append(rms_error(fitter.fit(noisy, truth).landmarks, truth))
    bounds = [cramer_rao_bound(sharp, *pair, method, sigma_n / 255).rms for pair in subject.pairs]
    assert root_mean_square(errors) == pytest.approx(root_mean_square(bounds), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [0.0, 4.0])
@pytest.mark.parametrize("sigma_n", [5.0, 10.0])
def test_noise_weights_bring_li_near_it_under_a_shadow(subject, sharp, gamma, sigma_n):
    model = PAPER.train(subject.pairs, camera=CameraModel(theta=PAPER_THETA))
    fitter = Fitter(model, "li+noise", PAPER.options)
    errors, bounds = [], []
    for trial in range(12):
        case = make_case(subject, 0, trial, gamma, sigma_n)
        clean = make_case(subject, 0, trial, gamma=0.0, sigma_n=0.0)
        errors.append(rms_error(fitter.fit(case.image, case.start).landmarks, case.truth))
        bounds.append(cramer_rao_bound(sharp, clean.image, case.truth, "li", sigma_n / 255).rms)
    efficiency = root_mean_square(bounds) / root_mean_square(errors)
    assert 0.7 < efficiency < 1.2


def root_mean_square(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
