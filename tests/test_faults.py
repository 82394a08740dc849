"""Full disks, clocks that jump, pictures that change or vanish meanwhile: nothing lost, nothing half written."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fuzz.faults.commands import Track
from liaam.batch import Settings, run_batch
from liaam.batch.work import FitJob
from liaam.datasets import load_folder
from liaam.errors import LiaamError
from liaam.io import VideoReader, video_writer, write_image, write_landmarks
from liaam.model.shape import diagonal_of
from liaam.training import train
from scenes import Head, make_set
from setups import train_on

resource = pytest.importorskip("resource", reason="limits of POSIX")

SIZE = (160, 120)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A small model, and a folder of landmarked pictures."""
    folder = tmp_path_factory.mktemp("faults")
    scenes = make_set(5, Head(5), size=SIZE)
    train_on(scenes, diagonal=40.0, response="srgb").save(folder / "face.liaam")
    (folder / "pictures").mkdir()
    for i, scene in enumerate(scenes):
        write_image(folder / "pictures" / f"face{i}.png", scene.image)
        write_landmarks(folder / "pictures" / f"face{i}.pts", scene.landmarks)
    shape = np.mean([scene.landmarks for scene in scenes], axis=0)
    x, y = 0.5 * (shape.min(axis=0) + shape.max(axis=0))
    start = f"{x:.0f},{y:.0f},{diagonal_of(shape):.0f}"
    return SimpleNamespace(folder=folder, model=folder / "face.liaam", pictures=folder / "pictures", start=start)


def batch_of(world, output, pictures=None, **options):
    settings = Settings("grey", world.start, 20)
    return run_batch(world.model, pictures or world.pictures, output, settings, jobs=1, **options)


