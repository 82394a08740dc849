"""What a method fits with: the views of a model, their levels, and how far their fits can be trusted."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from liaam.model.appearance import AppearanceModel
from liaam.model.shape import ShapeModel
from liaam.model.warp import PiecewiseAffineWarp, mesh_warp, surrounded_warp

MESH, SURROUNDINGS = "mesh", "surroundings"

VIEWS: dict[str, Callable[[ShapeModel, np.ndarray], PiecewiseAffineWarp]] = {
    MESH: mesh_warp,
    SURROUNDINGS: surrounded_warp,
}
"""What a view may show, by its name: the warp that carries its pixels, made of shapes and triangles."""

LITTLE = 2 / 3
"""Share of the log odds at :attr:`Reliability.ordinary` that are little. Measured on strangers of IMM, 924 fits under
four lamps, models with an ordinary quality of 0.90: all 34 fits that end in a wrong place for want of a better start
have less than 0.815, and no right one has less than 0.84; two thirds of the log odds is 0.816."""


@dataclass(frozen=True, eq=False)
class Level:
    """The model's appearance at one sharpness; a fit goes from the blurred levels to the sharp one.

    Attributes
    ----------
    blur : float
        Standard deviation of the Gaussian blur of the encoded images, pixels of the reference frame.
    appearances : dict of str to AppearanceModel
        By name of :data:`liaam.model.appearance.CHANNELS`, all on the pixels of the view. ``invariant`` is absent from
        a model trained on grey pictures; ``varied`` and ``illumination`` from one trained without lamps.
    """

    blur: float
    appearances: dict[str, AppearanceModel]


@dataclass(frozen=True, eq=False)
class Reliability:
    """What fits of the default method to pictures left out of training tell of those to come by the same method.

    Attributes
    ----------
    landmarks : (n, 2, 2) float64
        Covariance of each landmark beyond what a fit states of itself, square pixels of the reference frame.
    weights : (3,) float64
        Log odds that a fit is right: of 1, of the share of the picture it explains, and of its shape's strangeness.
    understated : float
        How many times the variances of a fit's parameters are what it states of itself, at least 1: shapes and
        appearances that the model lacks move the others, too.
    ordinary : float
        Quality that nearly all right fits have: 5 % of those to left-out pictures have less.
    """

    landmarks: np.ndarray
    weights: np.ndarray
    understated: float
    ordinary: float = 0.5

    @property
    def little(self) -> float:
        """Quality far below the ordinary: that of :data:`LITTLE` of its log odds."""
        odds = np.log(max(self.ordinary, 1e-9)) - np.log(max(1.0 - self.ordinary, 1e-9))
        return float(1.0 / (1.0 + np.exp(-LITTLE * odds)))

    def quality(self, evidence: np.ndarray) -> float:
        """Probability, 0 to 1, that a fit of some evidence (2,) is right, where right and wrong are as likely."""
        odds = self.weights[0] + self.weights[1:] @ evidence
        return float(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0)))) if np.isfinite(odds) else 0.0


@dataclass(frozen=True, eq=False)
class View:
    """What a method fits with: shapes, pixels, and the appearances on these.

    Attributes
    ----------
    warp : PiecewiseAffineWarp
        Of the mesh, or of the mesh and its surroundings; it holds the shapes.
    levels : tuple of Level
        Appearances from coarse to fine.
    reliability : Reliability, optional
        What tells right fits from wrong ones, where training has found out.
    """

    warp: PiecewiseAffineWarp
    levels: tuple[Level, ...]
    reliability: Reliability | None = None

    @property
    def shape_model(self) -> ShapeModel:
        """Shapes in pixels of the reference frame; those of all views have the same mean."""
        return self.warp.shape_model


def make_view(
    name: str,
    shape_model: ShapeModel,
    triangles: np.ndarray,
    levels: tuple[Level, ...] = (),
    reliability: Reliability | None = None,
) -> View:
    """View of one of the names :data:`VIEWS`."""
    return View(VIEWS[name](shape_model, triangles), levels, reliability)
