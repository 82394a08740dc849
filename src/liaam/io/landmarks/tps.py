"""``.tps`` of tpsDig and geomorph: pixel centres counted from 0, x to the right, y **upwards from the bottom** row.

One file holds many images. A record starts with ``LM=`` and its points; ``IMAGE=`` names the image, or else ``ID=``
without its extension. ``SCALE=`` is the length of a pixel. The points of ``CURVES=`` follow the landmarks, and each
curve becomes a contour. Outlines, radii, variables and comments are skipped. A missing landmark is ``NA NA``
(geomorph), ``NaN NaN``, or ``-1 -1`` (tpsDig); it is written ``NaN NaN``, which R and Python read. Records without
points are images that are not digitised yet, and are skipped.
"""

import math
import re
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.landmarks.base import (
    Contour,
    Landmarks,
    Placing,
    Source,
    in_objects,
    make_landmarks,
    parse_pair,
    short,
)

Lines = deque[tuple[int, str]]
"""Lines that are not blank, with their numbers."""

_KEY = re.compile(r"([A-Za-z]\w*)\s*=(.*)")
_MISSING = (-1.0, -1.0)


@dataclass
class _Record:
    """One image, while it is read."""

    points: list[tuple[float, float]]
    curves: list[Contour] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)
    scale: float | None = None


def parse(source: Source) -> Landmarks | dict[str, Landmarks]:
    """Parse the text of a ``.tps`` file into landmarks by image, or of one image without a name. y counts upwards."""
    path, chunks = source.path, _chunks(source)
    only, found = len(chunks) == 1, []
    for landmarks in source.each(((_name(path, lines), lines) for lines in chunks), partial(_landmarks, source, only)):
        found += [] if landmarks is None else [landmarks]
    if not found:
        raise LandmarkError(f"{path} has no points: place the landmarks of at least one image first.")
    return found[0] if found[0].image_name is None else in_objects(found)


def _chunks(source: Source) -> list[Lines]:
    """Split the lines into records."""
    lines = [(i, line.strip()) for i, line in enumerate(source.text.splitlines(), 1) if line.strip()]
    starts = [i for i, (_, line) in enumerate(lines) if re.match(r"LM3?\s*=", line, re.IGNORECASE)]
    if not starts or any(_KEY.fullmatch(line) for _, line in lines[: starts[0]]):
        number, line = next((pair for pair in lines if _KEY.fullmatch(pair[1])), lines[0])
        why = "comes before any LM=" if _KEY.fullmatch(line) else "is not expected here"
        raise LandmarkError(f"{source.path}: line {number} ('{short(line)}') {why}: export the file again.")
    return [deque(lines[start:end]) for start, end in zip(starts, [*starts[1:], len(lines)], strict=True)]


def _name(path: Path, lines: Lines) -> str:
    """Return the name of a record for messages."""
    facts = {match[1]: match[2] for match in (_KEY.fullmatch(line) for _, line in lines) if match}
    return facts.get("IMAGE") or facts.get("ID") or f"the record of line {lines[0][0]}"


def _landmarks(source: Source, only: bool, lines: Lines) -> Landmarks | None:
    """Make the landmarks of a record; None if it has no points."""
    path, line = source.path, lines[0][0]
    record = _record(source, lines)
    if not record.points:
        return None
    name = record.facts.get("IMAGE") or record.facts.get("ID")
    if name is None and not only:
        raise LandmarkError(f"{path}: the record of line {line} names no image: add a line IMAGE=, or ID=.")
    made = make_landmarks(path, record.points, record.curves, image_name=name, scale=record.scale)
    return replace(made, label=record.facts.get("ID", ""), placing=Placing(upwards=True))


