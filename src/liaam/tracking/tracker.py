"""Track an object through the frames of a video.

Each frame is fitted from the predicted position of the object, at the finest levels of the model, then at all. If both
fail, the object is lost and searched for. Part of the shape may drift, such as the jaw onto the background. Therefore
one in `review` frames is also fitted from the mean shape, and tracking continues from that fit if it is clearly better.
A Kalman filter (:mod:`liaam.tracking.kalman`) smooths the fits, with their covariances as measurement noise.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from liaam.errors import ImageError, MethodError, StartError
from liaam.fitting import FitResult, FitStatus, Fitter, Method, SolverOptions
from liaam.fitting.loop.encoded_image import NEAR
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.formatting import changed_repr
from liaam.io import VideoReader
from liaam.model import AAM
from liaam.model.aam import named_model
from liaam.model.shape import align, diagonal_of
from liaam.model.sides import reflected_points
from liaam.photometry import CameraModel
from liaam.photometry.picture import load_picture
from liaam.tracking import kalman
from liaam.tracking.frames import TrackedFrame, TrackStatus, lost_frame
from liaam.tracking.motion import Motion, landmark_covariances, rescaled

# Maximum mean distance between prediction and fit of the same object, as a fraction of the object's diagonal
JUMP = 0.25
# Of a fit from a prediction: number of finest levels, and most iterations at each
LEVELS = 1
ITERATIONS = 20
SLOWING = 0.7  # Factor of the velocity per frame in which the object is lost
FIRST_SPEED = 0.01  # Prior standard deviation of the speed, as a fraction of the object's diagonal per frame
# A fit from the mean shape replaces the tracked fit if its 1 - quality is less than this fraction of the other's.
# Measured on a talking face: 0.6 to 0.8 where the jaw had drifted, at least 0.88 where the track is right.
BETTER = 0.8
# Distance of a landmark between both fits, as a fraction of the object's diagonal, above which a track has drifted
APART = 0.02


@dataclass(frozen=True)
class TrackingOptions:
    """Options of a tracker.

    Attributes
    ----------
    smooth : bool
        Whether to smooth landmarks over time.
    patience : int
        Number of frames after a loss in which the object is expected at its last position.
    longest_wait : int
        Maximum number of frames between two searches. The first wait is one frame, and each is twice the previous one.
    review : int
        Interval, in frames, of additional fits from the mean shape, which replace the tracked fit if clearly better.
        They need a method that estimates the quality. 0 for never.
    """

    smooth: bool = True
    patience: int = 8
    longest_wait: int = 32
    review: int = 48

    __repr__ = changed_repr

    def __post_init__(self) -> None:
        """Raise if an option is out of range."""
        if self.longest_wait < 1 or min(self.patience, self.review) < 0:
            raise MethodError("longest_wait must be at least 1, patience and review at least 0")


ALL = slice(None)  # Coordinates of a track
MODES = slice(4, None)  # Those of the modes of its shape


@dataclass(frozen=True, eq=False)
class _CoordinateTrack:
    """Estimate of an object's k coordinates, and statistics of its motion (see :func:`kalman.noise_and_drive`)."""

    belief: kalman.Belief
    moments: kalman.Moments
    share: float  # fraction of a fit's covariance that changes from frame to frame
    drive: np.ndarray  # (k,): density of the acceleration
    rest: np.ndarray  # (n,) complex: the part of the shape outside the coordinates (:meth:`Motion.rest`)


@dataclass(eq=False)
class TrackState:
    """State of a tracker between two frames.

    Attributes
    ----------
    count : int
        Number of frames so far; at 0, an invalid frame raises.
    track : object or None
        Estimate of the object's motion; None if it is not known yet, or any more.
    lost : int
        Number of frames since the object was lost.
    wait : int
        Number of frames from one search to the next.
    due : int
        Number of frames until the next search.
    size : (int, int) or None
        Height and width of the last frame.
    last : (n, 2) float64 or None
        Landmarks of the last frame with the object.
    period : int
        Number of that frame divided by the review interval, rounded down.
    part : int
        Index of the model's part (:attr:`liaam.AAM.parts`) that is tracked.
    reflected : bool
        Whether the object is of the other side (:attr:`liaam.fitting.FitResult.reflected`).
    """

    count: int = 0
    track: _CoordinateTrack | None = None
    lost: int = 0
    wait: int = 0
    due: int = 0
    size: tuple[int, int] | None = None
    last: np.ndarray | None = None
    period: int = 0
    part: int = 0
    reflected: bool = False


