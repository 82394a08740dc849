"""'liaam track' as a person types it."""

import csv
import signal

import numpy as np
import pytest

from liaam.cli import video as cli_video
from liaam.formatting import ranges_of
from liaam.io import VideoReader, video_writer, write_image, write_landmarks
from liaam.tracking import Tracker


@pytest.fixture(scope="module")
def model_file(head_model, tmp_path_factory):
    path = tmp_path_factory.mktemp("head") / "head.liaam"
    head_model.save(path)
    return path


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    """Work where tracks without a name may be written."""
    monkeypatch.chdir(tmp_path)


def rows_of(path):
    return list(csv.DictReader(path.open()))


def frames_of(path):
    with VideoReader(path) as video:
        return [frame.image for frame in video]


def test_all_outputs(run, model_file, clip, moving, tmp_path):
    names = {name: tmp_path / name for name in ("track.csv", "drawn.mp4", "fresh.mp4")}
    options = ("-o", names["track.csv"], "--video", names["drawn.mp4"], "--shading-free", names["fresh.mp4"])
    code, out, err = run("track", model_file, clip, *options, "--ellipses", "--frames", ":6")
    assert (code, err) == (0, "")
    assert all(str(path) in out for path in names.values())
    rows = rows_of(names["track.csv"])
    assert [row["status"] for row in rows] == ["found"] + ["tracked"] * 5
    found = np.array([[float(rows[3][f"{a}{i}"]) for a in "xy"] for i in range(1, 59)])
    assert np.linalg.norm(found - moving[3].landmarks, axis=1).mean() < 4
    drawn, fresh = frames_of(names["drawn.mp4"]), frames_of(names["fresh.mp4"])
    assert len(drawn) == len(fresh) == 6
    assert drawn[0].shape[0] > 3 * fresh[0].shape[0]  # small frames are enlarged to draw on
    assert fresh[0].shape == moving[0].image.shape


def test_a_name_is_made_up_where_none_is_given(run, model_file, clip, tmp_path):
    code, out, _ = run("track", model_file, clip, "--frames", "3:6", "--no-smooth")
    assert code == 0
    assert "talk_track.csv" in out
    rows = rows_of(tmp_path / "talk_track.csv")
    assert [row["frame"] for row in rows] == ["3", "4", "5"]
    assert all(row["x5"] == row["raw_x5"] for row in rows)
    assert run("track", model_file, clip, "--frames", ":1")[0] == 0  # a track may be written over


def test_a_folder_of_frames_is_tracked(run, model_file, moving, tmp_path):
    (tmp_path / "frames").mkdir()
    for i, scene in zip((1, 2, 10), moving, strict=False):
        write_image(tmp_path / "frames" / f"f{i}.png", scene.image)
    code, _, err = run("track", model_file, "frames", "--video", "drawn.mp4")
    assert (code, err) == (0, "")
    rows = rows_of(tmp_path / "frames_track.csv")
    assert [(row["status"], row["time"]) for row in rows] == [
        ("found", "0.0000"),
        *(("tracked", t) for t in ("0.0400", "0.0800")),
    ]
    found = np.array([[float(rows[2][f"{a}{i}"]) for a in "xy"] for i in range(1, 59)])
    assert np.linalg.norm(found - moving[2].landmarks, axis=1).mean() < 4
    assert len(frames_of(tmp_path / "drawn.mp4")) == 3


def test_images_and_videos_name_each_others_command(run, model_file, clip, moving, tmp_path):
    write_image(tmp_path / "a.png", moving[0].image)
    code, _, err = run("track", model_file, "a.png")
    assert code == 1 and "a.png is an image, not a video: use 'liaam fit'" in " ".join(err.split())
    code, _, err = run("fit", model_file, clip)
    assert code == 1 and "talk.mp4 is a video, not an image: use 'liaam track'" in " ".join(err.split())


def test_starts_of_all_kinds(run, model_file, clip, moving, tmp_path):
    write_landmarks(tmp_path / "start.pts", moving[2].landmarks)
    low, high = moving[2].landmarks.min(0), moving[2].landmarks.max(0)
    for init in (tmp_path / "start.pts", ",".join(f"{v:.0f}" for v in (*low, *high))):
        options = ("-o", tmp_path / "t.npz", "--frames", "2:4", "--init", init, "-m", "li")
        assert run("track", model_file, clip, *options)[0] == 0
    with np.load(tmp_path / "t.npz", allow_pickle=False) as track:
        assert np.isfinite(track["theta"]).all()


