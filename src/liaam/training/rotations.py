"""Whether the objects in training images are about upright, or turned in any direction."""

import numpy as np

from liaam.model.file_format import ALL_ROTATIONS, UPRIGHT
from liaam.model.shape import align

TURNED = 40.0  # Rotation beyond which the search for upright objects misses one, degrees
# Share of the images beyond which objects that are turned so far are no exceptions, such as a scan that is upside down
MANY = 0.05


def rotations_of(shapes: np.ndarray, mean: np.ndarray) -> str:
    """Return which of :data:`liaam.model.file_format.ROTATIONS` the shapes (m, n, 2) of training images have.

    Rotations are those of the mean shape (n, 2), which has the average orientation, onto each shape.
    """
    turns = np.abs(np.rad2deg([align(mean, shape).angle for shape in shapes]))
    return ALL_ROTATIONS if float((turns > TURNED).mean()) > MANY else UPRIGHT
