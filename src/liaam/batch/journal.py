"""What is to be done and what is done, on disk: one SQLite file in a folder beside the output.

Rows are committed chunk by chunk, so that a kill at any point loses no more than the chunks under way. The file stays
locked while a batch works on it, and the system takes the lock off when the process ends, however it ends.
"""

import contextlib
import hashlib
import json
import os
import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from liaam.errors import LiaamError

PAGE = 1000
"""Pictures that are read from the journal at a time."""

_TABLES = """
CREATE TABLE IF NOT EXISTS facts (text TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS pictures (
    place BLOB NOT NULL, path BLOB NOT NULL, state TEXT, seen INTEGER, status TEXT, row TEXT, digest BLOB,
    UNIQUE (place, path)
);
"""
_LIST = """
INSERT INTO pictures (place, path, state, seen) VALUES (?, ?, ?, 1)
ON CONFLICT (place, path) DO UPDATE SET
    seen = 1,
    status = CASE WHEN state = excluded.state THEN status END,
    row = CASE WHEN state = excluded.state THEN row END,
    state = excluded.state
"""


def place_of(path: str) -> bytes:
    """Sort key of a path: in natural order, 2 before 10, whatever the case of the letters.

    Examples
    --------
    >>> sorted(["img10.png", "img2.png"], key=place_of)
    ['img2.png', 'img10.png']
    """

    def padded(found: re.Match) -> str:
        digits = found.group().lstrip("0")
        return f"{len(digits):03d}{digits}"

    return os.fsencode(re.sub("[0-9]+", padded, path.casefold()))


