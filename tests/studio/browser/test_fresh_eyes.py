"""What a person stumbled on who used the page for portraits with the documentation closed."""

import json
import re
import shutil
from urllib.parse import parse_qs, urlparse

import numpy as np
import pytest
from people import NAMES, annotate, client, kill, opened, shoot, wait_for
from test_begin import RELIT, drop_anywhere
from test_fit_tab import hook

from liaam.io import read_image, write_image
from liaam.studio.settings import STATIC

pytestmark = pytest.mark.slow

FACE = STATIC / "first" / "face.jpg"
CURRENT = "() => document.querySelector('[data-testid=strip] [aria-current=true]')?.dataset.name ?? null"
ABOVE = "() => document.querySelector('[data-testid=light-strength]').getBoundingClientRect().top"
STATUS = "[data-testid=fit-status]"


@pytest.fixture
def faces(tmp_path):
    """Give a folder with a portrait, and a picture without any face."""
    root = tmp_path / "faces"
    root.mkdir()
    shutil.copy(FACE, root / "anna.jpg")
    waves = np.sin(np.arange(300) / 9)
    write_image(root / "sea.png", np.uint8(120 + 60 * np.outer(waves, waves))[..., None].repeat(3, 2))
    return root


@pytest.fixture
def relit(serve, page, faces):
    """Give the page with the portrait of the folder in the view Relight."""
    page.goto(serve(faces, face=True).address)
    page.wait_for_selector("[role=tab][aria-selected=true]")
    wait_for(page, "() => window.liaamStudio?.state.project?.offered")
    page.locator("[data-testid=strip] [data-name='anna.jpg']").click()
    page.locator("[data-testid=tab-fit]").click()
    page.locator("[data-testid=layer-relit]").click()
    wait_for(page, RELIT)
    return page


def test_the_saved_picture_is_the_one_that_is_shown(relit, tmp_path):
    relit.locator("[data-testid=light-presets]").select_option("Candle")
    assert relit.locator("[data-testid=light-presets]").input_value() == "Candle"
    files = []
    for strength in ("1", "0.35"):
        relit.locator("[data-testid=opacity-view]").fill(strength)
        with relit.expect_download() as download, relit.expect_request("**/export?*") as asked:
            relit.locator("[data-testid=fit-save]").click()
        files.append(tmp_path / f"{strength}.png")
        download.value.save_as(files[-1])
    assert parse_qs(urlparse(asked.value.url).query)["opacity"] == ["0.35"]
    picture = read_image(FACE).astype(float)
    whole, third = (np.abs(read_image(file) - picture).mean() for file in files)
    assert third == pytest.approx(0.35 * whole, rel=0.05)


def test_nothing_moves_below_the_words_of_a_lamp_and_no_lamp_hides_another(relit, artefacts):
    places = {relit.evaluate(ABOVE)}
    for _ in range(4):
        relit.locator("[data-testid=lamp-add]").click()
        for key in ("ArrowUp", "ArrowRight"):
            relit.locator("[data-testid=lamp]").last.press(key)
            places.add(relit.evaluate(ABOVE))
    assert len(places) == 1
    directions = np.array([lamp["direction"][:2] for lamp in hook(relit, "light.lamps")])
    apart = np.linalg.norm(directions[:, None] - directions, axis=2) + 9 * np.eye(len(directions))
    assert apart.min() > 0.15
    shoot(relit, artefacts, "50-five-lamps")


