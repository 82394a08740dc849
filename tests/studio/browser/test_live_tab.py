"""The Live tab in a real browser, with a file as the camera: tracking, shading, timeline, recording, export."""

import base64
import csv
import re
from pathlib import Path

import av
import numpy as np
import pytest
from people import shoot, violations, wait_for
from shared_browser import SHARED

from benchmarks.studio import lacking, write_camera
from liaam.io import video_writer
from liaam.training import train

pytestmark = pytest.mark.slow

SIZE = "() => { const video = window.liaamStudio.live.video(); return [video.videoWidth, video.videoHeight]; }"

DURATION = """async (data) => {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const video = document.createElement("video");
  video.src = URL.createObjectURL(new Blob([bytes], { type: "video/webm" }));
  await new Promise((resolve, reject) => { video.onloadedmetadata = resolve; video.onerror = reject; });
  video.currentTime = video.duration / 2;
  await new Promise((resolve) => { video.onseeked = resolve; });
  return video.duration;
}"""

STATUS = "[data-testid=live-status]"

TRACKED = "() => window.liaamStudio.live.shown()?.fit.ok"

SEEK = """(time) => {
  const slider = document.querySelector("[data-testid=live-time]");
  slider.value = time;
  slider.dispatchEvent(new Event("input"));
}"""

WITHOUT_SHADING = "() => window.liaamStudio.live.shown()?.flat"

MORE = "n => window.liaamStudio.live.track().rows.size >= n"


@pytest.fixture(scope="module")
def picture(portraits) -> np.ndarray:
    """Give a picture that the model was not trained on, 640×480."""
    return portraits[9].image.repeat(2, axis=0).repeat(2, axis=1)


@pytest.fixture(scope="module")
def browser(picture, tmp_path_factory):
    """Give a browser with a camera in which the picture moves to and fro."""
    reason = lacking()
    if reason:
        pytest.skip(reason)
    return SHARED.with_flags(write_camera(tmp_path_factory.mktemp("camera") / "camera.mjpeg", picture))


@pytest.fixture(scope="session")
def portrait_model(portraits, tmp_path_factory) -> Path:
    """Give a model of the portraits."""
    path = tmp_path_factory.mktemp("model") / "portraits.liaam"
    train([(scene.image, scene.landmarks) for scene in portraits[:8]], leave_out=False, methods="all", lamps=None).save(
        path
    )
    return path


@pytest.fixture
def live(serve, page, folder, portrait_model):
    """Give the page with the Live tab open."""
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    open_live(page)
    return page


def open_live(page) -> None:
    page.locator("[data-testid=tab-live]").click()
    page.wait_for_selector("[data-testid=tab-live][aria-selected=true]")


def use_camera(page) -> None:
    """Start the camera, and wait until the object is found."""
    page.locator("[data-testid=live-camera]").click()
    wait_for(page, TRACKED)


def drawn(page) -> None:
    """Wait until the page has been drawn."""
    page.evaluate("() => new Promise((then) => requestAnimationFrame(() => requestAnimationFrame(then)))")


def pause(page) -> None:
    """Pause, and wait until the last frame is fitted and drawn."""
    page.evaluate("() => window.liaamStudio.live.video().pause()")
    drawn(page)  # the last frame has been sent
    wait_for(page, "() => window.liaamStudio.live.isIdle()")
    drawn(page)


def saved(page, button: str, path: Path) -> Path:
    """Click a button that saves a file, and give the file."""
    with page.expect_download() as download:
        page.locator(f"[data-testid={button}]").click()
    download.value.save_as(path / download.value.suggested_filename)
    return path / download.value.suggested_filename


def test_the_camera_is_tracked_and_exported(live, tmp_path):
    use_camera(live)
    wait_for(live, MORE, 10)
    live.locator(STATUS, has_text=re.compile("quality unknown|machine is slow")).wait_for()
    rows = list(csv.DictReader(saved(live, "live-save", tmp_path).open()))
    assert len(rows) >= 10
    assert {row["status"] for row in rows} <= {"found", "tracked", "corrected", "lost"}
    times = [float(row["time"]) for row in rows]
    assert times == sorted(times)
    assert int(rows[0]["frame"]) == 0 < int(rows[1]["frame"])
    x = np.array([float(row["x1"]) for row in rows if row["x1"]])
    assert np.ptp(x) > 1 and x.min() > 0 and x.max() < 640


