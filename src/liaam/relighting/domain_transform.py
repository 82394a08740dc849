"""Edge-preserving averages by the domain transform (Gastal and Oliveira, ACM TOG 2011)."""

import numpy as np

from liaam import _core

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
        kept = (np.power(feedback, each, dtype=np.float32) for each in (across, down))
        _core.filter_rows_and_columns(found, *map(np.ascontiguousarray, kept))
    return found
