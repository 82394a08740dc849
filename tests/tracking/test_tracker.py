"""Tracking generated videos: what moves is followed, what is hidden is found again, what trembles is calmed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from liaam.errors import ImageError, MethodError, StartError, VideoError
from liaam.fitting import Detection, Finder, FitStatus, Fitter
from liaam.model import SURROUNDINGS
from liaam.model.shape import align, diagonal_of
from liaam.tracking import Tracker, TrackingOptions, TrackStatus, track_video
from liaam.tracking.tracker import sharpest
from scenes import lateral
from setups import MOVING_FRAMES, moving_scene

RIGHT = 0.03


def off(landmarks: np.ndarray, scene) -> float:
    """Mean error as a share of the truth's diagonal."""
    return float(np.linalg.norm(landmarks - scene.landmarks, axis=1).mean() / diagonal_of(scene.landmarks))


def noisy(image: np.ndarray, rng: np.random.Generator, sigma: float = 6.0) -> np.ndarray:
    return np.clip(image + rng.normal(0, sigma, image.shape), 0, 255).astype(np.uint8)


def trembling(landmarks: np.ndarray) -> float:
    """Root mean square second difference of landmarks (frames, n, 2)."""
    return float(np.sqrt(np.mean(np.diff(landmarks, 2, axis=0) ** 2)))


def blank(scene) -> np.ndarray:
    return np.full_like(scene.image, 90)


def test_a_moving_head_is_followed(head_model, moving, clip):
    frames = list(track_video(head_model, clip))
    assert [frame.index for frame in frames] == list(range(len(moving)))
    assert [frame.status for frame in frames] == [TrackStatus.FOUND] + [TrackStatus.TRACKED] * (len(moving) - 1)
    assert frames[5].time == pytest.approx(0.2)
    for frame, scene in zip(frames, moving, strict=True):
        assert frame.ok
        assert off(frame.raw, scene) < RIGHT
        assert off(frame.landmarks, scene) < RIGHT
        assert frame.quality > 0.5
        assert np.isnan(frame.theta)


def test_a_part_of_a_video_from_a_given_start(head_model, moving, clip):
    init = moving[10].landmarks + 2.0
    frames = list(track_video(head_model, clip, init=init, start=10, stop=14, options=TrackingOptions(smooth=False)))
    assert [frame.index for frame in frames] == [10, 11, 12, 13]
    for frame in frames:
        assert off(frame.raw, moving[frame.index]) < RIGHT
        np.testing.assert_array_equal(frame.landmarks, frame.raw)
        np.testing.assert_array_equal(frame.covariances, frame.raw_covariances)


def test_light_that_changes_is_no_matter(head_model):
    tracker = Tracker(head_model)
    for i in range(5):
        scene = moving_scene(i / MOVING_FRAMES, lateral("left", ambient_strength=1.0 - 0.22 * i))
        frame = tracker.update(scene.image)
        assert frame.ok
        assert off(frame.landmarks, scene) < RIGHT


def test_a_method_with_an_angle_tells_it(head_model, moving):
    tracker = Tracker(head_model, "li", init=moving[0].landmarks)
    for scene in moving[:4]:
        frame = tracker.update(scene.image)
        assert np.isfinite(frame.theta)
        assert np.isnan(frame.quality)
        assert off(frame.raw, scene) < RIGHT


def test_what_is_hidden_is_lost_and_found_again(head_model, moving):
    tracker = Tracker(head_model, options=TrackingOptions(patience=2))
    hidden = range(6, 13)
    frames = [tracker.update(blank(s) if i in hidden else s.image) for i, s in enumerate(moving[:20])]
    lost = [frame.index for frame in frames if not frame.ok]
    assert set(hidden) <= set(lost)
    assert len(lost) <= len(hidden) + 4  # until the next search
    for i in hidden:
        assert np.isnan(frames[i].landmarks).all()
        assert np.isnan(frames[i].covariances).all()
        assert frames[i].fit_status not in (FitStatus.CONVERGED,)
    again = frames[max(lost) + 1 :]
    assert again[0].status is TrackStatus.FOUND
    assert all(frame.status is TrackStatus.TRACKED for frame in again[1:])
    assert all(off(frame.landmarks, moving[frame.index]) < RIGHT for frame in again)


