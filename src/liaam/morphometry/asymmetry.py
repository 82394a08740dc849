"""Asymmetry of specimens that were measured: individuals, sides, replicates and pairs from their names and tables."""

from __future__ import annotations

import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from liaam.errors import LiaamError
from liaam.formatting import short_repr
from liaam.io.files import natural_key, some_names
from liaam.model.shape import align
from liaam.morphometry.pairs import checked_twins, parse_pairs
from liaam.morphometry.replicates import REPEATED
from liaam.morphometry.sides import are_unreflected, individual_name, refuse_uneven, structure_name
from liaam.morphometry.specimens import Specimen
from liaam.morphometry.symmetry import (
    ERROR,
    FEWEST,
    INTERACTION,
    PERMUTATIONS,
    Asymmetry,
    matching_asymmetry,
    object_asymmetry,
)
from liaam.morphometry.table import comparable, size_column
from liaam.progress import Progress
from liaam.tables import Columns

OBJECT = "object"
MATCHING = "matching"
KINDS = (OBJECT, MATCHING)

BY_COVARIANCES = "error by covariances"
"""Row of the table of the second error term."""

_SHOWN = 3  # individuals that a message describes

_TOO_SMALL = 0.025
"""Probability of so small an interaction by the covariances below which they exceed what the sides differ by."""


