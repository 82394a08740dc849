"""What once went wrong without a word: names after undo, a length typed on a button, points that nobody looked at."""

import re
import shutil

import numpy as np
import pytest
from people import (
    NAMES,
    annotate,
    client,
    drag,
    open_picture,
    opened,
    picture,
    points_of,
    saved,
    wait_for,
    wait_for_point,
    wait_for_state,
)

from liaam.io import Contour, Landmarks, read_landmarks, write_landmarks

pytestmark = pytest.mark.slow


def click_each(page, marked, serve):
    """Open the second picture, which has no points, to place them one after another."""
    (marked / NAMES[1]).with_suffix(".ljson").unlink()
    page.goto(serve(marked).address)
    open_picture(page, NAMES[1])
    page.get_by_role("radio", name="Click each").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'none'")


def press(page, *place):
    """Click a position of the picture."""
    before = annotate(page, "undoSteps()")
    page.mouse.click(*client(page, [float(v) for v in place]))
    wait_for(page, "before => window.liaamStudio.annotate.undoSteps() > before", before)


def test_after_undo_the_next_click_places_the_point_that_was_undone(serve, page, marked):
    click_each(page, marked, serve)
    places = [[60.0 + 30 * i, 50.0 + 20 * (i % 2)] for i in range(5)]
    for place in places[:2]:
        press(page, *place)
    press(page, 200, 200)  # a slip
    page.keyboard.press("Control+z")
    assert annotate(page, "selection()") == [2]
    for place in places[2:]:
        press(page, *place)
    saved(page)
    stored = read_landmarks((marked / NAMES[1]).with_suffix(".ljson"))
    assert np.abs(stored.points - places).max() < 1.5
    for _ in range(5):
        page.keyboard.press("Control+z")
    assert annotate(page, "selection()") == [0] and annotate(page, "points()") == [None] * 5
    for _ in range(5):
        page.keyboard.press("Control+y")
    assert np.abs(points_of(page) - places).max() < 1.5


