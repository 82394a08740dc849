"""Batches: one row per picture, the same rows whoever does them and however often they are stopped."""

import csv
import glob
import io
import json
import multiprocessing
import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing, suppress
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from liaam import __version__
from liaam.batch import Settings, cluster as cluster_module, find_pictures, listed_pictures, run_batch, work
from liaam.batch.journal import Journal, place_of
from liaam.batch.run import DEATHS, _Batch, earlier_summary
from liaam.batch.work import FitJob, _shorts
from liaam.errors import LiaamError
from liaam.fitting import FitStatus
from liaam.io import read_collection, read_landmarks, write_collection, write_image, write_landmarks
from liaam.io.landmarks.writers import TPS_DECIMALS
from liaam.model.shape import diagonal_of
from liaam.morphometry import read_specimens
from scenes import Head, make_set
from setups import train_on

SIZE = (160, 120)
N_PICTURES = 9
FAULTS = {
    "text.jpg": (
        b"hello, I am no picture",
        "is not a PNG, JPEG, TIFF, BMP, PPM, PGM, WebP, AVIF, HEIC, GIF or JPEG 2000 image",
    ),
    "zero.png": (b"", "is empty"),
    "cut.png": (None, "cut short"),
    "cut.jpg": (b"\xff\xd8\xff\xe0\x00\x10JFIF", "damaged or cut short"),
}
"""What else lies in the folder of pictures, and what is said of it."""


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A small model, and a folder of pictures of which some are none."""
    folder = tmp_path_factory.mktemp("batch")
    scenes = make_set(N_PICTURES, Head(5), size=SIZE)
    train_on(scenes[:4], diagonal=50.0, response="srgb").save(folder / "face.liaam")
    pictures = folder / "images"
    (pictures / "more").mkdir(parents=True)
    for i, scene in enumerate(scenes):
        path = pictures / ("more" if i % 2 else "") / f"face{i + 2}.png"
        write_image(path, scene.image)
        write_landmarks(path.with_suffix(".pts"), scene.landmarks)
    for name, (content, _) in FAULTS.items():
        (pictures / name).write_bytes((pictures / "face2.png").read_bytes()[:900] if content is None else content)
    (pictures / ".hidden.png").write_bytes(b"")
    shape = np.mean([scene.landmarks for scene in scenes], axis=0)
    x, y = 0.5 * (shape.min(axis=0) + shape.max(axis=0))
    settings = Settings("grey", init=f"{x:.0f},{y:.0f},{diagonal_of(shape):.0f}", iterations=30)
    return SimpleNamespace(folder=folder, model=folder / "face.liaam", pictures=pictures, settings=settings)


def batch_of(world, output, pictures=None, **options):
    """Run a batch in one process, unless told otherwise."""
    pictures = world.pictures if pictures is None else pictures
    return run_batch(world.model, pictures, output, **{"settings": world.settings, "jobs": 1, **options})


def test_starts_are_texts_paths_and_boxes():
    assert Settings(init=(1, 2, 3.5, 4)).init == "1.0,2.0,3.5,4.0"
    assert Settings(init=np.array([1, 2, 3])).init == "1.0,2.0,3.0"
    assert Settings(init=Path("starts")).init == Settings(init="starts").init == "starts"
    for wrong in (["a"], [[1, 2], [3, 4]], 7):
        with pytest.raises(LiaamError, match="give a path, 'beside', or a box of numbers"):
            Settings(init=wrong)


def rows_of(path):
    """Rows of a .csv or .jsonl, without the seconds that they took."""
    text = path.read_text()
    rows = csv.DictReader(io.StringIO(text)) if path.suffix == ".csv" else map(json.loads, text.splitlines())
    return [{key: value for key, value in row.items() if key != "seconds"} for row in rows]


@pytest.fixture(scope="module")
def expected(world):
    """Rows of an undisturbed run in one process."""
    summary = batch_of(world, world.folder / "expected.csv")
    assert summary.fitted == summary.total == N_PICTURES + len(FAULTS)
    return rows_of(world.folder / "expected.csv")


def files_beside(path):
    return sorted(other.name for other in path.parent.iterdir())


def stop_at(n):
    """Progress that a person watches, and stops by Ctrl-C."""

    def tell(done, _total, _what):
        if done >= n:
            raise KeyboardInterrupt

    return tell


# Which pictures -----------------------------------------------------------------------------------


def test_finds_pictures_of_folders_patterns_and_files(world):
    inside = set(find_pictures(world.pictures))
    assert len(inside) == N_PICTURES + len(FAULTS)
    assert set(find_pictures(f"{world.pictures}/**")) == inside
    assert {Path(path).name for path in find_pictures(f"{world.pictures}/more/*.p?g")} == {
        f"face{i + 2}.png" for i in range(1, N_PICTURES, 2)
    }
    odd = world.folder / "a[1].xyz"
    odd.touch()
    odd.write_text("x")
    assert list(find_pictures(odd, odd)) == [str(odd), str(odd)]


def test_a_named_file_with_a_fault_is_a_row(world, tmp_path):
    (tmp_path / "zero.png").touch()
    (tmp_path / "nowhere.png").symlink_to("gone.png")
    pictures = find_pictures(tmp_path / "zero.png", tmp_path / "nowhere.png", world.pictures / "face2.png")
    assert batch_of(world, tmp_path / "r.csv", pictures).statuses == {"converged": 1, "error": 2}


def test_paths_stay_as_named(world, tmp_path, monkeypatch):
    (tmp_path / "real" / "sub").mkdir(parents=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "link").symlink_to("../real/sub")
    for name in ("real", "other"):
        (tmp_path / name / "x.png").touch()
    (tmp_path / "real" / "x.png").write_bytes((world.pictures / "face2.png").read_bytes())
    monkeypatch.chdir(tmp_path)
    names = ["other/link/../x.png", "./other//x.png", "other/x.png", ".//.//other/x.png", f"/{tmp_path}/real/x.png"]
    batch_of(world, "r.jsonl", names)
    assert {row["path"]: row["status"] for row in rows_of(tmp_path / "r.jsonl")} == {
        "other/link/../x.png": "converged",
        "other/x.png": "error",
        f"/{tmp_path}/real/x.png": "converged",
    }


@pytest.mark.parametrize(
    ("source", "message"),
    [("nowhere", "does not exist"), ("empty", "no images"), ("empty/**/*.png", "no images")],
)
def test_a_source_without_pictures_is_an_error_and_leaves_nothing(world, tmp_path, source, message):
    (tmp_path / "empty").mkdir()
    with pytest.raises(LiaamError, match=message):
        batch_of(world, tmp_path / "r.csv", str(tmp_path / source))
    with pytest.raises(LiaamError, match="no image to fit"):
        batch_of(world, tmp_path / "r.csv", [])
    assert files_beside(tmp_path / "r.csv") == ["empty"]


def test_reads_lists():
    lines = [b"\xef\xbb\xbfa b.png\r\n", b"\n", b"caf\xe9.jpg\n", b"  "]
    assert list(listed_pictures(lines)) == ["a b.png", os.fsdecode(b"caf\xe9.jpg")]


def test_order_is_natural():
    paths = ["b1.png", "a10.png", "a2.png", "A3.png", "a02.png", "a/1.png"]
    assert sorted(paths, key=lambda path: (place_of(path), path)) == [
        "a/1.png", "a02.png", "a2.png", "A3.png", "a10.png", "b1.png"
    ]  # fmt: skip


# Rows -----------------------------------------------------------------------------------------------


def test_each_picture_is_a_row(world, expected):
    paths = [row["path"] for row in expected]
    assert paths == sorted(paths, key=place_of)
    assert len(paths) == N_PICTURES + len(FAULTS)
    for row in expected:
        fault = FAULTS.get(Path(row["path"]).name)
        if fault is None:
            assert row["status"] == "converged"
            assert 0 < float(row["x1"]) < SIZE[0]
            assert float(row["xx1"]) > 0
            assert "x0" not in row
            assert row["quality"] == row["score"] == row["theta_deg"] == ""
        else:
            assert row["status"] == "error"
            assert fault[1] in row["message"]
            assert row["path"] in row["message"]
            assert row["x1"] == row["cost"] == ""
    assert json.loads((world.folder / "expected.csv.json").read_text())["statuses"] == {
        "converged": N_PICTURES,
        "error": len(FAULTS),
    }


def test_rows_depend_on_nothing_else(world, expected, tmp_path):
    shuffled = random.Random(1).sample([row["path"] for row in expected] * 2, 2 * len(expected))
    of_others = multiprocessing.active_children()  # workers of a cluster, of an earlier test, may be about to end
    batch_of(world, tmp_path / "a.csv", shuffled, jobs=2)
    assert rows_of(tmp_path / "a.csv") == expected
    assert (tmp_path / "a.csv").read_text().splitlines()[0].endswith(",seconds")
    assert {*multiprocessing.active_children()} <= {*of_others}


def test_numbers_are_written_alike_whatever_numpy_prints():
    values = np.array([24.776817, 1e-12, np.inf, np.nan, 3e38, 123456.78])
    with np.printoptions(legacy="1.13"):  # as another library may leave it
        assert _shorts(values) == [24.776817, 1e-12, None, None, 3e38, 123456.78]


def test_formats_say_the_same(world, expected, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    batch_of(world, tmp_path / "r.jsonl")
    batch_of(world, tmp_path / "r.parquet")
    table = parquet.read_table(tmp_path / "r.parquet")
    assert json.loads(table.schema.metadata[b"liaam"])["method"] == "grey"
    assert table.column_names[-1] == "seconds"
    for row, line, flat in zip(table.to_pylist(), rows_of(tmp_path / "r.jsonl"), expected, strict=True):
        assert [row["path"], row["status"], row["message"]] == [line["path"], line["status"], line["message"]]
        assert (row["landmarks"] is None) == (line["landmarks"] is None) == (flat["x1"] == "")
        if row["landmarks"] is not None:
            assert np.array_equal(row["landmarks"], np.array(line["landmarks"], np.float32))
            assert [str(v) for v in line["landmarks"]] == [
                v for k, v in flat.items() if k[0] in "xy" and k[1].isdigit()
            ]
            assert len(row["covariance"]) == 3 * len(row["landmarks"]) // 2
            assert row["cost"] == line["cost"] == float(flat["cost"])


def test_landmarks_of_usable_fits_are_written_as_tps(world, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(world.pictures)
    starts = world.folder / "starts.tps"
    scenes = {path: read_landmarks(path.with_suffix(".pts")) for path in world.pictures.rglob("face*.png")}
    marks = {path.name: replace(own, scale=0.25) for path, own in scenes.items()}
    write_collection(starts, marks, dict.fromkeys(marks, SIZE[::-1]))
    names = [str(path) for path in scenes]
    batch_of(world, tmp_path / "fits.tps", names, settings=Settings("grey", init=str(starts), iterations=30))
    batch_of(world, tmp_path / "fits.jsonl", names, settings=Settings("grey", init=str(starts), iterations=30))
    usable = {row["path"]: row for row in rows_of(tmp_path / "fits.jsonl") if row["status"] == "converged"}
    found = read_collection(tmp_path / "fits.tps")
    assert len(usable) > N_PICTURES // 2
    assert list(found) == list(usable)
    for name, landmarks in found.items():
        rounding = 0.5 * 10.0**-TPS_DECIMALS
        np.testing.assert_allclose(landmarks.points.ravel(), usable[name]["landmarks"], rtol=0, atol=1.01 * rounding)
        assert landmarks.scale == 0.25


def test_starts_and_covariances_are_choices(world, tmp_path):
    pictures = list(find_pictures(f"{world.pictures}/**/face*.png"))
    beside = Settings("grey", init="beside", iterations=30, covariance=False)
    batch_of(world, tmp_path / "a.jsonl", pictures, settings=beside)
    assert {row["status"] for row in rows_of(tmp_path / "a.jsonl")} == {"converged"}
    assert "covariance" not in rows_of(tmp_path / "a.jsonl")[0]
    boxes = tmp_path / "boxes"
    boxes.mkdir()
    for path in pictures[1:]:
        (boxes / f"{Path(path).stem}.box").write_text(world.settings.init.replace(",", " "))
    (boxes / f"{Path(pictures[1]).stem}.box").write_text("1,2")
    batch_of(world, tmp_path / "b.jsonl", pictures, settings=Settings("grey", init=str(boxes), iterations=30))
    rows = {row["path"]: row for row in rows_of(tmp_path / "b.jsonl")}
    assert "holds no landmark file" in rows[pictures[0]]["message"]
    assert "give four numbers" in rows[pictures[1]]["message"]
    assert [rows[path]["status"] for path in pictures[2:]] == ["converged"] * (N_PICTURES - 2)
    found = Settings("grey", iterations=30)
    assert Settings("grey", iterations=30, rotations="all").describe() != found.describe()  # other rows
    batch_of(world, tmp_path / "c.jsonl", pictures[:1], settings=found)
    assert 0 < rows_of(tmp_path / "c.jsonl")[0]["score"] <= 1


def test_every_object_of_an_image_has_a_row(tmp_path):
    scenes = make_set(6, Head(5), size=(160, 120))
    train_on(scenes, diagonal=60.0, response="srgb").save(tmp_path / "face.liaam")
    write_image(tmp_path / "two.png", np.concatenate([scenes[0].image, scenes[1].image], axis=1))
    write_image(tmp_path / "wall.png", np.full((150, 200, 3), 90, np.uint8))
    world = SimpleNamespace(model=tmp_path / "face.liaam", pictures=tmp_path, settings=Settings("grey"))
    batch_of(world, tmp_path / "one.jsonl")
    rows = rows_of(tmp_path / "one.jsonl")
    assert [(row["n_found"], row["object"]) for row in rows] == [(2, None), (1, None)]
    for name in ("all.csv", "all.jsonl"):
        summary = batch_of(world, tmp_path / name, settings=Settings("grey", every=True))
        rows = rows_of(tmp_path / name)
        assert summary.total == 2 and summary.statuses["error"] == 1
        assert [(Path(row["path"]).name, str(row["object"])) for row in rows[:2]] == [
            ("two.png", "1"),
            ("two.png", "2"),
        ]
        assert [str(row["n_found"]) for row in rows[:2]] == ["2", "2"]
        assert sum(summary.rows.values()) == 3
        assert "no object was found" in rows[2]["message"] and "more" not in rows[0]
        assert [each.name for each in read_specimens(tmp_path / name)][:2] == ["two#1", "two#2"]
    with pytest.raises(LiaamError, match="use only one of them"):
        Settings(init="beside", every=True)


def test_messages_name_starts_as_they_were_named(world, tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    for name in ("a.png", "b.png"):
        (tmp_path / "in" / name).write_bytes((world.pictures / "face2.png").read_bytes())
    (tmp_path / "in" / "b.box").write_text("1,2")
    monkeypatch.chdir(tmp_path)
    for i, init in enumerate(["beside", "in"]):
        batch_of(world, f"{i}.jsonl", "in", settings=Settings("grey", init))
        messages = [row["message"] for row in rows_of(tmp_path / f"{i}.jsonl")]
        assert "a.png: in holds no landmark file" in messages[0]
        assert messages[1].startswith("in/b.box: give four numbers")
    batch_of(world, "c.jsonl", tmp_path / "in", settings=Settings("grey", "in"))
    batch_of(world, "d.jsonl", tmp_path / "in", settings=Settings("grey", "beside"))
    assert "a.png: in holds" in rows_of(tmp_path / "c.jsonl")[0]["message"]
    assert f"a.png: {tmp_path / 'in'} holds" in rows_of(tmp_path / "d.jsonl")[0]["message"]


def test_a_fault_of_ours_is_a_row_too(world, tmp_path, monkeypatch):
    monkeypatch.setattr("liaam.fitting.search.starts.read_image", lambda path: 1 / 0)
    summary = batch_of(world, tmp_path / "r.csv")
    assert set(summary.statuses) == {"error"}
    assert "unexpected ZeroDivisionError" in rows_of(tmp_path / "r.csv")[0]["message"]


# Stops ----------------------------------------------------------------------------------------------


@pytest.fixture
def fitted(monkeypatch):
    """Paths that are fitted in this process, in turn."""
    paths, row = [], FitJob.row
    monkeypatch.setattr(FitJob, "row", lambda job, path: paths.append(path) or row(job, path))
    return paths


def test_a_stopped_batch_goes_on(world, expected, tmp_path, fitted):
    output = tmp_path / "r.csv"
    with pytest.raises(KeyboardInterrupt, match=r"4 of 13 images are finished.*r\.csv\.parts; run the same command"):
        batch_of(world, output, progress=stop_at(4))
    assert files_beside(output) == ["r.csv.parts"]
    summary = batch_of(world, output)
    assert (summary.fitted, summary.total) == (len(expected) - 4, len(expected))
    assert len(set(fitted)) == len(expected) >= len(fitted) - 1  # the one in progress is fitted again
    assert rows_of(output) == expected
    assert files_beside(output) == ["r.csv", "r.csv.json"]


def test_ctrl_c_is_no_death_of_the_images_in_progress(world, expected, tmp_path):
    for n in (3, 6):
        with pytest.raises(KeyboardInterrupt, match="run the same command again to resume"):
            batch_of(world, tmp_path / "r.csv", jobs=2, progress=stop_at(n))
    with Journal(tmp_path / "r.csv.parts") as journal:
        assert journal.suspects() == {}
    batch_of(world, tmp_path / "r.csv", jobs=2)
    assert rows_of(tmp_path / "r.csv") == expected


KILLED = """
import sys
from liaam.batch import Settings, run_batch
if __name__ == "__main__":
    run_batch(*sys.argv[1:4], Settings("grey", sys.argv[4], 30), jobs=2,
              progress=lambda done, total, what: print(done, flush=True))
