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
from functools import lru_cache

import numpy as np

from liaam.calibration.statistics import robust_deviation
from liaam.errors import CameraError
from liaam.evaluation import root_mean_square
from liaam.photometry.camera import falloff_at, least_share, squared_radius
from liaam.photometry.encoding import DARK, SATURATED, as_colour, is_grey, stored_values
from liaam.photometry.invariant import CHROMATICITY
from liaam.photometry.noise import noise_deviation
from liaam.photometry.response import Response, ResponseCurve, to_linear

LOWEST = 6 / 255  # Stored value at which the fitted curve starts; below it continues as a power law
# The curve is a spline of log((v + toe) / (top - v)), which resolves dark values and the shoulder finely
TOE, TOP = 0.02, 1.1
KNOTS = 17  # Number of equidistant knots of the spline
# Standard deviation (of log light) and correlation length (along the curve) of the prior's Gaussian process
SMOOTH, REACH = 0.3, 0.35
# Assumed range of log light between the stored values 8 and 250 if the power is unknown, and its relative standard
# deviation: sRGB has 6.0, a gamma of 2.2 has 7.6
USUAL_RANGE, RANGE_SPREAD = 6.6, 0.15
TERMS = 3  # Number of vignetting coefficients: r^2, r^4, r^6
# Prior standard deviations of a vignetting coefficient, and of the logs of an image's white balance and exposure
TERM_SPREAD, BALANCE_SPREAD, EXPOSURE_SPREAD = 0.5, 0.1, 5.0
BLOCK = 8  # Side of the blocks that are averaged, pixels; up to twice as large in large images
MOST_BLOCKS = 4000  # Largest number of blocks
# Largest relative standard deviation within a block, since averaging of stored values is not linear in light
TEXTURE = 0.05
# Fraction of the standard deviation within a block that counts as noise, for small registration errors
UNREGISTERED = 0.03
OUTLYING = 4.0  # Residual, in standard deviations, at which the weight is a quarter

MOST_STEPS = 40

# Lower bounds of the curve's increments, of the scale of the residuals, and of the relative light
LEAST_INCREMENT, LEAST_SCALE, LEAST_SHARE = 1e-3, 0.3, 0.1
EXACT = 1e-4  # Standard deviation of the assumed range of log light if the power is unknown
POINTS = 33  # Number of points of the resulting curve
# Least number of blocks of an image, difference of log exposures, and difference of r^2, for an estimate
FEWEST, LEAST_CONTRAST, LEAST_RADII = 20, 0.1, 0.05
# Largest standard errors of an estimate: of log light over the observed stored values, of the relative light in the
# corners, and of log exposures
WIDEST_RESPONSE, WIDEST_CORNER, LOOSEST = 0.1, 0.05, 0.5
# Largest residuals in log exposure of an estimate, if noise does not explain them and if it does
WORST_RMS, WORST_NOISE = 0.06, 0.3
# Standard error of log light and exposure by mixed light in blocks and clipped noise, from simulations
SYSTEMATIC = 1.5e-3
MISFIT = 4.0  # Ratio of residuals to noise above which noise does not explain them; JPEG of quality 75 gives 4 to 6
# Root mean square residual in log light, not explained by noise, above which an image is not a flat field
UNEVEN = 0.05

WHITE_WALL = "use an image of an evenly lit white wall, out of focus."


