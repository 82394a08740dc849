"""Hostile requests to the studio: paths, headers and bodies, passed directly to the application."""

from __future__ import annotations

import asyncio
import json
import secrets
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np

from fuzz.mutate import Random, one_of, spoilt, spoilt_json
from fuzz.target import Target

HOST, TOKEN = "127.0.0.1:8765", "token"

_ID = "abc"
"""Identifier of every upload, fit and live video here, so that requests reach those that exist."""

_FRAMES = b"/api/live/abc/frames?width=16&height=16&of_width=32&of_height=32&number=1&time=0.1&flat=1"
_TARGETS = (
    *(b"/", b"/?token=token", b"/style.css", b"/js/../index.html", b"/api/project", b"/api/project?stamp=1-0-idle"),
    *(b"/api/pictures/p1.png/image?size=64", b"/api/pictures/p1.png/chroma?size=20"),
    *(b"/api/pictures/p1.png/landmarks", b"/api/pictures/p1.png/history", b"/api/template", b"/api/training"),
    *(b"/api/template/file?name=x.pts", b"/api/review", b"/api/export/pts", b"/api/export/coco", b"/api/export/tps"),
    *(b"/api/uploads?name=x.png", b"/api/uploads/abc/image", b"/api/model/file", b"/api/model/guest?name=x.liaam"),
    *(b"/api/fits", b"/api/fits/abc/layers/flat", b"/api/live", b"/api/live/abc"),
    _FRAMES,
    *(b'/api/fits/abc/relit?light={"lamps":[],"ambient":0.5}', b"/api/fits/abc/export?what=pts", b"/api/nothing"),
)
_WORDS = (
    *(b"%2e%2e/", b"../", b"%00", b"%ff", b"%ED%A0%80", b"%", b"?", b"&", b"=", b"size=", b"name=", b"p1.png", b"//"),
    *(b"#", b"abc", b"width=", b"-1", b"1e999", b"99999999"),
)
_BODIES = (
    {"id": "x", "names": ["a", "b", "c"], "contours": [{"indices": [0, 1, 2], "closed": True}], "mapping": [0, 1, 2]},
    {"points": [[1, 2], [30, 2], [15, 20]], "invisible": [2], "revision": None},
    {"picture": "p1.png", "method": "soft-li", "start": {"box": [1, 2, 30, 20]}},
    {"upload": _ID, "method": "grey", "start": {"shape": [[12, 12], [40, 12], [42, 40], [12, 42], [26, 26]]}},
    *({"pictures": ["p1.png"], "did": did, "who": "Ann"} for did in ("checked", "left out", "deleted", "undeleted")),
)

FRAME = bytes(range(256)) * 4
"""A frame of a video, 16 x 16 pixels."""


class Request(NamedTuple):
    """A parsed request."""

    method: str
    target: bytes
    headers: list[tuple[bytes, bytes]]
    body: list[bytes]


def make(rng: Random) -> Request:
    """Make a request with some faults, usually with a valid token."""
    target = one_of(rng, _TARGETS) if rng.random() < 0.5 else _visible(spoilt(rng, _TARGETS, _WORDS)[:2000])
    method = one_of(rng, ("GET", "GET", "PUT", "POST", "POST", "DELETE", "HEAD", "OPTIONS", "PATCH", "X"))
    headers = [(b"host", HOST.encode()), (b"authorization", f"Bearer {TOKEN}".encode())]
    headers.append((b"content-type", one_of(rng, (b"application/json", b"application/json", b"image/png", b""))))
    for _ in range(int(rng.geometric(0.6)) - 1):
        name = one_of(
            rng, (b"host", b"origin", b"cookie", b"if-none-match", b"range", b"content-length", b"accept", b"x")
        )
        value = spoilt(
            rng, (HOST.encode(), b"http://" + HOST.encode(), b"bytes=0-5,7-", b"text/html", b"12", b'W/"x-64"')
        )
        headers.append((name, value[:2000]))
    if rng.random() < 0.05:
        headers.pop(int(rng.integers(2)))
    body = (
        spoilt_json(rng, _BODIES)
        if rng.random() < 0.8
        else spoilt(rng, (_png(), FRAME, b"version: 1\n{\n1 2\n}\n", b"[]"))
    )
    at = np.sort(rng.integers(len(body) + 1, size=int(rng.integers(3)))).tolist()
    return Request(method, target, headers, [body[i:j] for i, j in zip([0, *at], [*at, len(body)], strict=True)])


