"""Pictures: overlays of fits, models to look at, and the figures of experiments."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.evaluation import cumulative_errors
from liaam.io import atomic_path
from liaam.label_faults import LabelFault
from liaam.lamps import Lamps
from liaam.model import AAM
from liaam.photometry import linear_to_srgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {
    "soft-li": "#7b2ff2",
    "grey": "#9a9a9a",
    "rgb": "#e8743b",
    "li": "#19a979",
    "li-lit": "#0f6e4f",
    "li-pc": "#5899da",
    "li-pcs": "#1d4e89",
    "chroma": "#b565a7",
    "grey-plain": "#5c5c5c",
    "grey-norm": "#8a7f5c",
    "varied": "#9c5b3b",
    "aia": "#d4a017",
    "igo": "#c2185b",
}
"""One colour per method, the same in every figure."""

MARKERS = {
    "grey": "s",
    "rgb": "o",
    "li": "o",
    "li-lit": "s",
    "li-pc": "^",
    "li-pcs": "v",
    "chroma": "D",
    "grey-plain": "P",
    "grey-norm": "X",
    "varied": "<",
    "aia": ">",
    "igo": "*",
    "soft-li": "h",
}
"""One marker per method."""

ON_TOP = {"li": (4.0, 4.0), "li-lit": (1.2, 8.0), "li-pc": (1.8, 6.0), "li-pcs": (1.0, 6.0)}
"""Width of line and size of marker of methods that may coincide: a thin line with a large hollow marker lies
visibly on a wide line with a small one."""

LINE_WIDTH = 1.8

DASHES = ((0, (1, 1.5)), (0, (5, 2)), (0, (6, 2, 1, 2)))
"""Dashes of lines to compare with, such as a bound."""

FLOOR = 1e-3
"""What a logarithmic axis of errors shows at least; smaller errors are drawn there."""


def base_of(method: str) -> str:
    """Name of a method without its suffixes (``li`` of ``li+noise``)."""
    return method.partition("+")[0]


OTHERS = ("#1d4e89", "#e8743b", "#19a979", "#b565a7", "#d4a017", "#5c5c5c")
"""Colours of curves that are of no method, in turn."""


def colour_of(method: str) -> str:
    """Colour of a method in figures, suffixes or not; black for one of your own (several: see :data:`OTHERS`)."""
    return COLOURS.get(base_of(method), "#222222")


def style_of(method: str, n_points: int) -> dict[str, Any]:
    """How to draw a method's curve of so many points.

    One colour and marker per method, dashed with a suffix, dotted with two. Of many points some are marked, of
    each method others, so that no curve hides another's marks.
    """
    base = base_of(method)
    step = max(1, n_points // 8)
    place = list(MARKERS).index(base) if base in MARKERS else 0
    offset = place * max(1, step // 6) % step
    width, size = ON_TOP.get(base, (LINE_WIDTH, 5.0))
    hollow = base in ON_TOP and base != "li"
    n_suffixes = method.count("+")
    return {
        "color": colour_of(method),
        "lw": LINE_WIDTH if n_suffixes else width,
        "ls": ("-", "--", ":")[min(n_suffixes, 2)],
        "alpha": 0.55 if base == "li" and not n_suffixes else 1.0,
        "marker": MARKERS.get(base, "."),
        "markevery": (offset, step),
        "ms": size,
        "mfc": "none" if hollow or n_suffixes else colour_of(method),
        "mew": 1.2,
        "zorder": 3.0 + list(ON_TOP).index(base) if base in ON_TOP else 2.5,
    }


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


def ellipses(points: np.ndarray, covariances: np.ndarray, share: float = 0.95, n: int = 32) -> np.ndarray:
    """Ellipses that hold a share of Gaussian points.

    Parameters
    ----------
    points : (m, 2) float
    covariances : (m, 2, 2) float
    share : float
    n : int
        Points on each ellipse.

    Returns
    -------
    (m, n, 2) float64
    """
    values, axes = np.linalg.eigh(np.nan_to_num(covariances))
    # The square of a distance in standard deviations is chi-squared with two degrees of freedom.
    radii = np.sqrt(-2.0 * np.log(1.0 - share) * np.maximum(values, 0.0))
    turn = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return points[:, None] + np.einsum("mab,mb,nb->mna", axes, radii, circle)


def enlarged(image: np.ndarray) -> tuple[np.ndarray, int]:
    """Copy of a picture to draw on, (h', w', 3) uint8, and how often its size it has: small ones are enlarged."""
    import cv2

    picture = as_picture(image)
    zoom = max(1, round(700 / max(picture.shape[:2])))
    if zoom == 1:
        return picture.copy(), 1
    return cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC), zoom


def overlay(
    image: np.ndarray,
    shape: np.ndarray,
    model: AAM,
    colour: tuple[int, int, int] = (64, 255, 140),
    covariances: np.ndarray | None = None,
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
    covariances : (n, 2, 2) float, optional
        Of the landmarks, image pixels squared: their 95 % ellipses are drawn.

    Returns
    -------
    (h', w', 3) uint8
        The picture, small ones enlarged so that the lines do not cover them.
    """
    import cv2

    picture, zoom = enlarged(image)
    size = float(np.ptp(shape, axis=0).max()) * zoom if np.isfinite(shape).all() else 100.0
    size = float(np.clip(size, 1.0, 4 * max(picture.shape[:2])))  # a lost fit may be of any size
    thick = max(1, round(size / 300))
    # OpenCV draws on pixel centres with a fixed-point fraction of 4 bits.
    points = np.clip(np.nan_to_num((shape + 0.5) * zoom - 0.5), -1e6, 1e6)
    fixed = np.rint(points * 16).astype(np.int32)
    faint = picture.copy()
    edges = fixed[mesh_edges(model.triangles)].reshape(-1, 2, 1, 2)
    cv2.polylines(faint, list(edges), False, colour, thick, cv2.LINE_AA, 4)
    weight = 0.35 if model.contours else 0.6
    picture = cv2.addWeighted(faint, weight, picture, 1 - weight, 0)
    for indices, closed in model.contours:
        cv2.polylines(picture, [fixed[list(indices)].reshape(-1, 1, 2)], closed, colour, thick, cv2.LINE_AA, 4)
    if covariances is not None:
        rings = ellipses(points, zoom**2 * np.asarray(covariances))
        rings = np.clip(np.rint(rings * 16), -(2**30), 2**30).astype(np.int32)
        cv2.polylines(picture, list(rings), True, (255, 220, 64), thick, cv2.LINE_AA, 4)
    radius = int(16 * max(1.2, size / 180))
    for x, y in fixed:
        cv2.circle(picture, (int(x), int(y)), radius, (0, 0, 0), -1, cv2.LINE_AA, 4)
        cv2.circle(picture, (int(x), int(y)), int(radius * 0.7), colour, -1, cv2.LINE_AA, 4)
    return picture


