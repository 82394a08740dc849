"""Tracks as files."""

import csv

import numpy as np
import pytest

from liaam.errors import LiaamError
from liaam.tracking import Tracker
from liaam.tracking.files import is_track, track_writer


@pytest.fixture(scope="module")
def frames(head_model, moving):
    tracker = Tracker(head_model)
    images = [moving[0].image, moving[1].image, np.zeros_like(moving[2].image)]
    return [tracker.update(image, 0.04 * i) for i, image in enumerate(images)]


def write(path, frames):
    with track_writer(path, frames[0].raw.shape[0]) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def test_a_table_holds_everything(tmp_path, frames):
    path = write(tmp_path / "track.csv", frames)
    rows = list(csv.DictReader(path.open()))
    assert [row["status"] for row in rows] == ["found", "tracked", "lost"]
    for row, frame in zip(rows[:2], frames, strict=False):
        assert float(row["time"]) == pytest.approx(frame.time)
        assert float(row["quality"]) == pytest.approx(frame.quality, abs=1e-4)
        for i in (0, 57):
            seen = [float(row[f"{name}{i + 1}"]) for name in ("x", "y", "raw_x", "raw_y", "xx", "xy", "yy")]
            spread = frame.covariances[i]
            expected = [*frame.landmarks[i], *frame.raw[i], spread[0, 0], spread[0, 1], spread[1, 1]]
            np.testing.assert_allclose(seen, expected, rtol=1e-3, atol=1e-3)
        seen = [float(row[name]) for name in ("roll_deg", "size", "centre_x", "centre_y")]
        expected = [np.rad2deg(frame.roll), frame.size, *frame.landmarks.mean(axis=0)]
        np.testing.assert_allclose(seen, expected, atol=1e-3)
    assert rows[2]["x1"] == rows[2]["yy58"] == rows[2]["roll_deg"] == rows[2]["centre_y"] == ""
    assert is_track(path)


def test_arrays_hold_everything(tmp_path, frames):
    path = write(tmp_path / "track.npz", frames)
    with np.load(path, allow_pickle=False) as track:
        assert track["status"].tolist() == ["found", "tracked", "lost"]
        np.testing.assert_array_equal(track["frame"], [0, 1, 2])
        for name in ("landmarks", "raw", "covariances", "raw_covariances", "roll", "size"):
            np.testing.assert_array_equal(track[name], [getattr(frame, name) for frame in frames])
    assert is_track(path)


def test_a_track_of_nothing_can_be_read(tmp_path):
    for name in ("track.npz", "track.csv"):
        with track_writer(tmp_path / name, 58):
            pass
    with np.load(tmp_path / "track.npz", allow_pickle=False) as track:
        assert track["landmarks"].shape == (0, 58, 2)


def test_rows_are_on_disk_as_they_come(tmp_path, frames):
    with pytest.raises(RuntimeError, match="crash"), track_writer(tmp_path / "track.csv", 58) as writer:
        writer.write(frames[0])
        assert not (tmp_path / "track.csv").exists()
        raise RuntimeError("crash")
    rows = list(csv.DictReader((tmp_path / "track.part.csv").open()))
    assert [row["status"] for row in rows] == ["found"]
    assert not (tmp_path / "track.csv").exists()


def test_names_that_are_no_tracks(tmp_path):
    with pytest.raises(LiaamError, match=r"ends in .csv or .npz"), track_writer(tmp_path / "track.json", 58):
        pass


def test_other_files_are_no_tracks(tmp_path):
    for name in ("marks.csv", "marks.npz"):
        (tmp_path / name).write_text("x,y\n1,2\n")
        assert not is_track(tmp_path / name)
