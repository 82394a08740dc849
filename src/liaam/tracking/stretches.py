"""Track the stretches of a long video in parallel processes. The landmarks do not depend on the number of processes.

Tracking of a stretch starts some frames before it, to estimate the motion. If it then differs from the preceding track,
for example by another person, the preceding track continues into the stretch until both agree.
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
"""Number of frames of a stretch. The last one also takes the rest."""

RUN_IN = 75
"""Number of frames tracked before a stretch: three times the filter's memory (``kalman.MEMORY``)."""

MEETING = 0.001
"""Maximum mean distance of landmarks at which two tracks agree, as a fraction of the object's diagonal."""

POLLED = 0.2
"""Seconds between updates of the progress and of the stop flag."""


@dataclass(frozen=True)
class Stretch:
    """Frames ``start`` to ``stop`` (exclusive) of a video; to the end if ``stop`` is None."""

    number: int
    start: int
    stop: int | None


@dataclass(frozen=True, eq=False)
class TrackJob:
    """A video file to track, a new tracker, and whether to return the frames' fits with their landmarks."""

    tracker: Tracker
    video: str
    fits: bool = False


@dataclass(frozen=True, eq=False)
class TrackedStretch:
    """Track of a stretch, the frame before it from its run-in, and the state of the tracker at its end.

    ``fault`` is that of the file. ``whole`` is True at the end of the stretch, and False at the end of the file or at a
    stop.
    """

    before: TrackedFrame | None
    frames: list[tuple[TrackedFrame, FitResult | None]]
    state: TrackState
    fault: str
    whole: bool


Found = Generator[tuple[Stretch, TrackedStretch], None, None]


def cut(start: int, stop: int | None, n_frames: int | None, length: int | None = None) -> list[Stretch]:
    """Cut frames `start` to `stop` (exclusive) into stretches; one, if their number `n_frames` is unknown (None)."""
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
    """Track one stretch, from the state at the end of the previous one, or else with a run-in.

    ``seen`` is called with each frame, including the run-in, and returns whether to continue.
    """
    tracker, begin = job.tracker, stretch.start
    if state is None and stretch.number:
        begin = max(0, begin - RUN_IN)
        state = TrackState(count=1)  # only the first frame of a video may raise
    tracker.resume(state or TrackState())
    before, frames, reader = None, [], VideoReader(job.video, begin, stretch.stop)
    short = f"{job.video} is cut short: it has fewer frames than it announces"
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
    """Return whether another track may continue a track, from the same frame in both.

    A track that has been lost for more than `patience` frames accepts any object.
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
    """Continue the previous track (`last`) into a stretch until it agrees with the stretch's `own` track."""
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
    """Track stretches in parallel. Yield them in order, joined to one track.

    ``progress`` is called regularly, in another thread, with the number of frames done. If ``stopped`` returns True,
    the finished frames up to the first gap are yielded.
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
            f"{job.video}: the worker process for frames from {begin} on died (killed or out of memory); try --jobs 1"
        ) from death


def _each(job: TrackJob, stretches: list[Stretch], jobs: int, shared: "_Shared") -> Found:
    """Track each stretch separately. Yield them in order of completion."""
    if jobs == 1:
        return ((stretch, _track(job, shared, stretch)) for stretch in stretches)
    workers = min(jobs, len(stretches))
    return in_workers(partial(_track, job), stretches, workers, inherited=(shared,), stop_at_death=True)


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
    """Memory shared by the processes: the number of frames done in each stretch, and whether to stop.

    It has no locks, because a killed process would not release them.
    """

    n_done: Any
    stop: Any

    def seen(self, stretch: Stretch, frame: TrackedFrame) -> bool:
        """Count a frame of a stretch, but not of its run-in. Return whether to continue."""
        self.n_done[stretch.number] += frame.index >= stretch.start
        return not self.stop.value


@contextmanager
def _watched(n: int, progress: Callable[[int], object], stopped: Callable[[], bool]) -> Iterator[_Shared]:
    """Report progress and pass on the stop flag in a thread, while the caller waits for the workers."""
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


def _track(job: TrackJob, shared: _Shared, stretch: Stretch) -> TrackedStretch:
    return track_stretch(job, stretch, seen=partial(shared.seen, stretch))
