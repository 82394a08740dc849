"""Appearance models: PCA of textures sampled on the reference frame (paper eq 4)."""

from dataclasses import dataclass

import numpy as np

from liaam.pca import principal_components

APPEARANCES = ("value", "log", "invariant")
"""``value`` and ``log``: RGB in the encoding of that name; ``invariant``: L(theta) . log RGB, projected
before the PCA (the paper's LIT)."""


@dataclass(frozen=True)
class AppearanceModel:
    """Appearances A(x) = A0(x) + sum_i lambda_i A_i(x) (paper eq 4).

    Attributes
    ----------
    mean : (n_pixels, c) float32
        A0.
    modes : (m, n_pixels, c) float32
        A_i, orthonormal as vectors of n_pixels * c.
    eigenvalues : (m,) float64
        Variance along each mode.
    usable : (n_pixels,) float32
        Share of training images in which the pixel was usable, 0 to 1: its weight in a fit.
    """

    mean: np.ndarray
    modes: np.ndarray
    eigenvalues: np.ndarray
    usable: np.ndarray

    @property
    def n_modes(self) -> int:
        """Number of modes kept."""
        return len(self.modes)

    def texture(self, lam: np.ndarray) -> np.ndarray:
        """Appearance at coordinates lambda, (n_pixels, c) float32."""
        return self.mean + np.tensordot(np.asarray(lam, dtype=np.float32), self.modes, axes=1)


def train_appearance_model(textures: np.ndarray, usable: np.ndarray, variance: float | int) -> AppearanceModel:
    """Learn an appearance model.

    Parameters
    ----------
    textures : (n_images, n_pixels, c) float32
    usable : (n_images, n_pixels) float32 in {0, 1}
    variance : float or int
        Fraction of variance or number of modes to keep.
    """
    n, n_pixels, c = textures.shape
    components = principal_components(textures.reshape(n, -1), variance)
    return AppearanceModel(
        mean=components.mean.reshape(n_pixels, c).astype(np.float32),
        modes=components.modes.reshape(-1, n_pixels, c).astype(np.float32),
        eigenvalues=components.eigenvalues,
        usable=usable.mean(axis=0).astype(np.float32),
    )
