"""Begin without annotating: the first screen, a dropped model, and lamps, in a real browser."""

import base64
import json
import re

import numpy as np
import pytest
from people import shoot, wait_for
from test_fit_tab import PIXEL, dropped, hook
from test_layout import CLIPPED, SIZES

from liaam.io import write_image
from liaam.studio.settings import STATIC
from liaam.training import train

pytestmark = pytest.mark.slow

DROP_ANYWHERE = """([data, name]) => {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const transfer = new DataTransfer();
  transfer.items.add(new File([bytes], name));
  document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
}"""

RELIT = """() => window.liaamStudio.fit.view === "relit" && window.liaamStudio.fit.hasLayer
  && !window.liaamStudio.fit.relightBusy"""


BLANK = """() => [...document.querySelectorAll("#tab-fit .panel, #tab-fit .fit-bar")]
  .filter((each) => each.checkVisibility() && !each.innerText.trim()).map((each) => each.outerHTML)"""


@pytest.fixture
def empty(tmp_path):
    """Give an empty folder."""
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


@pytest.fixture(scope="session")
def model_bytes(portraits):
    """Give the content of a file of a model of the portraits."""
    return train(
        [(scene.image, scene.landmarks) for scene in portraits[:8]], leave_out=False, methods="all", lamps=None
    ).to_bytes()


def drop_anywhere(page, name: str, data: bytes) -> None:
    page.evaluate(DROP_ANYWHERE, [base64.b64encode(data).decode(), name])


def model_of(page) -> dict | None:
    return page.evaluate("() => window.liaamStudio.state.project.model")


SIDES = """() => {
  const { canvas } = window.liaamStudio.first;
  const ctx = canvas.getContext("2d");
  const brightness = (x) => ctx.getImageData(x, 280, 40, 60).data.reduce((sum, value) => sum + value);
  return [brightness(230), brightness(370)];
}"""
"""Brightness of either cheek."""


def test_the_first_screen_is_a_face_whose_light_follows_the_pointer(serve, page, empty, artefacts):
    page.goto(serve(empty, face=True).address)
    wait_for(page, "() => window.liaamStudio.first?.frames > 0")
    shoot(page, artefacts, "29-first")
    assert page.locator(".side:visible, .toolbar:visible, .strip:visible").count() == 0
    box = page.locator("[data-testid=first-picture]").bounding_box()
    ratios = []
    for x in (0.1, 0.9):
        frames = page.evaluate("() => window.liaamStudio.first.frames")
        page.mouse.move(box["x"] + x * box["width"], box["y"] + 0.4 * box["height"])
        wait_for(page, "frames => window.liaamStudio.first.moved && window.liaamStudio.first.frames > frames", frames)
        left, right = page.evaluate(SIDES)
        ratios.append(left / right)
    assert ratios[0] > 1.3 > 1 / 1.3 > ratios[1]
    page.locator("[data-testid=first-lamp]").press("Home")
    assert "from the front" in page.locator("[data-testid=first-lamp]").get_attribute("aria-valuetext")
    wait_for(page, "() => window.liaamStudio.state.project.model?.source === 'face'")  # fits at once
    page.locator("[data-testid=first-fit]").click()
    wait_for(page, RELIT)
    assert hook(page, "fit.quality") > 0.9
    assert list(empty.glob("[!.]*")) == []
    page.locator("[data-testid=tab-annotate]").click()
    page.locator("[data-testid=first-camera]").click()
    page.locator("[data-testid=tab-live][aria-selected=true]").wait_for()


def test_a_dropped_portrait_is_shown_under_a_lamp_and_its_landmarks_are_a_click_away(serve, page, empty, artefacts):
    page.goto(serve(empty, face=True).address)
    page.wait_for_selector("[role=tab][aria-selected=true]")
    wait_for(page, "() => window.liaamStudio?.state.project?.model?.source === 'face'")
    drop_anywhere(page, "me.jpg", (STATIC / "first" / "face.jpg").read_bytes())
    wait_for(page, RELIT)
    shoot(page, artefacts, "29-portrait")
    assert not (empty / "me.jpg").exists()
    with page.expect_download() as download:
        page.locator("[data-testid=fit-save]").click()
    assert download.value.suggested_filename == "me_relit.png"
    page.locator("[data-testid=fit-place]").click()
    page.locator("[data-testid=tab-annotate][aria-selected=true]").wait_for()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'proposal'")
    assert (empty / "me.jpg").exists()


