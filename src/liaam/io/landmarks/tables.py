"""Tables of landmarks (``.csv``, ``.tsv``, ``.txt``): a row for each landmark or image, DeepLabCut's, and lists.

Positions are centres counted from 0, x to the right and y downwards, but for ImageJ's results. The separator is a
comma, a semicolon, a tab or blanks. Columns have a meaning by their names, and else by their values.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, chain, count, groupby
from typing import Any, NamedTuple

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import is_number, natural_key
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.matching import names_picture, without_title
from liaam.io.landmarks.reading import NOWHERE, Source, TableLine, decimal, named_points, parse_point, plain, size_of

_HEADERS = ("scorer", "individuals", "bodyparts", "coords")  # of DeepLabCut; the second only for several animals
_WFLW = 5  # pairs of numbers of a box and of attributes
_SEPARATORS = r"\t;", r"\t,;", r"\s,;"
_FEW = 3  # least number of lines, and of points in each, to tell boxes from landmarks
IMAGES = {"image", "image_name", "image_file", "image_id", "image_path", "img", "file", "filename", "file_name"}
IMAGES |= {"photo", "picture", "photo_name", "path", "filepath", "file_path", "frame", "external"}
SPECIMENS = {"specimen", "specimen_id", "specimen_name", "individual", "sample", "sample_id", "subject", "animal"}
INDIVIDUALS = {"ind", "individual", "individual_id"}  # beside a column of specimens
SIDE = "side"
STATUS = "status"
LANDMARKS = {"landmark", "landmark_name", "landmark_id", "landmarks", "lm", "point", "point_name", "point_id", "points"}
LANDMARKS |= {"keypoint", "keypoint_name", "bodypart", "part", "marker", "joint", "lmk", "landmark_number", "kp"}
SIZES = ("image_width", "image_height"), ("img_width", "img_height"), ("width", "height")
VISIBLE = ("visible", "visibility", "v")
UNCLEAR = ("name", "label", "id", "no", "number", "index", "slice")  # the values decide what these mean
_AXIS = re.compile(r"(?:(?:pos|coord|point|pixel)_)?([xy])(?:_(?:px|pixels?|coords?|coordinates?|pos|position))?")
_FORMS = (
    r"(?:raw|coord|lm)?[ ._-]?(?P<axis>[xyz])[ ._-]?(?P<key>\d+)",
    r"(?P<axis>[xyz])[ ._-](?P<key>\w.*)",
    r"(?P<key>.*\w)[ ._-][(\[]?(?P<axis>[xyz])[)\]]?",
    r"(?P<key>\w*\d)(?P<axis>[xyz])",
    r"(?-i:(?P<key>\w*[a-z])(?P<axis>[XYZ]))",
)
# Words beside x and y that name no landmark.
_OTHERS = {"bbox", "box", "rect", "min", "max", "centroid", "center", "image", "size"}
_OTHERS |= {"px", "pixel", "pixels", "mm", "cm", "um", "inch"}


@dataclass(frozen=True)
class Columns:
    """Indices of columns: x and y; of images, specimens in an image, landmarks and so on, None if there are none."""

    x: int
    y: int
    image: int | None = None
    specimen: int | None = None
    landmark: int | None = None
    visible: int | None = None
    size: tuple[int, ...] = ()  # those of the width and height of the images
    factors: tuple[tuple[str, int], ...] = ()  # individual, side and status, by the name that `Landmarks` has for them


_OF_SHAPES = (("specimen", "centroid_size"), ("component", "of"), ("group", "specimens"))
"""Columns by which the tables of shapes of ``liaam measure`` are known; a unit may follow the second."""


class _Stated(NamedTuple):
    """What is stated of an object: what it is a structure of, and how its fit ended."""

    individual: str = ""
    side: str = ""
    status: str = ""


def _check_width(header: Sequence[str], row: TableLine) -> TableLine:
    if len(row[1]) != len(header):
        raise LandmarkError(f"line {row[0]} has {len(row[1])} cells but the header {len(header)}: correct the line.")
    return row


def whole(source: Source, header: Sequence[str], rows: Sequence[TableLine]) -> list[TableLine]:
    """Return the rows that have as many cells as the header, and leave out others."""
    return list(source.each(((f"line {row[0]}", row) for row in rows), partial(_check_width, header)))


def _refuse_shapes(source: Source, cells: Iterable[str]) -> None:
    """Raise if a table is one of shapes that ``liaam measure`` wrote; ``cells`` are its coordinates.

    Shapes are of centroid size 1. Other programs may have such columns beside positions.
    """
    known = any(
        first in source.header and any(re.fullmatch(rf"{second}(_[a-z]+)?", title) for title in source.header)
        for first, second in _OF_SHAPES
    )
    if known and all(abs(float(cell)) <= 1 for cell in cells if is_number(cell)):
        what = "it is a table of 'liaam measure', whose coordinates are those of shapes, not positions in images"
        raise LandmarkError(f"{what}: give the landmarks that were measured.")


def is_of_imagej(source: Source) -> bool:
    """Whether a table holds ImageJ's results, which are in the unit of the image if that is calibrated."""
    header = source.rows[0][1]
    # Its first column has a blank as its name, or one of two is "Label".
    return {"X", "Y"} <= {*header} and (source.text[:2] in (" ,", " \t") or "Label" in header[:2])


