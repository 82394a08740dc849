"""Commands that are killed, what they leave behind, and what they have to give in the end."""

from __future__ import annotations

import csv
import json
import shutil
import signal
import sqlite3
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.faults.victim import LATE, AtWrite, Ended, Victim, of_command

ANEW = 20
"""One kill of so many is of a new interpreter."""

INTERRUPTS = 3
"""One piece of work of so many meets a Ctrl-C first."""

INTERRUPTED = 130

MOST_IN_A_ROW = 3
"""Kills of one piece of work before it may finish."""

SAME_FRAME = 1.0
"""Largest mean difference, grey levels, of a frame that is the same but for the encoder's rounding."""

SIZE = (160, 120)
PICTURES = 6
FRAMES = 10


@dataclass(frozen=True)
class World:
    """What the commands work on: generated pictures with landmarks, a video, a model."""

    folder: Path
    start: str
    """A box for all pictures."""

    @property
    def pictures(self) -> Path:
        return self.folder / "pictures"

    @property
    def model(self) -> Path:
        return self.folder / "face.liaam"

    @property
    def video(self) -> Path:
        return self.folder / "face.mp4"


def make_world(folder: Path) -> World:
    """Generate what the commands work on."""
    from liaam.io import Landmarks, video_writer, write_image, write_landmarks
    from liaam.model.shape import diagonal_of
    from scenes import DIFFUSE, Expression, Head, Pose, make_set, render

    scenes = make_set(PICTURES, Head(5), size=SIZE, seed=2)
    mean = np.mean([scene.landmarks for scene in scenes], axis=0)
    x, y = 0.5 * (mean.min(axis=0) + mean.max(axis=0))
    world = World(folder, f"{x:.0f},{y:.0f},{diagonal_of(mean):.0f}")
    world.pictures.mkdir()
    for i, scene in enumerate(scenes):
        write_image(world.pictures / f"face{i}.png", scene.image)
        write_landmarks(world.pictures / f"face{i}.pts", Landmarks(scene.landmarks))
    with video_writer(world.video, Fraction(25)) as writer:
        for i in range(FRAMES):
            away = np.sin(2 * np.pi * i / FRAMES)
            pose = Pose(yaw=0.12 * away, x=4 * away, scale=0.97)
            writer.write(render(Head(5), pose, Expression(mouth_open=0.3), DIFFUSE, size=SIZE).image)
    return world


class Work:
    """A piece of work in a folder of its own, which is killed and done again until it is done.

    Parameters
    ----------
    arguments : list of str
        Of the command.
    folder : Path
        Where it writes.
    outputs : dict of str to bytes
        What it has to write in the end, by name.
    """

    def __init__(self, arguments: list[str], folder: Path, outputs: dict[str, bytes]) -> None:
        self.arguments, self.folder, self.outputs = arguments, folder, outputs
        self.before: dict[str, bytes] = {}
        """Older files of those names."""

    def check_killed(self) -> None:
        """Assert that each output is as it was before, or whole."""
        for name, content in self.outputs.items():
            path = self.folder / name
            found = path.read_bytes() if path.exists() else None
            assert found in (self.before.get(name), content) or self.same(name, found), f"{name} is half written"

    def same(self, name: str, found: bytes | None) -> bool:
        """Whether an output is the one of an undisturbed run, though its bytes are others."""
        return False

    def check_stopped(self, end: Ended) -> None:
        """Assert that it has stopped on a Ctrl-C, with a word and without a temporary file."""
        assert end.status in (0, INTERRUPTED, -signal.SIGINT), f"exit status {end.status}\n{end.said}"
        assert "Traceback" not in end.said, end.said
        assert end.status != INTERRUPTED or "stopped" in end.said, end.said
        left = [path.name for path in self.folder.glob(".liaam-*")]
        assert not left, f"{left} are left"

    def check_done(self) -> None:
        """Assert that there is what an undisturbed run writes, and nothing else."""
        there = {path.name for path in self.folder.iterdir()}
        assert there == set(self.outputs), f"it leaves {sorted(there)}, not {sorted(self.outputs)}"
        for name, content in self.outputs.items():
            found = (self.folder / name).read_bytes()
            assert found == content or self.same(name, found), f"{name} is another than that of an undisturbed run"


