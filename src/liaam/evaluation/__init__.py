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
from liaam.evaluation.learning_curve import LearningCurve, learning_curve
from liaam.evaluation.measure import cross_validate, evaluate
from liaam.evaluation.observers import compare_specimens
from liaam.evaluation.result import Evaluation

__all__ = [
    "Evaluation",
    "LearningCurve",
    "ShapeAgreement",
    "angle_difference",
    "compare_shapes",
    "compare_specimens",
    "cross_validate",
    "cumulative_errors",
    "error_statistics",
    "evaluate",
    "inter_ocular_distance",
    "landmark_errors",
    "learning_curve",
    "nme",
    "point_error",
    "rms_error",
    "within_ellipses",
]
