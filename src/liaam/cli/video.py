"""The command for videos: thin. Everything it does is a call that Python users have too."""

import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from liaam.cli.inputs import camera_for, check_output, read_init
from liaam.cli.terminal import INTERRUPTED, complain, console, progress_bar, say, table_of
from liaam.errors import LiaamError, MethodError, VideoError
from liaam.progress import Progress

if TYPE_CHECKING:
    from liaam.fitting import FitResult
    from liaam.io import VideoFrame, VideoReader
    from liaam.model import AAM
    from liaam.tracking import TrackedFrame, Tracker
    from liaam.tracking.stretches import Stretch


def track(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file of 'liaam train'.")],
    video: Annotated[str, typer.Argument(metavar="VIDEO", help="Video file, or the number of a camera (0).")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Landmarks of every frame, .csv or .npz; VIDEO_track.csv if no output is named."
        ),
    ] = None,
    annotated: Annotated[
        Path | None, typer.Option("--video", help="Video with the landmarks drawn in to write, such as out.mp4.")
    ] = None,
    shading_free: Annotated[
        Path | None,
        typer.Option("--shading-free", help="Video with the object under the light of training to write."),
    ] = None,
    init: Annotated[
        str | None,
        typer.Option(
            help="Where the object is in the first frame: a box x0,y0,x1,y1, a centre and the box's diagonal x,y,size, "
            "or a landmark file. Searched for if left out."
        ),
    ] = None,
    start: Annotated[int, typer.Option(help="First frame, counted from 0.", min=0)] = 0,
    end: Annotated[int | None, typer.Option(help="Frame to stop before.", min=1)] = None,
    frames: Annotated[int | None, typer.Option(help="Frames to track at most; instead of --end.", min=1)] = None,
    method: Annotated[str, typer.Option("--method", "-m", help="How to compare; see 'liaam methods'.")] = "soft-li",
    smooth: Annotated[
        bool, typer.Option(help="Smooth the landmarks over time, as far as their covariance lets them.")
    ] = True,
    review: Annotated[
        int | None,
        typer.Option(
            help="Frames from one fit from the mean shape to the next, which puts a track right that has gone astray: "
            "fewer are slower; 0 for none, 48 if left out.",
            min=0,
        ),
    ] = None,
    ellipses: Annotated[
        bool, typer.Option("--ellipses", help="Draw the ellipse that holds each landmark with 95 % probability.")
    ] = False,
    camera_file: Annotated[
        Path | None, typer.Option("--camera", help="Camera file of the video's camera, if not the training camera's.")
    ] = None,
    response: Annotated[
        str | None, typer.Option(help="Response of the video's camera, if not the training camera's.")
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            help="Processes that track stretches of a long video side by side; all cores if left out.",
            min=1,
        ),
    ] = None,
) -> None:
    """Track an object through a video; writes landmarks, and videos with them or without the shading.

    Ctrl-C stops, and what was done until then is written.
    """
    from liaam.io import VideoReader
    from liaam.model import load_model
    from liaam.tracking import Tracker, TrackingOptions
    from liaam.workers import one_thread

    source, stop = source_of(video), stop_of(start, end, frames)
    if output is None and annotated is None and shading_free is None:
        output = default_output(source)
    check_outputs(output, annotated, shading_free, source)
    model = load_model(model_file)
    camera = camera_for([], camera_file, response, model.camera)
    options = TrackingOptions(smooth=smooth) if review is None else TrackingOptions(smooth=smooth, review=review)
    tracker = Tracker(model, method, camera, options)
    counts, reader = Counts(), VideoReader(source, start, stop)
    task = Task(reader, tracker, start, stop, init, jobs)
    with stop_on_interrupt() as stopped, one_thread(), ExitStack() as files, progress_bar() as tell:
        sinks = open_sinks(files, tracker, output, annotated, shading_free, reader, ellipses, counts)
        pictures = annotated is not None or shading_free is not None
        follow(task, sinks, counts, tell, stopped, pictures=pictures, fits=shading_free is not None)
    report(counts, [path for path in (output, annotated, shading_free) if path is not None])
    if stopped():
        complain(f"stopped after {counts.n} frames; they are written")
        raise typer.Exit(INTERRUPTED)
    faults = [fault for fault in (task.fault, counts.all_grey and all_grey(shading_free, reader.name)) if fault]
    for fault in faults:
        complain(f"error: {fault}")
    if faults or not counts.n_tracked:
        raise typer.Exit(1)


