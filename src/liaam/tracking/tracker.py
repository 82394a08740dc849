"""Following an object through the frames of a video.

Each frame is fitted from where the motion so far puts the object, at the sharpest levels of the model only, since the
start is near. A fit that is not to be trusted is made again from there at all levels; if that fails too, the object is
lost, and searched for, at first in every frame and then ever more rarely. A part that has once gone astray, such as a
jaw that lies on the background, is carried along from frame to frame by fits that look fair on the whole: so every now
and then a frame is fitted anew, from the mean shape, and the fit that is clearly better is gone on from. What the fits
give is smoothed by a Kalman filter (:mod:`liaam.tracking.kalman`) with their own covariances as noise.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from liaam.drawing import plot_landmarks
from liaam.errors import ImageError, MethodError, StartError
from liaam.evaluation import finite_list
from liaam.fitting import FitResult, FitStatus, Fitter, Method, SolverOptions
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.fitting.picture import load_picture
from liaam.fitting.problem import NEAR
from liaam.fitting.result import LEAST_QUALITY
from liaam.model import AAM
from liaam.model.shape import align, diagonal_of
from liaam.photometry import CameraModel
from liaam.tracking import kalman
from liaam.tracking.motion import Motion, landmark_covariances, rescaled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

JUMP = 0.25
"""Mean distance between start and fit, as a share of the object's diagonal, beyond which a fit that was to follow has
run off to something else."""

SLOWING = 0.7
"""Share of its speed that an object keeps with each frame in which it is not seen."""

FIRST_SPEED = 0.01
"""Standard deviation of the speed before anything of it was seen, as a share of the diagonal, per frame."""


NOTICE = 0.1
"""Step, in standard deviations, that is the last one of a fit that follows. Measured on a talking face: an iteration in
five less than at 0.03, landmarks within 0.04 pixels, a fortieth of their deviations, and no more trembling."""


BETTER = 0.8
"""Share of what a fit's quality lacks to 1 that a fit from the mean shape may lack to be taken in its place. Measured
on a talking face whose jaw had gone astray for 1,000 frames: 0.6 to 0.8 there, 0.88 and more where the track is right
and the fit from the mean shape is not."""

APART = 0.02
"""Share of the object's diagonal that a landmark of that fit has to lie elsewhere: else nothing was astray."""


class TrackStatus(StrEnum):
    """How a frame's landmarks came about."""

    FOUND = "found"
    TRACKED = "tracked"
    CORRECTED = "corrected"
    LOST = "lost"


@dataclass(frozen=True)
class TrackingOptions:
    """How to follow.

    Attributes
    ----------
    smooth : bool
        Whether to smooth landmarks over time.
    levels : int
        Finest levels of the model that a frame is fitted with from the prediction; all of them are used to start.
    iterations : int
        Iterations at most of such a fit, at each level.
    patience : int
        Frames after a loss in which the object is looked for where it was last.
    longest_wait : int
        Frames between two searches at most: the first wait is one frame, and each is twice as long as the one before.
    review : int
        Every so many frames (at multiples of it, or at the next frame there is) one is fitted from the mean shape too,
        and what is clearly the better fit is gone on from, where the method knows the quality of its fits; 0 for never.
    """

    smooth: bool = True
    levels: int = 1
    iterations: int = 20
    patience: int = 8
    longest_wait: int = 32
    review: int = 48

    def __post_init__(self) -> None:
        """Refuse options that make no sense."""
        if min(self.levels, self.iterations, self.longest_wait) < 1 or min(self.patience, self.review) < 0:
            raise MethodError("levels, iterations and longest_wait are at least 1, patience and review are at least 0")


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """What is known of one frame.

    Attributes
    ----------
    index : int
        Number of the frame, as given or counted from 0.
    time : float
        Seconds, as given; NaN if not.
    status : TrackStatus
        ``found`` by the search or by the start that was given, ``tracked`` from the frame before, ``corrected`` from
        the mean shape, since part of what was tracked had gone astray some frames before, or ``lost``.
    fit_status : FitStatus or None
        Of the last fit that was tried; None where none was.
    quality : float
        Of that fit, 0 to 1 (see :class:`liaam.FitResult`); NaN where unknown.
    theta : float
        Angle of the camera that it estimates, radians; NaN for methods that estimate none.
    landmarks : (n, 2) float64
        Smoothed over time if asked for, else as fitted; image pixels, NaN if lost.
    raw : (n, 2) float64
        As fitted.
    covariances, raw_covariances : (n, 2, 2) float64
        Of ``landmarks`` and of ``raw``, image pixels squared.
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

    @property
    def ok(self) -> bool:
        """Whether there are landmarks."""
        return self.status is not TrackStatus.LOST

    def to_dict(self) -> dict:
        """Convert the frame to a dictionary that JSON can hold; values that are unknown are None."""
        return {
            "index": self.index,
            "time": self.time if np.isfinite(self.time) else None,
            "status": str(self.status),
            "fit_status": None if self.fit_status is None else str(self.fit_status),
            "quality": self.quality if np.isfinite(self.quality) else None,
            "theta_deg": float(np.rad2deg(self.theta)) if np.isfinite(self.theta) else None,
            "landmarks": finite_list(self.landmarks),
            "landmark_covariances": finite_list(self.covariances),
        }

    def plot(self, image: np.ndarray, *, ellipses: bool = True, ax: "Axes | None" = None) -> "Axes":
        """Draw the landmarks on the frame's image with Matplotlib; parameters are those of ``FitResult.plot``."""
        covariances = self.covariances if ellipses else None
        return plot_landmarks(image, self.landmarks, covariances=covariances, title=str(self.status), ax=ax)


