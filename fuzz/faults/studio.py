"""A studio that is killed between saves, and what it has to show once it is started again."""

from __future__ import annotations

import http.client
import json
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from fuzz.faults.commands import ANEW, World, fresh
from fuzz.faults.victim import LATE, AtWrite, Victim, of_command

NAMES = ("a", "b", "c", "d", "e")
FILES = {"p1": ".ljson", "p2": ".ljson", "p3": ".pts", "p4": ".pts"}
"""Pictures, and how their landmarks are kept."""

SAVES = 40
"""Saves of an undisturbed run, which ends then."""

TURNS = 10
"""One request of so many puts the template's points in another order."""

IN_A_ROW = 8
"""Kills of one studio's folder."""


@dataclass(frozen=True)
class Marks:
    """Landmarks of a picture, as they are sent."""

    points: tuple[tuple[float, float] | None, ...]
    invisible: tuple[int, ...]


@dataclass(frozen=True)
class Shown:
    """All that a studio has to show."""

    names: tuple[str, ...]
    marks: dict[str, Marks]

    def turned(self, mapping: list[int]) -> Shown:
        """What is shown after the points were put in another order."""

        def turn(marks: Marks) -> Marks:
            hidden = tuple(i for i, source in enumerate(mapping) if source in marks.invisible)
            return Marks(tuple(marks.points[i] for i in mapping), hidden)

        return Shown(tuple(self.names[i] for i in mapping), {name: turn(marks) for name, marks in self.marks.items()})


class Client:
    """A page: asks a studio, and says what is wrong with its answers."""

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self._connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=30)
        self._headers = {"authorization": f"Bearer {parse_qs(parts.query)['token'][0]}"}

    def ask(self, method: str, path: str, data: Any = None) -> Any:
        """Ask; gives the answer, which has to be one of success."""
        body = None if data is None else json.dumps(data)
        self._connection.request(method, path, body, {**self._headers, "content-type": "application/json"})
        answer = self._connection.getresponse()
        content = json.loads(answer.read())
        assert answer.status == 200, f"{method} {path}: {answer.status} {content}"
        return content

    def landmarks(self, name: str) -> dict[str, Any]:
        """Landmarks of a picture."""
        return self.ask("GET", f"/api/pictures/{name}.png/landmarks")

    def shown(self) -> Shown:
        """All that the studio shows."""
        template = self.ask("GET", "/api/project")["template"]
        answers = {name: self.landmarks(name) for name in FILES}
        return Shown(tuple(template["names"]), {name: _marks(answer) for name, answer in answers.items()})


def _marks(answer: dict[str, Any]) -> Marks:
    points = tuple(None if point is None else tuple(point) for point in answer["points"])
    return Marks(points, tuple(answer["invisible"]))


class Saving:
    """Saves at random, and what has to be there since."""

    def __init__(self, rng: np.random.Generator, shown: Shown) -> None:
        self._rng, self.shown = rng, shown
        self.next: Shown | None = None
        """What may be there too: a request that was not answered has asked for it."""

    def save(self, client: Client, n: int) -> None:
        """Save so many times, or until the studio is gone."""
        for _ in range(n):
            self._turn(client) if self._rng.integers(TURNS) == 0 else self._save(client)

    def _save(self, client: Client) -> None:
        name = str(self._rng.choice(list(FILES)))
        places = np.round(self._rng.uniform(1, 100, (len(NAMES), 2)), 2).tolist()
        points: list[tuple[float, float] | None] = [(x, y) for x, y in places]
        if FILES[name] == ".ljson" and self._rng.random() < 0.5:
            points[0] = None
        placed = [i for i, point in enumerate(points) if point is not None]
        marks = Marks(tuple(points), tuple(sorted(int(i) for i in self._rng.choice(placed, 2, replace=False))))
        before = client.landmarks(name)
        self.next = replace(self.shown, marks={**self.shown.marks, name: marks})
        data = {"points": marks.points, "invisible": marks.invisible, "revision": before["revision"]}
        client.ask("PUT", f"/api/pictures/{name}.png/landmarks", data)
        self._answered()

    def _turn(self, client: Client) -> None:
        mapping = [int(i) for i in self._rng.permutation(len(NAMES))]
        revision = client.ask("GET", "/api/project")["template"]["revision"]
        self.next = self.shown.turned(mapping)
        client.ask("PUT", "/api/template", {"names": self.next.names, "mapping": mapping, "revision": revision})
        self._answered()

    def _answered(self) -> None:
        assert self.next is not None
        self.shown, self.next = self.next, None

    def check(self, found: Shown) -> None:
        """Assert that all that was answered is there, and what was not is there whole or not at all."""
        assert found in (self.shown, self.next), f"saved {self.shown} or {self.next}, and there is {found}"
        self.shown, self.next = found, None


