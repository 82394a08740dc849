"""Response times of the studio in a real browser: a dropped image, the theta slider, live video.

Needs Playwright (the ``test`` extra) and Chromium. The studio's tests and the figures of its documentation use the
server and the browser of this module.
"""

import base64
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.metrics import report
from benchmarks.search import half_sets, pictures_of
from liaam.io import read_image, write_image, write_landmarks
from liaam.training import train
from scenes import DIFFUSE, Head, lateral, make_set, random_expression, random_pose, render

SIZE = (480, 640)
LARGE = (4000, 3000)
N_DROPS, N_MOVES = 12, 120
CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]
ADDRESS = re.compile(r"http://\S+/\?token=\S+")

DROP = """([name, base64]) => {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const transfer = new DataTransfer();
  transfer.items.add(new File([bytes], name));
  const target = document.querySelector("[data-testid=fit-drop]");
  for (const type of ["dragenter", "dragover", "drop"])
    target.dispatchEvent(new DragEvent(type, {dataTransfer: transfer, bubbles: true, cancelable: true}));
}"""


CIRCLE = """async ([x, y, radius, moves]) => {
  const lamp = document.querySelector("[data-testid=lamp]");
  for (let i = 0; i < moves; i += 1) {
    const at = { clientX: x + radius * Math.cos(i / 8), clientY: y + radius * Math.sin(i / 8) };
    lamp.dispatchEvent(new PointerEvent("pointermove", { ...at, pointerId: 1, bubbles: true }));
    await new Promise(requestAnimationFrame);
  }
}"""


def material(folder: Path) -> list[Path]:
    """Write a model, and images of the same head under hard light from either side. Return the images."""
    training = make_set(N_DROPS, Head(5), DIFFUSE, seed=3, size=(320, 240))
    train([(scene.image, scene.landmarks) for scene in training], lamps=None, methods="all").save(
        folder / "model.liaam"
    )
    paths = []
    for i in range(N_DROPS):
        rng = np.random.default_rng(100 + i)
        lights = lateral("left" if i % 2 else "right")
        scene = render(Head(5), random_pose(rng, SIZE), random_expression(rng), lights, size=SIZE, seed=i)
        paths.append(folder / f"lit-{i:02d}.png")
        write_image(paths[-1], scene.image)
    return paths


