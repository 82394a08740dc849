"""What the studio is told at its start: its address, its token, and its limits."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from pathlib import Path

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Names of this machine that only this machine can use."""

DEFAULT_PORT = 8765

STATIC = Path(__file__).with_name("static")


@dataclass(frozen=True)
class Settings:
    """The studio's address, its token, and its limits. Sizes are in bytes unless a name says otherwise."""

    host: str = "127.0.0.1"
    """Address that is listened on."""
    port: int = DEFAULT_PORT
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)
    """What a browser has to know; it is part of the address that ``liaam studio`` prints."""
    json_bytes: int = 2_000_000
    """Body of a request, unless it is an upload."""
    upload_bytes: int = 64_000_000
    pixels: int = 50_000_000
    """Width times height of a picture to work with, from its header, before anything is decoded."""
    whole_pixels: int = 16_000_000
    """Of a picture that is relit in full size at most: it takes a hundred bytes a pixel, and a second a megapixel."""
    uploads_kept: int = 8
    uploads_bytes: int = 130_000_000
    """Of the files of those, all together."""
    uploads_at_once: int = 8
    """Uploads that are read, wait or are decoded at a time; the next one is asked to come again."""
    bodies_bytes: int = 130_000_000
    """Of all requests that are under way: two of the largest uploads."""
    header_seconds: float = 10.0
    """How long a request's line and headers may take to come."""
    body_seconds: float = 300.0
    """How long its body may."""
    fits_kept: int = 64
    points: int = 1000
    """Landmarks of a template at most."""
    drain_seconds: float = 5.0
    """How long a body that is too large is read and thrown away, so that its sender gets to read why."""
    heartbeat_seconds: float = 15.0
    """Time between the comments that keep a silent event stream open."""
    proposals_at_once: int = 8
    """Pictures that the quick model fits before the careful one is trained."""
    proposals_per_training: int = 100
    """Pictures that a model fits at most before it may be trained again."""
    static: Path = STATIC
    """The page."""

    @property
    def cookie(self) -> str:
        """Name of the cookie: studios on other ports have others, though cookies do not know of ports."""
        return f"liaam-studio-{self.port}"

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach the studio."""
        return self.host in LOOPBACK

    @property
    def address(self) -> str:
        """What a person opens, token included."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/?token={self.token}"
