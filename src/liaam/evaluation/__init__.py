"""How accurate a model's fits are: errors on landmarked images that were not used for training."""

from liaam.error_measures import (
    angle_difference,
    cumulative_errors,
    error_statistics,
    inter_ocular_distance,
    landmark_errors,
    nme,
    point_error,
    rms_error,
    within_ellipses,
)
from liaam.evaluation.agreement import ShapeAgreement, compare_shapes
from liaam.evaluation.measure import cross_validate, evaluate
from liaam.evaluation.result import Evaluation

__all__ = [
    "Evaluation",
    "ShapeAgreement",
    "angle_difference",
    "compare_shapes",
    "cross_validate",
    "cumulative_errors",
    "error_statistics",
    "evaluate",
    "inter_ocular_distance",
    "landmark_errors",
    "nme",
    "point_error",
    "rms_error",
    "within_ellipses",
]
