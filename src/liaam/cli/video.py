"""The command ``liaam track``."""

import signal
import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from liaam.cli.inputs import CameraOption, EllipsesOption, camera_for, model_and_inputs
from liaam.cli.terminal import StoppedError, complain, progress_bar, say, show_table, table_of
from liaam.errors import LiaamError, MethodError, VideoError
from liaam.fitting.search.starts import read_start
from liaam.formatting import ranges_of
from liaam.io import VideoFrame, VideoReader, video_writer
from liaam.io.atomic import check_output
from liaam.io.files import count_of, real_path
from liaam.io.video import is_video
from liaam.io.video_writer import check_video_name
from liaam.progress import Progress

if TYPE_CHECKING:
    from liaam.fitting import FitResult
    from liaam.model import AAM
    from liaam.tracking import TrackedFrame, Tracker
    from liaam.tracking.shading import ShadingRemover


def track(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="[MODEL] VIDEO",
            help="Model file of 'liaam train', or a name that 'liaam show' lists, by default 'face'; then a video "
            "file, a folder of frames as images, or a camera number such as 0.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Landmarks of every frame, .csv or .npz. By default VIDEO_track.csv."),
    ] = None,
    annotated: Annotated[
        Path | None, typer.Option("--video", help="Video to write with the landmarks drawn in, such as out.mp4.")
    ] = None,
    shading_free: Annotated[
        Path | None, typer.Option("--shading-free", help="Video to write with the object under the training light.")
    ] = None,
    init: Annotated[
        str | None,
        typer.Option(
            help="Where the object is in the first frame: a box x0,y0,x1,y1; a centre and the box's diagonal x,y,size; "
            "or a landmark file. By default the object is searched for."
        ),
    ] = None,
    frames: Annotated[
        str,
        typer.Option(
            metavar="FIRST:END", help="Frames to track, from 0 and without END: 100:200, 100: or :50. By default all."
        ),
    ] = ":",
    method: Annotated[str, typer.Option("--method", "-m", help="Fitting method; see 'liaam fit --help'.")] = "soft-li",
    smooth: Annotated[bool, typer.Option(help="Smooth the landmarks over time, weighted by their covariance.")] = True,
    ellipses: EllipsesOption = False,
    given_camera: CameraOption = None,
) -> None:
    """Track an object through a video. Writes a table of landmarks, and on request videos with them or without shading.

    Ctrl-C stops after the current frame and keeps the results so far.
    """
    from liaam.model import load_model
    from liaam.tracking import Tracker, TrackingOptions
    from liaam.workers import in_order, one_thread

    model_file, videos = model_and_inputs(sources, "track", "VIDEO")
    if len(videos) != 1:
        raise VideoError(f"{len(videos)} videos are given; give one, after the model, as in 'liaam track MODEL VIDEO'")
    source = source_of(videos[0])
    start, stop = frames_in(frames)
    output = output or default_output(source)
    check_outputs(output, annotated, shading_free, source)
    model = load_model(model_file)
    camera = camera_for([], given_camera, model.camera)
    tracker = Tracker(model, method, camera, TrackingOptions(smooth=smooth))
    counts = Counts()
    with stop_on_interrupt() as stopped, one_thread(), progress_bar() as progress:
        reader = VideoReader(source, start, stop, progress)
        tracker.name = reader.name
        files = outputs(tracker, output, annotated, shading_free, reader, ellipses, counts)
        with files as write, closing(steps_of(tracker, reader, init, counts, progress, stopped)) as steps:
            for _ in in_order(write, steps, 1):  # in a thread, while the next frames are tracked
                pass
    report(counts, [output, *(path for path in (annotated, shading_free) if path is not None)])
    if stopped():
        raise StoppedError(f"stopped after {count_of(counts.n, 'frame')}; the results so far are written")
    faults = faults_of(reader, counts, shading_free)
    for fault in faults:
        complain(f"error: {fault}")
    is_always_lost = len(counts.lost) == counts.n
    if faults or is_always_lost:
        raise typer.Exit(1)


Step = tuple[VideoFrame, "TrackedFrame", "FitResult | None"]
"""A frame, its tracking result and its fit."""


