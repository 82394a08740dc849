"""Projects on generated scenes, and a studio that listens on a real port."""

import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from contract_checks import faults, sent
from small_projects import TRIANGLE, browser_of

from liaam.io import Contour, Landmarks, write_image, write_landmarks
from liaam.model.shape import Similarity, rotation
from liaam.studio import contract
from liaam.studio.app import Studio
from liaam.studio.project import Project
from liaam.studio.routes import Events
from liaam.studio.serving import make_server, open_port
from liaam.studio.settings import StudioSettings
from scenes import Head, Scene, make_set
from setups import BODY, TexturedObject

CONTOURS = (Contour(tuple(range(13))), Contour(tuple(range(21, 29)), closed=True))


@pytest.fixture(scope="session")
def portraits() -> list[Scene]:
    """Give eight pictures of one person."""
    return portraits_of(8)


def portraits_of(n: int) -> list[Scene]:
    """Take pictures that other tests show, too: they are rendered once for all."""
    return make_set(n, Head(5), size=(160, 120))


@pytest.fixture(scope="session")
def pictures(tmp_path_factory) -> Callable[[int], Path]:
    """Give a folder of at least so many pictures, p1.png and so on, with a landmark file, .ljson, for each."""
    folder = tmp_path_factory.mktemp("portraits")

    def get(n: int) -> Path:
        if n and not (folder / f"p{n}.png").exists():
            for i, scene in enumerate(portraits_of(n), 1):
                write_image(folder / f"p{i}.png", scene.image)
                write_landmarks(folder / f"p{i}.ljson", Landmarks(scene.landmarks, CONTOURS))
        return folder

    return get


@pytest.fixture(scope="session")
def pictures_of_objects(tmp_path_factory) -> Callable[[int], Path]:
    """Give a like folder of up to eight pictures of an object with eight landmarks.

    Training on them takes a third of the time of training on faces, which are lit by lamps.
    """
    folder = tmp_path_factory.mktemp("objects")
    rng = np.random.default_rng(8)
    thing = TexturedObject(rng, (110, 80))
    for i in range(1, 9):
        placed = Similarity(rng.normal(0.9, 0.03) * rotation(rng.normal(0.0, 0.1)), np.array([55.0, 40.0]))
        image, points = thing.photograph(placed(BODY - BODY.mean(axis=0) + rng.normal(0.0, 1.0, BODY.shape)), rng)
        write_image(folder / f"p{i}.png", image)
        write_landmarks(folder / f"p{i}.ljson", Landmarks(points, (Contour(tuple(range(6)), closed=True),)))
    return lambda _: folder


@pytest.fixture
def folder(pictures, tmp_path) -> Callable[..., Path]:
    """Make a project's folder: so many pictures, of which the first few have landmarks."""
    return partial(make_folder, tmp_path, pictures)


@pytest.fixture
def folder_of_objects(pictures_of_objects, tmp_path) -> Callable[..., Path]:
    """Make a folder as ``folder`` does, of objects on which training is quick."""
    return partial(make_folder, tmp_path, pictures_of_objects)


def make_folder(where: Path, pictures: Callable[[int], Path], n: int = 3, done: int = 0) -> Path:
    made = where / "parent" / "project"
    made.mkdir(parents=True)
    for i in range(1, n + 1):
        shutil.copy(pictures(n) / f"p{i}.png", made)
        if i <= done:
            shutil.copy(pictures(n) / f"p{i}.ljson", made)
    return made


@pytest.fixture
def small(tmp_path) -> Project:
    """Give a folder of four small pictures, and a template of three points."""
    folder = tmp_path / "parent" / "small"
    folder.mkdir(parents=True)
    for name in ("p1.png", "p2.png", "p10.png", "q.jpg"):
        write_image(folder / name, np.full((30, 40, 3), 90, np.uint8))
    project = Project(folder)
    project.save_template(TRIANGLE)
    return project


@dataclass(frozen=True)
class Running:
    """A studio on a port."""

    studio: Studio
    server: object
    thread: threading.Thread
    client: httpx.Client
    """Knows the token."""

    @property
    def port(self) -> int:
        return self.studio.settings.port

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def stop(self) -> None:
        self.server.should_exit = True
        self.thread.join(60)
        assert not self.thread.is_alive()


@pytest.fixture
def serve(monkeypatch) -> Iterator[Callable[..., Running]]:
    """Serve a folder as ``liaam studio`` does, in a thread; stopped at the end. Events have to keep the contract."""
    running: list[Running] = []
    wrong: list[str] = []
    publish = Events.publish

    def publish_and_check(self: Events, kind: str, data: Any) -> None:
        wrong.extend(faults(sent(data), contract.EVENTS[kind], kind))
        publish(self, kind, data)

    monkeypatch.setattr(Events, "publish", publish_and_check)

    def start(folder: Path, model: Path | None = None, **settings) -> Running:
        listener = open_port("127.0.0.1", 0)
        studio = Studio(folder, model, StudioSettings(port=listener.getsockname()[1], **settings))
        server = make_server(studio)
        thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
        thread.start()
        url = f"http://127.0.0.1:{studio.settings.port}"
        client = browser_of(url, headers={"authorization": f"Bearer {studio.settings.token}"})
        running.append(Running(studio, server, thread, client))
        return running[-1]

    yield start
    for one in running:
        one.client.close()
        one.stop()
        one.studio.close()
    assert wrong == []


@pytest.fixture(autouse=True, scope="session")
def state_folder(tmp_path_factory) -> Iterator[None]:
    """Keep tokens of studios that tests start out of the user's state folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
