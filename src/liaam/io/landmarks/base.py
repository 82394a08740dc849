"""The class `Landmarks`, and helpers shared by the readers of all landmark formats.

In liaam a landmark is (x, y) = (column, row) in pixels, with (0, 0) at the centre of the top-left pixel.
A missing landmark is (NaN, NaN). Each format's module converts from and to its own convention.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import count_of, natural_key, read_bytes, some_names

T = TypeVar("T")
R = TypeVar("R")

MAX_BYTES = 500_000_000
"""Size limit of landmark files, in bytes."""

_COMMAS = re.compile(r"\s*[^\s,]+\s*,\s*[^\s,]+\s*")
"""A line of x and y with a comma between them."""

_MISSING_WORDS = frozenset({"", "nan", "na", "n/a", "none", "null", "missing", "?", "-"})


@dataclass(frozen=True)
class Contour:
    """A line through landmarks, such as an eyelid or the jaw.

    Attributes
    ----------
    indices : tuple of int
        Landmarks along the line, counted from 0. A closed line does not repeat the first.
    closed : bool
        Whether the last landmark is connected to the first.
    """

    indices: tuple[int, ...]
    closed: bool = False

    @classmethod
    def all_of(cls, pairs: Iterable[tuple[Iterable[int], bool]]) -> "tuple[Contour, ...]":
        """Return the contours of (indices, closed), as a model has them."""
        return tuple(cls(tuple(indices), closed) for indices, closed in pairs)


@dataclass(frozen=True)
class Placing:
    """What the positions in a file count from.

    Attributes
    ----------
    size : (float, float), optional
        Width and height of the image that the positions are for, if the file states it.
    upwards : bool
        Whether y counts upwards from the bottom row.
    fractions : bool
        Whether x and y are fractions of the width and height.
    """

    size: tuple[float, float] | None = None
    upwards: bool = False
    fractions: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class Landmarks:
    """The landmarks of one image.

    Attributes
    ----------
    points : (n, 2) float64
        Read-only x and y in pixels; a missing landmark is (NaN, NaN).
    contours : tuple of Contour
        Lines through the landmarks, if the file has them.
    names : tuple of str
        One name per landmark, or empty.
    image_name : str, optional
        The image's file name, if the landmark file gives it.
    invisible : tuple of int
        Occluded landmarks with known positions, ascending. Only ``.ljson`` and ``.json`` store them.
    scale : float, optional
        Length of a pixel in the specimen's units, such as 0.01 mm. Only ``.tps`` stores it.
    others : tuple of Landmarks
        Further objects of the same image: the larger ones first where their sizes are known, else in the file's order.
    label : str
        What the file calls this object, such as the ID of a specimen, or empty.
    placing : Placing
        What the positions count from, until :func:`liaam.io.landmarks.in_pixels` has converted them.
    format : str
        Name of the file's format, or empty.

    Raises
    ------
    LandmarkError
        If the points are not (n, 2), infinite or half missing, if a contour or the names do not match them, or if the
        scale is not positive.
    """

    points: np.ndarray
    contours: tuple[Contour, ...] = ()
    names: tuple[str, ...] = ()
    image_name: str | None = None
    invisible: tuple[int, ...] = ()
    scale: float | None = None
    others: "tuple[Landmarks, ...]" = ()
    label: str = ""
    placing: Placing = Placing()
    format: str = ""

    def __post_init__(self) -> None:
        points = _checked_points(self.points)
        object.__setattr__(self, "points", points)
        if self.names and len(self.names) != len(points):
            raise LandmarkError(f"there are {len(self.names)} names for {len(points)} landmarks: give one name each.")
        wrong = [i for contour in self.contours for i in contour.indices if not 0 <= i < len(points)]
        if wrong:
            raise LandmarkError(
                f"a contour names landmark {wrong[0]} (counting from 0), but there are {len(points)} landmarks: "
                "correct the contour."
            )
        object.__setattr__(self, "invisible", tuple(sorted(set(self.invisible))))
        wrong = [index for index in self.invisible if not 0 <= index < len(points)]
        if wrong:
            raise LandmarkError(
                f"landmark {wrong[0]} (counting from 0) is marked invisible, but there are {len(points)} landmarks: "
                "correct the indices."
            )
        if self.scale is not None and not 0 < self.scale < math.inf:
            raise LandmarkError(f"the scale is {self.scale:g}: give the length of a pixel, a positive number.")

    def __len__(self) -> int:
        return len(self.points)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if copy is False and np.dtype(dtype or self.points.dtype) != self.points.dtype:
            raise ValueError(f"landmarks are float64: an array of {dtype} is a copy")  # as NumPy asks for
        return np.array(self.points, dtype) if copy else np.asarray(self.points, dtype)

    def __repr__(self) -> str:
        points, contours = count_of(len(self), "point"), count_of(len(self.contours), "contour")
        return f"Landmarks({points}, {self.missing.sum()} missing, {contours})"

    @property
    def missing(self) -> np.ndarray:
        """(n,) bool mask of missing landmarks."""
        return np.isnan(self.points[:, 0])

    def objects(self, name: str) -> "Iterator[tuple[str, Landmarks]]":
        """Yield each object and its name: ``name``, ``name#2``, ..., or ``name#ID`` if IDs tell them apart."""
        every = (self, *self.others)
        labels = [re.sub(r"[\\/#]", "_", each.label) for each in every]
        by_label = bool(self.others) and all(labels) and len(set(labels)) == len(labels)
        for number, each in zip(labels if by_label else count(1), every, strict=False):
            yield name if number == 1 else f"{name}#{number}", each

    def in_order_of(self, names: Sequence[str]) -> "Landmarks":
        """Return the landmarks with these names, in this order; unchanged if either has no names, or none in common.

        Raises
        ------
        LandmarkError
            If some of the names are missing, or name several landmarks.
        """
        if not names or self.names == tuple(names) or not set(names) & set(self.names):
            return self
        lacking = [name for name in names if self.names.count(name) != 1]
        if lacking:
            raise LandmarkError(f"its names lack {some_names(lacking)}, or have them twice: name each landmark once.")
        order = [self.names.index(name) for name in names]
        at = {old: new for new, old in enumerate(order)}
        contours = (Contour(tuple(at.get(i, -1) for i in each.indices), each.closed) for each in self.contours)
        return replace(
            self,
            points=self.points[order],
            names=tuple(names),
            contours=tuple(contour for contour in contours if -1 not in contour.indices),
            invisible=tuple(at[i] for i in self.invisible if i in at),
        )