def test_a_dropped_picture_of_anything_else_is_added(serve, page, empty, rng):
    page.goto(serve(empty, face=True).address)
    page.wait_for_selector("[role=tab][aria-selected=true]")
    wait_for(page, "() => window.liaamStudio?.state.project?.model?.source === 'face'")
    write_image(empty.parent / "noise.png", rng.integers(0, 256, (120, 160, 3)).astype(np.uint8))
    drop_anywhere(page, "noise.png", (empty.parent / "noise.png").read_bytes())
    page.locator(".toast", has_text="1 picture added.").wait_for()
    page.locator("[data-testid=tab-annotate][aria-selected=true]").wait_for()
    assert (empty / "noise.png").exists()


def test_a_dropped_model_fits_pictures_without_a_template(serve, page, folder, model_bytes, artefacts):
    before = sorted(path.name for path in folder.iterdir())
    page.goto(serve(folder).address)
    page.wait_for_selector("[role=tab][aria-selected=true]")
    drop_anywhere(page, "kate.liaam", model_bytes)  # on the tab Annotate
    wait_for(page, "() => window.liaamStudio.fit.fit?.picture === 'portrait-01.png'")
    assert page.locator("[data-testid=top-model]").inner_text() == "Fit only: kate"
    assert "fitted with kate.liaam (58 points)" in page.locator("[data-testid=guest]").inner_text()
    page.locator("[data-testid=export-menu]").click()
    assert page.locator("[data-testid=export-annotation]").is_hidden()
    shoot(page, artefacts, "30-guest")
    page.goto(page.url.partition("?")[0] + "?tab=annotate")  # the mode stays after a reload
    wait_for(page, "() => window.liaamStudio.fit?.fit?.picture === 'portrait-01.png'")
    page.locator("[data-testid=tab-annotate]").wait_for(state="hidden")
    page.locator("[data-testid=leave-guest]").click()
    page.locator("[data-testid=tab-annotate][aria-selected=true]").wait_for()
    assert model_of(page) is None
    assert sorted(path.name for path in folder.iterdir() if not path.name.startswith(".")) == before


def test_a_broken_model_is_refused_and_the_page_stays(serve, page, empty, model_bytes):
    page.goto(serve(empty).address)
    page.wait_for_selector("[role=tab][aria-selected=true]")
    for name, data in (("half.liaam", model_bytes[:-1000]), ("text.liaam", b"no model")):
        drop_anywhere(page, name, data)
        page.locator(".toast.bad", has_text=name).wait_for()
    assert "not a complete liaam model" in page.locator(".toast.bad").first.inner_text()
    assert model_of(page) is None
    assert page.locator("[data-testid=tab-annotate]").get_attribute("aria-selected") == "true"


@pytest.fixture
def relight(serve, page, empty, model_bytes, lit_portrait, tmp_path):
    """Give the page with a dropped picture in the view Relight."""
    write_image(tmp_path / "lit.png", lit_portrait.image)
    page.goto(serve(empty).address)
    page.wait_for_selector("[role=tab][aria-selected=true]")
    drop_anywhere(page, "kate.liaam", model_bytes)
    wait_for(page, "() => window.liaamStudio.state.project.model")
    dropped(page, tmp_path / "lit.png")
    page.locator("[data-testid=layer-relit]").click()
    wait_for(page, RELIT)
    return page


def lamps(page) -> list[dict]:
    return hook(page, "light.lamps")


