"""Track an object through a video file or a camera."""

import os
from collections.abc import Iterator

from liaam.fitting import Method
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.io import VideoReader
from liaam.model import AAM
from liaam.photometry import CameraModel
from liaam.tracking.tracker import TrackedFrame, Tracker, TrackingOptions


def track_video(
    model: AAM,
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
    model : AAM
    video : path-like or int
        A file, or a camera number.
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
    tracker = Tracker(model, method, camera, options or TrackingOptions(), init)
    with VideoReader(video, start, stop) as frames:
        tracker.name = frames.name
        for frame in frames:
            yield tracker.update(frame.image, frame.time, frame.index)
