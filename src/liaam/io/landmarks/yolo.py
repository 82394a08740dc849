"""Pose labels of Ultralytics' YOLO: a text file for each image, and ``data.yaml``."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from liaam.errors import LandmarkError
from liaam.io.files import is_number
from liaam.io.landmarks import reading as rd
from liaam.io.landmarks.base import Landmarks, Placing
from liaam.io.landmarks.reading import NOWHERE, Source

IMAGES = "images"
LABELS = "labels"
"""Folders of one layout: ``images/train/a.jpg`` has ``labels/train/a.txt``."""

_BOX = 5  # numbers before the points: the class, and a box
_FEWEST = 2  # points
_FLAGS = (0.0, 1.0, 2.0)  # a point is missing, hidden, or seen
_SETTINGS = ("data.yaml", "data.yml", "dataset.yaml")
_PARENTS = 3  # folders above the labels in which the settings may lie
_MOST_BYTES = 100_000  # of the settings
_SHAPE = re.compile(r"[\s\[-]*(\d{1,6})[\s,-]+([23])\b")  # of kpt_shape, as [17, 3] or as a list below it
_SLACK = 0.5  # share of the image's size that boxes may extend beyond it; in pixels, numbers are much larger
_NAME = re.compile(r"[^\s,'\"\[\]-][^,'\"\[\]\n]*")  # in a list: what is no comma, quote, bracket or dash before it
_NUMBERED_NAME = re.compile(r"(\d{1,6})\s*:\s*['\"]?([^,'\"\n}]+)")  # as 0: wing
_CLASS_OF_NAMES = re.compile(r"\b\d{1,6}[ \t]{0,9}:(?=[ \t]{0,9}[\[\n])")  # as 0: before the list of its points' names


@dataclass(frozen=True)
class _Form:
    """How the numbers behind the box of an object are divided.

    Attributes
    ----------
    n_points : int
        Number of points.
    n_values : int
        Numbers of each point: 2 (x and y), or 3 (and a flag).
    is_known : bool
        Whether they could be divided in no other way.
    """

    n_points: int
    n_values: int
    is_known: bool


def in_images(path: Path) -> Path | None:
    """Return the path in the folder of images of one in a folder of labels, if there is that folder.

    Of ``data/labels/train/a.txt`` it is ``data/images/train/a.txt``.
    """
    return _exchanged(path, LABELS, IMAGES)


def labels_of(folder: Path) -> Path | None:
    """Return the folder of labels of a folder of images, if there is one."""
    labels = _exchanged(folder, IMAGES, LABELS)
    return labels if labels is not None and labels.is_dir() else None


def _exchanged(path: Path, folder: str, other: str) -> Path | None:
    """Return a path with another folder in the place of the last of a name; None if it has none, or there is none."""
    parts = list(path.parts)
    if folder not in parts:
        return None
    last = len(parts) - 1 - parts[::-1].index(folder)
    parts[last] = other
    return Path(*parts) if Path(*parts[: last + 1]).is_dir() else None


def is_yolo(source: Source) -> bool:
    """Whether lines have a class and a box as fractions of the image, and more numbers."""
    if len(source.text) > rd.MAX_LINES_OF_NUMBERS:
        return False
    return all(_is_label(line.split()) for line in source.lines)


def _is_label(row: list[str]) -> bool:
    """Whether the cells of a line are those of an object."""
    if len(row) < _BOX or not all(map(is_number, row[:_BOX])):
        return False
    is_class = row[0].isascii() and row[0].isdigit()
    if not is_class:
        return False
    if not all(is_number(cell) or cell.lower() == "nan" for cell in row[_BOX:]):
        return False
    x, y, width, height = (float(cell) for cell in row[1:_BOX])
    are_fractions = all(-_SLACK <= value <= 1 + _SLACK for value in (x, y, width, height))
    return are_fractions and width > 0 and height > 0


def parse_yolo(source: Source) -> list[Landmarks]:
    """Parse lines of a class, a box and points: x and y as fractions of the image's size, and perhaps a flag.

    A flag of 0 says that a point is missing, and 1 that it is hidden; so do -1, -1 or NaN that it is missing.
    ``kpt_shape`` in ``data.yaml``, beside the file or above, says how many points there are; ``kpt_names`` names them.
    The largest object that has a point comes first.
    """
    rows = [line.split() for line in source.lines]
    odd = next((i for i, row in enumerate(rows, 1) if len(row) != len(rows[0])), None)
    if odd is not None:
        differ = f"line {odd} has {len(rows[odd - 1])} numbers, but line 1 has {len(rows[0])}"
        raise LandmarkError(f"{differ}: give each object its class, box and points.")
    settings = _settings_of(source.path)
    form = _form_of(rows, settings)
    if not form.is_known:
        source.notes.say("points of YOLO are taken for x and y, since no data.yaml has kpt_shape", source.path.name)
    names = _names_in(settings, form.n_points)
    wanted = source.reading.category
    classes = _classes_in(settings)
    objects = []
    for row in sorted(rows, key=_area_of_box, reverse=True):
        label = classes.get(row[0], row[0])
        if wanted is None or wanted in (label, row[0]):
            objects.append(_object_of(row[_BOX:], form.n_values, names))
    if not objects:
        raise LandmarkError(
            f"no objects of the class '{wanted}': it has {', '.join(sorted({row[0] for row in rows}))}."
        )
    return [each for each in objects if not each.missing.all()] or objects


def _area_of_box(row: list[str]) -> float:
    """Return the area of the box in the cells of a line, as a fraction of the image's."""
    width = float(row[3])
    height = float(row[4])
    return width * height


