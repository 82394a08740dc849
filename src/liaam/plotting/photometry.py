"""Figures of invariant images, sweeps over theta, agreement, responses and registrations."""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING

import cv2
import numpy as np

from liaam.calibration.chart import patch_corners
from liaam.calibration.comparison import Agreement, Averaged
from liaam.calibration.entropy import entropy_curve
from liaam.calibration.estimate import PHYSICAL
from liaam.drawing import as_picture
from liaam.photometry import CameraModel, to_linear
from liaam.photometry.camera import falloff_at
from liaam.photometry.projection import log_picture, projected
from liaam.plotting.figures import show_picture, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UNSEEN = (34, 40, 66)  # Colour of pixels without an invariant: dark blue, which differs from all grey values
STRETCH = (1.0, 99.0)  # Percentiles that become black and white in a rendering of an invariant image
SWEEP = np.arange(0, 180, 15)  # Angles of a sweep in degrees
THUMBNAIL = 240  # Size of the images of a sweep in pixels


def invariant_picture(values: np.ndarray, limits: tuple[float, float] | None = None) -> np.ndarray:
    """Render an invariant image as grey values, with dark blue for missing pixels.

    Parameters
    ----------
    values : (h, w) float
        Invariant image, NaN where missing.
    limits : (float, float), optional
        Values that become black and white. By default the 1st and 99th percentile.

    Returns
    -------
    (h, w, 3) uint8
    """
    seen = np.isfinite(values)
    if not seen.any():
        return np.full((*values.shape, 3), UNSEEN, dtype=np.uint8)
    low, high = limits or np.percentile(values[seen], STRETCH)
    grey = np.clip((np.nan_to_num(values) - low) / max(high - low, 1e-9), 0, 1)
    picture = np.repeat(np.rint(255 * grey).astype(np.uint8)[..., None], 3, axis=2)
    picture[~seen] = UNSEEN
    return picture


