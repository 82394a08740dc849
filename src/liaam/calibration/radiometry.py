"""Estimate response, vignetting and exposures of a camera from images of one scene under one light.

A surface x emits light rho(x), and image i stores v_i(x). With the response f from stored values to light, the relative
light V at the distance r_i(x) from the centre, and the exposure e_i,

    log f(v_i(x)) - log V(r_i(x)) - log e_i = log rho(x)        for every image i,

after Kim and Pollefeys, "Robust radiometric calibration and vignetting correction" (PAMI 2008). The weighted mean over
the images eliminates log rho(x). Robust weighted least squares solve for the rest, with three precautions:

- Noise affects both sides of the equation, mostly in the dark. Blocks of pixels are averaged, weighted by
  1 / (noise times slope of log f), and log f is linearised about the value that the other images predict.
- (log f, log V, log e) times a constant is also a solution unless ratios of exposures are known (Grossberg and Nayar,
  "Determining the camera response from images: what is knowable?", PAMI 2003). The invariant angle does not change.
- A prior determines what images do not: the covariance of a family of realistic curves, in place of the EMoR basis
  (Grossberg and Nayar, "Modeling the space of camera response functions", PAMI 2004), plus a smooth Gaussian process.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.calibration.estimate import robust_deviation
from liaam.calibration.response_blocks import MeasuredBlocks, checked_maps, checked_pictures, observe
from liaam.calibration.response_fit import (
    LEAST_CONTRAST,
    LEAST_SCALE,
    LEAST_SHARE,
    MISFIT,
    OUTLYING,
    RANGE_SPREAD,
    TERM_SPREAD,
    TERMS,
    ResponseFit,
    ResponseProblem,
    ResponseTable,
    evenly_along,
    largest_difference,
    light_share,
    robust_weights,
    solve,
)
from liaam.error_measures import root_mean_square
from liaam.errors import CameraError
from liaam.photometry.camera import least_share
from liaam.photometry.response import Response, ResponseCurve

FEWEST = 20  # Least number of blocks of an image for an estimate
LEAST_RADII = 0.05  # Least difference of r^2 among them
POINTS = 33  # Number of points of the resulting curve
# Largest standard errors of an estimate: of log light over the observed stored values, of the relative light in the
# corners, and of log exposures
WIDEST_RESPONSE = 0.1
WIDEST_CORNER = 0.05
LOOSEST = 0.5
# Root mean square residual in log light, not explained by noise, above which an image is not a flat field
UNEVEN = 0.05
_NO_WALL = "Vignetting cannot be estimated:"
WHITE_WALL = "use an image of an evenly lit white wall, out of focus."


@dataclass(frozen=True)
class VignettingEstimate:
    """Estimate of the vignetting of a lens.

    Attributes
    ----------
    coefficients : tuple of float
        Coefficients of r^2, r^4, ... as in ``CameraModel.vignetting``; empty if not observable.
    corner, corner_error : float
        Relative light in the corners and its standard error; NaN if not observable.
    message : str
        The light in the corners and why it is known, or the missing data and the remedy.
    """

    coefficients: tuple[float, ...] = ()
    corner: float = float("nan")
    corner_error: float = float("nan")
    message: str = ""

    @property
    def observable(self) -> bool:
        """Whether the data determine the vignetting."""
        return bool(self.coefficients)


@dataclass(frozen=True)
class RadiometricEstimate:
    """Joint estimate of a camera's response, vignetting and exposures.

    Attributes
    ----------
    response : Response
        Common to the channels: a curve with f(1) = 1 if ``observable``, else the given or assumed response.
    response_errors : tuple of float
        Standard error of log light at each ``response.stored``, relative to the mean over the usable range, without the
        error of the power. Empty unless ``response`` was fitted.
    vignetting : VignettingEstimate
    log_exposures, log_exposure_errors : tuple of float
        Natural logarithm of each image's exposure relative to the first, and its standard error
        (0 if given).
    power_known : bool
        Whether ratios of exposures, or the response, were given. Otherwise response, vignetting and exposures are known
        up to a common power, f^g, V^g, e^g, and g is assumed. The invariant angle does not depend on g.
    rms : float
        Root mean square residual in log exposure.
    observable : bool
        Whether the data determine the response, or the exposures if the response was given.
    message : str
        Why it is observable, or the missing data and the remedy.
    stored_range : (float, float)
        Range of stored values that two images contain. Outside, the curve is that of the prior.
    """

    response: Response
    response_errors: tuple[float, ...] = ()
    vignetting: VignettingEstimate = VignettingEstimate()
    log_exposures: tuple[float, ...] = ()
    log_exposure_errors: tuple[float, ...] = ()
    power_known: bool = False
    rms: float = float("nan")
    observable: bool = False
    message: str = ""
    stored_range: tuple[float, float] = (float("nan"), float("nan"))


def calibrate_response(
    images: Sequence[np.ndarray],
    *,
    exposures: Sequence[float] | None = None,
    homographies: Sequence[np.ndarray] | None = None,
    response: Response | None = None,
    vignetting: bool = True,
) -> RadiometricEstimate:
    """Estimate response, vignetting and exposures from images of one scene under one light.

    An exposure series from a tripod determines the response. Overlapping images, registered by homographies, also
    determine vignetting. Use two or three exposures in steps of two to four, of a scene from black to white.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8, uint16 or float
        Stored values of two or more images of one camera, with the same aperture and focal length (which change
        vignetting). The white balance may vary by some per cent.
    exposures : sequence of float, optional
        Relative exposures (time times gain), of which only ratios matter; estimated by default.
    homographies : sequence of (3, 3) float, optional
        From each image's pixels to the first's. By default the images are assumed registered (tripod). Vignetting is
        then unobservable, since each surface has the same distance from the centre in all images.
    response : Response, optional
        Known response; then only vignetting and exposures are estimated.
    vignetting : bool
        Whether to estimate vignetting if it is observable; otherwise none is assumed.

    Returns
    -------
    RadiometricEstimate
        Its messages name the quantities that are not observable; the others are estimated without them.

    Raises
    ------
    CameraError
        If there are fewer than two images, or sizes, exposures or homographies are inconsistent.
    ImageError
        If an array is not an image.

    Examples
    --------
    >>> dark, bright = (np.full((64, 64, 3), value, np.uint8) for value in (60, 90))
    >>> calibrate_response([dark, bright], exposures=(1, 2)).observable  # two stored values do not define a curve
    False
    """
    pictures = checked_pictures(images)
    logs = None
    if exposures is not None:  # logarithms relative to the first
        values = np.asarray(exposures, dtype=np.float64)
        if values.shape != (len(pictures),) or not np.isfinite(values).all() or (values <= 0).any():
            fault = f"exposures {list(exposures)}: give one positive number for each of the {len(pictures)} images"
            raise CameraError(fault)
        logs = np.log(values / values[0])
    measured = observe(pictures, checked_maps(homographies, pictures))
    if unlinked := _unlinked(measured, logs, response):
        return unlinked
    lens_fault = _lens_fault(measured, vignetting)
    fit = solve(ResponseProblem(measured, logs, response, 0 if lens_fault else TERMS))
    if fault := _fit_fault(fit):
        fit = solve(replace(fit.problem, response=fit.problem.response or "srgb"))
    if not lens_fault and (lens_fault := _corner_fault(fit)):
        fit = solve(replace(fit.problem, terms=0))
    return _report(fit, fault, lens_fault)


def vignetting_from_flat_field(image: np.ndarray, response: Response = "srgb") -> VignettingEstimate:
    """Estimate vignetting from one image of an evenly lit, uniform surface: a white wall, the sky, a sheet of paper.

    A linear gradient of the light is estimated too; light that falls off in all directions counts as vignetting.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float
    response : Response

    Returns
    -------
    VignettingEstimate
    """
    from scipy.optimize import least_squares  # heavy: imported when first needed

    measured = observe(checked_pictures([image], fewest=1), [np.eye(3)], least=1)
    if measured.n < FEWEST:
        return VignettingEstimate(message=f"{_NO_WALL} too few blocks are uniform and well exposed; {WHITE_WALL}")
    curve = ResponseTable.of(response)
    radius2 = measured.radius2[0]
    log_light = curve.log_light(measured.stored[0])
    deviation = measured.deviation[0] * curve.slope(measured.stored[0])
    constants = np.equal.outer(measured.channel, np.unique(measured.channel)).astype(np.float64)
    tilted = np.concatenate([measured.offset, constants], axis=1)

    def residuals(z: np.ndarray) -> np.ndarray:
        rest = log_light - np.log(light_share(radius2, z[:TERMS])) - tilted @ z[TERMS:]
        return np.concatenate([rest / deviation, z[:TERMS] / TERM_SPREAD])

    start = np.concatenate([np.zeros(TERMS), np.linalg.lstsq(tilted, log_light, rcond=None)[0]])
    optimum = least_squares(residuals, start, loss="cauchy", f_scale=OUTLYING, x_scale="jac")
    standard = residuals(optimum.x)[: len(radius2)]
    scale = max(robust_deviation(standard), LEAST_SCALE)
    covariance = scale**2 * np.linalg.inv(optimum.jac.T @ optimum.jac)[:TERMS, :TERMS]
    rms = float(np.sqrt(np.average(np.square(standard * deviation), weights=robust_weights(standard / scale))))
    if scale > MISFIT and rms > UNEVEN:
        fault = f"the surface is not uniform (its light varies by {100 * rms:.0f} %)"
        return VignettingEstimate(message=f"{_NO_WALL} {fault}; {WHITE_WALL}")
    message = f"From {measured.n} blocks of an evenly lit surface; light falling off to all sides has the same effect."
    return _vignetting_estimate(optimum.x[:TERMS], covariance, message)


def _unlinked(
    measured: MeasuredBlocks, logs: np.ndarray | None, response: Response | None
) -> RadiometricEstimate | None:
    """Estimate without any observable quantity, if an image shares too few blocks with the others."""
    counts = [len(np.unique(measured.block[row])) for row in measured.usable]
    least = int(np.argmin(counts))
    if counts[least] >= FEWEST:
        return None
    fault = (
        f"Nothing can be estimated: image {least + 1} has {counts[least]} blocks (of {FEWEST} needed) that are well "
        "exposed and smooth in another image too; register the images, and use exposures that differ less."
    )
    unknown = (0.0, *[float("nan")] * (len(counts) - 1))
    return RadiometricEstimate(
        response="srgb" if response is None else response,
        vignetting=VignettingEstimate(message=fault),
        log_exposures=unknown if logs is None else tuple(logs.tolist()),
        log_exposure_errors=unknown if logs is None else (0.0,) * len(logs),
        message=fault,
    )


def _lens_fault(measured: MeasuredBlocks, wanted: bool) -> str:
    """Message if vignetting is not wanted, or the positions of the surfaces do not determine it, else empty."""
    if not wanted:
        return "Vignetting was not requested."
    if _radii(measured) >= LEAST_RADII:
        return ""
    return (
        "Vignetting cannot be estimated: each surface has the same distance from the centre in all images; "
        "turn the camera between them, or use an image of an evenly lit wall."
    )


def _radii(measured: MeasuredBlocks) -> float:
    """90th percentile over surfaces of the difference of r^2 between images."""
    return float(np.percentile(largest_difference(measured.radius2, measured.usable), 90))


def _corner_fault(fit: ResponseFit) -> str:
    """Message if the estimated vignetting is unusable, else an empty string."""
    if fit.is_inconsistent:
        return "Vignetting cannot be estimated: the images are inconsistent."
    if fit.corner_error <= WIDEST_CORNER and least_share(fit.problem.split(fit.z).vignetting) > LEAST_SHARE:
        return ""
    return (
        f"Vignetting cannot be estimated: the relative light in the corners has a standard error of "
        f"{fit.corner_error:.2f}; turn the camera further, so that surfaces move from the centre to the corners."
    )


def _fit_fault(fit: ResponseFit) -> str:
    """Message if the response (or the exposures, for a given response) is not observable, else an empty string."""
    if fit.is_inconsistent:
        return (
            f"Nothing can be estimated: the images are inconsistent by a factor of {np.exp(fit.rms):.2f}; check that "
            "they are registered and taken under one light, and that the given exposures or response are correct."
        )
    if fit.log_errors.max() > LOOSEST:
        return (
            f"The exposures cannot be estimated: nothing links image {int(np.argmax(fit.log_errors)) + 1} to the "
            "first; use images that overlap in a chain."
        )
    if fit.problem.response is not None:
        return ""
    if fit.contrast < LEAST_CONTRAST:
        return (
            f"The response cannot be estimated: the exposures hardly differ (by {100 * fit.contrast:.0f} %); take "
            "images at one, two and four times an exposure. sRGB is assumed."
        )
    low, high = _held(fit.problem.measured)
    error = root_mean_square(fit.curve_errors(np.linspace(low, high, 100)))
    if error <= WIDEST_RESPONSE:
        return ""
    return (
        f"The response cannot be estimated: log light has a standard error of {error:.2f}; take images at one, "
        "two and four times an exposure, of a scene with dark and bright parts. sRGB is assumed."
    )


def _held(measured: MeasuredBlocks) -> tuple[float, float]:
    """Range of nearly all stored values."""
    low, high = np.percentile(measured.stored[measured.usable], [0.5, 99.5])
    return float(low), float(high)


def _report(fit: ResponseFit, fault: str, lens_fault: str) -> RadiometricEstimate:
    problem = fit.problem
    measured = fit.problem.measured
    curve = problem.curve(fit.z)
    logs = problem.logs(fit.z)
    falloff = problem.split(fit.z).vignetting
    lens = VignettingEstimate(message=lens_fault)
    if problem.terms:
        covariance = fit.covariance[-problem.terms :, -problem.terms :]
        message = f"The distances of surfaces from the centre differ by up to {_radii(measured):.2f} in r^2."
        lens = _vignetting_estimate(falloff, covariance, message)
    response = problem.response
    response_errors = ()
    if response is None:
        stored = evenly_along(POINTS)
        light = np.exp(curve.log_light(stored) - curve.light[-1])
        response = ResponseCurve(tuple(stored.tolist()), tuple(light.tolist()))
        response_errors = tuple(fit.curve_errors(stored).tolist())
    low, high = held = _held(measured)
    facts = (
        f"From {measured.n} blocks with stored values of {255 * low:.0f} to {255 * high:.0f} (of 255) at exposures "
        f"that differ by a factor of {np.exp(fit.contrast):.2f}."
    )
    if not problem.power_known:
        facts += (
            " No ratio of exposures is known, so response, vignetting and exposures are known up to a common power, "
            f"which is assumed (to about {100 * RANGE_SPREAD:.0f} %); the invariant angle does not depend on it."
        )
    if fit.scale > MISFIT:
        facts += (
            f" Residuals are {fit.scale:.0f} times the noise: check for strong JPEG compression, registration errors, "
            "or different lights."
        )
    return RadiometricEstimate(
        response=response,
        response_errors=response_errors,
        vignetting=lens,
        log_exposures=tuple(logs.tolist()),
        log_exposure_errors=tuple(fit.log_errors.tolist()),
        power_known=problem.power_known and not fault,
        rms=fit.rms,
        observable=not fault,
        message=fault or facts,
        stored_range=held,
    )


def _vignetting_estimate(falloff: np.ndarray, covariance: np.ndarray, message: str) -> VignettingEstimate:
    if least_share(falloff) <= LEAST_SHARE:
        fault = "less than a tenth of the light would remain in the corners"
        return VignettingEstimate(message=f"{_NO_WALL} {fault}; {WHITE_WALL}")
    corner = 1.0 + float(falloff.sum())
    corner_error = float(np.sqrt(covariance.sum()))
    message = f"the corners receive {corner:.1%} ± {corner_error:.1%} of the light. {message}"
    return VignettingEstimate(tuple(falloff.tolist()), corner, corner_error, message)