def test_a_short_gap_is_bridged_without_a_search(head_model, moving, monkeypatch):
    tracker = Tracker(head_model)
    frames = [tracker.update(scene.image) for scene in moving[:5]]
    monkeypatch.setattr(Fitter, "find", lambda *_, **__: [Detection(moving[0].landmarks, 0.0, 0.0, 1.0)])
    frames += [tracker.update(blank(moving[5])), tracker.update(moving[6].image)]
    assert [frame.status for frame in frames[-2:]] == [TrackStatus.LOST, TrackStatus.TRACKED]
    assert off(frames[-1].landmarks, moving[6]) < RIGHT


def test_searches_become_rare(head_model, moving, monkeypatch):
    searched, frame = [], 0

    def find(*_, **__):
        searched.append(frame)
        return [Detection(moving[0].landmarks, 0.0, 0.0, 1.0)]

    monkeypatch.setattr(Finder, "find_in", find)
    tracker = Tracker(head_model.with_view(SURROUNDINGS, reliabilities={}), options=TrackingOptions(longest_wait=8))
    for frame in range(40):  # noqa: B007 (``find`` reads it)
        assert not tracker.update(blank(moving[0])).ok
    assert searched == [0, 1, 3, 7, 15, 23, 31, 39]


def test_a_jump_is_no_tracking(head_model, moving):
    """A fit that ends far from where it started has found something else."""
    tracker = Tracker(head_model, init=moving[0].landmarks)
    first = tracker.update(moving[0].image)
    wide = np.pad(moving[0].image, ((0, 0), (90, 0), (0, 0)), mode="edge")[:, : moving[0].image.shape[1]]
    frame = tracker.update(wide)
    assert frame.status is not TrackStatus.TRACKED or off(frame.raw, moving[0]) < 2 * RIGHT
    assert first.status is TrackStatus.FOUND


def astray(tracker: Tracker, monkeypatch, quality: float) -> None:
    """Let fits that follow come out with part of the landmarks elsewhere, and a quality."""
    fit = tracker._near.fit

    def spoilt(image, start, name=""):
        result = fit(image, start, name)
        moved = result.landmarks.copy()
        moved[:20] += 0.1 * diagonal_of(moved)
        return replace(result, landmarks=moved, quality=quality)

    monkeypatch.setattr(tracker, "_near", SimpleNamespace(fit=spoilt))


def test_what_has_gone_astray_is_put_right(head_model, moving, monkeypatch):
    tracker = Tracker(head_model, options=TrackingOptions(review=4))
    first = tracker.update(moving[0].image)
    astray(tracker, monkeypatch, 1.0 - 3.0 * (1.0 - first.quality))
    frames = [tracker.update(scene.image) for scene in moving[1:6]]
    followed, corrected = TrackStatus.TRACKED, TrackStatus.CORRECTED
    assert [frame.status for frame in frames] == [followed, followed, followed, corrected, followed]
    assert off(frames[2].raw, moving[3]) > RIGHT > off(frames[3].raw, moving[4])
    np.testing.assert_allclose(frames[3].landmarks, frames[3].raw, atol=1e-9)  # not smoothed with what was astray
    assert frames[3].ok and frames[3].quality > frames[2].quality


@pytest.mark.parametrize(
    ("change", "moved", "status"),
    [
        ({}, 0.1, TrackStatus.CORRECTED),
        ({"quality": 0.79}, 0.1, TrackStatus.TRACKED),  # better, but not clearly
        ({"status": FitStatus.DIVERGED}, 0.1, TrackStatus.TRACKED),
        ({}, 0.01, TrackStatus.TRACKED),  # the same
        ({}, 0.5, TrackStatus.TRACKED),  # another object
    ],
)
def test_a_review_has_to_be_clearly_better(head_model, moving, monkeypatch, change, moved, status):
    tracker, starts = Tracker(head_model, options=TrackingOptions(review=1)), []
    tracker.update(moving[0].image)
    near = tracker._near.fit

    def followed(image, start, name=""):
        return replace(near(image, start, name), quality=0.75)

    def anew(image, start, name=""):
        starts.append(start)
        fit = near(image, start, name)
        return replace(
            fit, **{"landmarks": fit.landmarks + moved * diagonal_of(fit.landmarks), "quality": 0.9, **change}
        )

    monkeypatch.setattr(tracker, "_near", SimpleNamespace(fit=followed))
    monkeypatch.setattr(tracker, "fitter", SimpleNamespace(fit=anew))
    assert tracker.update(moving[1].image).status is status
    mean = head_model.shape_model.mean
    np.testing.assert_allclose(align(starts[0], mean)(starts[0]), mean, atol=1e-6)


