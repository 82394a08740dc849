"""Views of a model, their levels, what light does to them, and the calibration of the quality of their fits."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from liaam.formatting import short_repr
from liaam.io.files import count_of
from liaam.model.appearance import AppearanceModel
from liaam.model.presence import Presence
from liaam.model.shape import ShapeModel
from liaam.model.warp import PiecewiseAffineWarp, mesh_warp, surrounded_warp

MESH = "mesh"
SURROUNDINGS = "surroundings"

VIEWS: dict[str, Callable[..., PiecewiseAffineWarp]] = {
    MESH: mesh_warp,
    SURROUNDINGS: surrounded_warp,
}
"""Views by name: functions that make the warp of a view from the shape model, the triangles, and whether these are in
pieces."""

# Fraction of the log odds at typical below which a quality is low: 0.816 on 924 fits of unseen persons under four
# lamps. All 34 that poor starts led to a wrong place are below 0.815, all right ones above 0.84.
LOW = 2 / 3

N_QUALITY_FEATURES = 2
"""Number of features of the quality of a fit (:data:`liaam.fitting.quality.FEATURES`)."""


@dataclass(frozen=True, eq=False)
class Level:
    """The model's appearance under one blur; a fit proceeds from the most blurred level to the sharpest.

    Attributes
    ----------
    blur : float
        Standard deviation of the Gaussian blur of the encoded images, pixels of the reference frame.
    appearances : dict of str to AppearanceModel
        Appearances by name, keys of :data:`liaam.model.appearance.CHANNELS`, on the pixels of the view. Models of grey
        images lack ``invariant``; models trained without lamps lack ``varied`` and ``illumination``.
    """

    blur: float
    appearances: dict[str, AppearanceModel]


@dataclass(frozen=True, eq=False)
class Reliability:
    """Calibration of quality and covariance, learnt from fits of a method to left-out images.

    Attributes
    ----------
    landmarks : (n, 2, 2) float64
        Covariance of each landmark of left-out shapes about the nearest shape of the model, square pixels of the
        reference frame.
    bias : (n, 2, 2) float64
        Covariance of the remaining errors of fits to left-out images, beyond that of a fit.
    unit : float
        Mean variance of a residual at weight 1 in these fits. ``bias`` grows in proportion to that of a fit.
    weights : (1 + k,) float64
        Log odds that a fit is right: intercept, and coefficients of the features of the quality
        (:data:`liaam.fitting.quality.FEATURES`), of which models that are older than the last ones have fewer.
    variance_factor : float
        Factor, at least 1, by which the variances of a fit's parameters are too small, since the model biases them.
    typical : float
        5th percentile of the quality, for equal odds, of right fits to left-out images.
    prior : float
        Odds of right to wrong fits from starts near the object, of left-out images.
    final_prior : float
        Weight, at most 1, of the prior on the shape at the finest level with which left-out images are fitted best.
    expansion : float
        Factor, at least 1, on the distance of a fitted shape from the mean. With it, fits to left-out images vary as
        much as their true shapes, or as much as a small increase of their errors allows.
    presence : Presence, optional
        Calibration of whether landmarks are present; older files have none.
    scales : (n, 2, 2) float64, optional
        Symmetric matrices by which errors of each landmark that agree with the covariances above are multiplied to
        agree with those of fits to left-out images; older files have none.
    """

    landmarks: np.ndarray
    bias: np.ndarray
    unit: float
    weights: np.ndarray
    variance_factor: float
    typical: float = 0.5
    prior: float = 1.0
    final_prior: float = 1.0
    expansion: float = 1.0
    presence: Presence | None = None
    scales: np.ndarray | None = None

    __repr__ = short_repr

    @property
    def low(self) -> float:
        """Threshold of low quality: :data:`LOW` of the log odds of ``typical``."""
        odds = np.log(max(self.typical, 1e-9)) - np.log(max(1.0 - self.typical, 1e-9))
        return float(1.0 / (1.0 + np.exp(-LOW * odds)))

    def errors(self, unit: float) -> np.ndarray:
        """Covariance of each landmark (n, 2, 2), beyond that of a fit whose residuals have variance ``unit``."""
        return self.landmarks + unit / self.unit * self.bias

    def quality(self, evidence: np.ndarray) -> float:
        """Probability, 0 to 1, that a fit with the given evidence (k,) is right, for equal prior odds."""
        slopes = self.weights[1:]
        odds = self.weights[0] + slopes @ evidence[: len(slopes)]
        return float(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0)))) if np.isfinite(odds) else 0.0

    def with_prior(self, quality: float) -> float:
        """Probability that a fit near the object is right, from its quality for equal prior odds."""
        # In this order of sums, rounding does not make it larger than 1.
        return self.prior * quality / (self.prior * quality + (1.0 - quality))


@dataclass(frozen=True, eq=False)
class View:
    """Shapes, pixels, and appearances on these pixels, with which a method fits.

    Attributes
    ----------
    warp : PiecewiseAffineWarp
        Warp of the mesh, or of the mesh and its surroundings. It contains the shape model.
    levels : tuple of Level
        Appearances from coarse to fine.
    reliabilities : dict of Reliability
        Calibrations of the quality of fits, by the name of the method, as far as training has measured them.
    """

    warp: PiecewiseAffineWarp
    levels: tuple[Level, ...]
    reliabilities: Mapping[str, Reliability] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"View({self.warp.frame.n_pixels} pixels, {count_of(len(self.levels), 'level')})"

    @property
    def shape_model(self) -> ShapeModel:
        """Shape model in pixels of the reference frame; all views have the same mean."""
        return self.warp.shape_model


def shape_model_of(views: Mapping[str, View]) -> ShapeModel:
    """Return the shape model of the view that the default method fits with, or else of the mesh."""
    return views[SURROUNDINGS if SURROUNDINGS in views else MESH].shape_model
