"""Response, vignetting and exposures of a camera, from pictures of one scene under one light.

A surface x sends light rho(x), of which picture i stores v_i(x). With f from stored values to light (the response),
V the share of light that the lens lets through at the distance r_i(x) from the centre, and e_i the exposure,

    log f(v_i(x)) - log V(r_i(x)) - log e_i = log rho(x)        for every picture i,

after Kim and Pollefeys, "Robust radiometric calibration and vignetting correction" (PAMI 2008). The unknown
log rho(x) is eliminated as the weighted mean over the pictures; what is left is solved jointly by robust weighted
least squares. Three facts decide how:

- Stored values are noisy on both sides of the equation, most of all (in logarithms) in the dark. Blocks of pixels
  are averaged, the equation is weighted by 1 / (noise times slope of log f), and log f is linearised about
  the value that the other pictures predict, not about the noisy one: otherwise the noise flattens the curve.
- (log f, log V, log e) times one constant solve the equation as well, unless ratios of exposures are known
  (the exponential ambiguity: Grossberg and Nayar, "Determining the camera response from images: what is knowable?",
  PAMI 2003). A common power of R, G and B does not turn the invariant angle.
- A pair of ratio e leaves log f free by whatever repeats with each log e, and pictures say nothing of values that they
  do not hold. A prior fills both in: the spread of a family of real-looking curves, in the part of the EMoR basis
  (Grossberg and Nayar, "Modeling the space of camera response functions", PAMI 2004), plus what is smooth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from liaam.errors import CameraError
from liaam.photometry.camera import falloff_at, least_share, squared_radius
from liaam.photometry.encoding import DARK, SATURATED, as_colour, is_grey, stored_values
from liaam.photometry.invariant import CHROMATICITY
from liaam.photometry.noise import noise_deviation
from liaam.photometry.response import Response, ResponseCurve, to_linear

LOWEST = 6 / 255
"""Stored value at which the fitted curve begins; darker still, it goes on as a power."""

TOE, TOP = 0.02, 1.1
"""The curve is a spline along log((v + toe) / (top - v)): near log v in the dark, and stretched again at a shoulder."""

KNOTS = 17
"""Knots of the spline, equally far apart."""

SMOOTH, REACH = 0.3, 0.35
"""The prior's smooth part: standard deviation of the logarithm of light, and how far along the curve it is alike."""

USUAL_RANGE, RANGE_SPREAD = 6.6, 0.15
"""Logarithm of light between the stored values 8 and 250 where nothing tells the power, and the relative spread of it:
sRGB has 6.0, a gamma of 2.2 has 7.6."""

TERMS = 3
"""Coefficients of vignetting: r^2, r^4, r^6."""

TERM_SPREAD, BALANCE_SPREAD, EXPOSURE_SPREAD = 0.5, 0.1, 5.0
"""Prior standard deviations of each, and of the logarithms of a picture's white balance and exposure."""

BLOCK = 8
"""Pixels across the blocks that are averaged; up to twice as many in large pictures."""

MOST_BLOCKS = 4000
"""Blocks that are looked at."""

TEXTURE = 0.05
"""Most relative deviation within a block: stored values of mixed light are not the mixture's stored value."""

UNREGISTERED = 0.03
"""Share of the deviation within a block that counts as noise, for pictures that are not quite registered."""

OUTLYING = 4.0
"""Residuals, in standard deviations, that keep a quarter of their weight."""

MOST_STEPS = 40

LEAST_INCREMENT, LEAST_SCALE, LEAST_SHARE = 1e-3, 0.3, 0.1
"""What keeps the curve rising, the residuals' scale from nothing, and vignetting from black on the way there."""

EXACT = 1e-4
"""Standard deviation of the range of light that is set where nothing tells the power."""

POINTS = 33
"""Points of the curve that is given back."""

FEWEST, LEAST_CONTRAST, LEAST_RADII = 20, 0.1, 0.05
"""Blocks of a picture, difference of log exposure, and difference of r^2 below which nothing is claimed."""

WIDEST_RESPONSE, WIDEST_CORNER, LOOSEST = 0.1, 0.05, 0.5
"""Standard errors (of log light over the stored values at hand, of the share of light in corners, of log exposures)
beyond which nothing is claimed."""

