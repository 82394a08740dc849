"""Measurement error from replicates: Procrustes analysis of variance and repeatability."""

import math
import re
import warnings
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from liaam.errors import LiaamError
from liaam.io.files import some_names
from liaam.morphometry.curves import semilandmarks
from liaam.morphometry.sides import object_name, refuse_uneven, structure_name
from liaam.morphometry.specimens import Specimen
from liaam.morphometry.table import comparable, measures_in, scales_in, sizes_in
from liaam.tables import Columns

_FEWEST_PAIRS = 2  # objects that two files share, to compare the orders of their landmarks: one may be an outlier
_CLEARLY = 4.0  # least factor by which another order must bring landmarks closer together, so that no error is one

REPEATED = 2.0
"""Ratio of the variance of errors that fits state to that between their replicates above which replicates repeat each
other's errors. Covariances are right to about a factor of two."""

BY_COVARIANCES = "sd_by_covariances"
"""Column of the standard deviation of a replicate that its covariances state."""

_COMPARING = ("df_among", "df_within", "ms_among", "ms_within", "F", "P", "repeatability")
"""Columns that compare specimens with replicates; the others are of replicates only."""


def measurement_error(specimens: Sequence[Specimen], columns: Columns, by: str, slid: bool = False) -> Columns:
    """Compare specimens with replicates within specimens (Klingenberg & McIntyre 1998; Fruciano 2016).

    Parameters
    ----------
    specimens : sequence of Specimen
        All replicates, as :func:`liaam.morphometry.alike` gives them. Specimens may differ in their number.
    columns : dict of str to list
        What :func:`liaam.measure` made of them. Specimens with estimated landmarks do not count: an estimate is no
        observation. Nor do sizes without a scale where others have one: pixels do not compare with units.
    by : str
        ``"image"``: records of one object of an image are replicates, as :func:`liaam.read_specimens` found
        (`Specimen.replicate_of`); where that is unknown, those of one name before a ``#`` (``wing1``, ``wing1#2``).
        ``"code"``: specimens of one code are. ``"individual"``: those of one individual and side are.
        Otherwise the text before the number of a replicate in names, such as
        ``"_"`` in ``wing1_1`` and ``wing1_2``; of objects ``tray_1#3`` and ``tray_2#3`` of images, those of one number.
        Then, where specimens state their individual, those of one individual and side are replicates, unless their
        names state two sides, as of an image that was flipped.
    slid : bool
        Whether semilandmarks slid. Each then has one degree of freedom instead of two.

    Returns
    -------
    dict of str to list
        Rows: ``shape``, the measures, ``centroid_size``, and landmarks, without mean squares. ``sd`` is the standard
        deviation of replicates from their specimen's mean (of landmarks in pixels, x and y together), in ``unit``,
        which is empty for measures, as their names have it. ``sd_percent`` is that in percent of the mean value or
        centroid size. NaN where there are too few replicates. If standard errors of the replicates are known,
        ``sd_by_covariances`` is the root mean square of these. Fits to several images of a specimen repeat each other's
        errors, so that ``sd`` is then smaller (:func:`replicates_repeat_errors`).

    Raises
    ------
    LiaamError
        If no specimen has replicates, or images of the same objects have different numbers of them.
    """
    refuse_uneven(specimens, by)
    groups = _groups(specimens, by)
    if len(set(groups)) == len(groups):
        raise LiaamError(
            f"no specimen has replicates, as all names differ ({some_names(groups, 3)}): give 'image' if records of an "
            "image that lie on each other are replicates, or the text before the number of a replicate in names, such "
            "as _ in wing1_2"
        )
    is_estimated = np.array([bool(specimen.estimated) for specimen in specimens])

    def observed(values: np.ndarray) -> np.ndarray:
        """Return values (m, k) without those of specimens with estimated landmarks."""
        return np.where(is_estimated[:, None], math.nan, values)

    numbers = [int(name[1:]) for name in columns if re.fullmatch(r"X\d+", name)]
    shapes = np.empty((len(specimens), len(numbers), 2))
    for i, number in enumerate(numbers):
        shapes[:, i, 0] = columns[f"X{number}"]
        shapes[:, i, 1] = columns[f"Y{number}"]
    n_sliding = _count_semilandmarks(specimens) if slid else 0
    freedom = 2 * len(numbers) - 4 - n_sliding  # without position, size and angle
    flat = shapes.reshape(len(specimens), -1)
    errors = _errors_of_shapes(columns, numbers)
    counts = Counter(groups)
    is_repeated = ~is_estimated & np.array([counts[group] > 1 for group in groups])

    def stated(errors: np.ndarray) -> dict[str, float]:
        """Return the root mean square of the standard errors (m,) of replicates."""
        known = errors[is_repeated & np.isfinite(errors)]
        return {BY_COVARIANCES: float(np.sqrt(np.square(known).mean())) if len(known) else math.nan}

    rows: list[dict[str, Any]] = [
        {"measure": "shape", "unit": "centroid size"}
        | anova(observed(flat), groups, np.ones(1), freedom)
        | stated(_joint(errors))
    ]

    for name in measures_in(columns):
        values = comparable(columns, name)
        unknown = np.full(len(specimens), math.nan)
        of_measure = comparable(columns, f"{name}_se") if f"{name}_se" in columns else unknown
        rows.append(
            {"measure": name, "unit": ""} | anova(observed(values[:, None]), groups, values) | stated(of_measure)
        )

    sizes_px = _sizes_in_pixels(columns)
    names = next((specimen.names for specimen in specimens if specimen.names), ())
    for i, number in enumerate(numbers):
        points = shapes[:, i] * sizes_px[:, None]
        of_landmark = _joint(errors[:, i]) * sizes_px
        if by == "image" and not slid:  # records of one image share its coordinates
            points = _positions(specimens, number)
            of_landmark = np.array([_error_of_landmark(specimen, number) for specimen in specimens])
        row = {"measure": f"landmark {names[number - 1] if names else number}", "unit": "px"}
        row |= anova(observed(points), groups, sizes_px)
        row |= dict.fromkeys(_COMPARING, math.nan)  # positions in different images do not compare
        rows.append(row | stated(of_landmark))
    table = {name: [row[name] for row in rows] for name in rows[0]}
    if np.isnan(table[BY_COVARIANCES]).all():
        del table[BY_COVARIANCES]
    return table


