"""Figures of measured specimens."""

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from liaam.errors import LiaamError
from liaam.plotting.figures import INK, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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
    axis.plot(mean[::2], mean[1::2], "+", color="black", ms=12, mew=0.9, label="mean")
    spots = {"color": INK, "mew": 0, "ms": 4, "alpha": 0.5}
    axis.plot(table[:, ::2].ravel(), table[:, 1::2].ravel(), "o", label="specimens", **spots)
    for name, point in zip(places[::2], mean.reshape(-1, 2), strict=True):
        axis.annotate(name[1:], point, (6, 6), textcoords="offset points", fontsize=10, weight="bold")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2, frameon=False)  # where no landmark is
    axis.margins(0.1)
    axis.set(title=f"{len(table)} superimposed shapes, and the mean", aspect="equal")
    axis.set_axis_off()
    _, values, modes = np.linalg.svd(table - mean, full_matrices=False)
    shares = 100 * values**2 / max(np.square(values).sum(), 1e-300)
    scores = np.pad((table - mean) @ modes[:2].T, ((0, 0), (0, max(0, 2 - len(modes)))))
    axis = axes[0, 1]
    axis.plot(*scores.T, "o", color=INK, mec="white", mew=0.6, ms=7)
    labels = [f"PC {i + 1} ({share:.0f} % of the variance)" for i, share in enumerate([*shares, 0.0][:2])]
    axis.set(title="principal components of shape", xlabel=labels[0], ylabel=labels[1])
    axis.spines[["top", "right"]].set_visible(False)
    if len(names) <= MOST_NAMED:
        figure.draw_without_rendering()  # the room of a name depends on the size of the axes
        _write_names(axis, names.tolist(), scores)
    return figure


def _write_names(axis: "Axes", names: Sequence[str], places: np.ndarray) -> None:
    """Write names beside places (n, 2), first those far from the middle, and none on another."""
    away = np.linalg.norm(places - places.mean(axis=0), axis=1)
    written = []
    for _, name, (x, y) in sorted(zip(-away, names, places.tolist(), strict=True)):
        text = axis.annotate(name, (x, y), (4, 4), textcoords="offset points", fontsize=8, parse_math=False)
        room = text.get_window_extent()
        if any(room.overlaps(other) for other in written):
            text.remove()
        else:
            written.append(room)


def figure_of_asymmetry(
    mean: np.ndarray,
    directional: np.ndarray,
    fluctuating: np.ndarray,
    distances: np.ndarray,
    names: Sequence[str],
    sides: tuple[str, str],
    error: float = np.nan,
    numbers: Sequence[int] = (),
    lines: Sequence[Sequence[int]] = (),
    error_label: str = "by error alone",
    estimated: Sequence[bool] = (),
) -> "Figure":
    """Draw directional and fluctuating asymmetry at the landmarks, and the fluctuating asymmetry of each individual.

    Parameters
    ----------
    mean : (k, 2) float
        Mean shape, y upwards.
    directional : (2, k, 2) float
        Mean shape of each side.
    fluctuating : (n, k, 2) float
        Mean shape plus the difference between the sides of each individual, without the mean difference.
    distances : (n,) float
        Fluctuating asymmetry of each individual, in units of centroid size.
    names : sequence of str
        Names of the individuals.
    sides : tuple of str
        Names of the sides.
    error : float
        Root mean square distance that measurement error alone makes; NaN if unknown.
    numbers : sequence of int
        Numbers of the landmarks; from 1 by default.
    lines : sequence of sequence of int
        Landmarks along lines, by their place.
    error_label : str
        What the legend calls that distance.
    estimated : sequence of bool
        Which individuals have estimated landmarks, whose error the distance includes; none by default.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = subplots(1, 3, (14, 4.6))
    first, second = directional - mean
    axis = axes[0, 0]
    factor = _magnification(mean, first - second)
    _draw_shape(axis, mean, numbers, lines)
    axis.quiver(*mean.T, *(factor * (first - second)).T, angles="xy", scale_units="xy", scale=1, color=INK, width=0.007)
    axis.set_title(f"directional asymmetry, {factor:g} times: {sides[0]} minus {sides[1]}", fontsize=10)
    axis = axes[0, 1]
    apart = fluctuating - mean
    factor = _magnification(mean, apart)
    _draw_shape(axis, mean, numbers, lines)
    moved = mean + factor * apart
    axis.plot(moved[..., 0].ravel(), moved[..., 1].ravel(), ".", color=INK, ms=3, alpha=0.6)
    axis.set_title(f"fluctuating asymmetry of {len(names)} individuals, {factor:g} times", fontsize=10)
    axis = axes[0, 2]
    order = np.argsort(distances)
    is_estimated = np.array(estimated or [False] * len(distances), bool)[order]
    places = np.arange(len(distances))
    axis.plot(places[~is_estimated], distances[order][~is_estimated], "o", color=INK, ms=5)
    if is_estimated.any():
        spots = {"mfc": "none", "mec": INK, "mew": 1.2, "ms": 6}
        axis.plot(places[is_estimated], distances[order][is_estimated], "D", label="with estimated landmarks", **spots)
    if np.isfinite(error):
        axis.axhline(error, color="0.5", ls="--", lw=1, label=error_label)
    if np.isfinite(error) or is_estimated.any():
        axis.legend(frameon=False, loc="best", fontsize=8)
    if len(names) <= MOST_NAMED:
        axis.set_xticks(range(len(names)), [names[i] for i in order], rotation=90, fontsize=7, parse_math=False)
    else:
        axis.set_xticks([])
    axis.set_ylim(bottom=0)
    axis.set_title("fluctuating asymmetry of each individual", fontsize=10)
    axis.set_ylabel("Procrustes distance between sides")
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_shape(axis: "Axes", mean: np.ndarray, numbers: Sequence[int], lines: Sequence[Sequence[int]]) -> None:
    """Draw a shape (k, 2) in grey with its numbers."""
    for line in lines:
        axis.plot(*mean[list(line)].T, "-", color="0.75", lw=1)
    axis.plot(*mean.T, "o", color="0.4", ms=3)
    for number, point in zip(numbers or range(1, len(mean) + 1), mean, strict=True):
        axis.annotate(str(number), point, (4, 4), textcoords="offset points", fontsize=7, color="0.4")
    axis.set_aspect("equal")
    axis.margins(0.12)
    axis.set_axis_off()


def _magnification(mean: np.ndarray, differences: np.ndarray) -> float:
    """Return a round factor by which the largest of differences (..., 2) is a seventh of the shape's size."""
    largest = float(np.linalg.norm(differences, axis=-1).max(initial=0.0))
    extent = float(np.ptp(mean, axis=0).max())
    if not largest > 0:
        return 1.0
    wanted = extent / 7 / largest
    if wanted < 1:
        return 1.0
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= wanted))
