"""Variance of shape, of specimens and of measuring: scores of principal components and group means, with their errors.

Shapes are measured with errors. With s the tangent coordinates of a specimen and C their covariance, carried from those
of its landmarks (:func:`liaam.morphometry.superimposition.tangent_covariances`), the variance of m shapes is split by
the method of moments,

    total = sum |s - mean|^2 / (m - 1) = specimens + measuring,        measuring = mean trace(C).

The share of the specimens is the reliability ratio (Carroll et al. 2006, section 1.1), as for wings of flies in Ragheb
et al. (2013). It assumes classical errors, which do not depend on the shape. Those of hand-placed landmarks are such.
Fits do not fulfil it: they draw shapes to a mean and away from it again, and their covariances also hold errors of the
labels, so that the ratio is too low. Of models of 40 wings it is 0.57 where the squared correlation with labels is
0.69, and of 40 cephalograms the errors exceed the variance where that is 0.57. It is then unknown, and
:func:`liaam.evaluation.compare_shapes` measures it.
"""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import json_value, short_repr
from liaam.io.files import count_of, some_names
from liaam.morphometry.groups import large_groups
from liaam.morphometry.sides import individuals_are_stated, individuals_of
from liaam.morphometry.specimens import Specimen
from liaam.morphometry.superimposition import superimpose, tangent_covariances
from liaam.tables import Columns

FEWEST = 3  # Specimens from which a variance of shape is split
COMPONENTS = 10  # Principal components that are reported at most
MOST_PERMUTATIONS = 100000  # They state a P to 1e-5; the time of the test grows with their number
ROUNDING = 1e-12  # Relative difference of two shares of the variance that are equal but for rounding
LEAST = 1e-9  # Standard deviation along a component, of the first one's, below which it is rounding


