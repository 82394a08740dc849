"""Which part of an object is what the model expects: its pixels are segmented into present and absent ones.

The windows of :mod:`liaam.fitting.quality.presence` say that a part is absent, but not where it ends: its edge is in
the windows of landmarks beside it. Where image and fit are plain, they have nothing to compare.

Here each pixel has a likelihood ratio. Where the object is present, the gradients that the fit leaves are errors of the
model, whose variances training has estimated on left-out images. Where it is absent, the gradients of the image are
those of something blank or of something else. Pixels near each other are mostly of one kind. These are the unary and
pairwise terms of a fully connected conditional random field with a Gaussian kernel, of which the mean field is a few
convolutions (Krähenbühl and Koltun, NIPS 2011).
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from liaam import _core
from liaam.model.presence import MOST_LOG_ODDS, probability_of

if TYPE_CHECKING:
    from liaam.fitting.quality.presence import Surroundings

# Standard deviation of the kernel, as a fraction of the diagonal of the mean shape. From 0.02 to 0.03, results are the
# same within a landmark of a hundred (experiments/notes/damaged.md).
KERNEL = 0.025
STRENGTH = 3.0  # Log odds of a pixel whose neighbours are all of one kind
ROUNDS = 10  # Updates of the mean field, which then hardly changes
EVIDENCE = 1.2  # Weight of the likelihood of a pixel
# Variances of softly normalised gradients, at most 1: of a blank place, of another object, and what is added to the
# model's errors, because a fit is off by a fraction of a pixel.
BLANK = 0.01
OTHER = 0.12
MISPLACED = 0.02
OUTLIERS = 0.3  # Density of gradients of present parts that the model does not expect, such as dust and shadows
# Share of the pixels around a place, weighted by the kernel, that is absent if the place is as likely absent, and log
# odds of a place by that share. Nine of ten landmarks under discs over wings and cephalograms have a larger share, and
# one of fifty beside the discs.
HALF_ABSENT = 0.19
STEEPNESS = 20.0
# An absent part that the windows do not see surrounds a landmark with this share, and has at most this share of the
# object. A larger part contains landmarks whose windows can tell. Where these call all present, as in pictures of a
# kind that the model does not know, the segmentation is wrong.
SURELY_ABSENT = 0.6
SMALL_PART = 0.05
MOST_SQUARED = 1e30  # Limit on squared lengths: of what is not finite, too


class Segmentation(NamedTuple):
    """Probability that landmarks, and sampled pixels, are present."""

    landmarks: np.ndarray
    """(n,) float64."""
    pixels: np.ndarray
    """(n_pixels,) float64."""

    is_sure: bool
    """Whether most of what surrounds a landmark is absent, in a small part."""


def segmented(surroundings: "Surroundings", seen: np.ndarray, expected: np.ndarray) -> Segmentation:
    """Segment an object by its gradients in the image and those of the fit, each (n_pixels, 2), at a sharpest level."""
    log_odds = _log_odds_of_absence(seen, expected, surroundings.error_variances)
    own = surroundings.on_grid(EVIDENCE * surroundings.weights * log_odds)
    is_sampled = surroundings.is_sampled
    labels, around = _core.mean_field(own, is_sampled, surroundings.taps(KERNEL), STRENGTH, ROUNDS)  # 1 for absent
    shares = 0.5 + 0.5 * around.ravel()
    log_odds = np.clip(STEEPNESS * (HALF_ABSENT - shares), -MOST_LOG_ODDS, MOST_LOG_ODDS)
    present = probability_of(log_odds.astype(np.float64))
    share_absent = (labels > 0.0)[is_sampled > 0.0].mean()
    around_landmarks = shares[surroundings.cells_of_landmarks]
    return Segmentation(
        landmarks=present[surroundings.cells_of_landmarks],
        pixels=present[surroundings.cells_of_pixels],
        is_sure=bool((around_landmarks >= SURELY_ABSENT).any() and share_absent <= SMALL_PART),
    )


def _log_odds_of_absence(seen: np.ndarray, expected: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Return the log likelihood ratio of each pixel, absent by present, (n_pixels,), from gradients (n_pixels, 2).

    ``variances`` (n_pixels,) are those of the model's errors.
    """
    present = np.log(np.exp(_log_normal(_squares(seen - expected), variances + np.float32(MISPLACED))) + OUTLIERS)
    of_image = _squares(seen)
    other = _log_normal(of_image, OTHER)
    blank = _log_normal(of_image, BLANK) - other  # at most 3
    absent = other + np.log1p(np.exp(blank)) - np.float32(np.log(2.0))
    return absent - present


def _squares(gradients: np.ndarray) -> np.ndarray:
    """Return the squared lengths (n_pixels,) of gradients (n_pixels, 2), limited to what float32 can hold."""
    return np.minimum(np.einsum("nk,nk->n", gradients, gradients), np.float32(MOST_SQUARED))


def _log_normal(squares: np.ndarray, variance: np.ndarray | float) -> np.ndarray:
    """Return the log density of vectors of the plane by their squared lengths, times 2 pi."""
    return -np.log(variance) - 0.5 * squares / variance