def common_limits(images: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """Return common limits for rendering several invariant images."""
    values = np.concatenate([image[np.isfinite(image)][::7] for image in images])
    return tuple(np.percentile(values, STRETCH)) if len(values) else None  # type: ignore[return-value]


def figure_of_invariants(
    rows: Mapping[str, tuple[np.ndarray, np.ndarray]], patches: Sequence[np.ndarray] | None = None
) -> "Figure":
    """Draw images beside their invariant images, all with the same limits.

    Parameters
    ----------
    rows : mapping of name to (image (h, w, 3), invariant image (h, w))
    patches : sequence of (n, 4) or (n, 4, 2) float, optional
        Patches to draw on each image.
    """
    limits = common_limits([values for _, values in rows.values()])
    height, width = next(iter(rows.values()))[0].shape[:2]
    figure, axes = subplots(len(rows), 2, (7.0, 3.5 * len(rows) * height / width + 0.4))
    for i, ((name, (picture, values)), line) in enumerate(zip(rows.items(), axes, strict=True)):
        show_picture(line[0], brightened(picture), shortened(name, 36))
        show_picture(line[1], invariant_picture(values, limits), "invariant image")
        for quad in patch_corners(patches[i]) if patches is not None else ():
            line[0].fill(*quad.T, fill=False, edgecolor="white", lw=1.0)
    return figure


def brightened(image: np.ndarray) -> np.ndarray:
    """Scale a dark image, such as a linear one, so that its 99th percentile is near white."""
    picture = as_picture(image)
    top = float(np.percentile(picture[::4, ::4].max(axis=-1), 99))
    if top >= 160:
        return picture
    return np.clip(picture.astype(np.float32) * (230.0 / max(top, 1.0)), 0, 255).astype(np.uint8)


def figure_of_sweep(image: np.ndarray, camera: CameraModel) -> "Figure":
    """Draw invariant images over theta, above the entropy of their values.

    Parameters
    ----------
    image : (h, w, 3) uint8, uint16 or float array
    camera : CameraModel
        Camera with the response, and the angle to mark.
    """
    scale = THUMBNAIL / max(image.shape[:2])
    small = image if scale >= 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    encoded = log_picture(small, camera)
    columns = len(SWEEP) // 2
    height = encoded.shape[0] / encoded.shape[1]
    figure, axes, curve = _two_rows_above_a_panel(columns, (2.0 * columns, 4.0 * height + 3.2), height, 0.75)
    for axis, angle in zip(axes.ravel(), SWEEP, strict=True):
        show_picture(axis, invariant_picture(projected(encoded, float(np.deg2rad(angle)))), f"{angle}°")
    curve.axvspan(*np.rad2deg(PHYSICAL), color="#eef3ea", label="physical cameras")
    log_rgb = encoded[..., :3][encoded[..., 3] > 0]
    if len(log_rgb) > 100 and np.ptp(log_rgb, axis=0).max() > 1e-3:
        thetas, entropies = entropy_curve(log_rgb)
        curve.plot(np.rad2deg(thetas), entropies, color="#19a979", lw=1.8, label="entropy")
        curve.axvline(np.rad2deg(thetas[np.argmin(entropies)]), color="#19a979", ls=":", lw=1.4, label="its minimum")
    curve.axvline(np.rad2deg(camera.theta) % 180, color="black", ls="--", lw=1.2, label="theta given")
    ticks = np.arange(0, 181, 15)
    curve.set(xlim=(0, 180), xlabel="theta, degrees", ylabel="entropy of the values, bits", xticks=ticks)
    _finish_panel(curve)
    return figure


def _two_rows_above_a_panel(
    columns: int, size: tuple[float, float], height: float, lowest: float
) -> "tuple[Figure, np.ndarray, Axes]":
    """Make a figure of two rows of images, and axes below them over the whole width."""
    figure, axes = subplots(3, columns, size, heights=(height, height, lowest))
    for axis in axes[2]:
        axis.remove()
    return figure, axes[:2], figure.add_subplot(axes[2, 0].get_gridspec()[2, :])


def _finish_panel(axis: "Axes") -> None:
    """Remove the frame, and put the legend in a line above the axes, where it takes no width from the images."""
    axis.spines[["top", "right"]].set_visible(False)
    entries = len(axis.get_legend_handles_labels()[0])
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=entries, frameon=False, fontsize=9)


MATRIX = 4  # Maximum number of images to draw above the correlations. More are shown as a matrix.
LOWEST = 0.5  # Correlation at the lower end of a matrix's colour map
NUMBERED = 16  # Maximum number of images for numbers in the matrix


def figure_of_agreement(
    pictures: Sequence[np.ndarray], names: Sequence[str], seen: Averaged, pairs: Sequence[Agreement]
) -> "Figure":
    """Draw the correlations of invariant images and of log grey for each pair of images, below the images."""
    n = len(pictures)
    if n > MATRIX:
        side = max(4.0, 0.36 * n)
        figure, axes = subplots(1, 2, (2 * side + 2.6, side + 0.4))
        for axis, key, title in ((axes[0, 0], "invariant", "invariant"), (axes[0, 1], "log_grey", "log grey")):
            shown = _draw_matrix(axis, n, pairs, key, title)
        axes[0, 0].set_yticklabels([f"{shortened(name)}  {i + 1}" for i, name in enumerate(names)], fontsize=7)
        axes[0, 0].set_ylabel("")
        figure.colorbar(shown, ax=axes[0], label="correlation", shrink=0.8, extend="min")
        return figure
    limits = common_limits(list(seen.invariant))
    height = pictures[0].shape[0] / pictures[0].shape[1]
    figure, axes, bars = _two_rows_above_a_panel(n, (3.0 * n, 6.0 * height + 2.4), height, 0.7)
    for i in range(n):
        show_picture(axes[0, i], brightened(pictures[i]), f"{i + 1}  {shortened(names[i], 30)}")
        show_picture(axes[1, i], invariant_picture(seen.invariant[i], limits), "invariant image")
    places = np.arange(len(pairs))
    heights = {"invariant": [pair.invariant for pair in pairs]}
    heights["log grey"] = [pair.log_grey for pair in pairs]
    for shift, colour, (key, values) in zip((-0.18, 0.18), ("#19a979", "#9a9a9a"), heights.items(), strict=True):
        bars.bar_label(
            bars.bar(places + shift, values, 0.34, color=colour, label=key), fmt="%.3f", fontsize=8, padding=2
        )
    bars.set_xticks(places, [f"{pair.first + 1} and {pair.second + 1}" for pair in pairs])
    lowest = min([0.0, *chain.from_iterable(heights.values())])
    bars.set(ylabel="correlation", ylim=(1.25 * lowest, 1.12), xlabel="images")
    bars.axhline(0.0, color="black", lw=0.8)
    _finish_panel(bars)
    return figure