@dataclass(frozen=True, eq=False)
class ShapeVariation:
    """How shapes vary: between specimens, by measuring, and between groups.

    Attributes
    ----------
    names : tuple of str
        The m specimens that have a shape.
    groups : tuple of str
        Group of each, or empty.
    individuals : tuple of str
        Individual of each, if any has several specimens (sides, replicates), or empty. Groups are then compared by the
        means of individuals.
    n_left_out : int
        Specimens without a shape.
    landmarks : tuple of int
        Numbers of the k landmarks, from 1.
    total : float
        Variance of shape, in squared units of centroid size.
    measuring : float
        Part of it by errors of the landmarks; NaN if no covariances are known.
    scores, scores_se : (m, c) float64
        Scores of the first principal components, and their standard errors; NaN if unknown.
    shares : (c,) float64
        Share of each component in the variance.
    means : dict of str to (k, 2) float64
        Mean shape of each group, y upwards.
    means_se, means_se_by_measuring : dict of str to (k, 2) float64
        Standard errors of these, by differences of individuals and by measuring; and the part by measuring.
    tests : list of dict
        For all groups and for each two of several: ``groups``, ``specimens``, ``individuals``, ``distance`` (Procrustes
        distance between two means), ``R2`` (share of the groups in the variance between individuals) and ``P``.
    individuals_stated : bool
        Whether the individual of any specimen is known. If not, specimens are taken as independent.
    """

    names: tuple[str, ...]
    groups: tuple[str, ...]
    individuals: tuple[str, ...]
    n_left_out: int
    landmarks: tuple[int, ...]
    total: float
    measuring: float
    scores: np.ndarray
    scores_se: np.ndarray
    shares: np.ndarray
    means: dict[str, np.ndarray]
    means_se: dict[str, np.ndarray]
    means_se_by_measuring: dict[str, np.ndarray]
    tests: list[dict[str, str | float]]
    individuals_stated: bool = True

    __repr__ = short_repr

    @property
    def reliability(self) -> float:
        """Reliability ratio of classical errors: share of the specimens in the variance of shape; NaN if unknown."""
        return _reliability(self.total, self.measuring)

    @property
    def reliabilities(self) -> np.ndarray:
        """Reliability ratio of the scores of each component, (c,) float64, as :attr:`reliability`."""
        variances = self.scores.var(axis=0, ddof=1)
        errors = np.square(self.scores_se)
        pairs = zip(variances, _known_mean(errors), strict=True)
        return np.array([_reliability(total, measuring) for total, measuring in pairs])

    def by_specimen(self) -> Columns:
        """Return one row per specimen: its individual and group, if known, and scores ``PC1``, ``PC1_se``, ..."""
        columns: Columns = {"specimen": list(self.names)}
        if self.individuals:
            columns["individual"] = list(self.individuals)
        if self.groups:
            columns["group"] = list(self.groups)
        for i in range(self.scores.shape[1]):
            columns[f"PC{i + 1}"] = self.scores[:, i].tolist()
            if np.isfinite(self.scores_se).any():
                columns[f"PC{i + 1}_se"] = self.scores_se[:, i].tolist()
        return columns

    def by_component(self) -> Columns:
        """Return one row per principal component: its share of the variance, and its reliability ratio."""
        return {
            "component": list(range(1, len(self.shares) + 1)),
            "share": self.shares.tolist(),
            "variance": self.scores.var(axis=0, ddof=1).tolist(),
            "measuring": _known_mean(np.square(self.scores_se)).tolist(),
            "reliability": self.reliabilities.tolist(),
        }

    def by_group(self) -> Columns:
        """Return one row per group and landmark: the mean shape, its standard errors, and their part by measuring."""
        counts = ("specimens", "individuals") if self.individuals else ("specimens",)
        names = ("landmark", "x", "y", "x_se", "y_se", "x_se_by_measuring", "y_se_by_measuring")
        columns: Columns = {name: [] for name in ("group", *counts, *names)}
        for group, mean in self.means.items():
            columns["group"] += [group] * len(mean)
            columns["specimens"] += [self.groups.count(group)] * len(mean)
            if self.individuals:
                of_group = {who for who, own in zip(self.individuals, self.groups, strict=True) if own == group}
                columns["individuals"] += [len(of_group)] * len(mean)
            columns["landmark"] += list(self.landmarks)
            parts = {"": mean, "_se": self.means_se[group], "_se_by_measuring": self.means_se_by_measuring[group]}
            for end, values in parts.items():
                columns[f"x{end}"] += values[:, 0].tolist()
                columns[f"y{end}"] += values[:, 1].tolist()
        return columns

    def report(self) -> str:
        """Describe the variance of shape, and the differences between groups, as text."""
        left_out = f" ({self.n_left_out} without a shape left out)" if self.n_left_out else ""
        of = f" of {count_of(len(set(self.individuals)), 'individual')}" if self.individuals else ""
        lines = [f"variance of shape of {count_of(len(self.names), 'specimen')}{of}{left_out}: {self.total:.3g}"]
        if np.isnan(self.measuring):
            lines[0] += "; that of measuring is unknown, as the landmarks have no covariances"
        elif np.isnan(self.reliability):
            lines[0] += (
                f"; errors of the landmarks would make {self.measuring:.3g}, by their covariances, so that it cannot "
                "be split: compare with landmarks that people placed"
            )
        else:
            lines[0] += (
                f"; measurement error, by the covariances of the landmarks: {self.measuring:.3g} (reliability ratio of "
                f"the whole shape {self.reliability:.2f}, if errors do not depend on the shape)"
            )
        shown = zip(self.shares[:3], self.reliabilities[:3], strict=True)
        parts = [
            f"PC{i} {100 * share:.0f} %" + ("" if np.isnan(ratio) else f" ({ratio:.2f})")
            for i, (share, ratio) in enumerate(shown, 1)
        ]
        known = "" if np.isnan(self.reliabilities[:3]).all() else " (and the reliability ratio of the scores on each)"
        lines.append(f"principal components{known}: {', '.join(parts)}")
        if self.tests and (self.individuals or not self.individuals_stated):
            lines.append(self._how_compared())
        for test in self.tests:
            apart = "" if np.isnan(float(test["distance"])) else f"means {test['distance']:.3g} apart, "
            between = " between individuals" if self.individuals else ""
            lines.append(
                f"{test['groups']}: {apart}{100 * float(test['R2']):.0f} % of the variance of shape{between}, "
                f"P = {test['P']:.3f}"
            )
        return "\n".join(lines)

    def _how_compared(self) -> str:
        """Say that groups are compared by individuals, whose records are not independent; or else by specimens."""
        if not self.individuals:
            return (
                "groups are compared by specimens, which are taken as independent; if several are of one individual, "
                "such as both sides or replicates, state it: a column 'individual' of a table of your own "
                "(--specimens), or --replicates"
            )
        paired = len(in_several(self.individuals, self.groups))
        if not paired:
            return "groups are compared by the means of individuals, since the records of one are not independent"
        have = "individual has" if paired == 1 else "individuals have"
        return (
            f"{paired} {have} records in several groups: groups are compared by the means of each individual in each "
            "group, and exchanged only within individuals"
        )

    def to_json(self) -> str:
        """Return the variances, components and tests as text in JSON; what is unknown is null."""
        values = {
            "specimens": len(self.names),
            "individuals": len(set(self.individuals or self.names)),
            "individuals_stated": self.individuals_stated,
            "left_out": self.n_left_out,
            "variance": self.total,
            "variance_of_measuring": self.measuring,
            "reliability": self.reliability,
            "components": _rows(self.by_component()),
            "tests": self.tests,
        }
        return json.dumps(json_value(values), indent=1) + "\n"


