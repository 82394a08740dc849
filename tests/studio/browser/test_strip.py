"""The list of pictures in a real browser: long folders, search, order, filters; files dropped on any tab."""

import base64

import numpy as np
import pytest
from people import NAMES, opened, wait_for, wait_until

from liaam.io import Landmarks, write_image, write_landmarks

pytestmark = pytest.mark.slow

COUNT = 400
DROP = """([data, ...names]) => {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const transfer = new DataTransfer();
  for (const name of names) transfer.items.add(new File([bytes], name));
  document.querySelector("canvas").dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true }));
}"""

FACES = "[data-testid=strip] [data-name]"


@pytest.fixture
def long(serve, page, tmp_path):
    """Give the page on a folder of many small pictures, of which the first two are done."""
    folder = tmp_path / "long"
    folder.mkdir()
    for i in range(COUNT):
        write_image(folder / f"image-{i:03d}.png", np.full((9, 9, 3), i % 256, np.uint8))
    for i in range(2):
        write_landmarks(folder / f"image-{i:03d}.pts", Landmarks(np.array([[1.0, 1], [7, 1], [4, 7]])))
    page.goto(serve(folder).address)
    opened(page, "image-002.png")
    return page


def names(page) -> list[str]:
    return page.locator(FACES).evaluate_all("items => items.map((item) => item.dataset.name)")


def propose(page, proposals: dict[int, dict]) -> None:
    """Change the server's answers, so that some pictures have proposals."""

    def answer(route):
        project = route.fetch().json()
        for i, proposal in proposals.items():
            if "pictures" in project:
                project["pictures"][i] |= {"state": "proposed", **proposal}
        route.fulfill(json=project)

    page.route("**/api/project*", answer)
    page.evaluate("() => window.liaamStudio.state.refresh()")


def test_a_long_list_holds_only_what_is_visible(long):
    assert len(names(long)) < 40
    long.locator("[data-testid=strip]").evaluate("list => list.scrollTo(0, list.scrollHeight)")
    long.locator(f"{FACES}[data-name='image-399.png']").click()
    opened(long, "image-399.png")
    assert len(names(long)) < 40
    assert long.locator(f"{FACES}[aria-selected=true]").get_attribute("aria-posinset") == str(COUNT)
    wait_for(long, "() => document.querySelector('[data-name=\"image-399.png\"] img').naturalWidth > 0")
    long.locator("[data-testid=strip]").focus()
    long.keyboard.press("ArrowUp")
    opened(long, "image-398.png")


def test_the_list_is_searched_filtered_and_sorted(long):
    long.locator("[data-testid=strip-search]").fill("GE-39")
    wait_until(long, lambda: names(long) == [f"image-39{i}.png" for i in range(10)])
    long.locator(".strip-head", has_text="10 shown, 2 of 400 done").wait_for()
    long.locator(f"{FACES}[data-name='image-395.png']").click()
    opened(long, "image-395.png")
    long.keyboard.press("]")
    opened(long, "image-396.png")
    long.locator("[data-testid=strip-search]").fill("")
    long.locator("[data-testid=strip-filter]").select_option("done")
    wait_until(long, lambda: names(long) == ["image-000.png", "image-001.png"])
    long.locator("[data-testid=strip-filter]").select_option("all")
    propose(long, {200: {"uncertainty": 0.1}, 300: {"uncertainty": 0.01, "doubtful": True}})
    long.locator("[data-testid=strip-order]").select_option("uncertainty")
    long.locator("[data-testid=strip]").evaluate("list => list.scrollTo(0, 0)")
    wait_until(long, lambda: names(long)[:3] == ["image-300.png", "image-200.png", "image-000.png"])


def test_slow_work_is_shown_and_fast_work_is_not(long):
    line = long.locator("[data-testid=busy]")
    line.wait_for(state="hidden")
    assert float(line.evaluate("line => parseFloat(getComputedStyle(line).animationDelay)")) <= 0.15
    waiting = []
    long.route("**/api/pictures/image-010.png/image*", lambda route: waiting.append(route))
    long.evaluate("() => window.liaamStudio.state.select('image-010.png')")
    wait_until(long, lambda: waiting)
    assert not line.evaluate("line => line.hidden")  # the delay is that of the style
    wait_for(long, "() => Number(getComputedStyle(document.querySelector('[data-testid=busy]')).opacity) === 1")
    for route in waiting:  # more than one if the window draws again meanwhile
        route.continue_()
    long.unroute("**/api/pictures/image-010.png/image*")
    line.wait_for(state="hidden")


def test_a_picture_is_dropped_on_any_tab(serve, page, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    data = base64.b64encode((marked / NAMES[1]).read_bytes()).decode()
    page.evaluate(DROP, [data, "dropped.png"])
    page.locator(".toast", has_text="1 picture added").wait_for()
    page.locator("[data-testid=tab-fit]").click()
    page.evaluate(DROP, [data, "only-fitted.png"])  # and not added
    page.locator(".fit-source-name", has_text="only-fitted.png").first.wait_for()
    page.locator("[data-testid=tab-live]").click()
    page.evaluate(DROP, [data, "first.png", "second.png", "third.png"])
    page.locator(".toast", has_text=f"3 pictures added. The added pictures are copied into {marked.name}.").wait_for()
    page.locator("[data-testid=tab-annotate][aria-selected=true]").wait_for()
    added = {path.name for path in marked.glob("*.png")} - set(NAMES)
    assert added == {"dropped.png", "first.png", "second.png", "third.png"}
    page.evaluate(DROP, [data, "talk.mkv"])
    page.locator("[data-testid=tab-live][aria-selected=true]").wait_for()
