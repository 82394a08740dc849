"""The studio's own files, in a subfolder of the project's folder.

They are ``template.json``, ``change.json`` (:mod:`liaam.studio.template_change`), ``proposals.json``
and ``unchecked.json`` (:mod:`liaam.studio.proposals`), ``invisible.json`` and ``kept``
(:mod:`liaam.studio.landmark_files`), the models (:mod:`liaam.studio.model_store`), and ``id``, which identifies the
folder.
"""

from __future__ import annotations

import json
import secrets
import threading
from collections.abc import Callable
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
            self.note(name, None)
            try:
                path = self._folder() / name
            except Refusal as refusal:
                self.note(STATE, str(refusal))
                return None
            try:
                if not path.is_file():
                    return None
                content = json.loads(self.path(name).read_bytes())
                # Raises for NaN, which the page cannot parse, and for lone surrogates, which UTF-8 cannot encode.
                json.dumps(content, allow_nan=False, ensure_ascii=False).encode()
                if check(content):
                    return content
                fault: object = "its contents are not valid"
            except (OSError, ValueError, RecursionError, LiaamError, KeyError, TypeError, AttributeError) as error:
                fault = error
            self.note(name, f"{STATE}/{name} cannot be read ({fault}), so it is ignored: remove it, or fix it")
            return None

    def remove(self, *names: str) -> None:
        """Remove files if they exist."""
        with self._lock:
            for name in names:
                remove(self.path(name))
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

    def _folder(self) -> Path:
        folder = self.folder.root / STATE
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise Refusal(409, f"{STATE} is a link or a file where the studio keeps a folder: remove it")
        return folder


def _is_id(data: Any) -> bool:
    return isinstance(data, str) and 16 <= len(data) <= 64
