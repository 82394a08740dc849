"""Several sets of landmarks in a folder: a second template, and a second observer who does not see the first."""

import numpy as np
import pytest
from people import (
    NAMES,
    annotate,
    client,
    open_picture,
    opened,
    points_of,
    saved,
    shoot,
    violations,
    wait_for,
    wait_for_state,
)

from liaam.io import read_landmarks

pytestmark = pytest.mark.slow

SIZES = pytest.mark.parametrize("size", [(1280, 720), (820, 1180), (390, 844)], ids=str)


def start(marked, serve, open_page, size, **options):
    """Open the first picture; return the page and what presses a position on it."""
    page = open_page(*size, has_touch=size[0] < 1280, **options)
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    return page, page.touchscreen.tap if size[0] < 1280 else page.mouse.click


def make_set(page, name, kind, look=lambda: None):
    page.locator("[data-testid=set-new]").click()
    page.locator("[data-testid=set-name]").fill(name)
    page.locator(f"[data-testid=set-{kind}]").check()
    look()
    page.locator("[data-testid=set-make]").click()
    page.wait_for_url(f"**/set/{name}/**")
    wait_for(page, "name => window.liaamStudio?.state.project?.set === name", name)
    wait_for(page, "() => Boolean(window.liaamStudio.annotate)")


def place(page, press, points):
    """Click the points that are missing, in order."""
    for i, point in enumerate(points):
        wait_for(page, "i => window.liaamStudio.annotate.selection()[0] === i", i)
        press(*client(page, point))
        wait_for(page, "i => window.liaamStudio.annotate.points()[i] !== null", i)
    saved(page)


@SIZES
def test_a_second_template_beside_the_first(marked, serve, open_page, artefacts, size):
    page, press = start(marked, serve, open_page, size)
    first = points_of(page)
    assert page.locator("[data-testid=sets]").is_hidden()  # there is one set

    def look():
        assert violations(page) == {}
        shoot(page, artefacts, f"set-new-{size[0]}")

    make_set(page, "eyes", "own", look)
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'template'")
    for point in ([100.0, 100.0], [200.0, 100.0], [150.0, 160.0]):
        press(*client(page, point))
    page.locator("[data-testid=template-done]").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'file'")
    saved(page)
    shoot(page, artefacts, f"set-second-{size[0]}")
    assert violations(page) == {}
    mine = read_landmarks(marked / "eyes" / "portrait-01.ljson")
    assert len(mine) == 3 and len(read_landmarks(marked / "portrait-01.ljson")) == 5
    wait_for_state(page, NAMES[0], "done")
    wait_for_state(page, NAMES[1], "new")

    page.reload()  # the choice of the set stays
    opened(page, NAMES[0])
    assert page.locator("[data-testid=sets]").input_value() == "eyes" and len(points_of(page)) == 3
    assert page.locator("[data-testid=agreement]").is_hidden()  # these points have one observer
    page.locator("[data-testid=sets]").select_option("+")
    page.keyboard.press("Escape")
    assert page.locator("[data-testid=sets]").input_value() == "eyes"
    page.locator("[data-testid=sets]").select_option("")
    wait_for(page, "() => window.liaamStudio?.state.project?.set === ''")
    opened(page, NAMES[0])
    assert np.allclose(points_of(page), first)
    wait_for_state(page, NAMES[1], "done")


@SIZES
def test_a_second_observer_places_the_same_points_blind(marked, serve, open_page, artefacts, size):
    page, press = start(marked, serve, open_page, size)
    first = points_of(page)
    page.locator("[data-testid=set-new]").click()
    page.locator("[data-testid=set-name]").fill("../out")  # no name of a subfolder
    page.keyboard.press("Enter")
    assert page.locator("dialog[open]").count() == 1
    page.keyboard.press("Escape")

    make_set(page, "anna", "same")
    opened(page, NAMES[0])
    assert all(point is None for point in annotate(page, "points()"))
    assert page.locator("[data-testid=show-others]").is_disabled()
    page.get_by_role("radio", name="Click each").click()
    for k, name in enumerate(NAMES[:2], 1):
        if name != NAMES[0]:
            open_picture(page, name)
        theirs = read_landmarks((marked / name).with_suffix(".ljson")).points
        place(page, press, np.add(theirs, [k * 3.0, 0.0]).tolist())
        wait_for_state(page, name, "done")
    placed = read_landmarks(marked / "anna" / "portrait-01.ljson").points
    assert np.abs(placed - first - [3, 0]).max() < 1.5
    assert np.allclose(read_landmarks(marked / "portrait-01.ljson").points, first, atol=0.01)

    page.locator("[data-testid=show-others]").click()
    wait_for(page, "() => document.querySelector('[data-testid=show-others]').getAttribute('aria-pressed') === 'true'")
    shoot(page, artefacts, f"set-others-{size[0]}")
    page.locator("[data-testid=show-others]").click()  # no longer
    assert violations(page) == {}

    page.locator("[data-testid=agreement]").click()
    page.locator("[data-testid=agreement-sd]").wait_for()
    found = float(page.locator("[data-testid=agreement-sd]").inner_text().removesuffix(" px"))
    assert found == pytest.approx(np.sqrt((3**2 + 6**2) / 2 / 2), rel=0.2)
    for theme in ("light", "dark"):
        page.evaluate("theme => { document.documentElement.dataset.theme = theme; }", theme)
        shoot(page, artefacts, f"set-agreement-{size[0]}-{theme}")
        assert violations(page) == {}
    page.locator("[data-testid=agreement-picture]", has_text=NAMES[0]).click()
    wait_for(page, "() => document.querySelector('[data-testid=show-others]').getAttribute('aria-pressed') === 'true'")
    page.locator("[data-testid=agreement]").click()
    with page.expect_download() as waited:
        page.locator("[data-testid=agreement-save]").click()
    assert "repeatability" in waited.value.path().read_text()
    page.locator("[data-testid=agreement]").click()
    page.locator("[data-testid=agreement-picture]").first.click()  # the larger difference
    opened(page, NAMES[1])


def test_pages_in_two_sets_do_not_disturb_each_other(marked, serve, open_page):
    page, press = start(marked, serve, open_page, (1280, 720))
    make_set(page, "anna", "same")
    opened(page, NAMES[0])
    other = page.context.new_page()
    other.goto(page.url.partition("/set/")[0] + "/")
    opened(other, NAMES[0])
    theirs = points_of(other)
    place(page, press, (theirs + 2).tolist())
    other.keyboard.press("Tab")
    other.keyboard.press("ArrowRight")
    saved(other)
    saved(page)
    assert np.abs(points_of(other) - theirs).max() == pytest.approx(1, abs=0.01)
    assert np.abs(points_of(page) - theirs - 2).max() < 1.5
    assert np.abs(read_landmarks(marked / "portrait-01.ljson").points - points_of(other)).max() < 0.01
    assert not other.locator(".toast.bad").count() and not page.locator(".toast.bad").count()

    before = read_landmarks(marked / "anna" / "portrait-01.ljson").points
    page.locator("[data-testid=annotate-viewer] canvas").first.focus()
    page.keyboard.press("ArrowRight")
    page.locator("[data-testid=sets]").select_option("")  # at once: the change is saved before the page goes
    wait_for(page, "() => window.liaamStudio?.state.project?.set === ''")
    assert np.abs(read_landmarks(marked / "anna" / "portrait-01.ljson").points - before).max() == pytest.approx(
        1, abs=0.01
    )
