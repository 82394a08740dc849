"""Access control: checks the origin, the token and the size of each request. Pure ASGI, in front of the application.

A page of another site can make a browser send requests to this machine, and its name can be pointed at this machine
(DNS rebinding). So ``Host`` must be this server, ``Origin`` must be the studio's page, and each request must have the
token, which other sites cannot read.
"""

import hmac
import ipaddress
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

import anyio
import h11
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from liaam.studio import contract
from liaam.studio.refusal import Refusal
from liaam.studio.settings import LOOPBACK, StudioSettings

FITS = "/api/fits"
# Paths that accept larger bodies
UPLOADS = "/api/uploads"
GUEST = "/api/model/guest"
FILES = "/api/files"
RECORDINGS = "/api/recordings"

HEADERS: dict[str, str] = {
    "content-security-policy": (
        "default-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; style-src 'self' 'unsafe-inline'; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "x-frame-options": "DENY",
    "cache-control": "no-store",
}
"""Default headers of every response."""


class Guard:
    """Refuses requests from other sites, without the token, or with too large a body; adds headers to responses."""

    def __init__(self, app: ASGIApp, settings: StudioSettings) -> None:
        self.app, self.settings, self.crowd = app, settings, Crowd(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer or refuse one request."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        with suppress(h11.LocalProtocolError):  # invalid data after the request has closed the connection
            if scope["type"] == "http":
                await self._handle(scope, receive, with_headers)
            elif scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            else:  # web sockets are not supported
                await send({"type": "websocket.close", "code": 1008})

    async def _handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope)
        refusal = self._refusal(request.headers)
        given = request.query_params.getlist("token")
        is_page = scope["method"] == "GET" and scope["path"] == "/"
        if refusal is None and is_page and self._may_open(given):
            answer: Response = RedirectResponse("/", 303)
            answer.set_cookie(self.settings.cookie, self.settings.token, httponly=True, samesite="strict")
            await answer(scope, receive, send)
            return
        bearers = [
            text[7:].strip() for text in request.headers.getlist("authorization") if text[:7].lower() == "bearer "
        ]
        if refusal is None and not any(map(self._is_token, (*bearers, request.cookies.get(self.settings.cookie, "")))):
            no_token = "this browser does not have the studio's token: open the address that 'liaam studio' printed"
            refusal = Refusal(401, no_token)
        if refusal is None:
            await self._limited(scope, request.headers, receive, send)
            return
        # The message contains no user input, so it needs no escaping.
        page = f"<!doctype html><meta charset=utf-8><title>liaam studio</title><p>{refusal}</p>"
        wants_page = "text/html" in request.headers.get("accept", "")
        await (HTMLResponse(page, refusal.status) if wants_page else _answer_of(refusal))(scope, receive, send)

    def _refusal(self, headers: Headers) -> Refusal | None:
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not is_own_host(hosts[0], self.settings):
            return Refusal(421, "this server has another name: open the address that 'liaam studio' printed")
        origins = [origin.partition("http://") for origin in headers.getlist("origin")]
        if any(scheme or not is_own_host(host, self.settings) for scheme, _, host in origins):
            return Refusal(403, "the request comes from another site: send it from the studio's own page")
        if any(site not in ("same-origin", "none") for site in headers.getlist("sec-fetch-site")):
            return Refusal(403, "the request comes from another site: type or paste the studio's address instead")
        return None

    def _may_open(self, given: list[str]) -> bool:
        """Whether an address opens the page: with the token, or a ticket, once."""
        return len(given) == 1 and (self._is_token(given[0]) or self.settings.tickets.take(given[0]))

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(errors="replace"), self.settings.token.encode())

    async def _limited(self, scope: Scope, headers: Headers, receive: Receive, send: Send) -> None:
        is_upload = scope["path"].endswith((UPLOADS, GUEST, FILES, RECORDINGS))  # of any set of landmarks
        limit = self.settings.upload_bytes if is_upload else self.settings.json_bytes
        too_large = Refusal(413, f"the request is larger than {limit:,} bytes: send less")
        declared = headers.get("content-length", "")
        parts = []
        is_whole = False

        async def next_part() -> Message:
            nonlocal is_whole
            message = await receive()
            is_whole = not message.get("more_body", False)
            return message

        with ExitStack() as stack:
            try:
                if declared.isdecimal() and int(declared[:20]) > limit:
                    raise too_large
                hold = stack.enter_context(self.crowd.one(is_upload and scope["method"] == "POST"))
                # Nobody waits for the body of a request that needs none.
                if scope["method"] not in ("GET", "HEAD"):
                    with anyio.fail_after(self.settings.body_seconds):
                        async for part in Request(scope, next_part).stream():
                            limit -= len(part)
                            if limit < 0:
                                raise too_large
                            hold(len(part))
                            parts.append(part)
            except ClientDisconnect:
                return
            except TimeoutError:
                stack.close()  # and there is nothing to read
                late = Refusal(408, "the rest of the request did not arrive in time: send it again")
                await _answer_of(late, close=True)(scope, receive, send)
                return
            except Refusal as refusal:
                stack.close()
                if not is_whole:  # a client that is cut off would not read the answer
                    await self._drain(scope, receive)
                await _answer_of(refusal, close=True)(scope, receive, send)
                return
            messages = iter([{"type": "http.request", "body": b"".join(parts)}])

            async def again() -> Message:
                return next(messages, None) or await receive()

            await self.app(scope, again, send)

    async def _drain(self, scope: Scope, receive: Receive) -> None:
        """Read and discard the rest of a body, as much as an upload may have, and only for a while."""
        left = self.settings.upload_bytes
        with anyio.move_on_after(self.settings.drain_seconds), suppress(ClientDisconnect):
            async for part in Request(scope, receive).stream():
                left -= len(part)
                if left <= 0:
                    break


