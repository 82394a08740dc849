"""Whether the tissue at a landmark is what the model expects, from how well the image around it agrees with the fit."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

# Odds that a landmark is there before its surroundings are looked at: in collections, few landmarks are lost
PRIOR_ODDS = 10.0
MOST_LOG_ODDS = 7.0  # Limit on log odds: a few left-out images do not show what happens once in a thousand times
MOST_CONCORDANCE = 0.9999  # Limit on concordances, whose Fisher transform would be infinite at 1
# Standard deviations by which the contrast of present tissue may be too low. The log odds fall by one for each further
# one, by MOST_LOSS at most: blank places have ten too little and more, but shade lowers the contrast too.
USUAL_LOSS = 3.0
MOST_LOSS = 4.0


# Share of the usual concordance above which a landmark is not called absent, so that those beside a hole are not. Of 12
# wings and 24 cephalograms with a disc of 15 % of the diagonal, 1.9 % of the landmarks beside it are called absent.
# With 0.55 it is 1.2 %, but a painted edge where the wing's was passes for it; without a limit it is 2.5 %.
COVERED = 0.65


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
    slopes : (n,) float64
        Increase of the log odds with that z, at least 0; 0 for a landmark whose surroundings do not tell.
    contrasts, spreads : (n,) float64
        Mean and standard deviation of the contrast around each landmark (:class:`Agreement`) where it is present.
    """

    usual: np.ndarray
    other: np.ndarray
    slopes: np.ndarray
    contrasts: np.ndarray
    spreads: np.ndarray

    @property
    def centres(self) -> np.ndarray:
        """Fisher's z at which a landmark is as likely present as not, half-way between both means, (n,) float64."""
        return 0.5 * (self.usual + self.other)

    def probabilities(self, agreement: Agreement) -> np.ndarray:
        """Return the probability that each landmark is present, (n,) float64, from the agreement around it."""
        # Light and noise change the contrast of all landmarks; that of one is compared with the others.
        loss = self.contrasts - agreement.contrasts
        excess = (loss - np.median(loss)) / self.spreads - USUAL_LOSS
        centres = np.minimum(self.centres, fisher_z(COVERED * np.tanh(self.usual)))
        log_odds = self._log_odds(agreement.concordances, centres, self.slopes) - np.clip(excess, 0.0, MOST_LOSS)
        return 1.0 / (1.0 + np.exp(-log_odds))

    def agree(self, agreement: Agreement, weights: np.ndarray) -> np.ndarray:
        """Return whether places (m,) are more likely what the model expects, from the agreement around them.

        ``weights`` (m, n) are those of the landmarks around each place, of whose calibrations it has the mean.
        """
        centres = np.clip(weights @ self.centres, self.centres.min(), self.centres.max())
        slopes = np.clip(weights @ self.slopes, self.slopes.min(), self.slopes.max())
        return self._log_odds(agreement.concordances, centres, slopes) >= 0.0

    @staticmethod
    def _log_odds(concordances: np.ndarray, centres: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        away = slopes * (fisher_z(concordances) - centres)
        return np.clip(away, -MOST_LOG_ODDS, MOST_LOG_ODDS) + np.log(PRIOR_ODDS)
