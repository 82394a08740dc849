"""Appearance models: PCA of textures sampled on the reference frame (paper eq 4)."""

from dataclasses import dataclass

import numpy as np

from liaam.pca import Components, principal_components, unexplained_by_others

CHANNELS = {"value": 3, "log": 3, "orientation": 2, "soft": 3, "invariant": 1, "varied": 3, "illumination": 3}
"""Appearances a model may hold, and their channels.

``value``, ``log`` and ``orientation``: in the encoding of that name. ``soft``: the two components of the softly
normalised gradient and L(theta) . log RGB, on the mesh and its surroundings. ``invariant``: L(theta) . log RGB,
projected before the PCA (the paper's LIT). ``varied``: values under the training light and the lights of further
pictures in one PCA (training with lighting variation, the paper's [11]). ``illumination``: what those further
pictures show that ``value`` cannot explain, as modes to be added to it (the illumination basis of AIA, the paper's
[6]).
"""

APPEARANCES = tuple(name for name in CHANNELS if name != "illumination")
"""Those that a method can be compared with on their own."""

SURROUNDED = ("soft",)
"""Those learnt on the mesh with its surroundings (:class:`liaam.mesh.Surroundings`); the others on the mesh alone."""


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


def _fill(vectors: np.ndarray, seen: np.ndarray, variance: float | int) -> tuple[np.ndarray, Components]:
    """Vectors some of whose entries say nothing, filled in, and their principal components.

    Unseen entries start at the mean of those seen and are then filled in by the components of all (iterated
    PCA), so that a dark speckle or a border in one image is no mode of the model.
    """
    if seen.all():
        return vectors, principal_components(vectors, variance)
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
    return filled, components


def train_appearance_model(
    textures: np.ndarray, usable: np.ndarray, variance: float | int, leave_out: bool = True
) -> AppearanceModel:
    """Learn an appearance model.

    Parameters
    ----------
    textures : (n_images, n_pixels, c) float32
    usable : (n_images, n_pixels) or (n_images, n_pixels, c) float32 in {0, 1}
        Where channels differ, a pixel counts as usable where any of them is.
    variance : float or int
        Fraction of variance or number of modes to keep.
    leave_out : bool
        Find out what each image has that the others do not explain.
    """
    n, n_pixels, c = textures.shape
    if usable.ndim == 2:
        seen = np.repeat(usable > 0, c, axis=1).reshape(n, -1)
    else:
        seen, usable = (usable > 0).reshape(n, -1), usable.max(axis=2)
    filled, components = _fill(textures.reshape(n, -1), seen, variance)
    return AppearanceModel(
        mean=components.mean.reshape(n_pixels, c).astype(np.float32),
        modes=components.modes.reshape(-1, n_pixels, c).astype(np.float32),
        eigenvalues=components.eigenvalues,
        usable=usable.mean(axis=0).astype(np.float32),
        unexplained=_covariance(unexplained_by_others(filled, variance).reshape(textures.shape), usable)
        if leave_out
        else None,
    )


def _covariance(residuals: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Second moments (n_pixels, c, c) of residuals (n, n_pixels, c) over the images in which a pixel was usable."""
    moments = np.einsum("in,inc,ind->ncd", usable, residuals, residuals, optimize=True)
    return (moments / np.maximum(usable.sum(axis=0), 1)[:, None, None]).astype(np.float32)


def train_illumination(
    values: AppearanceModel, lit: np.ndarray, usable: np.ndarray, variance: float | int
) -> AppearanceModel:
    """Learn an illumination basis: what pictures under other lights show beyond an appearance model.

    Parameters
    ----------
    values : AppearanceModel
        The identity's appearance, learnt under one light.
    lit : (n_images, n_pixels, c) float32
        Textures under other lights.
    usable : (n_images, n_pixels) float32 in {0, 1}
    variance : float or int
        Fraction of variance or number of modes to keep.

    Returns
    -------
    AppearanceModel
        Mean zero; modes orthogonal to those of ``values`` and to its mean, so that identity, gain and
        illumination do not trade off (Kahraman et al., CVPR 2007, orthogonalise likewise).
    """
    n, n_pixels, c = lit.shape
    identity = np.concatenate([values.mean[None], values.modes]).reshape(-1, n_pixels * c).astype(np.float64)
    identity = np.linalg.qr(identity.T)[0]
    filled, _ = _fill(lit.reshape(n, -1), np.repeat(usable > 0, c, axis=1).reshape(n, -1), variance)
    beyond = filled - (filled @ identity) @ identity.T
    # Around zero, not around their mean: the mean change of light is a mode like any other.
    components = principal_components(np.concatenate([beyond, -beyond]), variance)
    return AppearanceModel(
        mean=np.zeros((n_pixels, c), np.float32),
        modes=components.modes.reshape(-1, n_pixels, c).astype(np.float32),
        eigenvalues=components.eigenvalues,
        usable=usable.mean(axis=0).astype(np.float32),
    )