def overlay_of_faults(image: np.ndarray, points: np.ndarray, faults: Sequence[LabelFault]) -> np.ndarray:
    """Draw landmarks on their picture, those at fault in red, numbered, with lines to where the others have them.

    Parameters
    ----------
    image : (h, w, 3) array
    points : (n, 2) float
        Landmarks, image pixels.
    faults : sequence of LabelFault
        Of this picture.

    Returns
    -------
    (h', w', 3) uint8
        The surroundings of the landmarks, enlarged.
    """
    import cv2

    margin = 0.15 * np.ptp(points, axis=0).max() + 5
    whole = np.array(image.shape[1::-1])
    low = np.clip(np.floor(points.min(axis=0) - margin), 0, whole).astype(int)
    high = np.clip(np.ceil(points.max(axis=0) + margin), 0, whole).astype(int)
    if (high - low < 8).any():  # landmarks of another picture, or of one that was larger
        low, high = np.zeros(2, int), whole
    picture, zoom = enlarged(image[low[1] : high[1], low[0] : high[0]])

    def at(place: np.ndarray) -> tuple[int, int]:
        x, y = np.clip(np.rint((place - low + 0.5) * zoom - 0.5), -1e6, 1e6)
        return int(x), int(y)

    size = max(picture.shape[:2]) / 700
    thick, radius = max(1, round(size)), max(2, round(3 * size))
    for point in points:
        cv2.circle(picture, at(point), radius, (64, 255, 140), -1, cv2.LINE_AA)
    for fault in faults:
        for i in fault.points:
            cv2.line(picture, at(points[i]), at(fault.expected[i]), (255, 220, 64), thick, cv2.LINE_AA)
            cv2.circle(picture, at(points[i]), radius, (255, 40, 40), -1, cv2.LINE_AA)
        for i in fault.points:
            x, y = at(points[i])
            place = (x + 2 * radius, y - radius)
            cv2.putText(picture, str(i + 1), place, cv2.FONT_HERSHEY_SIMPLEX, 0.45 * size, (255, 255, 255), thick)
    return picture


