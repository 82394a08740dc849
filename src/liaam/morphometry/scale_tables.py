"""Lengths of a pixel from a table of ``liaam scale``, for specimens."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import replace

from liaam.errors import LiaamError
from liaam.io.files import AnyPath, existing_file, name_key
from liaam.io.landmarks.matching import stem_of
from liaam.io.landmarks.reading import read_text
from liaam.morphometry.specimens import Specimen
from liaam.scale.lengths import Length

COLUMNS = ("image", "scale", "unit", "scale_se")
"""Columns of a table of lengths that are read."""

FOUND = "a ruler in the image"
"""Source of these lengths."""


def read_lengths(path: AnyPath) -> dict[str, Length]:
    """Read the table of ``liaam scale``: the length of a pixel by the name of the image.

    Images whose scale was refused, and so is empty, have none.

    Raises
    ------
    LiaamError
        If the file or a column is missing, a cell is not a number, or an image occurs twice.
    """
    path = existing_file(path, LiaamError, "table of scales")
    rows = list(csv.DictReader(read_text(path).splitlines()))
    if not rows or not {*COLUMNS[:3]} <= rows[0].keys():
        raise LiaamError(f"{path} has no columns {', '.join(COLUMNS[:3])}: give a table of 'liaam scale'")
    lengths: dict[str, Length] = {}
    for number, row in enumerate(rows, 2):
        if not (row["scale"] or "").strip():
            continue
        try:
            length = Length(float(row["scale"]), (row["unit"] or "").strip(), float(row.get("scale_se") or 0), FOUND)
        except ValueError as fault:
            raise LiaamError(f"{path}: line {number} has no length of a pixel ({fault}): correct it") from fault
        if lengths.setdefault(row["image"], length) is not length:
            raise LiaamError(f"{path}: line {number} has '{row['image'][:60]}' again: keep one line for each image")
    return lengths


def with_lengths(specimens: Sequence[Specimen], lengths: Mapping[str, Length]) -> tuple[Specimen, ...]:
    """Return specimens with the lengths of a pixel of their images, by name with or without folder and ending.

    All objects of an image (``tray#1``, ``tray_2`` of ``liaam fit --all``) have its length. A specimen of an image that
    is not in the table has none.

    Raises
    ------
    LiaamError
        If no specimen is of an image in the table.
    """
    by_name = {name_key(stem_of(image)): length for image, length in lengths.items()}
    chosen = [_length_of(specimen, by_name) for specimen in specimens]
    if not any(chosen):
        raise LiaamError(f"no specimen is of an image in the table of scales, such as {next(iter(lengths), 'none')}")
    return tuple(
        replace(
            specimen,
            scale=None if length is None else length.value,
            unit="" if length is None else length.unit,
            scale_se=0.0 if length is None else length.se,
            scale_source="" if length is None else length.source,
        )
        for specimen, length in zip(specimens, chosen, strict=True)
    )


def _length_of(specimen: Specimen, by_name: Mapping[str, Length]) -> Length | None:
    name = name_key(stem_of(specimen.name + ".png"))
    for key in (name, name.rpartition("#")[0], name.rpartition("_")[0]):
        if key in by_name:
            return by_name[key]
    return None
