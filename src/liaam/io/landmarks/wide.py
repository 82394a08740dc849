"""Tables of one row an image, such as ml-morph's and MorphoJ's (``id,X1,Y1,X2,...``): centres counted from 0.

Columns of x and y have a number or the landmark's name before or behind the axis. Rows are named by a column for the
image or specimen, or else by the only other column with text.
"""

import re
from typing import Any

from liaam.errors import LandmarkError
from liaam.io.files import natural_key
from liaam.io.landmarks.base import Landmarks
from liaam.io.landmarks.columns import IMAGES, SPECIMENS, UNCLEAR, pairs_of
from liaam.io.landmarks.reading import Source
from liaam.io.landmarks.tables import Row, check_widths, header_of, rows_of
from liaam.io.landmarks.text import parse_point


def is_it(source: Source) -> bool:
    """Whether the first line has x and y of at least two landmarks."""
    rows = rows_of(source)
    return bool(rows) and len(pairs_of(rows[0][1])) > 1


def parse(source: Source) -> Landmarks | list[Landmarks]:
    """Parse a row of landmarks for each image."""
    first, *rows = rows_of(source)
    rows = [(number, row) for number, row in rows if any(row)]
    check_widths(first[1], rows)
    given = pairs_of(first[1])
    numbered = all(map(str.isdigit, given))
    pairs = {key: given[key] for key in sorted(given, key=natural_key)} if numbered else given
    if any("z" in axes for axes in pairs.values()):
        raise LandmarkError("it has columns of z: export x and y only.")
    name = _name_column(source, header_of(source), rows, {i for axes in pairs.values() for i in axes.values()})
    # Numbers out of order may be the names of landmarks in another order.
    names = () if numbered and list(pairs) == list(given) else tuple(pairs)

    def make(line: Row) -> Landmarks:
        number, row = line
        points: Any = [parse_point((row[axes["x"]], row[axes["y"]]), f"line {number}") for axes in pairs.values()]
        return Landmarks(points, names=names, image_name=None if name is None else row[name].strip())

    found = list(source.each(((f"line {number}", (number, row)) for number, row in rows), make))
    return found[0] if name is None and found else found


def _name_column(source: Source, header: list[str], rows: list[Row], used: set[int]) -> int | None:
    others = [i for i in range(len(header)) if i not in used]
    for known in (IMAGES, SPECIMENS, {*UNCLEAR, ""}):
        found = [i for i in others if header[i] in known and all(row[i].strip() for _, row in rows)]
        pixels = [header[i] for i in found if all(re.fullmatch(r"\d+(\s+\d+)+", row[i].strip()) for _, row in rows)]
        if pixels:
            raise LandmarkError(
                f"the column '{pixels[0]}' holds the images' pixels: put the images' names in its place."
            )
        if found:
            return found[0]
    texts = [i for i in others if not all(re.fullmatch(r"[-\d.]*", row[i].strip()) for _, row in rows)]
    if len(texts) == 1 or len(rows) < 2:
        return texts[0] if len(texts) == 1 else None
    named = f" (the columns {', '.join(repr(header[i]) for i in texts)} may)" if texts else ""
    raise LandmarkError(f"no column names the images{named}: name it 'image'.")
