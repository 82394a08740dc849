"""Fits to images left out of training: how far from the truth they are, and how far they say that they are."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from liaam.fitting.quality import expanded_covariance, fitted_covariances
from liaam.io.files import count_of, some_names
from liaam.model.contours import Contours, contour_turns, outline_errors
from liaam.model.regressor import USUAL_SHARE
from liaam.model.shape import ShapeModel, diagonal_of, expanded_about
from liaam.training.covariances import surprise
from liaam.training.presence import AgreementOfFit

# Mean distance from the landmarks as a fraction of the shape's diagonal, of landmarks on contours from the contours: a
# fit is right up to the first and wrong beyond the second. Fits in between are not used.
RIGHT = 0.03
WRONG = 0.06
USUALLY_WRONG = 0.1  # Share of fits from near the object up to which nothing is wrong with the training images


@dataclass(frozen=True, eq=False)
class LeftOutFit:
    """A fit to a left-out image.

    Attributes
    ----------
    near : bool
        Whether it started near the object.
    error : float
        Mean distance of the landmarks from the true ones, or of those on contours from the true contours, as a fraction
        of the shape's diagonal.
    evidence : (k,) float64
        Features of quality, as of the result.
    unit : float
        Variance of a residual at weight 1.
    shapes : ShapeModel
        The shape model of the fit.
    contours : tuple of (indices, closed)
        Lines through landmarks.
    truth : (n, 2) float64
        True landmarks, pixels of the frame.
    known : (n,) bool
        Which of these are known; the others are estimates.
    p : (n_p,) float64
        Shape parameters of the fit.
    covariance : (n_q, n_q) float64
        Covariance of p, and of the angles.
    expansion : float
        Factor on the distance of the fitted shape from the mean.
    agreement : AgreementOfFit, optional
        Of right fits of methods that say which landmarks are present.
    refinement : (n, 2) float64, optional
        What a refiner has added to the landmarks, pixels of the frame; None without.
    name : str
        Of the image.
    """

    near: bool
    error: float
    evidence: np.ndarray
    unit: float
    shapes: ShapeModel
    contours: Contours
    truth: np.ndarray
    known: np.ndarray
    p: np.ndarray
    covariance: np.ndarray
    expansion: float = 1.0
    agreement: AgreementOfFit | None = None
    refinement: np.ndarray | None = None
    name: str = ""

    @property
    def right(self) -> bool:
        """Whether the fit is right."""
        return self.error <= RIGHT

    @property
    def wrong(self) -> bool:
        """Whether the fit is wrong."""
        return self.error > WRONG

    @property
    def landmarks(self) -> np.ndarray:
        """Fitted landmarks, (n, 2) float64, pixels of the frame."""
        return self.landmarks_at(self.expansion)

    def landmarks_at(self, expansion: float) -> np.ndarray:
        """Return the landmarks (n, 2) with the shape at as many times its distance from the mean."""
        if self.refinement is None:
            return self.shapes.shape(self.shapes.expanded(self.p, expansion))
        return expanded_about(self.shapes.mean, self.shapes.shape(self.p) + self.refinement, expansion)

    def expanded(self, expansion: float) -> "LeftOutFit":
        """Return the fit with its shape at as many times its distance from the mean."""
        return replace(self, expansion=expansion)._with_error()

    def refined_by(self, share: float) -> "LeftOutFit":
        """Return the fit with a share of the way to where its refiner leads, of which it has :data:`USUAL_SHARE`."""
        if self.refinement is None:
            return self
        return replace(self, refinement=share / USUAL_SHARE * self.refinement)._with_error()

    def unrefined(self) -> "LeftOutFit":
        """Return the fit without what a refiner has added."""
        return self if self.refinement is None else replace(self, refinement=None)._with_error()

    def _with_error(self) -> "LeftOutFit":
        """Return the fit with the error of its landmarks."""
        errors = outline_errors(self.landmarks, self.truth, self.contours)[self.known]
        return replace(self, error=float(errors.mean() / diagonal_of(self.truth)))

    @property
    def errors(self) -> np.ndarray:
        """True minus fitted landmarks, (n, 2) float64, turned from the contours of the image to those of the mean.

        NaN where the true one is not known.
        """
        errors = np.einsum("nab,nb->na", self._turns, self.truth - self.landmarks)
        return np.where(self.known[:, None], errors, np.nan)

    @property
    def spreads(self) -> np.ndarray:
        """Covariances of the landmarks by the fit, (n, 2, 2) float64, turned as the errors."""
        fitted = fitted_covariances(self.shapes, expanded_covariance(self.covariance, len(self.p), self.expansion))
        return self._turns @ fitted @ np.swapaxes(self._turns, 1, 2)

    @property
    def surprise(self) -> float:
        """Squared error of p in units of its covariance, 1 on average if that is right.

        Landmarks that are not known count as right, and the result is divided by the share of the others.
        """
        compared = np.where(self.known[:, None], self.truth, self.landmarks)
        error = self.shapes.parameters(compared) - self.shapes.parameters(self.landmarks)
        stated = expanded_covariance(self.covariance, len(self.p), self.expansion)
        return surprise(error, stated) / float(self.known.mean())

    @cached_property
    def _turns(self) -> np.ndarray:
        """Rotations (n, 2, 2) from the contours of the image to those of the mean shape."""
        return contour_turns(self.truth, self.shapes.mean, self.contours)


@dataclass(eq=False)
class LeftOutFits:
    """The fits of a method to left-out images.

    Attributes
    ----------
    final_prior : float
        Weight of the prior on the shape at the finest level of these fits.
    expansion : float
        Factor on the distance of the fitted shapes from the mean.
    fits : list of LeftOutFit
        Fits from starts near the object and from others, without those whose status says that they are lost.
    n_near : int
        Number of starts near the object, also of lost fits.
    lost : list of str
        Names of the images in which a fit from near the object is lost.
    """

    final_prior: float = 1.0
    expansion: float = 1.0
    fits: list[LeftOutFit] = field(default_factory=list)
    n_near: int = 0
    lost: list[str] = field(default_factory=list)

    @property
    def near_right(self) -> list[LeftOutFit]:
        """Right fits from starts near the object."""
        return [fit for fit in self.fits if fit.near and fit.right]

    @property
    def n_near_right(self) -> int:
        """Number of right fits from starts near the object."""
        return len(self.near_right)

    @property
    def near_error(self) -> float:
        """Mean error of the right fits from starts near the object, as a fraction of the diagonal; NaN without any."""
        errors = [fit.error for fit in self.near_right]
        return float(np.mean(errors)) if errors else np.nan

    def expanded(self, expansion: float) -> "LeftOutFits":
        """Return the fits with shapes at as many times their distance from the mean."""
        fits = self.fits if expansion == 1.0 else [fit.expanded(expansion) for fit in self.fits]
        return replace(self, fits=fits, expansion=expansion)

    def refined_by(self, share: float) -> "LeftOutFits":
        """Return the fits with a share of the way to where their refiners lead, of which they have the usual one."""
        return replace(self, fits=[fit.refined_by(share) for fit in self.fits])

    def unrefined(self) -> "LeftOutFits":
        """Return the fits without what refiners have added."""
        return replace(self, fits=[fit.unrefined() for fit in self.fits])

    def with_others(self, fits: list[LeftOutFit]) -> "LeftOutFits":
        """Return these fits with other ones after them, whose shapes are expanded alike."""
        others = fits if self.expansion == 1.0 else [fit.expanded(self.expansion) for fit in fits]
        return replace(self, fits=[*self.fits, *others])

    def describe(self) -> str:
        """Describe the accuracy of fits from starts near the object, for a model's card; empty if there are none."""
        if not self.n_near:
            return ""
        counts = f"{self.n_near_right} of {count_of(self.n_near, 'fit')} from starts near the object are right"
        right = f"in left-out images, {counts} (error at most {RIGHT:.0%} of the diagonal of the landmarks' box)"
        if not self.n_near_right:
            return right
        return f"{right}; the mean error of right fits is {self.near_error:.1%}"

    def describe_faults(self) -> str:
        """Say which fits from near the object are not right, if these are more than a few; empty otherwise."""
        n_wrong = self.n_near - self.n_near_right
        if n_wrong <= USUALLY_WRONG * self.n_near:
            return ""
        names = [*self.lost, *(fit.name for fit in self.fits if fit.near and not fit.right)]
        return (
            f"{n_wrong} of {count_of(self.n_near, 'fit')} to left-out images are not right, although they started near "
            f"the object ({some_names(list(dict.fromkeys(names)))}): look whether the landmarks of these images follow "
            "the convention of the others, or train on more images"
        )
