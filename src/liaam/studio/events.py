"""Server-sent events: one hub notifies every open page of changes."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import Any

ROOM = 100
"""Maximum number of events queued for a page. A page that falls further behind is disconnected; it reconnects and
reloads the project."""


class Events:
    """Sends events to the open pages; thread-safe."""

    def __init__(self, heartbeat: float = 15.0) -> None:
        self._heartbeat = heartbeat
        self._lock = threading.Lock()
        self._pages: dict[_Page, asyncio.AbstractEventLoop] = {}
        self._closed = False

    def __len__(self) -> int:
        return len(self._pages)

    def publish(self, kind: str, data: Any) -> None:
        """Send an event to all pages."""
        text = f"event: {kind}\ndata: {json.dumps(data)}\n\n"
        self._in_loops(lambda page: page.put(text))

    def close(self) -> None:
        """End all present and future streams, because the server stops."""
        self._closed = True
        self._in_loops(_Page.end)

    async def stream(self) -> AsyncIterator[str]:
        """Yield the events of one page until it disconnects, falls behind, or the server stops."""
        page = _Page()
        with self._lock:
            self._pages[page] = asyncio.get_running_loop()
        try:
            yield "retry: 1000\n\n"  # milliseconds until a browser reconnects
            while not self._closed:
                text = await page.get(self._heartbeat)
                if text is None:
                    return
                yield text
        finally:
            with self._lock:
                self._pages.pop(page, None)

    def _in_loops(self, call: Callable[[_Page], None]) -> None:
        """Call a function for each page on its event loop."""
        with self._lock:
            pages = list(self._pages.items())
        for page, loop in pages:
            with suppress(RuntimeError):  # the event loop is closed
                loop.call_soon_threadsafe(call, page)


class _Page:
    """Event queue of one page; used on the event loop only."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[str | None] = asyncio.Queue()
        self._ended = False

    def put(self, text: str) -> None:
        if self._queue.qsize() >= ROOM:
            self.end()
        elif not self._ended:
            self._queue.put_nowait(text)

    def end(self) -> None:
        """Drop the queued events and end the stream."""
        self._ended = True
        while not self._queue.empty():
            self._queue.get_nowait()
        self._queue.put_nowait(None)

    async def get(self, heartbeat: float) -> str | None:
        """Return the next event, a comment after ``heartbeat`` seconds without one, or None at the end."""
        try:
            return await asyncio.wait_for(self._queue.get(), heartbeat)
        except TimeoutError:
            return ": still here\n\n"
