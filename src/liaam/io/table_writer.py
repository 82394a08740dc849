"""Write tables as CSV."""

import csv
import io
import math
from pathlib import Path

from liaam.errors import LiaamError
from liaam.io.atomic import write_text_atomically
from liaam.io.files import AnyPath
from liaam.tables import Columns


def write_columns(path: AnyPath, columns: Columns) -> None:
    """Write columns atomically as ``.csv``; NaN becomes an empty cell.

    Raises
    ------
    LiaamError
        If the suffix is another, or writing fails.
    """
    if Path(path).suffix.lower() != ".csv":
        raise LiaamError(f"{path}: the table is written as CSV; give a name that ends in .csv")
    write_text_atomically(path, columns_text(columns))


def columns_text(columns: Columns) -> str:
    """Return columns as text in CSV; NaN becomes an empty cell."""
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow(cell if isinstance(cell, str) else "" if math.isnan(cell) else f"{cell:.9g}" for cell in row)
    return buffer.getvalue()