WORST_RMS, WORST_NOISE = 0.06, 0.3
"""Residuals in log exposure beyond which nothing is claimed: what noise does not explain, and what it does."""

SYSTEMATIC = 1.5e-3
"""Standard error of log light and exposure that more pixels do not reduce (blocks of mixed light, clipped noise), as
simulated."""

MISFIT = 4.0
"""Residuals, in units of what noise explains, that noise does not explain; JPEG of quality 75 brings 4 to 6."""

UNEVEN = 0.05
"""Root mean square residual in log light, if noise does not explain it, of what is no flat field."""


@dataclass(frozen=True)
class VignettingEstimate:
    """A lens's falloff, estimated.

    Attributes
    ----------
    coefficients : tuple of float
        Of r^2, r^4, ... as in ``CameraModel.vignetting``; empty where they cannot be told.
    standard_errors : tuple of float
        Of the coefficients; they are far from independent.
    corner, corner_error : float
        Share of light in the corners and its standard error; NaN where they cannot be told.
    observable : bool
        Whether the material can tell the vignetting.
    message : str
        What made it observable, or what is missing.
    rms : float
        Root mean square residual in log light, NaN where nothing was fitted.
    n : int
        Number of blocks that it rests on.
    """

    coefficients: tuple[float, ...]
    standard_errors: tuple[float, ...]
    corner: float
    corner_error: float
    observable: bool
    message: str
    rms: float
    n: int


@dataclass(frozen=True)
class RadiometricEstimate:
    """A camera's response, vignetting and exposures, estimated together.

    Attributes
    ----------
    response : Response
        Common to the channels: a curve with f(1) = 1 where ``observable``, else what was given or assumed.
    response_errors : tuple of float
        Standard error of the logarithm of light at each ``response.stored``, about the mean over the usable
        range (a common factor of light means nothing); empty unless ``response`` was fitted. Without the power's.
    vignetting : VignettingEstimate
    log_exposures, log_exposure_errors : tuple of float
        Natural logarithm of each picture's exposure relative to the first, and its standard error
        (0 where it was given).
    power_known : bool
        Whether ratios of exposures, or the response, were given. If not, response, vignetting and exposures hold up to
        a common power, f^g, V^g, e^g, and g was assumed; the invariant angle does not depend on it.
    power_error : float
        Relative standard error of the power.
    rms : float
        Root mean square residual in log exposure.
    observable : bool
        Whether the material can tell the response (for a response that was given: the exposures).
    message : str
        What made it observable, or what is missing, in a few sentences.
    stored_range : (float, float)
        Least and greatest stored values that two pictures hold and the curve rests on; beyond, it is the prior's.
    n : int
        Number of blocks that two or more pictures hold.
    """

    response: Response
    response_errors: tuple[float, ...]
    vignetting: VignettingEstimate
    log_exposures: tuple[float, ...]
    log_exposure_errors: tuple[float, ...]
    power_known: bool
    power_error: float
    rms: float
    observable: bool
    message: str
    stored_range: tuple[float, float]
    n: int


