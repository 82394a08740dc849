"""Server-sent events: one hub notifies every open page of changes."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator
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
        self._pages: dict[asyncio.Queue[str | None], asyncio.AbstractEventLoop] = {}
        self._closed = False

    def __len__(self) -> int:
        return len(self._pages)

    def publish(self, kind: str, data: Any) -> None:
        """Send an event to all pages."""
        self._send(f"event: {kind}\ndata: {json.dumps(data)}\n\n")

    def close(self) -> None:
        """End all present and future streams, because the server stops."""
        self._closed = True
        self._send(None)

    async def stream(self) -> AsyncIterator[str]:
        """Yield the events of one page until it disconnects, falls behind, or the server stops."""
        queue: asyncio.Queue[str | None] = asyncio.Queue()
        with self._lock:
            self._pages[queue] = asyncio.get_running_loop()
        try:
            yield "retry: 1000\n\n"  # milliseconds until a browser reconnects
            while not self._closed:
                text: str | None = ": still here\n\n"  # a comment, if there is nothing else to say
                with suppress(TimeoutError):
                    text = await asyncio.wait_for(queue.get(), self._heartbeat)
                if text is None:
                    return
                yield text
        finally:
            with self._lock:
                self._pages.pop(queue, None)

    def _send(self, text: str | None) -> None:
        """Queue an event for each page on its event loop; None ends the stream."""
        with self._lock:
            pages = list(self._pages.items())
        for queue, loop in pages:
            with suppress(RuntimeError):  # the event loop is closed
                loop.call_soon_threadsafe(_put, queue, text)


def _put(queue: asyncio.Queue[str | None], text: str | None) -> None:
    """Queue an event. At the end, or if a page falls behind, drop what is queued and end the stream."""
    if text is not None and queue.qsize() < ROOM:
        queue.put_nowait(text)
        return
    while not queue.empty():
        queue.get_nowait()
    queue.put_nowait(None)