def replicates_repeat_errors(error: Columns) -> bool:
    """Return whether replicates of shapes differ by far less than the covariances of their landmarks state.

    So do fits to several images of one specimen: each has nearly the same error, which replicates do not show. The
    repeatability is then that of taking the image, and not the reliability of the shapes.

    Parameters
    ----------
    error : dict of str to list
        What :func:`measurement_error` returns.
    """
    if BY_COVARIANCES not in error:
        return False
    return bool(error[BY_COVARIANCES][0] ** 2 > REPEATED * error["sd"][0] ** 2)


def _errors_of_shapes(columns: Columns, numbers: Sequence[int]) -> np.ndarray:
    """Return the standard errors of Procrustes coordinates, (m, k, 2) float64; NaN where unknown."""
    unknown = [math.nan] * len(columns["specimen"])
    errors = [[columns.get(f"{axis}{number}_se", unknown) for axis in "XY"] for number in numbers]
    return np.array(errors, np.float64).reshape(len(numbers), 2, -1).transpose(2, 0, 1)


def _joint(errors: np.ndarray) -> np.ndarray:
    """Return the root of the sum of squares of the standard errors (m, ...) of each record, (m,)."""
    return np.sqrt(np.square(errors.reshape(len(errors), -1)).sum(axis=1))


def _error_of_landmark(specimen: Specimen, number: int) -> float:
    """Return the standard error of x and y together of a landmark, counted from 1, in pixels; NaN if unknown."""
    if specimen.covariances is None or not specimen.is_usable:
        return math.nan
    return float(np.sqrt(max(0.0, np.trace(specimen.covariances[number - 1]))))


def _count_semilandmarks(specimens: Sequence[Specimen]) -> int:
    """Return the number of landmarks that slide along the curves of specimens."""
    curves = next((specimen.curves for specimen in specimens if specimen.curves), ())
    _, sliding = semilandmarks(curves)
    return len(sliding)


def _sizes_in_pixels(columns: Columns) -> np.ndarray:
    """Return the centroid sizes (m,) of specimens in pixels."""
    sizes = np.array(sizes_in(columns))
    scales = scales_in(columns)
    if not scales:
        return sizes
    return sizes / np.where(np.array(scales) > 0, scales, 1.0)  # sizes without a scale are in pixels


def _positions(specimens: Sequence[Specimen], number: int) -> np.ndarray:
    """Return where a landmark, counted from 1, is in the images of specimens, (m, 2) pixels; NaN if not to be used."""
    positions = np.full((len(specimens), 2), math.nan)
    for i, specimen in enumerate(specimens):
        if specimen.is_usable:
            positions[i] = specimen.points[number - 1]
    return positions


