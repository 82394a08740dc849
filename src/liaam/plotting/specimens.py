"""Figures of measured specimens."""

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from liaam.drawing import LANDMARK
from liaam.errors import LiaamError
from liaam.plotting.figures import subplots

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_NAMED = 60  # Number of specimens up to which their names are written beside their shapes


def figure_of_specimens(columns: Mapping[str, list]) -> "Figure":
    """Draw the specimens' shapes on each other, with the mean and the landmarks' numbers, and their main components.

    The columns are those of :func:`liaam.measure`. Specimens without a shape are left out; an error, if none has one.
    """
    places = [name for name in columns if re.fullmatch(r"[XY]\d+", name)]
    table = np.array([columns[name] for name in places], dtype=float).T
    whole = np.isfinite(table).all(axis=-1)
    if not places or not whole.any():
        raise LiaamError("no specimen has a shape to draw: landmarks are missing in all")
    names = np.array(columns["specimen"])[whole]
    table = table[whole]
    mean = table.mean(axis=0)
    figure, axes = subplots(1, 2, (11, 5))
    axis = axes[0, 0]
    axis.plot(table[:, ::2].ravel(), table[:, 1::2].ravel(), ".", color="0.6", ms=3)
    axis.plot(mean[::2], mean[1::2], "o", color=LANDMARK, ms=5)
    for i, (x, y) in enumerate(mean.reshape(-1, 2)):
        axis.annotate(str(i + 1), (x, y), (3, 3), textcoords="offset points", fontsize=8)
    axis.set(title=f"{len(table)} superimposed shapes, and the mean", aspect="equal")
    axis.set_axis_off()
    _, values, modes = np.linalg.svd(table - mean, full_matrices=False)
    shares = 100 * values**2 / max(np.square(values).sum(), 1e-300)
    scores = np.pad((table - mean) @ modes[:2].T, ((0, 0), (0, max(0, 2 - len(modes)))))
    axis = axes[0, 1]
    axis.plot(*scores.T, "o", color=LANDMARK, ms=5)
    for name, score in zip(names, scores, strict=True) if len(names) <= MOST_NAMED else ():
        axis.annotate(name, score, (3, 3), textcoords="offset points", fontsize=7, parse_math=False)
    labels = [f"PC {i + 1} ({share:.0f} % of the variance)" for i, share in enumerate([*shares, 0.0][:2])]
    axis.set(title="principal components of shape", xlabel=labels[0], ylabel=labels[1])
    axis.spines[["top", "right"]].set_visible(False)
    return figure
