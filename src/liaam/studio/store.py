"""What the studio keeps for a folder: one SQLite file, with the trained models beside it, in a subfolder.

The database holds JSON: values by kind and name (the template, a change of it that is under way, proposals, pictures
left at the mean shape, invisible points of ``.pts`` files, deleted landmarks, facts about the models), and lines that
are only appended (reviews, versions of the model). Landmarks lie beside the pictures, in their own formats.
"""

import json
import os
import secrets
import sqlite3
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from liaam.errors import LiaamError
from liaam.io.atomic import lock, sweep
from liaam.io.files import real_path
from liaam.studio.folder import SETS, STATE, File, Folder, disk_errors, revision_of
from liaam.studio.refusal import Refusal

DATABASE = "studio.db"
LOCK_FILE = "lock"
_SCHEMA = """
CREATE TABLE IF NOT EXISTS item (kind TEXT, name TEXT, json TEXT, hash TEXT, PRIMARY KEY (kind, name)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS line (number INTEGER PRIMARY KEY, kind TEXT, json TEXT, hash TEXT);
"""


class Store:
    """The studio's own files of a folder, or of a further set of landmarks; thread-safe. ``faults`` say what fails."""

    def __init__(self, folder: Folder, set_name: str = "") -> None:
        self.folder = folder
        self.set_name = set_name
        self.state = f"{SETS}/{set_name}" if set_name else STATE
        self.faults: dict[str, str] = {}
        self.writes = 0
        self._lock = threading.RLock()
        self._connection: sqlite3.Connection | None = None
        self._opened: os.stat_result | None = None

    @cached_property
    def id(self) -> str:
        """Unique identifier of the folder. It survives a move; a copy has another one."""
        with self._lock:
            identifier = self.get("id")
            if identifier is None:
                identifier = secrets.token_hex(16)
                with suppress(LiaamError):  # the id is then valid until the studio ends
                    self.put("id", {"": identifier})
            with disk_errors("the folder cannot be read", "restore it", partial(Refusal, 409)):
                facts = self.folder.root.stat()
            return revision_of(f"{identifier} {facts.st_dev} {facts.st_ino}".encode())

    def get(self, kind: str, name: str = "") -> Any:
        """Return a value, or None."""
        return self.all(kind, name).get(name)

    def all(self, kind: str, name: str | None = None) -> dict[str, Any]:
        """Return the values of a kind by name, or only the one with a name."""
        query = "SELECT name, json, hash FROM item WHERE kind = ?"
        arguments = [kind]
        if name is not None:
            query = f"{query} AND name = ?"
            arguments = [kind, name]
        return dict(self._read(query, arguments))

    def put(self, kind: str, values: Mapping[str, Any]) -> None:
        """Set values by name; None removes one."""
        with self.transaction() as connection:
            gone = [(kind, name) for name, value in values.items() if value is None]
            connection.executemany("DELETE FROM item WHERE kind = ? AND name = ?", gone)
            rows = [(kind, name, *_row(value)) for name, value in values.items() if value is not None]
            connection.executemany("INSERT OR REPLACE INTO item VALUES (?, ?, ?, ?)", rows)

    def append(self, kind: str, items: Iterable[Any]) -> None:
        """Append lines."""
        with self.transaction() as connection:
            rows = [(kind, *_row(item)) for item in items]
            connection.executemany("INSERT INTO line (kind, json, hash) VALUES (?, ?, ?)", rows)

    def lines(self, kind: str) -> list[Any]:
        """Return all lines of a kind, oldest first."""
        rows = self._read("SELECT number, json, hash FROM line WHERE kind = ? ORDER BY number", [kind])
        return [value for _, value in rows]

    def replace_lines(self, kind: str, changed: Callable[[Any], Any]) -> None:
        """Replace lines of a kind by what a function makes of them."""
        with self.transaction() as connection:
            for number, value in self._read("SELECT number, json, hash FROM line WHERE kind = ?", [kind]):
                after = changed(value)
                if after != value:
                    text, digest = _row(after)
                    connection.execute("UPDATE line SET json = ?, hash = ? WHERE number = ?", (text, digest, number))

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Write everything in the block, or nothing; blocks may be nested."""
        with self._lock:
            try:
                connection = self._open()
                if connection.in_transaction:
                    yield connection
                    return
                with connection:  # commits, or rolls back
                    connection.execute("BEGIN IMMEDIATE")
                    yield connection
                self.writes += 1
            except sqlite3.Error as fault:
                is_full = getattr(fault, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
                remedy = "make room on the disk" if is_full else "check the rights on the folder and the free space"
                sentence = f"{self.state}/{DATABASE} cannot be written ({fault}): {remedy}"
                raise Refusal(507 if is_full else 503, sentence) from fault

    def _read(self, query: str, arguments: list[str]) -> list[tuple[Any, Any]]:
        """Return (key, value) of rows; none if the database cannot be read, and no damaged ones, which is noted."""
        with self._lock:
            try:
                path = _state_of(self.folder.state_root, self.state) / DATABASE
                if not path.exists():  # a folder that is only looked at stays as it is
                    self.note(DATABASE, None)
                    return []
                rows = self._open().execute(query, arguments).fetchall()
            except (sqlite3.Error, LiaamError) as fault:
                self.note(DATABASE, f"{self.state}/{DATABASE} is not used: {fault}")
                return []
        whole = [(key, json.loads(text)) for key, text, digest in rows if _hash(text) == digest]
        if len(whole) < len(rows):
            n = len(rows) - len(whole)
            self.note("damaged", f"{n} of the entries of {self.state}/{DATABASE} were damaged, so they are ignored")
        return whole

    def _open(self) -> sqlite3.Connection:
        """Return the connection. It is made again if the file was removed or replaced meanwhile."""
        path = self.path(DATABASE)
        if self._connection is not None and self._opened is not None:
            with suppress(OSError):
                if self._connection.in_transaction or os.path.samestat(path.stat(), self._opened):
                    return self._connection
            self.close()
        try:
            self._connection = _connected(path)
        except sqlite3.DatabaseError as fault:
            if isinstance(fault, sqlite3.OperationalError):  # such as a full disk: the file itself may be whole
                raise
            name = f"damaged-{secrets.token_hex(4)}.db"
            for end in ("", "-journal"):  # a journal of the damaged file would spoil the new one
                with suppress(FileNotFoundError):
                    path.with_name(path.name + end).replace(path.with_name(name + end))
            damage = f"{self.state}/{DATABASE} was damaged ({fault}) and is kept as {name}: landmarks are not affected"
            self.note("damaged", f"{damage}, but the template, proposals and reviews begin anew")
            self._connection = _connected(path)
        else:
            self.note(DATABASE, None)
        self._opened = path.stat()
        return self._connection

    def close(self) -> None:
        """Close the database."""
        with self._lock:
            if self._connection is not None:
                self._connection.close()
            self._connection = None

    def path(self, name: str) -> Path:
        """Return the path of a file and create its folder."""
        path = _state_of(self.folder.state_root, self.state) / name
        if not real_path(path).is_relative_to(real_path(self.folder.state_root) / self.state):
            raise Refusal(409, f"{self.state}/{name} is a link that leads elsewhere, so it is not used: remove it")
        with disk_errors(f"{path.parent} cannot be made", "check the rights on the folder."):
            path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def set_aside(self, name: str) -> None:
        """Move a file to ``kept`` if it exists, under a name by its content."""
        path = self.path(name)
        with disk_errors(f"{path} cannot be moved"):
            if path.exists():
                path.replace(self.path(f"kept/{path.stem}.{revision_of(path.read_bytes())}{path.suffix}"))

    def note(self, key: str, fault: str | None) -> None:
        """Set or clear the message about a file."""
        with self._lock:
            if fault is None:
                self.faults.pop(key, None)
            else:
                self.faults[key] = self.folder.plain(fault)

    def prepare(self) -> None:
        """Create the folder's id and remove partial files of a killed process. Call it before any other writes."""
        with suppress(LiaamError, OSError):
            _ = self.id
            state = _state_of(self.folder.state_root, self.state)
            for folder in (self.folder.root / self.set_name, state, state / "kept"):
                sweep(folder)


