"""The page on screens of three sizes: what is visible, what touch does, and whether it is accessible."""

import json

import numpy as np
import pytest
from people import (
    NAMES,
    annotate,
    as_expert,
    client,
    opened,
    points_of,
    saved,
    shoot,
    untrained,
    violations,
    wait_for,
)

from liaam.io import Landmarks, write_landmarks
from liaam.training import train

pytestmark = pytest.mark.slow

SIZES = [(1280, 720), (820, 1180), (390, 844)]
NARROW = 900
"""Width in pixels below which the panel is under the picture."""

CLIPPED = """() => {
  const least = matchMedia("(pointer: coarse)").matches ? 40 : 16; // css pixels of what a finger touches
  const controls = "button, input:not([type=checkbox]):not([type=file]), select, a[href], [role=slider], [role=tab]";
  const scrolls = (element) => {
    for (let at = element.parentElement; at; at = at.parentElement)
      if (/auto|scroll/.test(getComputedStyle(at).overflow)) return true;
    return false;
  };
  const isClipped = (element) => {
    const { width, height, left, right, top, bottom } = element.getBoundingClientRect();
    const touched = element.closest("label") ?? element; // a tick is set by its words, too
    const box = touched.getBoundingClientRect();
    if (width < 16 || height < 16 || Math.min(box.width, box.height) < least - 0.5) return true;
    const isHigh = top < -1 || bottom > innerHeight + 1;
    const inside = left >= -1 && right <= innerWidth + 1 && (scrolls(element) || !isHigh);
    return !inside || (element.matches("button, [role=tab]") && element.scrollWidth > element.clientWidth + 1);
  };
  return [...document.querySelectorAll(controls)]
    .filter((element) => element.offsetParent)
    .filter((element) => !element.closest(".visually-hidden, .skip, .strip-space, .link, .lamp"))
    .filter(isClipped)
    .map((element) => element.outerHTML.slice(0, 120));
}"""


@pytest.fixture(scope="session")
def five_point_model(portraits, tmp_path_factory):
    """Give a model of the points of the fixture ``marked``."""
    path = tmp_path_factory.mktemp("model") / "five.liaam"
    shown = [(scene.image, scene.landmarks[[0, 6, 12, 33, 49]]) for scene in portraits[:4]]  # too few for a regressor
    train(shown, methods="all", lamps=None).save(path)
    return path


