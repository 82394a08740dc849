"""Asymmetry of shape: Procrustes analysis of variance, and the symmetric, directional and fluctuating components.

*Matching* symmetry is that of two separate structures, such as the wings of a fly, of which one side was reflected;
*object* symmetry that of one structure with paired landmarks and landmarks on its midline, such as a face, which is
compared with its own mirror image. Klingenberg & McIntyre (1998) describe the analysis for the first, Mardia, Bookstein
& Moreton (2000) and Klingenberg, Barluenga & Meyer (2002) for the second.

The model is that of Palmer & Strobeck (1986): individuals (random), sides (fixed), their interaction, and error.

- Sides differ on average: directional asymmetry.
- The interaction is fluctuating asymmetry, against which individuals and sides are tested.
- The error comes from replicates, against which the interaction is tested, or from the covariances of the landmarks.
  These are taken as independent between the sides. Errors that the sides have in common cancel in their differences, so
  that the interaction is then compared with too much error, and individuals, which they add to, with too little.

Numbers are those of ``bilat.symmetry`` of the R package geomorph, which counts degrees of freedom in configurations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from liaam.formatting import short_repr
from liaam.morphometry.superimposition import TOLERANCE, Superimposition, superimpose, tangent_covariances
from liaam.progress import Progress, reported
from liaam.tables import Columns

PERMUTATIONS = 999
"""Number of random orders, and with the observed one of those that P counts, as geomorph has it."""

EFFECTS = ("individual", "side", "individual x side", "error", "total")

FEWEST = 2
"""Least number of individuals."""

_INDIVIDUAL = 0  # places among the effects
_SIDE = 1
INTERACTION = 2
ERROR = 3

_TINY = 1e-6  # added to F before its logarithm, as in geomorph

Squares = np.ndarray
"""Sums of squares of individuals, sides, interaction and error, (4,) float64."""


@dataclass(frozen=True, eq=False)
class Asymmetry:
    """Components of shape and analysis of variance of n individuals with two sides.

    Shapes are tangent coordinates of one superimposition (:func:`liaam.morphometry.superimposition.superimpose`). The
    asymmetric and the fluctuating components are, as in geomorph, the mean shape plus a difference between sides.

    Attributes
    ----------
    kind : {"object", "matching"}
    mean : (k, 2) float64
        Mean shape; for object symmetry it is symmetric.
    symmetric : (n, k, 2) float64
        Mean of the sides of each individual.
    asymmetric : (n, k, 2) float64
        Mean shape plus the first side minus the second, of each individual.
    directional : (2, k, 2) float64
        Mean shape of each side.
    fluctuating : (n, k, 2) float64
        The same as `asymmetric`, less the mean difference between the sides.
    distances : (n,) float64
        Procrustes distance between the sides of each individual: its asymmetry in units of centroid size.
    fluctuating_distances : (n,) float64
        The same without directional asymmetry.
    unsigned_index : (n,) float64
        geomorph's ``unsigned.AI``: centroid size of `asymmetric`, about 1 + distance² / 2.
    size_ratios : (n,) float64
        Logarithm of the first side's centroid size over the second's; NaN for object symmetry, or if unknown.
    error : {"replicates", "covariances", ""}
        Where the error term comes from; empty if it is unknown.
    shape_anova : dict of str to list
        A row for each effect: individual, side, their interaction, error, total. ``df``, ``SS``, ``MS``, ``R2``, ``F``;
        ``Z`` and ``P`` by permutation; ``F_error``, the mean square over that of the error; ``Z_geomorph`` and
        ``P_geomorph``, as geomorph has them.
    size_anova : dict of str to list
        The same for the centroid size, of the individuals whose sizes are known; empty for object symmetry, or if there
        are fewer than two of these.
    """

    kind: str
    mean: np.ndarray
    symmetric: np.ndarray
    asymmetric: np.ndarray
    directional: np.ndarray
    fluctuating: np.ndarray
    distances: np.ndarray
    fluctuating_distances: np.ndarray
    unsigned_index: np.ndarray
    size_ratios: np.ndarray
    error: str
    shape_anova: Columns
    size_anova: Columns

    __repr__ = short_repr


def matching_asymmetry(
    shapes: np.ndarray,
    covariances: np.ndarray | None = None,
    *,
    estimated: np.ndarray | None = None,
    sizes: np.ndarray | None = None,
    permutations: int = PERMUTATIONS,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    only_error: bool = False,
    progress: Progress | bool | None = None,
) -> Asymmetry:
    """Analyse matching symmetry.

    Parameters
    ----------
    shapes : (n, 2, r, k, 2) float
        Landmarks of n individuals, two sides of each, and r replicates of each side, without gaps. One side is already
        reflected.
    covariances : (n, 2, r, k, 2, 2) float, optional
        Covariances of the landmarks. Used where r is 1.
    estimated : (n, 2, r) bool, optional
        Which have landmarks that were estimated from other specimens. They do not count in the error term, since
        replicates with estimates agree too well.
    sizes : (n, 2, r) float, optional
        Centroid sizes, if the shapes were scaled before; by default those of the shapes. NaN where
        unknown.
    permutations : int
        Number of random orders, or of random errors where the error comes from covariances; 0 for none.
    seed : int
        Seed of the random numbers.
    tolerance : float
        See :func:`liaam.morphometry.superimposition.superimpose`.
    only_error : bool
        Whether the interaction alone is tested, against the error by the covariances. The other tests, which take
        nearly all of the time, are then unknown.
    progress : callable or bool, optional
        See :func:`liaam.progress.reported`.

    Returns
    -------
    Asymmetry
    """
    shapes = np.asarray(shapes, np.float64)
    n, sides, replicates, k, _ = shapes.shape
    fit = superimpose(shapes.reshape(-1, k, 2), tolerance)
    aligned = fit.shapes.reshape(shapes.shape)
    sizes = np.reshape(fit.sizes if sizes is None else sizes, (n, sides, replicates, 1))
    is_measured = _measured((n, sides), estimated)
    errors = None
    if covariances is not None and replicates == 1:
        errors = tangent_covariances(shapes.reshape(-1, k, 2), np.reshape(covariances, (-1, k, 2, 2)), fit.mean)
        errors = _with_usual_errors(errors, is_measured.ravel())
    draw = None if errors is None else _draw_independently(errors, n)
    mean_square = np.nan if errors is None else float(np.trace(errors, axis1=1, axis2=2).mean())
    with reported("permutations", progress) as tell:
        rows = aligned.reshape(n, sides, replicates, -1)
        shape_anova = _anova(rows, is_measured, permutations, seed, tell, mean_square, draw, only_error)
        has_sizes = np.isfinite(sizes).all(axis=(1, 2, 3))
        size_anova = {}
        if has_sizes.sum() >= FEWEST and not only_error:
            size_anova = _anova(sizes[has_sizes], is_measured[has_sizes], permutations, seed, tell)
    ratios = np.log(sizes.mean(axis=2)).reshape(n, sides)
    return _components("matching", aligned, fit, ratios[:, 0] - ratios[:, 1], errors, shape_anova, size_anova)


def object_asymmetry(
    shapes: np.ndarray,
    twins: Sequence[int] | np.ndarray,
    covariances: np.ndarray | None = None,
    *,
    estimated: np.ndarray | None = None,
    permutations: int = PERMUTATIONS,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    only_error: bool = False,
    progress: Progress | bool | None = None,
) -> Asymmetry:
    """Analyse object symmetry: the first side is the object, the second its mirror image with landmarks exchanged.

    Parameters
    ----------
    shapes : (n, r, k, 2) float
        Landmarks of n individuals and r replicates of each, without gaps.
    twins : sequence of int
        Index of each landmark's twin on the other side; its own on the midline.
    covariances : (n, r, k, 2, 2) float, optional
        Covariances of the landmarks. Used where r is 1.
    estimated : (n, r) bool, optional
        Which have landmarks that were estimated from other specimens; see :func:`matching_asymmetry`.
    permutations, seed, tolerance, only_error, progress
        See :func:`matching_asymmetry`.

    Returns
    -------
    Asymmetry
    """
    shapes = np.asarray(shapes, np.float64)
    order = np.asarray(twins)
    n, replicates, k, _ = shapes.shape
    given = shapes.reshape(-1, k, 2)
    # As geomorph: reflected after a first superimposition, at whose mean shape the reflection then is.
    first = superimpose(given, tolerance).shapes
    both = np.concatenate([first, _mirrored(first, order)])
    fit = superimpose(both, tolerance)
    fit = _in_orientation_of(fit, first)
    aligned = np.stack([half.reshape(shapes.shape) for half in np.split(fit.shapes, 2)], axis=1)
    is_measured = _measured((n,), estimated)
    errors = None
    draw = None
    mean_square = np.nan
    if covariances is not None and replicates == 1:
        errors = tangent_covariances(given, np.reshape(covariances, (-1, k, 2, 2)), fit.mean)
        errors = _with_usual_errors(errors, is_measured)
        draw = _draw_mirrored(errors, _reflection(fit.mean, order), order)
        mean_square = float(np.trace(errors, axis1=1, axis2=2).mean())
    with reported("permutations", progress) as tell:
        rows = aligned.reshape(n, 2, replicates, -1)
        of_both = np.stack([is_measured, is_measured], axis=1)
        shape_anova = _anova(rows, of_both, permutations, seed, tell, mean_square, draw, only_error)
    return _components("object", aligned, fit, np.full(n, np.nan), errors, shape_anova, {})


def _measured(shape: tuple[int, ...], estimated: np.ndarray | None) -> np.ndarray:
    """Return of which cells of this shape no replicate has estimated landmarks, bool; ``estimated`` is one of these."""
    if estimated is None:
        return np.ones(shape, bool)
    return ~np.logical_or.reduce(estimated, axis=-1)


def _with_usual_errors(errors: np.ndarray, is_measured: np.ndarray) -> np.ndarray:
    """Return covariances (m, d, d), with the mean of those that were measured, (m,) bool, for the others."""
    usual = errors[is_measured].mean(axis=0)
    return np.where(is_measured[:, None, None], errors, usual)


def _mirrored(shapes: np.ndarray, twins: np.ndarray) -> np.ndarray:
    """Reflect shapes (..., k, 2) at the y axis, and exchange the landmarks of both sides."""
    return (shapes * [-1.0, 1.0])[..., twins, :]


def _in_orientation_of(fit: Superimposition, first: np.ndarray) -> Superimposition:
    """Turn a superimposition of shapes and their mirror images so that the shapes have their first orientation."""
    own = fit.shapes[: len(first)]
    turn = np.vdot(own[..., 0] + 1j * own[..., 1], first[..., 0] + 1j * first[..., 1])
    cosine = turn.real / abs(turn)
    sine = turn.imag / abs(turn)
    matrix = np.array([[cosine, sine], [-sine, cosine]])  # of rows x, y
    return Superimposition(fit.shapes @ matrix, fit.sizes, fit.mean @ matrix)


def _components(
    kind: str,
    aligned: np.ndarray,
    fit: Superimposition,
    ratios: np.ndarray,
    errors: np.ndarray | None,
    shape_anova: Columns,
    size_anova: Columns,
) -> Asymmetry:
    """Return the components of aligned shapes (n, 2, r, k, 2)."""
    of_sides = aligned.mean(axis=2)
    mean = aligned.mean(axis=(0, 1, 2))
    difference = of_sides[:, 0] - of_sides[:, 1]
    directional = of_sides.mean(axis=0)
    fluctuating = difference - difference.mean(axis=0)
    replicated = aligned.shape[2] > 1
    return Asymmetry(
        kind,
        mean,
        symmetric=of_sides.mean(axis=1),
        asymmetric=mean + difference,
        directional=directional,
        fluctuating=mean + fluctuating,
        distances=np.linalg.norm(difference, axis=(1, 2)),
        fluctuating_distances=np.linalg.norm(fluctuating, axis=(1, 2)),
        unsigned_index=np.linalg.norm(mean + difference, axis=(1, 2)),
        size_ratios=ratios,
        error="replicates" if replicated else "" if errors is None else "covariances",
        shape_anova=shape_anova,
        size_anova=size_anova,
    )


def sums_of_squares(values: np.ndarray, is_measured: np.ndarray | None = None) -> Squares:
    """Sums of squares of individuals, sides, their interaction and error, of values (n, 2, r, d), (4,) float64.

    The error is that of the sides that ``is_measured`` (n, 2) bool names; by default of all.
    """
    n, sides, replicates, _ = values.shape
    cells = values.mean(axis=2)
    individuals = cells.mean(axis=1)
    of_sides = cells.mean(axis=0)
    mean = of_sides.mean(axis=0)
    interaction = cells - individuals[:, None] - of_sides + mean
    return np.array(
        [
            sides * replicates * np.square(individuals - mean).sum(),
            n * replicates * np.square(of_sides - mean).sum(),
            replicates * np.square(interaction).sum(),
            np.square(values - cells[:, :, None])[... if is_measured is None else is_measured].sum(),
        ]
    )


def _freedom(shape: tuple[int, ...], is_measured: np.ndarray) -> np.ndarray:
    """Degrees of freedom of the effects of values (n, 2, r, d), in configurations, (4,) float64."""
    n, sides, replicates, _ = shape
    return np.array([n - 1, sides - 1, (n - 1) * (sides - 1), is_measured.sum() * (replicates - 1)], float)


def _ratios(squares: np.ndarray) -> np.ndarray:
    """F of individuals and sides over the interaction, and of the interaction over the error, (3,) of (4,)."""
    numerators = squares[[_INDIVIDUAL, _SIDE, INTERACTION]]
    return numerators / squares[[INTERACTION, INTERACTION, ERROR]]


def _anova(
    values: np.ndarray,
    is_measured: np.ndarray,
    permutations: int,
    seed: int,
    tell: Progress,
    error: float = np.nan,
    draw: Callable[[np.random.Generator], np.ndarray] | None = None,
    only_error: bool = False,
) -> Columns:
    """Analyse the variance of values (n, 2, r, d), with the error of sides that were measured, (n, 2) bool.

    ``error`` is the mean square of the error that is known from covariances, and ``draw`` draws values (n, 2, 1, d)
    that have such errors and no asymmetry. If ``only_error``, nothing but the interaction is tested, by these.
    """
    freedom = _freedom(values.shape, is_measured)
    squares = sums_of_squares(values, is_measured)
    with np.errstate(divide="ignore", invalid="ignore"):
        means = squares / freedom
        means[ERROR] = means[ERROR] if freedom[ERROR] else error
        observed = _ratios(means)
        over_error = means[:3] / means[ERROR]
        if only_error and draw is not None:
            by_chance = _drawn(values.shape, draw, error, permutations, seed, tell)
            tests = (*_effect_sizes(np.vstack([observed, by_chance])), np.full(3, np.nan), np.full(3, np.nan))
        else:
            tests = _permuted(values, is_measured, observed, permutations, seed, tell, draw, error)
        shares = squares / squares.sum()
    is_known = freedom[ERROR] > 0
    gap = np.nan
    columns = {
        "df": [*freedom[:3], freedom[ERROR] if is_known else gap, freedom.sum()],
        "SS": [*squares[:3], squares[ERROR] if is_known else gap, squares.sum()],
        "MS": [*means, gap],
        "R2": [*shares[:3], shares[ERROR] if is_known else gap, gap],
        "F": [*observed, gap, gap],
        "Z": [*tests[0], gap, gap],
        "P": [*tests[1], gap, gap],
        "F_error": [*over_error, gap, gap],
        "Z_geomorph": [*tests[2], gap, gap],
        "P_geomorph": [*tests[3], gap, gap],
    }
    return {"effect": list(EFFECTS)} | {name: [float(value) for value in values] for name, values in columns.items()}


def _permuted(
    values: np.ndarray,
    is_measured: np.ndarray,
    observed: np.ndarray,
    permutations: int,
    seed: int,
    tell: Progress,
    draw: Callable[[np.random.Generator], np.ndarray] | None,
    error: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Test three ratios by residual randomisation (Collyer, Sekora & Adams 2015): Z and P, and geomorph's.

    The residuals of the model without an effect are put into random orders, one order of all configurations for the
    three effects. Ratios compare mean squares of the same residuals. geomorph compares those of individuals and sides
    with the interaction of the residuals of the interaction, which individuals and sides are no part of.

    The interaction, where it can be compared with ``error`` only, is tested by random errors that ``draw`` draws.
    """
    n, sides, replicates, d = values.shape
    generator = np.random.default_rng(seed)
    mean = values.mean(axis=(0, 1, 2))
    individuals = values.mean(axis=(1, 2), keepdims=True)
    of_sides = values.mean(axis=(0, 2), keepdims=True)
    # What the model without each effect leaves. Effects that it has add nothing to those that are tested.
    residuals = (values - mean, values - individuals, values - individuals - of_sides + mean)
    residuals = tuple(_compact(each.reshape(-1, d)) for each in residuals)
    freedom = _freedom(values.shape, is_measured)
    own = np.empty((permutations + 1, 3))
    mixed = np.empty((permutations + 1, 3))
    own[0] = observed
    mixed[0] = observed
    for i in range(1, permutations + 1):
        order = generator.permutation(n * sides * replicates)
        means = [
            sums_of_squares(each[order].reshape(n, sides, replicates, -1), is_measured) / freedom for each in residuals
        ]  # one for each effect
        own[i] = [_ratios(each)[effect] for effect, each in enumerate(means)]
        last = means[INTERACTION]
        mixed[i] = [means[_INDIVIDUAL][_INDIVIDUAL], means[_SIDE][_SIDE], last[INTERACTION]]
        mixed[i] /= last[[INTERACTION, INTERACTION, ERROR]]
        if draw is not None:
            own[i, INTERACTION] = _drawn_ratio(draw(generator), freedom, error)
            mixed[i, INTERACTION] = np.nan
        tell(i, permutations, "permutations")
    return *_effect_sizes(own), *_effect_sizes(mixed)