@dataclass(eq=False)
class Tracker:
    """Tracks one object from frame to frame.

    Attributes
    ----------
    model : AAM
    method : str or Method
        See :class:`liaam.Fitter`.
    camera : CameraModel, optional
        Camera of the video, if it is not the training camera.
    options : TrackingOptions
    init : shape, box, or point and size, optional
        Where the object is in the first frame. By default it is searched for.
    name : str
        Name of the video, for messages.
    result : FitResult or None
        Fit of the last frame; None if the object is lost.
    state : TrackState
        State after the last frame.

    Examples
    --------
    >>> tracker = Tracker(model)                                    # doctest: +SKIP
    >>> tracked = [tracker.update(picture) for picture in pictures] # doctest: +SKIP
    """

    model: AAM
    method: str | Method = DEFAULT_METHOD
    camera: CameraModel | None = None
    options: TrackingOptions = TrackingOptions()
    init: object = None
    name: str = ""
    result: FitResult | None = field(default=None, init=False, repr=False)
    state: TrackState = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.fitter = Fitter(self.model, self.method, camera=self.camera, restarts=False)  # it searches instead
        # early_tolerance=0: stopping early would leave the landmarks between the previous frame's and this one's.
        options = SolverOptions(max_iterations=ITERATIONS, early_tolerance=0.0)
        self._near_fitters = []  # of each part: from a prediction, at the finest levels only
        for part in self.fitter.parts:
            finest = sharpest(part.model, LEVELS)
            fitter = Fitter(finest, self.method, options, camera=self.camera, margin=NEAR, restarts=False)
            self._near_fitters.append(fitter)
        self._estimates_theta = self.fitter.objectives[-1].method.free_angles != "none"
        self.reset()

    def reset(self) -> None:
        """Forget the object. The next frame counts as the first one."""
        self.result = None
        self.state = TrackState()
        self._use(self.state.part, self.state.reflected)

    def _use(self, part: int, reflected: bool) -> None:
        """Track the shape of one of the model's parts, as it is or reflected."""
        self.state.part = part
        self.state.reflected = reflected
        self._near = self._near_fitters[part]
        self._far = self.fitter.parts[part]
        self._motion = Motion.of(self._far.shapes, is_reflected=reflected)

    def update(self, image, time: float = float("nan"), index: int | None = None) -> TrackedFrame:
        """Find the object in the next frame.

        Parameters
        ----------
        image : (h, w, 3) array or path
            The size may change between frames.
        time : float
            Time in seconds, for the result.
        index : int, optional
            Number of the frame, for the result and for the review interval. By default frames are counted.

        Returns
        -------
        TrackedFrame

        Raises
        ------
        ImageError, StartError
            If the first frame or the start is invalid. Later invalid frames are ``lost``.
        """
        index = self.state.count if index is None else index
        name = f"{self.name}, frame {index}" if self.name else f"frame {index}"
        status = TrackStatus.LOST
        fit = None
        try:
            pixels, _ = load_picture(image, name)
        except ImageError:
            if self.state.count == 0:
                raise
            if self._is_expected():
                self._predicted()  # it keeps moving
            self._lose(searched=False)
        else:
            self._resize(pixels.shape[:2])
            status, fit = self._locate(pixels, index, name)
        self.state.count += 1
        if status is TrackStatus.LOST or fit is None:
            self.result = None
            return lost_frame(self._motion.shape_model.mean, index, time, fit)
        self.result = fit
        self._choose_part(fit)
        self.state.lost = 0
        self.state.wait = 0
        self.state.due = 0
        self.state.last = fit.landmarks
        self.state.period = self._period_of(index)
        return self._seen(fit, status, index, time)

    def _resize(self, size: tuple[int, int]) -> None:
        """Note the size (height, width) of a frame. If it changes, restart from the last position."""
        before = self.state.size
        self.state.size = size
        if before not in (None, size) and self.state.last is not None:
            self.state.last = rescaled(self.state.last, before, size)
            self.state.track = None  # speed and scatter change with the size

    def _choose_part(self, fit: FitResult) -> None:
        """Track the part of the model that a fit shows, and its side, if the motion is not known from another one."""
        if self.state.track is not None:
            return
        landmarks = fit.landmarks
        if fit.reflected:
            assert self.state.size is not None  # it was fitted to a frame
            _, width = self.state.size
            landmarks = reflected_points(landmarks, width)
        part = self.model.part_of(landmarks)
        if (part, fit.reflected) != (self.state.part, self.state.reflected):
            self._use(part, fit.reflected)

    def _is_expected(self) -> bool:
        """Return whether the object may still be near its last position."""
        return self.state.lost <= self.options.patience and self.state.last is not None

    def _lose(self, searched: bool) -> None:
        """Count a frame without the object, and set the time of the next search after one."""
        if searched:
            self.state.wait = min(max(1, 2 * self.state.wait), self.options.longest_wait)
            self.state.due = self.state.wait
        self.state.lost += 1
        self.state.due -= 1

    def _locate(self, pixels: np.ndarray, index: int, name: str) -> tuple[TrackStatus, FitResult | None]:
        """Find the object: from the given start, near its predicted position, or by a search if one is due.

        Return the status, and its fit or, if the object is lost, the last one that failed.
        """
        is_first = self.state.count == 0
        fit = None
        if is_first and self.init is not None:
            fit = self.fitter.fit(pixels, self.init, name)
            if _usable(fit):
                return TrackStatus.FOUND, fit
        elif self._is_expected():
            predicted = self._predicted()
            fit = self._followed(pixels, predicted, name)
            if fit is not None and _confirms(fit, predicted):
                return self._tracked_or_corrected(pixels, fit, index, name)
        is_search_due = self.state.due <= 0
        if is_search_due:
            found = _fit(self.fitter, pixels, None, name, must=is_first)
            # Reject a place with a low search score unless the quality of the fit confirms it.
            if found is not None and _usable(found) and not found.detection_doubtful:
                self.state.track = None  # the motion before does not apply
                return TrackStatus.FOUND, found
            fit = found or fit
        self._lose(is_search_due)
        return TrackStatus.LOST, fit

    def _followed(self, pixels: np.ndarray, predicted: np.ndarray, name: str) -> FitResult | None:
        """Return the last fit from a predicted shape (n, 2): at the finest levels, or also at all; None without one."""
        was_seen = self.state.lost == 0
        fitters = (self._near, self._far) if was_seen else (self._far,)
        last = None
        for fitter in fitters:
            fit = _fit(fitter, pixels, predicted, name)
            if fit is None:
                return last
            last = fit
            if _confirms(fit, predicted):
                return last
        return last

    def _tracked_or_corrected(
        self, pixels: np.ndarray, followed: FitResult, index: int, name: str
    ) -> tuple[TrackStatus, FitResult]:
        """Return the status and the fit that followed the object; or one that is clearly better, if a review is due."""
        is_review_due = self._period_of(index) != self.state.period
        better = self._reviewed(pixels, followed, name) if is_review_due else None
        if better is None:
            return TrackStatus.TRACKED, followed
        self.state.track = None  # the motion was wrong
        return TrackStatus.CORRECTED, better

    def _period_of(self, index: int) -> int:
        """Return the number of reviews due up to a frame, from its number only, since numbers may have gaps."""
        return index // self.options.review if self.options.review else 0

    def _reviewed(self, pixels: np.ndarray, followed: FitResult, name: str) -> FitResult | None:
        """Return a fit from the mean shape at the same place, if it is clearly better."""
        if np.isnan(followed.quality):
            return None
        mean = self._motion.shape_model.mean
        anew = _fit(self.fitter, pixels, align(mean, followed.landmarks)(mean), name)
        if anew is None:
            return None
        is_better = _usable(anew) and 1.0 - anew.quality < BETTER * (1.0 - followed.quality)
        distances = np.linalg.norm(anew.landmarks - followed.landmarks, axis=1)
        size = diagonal_of(followed.landmarks)
        has_drifted = distances.max() > APART * size
        is_same_object = distances.mean() < JUMP * size
        return anew if is_better and has_drifted and is_same_object else None

    def _predicted(self) -> np.ndarray:
        """Advance the track to this frame and return the predicted shape."""
        assert self.state.last is not None
        if self.state.track is None:
            return self.state.last
        track = self.state.track
        if self.state.lost:
            slower = replace(track.belief, velocity=SLOWING * track.belief.velocity)
            track = replace(track, belief=slower, moments=replace(track.moments, last=()))
        moved = kalman.predict(track.belief, track.drive)
        self.state.track = replace(track, belief=moved)
        return self._motion.shape(moved.position)

    def _seen(self, result: FitResult, status: TrackStatus, index: int, time: float) -> TrackedFrame:
        """Update the track with a fit."""
        motion = self._motion
        track = self.state.track
        y, covariance, basis = motion.measured(result)
        variances = covariance.diagonal()
        rest = motion.rest(result.landmarks, y)
        if track is None:
            noise = kalman.FIRST_SHARE * covariance
            speed = np.full(len(y), FIRST_SPEED * diagonal_of(result.landmarks) * np.sqrt(len(result.landmarks)))
            moments = kalman.first_moments(variances)
            belief = kalman.first_belief(y, noise, speed)
        else:
            noise = track.share * covariance
            moments = track.moments
            predicted = kalman.widened(track.belief, y, noise)
            belief = kalman.update(predicted, y, noise)
            # What a refiner adds to the modes of the shape is smoothed as much as these.
            rest = track.rest + kalman.gain(predicted, belief, MODES if len(y) > 4 else ALL) * (rest - track.rest)
        moments = kalman.observed(moments, y)
        share, drive = kalman.noise_and_drive(moments, variances)
        self.state.track = _CoordinateTrack(belief, moments, share, drive, rest)
        landmarks = result.landmarks
        covariances = result.landmark_covariances
        if self.options.smooth:
            landmarks = motion.shape_with(belief.position, rest)
            # Smoothing does not reduce the part of the fit's error that is the same in all frames.
            covariances = covariances + landmark_covariances(basis, belief.pp - noise)
        return TrackedFrame(
            index=index,
            time=time,
            status=status,
            fit_status=result.status,
            quality=result.quality,
            theta=result.theta if self._estimates_theta else np.nan,
            landmarks=landmarks,
            raw=result.landmarks,
            covariances=covariances,
            raw_covariances=result.landmark_covariances,
            mean=motion.shape_model.mean,
        )