@pytest.fixture(params=SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def sized(request, open_page, serve, marked, five_point_model):
    """Give a page of one size on a folder with a model; a narrow one has touch."""
    width, height = request.param
    page = open_page(width, height, has_touch=width < NARROW)
    as_expert(page)
    page.goto(serve(marked, "--model", str(five_point_model)).address)
    opened(page, NAMES[0])
    return page


def tabs(page):
    """Open one tab after the other, with a fit where there is one."""
    yield "annotate"
    page.locator("[data-testid=template-edit]").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'template'")
    yield "template"
    page.get_by_role("button", name="Cancel").click()
    page.locator("[data-testid=tab-measure]").click()
    page.locator("[data-testid=measure-table]").wait_for()
    yield "measure"
    page.locator("[data-testid=measure-view-shapes]").click()
    page.locator("[data-testid=shape-scatter] svg").wait_for()
    yield "shapes"
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit")
    yield "fit"
    page.locator("[data-testid=layer-relit]").click()
    wait_for(page, "() => window.liaamStudio.fit.hasLayer && !window.liaamStudio.fit.relightBusy")
    yield "relight"
    page.locator("[data-testid=tab-compare]").click()
    wait_for(page, "() => window.liaamStudio.compare.left.fit && window.liaamStudio.compare.right.fit")
    yield "compare"
    page.locator("[data-testid=tab-live]").click()
    page.locator("[data-testid=live-camera]").wait_for()
    yield "live"


def test_every_control_is_visible_and_the_picture_is_large(sized, artefacts):
    width, height = (sized.viewport_size[key] for key in ("width", "height"))
    for tab in tabs(sized):
        shoot(sized, artefacts, f"{width}-{tab}")
        assert sized.evaluate(CLIPPED) == [], tab
        free = sized.locator("section:not([hidden]) .viewer").first.bounding_box()
        if tab in ("annotate", "fit") and width < NARROW:
            side = sized.locator("section:not([hidden]) .side").bounding_box()
            assert free["width"] > 0.95 * width
            assert free["height"] > 0.25 * height
            assert side["y"] >= free["y"] + free["height"] - 1, "the panel is not under the picture"


SCROLLED = """viewer => {
  viewer.scrollIntoView({ block: "end", behavior: "instant" });
  return viewer.getBoundingClientRect().bottom <= innerHeight + 1;
}"""


@pytest.mark.parametrize("size", [(640, 360), (1280, 360), (1000, 700)], ids=lambda size: f"{size[0]}x{size[1]}")
def test_a_low_or_narrow_page_scrolls_and_cuts_nothing_off(open_page, serve, marked, five_point_model, size, artefacts):
    page = open_page(*size)
    as_expert(page)
    page.goto(serve(marked, "--model", str(five_point_model)).address)
    opened(page, NAMES[0])
    side = page.locator("section:not([hidden]) .side").bounding_box()
    skip = page.locator("[data-testid=skip-next]").bounding_box()
    assert skip["x"] + skip["width"] <= side["x"] + side["width"]
    for tab in ("annotate", "fit", "compare"):
        page.locator(f"[data-testid=tab-{tab}]").click()
        viewer = page.locator("section:not([hidden]) .viewer:visible").first
        assert viewer.bounding_box()["height"] >= 240
        page.wait_for_function(SCROLLED, arg=viewer.element_handle())  # again, since a picture may move it as it loads
        shoot(page, artefacts, f"{size[0]}x{size[1]}-{tab}")


@pytest.mark.parametrize("sized", [(1440, 900), *SIZES], indirect=True, ids=lambda size: f"{size[0]}x{size[1]}")
def test_axe_finds_no_violation_in_light_and_dark(sized):
    found = {}

    def look(what):
        for theme in ("light", "dark"):
            sized.emulate_media(color_scheme=theme, reduced_motion="reduce")
            found[f"{what}, {theme}"] = violations(sized)

    seen = []
    for tab in tabs(sized):
        look(tab)
        seen.append(tab)
        assert sized.locator("main:visible").count() == 1
    names = sized.evaluate("() => [...document.querySelectorAll('[role=tab]')].map((tab) => tab.dataset.testid)")
    assert {name.removeprefix("tab-") for name in names} <= set(seen)
    sized.keyboard.press("?")
    sized.locator("dialog").wait_for()
    look("keys")
    assert not any(found.values()), json.dumps(found, indent=1)


PLACES = """() => Object.fromEntries([
    ...document.querySelectorAll(".annotate-side :is(button, select, summary, input, p, .point-list)"),
    ...document.querySelectorAll(":is(.annotate-toolbar, .top, .strip-head) :is(button, select, input)")]
  .filter((element) => element.checkVisibility({ visibilityProperty: true }) && element.textContent !== "")
  .map((element) => [element.dataset.testid ?? element.getAttribute("aria-label") ?? element.textContent, element])
  .map(([name, element]) => [name, element.getBoundingClientRect()])
  .map(([name, { left, top, height }]) => [name, [left, top, height]]))"""


def test_nothing_moves_between_pictures_and_the_main_button_and_ten_points_are_in_view(
    open_page, serve, whole_folder, portraits
):
    for i, scene in enumerate(portraits[:4]):
        points = scene.landmarks[:14]
        points = points if i else np.where(np.arange(14)[:, None] == 3, np.nan, points)  # one is missing
        write_landmarks(whole_folder / f"portrait-{i + 1:02d}.ljson", Landmarks(points))
    page = open_page(1280, 720)
    untrained(page)
    page.goto(serve(whole_folder).address)
    wait_for(page, "() => window.liaamStudio?.annotate?.source()")
    before = {}
    for name in [f"portrait-{i + 1:02d}.png" for i in range(12)]:
        page.evaluate("name => window.liaamStudio.state.select(name)", name)
        opened(page, name)
        places = page.evaluate(PLACES)
        moved = {what: (before[what], place) for what, place in places.items() if before.get(what, place) != place}
        assert moved == {}, name
        before |= places
        button = page.locator("[data-testid=accept-next]").bounding_box()
        assert button["y"] >= 0
        assert button["y"] + button["height"] <= 720
        for index in range(10):
            point = page.locator(f".point[data-index='{index}']").bounding_box()
            inside = page.locator(".point-list").bounding_box()
            assert point["y"] >= inside["y"] and point["y"] + point["height"] <= min(
                inside["y"] + inside["height"], 720
            )
    side = page.locator(".annotate-side")
    side.evaluate("side => side.scrollTo(0, side.scrollHeight)")  # to the template's buttons
    assert page.locator("[data-testid=accept-next]").bounding_box() == button


class Fingers:
    """Touch by the protocol of Chromium, which Playwright has for taps only."""

    def __init__(self, page) -> None:
        self._session = page.context.new_cdp_session(page)

    def send(self, kind: str, *places) -> None:
        points = [{"x": float(x), "y": float(y), "id": i} for i, (x, y) in enumerate(places)]
        self._session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def move(self, start, end, steps: int = 6) -> None:
        """Move all fingers from their start to their end."""
        start, end = np.array(start, dtype=float), np.array(end, dtype=float)
        for k in range(1, steps + 1):
            self.send("touchMove", *(start + (end - start) * k / steps))


def test_touch_drags_a_point_under_a_loupe_and_pinches(open_page, serve, marked, artefacts):
    page = open_page(390, 844, has_touch=True, is_mobile=True)
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    fingers, before = Fingers(page), points_of(page)
    at = np.array(client(page, 4))
    fingers.send("touchStart", at)
    fingers.move([at], [np.add(at, (30, 20))])
    wait_for(page, "() => window.liaamStudio.annotate.loupe()")
    shoot(page, artefacts, "390-loupe")
    fingers.send("touchEnd")
    saved(page)
    moved = points_of(page) - before
    scale = page.evaluate("() => window.liaamStudio.annotate.viewer.scale")
    assert np.abs(moved[4] * scale - (30, 20)).max() < 3
    assert np.abs(moved[:4]).max() == 0
    page_scale = page.evaluate("() => visualViewport.scale")
    middle = np.array(client(page, [120, 160]))
    start = [np.subtract(middle, (40, 0)), np.add(middle, (40, 0))]
    end = [np.subtract(middle, (80, 0)), np.add(middle, (80, 0))]
    fingers.send("touchStart", *start)
    fingers.move(start, end)
    fingers.send("touchEnd")
    wait_for(page, "twice => Math.abs(window.liaamStudio.annotate.viewer.scale - twice) < 0.1 * twice", 2 * scale)
    assert page.evaluate("() => visualViewport.scale") == page_scale, "the page itself was zoomed"
    assert np.abs(client(page, [120, 160]) - middle).max() < 2, "what is between the fingers has moved"
    assert np.abs(points_of(page) - before - moved).max() < 1e-9
    assert not annotate(page, "isDirty()")
