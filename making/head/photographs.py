"""Photographs of rendered heads: exposure, the camera's response, noise and rounding."""

from dataclasses import dataclass

import cv2
import numpy as np

from liaam.photometry.response import linear_to_srgb

NOISE = 0.006
"""Standard deviation of the noise of linear values at full white; shot noise, so less in the dark."""


@dataclass(frozen=True)
class Development:
    """How a camera makes stored values of light.

    Attributes
    ----------
    contrast : float
        Strength of an S-shaped curve on top of sRGB's, 0 for none to 1.
    black : float
        Value at and below which it stores black, as sRGB value.
    """

    contrast: float = 0.0
    black: float = 0.0

    def stored(self, linear: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return the stored picture (h, w, 3) uint8 of linear values (h, w, 3), where 1 is white."""
        noise = NOISE * np.sqrt(np.maximum(linear, 0.0)) * rng.normal(size=linear.shape)
        values = linear_to_srgb(np.clip(linear + noise, 0.0, 1.0))
        values = np.clip((values - self.black) / (1.0 - self.black), 0.0, 1.0)
        curved = values + self.contrast * (values**2 * (3.0 - 2.0 * values) - values)
        return np.rint(255.0 * curved).astype(np.uint8)


def face_in(shape: tuple[int, ...], points: np.ndarray) -> np.ndarray:
    """Return the pixels (h, w) bool within the hull of the landmarks (n, 2)."""
    mask = np.zeros(shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(points).astype(np.int32)), 1)
    return mask > 0


def brightness(linear: np.ndarray, face: np.ndarray) -> float:
    """Return the brightness of a face in a linear picture (h, w, 3): that of its brightest tenth, without its shine."""
    return float(np.percentile(linear.mean(axis=2)[face], 90.0))
