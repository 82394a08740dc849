"""Text files of points: 300-W, ``.tem``, ``.asf``, StereoMorph, Morphologika, lines of x and y, ``.tps`` and ``.nts``.

A missing landmark is written ``nan nan``, or by another of the usual words. In ``.tps`` and ``.nts`` y counts
**upwards from the bottom** row.
"""

import math
import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import is_number
from liaam.io.landmarks import reading as rd
from liaam.io.landmarks.base import Contour, Landmarks, Placing, chain_edges, contour_of, edges_from
from liaam.io.landmarks.matching import names_picture
from liaam.io.landmarks.reading import Source
from liaam.io.sides import OTHER_SIDE, side_of_text

_COUNT = re.compile(r"n_?points\s*(?:[:=]\s*)?(\S+)", re.IGNORECASE)  # \s*[:=]?\s* would backtrack
_COMMENT = re.compile(r"(#|//|%).*")
_ASF_COLUMNS = 7  # path, type, x, y, point, from, to; further columns are optional
_SHAPES = re.compile(r"<landmarks\.pixel\b[^<>]*>")
_SCALING = re.compile(r"<scaling(?=[\s>])[^<>]*>([^<]*)</scaling\s*>")
_UNITS = re.compile(r"<scaling\.units\b[^<>]*>([^<]*)</scaling\.units\s*>")
_SECTION = re.compile(r"^[ \t]*\[(\w+)\][^\S\n]*$", re.MULTILINE)  # of Morphologika
_IMAGE = re.compile(r"<image\.name\b[^<>]*>([^<]*)</image\.name\s*>")
_NUMBER = r"(?:[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan|na)"
_LINE = re.compile(
    rf"(?:\"?(?P<name>[^\"\t,;]*?[^\"\s,;])\"?[\s,;]+)?(?P<x>{_NUMBER})[\s,;]+(?P<y>{_NUMBER})", re.IGNORECASE
)
_UPWARDS = Placing(upwards=True)
_KEY = re.compile(r"([A-Za-z]\w*)\s*=\s*(.*)")
_MATRIX = re.compile(
    r"1\s+(?P<rows>\d{1,9})(?P<named>[lbe]?)\s+(?P<columns>\d{1,9})(?P<columns_named>l?)"
    r"(?:\s+(?P<missing>[01])(?:\s+(?P<value>-?(?:\d+(?:\.\d*)?|\.\d+)))?)?(?:\s+dim\s*=\s*(?P<dim>\d))?\s*",
    re.IGNORECASE,
)
_FEWEST = 2
_LONGEST = 300
_MISSING = 9999.0  # what Morphologika writes for a missing x or y


def parse_pts(source: Source) -> list[Landmarks]:
    """Parse 300-W: a header, then one ``x y`` per line between braces. (1, 1) is the centre of the top-left pixel."""
    text = "\n".join(_COMMENT.sub("", line) for line in source.text.splitlines())
    header, brace, rest = text.partition("{")
    if not brace:
        raise LandmarkError("there is no '{' before its points, so it is not a 300-W .pts file: export it again.")
    body, brace, _ = rest.partition("}")
    lines = [line for line in body.splitlines() if line.strip()]
    count = _COUNT.search(header)
    if count is not None:
        rd.check_count("header", rd.parse_count(count[1], "points"), lines)
    if not brace:
        raise LandmarkError("there is no '}' after its points; it may be cut short: export it again.")
    pairs = [rd.parse_pair(line, f"point {number}") for number, line in enumerate(lines, 1)]
    points: Any = [(x - 1, y - 1) for x, y in pairs]
    return [Landmarks(points)]


