"""Figure of automatic shapes beside people's."""

from typing import TYPE_CHECKING

import numpy as np

from liaam.drawing import LANDMARK
from liaam.plotting.figures import subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 0.1  # Length of the largest bias or random error in the figure, as a fraction of the shape's extent


def figure_of_shape_agreement(
    mean: np.ndarray,
    bias: np.ndarray,
    random_error: np.ndarray,
    slopes: np.ndarray,
    ratios: np.ndarray,
    scores: np.ndarray,
) -> "Figure":
    """Draw bias and random error of the landmarks, slopes and variance ratios by component, and first scores.

    Parameters
    ----------
    mean, bias : (n, 2) float64
        Mean of people's shapes and mean difference of automatic from these, of centroid size 1, y downwards.
    random_error : (n,) float64
        Root mean square of what else differs.
    slopes, ratios : (c,) float64
        Slope and variance ratio along each principal component.
    scores : (2, m) float64
        Scores of the first component: of automatic and of people's shapes.
    """
    figure, axes = subplots(1, 3, (14, 4.6))
    _draw_landmarks(axes[0, 0], mean, bias, random_error)
    axis = axes[0, 1]
    numbers = np.arange(1, len(slopes) + 1)
    axis.axhline(1.0, color="0.7", lw=1, zorder=0)
    axis.plot(numbers, slopes, "o-", color=LANDMARK, label="slope on people's")
    axis.plot(numbers, ratios, "s--", color="0.4", label="variance ratio")
    axis.set(xlabel="principal component of people's shapes", xticks=numbers, title="1: as people's")
    axis.set_ylim(bottom=min(0.0, float(np.nanmin([0.0, *slopes, *ratios]))))
    axis.legend(frameon=False)
    axis = axes[0, 2]
    ends = [float(scores.min()), float(scores.max())]
    axis.plot(ends, ends, color="0.7", lw=1, zorder=0)
    axis.plot(scores[1], scores[0], "o", color=LANDMARK, ms=5)
    axis.set(xlabel="people's", ylabel="automatic", title="scores of the first component")
    for axis in axes[0, 1:]:
        axis.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_landmarks(axis: "Axes", mean: np.ndarray, bias: np.ndarray, random_error: np.ndarray) -> None:
    """Draw the bias of each landmark as an arrow, and its random error as a circle, both magnified alike."""
    from matplotlib.patches import Circle

    largest = max(float(np.linalg.norm(bias, axis=1).max()), float(random_error.max()))
    factor = SHOWN * float(np.ptp(mean, axis=0).max()) / largest if largest > 0 else 1.0
    for number, (point, radius) in enumerate(zip(mean, random_error, strict=True), 1):
        axis.add_patch(Circle((point[0], point[1]), factor * radius, fill=False, color="0.6"))
        axis.annotate(str(number), point, (4, 4), textcoords="offset points", fontsize=7, color="0.4")
    axis.plot(*mean.T, "o", color="0.4", ms=3)
    axis.quiver(*mean.T, *(factor * bias).T, angles="xy", scale_units="xy", scale=1, color=LANDMARK, width=0.007)
    axis.set_title(f"bias (arrows) and random error (circles), {factor:.2g} times", fontsize=10)
    axis.set_aspect("equal")
    axis.margins(0.15)
    axis.invert_yaxis()
    axis.set_axis_off()