def shape_variation(
    specimens: Sequence[Specimen],
    columns: Columns,
    groups: Sequence[str] | None = None,
    permutations: int = 999,
    seed: int = 0,
    by: str | None = None,
) -> ShapeVariation:
    """Split the variance of shape into that of specimens and of measuring, and compare groups.

    The test between groups is a permutation test of their share of the variance (Goodall 1991; Anderson 2001):
    individuals are exchanged with their errors, so that it holds whatever these are, if they are alike in all groups.
    Several specimens of one individual, such as both sides or replicates, are not independent: groups are compared by
    the means of individuals. Where the specimens of an individual are in several groups, its means in these are
    exchanged with each other only.

    Parameters
    ----------
    specimens : sequence of Specimen
        As :func:`liaam.morphometry.alike` gives them.
    columns : dict of str to list
        What :func:`liaam.measure` made of them.
    groups : sequence of str, optional
        Group of each specimen; empty if unknown.
    permutations : int
        Random permutations of the test, 0 to 100000; 0 for none.
    seed : int
        Seed of these.
    by : str, optional
        What tells replicates, as in :func:`liaam.morphometry.measurement_error`, where no individual is stated.

    Raises
    ------
    LiaamError
        If fewer than 3 specimens have a shape, fewer than two groups have two individuals with one, or the number of
        permutations is out of range.
    """
    if not 0 <= permutations <= MOST_PERMUTATIONS:
        raise LiaamError(f"{permutations} permutations: give 0 to {MOST_PERMUTATIONS}")
    numbers = [int(name[1:]) for name in columns if re.fullmatch(r"X\d+", name)]
    has_shape = np.isfinite(columns[f"X{numbers[0]}"]) if numbers else np.zeros(len(specimens), bool)
    used = [specimen for specimen, is_used in zip(specimens, has_shape, strict=True) if is_used]
    if len(used) < FEWEST:
        raise LiaamError(
            f"{count_of(len(used), 'specimen')} with a shape: the variance of shape is split from {FEWEST} specimens on"
        )
    inside = [number - 1 for number in numbers]
    shapes = np.array([specimen.points[inside] for specimen in used]) * (1.0, -1.0)  # y upwards
    fit = superimpose(shapes)
    covariances = _tangent_covariances(used, inside, shapes, fit.mean)
    flat = fit.shapes.reshape(len(used), -1)
    scores, axes, shares = principal_components(flat, COMPONENTS)
    scores_variances = np.einsum("ca,mab,cb->mc", axes, covariances, axes)  # along each axis, of each specimen
    total = float(np.square(flat - flat.mean(axis=0)).sum()) / (len(used) - 1)
    traces = np.trace(covariances, axis1=1, axis2=2)
    measuring = float(_known_mean(traces[:, None])[0])
    individuals = individuals_of(used, by)
    groups_of_used: tuple[str, ...] = ()
    compared: Sequence[str] = ()
    units = _Units.of(flat, covariances, individuals, [""] * len(used))
    if groups is not None:
        groups_of_used = tuple(group for group, is_used in zip(groups, has_shape, strict=True) if is_used)
        units = _Units.of(flat, covariances, individuals, groups_of_used)
        compared = large_groups(groups_of_used, individuals)
        _refuse_few_pairs(units, compared)
    means, means_se, by_measuring = _group_means(units, compared)
    return ShapeVariation(
        names=tuple(specimen.name for specimen in used),
        groups=groups_of_used,
        individuals=individuals if len(set(individuals)) < len(used) else (),
        n_left_out=len(specimens) - len(used),
        landmarks=tuple(numbers),
        total=total,
        measuring=measuring,
        scores=scores,
        scores_se=np.sqrt(np.maximum(scores_variances, 0.0)),
        shares=shares,
        means=means,
        means_se=means_se,
        means_se_by_measuring=by_measuring,
        tests=_tests(units, compared, permutations, seed),
        individuals_stated=individuals_are_stated(used, by),
    )


