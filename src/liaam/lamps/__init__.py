"""Lamps for training: what a lamp does to an image, learnt from a few objects, and copies of others under it."""

from liaam.lamps.bank import Lamps as Lamps, load_lamps as load_lamps
from liaam.lamps.copies import Copies as Copies
from liaam.lamps.learning import learn_lamps as learn_lamps
