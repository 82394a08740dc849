"""What happens outside of the page: other folders, other programs, and the address, in a real browser."""

import re
import shutil
from contextlib import suppress

import numpy as np
import pytest
from people import (
    NAMES,
    client,
    drag,
    dragging,
    kill,
    open_picture,
    opened,
    points_of,
    saved,
    wait_for,
    wait_for_point,
    wait_for_state,
    wait_for_tab,
    wait_until,
)

from liaam.io import Landmarks, read_image, read_landmarks, write_image, write_landmarks

pytestmark = pytest.mark.slow


def port_of(server) -> str:
    """Port of a server's address."""
    return server.address.split(":")[2].split("/")[0]


def go_to_another(page, address: str) -> None:
    """Go to the address of another folder on the same port.

    With the cookie of the new address, the page may see the other folder and reload itself, which ends a try. Where the
    machine is busy, this happens more than once.
    """
    for _ in range(5):
        with suppress(Exception):
            page.goto(address)
            return
    page.goto(address)


def test_unsaved_marks_stay_with_their_folder_whatever_another_is_called(serve, page, marked, tmp_path):
    other = tmp_path / "two" / "faces"
    shutil.copytree(marked, other)
    first = serve(marked, "--port", "0")
    page.goto(first.address)
    open_picture(page, NAMES[1])
    port = port_of(first)
    kill(first, page)
    drag(page, client(page, 2), [v + 30 for v in client(page, 2)])
    page.wait_for_selector("[data-testid=save-status]:not([data-state=saved])")
    mine = points_of(page)
    second = serve(other, "--port", port)
    stored = read_landmarks(other / "portrait-02.ljson").points
    go_to_another(page, second.address)
    open_picture(page, NAMES[1])
    assert np.abs(points_of(page) - stored).max() < 0.02
    second.kill()
    third = serve(marked, "--port", port)
    go_to_another(page, third.address)
    open_picture(page, NAMES[1])
    assert np.abs(points_of(page) - mine).max() < 0.02  # they waited for their own folder
    saved(page)
    assert np.abs(read_landmarks(marked / "portrait-02.ljson").points - mine).max() < 0.02


DROP = """([text, name]) => {
  const transfer = new DataTransfer();
  transfer.items.add(new File([text], name));
  document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
}"""


@pytest.mark.parametrize("width", [1280, 390])
def test_a_page_of_a_restarted_studio_asks_for_the_new_address(serve, page, marked, tmp_path, width):
    page.set_viewport_size({"width": width, "height": 720})
    first = serve(marked, "--port", "0")
    page.goto(first.address)
    opened(page, NAMES[0])
    first.kill()
    notice = page.locator("[data-testid=connection]")
    notice.get_by_text("not reachable").wait_for()
    shutil.rmtree(tmp_path / "state")  # with the token that both starts would have
    second = serve(marked, "--port", port_of(first))
    notice.get_by_text("The studio was restarted: open its new address").wait_for()
    assert notice.evaluate("it => it.scrollWidth <= it.clientWidth && it.getBoundingClientRect().right <= innerWidth")
    other = page.context.new_page()
    other.goto(second.address)  # the browser then has the new token
    notice.wait_for(state="hidden")


def test_a_page_goes_on_by_itself_when_the_studio_is_started_again(serve, page, marked):
    first = serve(marked, "--port", "0")
    page.goto(first.address)
    open_picture(page, NAMES[1])
    kill(first, page)
    drag(page, client(page, 2), [v + 30 for v in client(page, 2)])
    mine = points_of(page)
    serve(marked, "--port", port_of(first))
    page.locator("[data-testid=connection]").wait_for(state="hidden")
    saved(page)
    assert np.abs(read_landmarks(marked / "portrait-02.ljson").points - mine).max() < 0.02


def test_unsaved_marks_reach_a_studio_on_another_port(serve, page, marked, tmp_path):
    first = serve(marked, "--port", "0")
    page.goto(first.address)
    open_picture(page, NAMES[1])
    kill(first, page)
    drag(page, client(page, 2), [v + 30 for v in client(page, 2)])
    mine = points_of(page)
    with page.expect_download() as download:
        page.locator("[data-testid=save-work]").click()
    download.value.save_as(tmp_path / "work.json")
    page.goto(serve(marked, "--port", "0").address)
    open_picture(page, NAMES[1])
    assert np.abs(points_of(page) - mine).max() > 5
    page.evaluate(DROP, ["{}", "other.json"])
    page.locator(".toast.bad", has_text="1 file left out: other.json").wait_for()
    with page.expect_navigation():
        page.evaluate(DROP, [(tmp_path / "work.json").read_text(), "work.json"])
    opened(page, NAMES[1])
    saved(page)
    assert np.abs(read_landmarks(marked / "portrait-02.ljson").points - mine).max() < 0.02


def test_a_replaced_picture_is_shown_as_it_is_now(serve, page, marked):
    page.goto(serve(marked).address)
    open_picture(page, NAMES[0])
    size = page.evaluate("() => [liaamStudio.annotate.viewer.width, liaamStudio.annotate.viewer.height]")
    before = page.locator(f"[data-testid=strip] [data-name='{NAMES[0]}'] img").get_attribute("src")
    image = read_image(marked / NAMES[0])
    write_image(marked / NAMES[0], np.concatenate([image, image], axis=1))
    page.evaluate("() => dispatchEvent(new Event('focus'))")
    wait_for(page, "w => window.liaamStudio.annotate.viewer.width === w", 2 * size[0])
    face = f"[data-testid=strip] [data-name='{NAMES[0]}'] img[src]"
    wait_for(page, "([face, before]) => document.querySelector(face)?.getAttribute('src') !== before", [face, before])


