"""Tables of landmarks (``.csv``, ``.tsv``, ``.txt``): a row for each landmark or image, DeepLabCut's, and lists.

Positions are centres counted from 0, x to the right and y downwards, but for ImageJ's results. The separator is a
comma, a semicolon, a tab or blanks. :mod:`liaam.io.landmarks.columns` finds out what the columns mean.
"""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import is_number, natural_key
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.columns import LANDMARKS, UNCLEAR, Columns, columns_of, filled, name_column, pairs_of
from liaam.io.landmarks.matching import without_title
from liaam.io.landmarks.reading import Row, Source, decimal, named_points, parse_point, size_of

_HEADERS = ("scorer", "individuals", "bodyparts", "coords")  # of DeepLabCut; the second only for several animals
_WFLW = 5  # pairs of numbers of a box and of attributes
_SEPARATORS = r"\t;", r"\t,;", r"\s,;"
_FEW = 3  # least number of lines, and of points in each, to tell boxes from landmarks


def _check_width(header: Sequence[str], row: Row) -> Row:
    if len(row[1]) != len(header):
        raise LandmarkError(f"line {row[0]} has {len(row[1])} cells but the header {len(header)}: correct the line.")
    return row


def _whole(source: Source, header: Sequence[str], rows: Sequence[Row]) -> list[Row]:
    """Return the rows that have as many cells as the header, and leave out others."""
    return list(source.each(((f"line {row[0]}", row) for row in rows), partial(_check_width, header)))


def parse_long(source: Source) -> list[Landmarks]:
    """Parse landmarks of one image, or of many images if a column names the image.

    Rows without names are in the order of the landmarks; numbered ones are sorted. Empty x and y mean a missing
    landmark. ImageJ's results count from the corner of the first pixel, so half a pixel is subtracted.
    """
    header = source.header
    rows = [_check_width(header, row) for row in source.rows[1:] if any(row[1]) or len(row[1]) == len(header)]
    columns = columns_of(header, [row for _, row in rows])
    if columns.landmark is not None and header[columns.landmark] not in LANDMARKS | {*UNCLEAR}:
        source.notes.say("landmarks are named by the values of a column", header[columns.landmark])
    # ImageJ's first column has a blank as its name, or one of two is "Label".
    raw = source.rows[0][1]
    is_imagej = {"X", "Y"} <= {*raw} and (source.text[:2] in (" ,", " \t") or "Label" in raw[:2])

    def make(group: tuple[tuple[str, str], list[Row]]) -> Landmarks:
        (image, specimen), own = group
        points = np.array([_point(number, row, columns) for number, row in own]) - (0.5 if is_imagej else 0.0)
        names = () if columns.landmark is None else tuple(row[columns.landmark] for _, row in own)
        size = size_of(dict(zip(("width", "height"), (own[0][1][i] for i in columns.size), strict=False)))
        return Landmarks(points, (), names if any(names) else (), image or None, label=specimen, placing=Placing(size))

    groups = ((group[0][0] or "its table", group) for group in _grouped(source, rows, columns))
    made = list(source.each(groups, make))
    numbers = columns.landmark is not None and header[columns.landmark] != "name"
    return named_points(source, made, numbers) if columns.image is not None or numbers else made


def _filled(source: Source, rows: list[Row], column: int | None) -> list[str]:
    """Return the names of the images or specimens of rows, which exports of merged cells give in the first row only."""
    if column is None:
        return [""] * len(rows)
    names = filled([row[column] for _, row in rows])
    for name, (_, row) in zip(names, rows, strict=True):
        if name and not row[column]:
            source.notes.say("rows without a name of the image or specimen belong to the one above", name)
    return names