def parse_long(source: Source, first: int = 1) -> list[Landmarks]:
    """Parse landmarks of one image, or of many images if a column names the image; `first` is the number of its header.

    Rows without names are in the order of the landmarks; numbered ones are sorted. Empty x and y mean a missing
    landmark. ImageJ's results count from the corner of the first pixel, so half a pixel is subtracted.
    """
    header = source.header
    numbered = [(number + first - 1, row) for number, row in source.rows[1:] if any(row) or len(row) == len(header)]
    rows = [_check_width(header, row) for row in numbered]
    _refuse_shapes(source, (row[header.index(axis)] for _, row in rows for axis in "xy" if axis in header))
    columns = columns_of(header, [row for _, row in rows])
    if columns.landmark is not None and header[columns.landmark] not in LANDMARKS | {*UNCLEAR}:
        source.notes.say("landmarks are named by the values of a column", header[columns.landmark])
    shift = 0.5 if is_of_imagej(source) else 0.0

    def make(group: tuple[tuple[str, str], list[TableLine]]) -> Landmarks:
        (image, specimen), lines = group
        points = []
        for number, row in lines:
            point = parse_point((row[columns.x], row[columns.y]), f"line {number}")
            seen = "1" if columns.visible is None else row[columns.visible].strip().lower()
            points.append(NOWHERE if point == (0.0, 0.0) and seen in ("0", "false") else point)
        names = () if columns.landmark is None else tuple(row[columns.landmark] for _, row in lines)
        names = names if any(names) else ()
        size = size_of(dict(zip(("width", "height"), (lines[0][1][i] for i in columns.size), strict=False)))
        stated = _Stated(**{name: _common(row[i] for _, row in lines) for name, i in columns.factors})
        return Landmarks(
            np.array(points) - shift,
            (),
            names,
            image or None,
            label=specimen,
            placing=Placing(size),
            **stated._asdict(),
        )

    groups = ((group[0][0] or "its table", group) for group in _grouped(source, rows, columns))
    made = list(source.each(groups, make))
    numbers = columns.landmark is not None and header[columns.landmark] != "name"
    return named_points(source, made, numbers) if columns.image is not None or numbers else made


def _common(cells: Iterable[str]) -> str:
    """Return the value that cells have in common, empty ones left out; empty if they differ."""
    values = {cell.strip() for cell in cells} - {""}
    return values.pop() if len(values) == 1 else ""


def factors_of(header: Sequence[str]) -> tuple[tuple[str, int], ...]:
    """Return the columns of the individual, the side and the status of objects, in a header in lower case.

    Individuals are specimens where no other column names these.

    Raises
    ------
    LandmarkError
        If there are two columns of sides.
    """
    known = {*header}
    has_names = bool(known & (IMAGES | (SPECIMENS - INDIVIDUALS)))
    found = [("individual", i) for i, name in enumerate(header) if name in INDIVIDUALS and has_names]
    sides = [("side", i) for i, name in enumerate(header) if name == SIDE]
    if len(sides) > 1:
        raise LandmarkError(f"there are {len(sides)} columns '{SIDE}': keep one, with left or right in each row.")
    statuses = [("status", i) for i, name in enumerate(header) if name == STATUS]
    return (*found[:1], *sides, *statuses[:1])


