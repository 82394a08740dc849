"""Lengths of a pixel from a table of ``liaam scale``, for specimens."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import PureWindowsPath

from liaam.errors import LiaamError
from liaam.io.files import AnyPath, name_key, some_names
from liaam.io.landmarks.matching import stem_of
from liaam.io.table_reader import NAMING, NamedRow, naming_column, read_named_rows, refuse_again
from liaam.morphometry.specimens import Specimen
from liaam.scale.lengths import Length, unit_of

COLUMNS = ("image", "scale", "unit", "scale_se", "how", "fingerprint")
"""Columns of a table of lengths that are read; the last three may be absent."""

KIND = "table of scales"

TYPED = "the table of scales"
"""Source of the lengths whose row does not say how they were found, as a person puts them into the table."""


def read_lengths(*paths: AnyPath) -> dict[str, Length | None]:
    """Read tables of ``liaam scale``: the length of a pixel by the name of the image.

    That of images whose scale was refused, and so is empty, is None. Tables complete each other.

    Raises
    ------
    LiaamError
        If a file or a column is missing, a cell is not a number, or an image occurs twice in a table, or has a length
        in several.
    """
    joined: dict[str, Length | None] = {}
    table_of: dict[str, AnyPath] = {}
    for path in paths:
        for image, length in lengths_in(read_named_rows(path, KIND), path).items():
            if length is not None and joined.get(image) is not None:
                raise LiaamError(
                    f"{table_of[image]} and {path} both have a scale of '{image[:60]}': keep one line for each image"
                )
            if length is not None or image not in joined:
                joined[image] = length
                table_of[image] = path
    return joined


def lengths_in(rows: Sequence[NamedRow], path: AnyPath) -> dict[str, Length | None]:
    """Read the rows of one table of ``liaam scale``, as :func:`read_lengths`; ``path`` names it in messages."""
    lengths: dict[str, Length | None] = {}
    for number, row in with_usual_columns(rows, path):
        refuse_again(row["image"], lengths, path, number)
        try:
            lengths[row["image"]] = _length_in(row)
        except (ValueError, LiaamError) as fault:
            raise LiaamError(f"{path}: line {number} has no length of a pixel ({fault}): correct it") from fault
    return lengths


def with_usual_columns(rows: Sequence[NamedRow], path: AnyPath) -> list[NamedRow]:
    """Return the rows of a table of lengths with the columns called as ``liaam scale`` calls them.

    In a table that a person has written, the image may be called as in other tables of specimens.
    """
    if not rows:
        raise LiaamError(f"{path} has no rows below its header: give one row for each image")
    known = [*rows[0][1]]
    called = {name: next((each for each in known if each.lower() == name), None) for name in COLUMNS}
    called["image"] = naming_column(known)
    absent = [NAMING if name == "image" else name for name in COLUMNS[:3] if called[name] is None]
    if absent:
        columns = "columns" if len(absent) > 1 else "column"
        raise LiaamError(
            f"{path} has no {columns} {', '.join(absent)}: it has {', '.join(known)}; give a table of 'liaam scale', "
            f"or one of your own, with the columns {', '.join(COLUMNS[:3])}, such as wing1.jpg, 0.0031, mm"
        )
    usual = {own: name for name, own in called.items() if own is not None}
    return [(number, {usual.get(name, name): cell for name, cell in row.items()}) for number, row in rows]


def _length_in(row: Mapping[str, str]) -> Length | None:
    """Return the length of a pixel in a row; None if it is empty."""
    if not row["scale"].strip():
        return None
    unit = row["unit"].strip()
    source = row.get("how", "").strip() or TYPED
    fingerprint = row.get("fingerprint", "").strip()
    return Length(float(row["scale"]), unit_of(unit) or unit, float(row.get("scale_se") or 0), source, fingerprint)


def with_lengths(specimens: Sequence[Specimen], lengths: Mapping[str, Length | None]) -> tuple[Specimen, ...]:
    """Return specimens with the lengths of a pixel of their images, by name with or without folder and ending.

    All objects of an image have its length: those of fits state their image, others are named ``tray#1``. A specimen
    of an image that is not in the table, or whose scale was refused, has none.

    Raises
    ------
    LiaamError
        If no specimen is of an image in the table with a length, one may be of several images, an image in the table is
        another one than that of a specimen of this name, or those of several specimens are different images.
    """
    images = _images_with_lengths(specimens, lengths)
    _refuse_shared_lines(specimens, images)
    if not any(image is not None and lengths[image] for image in images):
        which = "with a scale " if any(images) else ""
        first = next(iter(lengths), "none")
        raise LiaamError(f"no specimen is of an image {which}in the table of scales, such as {first}")
    found = [None if image is None else lengths[image] for image in images]
    return tuple(
        replace(
            specimen,
            scale=None if length is None else length.value,
            unit="" if length is None else length.unit,
            scale_se=0.0 if length is None else length.se,
            scale_source="" if length is None else length.source,
        )
        for specimen, length in zip(specimens, found, strict=True)
    )


def _images_with_lengths(specimens: Sequence[Specimen], lengths: Mapping[str, Length | None]) -> list[str | None]:
    """Return the image of each specimen in a table; None if it is not there."""

    def is_other(i: int, image: str) -> bool:
        own, length = specimens[i], lengths[image]
        if length is None or not length.fingerprint or not own.fingerprint:
            return False
        # Files of another format may be of the same photograph.
        return length.fingerprint != own.fingerprint and _file_name(own.image) == _file_name(image)

    names = [specimen.name for specimen in specimens]
    return images_of(names, list(lengths), [specimen.image for specimen in specimens], is_other)


def _refuse_shared_lines(specimens: Sequence[Specimen], images: Sequence[str | None]) -> None:
    """Raise if a line of the table would be that of fits of different images."""
    first_of: dict[str, Specimen] = {}
    for specimen, image in zip(specimens, images, strict=True):
        if image is None or not specimen.image:
            continue
        first = first_of.setdefault(image, specimen)
        keys = (_key_of(first.image), _key_of(specimen.image))
        if keys[0] not in _ends_of(keys[1]) and keys[1] not in _ends_of(keys[0]):
            raise LiaamError(
                f"{image} in the table of scales is one image, and {first.image} and {specimen.image} are two: give a "
                f"table that 'liaam scale' has written for all images in one run"
            )


def _file_name(image: str) -> str:
    """Return the name of an image's file without folders, to be compared."""
    return name_key(PureWindowsPath(image).name)


