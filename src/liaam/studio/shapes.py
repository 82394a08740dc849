"""Measures of all pictures, and the space of their shapes, for the page and as a table."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import finite_list, finite_or_none
from liaam.io.sides import side_of_text
from liaam.io.table_writer import columns_text
from liaam.morphometry import (
    Measure,
    ShapeSpace,
    Specimen,
    groups_in,
    groups_of,
    individuals_of,
    measure,
    of_one_side,
    p_of_means,
    shape_space,
    shape_variation,
    with_estimated_landmarks,
)
from liaam.morphometry.measures import ScaleBar, parse_scale
from liaam.morphometry.sides import IGNORED
from liaam.morphometry.table import comparable, in_unit, scales_in, size_column, unit_of_table
from liaam.scale.lengths import Length, unit_of
from liaam.studio import contract
from liaam.studio.contract import ShapesQuery
from liaam.studio.folder import plain_name
from liaam.studio.measuring import GROUPED_BY, GROUPS, columns_of, kept_in
from liaam.studio.project import Placed, Project
from liaam.studio.refusal import Refusal
from liaam.studio.sides import for_measuring
from liaam.tables import Columns

SHOWN = 500
"""Shapes that are sent at most, to be drawn over each other."""

DIGITS = 5
"""Decimals of shapes of size 1: finer than a pixel of any screen."""

PERMUTATIONS = 999
FEWER_PERMUTATIONS = 199
MANY = 200
"""Specimens from which on there are fewer permutations, since a table that follows the points cannot wait for more."""

TESTED = 1000
"""Specimens up to which groups are tested."""


@dataclass(frozen=True, eq=False)
class Sample:
    """The pictures with landmarks, measured."""

    pictures: tuple[str, ...]
    specimens: tuple[Specimen, ...]  # all of one side
    sides: str  # what was done about sides, empty if nothing
    measures: tuple[Measure, ...]
    columns: Columns
    groups: tuple[str, ...]
    estimated: tuple[int, ...]  # number of points of each that were estimated

    @property
    def landmarks(self) -> list[int]:
        """Indices of the points that make the shape, which are not those at the ends of a scale bar."""
        return [int(name[1:]) - 1 for name in self.columns if re.fullmatch(r"X\d+", name)]


def sample_of(project: Project, asked: ShapesQuery) -> Sample:
    """Measure all pictures of a project, as a request asks. Points that are only proposed count as missing."""
    placed = [picture for picture in project.placed("measure") if _accepted(picture).any()]
    if not placed:
        raise Refusal(422, "all points are as they were proposed: accept those of a picture, then measure")
    specimens, sides = _of_one_side(_with_sides([_specimen(picture) for picture in placed]))
    specimens, scale = _with_scale(specimens, asked.scale)
    if asked.estimate:
        specimens, _ = with_estimated_landmarks(specimens, "tps", scale)
    called = kept_in(project.store)["names"]
    texts = dict.fromkeys(asked.measures.split())
    measures = tuple(replace(Measure.parse(text), name=called.get(text, "")) for text in texts)
    columns = measure(specimens, measures, scale)
    return Sample(
        pictures=tuple(picture.file.name for picture in placed),
        specimens=specimens,
        sides=sides,
        measures=measures,
        columns=columns,
        groups=_groups(project, [picture.file.stem for picture in placed], asked.by),
        estimated=tuple(len(specimen.estimated) for specimen in specimens),
    )


def shapes(project: Project, asked: ShapesQuery) -> contract.Shapes:
    """Return the measures of all pictures of a project, and the space of their shapes, for the page."""
    sample = sample_of(project, asked)
    space: contract.Space | None = None
    why_not = ""
    try:
        space = _space_json(sample)
    except LiaamError as fault:
        why_not = str(fault)
    return {
        "pictures": [*sample.pictures],
        "groups": [*sample.groups],
        "estimated": [*sample.estimated],
        "unscaled": _unscaled(sample.columns),
        "columns": _columns_json(sample),
        "space": space,
        "why_not": why_not,
        "sides": sample.sides,
        "tests": _tests(sample),
        "has_table": project.store.get(GROUPS) is not None,
    }


def table(project: Project, asked: ShapesQuery) -> tuple[str, bytes]:
    """Return the name and the content of a table of measurements, with groups and scores of shapes.

    Columns of measures have the names of their landmarks.
    """
    sample = sample_of(project, asked)
    columns: Columns = {"specimen": sample.columns["specimen"]}
    if any(sample.groups):
        columns["group"] = [*sample.groups]
    columns |= _named_columns(sample)
    if asked.only:
        of_shapes = re.compile(r"[XY]\d+(_se)?|.*_se")
        columns = {name: cells for name, cells in columns.items() if not of_shapes.fullmatch(name)}
        return f"{plain_name(project.title)}-measures.csv", columns_text(columns).encode()
    try:
        space = _space(sample)
    except LiaamError:
        space = None  # too few specimens
    if space is not None:
        columns["distance_from_mean"] = _spread(space, space.distances, len(sample.pictures))
        for number, scores in enumerate(space.scores.T, 1):
            columns[f"PC{number}"] = _spread(space, scores, len(sample.pictures))
    return f"{plain_name(project.title)}-measurements.csv", columns_text(columns).encode()


def _named_columns(sample: Sample) -> Columns:
    """Return the columns of a sample, with the names of landmarks in those of measures and their errors."""
    named = columns_of(sample.measures, sample.specimens[0].names)

    def name_of(column: str) -> str:
        measures = [measure for measure in named if column == measure or column.startswith(f"{measure}_")]
        longest = max(measures, key=len, default="")
        return named.get(longest, "") + column.removeprefix(longest)

    return {name_of(column): values for column, values in sample.columns.items()}


def save_groups(project: Project, data: Any) -> contract.Grouped:
    """Keep a table of groups, the ``text`` of a .csv file of a ``name``; return how many specimens it has."""
    asked = project.checked(contract.SaveGroups, data, "text and name, of a table of groups")
    if not isinstance(asked.text, str) or not isinstance(asked.name, str):
        raise Refusal(422, "the table of groups is not valid: send its text and its name")
    groups = groups_in(asked.text, plain_name(asked.name))
    groups_of([picture.file.stem for picture in project.placed("group")], groups)  # refuses a table of other specimens
    project.store.put(GROUPS, {"": groups})
    return {"specimens": len(groups)}


def _accepted(picture: Placed) -> np.ndarray:
    """Return which points have a position that a person has at least accepted, (n,) bool."""
    return np.array([origin not in (None, "proposed") for origin in picture.origins], bool)


def _specimen(picture: Placed) -> Specimen:
    landmarks = picture.landmarks
    return Specimen(
        picture.file.stem,
        np.where(_accepted(picture)[:, None], landmarks.points, np.nan),
        names=landmarks.names,
        scale=landmarks.scale,
        unit=unit_of(landmarks.unit),
        side=side_of_text(landmarks.side),
        image=picture.file.name,
    )


def _with_sides(specimens: Sequence[Specimen]) -> list[Specimen]:
    """Complete the sides that are known of some specimens only, or of none."""
    stated = [specimen.side for specimen in specimens]
    shapes = np.array([specimen.points for specimen in specimens])
    sides = for_measuring(stated, [specimen.name for specimen in specimens], shapes)
    return [replace(specimen, side=side or said) for specimen, side, said in zip(specimens, sides, stated, strict=True)]


def _of_one_side(specimens: Sequence[Specimen]) -> tuple[tuple[Specimen, ...], str]:
    """Reflect the specimens of one side, as ``liaam measure`` does; return them, and what was done or could not be."""
    try:
        return of_one_side(specimens)
    except LiaamError as fault:  # the page shows what there is while sides are being completed
        return of_one_side(specimens, IGNORED)[0], str(fault)


def _with_scale(
    specimens: tuple[Specimen, ...], written: str | None
) -> tuple[tuple[Specimen, ...], str | ScaleBar | None]:
    """Give specimens without a scale the length of a pixel that a person has written; return them, and the rule.

    A scale between two points is measured in each picture.
    """
    rule = parse_scale(written) if written else None
    if isinstance(rule, str) and not any(each.scale is not None for each in specimens):
        return specimens, None  # nothing is in this unit yet
    if not isinstance(rule, Length):
        return specimens, rule or _unit_of_files(specimens)
    of_all = {"scale": rule.value, "unit": rule.unit, "scale_se": rule.se}
    scaled = tuple(each if each.scale is not None else replace(each, **of_all) for each in specimens)
    return scaled, rule.unit


def _unit_of_files(specimens: Sequence[Specimen]) -> str | None:
    """Return the unit of scales that state none: millimetres, as the bars, if there are others."""
    units = {specimen.unit for specimen in specimens if specimen.scale is not None}
    return "mm" if len(units) > 1 else None


def _groups(project: Project, pictures: Sequence[str], by: str) -> tuple[str, ...]:
    """Return the group of each picture; empty if it has none."""
    if by not in GROUPED_BY:
        raise Refusal(422, f"pictures cannot be grouped by '{by[:20]}': choose one of {', '.join(GROUPED_BY[1:])}")
    if by == "folder":
        return tuple(str(PurePosixPath(picture).parent) for picture in pictures)
    if by == "name":
        return _groups_by_name([PurePosixPath(picture).name for picture in pictures])
    kept = project.store.get(GROUPS) if by == "table" else None
    return ("",) * len(pictures) if kept is None else groups_of(pictures, kept)


def _groups_by_name(names: Sequence[str]) -> tuple[str, ...]:
    """Return the letters that tell groups in names, such as ``male`` in ``male_07`` and ``B`` in ``wing16_B``.

    They are the first letters that are not the same in all names, and are shared by at least two names of two groups.
    """
    letters = [re.findall(r"[^\W\d_]+", name) for name in names]
    for place in range(max(map(len, letters), default=0)):
        groups = tuple(each[place] if place < len(each) else "" for each in letters)
        if sum(count > 1 for group, count in Counter(groups).items() if group) > 1:
            return groups
    return tuple(each[0] if each else "" for each in letters)


def _unscaled(columns: Columns) -> list[int]:
    """Return the indices of specimens without a scale; none where no specimen has one."""
    scales = scales_in(columns)
    return [] if scales is None else np.flatnonzero(~np.isfinite(np.array(scales, np.float64))).tolist()


def _columns_json(sample: Sample) -> list[contract.Column]:
    unit = unit_of_table(sample.columns)
    columns = []
    for wanted in sample.measures:
        columns.append(_column_json(sample, in_unit(wanted.column, unit, wanted.power), wanted, wanted.power))
    columns.append(_column_json(sample, size_column(sample.columns), None, 1))
    return columns


def _column_json(sample: Sample, name: str, wanted: Measure | None, power: int) -> contract.Column:
    unit = unit_of_table(sample.columns) or "px"
    units = {0: "°", 1: unit, 2: f"{unit}²"}
    return {
        "measure": None if wanted is None else f"{wanted.kind}:{'-'.join(wanted.landmarks)}",
        "called": "" if wanted is None else wanted.name,
        "name": name,
        "unit": units[power],
        "values": finite_list(comparable(sample.columns, name)),
        "p": finite_or_none(
            p_of_means(comparable(sample.columns, name), sample.groups, individuals_of(sample.specimens))
        ),
    }


def _space(sample: Sample) -> ShapeSpace:
    inside = sample.landmarks
    if not inside:  # no specimen has all landmarks
        return shape_space([])
    return shape_space([replace(each, points=each.points[inside], **_BARE) for each in sample.specimens])


_BARE: dict[str, Any] = {"covariances": None, "names": (), "estimated": ()}


def _space_json(sample: Sample) -> contract.Space:
    space = _space(sample)
    downwards = np.array([1.0, -1.0])
    try:
        bent = space.grid()
        grid: contract.Grid | None = {
            "rows": bent.rows,
            "columns": bent.columns,
            "points": _rounded(bent.points * downwards),
            "bends": _rounded(bent.bends * downwards),
        }
    except LiaamError:  # all landmarks on one line
        grid = None
    return {
        "landmarks": sample.landmarks,
        "of": space.specimens.tolist(),
        "mean": _rounded(space.mean * downwards),
        "shapes": _rounded(space.shapes[:SHOWN] * downwards),
        "scores": _rounded(space.scores),
        "axes": _rounded(space.axes * downwards),
        "shares": _rounded(space.shares),
        "distances": _rounded(space.distances),
        "limit": round(space.limit, DIGITS),
        "grid": grid,
    }


def _rounded(values: np.ndarray) -> list:
    return np.round(values, DIGITS).tolist()


def _tests(sample: Sample) -> list[contract.GroupTest]:
    """Test the differences between groups; nothing if there are not two of two specimens with a shape."""
    if len({group for group in sample.groups if group}) < 2 or len(sample.pictures) > TESTED:
        return []
    try:
        permutations = PERMUTATIONS if len(sample.pictures) < MANY else FEWER_PERMUTATIONS
        found = shape_variation(sample.specimens, sample.columns, sample.groups, permutations)
    except LiaamError:
        return []
    tests: list[contract.GroupTest] = []
    for test in found.tests:
        tests.append(
            {
                "groups": str(test["groups"]),
                "specimens": int(test["specimens"]),
                "distance": finite_or_none(float(test["distance"])),
                "share": float(test["R2"]),
                "p": float(test["P"]),
            }
        )
    return tests


def _spread(space: ShapeSpace, values: np.ndarray, n: int) -> list[float]:
    """Return values of the specimens with a shape as a column of all n; NaN for the others."""
    column = np.full(n, np.nan)
    column[space.specimens] = values
    return column.tolist()
