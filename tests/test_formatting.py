"""The text of objects."""

import numpy as np

import liaam
from liaam import TrackedFrame
from liaam.fitting import FitStatus
from liaam.tracking import TrackStatus


def test_the_text_of_an_object_has_shapes_of_arrays():
    points, squares = np.zeros((58, 2)), np.zeros((58, 2, 2))
    frame = TrackedFrame(
        7, 0.25, TrackStatus.FOUND, FitStatus.CONVERGED, 1 / 3, np.nan, points, points, squares, squares, points
    )
    assert repr(frame) == (
        "TrackedFrame(index=7, time=0.25, status='found', fit_status='converged', quality=0.333333, theta=nan, "
        "landmarks=(58, 2) float64, raw=(58, 2) float64, covariances=(58, 2, 2) float64, "
        "raw_covariances=(58, 2, 2) float64, mean=(58, 2) float64)"
    )


def test_options_and_fitters_print_what_differs_from_the_defaults():
    assert repr(liaam.SolverOptions()) == "SolverOptions()"
    assert repr(liaam.TrackingOptions(review=12)) == "TrackingOptions(review=12)"
    model = liaam.load_model("face")
    fitter = liaam.Fitter(model, options=liaam.SolverOptions(damping=0.0), restarts=False)
    assert repr(fitter) == f"Fitter(model={model!r}, options=SolverOptions(damping=0.0), restarts=False)"
