"""Tables of numbers that a calibration reads: CSV files with named columns."""

import csv
import os
from collections.abc import Mapping

import numpy as np

from liaam.errors import CameraError
from liaam.io.files import existing_file, is_number, read_bytes

LARGEST = 10_000_000  # Largest size of a file, bytes


def read_columns(
    path: str | os.PathLike, kind: str, columns: tuple[str, ...], aliases: Mapping[str, str] | None = None
) -> np.ndarray:
    """Read columns of numbers from a CSV file, (n, len(columns)) float64.

    A header line may give another order and further columns, in any case and by aliases. The separator is a comma,
    semicolon or tab. Lines that start with # are comments. Raises a CameraError that names the line; ``kind`` says what
    the file should be.
    """
    path = existing_file(path, CameraError, kind)
    try:
        text = read_bytes(path, CameraError, LARGEST).decode("utf-8-sig")
        filled_lines = [
            (i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip(" ,;\t") and line[0] != "#"
        ]
        separator = max(",;\t", key=filled_lines[0][1].count)
        rows = [
            (i, [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]) for i, line in filled_lines
        ]
    except (UnicodeDecodeError, csv.Error, IndexError) as error:
        raise CameraError(f"{path}: this is not a table; give a CSV file of {','.join(columns)}") from error
    order = list(range(len(columns)))
    width = len(rows[0][1])
    if not is_number(rows[0][1][0]):
        header = [cell.lower() for cell in rows.pop(0)[1]]
        canonical = {name.lower(): name for name in columns} | dict(aliases or {})
        names = [canonical.get(cell) for cell in header]
        if wrong := [name for name in columns if names.count(name) != 1]:
            raise CameraError(
                f"{path}: the header line must name the columns {', '.join(columns)} once each, but "
                f"{', '.join(wrong)} {'is' if len(wrong) == 1 else 'are'} missing or duplicated in: {', '.join(header)}"
            )
        order = [names.index(name) for name in columns]
    if not rows:
        raise CameraError(f"{path}: there is no line of numbers below the header line; add some")
    for line, cells in rows:
        if len(cells) != width or max(order) >= width:
            given = f"{path}, line {line}: there are {len(cells)} columns"
            raise CameraError(f"{given} instead of {max(width, len(columns))}; complete the line")
        if wrong := [cells[i] for i in order if not is_number(cells[i])]:
            raise CameraError(f"{path}, line {line}: {wrong[0]!r} is not a number; write it with a decimal point")
    return np.array([[float(cells[i]) for i in order] for _, cells in rows])
