"""Which landmarks of shapes are missing, and how uncertain the positions are that were estimated for them."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Missing:
    """Which landmarks of shapes are known, and the covariances of the estimates of the others.

    Attributes
    ----------
    known : (m, n) bool
        Whether a landmark of a shape is known. The positions of the others are estimates.
    factors : tuple of (r, n, 2) float64 arrays
        Of each shape, displacements in its own pixels whose outer products sum up to the covariance of its landmarks:
        two for each missing landmark, and none (r = 0) if all are known.
    """

    known: np.ndarray
    factors: tuple[np.ndarray, ...]

    @property
    def counts(self) -> np.ndarray:
        """Number of shapes in which each landmark is missing, (n,) int64."""
        return (~self.known).sum(axis=0)

    def of(self, indices: np.ndarray) -> "Missing":
        """Return what is missing in some of the shapes."""
        return Missing(self.known[indices], tuple(self.factors[i] for i in indices))
