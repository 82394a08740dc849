"""liaam: light-invariant active appearance models.

Train a deformable model on landmarked colour images taken under one light and fit it to images under any
other. The public names below load on first use, so that ``import liaam`` is quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from liaam.datasets import Dataset, Sample, load_folder
    from liaam.errors import LiaamError
    from liaam.fitting import (
        METHODS,
        Candidate,
        FitResult,
        FitStatus,
        Fitter,
        Method,
        SolverOptions,
        find,
        fit,
        fit_many,
    )
    from liaam.io import Landmarks, read_image, read_landmarks, write_image, write_landmarks
    from liaam.label_faults import LabelFault, find_label_faults
    from liaam.model import AAM, load_model
    from liaam.photometry import CameraModel, invariant_image, load_camera, theta_from_chart, theta_from_scene
    from liaam.registration import Registration, register
    from liaam.tracking import TrackedFrame, Tracker, TrackingOptions, track_video
    from liaam.training import train

__version__ = "0.1.0"

__all__ = [
    "AAM",
    "METHODS",
    "CameraModel",
    "Candidate",
    "Dataset",
    "FitResult",
    "FitStatus",
    "Fitter",
    "LabelFault",
    "Landmarks",
    "LiaamError",
    "Method",
    "Registration",
    "Sample",
    "SolverOptions",
    "TrackedFrame",
    "Tracker",
    "TrackingOptions",
    "find",
    "find_label_faults",
    "fit",
    "fit_many",
    "invariant_image",
    "load_camera",
    "load_folder",
    "load_model",
    "read_image",
    "read_landmarks",
    "register",
    "theta_from_chart",
    "theta_from_scene",
    "track_video",
    "train",
    "write_image",
    "write_landmarks",
]

_HOMES = {
    "datasets": ("Dataset", "Sample", "load_folder"),
    "errors": ("LiaamError",),
    "fitting": (
        "METHODS",
        "Candidate",
        "FitResult",
        "FitStatus",
        "Fitter",
        "Method",
        "SolverOptions",
        "find",
        "fit",
        "fit_many",
    ),
    "io": ("Landmarks", "read_image", "read_landmarks", "write_image", "write_landmarks"),
    "label_faults": ("LabelFault", "find_label_faults"),
    "model": ("AAM", "load_model"),
    "photometry": ("CameraModel", "invariant_image", "load_camera", "theta_from_chart", "theta_from_scene"),
    "registration": ("Registration", "register"),
    "tracking": ("TrackedFrame", "Tracker", "TrackingOptions", "track_video"),
    "training": ("train",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'liaam' has no attribute {name!r}")
    value = getattr(import_module(f"liaam.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
