"""Server-sent events: one hub tells every open page what changed."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator
from typing import Any

ROOM = 100
"""Events that may wait for a page; one that falls behind further is let go, and asks anew when it is back."""


class Events:
    """Tells open pages what happens; may be called from any thread."""

    def __init__(self, heartbeat: float = 15.0) -> None:
        self._heartbeat = heartbeat
        self._lock = threading.Lock()
        self._pages: dict[_Page, asyncio.AbstractEventLoop] = {}
        self._closed = False

    def __len__(self) -> int:
        return len(self._pages)

    def publish(self, kind: str, data: Any) -> None:
        """Tell all pages."""
        text = f"event: {kind}\ndata: {json.dumps(data)}\n\n"
        for page, loop in self._open_pages():
            _call(loop, page.put, text)

    def close(self) -> None:
        """End all streams, and those to come: the server stops."""
        self._closed = True
        for page, loop in self._open_pages():
            _call(loop, page.end)

    async def stream(self) -> AsyncIterator[str]:
        """Give one page's events until it goes, falls behind, or the server stops."""
        page = _Page()
        with self._lock:
            self._pages[page] = asyncio.get_running_loop()
        try:
            yield "retry: 1000\n\n"  # milliseconds after which a browser comes back
            while not self._closed:
                text = await page.get(self._heartbeat)
                if text is None:
                    return
                yield text
        finally:
            with self._lock:
                self._pages.pop(page, None)

    def _open_pages(self) -> list[tuple[_Page, asyncio.AbstractEventLoop]]:
        with self._lock:
            return list(self._pages.items())


class _Page:
    """What waits for one page; used on the event loop only."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[str | None] = asyncio.Queue()
        self._ended = False

    def put(self, text: str) -> None:
        if self._queue.qsize() >= ROOM:
            self.end()
        elif not self._ended:
            self._queue.put_nowait(text)

    def end(self) -> None:
        """Forget what waits, and end."""
        self._ended = True
        while not self._queue.empty():
            self._queue.get_nowait()
        self._queue.put_nowait(None)

    async def get(self, heartbeat: float) -> str | None:
        """Wait for the next event; a comment if none comes for a while, None at the end."""
        try:
            return await asyncio.wait_for(self._queue.get(), heartbeat)
        except TimeoutError:
            return ": still here\n\n"


def _call(loop: asyncio.AbstractEventLoop, call: Any, *arguments: Any) -> None:
    try:
        loop.call_soon_threadsafe(call, *arguments)
    except RuntimeError:  # the loop has ended, and its pages with it
        return
