"""Compute the angle from a camera's spectral sensitivities, by simulating its responses under a series of lights.

Under lights of different colour temperature the log responses to a surface lie nearly on a line in the plane orthogonal
to intensity (paper, section 2; Finlayson and Hordley, "Color constancy at a pixel", JOSA A 2001). Total least squares
estimates its direction, and L(theta) is orthogonal to it.
"""

import os
from typing import Literal, get_args

import numpy as np

from liaam.calibration.columns import read_columns
from liaam.calibration.estimate import AngleEstimate, axis_difference
from liaam.error_measures import root_mean_square
from liaam.errors import CameraError, installing
from liaam.photometry.invariant import CHROMATICITY, wien_theta

Lights = Literal["both", "planckian", "daylight", "wien"]
"""Planckian radiators, CIE daylights, both; ``wien``: radiators by Wien's approximation, as in the paper."""

KELVIN = (2500.0, 10000.0)  # Coldest and hottest light of a series
COLDEST_DAYLIGHT = 4000.0  # Lowest temperature of CIE daylights, kelvin
MIRED_STEP = 10.0  # Distance of neighbouring lights in reciprocal megakelvin, in which colour changes uniformly
K2_NM = 1.438776877e7  # Second radiation constant, nm K (CODATA 2018)
# Standard deviation of a broad sensor's sensitivity, nm, since peak wavelengths do not determine the width
SENSOR_WIDTH = 40.0
# Difference between the effective and the peak wavelength of a sensor, nm, since real curves are asymmetric
PEAK_OFFSET = 10.0
VISIBLE = (300.0, 830.0)  # Wavelengths of the daylight table, nm; sensitivities outside are ignored
FEWEST = 8  # Least number of wavelengths of sensitivity curves
COARSEST = 25.0  # Largest gap between wavelengths of sensitivity curves, nm

_ALIASES = {
    "wavelength": "wavelength_nm", "lambda": "wavelength_nm", "nm": "wavelength_nm",
    "red": "R", "green": "G", "blue": "B",
}  # fmt: skip


def theta_from_peaks(peaks_nm: tuple[float, float, float]) -> AngleEstimate:
    """Compute the angle from the peak wavelengths of the three sensors, by Wien's closed form.

    Parameters
    ----------
    peaks_nm : (float, float, float)
        Peak wavelengths of R, G and B, nm.

    Returns
    -------
    AngleEstimate
        Its standard error of some degrees is the deviation of broad and asymmetric sensors from the closed form, under
        real lights and on coloured surfaces. Stacked sensors (Foveon) deviate more: 9 degrees for the one with
        published curves.

    Raises
    ------
    CameraError
        If the peaks are not three decreasing wavelengths from 300 to 830 nm.
    """
    peaks = np.asarray(peaks_nm, dtype=np.float64)
    falling = peaks.shape == (3,) and np.isfinite(peaks).all() and (np.diff(peaks) < 0).all()
    if not falling or peaks[0] > VISIBLE[1] or peaks[2] < VISIBLE[0]:
        raise CameraError(
            f"peak wavelengths {peaks_nm}: give those of R, G and B in nm, longest first, such as 610, 540, 450"
        )
    theta = wien_theta(peaks)
    nm = np.arange(VISIBLE[0], VISIBLE[1] + 1)
    broad = theta_from_sensitivities(nm, np.exp(-0.5 * np.square((nm[:, None] - peaks) / SENSOR_WIDTH)))
    moved = [wien_theta(peaks + offset) for offset in PEAK_OFFSET * np.eye(3)]
    parts = [broad.standard_error, *(axis_difference(angle, theta) for angle in (broad.theta, *moved))]
    error = float(np.linalg.norm(parts))
    message = (
        f"by Wien's closed form; the error assumes broad sensors with effective wavelengths within {PEAK_OFFSET:g} nm "
        "of their peaks, under Planckian lights and daylights: sensitivity curves give a smaller error"
    )
    return AngleEstimate(theta, error, message, broad.light_change, broad.n)


