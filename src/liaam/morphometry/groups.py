"""Groups of specimens, such as species or sexes, from a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence

from liaam.errors import LiaamError
from liaam.io.files import AnyPath
from liaam.io.table_reader import NamedRow, named_rows_in, naming_column, read_named_rows, refuse_again
from liaam.morphometry.scale_tables import images_of

FEWEST_OF_GROUP = 2
"""Individuals from which the mean of a group can be compared with others, and has a standard error."""


def read_groups(path: AnyPath) -> dict[str, str]:
    """Read a table ``.csv`` with the columns ``specimen`` (or image) and ``group``: the group of each specimen.

    The group may have another name, such as ``sex``, if it is the only other column.

    Raises
    ------
    LiaamError
        If the file or a column is missing, or a specimen occurs twice.
    """
    return _groups_of_rows(read_named_rows(path, "table of groups"), str(path))


def groups_in(text: str, path: str) -> dict[str, str]:
    """Parse the text of a table of groups, as :func:`read_groups`; ``path`` names it in messages."""
    return _groups_of_rows(named_rows_in(text, path), path)


def _groups_of_rows(rows: Sequence[NamedRow], path: str) -> dict[str, str]:
    if not rows:
        raise LiaamError(f"{path} has no rows below its header: give one row for each specimen")
    known = [*rows[0][1]]
    column = naming_column(known, specimens_first=True)
    others = [name for name in known if name != column]
    of_group = next((name for name in known if name.lower() == "group"), others[0] if len(others) == 1 else None)
    if column is None or of_group is None:
        absent = [what for what, own in (("specimen (or picture, image)", column), ("group", of_group)) if own is None]
        what = f"column{'s' if len(absent) > 1 else ''} {' and '.join(absent)}"
        remedy = "call the columns so" if column is None or others else "add it, with one row for each specimen"
        raise LiaamError(f"{path} has no {what}: it has {', '.join(known)}; {remedy}")
    groups: dict[str, str] = {}
    for number, row in rows:
        name = row[column].strip()
        refuse_again(name, groups, path, number, "specimen")
        groups[name] = row[of_group].strip()
    return groups


def large_groups(groups: Sequence[str], individuals: Sequence[Hashable]) -> list[str]:
    """Return the groups that have enough individuals to be compared, sorted.

    Parameters
    ----------
    groups : sequence of str
        Group of each specimen; empty if it is in none.
    individuals : sequence of hashable
        Individual of each specimen.

    Raises
    ------
    LiaamError
        If there are not two.
    """
    pairs = {pair for pair in zip(groups, individuals, strict=True) if pair[0]}
    counts = Counter(group for group, _ in pairs)
    compared = sorted(name for name, count in counts.items() if count >= FEWEST_OF_GROUP)
    if len(compared) < 2:
        known = ", ".join(f"{name} ({counts[name]})" for name in sorted(counts))
        what = "specimens" if len(set(individuals)) == len(individuals) else "individuals"
        raise LiaamError(
            f"differences between groups need two groups of {FEWEST_OF_GROUP} {what} or more that can be compared: "
            f"there are {known or 'none'}"
        )
    return compared


def groups_of(specimens: Sequence[str], groups: Mapping[str, str]) -> tuple[str, ...]:
    """Return the group of each specimen, given by its name; empty if it is in none.

    Names go with or without folder and ending. All objects of an image (``tray#1``) are in its group.

    Raises
    ------
    LiaamError
        If no specimen is in a group, or one may be in several.
    """
    found = images_of(specimens, list(groups))
    if not any(name is not None and groups[name] for name in found):
        raise LiaamError(f"no specimen is in the table of groups, which has names such as {next(iter(groups), 'none')}")
    return tuple("" if name is None else groups[name] for name in found)
