"""The studio's door by itself: who is let in, how much may be sent, and what is answered, without a server."""

import asyncio
import json
import socket
from dataclasses import dataclass, field

import h11
import pytest

from liaam.studio.refusal import Refusal
from liaam.studio.safety import HEADERS, RETRY_AFTER, Crowd, Guard, is_own_host
from liaam.studio.settings import StudioSettings

SETTINGS = StudioSettings(
    port=8765, token="secret", json_bytes=100, upload_bytes=1000, bodies_bytes=1500, uploads_at_once=2,
    body_seconds=5.0, drain_seconds=0.2,
)  # fmt: skip
HOST = ("host", "127.0.0.1:8765")
TOKEN = ("authorization", "Bearer secret")


@dataclass
class Asked:
    """One request to a guard, and what became of it."""

    sent: list = field(default_factory=list)
    inside: list = field(default_factory=list)
    """Paths that were let in, and the bodies that were read there."""
    n_read: int = 0
    """Messages that were taken from the sender."""

    @property
    def status(self) -> int:
        return self.sent[0]["status"]

    @property
    def headers(self) -> dict[str, str]:
        return {name.decode(): value.decode() for name, value in self.sent[0]["headers"]}

    @property
    def body(self) -> bytes:
        return b"".join(message.get("body", b"") for message in self.sent[1:])

    @property
    def error(self) -> str:
        assert self.headers["content-type"] == "application/json"
        assert int(self.headers["content-length"]) == len(self.body)
        return json.loads(self.body)["error"]


def ask(
    *headers, method="GET", path="/api/x", query=b"", parts=(b"",), settings=SETTINGS, guard=None, reads=True, more=(),
    wait=0.0, kind="http",
) -> Asked:  # fmt: skip
    """Ask a guard whose application reads the body and says "yes"; gives what was answered."""
    asked = Asked()

    async def app(scope, receive, send):
        body = b""
        while reads:
            message = await receive()
            body += message.get("body", b"")
            if not message.get("more_body", False):
                break
        asked.inside.append((scope.get("path"), body))
        await send({"type": "http.response.start", "status": 200, "headers": list(more)})
        await send({"type": "http.response.body", "body": b"yes"})

    messages = [{"type": "http.request", "body": part, "more_body": i < len(parts)} for i, part in enumerate(parts, 1)]

    async def receive():
        asked.n_read += 1
        await asyncio.sleep(wait)
        return messages.pop(0) if messages else {"type": "http.disconnect"}

    async def send(message):
        asked.sent.append(message)

    scope = {
        "type": kind,
        "method": method,
        "path": path,
        "query_string": query,
        "headers": [(name.encode(), value.encode("latin-1")) for name, value in headers],
    }
    guard = guard or Guard(app, settings)
    guard.app = app
    asyncio.run(guard(scope, receive, send))
    return asked


# Who may ask


def test_who_knows_the_token_is_let_in():
    for known in (
        TOKEN,
        ("authorization", "bEARER  secret "),
        ("cookie", "a=b; liaam-studio-8765 = secret ; c"),
        ("cookie", "liaam-studio-8765=secret"),
    ):
        asked = ask(HOST, known)
        assert (asked.status, asked.body, asked.inside) == (200, b"yes", [("/api/x", b"")])


@pytest.mark.parametrize(
    "known",
    [
        ("authorization", "Bearer wrong"),
        ("authorization", "secret"),
        ("authorization", "Basic secret"),
        ("authorization", "Bearersecret"),
        ("authorization", "Bearer secret2"),
        ("authorization", "Bearer caf\u00e9"),
        ("cookie", "liaam-studio-8764=secret"),
        ("cookie", "liaam-studio-8765=wrong"),
        ("cookie", "secret"),
        ("x-token", "secret"),
    ],
)
def test_who_does_not_is_told_what_to_open(known):
    asked = ask(HOST, known)
    assert (asked.status, asked.inside) == (401, [])
    assert asked.error == "this browser does not have the studio's token: open the address that 'liaam studio' printed"
    assert "connection" not in asked.headers


def test_a_browser_gets_a_page_instead():
    asked = ask(HOST, ("accept", "text/html,*/*"))
    assert asked.status == 401
    assert asked.headers["content-type"] == "text/html; charset=utf-8"
    assert asked.body.startswith(b"<!doctype html>") and b"liaam studio" in asked.body
    assert int(asked.headers["content-length"]) == len(asked.body)