"""


def test_a_killed_batch_goes_on(world, expected, tmp_path):
    (tmp_path / "script.py").write_text(KILLED)
    arguments = [world.model, world.pictures, tmp_path / "r.csv", world.settings.init]
    command = [sys.executable, tmp_path / "script.py", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if int(line) >= 4:
                os.kill(process.pid, signal.SIGKILL)
                break
    assert process.returncode == -signal.SIGKILL
    summary = batch_of(world, tmp_path / "r.csv")
    assert summary.fitted <= len(expected) - 4
    assert rows_of(tmp_path / "r.csv") == expected


def test_a_complete_batch_is_left_alone_until_a_picture_changes(world, expected, tmp_path, fitted):
    output, picture = tmp_path / "r.csv", tmp_path / "in.png"
    picture.write_bytes((world.pictures / "face2.png").read_bytes())
    batch_of(world, output, [picture])
    before = output.stat().st_mtime_ns
    assert batch_of(world, output, [picture]).fitted == 0
    assert (output.stat().st_mtime_ns, len(fitted)) == (before, 1)
    assert not (tmp_path / "r.csv.parts").exists()
    picture.write_bytes((world.pictures / "face4.png").read_bytes())
    assert batch_of(world, output, [picture]).fitted == 1
    output.write_text("cut")  # no longer what the batch has written
    with pytest.raises(LiaamError, match=r"is not from an earlier batch.*--restart"):
        batch_of(world, output, [picture])
    assert batch_of(world, output, [picture], restart=True).fitted == 1


def test_fits_with_absent_landmarks_are_counted(world, tmp_path, monkeypatch, run):
    made = work.fit_row

    def row_of_torn(result, *more):
        present = np.full(len(result.landmarks), 0.1)
        return made(replace(result, status=FitStatus.CONVERGED, present=present), *more)

    monkeypatch.setattr(work, "fit_row", row_of_torn)
    pictures = [world.pictures / "face2.png", world.pictures / "more/face3.png"]
    said = "2 fits with absent landmarks, which are empty: see the column 'message'"
    for _ in range(2):  # the second time, the table is complete
        code, out, _ = run("batch", world.folder / "face.liaam", *pictures, "-o", tmp_path / "r.csv")
        assert code == 0 and said in out


@pytest.mark.parametrize("init", ["beside", "{folder}", "{folder}/one.pts"])
def test_a_start_that_is_mended_is_noticed(world, tmp_path, init):
    (tmp_path / "in").mkdir()
    shape = (world.pictures / "face2.pts").read_bytes()
    for name in ("a", "b"):
        (tmp_path / "in" / f"{name}.png").write_bytes((world.pictures / "face2.png").read_bytes())
        (tmp_path / "in" / f"{name}.pts").write_bytes(shape)
    mended = tmp_path / "in" / ("one.pts" if "one" in init else "b.pts")
    mended.write_bytes(shape[:20])
    options = {"settings": Settings("grey", init.format(folder=tmp_path / "in"), 30)}
    output, pictures = tmp_path / "r.csv", [str(tmp_path / "in" / name) for name in ("a.png", "b.png")]
    batch_of(world, output, pictures, **options)
    assert rows_of(output)[1]["status"] == "error"
    assert batch_of(world, output, pictures, **options).fitted == 0
    mended.write_bytes(shape)
    assert batch_of(world, output, pictures, **options).statuses == {"converged": 2}
    mended.unlink() if mended.stem == "b" else mended.write_bytes(shape[:20])
    with pytest.raises(KeyboardInterrupt):
        batch_of(world, output, pictures, progress=stop_at(2), **options)
    mended.write_bytes(shape)  # mended while the batch is stopped
    summary = batch_of(world, output, pictures, **options)
    assert (summary.fitted, summary.statuses) == (1 if mended.stem == "b" else 2, {"converged": 2})


def test_pictures_may_come_and_go_while_a_batch_is_stopped(world, tmp_path, fitted):
    pictures = list(find_pictures(f"{world.pictures}/**/face*.png"))
    with pytest.raises(KeyboardInterrupt):
        batch_of(world, tmp_path / "r.csv", pictures[:4], progress=stop_at(2))
    assert batch_of(world, tmp_path / "r.csv", pictures[1:6]).total == 5
    assert len(fitted) <= 7  # the one in progress is fitted again
    assert {row["path"] for row in rows_of(tmp_path / "r.csv")} == set(pictures[1:6])


@pytest.mark.parametrize("stopped", [True, False])
def test_other_settings_are_refused(world, tmp_path, stopped):
    output = tmp_path / "r.csv"
    if stopped:
        with pytest.raises(KeyboardInterrupt):
            batch_of(world, output, progress=stop_at(2))
    else:
        batch_of(world, output)
    other = Settings("rgb", world.settings.init, 30)
    with pytest.raises(
        LiaamError, match=r"an earlier batch had method grey and not rgb; give another name with -o, or add --restart"
    ):
        batch_of(world, output, settings=other)
    batch_of(world, output, settings=other, restart=True)
    assert json.loads((tmp_path / "r.csv.json").read_text())["settings"]["method"] == "rgb"


def test_a_batch_that_has_done_nothing_leaves_nothing(world, expected, tmp_path, monkeypatch):
    output, other = tmp_path / "r.csv", Settings("rgb", world.settings.init, 30)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt, match="no image is finished yet"):
        patch.setattr(FitJob, "row", lambda job, path: stop_at(0)(0, 0, ""))
        batch_of(world, output)
    assert files_beside(output) == []
    with Journal(tmp_path / "r.csv.parts") as journal:  # killed before the first row
        journal.restart({"method": "rgb"})
        journal.list(["a.png"], lambda path: None)
    batch_of(world, output)
    assert rows_of(output) == expected
    with Journal(tmp_path / "r.csv.parts") as journal:
        journal.restart({"method": "rgb"})
    with pytest.raises(LiaamError, match="had method grey and not rgb"):  # the table is there still
        batch_of(world, output, settings=other)
    assert files_beside(output) == ["r.csv", "r.csv.json"]
    assert rows_of(output) == expected


def test_two_batches_on_one_output_are_refused(world, tmp_path):
    with Journal(tmp_path / "r.csv.parts"), pytest.raises(LiaamError, match="is in use by another batch"):
        batch_of(world, tmp_path / "r.csv")
    batch_of(world, tmp_path / "r.csv")


def test_a_damaged_journal_says_how_to_go_on(world, tmp_path):
    (tmp_path / "r.csv.parts").mkdir()
    (tmp_path / "r.csv.parts" / "journal.sqlite").write_bytes(b"nonsense" * 1000)
    with pytest.raises(LiaamError, match=r"remove .* and start again"):
        batch_of(world, tmp_path / "r.csv")
    (tmp_path / "s.csv.parts").write_text("mine")
    with pytest.raises(LiaamError, match=r"s\.csv\.parts is a file"):
        batch_of(world, tmp_path / "s.csv")
    assert (tmp_path / "s.csv.parts").read_text() == "mine"


class Deadly(FitJob):
    """A job some of whose pictures kill the process."""

    def row(self, path):
        if "die" in path:
            os._exit(3)
        return super().row(path)


DEADLY = """
import os, sys
from liaam.batch import Settings, run_batch
from liaam.batch.work import FitJob

