"""A photograph of 150 megapixels in the studio: ``python -m benchmarks.large_picture``.

A face that comes with liaam is enlarged, with the noise of a camera. It is opened in a headless browser, fitted, and
zoomed and panned as with a wheel and a middle button.
"""

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil

from benchmarks.metrics import report
from benchmarks.studio import browsing, start
from liaam.datasets import load_face

PIXELS = 150e6
NOISE = 4.0  # standard deviation of 8-bit values
TILE = 1000  # pixels: the noise repeats
STEPS = 60  # of the wheel, and of the pointer while it pans

IS_SHOWN = "() => window.liaamStudio?.annotate?.source()"
IS_FITTED = "() => window.liaamStudio?.fit?.fit"
RECORD = """() => {
  const frames = [];
  let before = performance.now();
  const tick = (now) => {
    frames.push(now - before);
    before = now;
    if (!window.stopFrames) requestAnimationFrame(tick);
  };
  window.stopFrames = false;
  window.frames = frames;
  requestAnimationFrame(tick);
}"""
RECORDED = "() => { window.stopFrames = true; return window.frames.slice(1); }"


def write_large(path: Path) -> None:
    """Write the photograph, with as many pixels as asked."""
    image = load_face().read_image()
    factor = np.sqrt(PIXELS / (image.shape[0] * image.shape[1]))
    large = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    noise = np.random.default_rng(0).normal(0.0, NOISE, (TILE, TILE, 3)).astype(np.int16)
    for top in range(0, large.shape[0], TILE):
        for left in range(0, large.shape[1], TILE):
            part = large[top : top + TILE, left : left + TILE]
            part[:] = np.clip(part + noise[: part.shape[0], : part.shape[1]], 0, 255)
    cv2.imwrite(str(path), large[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])


def zoom_and_pan(page: Any) -> list[float]:
    """Zoom in and out at some places and pan there; return the times of the frames, milliseconds."""
    box = page.locator("[data-testid=canvas], canvas").first.bounding_box()
    centre = np.array([box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]])
    page.evaluate(RECORD)
    reach = np.array([150.0, 90.0])
    for direction in ((-80, -40), (60, 50), (0, 0)):
        place = centre + direction
        page.mouse.move(*place.tolist())
        for _ in range(STEPS):
            page.mouse.wheel(0, -60)
        page.mouse.down(button="middle")
        page.mouse.move(*(place + reach).tolist(), steps=STEPS)
        page.mouse.move(*(place - reach).tolist(), steps=STEPS)
        page.mouse.up(button="middle")
        for _ in range(STEPS):
            page.mouse.wheel(0, 60)
    return page.evaluate(RECORDED)


def main() -> None:
    """Print how soon the photograph is shown and fitted, the frames of zoom and pan, and the server's memory."""
    with tempfile.TemporaryDirectory() as name, browsing() as page:
        if page is None:
            return
        write_large(Path(name) / "large.jpg")
        server = start(Path(name), "--port", "0")
        try:
            began = time.perf_counter()
            page.goto(server.address)
            page.wait_for_function(IS_SHOWN, timeout=60_000)
            report("large_preview_s", time.perf_counter() - began, form=".2f")
            zoom_and_pan(page)  # warm
            frames = zoom_and_pan(page)
            report("large_frame_p99_ms", float(np.percentile(frames, 99)), f"of {len(frames)}", form=".0f")
            report("large_frame_worst_ms", max(frames), form=".0f")
            began = time.perf_counter()
            page.locator("[data-testid=tab-fit]").click()
            page.wait_for_function(IS_FITTED, timeout=60_000)
            report("large_fit_s", time.perf_counter() - began, form=".2f")
            if folder := os.environ.get("LIAAM_ARTEFACTS"):
                page.screenshot(path=Path(folder) / "large.png")
            memory = psutil.Process(server.process.pid).memory_info()
            report("large_memory_mb", memory.rss / 1e6, form=".0f")
        finally:
            server.stop()


if __name__ == "__main__":
    main()