def test_pictures_come_and_go_by_themselves(serve, page, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    shutil.copy(marked / NAMES[0], marked / "portrait-09.png")
    page.wait_for_selector("[data-testid=strip] [data-name='portrait-09.png']")
    (marked / "portrait-09.png").unlink()
    page.wait_for_selector("[data-testid=strip] [data-name='portrait-09.png']", state="detached")


def test_files_that_are_skipped_are_named_before_a_template_and_a_folder_that_is_gone_is_told(serve, page, folder):
    (folder / "phone.psd").write_bytes(b"")
    page.goto(serve(folder).address)
    page.locator("[data-testid=notices]:visible", has_text="phone.psd").wait_for()
    folder.rename(folder.with_name("elsewhere"))
    told = page.locator(".toast.bad", has_text="is the folder still there?")
    told.wait_for()
    folder.with_name("elsewhere").rename(folder)
    told.wait_for(state="detached")


def test_a_file_that_another_program_writes_is_shown_after_changes_on_the_page(serve, page, marked):
    page.goto(serve(marked).address)
    open_picture(page, NAMES[0])
    drag(page, client(page, 1), [v + 25 for v in client(page, 1)])
    saved(page)
    theirs = points_of(page) + 7
    write_landmarks(marked / "portrait-01.ljson", Landmarks(theirs))
    wait_for_point(page, 1, theirs[1].tolist())


def test_a_deleted_landmark_file_is_said_to_be_and_can_be_written_again(serve, page, marked):
    page.goto(serve(marked).address)
    open_picture(page, NAMES[2])
    mine = points_of(page)
    drag(page, client(page, 1), [v + 25 for v in client(page, 1)])
    saved(page)
    start = client(page, 2)
    with dragging(page, start, [v + 25 for v in start]):  # otherwise the page may find it first, and shows no points
        (marked / "portrait-03.ljson").unlink()
    page.locator("dialog", has_text=re.compile("deleted")).wait_for()
    page.keyboard.press("Enter")  # on the primary button, since whoever annotates presses Enter all the time
    saved(page)
    stored = read_landmarks(marked / "portrait-03.ljson").points
    assert np.abs(stored - points_of(page)).max() < 0.02
    assert np.abs(stored - mine).max() > 1


@pytest.mark.parametrize("is_slow", [False, True])
def test_a_template_changed_elsewhere_takes_unsaved_points_along(serve, page, marked, is_slow):
    """The request with the points fails before the template is changed, or arrives after that."""
    page.goto(serve(marked).address)
    open_picture(page, NAMES[1])
    # As another program would: the page hears of it when it looks again, or when its save is refused.
    page.evaluate(
        """async () => {
            const { template } = window.liaamStudio.state.project;
            const order = template.names.map((_, i) => template.names.length - 1 - i);
            const body = { names: order.map((i) => template.names[i]), contours: [], mirror: null,
                           points: order.map((i) => template.points[i]), mapping: order, revision: template.revision };
            window.liaamStudio.elsewhere = body;
        }"""
    )
    before = points_of(page)
    saves, is_up = [], False

    def answer(route):
        if is_up or route.request.method != "PUT":
            route.continue_()
            return
        saves.append(route)
        if not is_slow:
            route.abort()

    page.route("**/landmarks", answer)
    drag(page, client(page, 0), [v + 30 for v in client(page, 0)])
    wait_until(page, lambda: saves)
    mine = points_of(page)
    page.evaluate("""() => window.liaamStudio.app.api.put("/api/template", window.liaamStudio.elsewhere)""")
    before_change = page.evaluate("() => window.liaamStudio.elsewhere.revision")
    wait_for(page, "before => window.liaamStudio.state.project.template.revision !== before", before_change)
    is_up = True
    if is_slow:
        saves[0].continue_()
    wait_for_point(page, 4, mine[0].tolist())
    saved(page)
    assert np.abs(points_of(page) - mine[::-1]).max() < 0.02
    assert np.abs(read_landmarks(marked / "portrait-02.ljson").points - mine[::-1]).max() < 0.02
    assert np.abs(mine - before).max() > 1


def test_an_address_that_cannot_be_read_opens_the_page_all_the_same(serve, page, marked):
    server = serve(marked)
    page.goto(server.address)
    opened(page, NAMES[0])
    page.goto(f"http://127.0.0.1:{port_of(server)}/#100%")
    page.reload()
    page.wait_for_selector("[data-testid=strip] [data-name]")
    wait_for_state(page, NAMES[0], "done")


def test_back_and_forward_move_between_pictures_and_tabs(serve, page, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    page.wait_for_timeout(600)  # faster steps are one
    open_picture(page, NAMES[2])
    page.wait_for_timeout(600)
    page.locator("[data-testid=tab-measure]").click()
    wait_for_tab(page, "Measure")
    page.go_back()
    wait_for_tab(page, "Annotate")
    opened(page, NAMES[2])
    page.go_back()
    opened(page, NAMES[0])
    page.go_forward()
    opened(page, NAMES[2])
    page.go_forward()
    wait_for_tab(page, "Measure")
    page.reload()
    wait_for_tab(page, "Measure")
    assert page.evaluate("() => window.liaamStudio.state.current") == NAMES[2]
