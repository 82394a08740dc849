"""The studio's own files, in a subfolder of the project's folder.

They are ``template.json``, ``change.json`` (:mod:`liaam.studio.template_change`), ``proposals.json``
and ``unchecked.json`` (:mod:`liaam.studio.proposals`), ``invisible.json`` and ``kept``
(:mod:`liaam.studio.landmark_files`), ``log.jsonl`` (:mod:`liaam.studio.review`), the models and ``versions.jsonl``
(:mod:`liaam.studio.model_store`), and ``id``, which identifies the folder.
"""

from __future__ import annotations

import json
import os
import secrets
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from liaam.errors import LiaamError
from liaam.io.atomic import sweep, write_bytes_atomically
from liaam.io.files import real_path
from liaam.studio.folder import STATE, Folder, remove, revision_of
from liaam.studio.safety import Refusal


class StateFiles:
    """The studio's own files in a folder; thread-safe.

    Attributes
    ----------
    folder : Folder
    faults : dict of str to str
        Errors of these files and of the objects read from them.
    writes : int
        Incremented with every write or removal, except of ``id``.
    """

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self.faults: dict[str, str] = {}
        self.writes = 0
        self._lock = threading.RLock()
        self._id = ""

    @property
    def id(self) -> str:
        """Unique identifier of the folder. It survives a move; a copy has another one."""
        with self._lock:
            if not self._id:
                known = self.read("id", _is_id)
                if known is None:
                    known = secrets.token_hex(16)
                    with suppress(LiaamError):  # the id is then valid until the studio ends
                        self.write("id", known)
                try:
                    facts = self.folder.root.stat()
                except OSError as fault:
                    raise Refusal(409, f"the folder cannot be read ({fault.strerror or fault}): restore it") from fault
                self._id = revision_of(f"{known} {facts.st_dev} {facts.st_ino}".encode())
            return self._id

    def path(self, name: str) -> Path:
        """Return the path of a file and create its folder.

        Raises
        ------
        Refusal
            409 if it is a link that leads out of the studio's subfolder.
        """
        path = self._folder() / name
        self.note(STATE, None)
        if not real_path(path).is_relative_to(self.folder.root / STATE):
            raise Refusal(409, f"{STATE}/{name} is a link that leads elsewhere, so it is not used: remove it")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise LiaamError(
                f"{path.parent} cannot be made ({fault.strerror or fault}): check the rights on the folder."
            ) from fault
        return path

    def write(self, name: str, content: Any) -> None:
        """Write a file atomically: bytes as they are, any other content as JSON."""
        data = content if isinstance(content, bytes) else json.dumps(content, ensure_ascii=False).encode()
        with self._lock:
            write_bytes_atomically(self.path(name), data)
            self.writes += name != "id"  # the id is not shown
            self.note(name, None)

    def read(self, name: str, check: Callable[[Any], bool]) -> Any:
        """Read a JSON file. Return None if it does not exist or is damaged; damage is noted in ``faults``."""
        with self._lock:
            try:
                return _checked(self.path(name).read_bytes(), check) if self._has(name) else None
            except _DAMAGE as fault:
                self.note(name, f"{STATE}/{name} cannot be read ({fault}), so it is ignored: remove it, or fix it")
                return None

    def append(self, name: str, items: Iterable[Any]) -> None:
        """Append lines of JSON to a file and flush it. If the process is killed, the last line may be cut short."""
        data = "".join(json.dumps(item, ensure_ascii=False) + "\n" for item in items).encode()
        with self._lock:
            path = self.path(name)
            try:
                with path.open("ab+") as file:
                    is_cut = file.tell() > 0 and (file.seek(-1, os.SEEK_END), file.read(1))[1] != b"\n"
                    file.write(b"\n" * is_cut + data)
                    file.flush()
                    os.fsync(file.fileno())
            except OSError as fault:
                raise LiaamError(
                    f"{path} cannot be written ({fault.strerror or fault}): check the permissions and the free space."
                ) from fault
            self.writes += 1

    def read_lines(self, name: str, check: Callable[[Any], bool]) -> list[Any]:
        """Read a file of JSON lines. Damaged lines are skipped, and noted in ``faults`` if not cut short by a kill."""
        with self._lock:
            try:
                lines = self.path(name).read_bytes().split(b"\n")[:-1] if self._has(name) else []
            except _DAMAGE as fault:
                self.note(name, f"{STATE}/{name} cannot be read ({fault}), so it is ignored: remove it, or fix it")
                return []
            found, n_damaged = [], 0
            for line in filter(None, lines):
                try:
                    found.append(_checked(line, check))
                except _DAMAGE:
                    n_damaged += 1
            if n_damaged:
                what = f"{n_damaged} of the lines of {STATE}/{name}"
                self.note(name, f"{what} cannot be read, so they are ignored: remove them, or fix them")
            return found

    def remove(self, *names: str) -> None:
        """Remove files if they exist."""
        with self._lock:
            for name in names:
                remove(self.path(name))
            self.writes += 1

    def set_aside(self, name: str) -> None:
        """Move a file to ``kept`` if it exists, under a name by its content."""
        with self._lock:
            path = self.path(name)
            try:
                if path.exists():
                    path.replace(self.path(f"kept/{path.stem}.{revision_of(path.read_bytes())}{path.suffix}"))
            except OSError as fault:
                raise LiaamError(
                    f"{path} cannot be moved ({fault.strerror or fault}): check the rights on it."
                ) from fault
            self.writes += 1

    def note(self, key: str, fault: str | None) -> None:
        """Set or clear the error of a file."""
        with self._lock:
            if fault is None:
                self.faults.pop(key, None)
            else:
                self.faults[key] = self.folder.plain(fault)

    def sweep(self) -> None:
        """Remove partial files of a killed process, here and beside the pictures. Call it before any other writes."""
        with self._lock, suppress(LiaamError):
            for folder in (self.folder.root, self._folder(), self._folder() / "kept"):
                sweep(folder)

    def _has(self, name: str) -> bool:
        """Return whether a file exists, and clear its error. A subfolder that cannot be used is noted once."""
        self.note(name, None)
        try:
            folder = self._folder()
        except Refusal as refusal:
            self.note(STATE, str(refusal))
            return False
        return (folder / name).is_file()

    def _folder(self) -> Path:
        folder = self.folder.root / STATE
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise Refusal(409, f"{STATE} is a link or a file where the studio keeps a folder: remove it")
        return folder


_DAMAGE = (OSError, ValueError, RecursionError, LiaamError, KeyError, TypeError, AttributeError)
"""Errors of reading and checking a damaged file."""


def _checked(data: bytes, check: Callable[[Any], bool]) -> Any:
    """Parse and check JSON; raise one of :data:`_DAMAGE` if it is not valid."""
    content = json.loads(data)
    # Raises for NaN, which the page cannot parse, and for lone surrogates, which UTF-8 cannot encode.
    json.dumps(content, allow_nan=False, ensure_ascii=False).encode()
    if not check(content):
        raise ValueError("its contents are not valid")
    return content


def _is_id(data: Any) -> bool:
    return isinstance(data, str) and 16 <= len(data) <= 64
