"""Estimate the angle from surfaces under several lights: the direction of least scatter (paper section 2.2).

L(theta) . log rho of a surface does not depend on the light, so theta minimises the scatter of the surfaces between
lights. Linear light is averaged over a patch or block first, since logarithms of noisy values are biased. The scatter
is whitened, since plain least squares is biased towards the angle of least noise. A robust loss reduces the weight of
highlights, moving shadow edges and moving objects.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.calibration.estimate import WIDEST_ERROR, AngleEstimate, in_normal_units, jackknife
from liaam.errors import CameraError
from liaam.photometry.camera import CameraModel
from liaam.photometry.encoding import as_colour, in_all_channels, refuse_grey, stored_values, usable_range
from liaam.photometry.invariant import temperature_direction
from liaam.photometry.noise import noise_deviation
from liaam.photometry.response import log_slope, to_linear

GRID = np.deg2rad(np.arange(0.0, 180.0, 1.0))  # Angles at which the cost is evaluated before the best is refined
CAUCHY = 2.385  # Scale of Cauchy's loss, in standard deviations: 95 % efficient for Gaussian errors
FEWEST = 6  # Least number of surfaces for an estimate
FEW = 2000  # Approximate number of surfaces for the search on the grid; all surfaces are used for refinement
CONVERGED = 1e-6  # Change of the angle, radians, at which the iteration of angle and errors stops
BLOCK_NOISE = 0.05  # Target standard deviation of a block's logarithm; its bias is then about 0.001
MOST_BLOCKS = 10_000  # Largest number of blocks of an image
CLUSTERS = 6  # Number of regions along each axis for the jackknife, since errors of neighbouring blocks are correlated
COLOURS = 20  # Number of bins of invariant values that group surfaces by colour
# Mean square difference of the lights along the temperature direction, in units of its error variance, below which
# the angle counts as unobservable; errors alone give 1
WEAKEST_SIGNAL = 2.0
# The same limit if white balance is free, so that only spatial variation counts. Broad sensors and coloured surfaces
# cause variation too
WEAKEST_VARIATION = 16.0
SURE = 0.7  # Quantile of the F distribution above which the standard error is that over colours and not over regions


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Measurements of n surfaces under m lights."""

    log_rgb: np.ndarray  # (n, m, 3) float64: logarithm of the mean linear light of a surface under a light
    variance: np.ndarray  # (n, m, 3) float64: its variance by noise
    exposed: np.ndarray  # (n, m) bool: whether the surface is neither dark nor saturated
    clusters: np.ndarray  # (n,) int: errors in a cluster are correlated, so the jackknife leaves out whole clusters

    def only(self, chosen: np.ndarray | slice) -> "Surfaces":
        """Return some of the surfaces, by mask, indices or slice."""
        return Surfaces(self.log_rgb[chosen], self.variance[chosen], self.exposed[chosen], self.clusters[chosen])