def calibrate_response(
    images: Sequence[np.ndarray],
    *,
    exposures: Sequence[float] | None = None,
    homographies: Sequence[np.ndarray] | None = None,
    response: Response | None = None,
    vignetting: bool = True,
) -> RadiometricEstimate:
    """Estimate response, vignetting and exposures from pictures of one scene under one light.

    An exposure series from a tripod tells the response; overlapping pictures, registered by homographies, tell
    vignetting, too. Two or three exposures at steps of two to four, of a scene that goes from black to white, are best.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8, uint16 or float
        Stored values of two or more pictures, of one camera, aperture and focal length (which change vignetting);
        their white balance may drift by some per cent.
    exposures : sequence of float, optional
        Relative exposures (time times gain); estimated if left out. Only their ratios matter.
    homographies : sequence of (3, 3) float, optional
        From each picture's pixels to the first's. Left out, the pictures are registered (tripod), and
        vignetting cannot be seen, as each surface is at the same distance from the centre in all of them.
    response : Response, optional
        Where it is known: only vignetting and exposures are estimated.
    vignetting : bool
        Whether to estimate vignetting where it can be seen; if not, there is none.

    Returns
    -------
    RadiometricEstimate
        What the material cannot tell is said there; the rest is then fitted without it.

    Raises
    ------
    CameraError
        If there are fewer than two pictures, or sizes, exposures or homographies do not fit together.
    ImageError
        If an array is no picture.

    Examples
    --------
    >>> dark, bright = (np.full((64, 64, 3), value, np.uint8) for value in (60, 90))
    >>> calibrate_response([dark, bright], exposures=(1, 2)).observable  # two stored values are no curve
    False
    """
    pictures = _checked(images)
    logs = _log_ratios(exposures, len(pictures))
    seen = _observe(pictures, _maps(homographies, pictures))
    if fault := _overlap_fault(seen):
        return _nothing(seen, logs, response, fault)
    lens_fault = _lens_fault(seen) if vignetting else "Vignetting was not asked for."
    fit = _solve(_Problem(seen, logs, response, 0 if lens_fault else TERMS))
    if fault := _fit_fault(fit):
        fit = _solve(replace(fit.problem, response=fit.problem.response or "srgb"))
    if not lens_fault and (lens_fault := _corner_fault(fit)):
        fit = _solve(replace(fit.problem, terms=0))
    return _report(fit, fault, lens_fault)


def vignetting_from_flat_field(image: np.ndarray, response: Response = "srgb") -> VignettingEstimate:
    """Estimate vignetting from one picture of an evenly lit, even surface: a white wall, the sky, a sheet of paper.

    Light that falls off to one side is told apart; light that falls off to all sides is taken for vignetting.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float
    response : Response

    Returns
    -------
    VignettingEstimate
    """
    from scipy.optimize import least_squares  # heavy: imported when first needed

    seen = _observe(_checked([image], fewest=1), [np.eye(3)], least=1)
    if seen.n < FEWEST:
        return _no_vignetting("Vignetting cannot be told: hardly any block of the picture is evenly exposed.", seen.n)
    curve, radius2 = _Curve.of(response), seen.radius2[0]
    log_light = curve.log_light(seen.stored[0])
    deviation = seen.deviation[0] * curve.slope(seen.stored[0])
    constants = np.equal.outer(seen.channel, np.unique(seen.channel)).astype(np.float64)
    tilted = np.concatenate([seen.offset, constants], axis=1)

    def residuals(z: np.ndarray) -> np.ndarray:
        rest = log_light - np.log(_share(radius2, z[:TERMS])) - tilted @ z[TERMS:]
        return np.concatenate([rest / deviation, z[:TERMS] / TERM_SPREAD])

    start = np.concatenate([np.zeros(TERMS), np.linalg.lstsq(tilted, log_light, rcond=None)[0]])
    found = least_squares(residuals, start, loss="cauchy", f_scale=OUTLYING, x_scale="jac")
    standard = residuals(found.x)[: len(radius2)]
    scale = max(_robust_deviation(standard), LEAST_SCALE)
    covariance = scale**2 * np.linalg.inv(found.jac.T @ found.jac)[:TERMS, :TERMS]
    rms = float(np.sqrt(np.average(np.square(standard * deviation), weights=_robust(standard / scale))))
    if scale > MISFIT and rms > UNEVEN:
        return _no_vignetting(
            f"Vignetting cannot be told: the picture is not of an even surface (light differs by {100 * rms:.0f} %); "
            "fill it with an evenly lit white wall, out of focus.",
            seen.n,
        )
    message = f"From {seen.n} blocks of an evenly lit surface; light that falls off to all sides would look the same."
    return _vignetting_estimate(found.x[:TERMS], covariance, message, rms, seen.n)


# --- what the pictures show -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Seen:
    """Blocks of pixels as m pictures show them, each channel by itself: n of them.

    Attributes
    ----------
    stored, deviation : (m, n) float64
        Mean stored value in [0, 1] and its standard deviation.
    usable : (m, n) bool
    radius2 : (m, n) float64
        Squared distance from the picture's centre, 1 in its corners.
    offset : (n, 2) float64
        Place in the first picture, from its centre, the half diagonal being 1.
    channel, block : (n,) int
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
        """Root mean square (m, n) of values (m, n) of a block's channels: what moved, moved in all three."""
        count = np.bincount(self.block)
        sums = np.stack([np.bincount(self.block, weights=np.square(row)) for row in values])
        return np.sqrt(sums / np.maximum(count, 1))[:, self.block]


