"""What the readers of all formats share: how to read, what to say about a file, its text, numbers, and names."""

import csv
import io
import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

from liaam.errors import LandmarkError
from liaam.io.files import is_number, natural_key, read_bytes, some_names
from liaam.io.landmarks.base import Landmarks, Placing, Size, without_zeros

MAX_BYTES = 500_000_000  # of a landmark file
MAX_BINARY = 100_000_000  # bytes of a landmark file that is no text
MAX_LINES_OF_NUMBERS = 1_000_000  # letters of a file of few lines of numbers, such as YOLO's of one image

TableLine = tuple[int, list[str]]  # a line number, and the cells of the line

_UNIT = re.compile(r"[(\[]\s*([munµμ]?m|cm|microns?|in|inch(?:es)?|%|percent)\s*[)\]]", re.IGNORECASE)
_SUMMARY = {"Mean", "SD", "Min", "Max"}  # labels of rows that ImageJ adds below its results
_SEPARATED = re.compile(r"\s*([^\s,;]+)\s*[,;]\s*([^\s,;]+)\s*")  # x and y with a comma or semicolon between them
_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0e-\x1f]")  # characters that binary files hold and text does not
_MARKED = re.compile(r"[-+]?\d+[.,]\d+")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}[.,]\d{3}")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
_ABSENT = (-1.0, -999.0, -9999.0)  # what programs write for x and y of a missing landmark
_MISSING_WORDS = frozenset({"", "nan", "na", "n/a", "#n/a", "none", "null", "missing", "?", "-", "."})

T = TypeVar("T")
R = TypeVar("R")

# Errors of a reader where parts of a file are absent, or are of another type.
LACKING = (TypeError, KeyError, IndexError, ValueError, AttributeError, OverflowError)

_MOST_COMPARED = 1_000_000  # pairs of a point and a box of an image

NOWHERE = (math.nan, math.nan)
MISSING, HIDDEN, SEEN = range(3)  # how a landmark is marked
Box = tuple[float, float, float, float]  # left, top, right, bottom
Mark = tuple[Any, ...]  # the name of a landmark, x and y as numbers or text, and how it is marked


class UnrecognisedError(LandmarkError):
    """A text file that seems to hold no landmarks, such as a README."""


@dataclass(frozen=True)
class Reading:
    """How to read landmark files.

    Attributes
    ----------
    strict : bool
        Whether to refuse a file for one bad record, instead of leaving the record out.
    category : str, optional
        Name or number of the COCO category, label of CVAT's skeletons or dlib's boxes, or group of a menpo ``.ljson``
        that is the object.
    y_down : bool
        Whether ``.tps`` and ``.nts`` count y from the top, as some programs write them.
    stored : bool
        Whether positions are for photos as stored, before their EXIF orientation turns them.
    """

    strict: bool = False
    category: str | None = None
    y_down: bool = False
    stored: bool = False


USUAL = Reading()


@dataclass
class Notes:
    """What has to be said about a file: records that are left out, and what was done with others."""

    strict: bool = False
    left_out: dict[str, str] = field(default_factory=dict)  # reasons by record
    done: dict[str, list[str]] = field(default_factory=dict)  # records or images, by what was done with them

    def leave_out(self, which: str, why: LandmarkError | str) -> None:
        """Note that a record is left out; raise instead if strict."""
        if self.strict:
            raise why if isinstance(why, LandmarkError) else LandmarkError(f"{which}: {why}.")
        self.left_out.setdefault(which, str(why))

    def repair(self, what: str, which: str) -> None:
        """Note what was done with a faulty record; raise instead if strict."""
        if self.strict:
            raise LandmarkError(f"{what}: {which}.")
        self.say(what, which)

    def say(self, what: str, which: str) -> None:
        """Note what was done with a record or an image."""
        self.done.setdefault(what, []).append(which)

    def lines(self) -> list[str]:
        """Return one line for all that is left out, and one for each thing that was done."""
        lines = [f"{what}: {some_names(list(dict.fromkeys(which)))}" for what, which in self.done.items()]
        if not self.left_out:
            return lines
        (first, why), *more = self.left_out.items()
        others = f"; so are {some_names([name for name, _ in more], 20)}" if more else ""
        return [f"left out {first}{others} (because {why.rstrip('.')})", *lines]


