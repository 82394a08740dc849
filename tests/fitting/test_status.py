"""A fit's status tells a shape unlike any in training from one that has merely not converged."""

from types import SimpleNamespace

import numpy as np
import pytest

from liaam.fitting import FitStatus, Fitter, SolverOptions
from liaam.fitting.loop.levels import LinearImage
from liaam.fitting.loop.objective import Objective
from liaam.fitting.quality import status_of
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


@pytest.mark.parametrize("axis", [0, 1])
def test_dark_pixels_at_the_border_of_the_patch_are_a_reason(model, scenes, axis):
    """The patch covers x and y from 10 to 49; most of the object's pixels lie at its first and last ones."""
    points = np.full((10, 2), 30.0)
    points[:4, axis], points[4:8, axis] = 10.0, 49.0
    stage = SimpleNamespace(
        objective=SimpleNamespace(warp=SimpleNamespace(points=lambda _: points)),
        solution=SimpleNamespace(p=None, usable=np.arange(10) >= 8, flat=False, converged=True, held=False),
        pose=lambda each: each,
        to_patch=lambda each: each - 10.0,
        patch_size=(40, 40),
    )
    history = (SimpleNamespace(landmarks=scenes[0].landmarks),)
    black = LinearImage(np.zeros((60, 60, 3), np.uint8), "srgb")
    assert status_of(black, history, stage, model, model.shape_model) is FitStatus.TOO_DARK
