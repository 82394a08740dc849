"""Figures of models, lamps and fits."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from liaam.drawing import as_picture, line_of
from liaam.io import atomic_path
from liaam.model import AAM
from liaam.model.appearance import AppearanceModel
from liaam.photometry import invariant, linear_to_srgb
from liaam.training import LearntLamps

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

LINE_WIDTH = 1.8  # Of contours, points
INK = "#0b6e8a"  # Colour of landmarks on white: deep enough to be seen
MINUS = "#2f7fd0"  # Colour of shapes moved by minus two standard deviations along a mode
PLUS = "#e8743b"  # That of plus two
MOST_NUMBERED = 40  # Landmarks up to which each has its number beside it; of more, every other has one, and so on
LAMPS_DRAWN = 47  # Maximum number of lamps in a figure: with the training light they fill six rows
FITS_ACROSS = 3  # Number of fits in a row, so that their titles can be read on a page
LAMPS_ACROSS = 8  # Number of images in a row of it


def save_figure(figure: "Figure", *paths: Path, dpi: int = 120) -> None:
    """Write a figure atomically, in the format of each path's suffix, and close it.

    The output is reproducible: files have no date, and SVG identifiers are not random.
    """
    import matplotlib
    import matplotlib.pyplot as plt

    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    for path in paths:
        form = path.suffix.lstrip(".").lower() or "png"
        with atomic_path(path) as temporary, matplotlib.rc_context({"svg.hashsalt": "liaam"}):
            figure.savefig(temporary, dpi=dpi, format=form, bbox_inches="tight", metadata=undated.get(form))
    plt.close(figure)


def subplots(
    rows: int, columns: int, size: tuple[float, float], heights: Sequence[float] | None = None
) -> tuple["Figure", np.ndarray]:
    """Make a figure, with `size` in inches, and a grid of axes, (rows, columns). It needs no display."""
    import matplotlib

    matplotlib.use("Agg", force=False)
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        rows, columns, figsize=size, squeeze=False, constrained_layout=True, height_ratios=heights
    )
    return figure, axes


def _draw_shape(axis: "Axes", shape: np.ndarray, model: AAM, colour: str, label: str = "", **style) -> None:
    """Draw the contours of a shape (n, 2), or its mesh if the model has none; ``style`` is that of lines."""
    style = {"lw": LINE_WIDTH, **style}
    if not model.contours:
        axis.triplot(*shape.T, model.triangles, color=colour, alpha=0.8, label=label, lw=0.6 * style["lw"])
        return
    for i, (indices, closed) in enumerate(model.contours):
        axis.plot(*line_of(shape, indices, closed).T, color=colour, label=label if i == 0 else None, **style)


def show_picture(axis: "Axes", image: np.ndarray, title: str) -> None:
    """Show an image with a title and without axes."""
    axis.imshow(as_picture(image))
    axis.set_title(title, fontsize=10)
    axis.axis("off")


def figure_of_fits(
    training: np.ndarray,
    image: np.ndarray,
    start: np.ndarray,
    truth: np.ndarray,
    fits: Mapping[str, tuple[np.ndarray, float]],
    model: AAM,
) -> "Figure":
    """Draw a training image, the start, and each method's fit with the truth.

    Parameters
    ----------
    training, image : (h, w, 3)
    start, truth : (n, 2)
    fits : mapping of method to (shape, mean error in pixels)
    model : AAM
    """
    n_rows = -(-(2 + len(fits)) // FITS_ACROSS)
    figure, grid = subplots(n_rows, FITS_ACROSS, (2.6 * FITS_ACROSS, 3.9 * n_rows))
    axes = grid.ravel()
    for axis in axes[2 + len(fits) :]:
        axis.remove()
    show_picture(axes[0], training, "a training image")
    show_picture(axes[1], image, "new image in hard light: start")
    _draw_shape(axes[1], start, model, "#ffd166")
    for i, (axis, (method, (shape, error))) in enumerate(zip(axes[2:], fits.items(), strict=False)):
        show_picture(axis, image, f"{method}: {error:.1f} px")
        _draw_shape(axis, truth, model, "white", "truth", lw=0.9)
        _draw_shape(axis, shape, model, f"C{i}", method)
        axis.legend(loc="lower right", fontsize=9, framealpha=0.6)
    return figure


def figure_of_model(model: AAM, n_modes: int = 3) -> "Figure":
    """Draw the mean appearance, the mesh, and the first shape and appearance modes (two standard deviations).

    The shapes of a model of several are drawn below each other.
    """
    rows = [row for part in model.parts for row in _panels_of(part, n_modes)]
    columns = max(len(row) for row in rows)
    tallest = max(part.frame.size[1] / part.frame.size[0] for part in model.parts)
    figure, grid = subplots(len(rows), columns, (2.6 * columns, (2.6 * tallest + 0.4) * len(rows)))
    for axis in grid.ravel():
        axis.axis("off")
    for axes, row in zip(grid, rows, strict=True):
        for axis, draw in zip(axes, row, strict=False):
            draw(axis)
    figure.legend(*_legend_of_modes(), loc="outside lower center", ncols=2, frameon=False)
    return figure


Panel = Callable[["Axes"], None]
"""What draws a panel of a figure."""


def _panels_of(model: AAM, n_modes: int) -> tuple[list[Panel], list[Panel]]:
    """Return the panels of a model: its landmarks and shape modes, and its appearance and appearance modes."""
    appearance = model.levels[-1].appearances["log"]
    mean = _stored(model, appearance.mean)
    above = [
        partial(show_picture, image=mean, title="mean appearance"),
        partial(_show_landmarks, mean=mean, model=model),
    ]
    below = [partial(_show_mesh, mean=mean, model=model)]
    if model.is_colour:
        below.append(partial(_show_invariant, model=model, appearance=appearance))
    n_shapes = min(n_modes, len(model.shape_model.modes))
    n_appearances = min(n_shapes + len(above) - len(below), appearance.n_modes)  # as many as have room
    above += [partial(_show_shape_mode, model=model, i=i) for i in range(n_shapes)]
    below += [partial(_show_appearance_mode, model=model, appearance=appearance, i=i) for i in range(n_appearances)]
    return above, below


def _show_landmarks(axis: "Axes", mean: np.ndarray, model: AAM) -> None:
    """Draw the mean shape with its contours, and the numbers of the landmarks."""
    shape = model.shape_model.mean - model.frame.origin
    show_picture(axis, np.full_like(mean, 1.0), f"{model.n_points} landmarks")
    if model.contours:
        _draw_shape(axis, shape, model, "0.7", lw=0.8)
    axis.plot(*shape.T, ".", color=INK, ms=4)
    step = -(-model.n_points // MOST_NUMBERED)
    for i in range(0, model.n_points, step):
        axis.annotate(str(i + 1), shape[i], (2, 2), textcoords="offset points", fontsize=7)


def _show_mesh(axis: "Axes", mean: np.ndarray, model: AAM) -> None:
    """Draw the mean shape's triangles on the mean appearance."""
    show_picture(axis, mean, f"mesh, {len(model.triangles)} triangles")
    axis.triplot(*(model.shape_model.mean - model.frame.origin).T, model.triangles, color="#19a979", lw=0.7)