def test_the_shading_is_removed_and_the_picture_recorded(live, tmp_path):
    use_camera(live)
    live.locator("[data-testid=live-flat]").click()
    wait_for(live, WITHOUT_SHADING)
    assert live.locator("[data-testid=live-divider]").is_visible()
    live.locator("[data-testid=live-record]").click()
    live.locator("[data-testid=live-record][aria-pressed=true]").wait_for()
    wait_for(live, "() => window.liaamStudio.live.recorded() > 1000")
    video = saved(live, "live-record", tmp_path)
    assert video.suffix == ".webm" and video.stat().st_size > 1000
    assert video.read_bytes().startswith(b"\x1a\x45\xdf\xa3"), "not a WebM file"


def test_the_recording_is_the_picture_at_its_own_rate_and_seekable(live, tmp_path):
    use_camera(live)
    rows_and_time = "() => [window.liaamStudio.live.track().rows.size, performance.now() / 1000]"
    live.locator("[data-testid=live-record]").click()
    rows_before, began = live.evaluate(rows_and_time)
    live.wait_for_timeout(2500)
    wait_for(live, "() => window.liaamStudio.live.recorded() > 1000")
    _, asked_to_end = live.evaluate(rows_and_time)
    video = saved(live, "live-record", tmp_path)
    rows_after, ended = live.evaluate(rows_and_time)
    tracked = rows_after - rows_before
    with av.open(str(video)) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        seconds = container.duration / av.time_base
        assert [stream.width, stream.height] == live.evaluate(SIZE)
        # An encoder takes a while to begin, and a page that is busy a while to hear that it shall end.
        assert 0.4 * (asked_to_end - began) < seconds < 1.1 * (ended - began)
        assert len(frames) / seconds > 0.6 * tracked / (ended - began)
    seen = frames[-1].to_ndarray(format="rgb24").astype(float)
    assert not (seen.max(axis=2) < 8).all(axis=0).any()  # no black columns
    data = base64.b64encode(video.read_bytes()).decode()
    assert live.evaluate(DURATION, data) == pytest.approx(seconds, abs=0.1)


def test_the_camera_is_off_in_other_tabs(live):
    use_camera(live)
    live.locator("[data-testid=tab-fit]").click()
    wait_for(live, "() => !window.liaamStudio.live.isOpen()")
    open_live(live)
    live.locator("[data-testid=live-camera]").wait_for()
    assert live.locator(STATUS).inner_text() == "No video."
    live.locator(".toast", has_text="its track of").wait_for()


def test_a_video_is_tracked_and_its_frames_are_kept(live, picture, artefacts, tmp_path):
    path = tmp_path / "talk.webm"
    with video_writer(path, 10) as writer:
        for i in range(20):
            writer.write(np.roll(picture, i, axis=1), i / 10)
    live.locator("[data-testid=live-file]").set_input_files(path)
    wait_for(live, TRACKED)
    wait_for(live, "() => window.liaamStudio.live.video().ended")
    live.locator("[data-testid=live-play]", has_text="Play").wait_for()
    for time in ("0.2", "0.5"):  # a busy machine may have skipped their frames while the video played
        live.evaluate(SEEK, time)
        wait_for(live, f"() => Math.abs(window.liaamStudio.live.shown().time - {time}) < 0.06")
        wait_for(live, TRACKED)
    shoot(live, artefacts, "live-timeline")
    strip = live.locator("#tab-live .live-strip")
    before = strip.evaluate("strip => strip.toDataURL()")
    live.locator("[data-testid=tab-fit]").click()
    live.evaluate(SEEK, "0.2")  # its frame is drawn while the tab is hidden
    wait_for(live, "() => Math.abs(window.liaamStudio.live.shown().time - 0.2) < 0.06")
    wait_for(live, TRACKED)
    open_live(live)
    assert strip.evaluate("strip => strip.toDataURL()") == before
    file = saved(live, "live-save", tmp_path)
    assert file.name == "talk_track.csv"
    assert 1 < len(list(csv.DictReader(file.open()))) <= 20


def test_without_a_model_the_tab_says_what_to_do(serve, page, folder):
    page.goto(serve(folder).address)
    open_live(page)
    assert page.locator("[data-testid=live-camera]").is_disabled()
    page.locator("#tab-live").get_by_role("button", name="Annotate pictures").click()
    page.wait_for_selector("[data-testid=tab-annotate][aria-selected=true]")