row = FitJob.row
FitJob.row = lambda job, path: os._exit(3) if path.endswith("face4.png") else row(job, path)
if __name__ == "__main__":
    run_batch(sys.argv[1], sys.argv[2], sys.argv[3], Settings("grey", sys.argv[4], 30), jobs=2)
"""


def test_an_image_that_kills_two_runs_is_a_row_with_an_error(world, expected, tmp_path):
    (tmp_path / "script.py").write_text(DEADLY)
    arguments = [world.model, world.pictures, tmp_path / "r.csv", world.settings.init]
    for run in range(DEATHS):
        died = subprocess.run([sys.executable, tmp_path / "script.py", *map(str, arguments)])
        assert died.returncode == 3
        with Journal(tmp_path / "r.csv.parts") as journal:
            suspects = journal.suspects()
        assert suspects.pop(f"{world.pictures}/face4.png") == run + 1
        assert all(deaths == 1 for deaths in suspects.values())  # in progress beside it in the first run
    batch_of(world, tmp_path / "r.csv")
    rows = rows_of(tmp_path / "r.csv")
    dead = [row for row in rows if "died while fitting it" in row["message"]]
    assert [Path(row["path"]).name for row in dead] == ["face4.png"]
    assert [row for row in rows if row not in dead] == [row for row in expected if "face4.png" not in row["path"]]


def job_of(world, kind):
    return kind(world.model.read_bytes(), world.settings, str(world.pictures))


# A cluster -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster():
    """A scheduler and two workers, all processes of their own but the scheduler.

    The workers, and those that take the place of the lost, are copies of one process that has imported it all.
    """
    distributed = pytest.importorskip("distributed")
    from dask import config

    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    with (
        config.set({"distributed.worker.multiprocessing-method": method}),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
    ):
        yield cluster


def test_a_cluster_gives_the_same_rows_even_if_a_worker_is_lost(world, expected, tmp_path, cluster):
    import distributed

    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        pids = list(client.run(os.getpid).values())

    def kill_one(done, _total, _what):
        if done >= 3 and pids:
            os.kill(pids[0], signal.SIGKILL)
            pids.clear()

    options = {"scheduler": cluster.scheduler_address, "jobs": None}
    batch_of(world, tmp_path / "r.csv", progress=kill_one, **options)
    assert not pids
    assert rows_of(tmp_path / "r.csv") == expected


def test_a_picture_that_kills_workers_of_a_cluster_is_a_row(world, cluster, tmp_path):
    cluster.scheduler.allowed_failures = 0
    batch = _Batch(tmp_path / "r.csv", job_of(world, Deadly), 1, cluster.scheduler_address, lambda *_: None)
    batch.run(["face2.png", "die.png", "more/face3.png"], restart=False)
    rows = {row["path"]: row["message"] for row in rows_of(tmp_path / "r.csv")}
    assert len(rows) == 3 and [path for path, message in rows.items() if "died" in message] == ["die.png"]


def test_a_scheduler_that_is_not_there_is_an_error(world, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(cluster_module, "ANSWER", 0.5)
    with pytest.raises(LiaamError, match="no scheduler answers"):
        batch_of(world, tmp_path / "r.csv", jobs=None, scheduler="tcp://127.0.0.1:1")
    assert files_beside(tmp_path / "r.csv") == []
    with monkeypatch.context() as patch:
        patch.setattr(cluster_module, "Client", None)  # it would hang when it is thrown away
        for address in ("foo://bar", "nonsense", "tcp://host:1x"):
            with pytest.raises(LiaamError, match=f"{address}: no scheduler answers"):
                batch_of(world, tmp_path / "r.csv", jobs=None, scheduler=address)
    with pytest.raises(LiaamError, match="leave --jobs out"):
        batch_of(world, tmp_path / "r.csv", jobs=2, scheduler="tcp://127.0.0.1:1")


def test_another_program_in_place_of_a_scheduler_is_an_error(world, tmp_path):
    """A web server's answer is no length of a message, which would be all the memory there is."""
    pytest.importorskip("distributed")
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            with suppress(OSError):
                while True:
                    connection, _ = server.accept()
                    connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 9)
                    connection.close()

        threading.Thread(target=answer, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(LiaamError, match=f"{address}: no scheduler answers"):
            batch_of(world, tmp_path / "r.csv", jobs=None, scheduler=address)


# Bad input, and the command line ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"output": "r.xlsx"}, r"ends in \.parquet, \.csv, \.jsonl"),
        ({"output": "nowhere/r.csv"}, "nowhere does not exist"),
        ({"output": ".csv/"}, "ends in"),
        ({"jobs": 0}, "at least 1"),
        ({"settings": Settings("nonsense")}, "nonsense"),
        ({"settings": Settings("grey", init="nowhere")}, "no such file or folder"),
        ({"settings": Settings("grey", init="1,2")}, "not 2"),
        ({"settings": Settings("grey", response="purple")}, "purple"),
    ],
)
def test_refuses_what_makes_no_sense(world, tmp_path, change, message):
    options = {"output": "r.csv", **change}
    with pytest.raises(LiaamError, match=message):
        batch_of(world, tmp_path / options.pop("output"), **options)
    assert files_beside(tmp_path / "r.csv") == []


