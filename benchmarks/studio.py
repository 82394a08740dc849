"""How quickly the studio answers a person, in a real browser: a dropped picture, the theta slider, a moving light.

Needs Playwright (the ``test`` extra) and a Chromium.
"""

import base64
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from liaam.datasets.scenes import DIFFUSE, Head, lateral, make_set, random_expression, random_pose, render
from liaam.io import write_image
from liaam.training import train

SIZE = (480, 640)
N_DROPS, N_MOVES = 12, 120
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]

DROP = """([name, base64]) => {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const transfer = new DataTransfer();
  transfer.items.add(new File([bytes], name, {type: "image/png"}));
  const target = document.querySelector("[data-testid=fit-drop]");
  for (const type of ["dragenter", "dragover", "drop"])
    target.dispatchEvent(new DragEvent(type, {dataTransfer: transfer, bubbles: true, cancelable: true}));
}"""


def chromium() -> str | None:
    """Path of a Chromium, if there is one."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return os.environ.get("LIAAM_CHROMIUM") or next(filter(None, map(shutil.which, names)), None)


def material(folder: Path) -> list[Path]:
    """Write a model, and pictures of the same head under hard light from either side; gives the pictures."""
    training = make_set(N_DROPS, Head(5), DIFFUSE, seed=3, size=(320, 240))
    train([(scene.image, scene.landmarks) for scene in training]).save(folder / "model.liaam")
    paths = []
    for i in range(N_DROPS):
        rng = np.random.default_rng(100 + i)
        lights = lateral("left" if i % 2 else "right")
        scene = render(Head(5), random_pose(rng, SIZE), random_expression(rng), lights, size=SIZE, seed=i)
        paths.append(folder / f"lit-{i:02d}.png")
        write_image(paths[-1], scene.image)
    return paths


def drops(page, pictures: list[Path]) -> list[float]:
    """Milliseconds from each drop to the first frame painted with the fit."""
    times = []
    for path in pictures:
        page.evaluate("() => { window.lastFit = window.liaamStudio.fit.fit?.id ?? null; }")
        page.evaluate(DROP, [path.name, base64.b64encode(path.read_bytes()).decode()])
        page.wait_for_function(
            "() => window.liaamStudio.fit.fit && window.liaamStudio.fit.fit.id !== window.lastFit", timeout=60_000
        )
        page.wait_for_timeout(300)  # the first frame with it has been painted, and its time taken
        times.append(page.evaluate("() => window.liaamStudio.fit.lastDropMs"))
    return times


def theta_rate(page) -> float:
    """Frames per second of the invariant image while its slider is dragged to and fro."""
    page.locator("[data-testid=layer-invariant]").click()
    page.wait_for_load_state("networkidle")
    box = page.locator("[data-testid=theta-slider]").bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.5 * box["width"], y)
    page.mouse.down()
    for i in range(N_MOVES):
        page.mouse.move(box["x"] + box["width"] * (0.5 + 0.4 * np.sin(i / 8)), y)
    rate = page.evaluate("() => window.liaamStudio.fit.invariantFps()")
    page.mouse.up()
    return rate


@contextmanager
def served(folder: Path, *arguments: str) -> Iterator[str]:
    """Run ``liaam studio`` on a folder in a process of its own; gives its address."""
    command = [sys.executable, "-m", "liaam", "studio", str(folder), "--no-browser", "--port", "0", *arguments]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "COLUMNS": "300"})
    try:
        assert server.stdout
        found = next(filter(None, (re.search(r"http://\S+", line) for line in server.stdout)), None)
        if found is None:
            raise RuntimeError("the studio did not start")
        yield found.group()
    finally:
        server.terminate()
        server.wait()


@contextmanager
def browsing(size: tuple[int, int] = (1280, 720), **options) -> Iterator[Any]:
    """Give a page of a headless browser, or None, with the reason printed, where there is none."""
    executable = chromium()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        executable = None
    if executable is None:
        print("studio: skipped; it needs playwright (pip install '.[test]') and a Chromium (LIAAM_CHROMIUM names one)")
        yield None
        return
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=executable, args=FLAGS)
        yield browser.new_page(viewport={"width": size[0], "height": size[1]}, **options)
        browser.close()


def main() -> None:
    """Print the metrics."""
    with browsing() as page, tempfile.TemporaryDirectory() as name:
        if page is None:
            return
        pictures = material(Path(name))
        with served(Path(name), "--model", str(Path(name) / "model.liaam")) as address:
            page.goto(address)
            page.locator("[data-testid=tab-fit]").click()
            page.wait_for_function("() => window.liaamStudio.fit")
            drops(page, pictures[:2])  # warm
            times, seconds = [], []
            for path in pictures:
                times += drops(page, [path])
                seconds.append(page.evaluate("() => window.liaamStudio.fit.fit.seconds"))
            print(f"studio_drop_to_fit_ms {np.median(times):.0f} worst {max(times):.0f}")
            for part in ("search", "fit"):
                print(f"studio_{part}_ms {1000 * np.median([each[part] for each in seconds]):.0f}")
            print(f"studio_theta_frames_per_second {theta_rate(page):.0f}")


if __name__ == "__main__":
    main()
