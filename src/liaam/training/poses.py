"""Shapes of training images from which fits start, of objects whose parts move against each other."""

import numpy as np

from liaam.model.shape import aligned_to

# Largest number of shapes: each is a fit at the coarsest level, in several rotations
MOST = 60


def poses_of(shapes: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Return shapes (m, n, 2) aligned to their mean (n, 2), (k, n, 2) float32: all, or those that differ most."""
    aligned = aligned_to(mean, shapes)
    chosen = np.arange(len(aligned)) if len(aligned) <= MOST else most_different(aligned, MOST)
    return aligned[chosen].astype(np.float32)


def most_different(shapes: np.ndarray, count: int) -> np.ndarray:
    """Choose shapes (m, n, 2) far from each other by farthest-point sampling; return sorted indices, (count,) int."""
    flat = shapes.reshape(len(shapes), -1)
    chosen = [int(np.square(flat - flat.mean(axis=0)).sum(axis=1).argmin())]
    nearest = np.full(len(flat), np.inf)
    while len(chosen) < count:
        nearest = np.minimum(nearest, np.square(flat - flat[chosen[-1]]).sum(axis=1))
        chosen.append(int(nearest.argmax()))
    return np.array(sorted(chosen))
