"""The Fit and Compare tabs in a real browser: what comes in, what is shown, and what the server is asked."""

import base64
from pathlib import Path

import numpy as np
import pytest
from people import as_expert, shoot, wait_for, wait_until

from liaam.io import read_landmarks, write_image, write_landmarks

pytestmark = pytest.mark.slow

DROP = """([data, name]) => {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const transfer = new DataTransfer();
  transfer.items.add(new File([bytes], name));
  const event = new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true });
  document.querySelector("[data-testid=fit-drop]").dispatchEvent(event);
}"""

PIXEL = """([x, y]) => {
  const { canvas, container } = window.liaamStudio.fit.viewer; // the canvas goes on under the panels
  const [outer, inner] = [canvas, container].map((element) => element.getBoundingClientRect());
  const at = [x + inner.left - outer.left, y + inner.top - outer.top];
  const pixels = at.map((value) => Math.round((value * canvas.width) / canvas.clientWidth));
  return [...canvas.getContext("2d").getImageData(...pixels, 1, 1).data];
}"""

UNNAMED = """() => [...document.querySelectorAll("#tab-fit :is(button, input, select, a, canvas, [role=slider])")]
  .filter((each) => each.offsetParent && !each.closest("[aria-hidden=true]"))
  .filter((each) => !each.getAttribute("aria-label") && !(each.closest("label") ?? each).textContent.trim())
  .map((each) => each.outerHTML)"""


@pytest.fixture
def lit_file(lit_portrait, tmp_path) -> Path:
    """Give the picture under hard light as a file outside the folder."""
    path = tmp_path / "lit.png"
    write_image(path, lit_portrait.image)
    return path


@pytest.fixture
def fit_tab(serve, page, folder, portraits, portrait_model):
    """Give the page with the Fit tab open on the first portrait, of which the landmarks are known."""
    write_landmarks(folder / "portrait-01.pts", portraits[0].landmarks)
    as_expert(page)
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    page.wait_for_selector("[role=tab][aria-selected=true]")
    page.locator("[data-testid=strip] [data-name='portrait-01.png']").click()
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit?.picture === 'portrait-01.png'")
    return page


def hook(page, what: str):
    """Ask the Fit tab's hooks."""
    return page.evaluate(f"() => window.liaamStudio.fit.{what}")


def drop(page, path: Path) -> None:
    """Drop a file onto the tab."""
    page.evaluate(DROP, [base64.b64encode(path.read_bytes()).decode(), path.name])


def dropped(page, path: Path) -> dict:
    """Drop a file, and give the fit that comes of it."""
    drop(page, path)
    wait_for(page, "() => window.liaamStudio.fit.fit?.upload && window.liaamStudio.fit.lastDropMs !== null")
    return hook(page, "fit")


FRAME = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"


def wait_for_layer(page, name: str) -> None:
    """Wait until a view with an image of its own is painted."""
    wait_for(page, "name => window.liaamStudio.fit.view === name && window.liaamStudio.fit.hasLayer", name)
    page.evaluate(FRAME)


def centre(page, testid: str) -> tuple[float, float]:
    """Middle of a control on the page."""
    box = page.locator(f"[data-testid={testid}]").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_a_dropped_picture_is_fitted_with_its_upload(fit_tab, lit_file, lit_portrait, artefacts):
    asked = []
    fit_tab.on("request", lambda request: asked.append((request.method, request.url.split("/api/")[-1].split("?")[0])))
    before = fit_tab.evaluate("() => performance.now()")
    fit = dropped(fit_tab, lit_file)
    elapsed = fit_tab.evaluate("() => performance.now()") - before
    assert fit["ok"], fit["message"]
    assert np.linalg.norm(np.array(fit["shape"]) - lit_portrait.landmarks, axis=1).mean() < 5.0
    # What the page says of its speed holds the server's work, and is of this drop.
    assert 1000 * (fit["seconds"]["search"] + fit["seconds"]["fit"]) < hook(fit_tab, "lastDropMs") <= elapsed
    assert [each for each in asked if each[0] == "POST"] == [("POST", "uploads")]
    # It was shown from the file: the picture itself was not asked back from the server.
    assert not [what for _, what in asked if what.startswith("uploads/") and what.endswith("/image")]
    assert fit_tab.evaluate(UNNAMED) == []
    shoot(fit_tab, artefacts, "20-dropped")


