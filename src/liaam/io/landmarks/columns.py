"""The meaning of the columns of tables: by their names, and else by their values."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain, count, groupby

from liaam.errors import LandmarkError
from liaam.io.files import is_number, natural_key
from liaam.io.landmarks.matching import names_picture, without_title

IMAGES = {"image", "image_name", "image_file", "image_id", "image_path", "img", "file", "filename", "file_name"}
IMAGES |= {"photo", "picture", "photo_name", "path", "filepath", "file_path", "frame", "external"}
SPECIMENS = {"specimen", "specimen_id", "specimen_name", "individual", "sample", "sample_id", "subject", "animal"}
LANDMARKS = {"landmark", "landmark_name", "landmark_id", "landmarks", "lm", "point", "point_name", "point_id", "points"}
LANDMARKS |= {"keypoint", "keypoint_name", "bodypart", "part", "marker", "joint", "lmk", "landmark_number", "kp"}
SIZES = ("image_width", "image_height"), ("img_width", "img_height"), ("width", "height")
VISIBLE = ("visible", "visibility", "v")
UNCLEAR = ("name", "label", "id", "no", "number", "index", "slice")
"""Names of columns whose meaning their values decide."""

_AXIS = re.compile(r"(?:(?:pos|coord|point|pixel)_)?([xy])(?:_(?:px|pixels?|coords?|coordinates?|pos|position))?")

_UNIT = re.compile(r"[(\[]\s*([munµμ]?m|cm|microns?|in|inch(?:es)?|%|percent)\s*[)\]]", re.IGNORECASE)

_FORMS = (
    r"(?:raw|coord|lm)?[ ._-]?(?P<axis>[xyz])[ ._-]?(?P<key>\d+)",
    r"(?P<axis>[xyz])[ ._-](?P<key>\w.*)",
    r"(?P<key>.*\w)[ ._-][(\[]?(?P<axis>[xyz])[)\]]?",
    r"(?P<key>\w*\d)(?P<axis>[xyz])",
    r"(?-i:(?P<key>\w*[a-z])(?P<axis>[XYZ]))",
)
_OTHERS = {"bbox", "box", "rect", "min", "max", "centroid", "center", "image", "size"}
_OTHERS |= {"px", "pixel", "pixels", "mm", "cm", "um", "inch"}
"""Words beside x and y that name no landmark."""


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


def plain(cell: str) -> str:
    """Return a column's name in lower case, without what is in brackets, unless it is a unit other than pixels."""
    without = re.sub(r"[(\[].*[)\]]", "", _UNIT.sub(r" \1", cell))
    return re.sub(r"[\s_.-]+", "_", without.strip().casefold()).strip("_")


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
        found = [i for i, name in enumerate(header) if (match := _AXIS.fullmatch(name)) and match[1] == axis]
        first, *others = [i for i in found if header[i] == axis] or found
        if others:
            both = f"and '{header[first]}' both may be {axis}: name one of them {axis}"
            raise _ambiguous(header, both, others[0])
        axes[axis] = first
    values = [[row[i].strip() for row in rows] for i in range(len(header))]
    texts = [i for i in range(len(header)) if i not in axes.values()]
    image = _one(header, values, [i for i in texts if header[i] in IMAGES or _are_files(values[i])])
    specimen = _one(header, values, [i for i in texts if header[i] in SPECIMENS])
    landmark = _one(header, values, [i for i in texts if header[i] in LANDMARKS])
    if image in (None, specimen):
        image, specimen = specimen, None
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
    sizes = [own for own in sizes if len(own) == 2 and (header[own[0]] != "width" or _holds(own, axes, values))]
    visible = next((i for i in texts if header[i] in VISIBLE), None)
    return Columns(axes["x"], axes["y"], image, specimen, landmark, visible, *sizes[:1])


def _name_rows(title: str, values: Sequence[str]) -> bool:
    """Return whether a column names each row of an image by another text, or numbers them in another order."""
    if not len({*values}) == len(values) > 1 or "" in values:
        return False
    numbers = sorted(values, key=natural_key)
    counted = numbers in ([str(i + first) for i in range(len(values))] for first in (0, 1))
    return not any(map(is_number, values)) or (title in UNCLEAR and counted and numbers != [*values])