def theta_from_scene(
    images: Sequence[np.ndarray],
    camera: CameraModel | None = None,
    *,
    free_balance: bool = False,
    masks: Sequence[np.ndarray] | None = None,
) -> AngleEstimate:
    """Estimate the angle from registered images of one scene under several lights.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8, uint16 or float arrays
        Two or more images of equal size in which a pixel shows the same surface.
    camera : CameraModel, optional
        Camera with response, vignetting and optional noise; sRGB by default.
    free_balance : bool
        Whether the white balance differs between the images; then only spatial variation of the light is used.
    masks : sequence of (h, w) bool, optional
        Pixels of each image to use.

    Returns
    -------
    AngleEstimate

    Raises
    ------
    CameraError
        If the images differ in size, are grey, or too few surfaces are well exposed in two of them.
    """
    pictures = as_pictures(images)
    height, width = pictures[0].shape[:2]
    if any(picture.shape != pictures[0].shape for picture in pictures):
        sizes = ", ".join(f"{picture.shape[1]}×{picture.shape[0]}" for picture in pictures)
        raise CameraError(f"the images of a scene must have one size, but these have {sizes}; crop or align them")
    if masks is not None and [np.shape(mask) for mask in masks] != [(height, width)] * len(pictures):
        raise CameraError(f"masks: give one of {width}×{height} pixels for each of the {len(pictures)} images")
    camera = camera or CameraModel()
    block = _block_size(pictures, camera)
    labels, (down, across) = block_labels(height, width, block)
    regions = [labels if mask is None else np.where(mask, labels, -1) for mask in masks or [None] * len(pictures)]
    surfaces = observe(pictures, regions, down * across, camera, full=block * block)
    y, x = np.divmod(np.arange(down * across), across)
    clusters = (y * CLUSTERS // down) * CLUSTERS + x * CLUSTERS // across
    return theta_of_least_scatter(replace(surfaces, clusters=clusters), free_balance=free_balance)


def block_labels(height: int, width: int, block: int) -> tuple[np.ndarray, tuple[int, int]]:
    """Divide an image into square blocks; those at the right and lower border may be smaller.

    Returns the index (height, width) of each pixel's block, row by row, and the numbers of blocks down and across.
    Raises CameraError if fewer than three whole blocks fit down or across.
    """
    most = min(height, width) // 3
    if not 1 <= block <= most:
        raise CameraError(f"blocks of {block} pixels: give 1 to {most} for images of {width}×{height}")
    rows = np.arange(height) // block
    columns = np.arange(width) // block
    across = int(columns[-1]) + 1
    return rows[:, None] * across + columns, (int(rows[-1]) + 1, across)


def observe(
    pictures: Sequence[np.ndarray],
    regions: Sequence[np.ndarray],
    n: int,
    camera: CameraModel,
    *,
    full: int = 0,
    dark: float | None = None,
) -> Surfaces:
    """Measure the mean light of n labelled regions (h, w) in each image; each is a separate cluster.

    Labels are -1 outside regions. Regions with fewer than half of ``full`` pixels, and those whose mean stored value is
    below ``dark`` in any channel, are unusable; by default this is the least value with a usable logarithm.
    """
    seen = []
    for picture, region in zip(pictures, regions, strict=True):
        deviation = _deviation_of(picture, camera)
        labels = region.ravel()
        least, most = usable_range(camera.response, picture.dtype.str)
        least = least if dark is None else dark
        used = labels >= 0
        if picture.dtype.kind == "f":
            used &= in_all_channels(np.isfinite(picture)).ravel()
        labels = labels[used]
        stored = stored_values(picture.reshape(-1, 3)[used], np.float64)
        light, noise = _light_and_variance(stored, camera, deviation)
        if camera.vignetting:
            share = camera.falloff(*picture.shape[:2]).reshape(-1)[used][:, None]
            light = light / share
            noise = noise / np.square(share)
        count = np.bincount(labels, minlength=n).astype(np.float64)
        level, light, noise = (
            np.stack([np.bincount(labels, weights=each, minlength=n) for each in values.T], axis=1)
            / np.maximum(count, 1)[:, None]
            for values in (stored, light, noise)
        )
        # Threshold the mean: a threshold on noisy pixels would bias the rest.
        slack = 2.0 * deviation
        clipped = np.bincount(labels, weights=(stored >= most).any(axis=1), minlength=n) > 0.02 * count
        usable = (count > 0.5 * full) & ~clipped & (light > 0).all(axis=1)
        usable &= (level >= least + slack).all(axis=1) & (level <= most - slack).all(axis=1)
        light = np.where(usable[:, None], light, 1.0)
        variance = noise / np.maximum(count, 1)[:, None] / np.square(light)
        relative = np.where(usable[:, None], variance, 1.0)
        seen.append((np.log(light) + 0.5 * relative, relative, usable))
    logs, variances, exposed = (np.stack(part, axis=1) for part in zip(*seen, strict=True))
    return Surfaces(logs, variances, exposed, np.arange(n))


def _deviation_of(picture: np.ndarray, camera: CameraModel) -> float:
    """Standard deviation of an image's noise in stored values; 0 if the camera has a noise model."""
    return noise_deviation(picture) if camera.noise is None else 0.0


def _light_and_variance(stored: np.ndarray, camera: CameraModel, deviation: float) -> tuple[np.ndarray, np.ndarray]:
    """Linear light without bias by noise, and its variance, of stored values (any shape)."""
    response = camera.response
    light = to_linear(stored, response)
    if camera.noise is not None:  # noise of linear light: decoding has no bias
        return light, camera.noise.variance(light)
    # Noise of stored values: E f(v + n) = f(v) + f'' sigma^2 / 2; subtract this bias by a second difference.
    around = to_linear(stored + deviation, response) + to_linear(stored - deviation, response)
    slope = log_slope(np.maximum(stored, 1e-3), response) * to_linear(np.maximum(stored, 1e-3), response)
    return 2.0 * light - 0.5 * around, np.square(deviation * slope)


def _block_size(pictures: Sequence[np.ndarray], camera: CameraModel) -> int:
    """Side of blocks for which the noise of a moderately dark block's logarithm is :data:`BLOCK_NOISE`."""
    height, width = pictures[0].shape[:2]
    noisiest = 0.0
    for picture in pictures:
        values = stored_values(picture[:: max(1, height // 200), :: max(1, width // 200)], np.float64)
        level = float(np.percentile(values.min(axis=-1), 30))
        level = max(level, usable_range(camera.response, picture.dtype.str)[0])
        light, variance = _light_and_variance(np.array([level]), camera, _deviation_of(picture, camera))
        noisiest = max(noisiest, float(np.sqrt(variance[0]) / max(float(light[0]), 1e-6)))
    most = max(1, min(height, width) // 24)
    least = min(max(3, int(np.ceil(np.sqrt(height * width / MOST_BLOCKS)))), most)
    return int(np.clip(np.ceil(noisiest / BLOCK_NOISE), least, most))


def as_pictures(images: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Check that there are two or more images, all in colour."""
    pictures = [as_colour(image, f"image {i + 1}") for i, image in enumerate(images)]
    if len(pictures) < 2:
        raise CameraError("the angle is estimated from a change of light: give two or more images")
    for i, picture in enumerate(pictures):
        refuse_grey(picture, f"image {i + 1}", "an angle needs colour", CameraError)
    return pictures


def theta_of_least_scatter(surfaces: Surfaces, *, free_balance: bool = False) -> AngleEstimate:
    """Estimate the angle of least scatter of surfaces between lights, noise-whitened and robust.

    With ``free_balance`` the invariant has a free constant for each light. Raises CameraError if fewer than 6 surfaces
    are well exposed under two lights.
    """
    enough = surfaces.exposed.sum(axis=1) >= 2
    n = int(enough.sum())
    if n < FEWEST:
        raise CameraError(
            f"only {n} surfaces are well exposed in two images; at least {FEWEST} are needed: give images that are "
            "neither dark nor overexposed (stored values of 8 to 250 of 255 in every channel)"
        )
    scatter = _Scatter(surfaces.only(enough), free_balance)
    theta = scatter.best_angle()
    before = np.inf
    for _ in range(5):  # alternate between the angle and the model error
        if abs(theta - before) < CONVERGED:
            break
        before = theta
        scatter = scatter.with_model_error(theta)
        theta = scatter.best_angle()
    error = _error(scatter, theta)
    change, signal = _light_change(scatter, theta)
    times = f"log R/B by {change:.3f}, {np.sqrt(signal):.1f} times the errors"
    if free_balance and signal < WEAKEST_VARIATION:
        reason = (
            f"the lights' colours hardly vary from place to place ({times}), which a free white balance needs; give "
            "images with one white balance, or under light of uneven colour"
        )
    elif signal < WEAKEST_SIGNAL:
        reason = (
            f"the lights' colours hardly differ ({times}); give images under lights of different colour, such as "
            "lamp light and daylight"
        )
    elif not error < WIDEST_ERROR:
        reason = (
            f"its 95 % interval is ±{np.rad2deg(1.96 * error):.0f} degrees although the lights differ ({times}): {n} "
            "blocks or patches have too few colours; give images of more colours, well exposed"
        )
    else:
        seen = f"the lights differ by {change:.2f} in log R/B, {np.sqrt(signal):.0f} times the errors, on {n} surfaces"
        return AngleEstimate(theta, error, seen, change, n).with_warning()
    return AngleEstimate(theta, float("inf"), f"the angle cannot be estimated: {reason}", change, n)


@dataclass(frozen=True, eq=False)
class _Scatter:
    """Whitened scatter of surfaces as a function of the angle."""

    surfaces: Surfaces
    free_balance: bool
    model: float = 0.0
    """Variance of log rho, per channel, by model errors: broad sensors, highlights, registration errors."""

    def squares(self, rows: np.ndarray) -> np.ndarray:
        """Whitened within-surface sum of squares of projections by rows (k, 3), (k, n) float64."""
        s = self.surfaces
        projected = np.einsum("kc,nmc->knm", rows, s.log_rgb)
        weights = s.exposed / (np.einsum("kc,nmc->knm", np.square(rows), s.variance + self.model) + 1e-12)
        centred = _centred(projected, weights, self.free_balance)
        return (weights * np.square(centred)).sum(axis=2)

    @property
    def degrees(self) -> np.ndarray:
        """Degrees of freedom of each surface's sum of squares, (n,)."""
        return self.surfaces.exposed.sum(axis=1) - 1.0

    def costs(self, thetas: np.ndarray) -> np.ndarray:
        """Cauchy's loss of each surface at angles (k,), (k, n) float64."""
        parts = [
            self.squares(_unit_rows(part)) for part in np.array_split(np.atleast_1d(thetas), len(thetas) // 16 + 1)
        ]
        scale = CAUCHY**2 * self.degrees
        return scale * np.log1p(np.concatenate(parts) / scale)

    def best_angle(self) -> float:
        """Angle of least cost, radians in [0, pi)."""
        from scipy.optimize import minimize_scalar  # heavy: imported when first needed

        step = int(np.ceil(len(self.degrees) / FEW))
        thinned = replace(self, surfaces=self.surfaces.only(slice(None, None, step)))
        near = GRID[int(thinned.costs(GRID).sum(axis=1).argmin())]
        width = 1.5 * float(GRID[1])
        minimum = minimize_scalar(
            lambda t: float(self.costs(np.array([t])).sum()), bounds=(near - width, near + width), method="bounded",
            options={"xatol": 1e-6},
        )  # fmt: skip
        return float(minimum.x % np.pi)

    def with_model_error(self, theta: float) -> "_Scatter":
        """Return the scatter with the model variance that explains the median surface's squares at an angle."""
        from scipy.optimize import brentq  # heavy: imported when first needed
        from scipy.stats import chi2

        row = _unit_rows(np.array([theta]))
        wanted = chi2.ppf(0.5, self.degrees)

        def excess(log_model: float) -> float:
            squares = replace(self, model=float(np.exp(log_model))).squares(row)[0]
            return float(np.median(squares / wanted)) - 1.0

        low = float(np.log(1e-10))
        high = 0.0
        if excess(low) <= 0:
            return replace(self, model=0.0)
        root = high if excess(high) > 0 else brentq(excess, low, high, xtol=0.01, full_output=False)
        return replace(self, model=float(np.exp(float(root))))  # pyright: ignore[reportArgumentType]


def _centred(values: np.ndarray, weights: np.ndarray, free_balance: bool) -> np.ndarray:
    """Subtract each surface's weighted mean from values (..., n, m), and the means of the lights if balance is free."""

    def means(of: np.ndarray, axis: int) -> np.ndarray:
        total = np.maximum(weights.sum(axis=axis, keepdims=True), 1e-300)
        return (weights * of).sum(axis=axis, keepdims=True) / total

    centred = values - means(values, -1)
    if free_balance:
        for _ in range(3):  # alternate between lights and surfaces
            centred = centred - means(centred, -2)
            centred = centred - means(centred, -1)
    return centred


def _unit_rows(thetas: np.ndarray) -> np.ndarray:
    """Rows L(theta) of unit length, (k, 3) float64."""
    rows = np.stack([np.cos(thetas), np.sin(thetas), -np.cos(thetas) - np.sin(thetas)], axis=1)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _error(scatter: _Scatter, theta: float) -> float:
    """Half the width of the 95 % interval divided by 1.96, radians.

    Errors of neighbouring surfaces are correlated, and so are those of surfaces of one colour, since broad sensors
    shift with the colour. The jackknife over colours is used if its error is clearly larger.
    """
    from scipy.stats import f  # heavy: imported when first needed

    s = scatter.surfaces
    weights = s.exposed.astype(np.float64)
    values = (weights * (s.log_rgb @ _unit_rows(np.array([theta]))[0])).sum(axis=1) / weights.sum(axis=1)
    low, high = np.percentile(values, (1, 99))
    bins = np.clip((values - low) / max(high - low, 1e-9) * COLOURS, 0, COLOURS - 1).astype(int)
    (by_place, places), (by_colour, colours) = (_jackknife(scatter, theta, groups) for groups in (s.clusters, bins))
    if not np.isfinite([by_place, by_colour]).all():
        return float("inf")
    use_colours = (by_colour / max(by_place, 1e-12)) ** 2 > f.ppf(SURE, colours, places)
    error, degrees = (by_colour, colours) if use_colours else (by_place, places)
    return in_normal_units(error, degrees)


def _jackknife(scatter: _Scatter, theta: float, clusters: np.ndarray) -> tuple[float, float]:
    """Jackknife standard error of the angle over clusters, radians, and its degrees of freedom."""
    step = np.deg2rad(0.1)
    low, middle, high = scatter.costs(theta + step * np.array([-1.0, 0.0, 1.0]))
    slopes = (high - low) / (2 * step)
    bends = (high - 2 * middle + low) / step**2
    _, cluster = np.unique(clusters, return_inverse=True)
    slope = np.bincount(cluster, slopes)
    bend = np.bincount(cluster, bends)
    rest = bend.sum() - bend
    if len(slope) < 3 or not (rest > 0).all():
        return float("inf"), 1.0
    # One Newton step from all surfaces to those without a cluster.
    error = float(np.sqrt(jackknife(slope / rest)))
    # Clusters with little change of light hardly add degrees of freedom.
    effective = float(np.square(np.abs(bend).sum()) / np.square(bend).sum())
    return error, max(effective - 1.0, 1.0)


def _light_change(scatter: _Scatter, theta: float) -> tuple[float, float]:
    """Root mean square difference of the lights along d(theta), as log R/B, and its ratio to the error variance."""
    direction = temperature_direction(theta)
    s = scatter.surfaces
    along = s.log_rgb @ direction
    weights = s.exposed.astype(np.float64)
    centred = _centred(along, weights, scatter.free_balance)
    errors = ((s.variance + scatter.model) @ np.square(direction) * weights).sum(axis=1) / weights.sum(axis=1)
    squares = (weights * np.square(centred)).sum(axis=1) / scatter.degrees
    change = np.sqrt(2.0 * max(float(np.mean(squares - errors)), 0.0)) * abs(direction[0] - direction[2])
    return float(change), float(np.mean(squares) / np.mean(errors))
