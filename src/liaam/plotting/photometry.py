"""Figures of invariant images, sweeps over theta, agreement, responses and registrations."""

from collections.abc import Mapping, Sequence
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
    from matplotlib.image import AxesImage

UNSEEN = (34, 40, 66)  # Colour of pixels without an invariant: dark blue, which differs from all grey values
STRETCH = (1.0, 99.0)  # Percentiles that become black and white in a rendering of an invariant image
EVERY = 7  # Of the pixels of several images, one in so many is enough for their common percentiles
BRIGHT = 99.0  # Percentile of the largest channel that is the brightness of an image
BRIGHT_ENOUGH = 160.0  # Least brightness of an image that is shown as it is, of 255
NEAR_WHITE = 230.0  # Brightness that a darker one is given
SWEEP = np.arange(0, 180, 15)  # Angles of a sweep in degrees
THUMBNAIL = 240  # Size of the images of a sweep in pixels
FEWEST_PIXELS = 100  # Number of pixels that are too few for an entropy
LEAST_RANGE = 1e-3  # Range of the log light of a flat image, whose entropy does not depend on the angle
MOST_PICTURES = 4  # Maximum number of images to draw above the bars of their correlations; more are shown as a matrix
LOWEST = 0.5  # Correlation at the lower end of a matrix's colour map
MOST_NUMBERED = 16  # Maximum number of images for numbers in the matrix
GREEN = "#19a979"  # Of what the figures are about
GREY = "#9a9a9a"  # Of what it is compared with


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
    values = np.concatenate([image[np.isfinite(image)][::EVERY] for image in images])
    if not len(values):
        return None
    low, high = np.percentile(values, STRETCH)
    return low, high


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
    for i, (name, (picture, values)) in enumerate(rows.items()):
        left, right = axes[i]
        show_picture(left, brightened(picture), shortened(name, 36))
        show_picture(right, invariant_picture(values, limits), "invariant image")
        if patches is not None:
            for quad in patch_corners(patches[i]):
                left.fill(*quad.T, fill=False, edgecolor="white", lw=1.0)
    return figure


def brightened(image: np.ndarray) -> np.ndarray:
    """Scale a dark image, such as a linear one, so that its brightest parts are near white, (h, w, 3) uint8."""
    picture = as_picture(image)
    top = float(np.percentile(picture[::4, ::4].max(axis=-1), BRIGHT))  # a sixteenth of the pixels is enough
    if top >= BRIGHT_ENOUGH:
        return picture
    return np.clip(picture.astype(np.float32) * (NEAR_WHITE / max(top, 1.0)), 0, 255).astype(np.uint8)


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
    encoded = log_picture(small, camera)  # the logarithms of R, G and B, and their mask
    columns = len(SWEEP) // 2  # the images are in two rows
    height = encoded.shape[0] / encoded.shape[1]
    figure, axes, curve = _two_rows_above_a_panel(columns, (2.0 * columns, 4.0 * height + 3.2), height, 0.75)
    for axis, angle in zip(axes.ravel(), SWEEP, strict=True):
        show_picture(axis, invariant_picture(projected(encoded, float(np.deg2rad(angle)))), f"{angle}°")
    curve.axvspan(*np.rad2deg(PHYSICAL), color="#eef3ea", label="physical cameras")
    log_rgb = encoded[..., :3][encoded[..., 3] > 0]
    if len(log_rgb) > FEWEST_PIXELS and np.ptp(log_rgb, axis=0).max() > LEAST_RANGE:
        thetas, entropies = entropy_curve(log_rgb)
        curve.plot(np.rad2deg(thetas), entropies, color=GREEN, lw=1.8, label="entropy")
        curve.axvline(np.rad2deg(thetas[np.argmin(entropies)]), color=GREEN, ls=":", lw=1.4, label="its minimum")
    curve.axvline(np.rad2deg(camera.theta) % 180, color="black", ls="--", lw=1.2, label="theta given")
    ticks = np.arange(0, 181, 15)
    curve.set(xlim=(0, 180), xlabel="theta, degrees", ylabel="entropy of the values, bits", xticks=ticks)
    _finish_panel(curve)
    return figure


def _two_rows_above_a_panel(
    columns: int, size: tuple[float, float], height: float, lowest: float
) -> "tuple[Figure, np.ndarray, Axes]":
    """Make a figure of two rows of images, and axes below them over the whole width.

    ``height`` is that of the rows of images, and ``lowest`` that of the axes below, both relative to an image's width.
    """
    figure, axes = subplots(3, columns, size, heights=(height, height, lowest))
    for axis in axes[2]:
        axis.remove()
    return figure, axes[:2], figure.add_subplot(axes[2, 0].get_gridspec()[2, :])


def _finish_panel(axis: "Axes") -> None:
    """Remove the frame, and put the legend in a line above the axes, where it takes no width from the images."""
    axis.spines[["top", "right"]].set_visible(False)
    entries = len(axis.get_legend_handles_labels()[0])
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=entries, frameon=False, fontsize=9)