@pytest.mark.parametrize("fault", ["NotAllowedError", "NotFoundError", "NotReadableError", "OddError"])
def test_a_camera_that_cannot_be_used_is_explained(live, fault):
    live.evaluate(
        "(name) => { navigator.mediaDevices.getUserMedia = async () => { throw new DOMException('odd', name); }; }",
        fault,
    )
    live.locator("[data-testid=live-camera]").click()
    said = {"NotAllowedError": "Allow it", "NotFoundError": "no camera", "NotReadableError": "another program"}
    live.locator(STATUS, has_text=said.get(fault, "cannot be used (odd)")).wait_for()


def test_a_file_that_is_no_video_is_explained(live, tmp_path):
    path = tmp_path / "notes.mp4"
    path.write_text("no video")
    live.locator("[data-testid=live-file]").set_input_files(path)
    live.locator(STATUS, has_text="cannot play notes.mp4").wait_for()


def test_a_video_that_the_server_has_ended_goes_on(live):
    use_camera(live)
    live.evaluate("""async () => { for (let i = 0; i < 5; i += 1) await fetch("/api/live", {method: "POST"}); }""")
    count = live.evaluate("() => window.liaamStudio.live.track().rows.size")
    wait_for(live, MORE, count + 5)


@pytest.mark.parametrize("size", [(1280, 720), (820, 1180), (390, 844)], ids=str)
def test_the_tab_fits_every_screen(live, artefacts, size):
    live.set_viewport_size({"width": size[0], "height": size[1]})
    shoot(live, artefacts, f"{size[0]}-live-empty")
    use_camera(live)
    live.locator("[data-testid=live-flat]").click()
    wait_for(live, WITHOUT_SHADING)
    for scheme in ("light", "dark"):
        live.emulate_media(color_scheme=scheme)
        assert violations(live) == {}
        shoot(live, artefacts, f"{size[0]}-live-{scheme}")
    canvas = live.locator("#tab-live .viewer canvas").first.bounding_box()
    assert canvas["height"] > 0.25 * size[1] and canvas["width"] > 0.5 * size[0]
    assert live.evaluate("() => document.documentElement.scrollWidth <= innerWidth")


GRAPHS = ".live-graph canvas"

READ = "() => [...document.querySelectorAll('.live-graphs .number')].slice(0, 3).map((each) => each.textContent)"

DRAWN = f"() => ({READ})().every((text) => /[0-9]/.test(text))"


def test_graphs_show_what_the_exported_track_says(live, tmp_path):
    use_camera(live)
    live.locator("[data-testid=live-from]").select_option("3")
    live.locator("[data-testid=live-to]").select_option("7")
    wait_for(live, MORE, 20)
    pause(live)
    live.wait_for_timeout(1000)  # graphs are drawn at intervals
    assert live.locator(GRAPHS).count() == 4
    shown = [float(re.sub("[^-0-9.]", "", text)) for text in live.evaluate(READ)]
    row = list(csv.DictReader(saved(live, "live-save", tmp_path).open()))[-1]
    place = {name: float(value) for name, value in row.items() if re.fullmatch("[xy][0-9]+|roll_deg|size", name)}
    away = np.hypot(place["x4"] - place["x8"], place["y4"] - place["y8"])
    np.testing.assert_allclose(shown, [away, place["roll_deg"], place["size"]], atol=0.06)


def test_a_click_on_a_graph_seeks_in_a_video(live, picture, artefacts, tmp_path):
    path = tmp_path / "talk.webm"
    with video_writer(path, 10) as writer:
        for i in range(20):
            writer.write(np.roll(picture, i, axis=1), i / 10)
    live.locator("[data-testid=live-file]").set_input_files(path)
    wait_for(live, "() => window.liaamStudio.live.video().ended")
    wait_for(live, DRAWN)
    plot = live.locator(".live-graph .u-over").first
    box = plot.bounding_box()
    plot.click(position={"x": box["width"] / 4, "y": 20})
    wait_for(live, "() => Math.abs(window.liaamStudio.live.video().currentTime - 0.5) < 0.1")
    wait_for(live, "() => Math.abs(window.liaamStudio.live.shown().time - 0.5) < 0.15")
    assert live.evaluate("() => window.liaamStudio.live.track().run") > 0  # what is not watched is a gap
    live.wait_for_timeout(300)
    for scheme in ("light", "dark"):
        live.emulate_media(color_scheme=scheme)
        live.wait_for_timeout(300)
        shoot(live, artefacts, f"live-graphs-{scheme}")


