"""Tables of what is known of specimens besides their landmarks: individual, side and groups, as people keep them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches

from liaam.errors import LiaamError
from liaam.formatting import short_repr
from liaam.io.files import AnyPath, some_names
from liaam.io.landmarks.matching import stem_of
from liaam.io.landmarks.tables import INDIVIDUALS, SIDE
from liaam.io.sides import OTHER_SIDE, side_of_text
from liaam.io.table_reader import NAMING, naming_column, read_named_rows, refuse_again
from liaam.morphometry.scale_tables import images_of
from liaam.morphometry.sides import individual_name, refuse_odd_sides, side_is_by_fit
from liaam.morphometry.specimens import Specimen

KIND = "table of specimens"

_NEAR = 0.8  # likeness of two names, 0 to 1, above which one may be the other, mistyped


@dataclass(frozen=True, eq=False)
class SpecimenTable:
    """A table with a row for each image or specimen.

    Attributes
    ----------
    path : str
        Its file, for messages.
    columns : tuple of str
        Names of its columns.
    rows : dict of str to dict of str to str
        Cells by column, by the name of the image or specimen.
    """

    path: str
    columns: tuple[str, ...]
    rows: dict[str, dict[str, str]]

    __repr__ = short_repr

    @property
    def individual_column(self) -> str:
        """Name of the column of individuals; empty if there is none."""
        return next((name for name in self.columns if name.lower() in INDIVIDUALS), "")

    @property
    def side_column(self) -> str:
        """Name of the column of sides; empty if there is none."""
        return next((name for name in self.columns if name.lower() == SIDE), "")

    def reading_said(self, group: str = "") -> str:
        """Say which columns are read, of which ``group`` is that of groups, and which are not."""
        naming = naming_column(self.columns)
        read = [name for name in self.columns if name in (naming, self.individual_column, self.side_column, group)]
        others = [name for name in self.columns if name not in read]
        absent = [
            word
            for word, column in (("individual", self.individual_column), ("side", self.side_column))
            if not column and others
        ]
        said = f"{self.path}: read {', '.join(read)}"
        if others:
            said += f"; not used: {some_names(others)}"
        if absent:
            said += f" (there is no column {' and no column '.join(absent)}: if one of these is it, call it so)"
        return said

    def rows_of_none(self, specimens: Sequence[Specimen]) -> tuple[str, ...]:
        """Return the names of the rows of which there is no specimen.

        Each is given with a similar name of a specimen that has no row, as ``IMG_010.JPG (is it IMG_0101?)``.
        """
        rows = self._rows_of(specimens)
        found = {id(row) for row in rows if row is not None}
        unlisted = [each.name for each, row in zip(specimens, rows, strict=True) if row is None]
        named = []
        for name, row in self.rows.items():
            if id(row) not in found:
                near = get_close_matches(stem_of(name), unlisted, n=1, cutoff=_NEAR)
                named.append(name + (f" (is it {near[0]}?)" if near else ""))
        return tuple(named)

    def refuse_without_individuals(self, specimens: Iterable[Specimen], by: str | None = None) -> None:
        """Raise if the table states no individuals, and no individual has both sides by the names of specimens.

        ``by`` tells replicates, as in :func:`liaam.morphometry.measurement_error`.
        """
        sides_of: dict[str, set[str]] = defaultdict(set)
        for specimen in specimens:
            if specimen.side and specimen.is_usable:
                sides_of[individual_name(specimen, by)].add(specimen.side)
        if not self.individual_column and sides_of and all(len(sides) == 1 for sides in sides_of.values()):
            raise LiaamError(
                f"{self.path} does not state which left and right specimens are of one individual: it has no column "
                f"individual, but {', '.join(self.columns)}. Add one, or call the column that states it individual"
            )

    def cells_of(self, specimens: Sequence[Specimen], column: str) -> tuple[str, ...]:
        """Return the cell of a column for each specimen; empty for those that have no row.

        Images go with or without folder and ending, and all objects of an image (``tray#1``) have its row.

        Raises
        ------
        LiaamError
            If there is no such column, or a specimen may be of several rows.
        """
        own = self.column_called(column)
        if not own:
            raise LiaamError(f"{self.path} has no column '{column}': it has {', '.join(self.columns)}")
        return tuple("" if row is None else row[own].strip() for row in self._rows_of(specimens))

    def column_called(self, name: str) -> str:
        """Return the column of a name, which may be written with other capitals; empty if there is none."""
        others = (column for column in self.columns if column.casefold() == name.casefold())
        return name if name in self.columns else next(others, "")

    def of(self, specimens: Sequence[Specimen], sides: bool = True) -> tuple[tuple[Specimen, ...], tuple[str, ...]]:
        """Return specimens with the individual and the side that the table states, and the names of those without row.

        What the table leaves empty stays as it is. Fits keep their own side: if the table states another, that is
        `Specimen.stated_side`. :func:`liaam.morphometry.of_one_side` compares both, and the side with the shape.

        Parameters
        ----------
        specimens : sequence of Specimen
        sides : bool
            Whether to read the column ``side``.

        Returns
        -------
        specimens : tuple of Specimen
        unlisted : tuple of str
            Names of those that have no row.

        Raises
        ------
        LiaamError
            If no specimen has a row, one may be of several, or there are more than two sides.
        """
        found = self._rows_of(specimens)
        if all(row is None for row in found):
            raise LiaamError(f"no specimen has a row in {self.path}, which has names such as {next(iter(self.rows))}")
        individual = self.individual_column
        side = self.side_column if sides else ""
        cells = [row or {} for row in found]
        own = [side_of_text(row.get(side, "")) for row in cells]
        refuse_odd_sides([each.name for each in specimens], own, self.path)
        stated = [
            _of_side(replace(each, individual=row.get(individual, "").strip() or each.individual), of_row)
            for each, row, of_row in zip(specimens, cells, own, strict=True)
        ]
        return tuple(stated), tuple(each.name for each, row in zip(specimens, found, strict=True) if row is None)

    def _rows_of(self, specimens: Sequence[Specimen]) -> list[dict[str, str] | None]:
        names = [specimen.name for specimen in specimens]
        own = [specimen.image for specimen in specimens]
        return [None if name is None else self.rows[name] for name in images_of(names, list(self.rows), own)]


def _of_side(specimen: Specimen, side: str) -> Specimen:
    """Return a specimen with the side that a table states, if it does; a fit keeps its own."""
    if side in ("", specimen.side):
        return specimen
    if side in OTHER_SIDE and side_is_by_fit(specimen):
        return replace(specimen, stated_side=side)
    return replace(specimen, side=side)


def read_specimen_table(path: AnyPath) -> SpecimenTable:
    """Read a table ``.csv`` with a column of images or specimens, and any of ``individual``, ``side`` and others.

    Raises
    ------
    LiaamError
        If the file is missing, no column names the images, or an image occurs twice.
    """
    rows = read_named_rows(path, KIND)
    if not rows:
        raise LiaamError(f"{path} has no rows below its header: give one row for each image")
    columns = tuple(rows[0][1])
    naming = naming_column(columns)
    if naming is None:
        raise LiaamError(
            f"{path} has no column {NAMING}: it has {', '.join(columns)}; give a .csv file with one row for each image"
        )
    found: dict[str, dict[str, str]] = {}
    for number, row in rows:
        name = row[naming].strip()
        refuse_again(name, found, path, number)
        found[name] = row
    return SpecimenTable(str(path), columns, found)
