"""Measure specimens into a table."""

from __future__ import annotations

import math
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from liaam.errors import LiaamError
from liaam.io.landmarks import Contour
from liaam.model.shape import procrustes_mean
from liaam.morphometry.curves import slide as slid
from liaam.morphometry.measures import (
    DEGREES,
    Measure,
    Measured,
    ScaleBar,
    centroid_size,
    distance,
    indices_of,
    parse_scale,
    procrustes,
)
from liaam.morphometry.sides import are_unreflected
from liaam.morphometry.specimens import Specimen, has_shape
from liaam.scale.lengths import UNITS, Length
from liaam.tables import Columns

SpecimenRow = dict[str, str | float]

_SIZE = "centroid_size"
_SCALE = "scale"


class _Item(NamedTuple):
    """A column to measure: its name, function, landmarks, and power of the length in its unit."""

    column: str
    function: Callable[[np.ndarray], Measured]
    indices: Sequence[int]
    power: int


def measure(
    specimens: Iterable[Specimen],
    measures: str | Iterable[str | Measure] = (),
    scale: str | float | Length | ScaleBar | None = None,
    slide: str | None = None,
) -> Columns:
    """Measure specimens: distances, angles, areas, lengths, centroid size and Procrustes coordinates, with errors.

    Standard errors are carried from the landmarks' covariances, and from the errors of the scales, by the delta method;
    errors of different landmarks, and of a landmark and the scale, are taken as independent.

    Parameters
    ----------
    specimens : iterable of Specimen
        Those that have other landmarks than most are left out with a warning, see :func:`alike`.
    measures : str, or iterable of str or Measure
        Such as ``"distance:1-5"``, ``"angle:1-2-3"`` (at landmark 2), ``"area:1-2-3-4"`` and ``"length:1-2-3-4"`` (of
        the line through the landmarks), by numbers counted from 1 or by names. A name of the measure may come first, as
        in ``"wing length=distance:1-5"``, which is that of its column, ``wing_length``.
    scale : str, float, Length or ScaleBar, optional
        Length of a pixel, such as ``"0.0031 mm"``, or a scale bar such as ``"11-12=5 mm"``, whose ends are then not
        part of the shape. A unit alone, such as ``"mm"``, is that of the specimens whose scale has none. Default: each
        specimen's own scale. If the unit is known, specimens without a scale have no sizes; else they are in pixels.
    slide : {"bending", "procrustes"}, optional
        Slide the points of curves between their ends first, to the least bending energy or Procrustes distance.

    Returns
    -------
    dict of str to list
        Columns, one row per specimen; ``pandas.DataFrame`` takes them. ``specimen``, ``status`` (if known), ``scale``
        (length of a pixel, if known), the measures (angles in degrees), ``centroid_size``, ``individual`` and ``side``
        (if known), ``estimated`` (landmarks that were missing, if any), and the Procrustes coordinates ``X1``, ``Y1``,
        ``X2``, ... with y upwards. Where the unit is known, names have it, as in ``scale_mm_per_px``,
        ``distance_1_5_mm``, ``area_1_2_3_mm2`` and ``centroid_size_mm``. Columns ``..._se`` hold the standard errors,
        if any covariance is known. Cells are NaN where a landmark is missing or the status says that the landmarks
        should not be used.

    Raises
    ------
    LiaamError
        If there is no specimen with landmarks or curves to use, a measure names a landmark that does not exist, two
        measures have one name, some scales have a unit and others have none, or the scale is a unit alone and no
        specimen has one.
    """
    specimens, left_out = alike(specimens)
    for line in left_out:
        warnings.warn(line, stacklevel=2)
    usable = [specimen for specimen in specimens if specimen.is_usable]
    if not usable:
        raise LiaamError(f"there are {len(specimens)} specimens, none with landmarks to use: fit the images again.")
    if are_unreflected(usable):
        warnings.warn(
            "specimens of two sides are compared unreflected; pass them to liaam.morphometry.of_one_side before",
            stacklevel=2,
        )
    n = len(usable[0].points)
    given = [measures] if isinstance(measures, str) else measures
    wanted = [Measure.parse(item) if isinstance(item, str) else item for item in given]
    _check_columns(wanted)
    names = next((specimen.names for specimen in usable if specimen.names), ())
    places = [indices_of(item.column, item.landmarks, names, n) for item in wanted]
    rule = parse_scale(str(scale)) if isinstance(scale, str | float | int) else scale
    specimens, unit = _in_one_unit(specimens, rule)
    bar = indices_of("scale bar", rule.ends, names, n) if isinstance(rule, ScaleBar) else []
    inside = [index for index in range(n) if index not in bar]
    items = [
        _Item(in_unit(item.column, unit, item.power), item, place, item.power)
        for item, place in zip(wanted, places, strict=True)
    ]
    items.append(_Item(in_unit(_SIZE, unit, 1), centroid_size, inside, 1))
    whole = [i for i, specimen in enumerate(specimens) if specimen.is_usable and has_shape(specimen.points[inside])]
    specimens = specimens if slide is None else _slid(specimens, whole, inside, slide)
    mean = procrustes_mean(np.array([specimens[i].points[inside] for i in whole])) if whole else None
    with np.errstate(divide="ignore", invalid="ignore"):  # by points that are missing or coincide
        return _columns([_row(specimen, items, rule, bar, mean, unit) for specimen in specimens], unit)


