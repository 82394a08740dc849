"""Appearance models: PCA of textures sampled on the reference frame (paper eq 4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from liaam.model.pca import (
    centred,
    chunks,
    components_by,
    explained_by_others,
    gram_about,
    strongest,
)

CHANNELS = {"value": 3, "log": 3, "orientation": 2, "soft": 3, "invariant": 1, "varied": 3, "illumination": 3}
"""Appearances a model may hold, and their channels.

``value``, ``log`` and ``orientation``: in the encoding of that name. ``soft``: the two components of the softly
normalised gradient and L(theta) . log RGB. ``invariant``: L(theta) . log RGB, projected before the PCA (the paper's
LIT). ``varied``: values of the pictures and of their relit copies in one PCA (training with lighting variation, the
paper's [11]). ``illumination``: what those copies show that ``value`` cannot explain, as modes to be added to it (the
illumination basis of AIA, the paper's [6]).
"""

APPEARANCES = tuple(name for name in CHANNELS if name != "illumination")
"""Those that a method can be compared with on their own."""

COPIED_APPEARANCES = ("orientation", "soft", "varied", "illumination")
"""Those learnt from copies of the training pictures, too: of the search, of the default method, and of the references
that learn what light does. The others belong to methods that learn from pictures as they are."""


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
    unexplained : (n_pixels, c, c) float32, optional
        Covariance of what the modes of the other training images leave of each image (leave one out): how
        far the model errs at each pixel on a picture it has not seen.
    """

    mean: np.ndarray
    modes: np.ndarray
    eigenvalues: np.ndarray
    usable: np.ndarray
    unexplained: np.ndarray | None = None

    @property
    def n_modes(self) -> int:
        """Number of modes kept."""
        return len(self.modes)

    def at(self, kept: np.ndarray) -> "AppearanceModel":
        """Give the same appearances at some pixels only, by their numbers; modes are no longer of unit length."""
        unexplained = None if self.unexplained is None else self.unexplained[kept]
        return AppearanceModel(
            self.mean[kept],
            np.ascontiguousarray(self.modes[:, kept]),
            self.eigenvalues,
            self.usable[kept],
            unexplained,
        )

    def texture(self, lam: np.ndarray) -> np.ndarray:
        """Appearance at coordinates lambda, (n_pixels, c) float32."""
        return self.mean + np.tensordot(np.asarray(lam, dtype=np.float32), self.modes, axes=1)


FILLING_PASSES = 5
"""Passes of PCA and filling in; the filled values hardly move after the third."""


@dataclass(frozen=True, eq=False)
class Textures:
    """Textures to learn from, some of whose entries say nothing.

    Attributes
    ----------
    values : (n, n_pixels, c) float32
    seen : (n, n_pixels, c) bool
        Which of them say something.
    usable : (n, n_pixels) float32 in {0, 1}
        Pixels that count as usable: of which any channel is.
    """

    values: np.ndarray
    seen: np.ndarray
    usable: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray, usable: np.ndarray) -> "Textures":
        """Textures whose usable entries are told by pixel (n, n_pixels), or by channel (n, n_pixels, c)."""
        if usable.ndim == 3:
            return cls(values, usable > 0, usable.max(axis=2).astype(np.float32))
        return cls(values, np.broadcast_to((usable > 0)[..., None], values.shape), usable)

    def of_rows(self, rows: np.ndarray) -> "Textures":
        """Some of the textures, by number or mask."""
        return Textures(self.values[rows], self.seen[rows], self.usable[rows])

    @property
    def vectors(self) -> np.ndarray:
        """Values as one vector each, (n, d)."""
        return self.values.reshape(len(self.values), -1)

    @cached_property
    def _holes(self) -> np.ndarray:
        """Numbers of the entries that not all textures show."""
        return np.flatnonzero(~self.seen.all(axis=0))

    @cached_property
    def _partial(self) -> tuple[np.ndarray, np.ndarray]:
        """Values at those entries, (n, h) float32, and which say something, bool."""
        if not len(self._holes):
            nothing = np.zeros((len(self.values), 0), np.float32)
            return nothing, nothing > 0
        return self.vectors[:, self._holes], self.seen.reshape(len(self.values), -1)[:, self._holes]

    @cached_property
    def _products(self) -> np.ndarray:
        """Scalar products of the textures where all show something; the filling in does not change these."""
        about = self.vectors.mean(axis=0, dtype=np.float64)
        whole = self.vectors if not len(self._holes) else np.delete(self.vectors, self._holes, axis=1)
        return gram_about(whole, about if not len(self._holes) else np.delete(about, self._holes))

    def filled(self, variance: float | int, kept: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Textures, all or some, with what says nothing filled in.

        Unseen entries start at the mean of those seen and are then filled in by the components of all (iterated PCA),
        so that a dark speckle or a border in one image is no mode of the model. Components are combinations of the
        textures, so that only entries that some texture does not show are ever looked at again.

        Returns
        -------
        vectors : (n, d) float32
        products : (n, n) float64
            Their scalar products as seen from their mean.
        """
        rows = np.arange(len(self.values)) if kept is None else kept
        vectors, (partial, seen) = self.vectors, (part[rows] for part in self._partial)
        products = self._products[np.ix_(rows, rows)]
        if seen.all():
            return vectors[rows] if kept is not None else vectors, centred(products + _gram(partial))
        counts = seen.sum(axis=0)
        means = np.where(seen, partial, 0).sum(axis=0, dtype=np.float64) / np.maximum(counts, 1)
        # What no image shows keeps its mean value as it is; its weight in a fit is 0.
        means = np.where(counts > 0, means, partial.mean(axis=0, dtype=np.float64))
        filled = np.where(seen, partial, means.astype(np.float32))
        for _ in range(FILLING_PASSES):
            # In single precision, as the values are that come of it.
            mean = filled.mean(axis=0, dtype=np.float64).astype(np.float32)
            part = strongest(centred(products + gram_about(filled, mean)), variance)[1].astype(np.float32)
            filled = np.where(seen, partial, mean + part @ (part.T @ (filled - mean)))
        vectors = vectors[rows] if kept is not None else vectors.copy()
        vectors[:, self._holes] = filled
        return vectors, centred(products + _gram(filled))


def _gram(vectors: np.ndarray) -> np.ndarray:
    return gram_about(vectors, vectors.mean(axis=0, dtype=np.float64))


def train_appearance_model(
    textures: Textures,
    variance: float | int,
    kept: np.ndarray | None = None,
    left_out: Sequence[np.ndarray] | None = None,
) -> AppearanceModel:
    """Learn an appearance model.

    Parameters
    ----------
    textures : Textures
    variance : float or int
        Fraction of variance or number of modes to keep.
    kept : (m,) int, optional
        Which of the textures to learn from; all if left out.
    left_out : sequence of int arrays, optional
        Textures that are left out together to find out what each has that the others do not explain; that is not found
        out if left out.
    """
    _, n_pixels, c = textures.values.shape
    usable = textures.usable if kept is None else textures.usable[kept]
    vectors, products = textures.filled(variance, kept)
    components = components_by(vectors, vectors.mean(axis=0, dtype=np.float64), products, variance)
    return AppearanceModel(
        mean=components.mean.reshape(n_pixels, c).astype(np.float32),
        modes=components.modes.reshape(-1, n_pixels, c).astype(np.float32),
        eigenvalues=components.eigenvalues,
        usable=usable.mean(axis=0).astype(np.float32),
        unexplained=None
        if left_out is None
        else _unexplained(vectors, explained_by_others(products, variance, left_out), usable),
    )


def _unexplained(vectors: np.ndarray, explained: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Second moments (n_pixels, c, c) of what is not explained of vectors, where they are usable (n, n_pixels).

    ``explained``: the combination of other vectors that stands for each, (n, n).
    """
    n, n_pixels = usable.shape
    if n < 2:
        explained = np.eye(n)
    left, c = (np.eye(n) - explained).astype(np.float32), vectors.shape[1] // n_pixels
    moments = np.empty((n_pixels, c, c), np.float32)
    for part in chunks(n_pixels):
        own = vectors[:, part.start * c : part.stop * c]
        residuals = (left @ (own - own.mean(axis=0))).reshape(n, -1, c)
        weighed = residuals * usable[:, part, None]
        for a in range(c):
            for b in range(a, c):
                moments[part, a, b] = moments[part, b, a] = np.einsum("in,in->n", weighed[..., a], residuals[..., b])
    return moments / np.maximum(usable.sum(axis=0), 1)[:, None, None]


def train_illumination(values: AppearanceModel, relit: Textures, variance: float | int) -> AppearanceModel:
    """Learn an illumination basis: what pictures under other lights show beyond an appearance model.

    Parameters
    ----------
    values : AppearanceModel
        The identity's appearance, learnt under one light.
    relit : Textures
        Under other lights.
    variance : float or int
        Fraction of variance or number of modes to keep.

    Returns
    -------
    AppearanceModel
        Mean zero; modes orthogonal to those of ``values`` and to its mean, so that identity, gain and
        illumination do not trade off (Kahraman et al., CVPR 2007, orthogonalise likewise).
    """
    _, n_pixels, c = relit.values.shape
    identity = np.concatenate([values.mean[None], values.modes]).reshape(-1, n_pixels * c).astype(np.float64)
    identity = np.linalg.qr(identity.T)[0].astype(np.float32)
    filled, _ = relit.filled(variance)
    beyond = filled - (filled @ identity) @ identity.T
    # Around zero, not around their mean: the mean change of light is a mode like any other.
    zero = np.zeros(n_pixels * c)
    components = components_by(beyond, zero, gram_about(beyond, zero), variance)
    return AppearanceModel(
        mean=np.zeros((n_pixels, c), np.float32),
        modes=components.modes.reshape(-1, n_pixels, c).astype(np.float32),
        eigenvalues=components.eigenvalues,
        usable=relit.usable.mean(axis=0).astype(np.float32),
    )