def figure_of_agreement(
    pictures: Sequence[np.ndarray], names: Sequence[str], seen: Averaged, pairs: Sequence[Agreement]
) -> "Figure":
    """Draw the correlations of invariant images and of log grey for each pair of images.

    Those of a few images are bars below the images, those of many are two matrices.
    """
    if len(pictures) > MOST_PICTURES:
        return _figure_of_matrices(names, pairs)
    return _figure_of_bars(pictures, names, seen, pairs)


def _figure_of_matrices(names: Sequence[str], pairs: Sequence[Agreement]) -> "Figure":
    """Draw the correlations of invariant images, and those of log grey, as a matrix each."""
    n = len(names)
    side = max(4.0, 0.36 * n)  # inches
    figure, axes = subplots(1, 2, (2 * side + 2.6, side + 0.4))
    left, right = axes[0]
    _draw_matrix(left, n, pairs, "invariant", "invariant")
    shown = _draw_matrix(right, n, pairs, "log_grey", "log grey")
    left.set_yticklabels([f"{shortened(name)}  {i + 1}" for i, name in enumerate(names)], fontsize=7)
    left.set_ylabel("")
    figure.colorbar(shown, ax=axes[0], label="correlation", shrink=0.8, extend="min")
    return figure


def _figure_of_bars(
    pictures: Sequence[np.ndarray], names: Sequence[str], seen: Averaged, pairs: Sequence[Agreement]
) -> "Figure":
    """Draw images, their invariant images, and the correlations of each pair as two bars."""
    n = len(pictures)
    limits = common_limits(list(seen.invariant))
    height = pictures[0].shape[0] / pictures[0].shape[1]
    figure, axes, bars = _two_rows_above_a_panel(n, (3.0 * n, 6.0 * height + 2.4), height, 0.7)
    for i in range(n):
        show_picture(axes[0, i], brightened(pictures[i]), f"{i + 1}  {shortened(names[i], 30)}")
        show_picture(axes[1, i], invariant_picture(seen.invariant[i], limits), "invariant image")
    places = np.arange(len(pairs))
    of_invariants = [pair.invariant for pair in pairs]
    of_grey = [pair.log_grey for pair in pairs]
    left_bars = bars.bar(places - 0.18, of_invariants, 0.34, color=GREEN, label="invariant")
    right_bars = bars.bar(places + 0.18, of_grey, 0.34, color=GREY, label="log grey")
    bars.bar_label(left_bars, fmt="%.3f", fontsize=8, padding=2)
    bars.bar_label(right_bars, fmt="%.3f", fontsize=8, padding=2)
    bars.set_xticks(places, [f"{pair.first + 1} and {pair.second + 1}" for pair in pairs])
    lowest = min([0.0, *of_invariants, *of_grey])
    bars.set(ylabel="correlation", ylim=(1.25 * lowest, 1.12), xlabel="images")
    bars.axhline(0.0, color="black", lw=0.8)
    _finish_panel(bars)
    return figure


def shortened(name: str, most: int = 22) -> str:
    """Shorten a long name in the middle, because the names of a series differ at the end."""
    if len(name) <= most:
        return name
    n_first = most // 3
    n_last = most - n_first - 1  # one letter is the ellipsis
    return f"{name[:n_first]}…{name[len(name) - n_last :]}"


def _draw_matrix(axis: "Axes", n: int, pairs: Sequence[Agreement], key: str, title: str) -> "AxesImage":
    """Draw the attribute ``key`` of the pairs of n images as a matrix."""
    import matplotlib

    matrix = np.eye(n)
    for pair in pairs:
        matrix[pair.first, pair.second] = getattr(pair, key)
        matrix[pair.second, pair.first] = getattr(pair, key)
    colours = matplotlib.colormaps["viridis"].with_extremes(under="#1b1020", bad="#dddddd")
    shown = axis.imshow(matrix, vmin=LOWEST, vmax=1.0, cmap=colours)
    if n <= MOST_NUMBERED:
        for i, j in np.argwhere(~np.eye(n, dtype=bool)):
            value = matrix[i, j]
            ink = "white" if value < 0.5 * (LOWEST + 1.0) else "black"  # low correlations are dark
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
    axes[0, 0].plot(stored * 255, to_linear(stored, camera.response), color=GREEN, lw=1.8, label="this camera")
    axes[0, 0].plot(stored * 255, to_linear(stored, "srgb"), color="black", lw=1.2, ls="--", label="sRGB")
    axes[0, 0].set(xlabel="stored value, of 255", ylabel="linear light, of the largest", yscale="log", ylim=(1e-3, 1.3))
    axes[0, 0].legend(frameon=False)
    axes[0, 0].set_title("response", fontsize=10)
    if camera.vignetting:
        radius = np.linspace(0, 1, 101)
        axes[0, 1].plot(radius, falloff_at(np.square(radius), camera.vignetting), color=GREEN, lw=1.8)
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