def test_a_file_that_is_no_picture_is_refused_and_the_fit_before_stays(fit_tab, tmp_path):
    (tmp_path / "notes.png").write_text("no picture")
    before = hook(fit_tab, "fit.id")
    drop(fit_tab, tmp_path / "notes.png")
    fit_tab.wait_for_selector("[data-testid=fit-status] .error-text")
    assert "notes.png" in fit_tab.locator("[data-testid=fit-status]").inner_text()
    assert hook(fit_tab, "fit.id") == before
    assert fit_tab.locator(".toast").count() == 0
    fit_tab.keyboard.press("d")  # the panel slides away
    drop(fit_tab, tmp_path / "notes.png")
    fit_tab.locator(".toast.bad", has_text="notes.png").wait_for()


def test_theta_is_dragged_and_moved_by_keys(fit_tab, lit_file, artefacts):
    dropped(fit_tab, lit_file)
    fit_tab.locator("[data-testid=layer-invariant]").click()
    wait_for_layer(fit_tab, "invariant")
    slider = fit_tab.locator("[data-testid=theta-slider]")
    box = slider.bounding_box()
    place = [box["width"] * 0.5, box["height"] / 2]
    seen = set()
    fit_tab.mouse.move(box["x"] + place[0], box["y"] + place[1])
    fit_tab.mouse.down()
    middle = hook(fit_tab, "viewer.toScreen([320, 200])")
    for step in range(20):
        fit_tab.mouse.move(box["x"] + place[0] + 5 * step, box["y"] + place[1])
        fit_tab.evaluate("() => new Promise(requestAnimationFrame)")
        seen.add(tuple(fit_tab.evaluate(PIXEL, middle)))
    fit_tab.mouse.up()
    assert len(seen) > 5, "the invariant image does not follow theta"
    assert hook(fit_tab, "invariantFps()") > 0
    theta = hook(fit_tab, "theta")
    slider.focus()
    fit_tab.keyboard.press("ArrowRight")
    fit_tab.keyboard.press("Shift+ArrowLeft")
    assert hook(fit_tab, "theta") == pytest.approx(theta + 0.9, abs=0.051)
    shoot(fit_tab, artefacts, "21-invariant")


def test_the_divider_has_the_picture_at_its_left(fit_tab, lit_file, artefacts):
    fit = dropped(fit_tab, lit_file)
    x, y = np.mean(fit["shape"], axis=0)
    place = hook(fit_tab, f"viewer.toScreen([{x}, {y}])")
    plain = fit_tab.evaluate(PIXEL, place)
    fit_tab.locator("[data-testid=layer-flat]").click()
    fit_tab.locator("[data-testid=fit-split]").click()  # it is on at first
    for overlay in ("landmarks", "mesh"):
        assert fit_tab.locator(f"[data-testid=layer-{overlay}]").get_attribute("aria-pressed") == "false"
    wait_for_layer(fit_tab, "flat")
    flat = fit_tab.evaluate(PIXEL, place)
    assert flat != plain
    hint = fit_tab.locator(".fit-hint")
    fit_tab.locator("[data-testid=layer-relit]").click()
    assert fit_tab.locator("[data-testid=fit-split]").get_attribute("aria-pressed") == "false"  # as in Flat
    assert "Drag the lamp" in hint.inner_text() and "line" not in hint.inner_text()
    fit_tab.locator("[data-testid=fit-split]").click()
    assert "and the line between before and after" in hint.inner_text()
    fit_tab.locator("[data-testid=fit-split]").click()
    fit_tab.locator("[data-testid=layer-flat]").click()
    fit_tab.locator("[data-testid=fit-split]").click()
    divider = fit_tab.locator("[data-testid=divider]")
    viewer = fit_tab.locator("[data-testid=fit-viewer]").bounding_box()
    for target, expected in ((place[0] + 90, plain), (place[0] - 90, flat)):
        fit_tab.mouse.move(*centre(fit_tab, "divider"))
        fit_tab.mouse.down()
        fit_tab.mouse.move(viewer["x"] + target, viewer["y"] + 90, steps=3)
        fit_tab.mouse.up()
        assert abs(int(divider.get_attribute("aria-valuenow")) - 100 * target / viewer["width"]) < 2
        fit_tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert np.abs(np.array(fit_tab.evaluate(PIXEL, place)) - expected).max() <= 2
    at = int(divider.get_attribute("aria-valuenow"))
    fit_tab.keyboard.press("ArrowRight")
    assert int(divider.get_attribute("aria-valuenow")) == at + 2
    shoot(fit_tab, artefacts, "22-divider")


