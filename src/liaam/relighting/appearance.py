"""Shadow-free appearance: the fitted object under the light of training (paper eq 11)."""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from liaam.errors import MethodError
from liaam.fitting import FitResult, Fitter
from liaam.fitting.loop.encoded_image import correlated_pixels
from liaam.fitting.solution import solution_at
from liaam.formatting import short_repr
from liaam.model import AAM, MESH
from liaam.model.appearance import AppearanceModel
from liaam.photometry.encoding import refuse_grey
from liaam.photometry.picture import load_picture

LEAST_VARIANCE = (1 / 255) ** 2 / 12
"""Lower bound on a residual's variance: rounding to 8 bits of the logarithm of the brightest pixel. Without it, fits of
images without noise leave so small a residual that the prior cannot hold unobserved modes."""


@dataclass(frozen=True, eq=False)
class ShadowFree:
    """Appearance of a fitted object under the light of the training images.

    Attributes
    ----------
    log_rgb : (n_pixels, 3) float32
        Logarithm of linear light at each pixel of the reference frame, A~0 + sum_i lambda_i A~_i (eq 11).
    lam : (m,) float64
        Coordinates of the appearance, lambda.
    deviations : (m,) float64
        Posterior standard deviation of each coordinate. The square root of the mode's eigenvalue is its prior standard
        deviation; a much smaller value means that the image shows the mode well.
    light : (k,) float64
        Coordinates of the image's light in the model's light basis; empty if the model has none, or they were not
        estimated.
    """

    log_rgb: np.ndarray
    lam: np.ndarray
    deviations: np.ndarray
    light: np.ndarray = field(default_factory=lambda: np.zeros(0))

    __repr__ = short_repr

    @classmethod
    def unseen(cls, learnt: AppearanceModel) -> "ShadowFree":
        """Return the mean appearance, which is all that is known without an image."""
        return cls(learnt.mean, np.zeros(learnt.n_modes), np.sqrt(learnt.eigenvalues))


def shadow_free(fitter: Fitter, image, result: FitResult, prior: float = 1.0) -> ShadowFree:
    """Compute the appearance under the training light from a fit to an image under another light (paper eq 11).

    The coordinates maximise the posterior of the fit's residual and the Gaussian prior N(0, eigenvalue) of training.
    The prior keeps modes that the metric cannot observe (shading, for a light-invariant metric) at the mean.

    Parameters
    ----------
    fitter : Fitter
        The fitter of ``result``. Its method must be ``soft-li``, or compare logarithms with the model's ``log``
        appearance.
    image : (h, w, 3) uint8, uint16 or float array, or path
        The fitted image.
    result : FitResult
    prior : float
        Strength of the prior: 1 as learnt, 0 none (the paper).

    Returns
    -------
    ShadowFree

    Raises
    ------
    MethodError
        If the method has no log appearance, or ``result`` is from another method than the fitter's.
    """
    check_method(fitter, result)
    fitter = fitter.part_for(result)
    if fitter.objectives[-1].method.appearance == "soft":  # use the invariant alone, as 'li' does
        image, name = load_picture(image, "image")
        refuse_grey(image, name, "the appearance without shadows is computed from colours", MethodError)
        fitter = by_invariant(fitter)
        result = replace(result, theta=np.nan)
    seen = solution_at(fitter, image, result)
    learnt = fitter.view.levels[-1].appearances["log"]
    n = learnt.n_modes
    eigenvalues = learnt.eigenvalues
    if not seen["weight"] > 0:  # no pixel is usable
        return ShadowFree.unseen(learnt)
    # In units of squared residuals, like the shape prior.
    variance = correlated_pixels(fitter.view.levels[-1].blur) * max(seen["squares"] / seen["weight"], LEAST_VARIANCE)
    precision = np.zeros(len(seen["lam"]))
    precision[:n] = prior * variance / np.maximum(eigenvalues, 1e-12)
    modes = (seen["modes"][1:] * seen["masked"]).astype(np.float64)
    gram = modes @ modes.T
    # Rounding may make the eigenvalues of unobserved modes negative, by less than this.
    hessian = gram + np.diag(precision + 1e-9 * np.diag(gram).max())
    best = np.linalg.solve(hessian, gram @ seen["lam"] + modes @ (seen["masked"] * seen["residual"]))
    spread = np.sqrt(np.diag(np.linalg.inv(hessian)) * variance)
    return ShadowFree(learnt.texture(best[:n]), best[:n], spread[:n])


@lru_cache(maxsize=4)
def by_invariant(fitter: Fitter) -> Fitter:
    """Return a fitter by the invariant alone, of the sharpest level: models need not have ``log`` at the others."""
    return replace(fitter, model=fitter.model.with_view(MESH, levels=fitter.model.levels[-1:]), method="li")


def check_method(fitter: Fitter, result: FitResult | None = None) -> None:
    """Raise an error if a fitter's method has no appearance for relighting, or is not that of the fit."""
    method = fitter.objectives[-1].method
    if method.appearance not in ("log", "soft"):
        raise MethodError(
            f"method {method.name} does not fit a log-RGB appearance, which relighting needs; "
            "use 'soft-li', 'li', 'li-pc', 'li-pcs' or 'chroma'"
        )
    if result is not None and method != result.method:
        raise MethodError(
            f"the fit was made with method {result.method.name}, but the fitter has {method.name}; use the fit's fitter"
        )


def check_colour(model: AAM, name: str = "") -> None:
    """Raise an error if a model was trained on grey images."""
    if not model.is_colour:
        raise MethodError(
            f"{name or model.name or 'the model'}: the model was trained on grey images, and estimating shading needs "
            "colour; train on colour images"
        )
