"""Light or dark: as the system says, unless a person has chosen."""

import pytest
from people import wait_for

BACKGROUNDS = {"light": "rgb(244, 245, 248)", "dark": "rgb(18, 20, 27)"}


def wait_for_theme(page, theme: str) -> None:
    """Wait until the page says that it has a theme, and looks so."""
    wait_for(
        page,
        "([theme, colour]) => document.documentElement?.dataset.theme === theme"
        " && getComputedStyle(document.body).backgroundColor === colour",
        [theme, BACKGROUNDS[theme]],
    )


@pytest.mark.slow
@pytest.mark.parametrize("system", ["light", "dark"])
def test_the_page_follows_the_system_until_a_theme_is_chosen(page, serve, folder, system):
    other = "light" if system == "dark" else "dark"
    page.emulate_media(color_scheme=system)
    page.goto(serve(folder).address)
    wait_for_theme(page, system)
    page.emulate_media(color_scheme=other)
    wait_for_theme(page, other)
    page.emulate_media(color_scheme=system)
    wait_for_theme(page, system)
    page.locator("[data-testid=theme]").click()
    wait_for_theme(page, other)
    page.reload()
    wait_for_theme(page, other)