MOVES = """([x, y]) => {
  const lamp = document.querySelector("[data-testid=lamp]");
  for (let step = 0; step < 40; step += 1) {
    const at = { clientX: x + step, clientY: y + 0.5 * step };
    lamp.dispatchEvent(new PointerEvent("pointermove", { ...at, pointerId: 1, bubbles: true }));
  }
}"""


def test_a_moved_light_asks_for_one_picture_when_it_rests(fit_tab, lit_file, lit_portrait):
    dropped(fit_tab, lit_file)
    asked, waiting, moving = [], [], False

    def give(route):
        route.fulfill(path=str(lit_file), content_type="image/png")

    def answer(route):
        asked.append(route.request.url)
        if moving:
            waiting.append(route)
        else:
            give(route)

    fit_tab.route("**/relit?*", answer)
    fit_tab.locator("[data-testid=layer-relit]").click()
    wait_for_layer(fit_tab, "relit")
    wait_for(fit_tab, "() => !window.liaamStudio.fit.relightBusy")
    x, y = centre(fit_tab, "lamp")
    moving, before = True, len(asked)
    fit_tab.mouse.move(x, y)
    fit_tab.mouse.down()
    fit_tab.evaluate(MOVES, [x, y])
    fit_tab.mouse.up()
    wait_until(fit_tab, lambda: waiting)
    moving = False
    (first,) = waiting  # while the lamp moved, the browser computed its light
    give(first)
    wait_for(fit_tab, "() => !window.liaamStudio.fit.relightBusy")
    assert len(asked) == before + 1
    light = hook(fit_tab, "light")
    (lamp,) = light["lamps"]
    assert f"{round(lamp['direction'][0], 4)}" in asked[-1]
    assert np.linalg.norm(lamp["direction"]) == pytest.approx(1)
    fit_tab.keyboard.press("ArrowLeft")
    assert hook(fit_tab, "light.lamps[0].direction[0]") < lamp["direction"][0]


def test_a_box_and_the_mean_shape_are_starts(fit_tab, artefacts):
    asked = []
    fit_tab.on("request", lambda request: asked.append(request) if request.url.endswith("/api/fits") else None)
    viewer = fit_tab.locator("[data-testid=fit-viewer]").bounding_box()
    shape = np.array(hook(fit_tab, "fit.shape"))
    corners = [hook(fit_tab, f"viewer.toScreen([{x}, {y}])") for x, y in (shape.min(axis=0), shape.max(axis=0))]
    fit_tab.locator("[data-testid=start-box]").click()
    fit_tab.mouse.move(viewer["x"] + corners[0][0], viewer["y"] + corners[0][1])
    fit_tab.mouse.down()
    fit_tab.mouse.move(viewer["x"] + corners[1][0], viewer["y"] + corners[1][1], steps=3)
    with fit_tab.expect_response("**/api/fits"):
        fit_tab.mouse.up()
    box = asked[-1].post_data_json["start"]["box"]
    assert np.abs(np.array(box) - [*shape.min(axis=0), *shape.max(axis=0)]).max() < 1.0
    fit_tab.locator("[data-testid=start-mean]").click()
    wait_for(fit_tab, "() => window.liaamStudio.fit.start?.shape")
    before = np.array(hook(fit_tab, "start.shape"))
    fit_tab.keyboard.press("Shift+ArrowDown")
    after = np.array(hook(fit_tab, "start.shape"))
    assert np.abs(after - before - [0, 10]).max() < 1e-6
    shoot(fit_tab, artefacts, "23-mean-shape")
    with fit_tab.expect_response("**/api/fits"):
        fit_tab.locator("[data-testid=fit-viewer] canvas").press("Enter")
    assert np.abs(np.array(asked[-1].post_data_json["start"]["shape"]) - after).max() < 1e-6


def test_iterations_are_walked_through(fit_tab):
    fit = hook(fit_tab, "fit")
    slider = fit_tab.locator("[data-testid=fit-iterations]")
    assert int(slider.get_attribute("max")) == len(fit["iterations"]) - 1
    slider.fill("0")
    assert hook(fit_tab, "shownShape") == fit["iterations"][0]["shape"]
    assert "level 0" in slider.get_attribute("aria-valuetext")
    slider.press("End")
    assert hook(fit_tab, "shownShape") == fit["shape"]


