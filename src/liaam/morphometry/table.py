"""Measure specimens into a table."""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from liaam.errors import LiaamError
from liaam.fitting.result import USABLE
from liaam.io.landmarks import Contour
from liaam.model.shape import procrustes_mean
from liaam.morphometry.curves import slide as slid
from liaam.morphometry.measures import (
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
from liaam.morphometry.specimens import Specimen
from liaam.tables import Columns

SpecimenRow = dict[str, str | float]

_USABLE = {"", *USABLE}


class _Item(NamedTuple):
    """A column to measure: its name, function, landmarks, and power of the length in its unit."""

    column: str
    function: Callable[[np.ndarray], Measured]
    indices: Sequence[int]
    power: int


def measure(
    specimens: Iterable[Specimen],
    measures: str | Iterable[str | Measure] = (),
    scale: str | float | ScaleBar | None = None,
    slide: str | None = None,
) -> Columns:
    """Measure specimens: distances, angles, areas, centroid size and Procrustes coordinates, with standard errors.

    Standard errors are carried from the landmarks' covariances by the delta method; errors of different landmarks are
    taken as independent.

    Parameters
    ----------
    specimens : iterable of Specimen
        Those that have other landmarks than most are left out with a warning, see :func:`alike`.
    measures : str, or iterable of str or Measure
        Such as ``"distance:1-5"``, ``"angle:1-2-3"`` (at landmark 2) and ``"area:1-2-3-4"``, by numbers counted from
        1 or by names.
    scale : str, float or ScaleBar, optional
        Length of a pixel, or a scale bar such as ``"11-12=5"``, whose ends are then not part of the shape. Default:
        each specimen's own. Specimens without any are in pixels, and their ``scale`` is NaN.
    slide : {"bending", "procrustes"}, optional
        Slide the points of curves between their ends first, to the least bending energy or Procrustes distance.

    Returns
    -------
    dict of str to list
        Columns, one row per specimen; ``pandas.DataFrame`` takes them. ``specimen``, ``status`` (if known), ``scale``
        (length of a pixel, if known), the measures (angles in degrees), ``centroid_size``, ``side`` (if known),
        ``estimated`` (landmarks that were missing, if any), and the Procrustes coordinates ``X1``, ``Y1``, ``X2``, ...
        with y upwards. Columns ``..._se`` hold the standard errors, if any covariance is known. Cells are NaN where a
        landmark is missing or the status says that the landmarks should not be used.

    Raises
    ------
    LiaamError
        If there is no specimen with landmarks or curves to use, or a measure names a landmark that does not exist.
    """
    specimens, left_out = alike(specimens)
    for line in left_out:
        warnings.warn(line, stacklevel=2)
    usable = [specimen for specimen in specimens if specimen.status in _USABLE]
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
    names = next((specimen.names for specimen in usable if specimen.names), ())
    places = [indices_of(item.column, item.landmarks, names, n) for item in wanted]
    rule = scale if scale is None or isinstance(scale, ScaleBar) else parse_scale(str(scale))
    bar = indices_of("scale bar", rule.ends, names, n) if isinstance(rule, ScaleBar) else []
    inside = [index for index in range(n) if index not in bar]
    items = [_Item(item.column, item, place, item.power) for item, place in zip(wanted, places, strict=True)]
    items.append(_Item("centroid_size", centroid_size, inside, 1))
    whole = [
        i for i, specimen in enumerate(specimens) if specimen.status in _USABLE and _has_shape(specimen.points[inside])
    ]
    specimens = specimens if slide is None else _slid(specimens, whole, inside, slide)
    mean = procrustes_mean(np.array([specimens[i].points[inside] for i in whole])) if whole else None
    with np.errstate(divide="ignore", invalid="ignore"):  # by points that are missing or coincide
        return _columns([_row(specimen, items, rule, bar, mean) for specimen in specimens])


def _slid(specimens: Sequence[Specimen], whole: Sequence[int], inside: Sequence[int], how: str) -> tuple[Specimen, ...]:
    """Slide the semilandmarks of the specimens that are whole along the curves of the first that has any."""
    place = {index: i for i, index in enumerate(inside)}
    curves = next((specimen.curves for specimen in specimens if specimen.curves and specimen.status in _USABLE), ())
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


def _has_shape(points: np.ndarray) -> bool:
    """Whether no point is missing and not all are the same."""
    return bool(np.isfinite(points).all() and np.ptp(points, axis=0).any())


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
    fitted = [specimen for specimen in specimens if specimen.status in _USABLE]
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
        if reason and specimen.status in _USABLE:
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
    curves = tuple(Contour(tuple(place[i] for i in curve.indices), curve.closed) for curve in specimen.curves)
    estimated = tuple(place[i] for i in specimen.estimated)
    return replace(
        specimen, points=specimen.points[order], covariances=spread, names=names, curves=curves, estimated=estimated
    )


def _row(
    specimen: Specimen,
    items: Sequence[_Item],
    rule: float | ScaleBar | None,
    bar: Sequence[int],
    mean: np.ndarray | None,
) -> SpecimenRow:
    """Measure one specimen. The last item is the centroid size."""
    row: SpecimenRow = {"specimen": specimen.name, "status": specimen.status}
    if specimen.status not in _USABLE:
        return row
    length, slope = _pixel(specimen, rule, bar)
    has_scale = length > 0 if isinstance(rule, ScaleBar) else rule is not None or specimen.scale is not None
    row["scale"] = length if has_scale else math.nan
    if not has_scale:
        length = 1.0
        slope = np.zeros_like(specimen.points)
    for item in items:
        value, change = item.function(specimen.points[item.indices])
        gradient = item.power * length ** (item.power - 1) * value * slope if item.power else np.zeros_like(slope)
        gradient[item.indices] += length**item.power * change
        row[item.column] = value * length**item.power
        row[f"{item.column}_se"] = float(_standard_errors(specimen.covariances, gradient[None])[0])
    labels = specimen.names or [str(number) for number in range(1, len(specimen.points) + 1)]
    row |= {"side": specimen.side, "estimated": " ".join(labels[index] for index in specimen.estimated)}
    inside = items[-1].indices
    if mean is not None and _has_shape(specimen.points[inside]):
        row |= _shape(specimen, inside, mean)
    return row


def _pixel(specimen: Specimen, rule: float | ScaleBar | None, bar: Sequence[int]) -> Measured:
    """Return the length of a pixel and its gradient by all points, (n, 2)."""
    gradient = np.zeros_like(specimen.points)
    if not isinstance(rule, ScaleBar):
        return float(rule or specimen.scale or 1.0), gradient
    length, change = distance(specimen.points[bar])
    if not length > 0:
        return math.nan, gradient
    gradient[bar] = -rule.length / length**2 * change
    return rule.length / length, gradient


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


def _columns(rows: Sequence[SpecimenRow]) -> Columns:
    """Transpose rows. Drop what is unknown of all, such as status, scale and standard errors."""
    names = list(max(rows, key=len))
    columns = {name: [row.get(name, math.nan) for row in rows] for name in names}
    optional = {"status", "scale", "side", "estimated", *(name for name in names if name.endswith("_se"))}
    unknown = {name for name in optional if all(cell == "" or cell != cell for cell in columns[name])}
    return {name: cells for name, cells in columns.items() if name not in unknown}
