"""Pictures are removed and renamed on the page, with undo, by keyboard alone."""

import re
from contextlib import contextmanager

import pytest
from people import NAMES, opened, picture, points_of, shoot, wait_for, wait_until

pytestmark = pytest.mark.slow


@pytest.fixture
def listed(serve, page, marked):
    """Give the page with the focus in the list."""
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    page.locator("[data-testid=strip]").focus()
    return page


def test_a_picture_is_removed_and_comes_back_with_its_landmarks(listed, marked, artefacts):
    points = points_of(listed)
    listed.keyboard.press("Delete")
    listed.locator(".toast", has_text="portrait-01.png removed").wait_for()
    opened(listed, NAMES[1])
    assert listed.locator(".toast").count() == 1  # the template stays as it was
    assert not list(marked.glob("portrait-01.*"))
    shoot(listed, artefacts, "removed-1280")
    listed.locator("[data-testid=toast-action]").click()
    opened(listed, NAMES[0])
    assert (points_of(listed) == points).all()
    assert sorted(path.suffix for path in marked.glob("portrait-01.*")) == [".ljson", ".png"]


@contextmanager
def answered_late(page, what):
    """Let the page hear that the folder has changed before the server's answer to the request that has changed it."""
    late = []
    page.route(re.compile(f"/api/{what}$"), lambda route: late.append((route, route.fetch())))
    with page.expect_response(lambda response: "/api/project" in response.url):
        yield
    wait_until(page, lambda: late)
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    (route, response), *_ = late
    route.fulfill(response=response)


def test_a_picture_that_the_page_removes_is_not_missed_before_the_answer(listed):
    with answered_late(listed, "removed"):
        listed.keyboard.press("Delete")
    listed.locator(".toast", has_text="portrait-01.png removed").wait_for()
    opened(listed, NAMES[1])
    assert listed.locator(".toast").count() == 1
    wait_for(listed, "() => window.liaamStudio.state.project.pictures.length === 2")


def test_a_picture_that_the_page_renames_stays_open_before_the_answer(listed):
    with answered_late(listed, "renamed"):
        listed.keyboard.press("F2")
        listed.locator("[data-testid=rename]").fill("lisa")
        listed.keyboard.press("Enter")
    listed.locator(".toast", has_text="portrait-01.png is now lisa.png").wait_for()
    opened(listed, "lisa.png")
    assert listed.locator(".toast").count() == 1


def test_a_picture_is_renamed_with_its_landmarks(listed, marked):
    points = points_of(listed)
    listed.keyboard.press("F2")
    listed.locator("[data-testid=rename]").wait_for()
    listed.keyboard.type("lisa")
    listed.keyboard.press("Enter")
    opened(listed, "lisa.png")
    assert (points_of(listed) == points).all() and picture(listed, "lisa.png")["state"] == "done"
    assert sorted(path.suffix for path in marked.glob("lisa.*")) == [".ljson", ".png"]
    listed.locator("[data-testid=toast-action]").click()
    opened(listed, NAMES[0])
    wait_until(listed, lambda: not list(marked.glob("lisa.*")))


def test_a_name_that_is_refused_is_said_in_the_dialog_which_stays(listed, marked):
    listed.keyboard.press("F2")
    field = listed.locator("[data-testid=rename]")
    field.fill("portrait-02")
    listed.keyboard.press("Enter")
    listed.locator("[data-testid=dialog-fault]", has_text="portrait-02.png already: choose another name").wait_for()
    listed.keyboard.type("v")  # would let points be invisible, if the dialog had closed
    assert field.input_value() == "portrait-02v"
    field.fill("lisa")
    listed.keyboard.press("Enter")
    listed.locator(".toast", has_text="portrait-01.png is now lisa.png").wait_for()
    opened(listed, "lisa.png")
    assert listed.locator("dialog").count() == 0 and listed.locator(".toast.bad").count() == 0
    assert not listed.evaluate("() => window.liaamStudio.annotate.invisible()")


def test_several_are_removed_from_the_menu_and_come_back(listed, marked):
    for name in NAMES[1:]:
        listed.locator(f"[data-testid=strip] [data-name='{name}']").click(modifiers=["Control"])
    listed.locator("[data-testid=bulk-action]").select_option("remove")
    wait_for(listed, "() => window.liaamStudio.state.project.pictures.length < 3")
    listed.locator("[data-testid=toast-action]").click()
    wait_for(listed, "() => window.liaamStudio.state.project.pictures.length === 3")
    assert len(list(marked.glob("*.ljson"))) == 3