def with_groups(columns: Columns, groups: Sequence[str], name: str = "group") -> Columns:
    """Return a table of :func:`measure` with the group of each specimen in a column of this name.

    It comes after the columns of the individual, side and size, and is called ``group`` if the name is that of another
    column.
    """
    before = next(key for key in reversed(columns) if key in ("individual", "side") or key.startswith(_SIZE))
    found: Columns = {}
    for key, cells in columns.items():
        found[key] = cells
        if key == before:
            found["group" if name in columns else name] = list(groups)
    return found


def _check_columns(wanted: Sequence[Measure]) -> None:
    """Raise if two measures of different landmarks would have one column."""
    known: dict[str, Measure] = {}
    for item in wanted:
        other = known.setdefault(item.column.casefold(), item)
        if replace(other, name="") != replace(item, name=""):
            raise LiaamError(f"two measures have the column '{item.column}': give one of them another name")


def in_unit(column: str, unit: str, power: int = 1) -> str:
    """Return the name of a column with its unit, as ``area_1_2_3_mm2``, if that is known."""
    return f"{column}_{unit}{power if power > 1 else ''}" if unit and power else column


def unit_of_table(columns: Columns) -> str:
    """Return the unit of the sizes in a table of measurements; empty if unknown, or pixels."""
    return next((unit for unit in UNITS if in_unit(_SIZE, unit) in columns), "")


def size_column(columns: Columns) -> str:
    """Return the name of the column of centroid sizes in a table of measurements."""
    return in_unit(_SIZE, unit_of_table(columns))


def sizes_in(columns: Columns) -> list[float]:
    """Return the centroid sizes in a table of measurements."""
    return columns[size_column(columns)]


def scale_column(unit: str) -> str:
    """Return the name of the column of the length of a pixel."""
    return f"{_SCALE}_{unit}_per_px" if unit else _SCALE


def scales_in(columns: Columns) -> list[float] | None:
    """Return the lengths of a pixel in a table of measurements; None if it has none."""
    return columns.get(scale_column(unit_of_table(columns)))


def comparable(columns: Columns, name: str) -> np.ndarray:
    """Return a column of measures (n,); where some specimens have a scale, NaN for sizes of those that have none.

    Pixels do not compare with units; angles do.
    """
    values = np.array(columns[name], np.float64)
    scales = scales_in(columns)
    is_angle = name.startswith("angle_") or name.endswith(DEGREES)
    return values if scales is None or is_angle else np.where(np.isfinite(scales), values, np.nan)


def measures_in(columns: Columns) -> list[str]:
    """Return the names of the columns that hold measures, without their standard errors."""
    others = {scale_column(unit_of_table(columns)), *(f"{name}_se" for name in columns)}
    others |= {name for name, cells in columns.items() if any(isinstance(cell, str) for cell in cells)}
    return [name for name in columns if name not in others and not re.fullmatch(r"[XY]\d+", name)]