Sink = Callable[["VideoFrame", "TrackedFrame", "FitResult | None"], None]
"""Takes a frame, what was found in it, and the fit."""


@dataclass
class Counts:
    """What has come of the frames so far."""

    statuses: Counter = field(default_factory=Counter)
    qualities: list[float] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    fits: Counter = field(default_factory=Counter)
    n_unshaded: int = 0
    n_grey: int = 0
    began: float = field(default_factory=monotonic)

    @property
    def n(self) -> int:
        """Frames done."""
        return sum(self.statuses.values())

    @property
    def n_tracked(self) -> int:
        """Frames with landmarks."""
        return self.n - len(self.lost)

    @property
    def all_grey(self) -> bool:
        """Whether shading was to be taken off, and all frames with the object were grey."""
        return self.n_grey > 0 and not self.n_unshaded

    def add(self, frame: "TrackedFrame") -> None:
        """Count a frame."""
        self.statuses[str(frame.status)] += 1
        self.qualities.append(frame.quality)
        if not frame.ok:
            self.lost.append(frame.index)
            self.fits[frame.fit_status] += 1


def source_of(video: str) -> Path | int:
    """A file, or a camera where a number is no file's name."""
    return int(video) if video.isascii() and video.isdigit() and not Path(video).exists() else Path(video)


def stop_of(start: int, end: int | None, frames: int | None) -> int | None:
    """Frame to stop before."""
    if end is not None and frames is not None:
        raise VideoError("--end and --frames both say where to stop; give one of them")
    if end is not None and end <= start:
        raise VideoError(f"--end {end} is not after --start {start}; frames count from 0")
    return start + frames if frames is not None else end


def default_output(source: Path | int) -> Path:
    """Name of the track where none is given."""
    return Path(f"camera{source}_track.csv" if isinstance(source, int) else f"{source.stem}_track.csv")


def check_outputs(output: Path | None, annotated: Path | None, shading_free: Path | None, source: Path | int) -> None:
    """Complain about outputs before the work, not after it."""
    from liaam.io.video import check_video_name, is_video
    from liaam.tracking.files import check_track_name, is_track

    paths = [path for path in (output, annotated, shading_free) if path is not None]
    for path in paths:
        check_output(path)
    for path in (annotated, shading_free):
        if path is not None:
            check_video_name(path)
    if len({path.resolve() for path in paths}) < len(paths):
        raise LiaamError(f"{paths[0]}: two outputs have the same name; give each its own")
    if isinstance(source, Path) and source.resolve() in {path.resolve() for path in paths}:
        raise LiaamError(f"{source} is the video to be read; give the output another name")
    for path in (annotated, shading_free):
        if path is not None and path.exists() and not is_video(path):
            raise LiaamError(f"{path} exists and is no video; give another name to keep it")
    if output is None:
        return
    check_track_name(output)
    if output.exists() and not is_track(output):
        raise LiaamError(f"{output} exists and is no track; give another name with -o to keep it")


def open_sinks(
    files: ExitStack,
    tracker: "Tracker",
    output: Path | None,
    annotated: Path | None,
    shading_free: Path | None,
    reader: "VideoReader",
    ellipses: bool,
    counts: Counts,
) -> list[Sink]:
    """Open what was asked for, and nothing else; each is closed by ``files``. Videos are drawn and written aside."""
    from liaam.io import video_writer
    from liaam.tracking.aside import aside
    from liaam.tracking.files import track_writer
    from liaam.tracking.shading import ShadingRemover

    sinks: list[Sink] = []
    remover = None if shading_free is None else ShadingRemover(tracker.fitter)  # it may refuse: before files are made
    if output is not None:
        track_file = files.enter_context(track_writer(output, tracker.model.n_points))
        sinks.append(lambda _, tracked, __: track_file.write(tracked))
    if annotated is not None:
        draw = drawing(files.enter_context(video_writer(annotated, reader.rate)), tracker.model, ellipses)
        sinks.append(files.enter_context(aside(draw)))
    if shading_free is not None and remover is not None:
        unshade = unshading(files.enter_context(video_writer(shading_free, reader.rate)), remover, counts)
        sinks.append(files.enter_context(aside(unshade)))
    return sinks


