"""Tables as text: the separator, decimal commas, and the meaning of columns."""

import csv
import io
import re
from collections.abc import Sequence
from functools import lru_cache

from liaam.errors import LandmarkError
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.text import decimal

Row = tuple[int, list[str]]
"""A line number, and the cells of the line."""

_SEPARATORS = ";\t,"
_SUMMARY = {"Mean", "SD", "Min", "Max"}
"""Labels of rows that ImageJ adds below its results."""


def rows_of(source: Source) -> list[Row]:
    """Split a table into rows of cells, without blank rows. Decimal commas become points if commas do not separate."""
    return _rows_of(source.text)


@lru_cache(maxsize=1)
def _rows_of(text: str) -> list[Row]:
    text, separator = re.sub(r"\A(?:[^\S\r\n]*[\r\n])+", "", text), ""
    declared = re.match(r"\"?sep=(.)\"?[^\S\n\r]*[\r\n]+", text, re.IGNORECASE)
    if declared is not None:  # as Excel writes it
        separator, text = declared[1], text[declared.end() :]
    first = text.splitlines()[0] if text else ""
    most = max(_SEPARATORS, key=first.count)
    separator = separator or (most if most in first else " ")
    try:
        if separator == " ":
            rows = [(number, line.split()) for number, line in enumerate(text.splitlines(), 1)]
        else:
            blanks = all(cell[:1] == " " for cell in first.split(separator)[1:])  # they are no part of cells
            reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=blanks)
            rows = [(reader.line_num, row) for row in reader]
    except csv.Error as fault:
        raise LandmarkError(f"this is not a CSV table ({fault}): export it again.") from fault
    rows = rows or [(1, [""])]
    if "Label" in rows[0][1]:
        rows = [(number, row) for number, row in rows if not _SUMMARY & {*row} or number == rows[0][0]]
    if separator != ",":
        rows = [(number, [decimal(cell) for cell in row]) for number, row in rows]
    if len(rows) > 1 and len(rows[0][1]) == 1 and rows[0][1][0].strip().isdigit():  # the number of rows
        rows = rows[1:]
    if len(rows) > 1 and all(len(row) == len(rows[0][1]) + 1 for _, row in rows[1:] if row):  # R names rows only
        rows = [(rows[0][0], ["", *rows[0][1]]), *rows[1:]]
    return rows


def header_of(source: Source) -> list[str]:
    """Return the first row in lower case, without units in brackets and marks between words, or nothing."""
    rows = rows_of(source)
    return [plain(cell) for cell in rows[0][1]] if rows else []


def plain(cell: str) -> str:
    """Return a column's name in lower case, without a unit in brackets, with words joined by underscores."""
    return re.sub(r"[\s_.-]+", "_", re.sub(r"[(\[].*[)\]]", "", cell).strip().casefold()).strip("_")


def check_widths(header: Sequence[str], rows: Sequence[Row]) -> None:
    """Raise unless all rows have as many cells as the header."""
    for number, row in rows:
        if len(row) != len(header):
            raise LandmarkError(f"line {number} has {len(row)} cells but the header {len(header)}: correct the line.")


def filled(values: Sequence[str]) -> list[str]:
    """Fill empty cells with those above them, as merged cells are exported."""
    last, made = "", []
    for value in values:
        last = value or last
        made.append(last)
    return made


def without_gaps(source: Source, rows: list[Row], column: int) -> list[Row]:
    """Name the image or specimen in rows that lack it, as exports of merged cells do."""
    names = filled([row[column] for _, row in rows])
    for name, (_, row) in zip(names, rows, strict=True):
        if name and not row[column]:
            source.notes.say("rows without a name of the image or specimen belong to the one above", name)
    return [(n, [*row[:column], name, *row[column + 1 :]]) for name, (n, row) in zip(names, rows, strict=True)]


def is_imagej(source: Source) -> bool:
    """Whether ImageJ wrote the table: the first column has a blank as its name, or one of two is "Label"."""
    header = rows_of(source)[0][1]
    return {"X", "Y"} <= {*header} and (source.text[:2] in (" ,", " \t") or "Label" in header[:2])
