"""Camera calibration: angle, response, vignetting and noise, from images or from sensor data."""

from liaam.calibration.alignment import STILL as STILL, Aligned as Aligned, align_pictures as align_pictures
from liaam.calibration.chart import chart_patches as chart_patches, theta_from_chart as theta_from_chart
from liaam.calibration.comparison import (
    Agreement as Agreement,
    Averaged as Averaged,
    agreement as agreement,
    averaged as averaged,
)
from liaam.calibration.entropy import entropy_curve as entropy_curve, theta_from_image as theta_from_image
from liaam.calibration.estimate import PHYSICAL as PHYSICAL, AngleEstimate as AngleEstimate
from liaam.calibration.fits import theta_from_fits as theta_from_fits
from liaam.calibration.noise import (
    NoiseEstimate as NoiseEstimate,
    noise_from_flat as noise_from_flat,
    noise_from_image as noise_from_image,
    noise_from_pair as noise_from_pair,
)
from liaam.calibration.radiometry import (
    RadiometricEstimate as RadiometricEstimate,
    VignettingEstimate as VignettingEstimate,
    calibrate_response as calibrate_response,
    vignetting_from_flat_field as vignetting_from_flat_field,
)
from liaam.calibration.scatter import theta_from_scene as theta_from_scene
from liaam.calibration.spectral import (
    read_sensitivities as read_sensitivities,
    theta_from_peaks as theta_from_peaks,
    theta_from_sensitivities as theta_from_sensitivities,
)
