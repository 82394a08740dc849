"""A fitted image on the model's reference frame, and how far image and model can be trusted there."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.evaluation import short_repr
from liaam.model import AAM
from liaam.model.shape import align
from liaam.photometry import Response, from_linear
from liaam.photometry.invariant import THETA_DEFAULT
from liaam.photometry.response import log_slope
from liaam.relighting.painting import soft_edge
from liaam.training.textures import sample_appearance

NOISE_FACTOR = 3.0
"""Factor on the noise's variance: rounding and JPEG compression add to the measured noise."""

UNKNOWN = 0.05
"""Standard deviation of the model's errors if training has not measured it on left-out images."""

AT_THE_BORDER = 0.5
"""Standard deviation of the model's errors at the mesh's border, where a landmark one pixel off samples the
background."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A fitted image sampled on the reference frame, at the blur of the model's sharpest level."""

    log: np.ndarray
    """(n_pixels, 3) float32: logarithm of linear light."""
    usable: np.ndarray
    """(n_pixels,) float32 in {0, 1}."""
    noise: np.ndarray
    """(n_pixels, 3) float32: variance of the noise of ``log``."""

    __repr__ = short_repr

    @classmethod
    def of(cls, model: AAM, image: np.ndarray, shape: np.ndarray, response: Response, noise: float) -> "Seen":
        """Warp an image (h, w, 3), whose stored values have a standard deviation, by its fitted landmarks (n, 2)."""
        log, usable = sample_appearance(image, shape, model.warp, "log", response, model.levels[-1].blur)
        pixel = max(1.0, align(model.shape_model.mean, shape).scale)
        stored = from_linear(np.exp(log), response)
        return cls(log, usable, noise_variance(stored, response, noise / pixel).astype(np.float32))


def noise_variance(stored: np.ndarray, response: Response, deviation: float) -> np.ndarray:
    """Return the variance of logarithms of light from stored values in [0, 1] (any shape) and their deviation."""
    return np.square(deviation * log_slope(np.maximum(stored, 0.5 / 255), response))


@lru_cache(maxsize=4)
def errors_of_the_model(model: AAM) -> np.ndarray:
    """Return the variance of the errors of a model's appearance in fitted images, (n_pixels,) float32."""
    unexplained = model.levels[-1].appearances["log"].unexplained
    known = UNKNOWN**2 if unexplained is None else np.trace(unexplained, axis1=1, axis2=2) / 3.0
    return (known + np.square(AT_THE_BORDER * (1.0 - soft_edge(model)))).astype(np.float32)


def angle_of(theta: float) -> float:
    """Return a camera's angle, radians, or that assumed for unknown cameras."""
    return float(theta) if np.isfinite(theta) else THETA_DEFAULT
