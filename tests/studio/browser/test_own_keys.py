"""Keys of one's own: chosen on the page, kept for the next time, and refused if two commands would share one."""

import pytest
from people import NAMES, annotate, opened, shoot, violations, wait_for

pytestmark = pytest.mark.slow


def change(page, command: str, letter: str) -> None:
    page.keyboard.press("?")
    page.locator("[data-testid=change-keys]").click()
    page.locator(f"[data-testid=key-{command}]").fill(letter)


def test_a_command_has_the_key_that_was_chosen(serve, page, marked, artefacts):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    change(page, "v", "q")
    shoot(page, artefacts, "keys-1280")
    assert not violations(page)
    page.locator("[data-testid=keys-save]").click()
    page.reload()
    opened(page, NAMES[0])
    page.locator("[data-testid=point-list] [data-index='1']").click()
    page.keyboard.press("v")
    assert annotate(page, "invisible()") == []
    page.keyboard.press("q")
    wait_for(page, "() => window.liaamStudio.annotate.invisible().length === 1")


def test_two_commands_cannot_share_a_key(serve, page, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    change(page, "v", "u")
    page.locator("[data-testid=keys-save]").click()
    page.locator(".toast", has_text="have the same key, U").wait_for()
    assert page.evaluate("() => localStorage.getItem('liaam-studio:keys')") is None
