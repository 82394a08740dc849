"""The light of a fitted image: that of modes of light, estimated jointly with the appearance, and what they leave.

The invariant alone (:func:`liaam.relighting.shadow_free`) discards brightness and one direction of colour. If the
light is estimated jointly, all three channels contribute to the appearance. At a pixel x of the reference frame, the
image's log light is modelled as

    y(x) = A0(x) + sum_i lambda_i A_i(x)           appearance (paper eq 4)
         + sum_j h_j H_j(x) + c + e(x)             light, level and errors.

H are modes of light, which the model learnt from lamps, on the object and around it, or smooth ones without lamps; c is
one colour, by which exposures, white balances and skins differ. The errors e are noise, what the modes do not explain,
and the model's errors on left-out training images. They have long tails, such as marks and cast shadows, so each pass
solves weighted least squares with Gaussian priors, and then weighs the pixels by Student's t distribution.

Most images of an object may be in the training light, and errors of the model always look like a little light. So the
light is 0 with the probability that the data give to it, and its coordinates are means over both cases. An image that
is darker or redder as a whole is no evidence of another light, as its level c explains it; under another light, the
level is removed as well.

The colour of the light of the whole picture is estimated first (:func:`colour_on_object`), by the same model with a
wide prior of c: it is the mean colour of c and of the modes of light. Persons differ in colour less than lights do, and
their lips, brows and whites of the eyes do not differ as under another light. Light of the object's own colour is
limited to what its surroundings share (:meth:`LightColour.shared_with`). The rest is estimated from the image without
that colour, and has no mean colour of its own.

What the modes leave is light mostly where light varies, as along the edge of a shadow. It is not light where it is far
from the median of its surroundings, as marks are, nor where both halves of a symmetric object share it, under light
that they do not share. Elsewhere it stays in the picture, as beards, glasses and moles do, which no model knows.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.polynomial.legendre import legvander

from liaam.distance_transform import distance_transform
from liaam.formatting import short_repr
from liaam.model import AAM
from liaam.model.light_basis import HALF, in_field, sample_field
from liaam.model.shape import align, diagonal_of, mirror_order
from liaam.photometry import Response, linear_to_srgb
from liaam.photometry.invariant import CHROMATICITY, THETA_DEFAULT, temperature_direction
from liaam.photometry.noise import noise_deviation
from liaam.photometry.response import log_slope
from liaam.relighting.appearance import ShadowFree
from liaam.relighting.highlights import is_toned
from liaam.relighting.light_colour import RENDERED, LightColour, colour_around
from liaam.relighting.painting import Region, smoothstep
from liaam.training.textures import sample_appearance
from liaam.workers import one_numpy_thread

SQUARE = HALF * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float64)
"""Corners of the square around the mean shape to which lamps' light is known."""

# Lengths are fractions of the frame's diagonal, scales are standard deviations of Gaussians, and values are logarithms.
LEAST_UNEXPLAINED = 0.05  # Least standard deviation of what the modes of lamps do not explain, as lamps may be few
UNEXPLAINED = 0.06  # The same without lamps
COLOURED = 0.37  # Standard deviation of the colour of either, relative to its brightness
DEGREE = 6  # Without lamps: degree of the polynomials of brightness
OF_COLOUR = 3  # That of the polynomials of colour temperature
AMOUNT = 0.8  # Standard deviation of their coefficients, divided by one plus their degree

# Modes learnt from lamps leave smooth errors; counted pixel by pixel, they would outweigh the priors.
CORRELATED = 0.15  # Side of the area in which errors count as one
ACROSS = 4  # Number of samples across it

NOISE_FACTOR = 3.0  # Factor on the noise's variance, to which rounding and JPEG compression add
UNKNOWN = 0.05  # Standard deviation of the model's errors, if training has not measured it
AT_THE_BORDER = 0.5  # The same at the mesh's border, where a landmark one pixel off samples the background
SOFT_EDGE = 0.05  # Depth at which that has fallen to 0
LEVEL = 0.3  # Standard deviation of the brightness of an image's level
TINT = 0.1  # That of each of its two colours
TINT_OF_LIGHT = 0.4  # The same before the colour of the light is known: from daylight to candles
FREEDOM = 2.0  # Degrees of freedom of Student's t distribution of the errors
PASSES = 3  # More make no visible difference