def _groups(specimens: Sequence[Specimen], by: str) -> list[str]:
    """Return what the replicates of each specimen have in common; see :func:`measurement_error`."""
    name_of = object_name if by == "image" else structure_name
    return [name_of(specimen, by) for specimen in specimens]


def exchanged_landmarks(specimens: Sequence[Specimen], by: str) -> list[str]:
    """Find landmarks that files number in different orders, from replicates in them.

    Parameters
    ----------
    specimens : sequence of Specimen
        As :func:`liaam.morphometry.alike` gives them.
    by : str
        What tells replicates, as in :func:`measurement_error`.

    Returns
    -------
    list of str
        A sentence for each file whose order differs from that of the first.
    """
    records: dict[str, dict[str, np.ndarray]] = defaultdict(dict)  # points by file, of each object
    for specimen, group in zip(specimens, _groups(specimens, by), strict=True):
        if specimen.file and len(specimen.points):
            records[specimen.file].setdefault(group, specimen.points)
    names = next((specimen.names for specimen in specimens if specimen.names), ())
    if not records:
        return []
    first, *others = records
    found = []
    for other in others:
        shared = records[first].keys() & records[other].keys()
        pairs = [(records[first][group], records[other][group]) for group in sorted(shared)]
        order = _order_between(pairs) if len(pairs) >= _FEWEST_PAIRS else np.arange(0)
        moved = np.flatnonzero(order != np.arange(len(order))).tolist()
        if not moved:
            continue
        labels = [names[i] if names else str(i + 1) for i in moved]
        which = f"{', '.join(labels[:-1])} and {labels[-1]}"
        how = "are exchanged" if len(moved) == 2 else "are in different orders"
        found.append(f"landmarks {which} {how} between {first} and {other}: number them alike, and measure again")
    return found


def _order_between(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return the order of the second landmarks (n, 2) of pairs that suits the first best; as it is unless clear."""
    from scipy.optimize import linear_sum_assignment

    distances = []
    for points, others in pairs:
        moved = others + np.nanmedian(points - others, axis=0)  # files may count y from another side
        distances.append(np.linalg.norm(points[:, None] - moved, axis=2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of landmarks that are missing in all
        usual = np.nan_to_num(np.nanmedian(distances, axis=0), nan=0.0)
    identity = np.arange(len(usual))
    _, order = linear_sum_assignment(usual)
    moved_at = order != identity
    before = usual[identity, identity][moved_at].sum()
    after = usual[identity, order][moved_at].sum()
    return order if before > _CLEARLY * after else identity


def anova(values: np.ndarray, groups: Sequence[str], sizes: np.ndarray, freedom: float = 1) -> dict[str, float]:
    """Analyse the variance of values (n, d) between and within groups (n,). Rows with NaN are left out.

    A row has so many degrees of freedom. The standard deviation is also given in percent of the mean of the sizes, (n,)
    or (1,). What the rows are too few for is NaN.
    """
    from scipy.stats import f as f_distribution

    complete = np.isfinite(values).all(axis=1)
    values = values[complete]
    _, codes, counts = np.unique(np.asarray(groups)[complete], return_inverse=True, return_counts=True)
    n_groups = np.float64(len(counts))  # as float64, of which a division by 0 is NaN or infinite
    n_rows = np.float64(len(values))
    means = np.zeros((len(counts), values.shape[1]))
    np.add.at(means, codes, values / counts[codes, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        centre = values.sum(axis=0) / n_rows
        df_among = (n_groups - 1) * freedom
        df_within = (n_rows - n_groups) * freedom
        ss_within = np.square(values - means[codes]).sum()
        ss_among = np.square(means[codes] - centre).sum() if n_groups > 1 else math.nan  # of one group, rounding
        ms_among = ss_among / df_among
        ms_within = ss_within / df_within
        ratio = ms_among / ms_within
        # Number of replicates of a specimen, a mean that takes account of unequal numbers.
        n_each = (n_rows - np.square(counts).sum() / n_rows) / (n_groups - 1)
        sd = np.sqrt(ss_within / (n_rows - n_groups))
        mean_size = np.abs(np.nansum(sizes)) / np.isfinite(sizes).sum()
        return {
            "specimens": float(n_groups),
            "replicates": float(n_rows),
            "df_among": float(df_among),
            "df_within": float(df_within),
            "ms_among": float(ms_among),
            "ms_within": float(ms_within),
            "F": float(ratio),
            "P": float(f_distribution.sf(ratio, df_among, df_within)),
            "repeatability": float((ms_among - ms_within) / (ms_among + (n_each - 1) * ms_within)),
            "sd": float(sd),
            "sd_percent": float(100 * sd / mean_size),
        }
