"""Highlights: those that the camera clipped, and those that relighting would clip."""

import math

import numpy as np

from liaam.relighting.extrapolation import smoothstep
from liaam.relighting.painting import mean_of
from liaam.relighting.region import Region

CLIPPED = math.log(0.95)
"""Logarithm of light from which a channel counts as clipped."""

COLOUR_REACH, BRIGHTER = 2.0, 4.0
"""Half the side of the square within which the colour around clipped highlights is averaged, in reaches, and the power
of light that weighs it: gloss has the colour of the lamp, and is nearly as bright where it is not clipped."""

FALLBACK = 0.01
"""Weight of the mean colour of the object, for highlights larger than that square."""

BRIGHT = math.log(0.6)
"""Logarithm of light from which brightened pixels approach white gradually instead of being clipped."""


def spared(own: np.ndarray, light: np.ndarray, belongs: np.ndarray, region: Region) -> tuple[np.ndarray, np.ndarray]:
    """Spare clipped highlights, whose light is not known.

    Parameters
    ----------
    own : (bh, bw, 3) float32
        Logarithms of the image's light.
    light : (lh, lw, 3) float32
        Light that will be removed.
    belongs : (lh, lw, 1) float32
        How much a pixel belongs to the object.
    region : Region

    Returns
    -------
    light : (lh, lw, 3) float32
        Around highlights that are clipped in all channels, the object is not darkened, and its colour not changed.
    whole : (bh, bw, 3) float32
        Logarithms of the image's light where clipped channels are continued beyond white in the colour of the object
        around them. A change of light then moves all channels alike, and leaves no grey patch.
    """
    import cv2

    brightest = np.maximum.reduce(cv2.split(own))
    if not (brightest >= CLIPPED).any():
        return light, own
    some = (brightest >= CLIPPED).astype(np.float32)
    every = (np.minimum.reduce(cv2.split(own)) >= CLIPPED).astype(np.float32)
    gone = cv2.GaussianBlur(region.reduced(every), (0, 0), region.reach)[..., None]
    light = light + smoothstep(4.0 * gone) * (np.minimum(mean_of(light)[..., None], 0.0) - light)
    small = region.reduced(own)
    bright = np.exp(BRIGHTER * np.maximum.reduce(cv2.split(small)))[..., None]
    known = bright * belongs * (1.0 - region.reduced(some)[..., None])
    colour = small - mean_of(small)[..., None]
    width = 2 * round(COLOUR_REACH * region.reach) + 1
    sums = np.dstack([colour * known, known])
    everywhere = sums.mean(axis=(0, 1), dtype=np.float32)
    sums = cv2.blur(cv2.blur(sums, (width, width)), (width, width)) + FALLBACK * everywhere
    colour = region.enlarged(sums[..., :3] / np.maximum(sums[..., 3:], 1e-9))
    whole, at = own.copy(), np.nonzero(some)
    colour, seen = colour[at], own[at]
    over = seen >= CLIPPED
    # Gloss raises the weaker channels more.
    level = np.where(over, np.inf, seen - colour).min(axis=1, keepdims=True)
    level = np.where(over.all(axis=1, keepdims=True), -colour.min(axis=1, keepdims=True), level)
    beyond = np.where(over, np.maximum(colour + level - seen, 0.0), 0.0)
    whole[at] += region.enlarged(belongs).reshape(some.shape)[at][:, None] * beyond
    return light, whole


def below_white(log_rgb: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Compress brightened highlights (h, w, 3) below white, keeping their hue; ``own`` is the original light."""
    import cv2

    brightest = np.maximum.reduce(cv2.split(log_rgb))
    at = np.nonzero(brightest > BRIGHT)
    high, first = brightest[at], own[at].max(axis=1)
    limited = BRIGHT * np.exp((high - BRIGHT) / BRIGHT)
    log_rgb[at] += np.minimum(np.maximum(limited, first) - high, 0.0)[:, None]
    return log_rgb
