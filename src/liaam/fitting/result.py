"""What a fit gives back. Failure is a value with a sentence a person can act on."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from liaam.fitting.methods import Method
from liaam.fitting.search import Candidate
from liaam.model.shape import Similarity


class FitStatus(StrEnum):
    """How a fit ended. Defined once, with what a person can do about it."""

    CONVERGED = "converged"
    LIGHT_UNOBSERVABLE = "light unobservable"
    DOUBTFUL = "doubtful"
    MAX_ITERATIONS = "max iterations"
    DIVERGED = "diverged"
    LEFT_IMAGE = "left the image"
    TOO_DARK = "too dark"
    SATURATED = "saturated"
    NO_TEXTURE = "no texture"

    @property
    def ok(self) -> bool:
        """Whether the landmarks may be used."""
        return self in (FitStatus.CONVERGED, FitStatus.LIGHT_UNOBSERVABLE)

    @property
    def lost(self) -> bool:
        """Whether the fit has failed, whatever its quality."""
        return not self.ok and self not in (FitStatus.DOUBTFUL, FitStatus.MAX_ITERATIONS)

    @property
    def unusable(self) -> bool:
        """Whether the picture says too little where the fit ended: other starts near by see no more."""
        return self in (FitStatus.TOO_DARK, FitStatus.SATURATED, FitStatus.NO_TEXTURE)

    @property
    def message(self) -> str:
        """What happened, and what to do about it."""
        return _MESSAGES[self]


_MESSAGES = {
    FitStatus.CONVERGED: "The fit settled.",
    FitStatus.LIGHT_UNOBSERVABLE: (
        "The fit settled. The light's colour differs too little from training, for what the model leaves "
        "unexplained, to tell the cameras' angle, so it was held."
    ),
    FitStatus.DOUBTFUL: (
        "The fit settled, but explains the picture no better than wrong fits do; look at it, and start nearer to the "
        "object if it is wrong."
    ),
    FitStatus.MAX_ITERATIONS: (
        "The fit was still moving when its iterations ran out; start nearer to the object or allow more iterations."
    ),
    FitStatus.DIVERGED: (
        "The fit lost the object (its shape collapsed, folded, blew up, or is unlike any in training); start nearer to "
        "it, or use a method that suits the light."
    ),
    FitStatus.LEFT_IMAGE: (
        "More than half of the object lies outside the picture; start inside it, or use a wider picture."
    ),
    FitStatus.TOO_DARK: (
        "Most of the object is too dark for its colour to be measured; use a brighter picture, or method 'grey'."
    ),
    FitStatus.SATURATED: (
        "Most of the object is overexposed, so its colour cannot be measured; use a darker picture, or method 'grey'."
    ),
    FitStatus.NO_TEXTURE: (
        "The picture is flat where the fit started: there is nothing to fit to; check the start and the file."
    ),
}


_NO_QUALITY = (
    "Whether it is right is not known: only method 'soft-li' with a model trained by leaving pictures out tells that; "
    "look at it."
)


@dataclass(frozen=True, eq=False)
class Iteration:
    """One accepted state of a fit.

    Attributes
    ----------
    cost : float
        Mean squared residual.
    shape : (n, 2) float64
        Landmarks, image pixels.
    theta : float
        Image angle theta_2, radians; NaN for methods without angles.
    level : int
        Level of the model, 0 the coarsest; costs compare within a level only.
    """

    cost: float
    shape: np.ndarray
    theta: float
    level: int = 0


LEAST_QUALITY = 0.5
"""Quality below which a fit that has settled is doubtful."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of fitting one image.

    Attributes
    ----------
    shape : (n, 2) float64
        Landmarks (x, y), image pixels.
    status : FitStatus
        How the fit ended; ``status.ok`` says whether to use it, ``message`` what to do.
    theta : float
        Angle of this image's camera (theta_2), radians: as estimated, or for ``soft-li`` the camera's as it was given;
        NaN for methods without angles.
    theta_model : float
        Angle of the training camera (theta_1), radians; NaN for methods without angles.
    p : (m + 4,) float64
        Shape parameters in the model's pixels, the similarity vectors last; ``pose`` maps s(p) to the image.
    pose : Similarity
        Model pixels to image pixels.
    lam : (m,) float64
        Appearance coordinates, extra modes (gain, bias) last.
    cost : float
        Mean squared residual in the method's own units.
    n_iterations : int
        Steps tried.
    history : tuple of Iteration
        Each level's start and every accepted step; the last is the result. A last step too short to be noticed has the
        cost of the state before it.
    covariance : (n_q, n_q) float64
        Covariance of (p, free angles), by the picture and the prior. What blur and (for ``soft-li``) the model's errors
        tie together is counted once, and where left-out pictures have told by how much such variances fall short, they
        are that much larger.
    landmark_covariances : (n, 2, 2) float64
        Covariance of each landmark, image pixels squared: that of p carried to the landmarks, and what fits leave of
        landmarks placed by hand, as learnt by leaving training pictures out.
    evidence : (2,) float64
        How much of the picture the fit explains, and strangeness of its shape (:func:`liaam.fitting.fitter.evidence`).
    quality : float
        Probability, 0 to 1, that the fit is right, calibrated on pictures left out of training; 0 where the status says
        that the object is lost. NaN for other methods than ``soft-li`` and for models trained without leaving out.
    method : Method
        The row that was fitted.
    found : Candidate, optional
        What the search gave the fit to start from; None where the start was given.
    n_starts : int
        From how many starts the object was fitted: more than 1 where the first fit came to little and others were
        found (:attr:`liaam.fitting.Fitter.restarts`). All else is of the fit that was kept: ``history`` and ``start``
        need not begin where the first one did.
    """

    shape: np.ndarray
    status: FitStatus
    theta: float
    theta_model: float
    p: np.ndarray
    pose: Similarity
    lam: np.ndarray
    cost: float
    n_iterations: int
    history: tuple[Iteration, ...]
    covariance: np.ndarray
    landmark_covariances: np.ndarray
    evidence: np.ndarray
    quality: float
    method: Method
    found: Candidate | None = None
    n_starts: int = 1

    def __repr__(self) -> str:
        return (
            f"FitResult({self.method.name}: {self.status}, {len(self.shape)} landmarks, {self.n_iterations} iterations)"
        )

    @property
    def message(self) -> str:
        """What happened, and what to do about it."""
        if self.status.ok and np.isnan(self.quality):
            return f"{self.status.message} {_NO_QUALITY}"
        return self.status.message

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviation of each landmark, image pixels: root of the mean variance of x and y, (n,) float64."""
        return np.sqrt(0.5 * np.trace(self.landmark_covariances, axis1=1, axis2=2))

    @property
    def place_doubtful(self) -> bool:
        """Whether a search found the place and is not sure of it, and no quality says that the fit is right."""
        return self.found is not None and self.found.doubtful and not self.quality >= LEAST_QUALITY

    @property
    def start(self) -> np.ndarray:
        """Landmarks at the start of the fit that was kept, (n, 2) float64."""
        return self.history[0].shape

    def facts(self, image_name: str) -> dict:
        """What there is to say of the fit besides its landmarks, as ``liaam fit`` writes it in its .json files."""
        from liaam import __version__
        from liaam.fitting.angles import angle_degrees  # it needs this module

        return {
            "image": image_name,
            "start": "given" if self.found is None else "searched",
            "starts_tried": self.n_starts,
            "search_score": None if self.found is None else self.found.score,
            "search_doubtful": None if self.found is None else self.place_doubtful,
            "method": self.method.name,
            "status": str(self.status),
            "message": self.message,
            "theta_deg": angle_degrees(self),
            "cost": self.cost,
            "iterations": self.n_iterations,
            "quality": None if np.isnan(self.quality) else round(self.quality, 4),
            "landmark_deviations_px": [round(float(v), 3) for v in self.deviations],
            "liaam": __version__,
        }
