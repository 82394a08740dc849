"""Light or dark: as the system says, unless a person has chosen."""

import pytest

BACKGROUNDS = {"light": "rgb(244, 245, 248)", "dark": "rgb(18, 20, 27)"}


def shown(page):
    """Give the theme that the page says it has, if it looks so."""
    theme = page.evaluate("() => document.documentElement.dataset.theme")
    background = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    assert background == BACKGROUNDS[theme]
    return theme


@pytest.mark.parametrize("system", ["light", "dark"])
def test_the_page_follows_the_system_until_a_theme_is_chosen(page, serve, folder, system):
    other = "light" if system == "dark" else "dark"
    page.emulate_media(color_scheme=system)
    page.goto(serve(folder).address)
    assert shown(page) == system
    page.emulate_media(color_scheme=other)
    page.wait_for_function("other => document.documentElement.dataset.theme === other", arg=other)
    page.emulate_media(color_scheme=system)
    page.locator("[data-testid=theme]").click()
    assert shown(page) == other
    page.reload()
    assert shown(page) == other