def test_refuses_a_model_that_is_missing_and_a_table_of_others(world, tmp_path):
    with pytest.raises(LiaamError, match="does not exist; make one"):
        run_batch(tmp_path / "m.liaam", world.pictures, tmp_path / "r.csv")
    (tmp_path / "r.csv").write_text("mine")
    with pytest.raises(LiaamError, match="not from an earlier batch"):
        batch_of(world, tmp_path / "r.csv")
    (tmp_path / "r.parquet").mkdir()
    with pytest.raises(LiaamError, match="it is a folder"):
        batch_of(world, tmp_path / "r.parquet")
    assert (tmp_path / "r.csv").read_text() == "mine"


def test_says_which_extra_is_missing(world, tmp_path, monkeypatch):
    monkeypatch.setattr("liaam.batch.tables.find_spec", lambda name: None)
    monkeypatch.setattr("liaam.batch.run.find_spec", lambda name: None)
    with pytest.raises(LiaamError, match=r'pip install "\.\[batch\]"'):
        batch_of(world, tmp_path / "r.parquet")
    with pytest.raises(LiaamError, match=r'pip install "\.\[cluster\]"'):
        batch_of(world, tmp_path / "r.csv", jobs=None, scheduler="tcp://127.0.0.1:1")


def test_the_command(run, world, expected, tmp_path, monkeypatch):
    names = [os.fsencode(row["path"]) for row in expected]
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(b"\n".join(names))))
    options = ["-m", "grey", "--init", world.settings.init, "--jobs", 1, "-o", tmp_path / "r.csv"]
    code, out, err = run("batch", world.model, "-", *options)
    assert code == 0
    assert "13 images done" in out
    assert "13 rows: 9 converged, 4 error" in out
    assert "4 images could not be fitted; see the column 'message'" in err
    said = " ".join(err.split())
    faults = [" ".join(row["message"].split()) for row in expected if row["status"] == "error"]
    assert [fault in said for fault in faults] == [True, True, True, False]
    assert rows_of(tmp_path / "r.csv") == expected
    assert "nothing to do" in run("batch", world.model, f"{world.pictures}/**", *options)[1]
    options[-1] = tmp_path / "zero.csv"
    for said in ("1 image done", "nothing to do"):
        code, out, err = run("batch", world.model, world.pictures / "zero.png", *options)
        assert (code, said in out, "1 row: 1 error" in out) == (1, True, True)
        assert "1 image could not be fitted" in err
        [row] = rows_of(tmp_path / "zero.csv")
        assert " ".join(row["message"].split()) in " ".join(err.split())
    code, _, err = run("batch", world.model, *options)
    assert (code, "give the images, too, as in 'liaam batch MODEL IMAGE...'" in err) == (1, True)
    code, _, err = run("batch", *options)
    assert (code, "no images: give" in err) == (1, True)