def _record(source: Source, lines: Lines) -> _Record:
    record, last, section = _Record([]), "LM", ""
    while lines:
        number, line = lines.popleft()
        where = f"{source.path}: line {number} ('{short(line)}')"
        pair = _KEY.fullmatch(line)
        if pair is None and last in ("LM", "POINTS"):
            raise LandmarkError(f"{where} is not expected here: correct the number of points above it, or remove it.")
        if pair is None:  # of a comment, or of something that liaam does not use
            continue
        last, value = pair[1].upper(), pair[2].strip()
        if last == "LM3":
            raise LandmarkError(f"{where} begins points with x, y and z: export x and y only, as LM=.")
        if last == "LM":
            record.points += _points(source.path, where, value, lines)
        elif last == "POINTS":
            points, first = _points(source.path, where, value, lines), len(record.points)
            if section == "CURVES" and points:  # those of outlines are not used
                record.points += points
                record.curves.append(Contour(tuple(range(first, len(record.points)))))
        elif last == "SCALE":
            record.scale = _scale(source, where, value, record.facts)
        elif value:
            record.facts[last] = value
        section = last if last in ("CURVES", "OUTLINES") else section
    return record


def upwards(landmarks: Landmarks, image_size: tuple[float, float]) -> Landmarks:
    """Count y from the other side of an image of (width, height)."""
    x, y = landmarks.points.T
    return replace(landmarks, points=np.stack([x, image_size[1] - 1 - y], axis=1))


def dump(landmarks: Landmarks) -> str:
    """Return the text of a record. y counts upwards."""
    n = len(landmarks)
    curves = _curves(landmarks)
    first = curves[0][0] if curves else n
    lines = [f"LM={first}", *_lines(landmarks, range(first))]
    if curves:
        lines.append(f"CURVES={len(curves)}")
        for curve in curves:
            lines += [f"POINTS={len(curve)}", *_lines(landmarks, curve)]
    if landmarks.image_name:
        name = " ".join(landmarks.image_name.splitlines())
        lines += [f"IMAGE={name}", f"ID={PurePosixPath(name).stem}"]
    if landmarks.scale is not None:
        lines.append(f"SCALE={landmarks.scale!r}")
    return "\n".join([*lines, ""])


def dump_collection(collection: Mapping[str, Landmarks]) -> str:
    """Return the text of a file with the landmarks of many images, by file name."""
    return "".join(map(dump, collection.values()))


def _points(path: Path, where: str, count: str, lines: Lines) -> list[tuple[float, float]]:
    """Take as many points from the lines as a count promises."""
    if not (count.isascii() and count.isdigit()):
        raise LandmarkError(f"{where} has no number of points after '=': correct it, such as LM=12.")
    points = []
    while lines and "=" not in lines[0][1] and len(points) < float(count):  # int has a limit of digits
        number, line = lines.popleft()
        x, y = parse_pair(path, line, f"line {number}")
        if math.isnan(x) != math.isnan(y):
            raise LandmarkError(f"{path}: line {number} has only one of x and y: give both, or NA NA if missing.")
        points.append((math.nan, math.nan) if (x, y) == _MISSING else (x, y))
    if len(points) != float(count):
        raise LandmarkError(
            f"{where} promises {short(count)} points but {len(points)} follow; the file may be cut short: correct the "
            "number, or export the file again."
        )
    return points


def _scale(source: Source, where: str, text: str, facts: dict[str, str]) -> float | None:
    try:
        scale = float(text)
    except ValueError:
        scale = math.nan
    if not 0 < scale < math.inf:
        if source.reading.strict:
            raise LandmarkError(f"{where} is not the length of a pixel: give a positive number, or remove the line.")
        source.notes.say(
            "specimens have no scale, because SCALE= is no positive number", facts.get("IMAGE") or facts.get("ID", "")
        )
        return None
    return scale


def _curves(landmarks: Landmarks) -> list[tuple[int, ...]]:
    """Return the contours if they are open and the last landmarks in order, as curves are read; else nothing."""
    curves = [contour.indices for contour in landmarks.contours if not contour.closed]
    tail = [index for curve in curves for index in curve]
    n = len(landmarks)
    return curves if len(curves) == len(landmarks.contours) and tail == list(range(n - len(tail), n)) else []


def _lines(landmarks: Landmarks, indices: range | tuple[int, ...]) -> Iterator[str]:
    for index in indices:
        x, y = landmarks.points[index].tolist()
        yield "NaN NaN" if math.isnan(x) else f"{x!r} {y!r}"
