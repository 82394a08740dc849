"""Tables of results, written row by row: Parquet, CSV, JSON lines, or the landmarks as .tps."""

import csv
import importlib
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain, islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from liaam.errors import LandmarkError, LiaamError, installing
from liaam.fitting.result import USABLE
from liaam.io import Contour, Landmarks, atomic_path
from liaam.io.files import json_object
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.tables import INDIVIDUALS, SIDE
from liaam.io.landmarks.writers import tps_text, upwards
from liaam.io.table_reader import named_rows

GROUP = 1000  # Rows per Parquet row group, which are in memory together
# Columns and their types. Only the last one differs between runs.
COLUMNS = {
    "path": "string",
    "status": "string",
    "message": "string",
    "quality": "float32",
    "object": "int32",
    "specimen": "string",
    "code": "string",
    "score": "float32",
    "n_found": "int32",
    "theta_deg": "float32",
    "cost": "float64",
    "iterations": "int32",
    "expansion": "float32",
    "landmarks": "list<float32>",
    "covariance": "list<float32>",
    "scale": "float64",
    "scale_unit": "string",
    "scale_from": "string",
    "present": "list<float32>",
    "side": "string",
    "fingerprint": "string",
    "seconds": "float32",
}
NAMES = "landmark_names"  # Entry of rows, and of the metadata of Parquet, with the names of the landmarks

# Columns that are lists, and what each holds for a landmark, in this order
_PARTS = {"landmarks": ("x", "y"), "covariance": ("xx", "xy", "yy"), "present": ("present",)}


ParsedRow = tuple[str, dict[str, Any]]
"""A row as JSON text, and parsed."""


@dataclass(frozen=True)
class BatchTable:
    """Content of a table: its rows, the number of landmarks, and whether the rows have covariances.

    ``facts`` are the settings, ``contours`` lines through the landmarks, and ``names`` those of the landmarks or
    empty; each is stored if the format supports it.
    """

    rows: Iterable[ParsedRow]
    n_points: int
    covariance: bool
    facts: dict[str, Any]
    contours: tuple[Contour, ...] = ()
    names: tuple[str, ...] = ()


def _columns(covariance: bool) -> list[str]:
    """Return the names of the columns of a table with or without covariances."""
    return [name for name in COLUMNS if covariance or name != "covariance"]


def row_of(text: str, n_points: int, covariance: bool) -> dict[str, Any] | None:
    """Parse a row of JSON. Return None unless it has all columns, each of the right type."""
    row = json_object(text)
    names = _columns(covariance)
    if row is None or not row.keys() >= set(names):
        return None
    return row if all(_is_cell(row[name], name, n_points) for name in names) else None


def _is_cell(value: Any, column: str, n_points: int) -> bool:
    """Return whether a value of JSON may stand in a column; only text is never absent (None)."""
    kind = COLUMNS[column]
    if kind == "string":
        return isinstance(value, str)
    if value is None:
        return True
    if column in _PARTS:
        n_items = n_points * len(_PARTS[column])
        is_list = isinstance(value, list) and len(value) == n_items
        return is_list and all(item is None or _is_number(item) for item in value)
    if kind == "int32":
        return type(value) is int and abs(value) < 2**31
    return _is_number(value)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)  # true and false are none


def check_format(output: Path) -> None:
    """Raise, before any work, if the format cannot be written."""
    if output.suffix.lower() not in _WRITERS:
        page = "; 'liaam fit' writes web pages" if output.suffix.lower() in (".html", ".htm") else ""
        raise LiaamError(f"{output}: give a table that ends in {', '.join(_WRITERS)}{page}")
    if output.suffix.lower() == ".parquet" and find_spec("pyarrow") is None:
        raise LiaamError(
            f"{output}: Parquet needs pyarrow; run {installing('batch')}, or give a name that ends in .csv or .jsonl"
        )


def write_table(output: Path, table: BatchTable) -> None:
    """Write a table atomically in the format of its suffix."""
    with atomic_path(output) as temp:
        _WRITERS[output.suffix.lower()](temp, table)


def _write_parquet(path: Path, table: BatchTable) -> None:
    pa = importlib.import_module("pyarrow")
    parquet = importlib.import_module("pyarrow.parquet")
    types = {name: pa.type_for_alias(name) for name in ("string", "float32", "float64", "int32")}
    types["list<float32>"] = pa.list_(pa.float32())
    columns = [(name, types[COLUMNS[name]]) for name in _columns(table.covariance)]
    schema = pa.schema(columns, {"liaam": json.dumps(table.facts), NAMES: json.dumps(table.names)})
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        rows = iter(table.rows)
        while group := [row for _, row in islice(rows, GROUP)]:
            writer.write_table(pa.Table.from_pylist(group, schema))


def _write_csv(path: Path, table: BatchTable) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        write_csv_rows(file, table)


def write_csv_rows(file: TextIO, table: BatchTable) -> None:
    """Write flat columns: x1, y1, x2 ... and covariances xx1, xy1, yy1 ...; by names x_tip, y_tip, ..."""
    suffixes = [f"_{name}" for name in table.names] or [str(number) for number in range(1, table.n_points + 1)]
    headers = {name: _headers(name, suffixes) for name in _columns(table.covariance)}
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(chain.from_iterable(headers.values()))
    for _, row in table.rows:
        cells = (_cells(row[name], len(names)) for name, names in headers.items())
        writer.writerow(chain.from_iterable(cells))


def _headers(column: str, suffixes: Sequence[str]) -> list[str]:
    """Return the flat columns of a column: of a list, one for each part of each landmark, else the column itself."""
    if column not in _PARTS:
        return [column]
    return [f"{part}{suffix}" for suffix in suffixes for part in _PARTS[column]]


