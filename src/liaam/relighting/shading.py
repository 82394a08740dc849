"""The light of a fitted image: that of the modes of light, and what they leave.

In logarithms, a fitted image is the object's appearance under the training light, plus light, plus what the model does
not know: a beard, glasses, a mole, and errors of landmarks. Modes of light (:mod:`liaam.relighting.basis`) cannot
explain any of these. What they leave is light mostly where light varies, as along the edge of a shadow. It is not light
where it is far from the median of its surroundings, as marks are, nor where both halves of a symmetric object share it,
under light that they do not share. Elsewhere it stays in the picture.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.evaluation import short_repr
from liaam.lamps.bank import sample_field
from liaam.model import AAM
from liaam.model.shape import mirror_order
from liaam.relighting.basis import light_on_frame
from liaam.relighting.joint import InLight
from liaam.relighting.seen import NOISE_FACTOR, Seen, errors_of_the_model

SMOOTHNESS, WINDOW = 0.01, 0.08
"""Standard deviations of the Gaussians that smooth what the modes leave, and within which light varies, as fractions of
the frame's diagonal."""

WRONG = 3.0
"""Standard deviation of the errors of the modes of light, relative to that of their light within the window."""

SHADOWS = 0.6
"""The same without lamps, in logarithms, as modes then leave cast shadows; their edges are no marks either."""

ERRORS_PER_AREA = 2.0
"""Number of independent errors of the model in the area of the smoothing."""

MARK, CONTRAST, CAST = 0.12, 0.07, 0.45
"""Marks, such as moles, rims of glasses and letters, are found by the median of a square: its side, as a fraction of
the frame's diagonal, the difference from it, in logarithms, at which a pixel has less weight, and what is added to that
(in quadrature) where light varies, relative to the standard deviation of the modes' light within the window."""

SURROUNDINGS, DARKER, ALIKE = 0.2, 0.1, 0.3
"""What both halves of a symmetric object share is the object's own, as a beard is, beyond this difference of log
brightness (second) from its surroundings (first, standard deviation as a fraction of the frame's diagonal), unless the
light itself is as bright on both halves (third, standard deviation of what its halves share)."""

STEPS = 64.0
"""Steps of log light per unit in the median filter, which has 256 in all."""


@dataclass(frozen=True, eq=False)
class Shading:
    """Light of a fitted image relative to the training light, on the pixels of the reference frame."""

    coordinates: np.ndarray
    """(k,): of the modes of light."""
    log: np.ndarray
    """(n_pixels, 3) float32: logarithm of the light."""
    deviation: np.ndarray
    """(n_pixels,) float32: standard deviation of ``log``."""

    __repr__ = short_repr


def find_shading(model: AAM, seen: Seen, found: InLight) -> Shading:
    """Estimate the light of a fitted image from its appearance and the coordinates of its light."""
    modes, coordinates = light_on_frame(model), found.appearance.light
    lit = np.tensordot(coordinates.astype(np.float32), modes, axes=1) + found.level
    left = np.where(seen.usable[:, None] > 0, seen.log - found.appearance.log_rgb - lit, 0.0).astype(np.float32)
    bright = lit.mean(axis=1)
    varying = smoothed(model, np.square(bright), WINDOW) - np.square(smoothed(model, bright, WINDOW))
    varying = np.maximum(varying, 0.0)
    prior, contrast = WRONG**2 * varying, np.sqrt(CONTRAST**2 + CAST**2 * varying)
    if model.light is None:
        prior, contrast = prior + SHADOWS**2, np.full_like(prior, SHADOWS)
    else:
        left = without_pairs(model, left, bright)
    weights = seen.usable / (errors_of_the_model(model) + NOISE_FACTOR * seen.noise.mean(axis=1))
    rest = without_marks(model, left, weights, contrast)
    uncertain = 1.0 / np.maximum(ERRORS_PER_AREA * weights, 1e-6)
    kept = prior / (prior + uncertain)
    brightness = modes.mean(axis=2)
    variance = np.einsum("kn,kl,ln->n", brightness, found.covariance, brightness, optimize=True) + kept * uncertain
    log, deviation = lit + kept[:, None] * rest, np.sqrt(np.maximum(variance, 0.0))
    return Shading(coordinates, log.astype(np.float32), deviation.astype(np.float32))


def without_marks(model: AAM, left: np.ndarray, weights: np.ndarray, contrast: np.ndarray) -> np.ndarray:
    """Average what the modes leave, (n_pixels, 3), without marks, by weights (n_pixels,).

    A mark differs in light by a ``contrast`` (n_pixels,): first from the median of its surroundings, then
    from the first average.
    """
    near = medians(model, smoothed(model, left, 0.5 * SMOOTHNESS))
    for _ in range(2):
        kept = weights * np.exp(-0.5 * np.square((left - near) / contrast[:, None]).mean(axis=1))
        layers = np.column_stack([left * kept[:, None], kept])
        sums = blurred(model, layers, SMOOTHNESS)
        near = sums[:, :3] / np.maximum(sums[:, 3:], 1e-9)
    return near


def medians(model: AAM, values: np.ndarray) -> np.ndarray:
    """Return the medians of values (n_pixels, 3) in squares.

    They ignore lines and spots up to half the area of a square, but keep edges between larger regions.
    """
    import cv2

    levels = np.clip(STEPS * model.frame.picture(values) + 128.0, 0, 255).astype(np.uint8)
    found = cv2.medianBlur(levels, round(MARK * model.diagonal) | 1)
    return found[tuple(model.frame.pixels.T)] / np.float32(STEPS) - 2.0


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
    other = sample_field(model.frame.picture(values), mirrored[:, None]).ravel()
    return np.where(values * other > 0, np.sign(values) * np.minimum(np.abs(values), np.abs(other)), 0.0)


def smoothed(model: AAM, values: np.ndarray, scale: float) -> np.ndarray:
    """Average values (n_pixels, ...) of the frame by a Gaussian of ``scale`` diagonals."""
    sums = blurred(model, np.column_stack([values, np.ones(len(values))]), scale)
    return (sums[:, :-1] / np.maximum(sums[:, -1:], 1e-9)).reshape(values.shape)


def blurred(model: AAM, layers: np.ndarray, scale: float) -> np.ndarray:
    """Blur layers (n_pixels, c) of the frame, 0 around it, by a Gaussian of ``scale`` diagonals."""
    import cv2

    picture, border = model.frame.picture(layers), cv2.BORDER_CONSTANT
    return cv2.GaussianBlur(picture, (0, 0), scale * model.diagonal, borderType=border)[tuple(model.frame.pixels.T)]