def _holds(size: Sequence[int], axes: dict[str, int], values: list[list[str]]) -> bool:
    """Return whether a width and a height may be those of images, and not of boxes: no point lies beyond."""
    pairs = chain(*(zip(values[axes[axis]], values[i], strict=True) for i, axis in zip(size, "xy", strict=True)))
    return all(float(at) <= float(side) for at, side in pairs if is_number(at) and is_number(side))


def _tells_apart(keys: Sequence[tuple[str, str]], values: Sequence[str]) -> bool:
    """Return whether a column holds each of the same few values once in each image, as names of landmarks do."""
    groups = defaultdict[tuple[str, str], list[str]](list)
    for key, value in zip(keys, values, strict=True):
        groups[key].append(value)
    most = max(groups.values(), key=len, default=[])
    alike = all(len(set(own)) == len(own) and set(own) <= set(most) for own in groups.values())
    return alike and len(groups) > 1 < len(most)


def pairs_of(header: list[str]) -> dict[str, dict[str, int]]:
    """Return the indices of the columns of x and y by landmark, in a table of one row an image.

    Positions in space (``X_0``, ``Y_0``, ``Z_0``) are not read beside those in the image (``x_0``, ``y_0``).
    """
    columns = list(_columns_of_axes(header))
    kinds = {(key, axis.isupper()) for _, key, axis in columns}
    in_space = {(key, axis.isupper()) for _, key, axis in columns if axis in "zZ" and (key, axis.islower()) in kinds}
    found = defaultdict[str, dict[str, int]](dict)
    columns = [(i, key, axis.lower()) for i, key, axis in columns if (key, axis.isupper()) not in in_space]
    for i, key, axis in columns:
        at = found[key].setdefault(axis, i)
        if at != i:
            both = f"'{header[at]}' and '{header[i]}' both may be {axis} of '{key}'"
            raise LandmarkError(f"the columns {both}: remove one of them.")
    return {key: axes for key, axes in found.items() if {"x", "y"} <= axes.keys()}


def _columns_of_axes(header: list[str]) -> Iterator[tuple[int, str, str]]:
    """Yield the index, the landmark and the axis of the columns of landmarks."""
    for i, cell in enumerate(_numbered([cell.strip() for cell in header])):
        match = next(filter(None, (re.fullmatch(form, cell, re.IGNORECASE) for form in _FORMS)), None)
        if match is not None and plain(match["key"]) not in _OTHERS:
            yield i, match["key"], match["axis"]


def _numbered(header: list[str]) -> list[str]:
    """Return a header with numbers for columns x and y that are repeated, as they are or as x, x.1, x.2."""
    plain = [cell for cell in header if cell in ("x", "y", "X", "Y")]
    if len(plain) == len({*plain}) and not any(re.fullmatch(r"[xyXY]\.1", cell) for cell in header):
        return header
    numbers = defaultdict(count)
    return [f"{cell}.{next(numbers[cell])}" if cell in ("x", "y", "X", "Y") else cell for cell in header]


def name_column(header: list[str], rows: Sequence[Sequence[str]], used: set[int]) -> int | None:
    """Return the column that names the images in a table of one row an image; `used` are those of x and y."""
    others = [i for i in range(len(header)) if i not in used]
    for known in (IMAGES, SPECIMENS, {*UNCLEAR, ""}):
        found = [i for i in others if header[i] in known and all(row[i].strip() for row in rows)]
        pixels = [header[i] for i in found if all(re.fullmatch(r"\d+(\s+\d+)+", row[i].strip()) for row in rows)]
        if pixels:
            raise LandmarkError(f"the column '{pixels[0]}' holds the images' pixels: put their names in its place.")
        if found:
            return found[0]
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


def _one(header: list[str], values: list[list[str]], found: list[int]) -> int | None:
    """Return one of the columns of a meaning; raise if they divide the rows differently."""
    first = next((i for i in found if _are_files(values[i])), found[0] if found else None)
    for i in found:
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
