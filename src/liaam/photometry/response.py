"""Camera response: from stored pixel values to linear light and back."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from liaam.errors import ImageError


@dataclass(frozen=True)
class ResponseCurve:
    """A measured response, common to the three channels: stored values and their linear light.

    Between the points the logarithm of light is a monotone cubic of the logarithm of the stored value; outside it is a
    power law. Thus a power (gamma) needs two points only, and dark values keep their relative accuracy.

    Attributes
    ----------
    stored : tuple of float
        Stored values, increasing, above 0 and at most 1.
    linear : tuple of float
        Linear light of the stored values, increasing, on any scale (only ratios matter to the invariant). Light 1 at
        stored value 1 preserves the brightness of images.

    Raises
    ------
    ImageError
        If the points do not increase, are not positive, or are fewer than two.
    """

    stored: tuple[float, ...]
    linear: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the points."""
        points = (
            np.array([self.stored, self.linear], dtype=np.float64) if len(self.stored) == len(self.linear) else None
        )
        if points is None or points.shape[1] < 2 or not np.isfinite(points).all() or points.min() <= 0:
            raise ImageError("a response curve needs two or more pairs of positive stored values and linear light")
        if not (np.diff(points, axis=1) > 0).all() or points[0, -1] > 1:
            raise ImageError("a response curve must increase from point to point, with stored values of at most 1")
        _check_range(self, np.log(points))


Response = Literal["srgb", "linear"] | float | ResponseCurve
"""Relation of stored values and linear light: the sRGB curve, no curve, a power (gamma), or a measured curve."""


def parse_response(text: "str | float | Mapping | ResponseCurve") -> Response:
    """Convert ``srgb``, ``linear``, a gamma such as ``2.2``, or the ``stored`` and ``linear`` of a curve to a response.

    Raises ImageError if it is none of these.
    """
    if isinstance(text, ResponseCurve):
        return text
    if isinstance(text, Mapping):
        if set(text) != {"stored", "linear"}:
            raise ImageError("a response curve has exactly the entries 'stored' and 'linear'; remove or add entries")
        return ResponseCurve(tuple(map(float, text["stored"])), tuple(map(float, text["linear"])))
    if text in ("srgb", "linear"):
        return text
    try:
        gamma = float(text)
    except (TypeError, ValueError):
        gamma = np.nan
    if not 0.2 <= gamma <= 5.0:
        raise ImageError(f"response {text!r} is unknown: use 'srgb', 'linear' or a gamma between 0.2 and 5")
    return gamma


