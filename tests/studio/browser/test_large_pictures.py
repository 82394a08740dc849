"""Pictures of a hundred megapixels: shown at once, sharp where one looks, fitted and annotated."""

import shutil

import cv2
import numpy as np
import pytest
from people import opened, points_of, saved, shoot, wait_for

from liaam.io import Landmarks, read_landmarks, write_image, write_landmarks

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 7200, 9600
"""69 megapixels: more than the studio once took, and quick to write."""


@pytest.fixture(scope="module")
def wing(portraits, tmp_path_factory):
    """Give a picture with large and with tiny marks, beside its landmarks."""
    folder = tmp_path_factory.mktemp("wing")
    scene = portraits[0]
    image = cv2.resize(np.ascontiguousarray(scene.image), (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    image[3000:3004, 5000:5004] = (255, 0, 0)  # four pixels, which are gone in a preview
    write_image(folder / "wing.jpg", image)
    factor = WIDTH / scene.image.shape[1]
    write_landmarks(folder / "wing.ljson", Landmarks((scene.landmarks[[0, 6, 12, 33, 49]] + 0.5) * factor - 0.5))
    return folder


@pytest.fixture
def large(wing, tmp_path):
    """Give a folder with a copy of that picture and its landmarks."""
    return shutil.copytree(wing, tmp_path / "large")


RED = """([x, y]) => {
  const { viewer } = window.liaamStudio.annotate;
  const [cx, cy] = viewer.toClient([x, y]);
  const ratio = viewer.canvas.width / viewer.canvas.clientWidth;
  const { left, top } = viewer.canvas.getBoundingClientRect();
  const [red, green] = viewer.canvas.getContext("2d").getImageData((cx - left) * ratio, (cy - top) * ratio, 1, 1).data;
  return red > 150 && green < 100;
}"""


def test_a_large_picture_is_sharp_where_one_looks_and_keeps_its_points(serve, page, large, artefacts):
    page.goto(serve(large).address)
    opened(page, "wing.jpg")
    assert not page.evaluate(RED, [5001.5, 3001.5])
    page.evaluate(
        """([x, y]) => {
          const { viewer } = window.liaamStudio.annotate;
          viewer.fitTo([x - 60, y - 40, x + 60, y + 40], 0);
        }""",
        [5001.5, 3001.5],
    )
    wait_for(page, RED, [5001.5, 3001.5])
    shoot(page, artefacts, "large-1280")
    before = points_of(page)
    page.locator("[data-testid=point-list] [data-index='2']").click()
    for _ in range(3):
        page.keyboard.press("Shift+ArrowRight")
    saved(page)
    stored = read_landmarks(large / "wing.ljson").points
    assert stored[2] - before[2] == pytest.approx([30, 0], abs=0.02)
    assert stored[[0, 1, 3, 4]] == pytest.approx(before[[0, 1, 3, 4]], abs=0.01)


def test_a_large_picture_is_fitted_on_a_copy(serve, page, large, portrait_model, portraits):
    (large / "wing.ljson").unlink()
    page.goto(serve(large, "--model", str(portrait_model)).address)
    wait_for(page, "() => window.liaamStudio?.annotate?.source() === 'proposal'")
    truth = (portraits[0].landmarks + 0.5) * WIDTH / portraits[0].image.shape[1] - 0.5
    size = np.linalg.norm(np.ptp(truth, axis=0))
    assert np.linalg.norm(points_of(page) - truth, axis=1).mean() < 0.03 * size
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit")
    shape = np.array(page.evaluate("() => window.liaamStudio.fit.fit.shape"))
    assert np.linalg.norm(shape - truth, axis=1).mean() < 0.03 * size


def test_a_large_picture_that_is_dropped_is_fitted_and_sharp(serve, page, large, folder, portrait_model):
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    opened(page, "portrait-01.png")
    page.locator("[data-testid=tab-fit]").click()
    tiles = []
    page.on("request", lambda request: tiles.append(request.url) if "/tiles/" in request.url else None)
    page.locator("[data-testid=fit-file]").set_input_files(large / "wing.jpg")
    wait_for(page, "() => window.liaamStudio.fit.fit?.upload && window.liaamStudio.fit.viewer.width === 7200")
    assert not page.evaluate(RED.replace("annotate", "fit"), [5001.5, 3001.5])
    page.evaluate("() => window.liaamStudio.fit.viewer.fitTo([4940, 2960, 5060, 3040], 0)")
    wait_for(page, RED.replace("annotate", "fit"), [5001.5, 3001.5])
    assert tiles and all("/uploads/" in address for address in tiles)
    shown = page.evaluate("() => window.liaamStudio.fit.viewer.source.height")
    assert shown <= 2048  # not the whole picture