def _checked(images: Sequence[np.ndarray], fewest: int = 2) -> list[np.ndarray]:
    pictures = [as_colour(image, f"picture {i + 1}") for i, image in enumerate(images)]
    if len(pictures) < fewest:
        raise CameraError(f"{len(pictures)} picture was given; a response needs two or more of one scene")
    # Three equal channels are one.
    return [picture[..., :1] for picture in pictures] if all(map(is_grey, pictures)) else pictures


def _log_ratios(exposures: Sequence[float] | None, count: int) -> np.ndarray | None:
    """Logarithms of the exposures relative to the first's."""
    if exposures is None:
        return None
    values = np.asarray(exposures, dtype=np.float64)
    if values.shape != (count,) or not np.isfinite(values).all() or (values <= 0).any():
        raise CameraError(f"exposures {list(exposures)}: give one positive number for each of the {count} pictures")
    return np.log(values / values[0])


def _maps(homographies: Sequence[np.ndarray] | None, pictures: list[np.ndarray]) -> list[np.ndarray]:
    if homographies is None:
        if len({picture.shape for picture in pictures}) > 1:
            raise CameraError("the pictures differ in size; give homographies, or pictures from one tripod")
        return [np.eye(3)] * len(pictures)
    maps = [np.asarray(h, dtype=np.float64) for h in homographies]
    if len(maps) != len(pictures) or any(h.shape != (3, 3) or not np.isfinite(h).all() for h in maps):
        raise CameraError(f"give one 3×3 homography for each of the {len(pictures)} pictures, to the first's pixels")
    if any(np.linalg.cond(h) > 1e12 for h in maps):
        raise CameraError("a homography cannot be inverted; give maps from each picture's pixels to the first's")
    if not np.allclose(maps[0] / maps[0][2, 2], np.eye(3), atol=1e-6):
        raise CameraError("the first picture's homography must be the identity: all lead to its pixels")
    return maps