def _cells(value: Any, n_columns: int) -> list[Any]:
    """Return the values of the flat columns of a column. Where a list is absent, each is None."""
    return value if isinstance(value, list) else [value] * n_columns


def _write_lines(path: Path, table: BatchTable) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        if not table.names:
            file.writelines(f"{text}\n" for text, _ in table.rows)
        else:
            file.writelines(json.dumps(row | {NAMES: table.names}) + "\n" for _, row in table.rows)


def _write_tps(path: Path, table: BatchTable) -> None:
    """Write the landmarks of fits that may be used only, because the format has no status."""
    with path.open("w", encoding="utf-8", newline="") as file:
        for _, row in table.rows:
            if row["status"] in USABLE:
                points = np.array(row["landmarks"], dtype=np.float64).reshape(-1, 2)
                landmarks = Landmarks(points, table.contours, image_name=row["path"], scale=row["scale"])
                file.write(tps_text(upwards(landmarks, row["size"])))


TABLE_SUFFIXES = (".parquet", ".csv", ".jsonl")
"""Suffixes of tables that are written and read."""

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".xlsx")
"""Suffixes of tables of text, and of those that a person saved again from a spreadsheet."""

_ESSENTIAL = frozenset(("path", "status"))
_OTHERS = frozenset(("message", "quality", "cost", "theta_deg"))
"""Columns of which a table of a batch has at least one; people remove and add columns, and change their order."""


def is_table_of_text(file: Source) -> bool:
    """Whether a file of text or a spreadsheet is a table of a batch, by the names of its columns."""
    if file.path.suffix.lower() not in TEXT_SUFFIXES:
        return False
    try:
        _, header = file.rows[0]
    except LandmarkError:
        return False
    titles = {title.strip() for title in header}
    return titles >= _ESSENTIAL and bool(titles & _OTHERS)


def read_rows(path: Path) -> Iterator[dict[str, Any]]:
    """Iterate over the rows of a table ``.parquet`` or ``.jsonl`` of :func:`write_table`.

    Each has ``path``, ``status``, ``landmarks`` and ``covariance``, and ``landmark_names`` if there are names.

    Raises
    ------
    LiaamError
        If a row cannot be read, or pyarrow is missing.
    """
    return _checked(path, _READERS[path.suffix.lower()](path))


def rows_of_text(file: Source) -> Iterator[dict[str, Any]]:
    """Iterate over the rows of a table of text or a spreadsheet, as :func:`read_rows`."""
    return _checked(file.path, _parsed(file))


def _checked(path: Path, rows: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Iterate over rows that have what every row of a batch has."""
    n_read = 0
    try:
        for row in rows:
            checked = {"path": str(row["path"]), "status": str(row["status"]), "landmarks": row.get("landmarks")}
            n_read += 1
            yield row | checked
    except ImportError as fault:
        raise LiaamError(f"{path}: Parquet needs pyarrow; run {installing('batch')}") from fault
    except LandmarkError as fault:
        raise LandmarkError(f"{path}: {fault}") from fault
    except (ValueError, KeyError, TypeError, OSError, RecursionError) as fault:
        raise LiaamError(
            f"{path}: row {n_read + 1} is not one of 'liaam batch' ({fault}): run the batch again"
        ) from fault


def _read_parquet(path: Path) -> Iterator[dict[str, Any]]:
    parquet = importlib.import_module("pyarrow.parquet")
    with parquet.ParquetFile(path) as file:
        names = json.loads((file.schema_arrow.metadata or {}).get(NAMES.encode(), b"[]"))
        for group in file.iter_batches(GROUP):
            yield from (row | {NAMES: names} for row in group.to_pylist())


def _parsed(file: Source) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table of text, with the lists that flat columns hold."""
    titles = [title.strip() for title in file.rows[0][1]]
    renamed = _known_columns(titles)
    x_columns = [name for name in titles if re.fullmatch(r"x(\d+|_.+)", name, re.DOTALL)]
    suffixes = [name.removeprefix("x") for name in x_columns]
    if all(map(str.isdigit, suffixes)):
        suffixes.sort(key=int)
    headers = {column: _headers(column, suffixes) for column in _PARTS}
    names = [suffix.removeprefix("_") for suffix in suffixes if suffix.startswith("_")]
    for _, row in named_rows(file.rows):
        lists = {}
        for column, flat in headers.items():
            cells = [row.get(header, "") for header in flat]
            if any(cells):  # else the list is absent
                lists[column] = [float(cell) if cell else None for cell in cells]
        yield {**{renamed[name]: cell for name, cell in row.items()}, NAMES: names, **lists}


def _known_columns(titles: Sequence[str]) -> dict[str, str]:
    """Return what the columns of a table mean: those of side and individual may be written otherwise, as by people.

    Raises
    ------
    LandmarkError
        If two columns mean one of these.
    """
    known = {SIDE: SIDE} | dict.fromkeys(INDIVIDUALS, "individual")
    meanings = {title: known.get(title.lower(), title) for title in titles}
    for meaning in known.values():
        same = [title for title in meanings if meanings[title] == meaning]
        if len(same) > 1:
            raise LandmarkError(f"the columns {' and '.join(same)} both are of the {meaning}: keep one of them")
    return meanings


def _read_lines(path: Path) -> Iterator[dict[str, Any]]:
    with path.open(encoding="utf-8") as file:
        yield from map(json.loads, file)


_READERS = {".parquet": _read_parquet, ".jsonl": _read_lines}
_WRITERS = {".parquet": _write_parquet, ".csv": _write_csv, ".jsonl": _write_lines, ".tps": _write_tps}
