"""Crops of the objects of an image."""

import numpy as np

from liaam.trays.order import diagonal

MARGIN = 0.15
"""Margin around the landmarks, of their diagonal: objects end beyond their landmarks."""


def crop_box(points: np.ndarray, size: tuple[int, int], margin: float = MARGIN) -> tuple[int, int, int, int] | None:
    """Return the box around the landmarks of an object, with a margin, inside its image.

    Parameters
    ----------
    points : (n, 2) array
        Landmarks, pixels; those that are not finite are left out.
    size : (int, int)
        Width and height of the image.
    margin : float
        Of the diagonal of the landmarks.

    Returns
    -------
    (left, top, right, bottom) int, or None
        Columns from left to before right, and rows likewise; None if nothing of it is in the image.
    """
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        return None
    around = margin * diagonal(finite)
    low = np.clip(np.floor(finite.min(axis=0) - around), 0, size)
    high = np.clip(np.ceil(finite.max(axis=0) + around) + 1, 0, size)
    if (high - low < 1).any():
        return None
    left, top = low.astype(int).tolist()
    right, bottom = high.astype(int).tolist()
    return left, top, right, bottom
