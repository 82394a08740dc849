"""Estimate missing landmarks from complete specimens, as ``estimate.missing`` of geomorph (Gunz et al. 2009).

Two methods, of which each takes what the landmarks that are there say of those that are missing:

- ``tps``: the thin-plate spline that maps the mean of the complete specimens to the landmarks that are there;
- ``regression``: the linear regression of the missing coordinates on the others among complete specimens, on scores
  along the axes of two-block partial least squares, as there may be more coordinates than specimens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from liaam.errors import LiaamError
from liaam.fitting.result import USABLE
from liaam.io.files import some_names
from liaam.model.shape import Similarity, align
from liaam.morphometry.measures import ScaleBar, indices_of, parse_scale
from liaam.morphometry.specimens import Specimen
from liaam.morphometry.superimposition import superimpose
from liaam.scale.lengths import UNITS, Length

METHODS = ("tps", "regression")

FEWEST = 2
"""Least number of complete specimens."""

FEWEST_POINTS = 3
"""Least number of landmarks of a specimen that is completed, which an affine map needs."""

_THINNEST = 1e-6  # width of the landmarks that are there, relative to their length, below which they lie on one line


def with_estimated_landmarks(
    specimens: Sequence[Specimen], method: str, scale: str | float | ScaleBar | None = None
) -> tuple[tuple[Specimen, ...], tuple[str, ...]]:
    """Estimate the missing landmarks of specimens from those that are complete.

    Parameters
    ----------
    specimens : sequence of Specimen
        With the same landmarks, as :func:`liaam.morphometry.alike` gives them, and of one side
        (:func:`liaam.morphometry.of_one_side`).
    method : {"tps", "regression"}
        Thin-plate spline, or regression. Sizes count, above all for regression: those by the scale if it is known of
        all specimens, or else those in pixels, for which all should have been photographed at one scale.
    scale : str, float or ScaleBar, optional
        As in :func:`liaam.measure`. The ends of a scale bar are neither used nor estimated.

    Returns
    -------
    specimens : tuple of Specimen
        Landmarks that were estimated are listed in `Specimen.estimated`, and have no covariance. Specimens whose status
        says that they should not be used are left as they are.
    left : tuple of str
        A sentence for each specimen whose landmarks could not be estimated.

    Raises
    ------
    LiaamError
        If the method is unknown, or fewer than two specimens are complete.
    """
    _check_method(method)
    specimens = tuple(specimens)
    usable = {"", *USABLE}
    used = [i for i, specimen in enumerate(specimens) if specimen.status in usable and len(specimen.points)]
    if not used:
        return specimens, ()
    first = specimens[used[0]]
    bar = scale if scale is None or isinstance(scale, ScaleBar) else parse_scale(str(scale))
    ends = indices_of("scale bar", bar.ends, first.names, len(first.points)) if isinstance(bar, ScaleBar) else []
    inside = [index for index in range(len(first.points)) if index not in ends]
    points = np.array([specimens[i].points[inside] for i in used])
    pixels = _lengths_of_pixels([specimens[i] for i in used], bar, ends)[:, None, None]
    estimates, faults = estimate_missing(points * pixels, method, [specimens[i].name for i in used])
    completed = list(specimens)
    for i, estimate in zip(used, estimates / pixels, strict=True):
        specimen = specimens[i]
        filled = specimen.points.copy()
        filled[inside] = estimate
        gaps = np.isnan(specimen.points[:, 0]) & np.isfinite(filled[:, 0])
        if not gaps.any():
            continue
        covariances = specimen.covariances
        if covariances is not None:
            covariances = np.where(gaps[:, None, None], np.nan, covariances)
        which = tuple(sorted({*specimen.estimated, *np.flatnonzero(gaps).tolist()}))
        completed[i] = replace(specimen, points=filled, covariances=covariances, estimated=which)
    return tuple(completed), faults


def _lengths_of_pixels(
    specimens: Sequence[Specimen], rule: ScaleBar | Length | str | None, ends: Sequence[int]
) -> np.ndarray:
    """Return the length of a pixel of each specimen, (m,) float64; 1 for all if it is not known of all, or the same."""
    same = np.ones(len(specimens))
    if isinstance(rule, Length):
        return same
    if isinstance(rule, ScaleBar):
        lengths = [rule.length / np.linalg.norm(np.diff(each.points[[*ends]], axis=0)) for each in specimens]
    else:
        have_units = all(each.unit for each in specimens)
        if not have_units and any(each.unit for each in specimens):
            return same  # which measuring refuses
        lengths = [(each.scale or np.nan) * UNITS.get(each.unit, 1.0) for each in specimens]
    found = np.array(lengths)
    return found if (np.isfinite(found) & (found > 0)).all() else same


def estimate_missing(shapes: np.ndarray, method: str, names: Sequence[str] = ()) -> tuple[np.ndarray, tuple[str, ...]]:
    """Estimate missing points of shapes from those that are complete.

    Parameters
    ----------
    shapes : (m, k, 2) float
        NaN where missing.
    method : {"tps", "regression"}
    names : sequence of str, optional
        Names of the shapes for messages; numbers from 1 by default.

    Returns
    -------
    shapes : (m, k, 2) float64
        In the coordinates that were given; unchanged where points are there or could not be estimated.
    faults : tuple of str
        A sentence for each shape whose points could not be estimated.

    Raises
    ------
    LiaamError
        If the method is unknown, or a point is missing and fewer than two shapes are complete.
    """
    _check_method(method)
    shapes = np.array(shapes, np.float64)
    names = names or [str(i + 1) for i in range(len(shapes))]
    missing = np.isnan(shapes[..., 0])
    whole = missing.sum(axis=1) == 0
    broken = np.flatnonzero(~whole).tolist()
    if not missing.any():
        return shapes, ()
    if whole.sum() < FEWEST:
        raise LiaamError(
            f"{whole.sum()} of {len(shapes)} specimens have all landmarks, and two are needed to estimate those that "
            f"others lack: complete some of {some_names([names[i] for i in broken])}"
        )
    fit = superimpose(shapes[whole])
    complete = fit.shapes * fit.sizes[:, None, None]
    reference = complete.mean(axis=0)
    faults = []
    for i in broken:
        gaps = missing[i]
        try:
            if method == "tps":
                shapes[i, gaps] = _by_spline(reference, shapes[i], gaps)
            else:
                shapes[i, gaps] = _by_regression(reference, complete, shapes[i], gaps)
        except _UndeterminedError as fault:
            faults.append(f"{names[i]}: {fault}")
    return shapes, tuple(faults)


class _UndeterminedError(Exception):
    """The points that are there do not determine those that are missing."""


def _check_method(method: str) -> None:
    if method not in METHODS:
        raise LiaamError(f"missing landmarks cannot be estimated by '{method}': give {' or '.join(METHODS)}")


def _check_known(n_known: int, n_missing: int) -> None:
    if n_known < FEWEST_POINTS:
        raise _UndeterminedError(
            f"{n_missing} of {n_known + n_missing} landmarks are missing, and are not estimated: at least "
            f"{FEWEST_POINTS} must be there"
        )


def _by_spline(reference: np.ndarray, shape: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Map missing points of a reference (k, 2) by the thin-plate spline to the points that are there."""
    from scipy.interpolate import RBFInterpolator

    known = ~gaps
    _check_known(int(known.sum()), int(gaps.sum()))
    # The spline is the same at any size of the reference, and best determined at a size of 1.
    source = reference / np.abs(reference).max()
    spread = np.linalg.svd(source[known] - source[known].mean(axis=0), compute_uv=False)
    if spread[1] < _THINNEST * spread[0]:
        raise _UndeterminedError("the landmarks that are there lie on one line; the missing ones are not estimated")
    spline = RBFInterpolator(source[known], shape[known], kernel="thin_plate_spline")
    return spline(source[gaps])