@dataclass(frozen=True)
class VignettingEstimate:
    """Estimate of the vignetting of a lens.

    Attributes
    ----------
    coefficients : tuple of float
        Coefficients of r^2, r^4, ... as in ``CameraModel.vignetting``; empty if not observable.
    standard_errors : tuple of float
        Standard errors of the coefficients, which are strongly correlated.
    corner, corner_error : float
        Relative light in the corners and its standard error; NaN if not observable.
    observable : bool
        Whether the data determine the vignetting.
    message : str
        Why it is observable, or the missing data and the remedy.
    rms : float
        Root mean square residual in log light; NaN if nothing was fitted.
    n : int
        Number of blocks used.
    """

    coefficients: tuple[float, ...] = ()
    standard_errors: tuple[float, ...] = ()
    corner: float = float("nan")
    corner_error: float = float("nan")
    observable: bool = False
    message: str = ""
    rms: float = float("nan")
    n: int = 0


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
    power_error : float
        Relative standard error of the power.
    rms : float
        Root mean square residual in log exposure.
    observable : bool
        Whether the data determine the response, or the exposures if the response was given.
    message : str
        Why it is observable, or the missing data and the remedy.
    stored_range : (float, float)
        Range of stored values that two images contain. Outside, the curve is that of the prior.
    n : int
        Number of blocks in two or more images.
    """

    response: Response
    response_errors: tuple[float, ...] = ()
    vignetting: VignettingEstimate = VignettingEstimate()
    log_exposures: tuple[float, ...] = ()
    log_exposure_errors: tuple[float, ...] = ()
    power_known: bool = False
    power_error: float = RANGE_SPREAD
    rms: float = float("nan")
    observable: bool = False
    message: str = ""
    stored_range: tuple[float, float] = (float("nan"), float("nan"))
    n: int = 0


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
    pictures = _checked(images)
    logs = _log_ratios(exposures, len(pictures))
    measured = _observe(pictures, _maps(homographies, pictures))
    if fault := _overlap_fault(measured):
        return _nothing(measured, logs, response, fault)
    lens_fault = _lens_fault(measured, vignetting)
    fit = _solve(_Problem(measured, logs, response, 0 if lens_fault else TERMS))
    if fault := _fit_fault(fit):
        fit = _solve(replace(fit.problem, response=fit.problem.response or "srgb"))
    if not lens_fault and (lens_fault := _corner_fault(fit)):
        fit = _solve(replace(fit.problem, terms=0))
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

    measured = _observe(_checked([image], fewest=1), [np.eye(3)], least=1)
    if measured.n < FEWEST:
        message = f"Vignetting cannot be estimated: too few blocks are uniform and well exposed; {WHITE_WALL}"
        return VignettingEstimate(message=message, n=measured.n)
    curve, radius2 = _Curve.of(response), measured.radius2[0]
    log_light = curve.log_light(measured.stored[0])
    deviation = measured.deviation[0] * curve.slope(measured.stored[0])
    constants = np.equal.outer(measured.channel, np.unique(measured.channel)).astype(np.float64)
    tilted = np.concatenate([measured.offset, constants], axis=1)

    def residuals(z: np.ndarray) -> np.ndarray:
        rest = log_light - np.log(_share(radius2, z[:TERMS])) - tilted @ z[TERMS:]
        return np.concatenate([rest / deviation, z[:TERMS] / TERM_SPREAD])

    start = np.concatenate([np.zeros(TERMS), np.linalg.lstsq(tilted, log_light, rcond=None)[0]])
    found = least_squares(residuals, start, loss="cauchy", f_scale=OUTLYING, x_scale="jac")
    standard = residuals(found.x)[: len(radius2)]
    scale = max(robust_deviation(standard), LEAST_SCALE)
    covariance = scale**2 * np.linalg.inv(found.jac.T @ found.jac)[:TERMS, :TERMS]
    rms = float(np.sqrt(np.average(np.square(standard * deviation), weights=_robust(standard / scale))))
    if scale > MISFIT and rms > UNEVEN:
        fault = f"the surface is not uniform (its light varies by {100 * rms:.0f} %)"
        return VignettingEstimate(message=f"Vignetting cannot be estimated: {fault}; {WHITE_WALL}", n=measured.n)
    message = f"From {measured.n} blocks of an evenly lit surface; light falling off to all sides has the same effect."
    return _vignetting_estimate(found.x[:TERMS], covariance, message, rms, measured.n)


# --- measurements -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Measurements:
    """Measurements of n blocks of one channel each in m images.

    Stored values (m, n) in [0, 1], their standard deviations, and squared distances from the centre, 1 in the corners.
    Offsets (n, 2) are positions in the first image relative to its centre, in units of half the diagonal.
    """

    stored: np.ndarray
    deviation: np.ndarray
    usable: np.ndarray
    radius2: np.ndarray
    offset: np.ndarray
    channel: np.ndarray
    block: np.ndarray

    @property
    def n(self) -> int:
        """Number of blocks."""
        return len(np.unique(self.block))

    def over_channels(self, values: np.ndarray) -> np.ndarray:
        """Root mean square (m, n) of values (m, n) over a block's channels, since moved blocks move in all three."""
        count = np.bincount(self.block)
        sums = np.stack([np.bincount(self.block, weights=np.square(row)) for row in values])
        return np.sqrt(sums / np.maximum(count, 1))[:, self.block]