SMOOTHNESS = 0.01  # Scale of the Gaussian that smooths what the modes leave
ERRORS_PER_AREA = 2.0  # Number of independent errors of the model in its area
WINDOW = 0.08  # Scale within which the variation of light is measured
WRONG = 3.0  # Standard deviation of the errors of the modes' light, relative to that of the light in the window
SHADOWS = 0.6  # The same without lamps, as modes then leave cast shadows, whose edges are no marks either

# Marks, such as moles, rims of glasses and letters, are found by the median of a square.
MARK = 0.12  # Its side
CONTRAST = 0.07  # Difference from it at which a pixel has less weight
CAST = 0.45  # Added to that, in quadrature: this share of the standard deviation of the modes' light in the window
STEPS = 64.0  # Steps per unit in the median filter, which has 256 in all

# What both halves of a symmetric object share is its own, as a beard is, unless the light itself is alike on both.
SURROUNDINGS = 0.2  # Scale of the surroundings with which it is compared
DARKER = 0.1  # Difference from them beyond which it counts
ALIKE = 0.3  # Standard deviation of the light that both halves share, at which half of it counts


@lru_cache(maxsize=4)
def light_on_frame(model: AAM) -> tuple[np.ndarray, np.ndarray]:
    """Return modes of light on a model's reference frame, each one standard deviation, (k, n_pixels, 3) float32.

    Also return the standard deviation of what they do not explain, (n_pixels,). Without lamps, the modes are smooth.
    """
    if model.light is None:
        return _smooth_modes(model), np.full(model.n_pixels, UNEXPLAINED)
    at = frame_in_field(model)
    pictures = [*model.light.modes, model.light.remainder]
    *modes, remainder = (sample_field(picture.astype(np.float32), at)[:, 0] for picture in pictures)
    return np.stack(modes), np.maximum(remainder, LEAST_UNEXPLAINED)


def frame_in_field(model: AAM) -> np.ndarray:
    """Return where the pixels of a model's frame are in fields around its mean shape, (n_pixels, 1, 2)."""
    mean = model.shape_model.mean
    pixels = model.frame.pixels[:, ::-1] + model.frame.origin
    return in_field((pixels - middle_of(mean)) / diagonal_of(mean))[:, None]


def middle_of(shape: np.ndarray) -> np.ndarray:
    """Return the centre of a shape's bounding box, (2,)."""
    return 0.5 * (shape.min(axis=0) + shape.max(axis=0))


def _smooth_modes(model: AAM) -> np.ndarray:
    """Return products of Legendre polynomials in x and y, of brightness and then of colour temperature."""
    away = model.frame.pixels - model.frame.pixels.mean(axis=0)
    down, right = legvander(away / np.abs(away).max(), DEGREE).transpose(1, 2, 0)
    theta = model.camera.theta if np.isfinite(model.camera.theta) else THETA_DEFAULT
    modes = []
    for degree, colour in ((DEGREE, np.ones(3)), (OF_COLOUR, temperature_direction(theta))):
        for i in range(degree + 1):
            for j in range(degree + 1 - i):
                modes.append(np.outer(AMOUNT / (1 + i + j) * down[i] * right[j], colour))
    return np.array(modes, np.float32)


@one_numpy_thread()
def light_on_image(model: AAM, coordinates: np.ndarray, region: Region) -> np.ndarray:
    """Return the change of log light around an object in a region of an image, (h, w, 3) float32; 0 without lamps.

    On the object, its mean has no colour.
    """
    if model.light is None or not coordinates.any():
        return np.zeros((*region.small[::-1], 3), np.float32)
    coordinates = coordinates.astype(np.float32)
    change = np.tensordot(coordinates, model.light.modes, axes=1)
    on_frame = np.tensordot(coordinates, light_on_frame(model)[0], axes=1)
    return field_on_image(change - colour_of(on_frame), model.light.mean, region)