def _drawn(
    shape: tuple[int, ...],
    draw: Callable[[np.random.Generator], np.ndarray],
    error: float,
    count: int,
    seed: int,
    tell: Progress,
) -> np.ndarray:
    """Return the three ratios of so many draws of errors: of the interaction to the error, NaN for the others."""
    generator = np.random.default_rng(seed)
    freedom = _freedom(shape, np.ones(shape[:2], bool))
    ratios = np.full((count, 3), np.nan)
    for i in range(count):
        ratios[i, INTERACTION] = _drawn_ratio(draw(generator), freedom, error)
        tell(i + 1, count, "permutations")
    return ratios


def _drawn_ratio(values: np.ndarray, freedom: np.ndarray, error: float) -> float:
    """Return the mean square of the interaction of drawn errors (n, 2, 1, d), over that of the error."""
    return float(sums_of_squares(values)[INTERACTION] / freedom[INTERACTION] / error)


def _compact(rows: np.ndarray) -> np.ndarray:
    """Express rows (m, d) in as few columns as they have dimensions; sums of squares stay the same."""
    left, values, _ = np.linalg.svd(rows, full_matrices=False)
    keep = values > values.max(initial=0.0) * 1e-12
    return left[:, keep] * values[keep]


def _effect_sizes(ratios: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Z and P of the first of ratios (p, 3): its standard score among the logarithms, and the share as large."""
    if len(ratios) < 2:
        return np.full(3, np.nan), np.full(3, np.nan)
    logarithms = np.log(ratios + _TINY)
    # As large in exact numbers: sums in another order differ by rounding.
    probability = (ratios >= ratios[0] * (1 - 1e-12)).mean(axis=0)
    score = (logarithms[0] - logarithms.mean(axis=0)) / logarithms.std(axis=0)
    unknown = ~np.isfinite(ratios).all(axis=0)
    return np.where(unknown, np.nan, score), np.where(unknown, np.nan, probability)


def _roots(covariances: np.ndarray) -> np.ndarray:
    """Symmetric square roots of covariances (m, d, d), which may be singular."""
    values, vectors = np.linalg.eigh(covariances)
    return np.einsum("mij,mj,mkj->mik", vectors, np.sqrt(np.maximum(values, 0.0)), vectors)


def _draw_independently(covariances: np.ndarray, n: int) -> Callable[[np.random.Generator], np.ndarray]:
    """Return a function that draws errors (n, 2, 1, d) of two sides, which are independent."""
    roots = _roots(covariances)

    def draw(generator: np.random.Generator) -> np.ndarray:
        errors = np.einsum("mij,mj->mi", roots, generator.standard_normal(roots.shape[:2]))
        return errors.reshape(n, 2, 1, -1)

    return draw


def _reflection(mean: np.ndarray, twins: np.ndarray) -> np.ndarray:
    """Return the matrix (2, 2) of the reflection by which ``(mean @ matrix)[twins]`` is nearest to the mean (k, 2)."""
    left, _, right = np.linalg.svd(mean[twins].T @ mean)
    flip = np.diag([1.0, -np.sign(np.linalg.det(left @ right))])
    return left @ flip @ right


def _draw_mirrored(
    covariances: np.ndarray, reflection: np.ndarray, twins: np.ndarray
) -> Callable[[np.random.Generator], np.ndarray]:
    """Return a function that draws errors (n, 2, 1, d) of objects, and of their mirror images, which are the same."""
    roots = _roots(covariances)

    def draw(generator: np.random.Generator) -> np.ndarray:
        errors = np.einsum("mij,mj->mi", roots, generator.standard_normal(roots.shape[:2]))
        mirrored = (errors.reshape(len(errors), -1, 2) @ reflection)[:, twins]
        return np.stack([errors, mirrored.reshape(errors.shape)], axis=1)[:, :, None]

    return draw
