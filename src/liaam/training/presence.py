"""Learn when a landmark is present, from fits to left-out images (:mod:`liaam.model.presence`).

Around the landmarks of right fits, image and fit agree as they do where the tissue is what the model expects. Where the
same shape is moved away over the image, they agree as they do where it is something else.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from liaam.fitting.fitter import Fitter
from liaam.fitting.loop.encoded_image import EncodedImage
from liaam.fitting.loop.objective import State
from liaam.fitting.methods import Method
from liaam.fitting.quality import Surroundings
from liaam.fitting.result import FitResult
from liaam.model.presence import Agreement, Presence, fisher_z
from liaam.model.shape import diagonal_of, rotation

# Where other tissue is looked at: the shape is moved by so many diagonals, in so many directions. Nearer, the tissue at
# a landmark is often in the window; farther, it is mostly the ground.
AWAY = 0.2
DIRECTIONS = 8
LEAST_FITS = 5  # Least number of fits to learn from
# Weight, in fits, of the mean variance over all landmarks in that of one
SHRINK = 10.0
LEAST_VARIANCE = 0.01  # Of Fisher's z, which noise alone gives to windows of a hundred independent samples


class AgreementOfFit(NamedTuple):
    """How well a left-out image and a fit to it agree around the landmarks."""

    here: Agreement
    """NaN where the true landmark is not known."""
    elsewhere: tuple[Agreement, ...]
    """Where the shape is moved away; empty if the background is not valid."""


def can_be_judged(method: Method) -> bool:
    """Return whether fits of a method say which landmarks are present: those that compare gradients and their noise."""
    return method.encoding == "soft"


def agreement_of(
    fitter: Fitter, image: np.ndarray, result: FitResult, known: np.ndarray, has_background: bool
) -> AgreementOfFit:
    """Compare a fit with its image at its landmarks, of which some are ``known`` (n,), and away from them."""
    objective = fitter.objectives[-1]
    surroundings = Surroundings(objective)
    target, _ = fitter.target(image, result.landmarks)
    encoded = EncodedImage.at(
        target.image,
        result.landmarks,
        result.pose,
        method=objective.method,
        response=target.linear.response,
        blur=objective.blur,
        noise=target.measured(objective.method).noise,
        margin=1.5 * AWAY,
        density=objective.density,
    )
    shape = objective.warp.shape(result.p)
    angles = objective.start(result.p).angles

    def around(moved: np.ndarray) -> Agreement:
        state = State(objective.warp.parameters(shape + moved), angles, np.array(result.lam, np.float64))
        seen = objective.evaluate(encoded, state)
        metric = seen["metric"].reshape(objective.method.n_rows, -1)
        samples = seen["values"][:, : metric.shape[1]] @ metric.T
        return surroundings.compared(samples, seen["residual"], seen["usable"]).landmarks

    here = Agreement(*(np.where(known, each, np.nan) for each in around(np.zeros(2))))
    if not has_background:
        return AgreementOfFit(here, ())
    step = AWAY * diagonal_of(shape) * np.array([1.0, 0.0])
    turns = [rotation(2.0 * np.pi * i / DIRECTIONS) for i in range(DIRECTIONS)]
    return AgreementOfFit(here, tuple(around(turn @ step) for turn in turns))


def learn_presence(agreements: Sequence[AgreementOfFit]) -> Presence | None:
    """Learn the calibration from right fits to left-out images; None if there are too few.

    Fisher's z of both is taken for normally distributed with one variance, so that the log odds are linear in it.
    """
    elsewhere = [each for of_fit in agreements for each in of_fit.elsewhere]
    if len(agreements) < LEAST_FITS or not elsewhere:
        return None
    present = _Sample.of(fisher_z(np.array([each.here.concordances for each in agreements])))
    absent = _Sample.of(fisher_z(np.array([each.concordances for each in elsewhere])))
    contrast = _Sample.of(np.array([each.here.contrasts for each in agreements]))
    return Presence(
        usual=present.mean,
        other=absent.mean,
        variances=np.maximum(0.5 * (present.variance + absent.variance), LEAST_VARIANCE),
        contrasts=contrast.mean,
        spreads=np.sqrt(np.maximum(contrast.variance, LEAST_VARIANCE)),
    )


class _Sample(NamedTuple):
    """Mean and variance of a value of each landmark, (n,) float64."""

    mean: np.ndarray
    variance: np.ndarray

    @classmethod
    def of(cls, z: np.ndarray) -> "_Sample":
        """Estimate both from values z (m, n), of which NaN are left out; variances are shrunk to their mean."""
        known = np.isfinite(z)
        counts = known.sum(axis=0)
        z = np.where(known, z, 0.0)
        of_all = z.sum() / max(counts.sum(), 1)
        mean = np.where(counts > 0, z.sum(axis=0) / np.maximum(counts, 1), of_all)
        squares = np.where(known, np.square(z - mean), 0.0).sum(axis=0)
        pooled = squares.sum() / max(counts.sum(), 1)
        return cls(mean, (squares + SHRINK * pooled) / (counts + SHRINK))
