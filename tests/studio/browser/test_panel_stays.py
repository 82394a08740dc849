"""Nothing in the panels moves while messages come and go and lamps are dragged, and nothing covers the picture."""

import shutil

import numpy as np
import pytest
from people import NAMES, open_picture, opened, untrained, wait_for

from liaam.datasets import load_face
from liaam.io import Landmarks, write_image, write_landmarks

pytestmark = pytest.mark.slow

RECTS = """(selectors) => selectors.map((each) => {
  const { left, top, width, height } = document.querySelector(each).getBoundingClientRect();
  return [left, top, width, height].map((value) => Math.round(value));
})"""

PANEL = [
    f"[data-testid={name}]"
    for name in ("train", "accept-next", "skip-next", "point-list", "history", "export-all", "template-edit")
]
LAMP = [
    f"[data-testid={name}]"
    for name in ("fit-run", "opacity-view", "balance", "light-presets", "light-strength", "fit-save")
]


def rects(page, selectors) -> list[list[int]]:
    return page.evaluate(RECTS, selectors)


@pytest.mark.parametrize("size", [(1280, 720), (1440, 900)], ids=lambda size: f"{size[0]}x{size[1]}")
def test_the_points_stay_where_they_are_as_messages_come_and_go(open_page, serve, marked, size):
    page = open_page(*size)
    untrained(page)
    for name in ("portrait-04.png", "portrait-05.png"):  # without landmarks: at the mean shape
        shutil.copy(marked / NAMES[0], marked / name)
    page.goto(serve(marked).address)
    open_picture(page, NAMES[0])
    first = rects(page, PANEL)
    words = page.locator(".assist-words")
    assert not words.evaluate("box => box.scrollHeight > box.clientHeight")
    page.evaluate("() => { document.querySelector('.assist-end').hidden = false; }")  # once all pictures are done
    assert not words.evaluate("box => { box.firstChild.hidden = true; return box.scrollHeight > box.clientHeight; }")
    page.evaluate("() => window.liaamStudio.state.dispatchEvent(new Event('project'))")
    for name in ("portrait-04.png", NAMES[1]):
        open_picture(page, name)
        assert rects(page, PANEL) == first, name
    (marked / "broken.png").write_bytes(b"no picture")  # which becomes a notice, or a picture that cannot be read
    write_landmarks((marked / NAMES[2]).with_suffix(".ljson"), Landmarks(np.tile([[150.0, 100.0]], (5, 1))))  # a slip
    page.evaluate("() => window.dispatchEvent(new Event('focus'))")
    page.wait_for_timeout(1500)
    assert rects(page, PANEL) == first
    (last,) = rects(page, ["[data-testid=template-edit]"])
    assert last[1] + last[3] <= size[1], "the last row of the panel is below the page"


def test_disclosures_open_downwards(serve, page, marked):
    untrained(page)
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    above = PANEL[:4]
    summaries = "[data-testid=history] summary"
    before = [each[:2] for each in rects(page, [*above, summaries])]
    page.locator("[data-testid=history] summary").click()
    page.locator("[data-testid=history] li").first.wait_for()
    assert [each[:2] for each in rects(page, [*above, summaries])] == before
    summary, content = rects(page, [summaries, "[data-testid=history] li"])
    assert content[1] >= summary[1] + summary[3] - 1


def test_nothing_moves_while_lamps_are_added_and_dragged_or_the_view_changes(serve, page, tmp_path):
    folder = tmp_path / "faces"
    folder.mkdir()
    shutil.copy(load_face().image, folder / "lisa.jpg")
    page.goto(serve(folder, face=True).address)
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit")
    always = LAMP[:3]
    steady = rects(page, always)
    for view in ("flat", "shading", "relit"):
        page.locator(f"[data-testid=layer-{view}]").click()
        wait_for(page, "() => window.liaamStudio.fit.hasLayer")
        assert rects(page, always) == steady, view
    before = rects(page, LAMP)
    seen = set()
    for _ in range(3):
        page.locator("[data-testid=lamp-add]").click()
        for key in ("Shift+ArrowDown", "Shift+ArrowRight", "Shift+ArrowDown", "Shift+ArrowLeft", "Shift+ArrowLeft"):
            page.keyboard.press(key)
            seen.add(page.locator("[data-testid=light-words]").inner_text())
            assert rects(page, LAMP) == before
    assert len(seen) > 5


WHOLE = """(tab) => {
  const { viewer } = window.liaamStudio[tab];
  const [left, top] = viewer.toScreen([-0.5, -0.5]);
  const [right, bottom] = viewer.toScreen([viewer.width - 0.5, viewer.height - 0.5]);
  const box = viewer.container.querySelector(".viewer-zoom").getBoundingClientRect();
  const at = viewer.container.getBoundingClientRect();
  const covered = [
    Math.min(right, box.right - at.left) - Math.max(left, box.left - at.left),
    Math.min(bottom, box.bottom - at.top) - Math.max(top, box.top - at.top),
  ];
  return { covered, reach: Math.max((right - left) / at.width, (bottom - top) / at.height) };
}"""


@pytest.mark.parametrize("size", [(390, 844), (820, 1180), (1280, 720)], ids=lambda size: f"{size[0]}x{size[1]}")
@pytest.mark.parametrize("shape", [(480, 640), (640, 480), (500, 500)], ids=["wide", "tall", "square"])
def test_the_buttons_of_the_view_cover_nothing_of_the_whole_picture(open_page, serve, tmp_path, size, shape):
    """Rulers are often at the lower border."""
    folder = tmp_path / "one"
    folder.mkdir()
    write_image(folder / NAMES[0], np.full((*shape, 3), 120, np.uint8))
    write_landmarks(
        (folder / NAMES[0]).with_suffix(".ljson"), Landmarks(np.array([[100.0, 100], [200, 100], [150, 200]]))
    )
    page = open_page(*size, has_touch=size[0] < 900)
    page.goto(serve(folder).address)
    opened(page, NAMES[0])
    found = page.evaluate(WHOLE, "annotate")
    assert min(found["covered"]) <= 0
    assert found["reach"] > 0.8


