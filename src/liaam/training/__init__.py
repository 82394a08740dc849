"""Train an active appearance model from landmarked images."""

from liaam.training.kept import compact
from liaam.training.options import TrainingOptions
from liaam.training.textures import sample_appearance
from liaam.training.train import train

__all__ = ["TrainingOptions", "compact", "sample_appearance", "train"]
