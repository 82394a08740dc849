"""Read the table of a spreadsheet (``.xlsx``) as the text of a ``.csv`` file.

Only values are read: formulas are not computed, and nothing is fetched that a spreadsheet refers to.
"""

import csv
import io
import re
import zlib
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree
from zipfile import BadZipFile, ZipFile

from liaam.errors import LandmarkError
from liaam.io.landmarks.reading import Notes, decimal
from liaam.io.landmarks.unpacking import member_of

_MOST_BYTES = 20_000_000  # of a part of the file
_MOST_COLUMNS = 5000
_MOST_CELLS = 5_000_000
_MAIN = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_STRICT = "{http://purl.oclc.org/ooxml/spreadsheetml/main}"
_RELATION = re.compile(r"\{[^}]*/relationships\}id")


def csv_of_sheet(data: bytes, name: str, notes: Notes) -> str:
    """Return the first sheet that has cells as the text of a ``.csv`` file; notes call the file by its name."""
    try:
        with ZipFile(io.BytesIO(data)) as archive:
            sheets = _sheets_of(archive)
            strings = _strings_of(archive)
            for title, part in sheets:
                rows = list(_rows_of(member_of(archive, part, _MOST_BYTES), strings))
                if rows:
                    if len(sheets) > 1:
                        notes.say(f"of {len(sheets)} sheets '{title}' is read", name)
                    return _text_of(rows)
    except (BadZipFile, KeyError, NotImplementedError, RuntimeError, zlib.error) as fault:
        raise LandmarkError(f"it is no sound .xlsx ({fault}): save it again, or save it as CSV.") from fault
    raise LandmarkError("its sheets are empty: save the one with the landmarks as CSV.")


def _text_of(rows: list[list[str]]) -> str:
    buffer = io.StringIO(newline="")
    csv.writer(buffer).writerows(rows)
    return buffer.getvalue()


def _xml_of(data: bytes) -> Any:
    """Parse a part; what could define entities is refused."""
    if b"\0" in data or b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise LandmarkError("a part of it declares entities or is no text, which is not safe to read: save it as CSV.")
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as fault:
        raise LandmarkError(f"a part of it is damaged ({fault}): save it again, or save it as CSV.") from fault


def _name(element: Any) -> str:
    """Return the name of an element without the vocabulary that it is from."""
    return element.tag.removeprefix(_MAIN).removeprefix(_STRICT)


def _sheets_of(archive: ZipFile) -> list[tuple[str, str]]:
    """Return the titles and the parts of the sheets that are not hidden, in order."""
    book = _xml_of(member_of(archive, "xl/workbook.xml", _MOST_BYTES))
    links = _xml_of(member_of(archive, "xl/_rels/workbook.xml.rels", _MOST_BYTES))
    parts = {link.get("Id"): link.get("Target", "") for link in links}
    sheets = []
    for sheet in book.iter():
        if _name(sheet) != "sheet" or sheet.get("state", "visible") != "visible":
            continue
        key = next((value for attribute, value in sheet.items() if _RELATION.fullmatch(attribute)), None)
        target = parts.get(key, "")
        sheets.append((sheet.get("name", ""), target.lstrip("/") if target.startswith("/") else f"xl/{target}"))
    return sheets


def _strings_of(archive: ZipFile) -> list[str]:
    """Return the texts that cells refer to by number."""
    if "xl/sharedStrings.xml" not in archive.namelist():
        return []
    root = _xml_of(member_of(archive, "xl/sharedStrings.xml", _MOST_BYTES))
    return [_text_in(item) for item in root]


def _text_in(element: Any) -> str:
    """Return the text of an element, perhaps of several parts, without hints of how it is spoken."""
    texts = []
    for child in element:
        if _name(child) == "t":
            texts.append(child.text or "")
        elif _name(child) == "r":
            texts.append(_text_in(child))
    return "".join(texts)


def _rows_of(data: bytes, strings: list[str]) -> Iterator[list[str]]:
    """Yield the rows that have cells, filled up to their last cell."""
    n_cells = 0
    for row in _xml_of(data).iter():
        if _name(row) != "row":
            continue
        cells: list[str] = []
        for cell in row:
            column = _column_of(cell.get("r", ""), len(cells))
            if column >= _MOST_COLUMNS:
                raise LandmarkError(f"it has more than {_MOST_COLUMNS:,} columns: save the landmarks as CSV.")
            cells += [""] * (column + 1 - len(cells))
            cells[column] = _value_of(cell, strings)
        n_cells += len(cells)
        if n_cells > _MOST_CELLS:
            raise LandmarkError(f"it has more than {_MOST_CELLS:,} cells: save the landmarks as CSV.")
        if any(cells):
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