class StudioSaves:
    """Saves of a studio's page."""

    name = "studio"
    seconds_anew = 0.0

    def __init__(self) -> None:
        self.seconds, self.writes = 0.0, 0

    def measure(self, world: World, room: Path) -> None:
        """Save undisturbed: how long it takes, and how often it writes."""
        folder, writes = self._folder(world, room), room / "writes"
        writes.unlink(missing_ok=True)
        rng = np.random.default_rng(0)
        with running(Victim(of_command(_command(folder)), folder, room / "said", writes=writes)) as victim:
            client = Client(address_of(victim))
            saving, begun = Saving(rng, client.shown()), time.monotonic()
            saving.save(client, SAVES)
            self.seconds, self.writes = time.monotonic() - begun, writes.stat().st_size
            saving.check(client.shown())

    def trial(self, world: World, room: Path, rng: np.random.Generator, most: int) -> int:
        """Save in one folder, with kills in between; gives their number."""
        folder, kills = self._folder(world, room), 0
        saving: Saving | None = None
        for _ in range(min(most, IN_A_ROW)):
            with running(self._started(folder, room, rng)) as victim:
                try:
                    client = Client(address_of(victim))
                    found = client.shown()
                    saving = saving or Saving(rng, found)
                    saving.check(found)
                    with self._kill_at_some_time(victim, rng):
                        saving.save(client, 1000)
                except (OSError, http.client.HTTPException):  # it is gone
                    pass
                end = victim.ended()
            assert end.killed, f"exit status {end.status}\n{end.said}"
            assert "Traceback" not in end.said, end.said
            kills += 1
            check_files(folder)
        with running(Victim(of_command(_command(folder)), folder, room / "said")) as victim:
            found = Client(address_of(victim)).shown()
            if saving is not None:
                saving.check(found)
            left = [str(path) for path in folder.rglob(".liaam-*") if path.is_file()]
            assert not left, f"{left} are left"
        return kills

    def _started(self, folder: Path, room: Path, rng: np.random.Generator) -> Victim:
        """Start a studio, which may kill itself at a write."""
        command, said = _command(folder), room / "said"
        self._by_time = True
        if rng.integers(ANEW) == 0:
            return Victim.anew(command, said)
        self._by_time = rng.random() < 0.5
        at = AtWrite(int(rng.integers(self.writes)), rng.choice([0.0, rng.uniform(0, LATE)]))
        return Victim(of_command(command), folder, said, None if self._by_time else at)

    @contextmanager
    def _kill_at_some_time(self, victim: Victim, rng: np.random.Generator) -> Iterator[None]:
        """Kill it while this process saves, unless it does so itself."""
        if not self._by_time:
            yield
            return
        before = signal.signal(signal.SIGALRM, lambda *_: victim.kill())
        signal.setitimer(signal.ITIMER_REAL, float(rng.uniform(0.001, self.seconds)))
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)

    def _folder(self, world: World, room: Path) -> Path:
        """Give a folder of pictures, a template, and first landmarks."""
        from liaam.studio.project import Project

        folder = fresh(room / self.name)
        for name, suffix in FILES.items():
            shutil.copy(world.pictures / "face0.png", folder / f"{name}.png")
            if suffix == ".pts":
                rows = "".join(f"{i + 1} {i + 2}\n" for i in range(len(NAMES)))
                (folder / f"{name}.pts").write_text(f"version: 1\nn_points: {len(NAMES)}\n{{\n{rows}}}\n")
        Project(folder).save_template({"names": list(NAMES), "mapping": list(range(len(NAMES)))})
        return folder


def _command(folder: Path) -> list[str]:
    return ["studio", str(folder), "--no-browser", "--port", "0"]


@contextmanager
def running(victim: Victim) -> Iterator[Victim]:
    """Kill it in the end, if it is still there."""
    try:
        yield victim
    finally:
        if not victim.is_over:
            victim.kill()
            victim.ended()


def address_of(victim: Victim) -> str:
    """Wait for the address that a studio prints; OSError if it is gone before."""
    due = time.monotonic() + 60
    while time.monotonic() < due:
        for line in victim.said.splitlines(keepends=True):
            if line.startswith("liaam studio: ") and line.endswith("\n"):
                return line.split()[-1]
        if victim.wait(0.01) is not None:
            raise ConnectionError("the studio is gone")
    raise AssertionError(f"the studio does not start\n{victim.said}")


def check_files(folder: Path) -> None:
    """Assert that every file can be read."""
    from liaam.io import read_landmarks

    for path in folder.rglob("*"):
        if path.name.startswith(".liaam-") or not path.is_file():
            continue
        if path.suffix == ".json":
            json.loads(path.read_bytes())
        elif path.suffix in (".pts", ".ljson"):
            read_landmarks(path)
