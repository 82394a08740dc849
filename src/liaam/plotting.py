"""Pictures: overlays of fits, models to look at, and the figures of experiments."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from liaam.evaluation import cumulative_errors
from liaam.io import atomic_path
from liaam.model import AAM
from liaam.photometry import linear_to_srgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {
    "grey": "#9a9a9a",
    "rgb": "#e8743b",
    "li": "#19a979",
    "li-lit": "#0f6e4f",
    "li-pc": "#5899da",
    "li-pcs": "#1d4e89",
    "chroma": "#b565a7",
}
"""One colour per method, the same in every figure."""

LINE_WIDTH = 1.8


def colour_of(method: str) -> str:
    """Colour of a method in figures; black for methods of your own."""
    return COLOURS.get(method, "#222222")


def as_picture(image: np.ndarray) -> np.ndarray:
    """Give any image array as (h, w, 3) uint8 to look at; floats count from 0 to 1, NaN is black."""
    image = np.asarray(image)
    if image.dtype == np.uint16:
        image = image >> 8
    if image.dtype.kind == "f":
        image = (np.clip(np.nan_to_num(image), 0, 1) * 255).round()
    image = image.astype(np.uint8)
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


def mesh_edges(triangles: np.ndarray) -> np.ndarray:
    """Edges of a mesh, each once, (m, 2) int."""
    pairs = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    return np.unique(pairs, axis=0)


def overlay(
    image: np.ndarray, shape: np.ndarray, model: AAM, colour: tuple[int, int, int] = (64, 255, 140)
) -> np.ndarray:
    """Draw a fitted shape on its picture.

    Parameters
    ----------
    image : (h, w, 3) array
    shape : (n, 2) float
        Landmarks, image pixels.
    model : AAM
        Gives the mesh (drawn faintly) and the contours (drawn strongly).
    colour : (int, int, int)
        RGB of contours and landmarks.

    Returns
    -------
    (h', w', 3) uint8
        The picture, small ones enlarged so that the lines do not cover them.
    """
    import cv2

    picture = as_picture(image)
    zoom = max(1, round(700 / max(picture.shape[:2])))
    picture = cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC) if zoom > 1 else picture.copy()
    size = float(np.ptp(shape, axis=0).max()) * zoom if np.isfinite(shape).all() else 100.0
    size = float(np.clip(size, 1.0, 4 * max(picture.shape[:2])))  # a lost fit may be of any size
    thick = max(1, round(size / 300))
    # OpenCV draws on pixel centres with a fixed-point fraction of 4 bits.
    points = np.clip(np.nan_to_num((shape + 0.5) * zoom - 0.5), -1e6, 1e6)
    fixed = np.rint(points * 16).astype(np.int32)
    faint = picture.copy()
    for a, b in mesh_edges(model.triangles):
        cv2.line(faint, tuple(map(int, fixed[a])), tuple(map(int, fixed[b])), colour, thick, cv2.LINE_AA, 4)
    weight = 0.35 if model.contours else 0.6
    picture = cv2.addWeighted(faint, weight, picture, 1 - weight, 0)
    for indices, closed in model.contours:
        cv2.polylines(picture, [fixed[list(indices)].reshape(-1, 1, 2)], closed, colour, thick, cv2.LINE_AA, 4)
    radius = int(16 * max(1.2, size / 180))
    for x, y in fixed:
        cv2.circle(picture, (int(x), int(y)), radius, (0, 0, 0), -1, cv2.LINE_AA, 4)
        cv2.circle(picture, (int(x), int(y)), int(radius * 0.7), colour, -1, cv2.LINE_AA, 4)
    return picture


def save_figure(figure: "Figure", path: Path, dpi: int = 120) -> None:
    """Write a figure atomically and close it."""
    import matplotlib.pyplot as plt

    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format=path.suffix.lstrip(".") or "png", bbox_inches="tight")
    plt.close(figure)


def _subplots(rows: int, columns: int, size: tuple[float, float]) -> tuple["Figure", np.ndarray]:
    import matplotlib

    matplotlib.use("Agg", force=False)
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, constrained_layout=True)
    return figure, axes


def _draw_shape(axis: "Axes", shape: np.ndarray, model: AAM, colour: str, label: str = "", **style) -> None:
    style = {"lw": LINE_WIDTH, **style}
    if not model.contours:
        axis.triplot(
            shape[:, 0],
            shape[:, 1],
            model.triangles,
            color=colour,
            alpha=0.8,
            label=label,
            lw=0.6 * style["lw"],
        )
        return
    for i, (indices, closed) in enumerate(model.contours):
        line = shape[[*indices, indices[0]] if closed else list(indices)]
        axis.plot(line[:, 0], line[:, 1], color=colour, label=label if i == 0 else None, **style)


def _show(axis: "Axes", image: np.ndarray, title: str) -> None:
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
    """One training picture, the start, each method's fit, and the truth.

    Parameters
    ----------
    training, image : (h, w, 3)
    start, truth : (n, 2)
    fits : mapping of method to (shape, mean error in pixels)
    model : AAM
    """
    figure, axes = _subplots(1, 2 + len(fits), (3.1 * (2 + len(fits)), 4.4))
    _show(axes[0, 0], training, "one of the training pictures")
    _show(axes[0, 1], image, "new picture, hard lateral light: start")
    _draw_shape(axes[0, 1], start, model, "#ffd166")
    for axis, (method, (shape, error)) in zip(axes[0, 2:], fits.items(), strict=True):
        _show(axis, image, f"{method}: {error:.1f} px")
        _draw_shape(axis, truth, model, "white", "truth", lw=0.9)
        _draw_shape(axis, shape, model, colour_of(method), method)
        axis.legend(loc="lower right", fontsize=7, framealpha=0.6)
    return figure


def figure_of_model(model: AAM, n_modes: int = 3) -> "Figure":
    """Mean appearance with mesh, and what the first shape and appearance modes do (two standard deviations)."""
    shape_model, appearance = model.shape_model, model.levels[-1].appearances["value"]
    shown = max(1, min(n_modes, max(len(shape_model.modes), appearance.n_modes)))
    figure, axes = _subplots(2, 2 + shown, (2.6 * (2 + shown), 6.0))
    mean = _mean_picture(model)
    _show(axes[0, 0], mean, "mean appearance")
    _show(axes[1, 0], mean, f"mesh, {model.n_points} landmarks")
    axes[1, 0].triplot(*(shape_model.mean - model.frame.origin).T, model.triangles, color="#19a979", lw=0.7)
    _show(axes[0, 1], _log_picture(model), "mean of the logarithms")
    axes[1, 1].axis("off")
    if model.is_colour:
        invariant = model.levels[-1].appearances["invariant"].mean[:, 0]
        axes[1, 1].imshow(np.ma.masked_invalid(model.frame.picture(invariant, np.nan)), cmap="viridis")
        axes[1, 1].set_title("mean invariant", fontsize=10)
    for i in range(shown):
        _show_shape_mode(axes[0, 2 + i], model, i)
        _show_appearance_mode(axes[1, 2 + i], model, i)
    return figure


def _mean_picture(model: AAM) -> np.ndarray:
    return model.frame.picture(model.levels[-1].appearances["value"].mean, 1.0)


def _log_picture(model: AAM) -> np.ndarray:
    return model.frame.picture(linear_to_srgb(np.exp(model.levels[-1].appearances["log"].mean)), 1.0)


def _show_shape_mode(axis: "Axes", model: AAM, i: int) -> None:
    axis.axis("off")
    if i >= len(model.shape_model.modes):
        return
    mean = model.shape_model.mean
    step = 2 * np.sqrt(model.shape_model.eigenvalues[i]) * model.shape_model.modes[i].reshape(-1, 2)
    if not model.contours:
        axis.triplot(*mean.T, model.triangles, color="#d0d0d0", lw=0.6)
    for sign, colour in ((-1, "#5899da"), (1, "#e8743b")):
        moved = mean + sign * step
        if model.contours:
            _draw_shape(axis, moved, model, colour, lw=1.2)
        else:  # without contours: how far and whither each landmark goes
            axis.plot(*np.stack([mean, moved]).transpose(2, 0, 1), color=colour, lw=1.2)
            axis.plot(*moved.T, ".", color=colour, ms=4)
    axis.set_title(f"shape mode {i + 1}, −2 and +2 sd", fontsize=10)
    axis.set_aspect("equal")
    axis.invert_yaxis()


def _show_appearance_mode(axis: "Axes", model: AAM, i: int) -> None:
    axis.axis("off")
    appearance = model.levels[-1].appearances["value"]
    if i >= appearance.n_modes:
        return
    step = 2 * np.sqrt(appearance.eigenvalues[i]) * appearance.modes[i]
    pair = [model.frame.picture(appearance.mean + sign * step, 1.0) for sign in (-1, 1)]
    half = pair[0].shape[1] // 2
    _show(
        axis,
        np.concatenate([pair[0][:, :half], pair[1][:, half:]], axis=1),
        f"appearance mode {i + 1}, −2 | +2 sd",
    )


def figure_of_errors(errors: Mapping[str, Sequence[float]], bound: Iterable[float], limit: float) -> "Figure":
    """Cumulative error distributions of methods and of the shape model's own bound, in per cent of IOD."""
    figure, axes = _subplots(1, 1, (6.4, 4.4))
    axis = axes[0, 0]
    grid = np.linspace(0, 0.12, 241)
    axis.plot(
        100 * grid,
        100 * cumulative_errors(np.array(list(bound)), grid),
        color="#bbbbbb",
        ls="--",
        label="shape model's bound",
    )
    for method, values in errors.items():
        label = f"{method}: median {100 * np.median(values):.2f} %"
        axis.plot(
            100 * grid,
            100 * cumulative_errors(np.array(values), grid),
            color=colour_of(method),
            lw=LINE_WIDTH,
            label=label,
        )
    axis.axvline(100 * limit, color="#dddddd", lw=1, zorder=0)
    axis.set(xlabel="error, % of inter-ocular distance", ylabel="fits at or below, %", xlim=(0, 12), ylim=(0, 101))
    axis.legend(loc="lower right", fontsize=8, frameon=False)
    axis.spines[["top", "right"]].set_visible(False)
    return figure