def parse_asf(source: Source) -> list[Landmarks]:
    """Parse the AAM-API's rows of points, in fractions of the image's size.

    x is multiplied by the width and y by the height (not by width - 1), as the AAM-API does; the result is a pixel
    centre counted from 0. ``connects from`` and ``connects to`` become contours. The last line names the image.
    """
    lines = [line for line in source.lines if not line.startswith("#")]
    if not lines:
        raise LandmarkError("it holds comments only; it may be cut short: export it again.")
    count = rd.parse_count(lines[0], "points")
    columns = [line.split() for line in lines[1:]]
    rows = [row for row in columns if len(row) >= _ASF_COLUMNS]
    rd.check_count("header", count, rows)
    points = {}
    edges = []
    for row in rows:
        index, _, target = (rd.parse_count(token, "a point") for token in row[4:7])
        if max(index, target) >= count:
            raise LandmarkError(f"it names point {max(index, target)}, but has points 0 to {count - 1}: correct it.")
        points[index] = [rd.parse_number(cell, f"point {index}") for cell in row[2:4]]
        edges.append((index, target))
    if len(points) < count:
        lacking = min({*range(count)} - points.keys())
        raise LandmarkError(f"there is no point number {lacking}: number the points 0 to {count - 1}.")
    host = lines[-1] if len(columns) > count else None
    ordered: Any = [points[i] for i in range(count)]
    return [Landmarks(ordered, chain_edges(edges), image_name=host, placing=Placing(fractions=True))]


def parse_tem(source: Source) -> list[Landmarks]:
    """Parse a template of WebMorph or Psychomorph: points, then lines, which are optional.

    The numbers are taken as pixel centres counted from 0. Neither program documents whether its origin is the centre
    or the corner of the first pixel, and landmarks are placed by hand to about a pixel. The lines become contours: a
    count, then for each 0 (open) or 1 (closed), the number of points and their indices from 0.
    """
    count = rd.parse_count(source.lines[0], "points")
    pairs = source.lines[1 : count + 1]
    rd.check_count("first line", count, pairs)
    points: Any = [rd.parse_pair(line, f"point {number}") for number, line in enumerate(pairs, 1)]
    tokens = " ".join(source.lines[count + 1 :]).split()
    contours = []
    numbers = (rd.parse_count(token, "a line template") for token in tokens)
    try:
        for _ in range(next(numbers) if tokens else 0):
            closed = next(numbers) == 1
            contours.append(contour_of([next(numbers) for _ in range(next(numbers))], closed))
    except StopIteration:
        raise LandmarkError("it ends within its line templates; it may be cut short: export it again.") from None
    return [Landmarks(points, tuple(contour for contour in contours if contour is not None))]


def parse_shapes(source: Source) -> list[Landmarks]:
    """Parse StereoMorph's matrix ``landmarks.pixel`` of name, x and y: centres counted from 0.

    ``scaling`` is the length of a pixel, in ``scaling.units``. Curves are not read.
    """
    start = _SHAPES.search(source.text)
    image = _IMAGE.search(source.text)
    matrix, end, _ = source.text[start.end() :].partition("</landmarks.pixel") if start else ("", "", "")
    if not end:
        raise LandmarkError("it is cut short within its landmarks: export it again.")
    lines = [line.strip() for line in matrix.splitlines() if line.strip()]
    rows = [re.split(r"\t+| +(?=\S+$)| +(?=\S+\s+\S+$)", line) for line in lines]
    rows = [[cell.strip("\"' ") for cell in row] for row in rows if len(row) in (2, 3) and row[-1].strip("\"'") != "y"]
    points: Any = [rd.parse_point(row[-2:], f"'{row[0]}'") for row in rows]
    names = tuple(row[0] for row in rows if len(row) == 3)
    scaling = _SCALING.search(source.text)
    length = scaling[1].strip() if scaling else ""
    scale = float(length) if is_number(length) and float(length) > 0 else None
    if scaling and scale is None and length.upper() not in ("NA", ""):
        source.notes.repair("there is no scale, because scaling is not a positive number", source.path.name)
    units = _UNITS.search(source.text)
    unit = units[1].strip("\"' \n\t") if units and scale else ""
    return [Landmarks(points, (), names, image[1].strip("\"' \n\t") if image else None, scale=scale, unit=unit)]