def test_frames_without_the_object_are_told(run, model_file, moving, tmp_path):
    path = tmp_path / "gap.mp4"
    with video_writer(path, 25) as writer:
        for i, scene in enumerate(moving[:9]):
            writer.write(np.full_like(scene.image, 90) if 3 <= i < 6 else scene.image)
    options = ("-o", tmp_path / "t.csv", "--video", tmp_path / "v.mp4", "--shading-free", tmp_path / "s.mp4")
    code, _, err = run("track", model_file, path, *options)
    assert code == 0
    assert "lost in frames 3–5" in err
    assert [row["status"] == "lost" for row in rows_of(tmp_path / "t.csv")] == [3 <= i < 6 for i in range(9)]
    assert len(frames_of(tmp_path / "v.mp4")) == len(frames_of(tmp_path / "s.mp4")) == 9


@pytest.mark.parametrize(("n", "lost"), [(4, "lost in frames 0–3 "), (1, "lost in frame 0 ")])
def test_a_video_without_the_object_is_a_failure(run, model_file, moving, tmp_path, n, lost):
    with video_writer(tmp_path / "blank.mp4", 25) as writer:
        for _ in range(n):
            writer.write(np.full_like(moving[0].image, 90))
    code, _, err = run("track", model_file, tmp_path / "blank.mp4", "-o", tmp_path / "t.csv")
    assert code == 1
    assert lost in err
    assert len(rows_of(tmp_path / "t.csv")) == n


def test_a_damaged_video_is_tracked_as_far_as_it_goes(run, model_file, moving, tmp_path):
    import av

    path = tmp_path / "cut.mp4"  # with its index before the pictures, as for the web
    with av.open(str(path), "w", options={"movflags": "faststart"}) as out:
        stream = out.add_stream("mpeg4", rate=25, options={"g": "1", "b": "4000000"})
        stream.height, stream.width, stream.pix_fmt = *moving[0].image.shape[:2], "yuv420p"
        for scene in moving:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(scene.image, format="rgb24")))
        out.mux(stream.encode())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    code, _, err = run("track", model_file, path, "-o", tmp_path / "t.csv", "--video", tmp_path / "v.mp4")
    assert code == 1
    assert "cut short" in err or "damaged" in err
    assert 3 < len(rows_of(tmp_path / "t.csv")) < len(moving)
    assert len(frames_of(tmp_path / "v.mp4")) == len(rows_of(tmp_path / "t.csv"))


def grey(image):
    return np.repeat(image.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)


@pytest.mark.parametrize("kinds", ["gggg", "ccgg", "gccc", "bggg", "bccc"])
def test_grey_frames_keep_their_shading_and_only_a_grey_video_is_told(run, model_file, moving, tmp_path, kinds):
    """Frames are grey, in colour, or blank."""
    path, fresh = tmp_path / "grey.mp4", tmp_path / "s.mp4"
    with video_writer(path, 25) as writer:
        for kind, scene in zip(kinds, moving[:4], strict=True):
            writer.write({"g": grey, "c": np.asarray, "b": lambda image: np.full_like(image, 90)}[kind](scene.image))
    options = () if kinds[0] == "b" else ("--init", "18,40,100,150")
    code, _, err = run("track", model_file, path, "--shading-free", fresh, *options)
    assert (f"an unchanged copy of {path}" in " ".join(err.split())) == (code == 1) == ("c" not in kinds)
    face = slice(40, 150), slice(18, 100)
    pairs = zip(frames_of(path), frames_of(fresh), strict=True)
    changed = [np.abs(before[face].astype(int) - after[face]).mean() > 1.5 for before, after in pairs]
    assert changed[:2] == [kind == "c" for kind in kinds[:2]]  # what fades is still a little coloured once compressed


def test_a_video_of_uneven_times_keeps_them(run, model_file, moving, tmp_path):
    times = [0.0, 0.04, 0.08, 2.0, 2.04]
    with video_writer(tmp_path / "slow.mp4", 25) as writer:
        for time, scene in zip(times, moving, strict=False):
            writer.write(scene.image, time)
    outputs = tmp_path / "v.mp4", tmp_path / "s.mp4"
    options = ("--video", outputs[0], "--shading-free", outputs[1], "--frames", "1:")
    assert run("track", model_file, tmp_path / "slow.mp4", *options)[0] == 0
    for path in outputs:
        with VideoReader(path) as video:
            np.testing.assert_allclose([frame.time for frame in video], np.array(times[1:]) - 0.04, atol=2e-3)


