"""A real server and a real browser, and pictures with known landmarks to show them."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from liaam.datasets.scenes import DIFFUSE, Head, Scene, lateral, make_set, random_expression, random_pose, render
from liaam.io import write_image

CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
CHROMIUM_FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]
PORT_LINE = re.compile(r"http://127\.0\.0\.1:(\d+)/\?token=\S+")


def chromium() -> str:
    """Path of a Chromium, or skip."""
    named = os.environ.get("LIAAM_CHROMIUM")
    found = named or next(filter(None, map(shutil.which, CHROMIUM_NAMES)), None)
    if not found:
        pytest.skip("there is no Chromium on this machine (install one, or name it in LIAAM_CHROMIUM)")
    return found


@pytest.fixture(scope="module")
def browser():
    """Give one headless browser for a file's tests: while Playwright runs, no other test can have an event loop."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install '.[test]'")
    executable = chromium()
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=executable, args=CHROMIUM_FLAGS)
        yield found
        found.close()


@pytest.fixture(scope="session")
def artefacts(tmp_path_factory) -> Path:
    """Give the folder of the screenshots: LIAAM_ARTEFACTS, or a temporary one that is printed."""
    named = os.environ.get("LIAAM_ARTEFACTS")
    folder = Path(named) if named else tmp_path_factory.mktemp("studio-screenshots")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.fixture
def page(browser):
    """Give a fresh page of 1280×720 that fails the test when its scripts do."""
    context = browser.new_context(viewport={"width": 1280, "height": 720}, accept_downloads=True)
    opened, faults = context.new_page(), []
    opened.on("pageerror", lambda fault: faults.append(str(fault)))
    opened.set_default_timeout(20_000)
    yield opened
    context.close()
    assert not faults, f"scripts of the page failed: {faults}"


@dataclass
class Server:
    """A ``liaam studio`` of its own process."""

    process: subprocess.Popen
    address: str

    def kill(self) -> None:
        """End it as a power cut would."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


@pytest.fixture
def serve(tmp_path) -> Iterator[Callable[..., Server]]:
    """Give a function that starts ``liaam studio FOLDER ...`` and waits for its address."""
    running = []

    def start(folder: Path, *arguments: str) -> Server:
        log = (tmp_path / f"studio-{len(running)}.log").open("w")
        command = [sys.executable, "-m", "liaam", "studio", str(folder), "--no-browser", *arguments]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=log, text=True, env={**os.environ, "COLUMNS": "300"}
        )
        running.append(process)
        assert process.stdout
        seen = []
        for line in process.stdout:
            seen.append(line)
            address = PORT_LINE.search(line)
            if address:
                return Server(process, address.group())
        pytest.fail(f"the studio did not start: {seen} {Path(log.name).read_text()}")

    yield start
    for process in running:
        process.kill()
        process.wait()


@pytest.fixture(scope="session")
def portraits() -> list[Scene]:
    """Give twelve pictures of one head, as an ordinary camera sees it."""
    return make_set(12, Head(5), DIFFUSE, seed=3, size=(320, 240))


@pytest.fixture(scope="session")
def lit_portrait() -> Scene:
    """Give the same head under hard light from the side, 640×480."""
    import numpy as np

    rng = np.random.default_rng(77)
    return render(Head(5), random_pose(rng, (480, 640)), random_expression(rng), lateral("left"), size=(480, 640))


@pytest.fixture
def folder(portraits, tmp_path) -> Path:
    """Give a new folder of those pictures, without any landmarks."""
    root = tmp_path / "portraits"
    root.mkdir()
    for i, scene in enumerate(portraits):
        write_image(root / f"portrait-{i + 1:02d}.png", scene.image)
    return root