def is_morphologika(source: Source) -> bool:
    """Whether it has Morphologika's sections of counts and points."""
    names = {match[1].lower() for match in _SECTION.finditer(source.text)}
    return {"individuals", "landmarks", "rawpoints"} <= names


def parse_morphologika(source: Source) -> list[Landmarks]:
    """Parse Morphologika's points of specimens, of two dimensions: taken as centres counted from 0, y downwards.

    The names of specimens are those of images. A wireframe becomes the contours. Missing points are 9999.
    """
    matches = list(_SECTION.finditer(source.text))
    ends = [match.start() for match in matches[1:]] + [len(source.text)]
    parts = {
        match[1].lower(): [line.strip() for line in source.text[match.end() : end].splitlines() if line.strip()]
        for match, end in zip(matches, ends, strict=True)
    }
    n, n_points = (rd.parse_count(" ".join(parts[name]), name) for name in ("individuals", "landmarks"))
    if parts.get("dimensions", ["2"])[:1] != ["2"]:
        raise LandmarkError("it has points with x, y and z (Morphologika): export two dimensions.")
    if n * n_points == 0:
        raise LandmarkError(f"it says that it has {n} individuals of {n_points} landmarks: export it again.")
    lines = [line for line in parts["rawpoints"] if not line.startswith("'")]
    rd.check_count("file of Morphologika", n * n_points, lines)
    headings = [line.strip("' \t") for line in parts["rawpoints"] if line.startswith("'")]
    names = next((each for each in (parts.get("names", []), headings) if len(each) == n), None)
    names = names or [str(i + 1) for i in range(n)]
    edges = edges_from([[_whole(word) for word in line.split()] for line in parts.get("wireframe", [])], n_points)

    def make(i: int) -> Landmarks:
        rows = lines[i * n_points : (i + 1) * n_points]
        points: Any = [rd.parse_pair(line, f"point {number} of '{names[i]}'") for number, line in enumerate(rows, 1)]
        points = [rd.NOWHERE if x == y == _MISSING else (x, y) for x, y in points]
        return Landmarks(points, chain_edges(edges), image_name=names[i])

    return list(source.each(((names[i], i) for i in range(n)), make))


def _whole(word: str) -> int | str:
    """Return a word as a number if it is one."""
    return int(word) if word.isascii() and word.isdigit() and len(word) < 9 else word


def parse_lines(source: Source) -> list[Landmarks]:
    """Parse lines of x and y as of patternize, or with names: centres counted from 0, y downwards.

    HELEN's begin with the image's name. A first line with the number of points is skipped.
    """
    matches = lines_of(source)
    first = _first(source)
    points: Any = [rd.parse_point(match.group("x", "y"), match[0]) for match in matches]
    names = rd.names_of([match["name"] for match in matches if match["name"]])
    return rd.named_points(source, [Landmarks(points, (), names, None if first.isdigit() else first or None)])


def lines_of(source: Source) -> list[re.Match[str]]:
    """Match all lines, perhaps but the first, as ``x y`` or ``name x y``. Return none if some differ."""
    if len(max(source.lines, key=len)) > _LONGEST:
        return []
    lines = source.lines[1 if _first(source) else 0 :]
    for number, line in enumerate(lines):  # replace decimal commas, if x and y both have one
        cells = re.split(r"([\t;]|\s+)", line)
        made = list(map(rd.decimal, cells))
        lines[number] = "".join(made) if sum(map(operator.ne, made, cells)) == 2 else line
    matches = [match for match in map(_LINE.fullmatch, lines) if match is not None]
    alike = len({match["name"] is None for match in matches}) == 1
    whole = alike and len(matches) == len(lines) >= _FEWEST
    return matches if whole and _are_names([match["name"] for match in matches if match["name"]]) else []


