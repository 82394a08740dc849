"""Scale bars, and how levels along them are sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from liaam.formatting import short_repr
from liaam.scale.lengths import Length


class Profile(NamedTuple):
    """What is seen along an end of a bar, from within it outwards."""

    outwards: np.ndarray  # (n,): distances, pixels, rising
    levels: np.ndarray  # (n, ...)
    beyond: np.ndarray  # (m, ...): those of the ground beyond the end, at least one


def profile_at(outwards: np.ndarray, levels: np.ndarray, end: float, beyond: tuple[float, float]) -> Profile | None:
    """Return levels (n, ...) along an end by their distances; None if the ground beyond it is not seen.

    ``beyond`` are the distances from the end between which the ground is.
    """
    order = np.argsort(outwards)
    outwards = outwards[order]
    levels = levels[order]
    near, far = beyond
    ground = levels[(outwards > end + near) & (outwards < end + far)]
    return Profile(outwards, levels, ground) if len(ground) else None


SHORTEST = 40.0
"""Shortest bar in pixels. Strokes of letters, and bristles, are shorter."""


@dataclass(frozen=True, eq=False, repr=False)
class Bar:
    """A scale bar in an image.

    Attributes
    ----------
    length : float
        From one outer end to the other, pixels.
    length_se : float
        Its standard error.
    ends : (2, 2) float64
        x and y of the ends, in pixels.
    """

    length: float
    length_se: float
    ends: np.ndarray

    __repr__ = short_repr

    @property
    def angle(self) -> float:
        """Tilt against the horizontal, -90 to 90 degrees; downwards is positive."""
        across, down = self.ends[1] - self.ends[0]
        return (math.degrees(math.atan2(down, across)) + 90) % 180 - 90

    def pixel(self, bar: Length) -> Length:
        """Return the length of a pixel, given that of the bar."""
        value = bar.value / self.length
        error = value * math.hypot(self.length_se / self.length, bar.se / bar.value)
        return Length(value, bar.unit, error, "a scale bar in the image")


def axes_of(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the places of pixels along and across their main axis, their centre, and the axis."""
    centre = pixels.mean(axis=0)
    away = pixels - centre
    _, vectors = np.linalg.eigh(away.T @ away)
    axis = vectors[:, 1]
    axis = axis if axis[0] >= 0 else -axis
    return away @ axis, away @ np.array([-axis[1], axis[0]]), centre, axis


def sampled(
    grey: np.ndarray,
    middle: np.ndarray,
    axis: np.ndarray,
    along: np.ndarray,
    across: np.ndarray,
    *,
    is_linear: bool = False,
) -> np.ndarray:
    """Return the levels at places along and across an axis through a middle, (len(along), len(across)).

    They are interpolated by cubic polynomials, which go beyond the levels of the pixels beside a sharp edge by a tenth
    of its height, or linearly, which does not.
    """
    places = middle + along[:, None, None] * axis + across[:, None] * np.array([-axis[1], axis[0]])
    maps = (places[..., 0].astype(np.float32), places[..., 1].astype(np.float32))
    method = cv2.INTER_LINEAR if is_linear else cv2.INTER_CUBIC
    return cv2.remap(grey.astype(np.float32), *maps, method, borderMode=cv2.BORDER_REPLICATE)