def field_on_image(field: np.ndarray, mean: np.ndarray, region: Region) -> np.ndarray:
    """Return a field around a mean shape (n, 2), whose diagonal is 1, in a region of an image, (h, w, c) float32."""
    origin, right, down = in_field(align(mean, region.shape).inverse()(np.eye(3, 2, -1))).astype(np.float64)
    pose = np.column_stack([right - origin, down - origin, origin])
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(field, pose, region.small, flags=how, borderMode=cv2.BORDER_REPLICATE)


def appearance_in_light(
    model: AAM, log: np.ndarray, usable: np.ndarray, noise: np.ndarray
) -> tuple[ShadowFree, np.ndarray, np.ndarray]:
    """Estimate the appearance under the training light jointly with the light.

    The image on the reference frame has logarithms of light ``log`` (n_pixels, 3), whose ``noise`` are variances, and
    pixels that are ``usable`` (n_pixels,), 0 or 1. Also return the covariance (k, k) of the coordinates of the light,
    and the logarithm of the image's level (3,), times the probability of another light than that of training.
    """
    appearance = model.levels[-1].appearances["log"]
    coordinates, covariance, _ = _joint_estimate(model, log, usable, noise, TINT)

    # The light is 0 with the probability that the data give to it.
    n = appearance.n_modes
    light_part = slice(n, -3)
    light = coordinates[light_part]
    variance = covariance[light_part, light_part]
    same = as_in_training(light, variance)
    level = np.float32(1.0 - same) * (coordinates[-3:].astype(np.float32) @ _levels(TINT))
    coordinates = coordinates - same * covariance[:, light_part] @ np.linalg.solve(variance, light)
    spread = (1.0 - same) * (variance + same * np.outer(light, light))
    deviations = np.sqrt(np.diag(covariance)[:n])
    return (
        ShadowFree(appearance.texture(coordinates[:n]), coordinates[:n], deviations, coordinates[light_part]),
        spread,
        level,
    )


