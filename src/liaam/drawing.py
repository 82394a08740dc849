"""Landmarks drawn on images: what results and figures have in common."""

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from liaam.model.contours import Contours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LANDMARK = "#40ff8c"  # Colour of landmarks, and of fits that may be used
DOUBTFUL = "#ffa81f"  # Colour of fits to check
LOST = "#ff4141"  # Colour of fits that failed, and of faulty landmarks
ABSENT = "#ff2828"  # Colour of rings at landmarks that are not there
ELLIPSE = "#ffffff"  # Colour of ellipses
EDGE = 1.6  # Width of the dark edges around lines in figures, points, with which they are seen on any ground


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour such as ``#40ff8c``."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def line_of(points: np.ndarray, indices: Sequence[int], closed: bool) -> np.ndarray:
    """Return the points (m, 2) of a contour of landmarks (n, 2) in turn, the first again at the end if it is closed."""
    return points[[*indices, indices[0]] if closed else list(indices)]


def as_picture(image: np.ndarray) -> np.ndarray:
    """Convert any image array to (h, w, 3) uint8 for display; floats range from 0 to 1, NaN becomes black."""
    image = np.asarray(image)
    if image.dtype == np.uint16:
        image = image >> 8
    if image.dtype.kind == "f":
        image = (np.clip(np.nan_to_num(image), 0, 1) * 255).round()
    image = image.astype(np.uint8)
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


def ellipses(points: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Outlines (m, 32, 2) of the ellipses that contain 95 % of a Gaussian distribution around each point (m, 2)."""
    finite = np.isfinite(covariances).all(axis=(1, 2), keepdims=True)
    values, axes = np.linalg.eigh(np.where(finite, covariances, 0.0))
    # The squared Mahalanobis distance has a chi-squared distribution with two degrees of freedom.
    radii = np.sqrt(-2.0 * np.log(0.05) * np.maximum(values, 0.0))
    turn = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return points[:, None] + np.einsum("mab,mb,nb->mna", axes, radii, circle)


def plot_landmarks(
    image: np.ndarray | None,
    landmarks: np.ndarray,
    *,
    covariances: np.ndarray | None = None,
    contours: Contours = (),
    absent: np.ndarray | None = None,
    title: str = "",
    colour: str = LANDMARK,
    ax: "Axes | None" = None,
) -> "Axes":
    """Draw landmarks (n, 2), their contours and their 95 % ellipses with Matplotlib, on an image or on white.

    Landmarks that are not finite are left out. Of ``absent`` ones (n,), a ring is drawn.
    """
    from matplotlib.patheffects import withStroke

    ax = ax or new_axes()[1]
    if image is None:
        ax.set_aspect("equal")
        if not ax.yaxis_inverted():
            ax.invert_yaxis()
    else:
        ax.imshow(as_picture(image))
        ax.set_autoscale_on(False)

    def draw_line(line: np.ndarray, colour: str, width: float) -> None:
        ax.plot(*line.T, color=colour, lw=width, path_effects=[withStroke(linewidth=width + EDGE, foreground="black")])

    for indices, closed in contours:
        draw_line(line_of(landmarks, indices, closed), colour, 1.2)
    if covariances is not None:
        for outline in ellipses(landmarks, covariances):
            draw_line(np.concatenate([outline, outline[:1]]), ELLIPSE, 0.8)
    is_absent = np.zeros(len(landmarks), bool) if absent is None else absent
    ax.plot(*landmarks[~is_absent].T, "o", color=colour, mec="black", mew=0.8, ms=4)
    if is_absent.any():
        ax.plot(*landmarks[is_absent].T, "o", mfc="none", mec=ABSENT, mew=1.2, ms=6.0)
    ax.set_title(title, fontsize=10)
    ax.axis("off")
    return ax


def zoom_to(ax: "Axes", landmarks: np.ndarray, size: tuple[int, int]) -> None:
    """Limit the axes to the landmarks and a margin around them, within an image of a size (width, height)."""
    finite = landmarks[np.isfinite(landmarks).all(axis=1)]
    if not len(finite):
        return
    low = finite.min(axis=0)
    high = finite.max(axis=0)
    pad = 0.3 * float((high - low).max())
    limits = np.array(size) - 1.0
    low = np.clip(low - pad, 0.0, limits)
    high = np.clip(high + pad, 0.0, limits)
    if (high - low >= 2.0).all():  # some of the object lies inside the image
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(high[1], low[1])


def new_axes() -> tuple["Figure", "Axes"]:
    """Make a square figure with one pair of axes."""
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=(5.0, 5.0), layout="constrained")


def png_bytes(figure: "Figure") -> bytes:
    """Encode a figure as PNG, and close it."""
    import matplotlib.pyplot as plt

    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    plt.close(figure)
    return buffer.getvalue()
