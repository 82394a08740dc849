"""Blending of an appearance into each frame of a video."""

from functools import lru_cache

import cv2
import numpy as np

from liaam.photometry import Response, from_linear
from liaam.relighting.painting import as_eight_bit, box_around, log_light

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
    weight = painted[..., 3:]
    sums = _reduced(np.concatenate([weight * (own - painted[..., :3]), weight * own, weight], axis=2), step)
    sums = cv2.GaussianBlur(sums, (0, 0), reach / step)
    away = cv2.distanceTransform((painted[..., 3] <= 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    share = np.clip(1.0 - (away - 1.0) / (FARTHEST * reach), 0.0, 1.0)
    ys, xs = np.nonzero((painted[..., 3] > 0) | (share > 0))
    nearby = _enlarged(sums, own.shape[:2], step)[ys, xs]
    light = own[ys, xs] - _taken(own[ys, xs], seen[ys, xs], painted[ys, xs], nearby, share[ys, xs])
    at = np.clip((light - DARKEST) * ((BINS - 1) / -DARKEST), 0.0, BINS - 1.0) + 0.5
    changed = light != own[ys, xs]
    picture[box][ys, xs] = np.where(changed, _stored(response)[at.astype(np.int32)], picture[box][ys, xs])
    return picture


def _reduced(layers: np.ndarray, step: int) -> np.ndarray:
    """Average blocks of ``step`` by ``step`` pixels of (h, w, c) float32; the last blocks are filled with 0."""
    height, width = layers.shape[:2]
    padded = cv2.copyMakeBorder(layers[..., :4], 0, -height % step, 0, -width % step, cv2.BORDER_CONSTANT, value=0)
    rest = cv2.copyMakeBorder(layers[..., 4:], 0, -height % step, 0, -width % step, cv2.BORDER_CONSTANT, value=0)
    size = padded.shape[1] // step, padded.shape[0] // step
    parts = [cv2.resize(each, size, interpolation=cv2.INTER_AREA) for each in (padded, rest)]
    return np.concatenate(parts, axis=2)


def _enlarged(sums: np.ndarray, shape: tuple[int, int], step: int) -> np.ndarray:
    """Interpolate blocks (rows, columns, c) at their pixels, (h, w, c)."""
    size = sums.shape[1] * step, sums.shape[0] * step
    parts = [
        cv2.resize(np.ascontiguousarray(each), size, interpolation=cv2.INTER_LINEAR)
        for each in (sums[..., :4], sums[..., 4:])
    ]
    return np.concatenate(parts, axis=2)[: shape[0], : shape[1]]


def _taken(own: np.ndarray, seen: np.ndarray, painted: np.ndarray, nearby: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return the shading of pixels, (n, 3) logarithms: their own within the weights, and a share of the nearby."""
    weight, total = painted[:, 3:], np.maximum(nearby[:, 6:], 1e-6)
    seen_beyond = seen - nearby[:, 3:6] / total
    brighter = seen_beyond.mean(axis=1, keepdims=True)
    apart = np.square(brighter[:, 0] / ANOTHER_LIGHT) + np.square((seen_beyond - brighter) / ANOTHER_COLOUR).sum(axis=1)
    share = share * share * (3.0 - 2.0 * share) * np.exp(-0.5 * np.maximum(apart - 1.0, 0.0))
    share = np.where(share > LEAST_SHARE, share, np.float32(0.0))[:, None]
    return weight * (own - painted[:, :3]) + (1.0 - weight) * share * nearby[:, :3] / total


@lru_cache(4)
def _stored(response: Response) -> np.ndarray:
    """Return the stored values, (BINS,) uint8, of logarithms of light from DARKEST to 0."""
    light = np.exp(np.linspace(DARKEST, 0.0, BINS))
    return np.rint(255 * np.clip(from_linear(light, response), 0.0, 1.0)).astype(np.uint8)