def _by_regression(reference: np.ndarray, complete: np.ndarray, shape: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Predict missing points from the others by the regression among complete specimens (m, k, 2).

    As in geomorph, the points that are there are turned, but not scaled, to those of the reference, about the centroid
    of both, and the axes are those of the sums of products of the coordinates, not of their covariances.
    """
    known = ~gaps
    _check_known(int(known.sum()), int(gaps.sum()))
    if len(complete) < 2 * gaps.sum() + 2:
        raise _UndeterminedError(
            f"{gaps.sum()} landmarks are missing, for which regression needs {2 * gaps.sum() + 2} complete specimens, "
            f"and there are {len(complete)}; they are not estimated: take --estimate tps"
        )
    centre = shape[known].mean(axis=0)
    target = reference[known] - reference[known].mean(axis=0)
    turn = align(shape[known] - centre, target)
    turn = Similarity(turn.matrix / turn.scale, np.zeros(2))
    given = turn(shape[known] - centre).ravel()
    x = complete[:, known].reshape(len(complete), -1)
    y = complete[:, gaps].reshape(len(complete), -1)
    left, _, right = np.linalg.svd(x.T @ y, full_matrices=False)
    scores = np.column_stack([np.ones(len(x)), x @ left])
    slopes = np.linalg.lstsq(scores, y @ right.T, rcond=None)[0]
    predicted = np.concatenate([[1.0], given @ left]) @ slopes @ right
    return turn.inverse()(predicted.reshape(-1, 2)) + centre