def test_the_pair_of_points_is_kept(live):
    assert live.evaluate("() => window.liaamStudio.live.pair()") == [0, 1]
    use_camera(live)
    live.locator("[data-testid=live-to]").select_option("9")
    live.reload()
    wait_for(live, "() => window.liaamStudio?.live?.pair()?.[1] === 9")


def test_with_the_face_model_the_opening_of_the_mouth_is_shown_first(serve, page, tmp_path):
    (tmp_path / "empty").mkdir()
    page.goto(serve(tmp_path / "empty", face=True).address)
    open_live(page)
    chosen = "(end) => document.querySelector(`[data-testid=live-${end}]`).selectedOptions[0]?.textContent"
    wait_for(page, f"() => ({chosen})('from') === 'upper_lip_bottom' && ({chosen})('to') === 'lower_lip_top'")


PIXELS = """() => {
  const { viewer } = window.liaamStudio.live;
  const { canvas, width, height, left, top, scale } = viewer;
  const copy = Object.assign(document.createElement("canvas"), { width: 64, height: 48 });
  const [inner, outer] = [viewer.container, canvas].map((each) => each.getBoundingClientRect());
  const ratio = canvas.width / outer.width;
  const from = [left + inner.left - outer.left, top + inner.top - outer.top, scale * width, scale * height];
  copy.getContext("2d").drawImage(canvas, ...from.map((v) => v * ratio), 0, 0, 64, 48);
  return [...copy.getContext("2d").getImageData(0, 0, 64, 48).data];
}"""


def test_a_front_camera_is_shown_as_in_a_mirror_and_its_data_are_not(live):
    use_camera(live)
    assert live.evaluate("() => window.liaamStudio.live.mirrored()")
    pause(live)
    ways, shapes = {}, {}
    for flat in (False, True):
        if flat:
            live.locator("[data-testid=live-flat]").click()
            wait_for(live, WITHOUT_SHADING)
        for mirrored in (True, False):
            drawn(live)
            data = live.evaluate(PIXELS)
            ways[flat, mirrored] = np.array(data).reshape(48, 64, 4)[..., :3].astype(float)
            shapes[flat, mirrored] = live.evaluate("() => window.liaamStudio.live.shown().fit.shape")
            live.locator("[data-testid=live-mirror]").click()
    assert np.abs(ways[False, True] - ways[False, False][:, ::-1]).mean() < 4  # with the fit that is drawn over it
    assert np.abs(ways[False, True] - ways[False, False]).mean() > 8
    assert shapes[False, True] == shapes[False, False]
    # The divider stays where it is: the picture without shading is to the right of it both times.
    for mirrored in (True, False):
        changed = np.abs(ways[True, mirrored] - ways[False, mirrored]).mean(axis=(0, 2))
        assert changed[34:].sum() > 5 * changed[:30].sum()


def test_a_camera_is_chosen_and_kept(live):
    live.evaluate("""() => {
      const { mediaDevices } = navigator;
      const own = mediaDevices.getUserMedia.bind(mediaDevices);
      window.asked = [];
      mediaDevices.getUserMedia = async (what) => { window.asked.push(what.video); return own({ video: true }); };
      mediaDevices.enumerateDevices = async () => [
        { kind: "videoinput", deviceId: "lid", label: "Camera in the lid" },
        { kind: "audioinput", deviceId: "ear", label: "Microphone" },
        { kind: "videoinput", deviceId: "desk", label: "" },
      ];
    }""")
    use_camera(live)
    cameras = live.locator("[data-testid=live-cameras]")
    assert cameras.locator("option").all_inner_texts() == ["Camera in the lid", "Camera 2"]
    cameras.select_option("desk")
    wait_for(live, "() => window.asked.length === 2")
    wait_for(live, TRACKED)
    live.locator("[data-testid=live-stop]").click()
    assert cameras.is_hidden() and live.locator("[data-testid=live-mirror]").is_hidden()
    use_camera(live)
    asked = live.evaluate("() => window.asked")
    assert asked[0]["facingMode"] == "user"
    assert [each["deviceId"] for each in asked[1:]] == [{"ideal": "desk"}] * 2