def test_a_phone_is_told_to_tap_and_saves_without_scrolling(open_page, serve, tmp_path):
    folder = tmp_path / "faces"
    folder.mkdir()
    shutil.copy(load_face().image, folder / "lisa.jpg")
    page = open_page(390, 844, has_touch=True, is_mobile=True)
    page.goto(serve(folder, face=True).address)
    wait_for(page, "() => document.querySelector('.annotate-prompt')?.textContent.includes('tap Accept')")
    assert "Enter" not in page.locator("body").inner_text()
    assert "⏎" not in page.locator("body").inner_text()
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit")
    page.locator("[data-testid=layer-relit]").click()
    (save,) = rects(page, ["[data-testid=fit-save]"])
    assert save[1] >= 0
    assert save[1] + save[3] <= 844
    assert "Enter" not in page.locator("body").inner_text()


COVERED = """() => [...document.querySelectorAll("#tab-fit :is(.toolbar, .viewer-zoom) :is(button, input, summary)")]
  .filter((each) => each.checkVisibility())
  .filter((each) => {
    const { left, top, width, height } = each.getBoundingClientRect();
    const places = [0.1, 0.5, 0.9].map((share) => [left + share * width, top + share * height]);
    const at = ([x, y]) => document.elementFromPoint(x, y)?.closest("button, input, summary");
    return places.some((place) => at(place) !== each);
  }).map((each) => each.outerHTML.slice(0, 90))"""
"""Buttons of Fit that something lies over."""

UNREACHABLE = """() => [...document.querySelectorAll(".fit-menu a, .fit-menu button")]
  .filter((each) => each.offsetParent)
  .filter((each) => {
    each.scrollIntoView({ block: "nearest", behavior: "instant" });
    const { left, top, width, height } = each.getBoundingClientRect();
    return document.elementFromPoint(left + width / 2, top + height / 2) !== each;
  }).map((each) => each.textContent)"""


@pytest.mark.parametrize("height", [844, 664])
def test_all_of_fit_is_reached_and_seen_on_a_phone(open_page, serve, tmp_path, height):
    folder = tmp_path / "faces"
    folder.mkdir()
    shutil.copy(load_face().image, folder / "lisa.jpg")
    page = open_page(390, height, has_touch=True, is_mobile=True)
    page.goto(serve(folder, face=True).address)
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit")
    for view in ("picture", "flat", "balanced", "shading", "relit"):
        page.locator(f"[data-testid=layer-{view}]").click()
        wait_for(page, f"() => '{view}' === 'picture' || window.liaamStudio.fit.hasLayer")
        assert page.evaluate(COVERED) == [], view
        bar = page.locator("#tab-fit .fit-bar")
        assert bar.evaluate("bar => bar.scrollHeight <= bar.clientHeight"), bar.inner_text()
    (save,) = rects(page, ["[data-testid=fit-save]"])
    right = page.evaluate("() => window.liaamStudio.fit.viewer.toClient([window.liaamStudio.fit.viewer.width, 0])[0]")
    assert height < 800 or save[0] >= right, "Save lies over the picture"
    page.locator("[data-testid=export-menu]").click()
    assert page.evaluate(UNREACHABLE) == []
    page.keyboard.press("Escape")
    page.locator("[data-testid=fit-viewer] [data-testid=look]").click()
    box = page.locator("[data-testid=fit-viewer] .look-box").bounding_box()
    picture = page.locator("[data-testid=fit-viewer]").bounding_box()
    assert box["y"] >= picture["y"] + picture["height"] - 1, "the sliders lie over the picture that they change"
    assert box["y"] + box["height"] <= height
    page.locator("[data-testid=fit-viewer] [data-testid=look]").click()
    page.locator("#tab-fit [data-testid=expert]").check()
    assert page.evaluate(COVERED) == [], "expert"


def test_names_of_points_are_whole_on_a_tablet(open_page, serve, marked):
    names = [f"left_eyelid_upper_{i}" for i in range(5)]
    for name in NAMES:
        file = (marked / name).with_suffix(".ljson")
        write_landmarks(file, Landmarks(np.linspace((60, 60), (200, 160), 5), names=names))
    page = open_page(820, 1180, has_touch=True)
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    names = "[...document.querySelectorAll('.point-name')]"
    assert page.evaluate(f"() => {names}.filter((each) => each.scrollWidth > each.clientWidth).length") == 0


def test_no_choice_of_the_list_is_cut(serve, page, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    cut = """() => [...document.querySelectorAll(".strip-head select")].flatMap((select) => {
      if (!select.offsetParent) return [];
      const ctx = new OffscreenCanvas(1, 1).getContext("2d");
      const style = getComputedStyle(select);
      ctx.font = `${style.fontWeight} ${style.fontSize} ${style.fontFamily}`;
      const arrow = 22; // css pixels
      const room = select.clientWidth - parseFloat(style.paddingLeft) - arrow;
      const widths = [...select.options].map(({ text }) => [text, ctx.measureText(text).width]);
      return widths.filter(([, width]) => width > room);
    })"""
    assert page.evaluate(cut) == []