def _show_invariant(axis: "Axes", model: AAM, appearance: AppearanceModel) -> None:
    """Show the invariant of the mean appearance."""
    values = model.frame.picture(invariant(appearance.mean, model.theta), np.nan)
    # Without NaN below the mask: Matplotlib resamples what is masked, too, and may warn of it.
    axis.imshow(np.ma.masked_array(np.nan_to_num(values), np.isnan(values)), cmap="viridis")
    axis.set_title("mean invariant", fontsize=10)


def _show_appearance_mode(axis: "Axes", model: AAM, appearance: AppearanceModel, i: int) -> None:
    """Show an appearance mode: its left half at minus two standard deviations, and its right half at plus two."""
    step = 2 * np.sqrt(appearance.eigenvalues[i]) * appearance.modes[i]
    minus = _stored(model, appearance.mean - step)
    plus = _stored(model, appearance.mean + step)
    half = minus.shape[1] // 2
    halves = np.concatenate([minus[:, :half], plus[:, half:]], axis=1)
    show_picture(axis, halves, f"appearance mode {i + 1}")


def _show_shape_mode(axis: "Axes", model: AAM, i: int) -> None:
    """Draw the mean shape moved along a shape mode, by minus and plus two standard deviations."""
    mean = model.shape_model.mean
    step = 2 * np.sqrt(model.shape_model.eigenvalues[i]) * model.shape_model.modes[i].reshape(-1, 2)
    if not model.contours:
        axis.triplot(*mean.T, model.triangles, color="#d0d0d0", lw=0.6)
    for sign, colour in ((-1, MINUS), (1, PLUS)):
        moved = mean + sign * step
        if model.contours:
            _draw_shape(axis, moved, model, colour, lw=1.2)
        else:  # without contours: draw the displacement of each landmark
            axis.plot(*np.stack([mean, moved]).transpose(2, 0, 1), color=colour, lw=1.2)
            axis.plot(*moved.T, ".", color=colour, ms=4)
    axis.set_title(f"shape mode {i + 1}", fontsize=10)
    axis.set_aspect("equal")
    axis.invert_yaxis()


