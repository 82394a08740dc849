"""A real server and a real browser, and pictures with known landmarks to show them."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from forked_server import start_forked
from people import NAMES, TIMEOUT
from shared_browser import SHARED

from benchmarks.studio import Server, lacking
from liaam.io import Landmarks, write_image, write_landmarks
from liaam.training import train
from scenes import DIFFUSE, Head, Scene, lateral, make_set, random_expression, random_pose, render

SLOWDOWN = float(os.environ.get("LIAAM_SLOWDOWN", "1"))
"""How much slower the page is, also to find races."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(nextitem):
    """Close the browser after the last of the tests here that follow each other, and after their fixtures."""
    yield
    if nextitem is None or nextitem.path.parent != Path(__file__).parent:
        SHARED.close()


@pytest.fixture(scope="module")
def browser():
    """Give the headless browser of all files' tests."""
    reason = lacking()
    if reason:
        pytest.skip(reason)
    return SHARED.with_flags()


@pytest.fixture(scope="session")
def artefacts(tmp_path_factory) -> Path:
    """Give the folder of the screenshots: LIAAM_ARTEFACTS, or a temporary one that is printed."""
    named = os.environ.get("LIAAM_ARTEFACTS")
    folder = Path(named) if named else tmp_path_factory.mktemp("studio-screenshots")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.fixture
def open_page(browser):
    """Give a function that opens a fresh page, which fails the test when its scripts do.

    Pages of a test share nothing: each further one, and each with options, has a context of its own.
    """
    contexts, pages, faults = [], [], []

    def open_page(width: int = 1280, height: int = 720, **options):
        if pages or options:
            contexts.append(browser.new_context(viewport={"width": width, "height": height}, **options))
            page = contexts[-1].new_page()
        else:
            page = SHARED.new_page()
            page.set_viewport_size({"width": width, "height": height})
        pages.append(page)
        page.on("pageerror", lambda fault: faults.append(str(fault)))
        page.set_default_timeout(TIMEOUT)
        if SLOWDOWN > 1:
            session = page.context.new_cdp_session(page)
            session.send("Emulation.setCPUThrottlingRate", {"rate": SLOWDOWN})
        return page

    yield open_page
    for context in contexts:
        context.close()
    SHARED.clear()
    assert not faults, f"scripts of the page failed: {faults}"


@pytest.fixture
def page(open_page):
    """Give a fresh page of 1280×720."""
    return open_page()


@pytest.fixture
def serve(tmp_path) -> Iterator[Callable[..., Server]]:
    """Give a function that starts ``liaam studio FOLDER ...``, by default without the face model, and waits for it."""
    running = []

    def serve(folder: Path, *arguments: str, face: bool = False) -> Server:
        arguments = arguments if face else (*arguments, "--no-face")
        log = tmp_path / f"studio-{len(running)}.log"
        try:
            running.append(start_forked(folder, *arguments, errors=log, state=tmp_path / "state"))
        except RuntimeError as fault:
            pytest.fail(f"{fault} {log.read_text()}")
        return running[-1]

    yield serve
    for server in running:
        server.kill()


@pytest.fixture(scope="session")
def portraits() -> list[Scene]:
    """Give twelve pictures of one head, as an ordinary camera sees it."""
    return make_set(12, Head(5), DIFFUSE, seed=3, size=(320, 240))


@pytest.fixture(scope="session")
def portrait_model(trained_once, portraits, tmp_path_factory) -> Path:
    """Give a model of the portraits."""
    path = tmp_path_factory.mktemp("model") / "portraits.liaam"
    shown = [(scene.image, scene.landmarks) for scene in portraits[:8]]
    trained_once("portraits", lambda: train(shown, methods="all")).save(path)
    return path


@pytest.fixture(scope="session")
def lit_portrait() -> Scene:
    """Give the same head under hard light from the side, 640×480."""
    import numpy as np

    rng = np.random.default_rng(77)
    return render(Head(5), random_pose(rng, (480, 640)), random_expression(rng), lateral("left"), size=(480, 640))


def written(root: Path, portraits: list[Scene]) -> Path:
    """Write pictures to a new folder, without any landmarks."""
    root.mkdir()
    for i, scene in enumerate(portraits):
        write_image(root / f"portrait-{i + 1:02d}.png", scene.image)
    return root


@pytest.fixture
def folder(portraits, tmp_path) -> Path:
    """Give a new folder of three of those pictures: a model is fitted to all that are in a folder."""
    return written(tmp_path / "portraits", portraits[: len(NAMES)])


@pytest.fixture
def whole_folder(portraits, tmp_path) -> Path:
    """Give a new folder of all of those pictures."""
    return written(tmp_path / "all-portraits", portraits)


@pytest.fixture
def marked(tmp_path, portraits) -> Path:
    """Give a folder of three pictures with five points each."""
    root = tmp_path / "one" / "faces"
    root.mkdir(parents=True)
    for name, scene in zip(NAMES, portraits, strict=False):
        write_image(root / name, scene.image)
        write_landmarks((root / name).with_suffix(".ljson"), Landmarks(scene.landmarks[[0, 6, 12, 33, 49]]))
    return root


@pytest.fixture
def five_marked(marked) -> Path:
    """Give that folder with copies of two of its pictures: enough to train on."""
    for name, copied in zip(NAMES, ("portrait-04.png", "portrait-05.png"), strict=False):
        shutil.copy(marked / name, marked / copied)
        shutil.copy((marked / name).with_suffix(".ljson"), (marked / copied).with_suffix(".ljson"))
    return marked
