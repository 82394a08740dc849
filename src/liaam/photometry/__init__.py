"""Photometry for fitting: response, exposure, noise, the light-invariant projection, and encodings.

For camera calibration see :mod:`liaam.calibration`.
"""

from liaam.photometry.camera import (
    CameraModel as CameraModel,
    NoiseModel as NoiseModel,
    camera_from as camera_from,
    load_camera as load_camera,
)
from liaam.photometry.encoding import (
    ENCODINGS as ENCODINGS,
    encode as encode,
    exposure_faults as exposure_faults,
    is_grey as is_grey,
)
from liaam.photometry.invariant import (
    CHROMATICITY as CHROMATICITY,
    LUMINANCE as LUMINANCE,
    THETA_DEFAULT as THETA_DEFAULT,
    invariant as invariant,
    invariant_row as invariant_row,
    invariant_row_derivative as invariant_row_derivative,
    temperature_direction as temperature_direction,
    wien_theta as wien_theta,
)
from liaam.photometry.noise import noise_deviation as noise_deviation
from liaam.photometry.projection import invariant_image as invariant_image
from liaam.photometry.response import (
    Response as Response,
    ResponseCurve as ResponseCurve,
    describe_response as describe_response,
    from_linear as from_linear,
    linear_to_srgb as linear_to_srgb,
    log_slope as log_slope,
    parse_response as parse_response,
    srgb_to_linear as srgb_to_linear,
    to_linear as to_linear,
)
