"""Read tables with named columns, as people and spreadsheets save them."""

from collections.abc import Container, Iterable, Sequence
from pathlib import Path

from liaam.errors import LandmarkError, LiaamError
from liaam.io.files import AnyPath, existing_file
from liaam.io.landmarks.reading import TableLine, read_text, table_rows
from liaam.io.landmarks.tables import IMAGES, INDIVIDUALS, SPECIMENS

NamedRow = tuple[int, dict[str, str]]
"""The number of a line, and its cells by the names of their columns."""


def read_named_rows(path: AnyPath, kind: str) -> list[NamedRow]:
    """Read a table of text; ``kind`` says what it should be.

    A byte order mark, any usual separator and decimal commas are understood, as in landmark files
    (:func:`liaam.io.landmarks.reading.table_rows`).

    Raises
    ------
    LiaamError
        If the file is missing or no table.
    """
    path = existing_file(path, LiaamError, kind)
    return named_rows_in(read_text(path), path)


def named_rows_in(text: str, path: str | Path) -> list[NamedRow]:
    """Parse the text of a table, as :func:`read_named_rows`; ``path`` names it in messages."""
    try:
        return named_rows(table_rows(text))
    except LandmarkError as fault:
        raise LiaamError(f"{path}: {fault}") from fault


def naming_column(columns: Iterable[str], specimens_first: bool = False) -> str | None:
    """Return the column that names the image or the specimen of each row; None if there is none.

    All tables of specimens have it alike: it may be written with capitals, ``image`` and ``specimen`` come before other
    words, and images before specimens, unless ``specimens_first``.
    """
    by_name = {column.lower(): column for column in columns}
    kinds = (("image", IMAGES), ("specimen", SPECIMENS - INDIVIDUALS))
    for usual, names in reversed(kinds) if specimens_first else kinds:
        found = next((name for name in (usual, *by_name) if name in names and name in by_name), None)
        if found is not None:
            return by_name[found]
    return None


NAMING = "image (or photo, file, specimen)"
"""What messages call the column that names the image or specimen."""


def refuse_again(name: str, known: Container[str], path: AnyPath, number: int, kind: str = "image") -> None:
    """Raise if a line of a table names something that a line before it has named."""
    if name in known:
        raise LiaamError(f"{path}: line {number} has '{name[:60]}' again: keep one line for each {kind}")


def named_rows(lines: Sequence[TableLine]) -> list[NamedRow]:
    """Return the rows below a header that are not blank. Cells that lack at the end of a row are empty.

    Raises
    ------
    LandmarkError
        If a row has more cells than the header.
    """
    (_, header), *rows = lines
    titles = [title.strip() for title in header]
    named = []
    for number, row in rows:
        if any(row[len(titles) :]):
            raise LandmarkError(f"line {number} has {len(row)} cells but the header {len(titles)}: correct the line.")
        if any(row):
            cells = [*row, *[""] * (len(titles) - len(row))]
            named.append((number, dict(zip(titles, cells, strict=False))))
    return named
