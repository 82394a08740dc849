"""How accurate a model's fits are: errors on landmarked images that were not used for training."""

from liaam.accuracy.measure import cross_validate as cross_validate, evaluate as evaluate
from liaam.accuracy.result import Evaluation as Evaluation
