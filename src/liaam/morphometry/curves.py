"""Curves: points at even distances along them, and semilandmarks, the points between their ends, that slide.

They slide to the least bending energy of the thin-plate spline from the mean shape (Bookstein 1997), or to the least
Procrustes distance, in turn with Procrustes alignment (Gunz & Mitteroecker 2013). A semilandmark's direction is that
from its neighbour before to its neighbour after, as in geomorph; it stays on its curve, between its neighbours.
"""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import LiaamError
from liaam.io.landmarks import Contour
from liaam.model.shape import align, procrustes_mean
from liaam.morphometry.specimens import Specimen

CRITERIA = ("bending", "procrustes")

# Most rounds, few because all semilandmarks drift together with more, and movement of the mean that ends them
_ROUNDS, _TOLERANCE = 10, 1e-4


def with_even_curves(specimens: Iterable[Specimen], numbers: str | int) -> tuple[Specimen, ...]:
    """Resample curves, which may have been traced with any number of points.

    Parameters
    ----------
    specimens : iterable of Specimen
        Those without curves, or with another number of curves than of numbers, stay as they are.
    numbers : str or int
        Number of points of every curve, with both ends, or of each curve, such as ``"20,12"``; 3 to 1000.

    Returns
    -------
    tuple of Specimen
        First the landmarks that are in no curve or in several, then the other points of each curve; no covariances.

    Raises
    ------
    LiaamError
        If a number is not 3 to 1000, or no specimen has so many curves.
    """
    given = [int(part) if re.fullmatch(r" *[0-9]{1,4} *", part) else 0 for part in str(numbers).split(",")]
    if not 3 <= min(given) <= max(given) <= 1000:
        raise LiaamError(f"curves of {numbers} points: give 3 to 1000, such as 20, or 20,12 for two curves")
    specimens = tuple(specimens)
    suited = [bool(specimen.curves) and len(given) in (1, len(specimen.curves)) for specimen in specimens]
    if not any(suited):
        raise LiaamError(f"no specimen has curves to resample by {numbers}: give one number, or one for each curve")
    return tuple(
        _with_even_curves(specimen, given) if yes else specimen for specimen, yes in zip(specimens, suited, strict=True)
    )


def _with_even_curves(specimen: Specimen, numbers: Sequence[int]) -> Specimen:
    times = Counter(index for curve in specimen.curves for index in set(curve.indices))
    remaining = [index for index in range(len(specimen.points)) if times[index] != 1]
    old = specimen.names or [""] * len(specimen.points)
    points, names, curves = list(specimen.points[remaining]), [old[index] for index in remaining], []
    counts = numbers if len(numbers) > 1 else [*numbers] * len(specimen.curves)
    for number, (curve, count) in enumerate(zip(specimen.curves, counts, strict=True), 1):
        ends, line = {0: curve.indices[0]} | ({} if curve.closed else {count - 1: curve.indices[-1]}), []
        for place, point in enumerate(resample(specimen.points[list(curve.indices)], count, curve.closed)):
            end = ends.get(place)
            line.append(remaining.index(end) if end in remaining else len(points))
            if end not in remaining:
                points.append(point)
                names.append(f"curve{number}_{place + 1}" if end is None else old[end])
        curves.append(Contour(tuple(line), curve.closed))
    names = tuple(names) if specimen.names else ()
    return replace(specimen, points=np.array(points), covariances=None, names=names, curves=tuple(curves))


def resample(points: np.ndarray, number: int, closed: bool = False) -> np.ndarray:
    """Place points (number, 2) at even distances along a curve (n, 2): with both ends, or the first point if closed.

    NaN if a point of the curve is missing.
    """
    line = np.concatenate([points, points[: int(closed)]])
    lengths = _lengths(line)
    even = _at(line, lengths, np.linspace(0, lengths[-1], number, endpoint=not closed))
    return even if np.isfinite(lengths[-1]) else np.full((number, 2), np.nan)