def test_a_fit_becomes_the_annotation_after_asking(fit_tab, folder, portraits):
    shape = np.array(hook(fit_tab, "fit.shape"))
    fit_tab.locator("[data-testid=export-menu]").click()
    fit_tab.locator("[data-testid=export-annotation]").click()
    with fit_tab.expect_response(lambda response: response.request.method == "PUT") as saved:
        fit_tab.locator("[data-testid=confirm]").click()
    assert saved.value.ok
    assert np.abs(read_landmarks(folder / "portrait-01.pts").points - shape).max() < 0.01


def test_a_fit_is_coloured_by_its_status_and_compared_by_quality(fit_tab, lit_file):
    """The server's answers are changed, so that the fits end with the wanted quality."""

    def answer(route):
        answered = route.fetch().json()
        fit = answered.get("fit", answered)  # of an upload, or alone
        quality = {"soft-li": 0.6, "rgb": 0.7}[fit["method"]]
        fit |= {"quality": quality, "status": "converged", "ok": True, "found": None}
        route.fulfill(json=answered)

    for address in ("**/api/fits", "**/api/uploads?*"):
        fit_tab.route(address, answer)
    dropped(fit_tab, lit_file)
    fit_tab.locator("[data-testid=fit-status] .badge.good", has_text="converged, quality 60 %").wait_for()
    fit_tab.locator("[data-testid=tab-compare]").click()
    verdict = fit_tab.locator("[data-testid=compare-verdict]")
    verdict.get_by_text("rgb is more likely to be right: quality 70 %, soft-li: 60 %").wait_for()
    fit_tab.locator("[data-testid=compare-right].nearer").wait_for()


def test_the_objects_of_a_picture_are_fitted_in_turn(fit_tab, lit_file):
    asked, done, boxes = [], [], [[10.0, 20.0, 90.0, 120.0], [30.0, 20.0, 110.0, 130.0]]

    def answer(route):
        asked.append((route.request.post_data_json or {}).get("start") if "/fits" in route.request.url else None)
        answered = route.fetch().json()
        if asked[-1] is None:  # of a search, whose answer is changed to one of two objects
            found = {"score": 1.0, "doubtful": False}
            answered.get("fit", answered).update(n_found=2, objects=boxes, found=found, quality=0.9)
        route.fulfill(json=answered)
        done.append(route)

    for address in ("**/api/fits", "**/api/uploads?*"):
        fit_tab.route(address, answer)
    dropped(fit_tab, lit_file)
    for place in (".fit-hint", "[data-testid=fit-status]"):
        fit_tab.locator(place, has_text="1 more object in the picture").wait_for()
    following = fit_tab.get_by_role("button", name="Next object")
    for box in (boxes[1], boxes[0]):
        following.click()
        wait_until(fit_tab, lambda box=box: asked[-1] == {"box": box} and len(done) == len(asked))
    assert following.is_visible()


def test_all_specimens_of_a_picture_are_shown_and_selected(fit_tab, artefacts):
    """The answers are changed to those of a picture with two specimens: the second one lies a little lower."""
    boxes = [[10.0, 20.0, 90.0, 120.0], [30.0, 20.0, 110.0, 130.0]]

    def of_two(route):
        answered = route.fetch().json()
        answered.update(n_found=2, objects=boxes, found={"score": 1.0, "doubtful": False}, quality=0.9)
        route.fulfill(json=answered)

    def all_of_them(route):
        first = hook(fit_tab, "fit")
        lower = [point and [point[0], point[1] + 25] for point in first["shape"]]
        both = [
            first | {"specimen": {"number": 1, "name": "tray#1", "fault": ""}},
            first | {"shape": lower, "specimen": {"number": 2, "name": "tray#2", "fault": "it touches tray#1"}},
        ]
        route.fulfill(json={"fits": both, "faults": ["tray#1 and tray#2 touch, or nearly"]})

    fit_tab.route("**/api/fits", of_two)
    fit_tab.route("**/api/fits/all", all_of_them)
    fit_tab.locator("[data-testid=fit-run]").click()
    fit_tab.locator("[data-testid=fit-all]").click()
    rows = fit_tab.locator("[data-testid=fit-specimen]")
    rows.nth(1).wait_for()
    assert [text.partition(":")[0] for text in rows.all_inner_texts()] == ["tray#1", "tray#2"]
    assert rows.nth(0).get_attribute("aria-pressed") == "true"
    fit_tab.get_by_text("tray#1 and tray#2 touch, or nearly").wait_for()
    upper = hook(fit_tab, "fit")["shape"]
    rows.nth(1).click()
    assert rows.nth(1).get_attribute("aria-pressed") == "true"
    assert hook(fit_tab, "fit")["shape"][0][1] == upper[0][1] + 25
    shoot(fit_tab, artefacts, "fit-specimens")
    fit_tab.locator("[data-testid=export-menu]").click()
    assert "fits=" in fit_tab.locator("[data-testid=export-table]").get_attribute("href")
    fit_tab.keyboard.press("Escape")
    fit_tab.locator("[data-testid=fit-run]").click()  # a fit of one again
    rows.nth(0).wait_for(state="detached")