def _visible(target: bytes) -> bytes:
    """Restrict a target to visible ASCII, as the server does."""
    return bytes(byte for byte in target if 0x21 <= byte <= 0x7E)


@cache
def _png() -> bytes:
    from liaam.studio.pictures import png_bytes

    return png_bytes(np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8))


@cache
def _app(folder: str) -> Any:
    """Return the studio on a folder of one image."""
    from fuzz.engine import tiny
    from liaam.studio.app import Studio, make_app
    from liaam.studio.settings import StudioSettings

    home = Path(folder) / "project"
    home.mkdir()
    (home / "p1.png").write_bytes(_png())
    tiny().save(Path(folder) / "m.liaam")
    secrets.token_urlsafe = lambda *_: _ID  # this process does nothing else
    return make_app(Studio(home, Path(folder) / "m.liaam", StudioSettings(token=TOKEN, drain_seconds=0.1)))


async def _answer(app: Any, request: Request) -> tuple[int, dict[bytes, bytes], bytes]:
    path, _, query = request.target.partition(b"?")
    parts, sent = list(request.body), []

    async def receive() -> dict:
        if not parts:
            return {"type": "http.disconnect"}
        return {"type": "http.request", "body": parts.pop(0), "more_body": bool(parts)}

    async def send(message: dict) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "asgi": {"version": "3.0", "spec_version": "2.3"},
        "http_version": "1.1",
        "scheme": "http",
        "method": request.method,
        "path": unquote(path.decode("latin-1")),
        "raw_path": path,
        "root_path": "",
        "query_string": query,
        "headers": request.headers,
        "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 8765),
    }
    await app(scope, receive, send)
    begin, *rest = sent
    body = b"".join(message.get("body", b"") for message in rest)
    return begin["status"], {name.lower(): value for name, value in begin["headers"]}, body


def check(request: Request) -> None:
    """Send a request. Errors must have a message, and must not be server errors."""
    from liaam.errors import LiaamError

    status, headers, body = asyncio.run(_answer(_app(str(Path.cwd())), request))
    assert status < 500, (status, body[:200])
    assert b"content-security-policy" in headers
    names = {path.name for path in Path.cwd().iterdir()}
    assert names <= {"project", "m.liaam", "trace.txt"}, names
    if status >= 400 and headers.get(b"content-type") == b"application/json":
        raise LiaamError(json.loads(body)["error"])


def prepare() -> None:
    """Create the studio, request each resource once, and begin a fit and a live video."""
    app = _app(str(Path.cwd()))

    def send(method: str, target: bytes, body: bytes) -> int:
        kind = b"image/png" if body == _png() else b"application/json"
        headers = [(b"host", HOST.encode()), (b"authorization", f"Bearer {TOKEN}".encode()), (b"content-type", kind)]
        return asyncio.run(_answer(app, Request(method, target, headers, [body])))[0]

    for target in _TARGETS:
        for method, body in (("GET", b""), ("POST", b"{}"), ("POST", json.dumps(_BODIES[2]).encode())):
            send(method, target, body)
    begun = [send("DELETE", b"/api/model/guest", b""), send("POST", b"/api/uploads?name=x.png", _png())]
    begun += [send("POST", b"/api/fits", json.dumps(body).encode()) for body in _BODIES[2:4]]
    begun += [send("POST", b"/api/live", b"{}"), send("POST", _FRAMES, FRAME)]
    assert max(begun) < 300, begun


TARGETS = (Target("requests", make, check, prepare, ".txt", 0.2),)
