"""Relighting with learnt lamps: their effect is learnt from a few objects and applied to images of others."""

from liaam.lamps.bank import Lamps, load_lamps
from liaam.lamps.copies import Copies
from liaam.lamps.learning import learn_lamps

__all__ = ["Copies", "Lamps", "learn_lamps", "load_lamps"]
