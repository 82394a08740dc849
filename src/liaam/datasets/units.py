"""Find landmarks that are in other units than pixels."""

import math
from collections.abc import Sequence

import numpy as np

from liaam.datasets.dataset import Sample
from liaam.errors import LiaamError
from liaam.io.images import image_size

CORNER = 1 / 8
"""Share of the width and height of an image, from its top-left corner, in which landmarks in millimetres lie.

They do wherever the object is, if the image has at least 8 pixels for a millimetre. Landmarks in pixels do not: an
object that is photographed for its landmarks is larger, or lies elsewhere, at least in one of several images.
"""

OUTSIDE = -1.0
"""Least coordinate of landmarks in other units, which have no negative ones; that of a pixel is rounding."""

FEWEST = 2
"""Least number of images to judge by: a single one may be of a small object in the corner."""


def units_fault(samples: Sequence[Sample]) -> str:
    """Return a sentence if all landmarks lie in the top-left corner of their images, as those in millimetres do."""
    farthest = 0.0
    n_images = 0
    for sample in samples:
        points = sample.landmarks.points[~sample.landmarks.missing]
        if not len(points):
            continue
        try:
            width, height = _size_of(sample)
        except LiaamError:
            continue
        n_images += 1
        if (points > np.multiply(CORNER, (width, height))).any() or (points < OUTSIDE).any():
            return ""
        farthest = max(farthest, float(points.max()))
    if n_images < FEWEST:
        return ""
    return (
        f"all landmarks lie within the first {max(1, math.ceil(farthest))} pixels of every image, so that they are not "
        "pixels: export them in pixels (in ImageJ: Analyze > Set Scale > Click to Remove Scale, then measure again)"
    )


def _size_of(sample: Sample) -> tuple[int, int]:
    """Return the width and height of a sample's image."""
    if isinstance(sample.image, np.ndarray):
        height, width = sample.image.shape[:2]
        return width, height
    return image_size(sample.image)