Key = tuple[str, ...]
"""Folders and name of an image, without its ending, to be compared."""


def images_of(
    specimens: Sequence[str],
    images: Sequence[str],
    own_images: Sequence[str | None] | None = None,
    is_other: Callable[[int, str], bool] = lambda i, image: False,
) -> list[str | None]:
    """Return the image of each specimen, given by its name or by its own image if that is known; None if none is.

    The path of one is the end of the other's, as ``left/wing1`` is of ``wings/left/wing1.jpg``, but not of
    ``right/wing1.jpg``. ``is_other`` is called with the index of a specimen and an image of such a name, and returns
    whether it is known to be another image.
    """
    by_key: dict[Key, list[str]] = defaultdict(list)
    by_end: dict[Key, list[str]] = defaultdict(list)
    for image in images:
        # With its ending, which tells images of one name apart, and without it
        for key in dict.fromkeys((_file_key_of(image), _key_of(image))):
            by_key[key].append(image)
            for end in _ends_of(key):
                by_end[end].append(image)

    def image_of(i: int, specimen: str, own_image: str | None) -> str | None:
        *folders, name = _key_of(own_image or f"{specimen}.png")
        *_, file = _file_key_of(own_image or specimen)
        of_name = (name.rpartition("#")[0], name.rpartition("_")[0])
        for own in (file, name) if own_image else (name, *of_name):
            key = (*folders, own)
            named = by_end.get(key) or next((by_key[end] for end in _ends_of(key) if end in by_key), [])
            found = [image for image in named if not is_other(i, image)]
            if named and not found:
                raise LiaamError(
                    f"{named[0]} in the table of scales is another image than that of specimen {specimen}: run 'liaam "
                    "scale' on the images that were fitted; if they are copies of one size, remove the column "
                    "'fingerprint' from the table"
                )
            if len(found) > 1:
                remedy = "measure the folder that holds all of them, or keep its line alone"
                raise LiaamError(f"specimen {specimen} may be of the images {some_names(found)}: {remedy}")
            if found:
                return found[0]
        return None

    own_images = [None] * len(specimens) if own_images is None else own_images
    return [
        image_of(i, specimen, own_image)
        for i, (specimen, own_image) in enumerate(zip(specimens, own_images, strict=True))
    ]


def _key_of(image: str) -> Key:
    path = PureWindowsPath(image)
    return tuple(name_key(part) for part in (*path.parent.parts, stem_of(path.name)))


def _file_key_of(image: str) -> Key:
    """Return folders and name of an image with its ending, to be compared."""
    return tuple(name_key(part) for part in PureWindowsPath(image).parts)


def _ends_of(key: Key) -> list[Key]:
    """Return the path, and what remains of it without its first folders."""
    return [key[i:] for i in range(len(key))]
