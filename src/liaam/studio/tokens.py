"""The token of a folder's studio, kept in the user's state folder, so that pages go on after a restart; and tickets.

Only the user can read the token. One that others could have read or written, or of more than 30 days, is replaced, and
without a state folder each start has another one. The browser is started with a ticket instead, since all users of a
machine can see the arguments of processes.
"""

import hashlib
import os
import re
import secrets
import stat
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from liaam.io.files import real_path

_TOKEN = re.compile(r"[A-Za-z0-9_-]{32,64}")
TOKEN_SECONDS = 30 * 86400.0
"""How long a token lasts, from when it was made: a start after that makes another one."""

TICKET_SECONDS = 120.0  # how long a browser may take to start

_LARGEST = 100  # bytes of a file that may hold a token


class Tickets:
    """What the browser is started with: each ticket opens the page once, within two minutes; thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._ends: dict[str, float] = {}

    def new(self) -> str:
        """Return a ticket."""
        ticket = new_token()
        with self._lock:
            self._ends[ticket] = self._clock() + TICKET_SECONDS
        return ticket

    def take(self, text: str) -> bool:
        """Return whether a text is a ticket, which is not valid any more after that."""
        with self._lock:
            end = self._ends.pop(text, None)
        return end is not None and self._clock() < end


def new_token() -> str:
    """Return a new random token."""
    return secrets.token_urlsafe(24)


def lasting_token(folder: Path) -> str:
    """Return the token of a folder of pictures: the same one at each start."""
    if not folder.is_dir():
        return new_token()
    with suppress(OSError, RuntimeError):  # no home folder, a full disk, no rights: a token for this time
        tokens = user_folder()
        tokens.mkdir(parents=True, exist_ok=True, mode=0o700)
        path = tokens / f"{key_of(folder)}.token"
        token = _read(path)
        if token is None:
            token = new_token()
            _write(path, token)
        return token
    return new_token()


def user_folder() -> Path:
    """Return the folder in which the studio keeps what belongs to the user."""
    return _state_folder() / "liaam" / "studio"


def key_of(folder: Path) -> str:
    """Return the name by which a folder of pictures is known there."""
    return hashlib.sha256(os.fsencode(real_path(folder))).hexdigest()[:16]


def _state_folder() -> Path:
    """Return the folder for the state of programs of this user."""
    if named := os.environ.get("XDG_STATE_HOME"):
        return Path(named)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support"
    return Path.home() / ".local" / "state"


def _read(path: Path) -> str | None:
    """Return the token in a file; None if there is none, or others than this user may know it."""
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    except OSError:
        return None
    try:
        facts = os.fstat(descriptor)
        is_private = sys.platform == "win32" or (facts.st_uid == os.getuid() and not facts.st_mode & 0o077)
        is_old = time.time() - facts.st_mtime > TOKEN_SECONDS
        if not stat.S_ISREG(facts.st_mode) or not is_private or is_old:
            return None
        text = os.read(descriptor, _LARGEST).decode(errors="replace").strip()
    finally:
        os.close(descriptor)
    return text if _TOKEN.fullmatch(text) else None


def _write(path: Path, token: str) -> None:
    """Write a token that only this user can read, in place of what is there."""
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "w") as file:
            file.write(token)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
