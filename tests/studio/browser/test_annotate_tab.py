"""The Annotate tab in a real browser: what is saved, and what the page says of each picture."""

import re

import numpy as np
import pytest
from people import (
    NAMES,
    annotate,
    client,
    drag,
    open_picture,
    opened,
    points_of,
    saved,
    wait_for,
    wait_for_state,
    wait_until,
)

from liaam.io import Landmarks, write_landmarks
from liaam.model import load_model

pytestmark = pytest.mark.slow


@pytest.fixture
def blank(serve, page, marked):
    """Give the page on a folder whose second and third picture have no landmarks, with the second one open."""
    for name in NAMES[1:]:
        (marked / name).with_suffix(".ljson").unlink()
    page.goto(serve(marked).address)
    open_picture(page, NAMES[1])
    assert annotate(page, "source()") == "layout"
    return page


def test_enter_on_an_untouched_mean_shape_saves_nothing(blank, marked):
    blank.keyboard.press("v")  # a change of visibility is not a check, either
    blank.keyboard.press("Enter")
    warning = blank.locator(".toast", has_text="no point of it was moved")
    warning.wait_for()
    assert annotate(blank, "name()") == NAMES[1]
    blank.keyboard.press("Enter")
    opened(blank, NAMES[2])
    assert warning.count() == 0
    wait_for_state(blank, NAMES[1], "unchecked")
    blank.locator(f"[data-testid=strip] [data-name='{NAMES[1]}']", has_text="mean shape").wait_for()
    assert not list(marked.glob("portrait-02.*json"))
    blank.reload()
    opened(blank, NAMES[2])
    wait_for_state(blank, NAMES[1], "unchecked")


def test_a_moved_or_a_confirmed_mean_shape_is_saved(blank, marked):
    before = points_of(blank)
    middle = np.mean([client(blank, i) for i in range(5)], axis=0)
    step = np.array([12, 8])
    for moves in (1, 2):  # by the inside of its frame, which stays after the first move
        drag(blank, middle, middle + step)
        middle += step
        wait_for(blank, "moves => window.liaamStudio.annotate.undoSteps() === moves", moves)
    shifts = points_of(blank) - before
    assert np.ptp(shifts, axis=0).max() < 0.02 and shifts.min() > 5
    # A click on a button leaves the focus in the picture, so that Enter accepts.
    blank.locator("[data-testid=point-list] [data-index='2']").click()
    absent = blank.locator("button[title^=Absent]")
    absent.click()
    wait_for(blank, "() => window.liaamStudio.annotate.points()[2] === null")
    blank.keyboard.press("Enter")
    opened(blank, NAMES[2])
    wait_for_state(blank, NAMES[1], "done")
    assert (marked / "portrait-02.ljson").exists()
    blank.keyboard.press("Control+z")  # returns to the picture that was accepted
    opened(blank, NAMES[1])
    steps = annotate(blank, "undoSteps()")
    blank.keyboard.press("Control+z")  # and takes its last step back
    wait_for(blank, "steps => window.liaamStudio.annotate.undoSteps() === steps - 1", steps)
    blank.keyboard.press("Control+y")
    open_picture(blank, NAMES[2])
    blank.locator("[data-testid=confirm-layout]").click()
    blank.locator("[data-testid=confirm]").click()
    saved(blank)
    wait_for_state(blank, NAMES[2], "done")
    assert (marked / "portrait-03.ljson").exists()


def test_a_picture_that_is_being_saved_is_not_opened_again(blank):
    saves = []
    blank.route(
        "**/landmarks", lambda route: route.continue_() if route.request.method == "GET" else saves.append(route)
    )
    for n, name in enumerate(NAMES[1:], 1):
        opened(blank, name)
        drag(blank, client(blank, 2), [v + 12 for v in client(blank, 2)])
        blank.keyboard.press("Enter")
        wait_until(blank, lambda n=n: len(saves) == n)
    assert annotate(blank, "name()") == NAMES[2]
    for route in saves:
        route.continue_()
    blank.locator(".toast", has_text="All pictures are done").wait_for()


def test_enter_goes_on_from_a_picture_that_cannot_be_opened(blank, marked):
    (marked / NAMES[1]).write_bytes((marked / NAMES[1]).read_bytes()[:-2000])
    write_landmarks((marked / NAMES[2]).with_suffix(".ljson"), Landmarks(np.full((4, 2), 60.0)))
    blank.locator(f"[data-testid=strip] [data-name='{NAMES[2]}']", has_text="points do not fit").wait_for()
    wait_for_state(blank, NAMES[1], "broken")
    blank.keyboard.press("Enter")
    opened(blank, NAMES[2])
    why = blank.locator("[data-testid=why-next]").inner_text()
    assert "has 4 points where the template has 5" in why and "a copy of the file is kept" in why


def test_the_page_is_not_left_with_unsaved_changes_of_the_template_without_asking(serve, page, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    page.locator("[data-testid=template-edit]").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'template'")
    page.keyboard.press("p")
    asked = []
    page.once("dialog", lambda dialog: (asked.append(dialog.type), dialog.accept()))
    page.reload()
    assert asked == ["beforeunload"]


def test_a_picture_that_the_model_leaves_out_says_so(serve, page, five_marked):
    """Training leaves out the picture that is cut short, which keeps its points."""
    (five_marked / NAMES[2]).write_bytes((five_marked / NAMES[2]).read_bytes()[:-2000])
    page.goto(serve(five_marked).address)
    item = page.locator(f"[data-testid=strip] [data-name='{NAMES[2]}']")
    item.click()
    item.get_by_text("left out").wait_for()
    assert "cut short" in item.get_attribute("title")
    why = page.locator("[data-testid=why-next]")
    why.get_by_text(re.compile("leaves this picture out.*cut short")).wait_for()
    open_picture(page, NAMES[0])
    why.get_by_text(f"The model leaves out {NAMES[2]}.").wait_for()
    page.keyboard.press("Enter")
    page.locator(".toast", has_text=f"The model leaves out {NAMES[2]}.").wait_for()


def test_a_folder_with_enough_done_pictures_is_trained_on_opening(serve, page, five_marked, tmp_path):
    page.goto(serve(five_marked).address)
    wait_for(page, "() => window.liaamStudio?.state.project?.model?.n_images === 5")
    # The model is saved from its badge, and where landmarks are exported.
    badge, menu = (page.locator(f"[data-testid={name}]") for name in ("top-model", "export-all"))
    for ask in (badge.click, lambda: menu.select_option("model")):
        with page.expect_download() as download:
            ask()
        assert load_model(download.value.path().rename(tmp_path / "saved.liaam")).n_points == 5
