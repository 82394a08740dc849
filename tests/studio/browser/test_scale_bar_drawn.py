"""A scale bar drawn on the picture: two clicks along a ruler, and a length with its unit."""

import shutil

import numpy as np
import pytest
from people import (
    NAMES,
    annotate,
    client,
    drag,
    drop,
    open_picture,
    opened,
    saved,
    shoot,
    untrained,
    violations,
    wait_for,
    wait_until,
)

from liaam.io import read_landmarks, write_image
from scenes.ruler import draw as draw_ruler

pytestmark = pytest.mark.slow

ENDS = [[60.0, 130.0], [220.0, 130.0]]


def draw(page, length, unit, press):
    """Draw a bar along ENDS, and enter its length."""
    page.locator("[data-testid=scale-bar]").click()
    assert "one end" in page.locator(".annotate-prompt").inner_text()
    press(*client(page, ENDS[0]))
    wait_for(page, "() => document.querySelector('.annotate-prompt').textContent.includes('other end')")
    press(*client(page, ENDS[1]))
    page.locator("[data-testid=scale-length]").fill(length)
    page.locator("[data-testid=scale-unit]").select_option(unit)


def at_first_picture(marked, serve, open_page, size):
    """Open the first picture; return the page and what presses a position on it."""
    touch = size[0] < 1280
    page = open_page(*size, has_touch=touch)
    page.goto(serve(marked).address)
    opened(page, "portrait-01.png")
    return page, page.touchscreen.tap if touch else page.mouse.click


def scale_of(root, name):
    return read_landmarks((root / name).with_suffix(".ljson")).scale


@pytest.mark.parametrize("size", [(1280, 720), (820, 1180), (390, 844)], ids=str)
def test_a_scale_bar_is_drawn_undone_changed_and_exported(marked, serve, open_page, artefacts, size):
    page, press = at_first_picture(marked, serve, open_page, size)
    points = annotate(page, "points()")

    draw(page, "2", "cm", press)
    assert violations(page) == {}
    shoot(page, artefacts, f"scale-bar-{size[0]}-dialog")
    page.locator("[data-testid=scale-save]").click()
    wait_for(page, "() => window.liaamStudio.annotate.bar()?.unit === 'cm'")
    bar = annotate(page, "bar()")
    assert abs(bar["ends"][1][0] - bar["ends"][0][0] - 160) < 2
    saved(page)
    assert scale_of(marked, "portrait-01.png") == pytest.approx(20 / 160, rel=0.02)
    assert annotate(page, "points()") == points  # no point was placed or moved
    shoot(page, artefacts, f"scale-bar-{size[0]}")
    assert violations(page) == {}

    page.locator("[data-testid=undo]").click()
    wait_for(page, "() => window.liaamStudio.annotate.bar() === null")
    saved(page)
    assert scale_of(marked, "portrait-01.png") is None
    page.keyboard.press("Control+y")
    saved(page)
    page.reload()
    opened(page, "portrait-01.png")
    assert annotate(page, "bar()") == bar

    page.locator("[data-testid=scale-bar]").click()  # another length
    assert page.locator("[data-testid=scale-length]").input_value() == "2"
    page.locator("[data-testid=scale-length]").fill("40")
    page.locator("[data-testid=scale-unit]").select_option("mm")
    page.locator("[data-testid=scale-save]").click()
    wait_until(page, lambda: scale_of(marked, "portrait-01.png") == pytest.approx(40 / 160, rel=0.02))

    with page.expect_download() as waited:
        page.locator("[data-testid=export-all]").select_option("tps")
    tps = waited.value.path().read_text()
    assert tps.count("SCALE=0.2") == 1
    page.locator("[data-testid=export-all]").select_option("measure")
    with page.expect_download() as waited:
        page.locator("[data-testid=measure-save]").select_option("csv")
    assert "scale" in waited.value.path().read_text().splitlines()[0]
    page.locator("[data-testid=tab-annotate]").click()

    page.locator("[data-testid=scale-bar]").click()
    page.locator("[data-testid=scale-remove]").click()
    wait_until(page, lambda: scale_of(marked, "portrait-01.png") is None)


