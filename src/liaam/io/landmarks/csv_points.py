"""Plain ``.csv`` in liaam's own convention: pixel centres counted from 0, x to the right and y downwards.

The first line names the columns: ``x``, ``y``, and optionally ``name`` (of the landmark) and ``image`` (file name; the
file then holds many images). Other columns are ignored. Rows are in the order of the landmarks, and empty x and y mean
a missing landmark. The separator may also be a tab or a semicolon; with semicolons, numbers may have decimal commas.
"""

import csv
import io
import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import Landmarks, make_landmarks, parse_number

_Rows = list[tuple[int, dict[str, str]]]


def parse(path: Path, text: str) -> Landmarks | dict[str, Landmarks]:
    """Parse the text of a CSV file: landmarks of one image, or of many images if a column names the image."""
    header, rows = _table(path, text)
    if "image" not in header:
        return _landmarks(path, rows, None, header)
    groups: dict[str, _Rows] = {}
    for number, row in rows:
        groups.setdefault(row["image"], []).append((number, row))
    return {image: _landmarks(path, group, image, header) for image, group in groups.items()}


def dump(landmarks: Landmarks) -> str:
    """Return the text of a CSV file with one image's landmarks."""
    names = ["name"] if landmarks.names else []
    return _join([["x", "y", *names], *_cells(landmarks, bool(names))])


def dump_collection(collection: Mapping[str, Landmarks]) -> str:
    """Return the text of a CSV file with the landmarks of many images, by file name."""
    named = any(landmarks.names for landmarks in collection.values())
    rows = [[image, *cells] for image, landmarks in collection.items() for cells in _cells(landmarks, named)]
    return _join([["image", "x", "y", *(["name"] if named else [])], *rows])


def _table(path: Path, text: str) -> tuple[list[str], _Rows]:
    """Split the text into column names and rows with line numbers."""
    first = text.lstrip().splitlines()[0]
    delimiter = next((mark for mark in ",;\t" if mark in first), ",")
    reader = csv.reader(io.StringIO(text.lstrip(), newline=""), delimiter=delimiter)
    try:
        header = [cell.strip().lower() for cell in next(reader)]
        cells = [(reader.line_num, row) for row in reader if any(row) or len(row) == len(header)]
    except csv.Error as fault:
        raise LandmarkError(f"{path} is not a CSV table ({fault}): export it again.") from fault
    if "x" not in header or "y" not in header:
        raise LandmarkError(f"{path} has no columns x and y: name the columns in the first line, such as x,y.")
    if not cells:
        raise LandmarkError(f"{path} has no rows under its header; it may be cut short: export it again.")
    for number, row in cells:
        if len(row) != len(header):
            raise LandmarkError(
                f"{path}: line {number} has {len(row)} cells but the header {len(header)}: correct the line."
            )
    rows = [(number, dict(zip(header, row, strict=True))) for number, row in cells]
    if delimiter == ";":
        rows = [(n, {**row, "x": row["x"].replace(",", "."), "y": row["y"].replace(",", ".")}) for n, row in rows]
    return header, rows


def _landmarks(path: Path, rows: _Rows, image: str | None, header: list[str]) -> Landmarks:
    points = []
    for number, row in rows:
        x, y = (parse_number(path, row[axis], f"line {number}") for axis in "xy")
        if math.isnan(x) != math.isnan(y):
            raise LandmarkError(f"{path}: line {number} has only one of x and y: fill in both, or leave both empty.")
        points.append((x, y))
    names = [row["name"] for _, row in rows] if "name" in header else []
    return make_landmarks(path, points, names=names if any(names) else (), image_name=image)


def _cells(landmarks: Landmarks, named: bool) -> list[list[str]]:
    points = [["", ""] if x != x else [repr(x), repr(y)] for x, y in landmarks.points.tolist()]
    if not named:
        return points
    names = landmarks.names or [""] * len(points)
    return [[*point, name] for point, name in zip(points, names, strict=True)]


def _join(rows: Iterable[list[str]]) -> str:
    buffer = io.StringIO(newline="")
    csv.writer(buffer).writerows(rows)  # lines end in \r\n, so that a \r in a name is quoted
    return buffer.getvalue()