def _checked_points(points: Any) -> np.ndarray:
    """Return the points as a read-only (n, 2) float64 copy."""
    try:
        points = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as fault:
        raise LandmarkError(f"the landmarks are not numbers ({fault}): give an (n, 2) array of x, y.") from fault
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
        raise LandmarkError(f"the landmarks have shape {points.shape}: give an (n, 2) array of x, y with n > 0.")
    absent = np.isnan(points)
    half = np.flatnonzero(absent[:, 0] != absent[:, 1])
    if len(half):
        raise LandmarkError(
            f"landmark {half[0] + 1} (counting from 1) has only one of x and y: give both, or leave out both."
        )
    if np.isinf(points).any():
        raise LandmarkError("a landmark is infinite: give finite pixels, or NaN for a missing one.")
    points.setflags(write=False)
    return points


# Reading ------------------------------------------------------------------------------------------


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
        Name or number of the COCO category, or the label of CVAT's skeletons, that is the object.
    group : str, optional
        Group of landmarks of a menpo ``.ljson``.
    y_down : bool
        Whether ``.tps`` and ``.nts`` count y from the top, as some programs write them.
    stored : bool
        Whether positions are for photos as stored, before their EXIF orientation turns them.
    """

    strict: bool = False
    category: str | None = None
    group: str | None = None
    y_down: bool = False
    stored: bool = False


USUAL = Reading()
"""How files are read unless the user says otherwise."""


@dataclass
class Notes:
    """What has to be said about a file: records that are left out, and what was done with others."""

    strict: bool = False
    left_out: dict[str, str] = field(default_factory=dict)
    """Reasons by record."""
    done: dict[str, list[str]] = field(default_factory=dict)
    """Names of records or images, by what was done with them."""

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
    """The text of a landmark file, for the readers."""

    path: Path
    text: str
    reading: Reading = USUAL
    notes: Notes = field(default_factory=Notes)

    @cached_property
    def json(self) -> Any:
        """Its content as JSON."""
        return parse_json(self.path, self.text)

    @cached_property
    def xml(self) -> Any:
        """Its root element as XML."""
        return parse_xml(self.path, self.text)

    @cached_property
    def lines(self) -> list[str]:
        """Its lines that are not blank, without blanks at their ends."""
        return [line for line in map(str.strip, self.text.splitlines()) if line]

    def each(self, records: Iterable[tuple[str, T]], make: Callable[[T], R]) -> Iterator[R]:
        """Yield what is made of each record; leave out those with faults. Raise the first fault if none is sound."""
        first, some = None, False
        for which, record in records:
            try:
                made = make(record)
            except (TypeError, KeyError, ValueError, AttributeError, LandmarkError) as fault:
                if not isinstance(fault, LandmarkError):
                    fault = LandmarkError(f"{self.path}: {which} lacks parts or has others: export the file again.")
                first = first or fault
                self.notes.leave_out(which, fault if self.notes.strict else str(fault).removeprefix(f"{self.path}: "))
            else:
                some = True
                yield made
        if first is not None and not some:
            raise first


def make_landmarks(
    path: Path,
    points: Any,
    contours: Iterable[Contour] = (),
    names: Iterable[str] = (),
    image_name: str | None = None,
    invisible: Iterable[int] = (),
    scale: float | None = None,
) -> Landmarks:
    """Make `Landmarks`, with the file's name in the error if they are invalid."""
    try:
        return Landmarks(points, tuple(contours), tuple(names), image_name, tuple(invisible), scale)
    except LandmarkError as fault:
        raise LandmarkError(f"{path}: {fault}") from fault


