"""A fit's status tells a shape unlike any in training from one that has merely not converged."""

import numpy as np
import pytest

from liaam.fitting import FitStatus, Fitter, SolverOptions
from liaam.fitting.objective import Objective
from liaam.model.shape import align


@pytest.mark.parametrize(("deviations", "status"), [(1.0, FitStatus.MAX_ITERATIONS), (12.0, FitStatus.DIVERGED)])
def test_shape_far_outside_training_has_diverged(model, scenes, deviations, status):
    p = np.zeros(len(model.shape_model.basis))
    p[0] = deviations * np.sqrt(model.shape_model.eigenvalues[0])
    pose = align(model.shape_model.mean, scenes[0].landmarks)
    start = pose(model.shape_model.shape(p))
    result = Fitter(model, "rgb", SolverOptions(max_iterations=0)).fit(scenes[0].image, start)
    assert result.status == status
    np.testing.assert_allclose(result.landmarks, result.start, atol=1e-9)


@pytest.mark.parametrize("unit", [np.nan, np.inf, 1e-320])
def test_a_fit_whose_residuals_are_no_numbers_states_that_it_knows_nothing(model, scenes, monkeypatch, unit):
    monkeypatch.setattr(Objective, "noise_variance", lambda self, solution: unit)
    result = Fitter(model, "grey", SolverOptions(max_iterations=0)).fit(scenes[0].image, scenes[0].landmarks)
    assert np.isfinite(result.covariance).all()
    assert (result.sd > 0).all()
