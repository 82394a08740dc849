"""A long video tracked in stretches side by side, in processes: the same landmarks however many there are of them.

A stretch is tracked from some frames before it on, so that its tracker knows the motion when it begins. Where that has
come to something else than the track so far, such as another person, or another way for the jaw to lie, the track so
far goes on through the stretch until both are of one opinion.
"""

import multiprocessing
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from typing import Any

import numpy as np

from liaam.errors import LiaamError, VideoError
from liaam.fitting import FitResult
from liaam.io import VideoReader
from liaam.model.shape import diagonal_of
from liaam.tracking.tracker import TrackedFrame, Tracker, TrackState
from liaam.workers import WorkerDied, in_workers, one_thread

LENGTH = 1200
"""Frames of a stretch; the last one takes the rest."""

RUN_IN = 75
"""Frames that are tracked before a stretch: three times what the filter looks back on (``kalman.MEMORY``)."""

MEETING = 0.001
"""Mean distance of landmarks, as a share of the object's diagonal, up to which two tracks are of one opinion."""

POLLED = 0.2
"""Seconds between two looks at how far the workers are, and at whether to stop."""


@dataclass(frozen=True)
class Stretch:
    """Frames ``start`` to ``stop`` of a video, by number; to the end if that is None."""

    number: int
    start: int
    stop: int | None


@dataclass(frozen=True, eq=False)
class TrackJob:
    """What is to be tracked, and how.

    Attributes
    ----------
    tracker : Tracker
        One that has seen nothing yet.
    video : str
        Path of a file.
    fits : bool
        Whether the frames' fits are wanted beside their landmarks.
    """

    tracker: Tracker
    video: str
    fits: bool = False


@dataclass(frozen=True, eq=False)
class TrackedStretch:
    """A stretch that was tracked.

    Attributes
    ----------
    before : TrackedFrame or None
        The frame before it, as its run-in has it.
    frames : list of (TrackedFrame, FitResult or None)
    state : TrackState
        What the tracker knows at the end.
    fault : str
        What is wrong with the file; empty for a sound one.
    whole : bool
        Whether it was tracked to its end, and not until the file ended or somebody wished to stop.
    """

    before: TrackedFrame | None
    frames: list[tuple[TrackedFrame, FitResult | None]]
    state: TrackState
    fault: str
    whole: bool


Found = Generator[tuple[Stretch, TrackedStretch], None, None]