@pytest.fixture
def locked(world, tmp_path, monkeypatch):
    """A folder with a picture in it, beside one that may not be listed, whoever runs the tests."""
    for name in ("open", "closed", "open/deep/closed"):
        (tmp_path / name).mkdir(parents=True)
        write_image(tmp_path / name / "1.png", np.zeros((8, 8, 3), np.uint8))
    scandir = os.scandir

    def guarded(path="."):
        if not isinstance(path, int) and Path(path).name == "closed":
            raise PermissionError(13, "Permission denied", path)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", guarded)
    return tmp_path


@pytest.mark.parametrize("pattern", ["", "**", "**/*.png", "*/1.png", "**/**/[1].p?g"])
def test_a_folder_that_may_not_be_read_is_passed_over_and_named(locked, pattern):
    closed = []
    found = list(find_pictures(f"{locked}/{pattern}", on_closed=closed.append))
    assert [os.path.relpath(path, locked) for path in found] == ["open/1.png"]
    deep = set() if pattern == "*/1.png" else {"open/deep/closed"}
    assert {os.path.relpath(path, locked) for path in closed} == {"closed", *deep}
    with pytest.warns(UserWarning, match=r"skipped .*closed: it cannot be read"):
        assert list(find_pictures(f"{locked}/{pattern}")) == found


