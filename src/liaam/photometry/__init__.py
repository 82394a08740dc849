"""Photometry: response, noise, the light-invariant projection, encodings, and calibration of all of these.

What only calibrations use loads on first use, so that fitting starts quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from liaam.photometry.camera import CameraModel, NoiseModel, camera_from, load_camera
from liaam.photometry.encoding import ENCODINGS, encode, exposure_faults, is_grey
from liaam.photometry.estimate import PHYSICAL, AngleEstimate
from liaam.photometry.invariant import (
    CHROMATICITY,
    LUMINANCE,
    THETA_DEFAULT,
    invariant,
    invariant_row,
    invariant_row_derivative,
    temperature_direction,
    wien_theta,
)
from liaam.photometry.invariant_image import Agreement, Averaged, agreement, averaged, invariant_image
from liaam.photometry.response import (
    Response,
    ResponseCurve,
    describe_response,
    from_linear,
    linear_to_srgb,
    log_slope,
    parse_response,
    srgb_to_linear,
    to_linear,
)
from liaam.photometry.scatter import (
    chart_patches,
    least_squares_angle,
    theta_from_chart,
    theta_from_scene,
)

if TYPE_CHECKING:
    from liaam.photometry.entropy import EntropyEstimate, entropy_curve, theta_from_image
    from liaam.photometry.masks import dark_pixels, saturated_pixels, specular_pixels, usable_pixels
    from liaam.photometry.noise import (
        NoiseEstimate,
        noise_deviation,
        noise_from_flat,
        noise_from_image,
        noise_from_pair,
    )
    from liaam.photometry.radiometry import (
        RadiometricEstimate,
        VignettingEstimate,
        calibrate_response,
        vignetting_from_flat_field,
    )
    from liaam.photometry.spectral import (
        SpectralEstimate,
        read_sensitivities,
        theta_from_peaks,
        theta_from_sensitivities,
    )

__all__ = [
    "CHROMATICITY",
    "ENCODINGS",
    "LUMINANCE",
    "PHYSICAL",
    "THETA_DEFAULT",
    "Agreement",
    "AngleEstimate",
    "Averaged",
    "CameraModel",
    "EntropyEstimate",
    "NoiseEstimate",
    "NoiseModel",
    "RadiometricEstimate",
    "Response",
    "ResponseCurve",
    "SpectralEstimate",
    "VignettingEstimate",
    "agreement",
    "averaged",
    "calibrate_response",
    "camera_from",
    "chart_patches",
    "dark_pixels",
    "describe_response",
    "encode",
    "entropy_curve",
    "exposure_faults",
    "from_linear",
    "invariant",
    "invariant_image",
    "invariant_row",
    "invariant_row_derivative",
    "is_grey",
    "least_squares_angle",
    "linear_to_srgb",
    "load_camera",
    "log_slope",
    "noise_deviation",
    "noise_from_flat",
    "noise_from_image",
    "noise_from_pair",
    "parse_response",
    "read_sensitivities",
    "saturated_pixels",
    "specular_pixels",
    "srgb_to_linear",
    "temperature_direction",
    "theta_from_chart",
    "theta_from_image",
    "theta_from_peaks",
    "theta_from_scene",
    "theta_from_sensitivities",
    "to_linear",
    "usable_pixels",
    "vignetting_from_flat_field",
    "wien_theta",
]

_HOMES = {
    "entropy": ("EntropyEstimate", "entropy_curve", "theta_from_image"),
    "masks": ("dark_pixels", "saturated_pixels", "specular_pixels", "usable_pixels"),
    "noise": ("NoiseEstimate", "noise_deviation", "noise_from_flat", "noise_from_image", "noise_from_pair"),
    "radiometry": ("RadiometricEstimate", "VignettingEstimate", "calibrate_response", "vignetting_from_flat_field"),
    "spectral": ("SpectralEstimate", "read_sensitivities", "theta_from_peaks", "theta_from_sensitivities"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'liaam.photometry' has no attribute {name!r}")
    value = getattr(import_module(f"liaam.photometry.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
