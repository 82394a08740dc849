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
MOST_INVISIBLE = 0.02  # Largest share of a sensitivity outside the daylight table
NORMAL = 560.0  # Wavelength at which the powers of radiators are normalised, nm, as CIE does with daylights
FEWEST_LIGHTS = 8  # Least number of lights of a series, however narrow

# Coloured surfaces: reflectances of moderate saturation with one low frequency, in so many phases
N_HUES = 8
HUE_PERIOD = 250.0  # nm
HUE_AMPLITUDE = 0.25

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
    are_falling = peaks.shape == (3,) and np.isfinite(peaks).all() and (np.diff(peaks) < 0).all()
    if not are_falling or peaks[0] > VISIBLE[1] or peaks[2] < VISIBLE[0]:
        raise CameraError(
            f"peak wavelengths {peaks_nm}: give those of R, G and B in nm, longest first, such as 610, 540, 450"
        )
    theta = wien_theta(peaks)
    nm = np.arange(VISIBLE[0], VISIBLE[1] + 1)
    broad = theta_from_sensitivities(nm, np.exp(-0.5 * np.square((nm[:, None] - peaks) / SENSOR_WIDTH)))
    moved = [wien_theta(peaks + offset) for offset in PEAK_OFFSET * np.eye(3)]  # one peak after the other
    differences = [axis_difference(angle, theta) for angle in (broad.theta, *moved)]
    error = float(np.linalg.norm([broad.standard_error, *differences]))
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
    log_responses = _log_responses(nm, curves, _series(nm, lights, kelvin))
    of_white = {name: logs[0] for name, logs in log_responses.items()}
    theta = _angle_of(list(of_white.values()))
    # The cold and the hot lights of each surface show the curvature of its locus.
    differences = []
    for logs in log_responses.values():
        middle = logs.shape[1] // 2
        for locus in logs:
            for half in (locus[: middle + 1], locus[middle:]):
                differences.append(axis_difference(_angle_of([half]), theta))
    error = root_mean_square(differences)
    angles = [f"{np.rad2deg(_angle_of([locus])):.1f}° under the {name} series" for name, locus in of_white.items()]
    message = (
        f"white has {' and '.join(angles)}, {kelvin[0]:.0f} to {kelvin[1]:.0f} K; the error of "
        f"{np.rad2deg(error):.1f}° is the spread between surfaces and between lights, since broad sensors do not have "
        "a single angle"
    )
    warmth = np.concatenate([locus[:, 0] - locus[:, 2] for locus in of_white.values()])  # log R / B
    change = float(np.sqrt(2.0) * np.std(warmth, ddof=1))  # the root mean square difference of two lights
    n_surfaces = len(next(iter(log_responses.values())))
    return AngleEstimate(theta, error, message, change, n_surfaces)


