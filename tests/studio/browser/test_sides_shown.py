"""Sides of objects, such as left and right wings: said in the list and the panel, and chosen for a fit."""

import pytest
from people import NAMES, opened, picture, shoot, violations, wait_for, wait_until

pytestmark = pytest.mark.slow


def test_the_side_of_pictures_is_said_and_taken_back(serve, page, marked, artefacts):
    server = serve(marked)
    page.goto(server.address)
    opened(page, NAMES[0])
    panel = page.locator("[data-testid=picture-side]")
    assert not panel.is_visible()  # objects that have no sides need none
    page.route("**/side", lambda route: route.fulfill(json={"side": "mirrored", "both": True}))
    page.locator(f"[data-testid=strip] [data-name='{NAMES[1]}']").click()
    panel.filter(has_text="by name or shape: mirrored").wait_for()  # before anybody has said it
    page.unroute_all(behavior="wait")
    page.locator(f"[data-testid=strip] [data-name='{NAMES[0]}']").click()
    wait_for(page, "() => !document.querySelector('[data-testid=picture-side]').checkVisibility()")
    page.locator("[data-testid=strip-several]").click()
    page.locator("[data-testid=bulk-all]").click()
    page.locator("[data-testid=bulk-action]").select_option("left")
    wait_until(page, lambda: [picture(page, name)["side"] for name in NAMES] == ["left"] * 3)
    item = page.locator(f"[data-testid=strip] [data-name='{NAMES[1]}']")
    item.get_by_text("left").wait_for()
    page.locator("[data-testid=bulk-end]").click()
    panel.select_option("right")
    wait_until(page, lambda: [picture(page, name)["side"] for name in NAMES] == ["right", "left", "left"])
    page.locator(f"[data-testid=strip] [data-name='{NAMES[2]}']").click()
    opened(page, NAMES[2])
    assert panel.input_value() == "left"
    shoot(page, artefacts, "side-of-a-picture")
    page.locator(".toast", has_text="1 picture: right").locator("[data-testid=toast-action]").click()
    wait_until(page, lambda: picture(page, NAMES[0])["side"] == "left")
    assert violations(page) == {}
    page.reload()
    opened(page, NAMES[2])
    assert panel.input_value() == "left"


def test_the_model_is_trained_again_once_a_side_is_stated(serve, page, five_marked):
    page.goto(serve(five_marked).address)
    wait_for(page, "() => window.liaamStudio?.state.project?.model?.n_images === 5")
    wait_for(page, "() => window.liaamStudio.state.project.training.state === 'done'")
    trained = page.evaluate("() => window.liaamStudio.state.project.model.trained")
    page.locator("[data-testid=strip-several]").click()
    page.locator("[data-testid=bulk-action]").select_option("left")
    wait_for(page, "before => window.liaamStudio.state.project.model.trained !== before", trained)
    assert not page.evaluate("() => window.liaamStudio.state.project.model.sides_changed")


def test_a_fit_is_asked_for_one_side(serve, page, folder, portrait_model, artefacts):
    """The model of one side is shown as one of two, and the server is not asked for the other."""
    asked = []

    def with_sides(route):
        project = route.fetch().json()
        if project.get("model"):
            project["model"]["sides"] = {"own": "right", "other": "left", "n_own": 7, "n_other": 1}
        route.fulfill(json=project)

    def of_one_side(route):
        wanted = route.request.post_data_json
        asked.append(wanted["side"])
        route.fulfill(json=route.fetch(post_data=wanted | {"side": "auto"}).json() | {"side": wanted["side"]})

    page.route("**/api/project*", with_sides)
    page.route("**/api/fits", of_one_side)
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    opened(page, "portrait-01.png")
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit")
    sides = page.locator("[data-testid=fit-sides]")
    sides.get_by_text("1 of 8 training pictures was left, and reflected to be right.").wait_for()
    page.locator("[data-testid=side-left]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit?.side === 'left'")
    assert asked == ["auto", "left"]
    shoot(page, artefacts, "side-of-a-fit")
    assert violations(page) == {}
    page.locator("[data-testid=strip] [data-name='portrait-02.png']").click()  # another object may be of another side
    wait_for(page, "() => window.liaamStudio.fit.fit?.picture === 'portrait-02.png'")
    assert asked == ["auto", "left", "auto"]
    assert page.locator("[data-testid=side-auto]").is_checked()
    page.unroute_all(behavior="ignoreErrors")
