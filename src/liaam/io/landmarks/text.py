"""Decode the text of landmark files, and parse counts and coordinates."""

import csv
import io
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import is_number, read_bytes

MAX_BYTES = 500_000_000  # of a landmark file

Row = tuple[int, list[str]]  # a line number, and the cells of the line

_SUMMARY = {"Mean", "SD", "Min", "Max"}  # labels of rows that ImageJ adds below its results
_SEPARATED = re.compile(r"\s*([^\s,;]+)\s*[,;]\s*([^\s,;]+)\s*")  # x and y with a comma or semicolon between them
_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0e-\x1f]")  # characters that binary files hold and text does not
_MARKED = re.compile(r"[-+]?\d+[.,]\d+")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}[.,]\d{3}")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
_ABSENT = (-1.0, -999.0, -9999.0)  # what programs write for x and y of a missing landmark
_MISSING_WORDS = frozenset({"", "nan", "na", "n/a", "#n/a", "none", "null", "missing", "?", "-", "."})


def read_text(path: Path, data: bytes | None = None) -> str:
    """Read a text file, or decode its content, as UTF-8, UTF-16, or Latin-1. Raise if it is binary."""
    data = read_bytes(path, LandmarkError, MAX_BYTES) if data is None else data
    binary = LandmarkError(f"{path} is not a text file, so not a landmark file: export the landmarks again.")
    encoding = "utf-16" if data.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"
    if len(data) > 3 and encoding == "utf-8-sig" and not any(data[1:200:2]) and all(data[:200:2]):
        encoding = "utf-16-le"  # without a byte order mark
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as fault:
        if encoding.startswith("utf-16") or _CONTROL.search(data):
            raise binary from fault
        text = data.decode("latin-1")
    if "\0" in text:
        raise binary
    if not text.strip():
        raise LandmarkError(f"{path} is empty (only blank lines): copy or export it again.")
    return text


def rows_of(text: str) -> list[Row]:
    """Split a table into rows of cells, without blank rows. Decimal commas become points if commas do not separate."""
    text, separator = re.sub(r"\A(?:[^\S\r\n]*[\r\n])+", "", text), ""
    declared = re.match(r"\"?sep=(.)\"?[^\S\n\r]*[\r\n]+", text, re.IGNORECASE)
    if declared is not None:  # as Excel writes it
        separator, text = declared[1], text[declared.end() :]
    first = text.splitlines()[0] if text else ""
    most = max(";\t,|", key=first.count)
    separator = separator or (most if most in first else " ")
    if separator == " ":
        text = "\n".join(" ".join(line.split()) for line in text.splitlines())
    blanks = all(cell[:1] == " " for cell in first.split(separator)[1:])  # they are no part of cells
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=blanks)
        rows = [(reader.line_num, row) for row in reader]
    except csv.Error as fault:
        raise LandmarkError(f"this is not a CSV table ({fault}): export it again.") from fault
    rows = rows or [(1, [""])]
    if "Label" in rows[0][1]:
        rows = [(number, row) for number, row in rows if not _SUMMARY & {*row} or number == rows[0][0]]
    if separator != ",":
        _check_marks(cell.strip() for _, row in rows for cell in row)
        rows = [(number, [decimal(cell) for cell in row]) for number, row in rows]
    if len(rows) > 1 and len(rows[0][1]) == 1 and rows[0][1][0].strip().isdigit():  # the number of rows
        rows = rows[1:]
    if len(rows) > 1 and all(len(row) == len(rows[0][1]) + 1 for _, row in rows[1:] if row):  # R names rows only
        rows = [(rows[0][0], ["", *rows[0][1]]), *rows[1:]]
    return rows


def _check_marks(cells: Iterable[str]) -> None:
    """Raise if numbers have decimal commas as well as points, and some of these may separate thousands."""
    marked = [cell for cell in cells if _MARKED.fullmatch(cell)]
    with_comma = [cell for cell in marked if "," in cell]
    if 0 < len(with_comma) < len(marked) and any(map(_THOUSANDS.fullmatch, marked)):
        point = next(cell for cell in marked if "," not in cell)
        both = f"'{short(with_comma[0])}' and '{short(point)}'"
        raise LandmarkError(f"the numbers {both} have a comma and a point: write decimals one way, and no thousands.")


def parse_count(token: str, what: str) -> int:
    """Parse a non-negative integer."""
    if not (token.isascii() and token.isdigit() and len(token) <= 18):
        raise LandmarkError(f"'{short(token)}' is not a number of {what}: export the file again.")
    return int(token)


def check_count(where: str, count: int, rows: Sequence[object]) -> None:
    """Raise unless there are as many rows of points as a line of the file promises."""
    if len(rows) != count:
        cut = "the file may be cut short: export it again"
        raise LandmarkError(f"the {where} promises {count} points but {len(rows)} are there; {cut}.")


def parse_number(value: Any, where: str) -> float:
    """Parse one coordinate as text or of JSON; NaN for null and the usual words for a missing value."""
    if value is None or str(value).strip().lower() in _MISSING_WORDS:
        return math.nan
    if isinstance(value, bool) or not is_number(value) or "_" in str(value):
        what = short(str(value))
        raise LandmarkError(f"'{what}' in {where} is not a number: correct it (decimal points, as in 12.5).")
    return float(value)


def decimal(cell: str) -> str:
    """Replace a decimal comma, where commas do not separate."""
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell.strip()) else cell


def parse_point(tokens: Sequence[str], where: str) -> tuple[float, float]:
    """Parse x and y, both or neither of them missing."""
    x, y = (parse_number(token, where) for token in tokens)
    if math.isnan(x) != math.isnan(y):
        raise LandmarkError(f"{where} has only one of x and y: give both, or neither if the landmark is missing.")
    return (math.nan, math.nan) if x == y and x in _ABSENT else (x, y)


def parse_pair(line: str, where: str) -> tuple[float, float]:
    """Parse a line that holds x and y, both or neither of them missing."""
    match = _SEPARATED.fullmatch(line)
    tokens = match.groups() if match is not None else re.split(r"\s*;\s*|\s+", line.strip())
    if all(map(_DECIMAL_COMMA.fullmatch, tokens)):
        tokens = [decimal(token) for token in tokens]
    if len(tokens) != 2:
        raise LandmarkError(f"{where} holds {len(tokens)} values ('{short(line)}'), not x and y: correct it.")
    return parse_point(tokens, where)


def short(text: str, length: int = 40) -> str:
    """Cut a text for a message."""
    return text if len(text) <= length else f"{text[: length - 3]}..."
