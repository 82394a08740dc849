"""The Annotate tab in a real browser: what is saved, and what the page says of each picture."""

import pytest
from people import NAMES, annotate, client, drag, open_picture, opened, picture, saved, wait_for

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


def state_of(page, name: str) -> str:
    return picture(page, name)["state"]


def test_enter_on_an_untouched_mean_shape_saves_nothing(blank, marked):
    blank.keyboard.press("v")  # a change of visibility is not a check, either
    blank.keyboard.press("Enter")
    blank.locator(".toast", has_text="no point of it was moved").wait_for()
    assert annotate(blank, "name()") == NAMES[1]
    blank.keyboard.press("Enter")
    opened(blank, NAMES[2])
    wait_for(blank, "name => window.liaamStudio.state.picture(name).state === 'unchecked'", NAMES[1])
    assert "not checked" in blank.locator(f"[data-testid=strip] [data-name='{NAMES[1]}']").inner_text()
    assert not list(marked.glob("portrait-02.*json"))
    blank.reload()
    opened(blank, NAMES[2])
    assert state_of(blank, NAMES[1]) == "unchecked"


def test_a_moved_or_a_confirmed_mean_shape_is_saved(blank, marked):
    drag(blank, client(blank, 2), [v + 12 for v in client(blank, 2)])
    blank.keyboard.press("Enter")
    opened(blank, NAMES[2])
    assert state_of(blank, NAMES[1]) == "done"
    blank.locator("[data-testid=confirm-layout]").click()
    blank.locator("[data-testid=confirm]").click()
    saved(blank)
    wait_for(blank, "name => window.liaamStudio.state.picture(name).state === 'done'", NAMES[2])
    assert (marked / "portrait-03.ljson").exists()