def drawing(writer: Any, model: "AAM", ellipses: bool) -> Sink:
    """Give what writes annotated frames."""
    from liaam.plotting.video import annotated

    def write(frame: "VideoFrame", tracked: "TrackedFrame", _result: "FitResult | None") -> None:
        landmarks = tracked.landmarks if tracked.ok else None
        covariances = tracked.covariances if ellipses and tracked.ok else None
        writer.write(annotated(frame.image, landmarks, model, caption_of(tracked), covariances), frame.time)

    return write


def unshading(writer: Any, remover: Any, counts: Counts) -> Sink:
    """Give what writes frames without shading; those without the object, and grey ones, as they are."""
    from liaam.tracking import TrackStatus

    def write(frame: "VideoFrame", tracked: "TrackedFrame", result: "FitResult | None") -> None:
        if tracked.status is not TrackStatus.TRACKED:
            remover.reset()
        fresh = frame.image
        if result is not None:
            try:
                fresh = remover.remove(frame.image, result, tracked.landmarks)
                counts.n_unshaded += 1
            except MethodError:  # grey: a whole video, or one that fades
                counts.n_grey += 1
        writer.write(fresh, frame.time)

    return write


def all_grey(path: Path | None, name: str) -> str:
    """What is wrong with a shading-free video of which all frames are as they were."""
    return (
        f"{path} shows {name} as it was: the video is grey (three equal channels) wherever the object was found, and "
        "shading is told by colours; give a colour video"
    )


def caption_of(tracked: "TrackedFrame") -> str:
    """One line about a frame."""
    parts = [f"{tracked.index}", f"{tracked.time:.2f} s", str(tracked.status)]
    if tracked.ok and tracked.quality == tracked.quality:  # not NaN
        parts.append(f"quality {tracked.quality:.2f}")
    return "   ".join(parts)


@dataclass
class Task:
    """What is tracked, and by what."""

    reader: "VideoReader"
    tracker: "Tracker"
    start: int
    stop: int | None
    init: str | None
    jobs: int | None
    fault: str = ""
    """What is wrong with the video, in the end."""

    def __post_init__(self) -> None:
        self.tracker.name = self.reader.name

    def set_out(self, size: tuple[int, int]) -> None:
        """Tell the tracker where the object is, in a first frame of a size (width, height), if anybody said."""
        if self.init is not None:
            self.tracker.init = read_init(self.init, Path(self.reader.name), size)


Seen = tuple["VideoFrame", "TrackedFrame", "FitResult | None"]


def follow(
    task: Task,
    sinks: Sequence[Sink],
    counts: Counts,
    tell: Progress,
    stopped: Callable[[], bool],
    *,
    pictures: bool,
    fits: bool,
) -> None:
    """Track all frames and hand each to what was asked for."""
    stretches = stretches_of(task)
    if len(stretches) > 1:
        seen = side_by_side(task, stretches, tell, stopped, pictures, fits)
    else:
        seen = one_by_one(task, tell, stopped)
    with closing(seen):
        for frame, tracked, result in seen:
            counts.add(tracked)
            for sink in sinks:
                sink(frame, tracked, result)


def stretches_of(task: Task) -> "list[Stretch]":
    """Parts of a video that can be tracked side by side: of a long file that can be entered in its middle."""
    from liaam.fitting.search import is_searchable
    from liaam.io.video import can_enter
    from liaam.tracking.stretches import cut

    reader = task.reader
    if reader.live or not reader.announces or not is_searchable(task.tracker.model):
        return []
    stretches = cut(task.start, task.stop, reader.n_frames)
    return stretches if len(stretches) > 1 and can_enter(reader.name, stretches[1].start) else []


def one_by_one(task: Task, tell: Progress, stopped: Callable[[], bool]) -> Generator[Seen, None, None]:
    """Track frame by frame: a camera, or a short video."""
    reader, tracker, pace = task.reader, task.tracker, Pace()
    with reader:
        for n, frame in enumerate(reader, 1):
            if n == 1:
                task.set_out(frame.image.shape[1::-1])
            tracked = tracker.update(frame.image, frame.time, frame.index)
            yield frame, tracked, tracker.result
            tell(n, reader.n_frames or n, f"{pace(n):.1f} frames/s, {tracked.status}")
            if stopped():
                return
    task.fault = reader.fault


