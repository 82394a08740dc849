"""Videos that are tracked while they play: the page sends frames one by one, and gets the row of the track for each.

A row is a line of the .csv that ``liaam track`` writes. The page keeps the rows, so a video takes little more than its
tracker here. Frames are bare pixels: nothing has to be decoded.
"""

import io
import secrets
import time
from asyncio import wrap_future
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from liaam.errors import MethodError
from liaam.fitting import FitResult
from liaam.model import AAM
from liaam.studio import contract
from liaam.studio.model_store import ModelStore
from liaam.studio.pictures import Kept, jpeg_bytes
from liaam.studio.refusal import Refusal
from liaam.studio.routes import route
from liaam.studio.safety import RECORDINGS
from liaam.studio.settings import StudioSettings
from liaam.tracking import TrackedFrame, Tracker, TrackStatus
from liaam.tracking.files import TrackRows
from liaam.tracking.motion import rescaled
from liaam.tracking.shading import ShadingRemover

AT_ONCE = 3  # frames of a video in progress: one arrives, one is tracked, and the shading of one is removed
IDLE_SECONDS = 60.0  # time without a frame after which a video may end
SIDE = 16  # shortest side of a frame, pixels
WHOLE_SIDE = 20_000  # longest side of the video that a frame is a reduced copy of, pixels


class LiveVideo:
    """A video and its tracker. Each of its methods is called by one thread at a time."""

    def __init__(self, model: AAM) -> None:
        self.id = secrets.token_urlsafe(9)
        self.used = time.monotonic()
        self.in_progress = 0
        self.rows = TrackRows(model.n_points)
        self._tracker = Tracker(model)
        self._remover: ShadingRemover | None = None
        self._begin()

    def _begin(self) -> None:
        self._tracker.reset()
        self._tracker.state.count = 1  # the first frame of a tracker raises if it is invalid

    def track(self, image: np.ndarray, frame: "Frame") -> tuple[TrackedFrame, FitResult | None]:
        """Track the next frame; also return its fit, if the object is not lost."""
        if frame.fresh:
            self._begin()
        tracked = self._tracker.update(image, frame.time, frame.number)
        return tracked, self._tracker.result

    def without_shading(self, image: np.ndarray, tracked: TrackedFrame, result: FitResult | None) -> bytes:
        """Return a JPEG of a frame without its shading; empty if the object is lost, or the frame or model is grey."""
        try:
            self._remover = self._remover or ShadingRemover(self._tracker.fitter)
            if tracked.status is not TrackStatus.TRACKED:
                self._remover.reset()
            return b"" if result is None else jpeg_bytes(self._remover.remove(image, result, tracked.landmarks))
        except MethodError:
            return b""


class Frame:
    """What a request says about a frame: its size, its place in the video, and what is wanted."""

    def __init__(self, asked: contract.FrameQuery) -> None:
        try:
            self.width, self.height = int(asked.width), int(asked.height)
            self.whole = int(asked.of_height), int(asked.of_width)
            self.number, self.time = int(asked.number), float(asked.time)
        except (TypeError, ValueError) as fault:  # TypeError: one of them lacks
            raise Refusal(422, "send width, height, of_width, of_height, number and time of the frame") from fault
        if min(self.width, self.height) < SIDE or max(self.whole) > WHOLE_SIDE or min(self.whole) < SIDE:
            raise Refusal(422, f"the frame is too small or too large: its sides must be {SIDE} to {WHOLE_SIDE} pixels")
        if not (0 <= self.number < 2**31 and abs(self.time) < 1e9):
            raise Refusal(422, "the frame's number or time is out of range")
        self.fresh, self.flat = asked.fresh == "1", asked.flat == "1"

    def image(self, pixels: bytes) -> np.ndarray:
        """Return (height, width, 3) uint8 from the pixels, four bytes each (RGBA)."""
        expected = 4 * self.width * self.height
        if len(pixels) != expected:
            raise Refusal(422, f"the frame has {len(pixels)} bytes instead of {expected}: send RGBA, a byte each")
        rgba = np.frombuffer(pixels, np.uint8).reshape(self.height, self.width, 4)
        return np.ascontiguousarray(rgba[..., :3])


