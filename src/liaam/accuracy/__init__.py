"""How accurate a model's fits are: errors on landmarked images that were not used for training."""

from liaam.accuracy.measure import cross_validate, evaluate
from liaam.accuracy.result import Evaluation

__all__ = ["Evaluation", "cross_validate", "evaluate"]
