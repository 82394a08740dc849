"""A contour traced on the picture: a few clicks along it, and its points are placed evenly on a smooth curve."""

import numpy as np
import pytest
from people import annotate, client, drag, open_picture, opened, points_of, saved, shoot, violations, wait_for

from liaam.io import Contour, Landmarks, read_landmarks, write_image, write_landmarks

pytestmark = pytest.mark.slow

UPPER, LOWER, EYE = (0, 1, 2, 3, 4, 5, 6), (0, 7, 8, 9, 6), (10, 11, 12, 13, 14, 15)
CHEEKS = ((0, 16), (6, 17))
PARTS = {"upper": 7, "lower": 3, "eye": 6, "cheek": 2}
NAMES = tuple(f"{part}{i}" for part, n in PARTS.items() for i in range(1, n + 1))
WHOLE = f"() => window.liaamStudio.annotate.points().length === {len(NAMES)}"
SECOND = "portrait-02.png"
PROMPT = "() => document.querySelector('.annotate-prompt').textContent"
ARC = [(40 + 20 * i, 200 - 0.02 * (60**2 - (20 * i - 60) ** 2)) for i in range(7)]
"""Places along an upper lip, so to speak: a parabola of 120 pixels."""


@pytest.fixture
def lips(tmp_path, portraits):
    """Give a folder of two pictures; the first has points on lips with common corners, on cheeks, and on an eye."""
    root = tmp_path / "lips"
    root.mkdir()
    for i in range(2):
        write_image(root / f"portrait-0{i + 1}.png", portraits[i].image)
    turns = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    eye = np.column_stack([100 + 30 * np.cos(turns), 60 + 15 * np.sin(turns)])
    points = np.concatenate([ARC, [[70, 220], [100, 225], [130, 220]], eye, [[20, 190], [180, 190]]])
    contours = (Contour(UPPER), Contour(LOWER), Contour(EYE, closed=True), *map(Contour, CHEEKS))
    write_landmarks(root / "portrait-01.ljson", Landmarks(points, contours, names=NAMES))
    return root


def at_second(lips, serve, open_page, size):
    """Open the picture without points, to place them by clicks; return the page and what presses a position on it."""
    touch = size[0] < 1280
    page = open_page(*size, has_touch=touch)
    page.goto(serve(lips).address)
    opened(page, SECOND)
    page.get_by_role("radio", name="Click each").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'none'")
    return page, page.touchscreen.tap if touch else page.mouse.click


def trace(page, press, places):
    """Start to trace, and click these places."""
    page.locator("[data-testid=trace]").click()
    add(page, press, places)


def add(page, press, places):
    for place in places:
        before = annotate(page, "undoSteps()")
        press(*client(page, [float(v) for v in place]))
        wait_for(page, "(n) => window.liaamStudio.annotate.undoSteps() === n + 1", before)


def stored(lips):
    return read_landmarks(lips / "portrait-02.ljson").points


@pytest.mark.parametrize("size", [(1280, 720), (820, 1180), (390, 844)], ids=str)
def test_lips_and_an_eye_are_traced(lips, serve, open_page, artefacts, size):
    page, press = at_second(lips, serve, open_page, size)
    trace(page, press, [])
    assert "from upper1 to upper7" in page.evaluate(PROMPT)
    add(page, press, [ARC[0], ARC[2], ARC[4]])
    shoot(page, artefacts, f"trace-{size[0]}")
    assert violations(page) == {}
    add(page, press, [ARC[6]])
    press(*client(page, list(ARC[6])))  # the last place again, as by a double click
    wait_for(page, WHOLE)
    upper = points_of(page)[list(UPPER)]
    steps = np.linalg.norm(np.diff(upper, axis=0), axis=1)
    assert steps.max() / steps.min() < 1.08
    np.testing.assert_allclose(upper[:, 1], 200 - 0.02 * (60**2 - (upper[:, 0] - 100) ** 2), atol=4)
    assert annotate(page, "selection()") == [7]  # the next missing one
    assert annotate(page, "undoSteps()") == 1

    page.locator("[data-testid=trace]").click()  # the lower lip has its corners already
    add(page, press, [(100, 230)])
    page.locator("[data-testid=trace]").click()  # again, to end it
    wait_for(page, WHOLE)
    lower = points_of(page)[list(LOWER)]
    np.testing.assert_allclose(lower[[0, 4]], upper[[0, 6]])
    np.testing.assert_allclose(lower[2], [100, 230], atol=2)

    trace(page, press, [(130, 60), (100, 75), (70, 60), (100, 45)])
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        shoot(page, artefacts, f"trace-{size[0]}-{scheme}")
        assert violations(page) == {}
    press(*client(page, [130.0, 60.0]))  # the first place, which closes it
    saved(page)
    assert np.isfinite(stored(lips)[:16]).all()
    np.testing.assert_allclose(stored(lips)[[10, 13]], [[130, 60], [70, 60]], atol=2)
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")


def test_places_are_moved_undone_and_left_by_the_keyboard(lips, serve, open_page):
    page, press = at_second(lips, serve, open_page, (1280, 720))
    page.keyboard.press("c")
    add(page, press, ARC[::2])
    page.keyboard.press("Backspace")
    assert len(annotate(page, "points()")) == 3
    page.keyboard.press("Control+z")
    assert len(annotate(page, "points()")) == 4
    drag(page, client(page, list(ARC[2])), client(page, [80.0, 100.0]))
    np.testing.assert_allclose(points_of(page)[1], [80, 100], atol=1)
    page.keyboard.press("ArrowRight")
    np.testing.assert_allclose(points_of(page)[1], [81, 100], atol=1)
    page.keyboard.press("Escape")
    assert annotate(page, "points()") == [None] * len(NAMES)
    assert annotate(page, "undoSteps()") == 0
    page.keyboard.press("c")
    page.keyboard.press("Enter")  # ends nothing yet, and opens no other picture
    add(page, press, [ARC[0], ARC[6]])
    page.keyboard.press("Enter")
    wait_for(page, WHOLE)
    assert annotate(page, "name()") == SECOND
    np.testing.assert_allclose(points_of(page)[3], [100, 200], atol=1)
    page.keyboard.press("Control+z")  # one step
    assert annotate(page, "points()") == [None] * len(NAMES)


def test_points_are_replaced_and_spaced_evenly(lips, serve, open_page):
    page, press = at_second(lips, serve, open_page, (1280, 720))
    for place in (ARC[0], (50, 190), (60, 180)):
        press(*client(page, [float(v) for v in place]))
    page.locator("[data-testid=point-list] [data-index='1']").click()
    page.get_by_role("button", name="Space the curve's points evenly").click()
    points = points_of(page)[list(UPPER)]
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.isfinite(points).all() and steps.max() / steps.min() < 1.01
    np.testing.assert_allclose(points[6], [60, 180], atol=1)
    page.keyboard.press("c")
    add(page, press, [(30, 30), (90, 30)])
    open_picture(page, "portrait-01.png")  # leaves it without a change
    open_picture(page, SECOND)
    np.testing.assert_allclose(points_of(page)[list(UPPER)], points)
    assert page.locator("[data-testid=trace]").get_attribute("aria-pressed") == "false"


def test_without_contours_there_is_nothing_to_trace(marked, serve, page):
    page.goto(serve(marked).address)
    opened(page, "portrait-01.png")
    assert page.locator("[data-testid=trace]").is_disabled()
    page.keyboard.press("c")
    page.locator(".toast", has_text="Draw curves in the template").wait_for()
