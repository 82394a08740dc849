"""Bring pictures, folders and landmark files in, see them fitted, and see slips, in a real browser."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from people import annotate, drop, shoot, untrained, violations, wait_for, wait_for_state, wait_until
from test_layout import CLIPPED

from liaam import datasets
from liaam.io import Landmarks, read_image, write_image, write_landmarks
from liaam.io.landmarks import write_collection

pytestmark = pytest.mark.slow

FACE = Path(datasets.__file__).with_name("pictures") / "face" / "lisa.jpg"

READY = "() => document.querySelector('[role=tab][aria-selected=true]')"

NAMES = "() => [...document.querySelectorAll('.strip-item')].map((item) => item.dataset.name)"


def pictures_of(page) -> list[dict]:
    return page.evaluate("() => window.liaamStudio.state.project.pictures")


@pytest.fixture
def empty(tmp_path):
    """Give an empty folder."""
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


@pytest.fixture
def faces(tmp_path):
    """Give three photographs of a face, one of them hard to fit."""
    folder = tmp_path / "faces"
    folder.mkdir()
    image = read_image(FACE)
    noise = np.random.default_rng(0).integers(0, 150, image.shape)
    for name, picture in (
        ("a.png", image),
        ("b.png", np.clip(image // 4 + noise, 0, 255).astype(np.uint8)),
        ("c.png", image[:, ::-1]),
    ):
        write_image(folder / name, np.ascontiguousarray(picture))
    return sorted(folder.iterdir())


def test_pictures_and_landmarks_are_added_with_one_summary(
    serve, page, empty, whole_folder, marked, tmp_path, artefacts
):
    page.goto(serve(empty).address)
    wait_for(page, READY)
    assert page.locator("[data-testid=add-first]:visible").count() == 1
    shoot(page, artefacts, "40-nothing-yet")
    notes = tmp_path / "notes.txt"
    notes.write_text("Buy milk")
    drop(page, *sorted(marked.glob("*.png")), *sorted(marked.glob("*.ljson")), whole_folder / "portrait-04.png", notes)
    toast = page.locator(".toast", has_text="added")
    toast.wait_for()
    text = toast.inner_text()
    assert "4 pictures added, landmarks for 3, 1 file left out: notes.txt" in text
    assert len(list(empty.glob("*.png"))) == 4
    assert [picture["state"] for picture in pictures_of(page)] == ["done", "done", "done", "new"]
    drop(page, marked / "portrait-01.png")  # again
    page.locator(".toast", has_text="1 file already here").wait_for()


def test_a_table_for_all_pictures_is_added(serve, page, empty, portraits, tmp_path):
    collection = {f"p{i}.png": Landmarks(portraits[i].landmarks[:9]) for i in range(3)}
    for i in range(3):
        write_image(tmp_path / f"p{i}.png", portraits[i].image)
    sizes = dict.fromkeys(collection, (240, 320))
    write_collection(tmp_path / "all.tps", collection, dict.fromkeys(sizes, (320, 240)))
    page.goto(serve(empty).address)
    wait_for(page, READY)
    drop(page, tmp_path / "all.tps", *sorted(tmp_path.glob("p*.png")))
    page.locator(".toast", has_text="3 pictures added, landmarks for 3.").wait_for()


def test_a_folder_is_dropped(serve, page, empty, folder, tmp_path):
    nested = tmp_path / "session" / "second"
    nested.mkdir(parents=True)
    shutil.copy(folder / "portrait-01.png", tmp_path / "session")
    shutil.copy(folder / "portrait-02.png", nested)
    (nested / ".DS_Store").write_bytes(b"x")
    page.goto(serve(empty).address)
    page.locator("[data-testid=add-first]:visible").wait_for()
    session = page.context.new_cdp_session(page)
    data = {"items": [], "files": [str(tmp_path / "session")], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        session.send("Input.dispatchDragEvent", {"type": kind, "x": 600, "y": 400, "data": data})
    page.locator(".toast", has_text="2 pictures added.").wait_for()
    assert sorted(path.name for path in empty.glob("*.png")) == ["portrait-01.png", "portrait-02.png"]


def test_files_are_chosen_with_a_button(serve, page, empty, folder):
    page.goto(serve(empty).address)
    wait_for(page, READY)
    with page.expect_file_chooser() as chooser:
        page.locator("[data-testid=add-first]").click()
    assert chooser.value.is_multiple()
    chooser.value.set_files(sorted(folder.glob("*.png"))[:2])
    page.locator(".toast", has_text="2 pictures added.").wait_for()
    with page.expect_file_chooser() as chooser:
        page.locator("[data-testid=add-pictures]").click()
    chooser.value.set_files(folder / "portrait-03.png")
    page.locator(".toast", has_text="1 picture added.").wait_for()
    assert len(list(empty.glob("*.png"))) == 3


def test_faces_are_fitted_as_they_arrive_worst_first(serve, page, empty, faces, artefacts):
    page.goto(serve(empty, face=True).address)
    wait_for(page, READY)
    drop(page, *faces)
    for path in faces:
        wait_for_state(page, path.name, "proposed")
    wait_for(page, "() => !window.liaamStudio.state.project.fitting")
    qualities = {picture["name"]: picture for picture in pictures_of(page)}
    wait_for(page, "() => document.querySelectorAll('.strip-item').length === 3")
    shown = page.evaluate(NAMES)
    order = [
        0.0 if picture["nothing_found"] else picture["quality"] - picture["doubtful"]
        for picture in map(qualities.get, shown)
    ]
    assert order == sorted(order), order
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'proposal'")
    assert "face model" in page.locator(".assist").inner_text()
    shoot(page, artefacts, "41-faces-fitted")
    page.locator("[data-testid=tab-fit]").click()  # the model fits at once
    wait_for(page, "() => window.liaamStudio.fit.fit?.ok !== undefined")
    page.locator("[data-testid=tab-annotate]").click()
    used = []
    page.route("**/api/project*", lambda route: route.fulfill(json=route.fetch().json() | {"face_again": True}))

    def use(route):
        used.append(route.request.post_data_json["source"])
        route.fulfill(body="null", content_type="application/json")

    page.route("**/api/model", use)
    page.evaluate("() => window.liaamStudio.state.refresh()")
    page.locator("[data-testid=face-again]").click()
    page.locator(".toast", has_text="The face model places points again.").get_by_text("Undo").click()
    wait_until(page, lambda: used == ["face", "studio"])
    page.unroute_all(behavior="wait")
    page.locator("[data-testid=decline-face]").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'template'")
    assert page.evaluate("() => window.liaamStudio.state.project.template") is None


def test_new_pictures_are_accepted_on_the_wall(serve, page, whole_folder, portrait_model, portraits, artefacts):
    untrained(page)
    page.goto(serve(whole_folder, "--model", str(portrait_model)).address)
    wait_for_state(page, "portrait-12.png", "proposed")
    write_image(whole_folder / "new.png", portraits[0].image)  # fitted as soon as it lies in the whole_folder
    wait_for_state(page, "new.png", "proposed")
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'proposal'")
    before = page.locator("[data-testid=wall]").bounding_box()
    page.locator("[data-testid=export-all]").select_option("pts")
    refused = page.locator(".toast.bad", has_text="the points of 13 pictures are only proposed: accept them")
    refused.locator("[data-testid=toast-action]").click()
    wait_for(page, "() => document.querySelectorAll('.wall-points').length === 13")
    assert page.locator("[data-testid=wall]").bounding_box() == before  # a second press closes the wall
    assert page.locator(".stage:visible").count() == 0
    shoot(page, artefacts, "43-wall")
    assert page.evaluate(CLIPPED) == [] and violations(page) == {}
    qualities = sorted((picture["quality"], picture["name"]) for picture in pictures_of(page))
    level = page.locator("[data-testid=wall-level]")
    level.fill(str(int(100 * qualities[6][0])))
    sure = [name for quality, name in qualities if quality >= float(level.input_value()) / 100]
    page.locator("[data-testid=wall-accept]").click()
    page.locator(".toast", has_text=f"Points of {len(sure)} pictures accepted").wait_for()
    for name in sure:
        wait_for_state(page, name, "done")
    assert sum(picture["state"] == "done" for picture in pictures_of(page)) == len(sure)
    page.locator("[data-testid=bulk-undo]").click()
    wait_for_state(page, sure[0], "proposed")
    page.keyboard.press("ArrowDown")  # a row further
    page.keyboard.press("Enter")
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'proposal'")
    page.keyboard.press("w")
    wait_for(page, "name => window.liaamStudio.annotate.name() === name", qualities[0][1])
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'proposal'")
    page.keyboard.press("Enter")  # then the next worst
    wait_for(page, "name => window.liaamStudio.annotate.name() === name", qualities[1][1])

    page.set_viewport_size({"width": 640, "height": 560})  # so that the wall has to be scrolled
    page.keyboard.press("g")
    wait_for(page, "() => document.querySelector('[data-testid=strip]').scrollTop === 0")  # it begins with the worst
    page.keyboard.press("PageDown")
    page.keyboard.press("PageDown")
    wait_for(page, "() => document.querySelector('[data-testid=strip]').scrollTop > 100")
    page.wait_for_timeout(100)
    top = page.evaluate("() => document.querySelector('[data-testid=strip]').scrollTop")
    page.keyboard.press("Enter")
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'proposal'")
    page.keyboard.press("g")  # and is where it was, although that picture may have moved in it
    wait_for(page, "top => Math.abs(document.querySelector('[data-testid=strip]').scrollTop - top) < 2", top)
    page.keyboard.press("Shift+Enter")  # accept what is in view

    def proposed() -> list[str]:
        return [picture["name"] for picture in pictures_of(page) if picture["state"] == "proposed"]

    wait_until(page, lambda: len(proposed()) < 12)
    assert violations(page) == {}
    assert qualities[1][1] in proposed()  # which is further up
    page.keyboard.press("Home")
    page.evaluate("() => { document.querySelector('[data-testid=strip]').scrollTop = 0; }")
    page.locator(f"[data-testid=strip] [data-name='{qualities[1][1]}']").click()
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'proposal'")
    page.keyboard.press("Shift+Enter")  # back to the wall, and accept what is in view there
    wait_for_state(page, qualities[1][1], "done")
    assert page.locator("[data-testid=wall-page]").is_visible()


def test_points_that_were_placed_anew_since_a_look_are_not_accepted(serve, page, whole_folder, portrait_model):
    untrained(page)
    page.goto(serve(whole_folder, "--model", str(portrait_model)).address)
    wait_for_state(page, "portrait-12.png", "proposed")
    wait_for(page, "() => window.liaamStudio.annotate.source() === 'proposal'")
    page.keyboard.press("g")
    wait_for(page, "() => document.querySelectorAll('.wall-points').length === 12")
    page.locator("[data-testid=wall-level]").fill("50")
    sure = [each["name"] for each in pictures_of(page) if each["quality"] >= 0.5 and not each["doubtful"]]
    assert len(sure) > 2
    # As by a training that ends while the picture is out of view.
    page.evaluate("name => { window.liaamStudio.state.picture(name).quality = 0.995; }", sure[1])
    page.locator("[data-testid=wall-accept]").click()
    page.locator(".toast", has_text="placed the points of 1 picture that you looked at").wait_for()
    page.locator(".toast", has_text=f"Points of {len(sure) - 1} pictures accepted").wait_for()
    wait_for_state(page, sure[0], "done")
    assert [each["state"] for each in pictures_of(page) if each["name"] == sure[1]] == ["proposed"]
    page.locator("[data-testid=wall-accept]").click()  # after another look
    wait_for_state(page, sure[1], "done")
    order = page.locator("[data-testid=strip-order]")
    assert order.input_value() == "quality"
    page.keyboard.press("g")
    assert order.input_value() == "name"  # as before the wall
    items = page.locator("[data-testid=strip] [data-name]")
    in_order = "items => items.map((item) => item.dataset.name)"
    items.first.wait_for()
    shown = items.evaluate_all(in_order)
    assert shown == sorted(shown)
    page.keyboard.press("g")
    order.select_option("name")  # on the wall
    wait_until(page, lambda: len(items.evaluate_all(in_order)) == 12)
    shown = items.evaluate_all(in_order)
    assert shown == sorted(shown)


RED = """([x, y]) => {
  const { canvas, container } = window.liaamStudio.annotate.viewer;
  const ratio = canvas.width / canvas.clientWidth;
  const [own, outer] = [canvas, container].map((element) => element.getBoundingClientRect());
  const at = [x - 12 + outer.left - own.left, y - 12 + outer.top - own.top, 24, 24].map((v) => Math.round(ratio * v));
  const { data } = canvas.getContext("2d").getImageData(...at);
  return Array.from({ length: data.length / 4 }, (_, i) => data.slice(4 * i, 4 * i + 3))
    .map(([r, g, b]) => r > 240 && Math.abs(g - 90) < 12 && Math.abs(b - 79) < 12);
}"""


def test_a_slip_is_shown_beside_the_picture_and_before_training(serve, page, whole_folder, portraits, artefacts):
    for i, scene in enumerate(portraits[:9], 1):
        points = scene.landmarks.copy()
        if i == 3:
            points[[33, 39]] = points[[39, 33]]
        write_landmarks(whole_folder / f"portrait-{i:02d}.ljson", Landmarks(points))
    untrained(page)
    page.goto(serve(whole_folder).address)
    wait_for(page, "() => window.liaamStudio?.state.picture('portrait-03.png')?.slip")
    page.locator("[data-testid=strip-filter]").select_option("slips")
    wait_for(page, "() => document.querySelectorAll('.strip-item').length === 1")
    page.locator(".strip-item").click()
    wait_for(page, "() => window.liaamStudio.annotate?.name() === 'portrait-03.png'")
    assert "exchanged" in page.locator("[data-testid=why-next]").inner_text()
    assert sorted(annotate(page, "wrong()")) == [33, 39]
    wait_for(page, "() => window.liaamStudio.annotate.points()?.length === 58")
    x, y = annotate(page, "viewer.toScreen(window.liaamStudio.annotate.points()[33])")
    assert any(page.evaluate(RED, [x, y]))  # a ring around the point
    shoot(page, artefacts, "42-slip")
    page.locator("[data-testid=train]").click()
    dialog = page.locator("dialog[open]")
    assert "portrait-03.png" in dialog.inner_text()
    dialog.locator("[data-testid=look-at-slips]").click()
    assert page.evaluate("() => window.liaamStudio.state.project.training.state") == "idle"
    assert annotate(page, "name()") == "portrait-03.png"
    page.locator("[data-testid=annotate-viewer] canvas").first.focus()
    page.keyboard.press("Enter")  # the points are right
    page.locator("[data-testid=who]").fill("Ada")
    page.locator("[data-testid=who-save]").click()
    wait_for(page, "() => window.liaamStudio.state.picture('portrait-03.png').checked === 'Ada'")
    wait_for(page, "() => !window.liaamStudio.state.picture('portrait-03.png').slip")
    wait_for(page, "() => window.liaamStudio.annotate.name() !== 'portrait-03.png'")
