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

    def with_flags(self, flags: Sequence[str] = ()) -> Any:
        """Return the browser that runs, or another one if its flags are others."""
        if self._browser is None or self._flags != tuple(flags):
            self.close()
            self._flags = tuple(flags)
            self._browser = self._running.enter_context(launched(flags))
        return self._browser

    def close(self) -> None:
        """Close the browser, if one runs."""
        self._browser = None
        self._running.close()


SHARED = SharedBrowser()