@pytest.mark.parametrize("size", [(1280, 720), (390, 844)], ids=str)
def test_one_scale_for_all_pictures_and_its_undo(marked, serve, open_page, artefacts, size):
    page, press = at_first_picture(marked, serve, open_page, size)
    draw(page, "2", "cm", press)
    shoot(page, artefacts, f"scale-share-{size[0]}-dialog")
    # A training ends meanwhile, so that the marks of the picture are fetched again: what is typed is not lost.
    with page.expect_response("**/portrait-01.png/landmarks"):
        page.evaluate(
            """() => {
              const { state } = window.liaamStudio;
              state.picture().uncertainty = 0.1;
              state.dispatchEvent(new Event("project"));
            }"""
        )
    page.wait_for_timeout(100)
    page.locator("[data-testid=scale-share]").click()
    page.get_by_text("Scale set in 2 further pictures.").wait_for()
    shoot(page, artefacts, f"scale-share-{size[0]}")
    assert violations(page) == {}
    scales = [scale_of(marked, name) for name in NAMES]
    assert scales == [pytest.approx(20 / 160, rel=0.02)] * 3
    with page.expect_download() as waited:
        page.locator("[data-testid=export-all]").select_option("tps")
    assert waited.value.path().read_text().count("SCALE=0.12") == 3

    page.locator("[data-testid=toast-action]").click()  # Undo
    wait_until(page, lambda: all(scale_of(marked, name) is None for name in NAMES))  # one action has one undo
    page.get_by_text("Scale of 2 further pictures as before.").wait_for()
    assert annotate(page, "bar()") is None
    for key, length in (("y", 0.125), ("z", None), ("y", 0.125)):
        page.keyboard.press(f"Control+{key}")
        expected = None if length is None else pytest.approx(length, rel=0.02)
        wait_until(page, lambda expected=expected: all(scale_of(marked, name) == expected for name in NAMES))
    page.get_by_text("Scale set in 2 further pictures.").wait_for()
    open_picture(page, NAMES[1])
    page.locator("[data-testid=toast-action]").last.click()  # takes it back from another picture, too
    wait_until(page, lambda: all(scale_of(marked, name) is None for name in NAMES))
    open_picture(page, NAMES[0])
    page.locator("[data-testid=redo]").click()
    wait_until(page, lambda: all(scale_of(marked, name) is not None for name in NAMES))
    open_picture(page, NAMES[1])
    wait_for(page, "() => window.liaamStudio.annotate.bar()?.length === 2")
    page.keyboard.press("Tab")
    page.keyboard.press("ArrowRight")  # a point is moved, and the scale stays
    saved(page)
    assert scale_of(marked, NAMES[1]) == pytest.approx(20 / 160, rel=0.02)


def test_new_pictures_are_offered_the_scale_of_the_others(marked, serve, page, tmp_path):
    untrained(page)
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    draw(page, "2", "cm", page.mouse.click)
    page.locator("[data-testid=scale-share]").click()
    page.get_by_text("Scale set in 2 further pictures.").wait_for()
    drop(page, shutil.copy(marked / NAMES[0], tmp_path / "new.png"))
    told = page.locator(".toast", has_text="One has no scale, and all others have the same.")
    told.get_by_text("Use that scale").click()
    page.get_by_text("Scale set in 1 further picture.").wait_for()
    open_picture(page, "new.png")
    wait_for(page, "() => window.liaamStudio.annotate.bar()?.length === 2")


def test_a_length_that_makes_no_sense_is_not_taken(marked, serve, page, artefacts):
    page.goto(serve(marked).address)
    opened(page, "portrait-01.png")
    draw(page, "10", "mm", page.mouse.click)
    length, dialog = page.locator("[data-testid=scale-length]"), page.locator("dialog[open]")
    for typed in ("", "0", "-3", "1e9", "1e999", "abc", "1e-9", "1,250", "1.000,5"):
        length.fill("")
        length.press_sequentially(typed)
        for button in ("scale-save", "scale-share"):
            page.locator(f"[data-testid={button}]").click()
            assert dialog.is_visible(), typed
            assert not length.evaluate("field => field.checkValidity()")
    shoot(page, artefacts, "scale-wrong-length")
    assert annotate(page, "bar()") is None
    length.fill("")
    length.press_sequentially("2,5")  # with a decimal comma
    page.locator("[data-testid=scale-save]").click()
    wait_for(page, "() => window.liaamStudio.annotate.bar()?.length === 2.5")


