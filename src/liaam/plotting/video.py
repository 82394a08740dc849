"""Annotated frames of a tracked video."""

from functools import cache

import numpy as np

from liaam.model import AAM
from liaam.plotting.overlays import enlarged, overlay

GOOD = (64, 255, 140)  # Colour of the dot before the caption of a tracked frame
BAD = (255, 96, 80)  # That of a lost one


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
        The frame, enlarged if small, as by :func:`liaam.plotting.overlay`.
    """
    from PIL import Image, ImageDraw

    if landmarks is None:
        picture, _ = enlarged(image)
    else:
        picture = overlay(image, landmarks, model, covariances=covariances)
    # The caption, after a coloured dot, on a dark band at the bottom left.
    size = max(11, round(picture.shape[0] / 32))
    font = _font(size)
    pad = size // 2
    height = min(round(font.getbbox("Ag")[3]) + pad, picture.shape[0])
    width = min(round(font.getlength(caption)) + 2 * pad + size, picture.shape[1])
    corner = picture[picture.shape[0] - height :, :width]
    patch = Image.fromarray((0.4 * corner).astype(np.uint8))
    draw = ImageDraw.Draw(patch)
    middle = height // 2
    radius = max(2, round(0.28 * size))
    draw.ellipse((pad, middle - radius, pad + 2 * radius, middle + radius), fill=BAD if landmarks is None else GOOD)
    draw.text((pad + size, middle), caption, font=font, fill=(255, 255, 255), anchor="lm")
    corner[:] = np.asarray(patch)
    return picture


@cache
def _font(size: int):
    from PIL import ImageFont

    return ImageFont.load_default(size)
