"""liaam: light-invariant active appearance models.

Train a deformable model on landmarked colour images taken under one light and fit it to images under any
other. The public names below load on first use, so that ``import liaam`` is quick.
"""

from importlib import import_module
from itertools import chain
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # with "as", so that type checkers take them as public
    from liaam import (
        batch as batch,
        calibration as calibration,
        datasets as datasets,
        errors as errors,
        evaluation as evaluation,
        fitting as fitting,
        io as io,
        model as model,
        morphometry as morphometry,
        photometry as photometry,
        plotting as plotting,
        registration as registration,
        relighting as relighting,
        tracking as tracking,
        training as training,
    )
    from liaam.calibration import theta_from_chart, theta_from_scene
    from liaam.datasets import Dataset, Sample, load_folder
    from liaam.datasets.label_faults import LabelFault, find_label_faults
    from liaam.errors import LiaamError
    from liaam.evaluation import Evaluation, cross_validate, evaluate
    from liaam.fitting import (
        METHODS,
        Detection,
        FitResult,
        FitStatus,
        Fitter,
        Method,
        SolverOptions,
        find,
        fit,
        fit_all,
        fit_many,
    )
    from liaam.io import Landmarks, read_image, read_landmarks, write_image, write_landmarks
    from liaam.model import AAM, load_model
    from liaam.morphometry import Specimen, measure, read_specimens
    from liaam.photometry import CameraModel, invariant_image, load_camera
    from liaam.registration import Registration, register
    from liaam.relighting import relight
    from liaam.tables import to_dataframe
    from liaam.tracking import TrackedFrame, Tracker, TrackingOptions, track_video
    from liaam.training import TrainingOptions, compact, train

__version__ = "0.1.0"

_HOMES = {
    "batch": (),
    "calibration": ("theta_from_chart", "theta_from_scene"),
    "datasets": ("Dataset", "Sample", "load_folder"),
    "datasets.label_faults": ("LabelFault", "find_label_faults"),
    "errors": ("LiaamError",),
    "evaluation": ("Evaluation", "cross_validate", "evaluate"),
    "fitting": (
        *("METHODS", "Detection", "FitResult", "FitStatus", "Fitter", "Method", "SolverOptions"),
        *("find", "fit", "fit_all", "fit_many"),
    ),
    "io": ("Landmarks", "read_image", "read_landmarks", "write_image", "write_landmarks"),
    "model": ("AAM", "load_model"),
    "morphometry": ("Specimen", "measure", "read_specimens"),
    "photometry": ("CameraModel", "invariant_image", "load_camera"),
    "plotting": (),
    "registration": ("Registration", "register"),
    "relighting": ("relight",),
    "tables": ("to_dataframe",),
    "tracking": ("TrackedFrame", "Tracker", "TrackingOptions", "track_video"),
    "training": ("TrainingOptions", "compact", "train"),
}
"""The names of each module that are also names of the package. They and the modules load on first use."""

_SUBMODULES = sorted(_HOMES.keys() - {"datasets.label_faults", "tables"})

_NAMES = sorted(chain.from_iterable(_HOMES.values()))

if not TYPE_CHECKING:
    __all__ = _NAMES


def __getattr__(name: str) -> object:
    if name in _SUBMODULES:
        return import_module(f"liaam.{name}")
    for module, names in _HOMES.items():
        if name in names:
            value = globals()[name] = getattr(import_module(f"liaam.{module}"), name)
            return value
    raise AttributeError(f"module 'liaam' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*filter(lambda name: name.startswith("__"), globals()), *_NAMES, *_SUBMODULES})
