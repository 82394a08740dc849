"""Routes of the web application: functions that run in threads, and the bodies that they take."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from typing import Any
from urllib.parse import quote

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from liaam.studio.safety import Refusal

Reader = Callable[[Request], Awaitable[Any]]
"""Reads the body of a request, whose size :class:`liaam.studio.safety.Guard` has limited."""


def route(
    method: str,
    path: str,
    act: Callable[..., Any],
    read: Reader | None = None,
    limiter: CapacityLimiter | None = None,
    status: int = 200,
) -> Route:
    """Return a route that answers with what ``act`` returns: a response, a value as JSON, or None as 204.

    ``act`` runs in a thread, which keeps the event loop free. It takes the request and, with ``read``, its body.
    """

    async def endpoint(request: Request) -> Response:
        body = () if read is None else (await read(request),)
        answer = await run_sync(act, request, *body, limiter=limiter)
        if isinstance(answer, Response):
            return answer
        return Response(status_code=204) if answer is None else JSONResponse(answer, status)

    return Route(path, endpoint, methods=[method])


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
        content = json.loads(body, parse_constant=_no_number)
        if b"\\u" in body:  # raises for half of a surrogate pair, which cannot be encoded
            json.dumps(content, ensure_ascii=False).encode()
        return content
    except (ValueError, RecursionError) as fault:  # UnicodeDecodeError is a ValueError
        raise Refusal(400, f"the request is not JSON ({str(fault)[:100]})") from fault


def _no_number(text: str) -> Any:
    raise ValueError(f"{text} is not a JSON number")


def attachment(name: str, data: bytes, kind: str = "application/octet-stream") -> Response:
    """Return a file to save, with any characters in its name (RFC 6266)."""
    plain = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "._- ") else "_" for letter in name)
    place = f"attachment; filename=\"{plain}\"; filename*=UTF-8''{quote(name, safe='')}"
    return Response(data, media_type=kind, headers={"content-disposition": place, "cache-control": "no-store"})
