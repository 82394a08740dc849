"""Read videos, cameras and folders of frames, frame by frame.

The optional package PyAV (FFmpeg) decodes videos in a background thread, a few frames ahead; OpenCV reads cameras.
Frames are 8-bit RGB, upright.
"""

import importlib
from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import repeat
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from liaam.errors import ImageError, VideoError, installing
from liaam.formatting import short_repr
from liaam.io.files import AnyPath, as_8_bits, existing_file, natural_key
from liaam.io.images import STILL_SUFFIXES, image_kind, read_image
from liaam.progress import Progress
from liaam.workers import in_order

MAX_PIXELS = 50_000_000  # largest width times height of a frame, checked before it is decoded; 8K has 33 million
DEFAULT_RATE = Fraction(25)  # frames per second of files that do not specify a rate, and of folders of frames


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """One frame of a video.

    Attributes
    ----------
    index : int
        Frame number in the video, from 0.
    time : float
        Seconds since the beginning of the video.
    image : (h, w, 3) uint8
    """

    index: int
    time: float
    image: np.ndarray

    __repr__ = short_repr


class VideoReader:
    """Iterator over the frames of a video, a folder or a camera, decoded a few frames ahead in a background thread.

    Parameters
    ----------
    source : path-like or int
        A file; a folder of frames as images, in the natural order of their names (frame2 before frame10), at 25 frames
        per second; or a camera number (0 is the first).
    start, stop : int, optional
        First frame, and the one after the last. By default all frames.
    skipping : callable, optional
        Called in the thread that decodes, with the number of frames decoded before the first one, `start`, and a text.

    Attributes
    ----------
    name : str
        Name of the source, for messages.
    rate : Fraction
        Frames per second.
    n_frames : int or None
        Expected number of frames; None for a camera or if the file does not specify it.
    live : bool
        Whether the source is a camera.
    fault : str
        After the last frame: the fault of the file, such as that it is cut short; empty if there is none.

    Raises
    ------
    VideoError
        If PyAV is not installed, if the source is missing, an image, not a video, or has no frame in that range, or if
        frames are requested outside a ``with`` block.

    Examples
    --------
    >>> with VideoReader("walk.mp4") as video:  # doctest: +SKIP
    ...     for frame in video:
    ...         print(frame.index, frame.image.shape)
    """

    def __init__(
        self, source: AnyPath | int, start: int = 0, stop: int | None = None, skipping: Progress | None = None
    ):
        if start < 0 or (stop is not None and stop <= start):
            raise VideoError(f"frames {start} to {stop}: give a first frame of at least 0 and a later end")
        self.live = isinstance(source, int)
        self.name = f"camera {source}" if self.live else str(source)
        self.fault = ""
        self._start = start
        self._stop = stop
        self._skipping = skipping
        if isinstance(source, int):
            self._source: _Camera | _Folder | _File = _Camera(source)
        elif Path(source).is_dir():
            self._source = _Folder(Path(source))
        else:
            self._source = _File(source)
        self.rate = self._source.rate
        ends = [end for end in (stop, self._source.n_frames) if end]
        self.n_frames = max(0, min(ends) - start) if ends else None
        self._frames: Generator[VideoFrame, None, None] | None = None
        self._closed = False  # tells the thread that decodes to stop

    def __enter__(self) -> "VideoReader":
        self._frames = self._checked()
        return self

    def __exit__(self, *_: object) -> None:
        if self._frames is not None:
            self._frames.close()
        self._frames = None
        self._source.close()

    def __iter__(self) -> "VideoReader":
        """Iterate over the frames once. A second loop continues where the first one stopped."""
        return self

    def __next__(self) -> VideoFrame:
        if self._frames is None:
            where = "inside a with block; write 'with VideoReader(...) as video:' around the loop"
            raise VideoError(f"{self.name}: frames can be read only {where}")
        return next(self._frames)

    def _checked(self) -> Generator[VideoFrame, None, None]:
        """Yield the frames, then set the fault of the source; raise if there was no frame."""
        n_yielded = 0
        ahead = self._decoded_ahead()
        try:
            for frame in ahead:
                if frame is None:
                    break
                n_yielded += 1
                yield frame
        finally:
            self._closed = True
            ahead.close()
        n_seen = self._source.n_seen
        if not n_yielded and n_seen > self._source.n_damaged:
            few = f"has only {n_seen} frames, so none from frame {self._start} on"
            raise VideoError(f"{self.name} {few}; choose an earlier start")
        if not n_yielded:
            why = f"it is damaged or cut short, or its frames have more than {MAX_PIXELS:,} pixels"
            raise VideoError(f"{self.name} has no frame that can be decoded: {why}; export it again")
        self.fault = self._source.fault or self._source.damage

    def _decoded_ahead(self) -> Generator[VideoFrame | None, None, None]:
        """Yield the frames, decoded ahead by a thread, then None. A camera's are not, so that each is new."""
        frames = self._decoded()
        if self.live:
            return frames
        endless = repeat(None)  # one thread takes an item for each frame that it decodes
        return in_order(lambda _: next(frames, None), endless, threads=1)

    def _decoded(self) -> Generator[VideoFrame, None, None]:
        """Yield the frames from the first to the last that are asked for, without damaged ones."""
        for time, picture in self._source:
            index = self._source.n_seen - 1
            if self._closed or (self._stop is not None and index >= self._stop):
                return
            if index < self._start:
                if self._skipping is not None:
                    self._skipping(index + 1, self._start, "skipping frames")
                continue
            image = picture()
            if image is not None:
                yield VideoFrame(index, time, image)