def test_a_source_that_may_not_be_read_is_an_error(locked, world, tmp_path):
    with pytest.raises(LiaamError, match=r"closed cannot be read \(Permission denied\): check its permissions"):
        batch_of(world, tmp_path / "out.jsonl", locked / "closed")


def test_the_command_names_folders_that_may_not_be_read(run, locked, world, tmp_path):
    options = ["-m", "grey", "--init", world.settings.init, "--jobs", 1, "-o", tmp_path / "out.jsonl"]
    _, out, err = run("batch", world.model, locked, *options)
    assert "1 row: 1" in out
    assert err.count("it cannot be read; check its permissions") == 2
    assert [Path(row["path"]).name for row in rows_of(tmp_path / "out.jsonl")] == ["1.png"]


@pytest.mark.parametrize("pattern", ["**", "*/**/*.png", "**/more/*.png", "*/face?.png", "images/*.png"])
def test_a_pattern_lists_each_folder_once_and_finds_what_glob_does(world, monkeypatch, pattern):
    known = glob.glob(f"{world.folder}/{pattern}", recursive=True)  # noqa: PTH207
    listed, scandir = [], os.scandir
    monkeypatch.setattr(os, "scandir", lambda path: listed.append(os.path.realpath(path)) or scandir(path))
    found = list(find_pictures(f"{world.folder}/{pattern}"))
    assert sorted(found) == sorted(path for path in known if path.endswith((".png", ".jpg")))
    assert len(listed) == len(set(listed))


