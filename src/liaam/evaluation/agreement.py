"""Automatic landmarks beside people's, for statistics of shape: do they vary as much, and about the same mean?

Errors of landmarks do not tell. A model draws shapes towards its mean where an image says little, so that automatic
shapes vary less than the specimens: means, variances and differences between groups are then too small (attenuation).
With c, x and y the automatic shapes and those of two people, as deviations from their means after one Procrustes
superimposition, and sums over specimens and coordinates,

    slope = sum c y / sum x y,        variance ratio = sum c c / sum x y.

People's errors do not enter the products of different people. If only one has placed landmarks, y is x, and the slope
is that on the labels with their errors: it is too small by the labels' reliability.

The same products of group means, instead of specimens, say what becomes of a difference between groups. Two more ratios
are those of measurement error models (Carroll et al. 2006, chapters 1, 3 and 4): the reliability ratio, which is the
squared correlation slope^2 / (variance ratio), and the factor of regression calibration, slope / (variance ratio), by
which deviations from the mean are multiplied before they serve as predictors.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import json_value, short_repr
from liaam.io.files import count_of
from liaam.morphometry.groups import large_groups
from liaam.morphometry.replicates import anova
from liaam.morphometry.superimposition import superimpose
from liaam.morphometry.variation import permutation_probability
from liaam.plotting.shape_agreement import figure_of_shape_agreement
from liaam.tables import Columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FEWEST = 5  # Specimens from which variances are compared
PERMUTATIONS = 999  # Random changes of sign for the test of the means
COMPONENTS = 6  # Principal components that are reported
# Largest distance between landmarks that are copies, as a fraction of the centroid size: by rounding of the last digits
# that files hold. A specimen of which half are copies counts as one.
COPIED = 1e-6
# The same for all landmarks of a specimen, which are then copies rounded to whole pixels. People do not repeat all
# landmarks so well: their errors are 0.3 % or more.
NEARLY_COPIED = 1e-3
# Share of a component's variance on which two people must agree, so that a slope on it is no ratio of their errors
LEAST_COMMON = 0.3
LEAST_VARIED = 1e-9  # Root mean squared deviation from the mean shape below which shapes are all the same
TOLERANCE = 1e-15  # Of the superimposition, whose slopes are compared to many digits in tests
LARGE_SHARE = 0.05  # Share of the variance of shape from which a component's slope is in the range that is reported
LOW_SLOPE = 0.8  # Slope below which more landmarks have to be placed
INTERVAL = 0.95  # Probability of the intervals


@dataclass(frozen=True, eq=False)
class ShapeAgreement:
    """How automatic shapes agree with people's.

    Attributes
    ----------
    n_specimens : int
        Specimens that are compared.
    n_individuals : int
        Individuals that these are records of, such as both sides or replicates of each; as many if each is of its own.
    n_left_out : int
        Specimens without all landmarks.
    n_copied : int
        Specimens whose labels are copies of the automatic landmarks, left out as well.
    n_estimated : int
        Specimens that are compared with some automatic landmarks estimated, as those that a fit found absent.
    slope : float
        Slope of automatic on people's shapes: a difference between groups appears multiplied by about this.
    slope_interval : tuple of float
        95 % confidence interval of the slope, by the jackknife over individuals.
    attenuation : float
        Differences between the groups' means in automatic shapes as a multiple of those in people's; NaN without
        groups.
    attenuation_interval : tuple of float
        Its 95 % confidence interval.
    variance_ratio : float
        Variance of automatic shapes as a multiple of that of the specimens.
    mean_distance : float
        Procrustes distance between the mean shapes, as a multiple of the standard error of people's mean.
    mean_distance_of_people : float
        The same between the mean shapes of two people; NaN if only one has placed landmarks.
    p_of_means : float
        Probability of so large a distance if both means are equal: by random changes of sign of each individual's
        differences.
    size_correlation : float
        Correlation of the centroid sizes.
    size_ratio : float
        Geometric mean of the ratios of automatic to people's centroid sizes.
    repeatability : float
        Intraclass correlation of automatic and people's shapes, from a Procrustes analysis of variance.
    repeatability_of_people : float
        That of both people's shapes; NaN if only one has placed landmarks.
    components : list of dict
        For each principal component of people's shapes: share of the variance, slope, variance ratio and correlation.
        Slope and ratio are NaN where two people agree on less than 0.3 of the variance.
    bias : (n, 2) float64
        Mean difference of each landmark, automatic less people's, in units of centroid size.
    random_error : (n,) float64
        Root mean square of what else differs, in units of centroid size.
    mean : (n, 2) float64
        Mean of people's shapes, of centroid size 1.
    scores : (2, m) float64
        First principal component of people's shapes: the scores of automatic and of people's shapes.
    """

    n_specimens: int
    n_individuals: int
    n_left_out: int
    n_copied: int
    slope: float
    slope_interval: tuple[float, float]
    attenuation: float
    attenuation_interval: tuple[float, float]
    variance_ratio: float
    mean_distance: float
    p_of_means: float
    size_correlation: float
    size_ratio: float
    repeatability: float
    repeatability_of_people: float
    components: list[dict[str, float]]
    bias: np.ndarray
    random_error: np.ndarray
    mean: np.ndarray
    scores: np.ndarray
    n_estimated: int = 0
    mean_distance_of_people: float = np.nan

    __repr__ = short_repr

    @property
    def reliability(self) -> float:
        """Reliability ratio of automatic shapes: squared correlation with those of the specimens."""
        return self.slope**2 / self.variance_ratio if self.variance_ratio > 0 else np.nan

    @property
    def calibration(self) -> float:
        """Factor of regression calibration, for deviations of automatic shapes from their mean."""
        return self.slope / self.variance_ratio if self.variance_ratio > 0 else np.nan

    def by_component(self) -> Columns:
        """Return one row per principal component of people's shapes."""
        columns: Columns = {"component": list(range(1, len(self.components) + 1))}
        for name in ("share", "slope", "variance_ratio", "correlation"):
            columns[name] = [component[name] for component in self.components]
        return columns

    def by_landmark(self) -> Columns:
        """Return bias and random error of each landmark, in per cent of the centroid size."""
        return {
            "landmark": list(range(1, len(self.bias) + 1)),
            "bias_x_percent": (100 * self.bias[:, 0]).tolist(),
            "bias_y_percent": (100 * self.bias[:, 1]).tolist(),
            "random_percent": (100 * self.random_error).tolist(),
        }

    def report(self) -> str:
        """Describe the agreement in some lines of text."""
        specimens = self._counted
        by_chance = "as by chance" if self.p_of_means > 0.05 else "more than by chance"
        people = ""
        if np.isfinite(self.repeatability_of_people):
            people = f"; of the shapes of two people: {self.repeatability_of_people:.3f}"
        low = ""
        if self.slope < LOW_SLOPE:
            remedy = "place landmarks on more pictures, and train again"
            low = f"; below {LOW_SLOPE:g}, true differences appear too small: {remedy}"
        lines = [
            f"shapes of {specimens}{self._left_out()}: automatic shapes have {self.variance_ratio:.2f} times the "
            f"variance of shapes placed by hand; slope on these {self.slope:.2f} ({_range(self.slope_interval)}){low}",
            f"intraclass correlation of automatic shapes and shapes placed by hand: {self.repeatability:.3f}{people}",
            f"squared correlation with {self._compared_with}: {self.reliability:.2f}; factor of regression "
            f"calibration: {self.calibration:.2f}",
            f"mean shapes: apart by {self.mean_distance:.1f} standard errors of the mean by hand{self._of_people()}; "
            f"{by_chance}, by random changes of sign (P = {self.p_of_means:.3f})",
            f"centroid sizes: correlation {self.size_correlation:.3f}, ratio {self.size_ratio:.3f}",
            f"a difference between groups appears multiplied by about {self._of_groups()}{self._by_components()}",
        ]
        return "\n".join(lines)

    def methods(self) -> str:
        """Return two sentences for the section *Methods* of a paper."""
        people = "placed by a person"
        repeated = ""
        if np.isfinite(self.repeatability_of_people):
            people = "placed twice by people"
            repeated = f" (between people {self.repeatability_of_people:.2f})"
        specimens = self._counted
        probability = f"P = {self.p_of_means:.3f}" if self.p_of_means >= 0.001 else "P < 0.001"
        return (
            f"Automatic landmarks of {specimens} were compared with landmarks {people}, after a Procrustes "
            f"superimposition: automatic shapes had {self.variance_ratio:.2f} times their variance, a slope of "
            f"{self.slope:.2f} on them (95 % confidence interval {_range(self.slope_interval)}), an intraclass "
            f"correlation of {self.repeatability:.2f}{repeated} and a squared correlation of {self.reliability:.2f} "
            f"with {self._compared_with}. The mean shapes were {self.mean_distance:.1f} standard errors of the mean by "
            f"hand apart{self._of_people()} (random changes of sign, {probability}), the correlation of centroid sizes "
            f"was {self.size_correlation:.3f}, and a difference between groups is expected to appear multiplied by "
            f"{self._of_groups()}{self._by_components()}."
        )

    def to_json(self) -> str:
        """Return all numbers and the sentences for *Methods* as text in JSON; what is unknown is null."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        values |= {"reliability": self.reliability, "calibration": self.calibration, "methods": self.methods()}
        return json.dumps(json_value(values), indent=1) + "\n"

    def plot(self) -> "Figure":
        """Draw bias and random error of the landmarks, slopes by component, and scores of the first component."""
        slopes = np.array([component["slope"] for component in self.components])
        ratios = np.array([component["variance_ratio"] for component in self.components])
        return figure_of_shape_agreement(self.mean, self.bias, self.random_error, slopes, ratios, self.scores)

    def _left_out(self) -> str:
        """Return how many specimens are not compared, or by estimates, in brackets; nothing if all are as they are."""
        counts = []
        if self.n_estimated:
            counts.append(f"{self.n_estimated} of them with absent landmarks, at the positions that the fits estimate")
        if self.n_left_out:
            counts.append(f"{self.n_left_out} left out, which lack landmarks")
        if self.n_copied:
            counts.append(f"{self.n_copied} left out, whose landmarks by hand are copies of the automatic landmarks")
        return f" ({'; '.join(counts)})" if counts else ""

    @property
    def _counted(self) -> str:
        """The number of specimens; if some are of one individual, as records of so many."""
        if self.n_individuals == self.n_specimens:
            return count_of(self.n_specimens, "specimen")
        return f"{count_of(self.n_specimens, 'record')} of {count_of(self.n_individuals, 'individual')}"

    @property
    def _compared_with(self) -> str:
        """The shapes of the squared correlation: their errors are known only if two people have placed landmarks."""
        return "the true shapes" if np.isfinite(self.repeatability_of_people) else "the shapes placed by hand"

    def _of_people(self) -> str:
        """Return how far apart the mean shapes of two people are, if two have placed landmarks."""
        return f" (two people: {self.mean_distance_of_people:.1f})" if np.isfinite(self.mean_distance_of_people) else ""

    def _by_components(self) -> str:
        """Return the range of slopes along the larger principal components, if several are known."""
        slopes = [each["slope"] for each in self.components if each["share"] >= LARGE_SHARE]
        slopes = [slope for slope in slopes if np.isfinite(slope)]
        if len(slopes) < 2:
            return ""
        return f"; along single principal components, {min(slopes):.2f} to {max(slopes):.2f}"

    def _of_groups(self) -> str:
        """Return the attenuation of given groups, with its interval, or else the slope."""
        if not np.isfinite(self.attenuation):
            return f"{self.slope:.2f}"
        return f"{self.attenuation:.2f} ({_range(self.attenuation_interval)})"


def compare_shapes(
    automatic: np.ndarray,
    labels: np.ndarray,
    second: np.ndarray | None = None,
    *,
    groups: Sequence[str] | None = None,
    individuals: Sequence[str] | None = None,
    estimated: Sequence[bool] | None = None,
    permutations: int = PERMUTATIONS,
    seed: int = 0,
) -> ShapeAgreement:
    """Compare automatic landmarks of some specimens with those that one or two people have placed.

    Parameters
    ----------
    automatic, labels : (m, n, 2) float64
        Landmarks of the same specimens. Specimens that lack landmarks (NaN), or have all in one place, are left out,
        and so are those whose labels are copies of the automatic landmarks.
    second : (m, n, 2) float64, optional
        Landmarks that another person has placed, or the same person again.
    groups : sequence of str, optional
        Group of each specimen, such as its species or sex; empty if unknown.
    individuals : sequence of str, optional
        Individual of each specimen. Specimens of one are not independent: confidence intervals, the standard error of
        the mean and the test of the means are those of individuals. By default each is of its own.
    estimated : sequence of bool, optional
        Whether some automatic landmarks of each specimen are estimates, which the report then says.
    permutations : int
        Random changes of sign for the test of the means.
    seed : int
        Seed of these.

    Raises
    ------
    LiaamError
        If fewer than 5 individuals have all landmarks, the arrays differ in shape, the labels of all are copies of the
        automatic landmarks, or fewer than two groups have two specimens.
    """
    sets = _checked_sets(automatic, labels, second)
    if groups is not None and len(groups) != len(sets[0]):
        raise LiaamError(f"{len(groups)} groups of {len(sets[0])} specimens: give one for each specimen")
    if individuals is not None and len(individuals) != len(sets[0]):
        raise LiaamError(f"{len(individuals)} individuals of {len(sets[0])} specimens: give one for each specimen")
    owners = np.arange(len(sets[0])) if individuals is None else _numbered(individuals)
    choice = _chosen(sets, owners)
    owners = _numbered(owners[choice.used].tolist())
    codes = None if groups is None else _codes(np.asarray(groups)[choice.used], owners)
    used = [each[choice.used] for each in sets]
    shapes = _superimposed(used)
    slope, slope_interval = _with_interval(lambda kept: _slope(*shapes.of(kept)), owners)
    attenuation, attenuation_interval = _attenuation(shapes, codes, owners)
    components, scores = _components(shapes.ours, shapes.first, shapes.other)
    differences = shapes.positions[0] - shapes.positions[1]
    bias = differences.mean(axis=0)
    random = (differences - bias).reshape(shapes.n, -1, 2)
    standard_error = _error_of_mean(shapes.first, owners)
    sizes = [np.linalg.norm(each - each.mean(axis=1, keepdims=True), axis=(1, 2)) for each in used]
    between_people = between_means = np.nan
    if second is not None:
        between_people = _repeatability(shapes.positions[1], shapes.positions[2])
        between_means = float(np.linalg.norm((shapes.positions[2] - shapes.positions[1]).mean(axis=0)) / standard_error)
    return ShapeAgreement(
        n_specimens=shapes.n,
        n_individuals=int(owners.max()) + 1,
        n_left_out=int((~choice.complete).sum()),
        n_copied=int(choice.copied.sum()),
        mean_distance_of_people=between_means,
        n_estimated=0 if estimated is None else int(np.asarray(estimated, bool)[choice.used].sum()),
        slope=slope,
        slope_interval=slope_interval,
        attenuation=attenuation,
        attenuation_interval=attenuation_interval,
        variance_ratio=_product(shapes.ours, shapes.ours) / _product(shapes.first, shapes.other),
        mean_distance=float(np.linalg.norm(bias) / standard_error),
        p_of_means=_probability_of(differences, owners, permutations, seed),
        size_correlation=float(np.corrcoef(np.log(sizes[0]), np.log(sizes[1]))[0, 1]),
        size_ratio=float(np.exp(np.mean(np.log(sizes[0] / sizes[1])))),
        repeatability=_repeatability(shapes.positions[0], shapes.positions[1]),
        repeatability_of_people=between_people,
        components=components,
        bias=bias.reshape(-1, 2),
        random_error=np.sqrt(np.square(random).sum(axis=2).mean(axis=0)),
        mean=shapes.positions[1].mean(axis=0).reshape(-1, 2),
        scores=scores,
    )


@dataclass(frozen=True, eq=False)
class _Choice:
    """Which specimens are compared: those that are complete and no copies. All (m,) bool."""

    complete: np.ndarray
    copied: np.ndarray

    @property
    def used(self) -> np.ndarray:
        return self.complete & ~self.copied


@dataclass(frozen=True, eq=False)
class _Superimposed:
    """Superimposed shapes of the same specimens, of size 1: automatic ones, and those of one or two people.

    Attributes
    ----------
    positions : (k, m, d) float64
        Coordinates of each set, automatic ones first.
    ours, first, other : (m, d) float64
        Deviations from the mean of each set: automatic, one person's, and the last person's, who may be the same.
    """

    positions: np.ndarray
    ours: np.ndarray
    first: np.ndarray
    other: np.ndarray

    @property
    def n(self) -> int:
        """Number of specimens."""
        return len(self.ours)

    def of(self, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the deviations of some specimens, by index."""
        return self.ours[kept], self.first[kept], self.other[kept]


