"""Estimation of the shading of a fitted image: piecewise smooth, with the edges of cast shadows.

In logarithms, a fitted image is the object's appearance under the training light plus shading. The model's appearance
lacks fine detail, and misplaced landmarks cause errors at eyes and lips. The difference of image and model is thus
shading plus errors of known variance. The shading is its piecewise smooth part, by weighted least squares in which the
coupling of neighbours decreases at jumps (total variation by reweighting). Farbman, Fattal, Lischinski and Szeliski,
"Edge-preserving decompositions", ACM TOG 2008, use similar weights.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.evaluation import short_repr
from liaam.model import AAM
from liaam.model.mesh import ReferenceFrame
from liaam.model.shape import align
from liaam.photometry import Response, from_linear
from liaam.photometry.noise import noise_deviation
from liaam.photometry.response import log_slope
from liaam.relighting.lamplight import lit_frame, unexplained_on_frame
from liaam.relighting.painting import soft_edge
from liaam.training.textures import sample_appearance

MISPLACED = 0.4
"""Standard deviation of the corrected landmarks, pixels of the reference frame."""

FINE = 0.03
"""Standard deviation of detail finer than the model's appearance, in logarithms."""

UNKNOWN = 0.05
"""Standard deviation of the model's errors if training has not measured it on left-out images."""

AT_THE_BORDER = 0.5
"""Standard deviation of the model's errors at the mesh's border, where a landmark one pixel off samples the background.
There the image's own detail is kept."""

COUPLING, CORNER, PASSES = 0.03, 0.02, 2
"""Weight of a jump of shading between neighbours, jump below which the penalty is quadratic, and number of
reweightings."""

UNIT = 0.1
"""Standard deviation of a pixel's log light that gives a weight of 1."""


@dataclass(frozen=True, eq=False)
class Shading:
    """Shading of a fitted picture, on the pixels of the reference frame."""

    log: np.ndarray
    """(n_pixels, 3) float32: piecewise smooth part of log(image / appearance)."""
    variance: np.ndarray
    """(n_pixels,) float32: its variance, which is large at the edges of cast shadows."""
    model_variance: np.ndarray
    """(n_pixels,) float32: variance of the model's appearance."""

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Seen:
    """A fitted image sampled on the reference frame, at the blur of the model's sharpest level."""

    log: np.ndarray
    """(n_pixels, 3) float32: logarithm of linear light."""
    usable: np.ndarray
    """(n_pixels,) float32 in {0, 1}."""
    noise: np.ndarray
    """(n_pixels, 3) float32: variance of the noise of ``log``."""

    @classmethod
    def of(cls, model: AAM, image: np.ndarray, shape: np.ndarray, response: Response) -> "Seen":
        """Warp an image (h, w, 3) to the reference frame by its fitted landmarks (n, 2)."""
        log, usable = sample_appearance(image, shape, model.warp, "log", response, model.levels[-1].blur)
        pixel = max(1.0, align(model.shape_model.mean, shape).scale)
        return cls(log, usable, noise_variance(log, response, noise_deviation(image) / pixel))


def find_shading(model: AAM, seen: Seen, log_rgb: np.ndarray, light: np.ndarray) -> Shading:
    """Estimate the shading of a fitted image from its appearance under the training light with corrected landmarks.

    ``log_rgb`` (n_pixels, 3) is from :func:`liaam.relighting.joint.appearance_in_light`, and ``light`` (k,) are its
    coordinates of the light.
    """
    model_variance = errors_of_the_model(model, log_rgb)
    at_the_border = np.square(AT_THE_BORDER * (1.0 - soft_edge(model)))
    weights = seen.usable * UNIT**2 / (model_variance + seen.noise.mean(axis=1))
    lit = lit_frame(model, light)
    held = np.square(UNIT / unexplained_on_frame(model))
    log = (lit + piecewise_smooth(model.frame, seen.log - log_rgb - lit, weights, held)).astype(np.float32)
    steepness = np.square(model.frame.gradient(log)).sum(axis=1).mean(axis=1)
    return Shading(log, steepness.astype(np.float32), model_variance + at_the_border)


def errors_of_the_model(model: AAM, log_rgb: np.ndarray) -> np.ndarray:
    """Return the variance of the errors of a model's appearance in a fitted image, (n_pixels,) float32."""
    unexplained = model.levels[-1].appearances["log"].unexplained
    known = UNKNOWN**2 if unexplained is None else np.trace(unexplained, axis1=1, axis2=2) / 3.0
    slopes = np.square(model.frame.gradient(log_rgb)).sum(axis=1).mean(axis=1)
    return (known + FINE**2 + MISPLACED**2 * slopes).astype(np.float32)


def noise_variance(log_rgb: np.ndarray, response: Response, deviation: float) -> np.ndarray:
    """Return the variance of logarithms of light (any shape), given the noise deviation of the stored values."""
    return stored_noise(from_linear(np.exp(log_rgb), response), response, deviation).astype(np.float32)


def stored_noise(stored: np.ndarray, response: Response, deviation: float) -> np.ndarray:
    """Return the same from the stored values in [0, 1]."""
    return np.square(deviation * log_slope(np.maximum(stored, 0.5 / 255), response))


def piecewise_smooth(
    frame: ReferenceFrame, values: np.ndarray, weights: np.ndarray, held: np.ndarray | float = 0.0
) -> np.ndarray:
    """Compute the piecewise smooth part of values (n_pixels, c) on the reference frame, as float32.

    Pixels of weight 0 are interpolated from their neighbours; ``held`` (n_pixels,) are weights of a pull towards 0.
    """
    pairs, weights = neighbours(frame), np.asarray(weights, np.float64)
    right = values * weights[:, None]
    jump, found = np.full(len(pairs[0]), 1.0), right
    for _ in range(PASSES + 1):  # the first pass has uniform coupling
        found = factorised(pairs, COUPLING / (jump + CORNER), weights + held).solve(right)
        jump = np.linalg.norm(found[pairs[0]] - found[pairs[1]], axis=1)
    return found.astype(np.float32)


def factorised(pairs: tuple[np.ndarray, np.ndarray], coupling: np.ndarray, weights: np.ndarray):
    """Return the sparse LU factors of the least-squares system of pixel weights (n,) and couplings (k,) of pairs."""
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    (a, b), n = pairs, len(weights)
    links = coo_array((np.tile(-coupling, 2), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n))
    own = np.bincount(a, coupling, n) + np.bincount(b, coupling, n) + weights + 1e-9
    system = (links.tocsc() + diags_array(own)).tocsc()
    return splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


def neighbours(frame: ReferenceFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of horizontally and vertically adjacent pixels of a frame."""
    return every_few(frame, 1)[1]


@lru_cache(maxsize=8)
def every_few(frame: ReferenceFrame, step: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return the pixels at every ``step``-th row and column of a frame, and pairs of neighbours among these."""
    kept = np.flatnonzero((frame.pixels % step == 0).all(axis=1))
    width, height = frame.size
    number = np.full((-(-height // step), -(-width // step)), -1)
    number[tuple(frame.pixels[kept].T // step)] = np.arange(len(kept))
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    both = [(a[(a >= 0) & (b >= 0)], b[(a >= 0) & (b >= 0)]) for a, b in pairs]
    return kept, (np.concatenate([pair[0] for pair in both]), np.concatenate([pair[1] for pair in both]))