def test_the_token_in_the_address_becomes_a_cookie():
    asked = ask(HOST, path="/", query=b"a=1&token=secret")
    assert (asked.status, asked.body, asked.inside) == (303, b"", [])
    assert asked.headers["location"] == "/"
    assert asked.headers["set-cookie"] == "liaam-studio-8765=secret; HttpOnly; Path=/; SameSite=strict"


@pytest.mark.parametrize(
    ("method", "path", "query"),
    [
        ("POST", "/", b"token=secret"),
        ("GET", "/api", b"token=secret"),
        ("GET", "/", b"token=wrong"),
        ("GET", "/", b"token=secret&token=secret"),
        ("GET", "/", b"token=\xff"),
        ("GET", "/", b""),
    ],
)
def test_other_addresses_with_the_token_do_not(method, path, query):
    asked = ask(HOST, method=method, path=path, query=query)
    assert (asked.status, asked.inside) == (401, [])


def test_a_ticket_opens_the_page_once_and_nothing_else():
    ticket = SETTINGS.tickets.new()
    query = f"token={ticket}".encode()
    assert ask(HOST, path="/api/x", query=query).status == 401
    assert ask(("host", "evil.example"), path="/", query=query).status == 421
    assert ask(HOST, ("cookie", f"liaam-studio-8765={ticket}")).status == 401
    assert ask(HOST, ("authorization", f"Bearer {ticket}")).status == 401
    asked = ask(HOST, path="/", query=query)
    assert asked.status == 303 and ticket not in asked.headers["set-cookie"]
    assert asked.headers["set-cookie"] == "liaam-studio-8765=secret; HttpOnly; Path=/; SameSite=strict"
    assert ask(HOST, path="/", query=query).status == 401


def test_an_address_may_hold_twenty_fields():
    assert ask(HOST, path="/", query=b"&".join([b"a=b"] * 19) + b"&token=secret").status == 303


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ((TOKEN,), 421),
        ((HOST, HOST, TOKEN), 421),
        ((("host", "evil.example:8765"), TOKEN), 421),
        ((HOST, TOKEN, ("origin", "http://127.0.0.1:8765")), 200),
        ((HOST, TOKEN, ("origin", "https://127.0.0.1:8765")), 403),
        ((HOST, TOKEN, ("origin", "http://evil.example")), 403),
        ((HOST, TOKEN, ("origin", "http://127.0.0.1:8765"), ("origin", "null")), 403),
        ((HOST, TOKEN, ("sec-fetch-site", "same-origin")), 200),
        ((HOST, TOKEN, ("sec-fetch-site", "none")), 200),
        ((HOST, TOKEN, ("sec-fetch-site", "same-site")), 403),
        ((HOST, TOKEN, ("sec-fetch-site", "none"), ("sec-fetch-site", "cross-site")), 403),
    ],
)
def test_requests_come_from_the_studio_s_own_page(headers, status):
    asked = ask(*headers)
    assert asked.status == status
    assert bool(asked.inside) == (status == 200)
    if status != 200:
        assert {421: "this server has another name", 403: "the request comes from another site"}[status] in asked.error


def test_whence_a_request_comes_is_asked_before_its_token():
    assert ask(("host", "evil.example:8765"), path="/", query=b"token=secret").status == 421
    assert ask(HOST, ("origin", "null")).status == 403


@pytest.mark.parametrize(
    ("host", "settings", "own"),
    [
        ("127.0.0.1:8765", {}, True),
        ("LOCALHOST:8765", {}, True),
        ("[::1]:8765", {}, True),
        ("::1:8765", {}, True),
        ("[::1:8765", {}, False),
        ("127.0.0.1", {}, False),
        ("127.0.0.1:80", {}, False),
        ("192.168.1.5:8765", {}, False),
        ("127.0.0.1", {"port": 80}, True),
        ("localhost:80", {"port": 80}, True),
        ("[::1]", {"port": 80}, True),
        ("me.local:8765", {"host": "Me.Local"}, True),
        ("you.local:8765", {"host": "Me.Local"}, False),
        ("192.168.1.5:8765", {"host": "0.0.0.0"}, True),
        ("192.168.1.5:8765", {"host": "192.168.1.5"}, True),
        ("[fe80::1]:8765", {"host": "::"}, True),
        ("evil.example:8765", {"host": "0.0.0.0"}, False),
        ("evil.example:8765", {"host": "::"}, False),
        (f"{socket.gethostname()}:8765", {"host": "0.0.0.0"}, True),
        (f"{socket.gethostname()}:8765", {"host": "127.0.0.1"}, False),
        ("", {"port": 80}, False),
    ],
)
def test_names_of_this_server(host, settings, own):
    assert is_own_host(host, StudioSettings(**settings)) is own