def _checked_sets(automatic: np.ndarray, labels: np.ndarray, second: np.ndarray | None) -> list[np.ndarray]:
    """Return the two or three sets of landmarks (m, n, 2); raise LiaamError if they differ in shape."""
    sets = [np.asarray(each, np.float64) for each in (automatic, labels, *(() if second is None else (second,)))]
    if any(each.shape != sets[0].shape for each in sets) or sets[0].ndim != 3:
        raise LiaamError("the landmarks are not of the same specimens: give arrays (m, n, 2) of equal shape")
    return sets


def _chosen(sets: Sequence[np.ndarray], owners: np.ndarray) -> _Choice:
    """Return which specimens can be compared, given the individual (m,) of each; raise LiaamError if too few."""
    complete = np.all([_have_a_shape(each) for each in sets], axis=0)
    copied = complete & np.any([_are_copies(sets[0], other) for other in sets[1:]], axis=0)
    choice = _Choice(complete, copied)
    n = len(np.unique(owners[choice.used]))
    if n >= FEWEST:
        return choice
    if copied.any():
        raise LiaamError(
            f"the landmarks by hand are copies of the automatic landmarks ({int(copied.sum())} of "
            f"{count_of(len(complete), 'specimen')}), and cannot be compared with them: give landmarks that people "
            "have placed"
        )
    what = "specimen" if len(np.unique(owners)) == len(owners) else "individual"
    raise LiaamError(
        f"{count_of(n, what)} with all landmarks: variances of shape are compared from {FEWEST} {what}s on"
    )