@dataclass(frozen=True)
class Source:
    """The text of a landmark file, for the readers. What they raise does not name the file, which their caller does."""

    path: Path
    text: str
    reading: Reading = USUAL
    notes: Notes = field(default_factory=Notes)
    data: bytes = b""  # of a file that is no text

    @cached_property
    def json(self) -> Any:
        """Its content as JSON."""
        return json_of(self.text)

    @property
    def object(self) -> dict[str, Any]:
        """Its content as a JSON object; empty if it is something else."""
        return self.json if isinstance(self.json, dict) else {}

    @cached_property
    def xml(self) -> Any:
        """Its root element as XML. What could define entities or read other files is refused."""
        lower = self.text.lower()
        if "<!doctype" in lower or "<!entity" in lower:
            raise LandmarkError("it declares a document type or entities, which is not safe to read: remove that part.")
        try:
            return ElementTree.fromstring(self.text)
        except (ElementTree.ParseError, ValueError) as fault:
            raise LandmarkError(f"this is not complete XML ({fault}); it may be cut short: export it again.") from fault

    @cached_property
    def rows(self) -> list[TableLine]:
        """Its rows of cells, without blank ones. Decimal commas become points if commas do not separate."""
        return table_rows(self.text)

    @cached_property
    def header(self) -> list[str]:
        """Its first row in lower case, without units in brackets and marks between words."""
        return list(map(plain, self.rows[0][1]))

    @cached_property
    def lines(self) -> list[str]:
        """Its lines that are not blank, without blanks at their ends."""
        return [line for line in map(str.strip, self.text.splitlines()) if line]

    def each(self, records: Iterable[tuple[str, T]], make: Callable[[T], R]) -> Iterator[R]:
        """Yield what is made of each record; leave out those with faults. Raise the first fault if none is sound."""
        first = None
        some = False
        for which, record in records:
            try:
                made = make(record)
            except (LandmarkError, *LACKING) as fault:
                if not isinstance(fault, LandmarkError):
                    fault = LandmarkError(f"{which} lacks parts or has others: export the file again.")
                first = first or fault
                self.notes.leave_out(which, fault)
            else:
                some = some or made is not None
                yield made
        if first is not None and not some:
            raise first


def table_rows(text: str) -> list[TableLine]:
    """Return the rows of cells of a table, as people and programs save it.

    The separator is that of the header, or that which Excel declares (``sep=;``). Decimal commas become points if
    commas do not separate. Names of rows, which R writes without a title, and ImageJ's summary are no cells of columns.

    Raises
    ------
    LandmarkError
        If quotes do not match, or numbers have commas as well as points.
    """
    text = re.sub(r"\A(?:[^\S\r\n]*[\r\n])+", "", text)
    separator = ""
    declared = re.match(r"\"?sep=(.)\"?[^\S\n\r]*[\r\n]+", text, re.IGNORECASE)
    if declared is not None:  # as Excel writes it
        separator = declared[1]
        text = text[declared.end() :]
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
        too_long = "field larger" in str(fault)
        remedy = "end the quotes, or export JSON if cells are that long" if too_long else "export it again"
        raise LandmarkError(f"this is not a CSV table ({fault}): {remedy}.") from fault
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