def size_of_file(width: Any, height: Any) -> Placing:
    """Return how positions count in an image whose size a file states as numbers or text, if it does."""
    try:
        return Placing((float(width), float(height)))
    except (TypeError, ValueError, OverflowError):
        return Placing()


def in_objects(landmarks: Iterable[Landmarks]) -> dict[str, Landmarks]:
    """Return landmarks by image; further ones of an image are its others."""
    found: dict[str, list[Landmarks]] = {}
    for own in landmarks:
        found.setdefault(own.image_name or "", []).append(own)
    return {image: replace(first, others=tuple(others)) for image, (first, *others) in found.items()}


def named_points(source: Source, found: Sequence[Landmarks], numbers: bool = True) -> list[Landmarks]:
    """Make landmarks of many images alike by their names.

    Where an image lacks some of the names that most have, these landmarks are missing. It is left out where it has
    names that most lack, or has a name twice. If asked for, numbers are sorted, and those from 1 on are no names.
    """
    counts = Counter(name for own in found for name in set(own.names))
    usual = [name for name, count in counts.items() if name and 2 * count >= sum(bool(own.names) for own in found)]
    fullest = max(found, key=lambda own: len(set(own.names) & set(usual)))
    usual.sort(key=lambda name: fullest.names.index(name) if name in fullest.names else len(fullest))
    numbers = numbers and all(name.isascii() and name.isdigit() for name in usual)
    usual = sorted(usual, key=natural_key) if numbers else usual
    plain = numbers and [name.lstrip("0") for name in usual] == [str(i + 1) for i in range(len(usual))]

    def alike(own: Landmarks) -> Landmarks:
        if not own.names:
            return own
        odd = [name for name in own.names if name not in usual or own.names.count(name) > 1]
        if odd:
            raise LandmarkError(f"{source.path}: its landmark '{short(odd[0])}' occurs twice, or in few others.")
        if len(own) == len(usual) and not numbers:
            return own
        at = {name: i for i, name in enumerate(own.names)}
        points = [tuple(own.points[at[name]]) if name in at else (math.nan, math.nan) for name in usual]
        invisible = tuple(i for i, name in enumerate(usual) if at.get(name) in own.invisible)
        names = () if plain else tuple(usual)
        return replace(own, points=points, names=names, invisible=invisible, contours=())

    return list(source.each(((own.label or own.image_name or "", own) for own in found), alike))