def side_by_side(
    task: Task,
    stretches: "list[Stretch]",
    tell: Progress,
    stopped: Callable[[], bool],
    pictures: bool,
    fits: bool,
) -> Generator[Seen, None, None]:
    """Track stretches of a long video in processes; frames come without their picture unless pictures are wanted."""
    import numpy as np

    from liaam.io import VideoFrame, VideoReader
    from liaam.tracking.stretches import TrackJob, track_stretches
    from liaam.workers import all_cores

    reader, tracker, pace = task.reader, task.tracker, Pace()
    if task.init is not None:
        with VideoReader(reader.name, task.start, task.start + 1) as beginning:
            task.set_out(next(iter(beginning)).image.shape[1::-1])
    job = TrackJob(tracker, reader.name, fits)
    nothing, total = np.empty((0, 0, 3), np.uint8), reader.n_frames or 0
    tracked = track_stretches(
        job, stretches, task.jobs or all_cores(), lambda n: tell(n, total, f"{pace(n):.1f} frames/s"), stopped
    )
    with ExitStack() as open_:
        shown = by_number(iter(open_.enter_context(reader))) if pictures else None
        for stretch in open_.enter_context(closing(tracked)):
            task.fault = task.fault or stretch.fault
            for found, result in stretch.frames:
                yield shown(found.index) if shown else VideoFrame(found.index, found.time, nothing), found, result
                if pictures and stopped():  # to draw what is tracked already would take its time
                    return


def by_number(frames: "Iterator[VideoFrame]") -> "Callable[[int], VideoFrame]":
    """Go through frames to that of a number, or else the next one, or the last."""
    frame = next(frames)

    def at(number: int) -> "VideoFrame":
        nonlocal frame
        while frame.index < number and (following := next(frames, None)) is not None:
            frame = following
        return frame

    return at


class Pace:
    """Frames per second, of late."""

    def __init__(self) -> None:
        self._seen: deque = deque([(monotonic(), 0)], maxlen=60)

    def __call__(self, n: int) -> float:
        """Take note that so many are done."""
        self._seen.append((monotonic(), n))
        (before, fewer), (now, more) = self._seen[0], self._seen[-1]
        return (more - fewer) / max(now - before, 1e-9)


@contextmanager
def stop_on_interrupt() -> Iterator[Callable[[], bool]]:
    """Take the first Ctrl-C for a wish to stop after this frame, so that files are closed well; a second one does not
    wait for what is still to be written.
    """
    wished = threading.Event()
    if threading.current_thread() is not threading.main_thread():  # only it may take signals
        yield wished.is_set
        return
    before = signal.getsignal(signal.SIGINT)

    def wish(*_: object) -> None:
        if wished.is_set():  # the second one; what is open is closed in peace
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            raise KeyboardInterrupt
        wished.set()

    signal.signal(signal.SIGINT, wish)
    try:
        yield wished.is_set
    finally:
        signal.signal(signal.SIGINT, before)


def report(counts: Counts, outputs: Sequence[Path]) -> None:
    """Say what came out."""
    import numpy as np

    from liaam.evaluation import ranges_of

    seconds = max(monotonic() - counts.began, 1e-9)
    table = table_of("frames", "with landmarks", "lost", "found anew", "corrected", "quality", "frames/s")
    known = [quality for quality in counts.qualities if np.isfinite(quality)]
    again = max(0, counts.statuses["found"] - 1)
    quality = f"{np.median(known):.2f}" if known else "–"
    numbers = counts.n, counts.n_tracked, len(counts.lost), again, counts.statuses["corrected"]
    table.add_row(*map(str, numbers), quality, f"{counts.n / seconds:.1f}")
    console.print(table)
    for path in outputs:
        say(f"written to {path}")
    if not counts.lost:
        return
    reasons = ", ".join(f"{status or 'not searched'} {n}" for status, n in counts.fits.most_common())
    complain(
        f"lost in frames {ranges_of(counts.lost)} (last fits: {reasons}): look at them with --video; if the object is "
        "there, say with --init where it is in the first frame, or train on frames like these"
    )
