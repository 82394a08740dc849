"""Where the edges of a scale bar lie, in levels as they are stored and in linear light.

A camera blurs the light, and then encodes it: half the height of an edge in stored levels then lies on its dark side,
by 0.7 standard deviations of the blur. An image that was blurred or reduced after it was encoded has its edges at half
the height of stored levels. With a blur of s before the encoding and one of t after it, the edge lies s / sqrt(s² + t²)
of the way from the place in stored levels to that in linear light. The shape of an edge does not show this share: an
encoded edge is as symmetric as a linear one. So the middle of both is taken, and the share, which may be any from 0 to
1, is part of the error.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from liaam.photometry import srgb_to_linear

_MOST_LEVEL = 1e9  # of an image
_LIMITS = (0.2, 0.5, 0.8)  # shares of the height of an edge at which it is measured
OF_SHIFT = 1 / math.sqrt(12)
"""Standard error of an edge, of the distance between its places in stored levels and in linear light.

It is the standard deviation of an even distribution from one to the other. Edges of one image are blurred alike, so
that the errors of both ends of a bar add up, and are not squared."""


class Edge(NamedTuple):
    """The place of an edge."""

    at: float
    error: float  # its standard error by noise, pixels
    shift: float  # from its place in linear light to that in stored levels, pixels
    width: float  # from 20 to 80 % of the height, pixels


def levels_of(image: np.ndarray) -> np.ndarray | None:
    """Return the levels of an image (h, w) or (h, w, 3), stored and in linear light, as (h, w, 2) float32.

    Both are from 0 to 255 between the extremes; what is not a usual number is 0. Images of integers are taken to be
    encoded as sRGB, and others to be linear. None if all levels are the same.
    """
    grey = np.asarray(image)
    most = float(np.iinfo(grey.dtype).max) if np.issubdtype(grey.dtype, np.integer) else 0.0
    values = np.asarray(grey, np.float64)
    values = np.where(np.abs(values) < _MOST_LEVEL, values, 0.0)
    light = srgb_to_linear(np.clip(values / most, 0, 1)) if most else values
    both = [each.mean(axis=2) if each.ndim == 3 else each for each in (values, light)]
    spans = [float(np.ptp(each)) if each.size else 0.0 for each in both]
    if min(spans) <= 0:
        return None
    return np.stack([(each - each.min()) * (255 / span) for each, span in zip(both, spans, strict=True)], -1).astype(
        np.float32
    )


def edge_of(places: np.ndarray, shares: np.ndarray, noise: float) -> Edge | None:
    """Return where an edge is at half its height, in the middle between stored levels and linear light.

    Parameters
    ----------
    places : (n,) float64
        Rising, pixels.
    shares : (n, 2) float64
        Height, stored and in linear light, from 0 before the edge to 1 beyond it.
    noise : float
        Standard deviation of the stored heights.

    Returns
    -------
    Edge or None
        None if the edge does not rise from 20 to 80 % between the places.
    """
    low, stored, high = (first_above(places, shares[:, 0], limit) for limit in _LIMITS)
    linear = first_above(places, shares[:, 1], 0.5)
    if low is None or stored is None or high is None or linear is None or not high > low:
        return None
    error = noise * (high - low) / (_LIMITS[2] - _LIMITS[0]) / math.sqrt(2)
    return Edge((stored + linear) / 2, error, stored - linear, high - low)


def first_above(places: np.ndarray, share: np.ndarray, limit: float) -> float | None:
    """Return where values first rise above a limit for good, between two places."""
    below = np.flatnonzero(share < limit)
    if not len(below) or below[-1] + 1 >= len(share):
        return None
    i = below[-1]
    return float(places[i] + (limit - share[i]) / (share[i + 1] - share[i]) * (places[i + 1] - places[i]))