def test_no_face_is_made_of_a_picture_without_one(relit, artefacts):
    relit.locator("[data-testid=strip] [data-name='sea.png']").click()
    relit.locator(f"{STATUS} .badge", has_text="No face found").wait_for()
    assert "converged" not in relit.locator(STATUS).inner_text()
    assert "No face was found in this picture" in relit.locator(".fit-hint").inner_text()
    assert relit.locator("[data-testid=export-menu]").is_disabled()
    assert relit.locator("[data-testid=light-stage]").is_hidden()
    assert relit.locator("[data-testid=light]").get_attribute("inert") is not None  # it stays where it was
    assert relit.locator("[data-testid=fit-split]").is_disabled()
    assert relit.locator("[data-testid=layer-picture]").is_checked()  # which is what is seen
    shoot(relit, artefacts, "50-no-face")
    relit.locator("[data-testid=tab-annotate]").click()
    opened(relit, "sea.png")
    assert "No face was found in this picture" in relit.locator("[data-testid=why-next]").inner_text()
    relit.locator("[data-testid=strip] [data-name='sea.png']", has_text="nothing found").wait_for()
    relit.locator("[data-testid=skip-next]").click()
    opened(relit, "anna.jpg")


def test_it_is_said_at_the_picture_that_its_light_is_even_already(relit, artefacts):
    """The answers are changed to those of a picture in even light with a second face."""

    def even(route):
        answer = route.fetch()
        relit.wait_for_function("() => document.querySelector('[data-testid=fit-state]').textContent")
        scale = json.dumps(json.loads(answer.headers["x-scale"]) | {"even": True})
        route.fulfill(response=answer, headers=answer.headers | {"x-scale": scale})

    relit.locator("[data-testid=layer-flat]").click()
    relit.locator("[data-testid=strip] [data-name='sea.png']").click()
    relit.locator(f"{STATUS} .badge", has_text="No face found").wait_for()
    relit.route("**/layers/flat?*", even)
    relit.route(re.compile("/api/fits$"), lambda route: route.fulfill(json=route.fetch().json() | {"n_found": 2}))
    relit.locator("[data-testid=strip] [data-name='anna.jpg']").click()
    relit.locator("[data-testid=fit-state]", has_text="Removing the shading…").wait_for()
    relit.locator(".fit-divider-label", has_text="Already in even light").wait_for()
    relit.unroute("**/layers/flat?*")
    for name in ("opacity-view", "fit-save", "balance"):
        assert relit.locator(f"[data-testid={name}]").is_disabled(), name
    assert "nothing is taken off" in relit.locator("[data-testid=fit-save]").get_attribute("title")
    assert not relit.locator("[data-testid=balance]").is_checked()  # neutral: nothing is corrected
    relit.locator("[data-testid=fit-split]").click()
    relit.locator("[data-testid=fit-state]", has_text="Already in even light").wait_for()
    shoot(relit, artefacts, "50-even")

    expert = relit.locator("[data-testid=expert]")
    before = expert.bounding_box()
    expert.check()
    assert expert.bounding_box() == before
    relit.locator("[data-testid=layer-relit]").click()
    relit.locator("[data-testid=start-box]").click()
    assert relit.locator(".fit-hint").inner_text() == "Draw a box around the object."
    relit.locator("[data-testid=start-auto]").click()
    relit.locator("[data-testid=fit-run]").click()
    relit.locator(".fit-hint", has_text="1 more face in the picture: press “Fit all”").wait_for()
    relit.unroute_all(behavior="wait")
    for text, kind in (("failed", "bad"), ("first", "good"), ("second", "good")):
        relit.evaluate("([text, kind]) => { window.liaamStudio.app.toast(text, kind); }", [text, kind])
    assert relit.locator(".toast").all_inner_texts() == ["failed", "second"]


def test_a_picture_that_is_only_looked_at_is_said_to_be(relit, artefacts):
    drop_anywhere(relit, "guest.jpg", FACE.read_bytes())
    wait_for(relit, "() => window.liaamStudio.fit.fit?.upload")
    assert "Not in the folder" in relit.locator("[data-testid=fit-aside]").inner_text()
    assert relit.evaluate(CURRENT) is None
    shoot(relit, artefacts, "50-looked-at")
    relit.locator("[data-testid=strip] [data-name='anna.jpg']").click()  # the one that was shown before
    wait_for(relit, "() => window.liaamStudio.fit.fit?.picture === 'anna.jpg'")
    assert relit.evaluate(CURRENT) == "anna.jpg"
    assert relit.locator("[data-testid=fit-aside]").is_hidden()
    drop_anywhere(relit, "guest.jpg", FACE.read_bytes() + b"another")
    wait_for(relit, "() => window.liaamStudio.fit.fit?.upload")
    relit.locator("[data-testid=fit-place]").click()  # it is added, and opened
    opened(relit, "guest.jpg")


