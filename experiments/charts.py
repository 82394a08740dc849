"""Figures of experiments: curves, bars, cumulative errors, rows of images."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from liaam.error_measures import cumulative_errors
from liaam.plotting.figures import LINE_WIDTH, subplots

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
"""Colour of each method in all figures."""

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

DASHES = ((0, (1, 1.5)), (0, (5, 2)), (0, (6, 2, 1, 2)))
"""Dashes of reference lines, such as a bound."""

FLOOR = 1e-3
"""Lower limit of a logarithmic axis of errors. Smaller errors are drawn there."""

MOST_ACROSS = 2
"""Entries of a legend below each panel."""

OTHERS = ("#1d4e89", "#e8743b", "#19a979", "#b565a7", "#d4a017", "#5c5c5c")
"""Colours of curves that do not show a method, in turn."""


def base_of(method: str) -> str:
    """Return the name of a method without its suffixes (``li`` for ``li+noise``)."""
    return method.partition("+")[0]


def colour_of(method: str) -> str:
    """Return the colour of a method, with or without suffixes; dark grey for methods not in :data:`COLOURS`."""
    return COLOURS.get(base_of(method), "#222222")


def style_of(method: str, n_points: int) -> dict[str, Any]:
    """Return the style of a method's curve of `n_points` points.

    There is one colour and marker per method, dashed with a suffix and dotted with two. Long curves have markers on
    some points only, at different places for each method, so that markers do not hide each other.
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
    """Draw curves in panels side by side, with one legend below. Their letters can be read on a page of two panels."""
    figure, axes = subplots(1, len(panels), (4.0 * len(panels), 4.4))
    strange = list(dict.fromkeys(name for panel in panels for name in panel.curves if base_of(name) not in COLOURS))
    colours = dict(zip(strange, cycle(OTHERS))) if len(strange) > 1 else {}
    references = list(dict.fromkeys(name for panel in panels for name in panel.references))
    dashes = {name: DASHES[i % len(DASHES)] for i, name in enumerate(references)}
    for axis, panel in zip(axes[0], panels, strict=True):
        _draw_panel(axis, panel, dashes, colours)
    handles: dict[str, Any] = {}
    for axis in axes[0]:
        handles |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    columns = min(len(handles), MOST_ACROSS * len(panels))
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=columns, frameon=False, handlelength=3.2
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
        y[log & (y <= FLOOR)] = np.nan  # do not extend the axis for a bound of 0, as without noise
        axis.plot(x, y, color="black", lw=1.2, ls=dashes[name], label=name, zorder=8)
    if log:
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter(lambda value, _: f"≤ {value:g}" if np.isclose(value, FLOOR) else f"{value:g}")
    else:
        axis.set_ylim(bottom=0)
    values = sorted({x for points in panel.curves.values() for x, _ in points})
    if len(values) <= 10:  # a sweep: put ticks at its values
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
    """Return points as (2, n) float64. Values too small for a logarithmic axis are raised to its lower limit."""
    x, y = np.array(list(points), dtype=np.float64).reshape(-1, 2).T
    return np.stack([x, np.maximum(y, FLOOR) if log else y])


def figure_of_bars(
    groups: Mapping[str, Mapping[str, float | None]], label: str, colours: Callable[[str], str] = colour_of
) -> "Figure":
    """Draw horizontal bars of methods, one panel per group. None (no finite value) has no bar.

    ``groups`` are values by method, by the title of the panel; ``label`` is their name and unit.
    """
    longest = max(len(values) for values in groups.values())
    # The labels of a long row of panels would be too small to read on a page.
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
