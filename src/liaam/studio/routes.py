"""Routes of the web application: functions that run in threads, what requests may say, and events for the pages."""

import asyncio
import json
import re
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from functools import wraps
from typing import Any
from urllib.parse import quote

import numpy as np
from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from liaam.errors import LiaamError
from liaam.fitting.sides import AUTO
from liaam.photometry import srgb_to_linear
from liaam.relighting.lamp import AMBIENT, Lamp, check_ambient
from liaam.studio import contract
from liaam.studio.contract import OMITTED, given
from liaam.studio.refusal import Refusal

SIZES = (16, 16384)  # smallest and largest size of the longest side that a request may ask for, in pixels
MOST_DIGITS = 6  # of a size, so that it is read at once
MOST_LAMPS = 8  # maximum number of lamps of a relit picture, which bounds its time
MOST_POINTS = 100_000  # maximum number of points of a start
ONE_LAMP = '{"lamps": [{"direction": [0, 0, 1]}]}'
LARGEST = 1e9  # of a coordinate, beyond which arithmetic may overflow
ROOM = 100  # maximum number of events queued for a page; one further behind is disconnected, and loads again


def route(
    method: str,
    path: str,
    act: Callable[..., Any],
    read: Callable[[Request], Awaitable[Any]] | None = None,
    limiter: CapacityLimiter | None = None,
    status: int = 200,
) -> Route:
    """Return a route that answers with what ``act`` returns in a thread: a response, a value as JSON, or None as 204.

    ``act`` takes the request; the query, if the route has one in the contract; and, with ``read``, what that makes of
    the body. ``limiter`` limits how many run at once, and ``status`` is that of JSON.
    """
    query = agreed(method, path).query

    def answered(request: Request, *body: Any) -> Response:  # body: one argument or none
        asked = () if query is None else (given(query, request.query_params),)
        answer = act(request, *asked, *body)
        if isinstance(answer, Response):
            return answer
        return Response(status_code=204) if answer is None else JSONResponse(answer, status)

    @wraps(act)
    async def endpoint(request: Request) -> Response:
        body = () if read is None else (await read(request),)
        return await run_sync(answered, request, *body, limiter=limiter)

    return Route(path, endpoint, methods=[method])


def agreed(method: str, path: str) -> contract.Endpoint:
    """Return what the contract says of a route."""
    address = re.sub(r":\w+}", "}", path.removeprefix("/api/"))  # such as {name:path}
    return contract.ROUTES[f"{method} {address}"]


async def maybe_json(request: Request) -> Any:
    """Read the body of a request as JSON; None if there is none."""
    return await read_json(request) if request.headers.get("content-type") else None


async def read_json(request: Request) -> Any:
    """Read the body of a request as JSON."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        raise Refusal(415, f"the request is of type '{kind[:50]}': send application/json")
    body = await request.body()
    try:
        content = json.loads(body)
        if any(mark in body for mark in (b"\\u", b"NaN", b"Infinity")):
            # Raises for numbers that are none, and for half a surrogate pair, which Python's reader lets pass.
            json.dumps(content, ensure_ascii=False, allow_nan=False).encode()
        return content
    except (ValueError, RecursionError) as fault:  # UnicodeDecodeError is a ValueError
        raise Refusal(400, f"the request is not JSON ({str(fault)[:100]})") from fault


def attachment(name: str, data: bytes, kind: str = "application/octet-stream") -> Response:
    """Return a file to save, with any characters in its name (RFC 6266)."""
    plain = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "._- ") else "_" for letter in name)
    place = f"attachment; filename=\"{plain}\"; filename*=UTF-8''{quote(name, safe='')}"
    return Response(data, media_type=kind, headers={"content-disposition": place, "cache-control": "no-store"})


def checked_size(text: str | None, default: int) -> int:
    """Parse a requested size and clip it to :data:`SIZES`."""
    if text is None:
        return default
    if not (text.isascii() and text.isdigit() and len(text) <= MOST_DIGITS):
        raise Refusal(422, f"size {text[:20]!r} is not a whole number of pixels: send the longest side, such as 1024")
    return int(np.clip(int(text), *SIZES))


def parse_start(data: Any) -> Any:
    """Parse the start of a fit: null, a box, or a shape whose points may be null."""
    if data is None:
        return None
    if isinstance(data, dict) and len(data) == 1:
        start = given(contract.Start, data)
        box: Any = start.box
        points: Any = start.shape
        if _are_numbers(box, 4):
            return tuple(map(float, box))
        are_points = isinstance(points, list) and all(each is None or _are_numbers(each, 2) for each in points)
        if are_points and 0 < len(points) <= MOST_POINTS:
            return np.array([[np.nan, np.nan] if point is None else point for point in points], np.float64)
    raise Refusal(422, "the start is unclear: send null, {box: [left, top, right, bottom]} or {shape: [[x, y], ...]}")


def parse_side(data: Any) -> str:
    """Check that the side of the objects is a string; whether the model has such a side is checked with the model."""
    if data is OMITTED:
        return AUTO
    if not isinstance(data, str):
        raise Refusal(422, "the side is not a string: send auto, or one of the model's sides")
    return data


def _are_numbers(values: Any, n: int) -> bool:
    """Whether values are a list of n numbers, none of them too large."""
    is_list = isinstance(values, list) and len(values) == n
    return is_list and all(type(value) in (int, float) and -LARGEST < value < LARGEST for value in values)


def light_of(text: str | None) -> tuple[list[Lamp], float]:
    """Parse a :class:`liaam.studio.contract.SentLight` as JSON; without any, it is one lamp beside the camera."""
    try:
        light = given(contract.SentLight, json.loads(ONE_LAMP if text is None else text))
        lamps = [_lamp_of(given(contract.SentLamp, lamp)) for lamp in light.lamps]
        ambient = AMBIENT if light.ambient is OMITTED else light.ambient
        check_ambient(ambient)
    except LiaamError:
        raise
    except (ValueError, TypeError, RecursionError, OverflowError) as fault:
        raise Refusal(422, "the light is unclear: send JSON with lamps, each with a direction, and ambient") from fault
    if len(lamps) > MOST_LAMPS:
        raise Refusal(422, f"{len(lamps)} lamps are too many: send at most {MOST_LAMPS}")
    return lamps, ambient


def opacity_of(text: str | None) -> float:
    """Return the opacity of a request, by default 1."""
    try:
        opacity = 1.0 if text is None else float(text)
    except ValueError:
        opacity = np.nan
    if not 0.0 <= opacity <= 1.0:
        raise Refusal(422, "the opacity is not a number: send one from 0 to 1")
    return opacity


def _lamp_of(lamp: contract.SentLamp) -> Lamp:
    """Return a lamp of a request, with linear colours."""
    if lamp.direction is None:
        raise ValueError("a lamp has no direction")
    colour = (1.0, 1.0, 1.0) if lamp.colour is OMITTED else lamp.colour
    linear = srgb_to_linear(np.array(colour, np.float64))
    return Lamp(lamp.direction, tuple(linear.tolist()), lamp.strength, lamp.softness)


class Events:
    """Sends events to the open pages; thread-safe."""

    def __init__(self, heartbeat: float = 15.0) -> None:
        self._heartbeat = heartbeat  # seconds between comments to a page, which keep its connection open
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