def _in_one_unit(
    specimens: Sequence[Specimen], rule: Length | ScaleBar | str | None
) -> tuple[tuple[Specimen, ...], str]:
    """Return specimens whose scales are in one unit, and this unit: that of the rule, or else the most frequent one."""
    if isinstance(rule, Length | ScaleBar):
        return tuple(specimens), rule.unit
    scaled = [specimen for specimen in specimens if specimen.scale is not None]
    if rule and not scaled:
        raise LiaamError(
            f"scale '{rule}': no file states a scale that could be in {rule}: give the length of a pixel, such as "
            f"--scale '0.0031 {rule}', or a table of the scales that 'liaam scale' finds in the images"
        )
    units = Counter(specimen.unit for specimen in scaled if specimen.unit)
    unit = rule or (units.most_common(1)[0][0] if units else "")
    bare = next((specimen.name for specimen in scaled if not specimen.unit), None)
    if unit and not rule and bare is not None:
        known = next(specimen.name for specimen in scaled if specimen.unit)
        fault = f"the scale of {bare} has no unit, but that of {known} is in {unit}"
        raise LiaamError(f"{fault}: give the unit of those without, such as --scale {unit}")
    return tuple(_within(specimen, unit) for specimen in specimens), unit


def _within(specimen: Specimen, unit: str) -> Specimen:
    """Return a specimen with its scale in a unit."""
    if specimen.scale is None or not unit:
        return specimen
    length = Length(specimen.scale, specimen.unit, specimen.scale_se).within(unit)
    return replace(specimen, scale=length.value, scale_se=length.se, unit=unit)


def _slid(specimens: Sequence[Specimen], whole: Sequence[int], inside: Sequence[int], how: str) -> tuple[Specimen, ...]:
    """Slide the semilandmarks of the specimens that are whole along the curves of the first that has any."""
    place = {index: i for i, index in enumerate(inside)}
    curves = next((specimen.curves for specimen in specimens if specimen.curves and specimen.is_usable), ())
    chains = [Contour(tuple(place[i] for i in curve.indices if i in place), curve.closed) for curve in curves]
    if not curves:
        raise LiaamError("no specimen has curves to slide along: give landmark files with curves, such as .tps")
    shapes = np.array([specimens[i].points[inside] for i in whole]).reshape(-1, len(inside), 2)
    moved = list(specimens)
    for i, shape in zip(whole, slid(shapes, chains, how), strict=True):
        points = specimens[i].points.copy()
        points[inside] = shape
        moved[i] = replace(specimens[i], points=points, covariances=None)
    return tuple(moved)


def alike(specimens: Iterable[Specimen]) -> tuple[tuple[Specimen, ...], tuple[str, ...]]:
    """Keep the specimens that have the same landmarks, in one order, and tell why others are left out.

    Names decide where there are names: most specimens' names are those of all, in the order of the first of these
    specimens. Without names it is the number of landmarks that most have.

    Parameters
    ----------
    specimens : iterable of Specimen

    Returns
    -------
    used : tuple of Specimen
        With the same landmarks in the same order.
    left_out : tuple of str
        A sentence for each specimen that is left out.
    """
    specimens = tuple(specimens)
    fitted = [specimen for specimen in specimens if specimen.is_usable]
    if not fitted:
        return specimens, ()
    usual = Counter(len(specimen.points) for specimen in fitted).most_common(1)[0][0]
    sets = Counter(frozenset(specimen.names) for specimen in fitted if len(specimen.names) == usual)
    shared = sets.most_common(1)[0][0] if sets else frozenset()
    names = next((specimen.names for specimen in fitted if frozenset(specimen.names) == shared), ()) if shared else ()
    used = []
    left_out = []
    for specimen in specimens:
        absent = [name for name in names if name not in specimen.names]
        n = len(specimen.points)
        if specimen.names and absent:
            reason = f"it has no landmark {', '.join(absent[:5])}{' …' if len(absent) > 5 else ''}; it is left out"
        else:
            reason = f"it has {n} landmarks where most have {usual}; it is left out" if n != usual else ""
        if reason and specimen.is_usable:
            left_out.append(f"{specimen.name}: {reason}")
        else:
            used.append(specimen if reason else _in_order(specimen, names))
    return tuple(used), tuple(left_out)


def _in_order(specimen: Specimen, names: tuple[str, ...]) -> Specimen:
    """Return a specimen with its landmarks in the order of these names; without names it keeps its own order."""
    if not names or not specimen.names or specimen.names == names:
        return specimen
    order = [specimen.names.index(name) for name in names]
    spread = None if specimen.covariances is None else np.asarray(specimen.covariances)[order]
    place = {index: i for i, index in enumerate(order)}
    curves = tuple(replace(curve, indices=tuple(place[i] for i in curve.indices)) for curve in specimen.curves)
    estimated = tuple(place[i] for i in specimen.estimated)
    return replace(
        specimen, points=specimen.points[order], covariances=spread, names=names, curves=curves, estimated=estimated
    )


