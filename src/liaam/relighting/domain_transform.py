"""Edge-preserving averages by the domain transform (Gastal and Oliveira, ACM TOG 2011)."""

import numba
import numpy as np

ROUNDS = 3
"""Number of passes over rows and columns; three leave no visible stripes."""


def averaged(layers: np.ndarray, seen: np.ndarray, scale: float, edge: float) -> np.ndarray:
    """Average layers over nearby pixels of similar colour.

    Parameters
    ----------
    layers : (h, w, c) float
    seen : (h, w, 3) float
        Image that defines the edges.
    scale : float
        Standard deviation in regions of constant colour, pixels.
    edge : float
        Change of ``seen``, summed over channels, that counts as a distance of ``scale``.

    Returns
    -------
    (h, w, c) float32
    """
    found = np.array(layers, np.float32, order="C")
    across, down = (1.0 + scale / edge * np.abs(np.diff(seen, axis=axis)).sum(axis=2) for axis in (1, 0))
    for i in range(ROUNDS):  # standard deviations halve, and their squares sum to scale ** 2 (their equation 14)
        deviation = scale * np.sqrt(3.0) * 2.0 ** (ROUNDS - i - 1) / np.sqrt(4.0**ROUNDS - 1.0)
        feedback = np.exp(-np.sqrt(2.0) / deviation)
        _along_rows(found, np.power(feedback, across, dtype=np.float32))
        _along_columns(found, np.power(feedback, down, dtype=np.float32))
    return found


@numba.njit(cache=True)
def _along_rows(layers, kept):
    """Filter (h, w, c) recursively along each row, forward and backward, with feedback ``kept`` (h, w - 1)."""
    height, width, depth = layers.shape
    for y in range(height):
        for x in range(1, width):
            for k in range(depth):
                layers[y, x, k] += kept[y, x - 1] * (layers[y, x - 1, k] - layers[y, x, k])
        for x in range(width - 2, -1, -1):
            for k in range(depth):
                layers[y, x, k] += kept[y, x] * (layers[y, x + 1, k] - layers[y, x, k])


@numba.njit(cache=True)
def _along_columns(layers, kept):
    """Filter along each column; ``kept`` is (h - 1, w)."""
    height, width, depth = layers.shape
    for y in range(1, height):
        for x in range(width):
            for k in range(depth):
                layers[y, x, k] += kept[y - 1, x] * (layers[y - 1, x, k] - layers[y, x, k])
    for y in range(height - 2, -1, -1):
        for x in range(width):
            for k in range(depth):
                layers[y, x, k] += kept[y, x] * (layers[y + 1, x, k] - layers[y, x, k])