def describe_response(response: Response) -> "str | float | dict[str, list[float]]":
    """Convert a response to JSON types; :func:`parse_response` is the inverse."""
    if isinstance(response, ResponseCurve):
        return {"stored": list(response.stored), "linear": list(response.linear)}
    return response


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Decode sRGB values in [0, 1] to linear light (IEC 61966-2-1)."""
    v = np.asarray(values)
    return np.where(v <= 0.04045, v / 12.92, ((np.maximum(v, 0.04045) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """Encode linear light in [0, 1] as sRGB values (IEC 61966-2-1)."""
    v = np.asarray(values)
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * np.maximum(v, 0.0031308) ** (1 / 2.4) - 0.055)


def to_linear(values: np.ndarray, response: Response = "srgb") -> np.ndarray:
    """Decode stored values in [0, 1] (any shape) to linear light."""
    if response == "srgb":
        return srgb_to_linear(values)
    if response == "linear":
        return np.asarray(values)
    if isinstance(response, ResponseCurve):
        light = np.exp(_power_law_ends(_spline(response), np.log(np.maximum(values, SMALLEST))))
        return np.where(np.asarray(values) > SMALLEST, light, 0.0)
    return np.maximum(values, 0.0) ** float(response)


def from_linear(linear: np.ndarray, response: Response = "srgb") -> np.ndarray:
    """Encode linear light in [0, 1] (any shape) as stored values; inverse of :func:`to_linear`."""
    if response == "srgb":
        return linear_to_srgb(linear)
    if response == "linear":
        return np.asarray(linear)
    if not isinstance(response, ResponseCurve):
        return np.maximum(linear, 0.0) ** (1.0 / float(response))
    spline = _spline(response)
    wanted = np.log(np.maximum(linear, SMALLEST))
    grid = np.linspace(spline.x[0], spline.x[-1], 2048)
    logs = np.interp(wanted, spline(grid), grid)
    for _ in range(2):  # beyond the points, the first Newton step leaves them and the second follows the straight end
        logs = logs - (_power_law_ends(spline, logs) - wanted) / _power_law_ends(spline, logs, slope=True)
    return np.where(np.asarray(linear) > SMALLEST, np.exp(logs), 0.0)


def log_slope(stored: np.ndarray, response: Response = "srgb") -> np.ndarray:
    """Derivative of the logarithm of linear light by the stored value, d log rho / d v, at positive values.

    It converts a standard deviation of stored values to one of logarithms.
    """
    v = np.asarray(stored)
    if response == "srgb":
        return np.where(v <= 0.04045, 1.0 / np.minimum(v, 0.04045), 2.4 / (np.maximum(v, 0.04045) + 0.055))
    if isinstance(response, ResponseCurve):
        return _power_law_ends(_spline(response), np.log(v), slope=True) / v
    return (1.0 if response == "linear" else float(response)) / v


MOST_POINTS = 65536  # Largest number of points of a curve: the number of 16-bit values
# Largest slope of a curve in logarithms. 16-bit values just above a black level have 10,000; with larger slopes the
# squares of a logarithm's noise exceed the range of single precision.
MOST_STEEP = 1e5
MOST_CONTRAST = 10.0  # Largest overall gamma of a curve; twice the largest gamma accepted as a number
WHITES = (1e-4, 1e4)  # Range of linear light at stored value 1
BLACKEST = 0.02  # Stored value that defines, together with 1, the overall gamma of a curve


def _check_range(curve: ResponseCurve, logs: np.ndarray) -> None:
    """Raise if a curve is implausible for a camera and would exceed single precision; ``logs`` (2, n) of its points."""
    steps = np.diff(logs, axis=1)
    if logs.shape[1] > MOST_POINTS:
        raise ImageError(f"a response curve of {logs.shape[1]} points: give at most {MOST_POINTS}")
    if not (steps[1] <= MOST_STEEP * steps[0]).all() or not (steps[0] > 0).all():
        raise ImageError(
            "a response curve has two almost equal stored values with very different light: remove one of the points"
        )
    black, white = _power_law_ends(_spline(curve), np.log([BLACKEST, 1.0]))
    if not np.log(WHITES[0]) <= white <= np.log(WHITES[1]):
        raise ImageError(
            f"a response curve maps white to linear light of about 1e{white / np.log(10.0):.0f}: scale its light so "
            f"that white lies between {WHITES[0]:g} and {WHITES[1]:g} (usually 1)"
        )
    exponent = (white - black) / -np.log(BLACKEST)
    if not exponent <= MOST_CONTRAST:
        raise ImageError(
            f"a response curve has an overall gamma of {exponent:.3g}; the maximum is {MOST_CONTRAST:g}: check its "
            "linear light and that its stored values range from 0 to 1"
        )


SMALLEST = 1e-12  # Stored value or light below which a curve gives 0
# Least slope of a curve in logarithms, and the largest outside its points. The spline of increasing points can have
# flat ends, and just above a black level it is very steep.
FLATTEST = 1e-3
STEEPEST_END = 5.0


@lru_cache(maxsize=8)
def _spline(curve: ResponseCurve):
    """Log of light as a monotone cubic of the log of the stored value."""
    from scipy.interpolate import PchipInterpolator  # heavy: imported when first needed

    return PchipInterpolator(np.log(curve.stored), np.log(curve.linear))


def _power_law_ends(spline, log_values: np.ndarray, slope: bool = False) -> np.ndarray:
    """Value (or slope) of a log-log curve, extended linearly outside its points."""
    inside = np.clip(log_values, spline.x[0], spline.x[-1])
    within = np.maximum(spline(inside, 1), FLATTEST)
    beyond = np.minimum(within, STEEPEST_END)
    if slope:
        return np.where(log_values == inside, within, beyond)
    return spline(inside) + beyond * (log_values - inside)
