"""Tables of the sides of images, beside landmark files that have no column for them, such as ``.tps``."""

from pathlib import Path

from liaam.errors import LiaamError
from liaam.io.landmarks.tables import SIDE
from liaam.io.table_reader import naming_column, read_named_rows

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
    columns = [] if not rows else [*rows[0][1]]
    name = naming_column(columns)
    side = next((title for title in columns if title.lower() == SIDE), None)
    if name is None or side is None:
        return {}
    return {row[name].strip(): row[side].strip() for _, row in rows if row[name].strip()}