def largest_of(objects: Iterable[tuple[float, Landmarks]]) -> Landmarks:
    """Return the largest object of an image, with the others that have landmarks; from their areas and landmarks."""
    first, *others = (landmarks for _, landmarks in sorted(objects, key=lambda each: -each[0]))
    return replace(first, others=tuple(other for other in others if not other.missing.all()))


def read_text(path: Path) -> str:
    """Read a text file as UTF-8, UTF-16 with a byte order mark, or Latin-1. Raise if it is binary."""
    return decode_text(path, read_bytes(path, LandmarkError, MAX_BYTES))


def decode_text(path: Path, data: bytes) -> str:
    """Decode a file's content as :func:`read_text` does; `path` is for messages."""
    binary = LandmarkError(f"{path} is not a text file, so not a landmark file: export the landmarks again.")
    encoding = "utf-16" if data.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"
    if len(data) > 3 and encoding == "utf-8-sig" and not any(data[1:200:2]) and all(data[:200:2]):
        encoding = "utf-16-le"  # without a byte order mark
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as fault:
        if encoding.startswith("utf-16") or _has_control_characters(data):
            raise binary from fault
        text = data.decode("latin-1")
    if "\0" in text:
        raise binary
    if not text.strip():
        raise LandmarkError(f"{path} is empty (only blank lines): copy or export it again.")
    return text


def _has_control_characters(data: bytes) -> bool:
    """Return whether data hold control characters, as binary files do and text does not."""
    return len(data.translate(None, bytes(set(range(32)) - set(b"\t\n\f\r")))) < len(data)


def parse_count(path: Path, token: str, what: str) -> int:
    """Parse a non-negative integer."""
    if not (token.isascii() and token.isdigit() and len(token) <= 18):
        raise LandmarkError(f"{path}: '{short(token)}' is not a number of {what}: export the file again.")
    return int(token)


def check_count(path: Path, where: str, count: int, rows: Sequence[object]) -> None:
    """Raise unless there are as many rows of points as a line of the file promises."""
    if len(rows) != count:
        raise LandmarkError(
            f"{path}: the {where} promises {count} points but {len(rows)} are there; the file may be cut short: export "
            "it again."
        )


def parse_number(path: Path, token: str, where: str) -> float:
    """Parse one coordinate, NaN for the usual words for a missing value."""
    token = token.strip()
    if token.lower() in _MISSING_WORDS:
        return math.nan
    try:
        value = float(token) if "_" not in token else math.inf
    except ValueError:
        value = math.inf
    if not math.isfinite(value):
        raise LandmarkError(
            f"{path}: '{short(token)}' in {where} is not a number: correct it (decimal points, as in 12.5)."
        )
    return value


def parse_pair(path: Path, line: str, where: str) -> tuple[float, float]:
    """Parse a line that holds x and y."""
    tokens = line.split() if not _COMMAS.fullmatch(line) else line.replace(",", " ", 1).split()
    if len(tokens) != 2:
        raise LandmarkError(f"{path}: {where} holds {len(tokens)} values ('{short(line)}'), not x and y: correct it.")
    return parse_number(path, tokens[0], where), parse_number(path, tokens[1], where)


