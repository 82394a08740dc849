"""Blending of an appearance into each frame of a video: compiled, since it is done 25 times per second."""

from functools import lru_cache

import cv2
import numba
import numpy as np

from liaam.photometry import Response, from_linear
from liaam.relighting.painting import as_eight_bit, box_around, log_light

_njit = numba.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")

FARTHEST = 2.5
"""Distance beyond the weights to which shading is removed, in reaches."""

BLUR_OWN = 1.0
"""As :data:`liaam.relighting.extrapolation.BLUR_OWN`."""

LEAST_SHARE = 1e-3
"""Weight of a change of light below which it is set to 0."""

ANOTHER_LIGHT, ANOTHER_COLOUR = 0.6, 0.25
"""As in :mod:`liaam.relighting.extrapolation`: differences at which a pixel counts as not part of the object."""

FEWER = 4
"""Standard deviation of the blur in pixels of the reduced image in which it is done."""

DARKEST, BINS = -9.0, 65536
"""Logarithm of light that is stored as 0, and number of steps from there to white."""


def blended(image: np.ndarray, painted: np.ndarray, response: Response, reach: float) -> np.ndarray:
    """Blend an appearance into an image, and remove the shading next to it.

    Parameters
    ----------
    image : (h, w, 3) array
    painted : (h, w, 4) float32
        Logarithms of light, and their weights.
    response : Response
        Response of the image's camera.
    reach : float
        Standard deviation of the Gaussian by which the shading is continued beyond the weights, pixels.

    Returns
    -------
    (h, w, 3) uint8
    """
    picture = as_eight_bit(image)
    box = box_around(painted[..., 3] > 0, FARTHEST * reach + 2)
    painted = np.ascontiguousarray(painted[box])
    if not painted.size:
        return picture
    own, step = log_light(image[box], response), max(1, int(reach / FEWER))
    seen = cv2.GaussianBlur(own, (0, 0), BLUR_OWN)
    sums = np.zeros((-(-own.shape[0] // step), -(-own.shape[1] // step), 7), np.float32)
    _reduce(own, painted, step, sums)
    sums = cv2.GaussianBlur(sums, (0, 0), reach / step)
    away = cv2.distanceTransform((painted[..., 3] <= 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    _blend(own, seen, painted, sums, step, away, FARTHEST * reach, _stored(response), picture[box])
    return picture


@lru_cache(4)
def _stored(response: Response) -> np.ndarray:
    """Return the stored values, (BINS,) uint8, of logarithms of light from DARKEST to 0."""
    light = np.exp(np.linspace(DARKEST, 0.0, BINS))
    return np.rint(255 * np.clip(from_linear(light, response), 0.0, 1.0)).astype(np.uint8)


@_njit
def _reduce(own, painted, step, sums):
    """Sum the weighted shading, the weighted light, and the weights of blocks of pixels."""
    for y in range(own.shape[0]):
        for x in range(own.shape[1]):
            weight = painted[y, x, 3]
            if weight == 0:
                continue
            total = sums[y // step, x // step]
            for c in range(3):
                total[c] += weight * (own[y, x, c] - painted[y, x, c])
                total[3 + c] += weight * own[y, x, c]
            total[6] += weight


@_njit
def _blend(own, seen, painted, sums, step, away, farthest, stored, picture):
    """Write the stored values of light without its shading."""
    height, width = sums.shape[:2]
    scale = (len(stored) - 1) / -DARKEST
    nearby = np.zeros(7)
    for y in range(own.shape[0]):
        v = min(max((y - 0.5 * (step - 1)) / step, 0.0), height - 1.0)
        row, below = int(v), min(int(v) + 1, height - 1)
        v -= row
        for x in range(own.shape[1]):
            weight, share = painted[y, x, 3], 1.0 - (away[y, x] - 1.0) / farthest
            share = min(max(share, 0.0), 1.0)
            if weight == 0 and share == 0:
                continue
            u = min(max((x - 0.5 * (step - 1)) / step, 0.0), width - 1.0)
            column, right = int(u), min(int(u) + 1, width - 1)
            u -= column
            for c in range(7):
                top = (1.0 - u) * sums[row, column, c] + u * sums[row, right, c]
                nearby[c] = (1.0 - v) * top + v * ((1.0 - u) * sums[below, column, c] + u * sums[below, right, c])
            total = max(nearby[6], 1e-6)
            brighter = (seen[y, x, 0] + seen[y, x, 1] + seen[y, x, 2]) / 3.0
            brighter -= (nearby[3] + nearby[4] + nearby[5]) / (3.0 * total)
            apart = (brighter / ANOTHER_LIGHT) ** 2
            for c in range(3):
                apart += ((seen[y, x, c] - nearby[3 + c] / total - brighter) / ANOTHER_COLOUR) ** 2
            share *= share * (3.0 - 2.0 * share) * np.exp(-0.5 * max(apart - 1.0, 0.0))
            share = share if share > LEAST_SHARE else 0.0
            for c in range(3):
                taken = weight * (own[y, x, c] - painted[y, x, c]) + (1.0 - weight) * share * nearby[c] / total
                if taken != 0:
                    light = (own[y, x, c] - taken - DARKEST) * scale
                    picture[y, x, c] = stored[int(min(max(light, 0.0), len(stored) - 1.0) + 0.5)]