def in_whole(tracked: TrackedFrame, size: tuple[int, int], whole: tuple[int, int]) -> TrackedFrame:
    """Convert a frame tracked on a copy of a size (height, width) to the pixels of the whole video."""
    if size == whole:
        return tracked
    factors = np.array(whole[::-1]) / np.array(size[::-1])
    squares = np.outer(factors, factors)
    return replace(
        tracked,
        landmarks=rescaled(tracked.landmarks, size, whole),
        raw=rescaled(tracked.raw, size, whole),
        covariances=tracked.covariances * squares,
        raw_covariances=tracked.raw_covariances * squares,
    )


class LiveVideos:
    """The videos that are tracked live; thread-safe. A new model ends all of them; their pages start them again."""

    def __init__(self, models: ModelStore, settings: StudioSettings | None = None) -> None:
        self.models = models
        self._videos: Kept[str, LiveVideo] = Kept((settings or StudioSettings()).live_kept)
        models.listeners.append(lambda _: self._videos.keep_only(lambda *_: False))

    def open(self) -> LiveVideo:
        """Begin a video."""
        if (current := self.models.current) is None:
            raise Refusal(409, "there is no model yet: train one first, or start with --model FILE")
        oldest = time.monotonic() - IDLE_SECONDS
        self._videos.keep_only(lambda _, video: video.used > oldest)
        video = LiveVideo(current.model)
        self._videos.put(video.id, video)
        return video

    def get(self, number: str) -> LiveVideo:
        """Return the video with an id."""
        video = self._videos.found(number, "this video is no longer tracked: start it again")
        video.used = time.monotonic()
        return video

    def close(self, number: str) -> None:
        """End a video, if it has not ended."""
        self._videos.keep_only(lambda key, _: key != number)


def _seekable(request: Request, recording: bytes) -> Response:
    """Answer with a WebM recording with its duration and an index, which browsers leave out. That needs PyAV."""
    try:
        import av
    except ImportError:
        return Response(recording, media_type="video/webm")
    whole = io.BytesIO()
    try:
        with av.open(io.BytesIO(recording), "r") as source, av.open(whole, "w", format="webm") as target:
            stream = target.add_stream_from_template(source.streams.video[0])
            for packet in source.demux(source.streams.video[0]):
                if packet.dts is not None:  # the last one is empty
                    packet.stream = stream
                    target.mux(packet)
    except (OSError, ValueError, IndexError) as fault:  # FFmpeg's errors are among these
        raise Refusal(422, f"the recording is not a WebM video ({fault}): record again") from fault
    return Response(whole.getvalue(), media_type="video/webm")


def routes(videos: LiveVideos) -> list[Route]:
    """Return the endpoints of live videos."""
    # A thread for each step keeps the frames in order, and makes one tracker at a time.
    tracking = ThreadPoolExecutor(1, "live-track")
    painting = ThreadPoolExecutor(1, "live-paint")

    def begin(_: Request) -> contract.LiveVideo:
        video = tracking.submit(videos.open).result()
        return {"id": video.id, "header": video.rows.header}

    def end(request: Request) -> None:
        videos.close(request.path_params["id"])

    async def update(request: Request) -> Response:
        video = videos.get(request.path_params["id"])
        frame = Frame(contract.given(contract.FrameQuery, request.query_params))
        image = frame.image(await request.body())
        if video.in_progress >= AT_ONCE:
            raise Refusal(429, f"{AT_ONCE} frames of this video are in progress: wait for an answer")
        video.in_progress += 1
        try:
            tracked, result = await wrap_future(tracking.submit(video.track, image, frame))
            answer = video.rows.of(in_whole(tracked, (frame.height, frame.width), frame.whole)).encode()
            if frame.flat:
                answer += await wrap_future(painting.submit(video.without_shading, image, tracked, result))
            return Response(answer, media_type="application/octet-stream")
        finally:
            video.in_progress -= 1

    return [
        route("POST", RECORDINGS, _seekable, Request.body),
        route("POST", "/api/live", begin, status=201),
        Route("/api/live/{id}/frames", update, methods=["POST"]),
        route("DELETE", "/api/live/{id}", end),
    ]
