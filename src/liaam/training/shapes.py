"""Groups of training images whose shapes are too different for one Gaussian, such as those of different species.

Shapes are clustered by their Procrustes distances (Ward's method). A grouping is used if it makes left-out shapes
clearly more likely, with one Gaussian for each group, than with one Gaussian for all, and if there is a gap between the
groups. The shapes of one object that bends or turns its parts are not Gaussian either, but they have no gap, and parts
of them are no kinds.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, count, takewhile

import numpy as np

from liaam.errors import TrainingError
from liaam.model.file_format import MOST_SHAPES
from liaam.model.shape import aligned_to, deviations_from, procrustes_mean
from liaam.model.shape_prior import fit_prior, spread_points
from liaam.training.entries import FEWEST
from liaam.training.objects import LEFT_OUT_FOLDS, objects_of
from liaam.training.options import AUTO

LEAST_GROUP = 8  # Fewest images of a group that is found
# Least gain in the mean log-likelihood of a left-out shape for which groups are used. The gain is below 0 for nine sets
# of one kind of object, turned heads among them, 2.1 and 4.2 for wings of two outlines, and 8.4 if every other wing is
# mirrored.
GAIN = 1.0
# Least distance of the means of two groups, in standard deviations within them along the line between the means. The
# halves of a uniform distribution have 3.5, shapes of a generated animal that bends 2.9 to 4.1, two kinds of fish 6.7,
# mirrored shells 29, mirrored wings 108.
SEPARATION = 5.0
POINTS = 30  # Largest number of landmarks used. All groups use the same, so that likelihoods can be compared.
TINY = 1e-12  # Least distance to divide by; shapes have unit size
SAME = 1e-5  # Distance below which two shapes are of copies of one image


def shape_groups(shapes: np.ndarray, names: Sequence[str], wanted: int | str = AUTO) -> list[np.ndarray]:
    """Group shapes (m, n, 2) that need models of their own; return the indices of each group, the largest group first.

    Images of one object, recognised by their names, are left out together.

    Parameters
    ----------
    shapes : (m, n, 2) float64
    names : sequence of str
    wanted : int or "auto"
        Number of groups.

    Raises
    ------
    TrainingError
        If a group of those wanted has fewer than 3 images.
    """
    everything = [np.arange(len(shapes))]
    if wanted == 1 or (wanted == AUTO and len(shapes) < 2 * LEAST_GROUP):
        return everything
    if shapes.shape[1] > POINTS:
        shapes = shapes[:, spread_points(shapes[0], POINTS)]
    apart = procrustes_distances(shapes)
    if wanted != AUTO:
        groups = _clusters(apart, int(wanted))
        if len(groups) < int(wanted) or len(groups[-1]) < FEWEST:
            sizes = ", ".join(str(len(group)) for group in groups)
            raise TrainingError(
                f"shapes {wanted}: the images form groups of {sizes}, and a model needs {FEWEST} images; ask for "
                "fewer shapes, or add images"
            )
        return groups
    owners = (apart < SAME).argmax(axis=1)  # the object of each image; copies of an image are of one object
    for members in objects_of(names).values():
        owners[members] = members[0]
    best = everything
    evidence = _evidence(shapes, owners, everything)
    for groups in _groupings(apart) if np.isfinite(evidence) else ():
        found = _evidence(shapes, owners, groups)
        if not (found - evidence >= GAIN and separation(shapes, groups) >= SEPARATION):
            break
        best = groups
        evidence = found
    return best


def procrustes_distances(shapes: np.ndarray) -> np.ndarray:
    """Distances between shapes (m, n, 2) whatever their position, size and rotation, (m, m) float64, 0 to 1.

    Mirrored shapes differ.
    """
    points = shapes[..., 0] + 1j * shapes[..., 1]
    points = points - points.mean(axis=1, keepdims=True)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    squares = np.maximum(1.0 - np.square(np.abs(points @ points.conj().T)), 0.0)
    np.fill_diagonal(squares, 0.0)
    return np.sqrt(0.5 * (squares + squares.T))


def separation(shapes: np.ndarray, groups: Sequence[np.ndarray]) -> float:
    """Least distance of the means of two groups of shapes (m, n, 2), in standard deviations within them along it.

    ``groups`` holds indices of shapes. Infinity if all shapes of each group are the same.
    """
    aligned = aligned_to(procrustes_mean(shapes), shapes).reshape(len(shapes), -1)
    least = np.inf
    for one, other in combinations([aligned[group] for group in groups], 2):
        between = other.mean(axis=0) - one.mean(axis=0)
        distance = float(np.linalg.norm(between))
        within = np.concatenate([group - group.mean(axis=0) for group in (one, other)]) @ between / max(distance, TINY)
        least = min(least, distance / max(float(within.std()), TINY))
    return least


def _clusters(apart: np.ndarray, most: int) -> list[np.ndarray]:
    """Cluster by distances (m, m) into at most so many groups, the largest first."""
    from scipy.cluster.hierarchy import fcluster, ward
    from scipy.spatial.distance import squareform

    labels = fcluster(ward(squareform(apart, checks=False)), most, "maxclust")
    groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    return sorted(groups, key=len, reverse=True)


def _groupings(apart: np.ndarray) -> Iterator[list[np.ndarray]]:
    """Yield groupings into more and more groups of enough images. Images of small clusters join the nearest group."""
    n_groups = 1
    for most in takewhile(lambda most: most <= len(apart) // 2, count(2)):
        clusters = _clusters(apart, most)
        large = [cluster for cluster in clusters if len(cluster) >= LEAST_GROUP]
        if len(large) == n_groups:
            continue
        n_groups = len(large)
        if not 2 <= n_groups <= MOST_SHAPES:
            return
        nearest = np.argmin([apart[:, cluster].mean(axis=1) for cluster in large], axis=0)
        for which, cluster in enumerate(large):
            nearest[cluster] = which
        yield sorted((np.flatnonzero(nearest == i) for i in range(n_groups)), key=len, reverse=True)


def _evidence(shapes: np.ndarray, owners: np.ndarray, groups: list[np.ndarray]) -> float:
    """Return the mean log-likelihood of left-out shapes, with one Gaussian for each group."""
    total = 0.0
    for group in groups:
        parts = np.array_split(np.unique(owners[group]), LEFT_OUT_FOLDS)
        folds = [np.flatnonzero(np.isin(owners[group], part)) for part in parts if len(part)]
        if max(map(len, folds)) > len(group) / 2:
            return -np.inf  # most are of one object, and a person is not a kind of shape
        own = shapes[group]
        density = fit_prior(deviations_from(procrustes_mean(own), own), folds).evidence
        total += len(group) * (density + np.log(len(group) / len(shapes)))
    return total / len(shapes)