class _Source:
    """Where frames come from.

    Iterates over pairs of the time in seconds and a function that decodes the image, (h, w, 3) uint8, or returns None
    if it is damaged. Images before the start need no decoding.
    """

    rate = DEFAULT_RATE
    n_frames: int | None = None  # number of frames, if it is known
    n_seen = 0  # number of frames so far, with those before the start and damaged ones
    n_damaged = 0  # number of these that are damaged
    fault = ""  # why there are no further frames, unless the source simply ends
    damage = ""  # which damaged frames are missing

    def close(self) -> None:
        """Release the file or the camera."""


class _Folder(_Source):
    """A folder of images."""

    def __init__(self, folder: Path):
        images = (file for file in folder.iterdir() if file.suffix.lower() in STILL_SUFFIXES)
        visible = (file for file in images if not file.name.startswith("."))
        self.files = sorted(visible, key=lambda file: natural_key(file.name))
        if not self.files:
            raise VideoError(f"{folder} is a folder without images; give a video, or a folder of frames such as 1.png")
        self.n_frames = len(self.files)

    def __iter__(self) -> Iterator[tuple[float, Any]]:
        for i, file in enumerate(self.files):
            self.n_seen += 1
            yield float(i / self.rate), partial(self._picture, file)

    def _picture(self, file: Path) -> np.ndarray | None:
        try:
            return as_8_bits(read_image(file, MAX_PIXELS))
        except ImageError as fault:
            self.n_damaged += 1
            self.damage = self.damage or f"a frame is left out: {fault}"
            return None


