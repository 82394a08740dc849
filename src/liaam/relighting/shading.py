"""The light of a fitted image: that of the modes of light, and what they leave.

In logarithms, a fitted image is the object's appearance under the training light, plus light, plus what the model does
not know: a beard, glasses, a mole, and errors of landmarks. Modes of light (:mod:`liaam.relighting.basis`) cannot
explain any of these. What they leave is light mostly where light varies, as along the edge of a shadow, and it is not
light where its colour is not that of light: where it changes the invariant (paper eq 7), or colour temperature more
than brightness; nor where both halves of a symmetric object share it, under light that they do not share. Elsewhere it
stays in the picture.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.evaluation import short_repr
from liaam.lamps.bank import sample_field
from liaam.model import AAM
from liaam.model.shape import mirror_order
from liaam.photometry.invariant import invariant_row, temperature_direction
from liaam.relighting.basis import UNEXPLAINED, light_on_frame
from liaam.relighting.seen import NOISE_FACTOR, Seen, angle_of, errors_of_the_model

SMOOTHNESS, WINDOW = 0.01, 0.08
"""Standard deviations of the Gaussians that smooth what the modes leave, and within which light varies, as fractions of
the frame's diagonal."""

WRONG = 3.0
"""Standard deviation of the errors of the modes of light, relative to that of their light within the window."""

ERRORS_PER_AREA = 2.0
"""Number of independent errors of the model in the area of the smoothing."""

INVARIANT, TEMPERATURE = 0.06, 0.15
"""Standard deviations of light's colour along the invariant and the temperature, in logarithms."""

MARK, CONTRAST = 0.08, 0.2
"""Width of marks, such as moles, rims of glasses and letters, that are never light, as a fraction of the frame's
diagonal, and difference of log brightness from the median of their surroundings from which they are such."""

SURROUNDINGS, DARKER, ALIKE = 0.2, 0.1, 0.3
"""What both halves of a symmetric object share is the object's own, as a beard is, beyond this difference of log
brightness (second) from its surroundings (first, standard deviation as a fraction of the frame's diagonal), unless the
light itself is as bright on both halves (third, standard deviation of what its halves share)."""

STEPS = 64.0
"""Steps of log light per unit in the median filter, which has 256 in all."""

OUTLYING = 3.0
"""Weight against larger regions, such as beards, that differ more from their surroundings than errors do."""

COLOURED = 0.3
"""Change of colour temperature that comes with a change of brightness, at most."""


@dataclass(frozen=True, eq=False)
class Shading:
    """Light of a fitted image relative to the training light, on the pixels of the reference frame."""

    coordinates: np.ndarray
    """(k,): of the modes of light."""
    log: np.ndarray
    """(n_pixels, 3) float32: logarithm of the light."""
    rest: np.ndarray
    """(n_pixels, 3) float32: the part of ``log`` that is not that of the modes."""
    deviation: np.ndarray
    """(n_pixels,) float32: standard deviation of ``log``."""

    __repr__ = short_repr


def find_shading(
    model: AAM, seen: Seen, log_rgb: np.ndarray, coordinates: np.ndarray, covariance: np.ndarray
) -> Shading:
    """Estimate the light of a fitted image from its appearance and the coordinates of its light.

    ``log_rgb`` (n_pixels, 3), ``coordinates`` (k,) and their covariance (k, k) are from
    :func:`liaam.relighting.joint.appearance_in_light`.
    """
    modes = light_on_frame(model)
    lit = np.tensordot(coordinates.astype(np.float32), modes, axes=1)
    left = np.where(seen.usable[:, None] > 0, seen.log - log_rgb - lit, 0.0).astype(np.float32)
    if model.light is not None:  # without lamps, the modes leave cast shadows too
        left = without_marks(model, smoothed(model, left, 0.5 * SMOOTHNESS))
        left = without_pairs(model, left, lit.mean(axis=1))
    bright = lit.mean(axis=1)
    varying = smoothed(model, np.square(bright), WINDOW) - np.square(smoothed(model, bright, WINDOW))
    prior = WRONG**2 * np.maximum(varying, 0.0) + (UNEXPLAINED**2 if model.light is None else 0.0)
    noise = NOISE_FACTOR * seen.noise.mean(axis=1)
    errors = errors_of_the_model(model, log_rgb) + noise
    apart = smoothed(model, left.mean(axis=1), 0.5 * SMOOTHNESS) - smoothed(model, left.mean(axis=1), WINDOW)
    outlying = 0.0 if model.light is None else OUTLYING  # without lamps, cast shadows are so
    errors *= 1.0 + not_light(model, left, noise) + outlying * np.square(np.square(apart) / (errors + prior))
    weights = seen.usable / errors
    rest = smoothed(model, left, SMOOTHNESS, weights)
    uncertain = 1.0 / np.maximum(ERRORS_PER_AREA * smoothed(model, weights, SMOOTHNESS), 1e-6)
    kept = prior / (prior + uncertain)
    rest = (kept[:, None] * rest).astype(np.float32)
    brightness = modes.mean(axis=2)
    variance = np.einsum("kn,kl,ln->n", brightness, covariance, brightness, optimize=True) + kept * uncertain
    return Shading(
        coordinates, (lit + rest).astype(np.float32), rest, np.sqrt(np.maximum(variance, 0.0)).astype(np.float32)
    )


