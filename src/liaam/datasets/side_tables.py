"""Tables of the sides of images, beside landmark files that have no column for them, such as ``.tps``."""

from pathlib import Path

from liaam.errors import LiaamError
from liaam.io.landmarks.tables import IMAGES, SIDE, SPECIMENS
from liaam.io.table_reader import read_named_rows

SUFFIX = ".csv"


def sides_in_table(file: Path) -> dict[str, str]:
    """Return the sides that a table states, by image or specimen; empty if it states none.

    If it has several rows of one name, the last counts.
    """
    if file.suffix.lower() != SUFFIX:
        return {}
    try:
        rows = read_named_rows(file, "table of sides")
    except LiaamError:
        return {}
    columns = {} if not rows else {title.lower(): title for title in rows[0][1]}
    name = next((title for lower, title in columns.items() if lower in IMAGES | SPECIMENS), None)
    if name is None or SIDE not in columns:
        return {}
    return {row[name].strip(): row[columns[SIDE]].strip() for _, row in rows if row[name].strip()}