def _log_responses(nm: np.ndarray, curves: np.ndarray, series: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute the log responses of a camera with sensitivities (n, 3) to surfaces under series of lights, each (m, n).

    Return (k, m, 3) for each series: of a neutral surface, and of the coloured ones to which all channels respond.
    """
    # Frequency-limited reflectances after Stiles, Wyszecki and Ohta (JOSA 1977).
    phases = np.arange(N_HUES)[:, None] / N_HUES
    hues = 0.5 + HUE_AMPLITUDE * np.cos(2 * np.pi * (nm / HUE_PERIOD - phases))
    surfaces = np.vstack([np.ones_like(nm), hues])
    weighted = curves * _trapezoid_weights(nm)[:, None]
    responses = {
        name: np.einsum("kn,mn,nc->kmc", surfaces, power, weighted, optimize=True) for name, power in series.items()
    }
    are_responsive = np.all([(values > 0).all(axis=(1, 2)) for values in responses.values()], axis=0)
    if not are_responsive[0]:
        raise CameraError(
            "a channel does not respond to white light: its sensitivity is zero or mostly negative; check the curves"
        )
    return {name: np.log(values[are_responsive]) for name, values in responses.items()}


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
    red = _mean_wavelength(nm, curves[:, 0])
    blue = _mean_wavelength(nm, curves[:, 2])
    if red <= blue:
        raise CameraError(
            f"{path}: R has a shorter mean wavelength ({red:.0f} nm) than B ({blue:.0f} nm); name the columns in a "
            "header line such as wavelength_nm,R,G,B"
        )
    return nm, curves


def _mean_wavelength(nm: np.ndarray, curve: np.ndarray) -> float:
    """Return the mean wavelength of a sensitivity (n,), weighted by that, without its negative values."""
    positive = np.maximum(curve, 0)
    return float(nm @ positive / positive.sum())


def planckian(wavelengths_nm: np.ndarray, kelvin: np.ndarray | float, *, wien: bool = False) -> np.ndarray:
    """Compute the spectral power (m, n) of Planckian radiators, 1 at 560 nm; ``wien``: by Wien's approximation.

    It is proportional to nm^-5 / (exp(K2 / (nm T)) - 1), by Wien without the 1, at wavelength nm and temperature T.
    """
    nm = np.asarray(wavelengths_nm, dtype=np.float64)
    k2_by_kelvin = K2_NM / np.atleast_1d(kelvin)[:, None]
    if wien:
        ratio = np.exp(k2_by_kelvin / NORMAL - k2_by_kelvin / nm)
    else:
        ratio = np.expm1(k2_by_kelvin / NORMAL) / np.expm1(k2_by_kelvin / nm)
    return ratio * (NORMAL / nm) ** 5


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
    cold = float(kelvin[0])
    hot = float(kelvin[1])
    if not 1000.0 <= cold < hot <= 25000.0:
        raise CameraError(f"lights from {cold:g} to {hot:g} K: give the colder first, within 1000 to 25000 K")

    def even_in_mired(coldest: float) -> np.ndarray:
        """Temperatures to the hottest, kelvin, that are evenly spaced in reciprocal megakelvin."""
        n_steps = round((1e6 / coldest - 1e6 / hot) / MIRED_STEP)
        return 1e6 / np.linspace(1e6 / coldest, 1e6 / hot, max(FEWEST_LIGHTS, n_steps + 1))

    if lights in ("planckian", "wien"):
        return {lights: planckian(nm, even_in_mired(cold), wien=lights == "wien")}
    if max(cold, COLDEST_DAYLIGHT) >= hot:
        raise CameraError(f"there is no CIE daylight from {cold:g} to {hot:g} K; give lights='planckian'")
    of_day = daylight(nm, even_in_mired(max(cold, COLDEST_DAYLIGHT)))
    if lights == "daylight":
        return {"daylight": of_day}
    return {"planckian": planckian(nm, even_in_mired(cold)), "daylight": of_day}


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
    theta = float(np.arctan2(row[1], row[0]) % np.pi)
    return theta % float(np.pi)  # again: a tiny negative angle has become pi by rounding


def _check_curves(nm: np.ndarray, curves: np.ndarray) -> None:
    """Raise if sensitivity curves are invalid."""
    if nm.ndim != 1 or curves.shape != (len(nm), 3) or len(nm) < FEWEST:
        raise CameraError(
            f"wavelengths of shape {nm.shape} and sensitivities of shape {curves.shape}: give (n,) and (n, 3), of "
            f"{FEWEST} wavelengths or more"
        )
    if not np.isfinite(nm).all() or not np.isfinite(curves).all():
        raise CameraError("a wavelength or sensitivity is not a finite number; fill the gap or remove its row")
    steps = np.diff(nm)
    if (steps <= 0).any():
        first_wrong = nm[1:][steps <= 0][0]
        raise CameraError(f"wavelength {first_wrong:g} is not in order; give each once, shortest first")
    if nm[0] < 100 or nm[-1] > 3000:
        raise CameraError(f"wavelengths from {nm[0]:g} to {nm[-1]:g} are not in nm; visible light has 380 to 780 nm")
    for name, curve in zip("RGB", curves.T, strict=True):
        if curve.max() <= 0:
            raise CameraError(f"channel {name} has no sensitivity above 0; check the columns")
    if (steps > COARSEST).any():
        raise CameraError(f"wavelengths are {steps.max():g} nm apart; give sensitivities every {COARSEST:g} nm")


def _resampled(nm: np.ndarray, curves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Resample curves to steps of at most 1 nm within the daylight table."""
    area = np.abs(curves) * _trapezoid_weights(nm)[:, None]
    is_invisible = (nm < VISIBLE[0]) | (nm > VISIBLE[1])
    if (area[is_invisible].sum(axis=0) > MOST_INVISIBLE * area.sum(axis=0)).any():
        raise CameraError(
            f"a channel has more than {100 * MOST_INVISIBLE:g} % of its sensitivity outside {VISIBLE[0]:g} to "
            f"{VISIBLE[1]:g} nm, where daylight is unknown; measure the camera with its infrared filter"
        )
    low = max(nm[0], VISIBLE[0])
    high = min(nm[-1], VISIBLE[1])
    fine = np.union1d(nm[(nm >= low) & (nm <= high)], np.arange(np.ceil(low), np.floor(high) + 1))
    return fine, np.stack([np.interp(fine, nm, curve) for curve in curves.T], axis=1)