@dataclass(frozen=True, eq=False)
class _Track:
    """An object that is being followed: belief in its coordinates, and what its motion has been like.

    Attributes
    ----------
    belief : kalman.Belief
    moments : kalman.Moments
    share : float
    drive : (k,) float64
        Of :func:`kalman.noise_and_drive`.
    """

    belief: kalman.Belief
    moments: kalman.Moments
    share: float
    drive: np.ndarray


@dataclass(frozen=True, eq=False)
class _Loss:
    """How long the object has been lost, and when it is searched for next."""

    frames: int = 0
    wait: int = 0
    due: int = 0

    def next_frame(self, searched: bool, longest: int) -> "_Loss":
        if not searched:
            return replace(self, frames=self.frames + 1, due=self.due - 1)
        return _Loss(self.frames + 1, min(max(1, 2 * self.wait), longest), min(max(1, 2 * self.wait), longest) - 1)


@dataclass(frozen=True, eq=False)
class TrackState:
    """What a tracker knows between two frames, so that another one may go on; see :meth:`Tracker.resume`.

    Attributes
    ----------
    count : int
        Frames seen; 0 before the first, which is refused where it makes no sense.
    track : optional
        Belief in the object's motion.
    loss
        How long it has been lost.
    size : (height, width), optional
        Of the last frame.
    last : (n, 2) float64, optional
        Landmarks where it was last.
    period : int
        Number of the last frame with landmarks, over how many are between reviews.
    """

    count: int = 0
    track: _Track | None = None
    loss: _Loss = _Loss()
    size: tuple[int, int] | None = None
    last: np.ndarray | None = None
    period: int = 0