def _grouped(source: Source, rows: list[Row], columns: Columns) -> Iterator[tuple[tuple[str, str], list[Row]]]:
    """Yield the image and the specimen of each object, and its rows.

    The rows of an image whose every landmark occurs as often are those of several specimens or replicates.
    """
    groups = defaultdict[tuple[str, str], list[Row]](list)
    images = map(without_title, _filled(source, rows, columns.image))
    for image, specimen, row in zip(images, _filled(source, rows, columns.specimen), rows, strict=True):
        groups[image, specimen.strip()].append(row)
    for (image, specimen), own in groups.items():
        parts, seen = defaultdict[int, list[Row]](list), Counter[str]()
        for number, row in own:
            name = "" if columns.landmark is None else row[columns.landmark].strip()
            seen[name] += 1
            parts[seen[name]].append((number, row))
        if columns.image is None or "" in seen or len({*map(len, parts.values())}) > 1:
            parts = {1: own}
        for i, part in parts.items():
            yield (image, specimen if i == 1 else f"{specimen}{i}"), part


def _point(number: int, row: list[str], columns: Columns) -> tuple[float, float]:
    """Return the point of a row; missing if it is marked invisible and has no position."""
    point = parse_point((row[columns.x], row[columns.y]), f"line {number}")
    seen = "1" if columns.visible is None else row[columns.visible].strip().lower()
    return (math.nan, math.nan) if point == (0.0, 0.0) and seen in ("0", "false") else point


_Pairs = dict[str, dict[str, int]]  # indices of columns by landmark and axis


def parse_wide(source: Source) -> list[Landmarks]:
    """Parse a row of landmarks for each image, such as ml-morph's and MorphoJ's (``id,X1,Y1,X2,...``).

    Columns of x and y have a number or the landmark's name before or behind the axis. Rows are named by a column for
    the image or specimen, or else by the only other column with text.
    """
    (_, header), *rows = source.rows
    rows = _whole(source, header, [row for row in rows if any(row[1])])
    given = pairs_of(header)
    others = [key for key in given if not key.isdigit()]
    if len(others) < len(given) - 1:
        for key in others:
            source.notes.say("columns of x and y beside those of numbered landmarks are not read", key)
            del given[key]
    numbered = all(map(str.isdigit, given))
    pairs = {key: given[key] for key in sorted(given, key=natural_key)} if numbered else given
    if any("z" in axes for axes in pairs.values()):
        raise LandmarkError("it has columns of z: export x and y only.")
    used = {i for axes in pairs.values() for i in axes.values()}
    name = name_column(source.header, [row for _, row in rows], used)
    # Numbers out of order may be the names of landmarks in another order.
    named = not numbered or list(pairs) != list(given)
    return _of_rows(source, rows, {"": pairs}, lambda row: None if name is None else row[name].strip(), named)


def parse_dlc(source: Source) -> list[Landmarks]:
    """Parse DeepLabCut's rows of landmarks for each image, which have several header rows.

    Of several scorers the first is read. Individuals are the objects of an image. Likelihoods are not used.
    """
    rows = [row for row in source.rows if any(row[1])]
    headers = {row[0]: row for _, row in rows[:4] if row[0] in _HEADERS}
    if not {"scorer", "bodyparts", "coords"} <= headers.keys():
        raise LandmarkError("it lacks rows of DeepLabCut's table (scorer, bodyparts, coords): export it again.")
    coords = headers["coords"]
    for header in headers.values():
        _check_width(coords, (0, header))
    rows = _whole(source, coords, rows[len(headers) :])
    first = next((i for i, cell in enumerate(coords) if cell in ("x", "y")), len(coords))
    scorer, *others = dict.fromkeys(headers["scorer"][first:]) or [""]
    if others:
        source.notes.say(f"of several scorers '{scorer}' is read", source.path.name)
    objects = defaultdict[str, _Pairs](lambda: defaultdict(dict))
    for i in range(first, len(coords)):
        if headers["scorer"][i] == scorer and coords[i] in ("x", "y"):
            individual = headers["individuals"][i] if "individuals" in headers else ""
            objects[individual][headers["bodyparts"][i]][coords[i]] = i
    found = _of_rows(source, rows, objects, lambda row: "/".join(cell for cell in row[:first] if cell))
    return [own for own in found if not own.missing.all()]