def _filled(source: Source, rows: list[TableLine], column: int | None) -> list[str]:
    """Return the names of the images or specimens of rows, which exports of merged cells give in the first row only."""
    if column is None:
        return [""] * len(rows)
    names = filled([row[column] for _, row in rows])
    for name, (_, row) in zip(names, rows, strict=True):
        if name and not row[column]:
            source.notes.say("rows without a name of the image or specimen belong to the one above", name)
    return names


def _grouped(
    source: Source, rows: list[TableLine], columns: Columns
) -> Iterator[tuple[tuple[str, str], list[TableLine]]]:
    """Yield the image and the specimen of each object, and its rows.

    The rows of an image whose every landmark occurs as often are those of several specimens or replicates.
    """
    groups = defaultdict[tuple[str, str], list[TableLine]](list)
    images = map(without_title, _filled(source, rows, columns.image))
    for image, specimen, row in zip(images, _filled(source, rows, columns.specimen), rows, strict=True):
        groups[image, specimen.strip()].append(row)
    for (image, specimen), lines in groups.items():
        parts = defaultdict[int, list[TableLine]](list)
        seen = Counter[str]()
        for number, row in lines:
            name = "" if columns.landmark is None else row[columns.landmark].strip()
            seen[name] += 1
            parts[seen[name]].append((number, row))
        if columns.image is None or "" in seen or len({*map(len, parts.values())}) > 1:
            parts = {1: lines}
        for i, part in parts.items():
            yield (image, specimen if i == 1 else f"{specimen}{i}"), part


_Pairs = dict[str, dict[str, int]]  # indices of columns by landmark and axis


def parse_wide(source: Source) -> list[Landmarks]:
    """Parse a row of landmarks for each image, such as ml-morph's and MorphoJ's (``id,X1,Y1,X2,...``).

    Columns of x and y have a number or the landmark's name before or behind the axis. Rows are named by a column for
    the image or specimen, or else by the only other column with text.
    """
    (_, header), *rows = source.rows
    rows = whole(source, header, [row for row in rows if any(row[1])])
    given = pairs_of(header)
    others = [key for key in given if not key.isdigit()]
    if len(others) < len(given) - 1:
        for key in others:
            source.notes.say("columns of x and y beside those of numbered landmarks are not read", key)
            del given[key]
    numbered = all(map(str.isdigit, given))
    if numbered:
        _check_pairs(header, given)
    pairs = {key: given[key] for key in sorted(given, key=natural_key)} if numbered else given
    if any("z" in axes for axes in pairs.values()):
        raise LandmarkError("it has columns of z: export x and y only.")
    used = {i for axes in pairs.values() for i in axes.values()}
    _refuse_shapes(source, (row[i] for _, row in rows for i in used))
    name = name_column(source.header, [row for _, row in rows], used)
    # Numbers out of order may be the names of landmarks in another order.
    named = not numbered or list(pairs) != list(given)
    factors = tuple((factor, i) for factor, i in factors_of(source.header) if i != name and i not in used)
    return _of_rows(source, rows, {"": pairs}, lambda row: None if name is None else row[name].strip(), named, factors)


def _check_pairs(header: list[str], pairs: _Pairs) -> None:
    """Raise if a numbered landmark has one column only: without it, those after it would have other numbers."""
    for i, key, axis in _columns_of_axes(header):
        if key.isdigit() and key not in pairs:
            other = {"x": "y", "y": "x"}.get(axis.lower())
            if other is not None:
                title = header[i].strip()
                missing = re.sub(axis, other.upper() if axis.isupper() else other, title, count=1)
                raise LandmarkError(f"the column '{title}' has no column '{missing}' beside it: correct the headings.")


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
    rows = whole(source, coords, rows[len(headers) :])
    first = next((i for i, cell in enumerate(coords) if cell in ("x", "y")), len(coords))
    scorer, *others = dict.fromkeys(headers["scorer"][first:]) or [""]
    if others:
        source.notes.say(f"of several scorers '{scorer}' is read", source.path.name)
    objects = defaultdict[str, _Pairs](lambda: defaultdict(dict))
    for i in range(first, len(coords)):
        if headers["scorer"][i] == scorer and coords[i] in ("x", "y"):
            individual = headers["individuals"][i] if "individuals" in headers else ""
            objects[individual][headers["bodyparts"][i]][coords[i]] = i
    parsed = _of_rows(source, rows, objects, lambda row: "/".join(cell for cell in row[:first] if cell))
    return [landmarks for landmarks in parsed if not landmarks.missing.all()]


