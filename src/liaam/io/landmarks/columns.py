"""The meaning of the columns of a table with one row a landmark: by their names, and else by their values."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import PureWindowsPath

from liaam.errors import LandmarkError
from liaam.io.images import PICTURE_SUFFIXES, UNREAD_SUFFIXES

IMAGES = {"image", "image_name", "image_file", "image_id", "image_path", "img", "file", "filename", "file_name"}
IMAGES |= {"photo", "picture", "photo_name", "path", "filepath", "file_path", "frame", "external"}
SPECIMENS = {"specimen", "specimen_id", "specimen_name", "individual", "sample", "sample_id", "subject", "animal"}
LANDMARKS = {"landmark", "landmark_name", "landmark_id", "landmarks", "lm", "point", "point_name", "point_id", "points"}
LANDMARKS |= {"keypoint", "keypoint_name", "bodypart", "part", "marker", "joint", "lmk", "landmark_number", "kp"}
UNCLEAR = ("name", "label", "id", "no", "number", "index", "slice")
"""Names of columns whose meaning their values decide."""

_AXIS = re.compile(r"(?:(?:pos|coord|point|pixel)_)?([xy])(?:_(?:px|pixels?|coords?|coordinates?|pos|position))?")


@dataclass(frozen=True)
class Columns:
    """Indices of columns: x and y; of images, of specimens in an image, and of landmarks, None if there are none."""

    x: int
    y: int
    image: int | None = None
    specimen: int | None = None
    landmark: int | None = None


def has_points(header: Sequence[str]) -> bool:
    """Return whether a header has columns x and y."""
    return {"x", "y"} <= {axis for axis, _ in _axes(header)}


def _axes(header: Sequence[str]) -> Iterator[tuple[str, int]]:
    for i, name in enumerate(header):
        match = _AXIS.fullmatch(name)
        if match is not None:
            yield match[1], i


def columns_of(header: list[str], rows: Sequence[Sequence[str]]) -> Columns:
    """Find the columns of a table with a header in lower case. Raise if its meaning is ambiguous."""
    axes: dict[str, int] = {}
    for axis, i in _axes(header):
        if axis in axes and header[axes[axis]] == axis:
            continue
        if axis in axes and header[i] != axis:
            raise _ambiguous(header, f"and '{header[axes[axis]]}' both may be {axis}: name one of them {axis}", i)
        axes[axis] = i
    values = [[row[i].strip() for row in rows] for i in range(len(header))]
    texts = [i for i in range(len(header)) if i not in axes.values()]
    image = _one(header, values, [i for i in texts if header[i] in IMAGES])
    specimen = _one(header, values, [i for i in texts if header[i] in SPECIMENS])
    landmark = _one(header, values, [i for i in texts if header[i] in LANDMARKS])
    if image is None:
        image = next((i for i in texts if i not in (specimen, landmark) and _are_files(values[i])), None)
    if image is None:
        image, specimen = specimen, None
    unclear = [i for name in UNCLEAR for i in texts if header[i] == name and i not in (image, specimen, landmark)]
    for i in unclear:
        if image is None and header[i] != "name" and _in_blocks(values[i]):
            image = i
        elif landmark is None and (header[i] in ("name", "label") or _repeats(values[i])):
            landmark = i
    if image is None:
        _check_one_image(header, values, texts, landmark)
    return Columns(axes["x"], axes["y"], image, specimen, landmark)


def _check_one_image(header: list[str], values: list[list[str]], texts: list[int], landmark: int | None) -> None:
    """Raise if a table without a column for images seems to hold several."""
    counts = Counter(values[landmark]) if landmark is not None else Counter[str]()
    if landmark is not None and len(counts) > 1 and len({*counts.values()} - {1}) == len({*counts.values()}) == 1:
        raise _ambiguous(header, "repeats its names, but no column names the images: add a column 'image'", landmark)
    for i in texts if landmark is None else ():
        if header[i] and _in_blocks(values[i]) and not all(map(_is_number, values[i])):
            raise _ambiguous(header, "may name the images: name it 'image' if so, or else remove it", i)


def _one(header: list[str], values: list[list[str]], found: list[int]) -> int | None:
    """Return one of the columns of a meaning; raise if they divide the rows differently."""
    first = next((i for i in found if _are_files(values[i])), found[0] if found else None)
    for i in found:
        if first is not None and len(set(zip(values[first], values[i], strict=True))) != len(set(values[first])):
            raise _ambiguous(header, f"and '{header[first]}' both may name the same: remove one of them", i)
    return first


def _ambiguous(header: list[str], why: str, column: int) -> LandmarkError:
    return LandmarkError(f"the column '{header[column]}' {why}.")


def without_title(name: str) -> str:
    """Return an image's name without what ImageJ adds behind it, as in ``a.png:eye``."""
    return re.sub(r"(\.\w{2,5}):[^\\/]*$", r"\1", name)


def _are_files(values: Sequence[str]) -> bool:
    return bool(values) and all(
        PureWindowsPath(without_title(value)).suffix.lower() in (*PICTURE_SUFFIXES, *UNREAD_SUFFIXES)
        for value in set(values)
    )


def _in_blocks(values: Sequence[str]) -> bool:
    """Return whether rows of one value follow each other, for several values that each have several rows."""
    sizes = [len(list(group)) for _, group in groupby(values)]
    return 1 < len(sizes) == len(set(values)) and min(sizes) > 1


def _repeats(values: Sequence[str]) -> bool:
    present = [value for value in values if value]
    return len(set(present)) < len(present)


def _is_number(text: str) -> bool:
    return re.fullmatch(r"-?\d*\.?\d+", text) is not None