def json_of(text: str) -> Any:
    """Parse JSON."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as fault:
        why = short(str(fault), 100)
        raise LandmarkError(f"this is not complete JSON ({why}): it may be cut short; export it again.") from fault


def size_of(record: Any, *keys: str) -> Size | None:
    """Return the width and height, which may have other keys, of an image that a record states, if it does."""
    width, height = map(record.get, keys or ("width", "height"))
    return (float(width), float(height)) if area_of(width, height) > 0 and float(width) > 0 else None


def area_of(*sides: Any) -> float:
    """Return an area, or the product of the sides of a box; 0 if it is not known."""
    try:
        area = math.prod(map(float, sides))
    except (TypeError, ValueError, OverflowError):
        return 0.0
    return area if sides and math.isfinite(area) else 0.0


def object_of(marks: Iterable[Mark], image: str | None, size: Size | None = None, label: str = "") -> Landmarks:
    """Make the landmarks of an object as an annotation tool has them."""
    marks = list(marks)
    of = f" of '{image}'" if image else ""
    points: Any = [parse_point(at, f"point '{name}'{of}") if how else NOWHERE for name, *at, how in marks]
    hidden = tuple(i for i, mark in enumerate(marks) if mark[-1] == HIDDEN)
    names = names_of([mark[0] for mark in marks])
    return Landmarks(points, (), names, image, hidden, label=label, placing=Placing(size))


def in_boxes(marks: Iterable[Mark], boxes: Sequence[Box]) -> list[list[Mark]]:
    """Return the marks inside each box; raise if one lies in none, or in several."""
    marks = list(marks)
    if len(marks) * len(boxes) > _MOST_COMPARED:
        raise LandmarkError(f"{len(marks):,} points and {len(boxes):,} boxes are too many: group the points by object.")
    inside: list[list[Mark]] = [[] for _ in boxes]
    for mark in marks:
        x, y = parse_point(mark[1:3], f"point '{mark[0]}'")
        holding = [i for i, (left, top, right, bottom) in enumerate(boxes) if left <= x <= right and top <= y <= bottom]
        if len(holding) != 1:
            several = "in several boxes" if holding else "in no box"
            raise LandmarkError(f"point '{short(str(mark[0]))}' lies {several}: group the points by object.")
        inside[holding[0]].append(mark)
    return [marks_inside for marks_inside in inside if marks_inside]


def names_of(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the labels of an object's points as their names; nothing if all have one label, or none."""
    counts = Counter(labels)
    if len(counts) == 1 < len(labels) or not any(labels):
        return ()
    if counts[""] > 1:
        raise LandmarkError(f"{counts['']} of the points of an object have no name: name each of them, or none.")
    twice = [label for label, n in counts.items() if n > 1]
    if twice:
        raise LandmarkError(f"there are several points '{short(twice[0])}' in an object: group the points by object.")
    return tuple(labels)


def numbered_alike(objects: Sequence[Landmarks]) -> Sequence[Landmarks]:
    """Return landmarks whose numbers have no decimals, and no zeros in front if others lack these: 1, 01 and 1.0."""
    names = {name for landmarks in objects for name in landmarks.names}
    plain = {name: re.sub(r"\A(\d+)\.0+\Z", r"\1", name) for name in names}
    bare = {name: without_zeros(plain[name]) for name in names}
    plain = bare if len({*bare.values()}) < len({*plain.values()}) else plain
    alike = [tuple(plain[name] for name in landmarks.names) for landmarks in objects]
    if any(len({*each}) < len({*landmarks.names}) for each, landmarks in zip(alike, objects, strict=True)):
        return objects
    return [replace(landmarks, names=each) for landmarks, each in zip(objects, alike, strict=True)]


def named_points(source: Source, objects: Sequence[Landmarks], numbers: bool = True) -> list[Landmarks]:
    """Make landmarks of many images alike by their names.

    Where an image lacks some of the names that most have, these landmarks are missing. It is left out where it has
    names that most lack, or has a name twice. If asked for, numbers are sorted, and those from 1 on are no names.
    """
    objects = numbered_alike(objects)
    counts = Counter(name for landmarks in objects for name in set(landmarks.names))
    n_named = sum(bool(landmarks.names) for landmarks in objects)
    common = {name for name, count in counts.items() if name and 2 * count >= n_named}
    fullest = max((landmarks.names for landmarks in objects), key=lambda names: len(common & {*names}), default=())
    usual = [name for name in dict.fromkeys((*fullest, *counts)) if name in common]
    numbers = numbers and all(name.isascii() and name.isdigit() for name in usual)
    usual = sorted(usual, key=natural_key) if numbers else usual
    counted = numbers and [name.lstrip("0") for name in usual] == [str(i + 1) for i in range(len(usual))]

    def alike(landmarks: Landmarks) -> Landmarks:
        odd = [name for name, count in Counter(landmarks.names).items() if name not in common or count > 1]
        if odd:
            raise LandmarkError(f"its landmark '{short(odd[0])}' occurs twice, or in few others.")
        if not landmarks.names or (len(landmarks) == len(usual) and not numbers):
            return landmarks
        return replace(landmarks.with_names(usual), names=() if counted else tuple(usual))

    return list(
        source.each(((landmarks.label or landmarks.image_name or "", landmarks) for landmarks in objects), alike)
    )


