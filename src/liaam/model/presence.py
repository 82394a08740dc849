"""Whether the tissue at a landmark is what the model expects, from how well the image around it agrees with the fit."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from liaam.formatting import short_repr
from liaam.io.landmarks.base import PRESENT

# Odds that a landmark is there before its surroundings are looked at: in collections, few landmarks are lost
PRIOR_ODDS = 20.0
# Share of the landmarks up to which those called absent are taken for mistakes: something that covers an object, or is
# missing, has a size. Of fits to unseen faces under hard flashes, 7 to 11 % have more, and 43 % have one at least.
# Shadows hide more under light that the model has not seen: the share is doubled if the mean z falls by LOSS_OF_LIGHT.
BY_CHANCE = 0.03
LOSS_OF_LIGHT = 0.5
MOST_LOG_ODDS = 7.0  # Limit on log odds: a few left-out images do not show what happens once in a thousand times
MOST_CONCORDANCE = 0.9999  # Limit on concordances, whose Fisher transform would be infinite at 1
# Standard deviations by which the contrast of present tissue may be too low. The log odds fall by one for each further
# one, by MOST_LOSS at most: blank places have ten too little and more, but shade lowers the contrast too.
USUAL_LOSS = 3.0
MOST_LOSS = 4.0


# Share of the usual concordance above which a landmark is not called absent, so that those beside a hole are not. Of 24
# wings and 48 cephalograms with a disc of 15 % of the diagonal, 1.7 % of the landmarks beside it are called absent.
# With 0.65 it is somewhat less, but a sixth of the landmarks where an edge is painted in the place of the wing's pass.
COVERED = 0.7


class Agreement(NamedTuple):
    """How well image and fit agree around places, mostly landmarks."""

    concordances: np.ndarray
    """(m,) float64: see :mod:`liaam.fitting.quality.presence`."""
    contrasts: np.ndarray
    """(m,) float64: logarithm of the contrast of the image by that of the fit."""


def fisher_z(concordances: np.ndarray) -> np.ndarray:
    """Return Fisher's z of concordances, whose errors have about the same variance everywhere."""
    return np.arctanh(np.clip(concordances, -MOST_CONCORDANCE, MOST_CONCORDANCE))


@dataclass(frozen=True, eq=False)
class Presence:
    """Calibration of the probability that landmarks are present, learnt from fits to left-out images.

    Attributes
    ----------
    usual, other : (n,) float64
        Mean of Fisher's z of the concordance around each landmark where it is present, and where other tissue is.
    variances : (n,) float64
        Variance of that z, of both.
    contrasts, spreads : (n,) float64
        Mean and standard deviation of the contrast around each landmark (:class:`Agreement`) where it is present.
    """

    usual: np.ndarray
    other: np.ndarray
    variances: np.ndarray
    contrasts: np.ndarray
    spreads: np.ndarray

    __repr__ = short_repr

    def probabilities(self, agreement: Agreement) -> np.ndarray:
        """Return the probability that each landmark is present, (n,) float64, from the agreement around it.

        If no more are absent than by chance, their probability is :data:`liaam.io.landmarks.base.PRESENT`.

        Under another light, all landmarks agree less, and some much less. Mean and variance of those that are present
        are therefore those of the image, if they are lower and larger, and if most landmarks are present.
        """
        strict = probability_of(self._log_odds(agreement))
        kept = strict >= PRESENT
        if kept.all() or 2 * kept.sum() < len(kept):  # with those of the image, none of these would be absent
            return strict
        away = (fisher_z(agreement.concordances) - self.usual)[kept]
        loss = max(-float(away.mean()), 0.0)
        of_image = replace(
            self,
            usual=np.maximum(self.usual - loss, self.other),
            variances=np.maximum(self.variances, away.var()),
        )
        probabilities = probability_of(of_image._log_odds(agreement))
        if (probabilities < PRESENT).mean() <= BY_CHANCE * (1.0 + loss / LOSS_OF_LIGHT):
            return np.maximum(probabilities, PRESENT)
        return probabilities

    def agree(self, agreement: Agreement, weights: np.ndarray) -> np.ndarray:
        """Return whether places (m,) are more likely what the model expects, from the agreement around them.

        ``weights`` (m, n) are those of the landmarks around each place, of whose calibrations it has the mean.
        """
        z = fisher_z(agreement.concordances)
        usual, other, variances = (
            np.clip(weights @ values, values.min(), values.max()) for values in (self.usual, self.other, self.variances)
        )
        return _log_odds_of(z, usual, other, variances, centres=0.5 * (usual + other)) >= 0.0

    def _log_odds(self, agreement: Agreement) -> np.ndarray:
        """Return the log odds that each landmark is present, (n,) float64."""
        z = fisher_z(agreement.concordances)
        covered = fisher_z(COVERED * np.tanh(self.usual))
        centres = np.minimum(0.5 * (self.usual + self.other), covered)
        # Light and noise change the contrast of all landmarks; that of one is compared with the others.
        loss = self.contrasts - agreement.contrasts
        excess = (loss - np.median(loss)) / self.spreads - USUAL_LOSS
        return _log_odds_of(z, self.usual, self.other, self.variances, centres) - np.clip(excess, 0.0, MOST_LOSS)


def _log_odds_of(
    z: np.ndarray, usual: np.ndarray, other: np.ndarray, variances: np.ndarray, centres: np.ndarray
) -> np.ndarray:
    """Return the log odds of two normal distributions of one variance, with the prior odds at the centres."""
    away = np.maximum(usual - other, 0.0) / variances * (z - centres)
    return np.clip(away, -MOST_LOG_ODDS, MOST_LOG_ODDS) + np.log(PRIOR_ODDS)


def probability_of(log_odds: np.ndarray) -> np.ndarray:
    """Return the probability of log odds."""
    return 1.0 / (1.0 + np.exp(-log_odds))