def _checked(images: Sequence[np.ndarray], fewest: int = 2) -> list[np.ndarray]:
    pictures = [as_colour(image, f"image {i + 1}") for i, image in enumerate(images)]
    if len(pictures) < fewest:
        raise CameraError(f"there are too few images ({len(pictures)}); a response needs two or more of one scene")
    # Grey images have one channel of information.
    return [picture[..., :1] for picture in pictures] if all(map(is_grey, pictures)) else pictures


def _log_ratios(exposures: Sequence[float] | None, count: int) -> np.ndarray | None:
    """Logarithms of the exposures relative to the first."""
    if exposures is None:
        return None
    values = np.asarray(exposures, dtype=np.float64)
    if values.shape != (count,) or not np.isfinite(values).all() or (values <= 0).any():
        raise CameraError(f"exposures {list(exposures)}: give one positive number for each of the {count} images")
    return np.log(values / values[0])


def _maps(homographies: Sequence[np.ndarray] | None, pictures: list[np.ndarray]) -> list[np.ndarray]:
    if homographies is None:
        if len({picture.shape for picture in pictures}) > 1:
            raise CameraError("the images differ in size; give homographies, or images from one tripod")
        return [np.eye(3)] * len(pictures)
    maps = [np.asarray(h, dtype=np.float64) for h in homographies]
    if len(maps) != len(pictures) or any(h.shape != (3, 3) or not np.isfinite(h).all() for h in maps):
        raise CameraError(f"give one 3×3 homography for each of the {len(pictures)} images, to the first's pixels")
    if any(np.linalg.cond(h) > 1e12 for h in maps):
        raise CameraError("a homography cannot be inverted; give maps from each image's pixels to the first's")
    if not np.allclose(maps[0] / maps[0][2, 2], np.eye(3), atol=1e-6):
        raise CameraError("the first image's homography must be the identity, since all map to its pixels")
    return maps


