"""Lamps for training: what a lamp does to an image, learnt from a few objects, and copies of others under it."""

from liaam.training.lamps.bank import LearntLamps, load_lamps
from liaam.training.lamps.copies import Copies
from liaam.training.lamps.learning import learn_lamps

__all__ = ["Copies", "LearntLamps", "learn_lamps", "load_lamps"]
