"""F shows a picture mirrored: what is seen is exchanged, and points stay where they are in the picture."""

import numpy as np
import pytest
from people import NAMES, client, drag, open_picture, opened, points_of, saved, shoot, wait_for_point

pytestmark = pytest.mark.slow

COLOUR = """([x, y]) => {
  const { canvas } = window.liaamStudio.annotate.viewer;
  const ratio = canvas.width / canvas.clientWidth;
  const { left, top } = canvas.getBoundingClientRect();
  return [...canvas.getContext("2d").getImageData((x - left) * ratio, (y - top) * ratio, 1, 1).data].slice(0, 3);
}"""


def test_a_mirrored_view_exchanges_left_and_right_and_no_coordinates(serve, page, marked, artefacts):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    points = points_of(page)
    place = [100.0, 40.0]
    before = client(page, place)
    colour = page.evaluate(COLOUR, before)
    page.keyboard.press("f")
    after = client(page, place)
    box = page.locator("[data-testid=annotate-viewer]").bounding_box()
    middle = box["x"] + box["width"] / 2
    assert after[0] - middle == pytest.approx(middle - before[0], abs=1.5) and after[1] == pytest.approx(
        before[1], abs=0.1
    )
    assert np.abs(np.subtract(page.evaluate(COLOUR, after), colour)).max() < 12
    assert (points_of(page) == points).all()
    page.locator("[data-testid=point-list] [data-index='2']").click()
    page.keyboard.press("Shift+ArrowRight")  # to the right on the screen
    wait_for_point(page, 2, points[2] - (10, 0))
    x, y = client(page, 2)
    drag(page, (x, y), (x + 30, y))
    saved(page)
    scale = page.evaluate("() => window.liaamStudio.annotate.viewer.scale")
    assert points_of(page)[2][0] == pytest.approx(points[2][0] - 10 - 30 / scale, abs=0.6)
    shoot(page, artefacts, "mirrored-1280")
    open_picture(page, NAMES[1])
    button = page.locator("[data-testid=annotate-viewer] [data-testid=mirrored-view]")
    assert button.get_attribute("aria-pressed") == "false"
    open_picture(page, NAMES[0])
    assert button.get_attribute("aria-pressed") == "true"
    button.click()
    assert client(page, place) == pytest.approx(before, abs=0.5)
