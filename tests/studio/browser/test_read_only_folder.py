"""A folder that can only be read: its pictures are looked at, fitted, relit and measured."""

import os
import threading

import pytest
from people import NAMES, annotate, client, open_picture, opened, points_of, shoot, wait_for

from liaam.studio.app import Studio
from liaam.studio.serving import make_server, open_port
from liaam.studio.settings import StudioSettings
from liaam.training import train

pytestmark = pytest.mark.slow


@pytest.fixture
def protected(marked, portraits, tmp_path, monkeypatch):
    """Give the address of a studio on a folder in which nothing can be written, with a model."""
    path = tmp_path / "five.liaam"
    shown = [(scene.image, scene.landmarks[[0, 6, 12, 33, 49]]) for scene in portraits[:4]]  # too few for a regressor
    train(shown, lamps=None).save(path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "home"))
    may_access = os.access
    monkeypatch.setattr(
        os, "access", lambda place, mode: not str(place).startswith(str(marked)) and may_access(place, mode)
    )
    listener = open_port("127.0.0.1", 0)
    studio = Studio(marked, path, StudioSettings(port=listener.getsockname()[1]))
    server = make_server(studio)
    thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
    thread.start()
    studio.background.start()
    yield studio.settings.address
    server.should_exit = True
    thread.join(60)
    studio.close()


def test_pictures_are_shown_fitted_and_measured_and_nothing_is_written(protected, page, marked, artefacts):
    (marked / NAMES[2]).with_suffix(".ljson").unlink()
    before = {path: path.stat().st_mtime_ns for path in marked.rglob("*")}
    page.goto(protected)
    opened(page, NAMES[2])  # the first that is not done
    open_picture(page, NAMES[0])
    assert page.locator("[data-testid=read-only]").is_visible()
    points = points_of(page)
    x, y = client(page, 0)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y, steps=3)
    page.mouse.up()
    page.keyboard.press("Delete")
    assert (points_of(page) == points).all() and annotate(page, "undoSteps()") == 0
    shoot(page, artefacts, "read-only-1280")
    page.keyboard.press("Enter")
    opened(page, NAMES[2])
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'proposal'")
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit")
    page.locator("[data-testid=layer-relit]").click()
    wait_for(page, "() => window.liaamStudio.fit.hasLayer && !window.liaamStudio.fit.relightBusy")
    page.locator("[data-testid=tab-measure]").click()
    page.locator("[data-testid=measure-table]").wait_for()
    assert {path: path.stat().st_mtime_ns for path in marked.rglob("*")} == before
