"""Annotated frames of a tracked video."""

import numpy as np

from liaam.drawing import LANDMARK, LOST
from liaam.model import AAM
from liaam.plotting.overlays import LARGE_FRAME, enlarged, overlay, write_caption


def annotated(
    image: np.ndarray,
    landmarks: np.ndarray | None,
    model: AAM,
    caption: str,
    covariances: np.ndarray | None = None,
) -> np.ndarray:
    """Draw landmarks and a caption on a frame.

    Parameters
    ----------
    image : (h, w, 3) array
    landmarks : (n, 2) float, optional
        None where the object is lost.
    model : AAM
        Model with mesh and contours.
    caption : str
        Text at the bottom.
    covariances : (n, 2, 2) float, optional
        Covariances of the landmarks, drawn as 95 % confidence ellipses.

    Returns
    -------
    (h', w', 3) uint8
        The frame, enlarged if it is small.
    """
    if landmarks is None:
        picture, _ = enlarged(image, LARGE_FRAME)
        write_caption(picture, caption, LOST)
        return picture
    return overlay(image, landmarks, model, covariances, colour=LANDMARK, caption=caption, large=LARGE_FRAME)
