"""Read and write videos, and read cameras, frame by frame.

PyAV (FFmpeg) decodes, on a thread of its own a few frames ahead, and is loaded when the first video is opened: it is
optional. Frames are RGB with 8 bits, upright. A file is either written whole or not there.
"""

from __future__ import annotations

import importlib
import os
import queue
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import VideoError
from liaam.io.atomic import atomic_path
from liaam.io.files import existing_file

VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".avi", ".webm")
"""Endings (lower case) of the video files that can be written; whatever FFmpeg decodes can be read."""

AHEAD = 16
"""Frames that are decoded ahead."""

AHEAD_LIVE = 2
"""The same of a camera, whose older frames are dropped instead when nobody takes them."""

SOUGHT = 100
"""First frame from which on a file is entered at a key frame instead of decoded from its beginning."""

_REORDERED = 32
"""Frames by which a video's pieces lie before or behind their place in time, at most, in codecs in use."""

DEFAULT_RATE = Fraction(25)
"""Frames per second where a file does not say."""

_ENCODERS = (("libx264", {"crf": "18", "preset": "veryfast"}), ("mpeg4", {"qscale": "3"}))
_WEB_ENCODERS = (("libvpx-vp9", {"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "6"}),)
_WAIT, _PATIENCE = 0.2, 5.0
_TICKS = 60000  # per second, of what is written: a whole number of them for each frame of all usual rates
_LEAST_STEP = _TICKS // 1000  # some files tell times apart by milliseconds


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """One frame of a video.

    Attributes
    ----------
    index : int
        Number in the video, from 0.
    time : float
        Seconds since its beginning.
    image : (h, w, 3) uint8
    """

    index: int
    time: float
    image: np.ndarray


class VideoReader:
    """The frames of a video file or a camera, decoded on a thread a few frames ahead.

    Parameters
    ----------
    source : path-like or int
        A file, or the number of a camera (0 is the first).
    start, stop : int, optional
        First frame, and the one after the last; all if left out.

    Attributes
    ----------
    name : str
        What to call it.
    rate : Fraction
        Frames per second.
    n_frames : int or None
        How many frames will come as far as the file tells; None if it does not, and for a camera.
    announces : bool
        Whether the file itself tells how many frames it has.
    live : bool
        Whether it is a camera.
    ended : bool
        Once all frames have come: whether the source ended, and not at ``stop``.
    fault : str
        Once all frames have come: what is wrong with the file, such as that it is cut short; empty for a sound one.

    Raises
    ------
    VideoError
        If PyAV is not installed, or the source is missing, no video, or has no frame in that range; or if frames are
        asked for outside of a ``with`` block.

    Examples
    --------
    >>> with VideoReader("walk.mp4") as video:  # doctest: +SKIP
    ...     for frame in video:
    ...         print(frame.index, frame.image.shape)
    """

    def __init__(self, source: str | os.PathLike[str] | int, start: int = 0, stop: int | None = None):
        if start < 0 or (stop is not None and stop <= start):
            raise VideoError(f"frames {start} to {stop}: give a first frame of at least 0 and a later end")
        self.live = isinstance(source, int)
        self.name = f"camera {source}" if self.live else str(source)
        self.fault = ""
        self._start, self._stop = start, stop
        self._source = _open_camera(source) if isinstance(source, int) else _File(source)
        self.rate = self._source.rate
        self.n_frames = self._expected()
        self.announces, self.ended = bool(self._source.n_frames), False
        self._queue: queue.Queue[VideoFrame | BaseException | None] = queue.Queue(AHEAD_LIVE if self.live else AHEAD)
        self._closed = threading.Event()
        self._n_given, self._all_given = 0, False
        self._thread = threading.Thread(target=self._decode, name=f"decode {self.name}", daemon=True)

    def _expected(self) -> int | None:
        known = self._source.n_frames
        if not known:
            return None if self._stop is None else self._stop - self._start
        return max(0, min(known, known if self._stop is None else self._stop) - self._start)

    def __enter__(self) -> VideoReader:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._thread.join(_PATIENCE)
        if not self._thread.is_alive():  # a camera that has stalled may not be closed under its reader
            self._source.close()

    def __iter__(self) -> Iterator[VideoFrame]:
        """Give the frames, once: a second loop goes on where the first one stopped."""
        while not self._all_given:
            if self._thread.ident is None or self._closed.is_set():
                raise VideoError(
                    f"{self.name}: frames come inside of a with block only; write 'with VideoReader(...) as video:' "
                    "around the loop"
                )
            item = self._queue.get()
            if isinstance(item, VideoFrame):
                self._n_given += 1
                yield item
                continue
            self._all_given = True
            if item is not None:
                raise item
            if not self._n_given:
                raise VideoError(self._why_nothing())
            self.fault = self._source.fault or self._source.damage

    def _why_nothing(self) -> str:
        seen = self._source.n_seen
        if seen > self._source.n_damaged:
            return f"{self.name} has only {seen} frames, so there is none from {self._start} on; start sooner"
        return f"{self.name} holds no frame that can be decoded: it is damaged, or cut short; export it again"

    def _decode(self) -> None:
        """Put all frames into the queue, then None; or the error there was."""
        try:
            if self._start >= SOUGHT and isinstance(self._source, _File) and not self.live:
                self._source.skip_to(self._start)
            for time, picture in self._source:
                index = self._source.n_seen - 1
                if self._closed.is_set() or (self._stop is not None and index >= self._stop):
                    break
                if index >= self._start:
                    self._put(VideoFrame(index, time, picture()))
            else:
                self.ended = True
            self._put(None)
        except BaseException as error:
            self._put(error)

    def _put(self, item: VideoFrame | BaseException | None) -> None:
        while not self._closed.is_set():
            try:
                self._queue.put(item, timeout=_WAIT)
                return
            except queue.Full:
                if self.live:  # the newest picture counts
                    self._drop()

    def _drop(self) -> None:
        try:
            self._queue.get_nowait()
        except queue.Empty:
            return


class _File:
    """A video file through PyAV: gives (seconds, function that gives the picture) for each frame."""

    def __init__(self, path: str | os.PathLike[str]):
        av = _pyav(f"{path} is a video")
        self.path = existing_file(path, VideoError, "video")
        try:
            self.container = av.open(str(self.path), metadata_errors="replace")
        except av.error.FFmpegError as fault:
            raise VideoError(
                f"{path} is no video that FFmpeg can open ({fault.strerror}): it is of another kind, or cut short "
                "before its index; export it again, as .mp4 say"
            ) from fault
        if not self.container.streams.video or self.container.format.name == "tty":  # FFmpeg takes text for a terminal
            self.container.close()
            raise VideoError(f"{path} holds no moving picture: give a video file")
        self._begin(av, self.container.streams.video[0])

    def _begin(self, av: Any, stream: Any) -> None:
        stream.thread_type = "AUTO"
        self.stream, self.errors = stream, av.error.FFmpegError
        self.rate = Fraction(stream.average_rate or stream.guessed_rate or DEFAULT_RATE)
        self.n_frames, self.n_packets = self._announced(stream)
        self.n_seen, self.n_read, self.n_damaged, self.fault = 0, 0, 0, ""
        self.begun: float | None = None
        self.reformatter = av.video.reformatter.VideoReformatter()

    def _announced(self, stream: Any) -> tuple[int | None, int]:
        """Frames to be shown and pieces to be read, as far as the file tells: a trimmed .mp4 hides some of them."""
        entries = getattr(stream, "index_entries", ()) if "mp4" in self.container.format.name else ()  # of PyAV 16 on
        if not stream.frames or not entries:
            return stream.frames or None, stream.frames
        return sum(not entry.is_discard for entry in entries) or None, min(stream.frames, len(entries))

    def skip_to(self, start: int) -> None:
        """Go to the last key frame well before a frame, where the file tells which that is; else stay."""
        pieces, times = [], []
        try:
            pieces = self._pieces(start + 4 * _REORDERED)
            times = sorted(time for time, shown in pieces if shown and time is not None)
            if any(time is None for time, _ in pieces) or len(set(times)) < len(times):
                return
            _, first = self._next_times()
            times = times[times.index(first) :] if first in times else []  # those before lack what they need
            if len(times) <= start:
                self._reopen()
                return
            # Sooner than needed: what is shown just before a key frame may be stored behind it, and lack what it needs.
            sooner = times[max(0, start - _REORDERED)]
            self.container.seek(sooner, stream=self.stream)
            stored, shown = self._next_times()
            self.container.seek(sooner, stream=self.stream)
        except self.errors:
            stored = shown = None
        order = [time for time, _ in pieces]
        if stored not in order or shown not in times or times.index(shown) >= start:
            self._reopen()  # it goes elsewhere than it says
            return
        self.n_seen, self.begun = times.index(shown), float(times[0] * self.stream.time_base)
        self.n_read = order.index(stored)

    def _pieces(self, count: int) -> list[tuple[int | None, bool]]:
        """Time of the first pieces of the file in their order, and whether they are shown; nothing is decoded."""
        av = _pyav(f"{self.path} is a video")
        with av.open(str(self.path), metadata_errors="replace") as container:
            pieces = (piece for piece in container.demux(container.streams.video[0]) if piece.size)
            return [(piece.pts, not piece.is_discard) for piece in islice(pieces, count)]

    def _next_times(self) -> tuple[int | None, int | None]:
        """Times of the next piece, and of the first frame that comes of it and those after; None where none comes."""
        stored = None
        for packet in self.container.demux(self.stream):
            stored = packet.pts if stored is None else stored
            for frame in packet.decode():
                return stored, frame.pts
        return stored, None

    def _reopen(self) -> None:
        av = _pyav(f"{self.path} is a video")
        self.container.close()
        self.container = av.open(str(self.path), metadata_errors="replace")
        self._begin(av, self.container.streams.video[0])

    def __iter__(self) -> Iterator[tuple[float, Any]]:
        first, last = self.begun, -1.0
        try:
            for packet in self.container.demux(self.stream):
                self.n_read += bool(packet.size)
                for frame in self._frames_of(packet):
                    stamp = float(self.n_seen / self.rate) if frame.time is None else float(frame.time)
                    first = stamp if first is None else first
                    seconds = stamp - first
                    # Some files (.avi) number frames in the order of decoding; time does not run backwards.
                    last = seconds = seconds if seconds > last else last + float(1 / self.rate)
                    self.n_seen += 1
                    yield seconds, lambda frame=frame: self._picture(frame)
        except self.errors as fault:
            self.fault = (
                f"{self.path} is damaged after frame {self.n_seen} ({fault.strerror}); what comes before was read"
            )
            return
        if not self.n_damaged and self.n_read < self.n_packets:
            self.fault = (
                f"{self.path} is cut short: it has {self.n_read} of the {self.n_packets} frames that it announces"
            )

    def _frames_of(self, packet: Any) -> list[Any]:
        try:
            return packet.decode()
        except self.errors:
            self.n_damaged += 1
            self.n_seen += 1  # so that frames have the same numbers from wherever they are counted
            return []

    @property
    def damage(self) -> str:
        """What is known of damaged pieces so far; empty if there were none."""
        if not self.n_damaged:
            return ""
        return f"{self.path} is damaged: {self.n_damaged} pieces of it could not be decoded and are missing"

    def _picture(self, frame: Any) -> np.ndarray:
        picture = self.reformatter.reformat(frame, format="rgb24").to_ndarray()
        quarters = round(getattr(frame, "rotation", 0) / 90) % 4
        return np.ascontiguousarray(np.rot90(picture, quarters)) if quarters else picture

    def close(self) -> None:
        self.container.close()


class _Device(_File):
    """A camera of Linux through PyAV."""

    def __init__(self, number: int):
        av = _pyav(f"camera {number}")
        self.path = Path(f"/dev/video{number}")
        self.container = av.open(str(self.path), format="v4l2", metadata_errors="replace")
        self._begin(av, self.container.streams.video[0])
        self.n_frames = None


class _Capture:
    """A camera through OpenCV."""

    n_frames, n_damaged, damage = None, 0, ""

    def __init__(self, number: int):
        import cv2

        self.capture = cv2.VideoCapture(number)
        self.rate = Fraction(max(1, round(self.capture.get(cv2.CAP_PROP_FPS)) or 25))
        self.n_seen, self.fault = 0, ""

    @property
    def is_open(self) -> bool:
        return self.capture.isOpened()

    def __iter__(self) -> Iterator[tuple[float, Any]]:
        from time import monotonic

        begun = monotonic()
        while True:
            there, picture = self.capture.read()
            if not there:
                self.fault = "the camera gave no more pictures; is it still plugged in?"
                return
            self.n_seen += 1
            yield monotonic() - begun, lambda picture=picture: np.ascontiguousarray(picture[..., ::-1])

    def close(self) -> None:
        self.capture.release()


def _open_camera(number: int) -> _Device | _Capture:
    """Open a camera by PyAV's v4l2 where that works, or else by OpenCV."""
    if Path(f"/dev/video{number}").exists():
        try:
            return _Device(number)
        except Exception:  # no PyAV, or a driver that it does not get on with: OpenCV may do
            pass
    capture = _quiet_capture(number)
    if capture.is_open:
        return capture
    capture.close()
    there = sorted(path.name.removeprefix("video") for path in Path("/dev").glob("video[0-9]*"))
    others = f"there are {', '.join(there)}" if there else "this machine shows none"
    raise VideoError(
        f"camera {number} cannot be opened ({others}): plug one in, close other programs that use it, and check that "
        "you may read it; or give a video file"
    )


def _quiet_capture(number: int) -> _Capture:
    """Open by OpenCV, which would otherwise print its own words about a missing camera."""
    import cv2

    log = getattr(getattr(cv2, "utils", None), "logging", None)
    before = log.getLogLevel() if log else None
    if log:
        log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        return _Capture(number)
    finally:
        if log:
            log.setLogLevel(before)


class VideoWriter:
    """Takes the frames of a video that is being written; see :func:`video_writer`."""

    def __init__(self, container: Any, path: Path, rate: Fraction):
        self._container, self._path, self._rate = container, path, rate
        self._stream: Any = None
        self._size = (0, 0)
        # An .avi has a place for each frame of its rate, and none for times.
        self._timed = path.suffix.lower() != ".avi"
        self._base = Fraction(1, _TICKS) if self._timed else 1 / rate
        self._begun: float | None = None
        self._last = -1
        self.n_frames = 0

    def write(self, image: np.ndarray, time: float | None = None) -> None:
        """Add a frame.

        Parameters
        ----------
        image : (h, w, 3) uint8
            Brought to the size of the first frame.
        time : float, optional
            Seconds, such as :attr:`VideoFrame.time`, counted from those of the first frame that has a time; one frame
            of the rate after the frame before if left out or NaN. An ``.avi`` keeps to its rate.
        """
        import av  # there: the container is its

        if not self.n_frames:
            self._begin(image.shape[:2])
        frame = av.VideoFrame.from_ndarray(self._fitted(image), format="rgb24")
        frame.pts, frame.time_base = self._stamp(time), self._base
        self._container.mux(self._stream.encode(frame))
        self.n_frames, self._last = self.n_frames + 1, frame.pts

    def _stamp(self, time: float | None) -> int:
        """When to show the next frame, in units of the stream's time base; later than the one before."""
        if not self._timed:
            return self.n_frames
        step = round(_TICKS / self._rate)
        counted = self._last + step if self.n_frames else 0
        if time is None or not np.isfinite(time):
            return counted
        if self._begun is None:
            self._begun = time - counted / _TICKS
        stamp = round((time - self._begun) * _TICKS)
        return stamp if not self.n_frames else max(stamp, self._last + min(step, _LEAST_STEP))

    def _begin(self, size: tuple[int, int]) -> None:
        name, options = _encoder(self._path)
        self._size = (size[0] + size[0] % 2, size[1] + size[1] % 2)  # colour is stored for blocks of 2 × 2
        self._stream = self._container.add_stream(name, rate=self._rate, options=options)
        self._stream.height, self._stream.width = self._size
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = self._base

    def _fitted(self, image: np.ndarray) -> np.ndarray:
        height, width = self._size
        more = height - image.shape[0], width - image.shape[1]
        if more == (0, 0):
            return np.ascontiguousarray(image)
        if all(0 <= n <= 1 for n in more):
            return np.pad(image, ((0, more[0]), (0, more[1]), (0, 0)), mode="edge")
        import cv2

        return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)

    def finish(self) -> None:
        """Write what the encoder still holds."""
        if not self.n_frames:
            raise VideoError(f"{self._path}: there was no frame to write")
        self._container.mux(self._stream.encode())


@contextmanager
def video_writer(path: str | os.PathLike[str], rate: Fraction | float = DEFAULT_RATE) -> Iterator[VideoWriter]:
    """Write a video; the file is there once the block has ended without an error.

    Parameters
    ----------
    path : path-like
        Ends in one of :data:`VIDEO_SUFFIXES`. H.264, but for ``.webm`` (VP9).
    rate : Fraction or float
        Frames per second.

    Yields
    ------
    VideoWriter
        Its ``write(image, time=None)`` takes (h, w, 3) uint8, and seconds where frames do not come evenly.

    Raises
    ------
    VideoError
        If the ending is none of these, PyAV is missing, the disk refuses, or there was no frame.
    """
    path = Path(path)
    check_video_name(path)
    av = _pyav(f"{path} is a video")
    rate = rate if isinstance(rate, Fraction) else Fraction(rate).limit_denominator(1001)
    with atomic_path(path, VideoError) as temporary, av.open(str(temporary), "w") as container:
        writer = VideoWriter(container, path, rate)
        yield writer
        writer.finish()


def check_video_name(path: Path) -> None:
    """Complain about the name of a video that cannot be written."""
    if path.suffix.lower() not in VIDEO_SUFFIXES:
        raise VideoError(f"{path}: a video's name ends in {', '.join(VIDEO_SUFFIXES)}, such as {path.stem}.mp4")


def can_enter(path: str | os.PathLike[str], start: int) -> bool:
    """Tell whether a file can be read from about a frame on, without decoding all that comes before."""
    file = _File(path)
    try:
        file.skip_to(start)
        return file.begun is not None
    finally:
        file.close()


def is_video(path: Path) -> bool:
    """Tell whether a file is a video, as far as its beginning shows."""
    _pyav(f"{path} is a video")
    try:
        _File(path).close()
    except VideoError:
        return False
    return True


def _encoder(path: Path) -> tuple[str, dict[str, str]]:
    import av

    choice = _WEB_ENCODERS if path.suffix.lower() == ".webm" else _ENCODERS
    for name, options in choice:
        if name in av.codecs_available:
            # An .avi has no place for the order in which frames that refer to later ones are shown.
            return name, {**options, "bf": "0"} if path.suffix.lower() == ".avi" else options
    raise VideoError(f"{path}: this PyAV has no encoder for it ({choice[0][0]}); install PyAV's own wheel, or try .mp4")


def _pyav(what: str) -> Any:
    try:
        return importlib.import_module("av")  # optional
    except ImportError as error:
        raise VideoError(
            f'{what}, and PyAV, which reads and writes them, is not installed: pip install "liaam[video]"'
        ) from error