@dataclass
class Counts:
    """Statistics of the frames so far.

    Attributes
    ----------
    statuses : Counter
        Number of frames by :class:`liaam.tracking.TrackStatus`.
    qualities : list of float
        Quality of each frame; NaN if unknown.
    lost : list of int
        Frames without the object.
    fits_of_lost : Counter
        Number of these by the status of the last fit, or by None if there was no fit.
    n_shading_free, n_grey : int
        Number of frames whose shading was removed, and of those where it could not be, because they are grey.
    began : float
        When the first frame was expected, seconds of :func:`time.monotonic`.
    """

    statuses: Counter = field(default_factory=Counter)
    qualities: list[float] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    fits_of_lost: Counter = field(default_factory=Counter)
    n_shading_free: int = 0
    n_grey: int = 0
    began: float = field(default_factory=monotonic)

    @property
    def n(self) -> int:
        """Number of frames."""
        return sum(self.statuses.values())

    @property
    def rate(self) -> float:
        """Frames per second."""
        return self.n / max(monotonic() - self.began, 1e-9)  # clocks may be coarse

    def add(self, frame: "TrackedFrame") -> None:
        """Count a frame."""
        self.statuses[str(frame.status)] += 1
        self.qualities.append(frame.quality)
        if not frame.ok:
            self.lost.append(frame.index)
            self.fits_of_lost[frame.fit_status] += 1


def source_of(video: str) -> Path | int:
    """Return a file's path, or a camera's number if no file has that name."""
    is_number = video.isascii() and video.isdigit()
    if is_number and not Path(video).exists():
        return int(video)
    return Path(video)


def frames_in(text: str) -> tuple[int, int | None]:
    """Parse the first frame and the frame to stop before, if any: ``100:200``, ``100:`` or ``:200``."""
    first, colon, end = (part.strip() for part in text.partition(":"))
    if not colon or any(part and not part.isdecimal() for part in (first, end)):
        raise VideoError(f"--frames {text}: give the first frame and the one to stop before, such as 100:200 or :50")
    start = int(first or 0)
    stop = int(end) if end else None
    if stop is not None and stop <= start:
        raise VideoError(f"--frames {text}: {stop} is not after {start}; frames count from 0")
    return start, stop


def default_output(source: Path | int) -> Path:
    """Return the default path of the track."""
    if isinstance(source, int):
        name = f"camera{source}"
    elif source.is_dir():
        name = real_path(source).name  # also of "."
    else:
        name = source.stem
    return Path(f"{name}_track.csv")


def check_outputs(output: Path, annotated: Path | None, shading_free: Path | None, source: Path | int) -> None:
    """Raise, before any work, if an output cannot be written."""
    from liaam.tracking.files import check_track_name, is_track

    videos = [path for path in (annotated, shading_free) if path is not None]
    paths = [output, *videos]
    for path in paths:
        check_output(path)
    for path in videos:
        check_video_name(path)
    if len({real_path(path) for path in paths}) < len(paths):
        raise LiaamError(f"{output}: two outputs have the same name; give different names")
    if isinstance(source, Path) and real_path(source) in {real_path(path) for path in paths}:
        raise LiaamError(f"{source} is the input video; give the output another name")
    check_track_name(output)
    refuse_other_file(output, "track", is_track)
    for path in videos:
        refuse_other_file(path, "video", is_video)


def refuse_other_file(path: Path, kind: str, is_of_kind: Callable[[Path], bool]) -> None:
    """Raise if a file would be overwritten that is not of the kind that is written."""
    if path.exists() and not is_of_kind(path):
        raise LiaamError(f"{path} exists and is not a {kind}; give another name to keep it")


@contextmanager
def outputs(
    tracker: "Tracker",
    output: Path,
    annotated: Path | None,
    shading_free: Path | None,
    reader: VideoReader,
    ellipses: bool,
    counts: Counts,
) -> Iterator[Callable[[Step], None]]:
    """Open the requested outputs, and yield the function that writes a frame to them."""
    from liaam.tracking import TrackStatus
    from liaam.tracking.files import track_writer
    from liaam.tracking.shading import ShadingRemover

    remover = None if shading_free is None else ShadingRemover(tracker.fitter)  # may raise: before files are created
    with ExitStack() as files:
        track_file = files.enter_context(track_writer(output, tracker.model.n_points))
        annotated_file = shading_free_file = None
        if annotated is not None:
            annotated_file = files.enter_context(video_writer(annotated, reader.rate))
        if shading_free is not None:
            shading_free_file = files.enter_context(video_writer(shading_free, reader.rate))

        def write(step: Step) -> None:
            frame, tracked, result = step
            track_file.write(tracked)
            if annotated_file is not None:
                annotated_file.write(with_landmarks(frame, tracked, tracker.model, ellipses), frame.time)
            if shading_free_file is not None and remover is not None:
                if tracked.status is not TrackStatus.TRACKED:
                    remover.reset()
                picture = without_shading(frame, tracked, result, remover, counts)
                shading_free_file.write(picture, frame.time)

        yield write


