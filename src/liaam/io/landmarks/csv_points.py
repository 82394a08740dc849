"""Tables of one row a landmark (``.csv``, ``.tsv``, ``.txt``): centres counted from 0, x to the right and y downwards.

The first line names the columns, by meaning (:mod:`liaam.io.landmarks.columns`). Rows without names are in the order
of the landmarks; numbered ones are sorted. Empty x and y mean a missing landmark. The separator is a comma, a
semicolon or a tab. ImageJ's results count from the corner of the first pixel, so half a pixel is subtracted.
"""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.columns import LANDMARKS, UNCLEAR, Columns, columns_of, has_points, without_title
from liaam.io.landmarks.reading import MISSING, Source, named_points, size_of_file
from liaam.io.landmarks.tables import Row, check_widths, header_of, is_imagej, rows_of, without_gaps
from liaam.io.landmarks.text import parse_point


def is_it(source: Source) -> bool:
    """Whether the first line names columns x and y. A ``.csv`` is a table in any case."""
    return has_points(header_of(source))


def parse(source: Source) -> Landmarks | list[Landmarks]:
    """Parse landmarks of one image, or of many images if a column names the image."""
    header = header_of(source)
    rows = [(number, row) for number, row in rows_of(source)[1:] if any(row) or len(row) == len(header)]
    check_widths(header, rows)
    imagej = is_imagej(source)
    columns = columns_of(header, [row for _, row in rows])
    if columns.landmark is not None and header[columns.landmark] not in LANDMARKS | {*UNCLEAR}:
        source.notes.say(
            "landmarks are named by a column that has the same values in all images",
            header[columns.landmark],
        )
    for column in (columns.image, columns.specimen):
        rows = rows if column is None else without_gaps(source, rows, column)
    shift = 0.5 if imagej else 0.0
    groups: dict[tuple[str, str], list[Row]] = {}
    for number, row in rows:
        image = "" if columns.image is None else without_title(row[columns.image])
        specimen = "" if columns.specimen is None else row[columns.specimen].strip()
        groups.setdefault((image, specimen), []).append((number, row))
    if columns.image is not None:
        groups = {key: part for key, own in groups.items() for key, part in _parted(key, own, columns)}

    def make(group: tuple[tuple[str, str], list[Row]]) -> Landmarks:
        (image, specimen), own = group
        points = np.array([_point(number, row, columns) for number, row in own]) - shift
        names = [row[columns.landmark] for _, row in own] if columns.landmark is not None else []
        placing = size_of_file(*(own[0][1][i] for i in columns.size)) if columns.size else Placing()
        names = tuple(names) if any(names) else ()
        return Landmarks(points, (), names, image or None, label=specimen, placing=placing)

    made = list(source.each(((image or "its table", ((image, s), own)) for (image, s), own in groups.items()), make))
    numbers = columns.landmark is not None and header[columns.landmark] != "name"
    placed = named_points(source, made, numbers) if columns.image is not None or numbers else made
    return placed[0] if columns.image is None and placed else placed


def _parted(key: tuple[str, str], rows: list[Row], columns: Columns) -> Iterator[tuple[tuple[str, str], list[Row]]]:
    """Divide the rows of an image whose every landmark occurs as often, of several specimens or replicates."""
    seen: Counter[str] = Counter()
    parts: dict[int, list[Row]] = {}
    for number, row in rows:
        name = row[columns.landmark].strip() if columns.landmark is not None else ""
        seen[name] += 1
        parts.setdefault(seen[name], []).append((number, row))
    if columns.landmark is None or "" in seen or len({len(part) for part in parts.values()}) > 1:
        yield key, rows
        return
    for i, part in parts.items():
        yield (key if i == 1 else (key[0], f"{key[1]}{i}")), part


def _point(number: int, row: list[str], columns: Columns) -> tuple[float, float]:
    """Return the point of a row; missing if it is marked invisible and has no position."""
    point = parse_point((row[columns.x], row[columns.y]), f"line {number}")
    seen = "1" if columns.visible is None else row[columns.visible].strip().lower()
    return MISSING if point == (0.0, 0.0) and seen in ("0", "false") else point
