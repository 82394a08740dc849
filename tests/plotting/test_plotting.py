"""Figures: styles that tell methods apart, and files that do not change from run to run."""

import numpy as np

from experiments.charts import COLOURS, FLOOR, Panel, colour_of, figure_of_curves, style_of
from liaam.fitting import METHODS
from liaam.plotting import save_figure


def test_every_method_has_a_colour_of_its_own():
    assert set(METHODS) <= set(COLOURS)
    assert len(set(COLOURS.values())) == len(COLOURS)


def test_suffixes_keep_the_colour_and_dash_the_line():
    assert colour_of("li+noise") == colour_of("li")
    lines = [style_of(method, 6)["ls"] for method in ("li", "li+noise", "li+noise+tukey")]
    assert lines == ["-", "--", ":"]
    assert colour_of("my own") == "#222222"


def test_marks_of_methods_that_coincide_lie_apart_where_points_are_many():
    offsets = [style_of(method, 51)["markevery"][0] for method in ("li", "li-lit", "li-pc", "li-pcs")]
    assert len(set(offsets)) > 2
    assert {style_of(method, 6)["markevery"] for method in METHODS} == {(0, 1)}


def figure(y, log=True):
    return figure_of_curves(
        [Panel("x, px", "y, px", {"li": list(enumerate(y))}, {"bound": [(0, 0.0), (1, 1.0)]}, log=log)]
    )


def test_axis_is_logarithmic_only_where_values_span_a_decade():
    wide, narrow = figure([0.0, 5.0]), figure_of_curves([Panel("x", "y", {"li": [(0, 1.0), (1, 5.0)]}, log=True)])
    assert wide.axes[0].get_yscale() == "log"
    assert narrow.axes[0].get_yscale() == "linear"
    line, bound = (curve.get_ydata() for curve in wide.axes[0].get_lines())
    assert np.array_equal(line, [FLOOR, 5.0])
    assert np.isnan(bound[0])


def test_the_same_figure_gives_the_same_bytes(tmp_path):
    for name in "ab":
        save_figure(figure([0.01, None, 4.0]), tmp_path / f"{name}.svg", tmp_path / f"{name}.png")
    for suffix in (".svg", ".png"):
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    assert "<dc:date>" not in (tmp_path / "a.svg").read_text()
