"""Appearance, shading and misplaced landmarks of a fitted picture at once, each as likely as the others allow.

The invariant alone (:func:`liaam.relighting.shadow_free`) leaves most of what a picture says of the appearance unused:
brightness, and the colour that shading may take. With shading told at the same time, all three channels say something.
At a pixel x of the reference frame, the picture's log light is

    y(x) = A0(x) + sum_i lambda_i A_i(x)                 the appearance (paper eq 4)
         + sum_v beta_v(x) u_v . grad A(x)               landmarks v that lie off by u_v (eq 3, to first order)
         + (s(x) + sum_j h_j H_j(x)) 1 + c(s(x)) + e(x)  shading, and what is left.

Shading is a brightness s, smooth but for jumps, with the colour c(s): under one lamp and ambient light, log light moves
along one curve, log(a + l r), as the lamp's share r goes from shadow to full light, whatever the object. The ambient
light's own fall-off is a low polynomial H. The error e is what training pictures left out have shown, and noise. All
but c is linear: each pass solves it as weighted least squares with Gaussian priors, s eliminated pixel by pixel
(variable projection), and weighs the jumps of s anew (total variation by reweighting, as in
:mod:`liaam.relighting.shading`).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from liaam.model import AAM
from liaam.model.appearance import AppearanceModel
from liaam.model.mesh import ReferenceFrame
from liaam.photometry.invariant import CHROMATICITY
from liaam.relighting.appearance import ShadowFree
from liaam.relighting.shading import CORNER, COUPLING, UNIT, UNKNOWN, Seen, every_few, factorised

PIXELS = 2500
"""About as many pixels of the reference frame are looked at; some tens of numbers are asked of them."""

OFF = 0.5
"""Deviation of a fitted landmark from the truth, pixels of the reference frame."""

DEGREE, AMOUNT = 6, 0.2
"""Of the polynomial that shading has beyond the curve, and the deviation of its coefficients."""

BENDS = 3
"""Degree of the curve of colours."""

MADE_UP = 3.0
"""How many times the noise's variance counts: rounding and JPEG compression leave more than is measured."""

FINE_BRIGHTNESS, FINE_COLOUR = 0.03, 0.02
"""Deviations of what neither model nor shading explains, in logarithms."""

PASSES = 2
"""How often all is solved; more change nothing that can be seen."""

NO_PRIOR = 1e-6
"""Strength of a prior that is none: what is not seen at all has an answer yet."""

