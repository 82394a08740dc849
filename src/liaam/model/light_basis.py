"""What other lights do to an object, as fields on a square around the mean shape.

Training learns the fields from lamps (:mod:`liaam.training.lamps`), and relighting reads them.
"""

from dataclasses import dataclass

import numpy as np

SIDE = 128  # Side of the square of a LightBasis, pixels
# Half the side of a field's square, in diagonals of the mean shape. The square includes the background that a search
# covers.
HALF = 0.9


@dataclass(frozen=True, eq=False)
class LightBasis:
    """Changes of light, learnt from lamps, on a square around the mean shape (:mod:`liaam.training.lamps`).

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


def in_field(points: np.ndarray) -> np.ndarray:
    """Convert coordinates of the mean shape (..., 2) to pixels of a field, float32."""
    return ((points + HALF) * ((SIDE - 1) / (2 * HALF))).astype(np.float32)


def sample_field(field: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate a field (height, width, ...) float32 at its pixels ``at`` (h, w, 2) float32; constant beyond it."""
    import cv2  # heavy: imported when first needed

    return cv2.remap(field, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
