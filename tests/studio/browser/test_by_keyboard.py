"""From a folder of pictures to the exported file without a pointer."""

from pathlib import Path

import numpy as np
import pytest
from people import annotate, opened, points_of, saved, wait_for, wait_for_state

from liaam.io import read_landmarks, write_image

pytestmark = pytest.mark.slow

FOCUSED = "() => document.activeElement?.dataset?.testid ?? document.activeElement?.tagName"
N_POINTS = 4


def tab_to(page, testid: str) -> None:
    """Press Tab until a control has the focus."""
    seen = []
    for _ in range(150):
        if page.evaluate(FOCUSED) == testid:
            return
        page.keyboard.press("Tab")
        seen.append(page.evaluate(FOCUSED))
    raise AssertionError(f"Tab does not come to {testid}, but to {dict.fromkeys(seen)}")


def press(page, *keys: str) -> None:
    for key in keys:
        page.keyboard.press(key)


@pytest.fixture
def three(tmp_path, portraits) -> Path:
    """Give a folder of three pictures without points."""
    root = tmp_path / "three"
    root.mkdir()
    for i, scene in enumerate(portraits[:3]):
        write_image(root / f"p{i + 1}.png", scene.image)
    return root


def test_points_are_defined_placed_and_exported_by_keys_only(serve, page, three):
    page.goto(serve(three).address)
    wait_for(page, "() => window.liaamStudio?.annotate?.source() === 'template'")
    moves = [("Shift+ArrowLeft",) * 3, ("Shift+ArrowRight",) * 3, ("Shift+ArrowUp",) * 3, ("Shift+ArrowDown",) * 3]
    for keys in moves:
        press(page, "p", *keys)
    tab_to(page, "template-done")
    press(page, "Enter")
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'file'")
    saved(page)
    first = points_of(page)
    assert len(first) == N_POINTS and np.ptp(first, axis=0) == pytest.approx([60, 60])

    press(page, "]")
    for name in ("p2.png", "p3.png"):  # Enter opens the next
        opened(page, name)
        wait_for(page, "() => window.liaamStudio.annotate.source() === 'layout'")
        press(page, "ArrowRight", "ArrowDown")  # the whole shape
        wait_for(page, "() => window.liaamStudio.annotate.source() === 'file'")
        saved(page)
        wait_for_state(page, name, "partial")  # nobody has said that the points are right
        assert annotate(page, "name()") == name
        press(page, "Enter")
        wait_for_state(page, name, "done")

    press(page, "Escape")  # Tab leaves the picture
    tab_to(page, "export-all")
    with page.expect_download() as download:
        press(page, "ArrowDown", "ArrowDown", "ArrowDown", "ArrowDown", "Enter")
    assert download.value.suggested_filename == "three.tps"
    download.value.save_as(three / "three.tps")
    assert len(read_landmarks(three / "p3.ljson").points) == N_POINTS
    assert "IMAGE=p2.png" in (three / "three.tps").read_text()


def test_a_key_opens_a_closed_menu_and_does_nothing_by_itself(serve, page, marked):
    page.goto(serve(marked).address)
    opened(page, "portrait-01.png")
    asked = []
    page.on("request", lambda request: asked.append(request.url) if "/export/" in request.url else None)
    for key in ("ArrowDown", "PageDown", "t"):  # in a plain list, these choose an action at once
        page.locator("[data-testid=export-all]").focus()
        press(page, key)
        page.wait_for_timeout(200)
        press(page, "Escape")
    assert asked == []
