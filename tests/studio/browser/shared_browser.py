"""One headless browser for tests that follow each other: starting one takes as long as a short test."""

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

from benchmarks.studio import launched


class SharedBrowser:
    """A browser that is started when a test needs it, and closed before tests that cannot run beside it.

    While it runs, no other test of the process can have an event loop, because Playwright has one.
    """

    def __init__(self) -> None:
        self._running = ExitStack()
        self._browser: Any = None
        self._flags: tuple[str, ...] = ()
        self._context: Any = None
        self._empty_page: Any = None

    def with_flags(self, flags: Sequence[str] = ()) -> Any:
        """Return the browser that runs, or another one if its flags are others."""
        if self._browser is None or self._flags != tuple(flags):
            self.close()
            self._flags = tuple(flags)
            self._browser = self._running.enter_context(launched(flags))
        return self._browser

    def new_page(self) -> Any:
        """Return a page of a context that tests use one after the other.

        The context has the scripts of the studio, fetched and compiled, when it opens the studio again. That takes half
        of the time of a page in a context of its own. :meth:`clear` is called after a test.
        """
        if self._context is None:
            self._context = self._browser.new_context()
            self._empty_page = self._context.new_page()  # with the last page of a context, Chromium drops what it keeps
        return self._context.new_page()

    def clear(self) -> None:
        """Close the pages of :meth:`new_page`, and forget all that they have stored, but for files of the studio."""
        if self._context is None:
            return
        for page in self._context.pages:
            if page is not self._empty_page:
                page.close()
        self._context.clear_cookies()
        self._context.clear_permissions()
        self._context.set_offline(False)
        session = self._context.new_cdp_session(self._empty_page)
        session.send("Storage.clearDataForOrigin", {"origin": "*", "storageTypes": "all"})
        session.detach()

    def close(self) -> None:
        """Close the browser, if one runs."""
        self._browser = None
        self._context = None
        self._empty_page = None
        self._running.close()


SHARED = SharedBrowser()
