"""What has no known light: highlights that the camera clipped or relighting would clip, and a tone."""

import math
from functools import reduce

import cv2
import numpy as np

from liaam.relighting.extrapolation import Surroundings
from liaam.relighting.painting import Region, averages, mean_of, smoothstep

CLIPPED = math.log(0.95)  # Logarithm of light from which a channel counts as clipped
BRIGHT = math.log(0.6)  # That from which brightened pixels approach white gradually, instead of being clipped
COLOUR_REACH = 2.0  # Radius within which the colour around clipped highlights is averaged, in reaches
TONED = 0.05  # Standard deviation of log-chromaticities of an object in black and white, which has one tone
POWER = 4.0  # Power of light that weighs it: gloss has the lamp's colour, and is nearly as bright where not clipped
FALLBACK = 0.01  # Weight of the object's mean colour, for highlights larger than that


def spared(
    own: np.ndarray, small: np.ndarray, light: np.ndarray, around: Surroundings, region: Region
) -> tuple[np.ndarray, np.ndarray]:
    """Spare highlights, whose light is not known, and the tone of a picture in black and white.

    ``own`` (bh, bw, 3) are the logarithms of the image's light, ``small`` (lh, lw, 3) the same reduced, and ``light``
    (lh, lw, 3) will be removed. Return new ones of the last and the first. Gloss, and what is around highlights that
    are clipped in all channels, is not darkened, and its colour not changed. Where single channels are clipped, they
    continue beyond white in the colour of the object around them: then all channels change alike, without grey patches.
    """
    colours = small - mean_of(small)[..., None]
    if np.var(colours, axis=(0, 1), where=around.inside[..., None]).sum() < TONED**2:
        light = np.repeat(mean_of(light)[..., None], 3, axis=2)
    is_clipped = reduce(cv2.max, cv2.split(own)) >= CLIPPED
    unknown = around.gloss
    if is_clipped.any():
        unknown = np.maximum(_wholly_clipped(own, region), unknown)
    light = light + unknown * (np.minimum(mean_of(light)[..., None], 0.0) - light)
    if not is_clipped.any():
        return light, own
    return light, _beyond_white(
        own, is_clipped, _colour_around(small, colours, is_clipped, around, region), around, region
    )


def _wholly_clipped(own: np.ndarray, region: Region) -> np.ndarray:
    """Return how near pixels are to highlights that are clipped in all channels, (lh, lw, 1) from 0 to 1."""
    every = (reduce(cv2.min, cv2.split(own)) >= CLIPPED).astype(np.float32)
    near = cv2.GaussianBlur(region.reduced(every), (0, 0), region.reach)[..., None]
    return smoothstep(4.0 * near)


def _colour_around(
    small: np.ndarray, colours: np.ndarray, is_clipped: np.ndarray, around: Surroundings, region: Region
) -> np.ndarray:
    """Return the mean colour of the object's bright pixels that are not clipped, around each pixel, (lh, lw, 3)."""
    bright = np.exp(POWER * reduce(cv2.max, cv2.split(small)))[..., None]
    weights = bright * around.belongs * (1.0 - region.reduced(is_clipped.astype(np.float32))[..., None])
    return averages(colours, weights, COLOUR_REACH * region.reach, FALLBACK)


def _beyond_white(
    own: np.ndarray, is_clipped: np.ndarray, colour: np.ndarray, around: Surroundings, region: Region
) -> np.ndarray:
    """Continue clipped channels of logarithms of light (bh, bw, 3) beyond white, in the colour around them."""
    at = np.nonzero(is_clipped)
    colour = region.enlarged(colour)[at]
    seen = own[at]
    over = seen >= CLIPPED
    # Gloss raises the weaker channels more.
    level = np.where(over, np.inf, seen - colour).min(axis=1, keepdims=True)
    level = np.where(over.all(axis=1, keepdims=True), -colour.min(axis=1, keepdims=True), level)
    beyond = np.where(over, np.maximum(colour + level - seen, 0.0), 0.0)
    whole = own.copy()
    whole[at] += region.enlarged(around.belongs).reshape(is_clipped.shape)[at][:, None] * beyond
    return whole


def below_white(log_rgb: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Compress brightened highlights (h, w, 3) below white, keeping their hue; ``own`` is the original light."""
    brightest = reduce(cv2.max, cv2.split(log_rgb))
    at = np.nonzero(brightest > BRIGHT)
    high, first = brightest[at], own[at].max(axis=1)
    limited = BRIGHT * np.exp((high - BRIGHT) / BRIGHT)
    log_rgb[at] += np.minimum(np.maximum(limited, first) - high, 0.0)[:, None]
    return log_rgb
