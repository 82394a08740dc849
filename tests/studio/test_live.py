"""Videos that are tracked live: what the page gets for each frame, and frames and videos that make no sense."""

import csv
import io
import threading
import time

import cv2
import numpy as np
import pytest

from liaam.errors import MethodError
from liaam.studio import live
from liaam.studio.contract import FrameQuery, given
from liaam.studio.live import Frame, LiveVideo, LiveVideos, in_whole
from liaam.studio.model_store import ModelStore
from liaam.studio.refusal import Refusal
from liaam.studio.settings import StudioSettings
from liaam.tracking import Tracker, TrackStatus
from setups import moving_scene

PLACE = {"width": "320", "height": "240", "of_width": "320", "of_height": "240", "number": "0", "time": "0"}


@pytest.fixture(scope="module")
def images():
    """Give three frames of a moving head."""
    return [moving_scene(0.02 * i).image for i in range(3)]


@pytest.fixture(scope="module")
def model_file(head_model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "head.liaam"
    head_model.save(path)
    return path


def store(model) -> ModelStore:
    models = ModelStore()
    models.publish(model, {})
    return models


def frame(images, number: int = 0, **others: str) -> Frame:
    height, width = images[0].shape[:2]
    size = {"width": f"{width}", "height": f"{height}", "of_width": f"{width}", "of_height": f"{height}"}
    return Frame(given(FrameQuery, {**size, "number": f"{number}", "time": f"{number / 25}", **others}))


def rows_of(video: LiveVideo, answers: list[bytes]) -> list[dict[str, str]]:
    text = video.rows.header + "".join(answer.partition(b"\n")[0].decode() + "\n" for answer in answers)
    return list(csv.DictReader(io.StringIO(text)))


def update(video: LiveVideo, image, frame: Frame) -> bytes:
    """Give the answer of the server to a frame."""
    tracked, result = video.track(image, frame)
    row = video.rows.of(in_whole(tracked, image.shape[:2], frame.whole)).encode()
    return row + video.without_shading(image, tracked, result) if frame.flat else row


def points_of(row: dict[str, str]) -> np.ndarray:
    return np.array([[float(row[f"x{i}"]), float(row[f"y{i}"])] for i in range(1, 59)])


def test_rows_are_those_of_a_tracker(head_model, images):
    video, tracker = LiveVideo(head_model), Tracker(head_model)
    answers = [update(video, image, frame(images, i)) for i, image in enumerate(images)]
    rows = rows_of(video, answers)
    assert [row["status"] for row in rows] == ["found", "tracked", "tracked"]
    assert [row["time"] for row in rows] == ["0.0000", "0.0400", "0.0800"]
    for image, row in zip(images, rows, strict=True):
        np.testing.assert_allclose(points_of(row), tracker.update(image).landmarks, atol=1e-3)
    assert all(answer.endswith(b"\n") for answer in answers), "there is a picture that was not asked for"


def test_a_picture_without_shading_follows_its_row(head_model, images):
    answer = update(LiveVideo(head_model), images[0], frame(images, flat="1"))
    picture = cv2.imdecode(np.frombuffer(answer.partition(b"\n")[2], np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None and picture.shape == images[0].shape


def test_grey_frames_and_models_have_no_such_picture(head_model, images, monkeypatch):
    video = LiveVideo(head_model)
    grey = np.repeat(images[0].mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2)
    assert update(video, grey, frame(images, flat="1")).endswith(b"\n")

    def refuse(_):
        raise MethodError("grey")

    monkeypatch.setattr(live, "ShadingRemover", refuse)
    assert update(LiveVideo(head_model), images[0], frame(images, flat="1")).endswith(b"\n")


def test_a_frame_without_the_object_is_lost_and_the_next_one_is_found(head_model, images):
    video, nothing = LiveVideo(head_model), np.full_like(images[0], 90)
    answers = [update(video, nothing, frame(images)), update(video, images[0], frame(images, 1, fresh="1"))]
    rows = rows_of(video, answers)
    assert [row["status"] for row in rows] == ["lost", "found"]
    assert rows[0]["x1"] == ""


def test_landmarks_are_in_pixels_of_the_whole_video(head_model, images):
    tracked = Tracker(head_model).update(images[0])
    size = images[0].shape[:2]
    assert in_whole(tracked, size, size) is tracked
    twice = in_whole(tracked, size, (2 * size[0], 3 * size[1]))
    np.testing.assert_allclose(twice.landmarks + 0.5, (tracked.landmarks + 0.5) * (3, 2))
    np.testing.assert_allclose(twice.covariances, tracked.covariances * [[9, 6], [6, 4]])
    assert twice.status is TrackStatus.FOUND


@pytest.mark.parametrize(
    "wrong",
    [
        {"width": ""}, {"height": "x"}, {"width": "-320"}, {"width": "8"}, {"of_height": "0"}, {"of_width": "99999"},
        {"number": "-1"}, {"number": f"{2**31}"}, {"time": "nan"}, {"time": "inf"}, {"time": "1e99"},
        {"width": "9" * 5000},
    ],
    ids=str,
)  # fmt: skip
def test_places_that_make_no_sense_are_refused(wrong):
    with pytest.raises(Refusal) as refusal:
        Frame(given(FrameQuery, {**PLACE, **wrong}))
    assert refusal.value.status == 422


@pytest.mark.parametrize("n", [0, 1, 4 * 320 * 240 - 1, 4 * 320 * 240 + 4])
def test_a_frame_of_another_size_is_refused(n):
    with pytest.raises(Refusal, match=f"{n} bytes instead of {4 * 320 * 240}"):
        Frame(given(FrameQuery, PLACE)).image(bytes(n))


def test_the_number_of_videos_is_bounded_and_idle_ones_end(head_model, monkeypatch):
    videos = LiveVideos(store(head_model), StudioSettings(live_kept=2))
    first, second = videos.open(), videos.open()
    videos.get(first.id)
    third = videos.open()
    with pytest.raises(Refusal, match="no longer tracked"):
        videos.get(second.id)
    assert videos.get(first.id) is first and len(videos._videos) == 2
    videos.close(third.id)
    videos.close("unknown")
    assert len(videos._videos) == 1
    monkeypatch.setattr(live, "IDLE_SECONDS", -1.0)
    videos.open()
    assert len(videos._videos) == 1, "an idle video is kept"


def test_another_model_ends_all_videos(head_model):
    models = store(head_model)
    videos = LiveVideos(models)
    video = videos.open()
    models.publish(head_model, {})
    with pytest.raises(Refusal) as refusal:
        videos.get(video.id)
    assert refusal.value.status == 404
    models.publish(None)
    with pytest.raises(Refusal, match="no model yet"):
        videos.open()


def test_the_page_tracks_a_video_by_requests(folder, serve, model_file, images):
    running = serve(folder(0), model_file)
    begun = running.client.post("/api/live")
    video = begun.json()
    assert begun.status_code == 201 and video["header"].startswith("frame,time,status,")
    height, width = images[0].shape[:2]
    place = {"width": width, "height": height, "of_width": width, "of_height": height, "number": 3, "time": 0.12}
    body = np.dstack([images[0], np.full((height, width), 255, np.uint8)]).tobytes()
    address = f"/api/live/{video['id']}/frames"
    answer = running.client.post(address, params=place, content=body)
    assert answer.status_code == 200 and answer.text.startswith("3,0.1200,found,")
    hostile = [(place, body[:-1], 422), (place, bytes(2_000_001), 413), ({}, body, 422), (place, b"", 422)]
    for params, content, status in hostile:
        refused = running.client.post(address, params=params, content=content)
        assert refused.status_code == status and refused.json()["error"]
    assert running.client.post("/api/live/other/frames", params=place, content=body).status_code == 404
    assert running.client.delete(f"/api/live/{video['id']}").status_code == 204
    assert running.client.post(address, params=place, content=body).status_code == 404


def test_more_frames_at_once_than_allowed_are_refused(folder, serve, model_file, images, monkeypatch):
    running = serve(folder(0), model_file)
    video = running.client.post("/api/live").json()
    busy, go = threading.Semaphore(0), threading.Event()

    track = LiveVideo.track

    def slow(*arguments):
        busy.release()
        assert go.wait(60)
        return track(*arguments)

    monkeypatch.setattr(LiveVideo, "track", slow)
    body = bytes(4 * 320 * 240)

    def send():
        return running.client.post(f"/api/live/{video['id']}/frames", params=PLACE, content=body).status_code

    answers = []
    threads = [threading.Thread(target=lambda: answers.append(send())) for _ in range(live.AT_ONCE)]
    for thread in threads:
        thread.start()
    assert busy.acquire(timeout=60)
    deadline = time.monotonic() + 60
    while running.studio.live.get(video["id"]).in_progress < live.AT_ONCE:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert send() == 429
    go.set()
    for thread in threads:
        thread.join(60)
    assert answers == [200] * live.AT_ONCE and send() == 200