def names_in(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


@contextmanager
def full_disk(limit=2000):
    """Let no file grow beyond so many bytes: the system refuses, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


# Full disks -----------------------------------------------------------------------------------------

COMMANDS = {
    "train": ("train {pictures} -o {out}/m.liaam --diagonal 40 --no-leave-out --copies 0", "m.liaam"),
    "fit": ("fit {model} {picture} -m grey --init {start} -o {out}", "face0_fit.png"),
    "batch": ("batch {model} {pictures} -m grey --init {start} --jobs 1 -o {out}/r.csv --restart", "r.csv"),
    "track csv": ("track {model} {clip} -m grey --init {start} --frames :4 -o {out}/t.csv", "t.csv"),
    "track npz": ("track {model} {clip} -m grey --init {start} --frames :4 -o {out}/t.npz", None),
    "track mp4": ("track {model} {clip} -m grey --init {start} --frames :4 --video {out}/t.mp4", None),
    "show": ("show {model} -o {out}/m.png", "m.png"),
    "relight": ("relight {model} {picture} --init {start} -o {out}/lit.png", None),
    "invariant": ("camera invariant {picture} --camera 122 -o {out}", "face0_invariant.png"),
    "register": ("camera register {picture} {other} --warp translation -o {out}/same.png", "same.png"),
    "lamps": ("lamps {lamps} --training-lamp 0 -o {out}/x.lamps", "x.lamps"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_is_one_sentence_and_leaves_what_was_there(world, clip, run, tmp_path, name):
    line, old = COMMANDS[name]
    out, lamps = tmp_path / "out", tmp_path / "lamps"
    for folder in (out, lamps):
        folder.mkdir()
    for i in range(4):
        for suffix in (".png", ".pts"):
            shutil.copy(world.pictures / f"face{i // 2}{suffix}", lamps / f"a{i // 2}-{i % 2}{suffix}")
    if old is not None:
        (out / old).write_bytes(b"old" if old != "t.csv" else b"frame,time,status")
    before = {path: path.read_bytes() for path in out.iterdir()}
    picture, other = world.pictures / "face0.png", world.pictures / "face1.png"
    words = {"out": out, "picture": picture, "other": other, "clip": clip, "lamps": lamps, **vars(world)}
    with full_disk():
        status, said, error = run(*(word.format(**words) for word in line.split()))
    assert status == 1, said + error
    assert "check the permissions and the free space" in error.replace("the name, ", "")
    assert error.startswith("error: ") and error.count("\n") == 1
    kept = {path: path.read_bytes() for path in out.iterdir() if path.suffix not in (".pts", ".json") or path in before}
    assert kept == before


@pytest.mark.parametrize("suffix", [".csv", ".jsonl", ".parquet"])
def test_a_batch_goes_on_once_there_is_space(world, tmp_path, suffix):
    output, limits = tmp_path / f"r{suffix}", []

    def fill_up(done, _total, what):
        if what.startswith("writing") or done == 3:
            limits.append(full_disk(1000))
            limits[-1].__enter__()

    for _ in range(2):  # while it fits, and while it writes the table
        with pytest.raises(LiaamError, match="check the permissions and the free space"):
            batch_of(world, output, progress=fill_up)
        limits.pop().__exit__(None, None, None)
        assert names_in(tmp_path)[0] == f"r{suffix}.parts" and f"r{suffix}" not in names_in(tmp_path)
    assert batch_of(world, output).statuses == {"converged": 5}
    assert names_in(tmp_path) == [f"r{suffix}", f"r{suffix}.json"]


# Clocks that jump -----------------------------------------------------------------------------------


@pytest.fixture
def jumping_clock(monkeypatch):
    """A clock that jumps by a year, forth and back, each time that it is looked at."""
    real, looks = time.time, iter(range(10**9))
    monkeypatch.setattr(time, "time", lambda: real() + (3e7 if next(looks) % 2 else -3e7))


def test_a_batch_does_not_mind_the_clock(world, tmp_path, jumping_clock):
    pictures = shutil.copytree(world.pictures, tmp_path / "in")
    for i, path in enumerate(sorted(pictures.glob("*.png"))):
        os.utime(path, (4e9 - i, 4e9 - i))  # in the year 2096
    output, told = tmp_path / "r.csv", []
    with pytest.raises(KeyboardInterrupt):
        batch_of(world, output, pictures, progress=stop_at(2))
    assert batch_of(world, output, pictures, progress=lambda *news: told.append(news)).fitted == 3
    assert all("-" not in what for _, _, what in told)  # no negative rate
    assert 0 <= float((tmp_path / "r.csv").read_text().splitlines()[1].split(",")[-1]) < 60
    assert batch_of(world, output, pictures).fitted == 0
    os.utime(pictures / "face0.png", (1e9, 1e9))  # set back: another picture, whatever its age
    assert batch_of(world, output, pictures).fitted == 5


def stop_at(n):
    def tell(done, _total, _what):
        if done >= n:
            raise KeyboardInterrupt

    return tell


# Pictures that change or vanish ---------------------------------------------------------------------


def test_pictures_that_change_or_vanish_while_a_batch_runs(world, tmp_path):
    pictures = shutil.copytree(world.pictures, tmp_path / "in")
    output, other = tmp_path / "r.jsonl", np.zeros((30, 40, 3), np.uint8)

    def disturb(done, _total, _what):
        if done == 1:
            (pictures / "face0.png").unlink()  # done already
            (pictures / "face2.png").unlink()
            (pictures / "face3.png").write_bytes((pictures / "face3.png").read_bytes()[:700])
            write_image(pictures / "face4.png", other)

    summary = batch_of(world, output, pictures, progress=disturb)
    assert summary.total == 5 and summary.statuses["error"] == 3
    rows = {Path(row["path"]).name: row for row in map(json.loads, output.read_text().splitlines())}
    assert rows["face0.png"]["status"] == "converged"
    assert "outside" in rows["face4.png"]["message"]
    assert "does not exist" in rows["face2.png"]["message"] and "cut short" in rows["face3.png"]["message"]
    shutil.copy(world.pictures / "face2.png", pictures)
    summary = batch_of(world, output, pictures)
    assert (summary.total, summary.fitted) == (4, 4)  # it is noticed, so the table is made anew
    assert summary.statuses == {"converged": 2, "error": 2}


@pytest.mark.parametrize("change", ["vanish", "cut", "shrink"])
def test_a_picture_that_changes_before_it_is_trained_on_is_named(world, tmp_path, change):
    pictures = shutil.copytree(world.pictures, tmp_path / "in")
    data, picture = load_folder(pictures), pictures / "face3.png"
    if change == "vanish":
        picture.unlink()
    elif change == "cut":
        picture.write_bytes(picture.read_bytes()[:900])
    else:
        write_image(picture, np.full((9, 9), 99, np.uint8))
    with pytest.raises(LiaamError, match=r"face3"):
        train(data, diagonal=40.0, leave_out=False, copies=0)


def test_a_picture_that_turns_grey_before_it_is_trained_on_is_named(world, tmp_path):
    pictures = shutil.copytree(world.pictures, tmp_path / "in")
    data = load_folder(pictures)
    write_image(pictures / "face3.png", np.full((120, 160), 99, np.uint8))
    with pytest.warns(UserWarning, match="face3"):
        train(data, diagonal=40.0, leave_out=False, copies=0)


def test_a_model_that_changes_while_a_batch_runs_does_not_matter(world, tmp_path):
    model = shutil.copy(world.model, tmp_path / "m.liaam")

    def disturb(done, _total, _what):
        if done == 1:
            model.write_bytes(b"something else")

    settings = Settings("grey", world.start, 20)
    summary = run_batch(model, world.pictures, tmp_path / "r.csv", settings, jobs=1, progress=disturb)
    assert summary.statuses == {"converged": 5}


# Journals -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def half_done(world, tmp_path_factory):
    """A batch that was killed: files of its journal, and the table of an undisturbed run."""
    folder = tmp_path_factory.mktemp("journal")
    kept = {}

    def keep_files(done, _total, _what):
        if done == 3:
            kept.update((path.name, path.read_bytes()) for path in (folder / "r.jsonl.parts").iterdir())

    batch_of(world, folder / "r.jsonl", progress=keep_files)
    assert set(kept) == {"journal.sqlite", "journal.sqlite-wal"}
    return SimpleNamespace(files=kept, rows=[without_seconds(text) for text in lines_of(folder / "r.jsonl")])


def lines_of(path):
    return path.read_text().splitlines()


def kept(row):
    """Give a row as a job does: its status and text."""
    return row["status"], json.dumps({**row, "seconds": 0.0})


def without_seconds(text):
    return {key: value for key, value in json.loads(text).items() if key != "seconds"}


@pytest.fixture
def known_rows(half_done, monkeypatch):
    """Rows are looked up instead of fitted: what is tested is the journal."""
    rows = {row["path"]: row for row in half_done.rows}
    monkeypatch.setattr(FitJob, "row", lambda _job, path: kept(rows[path]))


def outcome(world, half_done, folder, files):
    """Go on with a journal's files; the rows have to be right, or there is an error that says what to do."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "r.jsonl.parts").mkdir(parents=True)
    for name, content in files.items():
        (folder / "r.jsonl.parts" / name).write_bytes(content)
    try:
        summary = batch_of(world, folder / "r.jsonl")
    except LiaamError as error:
        assert re.search("start again|--restart", str(error)), error
        assert not (folder / "r.jsonl").exists()
        return "refused"
    assert [without_seconds(text) for text in lines_of(folder / "r.jsonl")] == half_done.rows
    assert names_in(folder) == ["r.jsonl", "r.jsonl.json"]
    assert summary.total == len(half_done.rows)
    return summary.fitted


def test_a_journal_that_is_whole_goes_on(world, half_done, known_rows, tmp_path):
    assert outcome(world, half_done, tmp_path / "x", half_done.files) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["journal.sqlite", "journal.sqlite-wal"])
