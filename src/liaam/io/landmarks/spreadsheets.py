"""Read the table of a spreadsheet (``.xlsx``) as the text of a ``.csv`` file.

Only values are read: formulas are not computed, and nothing is fetched that a spreadsheet refers to.
"""

import csv
import io
import re
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

from liaam.errors import LandmarkError
from liaam.io.landmarks.reading import Notes, decimal, short
from liaam.io.landmarks.unpacking import Archive

_MOST_BYTES = 20_000_000  # of a part of the file
_MOST_COLUMNS = 5000
_MOST_CELLS = 1_000_000
_MOST_MARKS = 1_700_000
"""Marks of what is read, weighed by the time that they take, so that any file is read or refused in two seconds.

Excel's cells have eight or so. More than 200,000 cells are quicker to read as CSV."""
_WEIGHTS = ((b"<", 1), (b"=", 2), (b"<row", 8))  # of elements, of attributes, and of rows besides
_LONGEST = 32_767  # letters of a cell, as in Excel
_MOST_LETTERS = 20_000_000  # of all cells: each may refer to one long text
_LOCKED = b"\xd0\xcf\x11\xe0"  # what files with a password begin with, and those of .xls
_MAIN = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_STRICT = "{http://purl.oclc.org/ooxml/spreadsheetml/main}"
_RELATION = re.compile(r"\{[^}]*/relationships\}id")
_BOOK = "xl/workbook.xml"
_LINKS = "xl/_rels/workbook.xml.rels"
_STRINGS = "xl/sharedStrings.xml"


def csv_of_sheet(data: bytes, name: str, notes: Notes) -> str:
    """Return the first sheet that has cells as the text of a ``.csv`` file; notes call the file by its name."""
    if data.startswith(_LOCKED):
        raise LandmarkError("it has a password, or is an older .xls: save it as .xlsx without one, or as CSV.")
    book = _Workbook(data)
    sheets = _sheets_of(book)
    strings = _strings_of(book)
    for title, part in sheets:
        rows = list(_rows_of(book.xml(part), strings))
        if rows:
            if len(sheets) > 1:
                notes.say(f"of {len(sheets)} sheets '{title}' is read", name)
            return _text_of(rows)
    raise LandmarkError("its sheets are empty: save the one with the landmarks as CSV.")


class _Workbook:
    """The parts of a spreadsheet, of which only so many elements are read."""

    def __init__(self, data: bytes) -> None:
        self._archive = Archive(data, ".xlsx", "save it again, or save it as CSV")
        self._marks_left = _MOST_MARKS

    def has(self, name: str) -> bool:
        """Return whether there is a part of a name."""
        return self._archive.part(name) is not None

    def xml(self, name: str) -> Any:
        """Parse a part; what could define entities is refused."""
        part = self._archive.part(name)
        if part is None:
            raise self._archive.damage(f"it lacks '{short(name)}'")
        data = self._archive.read(part, _MOST_BYTES)
        if b"\0" in data or b"<!DOCTYPE" in data or b"<!ENTITY" in data:
            fault = "a part of it declares entities or is no text, which is not safe to read"
            raise LandmarkError(f"{fault}: save it as CSV.")
        self._marks_left -= sum(weight * data.count(mark) for mark, weight in _WEIGHTS)
        if self._marks_left < 0:
            raise LandmarkError("it has more cells, or other parts, than are read: save the landmarks as CSV.")
        try:
            return ElementTree.fromstring(data)
        except (ElementTree.ParseError, ValueError, LookupError) as fault:
            raise LandmarkError(f"a part of it is damaged ({fault}): save it again, or save it as CSV.") from fault


def _text_of(rows: list[list[str]]) -> str:
    buffer = io.StringIO(newline="")
    csv.writer(buffer).writerows(rows)
    return buffer.getvalue()


def _name(element: Any) -> str:
    """Return the name of an element without the vocabulary that it is from."""
    return element.tag.removeprefix(_MAIN).removeprefix(_STRICT)


def _sheets_of(book: _Workbook) -> list[tuple[str, str]]:
    """Return the titles and the parts of the sheets that are not hidden, in order."""
    listed = book.xml(_BOOK)
    parts = {link.get("Id"): link.get("Target", "") for link in book.xml(_LINKS)}
    sheets = []
    for sheet in listed.iter():
        if _name(sheet) != "sheet" or sheet.get("state", "visible") != "visible":
            continue
        key = next((value for attribute, value in sheet.items() if _RELATION.fullmatch(attribute)), None)
        target = parts.get(key, "")
        sheets.append((sheet.get("name", ""), target.lstrip("/") if target.startswith("/") else f"xl/{target}"))
    return sheets


def _strings_of(book: _Workbook) -> list[str]:
    """Return the texts that cells refer to by number."""
    return [_text_in(item) for item in book.xml(_STRINGS)] if book.has(_STRINGS) else []


def _text_in(element: Any) -> str:
    """Return the text of an element, perhaps in several formats, without hints of how it is spoken."""
    texts = []
    for child in element:
        runs = child if _name(child) == "r" else [child]
        texts += [run.text or "" for run in runs if _name(run) == "t"]
    text = "".join(texts)
    if len(text) > _LONGEST:
        raise LandmarkError(f"the cell '{short(text)}' has {len(text):,} letters, more than {_LONGEST:,}: shorten it.")
    return text


def _rows_of(sheet: Any, strings: list[str]) -> Iterator[list[str]]:
    """Yield the rows that have cells, filled up to their last cell, and to that of the first."""
    n_cells = 0
    n_letters = 0
    width = 0
    vocabulary, brace, _ = sheet.tag.rpartition("}")
    for row in sheet.iter(f"{vocabulary}{brace}row"):
        if len(row) == 0:
            continue
        cells: list[str] = []
        for cell in row:
            column = _column_of(cell.get("r", ""), len(cells))
            if column >= _MOST_COLUMNS:
                raise LandmarkError(f"it has more than {_MOST_COLUMNS:,} columns: save the landmarks as CSV.")
            cells += [""] * (column + 1 - len(cells))
            cells[column] = _value_of(cell, strings)
        cells += [""] * (width - len(cells))
        n_cells += len(cells)
        n_letters += sum(map(len, cells))
        if n_cells > _MOST_CELLS or n_letters > _MOST_LETTERS:
            most = f"{_MOST_CELLS:,} cells, or {_MOST_LETTERS:,} letters in them"
            raise LandmarkError(f"it has more than {most}: save the landmarks as CSV.")
        if any(cells):
            width = width or len(cells)
            yield cells


def _column_of(reference: str, following: int) -> int:
    """Return the index of the column of a cell such as ``AB12``; cells without a reference follow each other."""
    letters = re.match(r"[A-Z]{1,3}", reference)
    if letters is None:
        return following
    column = 0
    for letter in letters[0]:
        column = 26 * column + ord(letter) - ord("A") + 1
    return column - 1


def _value_of(cell: Any, strings: list[str]) -> str:
    kind = cell.get("t", "n")
    if kind == "inlineStr":
        return decimal(next((_text_in(child) for child in cell if _name(child) == "is"), ""))
    value = next((child.text or "" for child in cell if _name(child) == "v"), "")
    if kind != "s":
        return value
    if not (value.isascii() and value.isdigit() and len(value) < 9 and int(value) < len(strings)):
        raise LandmarkError("a cell refers to a text that is not there: save it again, or save it as CSV.")
    return decimal(strings[int(value)])
