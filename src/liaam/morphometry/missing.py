"""Estimate missing landmarks from complete specimens, as ``estimate.missing`` of geomorph (Gunz et al. 2009).

Two methods, of which each takes what the landmarks that are there say of those that are missing:

- ``tps``: the thin-plate spline that maps the mean of the complete specimens to the landmarks that are there;
- ``regression``: the linear regression of the missing coordinates on the others among complete specimens, on scores
  along the axes of two-block partial least squares, as there may be more coordinates than specimens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import LiaamError
from liaam.io.files import count_of, some_names
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

FAR = 4.0
"""Distance of an estimate from the mean position of the landmark, in root mean square distances of the same landmark in
complete specimens, beyond which it is doubtful. Of normal positions, about one in 15,000 or fewer are so far, if the
spread is that of many specimens."""

_FEWEST_TO_JUDGE = 5  # complete specimens, of which the spread can be known
_LEAST_SPREAD = 1e-4  # of the centroid size: below it, landmarks are in one place but for rounding

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

    See Also
    --------
    far_estimates : Which estimates are doubtful.
    estimated_on_a_side : Which landmarks are estimated in all specimens of one side.

    Raises
    ------
    LiaamError
        If the method is unknown, or fewer than two specimens are complete.
    """
    _check_method(method)
    specimens = tuple(specimens)
    used = [i for i, specimen in enumerate(specimens) if specimen.is_usable and len(specimen.points)]
    if not used:
        return specimens, ()
    first = specimens[used[0]]
    bar, ends = _bar(first, scale)
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


def _bar(
    specimen: Specimen, scale: str | float | ScaleBar | None
) -> tuple[ScaleBar | Length | str | None, Sequence[int]]:
    """Return a scale, and if it is a scale bar, which landmarks its ends are."""
    rule = scale if scale is None or isinstance(scale, ScaleBar) else parse_scale(str(scale))
    if not isinstance(rule, ScaleBar):
        return rule, []
    return rule, indices_of("scale bar", rule.ends, specimen.names, len(specimen.points))


def far_estimates(specimens: Sequence[Specimen], scale: str | float | ScaleBar | None = None) -> tuple[str, ...]:
    """Report estimated landmarks that lie far from where the same landmark lies in complete specimens.

    The landmarks that are not estimated are superimposed on their mean shape, by translation, rotation and scale. An
    estimate is far if its distance from the mean position of its landmark is more than :data:`FAR` times the root mean
    square distance of this landmark in complete specimens.

    Parameters
    ----------
    specimens : sequence of Specimen
        As :func:`with_estimated_landmarks` gives them.
    scale : str, float or ScaleBar, optional
        As in :func:`liaam.measure`. The ends of a scale bar are not used.

    Returns
    -------
    tuple of str
        For each specimen with such an estimate, its name, and each landmark with the ratio of the two distances. Empty
        if fewer than five specimens are complete.
    """
    used = [specimen for specimen in specimens if specimen.is_usable and len(specimen.points)]
    ends = [*_bar(used[0], scale)[1]] if used else []
    whole = np.array([specimen.points for specimen in used if not specimen.estimated])
    spots: dict[tuple[bytes, tuple[int, ...]], _Spots | None] = {}  # of specimens that lack the same landmarks
    lines = []
    for specimen in used:
        if not specimen.estimated:
            continue
        is_there = np.isfinite(specimen.points[:, 0])
        is_there[ends] = False
        key = is_there.tobytes(), specimen.estimated
        if key not in spots:
            spots[key] = _spots(whole, is_there, specimen.estimated)
        usual = spots[key]
        if usual is None:
            continue
        ratios = usual.distances(specimen.points[None])[0] / usual.spreads
        far = [
            f"{specimen.labels[i]} ({ratio:.0f} times)"
            for i, ratio in zip(usual.gaps, ratios, strict=True)
            if ratio > FAR
        ]
        if far:
            lines.append(f"{specimen.name}: {', '.join(far)}")
    return tuple(lines)


