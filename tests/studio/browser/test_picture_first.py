"""The picture fills the page: panels that slide away, brightness, the loupe, opacity, and messages over it."""

import hashlib

import numpy as np
import pytest
from people import NAMES, annotate, as_expert, client, kill, open_picture, opened, points_of, saved, shoot, wait_for

from liaam.io import Landmarks, read_image, write_image, write_landmarks

pytestmark = pytest.mark.slow

PIXEL = """([tab, x, y]) => {
  const { canvas } = window.liaamStudio[tab].viewer;
  const box = canvas.getBoundingClientRect();
  const at = [x - box.left, y - box.top].map((value) => Math.floor((value * canvas.width) / canvas.clientWidth));
  return [...canvas.getContext("2d").getImageData(...at, 1, 1).data].slice(0, 3);
}"""

FREE = """() => {
  const box = document.querySelector("section:not([hidden]) .viewer").getBoundingClientRect();
  return [box.x, box.y, box.width, box.height].map(Math.round);
}"""


def pixel(page, at, tab: str = "annotate") -> np.ndarray:
    """Colour of the canvas at a position of the page."""
    return np.array(page.evaluate(PIXEL, [tab, *at]), dtype=float)


def wait_for_pixel(page, at, colour, tab: str = "annotate", within: float = 2.0) -> None:
    """Wait until the canvas has a colour at a position of the page."""
    near = f"(where) => ({PIXEL})(where.at).every((value, i) => Math.abs(value - where.colour[i]) <= where.within)"
    wait_for(page, near, {"at": [tab, *map(float, at)], "colour": [float(v) for v in colour], "within": within})


def rests(page) -> None:
    """Wait until the visible picture has stayed at its place for some frames."""
    wait_for(
        page,
        f"""async () => {{
          const seen = new Set();
          for (let i = 0; i < 6; i += 1) {{ seen.add(String(({FREE})())); await new Promise(requestAnimationFrame); }}
          return seen.size === 1;
        }}""",
    )


@pytest.fixture
def tiles(tmp_path, rng):
    """Give a folder with a picture of coloured tiles, 8 pixels wide, and five landmarks."""
    root = tmp_path / "tiles"
    root.mkdir()
    colours = rng.integers(0, 256, (30, 40, 3), dtype=np.uint8)
    write_image(root / NAMES[0], colours.repeat(8, axis=0).repeat(8, axis=1))
    points = np.array([[60.0, 50], [250, 60], [160, 120], [90, 190], [230, 200]])
    write_landmarks((root / NAMES[0]).with_suffix(".ljson"), Landmarks(points))
    return root


def test_panels_slide_away_by_key_and_button_and_stay_away(page, serve, marked, artefacts):
    server = serve(marked)
    page.goto(server.address)
    opened(page, NAMES[0])
    whole = page.evaluate(FREE)
    page.evaluate("() => window.liaamStudio.annotate.viewer.zoomBy(1.5)")
    before = client(page, 2)
    page.keyboard.press("i")
    wait_for(page, f"(width) => ({FREE})()[2] > width + 150", whole[2])
    rests(page)
    assert client(page, 2) == pytest.approx(before, abs=0.6), "the picture moved with the panel"
    page.locator("[data-testid=show-side]").click()
    wait_for(page, "() => getComputedStyle(document.querySelector('.annotate-side')).visibility === 'hidden'")
    rests(page)
    x, _, width, _ = page.evaluate(FREE)
    assert x < 20
    assert width > 1240
    assert client(page, 2) == pytest.approx(before, abs=0.6)
    shoot(page, artefacts, "30-panels-away")
    page.reload()
    opened(page, NAMES[0])
    assert page.evaluate(FREE)[2] > 1240, "the panels came back"
    assert page.locator("[data-testid=show-strip]").get_attribute("aria-pressed") == "false"
    page.keyboard.press("z")
    wait_for(page, f"(free) => String(({FREE})()) === free", ",".join(map(str, whole)))
    assert page.locator("[data-testid=show-strip]").get_attribute("aria-pressed") == "true"
    page.keyboard.press("z")
    wait_for(page, f"() => ({FREE})()[2] > 1240")