def _of_rows(
    source: Source,
    rows: list[TableLine],
    objects: dict[str, _Pairs],
    image_of: Callable[[list[str]], str | None],
    named: bool = True,
    factors: Sequence[tuple[str, int]] = (),
) -> list[Landmarks]:
    """Return the landmarks of the objects of each row."""

    def make(part: tuple[TableLine, str]) -> Landmarks:
        (number, row), label = part
        pairs = objects[label]
        points: Any = [parse_point((row[axes["x"]], row[axes["y"]]), f"line {number}") for axes in pairs.values()]
        names = tuple(pairs) if named else ()
        stated = _Stated(**{factor: row[i].strip() for factor, i in factors})
        return Landmarks(points, (), names, image_of(row), label=label, **stated._asdict())

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
        name = words[at]
        values = words[1:] if at == 0 else words[:-1]
        return name, np.array([parse_point(pair, f"'{name}'") for pair in zip(values[::2], values[1::2], strict=True)])

    rows = list(source.each(((f"line {i}", words) for i, words in enumerate(lines, 1)), make))
    whole = len(rows) == len(lines)
    wflw = whole and all(
        len(row_values) > _WFLW + 1 and {*row_values[-3:].flat} <= {0.0, 1.0} for _, row_values in rows
    )
    last = _WFLW if wflw and all((row_values[-_WFLW] < row_values[1 - _WFLW]).all() for _, row_values in rows) else 0
    first = 0
    if whole and not last and len(rows) >= _FEW:
        first = 2 if all(_has_box(pairs) for _, pairs in rows) else 0
        last = 2 if all(_has_box(np.roll(pairs, 2, axis=0)) for _, pairs in rows) else 0
    for where in ["before"] * (first > 0) + ["behind"] * (last == 2):
        source.notes.say(f"four numbers {where} the points are taken for a box around them", source.path.name)
    return [Landmarks(pairs[first : len(pairs) - last], image_name=name) for name, pairs in rows]


def _has_box(pairs: np.ndarray) -> bool:
    """Whether the first four numbers are a box around all points: two corners, or one and the size."""
    if len(pairs) < 2 + _FEW:
        return False
    corner = pairs[0]
    other = pairs[1]
    low = pairs[2:].min(axis=0)
    high = pairs[2:].max(axis=0)
    around = (other >= high).all() or (corner + other >= high).all()
    return bool((corner <= low).all() and around and (other > 0).all())


def filled(values: Iterable[str]) -> list[str]:
    """Fill empty cells with those above them, as merged cells are exported."""
    return list(accumulate(values, lambda last, value: value or last))


def has_points(header: Sequence[str]) -> bool:
    """Return whether a header has columns x and y."""
    return {"x", "y"} <= {match[1] for match in map(_AXIS.fullmatch, header) if match is not None}