def track_video(
    model: AAM | str,
    video: str | os.PathLike[str] | int,
    *,
    init=None,
    start: int = 0,
    stop: int | None = None,
    method: str | Method = DEFAULT_METHOD,
    camera: CameraModel | None = None,
    options: TrackingOptions | None = None,
) -> Iterator[TrackedFrame]:
    """Track an object through a video, frame by frame.

    Parameters
    ----------
    model : AAM or "face"
    video : path-like or int
        A file, a folder of frames as images, or a camera number.
    init : shape, box, or point and size, optional
        Where the object is in the first frame. By default it is searched for.
    start, stop : int, optional
        First frame, and the one after the last.
    method : str or Method
    camera : CameraModel, optional
        Camera of the video, if it is not the training camera.
    options : TrackingOptions, optional

    Yields
    ------
    TrackedFrame
        One per frame. Frames without the object have the status ``lost``.

    Raises
    ------
    VideoError
        If the video cannot be read.

    Examples
    --------
    >>> for frame in track_video(model, "talk.mp4"):  # doctest: +SKIP
    ...     print(frame.index, frame.status, frame.landmarks.mean(axis=0))
    """
    tracker = Tracker(named_model(model), method, camera, options or TrackingOptions(), init)
    with VideoReader(video, start, stop) as frames:
        tracker.name = frames.name
        for frame in frames:
            yield tracker.update(frame.image, frame.time, frame.index)