def with_landmarks(frame: VideoFrame, tracked: "TrackedFrame", model: "AAM", ellipses: bool) -> np.ndarray:
    """Return a frame with its landmarks and a caption, (h, w, 3) uint8."""
    from liaam.plotting import video

    parts = [f"{tracked.index}", f"{tracked.time:.2f} s", str(tracked.status)]
    if tracked.ok and not np.isnan(tracked.quality):
        parts.append(f"quality {tracked.quality:.2f}")
    landmarks = tracked.landmarks if tracked.ok else None
    covariances = tracked.covariances if tracked.ok and ellipses else None
    return video.annotated(frame.image, landmarks, model, "   ".join(parts), covariances)


def without_shading(
    frame: VideoFrame, tracked: "TrackedFrame", result: "FitResult | None", remover: "ShadingRemover", counts: Counts
) -> np.ndarray:
    """Return a frame under the training light; a grey one, or one without the object, as it is. Count both."""
    if result is None:
        return frame.image
    try:
        picture = remover.remove(frame.image, result, tracked.landmarks)
    except MethodError:
        counts.n_grey += 1
        return frame.image
    counts.n_shading_free += 1
    return picture


def steps_of(
    tracker: "Tracker",
    reader: VideoReader,
    init: str | None,
    counts: Counts,
    progress: Progress,
    stopped: Callable[[], bool],
) -> Generator[Step, None, None]:
    """Track a video or a camera frame by frame, from the start ``init`` if there is one."""
    with reader:
        for n, frame in enumerate(reader, 1):
            if n == 1 and init is not None:
                tracker.init = read_start(init, Path(reader.name), frame.image.shape[1::-1])
            tracked = tracker.update(frame.image, frame.time, frame.index)
            counts.add(tracked)
            yield frame, tracked, tracker.result
            progress(n, reader.n_frames or n, f"{counts.rate:.1f} frames/s, {tracked.status}")
            if stopped():
                return


@contextmanager
def stop_on_interrupt() -> Iterator[Callable[[], bool]]:
    """Stop after the current frame on a first Ctrl-C, so that files are closed; stop at once on a second one."""
    requested = threading.Event()
    if threading.current_thread() is not threading.main_thread():  # only the main thread may handle signals
        yield requested.is_set
        return
    before = signal.getsignal(signal.SIGINT)

    def request_stop(*_: object) -> None:
        if requested.is_set():  # ignore further ones while files are closed
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            raise KeyboardInterrupt
        requested.set()

    signal.signal(signal.SIGINT, request_stop)
    try:
        yield requested.is_set
    finally:
        signal.signal(signal.SIGINT, before)


def faults_of(reader: VideoReader, counts: Counts, shading_free: Path | None) -> list[str]:
    """Return what went wrong with the video, and with the removal of its shading."""
    faults = [reader.fault] if reader.fault else []
    if counts.n_grey and not counts.n_shading_free:
        faults.append(
            f"{shading_free} is an unchanged copy of {reader.name}: every frame with the object is grey (three equal "
            "channels), and estimating shading needs colour; give a colour video"
        )
    return faults


def report(counts: Counts, outputs: Sequence[Path]) -> None:
    """Print a summary of the track."""
    table = table_of("frames", "with landmarks", "lost", "found again", "corrected", "quality", "frames/s")
    qualities = [quality for quality in counts.qualities if np.isfinite(quality)]
    found_again = max(0, counts.statuses["found"] - 1)  # the first time is no loss
    table.add_row(
        str(counts.n),
        str(counts.n - len(counts.lost)),
        str(len(counts.lost)),
        str(found_again),
        str(counts.statuses["corrected"]),
        f"{np.median(qualities):.2f}" if qualities else "–",
        f"{counts.rate:.1f}",
    )
    show_table(table)
    for path in outputs:
        say(f"written to {path}")
    if not counts.lost:
        return
    reasons = ", ".join(f"{status or 'not searched'} {n}" for status, n in counts.fits_of_lost.most_common())
    lost = f"{'frame' if len(counts.lost) == 1 else 'frames'} {ranges_of(counts.lost)}"
    complain(
        f"lost in {lost} (last fits: {reasons}): check them with --video; if the object is visible, give its place in "
        "the first frame with --init, or train on frames like these"
    )