def columns_of(header: list[str], rows: Sequence[Sequence[str]]) -> Columns:
    """Find the columns of a table with a header in lower case. Raise if its meaning is ambiguous."""
    axes: dict[str, int] = {}
    for axis in "xy":
        matching = [i for i, name in enumerate(header) if (match := _AXIS.fullmatch(name)) and match[1] == axis]
        first, *others = [i for i in matching if header[i] == axis] or matching
        if others:
            both = f"and '{header[first]}' both may be {axis}: name one of them {axis}"
            raise _ambiguous(header, both, others[0])
        axes[axis] = first
    values = [[row[i].strip() for row in rows] for i in range(len(header))]
    texts = [i for i in range(len(header)) if i not in axes.values()]
    image = _one(header, values, [i for i in texts if header[i] in IMAGES or _are_files(values[i])])
    has_others = any(header[i] in SPECIMENS - INDIVIDUALS for i in texts)
    specimens = SPECIMENS - INDIVIDUALS if has_others else SPECIMENS
    specimen = _one(header, values, [i for i in texts if header[i] in specimens])
    landmark = _one(header, values, [i for i in texts if header[i] in LANDMARKS])
    if image in (None, specimen):
        image = specimen
        specimen = None
    unclear = [i for name in UNCLEAR for i in texts if header[i] == name and i not in (image, specimen, landmark)]
    for i in unclear:
        present = [value for value in values[i] if value]
        if image is None and header[i] != "name" and _in_blocks(values[i]):
            image = i
        elif landmark is None and (header[i] in ("name", "label") or len({*present}) < len(present)):
            if image is not None and len({*zip(values[image], values[i], strict=True)}) == len({*values[image]}):
                continue  # one value an image
            landmark = i
    if image is None:
        _check_one_image(header, values, texts, landmark)
        names = [i for i in texts if _name_rows(header[i], values[i])]
        landmark = names[0] if landmark is None and len(names) == 1 else landmark
    elif landmark is None:
        keys = list(zip(filled(values[image]), values[image if specimen is None else specimen], strict=True))
        landmark = next((i for i in texts if i not in (image, specimen) and _tells_apart(keys, values[i])), None)
    sizes = [tuple(i for name in names for i in texts if header[i] == name) for names in SIZES]
    pairs = chain(*(zip(values[axes[axis]], values[i], strict=True) for i, axis in zip(sizes[-1], "xy", strict=False)))
    if any(is_number(at) and is_number(side) and float(at) > float(side) for at, side in pairs):
        sizes.pop()  # width and height are those of boxes, since points lie beyond
    size = next((pair for pair in sizes if len(pair) == 2), ())
    visible = next((i for i in texts if header[i] in VISIBLE), None)
    # Individuals tell the objects of an image apart where no other column does, and are what these are structures of.
    factors = tuple((name, i) for name, i in factors_of(header) if i not in (image, landmark))
    if specimen is not None and header[specimen] not in INDIVIDUALS:
        factors = tuple((name, i) for name, i in factors if i != specimen)
    return Columns(axes["x"], axes["y"], image, specimen, landmark, visible, size, factors)


def _name_rows(title: str, values: Sequence[str]) -> bool:
    """Return whether a column names each row of an image by another text, or numbers them in another order."""
    if not len({*values}) == len(values) > 1 or "" in values:
        return False
    numbers = sorted(values, key=natural_key)
    counted = numbers in ([str(i + first) for i in range(len(values))] for first in (0, 1))
    return not any(map(is_number, values)) or (title in UNCLEAR and counted and numbers != [*values])


def _tells_apart(keys: Sequence[tuple[str, str]], values: Sequence[str]) -> bool:
    """Return whether a column holds each of the same few values once in each image, as names of landmarks do."""
    groups = defaultdict[tuple[str, str], list[str]](list)
    for key, value in zip(keys, values, strict=True):
        groups[key].append(value)
    most = max(groups.values(), key=len, default=[])
    alike = all(len(set(cells)) == len(cells) and set(cells) <= set(most) for cells in groups.values())
    return alike and len(groups) > 1 < len(most)


def pairs_of(header: list[str]) -> dict[str, dict[str, int]]:
    """Return the indices of the columns of x and y by landmark, in a table of one row an image.

    Positions in space (``X_0``, ``Y_0``, ``Z_0``) are not read beside those in the image (``x_0``, ``y_0``).
    """
    columns = list(_columns_of_axes(header))
    kinds = {(key, axis.isupper()) for _, key, axis in columns}
    in_space = {(key, axis.isupper()) for _, key, axis in columns if axis in "zZ" and (key, axis.islower()) in kinds}
    pairs = defaultdict[str, dict[str, int]](dict)
    columns = [(i, key, axis.lower()) for i, key, axis in columns if (key, axis.isupper()) not in in_space]
    for i, key, axis in columns:
        at = pairs[key].setdefault(axis, i)
        if at != i:
            both = f"'{header[at]}' and '{header[i]}' both may be {axis} of '{key}'"
            raise LandmarkError(f"the columns {both}: remove one of them.")
    return {key: axes for key, axes in pairs.items() if {"x", "y"} <= axes.keys()}