@pytest.mark.parametrize(("review", "reviewed"), [(0, []), (3, [12, 15, 19]), (1, [11, 12, 14, 15, 16, 19]), (100, [])])
def test_frames_are_reviewed_by_their_number(head_model, moving, monkeypatch, review, reviewed):
    tracker, found = Tracker(head_model, options=TrackingOptions(review=review)), []
    monkeypatch.setattr(tracker, "_reviewed", lambda _pixels, _followed, name: found.append(int(name.split()[1])))
    for i in (10, 11, 12, 14, 15, 16, 19):  # a camera leaves frames out
        tracker.update(moving[i].image, index=i)
    assert found == reviewed


def test_what_knows_no_quality_is_not_reviewed(head_model, moving, monkeypatch):
    tracker = Tracker(head_model, "li", init=moving[0].landmarks, options=TrackingOptions(review=1))
    tracker.update(moving[0].image)
    monkeypatch.setattr(tracker, "fitter", None)
    assert tracker.update(moving[1].image).status is TrackStatus.TRACKED


def test_frames_of_another_size_are_followed(head_model, moving):
    import cv2

    tracker = Tracker(head_model)
    for i, scene in enumerate(moving[:8]):
        zoom = 1.5 if i in (3, 4, 5) else 1.0
        image = cv2.resize(scene.image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
        frame = tracker.update(image)
        assert frame.status is (TrackStatus.FOUND if i == 0 else TrackStatus.TRACKED)
        assert off((frame.landmarks + 0.5) / zoom - 0.5, scene) < RIGHT


# Smoothing


@pytest.fixture(scope="module")
def stills(head_model, moving):
    # With the sample's shapes, whose span holds the head: what is asked is what the filter makes of the fits' noise.
    # Smooth deformations have twice as many modes and let more of it through.
    warp = replace(head_model.views[SURROUNDINGS].warp, shape_model=head_model.shape_model)

    def follow(seed):
        rng, tracker = np.random.default_rng(seed), Tracker(head_model.with_view(SURROUNDINGS, warp=warp))
        return [tracker.update(noisy(moving[0].image, rng)) for _ in range(30)]

    return [follow(seed) for seed in (12, 13, 14)]


@pytest.fixture(scope="module")
def still(stills):
    return stills[0]


def test_a_still_scene_trembles_less(stills):
    # Over several draws: what is left of 22 frames of noise is 0.36 of what it was, on average over six.
    raw = np.array([[frame.raw for frame in frames] for frames in stills])
    smooth = np.array([[frame.landmarks for frame in frames] for frames in stills])
    left, before = (np.sqrt(np.mean([trembling(each[8:]) ** 2 for each in part])) for part in (smooth, raw))
    assert left < 0.5 * before
    assert np.linalg.norm(smooth[:, 15:].mean(1) - raw[:, 15:].mean(1), axis=2).max() < 0.3
    assert smooth[:, 15:].std(axis=1).mean() < 0.8 * raw[:, 15:].std(axis=1).mean()


def test_smoothing_does_not_lag(head_model, moving):
    """Noise or not, the smoothed landmarks keep up with the head: no further behind than the fits' own errors."""
    rng = np.random.default_rng(13)
    tracker = Tracker(head_model)
    frames = [tracker.update(noisy(scene.image, rng)) for scene in (*moving, *moving)]
    raw = np.array([frame.raw for frame in frames])[5:]
    smooth = np.array([frame.landmarks for frame in frames])[5:]
    truth = np.array([scene.landmarks for scene in (*moving, *moving)])[5:]
    assert np.linalg.norm(smooth - raw, axis=2).mean() < 0.5  # pixels; the head moves by up to 2 in a frame
    wrong = [np.linalg.norm(found - truth, axis=2).mean() for found in (raw, smooth)]
    assert wrong[1] < 1.1 * wrong[0]


def test_a_leap_is_followed_at_once(head_model, moving):
    tracker = Tracker(head_model)
    for _ in range(12):
        tracker.update(moving[0].image)
    leap = np.pad(moving[0].image, ((0, 0), (5, 0), (0, 0)), mode="edge")[:, : moving[0].image.shape[1]]
    frame = tracker.update(leap)
    assert np.linalg.norm(frame.landmarks - frame.raw, axis=1).mean() < 1.0


def test_smoothed_covariances_are_no_larger(still):
    for frame in still:
        assert np.linalg.eigvalsh(frame.raw_covariances - frame.covariances).min() > -1e-9
        assert np.linalg.eigvalsh(frame.covariances).min() > 0
    # Frames also differ by what their noise leaves unexplained, so that one is compared with itself.
    last = still[-1]
    smooth, raw = (np.trace(each, axis1=1, axis2=2).sum() for each in (last.covariances, last.raw_covariances))
    assert smooth < raw


# Bad input, and what must not stop a video


def test_bad_starts_are_errors_and_bad_frames_are_lost(head_model, moving):
    with pytest.raises(StartError, match="outside the image"):
        Tracker(head_model, init=(5000, 5000, 5100, 5100)).update(moving[0].image)
    grey = np.repeat(moving[1].image.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    with pytest.raises(ImageError, match="grey"):
        Tracker(head_model, "li", init=moving[0].landmarks).update(grey)
    tracker = Tracker(head_model, "li", init=moving[0].landmarks)
    assert tracker.update(moving[0].image).ok
    assert not tracker.update(grey).ok
    assert tracker.update(moving[2].image).ok


@pytest.mark.parametrize("bad", [np.zeros((4, 4, 3), np.uint8), np.zeros(7)])
def test_frames_that_are_no_pictures_are_lost(head_model, moving, bad):
    with pytest.raises(ImageError, match=r"walk\.mp4, frame 3"):
        Tracker(head_model, name="walk.mp4").update(bad, index=3)
    tracker = Tracker(head_model)
    assert tracker.update(moving[0].image).ok
    lost = tracker.update(bad, 0.04)
    assert (lost.status, lost.fit_status, lost.index, lost.time) == (TrackStatus.LOST, None, 1, 0.04)
    assert tracker.result is None
    after = tracker.update(moving[2].image)
    assert after.status is TrackStatus.TRACKED
    assert off(after.landmarks, moving[2]) < RIGHT


def test_errors_name_the_video(head_model, clip):
    with pytest.raises(StartError, match=r"talk.mp4, frame 2"):
        next(track_video(head_model, clip, init=(5000, 5000, 5100, 5100), start=2))


def test_a_grey_video_is_tracked_by_the_default_method(head_model, moving):
    tracker = Tracker(head_model)
    for scene in moving[:3]:
        grey = np.repeat(scene.image.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
        assert off(tracker.update(grey).landmarks, scene) < RIGHT


def test_a_tracker_begins_anew(head_model, moving):
    tracker = Tracker(head_model)
    tracker.update(moving[0].image)
    assert tracker.result is not None
    tracker.reset()
    assert tracker.result is None
    frame = tracker.update(moving[12].image)
    assert (frame.index, frame.status) == (0, TrackStatus.FOUND)


@pytest.mark.parametrize("wrong", [{"patience": -1}, {"longest_wait": 0}, {"review": -1}])
def test_options_that_make_no_sense(wrong):
    with pytest.raises(MethodError, match="at least"):
        TrackingOptions(**wrong)


def test_no_video_no_track(head_model, tmp_path):
    with pytest.raises(VideoError, match="does not exist"):
        next(track_video(head_model, tmp_path / "none.mp4"))


def test_the_sharpest_levels_stay(head_model):
    part = sharpest(head_model, 1)
    assert part.views[SURROUNDINGS].levels == head_model.views[SURROUNDINGS].levels[-1:]
    assert len(sharpest(head_model, 99).levels) == len(head_model.levels)
