"""What of a picture is shading: piecewise smooth, with the edges of cast shadows, and as far as the model is right.

A fitted picture is, in logarithms, the object's appearance under the training light plus shading. The model knows that
appearance but for fine detail, and but for what landmarks that lie a pixel off do to eyes and lips. So the difference
of picture and model is shading plus such errors, of which it is known where they are large. The shading is the
piecewise smooth part of it: weighted least squares with a coupling of neighbours that gives way where the shading
jumps (total variation, by reweighting; Farbman, Fattal, Lischinski and Szeliski, "Edge-preserving decompositions", ACM
TOG 2008, weigh likewise).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.model import AAM
from liaam.model.mesh import ReferenceFrame
from liaam.model.shape import align
from liaam.photometry import Response, from_linear
from liaam.photometry.noise import noise_deviation
from liaam.photometry.response import log_slope
from liaam.relighting.painting import soft_edge
from liaam.training.textures import sample_appearance

MISPLACED = 0.4
"""Deviation from the truth of landmarks that were put right, pixels of the reference frame."""

FINE = 0.03
"""Deviation of what is finer than the model's appearance, in logarithms."""

UNKNOWN = 0.05
"""Deviation of the model's errors where training has not left pictures out to measure it."""

AT_THE_BORDER = 0.5
"""Deviation of the model's errors at the mesh's border, where a landmark that lies a pixel off puts something else:
there the picture's own detail is believed."""

COUPLING, CORNER, PASSES = 0.03, 0.02, 2
"""Weight of a jump of shading between neighbours; jumps below CORNER are smoothed by their square; and how often the
system is weighed anew."""

UNIT = 0.1
"""Deviation of a pixel's log light that weighs one."""


@dataclass(frozen=True, eq=False)
class Shading:
    """Shading of a fitted picture, on the pixels of the reference frame.

    Attributes
    ----------
    log : (n_pixels, 3) float32
        Logarithm of picture over appearance, its piecewise smooth part.
    variance : (n_pixels,) float32
        How wrong it may be: large at the edges of cast shadows.
    model_variance : (n_pixels,) float32
        How far the model's appearance may be wrong.
    """

    log: np.ndarray
    variance: np.ndarray
    model_variance: np.ndarray


@dataclass(frozen=True, eq=False)
class Seen:
    """A fitted picture on the pixels of the reference frame, as sharp as the model's sharpest level.

    Attributes
    ----------
    log : (n_pixels, 3) float32
        Logarithm of linear light.
    usable : (n_pixels,) float32 in {0, 1}
    noise : (n_pixels, 3) float32
        Variance of its noise.
    """

    log: np.ndarray
    usable: np.ndarray
    noise: np.ndarray

    @classmethod
    def of(cls, model: AAM, image: np.ndarray, shape: np.ndarray, response: Response) -> "Seen":
        """Carry a picture (h, w, 3) to the reference frame by its fitted landmarks (n, 2)."""
        log, usable = sample_appearance(image, shape, model.warp, "log", response, model.levels[-1].blur)
        pixel = max(1.0, align(model.shape_model.mean, shape).scale)
        return cls(log, usable, noise_variance(log, response, noise_deviation(image) / pixel))


def find_shading(model: AAM, seen: Seen, log_rgb: np.ndarray) -> Shading:
    """Part a fitted picture into shading and what is under it.

    Parameters
    ----------
    model : AAM
    seen : Seen
    log_rgb : (n_pixels, 3) float32
        Appearance under the training light, where it lies in the picture
        (:func:`liaam.relighting.together.appearance_in_light`).

    Returns
    -------
    Shading
    """
    model_variance = errors_of_the_model(model, log_rgb)
    at_the_border = np.square(AT_THE_BORDER * (1.0 - soft_edge(model)))
    weights = seen.usable * UNIT**2 / (model_variance + seen.noise.mean(axis=1))
    log = piecewise_smooth(model.frame, seen.log - log_rgb, weights)
    steepness = np.square(model.frame.gradient(log)).sum(axis=1).mean(axis=1)
    return Shading(log, steepness.astype(np.float32), model_variance + at_the_border)


def errors_of_the_model(model: AAM, log_rgb: np.ndarray) -> np.ndarray:
    """Variance of what a model's appearance leaves unexplained in a fitted picture, (n_pixels,) float32."""
    unexplained = model.levels[-1].appearances["log"].unexplained
    known = UNKNOWN**2 if unexplained is None else np.trace(unexplained, axis1=1, axis2=2) / 3.0
    slopes = np.square(model.frame.gradient(log_rgb)).sum(axis=1).mean(axis=1)
    return (known + FINE**2 + MISPLACED**2 * slopes).astype(np.float32)


def noise_variance(log_rgb: np.ndarray, response: Response, deviation: float) -> np.ndarray:
    """Variance of logarithms of light (any shape) whose stored values have noise of some deviation."""
    stored = np.maximum(from_linear(np.exp(log_rgb), response), 0.5 / 255)
    return np.square(deviation * log_slope(stored, response)).astype(np.float32)


def piecewise_smooth(frame: ReferenceFrame, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Part of values of the reference frame that is smooth but for jumps, (n_pixels, c) float32.

    Parameters
    ----------
    frame : ReferenceFrame
    values : (n_pixels, c) float
    weights : (n_pixels,) float
        Of each pixel's values; those without weight are filled in from their neighbours.
    """
    pairs, weights = neighbours(frame), np.asarray(weights, np.float64)
    right = values * weights[:, None]
    jump, found = np.full(len(pairs[0]), 1.0), right
    for _ in range(PASSES + 1):  # the first, with all neighbours alike, only starts the others
        found = factorised(pairs, COUPLING / (jump + CORNER), weights).solve(right)
        jump = np.linalg.norm(found[pairs[0]] - found[pairs[1]], axis=1)
    return found.astype(np.float32)


def factorised(pairs: tuple[np.ndarray, np.ndarray], coupling: np.ndarray, weights: np.ndarray):
    """System of least squares of pixels (n,) with weights, and with couplings (k,) of pairs: its sparse LU factors."""
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    (a, b), n = pairs, len(weights)
    links = coo_array((np.tile(-coupling, 2), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n))
    own = np.bincount(a, coupling, n) + np.bincount(b, coupling, n) + weights + 1e-9
    system = (links.tocsc() + diags_array(own)).tocsc()
    return splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


def neighbours(frame: ReferenceFrame) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of pixels of a frame that lie side by side or one above the other, by their numbers."""
    return every_few(frame, 1)[1]


@lru_cache(maxsize=8)
def every_few(frame: ReferenceFrame, step: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Pixels of every so many rows and columns of a frame, and pairs of neighbours by their numbers among these."""
    kept = np.flatnonzero((frame.pixels % step == 0).all(axis=1))
    width, height = frame.size
    number = np.full((-(-height // step), -(-width // step)), -1)
    number[tuple(frame.pixels[kept].T // step)] = np.arange(len(kept))
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    both = [(a[(a >= 0) & (b >= 0)], b[(a >= 0) & (b >= 0)]) for a, b in pairs]
    return kept, (np.concatenate([pair[0] for pair in both]), np.concatenate([pair[1] for pair in both]))
