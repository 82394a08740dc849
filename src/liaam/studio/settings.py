"""Settings of the studio: its address, its token, and its limits."""

from dataclasses import dataclass, field
from pathlib import Path

from liaam.studio.tokens import Tickets, new_token

LOOPBACK = ("127.0.0.1", "localhost", "::1")  # names and addresses of the loopback
DEFAULT_PORT = 8765
STATIC = Path(__file__).with_name("static")


@dataclass(frozen=True)
class StudioSettings:
    """The studio's address, its token, and its limits."""

    host: str = "127.0.0.1"  # address to listen on
    port: int = DEFAULT_PORT
    token: str = field(default_factory=new_token, repr=False)
    """Secret for the browser; part of the address that ``liaam studio`` prints."""
    tickets: Tickets = field(default_factory=Tickets, repr=False, compare=False)
    """What may be in the place of the token in the address of the page, once each."""
    json_bytes: int = 2_000_000  # maximum body of a request that is not an upload
    upload_bytes: int = 64_000_000  # maximum body of an upload
    pixels: int = 200_000_000  # maximum width times height of a picture, checked in its header before it is decoded
    whole_pixels: int = 16_000_000
    """Most pixels of a relit picture that is saved, which takes 100 bytes per pixel and a second per megapixel. Larger
    pictures are reduced to it."""
    uploads_kept: int = 8  # number of uploads in memory
    uploads_bytes: int = 130_000_000  # maximum total size of the uploads in memory
    uploads_at_once: int = 8  # maximum number of concurrent uploads; the client of a further one is asked to retry
    bodies_bytes: int = 130_000_000  # maximum total body size of concurrent requests: two of the largest uploads
    header_seconds: float = 10.0  # time limit for a request's line and headers
    body_seconds: float = 300.0  # time limit for a request's body
    fits_kept: int = 64  # number of fits in memory
    live_kept: int = 4  # number of videos that are tracked live at a time; the one that was used least recently ends
    points: int = 1000  # maximum number of points of a template
    drain_seconds: float = 5.0  # how long too large a body is read and discarded, so that the client reads the answer
    heartbeat_seconds: float = 15.0  # interval of the comments that keep an idle event stream open
    face: bool = True  # whether the face model of liaam proposes points in a folder that has none of its own
    static: Path = STATIC  # folder of the page

    @property
    def cookie(self) -> str:
        """Name of the cookie. It contains the port, because browsers share cookies between ports."""
        return f"liaam-studio-{self.port}"

    @property
    def address(self) -> str:
        """Address to open in the browser, with the token."""
        return self._address(self.token)

    def ticket_address(self) -> str:
        """Return an address that opens the page once, for the arguments of a process."""
        return self._address(self.tickets.new())

    def _address(self, token: str) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/?token={token}"