def test_every_answer_has_the_headers_and_keeps_its_own():
    asked = ask(HOST, TOKEN, more=[(b"cache-control", b"private"), (b"x-own", b"1")])
    assert asked.headers == {
        **{name: value for name, value in HEADERS.items() if name != "cache-control"},
        "cache-control": "private",
        "x-own": "1",
    }
    for refused in (ask(HOST), ask(TOKEN), ask(HOST, path="/", query=b"token=secret")):
        assert HEADERS.items() <= refused.headers.items()
    assert HEADERS["cache-control"] == "no-store"
    assert HEADERS["x-content-type-options"] == "nosniff"
    assert HEADERS["referrer-policy"] == "no-referrer"
    assert HEADERS["cross-origin-resource-policy"] == "same-origin"
    assert HEADERS["x-frame-options"] == "DENY"
    policy = HEADERS["content-security-policy"].split("; ")
    assert {"default-src 'self'", "frame-ancestors 'none'", "base-uri 'none'", "form-action 'self'"} <= set(policy)


def test_what_is_no_request_passes_or_is_closed():
    assert ask(kind="lifespan", reads=False).inside
    asked = ask(HOST, TOKEN, kind="websocket")
    assert (asked.sent, asked.inside) == ([{"type": "websocket.close", "code": 1008}], [])


def test_a_connection_that_nonsense_has_ended_is_left_alone():
    async def app(scope, receive, send):
        raise h11.LocalProtocolError("too late")

    guard = Guard(app, SETTINGS)
    scope = {"type": "lifespan"}
    asyncio.run(guard(scope, None, None))  # type: ignore[arg-type]


# How much may be sent


