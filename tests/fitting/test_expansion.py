"""Fits with a weaker prior at the finest level, and shapes at more than their distance from the mean."""

from dataclasses import replace

import numpy as np
import pytest

from liaam import load_model
from liaam.errors import MethodError
from liaam.fitting import Fitter, SolverOptions
from liaam.fitting.solution import residual_at
from liaam.model import SURROUNDINGS
from setups import disturb


def expanded_model(model, factor):
    """Model whose fits are expanded."""
    known = replace(model.views[SURROUNDINGS].reliabilities["soft-li"], expansion=factor)
    return replace(model.with_view(SURROUNDINGS, reliabilities={"soft-li": known}), refiner=None)


def test_the_landmarks_are_expanded_and_the_registration_is_not(calibrated, lit_scene):
    start = disturb(lit_scene.landmarks)
    plain = Fitter(expanded_model(calibrated, 1.0)).fit(lit_scene.image, start)
    result = Fitter(expanded_model(calibrated, 1.5)).fit(lit_scene.image, start)
    shapes = calibrated.views[SURROUNDINGS].shape_model
    assert result.expansion == result.to_dict()["expansion"] == 1.5
    np.testing.assert_allclose(result.registered, plain.landmarks, atol=1e-9)
    np.testing.assert_array_equal(plain.registered, plain.landmarks)
    np.testing.assert_allclose(result.p[:-4], 1.5 * plain.p[:-4])
    np.testing.assert_allclose(result.landmarks, result.pose(shapes.shape(result.p)), atol=1e-9)
    # Deviations from the mean in the same pose grow by the factor, and so do the standard deviations of the modes.
    middle = result.pose(shapes.shape(np.r_[np.zeros(len(result.p) - 4), result.p[-4:]]))
    np.testing.assert_allclose(result.landmarks - middle, 1.5 * (plain.landmarks - middle), atol=1e-9)
    np.testing.assert_allclose(np.diag(result.covariance)[:-5], 1.5**2 * np.diag(plain.covariance)[:-5])
    assert (result.sd > plain.sd).all()


def test_pixels_are_compared_where_they_match(calibrated, lit_scene):
    start = disturb(lit_scene.landmarks)
    fitter = Fitter(expanded_model(calibrated, 1.0))
    plain = residual_at(fitter, lit_scene.image, fitter.fit(lit_scene.image, start))[0]
    fitter = Fitter(expanded_model(calibrated, 1.5))
    np.testing.assert_allclose(
        residual_at(fitter, lit_scene.image, fitter.fit(lit_scene.image, start))[0], plain, atol=1e-5
    )


def test_a_weaker_prior_is_that_of_the_finest_level_alone(calibrated):
    weak = Fitter(calibrated, options=SolverOptions(final_prior=0.25)).objectives
    strong = Fitter(calibrated, options=SolverOptions(final_prior=1.0)).objectives
    for each, other in zip(weak[:-1], strong[:-1], strict=True):
        np.testing.assert_array_equal(each.fields["prior"], other.fields["prior"])
    np.testing.assert_allclose(weak[-1].fields["prior"], 0.25 * strong[-1].fields["prior"])


def test_a_model_fits_with_the_prior_that_it_has_learnt(calibrated):
    known = replace(calibrated.views[SURROUNDINGS].reliabilities["soft-li"], final_prior=0.4)
    model = calibrated.with_view(SURROUNDINGS, reliabilities={"soft-li": known})
    assert Fitter(model).objectives[-1].prior_weight == 0.4
    assert Fitter(model, options=SolverOptions(final_prior=1.0)).objectives[-1].prior_weight == 1.0
    assert Fitter(model, "grey").objectives[-1].prior_weight == 1.0  # which is not calibrated


@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf, "1"])
def test_a_weight_is_a_finite_number(value):
    with pytest.raises(MethodError, match="final_prior"):
        SolverOptions(final_prior=value)


def test_what_is_learnt_is_in_the_file(calibrated, tmp_path):
    known = replace(calibrated.views[SURROUNDINGS].reliabilities["soft-li"], final_prior=0.3, expansion=1.25)
    calibrated.with_view(SURROUNDINGS, reliabilities={"soft-li": known}).save(tmp_path / "a.liaam")
    loaded = load_model(tmp_path / "a.liaam").views[SURROUNDINGS].reliabilities["soft-li"]
    assert (loaded.final_prior, loaded.expansion) == (0.3, 1.25)