class Journal:
    """Pictures in their order, and the rows of those that are done.

    Attributes
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._file = folder / "journal.sqlite"
        if folder.exists() and not folder.is_dir():
            raise LiaamError(
                f"{folder} is no folder, and what is done is kept in one of this name; move the file away, or give "
                "another name with -o"
            )
        with self._explained():
            folder.mkdir(exist_ok=True)
            self._base = sqlite3.connect(self._file, timeout=0.0, isolation_level=None)
            try:
                # Exclusive before the first access: then no shared memory is needed, which network disks lack.
                for pragma in ("locking_mode = EXCLUSIVE", "journal_mode = WAL", "synchronous = NORMAL"):
                    self._base.execute(f"PRAGMA {pragma}").fetchall()
                self._base.executescript(f"BEGIN EXCLUSIVE; {_TABLES} COMMIT;")
            except BaseException:
                self._base.close()
                raise

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self._base.close()

    @property
    def facts(self) -> dict[str, Any] | None:
        """Settings that the rows were made with; None in a journal that is new."""
        found = self._ask("SELECT text FROM facts")
        if not found:
            return None
        try:
            facts = json.loads(found[0][0])
        except (ValueError, TypeError, RecursionError):
            facts = None
        if not isinstance(facts, dict):
            raise self.damage("its settings cannot be read")
        return facts

    def check(self) -> None:
        """Check that all rows are as they were kept.

        Raises
        ------
        LiaamError
            If a byte of them, or how they are found, has changed.
        """
        (found,) = self._ask("PRAGMA integrity_check(1)")
        if found != ("ok",):
            raise self.damage(found[0])
        for path, *row, digest in self._pages("path, status, row, digest", "row IS NOT NULL"):
            if _digest(path, *row) != digest:
                raise self.damage("a row has changed")

    def restart(self, facts: dict[str, Any]) -> None:
        """Forget all rows, and note the settings of those to come."""
        with self._change():
            self._base.execute("DELETE FROM pictures")
            self._base.execute("DELETE FROM facts")
            self._base.execute("INSERT INTO facts VALUES (?)", (json.dumps(facts),))

    def list(self, pictures: Iterable[str], start_of: Callable[[str], Path | None]) -> None:
        """Note which pictures there are, each once; rows stay of those whose files are the same still.

        Parameters
        ----------
        pictures : iterable of str
        start_of : callable
            Gives the file that the start of a picture is read from, if there is one.
        """
        with self._change():
            self._base.execute("UPDATE pictures SET seen = 0")
            self._base.executemany(_LIST, map(partial(_entry, start_of), pictures))
            self._base.execute("DELETE FROM pictures WHERE NOT seen")

    @property
    def total(self) -> int:
        """Number of pictures."""
        return self._ask("SELECT count(*) FROM pictures")[0][0]

    @property
    def statuses(self) -> dict[str, int]:
        """Number of rows by status."""
        found = dict(
            self._ask("SELECT status, count(*) FROM pictures WHERE row IS NOT NULL GROUP BY status ORDER BY status")
        )
        if not all(isinstance(status, str) for status in found):
            raise self.damage("a row has no status")
        return found

    def todo(self, size: int) -> Iterator[tuple[str, ...]]:
        """Pictures without a row, in chunks, in their order."""
        chunk: list[str] = []
        for (path,) in self._pages("path", "row IS NULL"):
            chunk.append(os.fsdecode(path))
            if len(chunk) == size:
                yield tuple(chunk)
                chunk = []
        if chunk:
            yield tuple(chunk)

    def keep(self, chunk: Iterable[str], rows: Iterable[tuple[str, str]]) -> None:
        """Keep (status, row) of each picture of a chunk; they are on disk when this returns."""
        names = [(path, os.fsencode(path)) for path in chunk]
        entries = [
            (*row, _digest(name, *row), place_of(path), name) for (path, name), row in zip(names, rows, strict=True)
        ]
        with self._change():
            self._base.executemany(
                "UPDATE pictures SET status = ?, row = ?, digest = ? WHERE place = ? AND path = ?", entries
            )

    def rows(self) -> Iterator[str]:
        """All rows, in the order of the pictures."""
        for (row,) in self._pages("row", "row IS NOT NULL"):
            if not isinstance(row, str):
                raise self.damage("a row is no text")
            yield row

    def digest(self) -> str:
        """Digest of which pictures there are, of what size and age, and their starts."""
        digest = hashlib.sha256()
        for entry in self._pages("path, state", "TRUE"):
            digest.update(repr(entry).encode())
        return digest.hexdigest()

    def remove(self) -> None:
        """Forget everything: the table is written."""
        self._base.close()
        for path in self.folder.glob("journal.sqlite*"):
            path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # somebody has put something there
            self.folder.rmdir()

    def _pages(self, columns: str, which: str) -> Iterator[tuple]:
        """Read pictures page by page: rows are changed meanwhile, and there may be any number."""
        last = (b"", b"")
        while True:
            page = self._ask(
                f"SELECT place, path, {columns} FROM pictures WHERE (place, path) > (?, ?) AND {which} "
                f"ORDER BY place, path LIMIT {PAGE}",
                last,
            )
            if not page:
                return
            if not all(isinstance(key, bytes) for entry in page for key in entry[:2]):
                raise self.damage("a picture has no name")
            last = page[-1][:2]
            yield from (entry[2:] for entry in page)

    def damage(self, what: object) -> LiaamError:
        """Say that the journal is damaged, and how to go on."""
        return LiaamError(
            f"{self._file} is damaged, or of another version ({what}): remove {self.folder} and begin anew"
        )

    def _ask(self, question: str, values: tuple = ()) -> Sequence[tuple]:
        with self._explained():  # rows may turn out to be damaged when they are fetched
            return self._base.execute(question, values).fetchall()

    @contextmanager
    def _change(self) -> Iterator[None]:
        """All of a change or nothing."""
        with self._explained():
            self._base.execute("BEGIN")
            try:
                yield
            except BaseException:
                self._base.execute("ROLLBACK")
                raise
            self._base.execute("COMMIT")

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise LiaamError(
                f"{self.folder} cannot be written ({error.strerror or error}): check the rights and the free space"
            ) from error
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter of a message that repeats damaged bytes
            if "locked" in str(error):
                raise LiaamError(
                    f"{self.folder} is in use: another batch works on the same output; wait for it, or give another "
                    "name with -o"
                ) from None
            raise LiaamError(
                f"{self._file} cannot be read or written ({error}): check the rights and the free space; if it is "
                f"damaged, remove {self.folder} and begin anew"
            ) from error


def _digest(path: bytes, status: Any, row: Any) -> bytes:
    """What tells a row from all others; SQLite does not notice if a byte of it changes."""
    return hashlib.blake2b(repr((path, status, row)).encode("utf-8", "replace"), digest_size=8).digest()


def _entry(start_of: Callable[[str], Path | None], path: str) -> tuple[bytes, bytes, str]:
    path = re.sub(r"^(\./)+(?=.)", "", re.sub("(?<=.)//+", "/", path))  # normpath would take a link's .. for another
    return place_of(path), os.fsencode(path), json.dumps([_state(Path(path)), _state(start_of(path))])


def _state(path: Path | None) -> tuple[int, int] | None:
    """Size and age of a file; None if it is not there, or hidden from us: its row will say why."""
    try:
        found = None if path is None else path.stat()
    except (OSError, ValueError):
        return None
    return None if found is None else (found.st_size, found.st_mtime_ns)
