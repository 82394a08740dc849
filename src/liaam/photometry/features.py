"""Encodings by functions of the user: the channels of any function of an image, projected to a few.

A model keeps the function's name and the projection, but not the function: a file cannot hold it safely.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from liaam.errors import MethodError

FeatureFunction = Callable[[np.ndarray], Any]
"""From an image (h, w, 3) float32, sRGB values in [0, 1], to its channels (h, w, c) float."""

# Largest number of channels that are compared; the core samples eight, and the last is the weight of the pixel
WIDEST = 7
# Largest number of channels of a function. Training computes their covariance, which has 128 MB for so many.
MOST_CHANNELS = 4096
LARGEST = 1e6  # Largest magnitude of a channel, so that no sum of squares overflows in single precision


@dataclass(frozen=True, eq=False)
class Features:
    """What a model knows of a function of the user.

    The k channels that are compared are ``(channels - mean) @ projection`` of the c channels of the function.

    Attributes
    ----------
    name : str
        Name of the function.
    mean : (c,) float64
        Mean of its channels.
    projection : (c, k) float64
        Orthonormal columns.
    """

    name: str
    mean: np.ndarray
    projection: np.ndarray

    @property
    def width(self) -> int:
        """Number of channels that are compared, k."""
        return self.projection.shape[1]


@dataclass(frozen=True)
class Encoder:
    """A function of the user followed by a model's projection, as the encoding of a method."""

    function: FeatureFunction
    features: Features

    @property
    def width(self) -> int:
        """Number of channels that are compared, k."""
        return self.features.width

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Encode an image (h, w, 3) float32 to the channels that are compared, (h, w, k) float32."""
        channels = channels_of(self.function, image)
        features = self.features
        if channels.shape[2] != len(features.mean):
            raise MethodError(
                f"the function {features.name} returns {channels.shape[2]} channels, but returned "
                f"{len(features.mean)} when the model was trained; use the same function, or train the model again"
            )
        return ((channels - features.mean) @ features.projection).astype(np.float32)


def name_of(function: Any) -> str:
    """Return the name of a function. Raise if it has none, such as a lambda."""
    name = getattr(function, "__name__", "")
    if not callable(function) or not name.isidentifier():
        raise MethodError(f"features {function!r}: give a function with a name, defined by 'def'")
    return name


def channels_of(function: FeatureFunction, image: np.ndarray) -> np.ndarray:
    """Return the channels of an image (h, w, 3), (h, w, c) float64. Raise if they are not usable."""
    what = f"the function {getattr(function, '__name__', function)}"
    try:
        channels = np.asarray(function(image), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MethodError(f"{what} fails on an image of shape {image.shape}: {error}") from error
    if channels.ndim != 3 or channels.shape[:2] != image.shape[:2] or not 1 <= channels.shape[2] <= MOST_CHANNELS:
        raise MethodError(
            f"{what} returns an array of shape {channels.shape} for an image of shape {image.shape}; it must return "
            f"(height, width, channels) with at most {MOST_CHANNELS} channels"
        )
    if not (np.abs(channels) <= LARGEST).all():
        raise MethodError(f"{what} returns values that are not finite, or beyond {LARGEST:g}; scale them")
    return channels