def test_a_fit_that_failed_without_a_connection_is_made_when_it_is_back(relit):
    relit.route(re.compile("/api/fits$"), lambda route: route.abort())
    relit.locator("[data-testid=strip] [data-name='sea.png']").click()
    relit.locator(f"{STATUS} .error-text", has_text="not reachable").wait_for()
    relit.unroute(re.compile("/api/fits$"))
    relit.evaluate("() => window.liaamStudio.state.dispatchEvent(new CustomEvent('online', { detail: true }))")
    wait_for(relit, "() => window.liaamStudio.fit.fit?.picture === 'sea.png'")
    assert relit.locator(f"{STATUS} .error-text").count() == 0


def test_saved_is_not_said_to_be_so_while_the_server_is_away(serve, page, marked):
    server = serve(marked)
    page.goto(server.address)
    opened(page, NAMES[0])
    kill(server, page)
    page.locator("[data-testid=save-status]", has_text="server not reachable").wait_for()


def test_all_specimens_stay_when_another_picture_is_shown(relit):
    def all_of_them(route):
        first = hook(relit, "fit")
        both = [first | {"specimen": {"number": i, "name": f"anna#{i}", "fault": ""}} for i in (1, 2)]
        route.fulfill(json={"fits": both, "faults": []})

    relit.route("**/api/fits/all", all_of_them)
    relit.evaluate("() => document.querySelector('[data-testid=fit-all]').click()")
    relit.locator("[data-testid=fit-specimen]").nth(1).click()
    assert "Only the light of anna#2 is changed" in relit.locator("[data-testid=light-note]").inner_text()
    relit.locator("[data-testid=strip] [data-name='sea.png']").click()
    wait_for(relit, "() => window.liaamStudio.fit.fit?.picture === 'sea.png'")
    assert relit.locator("[data-testid=fit-specimen]").count() == 0
    relit.locator("[data-testid=strip] [data-name='anna.jpg']").click()
    relit.locator("[data-testid=fit-specimen][aria-pressed=true]", has_text="anna#2").wait_for()


def test_points_of_a_template_stay_when_a_model_offers_its_own(serve, page, folder, portrait_model):
    """The page learns of the model's points only after some were clicked, as on a slow machine."""
    offers = False

    def project(route):
        answered = route.fetch()
        data = answered.json()
        if "pictures" in data and not offers:
            data |= {"template": None, "offered": False}
        route.fulfill(response=answered, body=json.dumps(data))

    page.route("**/api/project*", project)
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    wait_for(page, "() => window.liaamStudio.annotate?.source() === 'template'")
    for at in ([40, 50], [90, 60], [70, 120]):
        page.mouse.click(*client(page, at))
    clicked = annotate(page, "points()")
    assert len(clicked) == 3
    offers = True
    page.evaluate("() => window.liaamStudio.state.refresh()")
    wait_for(page, "() => window.liaamStudio.state.project.offered")
    page.locator(".template-panel", has_text="Yours are kept").wait_for()
    page.locator("[data-testid=tab-fit]").click()
    page.locator(f"[data-testid=strip] [data-name='{NAMES[1]}']").click()
    wait_for(page, f"() => window.liaamStudio.fit.fit?.picture === '{NAMES[1]}'")
    page.locator("[data-testid=tab-annotate]").click()
    for _ in range(2):
        wait_for(page, "() => window.liaamStudio.annotate?.source() === 'template'")
        assert annotate(page, "points()") == clicked
        page.reload()
    wait_for(page, "() => window.liaamStudio.annotate?.source() === 'template'")
    page.locator(".template-panel button", has_text="Use the model's points").click()
    page.locator("[data-testid=confirm]").click()
    wait_for(page, "() => window.liaamStudio.annotate?.source() === 'proposal'")
