"""Train an active appearance model from landmarked images."""

from liaam.training.compacting import compact
from liaam.training.lamps import LearntLamps, learn_lamps, load_lamps
from liaam.training.options import TrainingOptions
from liaam.training.textures import sample_appearance
from liaam.training.train import train

__all__ = ["LearntLamps", "TrainingOptions", "compact", "learn_lamps", "load_lamps", "sample_appearance", "train"]
