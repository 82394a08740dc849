"""Appearance models: PCA of textures sampled on the reference frame (paper eq 4)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from liaam.encoding_constants import ENCODINGS, GRADIENTS
from liaam.model.pca import Components, centred, chunks, components_by, explained_by_others, gram_about, strongest
from liaam.photometry.features import WIDEST

CHANNELS = {
    **{name: facts.learnt for name, facts in ENCODINGS.items()},
    "search": 2,
    "invariant": 1,
    "varied": 3,
    "illumination": 3,
    "features": WIDEST,
}
"""Appearances that a model can contain, and their numbers of channels.

- The name of an encoding: in that encoding. Of ``soft``, they are the two components of the softly normalised gradient,
  and L(theta) . log RGB, which are correlated.
- ``search``: the strongest modes of ``orientation`` at the coarsest level, for the search.
- ``invariant``: L(theta) . log RGB, projected before the PCA (the paper's LIT).
- ``varied``: values of the images and of their relit copies in one PCA (the paper's [11]).
- ``illumination``: additional modes for the part of the relit copies that ``value`` does not explain (the illumination
  basis of AIA, the paper's [6]).
- ``features``: channels of a function of the user, projected to 7 if there are more, or as many as there are
  (:mod:`liaam.photometry.features`).
"""

# Appearances that a method can compare an image with
APPEARANCES = tuple(name for name in CHANNELS if name not in ("illumination", "search"))
# Appearances learnt from the training images and their copies. The others are learnt from the images only.
COPIED_APPEARANCES = (*GRADIENTS, "search", "varied", "illumination")


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
        Fraction of training images in which the pixel was usable, 0 to 1, of those in which known landmarks place it:
        its weight in a fit.
    unexplained : (n_pixels, c, c) float32, optional
        Covariance of the leave-one-out residuals at each pixel: the model's error on unseen images.
    """

    mean: np.ndarray
    modes: np.ndarray
    eigenvalues: np.ndarray
    usable: np.ndarray
    unexplained: np.ndarray | None = None

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.modes)

    def at(self, indices: np.ndarray) -> "AppearanceModel":
        """Return the appearances at the pixels with the given indices; the modes lose their unit length."""
        modes = np.ascontiguousarray(self.modes[:, indices])
        unexplained = self.unexplained
        unexplained = None if unexplained is None else unexplained[indices]
        return AppearanceModel(self.mean[indices], modes, self.eigenvalues, self.usable[indices], unexplained)

    @property
    def mask(self) -> np.ndarray:
        """Mask of the pixels at which not everything is 0, (n_pixels,) bool."""
        mask = self.mean.any(axis=1) | self.modes.any(axis=(0, 2)) | (self.usable > 0)
        return mask if self.unexplained is None else mask | self.unexplained.any(axis=(1, 2))

    def only_at(self, mask: np.ndarray) -> "AppearanceModel":
        """Return the appearances with 0, which no fit uses, at all pixels but those of a mask."""
        return self.at(np.flatnonzero(mask)).spread(mask)

    def spread(self, mask: np.ndarray) -> "AppearanceModel":
        """Return the appearances on all pixels of a frame, from those of a mask (n_pixels,); elsewhere they are 0."""
        errors = None if self.unexplained is None else spread(self.unexplained, mask)
        modes = spread(self.modes, mask, axis=1)
        return AppearanceModel(spread(self.mean, mask), modes, self.eigenvalues, spread(self.usable, mask), errors)

    def texture(self, lam: np.ndarray) -> np.ndarray:
        """Return the texture A(x) at coordinates lambda, (n_pixels, c) float32."""
        return self.mean + np.tensordot(np.asarray(lam, dtype=np.float32), self.modes, axes=1)


SEARCHED_MODES = 15  # Number of modes of search; with more, the reduced model of the search also explains other objects


def strongest_modes(orientations: AppearanceModel) -> AppearanceModel:
    """Return the appearance ``search`` of the appearance ``orientation``."""
    modes = orientations.modes[:SEARCHED_MODES]
    eigenvalues = orientations.eigenvalues[:SEARCHED_MODES]
    return replace(orientations, modes=modes, eigenvalues=eigenvalues, unexplained=None)


def spread(values: np.ndarray, mask: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return values at the places of a mask, along an axis, as values at all places; elsewhere they are 0."""
    whole = np.zeros((*values.shape[:axis], len(mask), *values.shape[axis + 1 :]), values.dtype)
    whole[(slice(None),) * axis + (np.flatnonzero(mask),)] = values  # a mask takes three times as long
    return whole


FILLING_PASSES = 5  # Iterations of PCA imputation; the imputed values hardly change after the third


@dataclass(frozen=True, eq=False)
class Textures:
    """Textures (n, n_pixels, c) to learn from. Entries that are not observed are missing.

    ``usable`` (n, n_pixels) float32 is 1 for pixels with an observed channel, else 0. ``known`` (n, n_pixels) bool says
    which pixels known landmarks place, so that they could be observed at all; None if all are.
    """

    values: np.ndarray
    observed: np.ndarray
    usable: np.ndarray
    known: np.ndarray | None = None

    @classmethod
    def of(cls, values: np.ndarray, usable: np.ndarray, known: np.ndarray | None = None) -> "Textures":
        """Make textures from a mask by pixel (n, n_pixels) or by channel (n, n_pixels, c)."""
        if known is not None:
            usable = usable * (known if usable.ndim == 2 else known[..., None])
        if usable.ndim == 3:
            return cls(values, usable > 0, usable.max(axis=2).astype(np.float32), known)
        return cls(values, np.broadcast_to((usable > 0)[..., None], values.shape), usable, known)

    def weights(self, rows: np.ndarray | None = None) -> np.ndarray:
        """Share of the textures in which each pixel is usable, of those in which it could be, (n_pixels,) float32."""
        usable = self.usable if rows is None else self.usable[rows]
        if self.known is None:
            return usable.mean(axis=0).astype(np.float32)
        known = self.known if rows is None else self.known[rows]
        return (usable.sum(axis=0) / np.maximum(known.sum(axis=0), 1)).astype(np.float32)

    @property
    def vectors(self) -> np.ndarray:
        """Textures as flat vectors, (n, d)."""
        return self.values.reshape(len(self.values), -1)

    @cached_property
    def _missing(self) -> np.ndarray:
        """Indices of the entries that are missing in some texture."""
        return np.flatnonzero(~self.observed.all(axis=0))

    @cached_property
    def _partial(self) -> tuple[np.ndarray, np.ndarray]:
        """Values at those entries, (n, h) float32, and which are observed, (n, h) bool."""
        return self.vectors[:, self._missing], self.observed.reshape(len(self.values), -1)[:, self._missing]

    @cached_property
    def _products(self) -> np.ndarray:
        """Gram matrix of the entries observed in all textures; imputation does not change it."""
        return gram_about(np.delete(self.vectors, self._missing, axis=1) if len(self._missing) else self.vectors)

    def filled(self, variance: float | int, chosen: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Impute the missing entries of all or some textures by iterated PCA.

        Return flat textures (n, d) float32, and their Gram matrix about the mean, (n, n) float64. Otherwise a dark
        speckle or a border in one image would become a mode.
        """
        rows = np.arange(len(self.values)) if chosen is None else chosen
        vectors = self.vectors
        partial, observed = (part[rows] for part in self._partial)
        products = self._products[np.ix_(rows, rows)]
        if observed.all():
            return vectors[rows] if chosen is not None else vectors, centred(products + gram_about(partial))
        counts = observed.sum(axis=0)
        means = np.where(observed, partial, 0).sum(axis=0, dtype=np.float64) / np.maximum(counts, 1)
        # Entries observed in no image keep their mean value; their weight in a fit is 0.
        means = np.where(counts > 0, means, partial.mean(axis=0, dtype=np.float64))
        filled = np.where(observed, partial, means.astype(np.float32))
        for _ in range(FILLING_PASSES):
            # Single precision suffices: the results are float32.
            mean = filled.mean(axis=0, dtype=np.float64).astype(np.float32)
            part = strongest(centred(products + gram_about(filled, mean)), variance)[1].astype(np.float32)
            filled = np.where(observed, partial, mean + part @ (part.T @ (filled - mean)))
        vectors = vectors[rows] if chosen is not None else vectors.copy()
        vectors[:, self._missing] = filled
        return vectors, centred(products + gram_about(filled))


def train_appearance_model(
    textures: Textures,
    variance: float | int,
    rows: np.ndarray | None = None,
    left_out: Sequence[np.ndarray] | None = None,
) -> AppearanceModel:
    """Learn an appearance model from all textures, or those with the indices ``rows``.

    ``left_out`` are the folds of the leave-out residuals; without them ``unexplained`` is None.
    """
    usable = textures.usable if rows is None else textures.usable[rows]
    vectors, products = textures.filled(variance, rows)
    components = components_by(vectors, vectors.mean(axis=0, dtype=np.float64), products, variance)
    n, n_pixels = usable.shape
    c = textures.values.shape[2]
    weights = textures.weights(rows)
    if left_out is None:
        return _appearance(components, c, weights)
    # Row i of ``explained`` holds the combination of the other vectors that reconstructs vector i.
    explained = explained_by_others(products, variance, left_out) if n > 1 else np.eye(n)
    left = (np.eye(n) - explained).astype(np.float32)
    moments = np.empty((n_pixels, c, c), np.float32)  # of the residuals at usable pixels
    for part in chunks(n_pixels):
        part_vectors = vectors[:, part.start * c : part.stop * c]
        residuals = (left @ (part_vectors - part_vectors.mean(axis=0))).reshape(n, -1, c)
        weighed = residuals * usable[:, part, None]
        for a in range(c):
            for b in range(a, c):
                moments[part, a, b] = moments[part, b, a] = np.einsum("in,in->n", weighed[..., a], residuals[..., b])
    return _appearance(components, c, weights, moments / np.maximum(usable.sum(axis=0), 1)[:, None, None])


def _appearance(
    components: Components, c: int, weights: np.ndarray, unexplained: np.ndarray | None = None
) -> AppearanceModel:
    n_pixels = len(weights)
    return AppearanceModel(
        components.mean.reshape(n_pixels, c).astype(np.float32),
        components.modes.reshape(-1, n_pixels, c).astype(np.float32),
        components.eigenvalues,
        weights,
        unexplained,
    )


def train_illumination(values: AppearanceModel, relit: Textures, variance: float | int) -> AppearanceModel:
    """Learn an illumination basis: modes of relit images that an appearance model does not explain.

    Its mean is zero. Its modes are orthogonal to the modes and the mean of ``values``, learnt under one light, so that
    identity, gain and illumination do not trade off (as in Kahraman et al., CVPR 2007).
    """
    _, n_pixels, c = relit.values.shape
    identity = np.concatenate([values.mean[None], values.modes]).reshape(-1, n_pixels * c).astype(np.float64)
    identity = np.linalg.qr(identity.T)[0].astype(np.float32)
    filled, _ = relit.filled(variance)
    beyond = filled - (filled @ identity) @ identity.T
    # About zero, not about the mean: the mean change of light is a mode like any other.
    zero = np.zeros(n_pixels * c)
    return _appearance(components_by(beyond, zero, gram_about(beyond, zero), variance), c, relit.weights())
