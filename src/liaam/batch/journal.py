"""Images of a batch and their finished rows, on disk: one SQLite file in a folder beside the output.

An image is noted before it is opened, and its row is committed when it is fitted: a kill loses only the images in
progress, and an image during which a process died twice is known. The file is locked while a batch runs, and the system
releases the lock when the process ends for any reason.
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
from liaam.io.files import json_object, make_folder

PAGE = 1000  # Number of images read from the journal at a time

# Of each image: `place` is its key for sorting, `state` the size and time of its file and of its start, `seen` whether
# it is in the current list, `begun` how often work on it has started without an end, `status` and `row` the status of
# its fit and the row of the table as JSON, NULL until it is finished, and `digest` that of the row.
_TABLES = """
CREATE TABLE IF NOT EXISTS facts (text TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS pictures (
    place BLOB NOT NULL, path BLOB NOT NULL, state TEXT, seen INTEGER, begun INTEGER DEFAULT 0,
    status TEXT, row TEXT, digest BLOB,
    UNIQUE (place, path)
);
"""
# Adds an image to the list. What was stored for it is kept only if the state is the same.
_LIST = """
INSERT INTO pictures (place, path, state, seen) VALUES (?, ?, ?, 1)
ON CONFLICT (place, path) DO UPDATE SET
    seen = 1,
    begun = CASE WHEN state = excluded.state THEN begun ELSE 0 END,
    status = CASE WHEN state = excluded.state THEN status END,
    row = CASE WHEN state = excluded.state THEN row END,
    state = excluded.state
"""


def place_of(path: str) -> bytes:
    """Return a sort key of a path for case-insensitive natural order, 2 before 10."""

    def padded(number: re.Match) -> str:
        """Put the number of digits first, so that text in alphabetical order has numbers in numerical order."""
        digits = number.group().lstrip("0")
        return f"{len(digits):03d}{digits}"

    return os.fsencode(re.sub("[0-9]+", padded, path.casefold()))


class Journal:
    """Images in order, with the rows of those that are finished."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._in_progress: set[str] = set()  # paths of images that this process has begun and not finished
        self._file = folder / "journal.sqlite"
        make_folder(folder)
        with self._explained():
            self._database = sqlite3.connect(self._file, timeout=0.0, isolation_level=None)
            try:
                # Exclusive mode before the first access avoids shared memory, which network disks lack.
                for pragma in ("locking_mode = EXCLUSIVE", "journal_mode = WAL", "synchronous = NORMAL"):
                    self._database.execute(f"PRAGMA {pragma}").fetchall()
                self._database.executescript(f"BEGIN EXCLUSIVE; {_TABLES} COMMIT;")
            except BaseException:
                self._database.close()
                raise

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        if self._in_progress:  # stopped, not killed
            with contextlib.suppress(LiaamError), self._change():
                self._count_begun(self._in_progress, -1)
        self._database.close()

    @property
    def facts(self) -> dict[str, Any] | None:
        """Settings of the rows; None in a new journal."""
        entries = self._ask("SELECT text FROM facts")
        if not entries:
            return None
        facts = json_object(entries[0][0])
        if facts is None:
            raise self.damage("its settings cannot be read")
        return facts

    def check(self) -> None:
        """Raise if the file is damaged, or a row has changed since it was committed."""
        [(verdict,)] = self._ask("PRAGMA integrity_check(1)")
        if verdict != "ok":
            raise self.damage(verdict)
        for path, status, row, digest in self._pages("path, status, row, digest", "row IS NOT NULL"):
            if _digest(path, status, row) != digest:
                raise self.damage("a row has changed")

    def restart(self, facts: dict[str, Any]) -> None:
        """Delete all rows and store the settings of new ones."""
        with self._change():
            self._database.execute("DELETE FROM pictures")
            self._database.execute("DELETE FROM facts")
            self._database.execute("INSERT INTO facts VALUES (?)", (json.dumps(facts),))

    def list(self, paths: Iterable[str], start_of: Callable[[str], Path | None]) -> None:
        """Store the list of images without duplicates. Keep the rows of images whose files have not changed.

        ``start_of`` returns the file with the start of an image, or None.
        """
        with self._change():
            self._database.execute("UPDATE pictures SET seen = 0")
            self._database.executemany(_LIST, map(partial(_entry, start_of), paths))
            self._database.execute("DELETE FROM pictures WHERE NOT seen")

    @property
    def total(self) -> int:
        """Number of images."""
        return self._ask("SELECT count(*) FROM pictures")[0][0]

    @property
    def statuses(self) -> dict[str, int]:
        """Number of rows by status."""
        counts = dict(
            self._ask("SELECT status, count(*) FROM pictures WHERE row IS NOT NULL GROUP BY status ORDER BY status")
        )
        if not all(isinstance(status, str) for status in counts):
            raise self.damage("a row has no status")
        return counts

    def todo(self) -> Iterator[str]:
        """Iterate over images that have no row and were not in progress when a process died, in order."""
        return (os.fsdecode(path) for (path,) in self._pages("path", "row IS NULL AND begun = 0"))

    def suspects(self) -> dict[str, int]:
        """Images without a row, and how often a process died while they were in progress."""
        entries = self._pages("path, begun", "row IS NULL AND begun > 0")
        deaths = {os.fsdecode(path): number for path, number in entries}
        if not all(isinstance(number, int) for number in deaths.values()):
            raise self.damage("a number is none")
        return deaths

    def begin(self, path: str) -> str:
        """Note on disk that an image is now in progress, and return its path."""
        with self._change():
            self._count_begun([path], 1)
        self._in_progress.add(path)
        return path

    def keep(self, path: str, row: tuple[str, str]) -> None:
        """Commit (status, row as JSON text) of an image to disk."""
        status, text = row
        name = os.fsencode(path)
        with self._change():
            self._database.execute(
                "UPDATE pictures SET status = ?, row = ?, digest = ? WHERE place = ? AND path = ?",
                (status, text, _digest(name, status, text), place_of(path), name),
            )
        self._in_progress.discard(path)

    def _count_begun(self, paths: Iterable[str], change: int) -> None:
        """Change how often work on images has started without an end; inside a transaction."""
        entries = [(change, place_of(path), os.fsencode(path)) for path in paths]
        self._database.executemany("UPDATE pictures SET begun = begun + ? WHERE place = ? AND path = ?", entries)

    def rows(self) -> Iterator[str]:
        """Iterate over all rows in the order of the images."""
        for (row,) in self._pages("row", "row IS NOT NULL"):
            if not isinstance(row, str):
                raise self.damage("a row is not text")
            yield row

    def digest(self) -> str:
        """Return a digest of the images and their starts, by path, size and modification time."""
        digest = hashlib.sha256()
        for entry in self._pages("path, state", "TRUE"):
            digest.update(repr(entry).encode())
        return digest.hexdigest()

    def remove(self) -> None:
        """Delete the journal."""
        self._database.close()
        for path in self.folder.glob("journal.sqlite*"):
            path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # the folder holds other files
            self.folder.rmdir()

    def _pages(self, columns: str, which: str) -> Iterator[tuple]:
        """Iterate over the columns of the images for which an SQL condition holds, in order.

        They are read page by page, because there may be many and their rows change meanwhile.
        """
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
                raise self.damage("an image has no name")
            last = page[-1][:2]
            yield from (entry[2:] for entry in page)

    def damage(self, what: object) -> LiaamError:
        """Return the error of a damaged journal."""
        return LiaamError(
            f"{self._file} is damaged or from another version ({what}): remove {self.folder} and start again"
        )

    def _ask(self, question: str, values: tuple = ()) -> Sequence[tuple]:
        """Return all rows of the answer to a query in SQL, with values for its question marks."""
        with self._explained():  # fetching may fail on damaged rows
            return self._database.execute(question, values).fetchall()

    @contextmanager
    def _change(self) -> Iterator[None]:
        """Run the block as one transaction."""
        with self._explained():
            self._database.execute("BEGIN")
            try:
                yield
            except BaseException:
                self._database.execute("ROLLBACK")
                raise
            self._database.execute("COMMIT")

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Raise the errors of SQLite as errors that say what to do."""
        try:
            yield
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter if a message quotes damaged bytes
            if "locked" in str(error):
                raise LiaamError(
                    f"{self.folder} is in use by another batch with the same output; wait for it, or give another name "
                    "with -o"
                ) from None
            raise LiaamError(
                f"{self._file} cannot be read or written ({error}): check the permissions and the free space; if it "
                f"is damaged, remove {self.folder} and start again"
            ) from error


def _digest(path: bytes, status: Any, row: Any) -> bytes:
    """Digest of a row. SQLite does not notice if a byte of it changes."""
    return hashlib.blake2b(repr((path, status, row)).encode("utf-8", "replace"), digest_size=8).digest()


def _entry(start_of: Callable[[str], Path | None], path: str) -> tuple[bytes, bytes, str]:
    """Return the values of :data:`_LIST` for an image. One path in several spellings is one image."""
    # Without repeated slashes and a first "./". normpath would resolve .. after a link wrongly.
    path = re.sub("(?<=.)//+", "/", path)
    path = re.sub(r"^(\./)+(?=.)", "", path)
    state = json.dumps([_state(Path(path)), _state(start_of(path))])
    return place_of(path), os.fsencode(path), state


def _state(path: Path | None) -> tuple[int, int] | None:
    """Return size and modification time of a file.

    None if there is none, or if it cannot be accessed, which the row of its image will report.
    """
    if path is None:
        return None
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_size, status.st_mtime_ns
