"""What a solution is worth: its status, its uncertainty, and the evidence that it is right.

:class:`Judge` makes the result of a fit. All that other packages need of this one is listed here.
"""

from liaam.fitting.quality.features import FEATURES, quality_features
from liaam.fitting.quality.judge import SLOW, Calibration, Judge
from liaam.fitting.quality.presence import Surroundings
from liaam.fitting.quality.status import status_of
from liaam.fitting.quality.uncertainty import (
    covariance,
    expanded_covariance,
    fitted_covariances,
    landmark_covariances,
)

__all__ = [
    "FEATURES",
    "SLOW",
    "Calibration",
    "Judge",
    "Surroundings",
    "covariance",
    "expanded_covariance",
    "fitted_covariances",
    "landmark_covariances",
    "quality_features",
    "status_of",
]
