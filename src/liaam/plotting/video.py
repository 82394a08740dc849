"""Annotated frames of a tracked video."""

from functools import cache

import numpy as np

from liaam.model import AAM
from liaam.plotting.overlays import enlarged, overlay

GOOD, BAD = (64, 255, 140), (255, 96, 80)
"""Colours of the dot before the caption, for tracked and lost frames."""


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
    if landmarks is None:
        picture, _ = enlarged(image)
    else:
        picture = overlay(image, landmarks, model, covariances=covariances)
    return captioned(picture, caption, BAD if landmarks is None else GOOD)


def captioned(picture: np.ndarray, text: str, colour: tuple[int, int, int]) -> np.ndarray:
    """Write a line of text, after a coloured dot, on a dark band at the bottom left. Modifies `picture`."""
    from PIL import Image, ImageDraw

    size = max(11, round(picture.shape[0] / 32))
    font, pad = _font(size), size // 2
    width_of_text, height_of_text = round(font.getlength(text)), round(font.getbbox("Ag")[3])
    height = min(height_of_text + pad, picture.shape[0])
    width = min(width_of_text + 2 * pad + size, picture.shape[1])
    corner = picture[picture.shape[0] - height :, :width]
    patch = Image.fromarray((0.4 * corner).astype(np.uint8))
    draw = ImageDraw.Draw(patch)
    middle, radius = height // 2, max(2, round(0.28 * size))
    draw.ellipse((pad, middle - radius, pad + 2 * radius, middle + radius), fill=colour)
    draw.text((pad + size, middle), text, font=font, fill=(255, 255, 255), anchor="lm")
    corner[:] = np.asarray(patch)
    return picture


@cache
def _font(size: int):
    from PIL import ImageFont

    return ImageFont.load_default(size)
