"""``.tps`` of tpsDig and geomorph: pixel centres counted from 0, x to the right, y **upwards from the bottom** row.

One file holds many images. A record starts with ``LM=`` and its points; ``IMAGE=`` names the image, or else ``ID=``
without its extension. ``SCALE=`` is the length of a pixel. The points of ``CURVES=`` follow the landmarks, and each
curve becomes a contour. Outlines, radii, variables and comments are skipped. A missing landmark is ``NA NA``
(geomorph), ``NaN NaN``, or ``-1 -1`` (tpsDig). Records without points, of images not digitised yet, are skipped.
"""

import re
from dataclasses import dataclass, field
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import is_number
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.contours import Contour
from liaam.io.landmarks.reading import MISSING, Source
from liaam.io.landmarks.text import parse_pair, short

_UPWARDS = Placing(upwards=True)
_KEY = re.compile(r"([A-Za-z]\w*)\s*=\s*(.*)")


@dataclass(frozen=True)
class _Block:
    """A line ``KEY=VALUE``, with the lines up to the next."""

    where: str
    key: str
    value: str
    body: list[tuple[int, str]] = field(default_factory=list)


def parse(source: Source) -> Landmarks | list[Landmarks]:
    """Parse records into landmarks of images, or of one image without a name. y counts upwards."""
    records: list[list[_Block]] = []
    for block in _blocks(source):
        if block.key in ("LM", "LM3"):
            records.append([])
        if not records:
            raise LandmarkError(f"{block.where} comes before any LM=: export the file again.")
        records[-1].append(block)
    if not records:
        raise LandmarkError(f"'{short(source.lines[0])}' is not expected here, before any LM=: export the file again.")
    named = ((_facts(record).get("IMAGE") or _facts(record).get("ID") or record[0].where, record) for record in records)
    found = [own for own in source.each(named, lambda record: _landmarks(source, record, len(records) == 1)) if own]
    return found[0] if len(found) == 1 and found[0].image_name is None else found


def _blocks(source: Source) -> list[_Block]:
    blocks: list[_Block] = []
    for number, line in enumerate(map(str.strip, source.text.splitlines()), 1):
        match = _KEY.fullmatch(line)
        if match is not None:
            blocks.append(_Block(f"line {number} ('{short(line)}')", match[1].upper(), match[2]))
        elif line and blocks:
            blocks[-1].body.append((number, line))
    return blocks


def _facts(record: list[_Block]) -> dict[str, str]:
    return {block.key: block.value for block in record if block.value or block.key == "SCALE"}


def _landmarks(source: Source, record: list[_Block], only: bool) -> Landmarks | None:
    """Make the landmarks of a record; None if it has no points."""
    facts, curves, section = _facts(record), [], ""
    points: Any = _points(record[0])
    for block in record[1:]:
        section = block.key if block.key in ("CURVES", "OUTLINES") else section
        own = _points(block) if block.key == "POINTS" else []
        if own and section == "CURVES":  # those of outlines are not used
            curves.append(Contour(tuple(range(len(points), len(points) + len(own)))))
            points = points + own
    if not points:
        return None
    label, name = facts.get("ID", ""), facts.get("IMAGE") or facts.get("ID")
    if name is None and not only:
        raise LandmarkError(f"the record of {record[0].where} names no image: add a line IMAGE=, or ID=.")
    scale = float(facts["SCALE"]) if is_number(facts.get("SCALE", "")) else 0.0
    if scale <= 0 and "SCALE" in facts:
        source.notes.repair("there is no scale, because SCALE= is not a positive number", name or source.path.name)
    return Landmarks(points, tuple(curves), (), name, (), scale if scale > 0 else None, (), label, _UPWARDS)


def _points(block: _Block) -> list[tuple[float, float]]:
    """Return as many points as a line promises."""
    if block.key == "LM3":
        raise LandmarkError(f"{block.where} begins points with x, y and z: export x and y only, as LM=.")
    if not (block.value.isascii() and block.value.isdigit()):
        raise LandmarkError(f"{block.where} has no number of points after '=': correct it, such as LM=12.")
    count, n = float(block.value), len(block.body)  # int has a limit of digits
    if n > count:
        number, line = block.body[int(count)]
        where = f"line {number} ('{short(line)}')"
        raise LandmarkError(f"{where} is not expected here: correct the number of points above it, or remove it.")
    points = [parse_pair(line, f"line {number}") for number, line in block.body]
    if n < count:
        promised = f"{short(block.value)} points but {n} follow; the file may be cut short"
        raise LandmarkError(f"{block.where} promises {promised}: correct the number, or export the file again.")
    return [MISSING if point == (-1.0, -1.0) else point for point in points]