def _object_of(cells: list[str], n_values: int, names: tuple[str, ...]) -> Landmarks:
    """Return the landmarks in the numbers behind a box, which are ``n_values`` for each."""
    values = np.array([float(cell) for cell in cells]).reshape(-1, n_values)
    flags = values[:, 2] if n_values == 3 else np.full(len(values), 2.0)
    points: Any = [rd.parse_point(pair, f"point {i}") for i, pair in enumerate(values[:, :2].tolist(), 1)]
    points = np.where(flags[:, None] == 0, NOWHERE, points)
    hidden = tuple(np.flatnonzero(flags == 1).tolist())
    return Landmarks(points, (), names, None, hidden, placing=Placing(fractions=True))


def _form_of(rows: list[list[str]], settings: str) -> _Form:
    """Return how the numbers behind the boxes are divided, by the settings, or else by the numbers themselves."""
    n = len(rows[0]) - _BOX
    shape = _SHAPE.match(_list_in(settings, "kpt_shape"))
    if shape is not None:
        if int(shape[1]) * int(shape[2]) != n:
            have = f"data.yaml says {shape[1]} points of {shape[2]} numbers, but a line has {n} numbers behind its box"
            raise LandmarkError(f"YOLO's {have}: correct one of them.")
        return _Form(int(shape[1]), int(shape[2]), is_known=True)
    has_flags = n % 3 == 0 and all(float(cell) in _FLAGS for row in rows for cell in row[_BOX + 2 :: 3])
    n_values = 3 if has_flags else 2
    if n % n_values or n < _FEWEST * n_values:
        what = "has boxes only" if n == 0 else f"has {n} numbers behind its boxes"
        raise LandmarkError(f"this file of YOLO {what}, not x and y of points: export pose labels, with data.yaml.")
    return _Form(n // n_values, n_values, is_known=has_flags or n % 3 != 0)


def _settings_of(path: Path) -> str:
    """Return the text of the settings beside a file of labels, or above it; empty if there are none."""
    if not path.is_file():  # its content was given in memory
        return ""
    for folder in (path.parent, *list(path.parent.parents)[:_PARENTS]):
        for name in _SETTINGS:
            file = folder / name
            try:
                if file.is_file() and file.stat().st_size <= _MOST_BYTES:
                    return file.read_text(encoding="utf-8", errors="replace")
            except OSError:
                continue
    return ""


def _list_in(settings: str, key: str) -> str:
    """Return what stands below a key of the settings, or behind it."""
    found = re.search(rf"^{key}[ \t]{{0,9}}:(.*(?:\n[ \t-].*)*)", settings, re.MULTILINE)
    return found[1] if found is not None else ""


def _classes_in(settings: str) -> dict[str, str]:
    """Return the names of classes by number."""
    text = _list_in(settings, "names")
    pairs: Any = _NUMBERED_NAME.findall(text)
    if pairs:
        return {number: name.strip() for number, name in pairs}
    return {str(i): name.strip() for i, name in enumerate(_NAME.findall(text))}


def _names_in(settings: str, n_points: int) -> tuple[str, ...]:
    """Return the names of the points, if the settings have as many."""
    text = _CLASS_OF_NAMES.sub("", _list_in(settings, "kpt_names"))
    names = [name.strip() for name in _NAME.findall(text)]
    return tuple(names) if len(names) == n_points == len({*names}) else ()
