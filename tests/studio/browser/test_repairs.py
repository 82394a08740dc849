"""What must stay right: labels, messages, fixed targets, undo, Escape, Back, reloads, and small screens."""

from pathlib import Path
from urllib.parse import unquote

import pytest
from people import (
    NAMES,
    annotate,
    as_expert,
    client,
    open_picture,
    opened,
    saved,
    shoot,
    wait_for,
    wait_for_state,
    wait_until,
)
from test_adding import READY

from liaam.io import Landmarks, write_landmarks

pytestmark = pytest.mark.slow

SHOWN = "**/image?*size=2048*"
"""Requests of pictures, but not of their thumbnails."""

OPEN = "name => window.liaamStudio?.annotate?.name() === name && window.liaamStudio.annotate.source()"


@pytest.fixture
def small(serve, page, marked):
    """Give the page of three done pictures."""
    page.goto(serve(marked).address)
    wait_for(page, OPEN, NAMES[0])
    return page


def select(page, name: str) -> None:
    page.evaluate("name => window.liaamStudio.state.select(name)", name)
    wait_for(page, OPEN, name)


def drag(page, index: int) -> None:
    """Drag a point a little, and wait until it is saved."""
    x, y = client(page, index)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 12, y + 8, steps=4)
    page.mouse.up()
    wait_for(page, "() => window.liaamStudio.annotate.undoSteps() === 1 && !window.liaamStudio.annotate.isDirty()")


def test_no_label_for_a_layer_that_is_not_there(serve, page, folder, portrait_model):
    waiting = []
    page.route("**/layers/flat*", lambda route: waiting.append(route))  # Playwright wants a function of Python
    page.goto(serve(folder, "--model", str(portrait_model)).address + "&tab=fit")
    wait_for(page, READY)
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit?.fit?.ok")
    page.locator("[data-testid=layer-flat]").click()
    for _ in range(200):
        if waiting:
            break
        page.wait_for_timeout(50)
    page.wait_for_timeout(300)
    assert not page.locator("#tab-fit [data-testid=divider]").is_visible()
    waiting[0].continue_()
    page.locator("#tab-fit [data-testid=divider]").wait_for()


def test_a_server_that_is_away_is_told_once(serve, page, marked, artefacts):
    server = serve(marked)
    page.goto(server.address)
    wait_for(page, OPEN, NAMES[0])
    server.kill()
    page.locator("[data-testid=connection]").wait_for()
    page.locator("[data-testid=check]").click()  # needs the server
    page.keyboard.press("Escape")
    page.locator("[data-testid=train]").click()
    page.wait_for_timeout(1500)
    shoot(page, artefacts, "50-away")
    assert page.locator(".toast").count() == 0


def test_nothing_moves_under_the_pointer_when_a_training_begins(small):
    targets = ["accept-next", "skip-next", "train", "auto-train", "check"]

    def places() -> list:
        return [small.locator(f"[data-testid={name}]").bounding_box() for name in targets]

    tell = """running => {
      const { state } = window.liaamStudio;
      const training = { state: running ? "running" : "idle", done: 1, total: 9, what: "images" };
      Object.assign(state.project, { training: { ...training, error: null } });
      state.dispatchEvent(new CustomEvent("training", { detail: state.project.training }));
    }"""
    before = places()
    # At rest nothing is animated: a bar of progress, which keeps its place, takes an eighth of a core even if hidden.
    wait_for(small, "() => document.getAnimations().length === 0")
    small.evaluate(tell, True)
    small.locator("[data-testid=training-cancel]").wait_for()
    assert small.locator("[data-testid=training-progress] p").inner_text() == "Training, 11 %"
    assert places() == before
    small.evaluate(tell, False)
    small.locator("[data-testid=training-cancel]").wait_for(state="hidden")
    assert places() == before


def test_undo_is_kept_on_opening_another_picture(small):
    before = annotate(small, "points()")
    drag(small, 1)
    select(small, NAMES[1])
    small.wait_for_timeout(1000)  # the save has been announced to all pages
    select(small, NAMES[0])
    assert annotate(small, "undoSteps()") == 1
    small.keyboard.press("Control+z")
    assert annotate(small, "points()") == before