def test_a_video_may_be_written_over(run, model_file, clip, tmp_path):
    for _ in range(2):
        assert run("track", model_file, clip, "--video", tmp_path / "v.mp4", "--frames", ":1")[0] == 0
    assert len(rows_of(tmp_path / "talk_track.csv")) == 1  # there is a table in any case


def test_a_grey_start_names_video_and_frame(run, model_file, moving, tmp_path):
    path = tmp_path / "grey.mp4"
    with video_writer(path, 25) as writer:
        for scene in moving[:2]:
            writer.write(grey(scene.image))
    code, _, err = run("track", model_file, path, "-o", tmp_path / "t.csv", "-m", "li", "--init", "18,40,100,150")
    assert code == 1
    assert "grey.mp4, frame 0" in err


def interrupt_at(index, monkeypatch):
    """Press Ctrl-C while a frame is tracked."""
    update = Tracker.update

    def interrupted(self, *frame):
        tracked = update(self, *frame)
        if tracked.index == index:
            signal.raise_signal(signal.SIGINT)
        return tracked

    monkeypatch.setattr(Tracker, "update", interrupted)


def test_ctrl_c_leaves_what_was_done(run, model_file, clip, tmp_path, monkeypatch):
    handler = signal.getsignal(signal.SIGINT)
    interrupt_at(3, monkeypatch)
    code, _, err = run("track", model_file, clip, "-o", tmp_path / "t.csv", "--video", tmp_path / "v.mp4")
    assert code == 130
    assert "stopped after 4 frames" in err
    assert len(rows_of(tmp_path / "t.csv")) == len(frames_of(tmp_path / "v.mp4")) == 4
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.csv", "v.mp4"]
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("{none}",), "none.mp4 does not exist"),
        (("{model}",), "is not a video"),
        (("97",), "camera 97 cannot be opened"),
        (("{clip}", "--frames", "5"), "--frames 5: give the first frame"),
        (("{clip}", "--frames", "a:5"), "--frames a:5: give the first frame"),
        (("{clip}", "--frames", "5:5"), "5 is not after 5"),
        (("{clip}", "--frames", "500:"), "has only 24 frames"),
        (("{clip}", "-o", "t.json"), "ends in .csv or .npz"),
        (("{clip}", "--video", "t.gif"), "a video's name ends in"),
        (("{clip}", "--video", "{clip}"), "is the input video"),
        (("{clip}", "--video", "a.mp4", "--shading-free", "a.mp4"), "the same name"),
        (("{clip}", "-o", "none/t.csv"), "does not exist"),
        (("{clip}", "-o", "{own}"), "is not a track"),
        (("{clip}", "--video", "own.mp4"), "own.mp4 exists and is not a video"),
        (("{clip}", "--shading-free", "own.mp4"), "own.mp4 exists and is not a video"),
        (
            ("{clip}", "-m", "grey", "--shading-free", "s.mp4"),
            "does not fit a log-RGB appearance, which relighting needs",
        ),
        (("{clip}", "-m", "magic"), "unknown method 'magic'"),
        (("{clip}", "--init", "nowhere.pts"), "there is no such file"),
        (("{clip}", "--init", "9000,9000,9100,9100"), "outside the image"),
        (("{clip}", "--init", "9000,9000,9100,9100", "--frames", "2:"), "talk.mp4, frame 2"),
    ],
)
def test_errors_name_fault_and_remedy(run, model_file, clip, tmp_path, monkeypatch, arguments, complaint):
    monkeypatch.chdir(tmp_path)
    own, film = tmp_path / "own.csv", tmp_path / "own.mp4"
    for path in (own, film):
        path.write_text("x,y\n1,2\n")
    names = {"none": tmp_path / "none.mp4", "model": model_file, "clip": clip, "own": own}
    code, _, err = run("track", model_file, *(a.format(**names) for a in arguments))
    assert code == 1
    assert complaint in err
    assert "Traceback" not in err
    assert own.read_text() == film.read_text() == "x,y\n1,2\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["own.csv", "own.mp4"]


def test_ranges_in_words():
    assert ranges_of([1, 2, 3, 7, 9, 10]) == "1–3, 7, 9–10"
    assert ranges_of(range(0, 40, 2), most=2) == "0, 2 and 18 more ranges"


def test_a_number_is_a_camera_unless_a_file_has_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli_video.source_of("0") == 0
    (tmp_path / "0").write_bytes(b"film")
    assert str(cli_video.source_of("0")) == "0"
    assert cli_video.default_output(2).name == "camera2_track.csv"