@dataclass(frozen=True, eq=False)
class AsymmetryResult:
    """Asymmetry of individuals.

    Attributes
    ----------
    analysis : liaam.morphometry.symmetry.Asymmetry
        Components, indices and analysis of variance. Shapes have y upwards.
    individuals : tuple of str
        Name of each individual.
    sides : tuple of str
        The first and the second side: ``original`` and ``mirrored`` for object symmetry.
    landmarks : tuple of int
        Numbers of the landmarks that are part of the shape, counted from 1.
    twins : tuple of int
        For object symmetry, the number of each landmark's twin; its own on the midline.
    replicates : int
        Number of replicates of each side.
    permutations, seed : int
        See :func:`asymmetry`.
    left_out : tuple of str
        A sentence for each individual that is left out.
    n_estimated : int
        Number of records with estimated landmarks, which do not count in the error term.
    estimated : tuple of str
        Of each individual, the landmarks that are estimated on either side, by name or number, with semicolons between
        them. The differences between its sides include the error of these estimates.
    by_covariances : liaam.morphometry.symmetry.Asymmetry, optional
        The analysis of the means of replicates with the error that the landmarks' covariances state, if there are
        replicates and covariances; None otherwise. Replicates of fits repeat each other's errors, which covariances
        include.
    """

    analysis: Asymmetry
    individuals: tuple[str, ...]
    sides: tuple[str, str]
    landmarks: tuple[int, ...]
    twins: tuple[int, ...]
    replicates: int
    permutations: int
    seed: int
    left_out: tuple[str, ...]
    n_estimated: int = 0
    estimated: tuple[str, ...] = ()
    by_covariances: Asymmetry | None = None

    __repr__ = short_repr

    @property
    def error_by_covariances(self) -> dict[str, float] | None:
        """The second error term: its mean square ``MS``, and by it ``F`` and ``P`` of fluctuating asymmetry.

        None unless there are replicates and covariances. The mean square is that of a record, as that of replicates.
        """
        if self.by_covariances is None:
            return None
        anova = self.by_covariances.shape_anova
        return {"MS": anova["MS"][ERROR], "F": anova["F"][INTERACTION], "P": anova["P"][INTERACTION]}

    @property
    def replicates_repeat_errors(self) -> bool:
        """Whether replicates differ by far less than the covariances of their landmarks state.

        So do fits to several images of one specimen: each has nearly the same error, which replicates do not show.
        """
        other = self.error_by_covariances
        return other is not None and bool(other["MS"] > REPEATED * self.analysis.shape_anova["MS"][ERROR])

    @property
    def error_exceeds_differences(self) -> bool:
        """Whether the sides differ less than the covariances state, if errors of the two sides were independent.

        Then errors of both sides are alike, or the covariances too large, and fluctuating asymmetry cannot be tested
        by them: what counts is the part of the error by which the sides differ, which is unknown. It is so if fewer
        than one in 40 sets of random errors have as small an interaction.
        """
        if self.analysis.error != "covariances":
            return False
        # P counts those as large, and the observed one, which counts on both sides.
        as_small = 1 - self.analysis.shape_anova["P"][INTERACTION] + 1 / (self.permutations + 1)
        return bool(as_small <= _TOO_SMALL)

    def anova(self) -> Columns:
        """Return the analyses of variance as a table: rows of shape, and of centroid size for matching symmetry."""
        analysis = self.analysis
        parts = [("shape", analysis.shape_anova), ("centroid_size", analysis.size_anova)]
        parts = [(trait, part) for trait, part in parts if part]
        if self.error_by_covariances is not None:
            empty = {name: [math.nan] for name in analysis.shape_anova}
            parts.insert(1, ("shape", empty | {"effect": [BY_COVARIANCES], "MS": [self.error_by_covariances["MS"]]}))
        traits = [trait for trait, part in parts for _ in part["effect"]]
        return {"trait": traits} | {name: [each for _, part in parts for each in part[name]] for name in parts[0][1]}

    def indices(self) -> Columns:
        """Return the asymmetry of each individual as a table; with the column ``estimated`` if any landmark is."""
        analysis = self.analysis
        table: Columns = {
            "individual": list(self.individuals),
            "asymmetry": analysis.distances.tolist(),
            "fluctuating_asymmetry": analysis.fluctuating_distances.tolist(),
            "unsigned_AI": analysis.unsigned_index.tolist(),
        }
        if analysis.kind == MATCHING:
            table["log_size_ratio"] = analysis.size_ratios.tolist()
        if any(self.estimated):
            table["estimated"] = list(self.estimated)
        return table

    def components(self) -> Columns:
        """Return the components of shape as a table: mean, symmetric, asymmetric, directional and fluctuating."""
        analysis = self.analysis
        parts = [
            ("mean", [""], analysis.mean[None]),
            ("directional", self.sides, analysis.directional),
            ("symmetric", self.individuals, analysis.symmetric),
            ("asymmetric", self.individuals, analysis.asymmetric),
            ("fluctuating", self.individuals, analysis.fluctuating),
        ]
        table: Columns = {
            "component": [component for component, names, _ in parts for _ in names],
            "of": [name for _, names, _ in parts for name in names],
        }
        shapes = np.concatenate([each for _, _, each in parts])
        for i, number in enumerate(self.landmarks):
            table[f"X{number}"] = shapes[:, i, 0].tolist()
            table[f"Y{number}"] = shapes[:, i, 1].tolist()
        return table

    def to_dict(self) -> dict[str, Any]:
        """Convert the result to a dictionary that JSON can hold; values that are unknown are None."""
        analysis = self.analysis
        return {
            "symmetry": analysis.kind,
            "individuals": list(self.individuals),
            "sides": list(self.sides),
            "replicates": self.replicates,
            "landmarks": list(self.landmarks),
            "twins": list(self.twins) if analysis.kind == OBJECT else None,
            "error_term": analysis.error or None,
            "error_exceeds_differences": self.error_exceeds_differences,
            "error_by_covariances": self.error_by_covariances
            and {name: _known(value) for name, value in self.error_by_covariances.items()},
            "replicates_repeat_errors": self.replicates_repeat_errors,
            "without_estimated": self.n_estimated,
            "permutations": self.permutations,
            "seed": self.seed,
            "left_out": list(self.left_out),
            "anova": _rows(self.anova()),
            "indices": _rows(self.indices()),
            "components": _rows(self.components()),
        }

    def to_json(self) -> str:
        """Return :meth:`to_dict` as text."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False) + "\n"

    def drawing(self, specimens: Sequence[Specimen] = ()) -> dict[str, Any]:
        """Return the arguments of :func:`liaam.plotting.specimens.figure_of_asymmetry`.

        Contours are those of the first of the specimens that has any.
        """
        analysis = self.analysis
        place = {number - 1: i for i, number in enumerate(self.landmarks)}
        curves = next((specimen.curves for specimen in specimens if specimen.curves), ())
        lines = [[*curve.indices, *curve.indices[: int(curve.closed)]] for curve in curves]
        return {
            "mean": analysis.mean,
            "directional": analysis.directional,
            "fluctuating": analysis.fluctuating,
            "distances": analysis.fluctuating_distances,
            "names": self.individuals,
            "estimated": [bool(labels) for labels in self.estimated],
            "sides": self.sides,
            "error": self._distance_by_error(),
            "error_label": self._error_label(),
            "numbers": self.landmarks,
            "lines": [[place[index] for index in line if index in place] for line in lines],
        }

    def _distance_by_error(self) -> float:
        """Root mean square distance between the sides of an individual that the error alone makes; NaN if unknown.

        For object symmetry this takes half of the error as asymmetric.
        """
        return math.sqrt(2 * self.analysis.shape_anova["MS"][ERROR] / self.replicates)

    def _error_label(self) -> str:
        """What the figure calls the distance by the error."""
        if self.analysis.error != "covariances":
            return "by error alone"
        if self.error_exceeds_differences:
            return "by the stated error, which is alike on both\nsides or too large, so that it tests nothing"
        return "by the stated error, if independent on both sides"


def _rows(columns: Columns) -> list[dict[str, Any]]:
    """Return the rows of a table, with None for NaN."""
    cells = zip(*columns.values(), strict=True)
    return [dict(zip(columns, map(_known, row), strict=True)) for row in cells]


def _known(cell: Any) -> Any:
    return cell if isinstance(cell, str) else float(cell) if math.isfinite(cell) else None


def asymmetry(
    specimens: Sequence[Specimen],
    columns: Columns,
    kind: str,
    *,
    pairs: str | Sequence[int] | None = None,
    by: str | None = None,
    permutations: int = PERMUTATIONS,
    seed: int = 0,
    progress: Progress | bool | None = None,
) -> AsymmetryResult:
    """Analyse the asymmetry of shape.

    Parameters
    ----------
    specimens : sequence of Specimen
        Of one side, as :func:`liaam.morphometry.of_one_side` gives them.
    columns : dict of str to list
        What :func:`liaam.measure` made of them.
    kind : {"object", "matching"}
        Object symmetry, of one structure with landmarks on both sides; or matching symmetry, of two structures, such as
        wings, whose side is that of the specimens.
    pairs : str or sequence of int, optional
        For object symmetry: pairs of landmarks such as ``"1-2,3-4"``, or the name of a file of them, or the index of
        each landmark's twin. By default from the landmarks' names.
    by : str, optional
        What tells replicates, as in :func:`liaam.morphometry.measurement_error`. Specimens of one individual and side
        are replicates of it.
    permutations : int
        Number of permutations, 0 to 100,000.
    seed : int
        Seed of the random numbers.
    progress : callable or bool, optional
        See :func:`liaam.progress.reported`.

    Returns
    -------
    AsymmetryResult
        Individuals that lack a side or a shape, or have another number of replicates than most, are left out; as are,
        for matching symmetry, those with landmarks that contradict the stated side (`Specimen.stated_side`), unless
        the side is that of a fit. The error
        term comes from replicates, or without any from the covariances of the landmarks, if all have them; records with
        estimated landmarks do not count in it. If there are both, there is a second error term
        (`AsymmetryResult.error_by_covariances`). Individuals
        without a scale, where others have one, are left out of the analysis of centroid sizes alone.

    Raises
    ------
    LiaamError
        If the sides or pairs are unknown or do not suit, or fewer than two individuals remain.
    """
    if kind not in KINDS:
        raise LiaamError(f"symmetry '{kind}' is unknown: give {' or '.join(KINDS)}")
    if not 0 <= permutations <= 100_000:
        raise LiaamError(f"{permutations} permutations: give 0 to 100000")
    numbers = [int(name[1:]) for name in columns if re.fullmatch(r"X\d+", name)]
    if not numbers:
        raise LiaamError("no specimen has a shape whose asymmetry can be measured: landmarks are missing in all")
    sides = _sides(specimens) if kind == MATCHING else ("",)
    shapes = np.array([[columns[f"X{number}"], columns[f"Y{number}"]] for number in numbers]).transpose(2, 0, 1)
    refuse_uneven(specimens, by)
    groups = _groups(specimens, [bool(np.isfinite(shape).all()) for shape in shapes], by, sides)
    doubts = _doubts_about_sides(specimens, by) if kind == MATCHING else {}
    chosen, left_out = _chosen(groups, sides, doubts)
    if len(chosen) < FEWEST:
        raise LiaamError(_too_few(len(groups), chosen, left_out, kind))
    order = np.array([[groups[name][side] for side in sides] for name in chosen])  # (n, sides, r) specimens
    spread = _covariances(specimens, columns, shapes, numbers)
    estimated = np.array([bool(specimen.estimated) for specimen in specimens])[order]
    has_error = spread is not None and not estimated.all() and not np.isnan(spread[order][~estimated]).any()
    covariances = np.nan_to_num(spread[order]) if spread is not None and has_error else None
    options: dict[str, Any] = {"permutations": permutations, "seed": seed, "progress": progress}
    twins: tuple[int, ...] = ()
    by_covariances = None
    # Errors that replicates have in common remain in their means.
    means = shapes[order].mean(axis=2, keepdims=True)
    of_means = None if covariances is None or order.shape[2] == 1 else covariances.mean(axis=2, keepdims=True)
    are_estimated = np.logical_or.reduce(estimated, axis=2)[..., None]
    if kind == OBJECT:
        twins = _twins(specimens, numbers, pairs, shapes)
        of_object = None if covariances is None else covariances[:, 0]
        analysis = object_asymmetry(shapes[order[:, 0]], twins, of_object, estimated=estimated[:, 0], **options)
        if of_means is not None:
            by_covariances = object_asymmetry(
                means[:, 0], twins, of_means[:, 0], estimated=are_estimated[:, 0], only_error=True, **options
            )
        sides = ("original", "mirrored")
    else:
        sizes = comparable(columns, size_column(columns))[order]
        analysis = matching_asymmetry(shapes[order], covariances, estimated=estimated, sizes=sizes, **options)
        if of_means is not None:
            by_covariances = matching_asymmetry(means, of_means, estimated=are_estimated, only_error=True, **options)
    return AsymmetryResult(
        analysis,
        tuple(chosen),
        (sides[0], sides[-1]),
        tuple(numbers),
        tuple(numbers[twin] for twin in twins),
        replicates=order.shape[2],
        permutations=permutations,
        seed=seed,
        left_out=left_out,
        n_estimated=int(estimated.sum()),
        estimated=tuple(_labels_of_estimates([specimens[i] for i in each.flat]) for each in order),
        by_covariances=by_covariances,
    )


def _sides(specimens: Sequence[Specimen]) -> tuple[str, str]:
    """Return the two sides of specimens."""
    sides = sorted({specimen.side for specimen in specimens if not specimen.stated_side} - {""})
    if are_unreflected(specimens):
        raise LiaamError(
            f"the specimens of the sides {some_names(sides)} are not reflected to each other: pass them to "
            "liaam.morphometry.of_one_side before"
        )
    if len(sides) == 2:
        return sides[0], sides[1]
    found = f"only the side {sides[0]}" if sides else "no sides"
    which = some_names([specimen.name for specimen in specimens], _SHOWN)
    raise LiaamError(
        f"matching symmetry compares the left and right structures of individuals, and the specimens ({which}) have "
        f"{found}: name them such as wing1_left and wing1_right, put them into folders left and right under the same "
        "names, or add a column 'side' to the table"
    )


Groups = dict[str, dict[str, list[int]]]
"""Indices of the specimens with a shape, by individual and side."""


def _groups(specimens: Sequence[Specimen], has_shape: Sequence[bool], by: str | None, sides: Sequence[str]) -> Groups:
    """Group the specimens with a shape by individual and side.

    For object symmetry, which has one nameless side, left and right structures of an individual are different groups.
    """
    is_matching = len(sides) > 1
    groups: Groups = defaultdict(lambda: {side: [] for side in sides})
    for i, specimen in enumerate(specimens):
        of_individual = groups[individual_name(specimen, by) if is_matching else structure_name(specimen, by)]
        side = specimen.side if is_matching else ""
        if has_shape[i] and side in of_individual:
            of_individual[side].append(i)
    return dict(sorted(groups.items(), key=lambda item: natural_key(item[0])))


@dataclass(frozen=True)
class _Doubt:
    """What contradicts a side of an individual, and whether it is a fit, whose side is taken."""

    why: str
    is_of_fit: bool


def _doubts_about_sides(specimens: Sequence[Specimen], by: str | None) -> dict[str, _Doubt]:
    """Return what contradicts the stated sides, by individual; what landmarks of people contradict comes first."""
    doubts: dict[str, _Doubt] = {}
    for specimen in sorted(specimens, key=lambda each: bool(each.status)):
        if specimen.stated_side:
            is_of_fit = bool(specimen.status)
            found = f"{specimen.side} by its landmarks"
            if specimen.side == specimen.stated_side:
                found = "mirrored, unlike most others"
            why = f"{specimen.name} is stated {specimen.stated_side}, and is {found}"
            doubts.setdefault(individual_name(specimen, by), _Doubt(why, is_of_fit))
    return doubts


def _chosen(groups: Groups, sides: Sequence[str], doubts: Mapping[str, _Doubt]) -> tuple[list[str], tuple[str, ...]]:
    """Return the individuals that have as many replicates of each side as most have, and why others are left out."""
    counts = {name: {side: len(found) for side, found in of_sides.items()} for name, of_sides in groups.items()}
    sure = [each for name, each in counts.items() if name not in doubts]
    even = Counter(max(each.values()) for each in sure if min(each.values()) == max(each.values()) > 0)
    usual = max(even, key=lambda number: (even[number], number), default=1)
    usually = f"{usual} of each side" if len(sides) > 1 else f"{usual}"
    chosen = []
    left_out = []
    for name, each in counts.items():
        doubt = doubts.get(name)
        if doubt and not doubt.is_of_fit:
            left_out.append(f"{name}: {doubt.why}; it is left out")
        elif set(each.values()) == {usual}:
            chosen.append(name)
        else:
            why = f" ({doubt.why})" if doubt else ""
            left_out.append(
                f"{name}: it has {_described(each)} with a shape, where most have {usually}{why}; it is left out"
            )
    return chosen, tuple(left_out)


def _described(counts: dict[str, int]) -> str:
    """Describe the number of records of each side."""
    return " and ".join(f"{count} {side}".strip() for side, count in counts.items()) + " records"


def _labels_of_estimates(specimens: Sequence[Specimen]) -> str:
    """Return the names or numbers of the landmarks that are estimated in any of the records of an individual."""
    indices = sorted({index for specimen in specimens for index in specimen.estimated})
    named = next((specimen for specimen in specimens if specimen.names), specimens[0])
    return named.list_of(indices)


_STATE_INDIVIDUALS = (
    "if both sides of an individual are there, name their images alike but for the side (fly1_left and fly1_right, or "
    "left/fly1 and right/fly1), or state it in a column 'individual' of a table of your own (--specimens)"
)


def _too_few(n_individuals: int, chosen: Sequence[str], left_out: Sequence[str], kind: str) -> str:
    """Say that there are too few individuals, and why."""
    found = f"{len(chosen)} of {n_individuals} individuals can be compared, and {FEWEST} are needed"
    if left_out:
        remedy = f"; {_STATE_INDIVIDUALS}" if kind == MATCHING and not chosen else ""
        return f"{found}: {'; '.join(left_out[:_SHOWN])}{remedy}"
    if kind == MATCHING:
        return f"{found}: digitise both sides of more of them"
    return f"{found}: digitise more of them"


def _twins(
    specimens: Sequence[Specimen], numbers: Sequence[int], pairs: str | Sequence[int] | None, shapes: np.ndarray
) -> tuple[int, ...]:
    """Return the place of each landmark's twin among the landmarks of the shape."""
    names = next((specimen.names for specimen in specimens if specimen.names), ())
    n = next(len(specimen.points) for specimen in specimens if len(specimen.points))
    if pairs is None:
        inside = [number - 1 for number in numbers]
        whole = shapes[np.isfinite(shapes).all(axis=(1, 2))]
        mean = whole.mean(axis=0) if len(inside) == n else None  # whose places are those that users count
        return checked_twins([names[index] for index in inside] if names else (), mean)
    if isinstance(pairs, str):
        twins = parse_pairs(pairs, names, n)
    else:
        twins = tuple(int(twin) for twin in pairs)
        if len(twins) != n or any(not 0 <= twin < n or twins[twin] != i for i, twin in enumerate(twins)):
            raise LiaamError(f"the twins {twins} do not pair {n} landmarks: if b is the twin of a, a must be that of b")
    place = {number - 1: i for i, number in enumerate(numbers)}
    for i, twin in enumerate(twins):
        if twin != i and i not in place:
            raise LiaamError(f"the pair {i + 1}-{twin + 1} has an end of the scale bar, which is no part of the shape")
    return tuple(place[twins[number - 1]] for number in numbers)


def _covariances(
    specimens: Sequence[Specimen], columns: Columns, shapes: np.ndarray, numbers: Sequence[int]
) -> np.ndarray | None:
    """Return the covariances of shapes (m, k, 2) as they are, (m, k, 2, 2): NaN where unknown, None if all are."""
    if f"X{numbers[0]}_se" not in columns:
        return None
    inside = [number - 1 for number in numbers]
    carried = np.full((*shapes.shape, 2), np.nan)
    for i, (specimen, shape) in enumerate(zip(specimens, shapes, strict=True)):
        if specimen.covariances is None or not np.isfinite(shape).all():
            continue
        upwards = np.diag([1.0, -1.0])
        matrix = align(specimen.points[inside] @ upwards, shape).matrix @ upwards
        carried[i] = matrix @ np.asarray(specimen.covariances)[inside] @ matrix.T
    return carried
