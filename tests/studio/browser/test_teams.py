"""Review, actions on several pictures, export, common sets of points and subfolders, in a real browser."""

import zipfile

import numpy as np
import pytest
from people import NAMES, annotate, client, drag, opened, picture, points_of, saved, untrained, wait_for

from liaam.io import Landmarks, read_collection, write_image, write_landmarks

pytestmark = pytest.mark.slow

ITEM = "[data-testid=strip] [data-name='{}']"


def checked(page, name, who):
    wait_for(page, "([name, who]) => window.liaamStudio.state.picture(name)?.checked === who", [name, who])


def in_state(page, name, state):
    wait_for(page, "([name, state]) => window.liaamStudio.state.picture(name)?.state === state", [name, state])


@pytest.fixture
def annotating(serve, page, marked):
    """Give the page on three done pictures, with training off."""
    untrained(page)
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    return page


def test_a_picture_is_checked_and_its_history_shown(annotating):
    page = annotating
    check = page.locator("[data-testid=check]")
    check.click()
    page.keyboard.press("Enter")  # without a name, which is not asked for again
    checked(page, NAMES[0], "someone")
    check.click()
    checked(page, NAMES[0], None)
    check.click()
    checked(page, NAMES[0], "someone")
    page.get_by_role("button", name="Your name…").click()
    page.keyboard.type("Ann")
    page.keyboard.press("Enter")
    check.click()
    checked(page, NAMES[0], None)
    check.click()
    checked(page, NAMES[0], "Ann")
    assert page.locator("dialog").count() == 0
    page.locator("[data-testid=review-state]", has_text="Checked by Ann").wait_for()
    assert page.locator(ITEM.format(NAMES[0])).get_attribute("title") == f"{NAMES[0]}: checked by Ann"
    page.locator("[data-testid=strip-filter]").select_option("review")
    page.locator(ITEM.format(NAMES[0])).wait_for(state="detached")
    page.locator("[data-testid=strip-filter]").select_option("all")
    x, y = client(page, 0)
    drag(page, (x, y), (x + 12, y + 6))  # a change withdraws the check
    saved(page)
    checked(page, NAMES[0], None)
    page.locator("[data-testid=review-state]", has_text="Not checked yet").wait_for()
    page.locator("[data-testid=history] summary").click()
    page.locator("[data-testid=history] li", has_text="Ann placed points").wait_for()
    page.locator("[data-testid=history] li", has_text="Ann checked it").wait_for()
    page.locator("[data-testid=check]").click()  # the name is asked for once
    checked(page, NAMES[0], "Ann")
    page.keyboard.press("Enter")  # goes on, and does not press the button again
    page.locator(".toast", has_text="All pictures are done").wait_for()
    checked(page, NAMES[0], "Ann")


def test_actions_on_several_pictures_are_undone(annotating, marked):
    page = annotating
    page.evaluate("() => localStorage.setItem('liaam-studio:who', 'Bob')")
    before = points_of(page)
    page.locator(ITEM.format(NAMES[0])).click(modifiers=["Control"])
    page.locator(ITEM.format(NAMES[2])).click(modifiers=["Shift"])
    page.locator(".strip-bulk", has_text="3 selected").wait_for()
    action, undo = page.locator("[data-testid=bulk-action]"), page.locator("[data-testid=bulk-undo]")
    action.select_option("checked")
    for name in NAMES:
        checked(page, name, "Bob")
    undo.click()
    checked(page, NAMES[0], None)
    page.locator(ITEM.format(NAMES[2])).click()  # no longer selected
    page.locator(".strip-bulk", has_text="2 selected").wait_for()
    action.select_option("left out")
    wait_for(page, "name => window.liaamStudio.state.picture(name).left_out === 'Bob'", NAMES[1])
    assert picture(page, NAMES[2])["left_out"] is None
    action.select_option("deleted")
    page.locator("dialog", has_text="The landmarks of 2 pictures will be deleted").wait_for()
    page.locator("[data-testid=confirm]").click()
    in_state(page, NAMES[0], "new")
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'layout'")  # the page no longer shows them
    assert not (marked / NAMES[0]).with_suffix(".ljson").exists()
    undo.click()
    in_state(page, NAMES[0], "done")
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'file'")
    assert points_of(page) == pytest.approx(before, abs=0.01)
    page.locator("[data-testid=bulk-end]").click()
    page.locator(".strip-bulk").wait_for(state="hidden")