def cut(start: int, stop: int | None, n_frames: int | None, length: int | None = None) -> list[Stretch]:
    """Stretches of a video.

    Parameters
    ----------
    start, stop : int, int or None
        First frame, and the one after the last.
    n_frames : int or None
        How many there are between them; one stretch where nobody knows.
    length : int, optional
        Of a stretch; :data:`LENGTH` if left out.
    """
    length = LENGTH if length is None else length
    n = max(1, (n_frames or 0) // length)
    begins = [start + i * length for i in range(n)]
    return [Stretch(i, *ends) for i, ends in enumerate(zip(begins, [*begins[1:], stop], strict=True))]


def track_stretch(
    job: TrackJob,
    stretch: Stretch,
    state: TrackState | None = None,
    seen: Callable[[TrackedFrame], bool] = lambda _: True,
) -> TrackedStretch:
    """Track one stretch.

    Parameters
    ----------
    job : TrackJob
    stretch : Stretch
    state : TrackState, optional
        What a tracker knew at the end of the stretch before; if left out, there is a run-in.
    seen : callable
        Called with each frame, those of the run-in too; tells whether to go on.
    """
    tracker, begin = job.tracker, stretch.start
    if state is None and stretch.number:
        begin = max(0, begin - RUN_IN)
        state = TrackState(count=1)  # in the middle of a video no frame is refused
    tracker.resume(state or TrackState())
    before, frames, reader = None, [], VideoReader(job.video, begin, stretch.stop)
    short = f"{job.video} is cut short: it has fewer frames than it says"
    try:
        with one_thread(), reader:
            for frame in reader:
                tracked = tracker.update(frame.image, frame.time, frame.index)
                if frame.index < stretch.start:
                    before = tracked
                else:
                    frames.append((tracked, tracker.result if job.fits else None))
                if not seen(tracked):
                    return TrackedStretch(before, frames, tracker.state, "", whole=False)
    except VideoError:  # no frame at all
        if not stretch.number:
            raise
    reached = bool(frames) and (not reader.ended or frames[-1][0].index + 1 == stretch.stop)
    return TrackedStretch(before, frames, tracker.state, reader.fault or ("" if frames else short), whole=reached)


def agree(track: TrackedFrame, other: TrackedFrame | None, lost: int = 0, patience: int = 0) -> bool:
    """Tell whether another track may go on where one is.

    Parameters
    ----------
    track, other : TrackedFrame, TrackedFrame or None
        The same frame as both have it.
    lost : int
        Frames for which the track has been lost.
    patience : int
        Frames for which it looks for its object where that was; it takes whatever it finds only after them.
    """
    if not track.ok:
        return lost > patience or (other is not None and not other.ok)
    if other is None or not other.ok:
        return False
    distance = np.linalg.norm(track.landmarks - other.landmarks, axis=1).mean()
    return bool(distance <= MEETING * diagonal_of(track.landmarks))


def joined(
    job: TrackJob, stretch: Stretch, last: TrackedStretch, own: TrackedStretch, stopped: Callable[[], bool]
) -> TrackedStretch:
    """Let the track so far go on through a stretch until it agrees with the stretch's own.

    Parameters
    ----------
    job : TrackJob
    stretch : Stretch
    last : TrackedStretch
        The stretch before.
    own : TrackedStretch
        The stretch as it was tracked from its run-in.
    stopped : callable
        Whether to stop.
    """
    patience, end = job.tracker.options.patience, last.frames[-1][0]
    lost = sum(1 for _ in takewhile(lambda found: not found[0].ok, reversed(last.frames)))
    if agree(end, own.before, lost, patience):
        return own
    theirs = {frame.index: frame for frame, _ in own.frames}
    met = False

    def goes_on(frame: TrackedFrame) -> bool:
        nonlocal met, lost
        lost = 0 if frame.ok else lost + 1
        met = agree(frame, theirs.get(frame.index), lost, patience)
        return not met and not stopped()

    going = track_stretch(job, stretch, last.state, goes_on)
    if not met:
        return going
    at = going.frames[-1][0].index
    return replace(own, frames=going.frames + [found for found in own.frames if found[0].index > at])


def track_stretches(
    job: TrackJob,
    stretches: list[Stretch],
    jobs: int,
    progress: Callable[[int], object] = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Generator[TrackedStretch, None, None]:
    """Track stretches side by side; they come in order, joined to one track.

    Parameters
    ----------
    job : TrackJob
    stretches : list of Stretch
    jobs : int
        Worker processes.
    progress : callable
        Called now and then, on another thread, with how many frames are done.
    stopped : callable
        Whether to stop: what is done is given then, as far as it comes without a gap.

    Raises
    ------
    VideoError, ImageError, StartError
        As of :class:`VideoReader`, and of :class:`Tracker` for the first frame.
    LiaamError
        If a worker dies.
    """
    last: TrackedStretch | None = None
    try:
        with (
            _watched(len(stretches), progress, stopped) as shared,
            closing(_each(job, stretches, jobs, shared)) as each,
        ):
            for stretch, tracked in _in_order(each):
                last = tracked if last is None else joined(job, stretch, last, tracked, stopped)
                yield last
                if not last.whole:
                    return  # stopped, or the file ends here
    except WorkerDied as death:
        begin = death.items[0].start
        raise LiaamError(
            f"{job.video}: the process that tracked frames {begin} on died (killed, or out of memory); try --jobs 1"
        ) from death


def _each(job: TrackJob, stretches: list[Stretch], jobs: int, shared: "_Shared") -> Found:
    """Stretches as they are tracked, each on its own."""
    if jobs == 1:
        for stretch in stretches:
            yield stretch, track_stretch(job, stretch, seen=partial(shared.seen, stretch))
        return
    workers = min(jobs, len(stretches))
    yield from in_workers(_track, stretches, workers, prepare=partial(_prepare, job), inherited=(shared,))


def _in_order(each: Found) -> Found:
    waiting: dict[int, tuple[Stretch, TrackedStretch]] = {}
    number = 0
    for stretch, tracked in each:
        waiting[stretch.number] = stretch, tracked
        while number in waiting:
            yield waiting.pop(number)
            number += 1


@dataclass(frozen=True, eq=False)
class _Shared:
    """What processes tell each other, without locks, which a process that is killed would leave closed.

    Attributes
    ----------
    n_done : array of int
        Frames of each stretch that are done.
    stop : bool value
        Whether to stop.
    """

    n_done: Any
    stop: Any

    def seen(self, stretch: Stretch, frame: TrackedFrame) -> bool:
        """Count a frame, but for those before a stretch; tells whether to go on."""
        self.n_done[stretch.number] += frame.index >= stretch.start
        return not self.stop.value


@contextmanager
def _watched(n: int, progress: Callable[[int], object], stopped: Callable[[], bool]) -> Iterator[_Shared]:
    """Tell of progress and pass on the wish to stop, on a thread: this one waits for the workers."""
    context, over = multiprocessing.get_context("spawn"), threading.Event()
    shared = _Shared(context.RawArray("q", n), context.RawValue("b", 0))

    def watch() -> None:
        while not over.wait(POLLED):
            shared.stop.value = stopped()
            progress(sum(shared.n_done))

    watcher = threading.Thread(target=watch, name="watch", daemon=True)
    watcher.start()
    try:
        yield shared
    finally:
        over.set()
        watcher.join()


_work: tuple[TrackJob, _Shared] | None = None


def _prepare(job: TrackJob, shared: _Shared) -> None:
    """Make this worker process ready for stretches of a job."""
    global _work
    _work = job, shared


def _track(stretch: Stretch) -> TrackedStretch:
    """Track a stretch in a worker process."""
    assert _work is not None
    job, shared = _work
    return track_stretch(job, stretch, seen=partial(shared.seen, stretch))