def estimated_on_a_side(specimens: Sequence[Specimen]) -> tuple[str, ...]:
    """Report landmarks that are estimated in all specimens of one side, and not in all of the other.

    Estimates follow the other landmarks, so that differences between the sides there are those of the estimates.

    Parameters
    ----------
    specimens : sequence of Specimen
        As :func:`with_estimated_landmarks` gives them.

    Returns
    -------
    tuple of str
        A sentence for each side.
    """
    used = [each for each in specimens if each.is_usable and each.side and np.isfinite(each.points).all()]
    sides = sorted({each.side for each in used})
    always = {side: set.intersection(*(set(each.estimated) for each in used if each.side == side)) for side in sides}
    if len(sides) != 2:
        return ()
    lines = []
    for side, other in (sides, sides[::-1]):
        only = sorted(always[side] - always[other])
        if only:
            labels = next(each.labels for each in used)
            named = some_names([labels[i] for i in only])
            what, it = ("landmark", "it") if len(only) == 1 else ("landmarks", "them")
            are = "is" if len(only) == 1 else "are"
            lines.append(
                f"{what} {named} {are} estimated in all {side} specimens: differences between the sides there are "
                f"those of the estimates. Place {it} in some of these, or remove {it} from all"
            )
    return tuple(lines)


@dataclass(frozen=True, eq=False)
class _Spots:
    """Where some landmarks lie in complete specimens that are superimposed by other landmarks.

    Attributes
    ----------
    known, gaps : list of int
        The landmarks by which shapes are superimposed, and the g others.
    target : (k,) complex128
        Mean positions of the first.
    centres : (g,) complex128
        Mean positions of the others.
    spreads : (g,) float64
        Root mean square distances of the others from these.
    """

    known: list[int]
    gaps: list[int]
    target: np.ndarray
    centres: np.ndarray
    spreads: np.ndarray

    def distances(self, shapes: np.ndarray) -> np.ndarray:
        """Return the distances (m, g) of the landmarks of shapes (m, n, 2) from their mean positions."""
        return np.abs(_placed(shapes, self.known, self.gaps, self.target) - self.centres)


def _spots(whole: np.ndarray, is_there: np.ndarray, gaps: Sequence[int]) -> _Spots | None:
    """Return where landmarks lie in the shapes (m, n, 2) that have all that are there; None if too few have."""
    gaps = [*gaps]
    known = [index for index in np.flatnonzero(is_there).tolist() if index not in gaps]
    if len(whole) < _FEWEST_TO_JUDGE or len(known) < FEWEST_POINTS:
        return None
    complete = whole[np.isfinite(whole[:, is_there]).all(axis=(1, 2))]
    complete = complete[np.ptp(complete[:, known], axis=1).any(axis=1)]  # not all in one place
    if len(complete) < _FEWEST_TO_JUDGE:
        return None
    mean = superimpose(complete[:, known]).mean
    target = mean[:, 0] + 1j * mean[:, 1]
    positions = _placed(complete, known, gaps, target)
    centres = positions.mean(axis=0)
    squares = np.square(np.abs(positions - centres)).sum(axis=0) / (len(complete) - 1)
    return _Spots(known, gaps, target, centres, np.maximum(np.sqrt(squares), _LEAST_SPREAD))


def _placed(shapes: np.ndarray, known: Sequence[int], gaps: Sequence[int], target: np.ndarray) -> np.ndarray:
    """Return landmarks (m, g) complex of shapes (m, n, 2), superimposed on a centred target by those that are known."""
    numbers = shapes[..., 0] + 1j * shapes[..., 1]
    numbers = numbers - numbers[:, known].mean(axis=1, keepdims=True)
    own = numbers[:, known]
    squares = np.square(np.abs(own)).sum(axis=1)
    turn = (own.conj() @ target) / np.where(squares > 0, squares, 1.0)
    return numbers[:, gaps] * turn[:, None]


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
    of both, and the axes are those of the sums of products of the coordinates, not of their covariances. The complete
    specimens keep the centroid of all their points. The predictors of an incomplete specimen are thus moved by the
    distance of both centroids, to where no complete specimen is, and the regression extrapolates. The more points of
    one end are missing, the farther; :func:`far_estimates` finds what it makes of that.
    """
    known = ~gaps
    _check_known(int(known.sum()), int(gaps.sum()))
    n_missing = int(gaps.sum())
    needed = 2 * n_missing + 2  # one more than the regression has coefficients
    if len(complete) < needed:
        are = "is" if n_missing == 1 else "are"
        raise _UndeterminedError(
            f"{count_of(n_missing, 'landmark')} {are} missing, for which regression needs {needed} complete specimens, "
            f"and there are {len(complete)}; nothing is estimated here: take --estimate tps"
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