def _columns_of_axes(header: list[str]) -> Iterator[tuple[int, str, str]]:
    """Yield the index, the landmark and the axis of the columns of landmarks. Repeated x, y are numbered."""
    cells = [cell.strip() for cell in header]
    numbers = defaultdict[str, Iterator[int]](count)
    axes = [cell for cell in cells if cell in ("x", "y", "X", "Y")]
    numbered = len(axes) > len({*axes}) or any(re.fullmatch(r"[xyXY]\.1", cell) for cell in cells)
    for i, cell in enumerate(cells):
        title = f"{cell}.{next(numbers[cell])}" if numbered and cell in ("x", "y", "X", "Y") else cell
        match = next(filter(None, (re.fullmatch(form, title, re.IGNORECASE) for form in _FORMS)), None)
        if match is not None and plain(match["key"]) not in _OTHERS:
            yield i, match["key"], match["axis"]


def name_column(header: list[str], rows: Sequence[Sequence[str]], used: set[int]) -> int | None:
    """Return the column that names the images in a table of one row an image; `used` are those of x and y."""
    others = [i for i in range(len(header)) if i not in used]
    for names in (IMAGES, SPECIMENS, {*UNCLEAR, ""}):
        candidates = [i for i in others if header[i] in names and all(row[i].strip() for row in rows)]
        pixels = [header[i] for i in candidates if all(re.fullmatch(r"\d+(\s+\d+)+", row[i].strip()) for row in rows)]
        if pixels:
            raise LandmarkError(f"the column '{pixels[0]}' holds the images' pixels: put their names in its place.")
        if candidates:
            return candidates[0]
    texts = [i for i in others if not all(re.fullmatch(r"[-\d.]*", row[i].strip()) for row in rows)]
    if len(texts) == 1 and header[texts[0]] in LANDMARKS:
        raise LandmarkError("it has a row for each landmark and columns for each image: exchange rows and columns.")
    if len(texts) == 1 or len(rows) < 2:
        return texts[0] if len(texts) == 1 else None
    named = f" (the columns {', '.join(repr(header[i]) for i in texts)} may)" if texts else ""
    raise LandmarkError(f"no column names the images{named}: name it 'image'.")


def _check_one_image(header: list[str], values: list[list[str]], texts: list[int], landmark: int | None) -> None:
    """Raise if a table without a column for images seems to hold several."""
    counts = Counter(values[landmark]) if landmark is not None else Counter[str]()
    if landmark is not None and len(counts) > 1 and len({*counts.values()} - {1}) == len({*counts.values()}) == 1:
        raise _ambiguous(header, "repeats its names, but no column names the images: add a column 'image'", landmark)
    for i in texts if landmark is None else ():
        if header[i] and _in_blocks(values[i]) and not all(map(is_number, values[i])):
            raise _ambiguous(header, "may name the images: name it 'image' if so, or else remove it", i)


def _one(header: list[str], values: list[list[str]], candidates: list[int]) -> int | None:
    """Return one of the columns of a meaning; raise if they divide the rows differently."""
    first = next((i for i in candidates if _are_files(values[i])), candidates[0] if candidates else None)
    for i in candidates:
        if first is not None and len(set(zip(values[first], values[i], strict=True))) != len(set(values[first])):
            raise _ambiguous(header, f"and '{header[first]}' both may name the same: remove one of them", i)
    return first


def _ambiguous(header: list[str], why: str, column: int) -> LandmarkError:
    return LandmarkError(f"the column '{header[column]}' {why}.")


def _are_files(values: Sequence[str]) -> bool:
    return any(values) and all(names_picture(without_title(value)) for value in {*values} - {""})


def _in_blocks(values: Sequence[str]) -> bool:
    """Return whether rows of one value follow each other, for several values that each have several rows."""
    sizes = [len(list(group)) for _, group in groupby(values)]
    return 1 < len(sizes) == len(set(values)) and min(sizes) > 1