@pytest.mark.parametrize(("path", "limit"), [("/api/x", 100), ("/api/uploads", 1000)])
def test_bodies_are_limited(path, limit):
    def send(n: int, *headers, parts=None) -> Asked:
        whole = [b"x" * n] if parts is None else parts
        return ask(HOST, TOKEN, *headers, method="POST", path=path, parts=whole)

    half = [b"x" * (limit // 2)] * 2
    assert send(limit, ("content-length", str(limit))).inside == [(path, b"x" * limit)]
    assert send(limit).inside == send(0, parts=half).inside == [(path, b"x" * limit)]
    for asked in (
        send(1, ("content-length", str(limit + 1))),
        send(1, ("content-length", "9" * 40)),
        send(limit + 1),
        send(0, parts=[*half, b"x"]),
        send(limit + 1, ("content-length", "few")),
    ):
        assert (asked.status, asked.inside) == (413, [])
        assert asked.error == f"the request is larger than {limit:,} bytes: send less"
        assert asked.headers["connection"] == "close"


def test_what_is_too_large_is_thrown_away_before_it_is_refused():
    parts = [b"x" * 90] * 5
    asked = ask(HOST, TOKEN, ("content-length", "450"), method="POST", parts=parts)
    assert (asked.status, asked.n_read) == (413, 5)  # all of it, and not waiting for more
    gone = ask(HOST, TOKEN, ("content-length", "450"), method="POST", parts=[])
    assert (gone.status, gone.n_read) == (413, 1)
    endless = ask(HOST, TOKEN, ("content-length", "9000"), method="POST", parts=[b"x" * 100] * 90)
    assert (endless.status, endless.n_read) == (413, 10)  # as much as an upload


def test_who_has_sent_all_of_what_is_too_large_is_answered_at_once():
    asked = ask(HOST, TOKEN, method="POST", parts=[b"x" * 90] * 2)  # the end is what is too much
    assert (asked.status, asked.n_read) == (413, 2)  # nothing more is waited for


def test_what_is_too_large_is_thrown_away_for_a_while_only():
    # A part comes each 0.05 s of the loop's own clock, by which it waits for 0.2.
    asked = ask(HOST, TOKEN, ("content-length", "450"), parts=[b"x"] * 99, wait=0.05)
    assert asked.status == 413
    assert asked.n_read < 20


def test_a_body_that_does_not_come_is_not_waited_for():
    quick = StudioSettings(**{**SETTINGS.__dict__, "body_seconds": 0.1})
    asked = ask(HOST, TOKEN, method="POST", parts=[b"x", b"y"], wait=60.0, settings=quick)
    assert (asked.status, asked.inside) == (408, [])
    assert asked.error == "the rest of the request did not arrive in time: send it again"
    assert asked.n_read == 1  # nothing more is read of who sends nothing


def test_an_answer_that_has_begun_is_not_begun_again():
    sent = []

    async def app(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})
        while True:
            await receive()

    async def receive():
        return {"type": "http.request", "body": b"x" * 60, "more_body": True}

    async def send(message):
        sent.append(message)

    headers = [(name.encode(), value.encode()) for name, value in (HOST, TOKEN)]
    scope = {"type": "http", "method": "POST", "path": "/", "query_string": b"", "headers": headers}
    asyncio.run(Guard(app, SETTINGS)(scope, receive, send))
    assert [message["type"] for message in sent] == ["http.response.start", "http.response.body"]


def test_who_has_sent_all_may_wait_for_the_end_of_the_connection():
    seen = []

    async def app(scope, receive, send):
        seen.extend([await receive(), await receive()])

    messages = [{"type": "http.request", "body": b"x" * 100}, {"type": "http.disconnect", "body": b"y" * 500}]

    async def receive():
        await asyncio.sleep(0.02)
        return messages.pop(0)

    headers = [(name.encode(), value.encode()) for name, value in (HOST, TOKEN)]
    scope = {"type": "http", "method": "POST", "path": "/", "query_string": b"", "headers": headers}
    asyncio.run(Guard(app, StudioSettings(**{**SETTINGS.__dict__, "body_seconds": 60.0}))(scope, receive, None))  # type: ignore[arg-type]
    assert [message["type"] for message in seen] == ["http.request", "http.disconnect"]


# Crowds


def test_so_many_uploads_at_a_time():
    guard = Guard(None, SETTINGS)  # type: ignore[arg-type]
    with guard.crowd.one(True), guard.crowd.one(True):
        asked = ask(HOST, TOKEN, method="POST", path="/api/uploads", guard=guard)
        assert (asked.status, asked.inside) == (503, [])
        assert asked.error == "the studio is busy with other pictures: try again in a moment"
        assert asked.headers["retry-after"] == str(RETRY_AFTER) == "2"
        assert ask(HOST, TOKEN, method="GET", path="/api/uploads", guard=guard).status == 200
        assert ask(HOST, TOKEN, method="POST", path="/api/fits", guard=guard).status == 200
    assert guard.crowd.uploads == 0
    assert ask(HOST, TOKEN, method="POST", path="/api/uploads", guard=guard).status == 200
    assert "retry-after" not in ask(HOST, guard=guard).headers


def test_so_many_bytes_of_bodies_at_a_time():
    crowd = Crowd(SETTINGS)
    with crowd.one(False) as first, crowd.one(True) as second:
        first(1000)
        second(400)
        second(100)
        with pytest.raises(Refusal) as refused:
            first(1)
        assert refused.value.status == 503
        first(0)
        assert (crowd.n_bytes, crowd.uploads) == (1500, 1)
    assert (crowd.n_bytes, crowd.uploads) == (0, 0)


def test_a_crowd_is_smaller_by_who_fails():
    crowd = Crowd(SETTINGS)
    with pytest.raises(KeyError), crowd.one(True) as hold:
        hold(7)
        raise KeyError
    assert (crowd.n_bytes, crowd.uploads) == (0, 0)


def test_bodies_that_were_read_no_longer_count():
    guard = Guard(None, SETTINGS)  # type: ignore[arg-type]
    for _ in range(3):
        assert ask(HOST, TOKEN, method="POST", path="/api/uploads", parts=[b"x" * 900], guard=guard).status == 200
    with guard.crowd.one(False) as hold:
        hold(700)
        assert ask(HOST, TOKEN, method="POST", path="/api/uploads", parts=[b"x" * 800], guard=guard).status == 200
        assert ask(HOST, TOKEN, method="POST", path="/api/uploads", parts=[b"x" * 801], guard=guard).status == 503