def _are_names(words: Sequence[str]) -> bool:
    """Whether the words before x and y name landmarks, and not images; nor are more numbers, as of x, y, confidence."""
    parts = [word.split() for word in words]
    numbers = [[part for part in of_name if is_number(part)] for of_name in parts]
    if any(len(of_name) > 1 for of_name in numbers) or not all(map(str.isdigit, chain.from_iterable(numbers))):
        return False
    if any(map(names_picture, chain.from_iterable(parts))):
        return False
    # Numbered landmarks may lack, but not most of them.
    return numbers != parts or max(map(float, words), default=0.0) <= 2 * len(words)


def _first(source: Source) -> str:
    """Return the first line if it is one word: an image's name, or a number of points."""
    return source.lines[0] if len(source.lines[0].split()) == 1 and not _LINE.fullmatch(source.lines[0]) else ""


@dataclass(frozen=True)
class _Block:
    """A line ``KEY=VALUE``, with the lines up to the next."""

    where: str
    key: str
    value: str
    body: list[tuple[int, str]] = field(default_factory=list)


def is_tps(source: Source) -> bool:
    """Whether the first line is one of a record of tpsDig."""
    match = _KEY.fullmatch(source.lines[0])
    return match is not None and match[1].upper() in ("LM", "LM3")


def parse_tps(source: Source) -> list[Landmarks]:
    """Parse the records of tpsDig and geomorph.

    A record starts with ``LM=`` and its points; ``IMAGE=`` names the image, or else ``ID=`` without its extension.
    ``SCALE=`` is the length of a pixel. The points of ``CURVES=`` follow the landmarks, and each curve becomes a
    contour. Outlines, radii, variables and comments are skipped, but for ``COMMENT=side=left`` or ``right``. A missing
    landmark is ``NA NA`` (geomorph), ``NaN NaN``, or ``-1 -1`` (tpsDig). Records without points, of images not
    digitised yet, are skipped.
    """
    records: list[list[_Block]] = []
    for block in _blocks(source):
        if block.key in ("LM", "LM3"):
            records.append([])
        if not records:
            raise LandmarkError(f"{block.where} comes before any LM=: export the file again.")
        records[-1].append(block)
    if not records:
        raise LandmarkError(
            f"'{rd.short(source.lines[0])}' is not expected here, before any LM=: export the file again."
        )
    named = ((_facts(record).get("IMAGE") or _facts(record).get("ID") or record[0].where, record) for record in records)
    specimens = source.each(named, lambda record: _specimen(source, record, len(records) == 1))
    return [specimen for specimen in specimens if specimen]


def _blocks(source: Source) -> list[_Block]:
    blocks: list[_Block] = []
    for number, line in enumerate(map(str.strip, source.text.splitlines()), 1):
        match = _KEY.fullmatch(line)
        if match is not None:
            blocks.append(_Block(f"line {number} ('{rd.short(line)}')", match[1].upper(), match[2]))
        elif line and blocks:
            blocks[-1].body.append((number, line))
    return blocks


def _facts(record: list[_Block]) -> dict[str, str]:
    return {block.key: block.value for block in record if block.value or block.key == "SCALE"}


def _specimen(source: Source, record: list[_Block], only: bool) -> Landmarks | None:
    """Make the landmarks of a record; None if it has no points."""
    facts = _facts(record)
    curves = []
    section = ""
    points: Any = _points(record[0])
    for block in record[1:]:
        section = block.key if block.key in ("CURVES", "OUTLINES") else section
        block_points = _points(block) if block.key == "POINTS" else []
        if block_points and section == "CURVES":  # those of outlines are not used
            curves.append(Contour(tuple(range(len(points), len(points) + len(block_points)))))
            points = points + block_points
    if not points:
        return None
    name = facts.get("IMAGE") or facts.get("ID")
    if name is None and not only:
        raise LandmarkError(f"the record of {record[0].where} names no image: add a line IMAGE=, or ID=.")
    written = rd.decimal(facts.get("SCALE", ""))
    scale = float(written) if is_number(written) else 0.0
    if scale <= 0 and "SCALE" in facts:
        source.notes.repair("there is no scale, because SCALE= is not a positive number", name or source.path.name)
    label = facts.get("ID", "")
    length = scale if scale > 0 else None
    side = _side_in(facts.get("COMMENT", ""))
    return Landmarks(points, tuple(curves), image_name=name, scale=length, label=label, side=side, placing=_UPWARDS)