def _joint_estimate(
    model: AAM, log: np.ndarray, usable: np.ndarray, noise: np.ndarray, tint: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate the coordinates of appearance, light and level, whose colours have the standard deviation ``tint``.

    Return them, (n_modes + k + 3,), their covariance, and the modes of light and level at samples, (k + 3, s, 3).
    Other arguments are those of :func:`appearance_in_light`.
    """
    appearance = model.levels[-1].appearances["log"]
    of_lamps, unexplained = light_on_frame(model)
    pixels, together = _samples(model)
    part = appearance.at(pixels)
    of_levels = np.broadcast_to(_levels(tint)[:, None], (3, len(pixels), 3))
    of_light = np.concatenate([of_lamps[:, pixels], of_levels])
    whitened = _whitening(part.unexplained, noise[pixels], unexplained[pixels])
    target = np.einsum("nc,ncd->nd", log[pixels] - part.mean, whitened).ravel()
    modes = np.einsum("mnc,ncd->mnd", np.concatenate([part.modes, of_light]), whitened, optimize=True)
    modes = modes.reshape(len(modes), -1)
    precision = np.concatenate([1.0 / np.maximum(appearance.eigenvalues, 1e-12), np.ones(len(of_light))])
    counts = (usable * (appearance.usable > 0))[pixels]
    coordinates, hessian = _robust_coordinates(modes, target, counts, precision, together)
    return coordinates, np.linalg.inv(hessian), of_light


def _levels(tint: float) -> np.ndarray:
    """Return modes of the level of an image, (3, 3) float32: its brightness and its two colours."""
    return np.array([np.full(3, LEVEL), *(tint * CHROMATICITY)], np.float32)


def colour_on_object(model: AAM, log: np.ndarray, usable: np.ndarray, noise: np.ndarray) -> LightColour | None:
    """Estimate the colour of the light of an image on the reference frame; arguments as of :func:`appearance_in_light`.

    None for an object in black and white, with or without a tone, which does not show the colour of its light.
    """
    seen = log[usable > 0]
    if len(seen) < 2 or is_toned(seen):
        return None
    coordinates, covariance, of_light = _joint_estimate(model, log, usable, noise, TINT_OF_LIGHT)
    n = model.levels[-1].appearances["log"].n_modes
    colours = CHROMATICITY @ of_light.mean(axis=1).T  # (2, k + 3): mean colour of each mode
    chromaticity = colours @ coordinates[n:]
    own = own_colour(model)
    errors = _errors_of_colour(model) + np.square(RENDERED / max(float(np.linalg.norm(own)), 1e-9)) * np.outer(own, own)
    return LightColour(chromaticity, colours @ covariance[n:, n:] @ colours.T + errors)


@lru_cache(maxsize=4)
def _errors_of_colour(model: AAM) -> np.ndarray:
    """Return the covariance (2, 2) of the model's errors of colour on left-out images.

    A whole object may share them.
    """
    unexplained = model.levels[-1].appearances["log"].unexplained
    if unexplained is None:
        return UNKNOWN**2 * np.eye(2)
    return CHROMATICITY @ unexplained.mean(axis=0) @ CHROMATICITY.T


def own_colour(model: AAM) -> np.ndarray:
    """Return the mean log-chromaticity of the object under the training light, (2,)."""
    return CHROMATICITY @ model.levels[-1].appearances["log"].mean.mean(axis=0, dtype=np.float64)


def colour_of(light: np.ndarray) -> np.ndarray:
    """Return the mean colour of logarithms of light (n, 3), (3,) float32, which has no brightness."""
    mean = light.mean(axis=0)
    return mean - mean.mean()


def _samples(model: AAM) -> tuple[np.ndarray, float]:
    """Return pixels on a grid, by index, and how many of them lie in the area in which errors count as one."""
    side = CORRELATED * model.diagonal
    step = max(1, int(side / ACROSS))
    pixels = np.flatnonzero((model.frame.pixels % step == 0).all(axis=1))
    if model.light is None:
        return pixels, 1.0
    return pixels, max(1.0, np.square(side / step))


def _whitening(of_model: np.ndarray | None, noise: np.ndarray, unexplained: np.ndarray) -> np.ndarray:
    """Return factors W (n, 3, 3) with W W' the inverse covariance of a pixel's errors.

    The errors are the model's, with covariances (n, 3, 3) or None if training has not measured them, noise of variances
    (n, 3), and what the modes of light do not explain, of deviations (n,), which is more of brightness than of colour.
    """
    grey = np.ones((3, 3))
    each = np.eye(3)
    of_light = np.square(unexplained)[:, None, None] * (grey + COLOURED**2 * (each - grey / 3.0))
    errors = UNKNOWN**2 * grey if of_model is None else of_model
    errors = errors + NOISE_FACTOR * noise[:, None] * each + of_light
    return np.linalg.cholesky(np.linalg.inv(errors)).astype(np.float32)


def _robust_coordinates(
    modes: np.ndarray, target: np.ndarray, usable: np.ndarray, precision: np.ndarray, together: float
) -> tuple[np.ndarray, np.ndarray]:
    """Fit whitened modes (m, 3 n) to a whitened target (3 n,) by Student's t distribution; return also the Hessian.

    ``precision`` (m,) is that of the prior of the coordinates, and so many pixels as ``together`` count as one.
    """
    weights = usable
    for _ in range(PASSES):
        rows = modes * np.repeat(weights / np.float32(together), 3)
        hessian = (rows @ modes.T).astype(np.float64) + np.diag(precision)
        coordinates = np.linalg.solve(hessian, rows @ target)
        left = (target - coordinates.astype(np.float32) @ modes).reshape(-1, 3)
        weights = usable * ((FREEDOM + 3.0) / (FREEDOM + np.square(left).sum(axis=1)))
    return coordinates, hessian


def as_in_training(light: np.ndarray, covariance: np.ndarray) -> float:
    """Return the probability that the coordinates of light (k,), whose prior is N(0, 1), are all 0.

    Both cases are equally likely beforehand. Their ratio is that of the densities of posterior and prior at 0
    (Dickey, "The weighted likelihood ratio", Annals of Mathematical Statistics 1971).
    """
    exponent = -0.5 * (light @ np.linalg.solve(covariance, light) + np.linalg.slogdet(covariance)[1])
    return float(1.0 / (1.0 + np.exp(-np.clip(exponent, -500.0, 500.0))))


def noise_of_log(light: np.ndarray, deviation: float) -> np.ndarray:
    """Return the standard deviation of logarithms of light (any shape) from that of its sRGB-encoded values."""
    return deviation * log_slope(np.maximum(linear_to_srgb(light), 0.5 / 255))


@dataclass(frozen=True, eq=False)
class Shading:
    """Light of a fitted image relative to the training light, on the pixels of the reference frame.

    The coordinates (k,) of its modes, its logarithm (n_pixels, 3) float32, and the standard deviation of that,
    (n_pixels,) float32. Its mean has no colour, which is that of the whole image, ``colour``.
    """

    coordinates: np.ndarray
    log: np.ndarray
    deviation: np.ndarray
    colour: LightColour

    __repr__ = short_repr

    def towards(self, other: "Shading", share: float) -> "Shading":
        """Return the light at a share of the way to another."""

        def mixed(one: np.ndarray, two: np.ndarray) -> np.ndarray:
            return one + share * (two - one)

        return Shading(
            coordinates=mixed(self.coordinates, other.coordinates),
            log=mixed(self.log, other.log),
            deviation=mixed(self.deviation, other.deviation),
            colour=LightColour(
                mixed(self.colour.chromaticity, other.colour.chromaticity),
                mixed(self.colour.covariance, other.colour.covariance),
            ),
        )


@one_numpy_thread()  # so that the bits do not depend on the number of threads
def find_shading(
    model: AAM, image: np.ndarray, shape: np.ndarray, response: Response, trusted: bool = True
) -> tuple[ShadowFree, Shading]:
    """Estimate the appearance and the light of an image (h, w, 3) with fitted landmarks (n, 2).

    The colour of the whole image's light is estimated only if the landmarks are ``trusted``.
    """
    log, usable = sample_appearance(image, shape, model.warp, "log", response, model.levels[-1].blur)
    deviation = noise_deviation(image, response) / max(1.0, align(model.shape_model.mean, shape).scale)
    noise = np.square(noise_of_log(np.exp(log), deviation)).astype(np.float32)
    colour = colour_on_object(model, log, usable, noise) if trusted else None
    if colour is None:
        colour = LightColour.unknown()
    else:
        colour = colour.shared_with(colour_around(image, shape, response), own_colour(model))
    log = log - colour.log.astype(np.float32)
    appearance, covariance, level = appearance_in_light(model, log, usable, noise)
    modes, _ = light_on_frame(model)
    lit = np.tensordot(appearance.light.astype(np.float32), modes, axes=1) + level
    left = np.where(usable[:, None] > 0, log - appearance.log_rgb - lit, 0.0).astype(np.float32)

    bright = lit.mean(axis=1)
    if model.light is not None:
        left = without_pairs(model, left, bright)
    wrong, contrast = _variation_of_light(model, bright)
    weights = usable / (errors_of_the_model(model) + NOISE_FACTOR * noise.mean(axis=1))
    uncertain = 1.0 / np.maximum(ERRORS_PER_AREA * weights, 1e-6)
    share = wrong / (wrong + uncertain)  # how much of what the modes leave is light
    light = lit + share[:, None] * without_marks(model, left, weights, contrast)
    brightness = modes.mean(axis=2)
    variance = np.einsum("kn,kl,ln->n", brightness, covariance, brightness, optimize=True) + share * uncertain
    deviation = np.sqrt(np.maximum(variance, 0.0))
    light = (light - colour_of(light)).astype(np.float32)
    return appearance, Shading(appearance.light, light, deviation.astype(np.float32), colour)


def _variation_of_light(model: AAM, bright: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how wrong the modes of light may be, a variance, and the contrast of a mark, both (n_pixels,).

    Both grow with the variation of the brightness of the modes' light, (n_pixels,), in a window.
    """
    varying = np.maximum(smoothed(model, np.square(bright), WINDOW) - smoothed(model, bright, WINDOW) ** 2, 0.0)
    wrong = WRONG**2 * varying
    if model.light is None:
        return wrong + SHADOWS**2, np.full_like(wrong, SHADOWS)
    return wrong, np.sqrt(CONTRAST**2 + CAST**2 * varying)


@lru_cache(maxsize=4)
def errors_of_the_model(model: AAM) -> np.ndarray:
    """Return the variance of the errors of a model's appearance in fitted images, (n_pixels,) float32."""
    unexplained = model.levels[-1].appearances["log"].unexplained
    variance = UNKNOWN**2 if unexplained is None else np.trace(unexplained, axis1=1, axis2=2) / 3.0
    depth = distance_transform(model.frame.picture(np.ones(model.n_pixels)) > 0)[tuple(model.frame.pixels.T)]
    soft = smoothstep((depth - 1.0) / (SOFT_EDGE * model.diagonal))
    return (variance + np.square(AT_THE_BORDER * (1.0 - soft))).astype(np.float32)


def without_marks(model: AAM, left: np.ndarray, weights: np.ndarray, contrast: np.ndarray) -> np.ndarray:
    """Average what the modes leave, (n_pixels, 3), without marks, by weights (n_pixels,).

    A mark differs in light by a ``contrast`` (n_pixels,): first from the median of its surroundings, then
    from the first average. A median ignores lines and spots, and keeps edges between larger regions.
    """
    picture = model.frame.picture(smoothed(model, left, 0.5 * SMOOTHNESS))
    levels = np.clip(STEPS * picture + 128.0, 0, 255).astype(np.uint8)
    medians = cv2.medianBlur(levels, round(MARK * model.diagonal) | 1)[tuple(model.frame.pixels.T)]
    near = medians / np.float32(STEPS) - 2.0
    for _ in range(2):
        unmarked = weights * np.exp(-0.5 * np.square((left - near) / contrast[:, None]).mean(axis=1))
        near = smoothed(model, left, SMOOTHNESS, unmarked)
    return near


def without_pairs(model: AAM, left: np.ndarray, bright: np.ndarray) -> np.ndarray:
    """Take what is dark on both halves of a symmetric object from what the modes leave, (n_pixels, 3).

    Light from a side does not fall on both halves alike: they share what is the object's own, such as a beard. How far
    the light here is alike on both is seen in the brightness of its modes, (n_pixels,).
    """
    mirrored = mirrored_places(model)
    if mirrored is None:
        return left
    shared = np.minimum(shared_by_halves(model, left.mean(axis=1), mirrored) + DARKER, 0.0)
    of_light = smoothed(model, np.square(shared_by_halves(model, bright, mirrored)), WINDOW)
    return left - (shared * ALIKE**2 / (ALIKE**2 + of_light))[:, None].astype(np.float32)


@lru_cache(maxsize=4)
def mirrored_places(model: AAM) -> np.ndarray | None:
    """Return where the pixels of the frame have their mirror images, (n_pixels, 2); None without symmetry."""
    order = mirror_order(model.shape_model.mean)
    frame = model.frame
    if order is None:
        return None
    corners = frame.points[order[frame.vertices]] - frame.origin
    return np.einsum("nv,nvc->nc", frame.weights, corners).astype(np.float32)


def shared_by_halves(model: AAM, values: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """Return the smaller of values (n_pixels,) and their mirror images, less their surroundings; 0 if signs differ."""
    values = smoothed(model, values, 2.0 * SMOOTHNESS)
    values = (values - smoothed(model, values, SURROUNDINGS)).astype(np.float32)
    other = sample_field(model.frame.picture(values), mirrored[:, None]).ravel()
    return np.where(values * other > 0, np.sign(values) * np.minimum(np.abs(values), np.abs(other)), 0.0)


def smoothed(model: AAM, values: np.ndarray, scale: float, weights: np.ndarray | None = None) -> np.ndarray:
    """Average values (n_pixels, ...) of the frame, by weights (n_pixels,), in a Gaussian of ``scale`` diagonals."""
    weight = np.ones((len(values), 1)) if weights is None else weights[:, None]
    picture = model.frame.picture(np.hstack([values.reshape(len(values), -1) * weight, weight]))
    sums = cv2.GaussianBlur(picture, (0, 0), scale * model.diagonal, borderType=cv2.BORDER_CONSTANT)
    sums = sums[tuple(model.frame.pixels.T)]
    return (sums[:, :-1] / np.maximum(sums[:, -1:], 1e-9)).reshape(values.shape)