def test_a_pattern_does_not_go_round_in_circles(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "1.png").touch()
    (tmp_path / "in" / "loop").symlink_to("../in")
    (tmp_path / "link").symlink_to("in")
    found = {os.path.relpath(path, tmp_path) for path in find_pictures(f"{tmp_path}/**")}
    assert found == {"in/1.png", "link/1.png"}


def damage(world, output, change):
    """Leave a batch half done, and change its journal."""
    journal_of(world, output)
    with closing(sqlite3.connect(output.with_name(f"{output.name}.parts") / "journal.sqlite")) as base:
        base.execute(change)
        base.commit()


def journal_of(world, output):
    """Leave a journal with one row of two pictures."""
    job = FitJob(world.model.read_bytes(), world.settings, str(world.pictures))
    folder = output.with_name(f"{output.name}.parts")
    with Journal(folder) as journal:
        journal.restart({"liaam": __version__, "model": sha256(job.model_file).hexdigest(), **job.settings.describe()})
        journal.list([str(world.pictures / "face2.png"), str(world.pictures / "face4.png")], job.start_file)
        first = journal.begin(str(world.pictures / "face2.png"))
        journal.keep(first, job.row(first))


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE facts SET text = '{'",
        "UPDATE facts SET text = '[]'",
        "UPDATE facts SET text = CAST(x'ff' AS TEXT)",
        "UPDATE pictures SET row = '{' WHERE row IS NOT NULL",
        "UPDATE pictures SET row = '{}' WHERE row IS NOT NULL",
        "UPDATE pictures SET row = '[]' WHERE row IS NOT NULL",
        "UPDATE pictures SET row = 7 WHERE row IS NOT NULL",
        "UPDATE pictures SET row = replace(row, '\"landmarks\": [', '\"landmarks\": [1, ')",
        "UPDATE pictures SET row = CAST(x'ff' AS TEXT) WHERE row IS NOT NULL",
        "UPDATE pictures SET status = NULL WHERE row IS NOT NULL",
        "UPDATE pictures SET status = x'07'",
        "UPDATE pictures SET begun = 'often' WHERE row IS NULL",
        "UPDATE pictures SET begun = NULL WHERE row IS NULL",
    ],
)
def test_a_journal_with_a_damaged_cell_says_how_to_go_on(world, tmp_path, change):
    output = tmp_path / "r.parquet"
    damage(world, output, change)
    pictures = [world.pictures / "face2.png", world.pictures / "face4.png"]
    with pytest.raises(LiaamError, match=r"is damaged.*remove .*\.parts and start again"):
        batch_of(world, output, pictures)
    assert not output.exists()
    assert batch_of(world, output, pictures, restart=True).total == 2