def in_several(individuals: Sequence[str], groups: Sequence[str]) -> list[str]:
    """Return the individuals that are in several groups; specimens in none have the group ""."""
    pairs = {(individual, group) for individual, group in zip(individuals, groups, strict=True) if group}
    counts = Counter(individual for individual, _ in pairs)
    return sorted(individual for individual, n in counts.items() if n > 1)


@dataclass(frozen=True, eq=False)
class _Units:
    """What is compared between groups: the mean of each individual's specimens in each of its groups.

    Attributes
    ----------
    shapes : (u, d) float64
        Mean tangent coordinates.
    covariances : (u, d, d) float64
        Mean covariances. Fits to several images of an individual repeat each other's errors, which thus do not cancel.
    individuals, groups : tuple of str
        Individual and group of each.
    n_specimens : (u,) int
        Specimens of each.
    """

    shapes: np.ndarray
    covariances: np.ndarray
    individuals: tuple[str, ...]
    groups: tuple[str, ...]
    n_specimens: np.ndarray

    @classmethod
    def of(cls, flat: np.ndarray, covariances: np.ndarray, individuals: Sequence[str], groups: Sequence[str]) -> _Units:
        """Return the units of specimens with tangent coordinates (m, d) and their covariances (m, d, d)."""
        members: dict[tuple[str, str], list[int]] = defaultdict(list)
        for i, key in enumerate(zip(individuals, groups, strict=True)):
            members[key].append(i)
        places = list(members.values())
        return cls(
            np.array([flat[each].mean(axis=0) for each in places]),
            np.array([covariances[each].mean(axis=0) for each in places]),
            tuple(individual for individual, _ in members),
            tuple(group for _, group in members),
            np.array([len(each) for each in places]),
        )


