"""Shadow-free appearance: what the fitted object looks like under the light of training (paper eq 11)."""

from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import MethodError
from liaam.fitting import FitResult, Fitter
from liaam.fitting.problem import correlated_pixels
from liaam.photometry.encoding import as_colour, refuse_grey

LEAST_VARIANCE = (1 / 255) ** 2 / 12
"""Of a residual: at least what rounding to 8 bits leaves of the brightest pixel's logarithm. A fit of a picture
without noise leaves less, down to rounding of float32, against which no prior would hold modes that are not seen."""


@dataclass(frozen=True, eq=False)
class ShadowFree:
    """Appearance of a fitted object under the light of the training pictures.

    Attributes
    ----------
    log_rgb : (n_pixels, 3) float32
        Logarithm of linear light at each pixel of the reference frame, A~0 + sum_i lambda_i A~_i.
    lam : (m,) float64
        Its coordinates.
    deviations : (m,) float64
        Standard deviation of each coordinate that the residual leaves, where the prior alone would leave the
        root of the mode's eigenvalue: how well the picture shows the mode.
    """

    log_rgb: np.ndarray
    lam: np.ndarray
    deviations: np.ndarray


def shadow_free(fitter: Fitter, image: np.ndarray, result: FitResult, prior: float = 1.0) -> ShadowFree:
    """Appearance under the training light, from a fit to a picture under another (paper eq 11).

    The coordinates are the most likely ones under the fit's residual and the Gaussian prior N(0, eigenvalue) of
    training: modes that the metric cannot see (shading, for a light-invariant one) stay at the mean instead of
    taking whatever noise gives them.

    Parameters
    ----------
    fitter : Fitter
        The one that made the fit; its method has to compare logarithms with the model's ``log`` appearance, or be
        ``soft-li``.
    image : (h, w, 3) array
        The picture fitted.
    result : FitResult
    prior : float
        Strength of the prior: 1 as learnt, 0 none (the paper).

    Returns
    -------
    ShadowFree

    Raises
    ------
    MethodError
        For a method without the log appearance, and for another fitter than the fit's.
    """
    check_method(fitter, result)
    method = fitter.objectives[-1].method
    if method.appearance == "soft":  # of what it measures, the invariant tells the appearance
        refuse_grey(as_colour(image), "image", "the appearance without shadows is rebuilt from colours", MethodError)
        fitter, result = replace(fitter, method="li"), replace(result, theta=np.nan)
    solution, known = fitter.settled_at(image, result)[1], fitter.view.levels[-1].appearances["log"]
    work, n, eigenvalues = solution.work, known.n_modes, known.eigenvalues
    if not work.sums[1] > 0:  # nothing of the picture can be used: what training says
        return ShadowFree(known.texture(np.zeros(n)), np.zeros(n), np.sqrt(eigenvalues))
    # In units of the residual's variance, as for the shape's prior.
    variance = correlated_pixels(fitter.view.levels[-1].blur) * max(float(solution.costs[-1]), LEAST_VARIANCE)
    precision = np.zeros(len(work.lam))
    precision[:n] = prior * variance / np.maximum(eigenvalues, 1e-12)
    modes = (work.rows[1:] * work.root).astype(np.float64)
    gram = modes @ modes.T
    # Modes that are not seen may have lost their sign to rounding; how far is luck, and nothing to hold others by.
    curvatures, axes = np.linalg.eigh(gram)
    ridge = 1e-9 * float(np.diag(gram).max())
    hessian = (axes * (np.maximum(curvatures, 0.0) + ridge)) @ axes.T + np.diag(precision)
    best = np.linalg.solve(hessian, gram @ work.lam + modes @ (work.root * work.residual))
    spread = np.sqrt(np.diag(np.linalg.inv(hessian)) * variance)
    return ShadowFree(known.texture(best[:n]), best[:n], spread[:n])


def check_method(fitter: Fitter, result: FitResult) -> None:
    """Complain about a fit from which no appearance can be rebuilt, and about another fitter than the fit's."""
    method = fitter.objectives[-1].method
    if method.appearance not in ("log", "soft"):
        raise MethodError(
            f"method {result.method.name} does not fit the appearance of log-RGB, so nothing can be rebuilt from it; "
            "fit with 'soft-li', 'li', 'li-pc', 'li-pcs' or 'chroma'"
        )
    if method != result.method:
        raise MethodError(f"the fit was made with method {result.method.name}, not {method.name}; give its own fitter")