def test_lamps_are_moved_by_the_mouse_and_change_the_right_half(relight):
    assert relight.locator("[data-testid=divider]").is_visible()
    shape = np.array(hook(relight, "fit.shape"))
    x, y = shape.mean(axis=0)
    left, right = (hook(relight, f"viewer.toScreen([{x + 0.1 * side * np.ptp(shape)}, {y}])") for side in (-1, 1))
    divider = relight.locator("[data-testid=divider]").bounding_box()
    viewer = relight.locator("[data-testid=fit-viewer]").bounding_box()
    assert left[0] + viewer["x"] < divider["x"] + divider["width"] / 2 < right[0] + viewer["x"]
    before = [relight.evaluate(PIXEL, place) for place in (left, right)]
    ball, lamp = (relight.locator(f"[data-testid={name}]").bounding_box() for name in ("light-stage", "lamp"))
    middle, grip = ((box["x"] + box["width"] / 2, box["y"] + box["height"] / 2) for box in (ball, lamp))
    face = hook(relight, f"viewer.toClient([{x}, {y}])")
    assert np.hypot(middle[0] - face[0], middle[1] - face[1]) < 0.2 * ball["width"]  # the lamp is over the face
    relight.mouse.move(*grip)
    relight.mouse.down()
    relight.mouse.move(*middle)
    assert lamps(relight)[0]["direction"] == pytest.approx([0, 0, 1], abs=0.02)
    relight.mouse.move(middle[0] - 0.45 * ball["width"], middle[1], steps=4)
    relight.mouse.up()
    direction = lamps(relight)[0]["direction"]
    assert direction[0] < -0.85
    assert "from the left" in relight.locator("[data-testid=light-words]").inner_text()
    wait_for(relight, f"before => String(({PIXEL})([{right[0]}, {right[1]}])) !== String(before)", before[1])
    assert relight.evaluate(PIXEL, left) == before[0]


AREA = """([left, top, width, height]) => {
  const { canvas } = window.liaamStudio.fit.viewer;
  const ratio = canvas.width / canvas.clientWidth;
  const [own, outer] = [canvas, canvas.parentElement].map((element) => element.getBoundingClientRect());
  const at = [left + outer.left - own.left, top + outer.top - own.top, width, height].map((v) => Math.round(ratio * v));
  return [...canvas.getContext("2d").getImageData(...at).data];
}"""
# At once: on a slow machine, the lamp would rest between two moves of a mouse.
MOVES = """([from, to]) => {
  const lamp = document.querySelector("[data-testid=lamp]");
  for (const share of [0.2, 0.4, 0.6, 0.8, 1]) {
    const [clientX, clientY] = [0, 1].map((axis) => from[axis] + share * (to[axis] - from[axis]));
    lamp.dispatchEvent(new PointerEvent("pointermove", { pointerId: 1, bubbles: true, buttons: 1, clientX, clientY }));
  }
  return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
}"""


def test_a_moved_lamp_is_shown_at_once_as_it_is_when_it_rests(relight):
    wait_for(relight, "() => !window.liaamStudio.fit.relightBusy")
    relight.wait_for_load_state("networkidle")
    shape = np.array(hook(relight, "fit.shape"))
    corners = [shape.min(axis=0).tolist(), shape.max(axis=0).tolist()]
    (left, top), (right, bottom) = (hook(relight, f"viewer.toScreen({corner})") for corner in corners)
    middle = (left + right) / 2
    area = [middle + 20, top + 40, right - middle - 40, bottom - top - 80]
    before = np.array(relight.evaluate(AREA, area), float)
    asked, held, moving = [], [], True

    def answer(route):
        asked.append(route)
        # Not answered yet: a slow machine may ask before the button is released.
        if moving:
            held.append(route)
        else:
            route.continue_()

    relight.route(re.compile("/relit"), answer)
    lamp = relight.locator("[data-testid=lamp]").bounding_box()
    ball = relight.locator("[data-testid=light-stage]").bounding_box()
    start = [lamp["x"] + lamp["width"] / 2, lamp["y"] + lamp["height"] / 2]
    relight.mouse.move(*start)
    relight.mouse.down()
    relight.evaluate(MOVES, [start, [ball["x"] + 0.85 * ball["width"], ball["y"] + 0.6 * ball["height"]]])
    rough = np.array(relight.evaluate(AREA, area), float)
    assert len(asked) <= 1  # not one a movement
    moving = False
    for route in held:
        route.continue_()
    relight.mouse.up()
    wait_for(relight, "() => !window.liaamStudio.fit.relightBusy")
    relight.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    exact = np.array(relight.evaluate(AREA, area), float)
    assert 1 <= len(asked) <= 2
    assert np.abs(rough - exact).mean() < 0.15 * np.abs(before - exact).mean()


