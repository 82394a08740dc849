"""Write videos: H.264, or VP9 for ``.webm``. Files are written atomically."""

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import VideoError
from liaam.io.atomic import atomic_path
from liaam.io.files import AnyPath
from liaam.io.images import VIDEO_SUFFIXES
from liaam.io.video import DEFAULT_RATE, pyav

# In one thread: with several, files of the same frames differ between runs by some bytes. A frame of 1920 x 1080 takes
# 27 ms of processor time, about as with several.
_X264 = {"crf": "18", "preset": "veryfast", "threads": "1"}
_MPEG4 = {"qscale": "3"}
_VP9 = {"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "6"}
# Encoders, of which the first that this PyAV has is used, with their options: a quality (crf, qscale) with hardly
# visible loss, and of several speeds a fast one, because videos are written while they are tracked.
_ENCODERS = (("libx264", _X264), ("mpeg4", _MPEG4))
_WEB_ENCODERS = (("libvpx-vp9", _VP9),)
_TICKS = 60000  # ticks in a second, the unit of times in written files: a multiple of all usual frame rates
_LEAST_STEP = _TICKS // 1000  # ticks between frames: some formats store times in milliseconds


class VideoWriter:
    """Encoder for the frames of a video; see :func:`video_writer`."""

    def __init__(self, container: Any, path: Path, rate: Fraction):
        self._container = container
        self._path = path
        self._rate = rate
        self._stream: Any = None
        self._size = (0, 0)
        # An .avi has a fixed rate and stores no times.
        self._timed = path.suffix.lower() != ".avi"
        self._base = Fraction(1, _TICKS) if self._timed else 1 / rate  # seconds of a unit of time stamps
        self._begun: float | None = None  # time of the first frame, by the first frame that has a time, seconds
        self._last = -1  # time stamp of the last frame
        self.n_frames = 0

    def write(self, image: np.ndarray, time: float | None = None) -> None:
        """Add a frame.

        Parameters
        ----------
        image : (h, w, 3) uint8
            Resized to the size of the first frame.
        time : float, optional
            Seconds, such as :attr:`liaam.io.VideoFrame.time`, relative to the first frame that has a time. If left out
            or NaN, the frame follows the previous one at the given rate. An ``.avi`` ignores times.
        """
        import av

        if not self.n_frames:
            self._begin(*image.shape[:2])
        frame = av.VideoFrame.from_ndarray(self._fitted(image), format="rgb24")
        frame.pts = self._stamp(time)
        frame.time_base = self._base
        self._container.mux(self._stream.encode(frame))
        self.n_frames += 1
        self._last = frame.pts

    def _stamp(self, time: float | None) -> int:
        """Return the time of the next frame in units of the time base, later than that of the previous one."""
        if not self._timed:
            return self.n_frames
        step = round(_TICKS / self._rate)  # between frames at the given rate
        is_first = self.n_frames == 0
        by_rate = 0 if is_first else self._last + step
        if time is None or not np.isfinite(time):
            return by_rate
        if self._begun is None:
            self._begun = time - by_rate / _TICKS
        by_time = round((time - self._begun) * _TICKS)
        if is_first:
            return by_time
        return max(by_time, self._last + min(step, _LEAST_STEP))

    def _begin(self, height: int, width: int) -> None:
        """Open the stream for frames of a size."""
        import av

        suffix = self._path.suffix.lower()
        encoders = _WEB_ENCODERS if suffix == ".webm" else _ENCODERS
        available = [encoder for encoder in encoders if encoder[0] in av.codecs_available]
        if not available:
            best, _ = encoders[0]
            lack = f"this PyAV lacks the encoder {best}"
            raise VideoError(f"{self._path}: {lack}; install PyAV from PyPI, or try .mp4")
        name, options = available[0]
        # An .avi cannot store B-frames, which are shown in another order than decoded.
        options = {**options, "bf": "0"} if suffix == ".avi" else options
        self._size = (height + height % 2, width + width % 2)  # even, as colour is stored for blocks of 2 × 2
        self._stream = self._container.add_stream(name, rate=self._rate, options=options)
        self._stream.height, self._stream.width = self._size
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = self._base

    def _fitted(self, image: np.ndarray) -> np.ndarray:
        """Return an image in the size of the video: with a row or column more if that is all it lacks, or resized."""
        height, width = self._size
        rows = height - image.shape[0]
        columns = width - image.shape[1]
        if rows == 0 and columns == 0:
            return np.ascontiguousarray(image)
        if 0 <= rows <= 1 and 0 <= columns <= 1:
            return np.pad(image, ((0, rows), (0, columns), (0, 0)), mode="edge")
        import cv2

        return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)

    def finish(self) -> None:
        """Write what the encoder still holds."""
        if not self.n_frames:
            raise VideoError(f"{self._path}: there is no frame to write; write at least one")
        self._container.mux(self._stream.encode())


@contextmanager
def video_writer(path: AnyPath, rate: Fraction | float = DEFAULT_RATE) -> Iterator[VideoWriter]:
    """Write a video. The file is created when the block ends without an error.

    Parameters
    ----------
    path : path-like
        Has one of the suffixes ``.mp4``, ``.m4v``, ``.mov``, ``.mkv``, ``.avi``, ``.webm``. The codec is H.264, or VP9
        for ``.webm``.
    rate : Fraction or float
        Frames per second.

    Yields
    ------
    VideoWriter
        Its ``write(image, time=None)`` takes (h, w, 3) uint8, and a time in seconds if frames are not evenly spaced.

    Raises
    ------
    VideoError
        If the suffix is unknown, PyAV is missing, writing fails, or there is no frame.
    """
    path = Path(path)
    check_video_name(path)
    av = pyav(f"{path}: videos need PyAV")
    rate = rate if isinstance(rate, Fraction) else Fraction(rate).limit_denominator(1001)
    with atomic_path(path, VideoError) as temporary, av.open(str(temporary), "w") as container:
        writer = VideoWriter(container, path, rate)
        yield writer
        writer.finish()


def check_video_name(path: Path) -> None:
    """Raise if the suffix is not that of a video that can be written."""
    if path.suffix.lower() not in VIDEO_SUFFIXES:
        raise VideoError(f"{path}: a video's name ends in {', '.join(VIDEO_SUFFIXES)}, such as {path.stem}.mp4")