def _row(
    specimen: Specimen,
    items: Sequence[_Item],
    rule: Length | ScaleBar | str | None,
    bar: Sequence[int],
    mean: np.ndarray | None,
    unit: str,
) -> SpecimenRow:
    """Measure one specimen. The last item is the centroid size. Sizes in pixels are none in a known unit."""
    row: SpecimenRow = {"specimen": specimen.name, "status": specimen.status}
    if not specimen.is_usable:
        return row | {"individual": specimen.individual}
    length, slope, length_se = _pixel(specimen, rule, bar)
    scale = scale_column(unit)
    row[scale] = length
    row[f"{scale}_se"] = _joint(float(_standard_errors(specimen.covariances, slope[None])[0]), length_se)
    if length != length and not unit:
        length = 1.0
    for item in items:
        value, change = item.function(specimen.points[item.indices])
        by_length = item.power * length ** (item.power - 1) * value if item.power else 0.0
        gradient = by_length * slope
        gradient[item.indices] += length**item.power * change
        row[item.column] = value * length**item.power
        of_points = float(_standard_errors(specimen.covariances, gradient[None])[0])
        row[f"{item.column}_se"] = math.hypot(of_points, by_length * length_se)
    row |= {"individual": specimen.individual, "side": specimen.side}
    row["estimated"] = specimen.list_of(specimen.estimated)
    inside = items[-1].indices
    if mean is not None and has_shape(specimen.points[inside]):
        row |= _shape(specimen, inside, mean)
    return row


def _pixel(
    specimen: Specimen, rule: Length | ScaleBar | str | None, bar: Sequence[int]
) -> tuple[float, np.ndarray, float]:
    """Return the length of a pixel, NaN if unknown, its gradient by all points (n, 2), and its error besides."""
    gradient = np.zeros_like(specimen.points)
    if isinstance(rule, Length):
        return rule.value, gradient, rule.se
    if not isinstance(rule, ScaleBar):
        return (math.nan if specimen.scale is None else specimen.scale), gradient, specimen.scale_se
    length, change = distance(specimen.points[bar])
    if not length > 0:
        return math.nan, gradient, 0.0
    gradient[bar] = -rule.length / length**2 * change
    return rule.length / length, gradient, rule.se / length


def _joint(of_points: float, of_length: float) -> float:
    """Return the standard error of a scale, by the points of its bar and by the bar's length; NaN if there is none."""
    known = math.hypot(0.0 if of_points != of_points else of_points, of_length)
    return known or math.nan


def _standard_errors(covariances: np.ndarray | None, jacobian: np.ndarray) -> np.ndarray:
    """Carry the covariances of n landmarks to the errors of m values, given their derivatives (m, n, 2)."""
    if covariances is None:
        return np.full(len(jacobian), math.nan)
    touched = jacobian.any(axis=(0, 2))  # other landmarks may be missing
    jacobian = jacobian[:, touched]
    variances = np.einsum("mni,nij,mnj->m", jacobian, covariances[touched], jacobian)
    return np.sqrt(np.maximum(variances, 0.0))


def _shape(specimen: Specimen, inside: Sequence[int], mean: np.ndarray) -> SpecimenRow:
    """Return the Procrustes coordinates, y upwards, and then their standard errors."""
    shape, jacobian = procrustes(specimen.points[inside], mean)
    covariances = None if specimen.covariances is None else specimen.covariances[inside]
    errors = _standard_errors(covariances, jacobian.reshape(len(jacobian), -1, 2))
    row: SpecimenRow = {}
    for end, values in (("", shape * (1, -1)), ("_se", errors.reshape(shape.shape))):
        for index, (x, y) in zip(inside, values.tolist(), strict=True):
            row |= {f"X{index + 1}{end}": x, f"Y{index + 1}{end}": y}
    return row


def _columns(rows: Sequence[SpecimenRow], unit: str) -> Columns:
    """Transpose rows. Drop what is unknown of all, such as status, scale and standard errors."""
    names = list(max(rows, key=len))
    columns = {name: [row.get(name, math.nan) for row in rows] for name in names}
    errors = {name for name in names if name.endswith("_se")}
    optional = {"status", scale_column(unit), "side", "estimated", *errors}
    unknown = {name for name in optional if all(cell == "" or cell != cell for cell in columns[name])}
    if all(row["individual"] in ("", row["specimen"]) for row in rows):  # all are their own
        unknown.add("individual")
    return {name: cells for name, cells in columns.items() if name not in unknown}