@pytest.mark.parametrize(
    "change",
    [
        *({"statuses": value} for value in (None, [], {"converged": "x"}, {"converged": -1}, {"converged": 1e400})),
        *({"settings": []}, {"settings": None}, {"pictures": {}}, {"bytes": []}, {"faults": "x"}, {"faults": [3]}),
    ],
    ids=str,
)
def test_a_damaged_summary_is_none(tmp_path, change):
    output = tmp_path / "r.csv"
    output.write_bytes(b"a,b\n")
    facts = {"settings": {}, "statuses": {"converged": 1}, "pictures": "ab", "bytes": 4}
    (tmp_path / "r.csv.json").write_text(json.dumps(facts))
    assert earlier_summary(output) == facts
    (tmp_path / "r.csv.json").write_text(json.dumps({**facts, **change}))
    assert earlier_summary(output) is None
    (tmp_path / "r.csv.json").write_text("[" * 100_000)
    assert earlier_summary(output) is None


def test_a_journal_whose_own_words_are_no_text_is_damaged(tmp_path):
    with Journal(tmp_path / "r.parts"):
        pass
    file = tmp_path / "r.parts" / "journal.sqlite"
    file.write_bytes(file.read_bytes().replace(b"facts (text", b"facts \xff(ext"))
    with pytest.raises(LiaamError, match=r"is damaged.*start again"), Journal(tmp_path / "r.parts"):
        pass