@dataclass(eq=False)
class Tracker:
    """Follows one object from frame to frame.

    Attributes
    ----------
    model : AAM
    method : str or Method
        As of :class:`liaam.Fitter`.
    camera : CameraModel, optional
        Of the video, if not the training camera's.
    options : TrackingOptions
    init : shape, box, or point and size, optional
        Where the object is in the first frame; searched for if left out.
    name : str
        What the frames are of, such as the name of a video, for messages.
    result : FitResult or None
        The last frame's fit; None if it is lost.

    Examples
    --------
    >>> tracker = Tracker(model)                                    # doctest: +SKIP
    >>> tracked = [tracker.update(picture) for picture in pictures] # doctest: +SKIP
    """

    model: AAM
    method: str | Method = DEFAULT_METHOD
    camera: CameraModel | None = None
    options: TrackingOptions = field(default_factory=TrackingOptions)
    init: object = None
    name: str = ""
    result: FitResult | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self.fitter = Fitter(self.model, self.method, camera=self.camera, restarts=False)  # it searches instead
        # No hurry: a frame would be left between where it is and where the one before it said it was.
        near = SolverOptions(max_iterations=self.options.iterations, notice=NOTICE, hurry=0.0)
        few = sharpest(self.model, self.options.levels)
        self._near = Fitter(few, self.method, near, camera=self.camera, margin=NEAR, restarts=False)
        self._motion = Motion(self.fitter.shapes)
        self._estimates = self.fitter.objectives[-1].method.free_angles != "none"
        self.reset()

    def reset(self) -> None:
        """Forget the object; the next frame is a first one."""
        self.resume(TrackState())

    @property
    def state(self) -> TrackState:
        """What is known after the last frame."""
        return TrackState(self._count, self._track, self._loss, self._size, self._last, self._period)

    def resume(self, state: TrackState) -> None:
        """Go on where a tracker with the same model and method was."""
        self.result = None
        self._count, self._track, self._loss = state.count, state.track, state.loss
        self._size, self._last, self._period = state.size, state.last, state.period

    def update(self, image, time: float = float("nan"), index: int | None = None) -> TrackedFrame:
        """Find the object in the next frame.

        Parameters
        ----------
        image : (h, w, 3) array or path
            Frames may change their size.
        time : float
            Seconds, for the result.
        index : int, optional
            Number of the frame, for the result and for what is done every so many frames; counted if left out.

        Returns
        -------
        TrackedFrame

        Raises
        ------
        ImageError, StartError
            For a first frame or a start that make no sense; later frames of the kind are lost.
        """
        index = self._count if index is None else index
        name = f"{self.name}, frame {index}" if self.name else f"frame {index}"
        try:
            pixels, _ = load_picture(image, name)
        except ImageError:
            if self._count == 0:
                raise
            return self._missed(index, time)
        self._follow_size(pixels.shape[0], pixels.shape[1])
        status, tried = self._locate(pixels, index, name)
        self._count += 1
        self.result = None if status is TrackStatus.LOST else tried
        if status is TrackStatus.LOST or tried is None:
            return _lost(self.model.n_points, index, time, tried)
        self._loss, self._last, self._period = _Loss(), tried.landmarks, self._period_of(index)
        return self._seen(tried, status, index, time)

    def _missed(self, index: int, time: float) -> TrackedFrame:
        """Go past a frame that is no picture: the object is lost in it, and moves on meanwhile."""
        if self._loss.frames <= self.options.patience and self._last is not None:
            self._predicted()
        self._loss = self._loss.next_frame(False, self.options.longest_wait)
        self._count, self.result = self._count + 1, None
        return _lost(self.model.n_points, index, time, None)

    def _follow_size(self, height: int, width: int) -> None:
        """Carry what is known over to frames of another size."""
        before, self._size = self._size, (height, width)
        if before in (None, self._size) or self._last is None:
            return
        # Its speed and scatter are others now: begin anew from where it was.
        self._last, self._track = rescaled(self._last, before, self._size), None

    def _locate(self, pixels: np.ndarray, index: int, name: str) -> tuple[TrackStatus, FitResult | None]:
        """Status, and the fit that it rests on or the last that failed."""
        first, tried = self._count == 0, None
        if first and self.init is not None:
            tried = self.fitter.fit(pixels, self.init, name)
            if _usable(tried):
                return TrackStatus.FOUND, tried
        elif self._loss.frames <= self.options.patience and self._last is not None:
            right, tried = self._follow(pixels, name)
            if right and tried is not None:
                due = self._period_of(index) != self._period
                better = self._reviewed(pixels, tried, name) if due else None
                if better is None:
                    return TrackStatus.TRACKED, tried
                self._track = None  # its motion was that of something else
                return TrackStatus.CORRECTED, better
        searched = self._loss.due <= 0
        if searched:
            right, found = self._search(pixels, name, first)
            tried = found or tried
            if right:
                self._track = None  # it may be anywhere now
                return TrackStatus.FOUND, tried
        self._loss = self._loss.next_frame(searched, self.options.longest_wait)
        return TrackStatus.LOST, tried

    def _follow(self, pixels: np.ndarray, name: str) -> tuple[bool, FitResult | None]:
        """Fit from where the object should be."""
        start = self._predicted()
        fitters = (self._near, self.fitter) if self._loss.frames == 0 else (self.fitter,)
        tried = None
        for fitter in fitters:
            try:
                tried = fitter.fit(pixels, start, name)
            except (StartError, ImageError):  # it has moved out, or the frame is grey
                return False, tried
            if _usable(tried) and _distance(tried.landmarks, start) < JUMP * diagonal_of(start):
                return True, tried
        return False, tried

    def _period_of(self, index: int) -> int:
        """Reviews due up to a frame, by its number: whoever tracks it counts the same, and there may be holes."""
        return index // self.options.review if self.options.review else 0

    def _reviewed(self, pixels: np.ndarray, followed: FitResult, name: str) -> FitResult | None:
        """Fit from the mean shape where the object is, if that is clearly better."""
        if np.isnan(followed.quality):
            return None
        mean = self.model.shape_model.mean
        try:
            anew = self.fitter.fit(pixels, align(mean, followed.landmarks)(mean), name)
        except (StartError, ImageError):
            return None
        apart, size = np.linalg.norm(anew.landmarks - followed.landmarks, axis=1), diagonal_of(followed.landmarks)
        better = _usable(anew) and 1.0 - anew.quality < BETTER * (1.0 - followed.quality)
        # Nothing was astray, or this is another object.
        elsewhere = apart.max() > APART * size and apart.mean() < JUMP * size
        return anew if better and elsewhere else None

    def _predicted(self) -> np.ndarray:
        """Where the object should be in this frame; lets the track's belief move on to it."""
        assert self._last is not None
        if self._track is None:
            return self._last
        track, motion = self._track, self._motion
        moments, belief = track.moments, track.belief
        if self._loss.frames:
            moments, belief = kalman.interrupted(moments), kalman.slowed(belief, SLOWING)
        moved = kalman.predict(belief, track.drive)
        self._track = replace(track, belief=moved, moments=moments)
        return motion.shape(moved.position)

    def _search(self, pixels: np.ndarray, name: str, first: bool) -> tuple[bool, FitResult | None]:
        """Look for the object in the whole frame."""
        try:
            tried = self.fitter.fit(pixels, name=name)
        except (StartError, ImageError):
            if first:
                raise
            return False, None
        # A doubtful place counts only where fits can tell whether they are right.
        return _usable(tried) and not tried.place_doubtful, tried

    def _seen(self, result: FitResult, status: TrackStatus, index: int, time: float) -> TrackedFrame:
        """Take a fit into the track."""
        motion, track = self._motion, self._track
        y, own, basis = motion.measured(result)
        variances = own.diagonal()
        if track is None:
            noise = kalman.FIRST_SHARE * own
            speed = np.full(len(y), FIRST_SPEED * diagonal_of(result.landmarks) * np.sqrt(len(result.landmarks)))
            moments, belief = kalman.first_moments(variances), kalman.first_belief(y, noise, speed)
        else:
            noise = track.share * own
            moments, belief = track.moments, kalman.update(kalman.widened(track.belief, y, noise), y, noise)
        moments = kalman.observed(moments, y)
        self._track = _Track(belief, moments, *kalman.noise_and_drive(moments, variances))
        landmarks, covariances = result.landmarks, result.landmark_covariances
        if self.options.smooth:
            # What the coordinates do not show of the shape stays as it was fitted.
            landmarks = landmarks + motion.shape(belief.position) - motion.shape(y)
            # The part of the fit's error that is the same in all frames is not smoothed away.
            covariances = covariances + landmark_covariances(basis, belief.pp - noise)
        return TrackedFrame(
            index=index,
            time=time,
            status=status,
            fit_status=result.status,
            quality=result.quality,
            theta=result.theta if self._estimates else np.nan,
            landmarks=landmarks,
            raw=result.landmarks,
            covariances=covariances,
            raw_covariances=result.landmark_covariances,
        )


def sharpest(model: AAM, levels: int) -> AAM:
    """The model without its coarser levels, of which so many finest ones stay."""
    return replace(model, views={name: replace(v, levels=v.levels[-levels:]) for name, v in model.views.items()})


def _usable(result: FitResult) -> bool:
    """Tell whether a fit can be gone on from: settled, or nearly so, and not doubtful."""
    return result.status.ok or (result.status is FitStatus.MAX_ITERATIONS and not result.quality < LEAST_QUALITY)


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b, axis=1).mean())


def _lost(n: int, index: int, time: float, tried: FitResult | None) -> TrackedFrame:
    nothing, unknown = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
    return TrackedFrame(
        index=index,
        time=time,
        status=TrackStatus.LOST,
        fit_status=None if tried is None else tried.status,
        quality=np.nan if tried is None else tried.quality,
        theta=np.nan,
        landmarks=nothing,
        raw=nothing,
        covariances=unknown,
        raw_covariances=unknown,
    )
