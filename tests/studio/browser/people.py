"""What a person does with the studio, by mouse and keyboard."""

import base64
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

TIMEOUT = int(os.environ.get("LIAAM_TIMEOUT", "300000"))
"""Milliseconds that anything may take on a busy machine."""

POINTS = [0, 2, 4, 6, 8, 10, 12, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31, 33, 34, 36, 38, 39, 41, 43, 45, 49, 51, 52, 55]
"""Landmarks of the scenes that are placed: jaw, eyes, brows, mouth, nose."""

NAMES = [f"portrait-{i + 1:02d}.png" for i in range(3)]
"""Pictures of the fixture ``marked``."""

PATHS = [(7, False), (4, True), (4, True), (3, False), (3, False), (4, True), (4, False)]
"""How many of them make a curve, and whether it is closed."""


DROP = """(files) => {
  const transfer = new DataTransfer();
  for (const [name, data] of files)
    transfer.items.add(new File([Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0))], name));
  document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
}"""


def drop(page, *paths: Path) -> None:
    """Drop files on the page, as from a file manager."""
    page.evaluate(DROP, [[path.name, base64.b64encode(path.read_bytes()).decode()] for path in paths])


def client(page, where) -> list[float]:
    """Where a point of the picture is on the page."""
    return page.evaluate("where => window.liaamStudio.annotate.toClient(where)", where)


def as_expert(page) -> None:
    """Let the page show methods, residuals and iterations, and the tab Compare; call it before the page is opened."""
    page.add_init_script("localStorage.setItem('liaam-studio:expert', 'on')")


def untrained(page) -> None:
    """Let the page not train by itself, which takes long; call it before the page is opened."""
    page.add_init_script("localStorage.setItem('liaam-studio:auto-train', 'off')")


def annotate(page, what: str):
    """Ask the Annotate tab's hooks."""
    return page.evaluate(f"() => window.liaamStudio.annotate.{what}")


def points_of(page) -> np.ndarray:
    """Landmarks as they are shown, (n, 2), NaN without place."""
    return np.array([point or [np.nan, np.nan] for point in annotate(page, "points()")], dtype=float).reshape(-1, 2)


def wait_for(page, condition: str, argument=None) -> None:
    """Wait until JavaScript says yes."""
    # By default it is asked at each frame, for which the page draws sixty frames a second.
    page.wait_for_function(condition, arg=argument, timeout=TIMEOUT, polling=20)


def wait_until(page, condition: Callable[[], object]) -> None:
    """Wait until Python says yes, while the page goes on."""
    end = time.monotonic() + TIMEOUT / 1000
    while not condition():
        assert time.monotonic() < end, "the page did not come to the expected state"
        page.wait_for_timeout(20)


def wait_for_state(page, name: str, state: str) -> None:
    """Wait until the page knows that a picture is in a state."""
    wait_for(page, "([name, state]) => window.liaamStudio.state.picture(name)?.state === state", [name, state])


def wait_for_point(page, index: int, where: Sequence[float]) -> None:
    """Wait until a point is at a position of the picture."""
    point = "(window.liaamStudio.annotate.points()[index] ?? [NaN, NaN])"
    wait_for(
        page,
        f"([index, x, y]) => {{ const [u, v] = {point}; return Math.hypot(u - x, v - y) < 0.02; }}",
        [index, *where],
    )


def wait_for_tab(page, label: str) -> None:
    """Wait until a tab is open."""
    chosen = "document.querySelector('[role=tab][aria-selected=true]')?.textContent"
    wait_for(page, f"label => {chosen} === label", label)


def opened(page, name: str) -> None:
    """Wait until a picture is open for annotation."""
    wait_for(
        page,
        "name => window.liaamStudio.annotate?.name() === name && window.liaamStudio.annotate.source() !== null",
        name,
    )


def open_picture(page, name: str) -> None:
    """Click a picture in the strip."""
    page.locator(f"[data-testid=strip] [data-name='{name}']").click()
    opened(page, name)


def saved(page) -> None:
    """Wait until all is saved."""
    page.wait_for_selector("[data-testid=save-status][data-state=saved]", timeout=TIMEOUT)
    wait_for(page, "() => !window.liaamStudio.annotate.isDirty()")


def make_template(page, truth: np.ndarray) -> None:
    """Click the template on the first picture, curve by curve, and say that it is done."""
    wait_for(page, "() => window.liaamStudio.annotate?.source() === 'template'")
    first = 0
    for count, closed in PATHS:
        page.locator("[data-testid=template-new-path]").click()
        for point in truth[first : first + count]:
            page.mouse.click(*client(page, point.tolist()))
        first += count
        end = "template-close-path" if closed else "template-new-path"
        page.locator(f"[data-testid={end}]").click()
    page.locator("[data-testid=template-done]").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'file'")
    saved(page)


@contextmanager
def dragging(page, start: Sequence[float], end: Sequence[float], steps: int = 3) -> Iterator[None]:
    """Drag with the mouse, page coordinates; the block runs before the button is released."""
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=steps)
    yield
    page.mouse.up()


def drag(page, start: Sequence[float], end: Sequence[float], steps: int = 3) -> None:
    """Drag with the mouse, page coordinates."""
    with dragging(page, start, end, steps):
        pass


def place_all(page, truth: np.ndarray, near: float = 1.5) -> None:
    """Drag each point that is further off than ``near`` pixels to where it belongs.

    The model may place the points of an untouched picture anew at any time, so that the first drag misses.
    """
    for i, target in enumerate(truth):
        for _ in range(3):
            if np.linalg.norm(points_of(page)[i] - target) <= near:
                break
            drag(page, client(page, i), client(page, target.tolist()), steps=1)  # the picture is drawn at each


def errors(page, truth: np.ndarray) -> np.ndarray:
    """Distance of each point shown from the truth, pixels."""
    return np.linalg.norm(points_of(page) - truth, axis=1)


def picture(page, name: str) -> dict:
    """What the page knows of a picture."""
    return page.evaluate("name => window.liaamStudio.state.picture(name)", name)


def shoot(page, folder: Path, name: str) -> None:
    """Keep a screenshot, and see that no value of the scripts is shown as text."""
    lines = {line.strip() for line in page.locator("body").inner_text().splitlines()}
    assert not lines & {"false", "true", "null", "undefined", "NaN", "[object Object]"}, name
    page.screenshot(path=folder / f"{name}.png")


def violations(page) -> dict[str, list[str]]:
    """Elements that axe finds inaccessible at levels A and AA, by rule."""
    from axe_playwright_python.sync_playwright import Axe

    if not page.evaluate("() => 'axe' in window"):
        page.evaluate(Axe().axe_script)
    options = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]}}
    # What axe finds right stays on the page: to send it takes four times as long as to find it.
    found = page.evaluate("async (options) => (await axe.run(document, options)).violations", options)
    return {each["id"]: [node["html"] for node in each["nodes"]] for each in found}


def kill(server, page):
    """Kill a server, and wait until its page has said so and moved the picture down."""
    server.kill()
    page.locator("[data-testid=connection]", has_text="not reachable").wait_for()
    page.evaluate("() => new Promise((then) => requestAnimationFrame(() => requestAnimationFrame(then)))")
