"""The box that corrects the colour of the light: what it says, shows and saves."""

import numpy as np
import pytest
from people import wait_for

from liaam.datasets import load_face
from liaam.io import read_image, write_image
from liaam.photometry import linear_to_srgb, srgb_to_linear

pytestmark = pytest.mark.slow

CORNER = """() => {
  const { canvas, container } = window.liaamStudio.fit.viewer; // the canvas goes on under the panels
  const [outer, inner] = [canvas, container].map((element) => element.getBoundingClientRect());
  const [x, y] = window.liaamStudio.fit.viewer.toScreen([20, 20]);
  const factor = canvas.width / canvas.clientWidth;
  const at = [factor * (x + inner.left - outer.left), factor * (y + inner.top - outer.top)];
  return [...canvas.getContext("2d").getImageData(...at, 1, 1).data].slice(0, 3);
}"""


def shown(page) -> np.ndarray:
    wait_for(page, "() => window.liaamStudio.fit.hasLayer && !window.liaamStudio.fit.relightBusy")
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return np.array(page.evaluate(CORNER), float)


def test_the_colour_of_the_light_is_named_and_corrected_or_kept(page, serve, tmp_path):
    folder = tmp_path / "evening"
    folder.mkdir()
    photograph = read_image(load_face().image)
    blue = srgb_to_linear(photograph / 255.0) * np.exp((-0.3, 0.0, 0.4))
    write_image(folder / "a.png", np.rint(255 * linear_to_srgb(np.clip(blue, 0.0, 1.0))).astype(np.uint8))
    write_image(folder / "b.png", photograph)
    page.goto(serve(folder, face=True).address)
    page.locator("[data-testid=strip] [data-name='a.png']").click()
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit?.picture === 'a.png'")
    box, colour = (page.locator(f"[data-testid={name}]") for name in ("balance", "light-colour"))
    for view in ("flat", "relit"):
        page.locator(f"[data-testid=layer-{view}]").click()
        if view == "flat":
            page.locator("[data-testid=fit-split]").click()  # the view alone, here and in the other
        wait_for(page, "() => document.querySelector('[data-testid=light-colour]').textContent === 'blue'")
        assert box.is_checked()
        corrected = shown(page)
        box.uncheck()
        kept = shown(page)
        assert corrected[2] / corrected[0] < 0.85 * kept[2] / kept[0], view
        with page.expect_download() as saved:
            page.locator("[data-testid=fit-save]").click()
        page.locator(".toast.good", has_text=f"Saved {saved.value.suggested_filename}").wait_for()
        saved.value.save_as(tmp_path / f"{view}.png")
        assert np.abs(read_image(tmp_path / f"{view}.png")[20, 20] - kept).max() <= 6
        box.check()
        assert np.abs(shown(page) - corrected).max() <= 3
    page.locator("[data-testid=layer-balanced]").click()  # the colour alone
    assert box.is_checked() and box.is_disabled()
    corrected = shown(page)
    assert corrected[2] / corrected[0] < 0.85 * kept[2] / kept[0]
    with page.expect_download() as saved:
        page.locator("[data-testid=fit-save]").click()
    saved.value.save_as(tmp_path / saved.value.suggested_filename)
    assert np.abs(read_image(tmp_path / "a_balanced.png")[20, 20] - corrected).max() <= 6
    page.locator("[data-testid=strip] [data-name='b.png']").click()
    page.locator("[data-testid=fit-state]", has_text="No colour to correct").wait_for()
    assert page.locator("[data-testid=fit-save]").is_disabled()
    wait_for(page, "() => document.querySelector('[data-testid=light-colour]').textContent === 'neutral'")
    assert colour.inner_text() == "neutral"
    assert box.is_disabled()
