"""The part of an image that relighting changes, and the lower resolution at which its light is computed."""

from dataclasses import dataclass

import numpy as np

from liaam.model.shape import diagonal_of
from liaam.relighting.painting import REACH

FINEST = 128.0
"""Largest diagonal of an object, in pixels, at which light is computed. In larger objects it is enlarged."""


@dataclass(frozen=True, eq=False)
class Region:
    """A box of an image, and the same at the resolution of light.

    Attributes
    ----------
    box : (rows, columns)
    size, small : (int, int)
        Width and height in pixels of the image and of light.
    shape : (n, 2) float64
        Landmarks, pixels of light.
    """

    box: tuple[slice, slice]
    size: tuple[int, int]
    small: tuple[int, int]
    shape: np.ndarray

    @classmethod
    def of(cls, shape: np.ndarray, box: tuple[slice, slice]) -> "Region":
        """Choose the resolution of light for an object with landmarks (n, 2) in a box of an image."""
        (top, bottom), (left, right) = ((each.start, each.stop) for each in box)
        size, factor = (right - left, bottom - top), min(1.0, FINEST / max(diagonal_of(shape), 1e-6))
        small = (min(size[0], max(1, round(size[0] * factor))), min(size[1], max(1, round(size[1] * factor))))
        scale = np.divide(small, np.maximum(size, 1))
        return cls(box, size, small, (shape - (left, top) + 0.5) * scale - 0.5)

    @property
    def reach(self) -> float:
        """Distance over which a new light fades out around the mesh, pixels of light."""
        return max(1.0, REACH * diagonal_of(self.shape))

    def reduced(self, picture: np.ndarray) -> np.ndarray:
        """Average a picture of the box, (h, w, up to 4), to the resolution of light."""
        import cv2

        return picture if self.size == self.small else cv2.resize(picture, self.small, interpolation=cv2.INTER_AREA)

    def enlarged(self, layers: np.ndarray) -> np.ndarray:
        """Interpolate layers of light, (h, w, up to 4), at the pixels of the box."""
        import cv2

        return layers if self.size == self.small else cv2.resize(layers, self.size, interpolation=cv2.INTER_LINEAR)