def _observe(pictures: list[np.ndarray], maps: list[np.ndarray], least: int = 2) -> _Seen:
    """Average blocks of the first picture's pixels in all pictures; keep what ``least`` of them hold well exposed."""
    height, width = pictures[0].shape[:2]
    edge = int(np.clip(np.sqrt(height * width / MOST_BLOCKS), min(BLOCK, height // 8, width // 8), 2 * BLOCK))
    parts = [_observe_one(p, m, (height, width), edge) for p, m in zip(pictures, maps, strict=True)]
    stored, deviation, usable, radius2 = (np.stack(part) for part in zip(*parts, strict=True))
    y, x, channel = np.mgrid[: stored.shape[1], : stored.shape[2], : stored.shape[3]]
    offset = np.stack([x - x.max() / 2, y - y.max() / 2], axis=-1) / np.hypot(x.max() / 2, y.max() / 2)
    kept = np.flatnonzero((usable.sum(axis=0) >= least).ravel())
    block = kept // stored.shape[3]
    step = len(np.unique(block)) // MOST_BLOCKS + 1
    kept, block = kept[block % step == 0], block[block % step == 0]
    stored, deviation, usable, radius2 = (
        part.reshape(len(pictures), -1)[:, kept] for part in (stored, deviation, usable, radius2)
    )
    return _Seen(stored, deviation, usable, radius2, offset.reshape(-1, 2)[kept], channel.ravel()[kept], block)


def _observe_one(
    picture: np.ndarray, to_first: np.ndarray, size: tuple[int, int], edge: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mean of blocks, its deviation, whether it is usable, and squared radius: each (rows, columns, channels)."""
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

    # Centred, as the variance is a small difference of large float32 numbers.
    values = stored_values(picture)
    noise = noise_deviation(picture)
    mean = block_mean(values)
    texture = np.sqrt(np.maximum(block_mean(np.square(values - 0.5)) - np.square(mean - 0.5) - noise**2, 0.0))
    is_inside = block_mean(np.ones(picture.shape[:2], np.float32)) > 0.999
    is_cut = block_mean(((values <= 0) | (values >= 1)).astype(np.float32)) > 0.02
    usable = is_inside & ~is_cut & (mean >= DARK) & (mean <= SATURATED) & (texture <= TEXTURE * mean + noise)
    deviation = np.sqrt(noise**2 / edge**2 + (UNREGISTERED * texture) ** 2 + (0.1 / 255) ** 2)
    y, x = np.mgrid[:rows, :columns] * edge + (edge - 1) / 2
    there = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(to_first).T
    radius2 = squared_radius(there[..., 0] / there[..., 2], there[..., 1] / there[..., 2], *picture.shape[:2])
    return mean, deviation, usable, np.broadcast_to(radius2[..., None], mean.shape)


# --- the response as a curve ------------------------------------------------------------------------------------------


def _axis(stored: np.ndarray) -> np.ndarray:
    return np.log((stored + TOE) / (TOP - stored))


def _evenly(count: int) -> np.ndarray:
    """Stored values (count,) from the lowest to 1, equally far apart along the curve."""
    low, high = _axis(np.array([LOWEST, 1.0])).tolist()
    ratio = np.exp(np.linspace(low, high, count))
    return np.clip((TOP * ratio - TOE) / (1.0 + ratio), LOWEST, 1.0)


def _knots() -> np.ndarray:
    return np.pad(_axis(_evenly(KNOTS)), 3, mode="edge")


def _increments(stored: np.ndarray) -> np.ndarray:
    """Integrated B-splines (..., J) of stored values: a curve of positive coefficients rises."""
    from scipy.interpolate import BSpline  # heavy: imported when first needed

    knots = _knots()
    axis = np.clip(_axis(stored.ravel()), knots[0], knots[-1])
    splines = BSpline.design_matrix(axis, knots, 3).toarray()
    return np.cumsum(splines[:, ::-1], axis=1)[:, ::-1][:, 1:].reshape(*stored.shape, -1)


@dataclass(frozen=True)
class _Curve:
    """Logarithm of light by stored value, as a table: (k,) each, rising."""

    stored: np.ndarray
    light: np.ndarray

    @classmethod
    def of(cls, response: "Response | np.ndarray") -> "_Curve":
        """Tabulate a response, or a curve of given increments (J,)."""
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
    """Mean (J,) and covariance (J, J) of a response's increments.

    The family is powers of v + v (1 - v) times a quadratic: tone curves with toe, shoulder and s-shape.
    """
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
    """What is sought: z (P,) of increments, exposures, white balances and vignetting, as far as they are free.

    Attributes
    ----------
    known_logs : (m,) float64, optional
        Log exposures.
    response : Response, optional
    terms : int
        Coefficients of vignetting.
    """

    seen: _Seen
    known_logs: np.ndarray | None
    response: Response | None
    terms: int

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Numbers of increments, exposures, white balances and coefficients of vignetting that are free."""
        increments = 0 if self.response is not None else len(_prior()[0])
        others = len(self.seen.stored) - 1
        colours = 2 * others if self.seen.channel.any() else 0
        return increments, 0 if self.known_logs is not None else others, colours, self.terms

    @property
    def power_known(self) -> bool:
        logs = self.known_logs
        return self.response is not None or (logs is not None and float(np.ptp(logs)) >= LEAST_CONTRAST)

    def split(self, z: np.ndarray) -> list[np.ndarray]:
        """Increments, exposures, white balances and coefficients of vignetting, those that are free."""
        return np.split(z, np.cumsum(self.sizes)[:-1])

    def curve(self, z: np.ndarray) -> _Curve:
        return _Curve.of(self.split(z)[0] if self.response is None else self.response)

    def logs(self, z: np.ndarray) -> np.ndarray:
        """Log exposures (m,)."""
        return np.concatenate([[0.0], self.split(z)[1]]) if self.known_logs is None else self.known_logs

    def exposure(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log of what scales each block's light in each picture (m, n), and its derivative by z (m, n, P)."""
        seen, (curve, logs, colours, falloff) = self.seen, self.split(z)
        m, n = seen.stored.shape
        share = _share(seen.radius2, falloff)
        others = np.eye(m)[:, None, 1:]
        by_log = np.broadcast_to(others, (m, n, m - 1))[..., : len(logs)]
        by_colour = np.einsum("mop,nc->mnpc", others, CHROMATICITY.T[seen.channel]).reshape(m, n, -1)
        by_colour = by_colour[..., : len(colours)]
        by_falloff = np.stack([seen.radius2 ** (i + 1) for i in range(TERMS)], axis=-1)[..., : self.terms]
        by_falloff = by_falloff / share[..., None]
        value = self.logs(z)[:, None] + by_colour @ colours + np.log(share)
        return value, np.concatenate([np.zeros((m, n, len(curve))), by_log, by_colour, by_falloff], axis=-1)

    def linearised(self, z: np.ndarray, about: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log radiance as known (m, n) + design (m, n, P) @ z, about stored values and the last z.

        log f(v) = log f(about) + (log f)'(about) (v - about), the derivative taken from the last curve.
        """
        curve, (exposure, derivative) = self.curve(z), self.exposure(z)
        known = curve.slope(about) * (self.seen.stored - about) - exposure + derivative @ z
        design = -derivative
        if self.response is None:
            design[..., : self.sizes[0]] += _increments(about)
        else:
            known += curve.log_light(about)
        return design, known

    def start(self) -> np.ndarray:
        return np.concatenate([_prior()[0][: self.sizes[0]], np.zeros(sum(self.sizes[1:]))])

    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows (k, P) and values (k,) of unit deviation; without known ratios they fix the power, too."""
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
    """Share of light that vignetting leaves, kept from zero on the way to the solution."""
    return np.maximum(falloff_at(radius2, falloff), LEAST_SHARE)


@dataclass(frozen=True)
class _Fit:
    """A solution.

    Attributes
    ----------
    covariance : (P, P) float64
    scale : float
        Deviation of the residuals in units of what noise explains.
    rms : float
        Root mean square residual in log exposure, robustly weighted.
    """

    problem: _Problem
    z: np.ndarray
    covariance: np.ndarray
    scale: float
    rms: float

    @property
    def log_errors(self) -> np.ndarray:
        """Standard errors (m,) of the log exposures, 0 where they were given."""
        free = np.sqrt(self.problem.split(np.diag(self.covariance))[1] + SYSTEMATIC**2)
        return np.concatenate([[0.0], free]) if len(free) else np.zeros(len(self.problem.seen.stored))

    @property
    def corner_error(self) -> float:
        terms = self.problem.terms
        return float(np.sqrt(self.covariance[len(self.z) - terms :, len(self.z) - terms :].sum()))

    @property
    def contrast(self) -> float:
        """Root mean square difference of log exposure by which surfaces were seen."""
        spread = _spread(self.problem.exposure(self.z)[0], self.problem.seen.usable)
        return float(np.sqrt(np.mean(np.square(spread))))

    def curve_errors(self, stored: np.ndarray) -> np.ndarray:
        """Standard errors of log light about its mean over the usable range."""
        size = self.problem.sizes[0]
        rows = _increments(stored) - _increments(np.linspace(DARK, SATURATED, 100)).mean(axis=0)
        return np.sqrt(np.einsum("ij,jk,ik->i", rows, self.covariance[:size, :size], rows) + SYSTEMATIC**2)


def _solve(problem: _Problem) -> _Fit:
    """Iterate linearised, reweighted least squares to the joint robust estimate."""
    seen, z = problem.seen, problem.start()
    prior_rows, prior_values = problem.prior()
    about, robust, scale, gram, rms = seen.stored, np.ones_like(seen.stored), 1.0, np.zeros((0, 0)), 0.0
    for _ in range(MOST_STEPS):
        noise = seen.deviation * problem.curve(z).slope(about)
        weight = seen.usable * robust / np.square(noise)
        own = weight / weight.sum(axis=0)
        design, known = problem.linearised(z, about)
        # The surface's own log radiance, the weighted mean over pictures, is eliminated.
        design_rest = design - np.einsum("mn,mnp->np", own, design)
        known_rest = known - np.einsum("mn,mn->n", own, known)
        root = np.sqrt(weight) / scale
        rows = np.concatenate([(design_rest * root[..., None]).reshape(known.size, len(z)), prior_rows])
        values = np.concatenate([-(known_rest * root).ravel(), prior_values])
        gram = rows.T @ rows
        before, z = z, _rising(gram, rows.T @ values, problem.sizes[0])
        residual = np.where(seen.usable, design_rest @ z + known_rest, 0.0)
        standard = residual / (noise * np.sqrt(np.maximum(1.0 - own, 0.05)))
        scale = max(_robust_deviation(standard[seen.usable]), LEAST_SCALE)
        robust = _robust(seen.over_channels(standard) / scale)
        rms = float(np.sqrt(np.average(np.square(residual), weights=robust * seen.usable)))
        radiance = (own * (design @ z + known)).sum(axis=0)
        about = problem.curve(z).stored_of(radiance + problem.exposure(z)[0])
        if np.abs(z - before).max(initial=0.0) < 1e-4:
            break
    return _Fit(problem, z, np.linalg.inv(gram), scale, rms)


def _rising(gram: np.ndarray, moment: np.ndarray, increments: int) -> np.ndarray:
    """Solve normal equations with increments that stay positive."""
    from scipy.optimize import lsq_linear  # heavy: imported when first needed

    if not len(moment):
        return moment
    factor = np.linalg.cholesky(gram)
    lower = np.where(np.arange(len(moment)) < increments, LEAST_INCREMENT, -np.inf)
    return lsq_linear(factor.T, np.linalg.solve(factor, moment), (lower, np.inf)).x


def _robust(standard: np.ndarray) -> np.ndarray:
    """Weights of Geman and McClure: what does not belong loses its say, unlike with Cauchy's."""
    return 1.0 / np.square(1.0 + np.square(standard / OUTLYING))


def _robust_deviation(values: np.ndarray) -> float:
    return float(1.4826 * np.median(np.abs(values)))


def _spread(values: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Largest difference (n,) between pictures (m, n) that can be used."""
    return np.where(usable, values, -np.inf).max(axis=0) - np.where(usable, values, np.inf).min(axis=0)


# --- what is said of it -----------------------------------------------------------------------------------------------


def _overlap_fault(seen: _Seen) -> str:
    """Say which picture shows too little that others show; nothing if none does."""
    counts = [len(np.unique(seen.block[row])) for row in seen.usable]
    least = int(np.argmin(counts))
    if counts[least] >= FEWEST:
        return ""
    return (
        f"Nothing can be told: picture {least + 1} has {counts[least]} blocks (of {FEWEST} needed) that are well "
        "exposed and smooth in another one, too; register the pictures, and take exposures that differ by less."
    )


def _lens_fault(seen: _Seen) -> str:
    """Say why the places of the surfaces tell nothing of the vignetting; nothing if they do."""
    if _radii(seen) >= LEAST_RADII:
        return ""
    return (
        "Vignetting cannot be told: each surface is seen at the same distance from the centre in all pictures; "
        "turn the camera between them, or take a picture of an evenly lit wall."
    )


def _radii(seen: _Seen) -> float:
    """Difference of r^2 between pictures that a tenth of the surfaces exceed."""
    return float(np.percentile(_spread(seen.radius2, seen.usable), 90))


def _corner_fault(fit: _Fit) -> str:
    """Say what is wrong with the vignetting that was found; nothing if it can be used."""
    if _disagrees(fit):
        return "Vignetting cannot be told: the pictures disagree."
    if fit.corner_error <= WIDEST_CORNER and least_share(fit.problem.split(fit.z)[-1]) > LEAST_SHARE:
        return ""
    return (
        f"Vignetting cannot be told: the share of light in the corners is uncertain by {fit.corner_error:.2f}; "
        "turn the camera further, so that surfaces go from the middle to the corners."
    )


def _disagrees(fit: _Fit) -> bool:
    return fit.rms > (WORST_RMS if fit.scale > MISFIT else WORST_NOISE)


def _fit_fault(fit: _Fit) -> str:
    """Say why the response (a given one: the exposures) cannot be told; nothing if it can."""
    if _disagrees(fit):
        return (
            f"Nothing can be told: where the pictures should agree they differ by a factor of {np.exp(fit.rms):.2f}; "
            "are they registered, taken under one light, and is what was given (exposures, response) right?"
        )
    if fit.log_errors.max() > LOOSEST:
        return (
            f"The exposures cannot be told: nothing links picture {int(np.argmax(fit.log_errors)) + 1} to the first; "
            "let the pictures overlap in a chain."
        )
    if fit.problem.response is not None:
        return ""
    if fit.contrast < LEAST_CONTRAST:
        return (
            f"The response cannot be told: the exposures hardly differ (by {100 * fit.contrast:.0f} %); take pictures "
            "at one, two and four times an exposure. sRGB is assumed."
        )
    low, high = _held(fit.problem.seen)
    error = float(np.sqrt(np.mean(np.square(fit.curve_errors(np.linspace(low, high, 100))))))
    if error <= WIDEST_RESPONSE:
        return ""
    return (
        f"The response cannot be told: the logarithm of light would be uncertain by {error:.2f}; take pictures at one, "
        "two and four times an exposure, of a scene with dark and bright parts. sRGB is assumed."
    )


def _held(seen: _Seen) -> tuple[float, float]:
    """Stored values between which nearly all lie."""
    low, high = np.percentile(seen.stored[seen.usable], [0.5, 99.5])
    return float(low), float(high)


def _report(fit: _Fit, fault: str, lens_fault: str) -> RadiometricEstimate:
    problem, seen = fit.problem, fit.problem.seen
    curve, logs, falloff = problem.curve(fit.z), problem.logs(fit.z), problem.split(fit.z)[-1]
    lens = _no_vignetting(lens_fault, seen.n)
    if problem.terms:
        covariance = fit.covariance[-problem.terms :, -problem.terms :]
        message = f"Surfaces are seen at distances from the centre that differ by up to {_radii(seen):.2f} in r^2."
        lens = _vignetting_estimate(falloff, covariance, message, fit.rms, seen.n)
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
        stored_range=_held(seen),
        n=seen.n,
    )


def _sentences(fit: _Fit) -> str:
    """Say what made response or exposures observable, and what to mind."""
    low, high = (255 * value for value in _held(fit.problem.seen))
    said = [
        f"From {fit.problem.seen.n} blocks with stored values of {low:.0f} to {high:.0f} (of 255) at exposures that "
        f"differ by a factor of {np.exp(fit.contrast):.2f}."
    ]
    if not fit.problem.power_known:
        said.append(
            "No ratio of exposures is known, so response, vignetting and exposures hold up to a common power, "
            f"which is assumed (to about {100 * RANGE_SPREAD:.0f} %); the invariant angle does not depend on it."
        )
    if fit.scale > MISFIT:
        said.append(
            f"Residuals are {fit.scale:.0f} times what noise explains: hard JPEG compression, poor registration, or "
            "another light?"
        )
    return " ".join(said)


def _nothing(seen: _Seen, logs: np.ndarray | None, response: Response | None, fault: str) -> RadiometricEstimate:
    """Report that there is too little to see."""
    nan = float("nan")
    unknown = (0.0, *[nan] * (len(seen.stored) - 1))
    return RadiometricEstimate(
        response="srgb" if response is None else response,
        response_errors=(),
        vignetting=_no_vignetting(fault, seen.n),
        log_exposures=unknown if logs is None else tuple(logs.tolist()),
        log_exposure_errors=unknown if logs is None else (0.0,) * len(logs),
        power_known=False,
        power_error=RANGE_SPREAD,
        rms=nan,
        observable=False,
        message=fault,
        stored_range=(nan, nan),
        n=seen.n,
    )


def _no_vignetting(message: str, n: int) -> VignettingEstimate:
    nan = float("nan")
    return VignettingEstimate((), (), nan, nan, observable=False, message=message, rms=nan, n=n)


def _vignetting_estimate(
    falloff: np.ndarray, covariance: np.ndarray, message: str, rms: float, n: int
) -> VignettingEstimate:
    errors = np.sqrt(np.diag(covariance))
    corner_error = float(np.sqrt(covariance.sum()))
    if least_share(falloff) <= LEAST_SHARE:
        return _no_vignetting("Vignetting cannot be told: less than a tenth of the light would reach the corners.", n)
    return VignettingEstimate(
        coefficients=tuple(falloff.tolist()),
        standard_errors=tuple(errors.tolist()),
        corner=1.0 + float(falloff.sum()),
        corner_error=corner_error,
        observable=True,
        message=message,
        rms=rms,
        n=n,
    )