def _superimposed(sets: Sequence[np.ndarray]) -> _Superimposed:
    """Superimpose sets of landmarks (m, n, 2); raise LiaamError if all labels have one shape."""
    fit = superimpose(np.concatenate(sets), TOLERANCE)
    positions = fit.shapes.reshape(len(sets), len(sets[0]), -1)
    deviations = positions - positions.mean(axis=1, keepdims=True)
    first = deviations[1]
    if _product(first, first) < len(first) * LEAST_VARIED**2:
        raise LiaamError(
            "the landmarks by hand of all specimens have the same shape, so there is no variance to compare"
        )
    return _Superimposed(positions, ours=deviations[0], first=first, other=deviations[-1])


def _attenuation(
    shapes: _Superimposed, codes: np.ndarray | None, owners: np.ndarray
) -> tuple[float, tuple[float, float]]:
    """Return the slope of group means and its confidence interval; NaN without groups."""
    if codes is None:
        return np.nan, (np.nan, np.nan)

    def slope_of_groups(kept: np.ndarray) -> float:
        return _slope(*(_group_means(each, codes[kept]) for each in shapes.of(kept)))

    return _with_interval(slope_of_groups, owners)


def _have_a_shape(points: np.ndarray) -> np.ndarray:
    """Return which shapes (m, n, 2) have all landmarks, and not all in one place, (m,) bool."""
    return np.isfinite(points).all(axis=(1, 2)) & np.ptp(points, axis=1).any(axis=1)


