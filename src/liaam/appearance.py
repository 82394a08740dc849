"""Appearance models: PCA of textures sampled on the reference frame (paper eq 4)."""

from dataclasses import dataclass

import numpy as np

from liaam.pca import Components, principal_components

APPEARANCES = ("value", "log", "invariant")
"""``value`` and ``log``: RGB in the encoding of that name; ``invariant``: L(theta) . log RGB, projected
before the PCA (the paper's LIT)."""


@dataclass(frozen=True, eq=False)
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


FILLING_PASSES = 5
"""Passes of PCA and filling in; the filled values hardly move after the third."""


def _components_of_seen(vectors: np.ndarray, seen: np.ndarray, variance: float | int) -> Components:
    """Principal components of vectors some of whose entries say nothing.

    Unseen entries start at the mean of those seen and are then filled in by the components of all (iterated
    PCA), so that a dark speckle or a border in one image is no mode of the model.
    """
    if seen.all():
        return principal_components(vectors, variance)
    counts = seen.sum(axis=0)
    means = np.where(seen, vectors, 0).sum(axis=0, dtype=np.float64) / np.maximum(counts, 1)
    # What no image shows keeps its mean value as it is; its weight in a fit is 0.
    means = np.where(counts > 0, means, vectors.mean(axis=0, dtype=np.float64))
    filled = np.where(seen, vectors, means.astype(np.float32))
    components = principal_components(filled, variance)
    for _ in range(FILLING_PASSES):
        coordinates = (filled - components.mean) @ components.modes.T
        explained = (components.mean + coordinates @ components.modes).astype(np.float32)
        filled = np.where(seen, vectors, explained)
        components = principal_components(filled, variance)
    return components


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
    seen = np.repeat(usable > 0, c, axis=1).reshape(n, -1)
    components = _components_of_seen(textures.reshape(n, -1), seen, variance)
    return AppearanceModel(
        mean=components.mean.reshape(n_pixels, c).astype(np.float32),
        modes=components.modes.reshape(-1, n_pixels, c).astype(np.float32),
        eigenvalues=components.eigenvalues,
        usable=usable.mean(axis=0).astype(np.float32),
    )
