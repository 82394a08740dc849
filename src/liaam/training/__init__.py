"""Train an active appearance model from landmarked images."""

from liaam.training.options import TrainingOptions
from liaam.training.textures import sample_appearance
from liaam.training.train import train

__all__ = ["TrainingOptions", "sample_appearance", "train"]