def _legend_of_modes() -> "tuple[list[Line2D], list[str]]":
    """Return the entries of a legend: what the colours of shape modes and the halves of appearance modes are."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour, lw=2) for colour in (MINUS, PLUS)]
    return handles, [
        "\N{MINUS SIGN}2 standard deviations; left half of appearance modes",
        "+2 standard deviations; right half",
    ]


def _stored(model: AAM, log_rgb: np.ndarray) -> np.ndarray:
    """Return the picture (h, w, 3) of logarithms of light (n_pixels, 3) on the reference frame."""
    return model.frame.picture(linear_to_srgb(np.minimum(np.exp(log_rgb), 1.0)), 1.0)


def figure_of_lamps(lamps: LearntLamps, image: np.ndarray | None = None, points: np.ndarray | None = None) -> "Figure":
    """Draw an image under each lamp.

    Parameters
    ----------
    lamps : LearntLamps
    image : (h, w, 3) array, optional
        Image under the training light. By default plain grey.
    points : (n, 2) float, optional
        Landmarks of the image. By default the mean landmarks.
    """
    if image is None or points is None:
        image = np.full((160, 160, 3), 128, np.uint8)
        points = 79.5 + 100.0 * lamps.mean
    shown = range(min(len(lamps), LAMPS_DRAWN))
    titles = ["training light", *(lamps.names[i] for i in shown)]
    pictures = [image, *lamps.relit(image, points, shown)]
    across = min(len(pictures), LAMPS_ACROSS)
    n_gaps = -len(pictures) % across
    titles += [" " * i for i in range(n_gaps)]  # blank, but different: they are the keys of a row
    pictures += [None] * n_gaps
    rows = []
    for first in range(0, len(pictures), across):
        of_row = slice(first, first + across)
        rows.append(dict(zip(titles[of_row], pictures[of_row], strict=True)))
    figure = figure_of_pictures(rows, width=1.6)
    figure.axes[0].plot(*points.T, ".", color="white", ms=1.5)
    return figure


def figure_of_pictures(rows: Sequence[Mapping[str, np.ndarray | None]], width: float = 2.6) -> "Figure":
    """Draw images with titles, one row per mapping. None leaves a gap; columns without images are left out.

    `width` is the width of an image in inches.
    """
    images_of_rows = [list(row.values()) for row in rows]
    shown = [i for i in range(len(rows[0])) if any(images[i] is not None for images in images_of_rows)]
    first = next(image for image in images_of_rows[0] if image is not None)
    height = width * first.shape[0] / first.shape[1] + 0.3  # with the title
    figure, axes = subplots(len(rows), len(shown), (width * len(shown), height * len(rows)))
    for axes_of_row, row, images in zip(axes, rows, images_of_rows, strict=True):
        titles = list(row)
        for axis, i in zip(axes_of_row, shown, strict=True):
            axis.axis("off")
            image = images[i]
            if image is not None:
                show_picture(axis, image, titles[i])
    return figure
