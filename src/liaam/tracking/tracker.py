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
# Step size, in standard deviations, at which a fit from a prediction has converged. Measured on a talking face: 20 %
# fewer iterations than 0.03, landmarks within 0.04 pixels (1/40 of their standard deviation), and the same jitter.
RELATIVE_TOLERANCE = 0.1
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


@dataclass(frozen=True, eq=False)
class _CoordinateTrack:
    """Estimate of an object's coordinates, and statistics of its motion (see :func:`kalman.noise_and_drive`)."""

    belief: kalman.Belief
    moments: kalman.Moments
    share: float
    drive: np.ndarray


@dataclass(eq=False)
class TrackState:
    """State of a tracker between two frames.

    It holds the number of frames so far (at 0, an invalid frame raises), the estimate of the object's motion, how many
    frames the object has been lost, the wait between searches and the time until the next one in frames, the size
    (height, width) of the last frame, the last landmarks (n, 2), the number of the last frame with landmarks divided by
    the review interval, the index of the model's part (:attr:`liaam.AAM.parts`) that is tracked, and whether the object
    is of the other side (:attr:`liaam.fitting.FitResult.reflected`).
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
        near = SolverOptions(max_iterations=ITERATIONS, relative_tolerance=RELATIVE_TOLERANCE, early_tolerance=0.0)
        self._of_parts = []
        for part in self.fitter.parts:
            few = sharpest(part.model, LEVELS)
            fitter = Fitter(few, self.method, near, camera=self.camera, margin=NEAR, restarts=False)
            self._of_parts.append((fitter, part))
        self._estimates = self.fitter.objectives[-1].method.free_angles != "none"
        self.reset()

    def reset(self) -> None:
        """Forget the object. The next frame counts as the first one."""
        self.result, self.state = None, TrackState()
        self._use(self.state.part, self.state.reflected)

    def _use(self, part: int, reflected: bool) -> None:
        """Track the shape of one of the model's parts, as it is or reflected."""
        self.state.part = part
        self.state.reflected = reflected
        self._near, self._far = self._of_parts[part]
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
        tried = None
        try:
            pixels, _ = load_picture(image, name)
        except ImageError:
            if self.state.count == 0:
                raise
            if self._is_expected():
                self._predicted()  # it keeps moving
            self._lose(searched=False)
        else:
            before = self.state.size
            self.state.size = pixels.shape[:2]
            if before not in (None, self.state.size) and self.state.last is not None:
                # Speed and scatter change with the size: restart from the last position.
                self.state.last = rescaled(self.state.last, before, self.state.size)
                self.state.track = None
            status, tried = self._locate(pixels, index, name)
        self.state.count += 1
        self.result = None if status is TrackStatus.LOST else tried
        if status is TrackStatus.LOST or tried is None:
            return lost_frame(self._motion.shape_model.mean, index, time, tried)
        assert self.state.size is not None  # the frame is valid
        _, width = self.state.size
        part = self.model.part_of(reflected_points(tried.landmarks, width) if tried.reflected else tried.landmarks)
        if self.state.track is None and (part, tried.reflected) != (self.state.part, self.state.reflected):
            self._use(part, tried.reflected)
        self.state.lost = self.state.wait = self.state.due = 0
        self.state.last, self.state.period = tried.landmarks, self._period_of(index)
        return self._seen(tried, status, index, time)

    def _is_expected(self) -> bool:
        """Return whether the object may still be near its last position."""
        return self.state.lost <= self.options.patience and self.state.last is not None

    def _lose(self, searched: bool) -> None:
        """Count a frame without the object, and set the time of the next search after one."""
        if searched:
            self.state.due = self.state.wait = min(max(1, 2 * self.state.wait), self.options.longest_wait)
        self.state.lost, self.state.due = self.state.lost + 1, self.state.due - 1

    def _locate(self, pixels: np.ndarray, index: int, name: str) -> tuple[TrackStatus, FitResult | None]:
        """Return the status, and its fit or the last failed one."""
        first = self.state.count == 0
        tried = None
        if first and self.init is not None:
            tried = self.fitter.fit(pixels, self.init, name)
            if _usable(tried):
                return TrackStatus.FOUND, tried
        elif self._is_expected():
            right, tried = self._follow(pixels, name)
            if right and tried is not None:
                due = self._period_of(index) != self.state.period
                better = self._reviewed(pixels, tried, name) if due else None
                if better is None:
                    return TrackStatus.TRACKED, tried
                self.state.track = None  # the motion was wrong
                return TrackStatus.CORRECTED, better
        searched = self.state.due <= 0
        if searched:
            result = _fit(self.fitter, pixels, None, name, must=first)
            tried = result or tried
            # Reject a place with a low search score unless the quality of the fit confirms it.
            if result is not None and _usable(result) and not result.detection_doubtful:
                self.state.track = None  # the motion before does not apply
                return TrackStatus.FOUND, result
        self._lose(searched)
        return TrackStatus.LOST, tried

    def _follow(self, pixels: np.ndarray, name: str) -> tuple[bool, FitResult | None]:
        """Fit from the predicted position; return whether the last fit is of the object, and that fit."""
        start = self._predicted()
        tried = None
        for fitter in (self._near, self._far) if self.state.lost == 0 else (self._far,):
            result = _fit(fitter, pixels, start, name)
            if result is None:
                break
            tried = result
            if _usable(tried) and np.linalg.norm(tried.landmarks - start, axis=1).mean() < JUMP * diagonal_of(start):
                return True, tried
        return False, tried

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
        apart = np.linalg.norm(anew.landmarks - followed.landmarks, axis=1)
        size = diagonal_of(followed.landmarks)
        better = _usable(anew) and 1.0 - anew.quality < BETTER * (1.0 - followed.quality)
        # If near, the track has not drifted; if far, this is another object.
        elsewhere = apart.max() > APART * size and apart.mean() < JUMP * size
        return anew if better and elsewhere else None

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
        if track is None:
            noise = kalman.FIRST_SHARE * covariance
            speed = np.full(len(y), FIRST_SPEED * diagonal_of(result.landmarks) * np.sqrt(len(result.landmarks)))
            moments = kalman.first_moments(variances)
            belief = kalman.first_belief(y, noise, speed)
        else:
            noise = track.share * covariance
            moments = track.moments
            belief = kalman.update(kalman.widened(track.belief, y, noise), y, noise)
        moments = kalman.observed(moments, y)
        self.state.track = _CoordinateTrack(belief, moments, *kalman.noise_and_drive(moments, variances))
        landmarks = result.landmarks
        covariances = result.landmark_covariances
        if self.options.smooth:
            # The part of the shape outside the coordinates stays as fitted.
            landmarks = landmarks + motion.shape(belief.position) - motion.shape(y)
            # Smoothing does not reduce the part of the fit's error that is the same in all frames.
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
    return replace(model, views={name: replace(v, levels=v.levels[-levels:]) for name, v in model.views.items()})


def _fit(fitter: Fitter, pixels: np.ndarray, start, name: str, *, must: bool = False) -> FitResult | None:
    """Return a fit; None, unless it ``must`` be, if the start is outside the frame or the frame cannot be fitted."""
    try:
        return fitter.fit(pixels, start, name)
    except (StartError, ImageError):  # the object left the frame, or the frame is grey
        if must:
            raise
        return None


def _usable(result: FitResult) -> bool:
    """Return whether to accept a fit: converged, or stopped at the iteration limit without a low quality."""
    return result.status.ok or (result.status is FitStatus.MAX_ITERATIONS and not result.quality < result.least_quality)