def principal_components(shapes: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return scores (m, c), axes (c, d) and shares of the variance (c,) of the first components of shapes (m, d).

    The sign of an axis is that of its largest coordinate.
    """
    deviations = shapes - shapes.mean(axis=0)
    _, singular, axes = np.linalg.svd(deviations, full_matrices=False)
    count = max(1, min(most, int((singular > LEAST * singular[0]).sum())))
    axes = axes[:count]
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)
    axes = axes * np.where(largest < 0, -1.0, 1.0)  # a component's sign is arbitrary
    squares = float(np.square(singular).sum())
    return deviations @ axes.T, axes, np.square(singular[:count]) / (squares or 1.0)


def _tangent_covariances(
    used: Sequence[Specimen], inside: Sequence[int], shapes: np.ndarray, mean: np.ndarray
) -> np.ndarray:
    """Return the covariances of specimens' tangent coordinates, (m, 2 k, 2 k); NaN where those of points are unknown.

    ``inside`` are the indices of the k landmarks of the shapes (m, k, 2), and ``mean`` (k, 2) is their mean.
    """
    upwards = np.diag([1.0, -1.0])
    result = np.full((len(used), 2 * len(inside), 2 * len(inside)), np.nan)
    for i, specimen in enumerate(used):
        if specimen.covariances is None or not np.isfinite(specimen.covariances[inside]).all():
            continue
        of_points = upwards @ specimen.covariances[inside] @ upwards
        result[i] = tangent_covariances(shapes[i : i + 1], of_points[None], mean)[0]
    return result


def _refuse_few_pairs(units: _Units, compared: Sequence[str]) -> None:
    """Raise if some individuals are in several groups and most are in one: either may be a mistake."""
    members = [(who, group) for who, group in zip(units.individuals, units.groups, strict=True) if group in compared]
    paired = in_several([who for who, _ in members], [group for _, group in members])
    n = len({who for who, _ in members})
    if 0 < 2 * len(paired) < n:
        raise LiaamError(
            f"{len(paired)} of {n} individuals have records in several groups, and others in one "
            f"({some_names(paired)}): correct their groups or individuals, or leave them out"
        )


def _group_means(
    units: _Units, compared: Sequence[str]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the mean shape (k, 2) of each group that is compared, its standard errors, and their part by measuring."""
    means = {}
    means_se = {}
    by_measuring = {}
    for name in compared:
        members = np.array([group == name for group in units.groups])
        n = int(members.sum())
        shapes = units.shapes[members]
        variances = np.diagonal(units.covariances[members], axis1=1, axis2=2)
        means[name] = shapes.mean(axis=0).reshape(-1, 2)
        means_se[name] = (shapes.std(axis=0, ddof=1) / np.sqrt(n)).reshape(-1, 2)
        by_measuring[name] = (np.sqrt(variances.sum(axis=0)) / n).reshape(-1, 2)
    return means, means_se, by_measuring


def _tests(units: _Units, compared: Sequence[str], permutations: int, seed: int) -> list[dict[str, str | float]]:
    """Test the difference of all groups, and of each two if there are more."""
    if not compared:
        return []
    pairs = list(combinations(compared, 2))
    sets = [tuple(compared), *pairs] if len(pairs) > 1 else pairs
    groups = np.array(units.groups)
    tests = []
    for names in sets:
        members = np.isin(groups, names)
        shapes = units.shapes[members]
        codes = np.searchsorted(sorted(names), groups[members])
        _, individuals = np.unique(np.array(units.individuals)[members], return_inverse=True)
        rng = np.random.default_rng(seed)
        share = _share(shapes, codes)
        by_chance = np.array([_share(shapes, _exchanged(codes, individuals, rng)) for _ in range(permutations)])
        distance = np.nan
        if len(names) == 2:
            distance = float(np.linalg.norm(shapes[codes == 0].mean(axis=0) - shapes[codes == 1].mean(axis=0)))
        tests.append(
            {
                "groups": " – ".join(names),
                "specimens": int(units.n_specimens[members].sum()),
                "individuals": int(individuals.max()) + 1,
                "distance": distance,
                "R2": share,
                "P": permutation_probability(by_chance, share) if permutations else np.nan,
            }
        )
    return tests


def _exchanged(codes: np.ndarray, individuals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Exchange the groups (u,) of units at random; within individuals (u,) if any is in several groups."""
    order = rng.permutation(len(codes))
    if individuals.max(initial=-1) + 1 == len(codes):
        return codes[order]
    exchanged = np.empty_like(codes)
    # Both lists name the units by individual: in their order, and in a random one.
    exchanged[np.argsort(individuals, kind="stable")] = codes[order[np.argsort(individuals[order], kind="stable")]]
    return exchanged


def permutation_probability(by_chance: np.ndarray, observed: float) -> float:
    """Return the probability of a value as large by chance, given values by chance (n,); 1 if there are none.

    The observed value counts as one of them (Phipson & Smyth 2010).
    """
    n_as_large = int((by_chance >= observed * (1 - ROUNDING)).sum())
    return (1 + n_as_large) / (1 + len(by_chance))


def _share(shapes: np.ndarray, codes: np.ndarray) -> float:
    """Return the share of the sum of squares of shapes (m, d) that is between groups."""
    counts = np.bincount(codes)
    centred = shapes - shapes.mean(axis=0)
    sums = np.zeros((len(counts), shapes.shape[1]))
    np.add.at(sums, codes, centred)
    total = float(np.square(centred).sum())
    return float((np.square(sums).sum(axis=1) / counts).sum()) / total if total > 0 else 0.0


def _reliability(total: float, measuring: float) -> float:
    """Return the share of a variance that is not by measuring; NaN if that exceeds it, or is unknown."""
    return float(1.0 - measuring / total) if 0.0 <= measuring < total else np.nan


def _known_mean(values: np.ndarray) -> np.ndarray:
    """Return the mean of the values (m, c) that are known, (c,); NaN if none is."""
    known = np.isfinite(values).all(axis=1)
    return values[known].mean(axis=0) if known.any() else np.full(values.shape[1], np.nan)


def _rows(columns: Columns) -> list[dict[str, str | float]]:
    """Return columns as rows."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