def test_a_journal_that_is_cut_is_refused_or_goes_on(world, half_done, known_rows, tmp_path, name):
    content = half_done.files[name]
    lengths = {*range(0, 130, 7), *range(0, len(content), 1021), *range(0, len(content), 4096)}
    seen = set()
    for length in sorted(lengths):
        seen.add(outcome(world, half_done, tmp_path / "x", {**half_done.files, name: content[:length]}))
    assert seen & {2, 3, 4, 5}


def whole_journal(world, half_done, folder):
    """The journal in one file, as SQLite leaves it where it is closed in good order."""
    import sqlite3
    from contextlib import closing

    folder.mkdir()
    for name, content in half_done.files.items():
        (folder / name).write_bytes(content)
    with closing(sqlite3.connect(folder / "journal.sqlite")) as base:
        base.execute("PRAGMA journal_mode = DELETE")
    return (folder / "journal.sqlite").read_bytes()


@pytest.mark.parametrize("kind", ["flip", "noise", "page", "swap"])
def test_a_journal_with_damaged_bytes_gives_no_wrong_row(world, half_done, known_rows, tmp_path, rng, kind):
    content = whole_journal(world, half_done, tmp_path / "whole")
    seen = set()
    for _ in range(24):
        data = bytearray(content)
        at = int(rng.integers(len(data)))
        if kind == "flip":
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == "noise":
            data[at : at + 40] = rng.bytes(len(data[at : at + 40]))
        else:
            first, second = (4096 * int(page) for page in rng.integers(len(data) // 4096, size=2))
            page = bytes(4096) if kind == "page" else data[second : second + 4096]
            data[first : first + 4096] = page
        seen.add(outcome(world, half_done, tmp_path / "x", {"journal.sqlite": bytes(data)}))
    assert "refused" in seen


def test_a_digit_that_changes_in_a_row_is_noticed(world, half_done, known_rows, tmp_path):
    content = whole_journal(world, half_done, tmp_path / "whole")
    row = next(row for row in half_done.rows if str(row["landmarks"][0]).encode() in content)
    digits = str(row["landmarks"][0]).encode()
    other = digits[:-1] + (b"1" if digits[-1:] != b"1" else b"2")
    damaged = content.replace(digits, other, 1)
    assert damaged != content
    assert outcome(world, half_done, tmp_path / "x", {"journal.sqlite": damaged}) == "refused"


def test_a_journal_twice_in_one_file_goes_on(world, half_done, known_rows, tmp_path):
    content = whole_journal(world, half_done, tmp_path / "whole")
    assert outcome(world, half_done, tmp_path / "x", {"journal.sqlite": content + content}) in (2, "refused")


def test_a_journal_of_other_pictures_gives_none_of_its_rows(world, half_done, known_rows, tmp_path):
    pictures = shutil.copytree(world.pictures, tmp_path / "in")
    output = tmp_path / "r.jsonl"
    (tmp_path / "r.jsonl.parts").mkdir()
    for name, content in half_done.files.items():
        (tmp_path / "r.jsonl.parts" / name).write_bytes(content)
    rows = {str(pictures / Path(row["path"]).name): row for row in half_done.rows}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FitJob, "row", lambda _job, path: kept({**rows[path], "path": path}))
        assert batch_of(world, output, pictures).fitted == 5
    assert {row["path"] for row in map(json.loads, lines_of(output))} == set(rows)


# Videos ---------------------------------------------------------------------------------------------


def test_a_video_that_cannot_be_finished_is_not_there(world, clip, run, tmp_path, tmp_path_factory):
    """What an encoder still holds comes last: a disk that is full by then is no success."""
    target = tmp_path / "t.mp4"
    table = tmp_path_factory.mktemp("track") / "t.csv"
    options = ("-m", "grey", "--init", world.start, "--frames", ":4", "-o", table, "--video", target)
    line = ("track", world.model, clip, *options)
    assert run(*line)[0] == 0
    whole = target.read_bytes()
    for limit in (len(whole) - 1, len(whole) // 2, 40):
        with full_disk(limit):
            status, _, error = run(*line)
        assert (status, error.count("\n")) == (1, 1)
        assert target.read_bytes() == whole and names_in(tmp_path) == ["t.mp4"]
    with VideoReader(target) as reader:
        assert len(list(reader)) == 4


# Kills ----------------------------------------------------------------------------------------------


def test_videos_are_the_same_by_their_frames(tmp_path):
    """Which the trials of tracks ask for: no encoder promises the same bytes."""
    frames = np.random.default_rng(0).integers(0, 255, (6, 12, 16, 3)).repeat(8, 1).repeat(8, 2).astype(np.uint8)

    def encoded(frames):
        with video_writer(tmp_path / "t.mp4") as writer:
            for frame in frames:
                writer.write(frame)
        return (tmp_path / "t.mp4").read_bytes()

    whole = encoded(frames)
    work = Track([], tmp_path, {"t.mp4": whole, "t.csv": b"frame\n"})
    free_space = b"\0\0\0\x08free"
    assert work.same("t.mp4", whole + free_space)
    assert not work.same("t.mp4", encoded(frames[:-1]))
    assert not work.same("t.mp4", encoded(frames[::-1]))
    assert not work.same("t.mp4", whole[: len(whole) // 2])
    assert not work.same("t.mp4", b"")
    assert not work.same("t.csv", b"frame\n1\n")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="forks, and finds workers in /proc")
def test_some_kills_lose_nothing():
    root = Path(__file__).resolve().parents[1]
    names = ("train", "batch", "track", "studio")
    line = [sys.executable, "-m", "fuzz.faults", *names, "--kills", "8", "--seed", "3"]
    done = subprocess.run(line, cwd=root, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(f"{name}: 2 kills" in done.stdout for name in names)