class StoredTable(dict[str, Any]):
    """The values of a kind by name, in memory as well."""

    def __init__(self, store: Store, kind: str) -> None:
        super().__init__(store.all(kind))
        self._store = store
        self._kind = kind

    def of(self, picture: File) -> Any:
        """Return the value for a picture, unless the picture, by its ``tag``, was replaced since."""
        value = self.get(picture.name)
        return value if value is not None and value.get("tag") == picture.tag else None

    def save(self, values: Mapping[str, Any]) -> None:
        """Set values; None removes one."""
        self._store.put(self._kind, values)
        self.update(values)
        for name in [name for name, value in values.items() if value is None]:
            del self[name]

    def rename(self, names: Mapping[str, str]) -> None:
        """Give values new names."""
        moved = {name: new for name, new in names.items() if name in self}
        if moved:
            values = {new: self[name] for name, new in moved.items()}
            self.save({**dict.fromkeys(moved), **values})

    def forget(self) -> None:
        """Remove all values."""
        with self._store.transaction() as connection:
            connection.execute("DELETE FROM item WHERE kind = ?", (self._kind,))
        self.clear()


def _state_of(folder: Path, name: str = STATE) -> Path:
    state = folder / STATE
    if state.is_symlink() or (state.exists() and not state.is_dir()):
        raise Refusal(409, f"{STATE} is a link or a file where the studio keeps a folder: remove it")
    return folder / name


def _connected(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, timeout=5.0, isolation_level=None, check_same_thread=False)
    try:
        (state,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        if state != "ok":
            raise sqlite3.DatabaseError(state)
        connection.executescript(_SCHEMA)
        connection.execute("SELECT item.hash, line.hash FROM item, line LIMIT 1")
    except BaseException as fault:
        connection.close()
        if isinstance(fault, UnicodeDecodeError):  # of a message that repeats damaged text
            raise sqlite3.DatabaseError("its text is not UTF-8") from fault
        raise
    return connection


def _row(value: Any) -> tuple[str, str]:
    """Return a value as JSON, and its hash. Raises for NaN, which no page can parse."""
    text = json.dumps(value, allow_nan=False)
    return text, _hash(text)


def _hash(text: Any) -> str:
    """SQLite does not notice a changed byte within a value."""
    return revision_of(str(text).encode(errors="replace"))


@contextmanager
def folder_locked(folder: Folder, address: str) -> Iterator[None]:
    """Hold a lock on a folder in the block: two studios would overwrite each other's landmark files.

    The system releases it when this process ends for any reason. A second studio names the address.
    """
    try:
        path = _state_of(folder.state_root) / LOCK_FILE
    except Refusal:
        yield  # the project reports this and writes nothing there
        return
    with disk_errors(f"{path} cannot be made"):
        path.parent.mkdir(exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    try:
        try:
            lock(descriptor)  # not on a file system without locks
        except BlockingIOError as fault:
            holder = os.read(descriptor, 1000).decode(errors="replace")
            raise LiaamError(
                f"{folder.root} is open in another studio{holder}: use that one, or stop it first."
            ) from fault
        with suppress(OSError):  # only used for an error message
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f" ({address}, process {os.getpid()})".encode())
        yield
    finally:
        os.close(descriptor)