def _side_in(comment: str) -> str:
    """Return the side that a comment such as ``side=left`` states; empty if it states none."""
    match = _KEY.fullmatch(comment)
    side = side_of_text(match[2]) if match is not None and match[1].lower() == "side" else ""
    return side if side in OTHER_SIDE else ""


def _points(block: _Block) -> list[tuple[float, float]]:
    """Return as many points as a line promises."""
    if block.key == "LM3":
        raise LandmarkError(f"{block.where} begins points with x, y and z: export x and y only, as LM=.")
    if not (block.value.isascii() and block.value.isdigit()):
        raise LandmarkError(f"{block.where} has no number of points after '=': correct it, such as LM=12.")
    count = float(block.value)  # int has a limit of digits
    n = len(block.body)
    if n > count:
        number, line = block.body[int(count)]
        where = f"line {number} ('{rd.short(line)}')"
        raise LandmarkError(f"{where} is not expected here: correct the number of points above it, or remove it.")
    points = [rd.parse_pair(line, f"line {number}") for number, line in block.body]
    if n < count:
        promised = f"{rd.short(block.value)} points but {n} follow; the file may be cut short"
        raise LandmarkError(f"{block.where} promises {promised}: correct the number, or export the file again.")
    return points


def parse_nts(source: Source) -> list[Landmarks]:
    """Parse a matrix of NTSYS, a row of x y of each landmark for a specimen.

    The header has the number of rows and columns, an L (or B, E) behind the number of rows if these are named, whether
    values are missing and by which number, and ``DIM=2``. A matrix of two columns holds the landmarks of one image.
    """
    lines = [line for line in source.lines if not line.startswith(('"', "'"))]
    header = _MATRIX.fullmatch(" ".join(lines[0].split())) if lines else None
    if header is None:
        raise LandmarkError("there is no header of a matrix, such as '1 10L 16 0 DIM=2': export it again.")
    n = int(header["rows"])
    width = int(header["columns"])
    dim = int(header["dim"] or 2)
    if dim != 2 or width % 2:
        raise LandmarkError(f"it holds {width} columns of {dim} dimensions: export x and y only.")
    words = " ".join(lines[1:]).split()
    names, values = _labels_and_values(header, words, n, width) if n <= len(words) else ([], words)
    if len(values) != n * width or not values:
        raise LandmarkError(f"{n} x {width} numbers are promised but {len(values)} are there: export it again.")
    numbers = np.array([rd.parse_number(value, "a row") for value in values])
    if header["missing"] == "1" and header["value"]:
        numbers[numbers == float(header["value"])] = math.nan
    if width == 2:
        return [Landmarks(numbers.reshape(-1, 2), placing=_UPWARDS)]
    rows = zip(names, numbers.reshape(n, -1, 2), strict=True)
    named = ((name, (name, points)) for name, points in rows)
    return list(source.each(named, lambda row: Landmarks(row[1], image_name=row[0], placing=_UPWARDS)))


def _labels_and_values(header: re.Match[str], words: list[str], n: int, width: int) -> tuple[list[str], list[str]]:
    """Separate the names of rows, or their numbers, from the values."""
    kind = header["named"].lower()
    names = [str(i + 1) for i in range(n)]
    if kind == "l":
        names = words[:n]
        words = words[n:]
    words = words[width:] if header["columns_named"] else words
    if kind in ("b", "e") and len(words) == n * (width + 1):
        at = 0 if kind == "b" else width
        names = words[at :: width + 1]
        words = [word for i, word in enumerate(words) if i % (width + 1) != at]
    return (names if len(names) == n else [str(i + 1) for i in range(n)]), words