def photographs(folder: Path, data: Path, letters: int) -> list[Path]:
    """Write a model of half of a data set's persons. Return images of the other half; see :func:`half_sets`."""
    training, others = half_sets(data, letters)[0]
    train(pictures_of(training), leave_out=False, lamps=None, methods="all").save(folder / "model.liaam")
    files = [sample.image for sample in others if isinstance(sample.image, Path)]
    return files[:: max(1, len(files) // N_DROPS)][:N_DROPS]


def drops(page, pictures: list[Path]) -> list[float]:
    """Milliseconds from each drop to the first frame painted with the fit."""
    times = []
    for path in pictures:
        page.evaluate("() => { window.lastFit = window.liaamStudio.fit.fit?.id ?? null; }")
        page.evaluate(DROP, [path.name, base64.b64encode(path.read_bytes()).decode()])
        page.wait_for_function(
            "() => window.liaamStudio.fit.fit && window.liaamStudio.fit.fit.id !== window.lastFit", timeout=60_000
        )
        page.wait_for_timeout(300)  # until the first frame is painted and timed
        times.append(page.evaluate("() => window.liaamStudio.fit.lastDropMs"))
    return times


def enlarged(path: Path, folder: Path) -> Path:
    """Write a picture with 12 megapixels, as a camera's JPEG, to a folder."""
    import cv2

    large = folder / f"large-{path.stem}.jpg"
    write_image(large, cv2.resize(read_image(path), LARGE, interpolation=cv2.INTER_CUBIC))
    return large


def theta_rate(page) -> float:
    """Frames per second of the invariant image while its slider is dragged to and fro."""
    page.locator("[data-testid=expert]").check()
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


def relight_rate(page) -> float:
    """Relit images per second while a lamp is dragged round the object."""
    page.locator("[data-testid=layer-relit]").click()
    page.wait_for_function("() => window.liaamStudio.fit.hasLayer")
    page.wait_for_load_state("networkidle")  # until the page can compute light
    box = page.locator("[data-testid=light-stage]").bounding_box()
    x, y, radius = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, 0.4 * box["width"]
    lamp = page.locator("[data-testid=lamp]").bounding_box()
    page.mouse.move(lamp["x"] + lamp["width"] / 2, lamp["y"] + lamp["height"] / 2)
    page.mouse.down()
    # Playwright moves the mouse less often than a screen is drawn.
    page.evaluate(CIRCLE, [x, y, radius, N_MOVES])
    rate = page.evaluate("() => window.liaamStudio.fit.relightFps()")
    page.mouse.up()
    return rate


# A newcomer ----------------------------------------------------------------------------------------


def newcomer() -> None:
    """Print the seconds from the request of the page of an empty folder to a face under a lamp."""
    with browsing() as page, tempfile.TemporaryDirectory() as name:
        if page is None:
            return
        with served(Path(name)) as address:
            began = time.perf_counter()
            page.goto(address)
            page.wait_for_function("() => window.liaamStudio?.first?.frames > 0", timeout=120_000)
            report("studio_newcomer_s", time.perf_counter() - began, "", form=".2f")


# Live video ----------------------------------------------------------------------------------------

N_CAMERA = 90
"""Frames after which the video of the camera begins again: three seconds."""

LIVE_SECONDS = 5
"""How long the camera runs before its rate is read, in which the rate is that of the last 50 frames."""


def write_camera(path: Path, image: np.ndarray) -> list[str]:
    """Write a video of a moving image, as Motion JPEG. Return the flags with which Chromium takes it for a camera."""
    import cv2

    height, width = image.shape[:2]
    with path.open("wb") as file:
        for turn in 2 * np.pi * np.arange(N_CAMERA) / N_CAMERA:
            matrix = cv2.getRotationMatrix2D((width / 2, height / 2), 4 * np.sin(turn), 1 + 0.04 * np.cos(turn))
            matrix[:, 2] += 0.02 * width * np.sin(turn), 0.02 * height * np.sin(2 * turn)
            moved = cv2.warpAffine(image, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE)
            file.write(cv2.imencode(".jpg", moved[..., ::-1])[1].tobytes())
    fake = (
        "use-fake-device-for-media-stream",
        "use-fake-ui-for-media-stream",
        f"use-file-for-fake-video-capture={path}",
    )
    return [f"--{flag}" for flag in fake]


def live(page) -> None:
    """Print the rate and the delay of live video from the camera, with and without its shading."""
    page.locator("[data-testid=tab-live]").click()
    page.locator("[data-testid=live-camera]").click()
    for name in ("live", "live_flat"):
        page.wait_for_function("() => window.liaamStudio.live.shown()?.fit.ok")
        page.wait_for_timeout(1000 * LIVE_SECONDS)
        rate, delays = page.evaluate("() => [window.liaamStudio.live.rate(), window.liaamStudio.live.delays()]")
        median, high = np.percentile(delays, (50, 95))
        report(f"studio_{name}_frames_per_second", rate, f"delay {median:.0f} ms, 95 % {high:.0f} ms", form=".1f")
        page.locator("[data-testid=live-flat]").click()
    page.locator("[data-testid=live-stop]").click()


# Many pictures -------------------------------------------------------------------------------------

MANY = 10_000

USABLE = "() => window.liaamStudio?.annotate?.source() && document.querySelector('.strip img[src]')"

FRAMES = """async () => {
  const list = document.querySelector("[data-testid=strip]");
  const frames = [];
  let before = await new Promise(requestAnimationFrame);
  for (let step = 0; step < 240; step += 1) {
    list.scrollTop += step % 60 < 50 ? 400 : 40_000; // as by a wheel, with some long jumps
    const now = await new Promise(requestAnimationFrame);
    frames.push(now - before);
    before = now;
  }
  return frames;
}"""


def many_pictures(folder: Path, count: int = MANY) -> None:
    """Write small images, of which the first four have landmarks."""
    import cv2

    scene = make_set(1, Head(5), DIFFUSE, seed=3, size=(320, 240))[0]
    rng = np.random.default_rng(0)
    some = [np.clip(scene.image + rng.integers(-40, 40, 3), 0, 255).astype(np.uint8) for _ in range(50)]
    data = [cv2.imencode(".jpg", image[..., ::-1])[1].tobytes() for image in some]
    for i in range(count):
        (folder / f"image-{i:05d}.jpg").write_bytes(data[i % len(data)])
    for i in range(4):
        write_landmarks(folder / f"image-{i:05d}.pts", scene.landmarks)


def many() -> None:
    """Print how soon a folder of many images can be used, how fast its list scrolls, and the memory of the page."""
    with browsing() as page, tempfile.TemporaryDirectory() as name:
        if page is None:
            return
        many_pictures(Path(name))
        began = time.perf_counter()
        with served(Path(name)) as address:
            started = time.perf_counter()
            page.goto(address)
            page.wait_for_function(USABLE)
            opened = time.perf_counter() - started
            report("studio_many_usable_s", opened, f"server {started - began:.2f} s", form=".2f")
            page.wait_for_timeout(5000)  # until all files are read
            page.evaluate(FRAMES)  # warm
            frames = page.evaluate(FRAMES)
            report("studio_many_frame_p95_ms", float(np.percentile(frames, 95)), f"worst {max(frames):.0f}", form=".0f")
            session = page.context.new_cdp_session(page)
            session.send("HeapProfiler.collectGarbage")
            heap = page.evaluate("() => performance.memory.usedJSHeapSize")
            report("studio_many_heap_mb", heap / 1e6, f"renderer {renderer_bytes() / 1e6:.0f} MB", form=".0f")


def renderer_bytes() -> int:
    """Return the memory of the largest renderer process of the browser, without pages shared with others."""
    import psutil

    below = psutil.Process().children(recursive=True)
    renderers = [process for process in below if "--type=renderer" in process.cmdline()]
    return max((process.memory_full_info().uss for process in renderers), default=0)


# The server and the browser ------------------------------------------------------------------------


@dataclass(frozen=True)
class Server:
    """A ``liaam studio`` in a separate process."""

    process: subprocess.Popen
    address: str

    def stop(self) -> None:
        """End it as by Ctrl-C, without output."""
        self.process.terminate()
        self.process.wait()

    def kill(self) -> None:
        """End it as by a power failure."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


def start(folder: Path, *arguments: str) -> Server:
    """Run ``liaam studio`` on a folder.

    Raises
    ------
    RuntimeError
        If it ends without printing its address.
    """
    command = [sys.executable, "-m", "liaam", "studio", str(folder), "--no-browser", *arguments]
    environment = {**os.environ, "COLUMNS": "300"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout
    return Server(process, announced(process.stdout))


def announced(lines: Iterable[str]) -> str:
    """Return the address that a studio prints. Raise RuntimeError if it ends without."""
    said = []
    for line in lines:
        said.append(line)
        if address := ADDRESS.search(line):
            return address.group()
    raise RuntimeError(f"the studio did not start: {''.join(said)}")


@contextmanager
def served(folder: Path, *arguments: str) -> Iterator[str]:
    """Run ``liaam studio`` on a folder in the block. Yield its address."""
    server = start(folder, "--port", "0", *arguments)
    try:
        yield server.address
    finally:
        server.stop()


def chromium() -> str | None:
    """Return the path of Chromium, if installed."""
    return os.environ.get("LIAAM_CHROMIUM") or next(filter(None, map(shutil.which, CHROMIUM_NAMES)), None)


def lacking() -> str | None:
    """Describe what is missing for a browser; None if nothing is."""
    if find_spec("playwright") is None:
        return "playwright is not installed: pip install '.[test]'"
    if chromium() is None:
        return "there is no Chromium on this machine (install one, or name it in LIAAM_CHROMIUM)"
    return None


@contextmanager
def launched(flags: Sequence[str] = ()) -> Iterator[Any]:
    """Yield a headless browser, if nothing is :func:`lacking`."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium(), args=[*FLAGS, *flags])
        yield browser
        browser.close()


@contextmanager
def browsing(size: tuple[int, int] = (1280, 720), flags: Sequence[str] = (), **options) -> Iterator[Any]:
    """Yield a page of a headless browser, or print why there is none and yield None."""
    reason = lacking()
    if reason:
        print(f"studio: skipped; {reason}")
        yield None
        return
    with launched(flags) as browser:
        yield browser.new_page(viewport={"width": size[0], "height": size[1]}, **options)


def main(data: str | None = None, letters: int = 2) -> None:
    """Print the metrics for generated images, and for many, or for a data set.

    The first `letters` of a name identify the person.
    """
    if data is None:
        newcomer()
        many()
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryDirectory() as elsewhere:
        pictures = material(Path(name)) if data is None else photographs(Path(name), Path(data), letters)
        flags = write_camera(Path(name) / "camera.mjpeg", read_image(pictures[0]))
        with browsing(flags=flags) as page, served(Path(name), "--model", f"{name}/model.liaam") as address:
            if page is None:
                return
            page.goto(address)
            page.locator("[data-testid=tab-fit]").click()
            page.wait_for_selector("[data-testid=tab-fit][aria-selected=true]")  # files can be dropped now
            drops(page, pictures[:2])  # warm
            times, seconds = [], []
            for path in pictures:
                times += drops(page, [path])
                seconds.append(page.evaluate("() => window.liaamStudio.fit.fit.seconds"))
            report("studio_drop_to_fit_ms", float(np.median(times)), f"worst {max(times):.0f}", form=".0f")
            for part in ("search", "fit"):
                report(f"studio_{part}_ms", 1000 * np.median([each[part] for each in seconds]), form=".0f")
            large = drops(page, [enlarged(path, Path(elsewhere)) for path in pictures[:4]])
            report("studio_large_drop_to_fit_ms", float(np.median(large)), f"worst {max(large):.0f}", form=".0f")
            drops(page, pictures[:1])
            report("studio_theta_frames_per_second", theta_rate(page), form=".0f")
            report("studio_relit_images_per_second", relight_rate(page), form=".0f")
            live(page)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None, int(sys.argv[2]) if len(sys.argv) > 2 else 2)