class _Camera(_Source):
    """A camera through OpenCV."""

    def __init__(self, number: int):
        import cv2

        log = cv2.utils.logging
        before = log.getLogLevel()
        log.setLogLevel(log.LOG_LEVEL_SILENT)  # it warns about a missing camera
        try:
            self.capture = cv2.VideoCapture(number)
            announced = round(self.capture.get(cv2.CAP_PROP_FPS))  # 0 if it is unknown
            self.rate = Fraction(max(1, announced)) if announced else DEFAULT_RATE
        finally:
            log.setLogLevel(before)
        if self.capture.isOpened():
            return
        self.close()
        numbers = sorted(path.name.removeprefix("video") for path in Path("/dev").glob("video[0-9]*"))
        others = f"available: {', '.join(numbers)}" if numbers else "no camera found"
        remedy = "connect it, close other programs that use it, and check its permissions; or give a video file"
        raise VideoError(f"camera {number} cannot be opened ({others}): {remedy}")

    def __iter__(self) -> Iterator[tuple[float, Any]]:
        begun = monotonic()
        while True:
            is_read, bgr = self.capture.read()
            if not is_read:
                self.fault = "the camera sends no more images; check that it is still connected"
                return
            self.n_seen += 1
            yield monotonic() - begun, partial(self._rgb, bgr)

    @staticmethod
    def _rgb(bgr: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(bgr[..., ::-1])

    def close(self) -> None:
        self.capture.release()


class _File(_Source):
    """A video file through PyAV."""

    def __init__(self, path: AnyPath):
        self.path = existing_file(path, VideoError, "video")
        av = pyav(f"{path}: videos need PyAV")
        self.errors = av.error.FFmpegError
        self.reformatter = av.video.reformatter.VideoReformatter()
        # FFmpeg decodes some frames to open a file, so that it has a limit as well: twice ours, because some decoders
        # count what they pad frames with.
        options = {"max_pixels": str(2 * MAX_PIXELS)}
        # Before its version 19, PyAV refused files whose titles and the like are not UTF-8 unless told otherwise.
        lenient = {"metadata_errors": "replace"} if int(av.__version__.partition(".")[0]) < 19 else {}
        try:
            self.container = av.open(str(path), options=options, **lenient)
        except self.errors as fault:
            why = f"({fault.strerror}): it has another format or is cut short before its index"
            raise VideoError(f"{path} is not a video that FFmpeg can open {why}; export it as .mp4") from fault
        try:
            streams = self.container.streams.video
            kind = self.container.format.name
            is_image = kind == "image2" or kind.endswith("_pipe")  # FFmpeg's names of the formats of still images
            if is_image or (streams and streams[0].frames == 1 and image_kind(self.path)):
                raise VideoError(f"{path} is an image, not a video: use 'liaam fit', or give a folder of frames")
            if not streams or kind == "tty":  # FFmpeg takes text for a terminal
                raise VideoError(f"{path} has no video stream: give a video file")
            if streams[0].codec_context is None:
                raise VideoError(f"{path} has a codec that FFmpeg does not know: export it as .mp4 with H.264")
            stream = streams[0]
            stream.thread_type = "AUTO"
            stream.codec_context.options = options
            self.stream = stream
            self.rate = Fraction(stream.average_rate or stream.guessed_rate or DEFAULT_RATE)
            self.n_frames, self.n_packets = self._announced(stream)
            self._check_size(stream, "its frames have")
        except VideoError:
            self.close()
            raise

    def _check_size(self, what: Any, whose: str) -> None:
        """Refuse a stream or a frame of too many pixels."""
        if what.width * what.height > MAX_PIXELS:
            size = f"{what.width} x {what.height} pixels, more than the {MAX_PIXELS:,} allowed"
            raise VideoError(f"{self.path}: {whose} {size}: make the video smaller")

    def _announced(self, stream: Any) -> tuple[int | None, int]:
        """Return the number of frames, or None, and of packets, or 0, that the file announces.

        A trimmed .mp4 hides some frames, whose entries in the index are to be discarded.
        """
        is_mp4 = "mp4" in self.container.format.name
        entries = getattr(stream, "index_entries", ()) if is_mp4 else ()  # which PyAV has from version 16 on
        if not stream.frames or not entries:
            return stream.frames or None, stream.frames
        n_shown = sum(not entry.is_discard for entry in entries)
        return n_shown or None, min(stream.frames, len(entries))

    def __iter__(self) -> Iterator[tuple[float, Any]]:
        first = None  # time stamp of the first frame, from which times count
        time = -1.0  # of the last frame
        n_read = 0  # number of packets with data
        try:
            for packet in self.container.demux(self.stream):
                n_read += bool(packet.size)
                for frame in self._frames_of(packet):
                    self._check_size(frame, f"frame {self.n_seen} has")
                    stamp = float(self.n_seen / self.rate) if frame.time is None else float(frame.time)
                    if first is None:
                        first = stamp
                    # Some files (.avi) have times in decoding order; keep times increasing.
                    time = stamp - first if stamp - first > time else time + float(1 / self.rate)
                    self.n_seen += 1
                    yield time, partial(self._picture, frame)
            if not self.n_damaged and n_read < self.n_packets:
                self.fault = f"{self.path} is cut short: it has {n_read} of its {self.n_packets} frames"
        except self.errors as fault:
            why = f"is damaged after frame {self.n_seen} ({fault.strerror})"
            self.fault = f"{self.path} {why}; only earlier frames were read"

    def _frames_of(self, packet: Any) -> list[Any]:
        """Return the frames of a packet; none, and count it as a damaged frame, if it cannot be decoded."""
        try:
            return packet.decode()
        except (self.errors, ValueError):  # the latter, from PyAV 19 on, where the decoder could not be opened before
            self.n_damaged += 1
            self.n_seen += 1  # keep frame numbers independent of the start frame
            self.damage = f"{self.path} is damaged: {self.n_damaged} packets could not be decoded and are missing"
            return []

    def _picture(self, frame: Any) -> np.ndarray:
        """Return the image of a frame, upright."""
        picture = self.reformatter.reformat(frame, format="rgb24").to_ndarray()
        quarter_turns = round(getattr(frame, "rotation", 0) / 90) % 4  # counter-clockwise
        return np.ascontiguousarray(np.rot90(picture, quarter_turns)) if quarter_turns else picture

    def close(self) -> None:
        self.container.close()


def is_video(path: Path) -> bool:
    """Return whether a file can be opened as a video."""
    pyav(f"{path}: videos need PyAV")
    with suppress(VideoError), closing(_File(path)):
        return True
    return False


def pyav(what: str) -> Any:
    """Import PyAV; raise if it is not installed, naming what needs it."""
    try:
        return importlib.import_module("av")  # optional
    except ImportError as error:
        raise VideoError(f"{what}, which is not installed: {installing('video')}") from error