def without_marks(model: AAM, left: np.ndarray) -> np.ndarray:
    """Replace what the modes leave, (n_pixels, 3), by the median of its surroundings where it is far from that.

    The median of a square ignores lines and spots up to half its area, but keeps edges between larger regions.
    """
    import cv2

    frame, deviation = model.frame, 0.3 * MARK * model.diagonal
    layers = cv2.GaussianBlur(frame.picture(np.column_stack([left, np.ones(len(left), np.float32)])), (0, 0), deviation)
    picture = layers[..., :3] / np.maximum(layers[..., 3:], 1e-3)  # around the frame
    picture[tuple(frame.pixels.T)] = left
    levels = np.clip(STEPS * picture + 128.0, 0, 255).astype(np.uint8)
    median = cv2.medianBlur(levels, round(MARK * model.diagonal) | 1)[tuple(frame.pixels.T)] / np.float32(STEPS) - 2.0
    apart = (left - median).mean(axis=1, keepdims=True) / CONTRAST
    return (median + np.exp(-0.5 * np.square(apart)) * (left - median)).astype(np.float32)


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
    order, frame = mirror_order(model.shape_model.mean), model.frame
    if order is None:
        return None
    corners = frame.points[order[frame.vertices]] - frame.origin
    return np.einsum("nv,nvc->nc", frame.weights, corners).astype(np.float32)


def shared_by_halves(model: AAM, values: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """Return the smaller of values (n_pixels,) and their mirror images, less their surroundings; 0 if signs differ."""
    values = smoothed(model, values, 2.0 * SMOOTHNESS)
    values = (values - smoothed(model, values, SURROUNDINGS)).astype(np.float32)
    picture = model.frame.picture(values[:, None])
    other = sample_field(picture, mirrored[:, None]).ravel()
    return np.where(values * other > 0, np.sign(values) * np.minimum(np.abs(values), np.abs(other)), 0.0)


def not_light(model: AAM, left: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return how far the colour of what the modes leave, (n_pixels, 3), is from light's, (n_pixels,) squared."""
    theta = angle_of(model.camera.theta)
    row = invariant_row(theta)[0]
    colours = np.column_stack([row / np.linalg.norm(row), temperature_direction(theta), np.full(3, 1 / 3)])
    invariant, temperature, brightness = smoothed(model, left @ colours, 0.5 * SMOOTHNESS).T
    beyond = np.abs(temperature - np.median(temperature)) - COLOURED * np.abs(brightness)
    apart = np.square(invariant - np.median(invariant)) / (INVARIANT**2 + noise)
    return apart + np.square(np.maximum(beyond, 0.0)) / (TEMPERATURE**2 + noise)


def smoothed(model: AAM, values: np.ndarray, scale: float, weights: np.ndarray | None = None) -> np.ndarray:
    """Average values (n_pixels, ...) of the frame by a Gaussian of ``scale`` diagonals, with weights (n_pixels,)."""
    import cv2

    frame, weights = model.frame, np.ones(model.n_pixels) if weights is None else weights
    layers = np.column_stack([values * weights.reshape(-1, *[1] * (values.ndim - 1)), weights])
    deviation, border = scale * model.diagonal, cv2.BORDER_CONSTANT
    picture = cv2.GaussianBlur(frame.picture(layers), (0, 0), deviation, borderType=border)
    sums = picture[tuple(frame.pixels.T)]
    return (sums[:, :-1] / np.maximum(sums[:, -1:], 1e-9)).reshape(values.shape)
