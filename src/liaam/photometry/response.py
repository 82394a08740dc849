"""Camera response: from stored pixel values to linear light and back."""

from typing import Literal

import numpy as np

from liaam.errors import ImageError

Response = Literal["srgb", "linear"] | float
"""How stored values relate to linear light: the sRGB curve, no curve, or a power (gamma)."""


def parse_response(text: str | float) -> Response:
    """Read a response as people write it: ``srgb``, ``linear`` or a gamma such as ``2.2``."""
    if text in ("srgb", "linear"):
        return text
    try:
        gamma = float(text)
    except ValueError:
        gamma = np.nan
    if not 0.2 <= gamma <= 5.0:
        raise ImageError(f"response {text!r} is not known: use 'srgb', 'linear' or a gamma between 0.2 and 5")
    return gamma


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Decode sRGB values in [0, 1] to linear light (IEC 61966-2-1)."""
    v = np.asarray(values)
    return np.where(v <= 0.04045, v / 12.92, ((np.maximum(v, 0.04045) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """Encode linear light in [0, 1] as sRGB values (IEC 61966-2-1)."""
    v = np.asarray(values)
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * np.maximum(v, 0.0031308) ** (1 / 2.4) - 0.055)


def to_linear(values: np.ndarray, response: Response = "srgb") -> np.ndarray:
    """Decode stored values in [0, 1] (any shape) to linear light under a response."""
    if response == "srgb":
        return srgb_to_linear(values)
    if response == "linear":
        return np.asarray(values)
    return np.maximum(values, 0.0) ** float(response)


def from_linear(linear: np.ndarray, response: Response = "srgb") -> np.ndarray:
    """Encode linear light in [0, 1] (any shape) as stored values under a response; inverse of :func:`to_linear`."""
    if response == "srgb":
        return linear_to_srgb(linear)
    if response == "linear":
        return np.asarray(linear)
    return np.maximum(linear, 0.0) ** (1.0 / float(response))


def log_slope(stored: np.ndarray, response: Response = "srgb") -> np.ndarray:
    """Derivative of the logarithm of linear light by the stored value, d log rho / d v, at positive values.

    It turns a standard deviation of stored values into one of logarithms.
    """
    v = np.asarray(stored)
    if response == "srgb":
        return np.where(v <= 0.04045, 1.0 / np.minimum(v, 0.04045), 2.4 / (np.maximum(v, 0.04045) + 0.055))
    return (1.0 if response == "linear" else float(response)) / v
