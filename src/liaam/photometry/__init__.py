"""Photometry for fitting: response, exposure, noise, the light-invariant projection, and encodings.

For camera calibration see :mod:`liaam.calibration`.
"""

from liaam.photometry.camera import CameraModel, NoiseModel, camera_from, load_camera
from liaam.photometry.encoding import ENCODINGS, encode, exposure_faults, is_grey
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
from liaam.photometry.noise import noise_deviation
from liaam.photometry.projection import invariant_image
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

__all__ = [
    "CHROMATICITY",
    "ENCODINGS",
    "LUMINANCE",
    "THETA_DEFAULT",
    "CameraModel",
    "NoiseModel",
    "Response",
    "ResponseCurve",
    "camera_from",
    "describe_response",
    "encode",
    "exposure_faults",
    "from_linear",
    "invariant",
    "invariant_image",
    "invariant_row",
    "invariant_row_derivative",
    "is_grey",
    "linear_to_srgb",
    "load_camera",
    "log_slope",
    "noise_deviation",
    "parse_response",
    "srgb_to_linear",
    "temperature_direction",
    "to_linear",
    "wien_theta",
]