def sharpest(model: AAM, levels: int) -> AAM:
    """Return the model with only its `levels` finest levels."""
    views = {name: replace(view, levels=view.levels[-levels:]) for name, view in model.views.items()}
    return replace(model, views=views)


def _fit(fitter: Fitter, pixels: np.ndarray, start, name: str, *, must: bool = False) -> FitResult | None:
    """Return a fit; None, unless it ``must`` be, if the start is outside the frame or the frame cannot be fitted."""
    try:
        return fitter.fit(pixels, start, name)
    except (StartError, ImageError):  # the object left the frame, or the frame is grey
        if must:
            raise
        return None


def _usable(fit: FitResult) -> bool:
    """Return whether to accept a fit: converged, or stopped at the iteration limit without a low quality."""
    if fit.status.ok:
        return True
    is_low = fit.quality < fit.least_quality  # not if it is unknown, NaN
    return fit.status is FitStatus.MAX_ITERATIONS and not is_low


def _confirms(fit: FitResult, predicted: np.ndarray) -> bool:
    """Return whether a fit is of the object that was expected at a shape (n, 2): usable, and not far from it."""
    if not _usable(fit):
        return False
    distance = np.linalg.norm(fit.landmarks - predicted, axis=1).mean()
    return bool(distance < JUMP * diagonal_of(predicted))
