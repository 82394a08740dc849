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

_ROUNDS = 10  # Most rounds of sliding and alignment; with more, all semilandmarks drift together
_TOLERANCE = 1e-4  # Movement of the mean shape, of centroid size 1, that ends the rounds
_LEAST_MOVE = 1e-3  # Length of the longest move below which a round is not worth it, relative to the mean gap


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
    counts = [_count(part) for part in str(numbers).split(",")]
    if not 3 <= min(counts) <= max(counts) <= 1000:
        raise LiaamError(f"curves of {numbers} points: give 3 to 1000, such as 20, or 20,12 for two curves")
    specimens = tuple(specimens)
    are_suited = [bool(specimen.curves) and len(counts) in (1, len(specimen.curves)) for specimen in specimens]
    if not any(are_suited):
        raise LiaamError(f"no specimen has curves to resample by {numbers}: give one number, or one for each curve")
    return tuple(
        _with_even_curves(specimen, counts) if is_suited else specimen
        for specimen, is_suited in zip(specimens, are_suited, strict=True)
    )


def _count(text: str) -> int:
    """Return a whole number of at most four digits; 0, which is refused, for other texts."""
    return int(text) if re.fullmatch(r" *[0-9]{1,4} *", text) else 0


def _with_even_curves(specimen: Specimen, counts: Sequence[int]) -> Specimen:
    """Resample the curves of a specimen to so many points each, or all to one count."""
    n_curves = Counter(index for curve in specimen.curves for index in set(curve.indices))  # by landmark
    fixed = [index for index in range(len(specimen.points)) if n_curves[index] != 1]  # in no curve or in several
    old_names = specimen.names or [""] * len(specimen.points)
    points = list(specimen.points[fixed])
    names = [old_names[index] for index in fixed]
    curves = []
    if len(counts) == 1:
        counts = [*counts] * len(specimen.curves)
    for number, (curve, count) in enumerate(zip(specimen.curves, counts, strict=True), 1):
        ends = {0: curve.indices[0]}  # landmarks at the ends, by their place on the new curve
        if not curve.closed:
            ends[count - 1] = curve.indices[-1]
        indices = []
        for place, point in enumerate(resample(specimen.points[list(curve.indices)], count, curve.closed)):
            end = ends.get(place)
            if end is not None and end in fixed:
                indices.append(fixed.index(end))
                continue
            indices.append(len(points))
            points.append(point)
            names.append(f"curve{number}_{place + 1}" if end is None else old_names[end])
        curves.append(Contour(tuple(indices), curve.closed))
    return replace(
        specimen,
        points=np.array(points),
        covariances=None,
        names=tuple(names) if specimen.names else (),
        curves=tuple(curves),
    )


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

    n = len(mean)
    squares = squareform(pdist(mean, "sqeuclidean"))
    kernel = xlogy(squares, squares)  # r^2 log r^2, and 0 at 0
    affine = np.column_stack([np.ones(n), mean])
    system = np.block([[kernel, affine], [affine.T, np.zeros((3, 3))]])
    return np.linalg.pinv(system, rcond=1e-12, hermitian=True)[:n, :n]  # points may coincide


def semilandmarks(curves: Iterable[Contour]) -> tuple[np.ndarray, np.ndarray]:
    """Return the landmarks along all curves (e,), one curve after the other, and the places there of those that slide.

    Ends of curves, the first landmark of closed ones, and landmarks of several curves do not slide.
    """
    chain = []
    times = Counter()  # by landmark; ends count twice, so that they do not slide
    for curve in curves:
        if curve.indices:
            line = [*curve.indices, *curve.indices[: int(curve.closed)]]
            chain += line
            times.update([*line, line[0], line[-1]])
    sliding = [i for i, index in enumerate(chain) if times[index] == 1]
    return np.array(chain, int), np.array(sliding, int)


def slide(shapes: np.ndarray, curves: Sequence[Contour], criterion: str) -> np.ndarray:
    """Slide the semilandmarks of shapes (m, n, 2) without gaps, which keep their positions, orientations and sizes."""
    if criterion not in CRITERIA:
        raise LiaamError(f"semilandmarks cannot slide by '{criterion}': give {' or '.join(CRITERIA)}")
    chain, sliding = semilandmarks(curves)
    if not len(shapes) or not len(sliding):
        return shapes
    tracks = [_JoinedCurves(shape, chain, sliding, _lengths(shape[chain])) for shape in shapes]
    places = [track.lengths for track in tracks]  # of each shape
    mean = procrustes_mean(shapes)
    for _ in range(_ROUNDS):
        weights = bending_energy(mean) if criterion == "bending" else np.eye(len(mean))
        places = [track.step(positions, mean, weights) for track, positions in zip(tracks, places, strict=True)]
        shapes = np.array([track.shape_at(positions) for track, positions in zip(tracks, places, strict=True)])
        last = mean
        mean = procrustes_mean(shapes)
        if np.abs(align(mean, last)(mean) - last).max() < _TOLERANCE:
            break
    return shapes


@dataclass(frozen=True, eq=False)
class _JoinedCurves:
    """The curves of a shape, joined into one line; places on it are lengths from its start."""

    shape: np.ndarray  # (n, 2) float64
    chain: np.ndarray  # (e,) int: landmarks along the line
    sliding: np.ndarray  # (s,) int: those of them that slide, by their position in the chain
    lengths: np.ndarray  # (e,) float64: places of the landmarks before they slide

    def shape_at(self, places: np.ndarray) -> np.ndarray:
        """Return the shape with its semilandmarks at these places, (e,)."""
        shape = self.shape.copy()
        shape[self.chain[self.sliding]] = _at(self.shape[self.chain], self.lengths, places[self.sliding])
        return shape

    def step(self, places: np.ndarray, mean: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Move along the curves to a smaller trace(d' W d) of the differences d from the mean and weights W (n, n).

        Return the new places (e,), or the old ones if no move is worth it. No move is longer than half of a gap.
        """
        shape = self.shape_at(places)
        moving = self.chain[self.sliding]
        target = align(mean, shape)(mean)
        along = shape[self.chain[self.sliding + 1]] - shape[self.chain[self.sliding - 1]]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
        # The Newton step of half the cost, of which these are gradient and Hessian.
        gradient = np.sum(along * (weights @ (shape - target))[moving], axis=1)
        hessian = weights[np.ix_(moving, moving)] * (along @ along.T)
        moves = -np.linalg.lstsq(hessian, gradient, rcond=1e-10)[0]  # semilandmarks may coincide
        half_gaps = np.diff(places) / 2
        cost = np.vdot(shape - target, weights @ (shape - target))
        while np.abs(moves).max() > _LEAST_MOVE * half_gaps.mean():
            moved = places.copy()
            moved[self.sliding] += np.clip(moves, -half_gaps[self.sliding - 1], half_gaps[self.sliding])
            difference = self.shape_at(moved) - target
            if np.vdot(difference, weights @ difference) <= cost:
                return moved
            moves = moves / 2  # the curve bends away from its direction
        return places


def _lengths(line: np.ndarray) -> np.ndarray:
    """Lengths of a line (n, 2) up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def _at(line: np.ndarray, lengths: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Points (k, 2) of a line at these lengths from its start."""
    return np.stack([np.interp(places, lengths, values) for values in line.T], axis=1)