def _are_copies(automatic: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return the specimens whose labels (m, n, 2) are copies of the automatic landmarks, (m,) bool."""
    with np.errstate(invalid="ignore"):
        sizes = np.linalg.norm(automatic - automatic.mean(axis=1, keepdims=True), axis=(1, 2))
        distances = np.linalg.norm(labels - automatic, axis=2) / sizes[:, None]
        half = (distances <= COPIED).mean(axis=1) >= 0.5
        return half | (distances <= NEARLY_COPIED).all(axis=1)


def _codes(groups: np.ndarray, owners: np.ndarray) -> np.ndarray:
    """Return the group of each specimen as a number, (m,) int; -1 where it is unknown, or of too few individuals."""
    numbers = {name: i for i, name in enumerate(large_groups(groups.tolist(), owners.tolist()))}
    return np.array([numbers.get(group, -1) for group in groups.tolist()])


def _group_means(deviations: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Return the mean deviation of the group of each specimen, (m, d), less that of all that are in groups."""
    kept = deviations[codes >= 0]
    of_group = codes[codes >= 0]
    means = np.zeros_like(kept)
    for code in np.unique(of_group):
        means[of_group == code] = kept[of_group == code].mean(axis=0)
    return means - kept.mean(axis=0)


def _product(first: np.ndarray, second: np.ndarray) -> float:
    """Return the sum of the products of deviations (m, d)."""
    return float(np.sum(first * second))


def _slope(ours: np.ndarray, first: np.ndarray, other: np.ndarray) -> float:
    """Return the slope of automatic deviations (m, d) on those of one person, or of two people."""
    ours, first, other = (each - each.mean(axis=0) for each in (ours, first, other))
    return _product(ours, other) / _product(first, other)


def _numbered(individuals: Sequence[str] | Sequence[int]) -> np.ndarray:
    """Return individuals as numbers from 0 in the order of their first specimens, (m,) int."""
    numbers = {individual: i for i, individual in enumerate(dict.fromkeys(individuals))}
    return np.array([numbers[individual] for individual in individuals], int)


def _with_interval(statistic: Callable[[np.ndarray], float], owners: np.ndarray) -> tuple[float, tuple[float, float]]:
    """Return a statistic of specimens and its confidence interval by the jackknife (Efron & Tibshirani 1993, 11).

    All specimens of an individual, given by its number (m,), are left out together.
    """
    from scipy.stats import t

    n = int(owners.max()) + 1
    value = statistic(np.arange(len(owners)))
    left_out = np.array([statistic(np.flatnonzero(owners != i)) for i in range(n)])
    error = float(np.sqrt((n - 1) / n * np.square(left_out - left_out.mean()).sum()))
    half = float(t.ppf(0.5 + INTERVAL / 2, n - 1)) * error
    return value, (value - half, value + half)


def _sums(values: np.ndarray, owners: np.ndarray) -> np.ndarray:
    """Return the sums (n, d) of the values (m, d) of each individual, given by its number (m,)."""
    sums = np.zeros((int(owners.max()) + 1, values.shape[1]))
    np.add.at(sums, owners, values)
    return sums


def _error_of_mean(deviations: np.ndarray, owners: np.ndarray) -> float:
    """Return the standard error of the mean shape, from deviations (m, d) of specimens of individuals (m,)."""
    sums = _sums(deviations, owners)
    n = len(sums)
    return float(np.sqrt(_product(sums, sums) * n / (n - 1))) / len(deviations)


def _repeatability(first: np.ndarray, second: np.ndarray) -> float:
    """Return the intraclass correlation of superimposed shapes (m, d) of the same specimens."""
    specimens = [str(i) for i in range(len(first))]
    return anova(np.concatenate([first, second]), specimens * 2, np.ones(1))["repeatability"]


def _range(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.2f} to {interval[1]:.2f}"


def _probability_of(differences: np.ndarray, owners: np.ndarray, permutations: int, seed: int) -> float:
    """Return the probability of a mean difference as large by random changes of sign of differences (m, d).

    Those of an individual, given by its number (m,), change together.
    """
    rng = np.random.default_rng(seed)
    sums = _sums(differences, owners)
    observed = np.linalg.norm(sums.sum(axis=0))
    signs = rng.choice([-1.0, 1.0], (permutations, len(sums)))
    by_chance = np.linalg.norm(signs @ sums, axis=1)
    return permutation_probability(by_chance, float(observed))


def _components(ours: np.ndarray, first: np.ndarray, other: np.ndarray) -> tuple[list[dict[str, float]], np.ndarray]:
    """Compare deviations (m, d) along the principal components of the first person's.

    Also return the scores of the first component, (2, m): automatic and people's.
    """
    _, singular, axes = np.linalg.svd(first, full_matrices=False)
    count = min(COMPONENTS, int((singular > 1e-9 * singular[0]).sum()))
    rows = []
    for axis, value in zip(axes[:count], singular[:count], strict=True):
        c = ours @ axis
        x = first @ axis
        y = other @ axis
        common = float(x @ y)
        if common < LEAST_COMMON * float(x @ x):
            common = np.nan
        scale = float(np.sqrt((c @ c) * (x @ x)))
        rows.append(
            {
                "share": float(value**2 / np.square(singular).sum()),
                "slope": float(c @ y) / common,
                "variance_ratio": float(c @ c) / common,
                "correlation": float(c @ x) / scale if scale > 0 else np.nan,
            }
        )
    return rows, np.stack([ours @ axes[0], first @ axes[0]])