def test_escape_ends_the_selection_of_several_wherever_the_focus_is(small):
    small.locator("[data-testid=strip-several]").click()
    small.locator("[data-testid=annotate-viewer] canvas").first.focus()
    small.keyboard.press("Escape")
    assert small.locator("[data-testid=strip-several]").get_attribute("aria-pressed") == "false"


def test_back_leads_through_tabs_and_pictures(serve, page, marked, portrait_model):
    page.goto(serve(marked, "--model", str(portrait_model)).address)
    wait_for(page, OPEN, NAMES[0])
    page.wait_for_timeout(600)  # quicker steps are one
    page.locator("[data-testid=tab-fit]").click()
    page.wait_for_timeout(600)
    page.evaluate("name => window.liaamStudio.state.select(name)", NAMES[2])
    page.wait_for_timeout(600)
    page.locator("[data-testid=tab-live]").click()
    page.wait_for_timeout(600)
    tab = "() => document.querySelector('[role=tab][aria-selected=true]').dataset.testid"
    for expected in (("tab-fit", NAMES[2]), ("tab-fit", NAMES[0]), ("tab-annotate", NAMES[0])):
        page.go_back()
        page.wait_for_timeout(300)
        assert (page.evaluate(tab), page.evaluate("() => window.liaamStudio.state.current")) == expected


def test_a_picture_that_is_deleted_says_so(small, marked):
    for file in marked.glob("portrait-01.*"):
        file.unlink()
    small.locator(".toast", has_text="portrait-01.png is no longer in the folder").wait_for()


def test_after_the_last_picture_the_page_leads_on(small, artefacts):
    for name in ("review", "measure", "export", "fit", "live"):
        assert small.locator(f"[data-testid=then-{name}]").is_visible()
    assert small.locator("[data-testid=accept-next]").is_disabled()
    shoot(small, artefacts, "51-all-done")
    small.locator("[data-testid=then-measure]").click()
    measures = small.locator("[data-testid=measure-list] li")
    for kind, points in (("distance", [0, 1]), ("angle", [0, 1, 2])):
        small.locator(f"[data-testid=measure-kind-{kind}]").click()
        for point in points:
            small.locator(f".plot-pick[data-index='{point}']").click()
    wait_until(small, lambda: measures.count() == 2)
    fault = small.locator("[data-testid=measure-scale-fault]")
    scale = small.locator("[data-testid=measure-scale]")
    for leave in ("value", "tab"):  # what was wrong with the value goes with either
        scale.fill("one pixel")
        small.evaluate("() => window.liaamStudio.state.select('portrait-02.png')")
        scale.press("Enter")  # what is typed has stayed although the tab was drawn again
        fault.wait_for()
        assert scale.input_value() == "one pixel"
        if leave == "tab":
            small.locator("[data-testid=tab-fit]").click()
            small.locator("[data-testid=tab-measure]").click()
            assert not fault.is_visible() and scale.input_value() == "1-3=4"
        scale.fill("1-3=5,5 mm" if leave == "tab" else "1-3=4")
        scale.press("Enter")
        fault.wait_for(state="hidden")
    with small.expect_download() as download:
        small.locator("[data-testid=measure-save]").select_option("csv")
    table = Path(download.value.path()).read_text().splitlines()
    assert table[0].startswith("specimen,") and "angle_1_2_3" in table[0]
    assert len(table) == 4
    small.locator("[data-testid=tab-annotate]").click()
    small.locator("[data-testid=then-review]").click()
    assert small.locator("[data-testid=strip-filter]").input_value() == "review"
    small.locator("[data-testid=then-live]").click()
    small.locator("[data-testid=tab-live][aria-selected=true]").wait_for()