def shortened(name: str, most: int = 22) -> str:
    """Shorten a long name in the middle, because the names of a series differ at the end."""
    return name if len(name) <= most else f"{name[: most // 3]}…{name[len(name) - most + most // 3 + 1 :]}"


def _draw_matrix(axis: "Axes", n: int, pairs: Sequence[Agreement], key: str, title: str):
    import matplotlib

    matrix = np.eye(n)
    for pair in pairs:
        matrix[pair.first, pair.second] = matrix[pair.second, pair.first] = getattr(pair, key)
    colours = matplotlib.colormaps["viridis"].with_extremes(under="#1b1020", bad="#dddddd")
    shown = axis.imshow(matrix, vmin=LOWEST, vmax=1.0, cmap=colours)
    if n <= NUMBERED:
        for i, j in np.argwhere(~np.eye(n, dtype=bool)):
            value = matrix[i, j]
            ink = "white" if value < 0.5 * (LOWEST + 1.0) else "black"
            text = "–" if np.isnan(value) else f"{value:z.2f}"
            axis.text(j, i, text, ha="center", va="center", fontsize=6, color=ink)
    median = np.nanmedian([getattr(pair, key) for pair in pairs])
    axis.set_title(f"{title}: median {median:z.3f}", fontsize=10)
    axis.set(xlabel="image", ylabel="image")
    for set_ticks in (axis.set_xticks, axis.set_yticks):
        set_ticks(range(n), [str(i + 1) for i in range(n)], fontsize=7)
    return shown


def figure_of_response(camera: CameraModel) -> "Figure":
    """Draw a camera's response beside sRGB, and its vignetting if known."""
    panels = 2 if camera.vignetting else 1
    figure, axes = subplots(1, panels, (4.5 * panels, 3.6))
    stored = np.linspace(1 / 255, 1, 255)
    axes[0, 0].plot(stored * 255, to_linear(stored, camera.response), color="#19a979", lw=1.8, label="this camera")
    axes[0, 0].plot(stored * 255, to_linear(stored, "srgb"), color="black", lw=1.2, ls="--", label="sRGB")
    axes[0, 0].set(xlabel="stored value, of 255", ylabel="linear light, of the largest", yscale="log", ylim=(1e-3, 1.3))
    axes[0, 0].legend(frameon=False)
    axes[0, 0].set_title("response", fontsize=10)
    if camera.vignetting:
        radius = np.linspace(0, 1, 101)
        axes[0, 1].plot(radius, falloff_at(np.square(radius), camera.vignetting), color="#19a979", lw=1.8)
        axes[0, 1].set(xlabel="distance from the centre, 1 in the corners", ylabel="fraction of light", ylim=(0, 1.05))
        axes[0, 1].set_title("vignetting", fontsize=10)
    for axis in axes[0]:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color="#e6e6e6", lw=0.8)
    return figure


def checkerboard(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Combine two registered images in a checkerboard pattern: lines continue across fields where they are aligned.

    Parameters
    ----------
    a, b : (h, w, 3) arrays

    Returns
    -------
    (h, w, 3) uint8
    """
    height, width = a.shape[:2]
    size = max(8, max(height, width) // 8)
    odd = ((np.arange(height) // size)[:, None] + np.arange(width) // size) % 2 == 1
    return np.where(odd[..., None], as_picture(b), as_picture(a))