def test_a_bar_without_length_waits_for_its_other_end(marked, serve, page):
    page.goto(serve(marked).address)
    opened(page, "portrait-01.png")
    page.locator("[data-testid=scale-bar]").click()
    for _ in range(2):
        page.mouse.click(*client(page, ENDS[0]))
    assert page.locator("dialog[open]").count() == 0
    assert "other end" in page.locator(".annotate-prompt").inner_text()
    page.mouse.click(*client(page, ENDS[1]))
    page.locator("[data-testid=scale-length]").wait_for()
    page.keyboard.press("Escape")

    page.locator("[data-testid=scale-bar]").click()  # or draw it in one drag
    drag(page, client(page, ENDS[1]), client(page, ENDS[0]))
    page.locator("[data-testid=scale-length]").fill("4")
    page.keyboard.press("Enter")
    wait_for(page, "() => window.liaamStudio.annotate.bar()?.length === 4")
    assert np.abs(np.array(annotate(page, "bar()")["ends"]) - ENDS[::-1]).max() < 1.5


def test_escape_ends_drawing_and_the_bar_of_a_picture_is_its_own(marked, serve, page):
    server = serve(marked)
    page.goto(server.address)
    opened(page, "portrait-01.png")
    page.locator("[data-testid=scale-bar]").click()
    page.mouse.click(*client(page, ENDS[0]))
    page.keyboard.press("Escape")
    assert page.locator("[data-testid=scale-bar]").get_attribute("aria-pressed") == "false"
    assert annotate(page, "bar()") is None
    draw(page, "5", "mm", page.mouse.click)
    page.locator("[data-testid=scale-save]").click()
    saved(page)
    page.keyboard.press("s")  # the dialog of the bar that is there
    page.locator("[data-testid=scale-length]").wait_for()
    page.keyboard.press("Escape")
    page.locator("[data-testid=scale-bar]").click()
    page.get_by_role("button", name="Draw again").click()
    open_picture(page, "portrait-02.png")
    assert page.locator("[data-testid=scale-bar]").get_attribute("aria-pressed") == "false"
    assert annotate(page, "bar()") is None
    open_picture(page, "portrait-01.png")
    assert annotate(page, "bar()")["length"] == 5


def test_the_scale_is_found_in_the_picture(marked, serve, open_page, artefacts, rng):
    image = draw_ruler("hierarchical", rng, size=9.0, angle=5.0).image
    write_image(marked / "portrait-01.png", image)
    page, _ = at_first_picture(marked, serve, open_page, (1280, 720))
    page.locator("[data-testid=scale-bar]").click()
    page.locator("[data-testid=scale-find]").click()
    page.locator("[data-testid=find-kind]").select_option("ruler")
    page.locator("[data-testid=find-length]").fill("1")
    page.locator("[data-testid=find-go]").click()
    text = page.locator("[data-testid=found-scale]").inner_text()
    assert "ticks: 0.111" in text and "mm per pixel" in text
    assert violations(page) == {}
    shoot(page, artefacts, "scale-found")
    page.locator("[data-testid=found-use]").click()
    wait_for(page, "() => window.liaamStudio.annotate.bar()?.unit === 'mm'")
    saved(page)
    assert scale_of(marked, "portrait-01.png") == pytest.approx(1 / 9, rel=1e-3)

    page.locator("[data-testid=scale-bar]").click()  # now there is one: look for another kind
    page.locator("[data-testid=scale-find-again]").click()
    page.locator("[data-testid=find-kind]").select_option("bar")
    page.locator("[data-testid=find-go]").click()
    page.get_by_text("or else click both ends of a known length").wait_for()
    assert scale_of(marked, "portrait-01.png") == pytest.approx(1 / 9, rel=1e-3)