def of_category(
    source: Source, objects: Iterable[tuple[str, Landmarks]], titles: Mapping[str, str] = {}, alike: bool = True
) -> list[Landmarks]:
    """Return the landmarks of the category that is asked for, or else that has more of them, then more images.

    A category has a key and may have a title. Those of the same names are one, if they may be alike.
    """
    objects = list(objects)
    groups = defaultdict[str, list[Landmarks]](list)
    for key, landmarks in objects:
        groups[key].append(landmarks)
    named = {key: titles.get(key, key) for key in groups}
    wanted = source.reading.category
    if wanted is not None:
        chosen = {key for key in groups if wanted.casefold() in (key.casefold(), named[key].casefold())}
        if not chosen:
            has = some_names(list(dict.fromkeys(named.values())))
            raise LandmarkError(f"no landmarks of the category '{wanted}': it has {has}.")
        return [landmarks for key, landmarks in objects if key in chosen]

    def rank(key: str) -> tuple[int, int]:
        usual = Counter(map(len, groups[key])).most_common(1)[0][0]
        return usual, len({landmarks.image_name for landmarks in groups[key]})

    kinds = {
        key: {*chain(*(landmarks.names for landmarks in groups[key]))} or rank(key)[0] if alike else key
        for key in groups
    }
    first, *others = sorted(groups, key=rank, reverse=True) if groups else [""]
    others = [key for key in others if kinds[key] != kinds[first]]
    if others and rank(others[0]) == rank(first):
        both = f"'{named[first]}' and '{named[others[0]]}'"
        raise LandmarkError(f"the categories {both} have as many landmarks and images: choose one with --category.")
    for key in others:
        what = f"left out the category '{named[key]}', because '{named[first]}' has more (--category chooses)"
        for landmarks in groups[key]:
            source.notes.say(what, landmarks.image_name or "")
    return [landmarks for key, landmarks in objects if key not in others]


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


@lru_cache(1000)
def plain(cell: str) -> str:
    """Return a column's name in lower case, without what is in brackets, unless it is a unit other than pixels."""
    without = re.sub(r"[(\[].*[)\]]", "", _UNIT.sub(r" \1", cell))
    return re.sub(r"[\s_.-]+", "_", without.strip().casefold()).strip("_")


def check_count(where: str, count: int, rows: Sequence[object]) -> None:
    """Raise unless there are as many rows of points as a line of the file promises."""
    if len(rows) != count:
        cut = "the file may be cut short: export it again"
        raise LandmarkError(f"the {where} promises {count} points but {len(rows)} are there; {cut}.")


def parse_number(value: Any, where: str) -> float:
    """Parse one coordinate as text or of JSON; NaN for null and the usual words for a missing value."""
    if is_number(value) and not isinstance(value, bool) and not (isinstance(value, str) and "_" in value):
        return float(value)
    if value is None or str(value).strip().lower() in _MISSING_WORDS:
        return math.nan
    what = f"'{short(str(value))}' in {where}"
    raise LandmarkError(f"{what} is not a number: correct it (decimal points, as in 12.5).")


def decimal(cell: str) -> str:
    """Replace a decimal comma, where commas do not separate."""
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell.strip()) else cell


def parse_point(tokens: Sequence[str], where: str) -> tuple[float, float]:
    """Parse x and y, both or neither of them missing."""
    x, y = (parse_number(token, where) for token in tokens)
    if math.isnan(x) != math.isnan(y):
        raise LandmarkError(f"{where} has only one of x and y: give both, or neither if the landmark is missing.")
    return NOWHERE if x == y and x in _ABSENT else (x, y)


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
