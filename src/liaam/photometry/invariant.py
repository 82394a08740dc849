"""The light-invariant projection of log-RGB (paper, section 2 and eq 6-8).

For Lambertian surfaces, Planckian light (Wien) and narrow-band sensors, a change of light moves ``log rho`` along
``1 = (1, 1, 1)`` (intensity) and along ``d(theta)`` (colour temperature). The row ``L(theta)`` is
orthogonal to both, so the invariant ``L(theta) . log rho`` does not change.
"""

from collections.abc import Sequence

import numpy as np

from liaam import encoding_constants

# Rec. 709 luminance weights, the metric of the grey method, shape (1, 3).
LUMINANCE = encoding_constants.LUMINANCE[None]
# The two orthonormal rows orthogonal to 1, the metric of the chroma method, shape (2, 3)
CHROMATICITY = np.array(
    [
        [1 / np.sqrt(2), -1 / np.sqrt(2), 0.0],
        [1 / np.sqrt(6), 1 / np.sqrt(6), -2 / np.sqrt(6)],
    ]
)
# Angle assumed for an unknown camera, radians: that of the shift of the logarithm of linear sRGB under Planckian lights
# of 3000-8000 K. Published sensor sensitivities give 116-122 degrees.
THETA_DEFAULT = float(np.deg2rad(122.0))


def invariant_row(theta: float) -> np.ndarray:
    """Row L(theta) = (cos, sin, -cos - sin) of paper eq 8, (1, 3) float64, of a camera with angle theta in radians.

    Examples
    --------
    >>> float(abs(invariant_row(2.0).sum())) < 1e-15  # blind to intensity: L . 1 = 0
    True
    """
    c = np.cos(theta)
    s = np.sin(theta)
    return np.array([[c, s, -c - s]])


def invariant_row_derivative(theta: float) -> np.ndarray:
    """Derivative dL/dtheta = (-sin, cos, sin - cos), shape (1, 3) float64."""
    c = np.cos(theta)
    s = np.sin(theta)
    return np.array([[-s, c, s - c]])


def temperature_direction(theta: float) -> np.ndarray:
    """Unit direction d(theta) in which log rho moves with colour temperature, shape (3,) float64.

    It is orthogonal to both ``1`` and ``L(theta)``. For theta in 90-135 degrees it points towards more blue (a hotter
    light).
    """
    d = np.cross(invariant_row(theta)[0], np.ones(3))
    d /= np.linalg.norm(d)
    return d if d[2] >= 0 else -d


def invariant(log_rgb: np.ndarray, theta: float) -> np.ndarray:
    """Light-invariant value L(theta) . log rho (...) float64 of logarithms of linear RGB (..., 3) (paper eq 7)."""
    return np.asarray(log_rgb, dtype=np.float64) @ invariant_row(theta)[0]


def wien_theta(peaks_nm: Sequence[float] | np.ndarray) -> float:
    """Angle of an ideal narrow-band camera, radians, from the peak wavelengths of R, G and B (Wien's approximation).

    It is 90 deg + atan2(1/lB - 1/lG, 1/lB - 1/lR), which depends on ratios of the wavelengths only.

    Examples
    --------
    >>> round(float(np.rad2deg(wien_theta((610, 540, 450)))), 1)
    122.1
    """
    r, g, b = (1.0 / x for x in peaks_nm)
    return float(np.pi / 2 + np.arctan2(b - g, b - r))