def test_lamps_are_moved_added_and_removed_by_keys(relight):
    lamp = relight.locator("[data-testid=lamp]")
    lamp.focus()
    relight.keyboard.press("Home")
    relight.keyboard.press("Shift+ArrowRight")
    assert lamps(relight)[0]["direction"][:2] == pytest.approx([0.15, 0])
    relight.locator("[data-testid=lamp-add]").press("Enter")
    assert len(lamps(relight)) == 2
    relight.keyboard.press("ArrowDown")  # the new lamp has the focus
    assert hook(relight, "light.selected") == 1
    assert lamps(relight)[0]["direction"][:2] == pytest.approx([0.15, 0])
    relight.locator("[data-testid=lamp-colour]").fill("#ff0000")
    with relight.expect_request(lambda request: "/relit" in request.url and "%5B1%2C0%2C0%5D" in request.url):
        relight.locator("[data-testid=light-strength]").press("End")
    assert (lamps(relight)[1]["colour"], lamps(relight)[1]["strength"]) == ("#ff0000", 3)
    relight.locator("[data-testid=light-softness]").press("End")
    assert lamps(relight)[1]["softness"] == 1
    relight.locator("[data-testid=lamp-remove]").press("Enter")
    assert len(lamps(relight)) == 1
    relight.locator("[data-testid=light-presets]").select_option("Two colours")
    assert relight.locator("[data-testid=lamp]").count() == 2
    wait_for(relight, RELIT)
    relight.locator("[data-testid=light-presets]").select_option("One lamp")
    assert relight.locator("[data-testid=lamp]").count() == 1


def test_a_light_is_exported_as_it_is_shown(relight):
    relight.locator("[data-testid=light-presets]").select_option("Candle")
    relight.locator("[data-testid=export-menu]").click()
    with relight.expect_download() as download:
        relight.locator("[data-testid=export-relit]").click()
    assert download.value.suggested_filename == "lit_relit.png"
    assert "%22softness%22%3A0.3" in relight.locator("[data-testid=export-relit]").get_attribute("href")


HIDDEN_IN_BOX = """() => {
  const box = document.querySelector('[data-testid=fit-viewer] .look-box');
  const { left, top, width, height } = box.getBoundingClientRect();
  const step = (i) => (i + 0.5) / 20;
  const places = [...Array(400).keys()].map((i) =>
    [left + step(i % 20) * width, top + step(Math.floor(i / 20)) * height]);
  const found = places.map(([x, y]) => document.elementFromPoint(x, y));
  return found.filter((element) => !box.contains(element)).map(({ className }) => className);
}"""
"""What lies over the box with brightness and contrast."""


@pytest.mark.parametrize(("size", "theme"), list(zip(SIZES, ("light", "dark", "light"), strict=True)))
def test_the_first_screen_and_the_lamps_fit_every_screen(browser, serve, empty, size, theme, artefacts):
    from axe_playwright_python.sync_playwright import Axe

    options = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]}}
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]},
        has_touch=size[0] < 900,
        color_scheme=theme,
        reduced_motion="reduce",
    )
    page = context.new_page()
    page.set_default_timeout(20_000)
    page.goto(serve(empty, face=True).address)
    page.locator("[data-testid=first-fit]:visible").wait_for()
    wait_for(page, "() => window.liaamStudio?.first?.frames > 0")  # the lamp is in its place

    def check(name: str) -> None:
        shoot(page, artefacts, f"{size[0]}-{theme}-{name}")
        assert page.evaluate(CLIPPED) == [], name
        found = Axe().run(page, options=options).response["violations"]
        assert not found, json.dumps({each["id"]: [node["html"] for node in each["nodes"]] for each in found})

    check("first")
    wait_for(page, "() => window.liaamStudio.state.project.model")
    page.locator("[data-testid=first-fit]").click()
    wait_for(page, RELIT)
    check("face")
    page.locator("[data-testid=light-presets]").select_option("Two colours")
    wait_for(page, RELIT)
    check("lamps")
    page.locator("[data-testid=fit-viewer] [data-testid=look]").click()
    assert page.locator("[data-testid=fit-viewer] .look-box .number:visible").count() == 3
    assert page.evaluate(HIDDEN_IN_BOX) == [], "something is drawn over the box"
    check("brightness")
    context.close()
