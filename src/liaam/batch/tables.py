"""Tables of results, written row by row: Parquet, CSV, or JSON lines."""

import csv
import importlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

from liaam.errors import LiaamError
from liaam.io import atomic_path
from liaam.io.files import json_object

GROUP = 1000
"""Rows per Parquet row group, which are in memory together."""

COLUMNS = {
    "path": "string",
    "status": "string",
    "message": "string",
    "quality": "float32",
    "found": "float32",
    "theta_deg": "float32",
    "cost": "float64",
    "iterations": "int32",
    "landmarks": "list<float32>",
    "covariance": "list<float32>",
    "seconds": "float32",
}
"""Columns and their types. Only the last one differs between runs."""

_PARTS = {"landmarks": ("x", "y"), "covariance": ("xx", "xy", "yy")}


ParsedRow = tuple[str, dict[str, Any]]
"""A row as JSON text, and parsed."""


@dataclass(frozen=True)
class Table:
    """Content of a table: its rows, the number of landmarks, and whether the rows have covariances.

    ``facts`` are the settings, stored in the file if the format supports it.
    """

    rows: Iterable[ParsedRow]
    n_points: int
    covariance: bool
    facts: dict[str, Any]

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return _columns(self.covariance)


def _columns(covariance: bool) -> list[str]:
    return [name for name in COLUMNS if covariance or name != "covariance"]


def row_of(text: str, n_points: int, covariance: bool) -> dict[str, Any] | None:
    """Parse a row of JSON. Return None unless it has all columns, each of the right type."""
    row, names = json_object(text), _columns(covariance)
    if row is None or not row.keys() >= set(names):
        return None
    sound = all(_is_cell(row[name], COLUMNS[name], n_points * len(_PARTS.get(name, ()))) for name in names)
    return row if sound else None


def _is_cell(value: Any, kind: str, width: int) -> bool:
    if kind == "string":
        return isinstance(value, str)
    if value is None:
        return True
    if width:
        return isinstance(value, list) and len(value) == width and all(_is_cell(item, "float32", 0) for item in value)
    return type(value) is int and abs(value) < 2**31 if kind == "int32" else type(value) in (int, float)


def check_format(output: Path) -> None:
    """Raise, before any work, if the format cannot be written."""
    if output.suffix.lower() not in _WRITERS:
        raise LiaamError(f"{output}: give a table that ends in {', '.join(_WRITERS)}")
    if output.suffix.lower() == ".parquet" and find_spec("pyarrow") is None:
        raise LiaamError(
            f'{output}: Parquet needs pyarrow; run pip install "liaam[batch]", or give a name that ends in .csv or '
            ".jsonl"
        )


def write_table(output: Path, table: Table) -> None:
    """Write a table atomically in the format of its suffix."""
    with atomic_path(output) as temp:
        _WRITERS[output.suffix.lower()](temp, table)


def _write_parquet(path: Path, table: Table) -> None:
    pa, parquet = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    types = {name: pa.type_for_alias(name) for name in ("string", "float32", "float64", "int32")}
    types["list<float32>"] = pa.list_(pa.float32())
    schema = pa.schema([(name, types[COLUMNS[name]]) for name in table.columns], {"liaam": json.dumps(table.facts)})
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        rows = iter(table.rows)
        while group := [row for _, row in islice(rows, GROUP)]:
            writer.write_table(pa.Table.from_pylist(group, schema))


def _write_csv(path: Path, table: Table) -> None:
    """Write flat columns: x0, y0, x1 ... and covariances xx0, xy0, yy0, xx1 ..."""
    widths = {name: table.n_points * len(parts) for name, parts in _PARTS.items()}
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header for name in table.columns for header in _headers(name, table.n_points))
        for _, row in table.rows:
            writer.writerow(cell for name in table.columns for cell in _cells(row[name], widths.get(name)))


def _write_lines(path: Path, table: Table) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"{text}\n" for text, _ in table.rows)


def _headers(name: str, n_points: int) -> list[str]:
    return [f"{part}{i}" for i in range(n_points) for part in _PARTS[name]] if name in _PARTS else [name]


def _cells(value: Any, width: int | None) -> list[Any]:
    if width is None:
        return [value]
    return [None] * width if value is None else value


_WRITERS = {".parquet": _write_parquet, ".csv": _write_csv, ".jsonl": _write_lines}
