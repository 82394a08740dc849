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
TONED = 0.08  # Standard deviation of log-chromaticities of an object in black and white, which has one tone
POWER = 4.0  # Power of light that weighs it: gloss has the lamp's colour, and is nearly as bright where not clipped
FALLBACK = 0.01  # Weight of the object's mean colour, for highlights larger than COLOUR_REACH
WHOLLY_CLIPPED = 0.25  # Share of wholly clipped pixels around one from which its light counts as unknown


def spared(
    log_rgb: np.ndarray, small: np.ndarray, light: np.ndarray, around: Surroundings, region: Region
) -> tuple[np.ndarray, np.ndarray]:
    """Spare highlights, whose light is not known, and the tone of a picture in black and white.

    Gloss, and what is around highlights that are clipped in all channels, is not darkened, and its colour not changed.
    Where single channels are clipped, they continue beyond white in the colour of the object around them: then all
    channels change alike, without grey patches.

    Parameters
    ----------
    log_rgb : (bh, bw, 3) float32
        Logarithms of the image's light in the box of the region.
    small : (lh, lw, 3) float32
        The same at the resolution of light.
    light : (lh, lw, 3) float32
        Logarithm of the light that will be removed.
    around : Surroundings
    region : Region

    Returns
    -------
    light, log_rgb
        The light to remove instead, and the logarithms of the image's light from which it is removed.
    """
    colours = small - mean_of(small)[..., None]
    if is_toned(small[around.inside]):
        light = np.repeat(mean_of(light)[..., None], 3, axis=2)
    is_clipped = reduce(cv2.max, cv2.split(log_rgb)) >= CLIPPED
    unknown = around.gloss  # how little of a pixel's light is known, 0 to 1
    if is_clipped.any():
        unknown = np.maximum(_near_wholly_clipped(log_rgb, region), unknown)
    without_darkening = np.minimum(mean_of(light)[..., None], 0.0)
    light = light + unknown * (without_darkening - light)
    if not is_clipped.any():
        return light, log_rgb
    colour = _colour_around(small, colours, is_clipped, around, region)
    return light, _beyond_white(log_rgb, is_clipped, colour, around, region)


def is_toned(log_rgb: np.ndarray) -> bool:
    """Whether an object of logarithms of light (n, 3) is black and white, in one tone."""
    colours = log_rgb - log_rgb.mean(axis=1, keepdims=True)
    return bool(np.var(colours, axis=0).sum() < TONED**2)


def _near_wholly_clipped(log_rgb: np.ndarray, region: Region) -> np.ndarray:
    """Return how near pixels are to highlights that are clipped in all channels, (lh, lw, 1) from 0 to 1."""
    all_clipped = (reduce(cv2.min, cv2.split(log_rgb)) >= CLIPPED).astype(np.float32)
    share = cv2.GaussianBlur(region.reduced(all_clipped), (0, 0), region.reach)[..., None]
    return smoothstep(share / WHOLLY_CLIPPED)


def _colour_around(
    small: np.ndarray, colours: np.ndarray, is_clipped: np.ndarray, around: Surroundings, region: Region
) -> np.ndarray:
    """Return the mean colour of the object's bright pixels that are not clipped, around each pixel, (lh, lw, 3)."""
    brightness = np.exp(POWER * reduce(cv2.max, cv2.split(small)))[..., None]
    share_clipped = region.reduced(is_clipped.astype(np.float32))[..., None]
    weights = brightness * around.belongs * (1.0 - share_clipped)
    return averages(colours, weights, COLOUR_REACH * region.reach, FALLBACK)


def _beyond_white(
    log_rgb: np.ndarray, is_clipped: np.ndarray, colour: np.ndarray, around: Surroundings, region: Region
) -> np.ndarray:
    """Continue clipped channels of logarithms of light (bh, bw, 3) beyond white, in the colour around them."""
    at = np.nonzero(is_clipped)
    pixels = log_rgb[at]  # (k, 3)
    colour = region.enlarged(colour)[at]
    is_over = pixels >= CLIPPED  # by channel
    # Mean logarithm of light, by the channel that is lowest for its colour: gloss raises the weaker channels more. If
    # all channels are clipped, that with which the weakest is white.
    level = np.where(is_over, np.inf, pixels - colour).min(axis=1, keepdims=True)
    level_of_white = -colour.min(axis=1, keepdims=True)
    level = np.where(is_over.all(axis=1, keepdims=True), level_of_white, level)
    beyond = np.where(is_over, np.maximum(colour + level - pixels, 0.0), 0.0)
    belongs = region.enlarged(around.belongs).reshape(is_clipped.shape)[at]
    continued = log_rgb.copy()
    continued[at] += belongs[:, None] * beyond
    return continued


def below_white(log_rgb: np.ndarray, original: np.ndarray) -> np.ndarray:
    """Compress brightened highlights (h, w, 3) below white in place, keeping their hue.

    ``original`` (h, w, 3) is the light before it was brightened, below which no pixel is darkened.
    """
    brightest = reduce(cv2.max, cv2.split(log_rgb))
    at = np.nonzero(brightest > BRIGHT)
    of_pixels = brightest[at]
    of_original = original[at].max(axis=1)
    limited = BRIGHT * np.exp((of_pixels - BRIGHT) / BRIGHT)  # slope 1 at BRIGHT, and towards 0, white
    log_rgb[at] += np.minimum(np.maximum(limited, of_original) - of_pixels, 0.0)[:, None]
    return log_rgb