def bending_energy(mean: np.ndarray) -> np.ndarray:
    """Matrix B (n, n) of a shape (n, 2). The spline from it to y (n, 2) has the bending energy trace(y' B y)."""
    from scipy.spatial.distance import pdist, squareform
    from scipy.special import xlogy

    n, squares = len(mean), squareform(pdist(mean, "sqeuclidean"))
    affine = np.column_stack([np.ones(n), mean])
    system = np.block([[xlogy(squares, squares), affine], [affine.T, np.zeros((3, 3))]])
    return np.linalg.pinv(system, rcond=1e-12, hermitian=True)[:n, :n]  # points may coincide


def semilandmarks(curves: Iterable[Contour]) -> tuple[np.ndarray, np.ndarray]:
    """Return the landmarks along all curves (e,), one curve after the other, and the places there of those that slide.

    Ends of curves, the first landmark of closed ones, and landmarks of several curves do not slide.
    """
    chains = [(*curve.indices, *curve.indices[: int(curve.closed)]) for curve in curves if curve.indices]
    chain = [index for indices in chains for index in indices]
    times = Counter(chain) + Counter(indices[end] for indices in chains for end in (0, -1))
    return np.array(chain, int), np.array([i for i, index in enumerate(chain) if times[index] == 1], int)


def slide(shapes: np.ndarray, curves: Sequence[Contour], criterion: str) -> np.ndarray:
    """Slide the semilandmarks of shapes (m, n, 2) without gaps, which keep their positions, orientations and sizes."""
    if criterion not in CRITERIA:
        raise LiaamError(f"semilandmarks cannot slide by '{criterion}': give {' or '.join(CRITERIA)}")
    chain, sliding = semilandmarks(curves)
    if not len(shapes) or not len(sliding):
        return shapes
    tracks = [_JoinedCurves(shape, chain, sliding, _lengths(shape[chain])) for shape in shapes]
    places, mean = [track.lengths for track in tracks], procrustes_mean(shapes)
    for _ in range(_ROUNDS):
        weights = bending_energy(mean) if criterion == "bending" else np.eye(len(mean))
        places = [track.step(positions, mean, weights) for track, positions in zip(tracks, places, strict=True)]
        shapes = np.array([track.shape_at(positions) for track, positions in zip(tracks, places, strict=True)])
        last, mean = mean, procrustes_mean(shapes)
        if np.abs(align(mean, last)(mean) - last).max() < _TOLERANCE:
            break
    return shapes


@dataclass(frozen=True, eq=False)
class _JoinedCurves:
    """The curves of a shape, joined into one line; places on it are lengths from its start."""

    shape: np.ndarray
    chain: np.ndarray
    sliding: np.ndarray
    lengths: np.ndarray

    def shape_at(self, places: np.ndarray) -> np.ndarray:
        """Return the shape with its semilandmarks at these places."""
        shape = self.shape.copy()
        shape[self.chain[self.sliding]] = _at(self.shape[self.chain], self.lengths, places[self.sliding])
        return shape

    def step(self, places: np.ndarray, mean: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Move along the curves to a smaller trace(d' W d) of the differences d from the mean and weights W (n, n)."""
        shape, on_chain = self.shape_at(places), self.chain[self.sliding]
        target = align(mean, shape)(mean)
        along = shape[self.chain[self.sliding + 1]] - shape[self.chain[self.sliding - 1]]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
        slope = np.sum(along * (weights @ (shape - target))[on_chain], axis=1)
        moves = -np.linalg.lstsq(weights[np.ix_(on_chain, on_chain)] * (along @ along.T), slope, rcond=1e-10)[0]
        gaps, cost = np.diff(places) / 2, np.vdot(shape - target, weights @ (shape - target))
        while np.abs(moves).max() > 1e-3 * gaps.mean():
            moved = places.copy()
            moved[self.sliding] += np.clip(moves, -gaps[self.sliding - 1], gaps[self.sliding])
            away = self.shape_at(moved) - target
            if np.vdot(away, weights @ away) <= cost:
                return moved
            moves = moves / 2  # the curve bends away from its direction
        return places


def _lengths(line: np.ndarray) -> np.ndarray:
    """Lengths of a line (n, 2) up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def _at(line: np.ndarray, lengths: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Points (k, 2) of a line at these lengths from its start."""
    return np.stack([np.interp(places, lengths, values) for values in line.T], axis=1)