def _of_rows(
    source: Source, rows: list[Row], objects: dict[str, _Pairs], image_of: Callable[[list[str]], str | None], named=True
) -> list[Landmarks]:
    """Return the landmarks of the objects of each row."""

    def make(part: tuple[Row, str]) -> Landmarks:
        (number, row), label = part
        pairs = objects[label]
        points: Any = [parse_point((row[axes["x"]], row[axes["y"]]), f"line {number}") for axes in pairs.values()]
        return Landmarks(points, names=tuple(pairs) if named else (), image_name=image_of(row), label=label)

    return list(source.each(((f"line {row[0]}", (row, label)) for row in rows for label in objects), make))


def is_list(source: Source) -> bool:
    """Whether lines have at least two landmarks and one name."""
    return bool(source.lines) and all(_name_at(_words(line)) is not None for line in source.lines[:20])


def _words(line: str) -> list[str]:
    """Split a line; a name may hold blanks if others separate, and commas may be decimal if these do not."""
    tabbed, marked, every = ([word.strip() for word in re.split(f"[{by}]", line) if word.strip()] for by in _SEPARATORS)
    words = [decimal(cell) for cell in tabbed]
    if words != tabbed:
        return words
    return every if _name_at(marked) is None else marked


def _name_at(words: list[str]) -> int | None:
    """Return the index of the name, the first or last word, if all others are numbers."""
    for at, others in ((0, words[1:]), (-1, words[:-1])):
        if len(others) > 3 and not _is_value(words[at]) and all(map(_is_value, others)):
            return at
    return None


def _is_value(word: str) -> bool:
    return is_number(word) or word.lower() == "nan"


def parse_list(source: Source) -> list[Landmarks]:
    """Parse x y of all landmarks and the image's name, first or last, in a line for each image, without a header.

    Lines of WFLW also have a box and six attributes of 0 or 1 before the name, which are skipped, as is a box around
    all points before or behind them.
    """
    lines = [_words(line) for line in source.lines]
    at = _name_at(lines[0]) or 0

    def make(words: list[str]) -> tuple[str, np.ndarray]:
        if _name_at(words) != at or len(words) % 2 == 0:
            raise LandmarkError("it has other parts than x y of landmarks and a name: correct it.")
        name, values = words[at], words[1:] if at == 0 else words[:-1]
        return name, np.array([parse_point(pair, f"'{name}'") for pair in zip(values[::2], values[1::2], strict=True)])

    rows = list(source.each(((f"line {i}", words) for i, words in enumerate(lines, 1)), make))
    whole = len(rows) == len(lines)
    last = _WFLW if whole and all(_has_attributes(pairs) for _, pairs in rows) else 0
    first = 0
    if whole and not last and len(rows) >= _FEW:
        first = 2 if all(_has_box(pairs) for _, pairs in rows) else 0
        last = 2 if all(_has_box(np.roll(pairs, 2, axis=0)) for _, pairs in rows) else 0
    for where in ["before"] * (first > 0) + ["behind"] * (last == 2):
        source.notes.say(f"four numbers {where} the points are taken for a box around them", source.path.name)
    return [Landmarks(pairs[first : len(pairs) - last], image_name=name) for name, pairs in rows]


def _has_attributes(pairs: np.ndarray) -> bool:
    flags, box = {*pairs[-3:].flat}, pairs[-_WFLW:]
    return len(pairs) > _WFLW + 1 and flags <= {0.0, 1.0} and bool((box[0] < box[1]).all())


def _has_box(pairs: np.ndarray) -> bool:
    """Whether the first four numbers are a box around all points: two corners, or one and the size."""
    if len(pairs) < 2 + _FEW:
        return False
    corner, other, low, high = pairs[0], pairs[1], pairs[2:].min(axis=0), pairs[2:].max(axis=0)
    around = (other >= high).all() or (corner + other >= high).all()
    return bool((corner <= low).all() and around and (other > 0).all())