def _observe(pictures: list[np.ndarray], maps: list[np.ndarray], least: int = 2) -> _Measurements:
    """Average blocks of the first image's pixels in all images; keep those that are usable in ``least`` of them."""
    height, width = pictures[0].shape[:2]
    edge = int(np.clip(np.sqrt(height * width / MOST_BLOCKS), min(BLOCK, height // 8, width // 8), 2 * BLOCK))
    parts = [_observe_one(p, m, (height, width), edge) for p, m in zip(pictures, maps, strict=True)]
    stored, deviation, usable, radius2 = np.stack(parts, axis=1)
    y, x, channel = np.mgrid[: stored.shape[1], : stored.shape[2], : stored.shape[3]]
    offset = np.stack([x - x.max() / 2, y - y.max() / 2], axis=-1) / np.hypot(x.max() / 2, y.max() / 2)
    kept = (usable.sum(axis=0) >= least).ravel()
    block = np.arange(kept.size) // stored.shape[3]
    kept &= block % (len(np.unique(block[kept])) // MOST_BLOCKS + 1) == 0
    stored, deviation, usable, radius2 = (
        part.reshape(len(pictures), -1)[:, kept] for part in (stored, deviation, usable > 0, radius2)
    )
    offset, channel = offset.reshape(-1, 2)[kept], channel.ravel()[kept]
    return _Measurements(stored, deviation, usable, radius2, offset, channel, block[kept])


def _observe_one(picture: np.ndarray, to_first: np.ndarray, size: tuple[int, int], edge: int) -> np.ndarray:
    """Mean of blocks, its deviation, whether it is usable, and squared radius, (4, rows, columns, channels)."""
    import cv2  # heavy: imported when first needed

    height, width = size
    rows, columns = height // edge, width // edge
    is_moved = not np.allclose(to_first, np.eye(3)) or picture.shape[:2] != size

    def block_mean(values: np.ndarray) -> np.ndarray:
        if is_moved:
            values = cv2.warpPerspective(values, to_first, (width, height), flags=cv2.INTER_LINEAR)
        cut = values[: rows * edge, : columns * edge]
        mean = cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA)
        return mean.reshape(rows, columns, -1).astype(np.float64)

    # Centred, since the variance is a small difference of large float32 numbers.
    values = stored_values(picture)
    noise = noise_deviation(picture)
    mean = block_mean(values)
    texture = np.sqrt(np.maximum(block_mean(np.square(values - 0.5)) - np.square(mean - 0.5) - noise**2, 0.0))
    is_inside = block_mean(np.ones(picture.shape[:2], np.float32)) > 0.999
    is_clipped = block_mean(((values <= 0) | (values >= 1)).astype(np.float32)) > 0.02
    usable = is_inside & ~is_clipped & (mean >= DARK) & (mean <= SATURATED) & (texture <= TEXTURE * mean + noise)
    deviation = np.sqrt(noise**2 / edge**2 + (UNREGISTERED * texture) ** 2 + (0.1 / 255) ** 2)
    y, x = np.mgrid[:rows, :columns] * edge + (edge - 1) / 2
    there = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(to_first).T
    radius2 = squared_radius(there[..., 0] / there[..., 2], there[..., 1] / there[..., 2], *picture.shape[:2])
    return np.stack([mean, deviation, usable, np.broadcast_to(radius2[..., None], mean.shape)])


# --- the response as a curve ------------------------------------------------------------------------------------------


def _axis(stored: np.ndarray) -> np.ndarray:
    return np.log((stored + TOE) / (TOP - stored))


def _evenly(count: int) -> np.ndarray:
    """Stored values (count,) from the lowest to 1, equidistant along the curve."""
    low, high = _axis(np.array([LOWEST, 1.0])).tolist()
    ratio = np.exp(np.linspace(low, high, count))
    return np.clip((TOP * ratio - TOE) / (1.0 + ratio), LOWEST, 1.0)


def _knots() -> np.ndarray:
    return np.pad(_axis(_evenly(KNOTS)), 3, mode="edge")


def _increments(stored: np.ndarray) -> np.ndarray:
    """Integrated B-splines (..., J) of stored values; a curve with positive coefficients is increasing."""
    from scipy.interpolate import BSpline  # heavy: imported when first needed

    knots = _knots()
    axis = np.clip(_axis(stored.ravel()), knots[0], knots[-1])
    splines = BSpline.design_matrix(axis, knots, 3).toarray()
    return np.cumsum(splines[:, ::-1], axis=1)[:, ::-1][:, 1:].reshape(*stored.shape, -1)


@dataclass(frozen=True)
class _Curve:
    """Table of the logarithm of light by stored value: (k,) each, increasing."""

    stored: np.ndarray
    light: np.ndarray

    @classmethod
    def of(cls, response: "Response | np.ndarray") -> "_Curve":
        """Tabulate a response, or a curve with given increments (J,)."""
        stored = _evenly(1500)
        if isinstance(response, np.ndarray):
            return cls(stored, _increments(stored) @ response)
        return cls(stored, np.log(np.asarray(to_linear(stored, response), dtype=np.float64)))

    def log_light(self, stored: np.ndarray) -> np.ndarray:
        return np.interp(stored, self.stored, self.light)

    def slope(self, stored: np.ndarray) -> np.ndarray:
        return np.interp(stored, self.stored, np.gradient(self.light, self.stored))

    def stored_of(self, log_light: np.ndarray) -> np.ndarray:
        return np.interp(log_light, self.light, self.stored)


@lru_cache(maxsize=1)
def _prior() -> tuple[np.ndarray, np.ndarray]:
    """Prior mean (J,) and covariance (J, J) of increments: tone curves v + v (1 - v) q(v), q quadratic, and powers."""
    stored = _evenly(300)
    levels = np.linspace(-0.6, 0.6, 5)
    toned = [
        stored * (1 + (1 - stored) * (a + b * stored + c * stored**2)) for a in levels for b in levels for c in levels
    ]
    rising = [np.log(tone) for tone in toned if (np.diff(tone) > 0.1 * np.diff(stored)).all()]
    curves = np.stack([gamma * curve for curve in rising for gamma in (1.0, 1.8, 2.2, 2.6)], axis=1)
    design = _increments(stored)
    family = np.linalg.lstsq(design - design.mean(axis=0), curves - curves.mean(axis=0), rcond=None)[0]
    knots = _knots()
    centres = np.array([knots[j + 1 : j + 4].mean() for j in range(design.shape[1] + 1)])
    along = (centres - centres[0]) / (centres[-1] - centres[0])
    smooth = SMOOTH**2 * np.exp(-0.5 * np.square((along[:, None] - along) / REACH)) + 1e-6 * np.eye(len(along))
    return family.mean(axis=1), np.cov(family) + np.diff(np.diff(smooth, axis=0), axis=1)


# --- the joint estimate -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Problem:
    """The problem; its unknowns z (P,) are the free increments, exposures, white balances and vignetting coefficients.

    Log exposures (m,) and the response may be given; ``terms`` is the number of vignetting coefficients.
    """

    measured: _Measurements
    known_logs: np.ndarray | None
    response: Response | None
    terms: int

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Numbers of free increments, exposures, white balances and vignetting coefficients."""
        increments = 0 if self.response is not None else len(_prior()[0])
        others = len(self.measured.stored) - 1
        colours = 2 * others if self.measured.channel.any() else 0
        return increments, 0 if self.known_logs is not None else others, colours, self.terms

    @property
    def power_known(self) -> bool:
        logs = self.known_logs
        return self.response is not None or (logs is not None and float(np.ptp(logs)) >= LEAST_CONTRAST)

    def split(self, z: np.ndarray) -> list[np.ndarray]:
        """Split z into increments, exposures, white balances and vignetting coefficients."""
        return np.split(z, np.cumsum(self.sizes)[:-1])

    def curve(self, z: np.ndarray) -> _Curve:
        return _Curve.of(self.split(z)[0] if self.response is None else self.response)

    def logs(self, z: np.ndarray) -> np.ndarray:
        """Log exposures (m,)."""
        return np.concatenate([[0.0], self.split(z)[1]]) if self.known_logs is None else self.known_logs

    def exposure(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log of the factor of each block's light in each image (m, n), and its derivative by z (m, n, P)."""
        measured, (curve, logs, colours, falloff) = self.measured, self.split(z)
        m, n = measured.stored.shape
        share = _share(measured.radius2, falloff)
        others = np.eye(m)[:, None, 1:]
        by_log = np.broadcast_to(others, (m, n, m - 1))[..., : len(logs)]
        by_colour = np.einsum("mop,nc->mnpc", others, CHROMATICITY.T[measured.channel]).reshape(m, n, -1)
        by_colour = by_colour[..., : len(colours)]
        by_falloff = np.stack([measured.radius2 ** (i + 1) for i in range(TERMS)], axis=-1)[..., : self.terms]
        by_falloff = by_falloff / share[..., None]
        value = self.logs(z)[:, None] + by_colour @ colours + np.log(share)
        return value, np.concatenate([np.zeros((m, n, len(curve))), by_log, by_colour, by_falloff], axis=-1)

    def linearised(self, z: np.ndarray, about: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linearise log radiance about stored values and the last z, as known (m, n) + design (m, n, P) @ z.

        log f(v) = log f(about) + (log f)'(about) (v - about), with the derivative of the last curve.
        """
        curve, (exposure, derivative) = self.curve(z), self.exposure(z)
        known = curve.slope(about) * (self.measured.stored - about) - exposure + derivative @ z
        design = -derivative
        if self.response is None:
            design[..., : self.sizes[0]] += _increments(about)
        else:
            known += curve.log_light(about)
        return design, known

    def start(self) -> np.ndarray:
        return np.concatenate([_prior()[0][: self.sizes[0]], np.zeros(sum(self.sizes[1:]))])

    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Whitened rows (k, P) and values (k,) of the prior, which fixes the power if ratios are unknown."""
        mean, covariance = _prior()
        curve, exposures, colours, terms = self.sizes
        spreads = np.repeat([EXPOSURE_SPREAD, BALANCE_SPREAD, TERM_SPREAD], [exposures, colours, terms])
        rows = np.diag(np.concatenate([np.zeros(curve), 1.0 / spreads]))
        values = np.zeros(len(rows))
        if not curve:
            return rows, values
        rows[:curve, :curve] = np.linalg.inv(np.linalg.cholesky(covariance))
        values[:curve] = rows[:curve, :curve] @ mean
        if self.power_known:
            return rows, values
        span = np.diff(_increments(np.array([DARK, SATURATED])), axis=0)
        span = np.pad(span, ((0, 0), (0, len(rows) - curve)))
        return np.concatenate([rows, span / EXACT]), np.append(values, USUAL_RANGE / EXACT)


def _share(radius2: np.ndarray, falloff: np.ndarray) -> np.ndarray:
    """Relative light with vignetting, bounded below during the iteration."""
    return np.maximum(falloff_at(radius2, falloff), LEAST_SHARE)


@dataclass(frozen=True)
class _Fit:
    """A solution, with the robust standard deviation of its residuals in units of the noise, and in log exposure."""

    problem: _Problem
    z: np.ndarray
    covariance: np.ndarray
    scale: float
    rms: float

    @property
    def log_errors(self) -> np.ndarray:
        """Standard errors (m,) of the log exposures, 0 if given."""
        free = np.sqrt(self.problem.split(np.diag(self.covariance))[1] + SYSTEMATIC**2)
        return np.concatenate([[0.0], free]) if len(free) else np.zeros(len(self.problem.measured.stored))

    @property
    def corner_error(self) -> float:
        terms = self.problem.terms
        return float(np.sqrt(self.covariance[len(self.z) - terms :, len(self.z) - terms :].sum()))

    @property
    def is_inconsistent(self) -> bool:
        return self.rms > (WORST_RMS if self.scale > MISFIT else WORST_NOISE)

    @property
    def contrast(self) -> float:
        """Root mean square difference of the surfaces' log exposures."""
        spread = _spread(self.problem.exposure(self.z)[0], self.problem.measured.usable)
        return root_mean_square(spread)

    def curve_errors(self, stored: np.ndarray) -> np.ndarray:
        """Standard errors of log light relative to its mean over the usable range."""
        size = self.problem.sizes[0]
        rows = _increments(stored) - _increments(np.linspace(DARK, SATURATED, 100)).mean(axis=0)
        return np.sqrt(np.einsum("ij,jk,ik->i", rows, self.covariance[:size, :size], rows) + SYSTEMATIC**2)


def _solve(problem: _Problem) -> _Fit:
    """Compute the joint robust estimate by linearised, iteratively reweighted least squares."""
    measured, z = problem.measured, problem.start()
    prior_rows, prior_values = problem.prior()
    about, robust, scale, gram, rms = measured.stored, np.ones_like(measured.stored), 1.0, np.zeros((0, 0)), 0.0
    for _ in range(MOST_STEPS):
        noise = measured.deviation * problem.curve(z).slope(about)
        weight = measured.usable * robust / np.square(noise)
        own = weight / weight.sum(axis=0)
        design, known = problem.linearised(z, about)
        # Eliminate the log radiance of the surfaces, the weighted mean over images.
        design_rest = design - np.einsum("mn,mnp->np", own, design)
        known_rest = known - np.einsum("mn,mn->n", own, known)
        root = np.sqrt(weight) / scale
        rows = np.concatenate([(design_rest * root[..., None]).reshape(known.size, len(z)), prior_rows])
        values = np.concatenate([-(known_rest * root).ravel(), prior_values])
        gram = rows.T @ rows
        before, z = z, _bounded(gram, rows.T @ values, problem.sizes[0])
        residual = np.where(measured.usable, design_rest @ z + known_rest, 0.0)
        standard = residual / (noise * np.sqrt(np.maximum(1.0 - own, 0.05)))
        scale = max(robust_deviation(standard[measured.usable]), LEAST_SCALE)
        robust = _robust(measured.over_channels(standard) / scale)
        rms = float(np.sqrt(np.average(np.square(residual), weights=robust * measured.usable)))
        radiance = (own * (design @ z + known)).sum(axis=0)
        about = problem.curve(z).stored_of(radiance + problem.exposure(z)[0])
        if np.abs(z - before).max(initial=0.0) < 1e-4:
            break
    return _Fit(problem, z, np.linalg.inv(gram), scale, rms)


def _bounded(gram: np.ndarray, moment: np.ndarray, increments: int) -> np.ndarray:
    """Solve normal equations with positive increments."""
    from scipy.optimize import lsq_linear  # heavy: imported when first needed

    if not len(moment):
        return moment
    factor = np.linalg.cholesky(gram)
    lower = np.where(np.arange(len(moment)) < increments, LEAST_INCREMENT, -np.inf)
    return lsq_linear(factor.T, np.linalg.solve(factor, moment), (lower, np.inf)).x


def _robust(standard: np.ndarray) -> np.ndarray:
    """Weights of Geman and McClure, which reject outliers, unlike Cauchy's."""
    return 1.0 / np.square(1.0 + np.square(standard / OUTLYING))


def _spread(values: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Largest difference (n,) of values (m, n) between usable images."""
    return np.where(usable, values, -np.inf).max(axis=0) - np.where(usable, values, np.inf).min(axis=0)


# --- report -----------------------------------------------------------------------------------------------------------


def _overlap_fault(measured: _Measurements) -> str:
    """Message if an image shares too few blocks with the others, else an empty string."""
    counts = [len(np.unique(measured.block[row])) for row in measured.usable]
    least = int(np.argmin(counts))
    if counts[least] >= FEWEST:
        return ""
    return (
        f"Nothing can be estimated: image {least + 1} has {counts[least]} blocks (of {FEWEST} needed) that are well "
        "exposed and smooth in another image too; register the images, and use exposures that differ less."
    )


def _lens_fault(measured: _Measurements, wanted: bool) -> str:
    """Message if vignetting is not wanted, or the positions of the surfaces do not determine it, else empty."""
    if not wanted:
        return "Vignetting was not requested."
    if _radii(measured) >= LEAST_RADII:
        return ""
    return (
        "Vignetting cannot be estimated: each surface has the same distance from the centre in all images; "
        "turn the camera between them, or use an image of an evenly lit wall."
    )


def _radii(measured: _Measurements) -> float:
    """90th percentile over surfaces of the difference of r^2 between images."""
    return float(np.percentile(_spread(measured.radius2, measured.usable), 90))


def _corner_fault(fit: _Fit) -> str:
    """Message if the estimated vignetting is unusable, else an empty string."""
    if fit.is_inconsistent:
        return "Vignetting cannot be estimated: the images are inconsistent."
    if fit.corner_error <= WIDEST_CORNER and least_share(fit.problem.split(fit.z)[-1]) > LEAST_SHARE:
        return ""
    return (
        f"Vignetting cannot be estimated: the relative light in the corners has a standard error of "
        f"{fit.corner_error:.2f}; turn the camera further, so that surfaces move from the centre to the corners."
    )


def _fit_fault(fit: _Fit) -> str:
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


def _held(measured: _Measurements) -> tuple[float, float]:
    """Range of nearly all stored values."""
    low, high = np.percentile(measured.stored[measured.usable], [0.5, 99.5])
    return float(low), float(high)


def _report(fit: _Fit, fault: str, lens_fault: str) -> RadiometricEstimate:
    problem, measured = fit.problem, fit.problem.measured
    curve, logs, falloff = problem.curve(fit.z), problem.logs(fit.z), problem.split(fit.z)[-1]
    lens = VignettingEstimate(message=lens_fault, n=measured.n)
    if problem.terms:
        covariance = fit.covariance[-problem.terms :, -problem.terms :]
        message = f"The distances of surfaces from the centre differ by up to {_radii(measured):.2f} in r^2."
        lens = _vignetting_estimate(falloff, covariance, message, fit.rms, measured.n)
    response, response_errors = problem.response, ()
    if response is None:
        stored = _evenly(POINTS)
        light = np.exp(curve.log_light(stored) - curve.light[-1])
        response = ResponseCurve(tuple(stored.tolist()), tuple(light.tolist()))
        response_errors = tuple(fit.curve_errors(stored).tolist())
    return RadiometricEstimate(
        response=response,
        response_errors=response_errors,
        vignetting=lens,
        log_exposures=tuple(logs.tolist()),
        log_exposure_errors=tuple(fit.log_errors.tolist()),
        power_known=problem.power_known and not fault,
        power_error=0.0 if problem.power_known and not fault else RANGE_SPREAD,
        rms=fit.rms,
        observable=not fault,
        message=fault or _sentences(fit),
        stored_range=_held(measured),
        n=measured.n,
    )


def _sentences(fit: _Fit) -> str:
    """Message of an observable response: the data, assumptions, and warnings."""
    low, high = (255 * value for value in _held(fit.problem.measured))
    sentences = [
        f"From {fit.problem.measured.n} blocks with stored values of {low:.0f} to {high:.0f} (of 255) at exposures "
        f"that differ by a factor of {np.exp(fit.contrast):.2f}."
    ]
    if not fit.problem.power_known:
        sentences.append(
            "No ratio of exposures is known, so response, vignetting and exposures are known up to a common power, "
            f"which is assumed (to about {100 * RANGE_SPREAD:.0f} %); the invariant angle does not depend on it."
        )
    if fit.scale > MISFIT:
        sentences.append(
            f"Residuals are {fit.scale:.0f} times the noise: check for strong JPEG compression, registration errors, "
            "or different lights."
        )
    return " ".join(sentences)


def _nothing(
    measured: _Measurements, logs: np.ndarray | None, response: Response | None, fault: str
) -> RadiometricEstimate:
    """Estimate without any observable quantity."""
    unknown = (0.0, *[float("nan")] * (len(measured.stored) - 1))
    return RadiometricEstimate(
        response="srgb" if response is None else response,
        vignetting=VignettingEstimate(message=fault, n=measured.n),
        log_exposures=unknown if logs is None else tuple(logs.tolist()),
        log_exposure_errors=unknown if logs is None else (0.0,) * len(logs),
        message=fault,
        n=measured.n,
    )


def _vignetting_estimate(
    falloff: np.ndarray, covariance: np.ndarray, message: str, rms: float, n: int
) -> VignettingEstimate:
    if least_share(falloff) <= LEAST_SHARE:
        fault = "less than a tenth of the light would remain in the corners"
        return VignettingEstimate(message=f"Vignetting cannot be estimated: {fault}; {WHITE_WALL}", n=n)
    return VignettingEstimate(
        coefficients=tuple(falloff.tolist()),
        standard_errors=tuple(np.sqrt(np.diag(covariance)).tolist()),
        corner=1.0 + float(falloff.sum()),
        corner_error=float(np.sqrt(covariance.sum())),
        observable=True,
        message=message,
        rms=rms,
        n=n,
    )
