"""The result of a fit. A fit that fails is a result too, with a status and a message."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.drawing import DOUBTFUL, LANDMARK, LOST, new_axes, plot_landmarks, png_bytes, zoom_to
from liaam.errors import LiaamError
from liaam.fitting.detection import Detection, are_beside
from liaam.fitting.loop.levels import FittedLevel
from liaam.fitting.methods import Method
from liaam.formatting import finite_list, short_repr
from liaam.io.files import count_of, some_names
from liaam.io.landmarks.base import PRESENT
from liaam.model.contours import Contours
from liaam.model.shape import Similarity
from liaam.photometry.picture import load_picture
from liaam.tables import Columns, landmark_columns, to_dataframe

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes


class FitStatus(StrEnum):
    """How a fit ended, with a message that says what to do."""

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
        """Whether the image lacks usable pixels at the object, so that other starts nearby fail as well."""
        return self in (FitStatus.TOO_DARK, FitStatus.SATURATED, FitStatus.NO_TEXTURE)

    @property
    def message(self) -> str:
        """What happened, and what to do."""
        return _MESSAGES[self]

    @property
    def colour(self) -> str:
        """Colour in which a fit is drawn: green if it may be used, red if it has failed, or else amber."""
        if self.ok:
            return LANDMARK
        return LOST if self.lost else DOUBTFUL


USABLE = frozenset(str(status) for status in FitStatus if status.ok)
"""Statuses of fits whose landmarks may be used, as written in files."""

_MESSAGES = {
    FitStatus.CONVERGED: "The fit converged.",
    FitStatus.LIGHT_UNOBSERVABLE: (
        "The fit converged. The light's colour is too close to that of training to estimate the camera's angle, which "
        "was kept fixed."
    ),
    FitStatus.DOUBTFUL: (
        "The fit converged, but its quality is low: in training, fits that matched so badly were mostly wrong. Check "
        "the landmarks, and start nearer to the object if they are wrong."
    ),
    FitStatus.MAX_ITERATIONS: (
        "The fit did not converge within its iterations; start nearer to the object or allow more iterations."
    ),
    FitStatus.DIVERGED: (
        "The fit diverged (its shape collapsed, folded, grew too large, or is unlike any in training); start nearer to "
        "the object, or use a method that suits the light."
    ),
    FitStatus.LEFT_IMAGE: (
        "More than half of the object lies outside the image; start inside it, or use a wider image."
    ),
    FitStatus.TOO_DARK: (
        "Most of the object is too dark for its colour to be measured; use method 'soft-li' or 'grey', or a brighter "
        "image."
    ),
    FitStatus.SATURATED: (
        "Most of the object is overexposed, so its colour cannot be measured; use method 'soft-li' or 'grey', or a "
        "darker image."
    ),
    FitStatus.NO_TEXTURE: (
        "The image has no texture, or no valid values, where the fit started; check the start and the file."
    ),
}


# Share of the landmarks that must be present: a fit of which most landmarks are absent may as well be elsewhere
LEAST_PRESENT = 0.5
MOST_NAMED = 10  # Largest number of absent landmarks that a message names

_NO_QUALITY = (
    "Its quality is unknown and its ellipses are not calibrated: this takes method 'soft-li', or one that was "
    "named in training, and a model trained by leaving images out; check the landmarks."
)

_NOTHING_SAYS_SO = (
    "The fit converged, but nothing says that it is right: it explains no more of the image than chance does, or in "
    "training too few fits to left-out images were right ('liaam show MODEL' says so). Check the landmarks, and train "
    "on more images."
)


_MOSTLY_ABSENT = (
    "The fit converged, but the image around most of its landmarks is not what the model expects, so that it may as "
    "well be in the wrong place. Check the landmarks, and start nearer to the object if they are wrong."
)

_GREY = "The image is grey, unlike those of training, so that its landmarks are less certain."

_AT_START = "It ended far from its start, so it was discarded: the landmarks are those of the start."


@dataclass(frozen=True, eq=False)
class Iteration:
    """One accepted state of a fit.

    Attributes
    ----------
    cost : float
        Mean squared residual.
    landmarks : (n, 2) float64
        Image pixels.
    theta : float
        Image angle theta_2, radians; NaN for methods without angles.
    level : int
        Level, 0 the coarsest that the fit used; costs of different levels are not comparable.
    """

    cost: float
    landmarks: np.ndarray
    theta: float
    level: int = 0

    __repr__ = short_repr


ABSENT = ("empty", "estimate")
"""What tables and files hold of absent landmarks: nothing, or the estimates of their positions."""

LEAST_QUALITY = 0.5
"""Quality for equal odds of right and wrong fits below which a converged fit is doubtful."""


def trace(stages: Sequence[FittedLevel]) -> tuple[Iteration, ...]:
    """Return the start and every accepted state of all levels."""
    return tuple(
        Iteration(cost, shape, theta if stage.objective.method.has_angles else np.nan, level)
        for level, stage in enumerate(stages)
        for cost, shape, (_, theta) in zip(
            stage.solution.costs.tolist(),
            stage.shapes(stage.solution.path),
            stage.solution.angle_history.tolist(),
            strict=True,
        )
    )


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of fitting one image.

    Attributes
    ----------
    landmarks : (n, 2) float64
        Fitted landmarks (x, y), image pixels: those to measure, with the ``shift``.
    status : FitStatus
        How the fit ended. Use the landmarks if ``status.ok``; ``message`` says what to do.
    theta : float
        Angle of this image's camera (theta_2), radians: the estimate, or for ``soft-li`` the given camera's; NaN for
        methods without angles.
    theta_model : float
        Angle of the training camera (theta_1), radians; NaN for methods without angles.
    p : (m + 4,) float64
        Shape parameters in model pixels (eq 2), the similarity vectors last; ``pose`` maps s(p) to the image, where it
        is ``landmarks``, before a refiner moves them.
    pose : Similarity
        Model pixels to image pixels; with a reflection if the object was ``reflected``.
    lam : (m,) float64
        Appearance coordinates lambda (eq 4), extra modes (gain, bias) last.
    cost : float
        Mean squared residual, in the method's units.
    n_iterations : int
        Number of steps, rejected ones included.
    history : tuple of Iteration
        Each level's start and every accepted step; the last is the result, before its ``expansion``. If the last step
        was negligible, its cost is that before the step.
    covariance : (n_q, n_q) float64
        Covariance of (p, free angles), given the image and the prior. It accounts for correlation by the blur and (for
        ``soft-li``) by the model's errors, and is scaled up if left-out images showed larger errors.
    landmark_covariances : (n, 2, 2) float64
        Covariance of each landmark, image pixels squared: that of p propagated to the landmarks, plus the errors
        measured on left-out training images. Meaningful only if ``status.ok``.
    residual_variance : float
        Variance of a residual at weight 1: what the model leaves unexplained in this image. The landmarks' covariances
        grow with it.
    evidence : (k,) float64
        Explained contrast, and the shape's distance from the mean
        (:func:`liaam.fitting.quality.quality_features`).
    quality : float
        Probability, 0 to 1, that the fit is right, calibrated on left-out training images, with as many right fits as
        among those from starts near the object; for equal odds if an uncertain detection was the start. 0 if the fit
        has failed. NaN for methods that training has not calibrated and for models trained without leaving out.
    least_quality : float
        Quality below which a converged fit is doubtful: more likely than not, its image is one of a wrong fit.
    method : Method
        The fitted method.
    present : (n,) float64, optional
        Probability that the tissue at each landmark is what the model expects, from how well image and fit agree around
        it, calibrated on left-out training images; see :attr:`absent`. None for methods and models without that.
    found : Detection, optional
        The detection that the fit started from; None if the start was given.
    side : str
        Side of the object, ``left`` or ``right``, or ``original`` or ``mirrored`` if training knew no names of the
        sides; empty if the model has one side only (:attr:`liaam.AAM.sides`). Of both fits, that of the likelier side
        is kept.
    reflected : bool
        Whether the object is of the other side than the model, so that the image reversed left to right was fitted. The
        landmarks are in the image as it is; `p` and `lam` are those of the reversed object.
    part : int
        Index of the shape of the model that was fitted (:attr:`liaam.AAM.parts`).
    n_starts : int
        Number of starts, more than 1 after restarts (:attr:`liaam.fitting.Fitter.restarts`). All other attributes,
        also ``history`` and ``start``, describe the fit that was kept.
    expansion : float
        Factor, at least 1, on the distance of the fitted shape from the mean shape, that the model has learnt from
        left-out images, so that shapes vary as much as the objects do
        (:attr:`liaam.model.Reliability.expansion`). :attr:`registered` is without it.
    shift : (n, 2) float64, optional
        What that factor and the model's refiner (:attr:`liaam.AAM.refiner`) added to the landmarks, image pixels; None
        without both.
    at_start : bool
        Whether the landmarks are those of the start, since the fit may not be used and ended far from there
        (:mod:`liaam.fitting.fallback`). ``history`` then ends with the start.
    without_colour : bool
        Whether the image is grey, and the method would compare colours, too, so that the landmarks are less certain.
    contours : tuple of (indices, closed)
        Lines through landmarks, for drawing, and along which landmarks are less certain than across.
    landmark_names : tuple of str
        One name per landmark, or empty if the training images have none.
    image : array or Path, optional
        The image that was fitted: its path, or the array if :func:`liaam.fit` was given one. Other functions keep no
        arrays, so that many results do not fill the memory.
    """

    landmarks: np.ndarray
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
    residual_variance: float
    evidence: np.ndarray
    quality: float
    method: Method
    present: np.ndarray | None = None
    found: Detection | None = None
    least_quality: float = LEAST_QUALITY
    side: str = ""
    reflected: bool = False
    part: int = 0
    n_starts: int = 1
    expansion: float = 1.0
    shift: np.ndarray | None = None
    at_start: bool = False
    without_colour: bool = False
    contours: Contours = ()
    landmark_names: tuple[str, ...] = ()
    image: np.ndarray | Path | None = None

    @property
    def registered(self) -> np.ndarray:
        """Landmarks (n, 2) at which the model matches the image best, to compare pixels: without ``shift``."""
        return self.landmarks if self.shift is None else self.landmarks - self.shift

    def __repr__(self) -> str:
        counts = f"{len(self.landmarks)} landmarks, {count_of(self.n_iterations, 'iteration')}"
        side = f", {self.side}" if self.side else ""
        return f"FitResult({self.method.name}: {self.status}, quality {self.quality_text}{side}, {counts})"

    def reported(self, absent: str = "empty") -> tuple[np.ndarray, np.ndarray]:
        """Return positions (n, 2) and covariances (n, 2, 2) for tables and files.

        Those of absent landmarks are NaN in fits whose status is ok, or the estimates if ``absent`` is "estimate".
        """
        check_absent(absent)
        if absent == "estimate" or not self.status.ok:
            return self.landmarks, self.landmark_covariances
        positions = np.where(self.absent[:, None], np.nan, self.landmarks)
        return positions, np.where(self.absent[:, None, None], np.nan, self.landmark_covariances)

    @property
    def _absent_text(self) -> str:
        """Which landmarks are absent, by name or by number from 1, and what that means; empty if none is."""
        indices = np.flatnonzero(self.absent).tolist()
        if not indices or not self.status.ok:
            return ""
        names = [self.landmark_names[i] if self.landmark_names else str(i + 1) for i in indices]
        return (
            f" Absent: {some_names(names, MOST_NAMED)}. The image there is not what the model expects, so the fit goes "
            "without it; it only estimates these positions, from the other landmarks."
        )

    @property
    def message(self) -> str:
        """What happened, and what to do."""
        sentences = [self._doubt if self.status is FitStatus.DOUBTFUL else f"{self.status.message}{self._absent_text}"]
        if self.status.ok and not self.calibrated:
            sentences = [self.status.message, _NO_QUALITY]
        if self.status.ok and self.without_colour:
            sentences.append(_GREY)
        if self.at_start:
            sentences.append(_AT_START)
        return " ".join(sentences)

    @property
    def _doubt(self) -> str:
        """Why the fit is doubtful, and what to do."""
        if not self.calibrated:
            return _NOTHING_SAYS_SO
        return _MOSTLY_ABSENT if (~self.absent).mean() < LEAST_PRESENT else self.status.message

    @property
    def quality_text(self) -> str:
        """The quality with two digits, or ``unknown``."""
        return f"{self.quality:.2f}" if self.calibrated else "unknown"

    @property
    def calibrated(self) -> bool:
        """Whether quality and covariances are calibrated on left-out images; if not, the quality is NaN."""
        return not np.isnan(self.quality)

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation of each landmark, (n,) float64, image pixels: from the mean variance of x and y.

        Meaningful only if ``status.ok``: a fit that failed may have small ones.
        """
        return deviations(self.landmark_covariances)

    @property
    def absent(self) -> np.ndarray:
        """Which landmarks are more likely absent than present, (n,) bool: broken off, covered, or outside the image.

        The fit then goes without the image around them. Their positions are estimates from the other landmarks, and
        their covariances are large accordingly. None is absent where :attr:`present` is not known.
        """
        if self.present is None:
            return np.zeros(len(self.landmarks), bool)
        return self.present < PRESENT

    @property
    def detection_doubtful(self) -> bool:
        """Whether the detection is uncertain, and the quality does not show that the fit is right."""
        return self.found is not None and self.found.doubtful and not self.quality >= self.least_quality

    @property
    def n_found(self) -> int | None:
        """Number of objects in the image that are found with certainty, this one included; None if the start was given.

        Further objects count if they are at least half as large, and at least 0.3 times the image's shorter side
        unless no large object was certain.
        """
        return None if self.found is None else 1 + len(self.beside)

    @property
    def beside(self) -> tuple[Detection, ...]:
        """The further objects that :attr:`n_found` counts; none if the start was given."""
        others = () if self.found is None else self.found.others
        return tuple(other for other in others if are_beside(other.landmarks, self.landmarks))

    @property
    def start(self) -> np.ndarray:
        """Landmarks at the start of the fit that was kept, (n, 2) float64."""
        return self.history[0].landmarks

    @property
    def place(self) -> np.ndarray:
        """Where the object is, (n, 2): the landmarks, or those of the search if the fit is lost."""
        return self.found.landmarks if self.status.lost and self.found is not None else self.landmarks

    @property
    def theta_degrees(self) -> float | None:
        """Estimated angle of the image's camera, degrees; None if the method does not estimate it."""
        estimated = self.method.free_angles != "none" and np.isfinite(self.theta)
        return float(np.rad2deg(self.theta)) if estimated else None

    def to_dict(self, absent: str = "empty", *, rounded: bool = True) -> dict:
        """Convert the result to a dictionary that JSON can hold.

        Parameters
        ----------
        absent : {"empty", "estimate"}
            What stands for the positions of absent landmarks, and their sd and covariance: None, or the estimates.
        rounded : bool
            Whether quality, sd and covariances have the decimals that are worth reading, or all.

        Returns
        -------
        dict
            What ``liaam fit`` writes to its .json files: ``image`` (its name, if known), ``start``, ``status``,
            ``message``, ``quality``, ``side``, ``landmarks`` (x, y in image pixels), ``sd`` and
            ``covariance`` (xx, xy, yy) of each landmark, ``present`` (the probability of each), and others. Values that
            are unknown are None.
        """
        from liaam import __version__

        positions, covariances = self.reported(absent)
        decimals = _rounded if rounded else _all_decimals
        return {
            **self.facts(rounded=rounded),
            "present": None if self.present is None else np.round(self.present, 4).tolist(),
            "sd": finite_list(decimals(deviations(covariances), 3)),
            "covariance": finite_list(decimals(covariances[:, (0, 0, 1), (0, 1, 1)], 6)),
            "liaam": __version__,
            "landmark_names": list(self.landmark_names),
            "landmarks": finite_list(positions),
        }

    def facts(self, *, rounded: bool = True) -> dict[str, Any]:
        """Return what :meth:`to_dict` says of the fit as a whole, without the lists of the landmarks."""
        decimals = _rounded if rounded else _all_decimals
        return {
            "image": self.image.name if isinstance(self.image, Path) else None,
            "start": "given" if self.found is None else "searched",
            "starts_tried": self.n_starts,
            "side": self.side or None,
            "score": None if self.found is None else self.found.score,
            "n_found": self.n_found,
            "detection_doubtful": None if self.found is None else self.detection_doubtful,
            "method": self.method.name,
            "status": str(self.status),
            "message": self.message,
            "theta_deg": self.theta_degrees,
            "cost": self.cost if np.isfinite(self.cost) else None,
            "iterations": self.n_iterations,
            "expansion": decimals(self.expansion, 4),
            "at_start": self.at_start,
            "quality": decimals(self.quality, 4) if self.calibrated else None,
            "calibrated": self.calibrated,
        }

    def to_columns(self, name: str | None = None, absent: str = "empty") -> Columns:
        """Return the landmarks as a table of lists, one row per landmark; see :func:`liaam.to_dataframe`.

        ``name`` is that of the image; by default its file name, or ``image``.
        """
        positions, covariances = self.reported(absent)
        own_name = self.image.name if isinstance(self.image, Path) else "image"
        more = {"names": self.landmark_names, "quality": self.quality, "status": str(self.status)}
        return landmark_columns({"image": name or own_name}, positions, covariances, **more)

    def to_dataframe(self, name: str | None = None, absent: str = "empty") -> "pandas.DataFrame":
        """Convert the result to a pandas data frame with one row per landmark; see :func:`liaam.to_dataframe`."""
        return to_dataframe(self, None if name is None else [name], absent)

    def plot(self, image=None, *, ellipses: bool = True, ax: "Axes | None" = None) -> "Axes":
        """Draw the landmarks on the image with Matplotlib.

        Parameters
        ----------
        image : (h, w, 3) array or path, optional
            The image that was fitted. Default: :attr:`image`, and a white background if that is not known.
        ellipses : bool
            Whether to draw the 95 % confidence ellipse of each landmark.
        ax : matplotlib.axes.Axes, optional
            A new figure is made if None.

        Returns
        -------
        matplotlib.axes.Axes
        """
        return plot_landmarks(
            self._pixels() if image is None else load_picture(image, "image")[0],
            self.landmarks,
            covariances=self.landmark_covariances if ellipses else None,
            contours=self.contours,
            absent=self.absent,
            title=f"{self.method.name}: {self.status}, quality {self.quality_text}{f', {self.side}' * bool(self.side)}",
            colour=self.status.colour,
            ax=ax,
        )

    def _pixels(self) -> np.ndarray | None:
        return None if self.image is None else load_picture(self.image, "image")[0]

    def _repr_png_(self) -> bytes | None:
        """Show the object with its landmarks in a notebook; None, for the usual text, if the image is not known."""
        try:
            pixels = self._pixels()
        except LiaamError:  # the file has gone
            return None
        if pixels is None or not np.isfinite(self.landmarks).any():
            return None
        figure, ax = new_axes()
        self.plot(pixels, ax=ax)
        zoom_to(ax, self.landmarks, (pixels.shape[1], pixels.shape[0]))
        return png_bytes(figure)


