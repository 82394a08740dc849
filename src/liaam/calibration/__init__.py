"""Camera calibration: angle, response, vignetting and noise, from images or from sensor data."""

from liaam.calibration.alignment import STILL, Aligned, align_pictures
from liaam.calibration.chart import chart_patches, theta_from_chart
from liaam.calibration.comparison import Agreement, Averaged, agreement, averaged
from liaam.calibration.entropy import entropy_curve, theta_from_image
from liaam.calibration.estimate import PHYSICAL, AngleEstimate
from liaam.calibration.fits import theta_from_fits
from liaam.calibration.noise import NoiseEstimate, noise_from_flat, noise_from_image, noise_from_pair
from liaam.calibration.radiometry import (
    RadiometricEstimate,
    VignettingEstimate,
    calibrate_response,
    vignetting_from_flat_field,
)
from liaam.calibration.scatter import theta_from_scene
from liaam.calibration.spectral import read_sensitivities, theta_from_peaks, theta_from_sensitivities

__all__ = [
    "PHYSICAL",
    "STILL",
    "Agreement",
    "Aligned",
    "AngleEstimate",
    "Averaged",
    "NoiseEstimate",
    "RadiometricEstimate",
    "VignettingEstimate",
    "agreement",
    "align_pictures",
    "averaged",
    "calibrate_response",
    "chart_patches",
    "entropy_curve",
    "noise_from_flat",
    "noise_from_image",
    "noise_from_pair",
    "read_sensitivities",
    "theta_from_chart",
    "theta_from_fits",
    "theta_from_image",
    "theta_from_peaks",
    "theta_from_scene",
    "theta_from_sensitivities",
    "vignetting_from_flat_field",
]
