"""Long videos in stretches: all frames, once, in order, and the same however many processes there are."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from liaam.errors import LiaamError, StartError
from liaam.io import VideoReader, video_writer
from liaam.model.shape import diagonal_of
from liaam.tracking import Tracker, TrackStatus, stretches, track_video
from liaam.tracking.stretches import (
    Stretch,
    TrackedStretch,
    TrackJob,
    agree,
    cut,
    joined,
    track_stretch,
    track_stretches,
)
from liaam.tracking.tracker import TrackState
from liaam.workers import WorkerDied

LENGTH = 8


@pytest.fixture
def job(head_model, clip):
    return TrackJob(Tracker(head_model, name="talk"), str(clip))


@pytest.fixture(scope="module")
def followed(head_model, clip):
    """Frames of one tracker from the first to the last."""
    return list(track_video(head_model, clip))


def parts(job, jobs=1, length=LENGTH, **options):
    n_frames = VideoReader(job.video).n_frames
    return list(track_stretches(job, cut(0, None, n_frames, length), jobs, **options))


def frames_of(tracked):
    return [frame for part in tracked for frame, _ in part.frames]


def landmarks_of(frames):
    return np.array([frame.landmarks for frame in frames])


@given(st.integers(0, 50), st.integers(1, 500), st.integers(1, 100))
def test_stretches_hold_each_frame_once(start, n_frames, length):
    found = cut(start, start + n_frames, n_frames, length)
    ends = [part.stop for part in found]
    assert [part.number for part in found] == list(range(len(found)))
    assert [part.start for part in found] == [start, *ends[:-1]]
    assert ends[-1] == start + n_frames
    assert all(part.stop - part.start >= min(length, n_frames) for part in found)


def test_a_video_of_unknown_length_is_one_stretch():
    assert cut(3, None, None) == [Stretch(0, 3, None)]


@pytest.mark.slow
def test_stretches_say_what_one_tracker_says(job, followed):
    found = frames_of(parts(job))
    assert [frame.index for frame in found] == list(range(len(followed)))
    assert [frame.status for frame in found] == [frame.status for frame in followed]
    np.testing.assert_allclose([frame.time for frame in found], [frame.time for frame in followed])
    away = np.linalg.norm(landmarks_of(found) - landmarks_of(followed), axis=2).mean(axis=1)
    assert away.max() < 0.01 * diagonal_of(followed[0].landmarks)


@pytest.mark.slow
def test_processes_give_the_same_numbers(job):
    alone, beside = parts(job), parts(job, jobs=2)
    for a, b in zip(frames_of(alone), frames_of(beside), strict=True):
        assert (a.index, a.status, a.time) == (b.index, b.status, b.time)
        np.testing.assert_array_equal(a.landmarks, b.landmarks)
        np.testing.assert_array_equal(a.covariances, b.covariances)


def test_fits_come_where_they_are_wanted(job):
    assert all(result is None for part in parts(job) for _, result in part.frames)
    with_fits = parts(replace(job, fits=True))
    assert all(result.status is frame.fit_status for part in with_fits for frame, result in part.frames)


def test_a_start_that_makes_no_sense_is_told(head_model, clip):
    job = TrackJob(Tracker(head_model, init=(9000, 9000, 9100, 9100)), str(clip))
    with pytest.raises(StartError, match="outside the image"):
        parts(job)


def test_nothing_is_refused_in_the_middle(head_model, moving, tmp_path):
    """A run-in may begin in a frame that a first frame could not be."""
    path = tmp_path / "fades.mp4"
    with video_writer(path, 25) as writer:
        for i, scene in enumerate(moving[:12]):
            grey = np.repeat(scene.image.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
            writer.write(np.full_like(grey, 90) if i >= 4 else scene.image)
    found = frames_of(parts(TrackJob(Tracker(head_model), str(path)), length=4))
    assert [frame.ok for frame in found] == [True] * 4 + [False] * 8


def moved(frame, by):
    return replace(frame, landmarks=frame.landmarks + by)


def test_tracks_agree_near_each_other_and_nobody_takes_over_from_a_short_loss(followed):
    frame = followed[5]
    lost = replace(frame, status=TrackStatus.LOST)
    assert agree(frame, frame) and agree(frame, moved(frame, 1e-4)) and agree(lost, lost)
    assert not agree(frame, moved(frame, 1.0)) and not agree(frame, lost) and not agree(frame, None)
    assert not agree(lost, frame, lost=8, patience=8) and not agree(lost, None, lost=1, patience=8)
    assert agree(lost, frame, lost=9, patience=8)


def test_a_track_lost_for_a_frame_goes_on(job, followed):
    """Of its own object, when the other track has found something else meanwhile."""
    first = track_stretch(job, Stretch(0, 0, 8))
    blink = replace(first.frames[-1][0], status=TrackStatus.LOST)
    first = replace(first, frames=[*first.frames[:-1], (blink, None)])
    own = as_stretch([moved(frame, 20.0) for frame in followed[8:16]], before=moved(followed[7], 20.0))
    found = frames_of([joined(job, Stretch(1, 8, 16), first, own, lambda: False)])
    away = np.linalg.norm(landmarks_of(found) - landmarks_of(followed[8:16]), axis=2).mean(axis=1)
    assert away.max() < 0.01 * diagonal_of(followed[0].landmarks)


def as_stretch(frames, before=None):
    return TrackedStretch(before, [(frame, None) for frame in frames], TrackState(count=len(frames)), "", whole=True)


@pytest.mark.parametrize("meeting", [9, 11, None])
def test_a_track_goes_on_until_both_are_of_one_opinion(job, followed, meeting):
    """A stretch whose own track is elsewhere at first, or all the time."""
    first = track_stretch(job, Stretch(0, 0, 8))
    elsewhere = [
        moved(frame, 20.0) if meeting is None or frame.index < meeting else frame
        for frame in frames_of([track_stretch(job, Stretch(1, 8, 16), first.state)])
    ]
    own = as_stretch(elsewhere, before=moved(followed[7], 20.0))
    found = frames_of([joined(job, Stretch(1, 8, 16), first, own, lambda: False)])
    assert [frame.index for frame in found] == list(range(8, 16))
    away = np.linalg.norm(landmarks_of(found) - landmarks_of(followed[8:16]), axis=2).mean(axis=1)
    assert away.max() < 0.01 * diagonal_of(followed[0].landmarks)
    taken = [frame is other for frame, other in zip(found, elsewhere, strict=True)]
    assert taken == [meeting is not None and i > meeting for i in range(8, 16)]


def test_holes_of_a_damaged_file_are_no_end(job, followed, monkeypatch):
    """Pieces that cannot be decoded, the last one of a stretch among them."""
    known = [[followed[i] for i in (0, 1, 4, 5, 6)], followed[8:16], followed[16:]]
    parts_ = cut(0, None, 24, LENGTH)
    each = [(part, as_stretch(frames, followed[part.start - 1])) for part, frames in zip(parts_, known, strict=True)]
    each[0] = parts_[0], replace(each[0][1], fault="damaged")
    monkeypatch.setattr(stretches, "_each", lambda *_: (part for part in each))
    monkeypatch.setattr(stretches, "agree", lambda *_: True)
    tracked = list(track_stretches(job, parts_, 1))
    assert [frame.index for frame in frames_of(tracked)] == [i for i in range(24) if i not in (2, 3, 7)]
    assert [part.fault for part in tracked] == ["damaged", "", ""]


def test_a_wish_to_stop_leaves_no_gap(job):
    seen = []

    def stopped():
        return len(seen) > 0

    stopping = track_stretches(job, cut(0, None, 24, LENGTH), 1, seen.append, stopped)
    found = frames_of(stopping)
    assert [frame.index for frame in found] == list(range(len(found)))


def test_progress_tells_frames_and_no_run_in(job, monkeypatch):
    monkeypatch.setattr(stretches, "POLLED", 0.01)
    told = []
    parts(job, progress=told.append)
    assert told == sorted(told)
    assert 0 < told[-1] <= 24


def test_a_file_that_ends_early_says_so(head_model, moving, tmp_path):
    path = tmp_path / "short.mp4"
    with video_writer(path, 25) as writer:
        for scene in moving[:6]:
            writer.write(scene.image)
    job = TrackJob(Tracker(head_model), str(path))
    tracked = list(track_stretches(job, [Stretch(0, 0, 6), Stretch(1, 6, None)], 1))
    assert [frame.index for frame in frames_of(tracked)] == list(range(6))
    assert "fewer frames than it announces" in tracked[-1].fault


def test_a_worker_that_dies_is_told(job, monkeypatch):
    def dies(*_, stop_at_death, **__):
        assert stop_at_death  # a stretch takes minutes
        raise WorkerDied([Stretch(1, 8, 16)])
        yield

    monkeypatch.setattr(stretches, "in_workers", dies)
    with pytest.raises(LiaamError, match=r"frames from 8 on died .* --jobs 1"):
        parts(job, jobs=2)
