"""Tracking results of frames."""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from liaam.drawing import plot_landmarks
from liaam.fitting import FitResult, FitStatus
from liaam.formatting import finite_list, finite_or_none, short_repr
from liaam.model.shape import Similarity, align
from liaam.tables import Columns, landmark_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class TrackStatus(StrEnum):
    """Source of a frame's landmarks."""

    FOUND = "found"
    TRACKED = "tracked"
    CORRECTED = "corrected"
    LOST = "lost"


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """Tracking result of one frame.

    Attributes
    ----------
    index : int
        Number of the frame, as given or counted from 0.
    time : float
        Time in seconds, as given; NaN if not given.
    status : TrackStatus
        ``found`` by the search or from the given start, ``tracked`` from the previous frame, ``corrected`` by a fit
        from the mean shape because the track had drifted, or ``lost``.
    fit_status : FitStatus or None
        Status of the last fit; None if there was none.
    quality : float
        Quality of that fit, 0 to 1 (see :class:`liaam.FitResult`); NaN if unknown.
    theta : float
        Estimated angle of the camera, in radians; NaN for methods that do not estimate it.
    landmarks : (n, 2) float64
        Landmarks in image pixels, smoothed over time if requested; NaN if lost.
    raw : (n, 2) float64
        Landmarks as fitted.
    covariances, raw_covariances : (n, 2, 2) float64
        Covariances of ``landmarks`` and of ``raw``, in square pixels.
    mean : (n, 2) float64
        Mean shape of the model, which :attr:`pose` places on the landmarks.
    """

    index: int
    time: float
    status: TrackStatus
    fit_status: FitStatus | None
    quality: float
    theta: float
    landmarks: np.ndarray
    raw: np.ndarray
    covariances: np.ndarray
    raw_covariances: np.ndarray
    mean: np.ndarray

    __repr__ = short_repr

    @property
    def ok(self) -> bool:
        """Whether there are landmarks."""
        return self.status is not TrackStatus.LOST

    @cached_property
    def pose(self) -> Similarity:
        """The similarity of the plane that takes the mean shape nearest to the landmarks; NaN if lost."""
        return align(self.mean, self.landmarks)

    @property
    def roll(self) -> float:
        """Angle in the image from the mean shape to the landmarks, clockwise as seen, in radians; NaN if lost."""
        return self.pose.angle if self.ok else np.nan

    @property
    def size(self) -> float:
        """Centroid size of the mean shape in its pose, in image pixels; NaN if lost."""
        if not self.ok:
            return np.nan
        size_of_mean = float(np.linalg.norm(self.mean - self.mean.mean(axis=0)))
        return self.pose.scale * size_of_mean

    def to_dict(self) -> dict:
        """Convert the frame to a dictionary that JSON can hold; values that are unknown are None."""
        return {
            "index": self.index,
            "time": finite_or_none(self.time),
            "status": str(self.status),
            "fit_status": None if self.fit_status is None else str(self.fit_status),
            "quality": finite_or_none(self.quality),
            "theta_deg": finite_or_none(np.rad2deg(self.theta)),
            "roll_deg": finite_or_none(np.rad2deg(self.roll)),
            "size": finite_or_none(self.size),
            "landmarks": finite_list(self.landmarks),
            "landmark_covariances": finite_list(self.covariances),
        }

    def to_columns(self, name: str | None = None) -> Columns:
        """Return the landmarks as a table of lists, one row per landmark; see :func:`liaam.to_dataframe`."""
        labels = {"frame": self.index if name is None else name, "time": self.time}
        more = {"quality": self.quality, "status": str(self.status)}
        return landmark_columns(labels, self.landmarks, self.covariances, **more)

    def plot(self, image: np.ndarray, *, ellipses: bool = True, ax: "Axes | None" = None) -> "Axes":
        """Draw the landmarks on the frame's image with Matplotlib; parameters are those of ``FitResult.plot``."""
        covariances = self.covariances if ellipses else None
        return plot_landmarks(image, self.landmarks, covariances=covariances, title=str(self.status), ax=ax)


def lost_frame(mean: np.ndarray, index: int, time: float, tried: FitResult | None) -> TrackedFrame:
    """Return a frame without the object, after a fit that failed."""
    no_landmarks = np.full_like(mean, np.nan)
    no_covariances = np.full((len(mean), 2, 2), np.nan)
    return TrackedFrame(
        index=index,
        time=time,
        status=TrackStatus.LOST,
        fit_status=None if tried is None else tried.status,
        quality=np.nan if tried is None else tried.quality,
        theta=np.nan,
        landmarks=no_landmarks,
        raw=no_landmarks,
        covariances=no_covariances,
        raw_covariances=no_covariances,
        mean=mean,
    )