class Batch(Work):
    """A batch: what its journal holds stays, and is not done again."""

    table = "r.csv"

    def __init__(self, arguments: list[str], folder: Path, outputs: dict[str, bytes]) -> None:
        super().__init__(arguments, folder, outputs)
        self.kept: dict[bytes, str] = {}

    def same(self, name: str, found: bytes | None) -> bool:
        """Tables differ in the seconds, and their summaries in the table's size."""
        if found is None:
            return False
        if name == self.table:
            return _rows(found) == _rows(self.outputs[name])
        return _without(found, "bytes") == _without(self.outputs[name], "bytes")

    def check_killed(self) -> None:
        super().check_killed()
        kept = self._journal()
        if kept is None:  # it was about to end
            self._check_kept()
            return
        lost = [path for path in self.kept if kept.get(path) != self.kept[path]]
        assert not lost, f"rows of {lost} are lost or done again"
        self.kept = kept

    def check_done(self) -> None:
        super().check_done()
        self._check_kept()

    def _check_kept(self) -> None:
        """Assert that rows of earlier runs stand in the table, seconds and all."""
        table = (self.folder / self.table).read_text() if self.kept else ""
        seconds = {row["path"]: row["seconds"] for row in csv.DictReader(table.splitlines())}
        for path, text in self.kept.items():
            row = json.loads(text)
            assert float(seconds[path.decode()]) == row["seconds"], f"{path.decode()} is done twice"

    def _journal(self) -> dict[bytes, str] | None:
        """Rows in the journal, of a copy: SQLite tidies up what it opens. None where there is no journal any more."""
        parts = self.folder / f"{self.table}.parts"
        if not (parts / "journal.sqlite").exists():
            return None if self.kept else {}
        copy = self.folder.with_name(f"{self.folder.name}-journal")
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(parts, copy)
        with closing(sqlite3.connect(copy / "journal.sqlite")) as base:
            assert base.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            if not base.execute("SELECT 1 FROM sqlite_master WHERE name = 'pictures'").fetchall():
                return {}
            return dict(base.execute("SELECT path, row FROM pictures WHERE row IS NOT NULL").fetchall())


class Track(Work):
    """A track: rows that are done can be read in a file beside it."""

    video = "t.mp4"

    def same(self, name: str, found: bytes | None) -> bool:
        """Encoders do not promise the same bytes for the same frames, so that videos are compared by their frames."""
        if name != self.video or found is None:
            return False
        frames = _frames(found)
        expected = _frames(self.outputs[name])
        return frames.shape == expected.shape and bool((_mean_differences(frames, expected) < SAME_FRAME).all())

    def check_killed(self) -> None:
        super().check_killed()
        part = self.folder / "t.part.csv"
        if part.exists():
            assert self.outputs["t.csv"].startswith(part.read_bytes()), "the rows that are done are others"

    def check_stopped(self, end: Ended) -> None:
        """What is done by then is written."""
        super().check_stopped(end)
        self.before = {
            name: (self.folder / name).read_bytes() for name in self.outputs if (self.folder / name).exists()
        }
        assert self.outputs["t.csv"].startswith(self.before.get("t.csv", b"")), "the rows that are done are others"


