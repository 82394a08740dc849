"""Light: what lamps do to pictures of a class of objects, learnt from a few objects and laid on others."""

from liaam.lamps.bank import Lamps, load_lamps
from liaam.lamps.copies import Copies
from liaam.lamps.learning import learn_lamps

__all__ = ["Copies", "Lamps", "learn_lamps", "load_lamps"]