def test_the_list_selects_several_by_keys(annotating):
    page = annotating
    page.locator("[data-testid=strip]").focus()
    page.keyboard.press("Shift+ArrowDown")
    page.locator(".strip-bulk", has_text="2 selected").wait_for()
    page.keyboard.press("Control+a")
    page.locator(".strip-bulk", has_text="3 selected").wait_for()
    page.keyboard.press(" ")
    page.locator(".strip-bulk", has_text="2 selected").wait_for()
    page.keyboard.press("Escape")
    page.locator(".strip-bulk").wait_for(state="hidden")


def test_all_landmarks_are_exported(annotating, marked, tmp_path):
    for kind in ("pts", "coco"):
        with annotating.expect_download() as found:
            annotating.locator("[data-testid=export-all]").select_option(kind)
        found.value.save_as(tmp_path / found.value.suggested_filename)
    with zipfile.ZipFile(tmp_path / f"{marked.name}-pts.zip") as archive:
        assert archive.namelist() == [f"{name.removesuffix('.png')}.pts" for name in NAMES]
    assert list(read_collection(tmp_path / f"{marked.name}.json")) == NAMES


def test_a_common_set_of_points_starts_the_template(serve, page, folder):
    page.goto(serve(folder).address)
    wait_for(page, "() => window.liaamStudio?.annotate?.source() === 'template'")
    page.locator("[data-testid=template-preset]").select_option("face-68")
    wait_for(page, "() => window.liaamStudio.annotate.points().length === 68")
    points = points_of(page)
    assert (points.min(axis=0) >= 0).all() and (points.max(axis=0) <= (320, 240)).all()
    page.reload()
    page.get_by_role("button", name="The points are in place").wait_for()
    page.locator("[data-testid=template-done]").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'layout'")
    assert not list(folder.glob("*.ljson"))  # no point was moved
    names = page.evaluate("() => window.liaamStudio.state.project.template.names")
    assert (len(names), names[8], names[36]) == (68, "chin", "right_eye_outer_corner")
    assert page.evaluate("() => window.liaamStudio.state.project.template.mirror[36]") == 45


def test_pictures_of_subfolders_are_shown_searched_and_filtered(serve, page, portraits, tmp_path):
    root = tmp_path / "persons"
    for i, name in enumerate(("ann/1.png", "ann/2.png", "bob/side/1.png")):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        write_image(root / name, portraits[i].image)
    write_landmarks(root / "ann" / "1.pts", Landmarks(portraits[0].landmarks[[0, 6, 12, 33, 49]]))
    page.goto(serve(root).address)
    opened(page, "ann/2.png")
    shown = page.locator("[data-testid=strip] [data-name]")
    choice = page.locator("[data-testid=strip-folder]")
    assert choice.locator("option").all_inner_texts() == ["All subfolders", "ann (2)", "bob (1)", "bob/side (1)"]
    choice.select_option("bob")
    assert shown.evaluate_all("items => items.map((item) => item.dataset.name)") == ["bob/side/1.png"]
    shown.click()
    opened(page, "bob/side/1.png")
    choice.select_option("")
    page.locator("[data-testid=strip-search]").fill("ann/1")
    page.locator(ITEM.format("bob/side/1.png")).wait_for(state="detached")
    page.locator(ITEM.format("ann/1.png")).click()
    opened(page, "ann/1.png")
    wait_for(page, "() => document.querySelector('[data-name=\"ann/1.png\"] img').naturalWidth > 0")
    x, y = client(page, 0)
    drag(page, (x, y), (x + 12, y + 6))
    saved(page)
    assert sorted(path.name for path in (root / "ann").iterdir()) == ["1.png", "1.pts", "2.png"]
    assert not np.allclose(points_of(page)[0], portraits[0].landmarks[0])
    page.reload()
    opened(page, "ann/1.png")
    assert annotate(page, "source()") == "file"
