"""Sparse systems on the pixels of the reference frame."""

from functools import lru_cache

import numpy as np

from liaam.model.mesh import ReferenceFrame


def factorised(pairs: tuple[np.ndarray, np.ndarray], coupling: np.ndarray, weights: np.ndarray):
    """Return the sparse LU factors of the least-squares system of pixel weights (n,) and couplings (k,) of pairs."""
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    (a, b), n = pairs, len(weights)
    links = coo_array((np.tile(-coupling, 2), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n))
    own = np.bincount(a, coupling, n) + np.bincount(b, coupling, n) + weights + 1e-9
    system = (links.tocsc() + diags_array(own)).tocsc()
    return splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


def neighbours(frame: ReferenceFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of horizontally and vertically adjacent pixels of a frame."""
    return every_few(frame, 1)[1]


@lru_cache(maxsize=8)
def every_few(frame: ReferenceFrame, step: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return the pixels at every ``step``-th row and column of a frame, and pairs of neighbours among these."""
    kept = np.flatnonzero((frame.pixels % step == 0).all(axis=1))
    width, height = frame.size
    number = np.full((-(-height // step), -(-width // step)), -1)
    number[tuple(frame.pixels[kept].T // step)] = np.arange(len(kept))
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    both = [(a[(a >= 0) & (b >= 0)], b[(a >= 0) & (b >= 0)]) for a, b in pairs]
    return kept, (np.concatenate([pair[0] for pair in both]), np.concatenate([pair[1] for pair in both]))