def test_compare_shows_the_object_on_a_phone(serve, open_page, folder, portrait_model, portraits, artefacts):
    write_landmarks(folder / "portrait-01.ljson", Landmarks(portraits[0].landmarks))
    page = open_page(390, 844, has_touch=True)
    as_expert(page)
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    wait_for(page, READY)
    page.locator("[data-testid=tab-compare]").click()
    wait_for(page, "() => ['left', 'right'].every((side) => window.liaamStudio.compare[side].fit)")
    page.wait_for_timeout(300)
    shoot(page, artefacts, "52-compare-390")
    width = page.evaluate("""() => {
      const { fit, viewer } = window.liaamStudio.compare.left;
      const xs = fit.shape.map((point) => viewer.toScreen(point)[0]);
      return Math.max(...xs) - Math.min(...xs);
    }""")
    assert width > 100


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_picture_begins_high_on_a_low_page(serve, open_page, marked, artefacts, theme):
    page = open_page(640, 400, color_scheme=theme)
    page.goto(serve(marked).address)
    wait_for(page, OPEN, NAMES[0])
    shoot(page, artefacts, f"53-low-{theme}")
    assert page.locator("[data-testid=annotate-viewer]").bounding_box()["y"] < 210
    wait_for_state(page, NAMES[0], "done")


def test_a_proposal_that_comes_while_a_picture_opens_is_shown(serve, page, folder, portrait_model):
    """A large picture takes seconds to open, in which its marks may change."""
    held, answered = [], []
    states = {}  # of the pictures, as the page knows them

    def list_pictures(route):
        response = route.fetch()
        listed = response.json()
        if not states and any(picture["state"] == "new" for picture in listed["pictures"]):
            for picture in listed["pictures"]:  # as before the first proposal; the list is fetched again with the next
                picture["state"] = picture["state"].replace("proposed", "new")
        states.update({picture["name"]: picture["state"] for picture in listed["pictures"]})
        route.fulfill(response=response, json=listed)

    def answer(route):
        if route.request.method != "GET" or answered:
            route.continue_()
            return
        answered.append(route)
        name = unquote(route.request.url.rpartition("/landmarks")[0].partition("/pictures/")[2])
        if states.get(name) == "proposed":  # the proposal came before the page, which asks for no other marks
            route.continue_()
            return
        response = route.fetch()
        marks = response.json()
        before = {"source": "none", "points": [None] * len(marks["points"])}
        route.fulfill(response=response, json={**marks, **before})

    page.route("**/api/project", list_pictures)
    page.route("**/landmarks", answer)
    page.route(SHOWN, lambda route: held.append(route))
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    wait_for(page, "() => window.liaamStudio?.state.picture(window.liaamStudio.state.current)?.state === 'proposed'")
    for _ in range(100):
        if held and answered:
            break
        page.wait_for_timeout(50)
    page.unroute(SHOWN)
    for route in held:
        route.continue_()
    wait_for(page, "() => window.liaamStudio?.annotate?.source() === 'proposal'")


def test_ellipses_stay_around_the_points_that_nobody_has_moved(serve, open_page, folder, portrait_model):
    """They were gone from a picture that a person had touched and came back to."""
    page = open_page(390, 800, has_touch=True)
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    wait_for(page, "() => window.liaamStudio?.annotate?.source() === 'proposal'")
    around = "window.liaamStudio.annotate.ellipses().map((has, i) => (has ? -1 : i)).filter((i) => i >= 0).join()"
    without = f"expected => window.liaamStudio.annotate.ellipses().length === 58 && {around} === expected"
    for where in (20, [4, 4]):
        page.touchscreen.tap(*client(page, where))
        wait_for(page, without, "")
    page.touchscreen.tap(*client(page, 20))
    page.keyboard.press("ArrowLeft")
    saved(page)
    wait_for(page, without, "20")
    open_picture(page, NAMES[1])
    open_picture(page, NAMES[0])
    wait_for(page, without, "20")
    page.locator("[data-testid=undo]").click()
    wait_for(page, without, "")
    page.locator("[data-testid=redo]").click()
    saved(page)
    page.reload()
    opened(page, NAMES[0])
    wait_for(page, without, "20")