OUTLYING = 3.0
"""Square of a colour's distance from the curve, in medians, at which it counts half."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Colour of shading by its brightness.

    Attributes
    ----------
    low, high : float
        Brightness from where to where it is known; beyond, the colour stays as there.
    coefficients : (BENDS + 1, 2) float64
        Of Chebyshev polynomials on that range, for both rows of :data:`CHROMATICITY`.
    """

    low: float
    high: float
    coefficients: np.ndarray

    def __call__(self, brightness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Colours (n, 3) at brightnesses (n,), and their derivatives (n, 3)."""
        from numpy.polynomial import chebyshev

        at, scale = _to_unit(brightness, self.low, self.high)
        slopes = chebyshev.chebval(at, chebyshev.chebder(self.coefficients)) * (scale * (np.abs(at) < 1))
        return chebyshev.chebval(at, self.coefficients).T @ CHROMATICITY, slopes.T @ CHROMATICITY


def light_curve(brightness: np.ndarray, shading: np.ndarray, weights: np.ndarray) -> Curve:
    """Curve of a light's colours by brightness, through most of a picture's pixels.

    Parameters
    ----------
    brightness : (n,) float
        Of the shading, in logarithms.
    shading : (n, 3) float
        Shading with what errs.
    weights : (n,) float
    """
    from numpy.polynomial import chebyshev

    low, high = np.quantile(brightness[weights > 0], [0.005, 0.995]) if weights.any() else (0.0, 0.0)
    basis = chebyshev.chebvander(_to_unit(brightness, low, high)[0], BENDS)
    colours, kept = shading @ CHROMATICITY.T, weights
    ridge = 1e-6 * np.eye(BENDS + 1) * max(float(weights.sum()), 1e-12)
    coefficients = np.zeros((BENDS + 1, 2))
    for _ in range(4):  # ever less of what lies far off
        weighted = basis * kept[:, None]
        coefficients = np.linalg.solve(weighted.T @ basis + ridge, weighted.T @ colours)
        squares = np.square(colours - basis @ coefficients)
        off = (squares / np.maximum(np.median(squares[weights > 0], axis=0), 1e-12)).sum(axis=1) if kept.any() else 0.0
        kept = weights / (1.0 + off / OUTLYING)
    return Curve(float(low), float(high), coefficients)


def _to_unit(values: np.ndarray, low: float, high: float) -> tuple[np.ndarray, float]:
    """Values brought from a range to -1 to 1, and cut there; and by how much that stretches them."""
    scale = 2.0 / max(high - low, 1e-6)
    return np.clip((values - low) * scale - 1.0, -1.0, 1.0), scale


@dataclass(frozen=True, eq=False)
class Problem:
    """What is asked of some pixels of the reference frame.

    Attributes
    ----------
    seen : (n, 3) float
        Log light beyond the mean appearance.
    modes : (m, n, 3) float
        Of appearance, of shading beyond the curve, and of landmarks that lie off.
    precision : (m,) float
        Of their coordinates, before the picture is seen.
    weights : (n, 3, 3) float
        :data:`UNIT` squared times the inverse covariance of what errs; 0 where the picture says nothing.
    pairs : tuple of (k,) int
        Neighbours.
    coupling : float
        Weight of their jumps.
    """

    seen: np.ndarray
    modes: np.ndarray
    precision: np.ndarray
    weights: np.ndarray
    pairs: tuple[np.ndarray, np.ndarray]
    coupling: float

    def first_brightness(self, found: np.ndarray) -> np.ndarray:
        """Brightness of shading (n,), smooth without jumps, by first coordinates."""
        mean = self._shading(found).mean(axis=1)
        weights = self.weights.sum(axis=(1, 2))
        coupling = np.full(len(self.pairs[0]), self.coupling)
        return factorised(self.pairs, coupling, weights).solve(weights * mean)

    def solved(self, found: np.ndarray, brightness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One pass: coordinates (m,), brightness of shading (n,), and covariance of the coordinates (m, m)."""
        of_colours = np.einsum("kc,ncd,kd->n", CHROMATICITY, self.weights, CHROMATICITY)
        colour, slope = light_curve(brightness, self._shading(found), of_colours)(brightness)
        # To first order the curve's shading is brightness * along, and a rest that is known.
        along, right = 1.0 + slope, self.seen - (colour - brightness[:, None] * slope)
        weighted = np.einsum("ncd,nd->nc", self.weights, along)
        jumps = np.abs(brightness[self.pairs[0]] - brightness[self.pairs[1]])
        system = factorised(self.pairs, self.coupling / (jumps + CORNER), (weighted * along).sum(axis=1))
        mixed = np.einsum("mnc,nc->nm", self.modes, weighted)
        eliminated = system.solve(np.column_stack([mixed, (weighted * right).sum(axis=1)]))
        of_modes = np.einsum("ncd,mnd->mnc", self.weights, self.modes, optimize=True).reshape(len(mixed.T), -1)
        hessian = of_modes @ self.modes.reshape(len(of_modes), -1).T - mixed.T @ eliminated[:, :-1]
        covariance = np.linalg.inv(hessian + UNIT**2 * np.diag(self.precision))
        found = covariance @ (of_modes @ right.ravel() - mixed.T @ eliminated[:, -1])
        return found, eliminated[:, -1] - eliminated[:, :-1] @ found, UNIT**2 * covariance

    def _shading(self, found: np.ndarray) -> np.ndarray:
        return self.seen - np.tensordot(found, self.modes, axes=1)


def appearance_in_light(model: AAM, seen: Seen, start: ShadowFree, prior: float = 1.0) -> tuple[ShadowFree, np.ndarray]:
    """Appearance under the training light of a picture whose shading is not known.

    Parameters
    ----------
    model : AAM
    seen : Seen
        The picture, by its fitted landmarks.
    start : ShadowFree
        A first guess, which the invariant told.
    prior : float
        Strength of the appearance's prior, see :func:`liaam.relighting.shadow_free`.

    Returns
    -------
    appearance : ShadowFree
    displaced : (n_pixels, 3) float32
        The same where it lies in the picture: landmarks put where they belong.
    """
    known, frame = model.levels[-1].appearances["log"], model.frame
    usable = seen.usable * (known.usable > 0)
    step = max(1, round(float(np.sqrt(frame.n_pixels / PIXELS))))
    kept, pairs = every_few(frame, step)
    if not usable[kept].any():
        return start, start.log_rgb
    part, n, shares = known.at(kept), known.n_modes, _shares(frame)
    fixed = np.concatenate([part.modes, _polynomials(frame)[:, kept, None] * np.ones(3)])
    priors = (max(prior, NO_PRIOR) / np.maximum(known.eigenvalues, 1e-12), np.full(len(fixed) - n, AMOUNT**-2.0))
    precision = np.concatenate([*priors, np.full(2 * len(shares), OFF**-2.0)])
    weights = _weights(known, seen.noise, usable)[kept]
    # Solved for: lambda, the polynomial's coefficients, and the landmarks' offsets, all x before all y.
    found, covariance = np.concatenate([start.lam, np.zeros(len(precision) - n)]), np.diag(1.0 / precision)
    log_rgb, brightness = start.log_rgb, None
    for _ in range(PASSES):
        slopes = frame.gradient(log_rgb)[kept]
        offsets = np.einsum("vn,nac->avnc", shares[:, kept], slopes).reshape(-1, *part.mean.shape)
        modes = np.concatenate([fixed, offsets])
        # A jump stands for as many pixels of an edge as steps are wide, a pixel for their square.
        problem = Problem(seen.log[kept] - part.mean, modes, precision, weights, pairs, COUPLING / step)
        brightness = problem.first_brightness(found) if brightness is None else brightness
        found, brightness, covariance = problem.solved(found, brightness)
        log_rgb = known.texture(found[:n])
    offsets = found[-2 * len(shares) :].reshape(2, -1) @ shares
    displaced = log_rgb + np.einsum("an,nac->nc", offsets, frame.gradient(log_rgb))
    return ShadowFree(log_rgb, found[:n], np.sqrt(np.diag(covariance)[:n])), displaced.astype(np.float32)


def _weights(known: AppearanceModel, noise: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """See :class:`Problem`; (n_pixels, 3, 3) float64."""
    grey, every = np.ones((3, 3)), np.eye(3)
    unexplained = UNKNOWN**2 * grey if known.unexplained is None else known.unexplained
    fine = FINE_BRIGHTNESS**2 * grey + FINE_COLOUR**2 * every
    return np.linalg.inv(unexplained + fine + MADE_UP * noise[:, None] * every) * (UNIT**2 * usable)[:, None, None]


@lru_cache(maxsize=4)
def _shares(frame: ReferenceFrame) -> np.ndarray:
    """How much each landmark moves each pixel: barycentric weights beta_v(x) of eq 3, (n_points, n_pixels) float64."""
    shares = np.zeros((len(frame.points), frame.n_pixels))
    np.put_along_axis(shares, frame.vertices.T, frame.weights.T, axis=0)
    return shares


@lru_cache(maxsize=4)
def _polynomials(frame: ReferenceFrame) -> np.ndarray:
    """Products of Legendre polynomials in x and y up to :data:`DEGREE` but for the constant, (m, n_pixels) float64."""
    from numpy.polynomial import legendre

    away = frame.pixels - frame.pixels.mean(axis=0)
    down, right = legendre.legvander(away / np.abs(away).max(), DEGREE).transpose(1, 2, 0)
    return np.stack([down[i] * right[j] for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j])