RETRY_AFTER = 2  # seconds until a client should retry a request to a busy studio


class Crowd:
    """Limits the bytes of concurrent request bodies and the number of concurrent uploads. Not thread-safe."""

    def __init__(self, settings: StudioSettings) -> None:
        self.settings = settings
        self.n_bytes = 0
        self.uploads = 0

    @contextmanager
    def one(self, is_upload: bool) -> Iterator[Callable[[int], None]]:
        """Admit a request until it is answered; yield a function to call with the size of each received part."""
        busy = Refusal(503, "the studio is busy with other pictures: try again in a moment", retry_after=RETRY_AFTER)
        if is_upload and self.uploads >= self.settings.uploads_at_once:
            raise busy
        held = 0

        def hold(n_bytes: int) -> None:
            nonlocal held
            if self.n_bytes + n_bytes > self.settings.bodies_bytes:
                raise busy
            self.n_bytes += n_bytes
            held += n_bytes

        self.uploads += is_upload
        try:
            yield hold
        finally:
            self.uploads -= is_upload
            self.n_bytes -= held


def is_own_host(host: str, settings: StudioSettings) -> bool:
    """Whether a ``Host`` header names this server.

    On all addresses it may be any IP address, but only this machine's name: other names can be pointed at this machine.
    """
    name, _, port = host.lower().rpartition(":")
    if port != str(settings.port):
        name = host.lower()
        port = "80"  # browsers omit the default port
    if port != str(settings.port):
        return False
    bare = name[1:-1] if name.startswith("[") and name.endswith("]") else name
    if bare in LOOPBACK or bare == settings.host.lower():
        return True
    if settings.host not in ("0.0.0.0", "::"):
        return False
    with suppress(ValueError):
        return bare == socket.gethostname().lower() or bool(ipaddress.ip_address(bare))
    return False


def _answer_of(refusal: Refusal, close: bool = False) -> JSONResponse:
    headers = {"connection": "close"} if close else {}
    if refusal.retry_after is not None:
        headers["retry-after"] = str(refusal.retry_after)
    fault: contract.Fault = {"error": str(refusal)}
    return JSONResponse(fault, refusal.status, headers)