def test_two_methods_are_compared(fit_tab, artefacts):
    fit_tab.locator("[data-testid=tab-compare]").click()
    wait_for(
        fit_tab,
        "() => /is closer|Equal errors/.test(document.querySelector('[data-testid=compare-verdict]').textContent)",
    )
    sides = [fit_tab.evaluate(f"() => window.liaamStudio.compare.{side}.fit") for side in ("left", "right")]
    nearer = min(sides, key=lambda fit: fit["error"]["pixels"])
    assert sides[0]["method"] != sides[1]["method"]
    verdict = fit_tab.locator("[data-testid=compare-verdict]").inner_text()
    assert verdict.startswith(f"{nearer['method']} is closer")
    views = "() => [window.liaamStudio.compare.left.viewer.view, window.liaamStudio.compare.right.viewer.view]"
    start = fit_tab.evaluate(views)
    fit_tab.locator("[data-testid=compare-right] canvas").hover()
    fit_tab.mouse.wheel(0, -300)
    wait_for(fit_tab, f"(scale) => ({views})()[0].scale > scale", start[0]["scale"])
    wait_for(fit_tab, f"() => {{ const [a, b] = ({views})(); return JSON.stringify(a) === JSON.stringify(b); }}")
    fit_tab.locator("[data-testid=compare-swap]").click()
    ids = "[window.liaamStudio.compare.left.fit?.id, window.liaamStudio.compare.right.fit?.id]"
    wait_for(fit_tab, f"wanted => String({ids}) === String(wanted)", [fit["id"] for fit in reversed(sides)])
    shoot(fit_tab, artefacts, "24-compare")


COUNT_SCALINGS = """() => {
  const draw = CanvasRenderingContext2D.prototype.drawImage;
  window.scalings = 0;
  CanvasRenderingContext2D.prototype.drawImage = function (image, ...where) {
    if (image instanceof HTMLImageElement || image instanceof ImageBitmap) window.scalings += 1;
    return draw.call(this, image, ...where);
  };
}"""


def test_a_picture_is_scaled_once_for_a_view(fit_tab):
    """What is drawn over it changes far more often than the view, and scaling is what takes the time."""
    page = fit_tab
    page.evaluate(FRAME)
    at = page.evaluate("() => window.liaamStudio.fit.viewer.toScreen([5, 5])")  # no mesh there
    before = page.evaluate(PIXEL, at)
    page.evaluate(COUNT_SCALINGS)
    for key in ("l", "m", "e", "e", "m", "l"):
        page.keyboard.press(key)
        page.evaluate(FRAME)
    assert page.evaluate("() => window.scalings") == 0
    assert page.evaluate(PIXEL, at) == before
    page.evaluate("() => window.liaamStudio.fit.viewer.zoomBy(2)")
    page.evaluate(FRAME)
    assert page.evaluate("() => window.scalings") == 1
    page.evaluate("() => window.liaamStudio.fit.viewer.fit()")
    page.evaluate(FRAME)
    assert page.evaluate(PIXEL, at) == before


def test_a_drop_scales_its_picture_once(fit_tab, lit_file):
    """Not again when the server has the picture, nor when the fit has come: both would delay what is waited for."""
    page = fit_tab
    page.evaluate(FRAME)
    page.evaluate(COUNT_SCALINGS)
    dropped(page, lit_file)
    page.evaluate(FRAME)
    assert page.evaluate("() => window.scalings") == 1