def check_number(path: Path, value: Any, where: str) -> float:
    """Check one coordinate from JSON, a number or null for a missing value."""
    if value is None:
        return math.nan
    try:
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.inf
    except OverflowError:
        number = math.inf
    if math.isinf(number):
        raise LandmarkError(f"{path}: '{short(str(value))}' in {where} is not a number: correct it, or use null.")
    return number


def parse_json(path: Path, text: str) -> Any:
    """Parse JSON. Raise LandmarkError if it is invalid."""
    import json

    try:
        return json.loads(text)
    except (ValueError, RecursionError) as fault:
        raise LandmarkError(
            f"{path} is not complete JSON ({short(str(fault), 100)}): it may be cut short; export it again."
        ) from fault


def parse_xml(path: Path, text: str) -> Any:
    """Parse XML. Reject documents that could define entities or read other files."""
    from xml.etree import ElementTree

    lower = text.lower()
    if "<!doctype" in lower or "<!entity" in lower:
        raise LandmarkError(
            f"{path} declares a document type or entities, which is not safe to read: remove that part."
        )
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as fault:
        raise LandmarkError(f"{path} is not complete XML ({fault}); it may be cut short: export it again.") from fault


def short(text: str, length: int = 40) -> str:
    """Cut a text for a message."""
    return text if len(text) <= length else f"{text[: length - 3]}..."


# Contours -----------------------------------------------------------------------------------------


def contour_of(indices: Sequence[int], closed: bool) -> Contour | None:
    """Make a contour. A repeated first point closes it; a single point gives None."""
    if len(indices) > 2 and indices[0] == indices[-1]:
        indices, closed = indices[:-1], True
    if len(set(indices)) < 2:
        return None
    return Contour(tuple(indices), closed)


def edges_of(contours: Iterable[Contour]) -> list[tuple[int, int]]:
    """List the edges between neighbours along the contours."""
    edges = []
    for contour in contours:
        edges += zip(contour.indices, contour.indices[1:], strict=False)
        if contour.closed:
            edges.append((contour.indices[-1], contour.indices[0]))
    return edges


def chain_edges(edges: Iterable[tuple[int, int]]) -> tuple[Contour, ...]:
    """Join edges into contours, the inverse of `edges_of` for contours that do not touch.

    Lines end at loose ends and where three or more edges meet; lines without ends are closed. Repeated edges
    count once, and edges from a landmark to itself are ignored.
    """
    neighbours = _neighbours(edges)
    used: set[frozenset[int]] = set()
    ends = [node for node, others in neighbours.items() if len(others) != 2]
    chains = [_walk(node, other, neighbours, used) for node in ends for other in neighbours[node]]
    chains += [_walk(node, others[0], neighbours, used) for node, others in neighbours.items() if others]
    contours = (contour_of(chain, closed=False) for chain in chains)
    found = [contour for contour in contours if contour is not None]
    order = {node: number for number, node in enumerate(neighbours)}
    return tuple(sorted(found, key=lambda contour: min(order[node] for node in contour.indices)))


def _neighbours(edges: Iterable[tuple[int, int]]) -> dict[int, list[int]]:
    neighbours: dict[int, dict[int, None]] = {}
    for start, end in edges:
        if start != end:
            neighbours.setdefault(start, {})[end] = None
            neighbours.setdefault(end, {})[start] = None
    return {node: list(others) for node, others in neighbours.items()}


def _walk(start: int, following: int, neighbours: dict[int, list[int]], used: set[frozenset[int]]) -> list[int]:
    """Follow unused edges from `start` through `following` up to a loose end or a junction."""
    chain = [start]
    node, target = start, following
    while frozenset((node, target)) not in used:
        used.add(frozenset((node, target)))
        chain.append(target)
        others = neighbours[target]
        if len(others) != 2:
            break
        node, target = target, others[0] if others[1] == node else others[1]
    return chain