def theta_from_sensitivities(
    wavelengths_nm: np.ndarray,
    sensitivities: np.ndarray,
    lights: Lights = "both",
    *,
    kelvin: tuple[float, float] = KELVIN,
) -> AngleEstimate:
    """Compute the angle from sensitivity curves, for a neutral surface under a series of lights.

    Parameters
    ----------
    wavelengths_nm : (n,) float
        Increasing, nm.
    sensitivities : (n, 3) float
        Sensitivities of R, G and B to radiant power, each on any scale. Small negative values, as from measurements and
        colour matrices, are accepted.
    lights : {"both", "planckian", "daylight", "wien"}
        Planckian radiators; CIE daylights (from 4000 K up); both; or radiators by Wien's approximation.
    kelvin : (float, float)
        Coldest and hottest light.

    Returns
    -------
    AngleEstimate
        Its standard error is the spread between surfaces and lights. ``n`` is the number of surfaces, one neutral and
        the others coloured, of which the spread was computed.

    Raises
    ------
    CameraError
        If the curves are invalid, or the three channels respond alike, so that lights do not change the colour.
    """
    nm = np.asarray(wavelengths_nm, dtype=np.float64)
    curves = np.asarray(sensitivities, dtype=np.float64)
    _check_curves(nm, curves)
    nm, curves = _resampled(nm, curves)
    # A neutral surface, then eight hues of moderate saturation and one low frequency: frequency-limited reflectances
    # after Stiles, Wyszecki and Ohta (JOSA 1977).
    hues = 0.5 + 0.25 * np.cos(2 * np.pi * (nm / 250.0 - np.arange(8)[:, None] / 8))
    surfaces = np.vstack([np.ones_like(nm), hues])
    weighted = curves * _trapezoid_weights(nm)[:, None]
    responses = {
        name: np.einsum("kn,mn,nc->kmc", surfaces, power, weighted, optimize=True)
        for name, power in _series(nm, lights, kelvin).items()
    }
    responsive = np.all([(r > 0).all(axis=(1, 2)) for r in responses.values()], axis=0)
    if not responsive[0]:
        raise CameraError(
            "a channel does not respond to white light: its sensitivity is zero or mostly negative; check the curves"
        )
    series = {name: np.log(r[responsive]) for name, r in responses.items()}
    theta = _angle_of([logs[0] for logs in series.values()])
    # The cold and the hot lights of each surface show the curvature of its locus.
    loci = [surface for logs in series.values() for surface in logs]
    halves = [half for locus in loci for half in (locus[: len(locus) // 2 + 1], locus[len(locus) // 2 :])]
    error = root_mean_square([axis_difference(_angle_of([half]), theta) for half in halves])
    alone = {name: _angle_of([logs[0]]) for name, logs in series.items()}
    warmth = np.concatenate([logs[0, :, 0] - logs[0, :, 2] for logs in series.values()])
    parts = " and ".join(f"{np.rad2deg(angle):.1f}° under the {name} series" for name, angle in alone.items())
    message = (
        f"white has {parts}, {kelvin[0]:.0f} to {kelvin[1]:.0f} K; the error of {np.rad2deg(error):.1f}° is the spread "
        "between surfaces and between lights, since broad sensors do not have a single angle"
    )
    change = float(np.sqrt(2.0) * np.std(warmth, ddof=1))
    return AngleEstimate(theta, error, message, change, int(responsive.sum()))


def read_sensitivities(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray]:
    """Read sensitivity curves from a CSV file.

    Columns are ``wavelength_nm``, ``R``, ``G`` and ``B``. A header line may give another order and further columns; it
    is not case-sensitive and may use ``nm``, ``wavelength``, ``red``, ``green`` and ``blue``. The separator is a
    comma, semicolon or tab. Lines that start with # are comments.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    wavelengths_nm : (n,) float64
        Increasing.
    sensitivities : (n, 3) float64
        Sensitivities of R, G and B.

    Raises
    ------
    CameraError
        If the file is missing, or a line is invalid; the message names the line.
    """
    table = read_columns(path, "table of sensitivities", ("wavelength_nm", "R", "G", "B"), _ALIASES)
    if len(table) < FEWEST:
        raise CameraError(f"{path}: {len(table)} wavelengths are too few; give {FEWEST} or more, in nm")
    table = table[np.argsort(table[:, 0])]
    nm = table[:, 0]
    curves = table[:, 1:]
    try:
        _check_curves(nm, curves)
    except CameraError as error:
        raise CameraError(f"{path}: {error}") from error
    red, blue = (float(nm @ np.maximum(curves[:, c], 0) / np.maximum(curves[:, c], 0).sum()) for c in (0, 2))
    if red <= blue:
        raise CameraError(
            f"{path}: R has a shorter mean wavelength ({red:.0f} nm) than B ({blue:.0f} nm); name the columns in a "
            "header line such as wavelength_nm,R,G,B"
        )
    return nm, curves


def planckian(wavelengths_nm: np.ndarray, kelvin: np.ndarray | float, *, wien: bool = False) -> np.ndarray:
    """Compute the spectral power (m, n) of Planckian radiators, 1 at 560 nm; ``wien``: by Wien's approximation."""
    nm = np.asarray(wavelengths_nm, dtype=np.float64)
    reach = K2_NM / np.atleast_1d(kelvin)[:, None]
    ratio = np.exp(reach / 560.0 - reach / nm) if wien else np.expm1(reach / 560.0) / np.expm1(reach / nm)
    return ratio * (560.0 / nm) ** 5


def daylight(wavelengths_nm: np.ndarray, kelvin: np.ndarray | float) -> np.ndarray:
    """Compute the spectral power (m, n) of daylights of 4000 to 25000 K, 100 at 560 nm (CIE 15:2004, section 3.1)."""
    try:
        import colour  # heavy: imported when first needed
    except ImportError as fault:
        raise CameraError(f"the spectra of daylight come from colour-science; run {installing('spectral')}") from fault
    xy = colour.temperature.CCT_to_xy_CIE_D(np.atleast_1d(kelvin))
    days = [colour.sd_CIE_illuminant_D_series(each, M1_M2_rounding=False) for each in xy]
    return np.stack([np.interp(wavelengths_nm, day.wavelengths, day.values, 0.0, 0.0) for day in days])


def _series(nm: np.ndarray, lights: str, kelvin: tuple[float, float]) -> dict[str, np.ndarray]:
    """Spectra (m, n) of the requested series of lights, by name."""
    if lights not in get_args(Lights):
        raise CameraError(f"lights {lights!r} are unknown: give one of {', '.join(get_args(Lights))}")
    cold, hot = (float(k) for k in kelvin)
    if not 1000.0 <= cold < hot <= 25000.0:
        raise CameraError(f"lights from {cold:g} to {hot:g} K: give the colder first, within 1000 to 25000 K")

    def even_in_mired(cold: float) -> np.ndarray:
        steps = round((1e6 / cold - 1e6 / hot) / MIRED_STEP)
        return 1e6 / np.linspace(1e6 / cold, 1e6 / hot, max(8, steps + 1))

    if lights in ("planckian", "wien"):
        return {lights: planckian(nm, even_in_mired(cold), wien=lights == "wien")}
    if max(cold, COLDEST_DAYLIGHT) >= hot:
        raise CameraError(f"there is no CIE daylight from {cold:g} to {hot:g} K; give lights='planckian'")
    day = {"daylight": daylight(nm, even_in_mired(max(cold, COLDEST_DAYLIGHT)))}
    return day if lights == "daylight" else {"planckian": planckian(nm, even_in_mired(cold)), **day}


def _trapezoid_weights(nm: np.ndarray) -> np.ndarray:
    """Weights (n,) of the trapezoidal rule."""
    weights = np.gradient(nm)
    weights[[0, -1]] *= 0.5
    return weights


def _angle_of(loci: list[np.ndarray]) -> float:
    """Angle, radians in [0, pi), with L(theta) orthogonal to the common direction of loci of log responses (m, 3)."""
    chroma = np.concatenate([logs - logs.mean(axis=0) for logs in loci]) @ CHROMATICITY.T
    _, sizes, axes = np.linalg.svd(chroma, full_matrices=False)
    if sizes[0] < 1e-6 * np.sqrt(len(chroma)):
        raise CameraError("the three channels respond alike to every light, so there is no angle; check the columns")
    row = np.cross(axes[0] @ CHROMATICITY, np.ones(3))
    return float(np.arctan2(row[1], row[0]) % np.pi) % float(np.pi)


def _check_curves(nm: np.ndarray, curves: np.ndarray) -> None:
    """Raise if sensitivity curves are invalid."""
    if nm.ndim != 1 or curves.shape != (len(nm), 3) or len(nm) < FEWEST:
        raise CameraError(
            f"wavelengths of shape {nm.shape} and sensitivities of shape {curves.shape}: give (n,) and (n, 3), of "
            f"{FEWEST} wavelengths or more"
        )
    if not np.isfinite(nm).all() or not np.isfinite(curves).all():
        raise CameraError("a wavelength or sensitivity is not a finite number; fill the gap or remove its row")
    if (np.diff(nm) <= 0).any():
        raise CameraError(f"wavelength {nm[1:][np.diff(nm) <= 0][0]:g} is not in order; give each once, shortest first")
    if nm[0] < 100 or nm[-1] > 3000:
        raise CameraError(f"wavelengths from {nm[0]:g} to {nm[-1]:g} are not in nm; visible light has 380 to 780 nm")
    if deaf := [name for name, curve in zip("RGB", curves.T, strict=True) if curve.max() <= 0]:
        raise CameraError(f"channel {deaf[0]} has no sensitivity above 0; check the columns")
    if (np.diff(nm) > COARSEST).any():
        raise CameraError(f"wavelengths are {np.diff(nm).max():g} nm apart; give sensitivities every {COARSEST:g} nm")


def _resampled(nm: np.ndarray, curves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Resample curves to steps of at most 1 nm within the daylight table."""
    area = np.abs(curves) * _trapezoid_weights(nm)[:, None]
    if (area[(nm < VISIBLE[0]) | (nm > VISIBLE[1])].sum(axis=0) > 0.02 * area.sum(axis=0)).any():
        raise CameraError(
            f"a channel has more than 2 % of its sensitivity outside {VISIBLE[0]:g} to {VISIBLE[1]:g} nm, where "
            "daylight is unknown; measure the camera with its infrared filter"
        )
    low = max(nm[0], VISIBLE[0])
    high = min(nm[-1], VISIBLE[1])
    fine = np.union1d(nm[(nm >= low) & (nm <= high)], np.arange(np.ceil(low), np.floor(high) + 1))
    return fine, np.stack([np.interp(fine, nm, curve) for curve in curves.T], axis=1)
