"""Relighting with learnt lamps: their effect is learnt from a few objects and applied to images of others."""

from liaam.lamps.bank import Lamps as Lamps, load_lamps as load_lamps
from liaam.lamps.copies import Copies as Copies
from liaam.lamps.learning import learn_lamps as learn_lamps
