"""The words of fitting are shown to experts only, and the tab Compare where there are methods to compare."""

import re

import pytest
from people import NAMES, as_expert, opened, shoot, wait_for

from liaam.io import write_landmarks

pytestmark = pytest.mark.slow

WORDS = re.compile(r"residual|\blevel\b|\bcost\b|soft-li|\brgb\b|θ|invariant|iteration", re.IGNORECASE)

VISIBLE = """() => [...document.querySelectorAll(".top *, #tab-fit *")]
  .filter((each) => each.checkVisibility())
  .flatMap((each) => [...each.childNodes].filter((node) => node.nodeType === 3).map((node) => node.data)
    .concat(each.getAttribute("aria-label") ?? "", each.title ?? ""))
  .join("\\n")"""


@pytest.fixture
def fitted(page, serve, folder, portraits, portrait_model):
    """Give the Fit tab with a fit, of somebody who never saw it before."""
    write_landmarks(folder / "portrait-01.pts", portraits[0].landmarks)
    page.goto(serve(folder, "--model", str(portrait_model)).address)
    page.wait_for_selector("[role=tab][aria-selected=true]")
    page.locator("[data-testid=tab-fit]").click()
    wait_for(page, "() => window.liaamStudio.fit.fit")
    return page


def without_box(text: str) -> str:
    """Return the texts of the page but for the title of the box itself, which says what it shows."""
    return "\n".join(line for line in text.splitlines() if not line.startswith("Show methods, residual"))


def test_expert_words_and_compare_come_with_expert(fitted, artefacts):
    compare = fitted.locator("[data-testid=tab-compare]")
    assert WORDS.findall(without_box(fitted.evaluate(VISIBLE))) == []
    assert not compare.is_visible()
    shoot(fitted, artefacts, "fit-plain")
    fitted.keyboard.press("?")
    assert "Compare" not in fitted.locator("dialog").inner_text()
    fitted.keyboard.press("Escape")
    fitted.keyboard.press("5")
    assert fitted.locator("[data-testid=tab-fit][aria-selected=true]").is_visible()

    fitted.locator("[data-testid=expert]").check()
    assert compare.is_visible()
    fitted.locator("[data-testid=layer-residual]").click()
    wait_for(fitted, "() => window.liaamStudio.fit.view === 'residual' && window.liaamStudio.fit.hasLayer")
    words = {word.lower() for word in WORDS.findall(fitted.evaluate(VISIBLE))}
    assert words >= {"residual", "level", "cost", "invariant"}
    assert fitted.locator("[data-testid=fit-method]").input_value() == "soft-li"
    shoot(fitted, artefacts, "fit-expert")
    fitted.reload()
    wait_for(fitted, "() => window.liaamStudio?.fit?.fit")
    assert compare.is_visible()  # the browser remembers it
    fitted.locator("[data-testid=fit-method]").select_option("rgb")
    wait_for(fitted, "() => window.liaamStudio.fit.fit?.method === 'rgb'")

    fitted.locator("[data-testid=layer-residual]").click()
    fitted.locator("[data-testid=expert]").uncheck()
    wait_for(fitted, "() => window.liaamStudio.fit.fit?.method === 'soft-li'")  # no method that cannot be seen
    assert fitted.evaluate("() => window.liaamStudio.fit.view") == "picture"
    assert not compare.is_visible()


def test_a_model_of_one_method_has_nothing_to_compare(serve, open_page, marked):
    page = open_page()
    as_expert(page)
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    page.goto(page.url.partition("?")[0] + "?tab=compare")  # an address of before; there is no model
    wait_for(page, "() => document.querySelector('[role=tab][aria-selected=true]')")
    assert page.locator("[data-testid=tab-fit][aria-selected=true]").is_visible()
    assert not page.locator("[data-testid=tab-compare]").is_visible()
