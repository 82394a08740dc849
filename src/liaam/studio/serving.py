"""Serve the studio on this machine until it is stopped with Ctrl-C."""

import socket
import sys
import threading
import time
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liaam.errors import LiaamError, installing
from liaam.studio.settings import DEFAULT_PORT, LOOPBACK, StudioSettings
from liaam.studio.tokens import lasting_token, new_token
from liaam.workers import one_blas_thread

if TYPE_CHECKING:
    from liaam.studio.app import Studio

PORTS_TRIED = 20
GRACE = 2
"""Seconds for running requests to finish when the server stops."""
KEEP_ALIVE = 5
"""Seconds that a connection may be idle between requests."""

LARGE_BLOCK = 1 << 20  # bytes from which on a block of memory is returned to the system when it is freed
ARENAS = 2  # number of heaps for smaller blocks. By default there are eight for each core, and each keeps freed memory
LEFT_FREE = 64 << 20
"""Bytes of freed memory at the end of a heap that are not returned at once, but after :data:`TRIM_SECONDS`. With the
default of 128 KB, a third of the time of live video is spent on getting the same memory again."""

TRIM_SECONDS = 5.0  # interval at which freed memory between used blocks is returned to the system


def serve(
    folder: Path,
    model: Path | None = None,
    host: str = "127.0.0.1",
    port: int | None = None,
    open_browser: bool = True,
    say: Callable[[str], None] = print,
    face: bool = True,
) -> None:
    """Serve the studio of a folder until Ctrl-C.

    Parameters
    ----------
    folder : Path
        Folder of the pictures; may be empty.
    model : Path, optional
        Model to use instead of the one that the studio trained in this folder before.
    host : str
        Address to listen on. With any other than the loopback, other machines that have the token have access.
    port : int, optional
        By default the first free port from 8765 on.
    open_browser : bool
    say : callable
        Prints a line.
    face : bool
        Whether the face model that comes with liaam proposes points in a folder that has none of its own.

    Raises
    ------
    LiaamError
        If the folder, the model, or the port cannot be used, or the ``[studio]`` extra is missing.
    """
    _uvicorn()
    from liaam.studio.app import Studio

    _return_freed_memory()
    listener = open_port(host, port)
    with listener, one_blas_thread():
        # Pages of an earlier start go on with a lasting token. Over a network it would travel unencrypted.
        token = lasting_token(folder) if host in LOOPBACK else new_token()
        settings = StudioSettings(host=host, port=listener.getsockname()[1], token=token, face=face)
        studio = Studio(folder, model, settings)
        server = make_server(studio)
        studio.background.start()
        _welcome(settings, open_browser, say)  # requests wait until the server runs
        try:
            server.run([listener])
        except KeyboardInterrupt:  # uvicorn repeats the signal once it has stopped
            return
        finally:
            studio.close()


def make_server(studio: "Studio") -> Any:
    """Create the server of a studio, a ``uvicorn.Server`` that ends its event streams when it stops."""
    uvicorn = _uvicorn()
    from liaam.studio.app import make_app

    class Server(uvicorn.Server):
        async def shutdown(self, *args: Any, **options: Any) -> None:
            studio.end_events()  # otherwise the server would wait for the event streams
            await super().shutdown(*args, **options)

    config = uvicorn.Config(
        make_app(studio),
        http=_protocol(studio.settings.header_seconds),
        ws="none",
        lifespan="off",
        loop="asyncio",
        log_config=None,  # plain lines on standard error, warnings and errors only
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=GRACE,
        timeout_keep_alive=min(KEEP_ALIVE, studio.settings.header_seconds),
        h11_max_incomplete_event_size=65536,
    )
    return Server(config)


def _protocol(header_seconds: float) -> Any:
    """Return an h11 protocol that closes a connection whose request line and headers do not arrive in time."""
    import h11
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class HeaderTimeout(H11Protocol):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._check(last=self)

        def _check(self, last: Any) -> None:
            """Close a connection that still waits for the same request, or for the rest of one that is answered."""
            answered = self.cycle is not None and self.cycle.response_complete
            waits = self.conn.their_state is h11.IDLE or answered
            if waits and self.cycle is last:
                self.transport.close()
            elif not self.transport.is_closing():
                self.loop.call_later(header_seconds, self._check, self.cycle if waits else self)

    return HeaderTimeout


def open_port(host: str, port: int | None) -> socket.socket:
    """Listen on a given port, or on the first free one."""
    if port is not None and not 0 <= port <= 65535:
        raise LiaamError(f"--port {port}: ports are 1 to 65535")
    tries = range(DEFAULT_PORT, DEFAULT_PORT + PORTS_TRIED) if port is None else (port,)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    reason = ""
    both = host == "::" and socket.has_dualstack_ipv6()
    for number in tries:
        try:
            made = socket.create_server((host, number), family=family, backlog=128, dualstack_ipv6=both)
        except OSError as fault:
            reason = str(fault.strerror or fault).partition(" (while")[0]
        else:
            # Without an explicit protocol, asyncio does not set TCP_NODELAY, and small answers are delayed by 40 ms.
            return socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP, made.detach())
    taken = f"port {port} of {host} is not free"
    none = f"no port from {tries[0]} to {tries[-1]} of {host} is free"
    raise LiaamError(f"{none if port is None else taken} ({reason}): choose another with --port")


def _return_freed_memory() -> None:
    """Make glibc return freed memory to the system: large blocks at once, others every few seconds.

    By default each thread keeps freed blocks of up to 32 MB, and pictures are decoded in many threads in blocks of
    16 MB. Under 200 concurrent uploads this lowers the memory from 2.0 GB to 0.9 GB. With a limit of 8 MB instead of
    1 MB, and more heaps, memory grew from 1.4 GB to 2.5 GB within three hours of work.
    """
    import ctypes

    c = ctypes.CDLL(None) if sys.platform == "linux" else None
    if not hasattr(c, "mallopt"):
        return
    c.mallopt(-3, LARGE_BLOCK)  # M_MMAP_THRESHOLD
    c.mallopt(-1, LEFT_FREE)  # M_TRIM_THRESHOLD
    c.mallopt(-8, ARENAS)  # M_ARENA_MAX

    def trim() -> None:
        while True:
            time.sleep(TRIM_SECONDS)
            c.malloc_trim(0)

    threading.Thread(target=trim, name="studio-memory", daemon=True).start()


def _uvicorn() -> Any:
    try:
        import starlette  # noqa: F401
        import uvicorn
    except ImportError as fault:
        raise LiaamError(f"the studio needs starlette and uvicorn: {installing('studio')}") from fault
    return uvicorn


def _welcome(settings: StudioSettings, open_browser: bool, say: Callable[[str], None]) -> None:
    shown = settings if settings.host not in ("0.0.0.0", "::") else replace(settings, host=socket.gethostname())
    if settings.host not in LOOPBACK:
        reach = f"other machines can reach the studio at {settings.host}"
        say(f"warning: {reach}; anyone with its address can change files")
    say(f"liaam studio: {shown.address}")
    say("Press Ctrl-C to stop it")
    if open_browser:
        threading.Thread(target=webbrowser.open, args=(shown.ticket_address(),), daemon=True).start()