def test_a_length_is_typed_as_soon_as_the_second_end_is_clicked(serve, page, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    page.keyboard.press("s")
    for place in ([60.0, 130.0], [220.0, 130.0]):
        page.mouse.click(*client(page, place))
    page.locator("[data-testid=scale-length]").wait_for()
    page.keyboard.type("0.5")
    page.keyboard.press("Enter")
    wait_for(page, "() => window.liaamStudio.annotate.bar()?.length === 0.5")


def test_points_accepted_with_others_are_known_as_such_until_each_is_moved_or_confirmed(serve, page, marked):
    click_each(page, marked, serve)
    page.get_by_role("radio", name="Mean shape").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'layout'")
    drag(page, client(page, 0), [v + 15 for v in client(page, 0)])
    assert page.locator(".point[data-state=proposed]").count() == 4
    page.keyboard.press("Enter")
    page.locator(".toast", has_text="All pictures are done").wait_for()
    saved(page)
    wait_for(page, "name => window.liaamStudio.state.picture(name).unconfirmed === 4", NAMES[1])
    assert page.locator(".point[data-state=accepted]").count() == 4
    assert "4 unconfirmed" in page.locator("[data-testid=review-state]").inner_text()
    page.locator("[data-testid=point-list] [data-index='1']").click()
    for _ in range(4):
        page.keyboard.press("y")
    saved(page)
    wait_for(page, "name => window.liaamStudio.state.picture(name).unconfirmed === 0", NAMES[1])
    page.reload()
    opened(page, NAMES[1])
    assert page.locator(".point[data-state=placed]").count() == 5


def test_training_on_four_pictures_says_which_one_it_leaves_out(serve, page, marked):
    shutil.copy(marked / NAMES[0], marked / "portrait-04.png")
    points = read_landmarks((marked / NAMES[0]).with_suffix(".ljson")).points
    write_landmarks(marked / "portrait-04.ljson", Landmarks(points[[1, 0, 2, 4, 3]]))  # left and right are exchanged
    page.goto(serve(marked).address)
    item = page.locator("[data-testid=strip] [data-name='portrait-04.png']")
    item.get_by_text("left out").wait_for()
    item.click()
    why = page.locator("[data-testid=why-next]")
    why.get_by_text(re.compile("leaves this picture out, because its points fold the mesh")).wait_for()
    assert "3 of 4 done, 1 left out" in page.locator(".assist-count").inner_text()


def test_tracing_moves_no_landmark(serve, page, marked):
    """The second point of the curve is a landmark that a person has placed, the fourth slides."""
    write_landmarks(
        marked / "portrait-01.ljson", Landmarks(points := [[40, 60], [80, 60], [120, 60], [160, 60], [200, 60]])
    )
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    template = {"names": list("abcde"), "contours": [{"indices": [0, 1, 2, 3, 4], "closed": False}], "mirror": None}
    kinds = ["landmark", "landmark", "semilandmark", "semilandmark", "landmark"]
    change = {**template, "points": points, "kinds": kinds}
    page.evaluate("change => window.liaamStudio.app.api.put('/api/template', change)", change)
    wait_for(page, "() => window.liaamStudio.state.project.template.kinds[2] === 'semilandmark'")
    opened(page, NAMES[0])
    page.locator("[data-testid=point-list] [data-index='2']").click()
    page.keyboard.press("c")
    for place in ([100.0, 200.0], [220.0, 200.0]):
        page.mouse.click(*client(page, place))
    page.keyboard.press("Enter")
    wait_for_point(page, 1, points[1])
    found = points_of(page)
    assert np.abs(found[[0, 1, 4]] - np.array(points)[[0, 1, 4]]).max() == 0
    assert np.abs(found[[2, 3]] - np.array(points)[[2, 3]]).max() > 10


def test_clicks_of_a_template_are_landmarks_by_themselves_until_a_curve_is_drawn(serve, page, marked):
    for file in marked.glob("*.ljson"):
        file.unlink()
    page.goto(serve(marked).address)
    wait_for(page, "() => window.liaamStudio.annotate?.source() === 'template'")
    for x in (40.0, 80.0, 120.0):
        page.mouse.click(*client(page, [x, 60.0]))
    names = page.locator("[data-testid=point-list] input")
    names.nth(0).click()
    page.keyboard.type("tip")  # it replaces the whole default name
    page.keyboard.press("Tab")
    page.keyboard.type("base")
    assert [names.nth(i).input_value() for i in range(2)] == ["tip", "base"]
    page.locator("canvas").first.focus()
    for y in (160.0, 200.0):
        page.keyboard.press("n")
        for x in (40.0, 80.0, 120.0, 160.0):
            page.mouse.click(*client(page, [x, y]))
        page.keyboard.press("n")
    page.locator("[data-testid=curve-name]").nth(1).fill("costa")
    page.locator("[data-testid=curve-name]").nth(0).fill("Costa")
    page.locator("[data-testid=template-done]").click()
    page.get_by_text("Two curves have the name 'Costa': rename one.").wait_for()
    page.locator("[data-testid=curve-name]").nth(0).fill("")
    page.locator("[data-testid=template-done]").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'file'")
    saved(page)
    stored = read_landmarks(marked / "portrait-01.ljson").contours
    assert stored == (Contour((3, 4, 5, 6)), Contour((7, 8, 9, 10), name="costa"))
    kinds = page.evaluate("() => window.liaamStudio.state.project.template.kinds")
    assert [i for i, kind in enumerate(kinds) if kind == "semilandmark"] == [4, 5, 8, 9]
    with page.expect_download() as waited:
        page.locator("[data-testid=export-all]").select_option("sliders")
    assert waited.value.path().read_text().split() == ["before,slide,after", "4,5,6", "5,6,7", "8,9,10", "9,10,11"]


def test_a_picture_is_finished_without_a_point_that_its_object_lacks(serve, page, marked):
    click_each(page, marked, serve)
    for i in range(4):
        press(page, 60 + 30 * i, 50)
    page.keyboard.press("u")
    saved(page)
    wait_for_state(page, NAMES[1], "done")
    assert picture(page, NAMES[1])["absent"] == 1
    page.locator(f"[data-testid=strip] [data-name='{NAMES[1]}']", has_text="1 absent").wait_for()
    page.keyboard.press("Enter")
    page.locator(".toast", has_text="All pictures are done").wait_for()
    page.reload()
    opened(page, NAMES[1])
    assert page.locator(".point[data-state=absent]").count() == 1


def test_two_tabs_do_not_take_back_each_others_absent_points(serve, open_page, marked):
    """They are not in the landmark file, so that the later tab overwrote those of the earlier without a word."""
    points = read_landmarks((marked / NAMES[0]).with_suffix(".ljson")).points.copy()
    points[[3, 4]] = np.nan
    write_landmarks((marked / NAMES[0]).with_suffix(".ljson"), Landmarks(points))
    server = serve(marked)
    tabs = [open_page(), open_page()]
    for tab in tabs:
        tab.goto(server.address)
        opened(tab, NAMES[0])
    tabs[1].context.set_offline(True)
    for tab, point in zip(tabs, (3, 4), strict=True):
        tab.locator(f"[data-testid=point-list] [data-index='{point}']").click()
        tab.keyboard.press("u")
    saved(tabs[0])
    tabs[1].context.set_offline(False)
    for tab in tabs:
        wait_for(tab, "() => document.querySelectorAll('.point[data-state=absent]').length === 2")
        saved(tab)
    tabs[0].reload()
    opened(tabs[0], NAMES[0])
    assert tabs[0].locator(".point[data-state=absent]").count() == 2


def test_undo_takes_back_the_same_in_two_tabs(serve, open_page, marked):
    """A change in one tab emptied the history of the other, where Undo then did nothing."""
    server = serve(marked)
    tabs = [open_page(), open_page()]
    for tab in tabs:
        tab.goto(server.address)
        opened(tab, NAMES[0])
    before = points_of(tabs[0])

    def are(places, steps):
        for tab in tabs:
            for index in (0, 1):
                wait_for_point(tab, index, places[index].tolist())
            saved(tab)
            assert annotate(tab, "undoSteps()") == steps

    def moved(tab, index):
        x, y = client(tab, index)
        drag(tab, [x, y], [x + 30, y])
        saved(tab)
        return points_of(tab)

    first = moved(tabs[0], 0)
    are(first, 1)
    second = moved(tabs[1], 1)
    are(second, 2)
    tabs[0].keyboard.press("Control+z")  # what the other tab has done
    are(first, 1)
    tabs[1].keyboard.press("Control+z")  # what that tab has done
    are(before, 0)
    tabs[0].keyboard.press("Control+y")
    are(first, 1)
    open_picture(tabs[1], NAMES[1])
    tabs[0].keyboard.press("Control+y")
    saved(tabs[0])
    open_picture(tabs[1], NAMES[0])
    are(second, 2)