def save_figure(figure: "Figure", *paths: Path, dpi: int = 120) -> None:
    """Write a figure atomically, in the format of each path's suffix, and close it.

    The same figure gives the same bytes: files bear no date, and an SVG's names are not drawn by chance.
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
    """Make a figure of a size in inches with a grid of axes, (rows, columns), whatever the display."""
    import matplotlib

    matplotlib.use("Agg", force=False)
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        rows, columns, figsize=size, squeeze=False, constrained_layout=True, height_ratios=heights
    )
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


def show_picture(axis: "Axes", image: np.ndarray, title: str) -> None:
    """Show a picture with a title and no axes."""
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
    figure, axes = subplots(1, 2 + len(fits), (3.1 * (2 + len(fits)), 4.4))
    show_picture(axes[0, 0], training, "one of the training pictures")
    show_picture(axes[0, 1], image, "new picture, hard lateral light: start")
    _draw_shape(axes[0, 1], start, model, "#ffd166")
    for axis, (method, (shape, error)) in zip(axes[0, 2:], fits.items(), strict=True):
        show_picture(axis, image, f"{method}: {error:.1f} px")
        _draw_shape(axis, truth, model, "white", "truth", lw=0.9)
        _draw_shape(axis, shape, model, colour_of(method), method)
        axis.legend(loc="lower right", fontsize=7, framealpha=0.6)
    return figure


def figure_of_model(model: AAM, n_modes: int = 3) -> "Figure":
    """Mean appearance with mesh, and what the first shape and appearance modes do (two standard deviations)."""
    shape_model, appearance = model.shape_model, model.levels[-1].appearances["value"]
    shown = max(1, min(n_modes, max(len(shape_model.modes), appearance.n_modes)))
    figure, axes = subplots(2, 2 + shown, (2.6 * (2 + shown), 6.0))
    mean = _mean_picture(model)
    show_picture(axes[0, 0], mean, "mean appearance")
    show_picture(axes[1, 0], mean, f"mesh, {model.n_points} landmarks")
    axes[1, 0].triplot(*(shape_model.mean - model.frame.origin).T, model.triangles, color="#19a979", lw=0.7)
    show_picture(axes[0, 1], _log_picture(model), "mean of the logarithms")
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
    show_picture(
        axis,
        np.concatenate([pair[0][:, :half], pair[1][:, half:]], axis=1),
        f"appearance mode {i + 1}, −2 | +2 sd",
    )


def figure_of_errors(errors: Mapping[str, Sequence[float]], bound: Iterable[float], limit: float) -> "Figure":
    """Cumulative error distributions of methods and of the shape model's own bound, in per cent of IOD."""
    figure, axes = subplots(1, 1, (6.4, 4.4))
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
        shares = cumulative_errors(np.array(values), grid)
        axis.plot(100 * grid, 100 * shares, label=label, **style_of(method, len(grid)))
    axis.axvline(100 * limit, color="#dddddd", lw=1, zorder=0)
    axis.set(xlabel="error, % of inter-ocular distance", ylabel="fits at or below, %", xlim=(0, 12), ylim=(0, 101))
    axis.legend(loc="lower right", fontsize=8, frameon=False)
    axis.spines[["top", "right"]].set_visible(False)
    return figure


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves in one pair of axes.

    Attributes
    ----------
    x_label, y_label : str
        With units.
    curves : mapping of method to points (x, y)
        NaN or None leaves a gap.
    references : mapping of name to points (x, y)
        Lines to compare with, such as a bound; drawn in black dashes.
    title : str
    log : bool
        Whether the y axis is logarithmic where the values span more than a decade.
    """

    x_label: str
    y_label: str
    curves: Mapping[str, Sequence[tuple[float, float | None]]]
    references: Mapping[str, Sequence[tuple[float, float | None]]] = field(default_factory=dict)
    title: str = ""
    log: bool = False


def figure_of_curves(panels: Sequence[Panel]) -> "Figure":
    """Curves of methods or of anything else, a panel beside the other, with one legend."""
    figure, axes = subplots(1, len(panels), (5.0 * len(panels) + 1.5, 4.2))
    strange = list(dict.fromkeys(name for panel in panels for name in panel.curves if base_of(name) not in COLOURS))
    colours = dict(zip(strange, cycle(OTHERS))) if len(strange) > 1 else {}
    references = list(dict.fromkeys(name for panel in panels for name in panel.references))
    dashes = {name: DASHES[i % len(DASHES)] for i, name in enumerate(references)}
    for axis, panel in zip(axes[0], panels, strict=True):
        _draw_panel(axis, panel, dashes, colours)
    handles: dict[str, Any] = {}
    for axis in axes[0]:
        handles |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    figure.legend(
        handles.values(), handles.keys(), loc="outside right center", fontsize=9, frameon=False, handlelength=3.2
    )
    return figure


def _draw_panel(axis: "Axes", panel: Panel, dashes: Mapping[str, Any], colours: Mapping[str, str]) -> None:
    log = panel.log and _spans_a_decade([*panel.curves.values(), *panel.references.values()])
    for method, points in panel.curves.items():
        style = style_of(method, len(points))
        if method in colours:
            style |= {"color": colours[method], "mfc": colours[method]}
        axis.plot(*_columns(points, log), label=method, **style)
    for name, points in panel.references.items():
        x, y = _columns(points, log)
        y[log & (y <= FLOOR)] = np.nan  # a bound of 0 (no noise, say) is no reason for a longer axis
        axis.plot(x, y, color="black", lw=1.2, ls=dashes[name], label=name, zorder=8)
    if log:
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter(lambda value, _: f"≤ {value:g}" if np.isclose(value, FLOOR) else f"{value:g}")
    else:
        axis.set_ylim(bottom=0)
    values = sorted({x for points in panel.curves.values() for x, _ in points})
    if len(values) <= 10:  # a sweep: its own values are what was measured
        axis.set_xticks(values)
    axis.set(xlabel=panel.x_label, ylabel=panel.y_label, title=panel.title)
    axis.grid(axis="y", color="#e6e6e6", lw=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def _spans_a_decade(lines: Sequence[Sequence[tuple[float, float | None]]]) -> bool:
    values = np.concatenate([_columns(points, log=True)[1] for points in lines])
    values = values[np.isfinite(values)]
    return len(values) > 0 and bool(values.max() > 10 * values.min())


def _columns(points: Sequence[tuple[float, float | None]], log: bool) -> np.ndarray:
    """Points as (2, n) float64; what is too small for a logarithmic axis lies on its floor."""
    x, y = np.array(list(points), dtype=np.float64).reshape(-1, 2).T
    return np.stack([x, np.maximum(y, FLOOR) if log else y])


def figure_of_bars(
    groups: Mapping[str, Mapping[str, float | None]], label: str, colours: Callable[[str], str] = colour_of
) -> "Figure":
    """Horizontal bars of methods, a panel for each group; None (no finite value) has no bar.

    Parameters
    ----------
    groups : mapping of title to (mapping of method to value)
    label : str
        What the values are, with their unit.
    colours : callable
        Colour of a method.
    """
    longest = max(len(values) for values in groups.values())
    # A long row of panels would be shrunk on a page until its labels cannot be read.
    rows = 1 if len(groups) <= 3 else 2
    columns = -(-len(groups) // rows)
    figure, axes = subplots(rows, columns, (4.6 * columns, rows * (0.36 * longest + 1.3)))
    for axis in axes.ravel()[len(groups) :]:
        axis.remove()
    for axis, (title, values) in zip(axes.ravel(), groups.items(), strict=False):
        sizes = [np.nan if value is None else value for value in values.values()]
        bars = axis.barh(list(values), sizes, color=[colours(method) for method in values], height=0.7)
        axis.bar_label(bars, [_short(size) for size in sizes], padding=3, fontsize=8)
        axis.invert_yaxis()
        axis.margins(x=0.15)
        axis.set_xlabel(label, fontsize=9)
        axis.set_title(title, fontsize=10)
        axis.spines[["top", "right"]].set_visible(False)
    return figure


def _short(value: float) -> str:
    if np.isnan(value):
        return "–"
    return f"{value:.2f}" if value >= 0.01 else "< 0.01"


LAMPS_DRAWN, LAMPS_ACROSS = 47, 8
"""Lamps that are drawn at most, and pictures in a row."""


def figure_of_lamps(lamps: Lamps, image: np.ndarray | None = None, points: np.ndarray | None = None) -> "Figure":
    """A picture and what each lamp makes of it.

    Parameters
    ----------
    lamps : Lamps
    image : (h, w, 3) array, optional
        In the light of training; plain grey if left out, under the mean landmarks.
    points : (n, 2) float, optional
        Its landmarks.
    """
    if image is None or points is None:
        image = np.full((160, 160, 3), 128, np.uint8)
        points = 79.5 + 100.0 * lamps.mean
    shown = range(min(len(lamps), LAMPS_DRAWN))
    titles = ["light of training", *(lamps.names[i] for i in shown)]
    lit = [image, *lamps.relit(image, points, shown)]
    pictures: list[tuple[str, np.ndarray | None]] = list(zip(titles, lit, strict=True))
    rows = [pictures[first : first + LAMPS_ACROSS] for first in range(0, len(pictures), LAMPS_ACROSS)]
    rows[-1] += [(" " * i, None) for i in range(len(rows[0]) - len(rows[-1]))]
    figure = figure_of_pictures([dict(row) for row in rows], 1.6)
    figure.axes[0].plot(*points.T, ".", color="white", ms=1.5)
    return figure


def figure_of_pictures(rows: Sequence[Mapping[str, np.ndarray | None]], width: float = 2.6) -> "Figure":
    """Pictures with titles, a row for each mapping; None leaves a gap, and a column without any picture is left out.

    ``width`` is that of a picture, inches.
    """
    shown = [i for i in range(len(rows[0])) if any(list(row.values())[i] is not None for row in rows)]
    first = next(image for image in rows[0].values() if image is not None)
    height = width * first.shape[0] / first.shape[1] + 0.3
    figure, axes = subplots(len(rows), len(shown), (width * len(shown), height * len(rows)))
    for line, row in zip(axes, rows, strict=True):
        titles, images = list(row), list(row.values())
        for axis, i in zip(line, shown, strict=True):
            axis.axis("off")
            image = images[i]
            if image is not None:
                show_picture(axis, image, titles[i])
    return figure