@dataclass
class Kind:
    """A kind of work."""

    name: str
    make: type[Work]
    arguments: Callable[[World, Path], list[str]]
    outputs: tuple[str, ...]
    older: tuple[str, ...] = ()
    """Names of outputs that may be there before."""
    most_kills: int = MOST_IN_A_ROW
    seconds: float = 0.0
    """Of an undisturbed run."""
    seconds_anew: float = 0.0
    """In a new interpreter."""
    writes: int = 0
    expected: dict[str, bytes] = field(default_factory=dict)

    def run_of(self, arguments: list[str]) -> Callable[[], object]:
        """What a process does that runs this."""
        return of_command(arguments)

    def measure(self, world: World, room: Path) -> None:
        """Run it undisturbed: how long it takes, how often it writes, and what."""
        for i in range(2):
            folder = fresh(room / f"{self.name}-undisturbed")
            arguments, writes = self.arguments(world, folder), room / "writes"
            writes.unlink(missing_ok=True)
            victim = Victim(self.run_of(arguments), folder, room / "said", writes=writes)
            done = succeeded(victim.ended())
            self.seconds, self.writes = done.seconds, writes.stat().st_size
            work = self.make(arguments, folder, self.expected or dict.fromkeys(self.outputs, b""))
            if i:
                work.check_done()
            self.expected = {name: (folder / name).read_bytes() for name in self.outputs}
        folder = fresh(room / f"{self.name}-undisturbed")
        arguments = self.arguments(world, folder)
        self.seconds_anew = succeeded(Victim.anew(arguments, room / "said").ended()).seconds
        self.make(arguments, folder, self.expected).check_done()

    def trial(self, world: World, room: Path, rng: np.random.Generator, most: int) -> int:
        """Begin a piece of work, kill it some times, and have it finish; gives the number of kills."""
        folder, kills = fresh(room / self.name), 0
        work = self.make(self.arguments(world, folder), folder, self.expected)
        if self.older and rng.random() < 0.5:
            work.before = {name: b"old " + name.encode() for name in self.older}
            for name, content in work.before.items():
                (folder / name).write_bytes(content)
        if rng.integers(INTERRUPTS) == 0:
            work.check_stopped(self._killed(work, room, rng, signal.SIGINT))
        for _ in range(min(most, int(rng.integers(1, self.most_kills + 1)))):
            end = self._killed(work, room, rng)
            if not end.killed:
                succeeded(end)
                work.check_done()
                break
            kills += 1
            work.check_killed()
        succeeded(Victim(self.run_of(work.arguments), folder, room / "said").ended())
        work.check_done()
        return kills

    def _killed(self, work: Work, room: Path, rng: np.random.Generator, by: int = signal.SIGKILL) -> Ended:
        """Run it until a random moment: by the clock, at a write, or in a new interpreter."""
        if by == signal.SIGKILL and rng.integers(ANEW) == 0:
            return Victim.anew(work.arguments, room / "said").killed_after(rng.uniform(0, self.seconds_anew))
        run, said = self.run_of(work.arguments), room / "said"
        if rng.random() < 0.5:
            return Victim(run, work.folder, said).killed_after(rng.uniform(0, self.seconds), by)
        at = AtWrite(int(rng.integers(self.writes)), rng.choice([0.0, rng.uniform(0, LATE)]), by)
        return Victim(run, work.folder, said, at).ended()


def fresh(folder: Path) -> Path:
    """Make an empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def succeeded(end: Ended) -> Ended:
    """Assert that a process ended well."""
    assert end.status == 0, f"exit status {end.status}\n{end.said}"
    assert "Traceback" not in end.said, end.said
    return end


def _rows(table: bytes) -> list[dict[str, str]]:
    rows = list(csv.DictReader(table.decode().splitlines()))
    return [{key: value for key, value in row.items() if key != "seconds"} for row in rows]


def _frames(video: bytes) -> np.ndarray:
    """Decode a video, (n, h, w, 3) float32; no frames if it is not whole."""
    from liaam.errors import VideoError
    from liaam.io import VideoReader

    with tempfile.NamedTemporaryFile(suffix=".mp4") as file:
        file.write(video)
        file.flush()
        try:
            with VideoReader(file.name) as reader:
                return np.array([frame.image for frame in reader], np.float32)
        except VideoError:
            return np.empty((0, 0, 0, 3), np.float32)


def _mean_differences(frames: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Mean absolute difference of each frame, grey levels, (n,)."""
    return np.abs(frames - expected).reshape(len(frames), -1).mean(axis=1) if len(frames) else np.array([np.inf])


def _without(text: bytes, key: str) -> Any:
    return {name: value for name, value in json.loads(text).items() if name != key}


def _train(world: World, folder: Path) -> list[str]:
    options = ("--diagonal", "40", "--no-leave-out", "--copies", "0", "--methods", "grey")
    return ["train", str(world.pictures), "-o", str(folder / "m.liaam"), *options]


def _batch(world: World, folder: Path) -> list[str]:
    options = ("--init", world.start, "--method", "grey", "--jobs", "2")
    return ["batch", str(world.model), str(world.pictures), "-o", str(folder / "r.csv"), *options]


def _track(world: World, folder: Path) -> list[str]:
    outputs = ("-o", str(folder / "t.csv"), "--video", str(folder / "t.mp4"))
    return ["track", str(world.model), str(world.video), *outputs, "--init", world.start, "--method", "grey"]


def kinds() -> tuple[Kind, ...]:
    """All kinds of commands."""
    return (
        Kind("train", Work, _train, ("m.liaam",), older=("m.liaam",)),
        Kind("batch", Batch, _batch, ("r.csv", "r.csv.json"), most_kills=1),  # an image that meets two is given up
        Kind("track", Track, _track, ("t.csv", "t.mp4")),
    )
