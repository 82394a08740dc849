"""Measurement error from replicates: Procrustes analysis of variance and repeatability."""

import math
import re
import warnings
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from liaam.errors import LiaamError
from liaam.fitting.result import USABLE
from liaam.io.files import some_names
from liaam.morphometry.curves import semilandmarks
from liaam.morphometry.sides import object_name, refuse_uneven, structure_name
from liaam.morphometry.specimens import Specimen
from liaam.morphometry.table import comparable, scale_column, scales_in, sizes_in, unit_of_table
from liaam.tables import Columns

_FEWEST_PAIRS = 2  # objects that two files share, to compare the orders of their landmarks
_CLEARLY = 4.0  # least factor by which another order must bring landmarks closer together

_SQUARES = ("df_among", "df_within", "ms_among", "ms_within", "F", "P", "repeatability")


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
        ``"code"``: specimens of one code are. Otherwise the text before the number of a replicate in names, such as
        ``"_"`` in ``wing1_1`` and ``wing1_2``; of objects ``tray_1#3`` and ``tray_2#3`` of images, those of one number.
        Then, where specimens state their individual, those of one individual and side are replicates.
    slid : bool
        Whether semilandmarks slid. Each then has one degree of freedom instead of two.

    Returns
    -------
    dict of str to list
        Rows: ``shape``, the measures, ``centroid_size``, and landmarks, without mean squares. ``sd`` is the standard
        deviation of replicates from their specimen's mean (of landmarks in pixels, x and y together), ``sd_percent``
        that in percent of the mean value or centroid size. NaN where there are too few replicates.

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
    sizes = np.array(sizes_in(columns))
    scales = np.array(scales_in(columns) or [1.0] * len(sizes))
    pixels = sizes / np.where(scales > 0, scales, 1.0)
    numbers = [int(name[1:]) for name in columns if re.fullmatch(r"X\d+", name)]
    shapes = [np.array([columns[f"X{number}"], columns[f"Y{number}"]]).T for number in numbers]
    sliding = (
        len(semilandmarks(next((specimen.curves for specimen in specimens if specimen.curves), ()))[1]) if slid else 0
    )
    estimated = np.array([bool(specimen.estimated) for specimen in specimens])

    def observed(values: np.ndarray) -> np.ndarray:
        """Return values (m, k) without those of specimens with estimated landmarks."""
        return np.where(estimated[:, None], math.nan, values)

    flat = observed(np.concatenate([np.empty((len(sizes), 0)), *shapes], axis=1))
    rows = [{"measure": "shape"} | anova(flat, groups, np.ones(1), 2 * len(shapes) - 4 - sliding)]
    others = {"specimen", "side", "status", "estimated", scale_column(unit_of_table(columns))}
    others |= {f"{name}_se" for name in columns}
    for name in (name for name in columns if name not in others and not re.fullmatch(r"[XY]\d+", name)):
        values = comparable(columns, name)
        rows.append({"measure": name} | anova(observed(values[:, None]), groups, values))
    names = next((specimen.names for specimen in specimens if specimen.names), ())
    usable = {"", *USABLE}
    for number, shape in zip(numbers, shapes, strict=True):
        points = shape * pixels[:, None]
        if by == "image" and not slid:
            points = np.array(
                [specimen.points[number - 1] if specimen.status in usable else [math.nan] * 2 for specimen in specimens]
            )
        row = {"measure": f"landmark {names[number - 1] if names else number}"} | anova(
            observed(points), groups, pixels
        )
        rows.append(row | dict.fromkeys(_SQUARES, math.nan))  # positions in different images do not compare
    return {name: [row[name] for row in rows] for name in rows[0]}


def _groups(specimens: Sequence[Specimen], by: str) -> list[str]:
    """Return what the replicates of each specimen have in common; see :func:`measurement_error`."""
    if by == "image":
        return [object_name(specimen, by) for specimen in specimens]
    return [structure_name(specimen, by) for specimen in specimens]


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
    first, *others = records or [""]
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

    A row has so many degrees of freedom. The standard deviation is also given in percent of the mean of the sizes (n,).
    """
    from scipy.stats import f as f_distribution

    complete = np.isfinite(values).all(axis=1)
    values = values[complete]
    _, codes, counts = np.unique(np.asarray(groups)[complete], return_inverse=True, return_counts=True)
    n = np.float64(len(counts))
    total = np.float64(len(values))
    means = np.zeros((len(counts), values.shape[1]))
    np.add.at(means, codes, values / counts[codes, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        centre = values.sum(axis=0) / total
        df_among = (n - 1) * freedom
        df_within = (total - n) * freedom
        within = np.square(values - means[codes]).sum()
        ms_among = np.square(means[codes] - centre).sum() / df_among
        ms_within = within / df_within
        each = (total - np.square(counts).sum() / total) / (n - 1)  # replicates of a specimen
        ratio = ms_among / ms_within
        repeatability = (ms_among - ms_within) / (ms_among + (each - 1) * ms_within)
        chance = f_distribution.sf(ratio, df_among, df_within)
        squares = (df_among, df_within, ms_among, ms_within, ratio, chance, repeatability)
        sd = np.sqrt(within / (total - n))
        mean = np.abs(np.nansum(sizes)) / np.isfinite(sizes).sum()
        names = ("specimens", "replicates", *_SQUARES, "sd", "sd_percent")
        return dict(zip(names, map(float, (n, total, *squares, sd, 100 * sd / mean)), strict=True))