def _rounded(values: Any, decimals: int) -> Any:
    """Return a number or an array rounded to decimals."""
    return np.round(values, decimals) if isinstance(values, np.ndarray) else round(values, decimals)


def _all_decimals(values: Any, _decimals: int) -> Any:
    """Return a number or an array as it is."""
    return values


def deviations(covariances: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each landmark, (n,), from the mean variance of x and y, of (n, 2, 2)."""
    return np.sqrt(0.5 * np.trace(covariances, axis1=1, axis2=2))


def check_absent(absent: str) -> None:
    """Raise LiaamError unless it is one of :data:`ABSENT`."""
    if absent not in ABSENT:
        raise LiaamError(f"absent {absent!r} is unknown; choose from {', '.join(ABSENT)}")


def likeliness(result: FitResult) -> tuple[float, float]:
    """Return by what fits of different shapes are compared: the quality, or else the fraction that they explain.

    That fraction alone is larger in coarser frames, and with more modes.
    """
    return 0.0 if isnan(result.quality) else result.quality, explained_fraction(result)


def explained_fraction(result: FitResult) -> float:
    """Return the fraction that a fit explains, by which fits of one shape are compared; -inf if it is lost."""
    return -inf if result.status.lost or isnan(result.evidence[0]) else float(result.evidence[0])


def odds_of(probability: float) -> float:
    """Return the odds of a probability."""
    return probability / max(1.0 - probability, 1e-9)


def with_prior(result: FitResult, prior: float) -> FitResult:
    """Return a result whose odds of being right are multiplied by the prior odds of its place, at most 1."""
    if prior == 1.0:
        return result
    odds = prior * odds_of(result.quality)
    quality = odds / (1.0 + odds)
    doubtful = result.status.ok and quality < LEAST_QUALITY
    return replace(result, quality=quality, status=FitStatus.DOUBTFUL if doubtful else result.status)
