"""What light does to an object and its surroundings, as a low-rank basis."""

from dataclasses import dataclass

import numpy as np

SIDE = 128
"""Side of the square, pixels."""


@dataclass(frozen=True, eq=False)
class LightBasis:
    """Changes of light, learnt from lamps, on a square around the mean shape (:mod:`liaam.lamps`).

    The log ratio of an image to the same under the training light is a sum of modes with coordinates from N(0, 1), and
    of a remainder.

    Attributes
    ----------
    mean : (n, 2) float64
        Mean shape. The centre of its bounding box is the origin, and the diagonal 1.
    modes : (k, side, side, 3) float32
        Each is one standard deviation of log light.
    remainder : (side, side) float16
        Standard deviation of the remainder's brightness, on objects (or lamps, of a single object) that were left out
        when the modes were learnt.
    """

    mean: np.ndarray
    modes: np.ndarray
    remainder: np.ndarray
