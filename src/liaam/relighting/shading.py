"""The light of a fitted image: that of the modes of light, and what they leave.

In logarithms, a fitted image is the object's appearance under the training light, plus light, plus what the model does
not know: a beard, glasses, a mole, and errors of landmarks. Modes of light (:mod:`liaam.relighting.joint`) cannot
explain any of these. What they leave is light mostly where light varies, as along the edge of a shadow. It is not light
where it is far from the median of its surroundings, as marks are, nor where both halves of a symmetric object share it,
under light that they do not share. Elsewhere it stays in the picture.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from liaam.evaluation import short_repr
from liaam.lamps.bank import sample_field
from liaam.model import AAM
from liaam.model.shape import mirror_order
from liaam.relighting.appearance import ShadowFree
from liaam.relighting.joint import NOISE_FACTOR, UNKNOWN, Seen, appearance_in_light, light_on_frame
from liaam.relighting.painting import distance, smoothstep

SMOOTHNESS, WINDOW = 0.01, 0.08
"""Standard deviations of the Gaussians that smooth what the modes leave, and within which light varies, as fractions of
the frame's diagonal."""

WRONG, SHADOWS, ERRORS_PER_AREA = 3.0, 0.6, 2.0
"""Standard deviation of the errors of the modes of light, relative to that of their light within the window; and
without lamps, in logarithms, as modes then leave cast shadows, whose edges are no marks either; and number of
independent errors of the model in the area of the smoothing."""

AT_THE_BORDER, SOFT_EDGE = 0.5, 0.05
"""Standard deviation of the model's errors at the mesh's border, where a landmark one pixel off samples the background,
and depth at which they have fallen to 0, as a fraction of the model's diagonal."""

MARK, CONTRAST, CAST, STEPS = 0.12, 0.07, 0.45, 64.0
"""Marks, such as moles, rims of glasses and letters, are found by the median of a square: its side, as a fraction of
the frame's diagonal, the difference from it, in logarithms, at which a pixel has less weight, and what is added to that
(in quadrature) where light varies, relative to the standard deviation of the modes' light within the window; and the
steps per unit in the median filter, which has 256 in all."""

SURROUNDINGS, DARKER, ALIKE = 0.2, 0.1, 0.3
"""What both halves of a symmetric object share is the object's own, as a beard is, beyond this difference of log
brightness (second) from its surroundings (first, standard deviation as a fraction of the frame's diagonal), unless the
light itself is as bright on both halves (third, standard deviation of what its halves share)."""


@dataclass(frozen=True, eq=False)
class Shading:
    """Light of a fitted image relative to the training light, on the pixels of the reference frame.

    The coordinates (k,) of its modes, its logarithm (n_pixels, 3) float32, and the standard deviation of that,
    (n_pixels,) float32.
    """

    coordinates: np.ndarray
    log: np.ndarray
    deviation: np.ndarray

    __repr__ = short_repr


def find_shading(model: AAM, seen: Seen, prior: float = 1.0) -> tuple[ShadowFree, Shading]:
    """Estimate the appearance and the light of a fitted image; ``prior`` is that of the appearance."""
    appearance, covariance, level = appearance_in_light(model, seen, prior)
    modes, _ = light_on_frame(model)
    lit = np.tensordot(appearance.light.astype(np.float32), modes, axes=1) + level
    left = np.where(seen.usable[:, None] > 0, seen.log - appearance.log_rgb - lit, 0.0).astype(np.float32)
    bright = lit.mean(axis=1)
    varying = smoothed(model, np.square(bright), WINDOW) - np.square(smoothed(model, bright, WINDOW))
    varying = np.maximum(varying, 0.0)
    wrong, contrast = WRONG**2 * varying, np.sqrt(CONTRAST**2 + CAST**2 * varying)
    if model.light is None:
        wrong, contrast = wrong + SHADOWS**2, np.full_like(wrong, SHADOWS)
    else:
        left = without_pairs(model, left, bright)
    weights = seen.usable / (errors_of_the_model(model) + NOISE_FACTOR * seen.noise.mean(axis=1))
    uncertain = 1.0 / np.maximum(ERRORS_PER_AREA * weights, 1e-6)
    kept = wrong / (wrong + uncertain)
    brightness = modes.mean(axis=2)
    variance = np.einsum("kn,kl,ln->n", brightness, covariance, brightness, optimize=True) + kept * uncertain
    log = lit + kept[:, None] * without_marks(model, left, weights, contrast)
    deviation = np.sqrt(np.maximum(variance, 0.0))
    return appearance, Shading(appearance.light, log.astype(np.float32), deviation.astype(np.float32))


@lru_cache(maxsize=4)
def errors_of_the_model(model: AAM) -> np.ndarray:
    """Return the variance of the errors of a model's appearance in fitted images, (n_pixels,) float32."""
    unexplained = model.levels[-1].appearances["log"].unexplained
    known = UNKNOWN**2 if unexplained is None else np.trace(unexplained, axis1=1, axis2=2) / 3.0
    depth = distance(model.frame.picture(np.ones(model.n_pixels)) > 0)[tuple(model.frame.pixels.T)]
    soft = smoothstep((depth - 1.0) / (SOFT_EDGE * model.diagonal))
    return (known + np.square(AT_THE_BORDER * (1.0 - soft))).astype(np.float32)


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
        kept = weights * np.exp(-0.5 * np.square((left - near) / contrast[:, None]).mean(axis=1))
        near = smoothed(model, left, SMOOTHNESS, kept)
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


def smoothed(model: AAM, values: np.ndarray, scale: float, weights: np.ndarray | None = None) -> np.ndarray:
    """Average values (n_pixels, ...) of the frame, by weights (n_pixels,), in a Gaussian of ``scale`` diagonals."""
    kept = np.ones((len(values), 1)) if weights is None else weights[:, None]
    picture = model.frame.picture(np.hstack([values.reshape(len(values), -1) * kept, kept]))
    sums = cv2.GaussianBlur(picture, (0, 0), scale * model.diagonal, borderType=cv2.BORDER_CONSTANT)
    sums = sums[tuple(model.frame.pixels.T)]
    return (sums[:, :-1] / np.maximum(sums[:, -1:], 1e-9)).reshape(values.shape)
