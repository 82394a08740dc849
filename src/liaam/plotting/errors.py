"""Figures of errors: their cumulative distribution, and the images with the largest ones."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.drawing import LANDMARK, new_axes, zoom_to
from liaam.error_measures import cumulative_errors
from liaam.photometry.picture import load_picture
from liaam.plotting.figures import LINE_WIDTH, show_picture, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ACROSS = 5  # Images in a row
TRUTH = "#ff4060"  # Colour of given landmarks beside fitted ones


def plot_cumulative(errors: np.ndarray, limit: float, label: str, ax: "Axes | None" = None) -> "Axes":
    """Draw the cumulative distribution of errors (k,), fractions, up to twice the limit, in per cent."""
    ax = ax or new_axes()[1]
    grid = np.linspace(0, 2 * limit, 401)
    shares = cumulative_errors(errors, grid)
    ax.plot(100 * grid, 100 * shares, lw=LINE_WIDTH)
    ax.axvline(100 * limit, color="0.8", lw=1, zorder=0)
    ax.set(xlabel=label, ylabel="images at or below, %", xlim=(0, 200 * limit), ylim=(0, 101))
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def plot_curve(
    sizes: Sequence[int],
    medians: np.ndarray,
    forecast: tuple[int, tuple[float, float, float]],
    people: float,
    label: str,
    ax: "Axes | None" = None,
) -> "Axes":
    """Draw errors, fractions, by the number of training images, and a forecast with its interval, in per cent."""
    ax = ax or new_axes()[1]
    n, (error, lowest, highest) = forecast
    ax.plot(sizes, 100 * medians, "o-", lw=LINE_WIDTH)
    spread = 100 * np.array([[error - lowest], [highest - error]])
    ax.errorbar([n], [100 * error], spread, fmt="o", color="0.4", capsize=3, label="forecast, 95 % interval")
    if np.isfinite(people):
        ax.axhline(100 * people, color="0.7", lw=1, zorder=0, label="people")
    ax.set(xlabel="images trained on", ylabel=label, xscale="log")
    ax.set_xticks([*sizes, n], [str(size) for size in (*sizes, n)], minor=False)
    ax.set_xticks([], minor=True)
    ax.set_ylim(bottom=0)
    ax.legend(frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def figure_of_worst(
    images: Sequence[Any], truths: np.ndarray, landmarks: np.ndarray, titles: Sequence[str]
) -> "Figure":
    """Draw given (`truths`) and fitted landmarks, (k, n, 2), on one or more images; points not finite are left out."""
    rows = -(-len(images) // ACROSS)
    columns = min(len(images), ACROSS)
    figure, axes = subplots(rows, columns, (2.6 * columns, 2.9 * rows))
    for axis in axes.ravel():
        axis.axis("off")
    for axis, image, truth, fit, title in zip(axes.ravel(), images, truths, landmarks, titles, strict=False):
        pixels = load_picture(image, "image")[0]
        show_picture(axis, pixels, title)
        axis.set_autoscale_on(False)
        for start, end in zip(truth, fit, strict=True):
            axis.plot(*np.stack([start, end]).T, color="white", lw=0.7)
        edge = {"ms": 6, "mec": "black", "mew": 0.5}  # seen on any ground
        axis.plot(*truth.T, ".", color=TRUTH, label="given", **edge)
        axis.plot(*fit.T, ".", color=LANDMARK, label="fitted", **edge)
        zoom_to(axis, np.concatenate([truth, fit]), (pixels.shape[1], pixels.shape[0]))
    axes[0, 0].legend(loc="lower right", fontsize=7, framealpha=0.6)
    return figure