def test_the_picture_goes_on_under_the_panels(page, serve, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    page.evaluate("() => window.liaamStudio.annotate.viewer.zoomBy(8)")
    canvas = page.locator("[data-testid=annotate-viewer] canvas").first.bounding_box()
    assert (canvas["width"], canvas["height"]) == (1280, 720)
    panel = page.locator(".annotate-side").bounding_box()
    under = (panel["x"] + panel["width"] / 2, panel["y"] + panel["height"] / 2)
    wait_for(page, f"(where) => ({PIXEL})(where).some((value) => value > 0)", ["annotate", *under])


THUMBNAILS = (
    "() => [...document.querySelectorAll('[data-testid=strip] img')].every((img) => img.complete && img.naturalWidth)"
)
"""Whether those in the list have been fetched."""


def test_brightness_changes_what_is_seen_and_never_the_file(page, serve, tiles, artefacts):
    write_image(tiles / NAMES[1], np.full((240, 320, 3), 90, np.uint8))
    page.goto(serve(tiles).address)
    open_picture(page, NAMES[0])
    files = {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in tiles.iterdir() if path.is_file()}
    at = client(page, [123.5, 83.5])
    wait_for_pixel(page, at, read_image(tiles / NAMES[0])[83, 123], within=25)  # the page has it as a JPEG
    plain = pixel(page, at)
    wait_for(page, THUMBNAILS)
    requests = []
    page.on("request", lambda request: requests.append(request.url) if "/api/" in request.url else None)
    page.keyboard.press("a")
    for name, value in (("brightness", 0.4), ("contrast", -0.5), ("gamma", 0.6)):
        page.locator(f"[data-testid=annotate-viewer] [data-testid=look-{name}]").fill(str(value))
    bright = (plain / 255 * 2**0.4) ** (2**-0.6)
    wait_for_pixel(page, at, 255 * np.clip((bright - 0.5) * 2**-0.5 + 0.5, 0, 1))
    shoot(page, artefacts, "31-brightness")
    assert not [url for url in requests if "image" in url], "the picture was fetched again"
    page.reload()
    opened(page, NAMES[0])
    wait_for_pixel(page, at, 255 * np.clip((bright - 0.5) * 2**-0.5 + 0.5, 0, 1))
    keys = page.evaluate("() => Object.keys(localStorage).filter((key) => key.startsWith('liaam-look:'))")
    assert keys == [f"liaam-look:{page.evaluate('() => window.liaamStudio.state.project.id')}"]
    # It holds for all pictures, says so over each of them, and is taken back there.
    page.keyboard.press("]")
    opened(page, NAMES[1])
    for tab in ("annotate", "fit"):
        page.locator(f"[data-testid=tab-{tab}]").click()
        notice = page.locator(f"[data-testid={tab}-viewer] [data-testid=look-notice]")
        assert notice.inner_text().split("\n")[0] == "Shown with brightness ×1.32, contrast ×0.71, gamma ×1.52"
    shoot(page, artefacts, "31-brightness-in-fit")
    notice.locator("[data-testid=look-off]").click()
    assert page.locator("[data-testid=look-notice]:visible").count() == 0
    page.locator("[data-testid=tab-annotate]").click()
    open_picture(page, NAMES[0])
    wait_for_pixel(page, at, plain)
    page.locator("[data-testid=annotate-viewer] [data-testid=look]").click()
    page.locator("[data-testid=annotate-viewer] [data-testid=look-brightness]").fill("0.4")
    reset = page.locator("[data-testid=annotate-viewer] [data-testid=look-reset]")
    assert reset.evaluate("(button) => getComputedStyle(button).writingMode") == "horizontal-tb"
    reset.click()
    wait_for_pixel(page, at, plain)
    page.keyboard.press("Escape")
    wait_for(page, "() => !document.querySelector('[data-testid=annotate-viewer] details').open")
    assert {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in files} == files


def loupe(page) -> dict:
    """Wait for the loupe, and say what it shows and where it is on the page."""
    wait_for(page, "() => window.liaamStudio.annotate.loupe()")
    page.evaluate("() => new Promise((then) => requestAnimationFrame(() => requestAnimationFrame(then)))")
    shown, free = annotate(page, "loupe()"), page.evaluate(FREE)
    return shown | {"centre": np.add(shown["centre"], free[:2])}


def check_loupe(page, picture) -> None:
    """Compare the inside of tiles in the loupe, away from its cross, with the picture."""
    shown = loupe(page)
    checked = 0
    for offset in [(right, down) for right in (-36, -27, 27, 36) for down in (-36, -27, 27, 36)]:
        x, y = np.add(shown["xy"], np.divide(offset, shown["scale"]))
        if min((x + 0.5) % 8, (y + 0.5) % 8) < 1 or max((x + 0.5) % 8, (y + 0.5) % 8) > 7:
            continue
        colour = picture[round(y), round(x)].astype(float)
        assert np.abs(pixel(page, shown["centre"] + offset) - colour).max() <= 25, offset  # the page has it as a JPEG
        checked += 1
    assert checked >= 4
    assert shown["scale"] >= 2 * annotate(page, "viewer.scale")


def test_the_loupe_shows_the_pixels_around_a_dragged_point(page, serve, tiles, artefacts):
    page.goto(serve(tiles).address)
    opened(page, NAMES[0])
    picture = read_image(tiles / NAMES[0])
    start = client(page, 2)
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(start[0] + 14, start[1] + 9, steps=3)
    check_loupe(page, picture)
    shoot(page, artefacts, "32-loupe")
    page.mouse.up()
    saved(page)
    assert annotate(page, "loupe()") is None
    page.keyboard.press("Shift+ArrowRight")
    check_loupe(page, picture)
    assert loupe(page)["xy"] == pytest.approx(points_of(page)[2])
    wait_for(page, "() => window.liaamStudio.annotate.loupe() === null")  # it goes by itself
    page.keyboard.press("Delete")
    page.mouse.move(start[0] + 30, start[1] + 20, steps=3)
    check_loupe(page, picture)
    page.keyboard.press("r")
    wait_for(page, "() => window.liaamStudio.annotate.loupe() === null")


def test_a_picture_that_was_panned_is_drawn_as_if_it_were_drawn_anew(page, serve, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    same = page.evaluate(
        """async () => {
          const { viewer } = window.liaamStudio.annotate;
          const frame = () => new Promise((then) => requestAnimationFrame(() => requestAnimationFrame(then)));
          const pixels = () => viewer.canvas.getContext("2d")
            .getImageData(0, 0, viewer.canvas.width, viewer.canvas.height).data.slice();
          viewer.zoomBy(1.7);
          await frame();
          for (const by of [[31.4, -12.7], [-80, 44], [3, 5]]) { viewer.panBy(...by); await frame(); }
          const panned = pixels();
          for (const on of [true, false]) { viewer.mirror(on); await frame(); } // draws all of it again
          const anew = pixels();
          return panned.length > 1e6 && panned.every((value, i) => Math.abs(value - anew[i]) <= 1);
        }"""
    )
    assert same


@pytest.fixture
def fitted(page, serve, folder, portraits, portrait_model):
    """Give the page with a fit in the Fit tab."""
    write_landmarks(folder / "portrait-01.pts", portraits[0].landmarks)
    as_expert(page)
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    opened(page, "portrait-02.png")
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit?.picture === 'portrait-02.png'")
    return page


def test_layers_have_an_opacity(fitted, artefacts):
    page = fitted
    x, y = np.mean(page.evaluate("() => window.liaamStudio.fit.fit.shape"), axis=0)
    at = page.evaluate(f"() => window.liaamStudio.fit.viewer.toClient([{x}, {y}])")
    page.keyboard.press("l")
    page.evaluate("() => new Promise((then) => requestAnimationFrame(() => requestAnimationFrame(then)))")
    plain = pixel(page, at, "fit")
    page.locator("[data-testid=layer-residual]").click()
    wait_for(
        page,
        f"(where) => String(({PIXEL})(where.at)) !== where.plain",
        {"at": ["fit", *at], "plain": ",".join(str(int(v)) for v in plain)},
    )
    full = pixel(page, at, "fit")
    for keys in (1, 2):
        page.keyboard.press("o")
        wait_for_pixel(page, at, plain + (full - plain) * (1 - 0.25 * keys), "fit", within=3)
    shoot(page, artefacts, "33-opacity")
    page.locator("[data-testid=opacity-view]").fill("0")
    wait_for_pixel(page, at, plain, "fit", within=1)
    corner = page.evaluate("() => window.liaamStudio.fit.viewer.toClient(window.liaamStudio.fit.fit.shape[0])")
    bare = pixel(page, corner, "fit")
    page.locator("[data-testid=layer-landmarks]").click()
    wait_for(
        page,
        f"(where) => ({PIXEL})(where.at).some((value, i) => Math.abs(value - where.bare[i]) > 20)",
        {"at": ["fit", *corner], "bare": bare.tolist()},
    )
    dot = pixel(page, corner, "fit")
    page.locator("[data-testid=opacity-landmarks]").fill("0.5")
    wait_for(
        page,
        f"(where) => ({PIXEL})(where.at).some((value, i) => Math.abs(value - where.dot[i]) > 10)",
        {"at": ["fit", *corner], "dot": dot.tolist()},
    )
    page.locator("[data-testid=opacity-landmarks]").fill("0")
    wait_for_pixel(page, corner, bare, "fit", within=1)


def test_the_message_of_a_lost_server_moves_nothing(page, serve, marked, artefacts):
    server = serve(marked)
    page.goto(server.address)
    opened(page, NAMES[0])
    before, where = page.evaluate(FREE), client(page, 0)
    kill(server, page)
    assert page.evaluate(FREE) == before
    assert client(page, 0) == where
    notice = page.locator("[data-testid=connection]").bounding_box()
    assert notice["x"] >= 0
    assert notice["x"] + notice["width"] <= 1280
    tools = page.locator("[data-testid=undo]").bounding_box()
    assert notice["y"] > tools["y"] + tools["height"], "the message covers the tools"
    shoot(page, artefacts, "34-lost-server")


def test_both_sides_of_a_comparison_are_visible_on_a_phone(fitted, artefacts):
    fitted.set_viewport_size({"width": 390, "height": 844})
    fitted.locator("[data-testid=tab-compare]").click()
    wait_for(fitted, "() => window.liaamStudio.compare.left.fit && window.liaamStudio.compare.right.fit")
    rests(fitted)
    for side in ("left", "right"):
        box = fitted.locator(f"[data-testid=compare-{side}]").bounding_box()
        picture = fitted.locator(f"[data-testid=compare-{side}] .viewer").bounding_box()
        assert box["y"] + box["height"] <= 844
        assert picture["height"] > 110
        assert "Quality" in fitted.locator(f"[data-testid=compare-{side}] .compare-result").inner_text()
    shoot(fitted, artefacts, "35-compare-phone")
